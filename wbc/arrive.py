"""The controller after one tick that is to be looked at: of a log, or of a run to it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from .controller import Controller
from .replay import Replay
from .spec import Spec


def is_log(name: str) -> bool:
    """Whether a name is that of a log, an npz file or the folder of a run; else it is that of a spec."""
    return name.endswith(".npz") or Path(name, "log.npz").is_file()


def logged(
    log: str, tick: int | None, at: float | None, solver: str | None = None, overrides: Sequence[str] = ()
) -> tuple[Controller, dict[str, Any]]:
    """The controller after a tick of a log, by its number or time [s], solved again as it was or with changes as of
    `--set`; which tick that is, and what is not as it was. Raises LogError, SpecError."""
    run = Replay(log)
    tick = run.tick_at(at) if at is not None else tick or 0
    controller, arguments = run.at(tick)
    changed = solver is not None or bool(overrides)
    if changed:
        other = run.other(solver, overrides)
        other.memory, controller = controller.memory, other
    out, notes = controller.step(*arguments), run.notes
    if not changed and not run.recorded(tick).same(out):
        notes.append("the tick is not what was recorded, bit for bit")
    return controller, {"log": log, "tick": tick, "notes": notes}


def simulated(spec: Spec, seed: int, progress: Callable[[int], None] | None = None) -> Controller:
    """The controller after the last tick of a spec's run."""
    from .build import build
    from .run import run

    built = build(spec)
    run(built, seed, progress)
    return built.controller
