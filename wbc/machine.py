"""What the machine lets a control loop do: its timer, its scheduler, its algebra library, its renderer."""

from __future__ import annotations

import ctypes
import os
import platform
import re
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

PERIOD = 1e-3  # [s]
RENDERERS = ("egl", "osmesa", "glfw")
CAP_SYS_NICE = 23
_FRAME = """
import mujoco
model = mujoco.MjModel.from_xml_string('<mujoco><worldbody><light pos="0 0 3"/><geom size="1"/></worldbody></mujoco>')
data = mujoco.MjData(model)
mujoco.mj_forward(model, data)
renderer = mujoco.Renderer(model, 48, 64)
renderer.update_scene(data)
assert renderer.render().max() > 0, "the frame is black"
"""


class Finding(NamedTuple):
    """One thing looked at: `status` is "ok", "note" or "problem"; `do` is empty where all is well."""

    name: str
    status: str
    found: str
    do: str = ""


def loaded(name: str, told: Path = Path("/proc/self/maps")) -> list[str]:
    """Files of the shared libraries of that name that are in this process; nothing where the system does not tell."""
    try:
        maps = told.read_text()
    except OSError:
        return []
    return list(dict.fromkeys(re.findall(rf"(/\S*/{re.escape(name)}[^/\s]*\.so\S*)$", maps, re.MULTILINE)))


def lateness(seconds: float, period: float = PERIOD) -> list[float]:
    """How late a loop that sleeps until its next tick wakes, each time [s], sorted."""
    late, ticks = [], max(1, round(seconds / period))
    begun = time.perf_counter()
    for tick in range(1, ticks + 1):
        due = begun + tick * period
        if (left := due - time.perf_counter()) > 0.0:
            time.sleep(left)
        late.append(time.perf_counter() - due)
    return sorted(late)


def timer(seconds: float) -> Iterator[Finding]:
    """The timer's resolution, and how late a loop of 1 kHz wakes from its sleep."""
    resolution = time.get_clock_info("perf_counter").resolution
    late = lateness(seconds)
    median, most = late[len(late) // 2], late[-1]
    p99 = late[min(len(late) - 1, round(0.99 * len(late)))]
    found = f"resolution {resolution * 1e9:.0f} ns; at 1 kHz it wakes {median * 1e6:.0f} us late in the median, "
    found += f"{p99 * 1e6:.0f} us p99, {most * 1e6:.0f} us at most"
    steady = p99 < 0.5 * PERIOD and resolution <= 1e-6
    do = (
        "" if steady else "simulation does not mind; for a robot: fewer programs, a real-time priority, cores set apart"
    )
    yield Finding("timer", "ok" if steady else "note", found, do)


def scheduler() -> Iterator[Finding]:
    """Cores, load, frequency governor, and whether a loop may ask for a real-time priority."""
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    load = os.getloadavg()[0] if hasattr(os, "getloadavg") else 0.0
    busy = load > 0.7 * cores
    yield Finding(
        "cores", "note" if busy else "ok", f"{cores} of {os.cpu_count()}, load {load:.1f}",
        "timings mean little while other programs run" if busy else "",
    )  # fmt: skip
    governors = sorted({_read(path) for path in Path("/sys/devices/system/cpu").glob("cpu*/cpufreq/scaling_governor")})
    slow = bool(governors) and governors != ["performance"]
    yield Finding(
        "governor", "note" if slow else "ok", ", ".join(governors) or "not told by the system",
        "for steady ticks: cpupower frequency-set -g performance" if slow else "",
    )  # fmt: skip
    kernel = "real-time kernel" if _read(Path("/sys/kernel/realtime")) == "1" else f"{platform.system()} kernel"
    allowed = priority()
    yield Finding(
        "real-time priority", "ok" if allowed else "note",
        f"{f'up to {allowed}' if allowed else 'not allowed'}; {kernel}",
        "" if allowed else "for a robot: an rtprio line for the user in /etc/security/limits.conf, and chrt -f 80",
    )  # fmt: skip


def priority() -> int:
    """The highest real-time priority that this process may ask for; 0: none."""
    if not hasattr(os, "sched_get_priority_max"):
        return 0
    import resource

    for line in _read(Path("/proc/self/status")).splitlines():
        if line.startswith("CapEff:") and int(line.split()[1], 16) >> CAP_SYS_NICE & 1:
            return os.sched_get_priority_max(os.SCHED_FIFO)
    limit = resource.getrlimit(resource.RLIMIT_RTPRIO)[0] if hasattr(resource, "RLIMIT_RTPRIO") else 0
    return os.sched_get_priority_max(os.SCHED_FIFO) if limit < 0 else int(limit)


def algebra() -> Iterator[Finding]:
    """Threads of the BLAS: on matrices of a tick's size several cost more than they bring, and unsteady ticks."""
    import numpy as np

    blas = np.show_config("dicts")["Build Dependencies"]["blas"]
    found = f"{blas.get('name')} {blas.get('version')}"
    threads = _threads()
    if threads is None:
        yield Finding("BLAS", "ok", f"{found}, which does not tell its threads")
    elif threads > 1:
        yield Finding("BLAS", "note", f"{found}, {threads} threads", "OMP_NUM_THREADS=1 makes ticks steadier")
    else:
        yield Finding("BLAS", "ok", f"{found}, 1 thread")


def _threads() -> int | None:
    for path in [path for name in ("libscipy_openblas", "libopenblas") for path in loaded(name)]:
        library = ctypes.CDLL(path)
        for name in ("scipy_openblas_get_num_threads64_", "openblas_get_num_threads64_", "openblas_get_num_threads"):
            if hasattr(library, name):
                return int(getattr(library, name)())
    return None


def pictures() -> Iterator[Finding]:
    """Whether report.png can be drawn, which needs no display."""
    import io

    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(1, 1))
    FigureCanvasAgg(figure)
    figure.savefig(stream := io.BytesIO(), format="png")
    yield Finding("report.png", "ok", f"can be drawn ({len(stream.getvalue())} bytes of a trial)")


def rendering() -> Iterator[Finding]:
    """Whether MuJoCo draws a frame off screen, and with what: `wbc` itself needs none."""
    asked = os.environ.get("MUJOCO_GL", "")
    if asked:
        failed = frame(asked)
        if not failed:
            yield Finding("rendering", "ok", f"off screen with MUJOCO_GL={asked}")
            return
        yield Finding(
            "rendering", "note", f"MUJOCO_GL={asked} draws no frame: {failed}", "unset it, or see the next line"
        )
    works = next((name for name in RENDERERS if name != asked and not frame(name)), "")
    if works:
        do = "" if works == "glfw" else f"MUJOCO_GL={works} where a program draws frames; wbc itself draws none"
        yield Finding("off screen", "ok" if not asked else "note", f"{works} draws a frame", do)
    else:
        do = "only for pictures of the scene: install EGL (libegl1) or OSMesa (libosmesa6)"
        yield Finding("off screen", "note", f"none of {', '.join(RENDERERS)} draws a frame", do)
    window = sys.platform != "linux" or os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")
    yield Finding(
        "window", "ok" if window else "note", "a display" if window else "no display", "" if window else "--headless"
    )


def frame(backend: str, timeout: float = 30.0) -> str:
    """Why that backend draws no frame; nothing when it does. In a process of its own: some crash."""
    environment = os.environ | {"MUJOCO_GL": backend}
    try:
        done = subprocess.run(
            [sys.executable, "-c", _FRAME],
            env=environment,
            capture_output=True,
            text=True,
            timeout=timeout,
            check=False,
        )
    except (OSError, subprocess.TimeoutExpired) as error:
        return type(error).__name__
    told = done.stderr.strip().splitlines()
    return "" if done.returncode == 0 else (told[-1][:120] if told else f"exit status {done.returncode}")


def _read(path: Path) -> str:
    try:
        return path.read_text().strip()
    except OSError:
        return ""
