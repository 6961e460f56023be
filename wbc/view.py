"""A window on the running simulation, in real time, when there is a display."""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

FRAME = 1 / 60  # [s]

Show = Callable[[Any], None]


@contextmanager
def window() -> Iterator[Show | None]:
    """A function that draws a simulator in real time; None, with a line on stderr, where there is no display."""
    if sys.platform.startswith("linux") and not (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")):
        print("no display: running without a window (--headless says so on purpose)", file=sys.stderr)
        yield None
        return
    import mujoco.viewer

    opened: list[Any] = []
    clock = [0.0, 0.0]  # wall time of the start, simulated time of the last frame

    def show(simulator: Any) -> None:
        if not opened:
            opened.append(mujoco.viewer.launch_passive(simulator.model, simulator.data))
            clock[0] = time.perf_counter() - simulator.data.time
        if simulator.data.time - clock[1] >= FRAME and opened[0].is_running():
            clock[1] = simulator.data.time
            opened[0].sync()
            time.sleep(max(0.0, clock[0] + simulator.data.time - time.perf_counter()))

    try:
        yield show
    finally:
        for viewer in opened:
            viewer.close()
