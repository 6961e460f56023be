"""What this installation consists of, and what is wrong with it: each finding with what to do.

A `problem` is something that the package needs and that is broken, a `note` something that costs speed, steadiness or
an optional feature. Nothing here is needed by a controller; every examination imports what it looks at, and one that
fails is a finding itself.
"""

from __future__ import annotations

import importlib.metadata
import os
import platform
import re
import sys
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any

from .machine import Finding, loaded

# the least version of what the package needs, as in pyproject.toml
NEEDED = {
    "numpy": "2.0", "numba": "0.61", "pin": "4.0", "mujoco": "4.0", "proxsuite": "0.7", "qpsolvers": "4.4",
    "daqp": "0.8", "highspy": "1.10", "pydantic": "2.8", "pyyaml": "6.0", "click": "8.1", "rich": "13.7",
    "matplotlib": "3.8",
}  # fmt: skip
DIRECT = ("daqp", "proxqp")  # solvers that the package needs; the others are extras
AGREES = 1e-6  # how far the answer to the small program may be from the known one


def examine(seconds: float = 1.0, rendering: bool = True) -> dict[str, Any]:
    """Everything, as one JSON object: `ok`, `findings`, and what there is by name.

    `seconds`: how long the timer is watched [s]; `rendering`: whether a frame is drawn off screen, in a process of its
    own, which takes seconds.
    """
    from . import __version__, machine
    from .resources import shipped_names

    ways: list[Callable[[], Iterable[Finding]]] = [_python, _packages, _pinocchio, _solvers, _kernels]
    ways += [lambda: machine.timer(seconds), machine.scheduler, machine.algebra, machine.pictures]
    ways += [machine.rendering] if rendering else []
    findings = [finding for way in ways for finding in _guarded(way)]
    solvers = [each.name.removeprefix("solver ") for each in findings if each.name.startswith("solver ")]
    return {
        "wbc": __version__,
        "ok": all(each.status != "problem" for each in findings),
        "findings": [each._asdict() for each in findings],
        "python": f"{platform.python_version()} at {sys.executable}",
        "platform": platform.platform(),
        "packages": {name: version(name) or "missing" for name in NEEDED},
        "solvers": solvers,
        "specs": shipped_names("tasks", ".yaml"),
        "robots": shipped_names("scenes/robots", ".xml"),
    }


def _guarded(way: Callable[[], Iterable[Finding]]) -> list[Finding]:
    try:
        return list(way())
    except Exception as error:  # a broken installation may raise anything
        name = getattr(way, "__name__", "examination").strip("_<>")
        message = " ".join(f"{type(error).__name__}: {error}".split())
        return [Finding(name, "problem", message[:300], "reinstall the package that this names: pip install wbc")]


def version(name: str) -> str:
    """The version of an installed distribution, or nothing."""
    try:
        return importlib.metadata.version(name)
    except importlib.metadata.PackageNotFoundError:
        return ""


def older(found: str, least: str) -> bool:
    """Whether a version is older than the least one, by its numbers."""
    return [int(n) for n in re.findall(r"\d+", found)[:2]] < [int(n) for n in re.findall(r"\d+", least)]


def _python() -> Iterator[Finding]:
    from . import __file__ as here
    from . import __version__

    yield Finding("wbc", "ok", f"{__version__} at {Path(here).parent}")
    old = sys.version_info < (3, 11)
    yield Finding(
        "python", "problem" if old else "ok", f"{platform.python_version()} at {sys.executable}",
        "expected Python 3.11 or newer" if old else "",
    )  # fmt: skip


def _packages() -> Iterator[Finding]:
    for name, least in NEEDED.items():
        found = version(name)
        if name == "pin" and not found:
            continue  # Pinocchio may come from elsewhere, see below
        if not found or older(found, least):
            yield Finding(
                name, "problem", found or "missing", f"expected {least} or newer: pip install '{name}>={least}'"
            )
        else:
            yield Finding(name, "ok", found)


def _pinocchio() -> Iterator[Finding]:
    """A copy of ROS or of conda before that of `pin` is a frequent trouble, and two in one process crash."""
    import pinocchio

    here = Path(pinocchio.__file__).resolve()
    found = f"{pinocchio.__version__} from {here.parent}"
    unset = f"take {_entry(here)} out of PYTHONPATH" if _entry(here) else "use an environment with one Pinocchio"
    if older(pinocchio.__version__, NEEDED["pin"]):
        yield Finding("pinocchio", "problem", found, f"expected {NEEDED['pin']} or newer; {unset}, pip install pin")
    elif (own := _own()) and here not in own:
        yield Finding("pinocchio", "problem", found, f"it shadows that of `pin` in {own[0].parent}; {unset}")
    elif not own:
        yield Finding("pinocchio", "note", found, "it is not that of the package `pin`, with which wbc is tested")
    else:
        yield Finding("pinocchio", "ok", found)
    if others := [path for path in copies(sys.path) if path != here]:
        do = "fine as long as it comes first; an environment without ROS or conda in PYTHONPATH is safer"
        yield Finding("other Pinocchios", "note", ", ".join(str(path.parent) for path in others), do)
    if len(twice := loaded("libpinocchio_default")) > 1:
        yield Finding(
            "pinocchio library", "problem", f"loaded twice: {', '.join(twice)}", f"{unset}, and LD_LIBRARY_PATH"
        )


def _own() -> list[Path]:
    """Where the distribution `pin` has its module."""
    try:
        files = importlib.metadata.distribution("pin").files or []
    except importlib.metadata.PackageNotFoundError:
        return []
    return [Path(str(f.locate())).resolve() for f in files if f.parts[-2:] == ("pinocchio", "__init__.py")]


def copies(folders: Iterable[str]) -> list[Path]:
    """Every Pinocchio that an import could find, the first one first."""
    found = (Path(folder, "pinocchio", "__init__.py") for folder in folders)
    return list(dict.fromkeys(path.resolve() for path in found if path.is_file()))


def _entry(module: Path) -> str:
    """The entry of PYTHONPATH that a module was found through, or nothing."""
    entries = [entry for entry in os.environ.get("PYTHONPATH", "").split(os.pathsep) if entry]
    return next((entry for entry in entries if module.is_relative_to(Path(entry).resolve())), "")


def _solvers() -> Iterator[Finding]:
    """Each solves one small program with a known answer, and its answer is certified."""
    from .solver import DEFAULT, installed

    there = installed()
    for name in dict.fromkeys([*DIRECT, *there]):
        if name not in there:
            yield Finding(f"solver {name}", "problem", "missing", "pip install wbc")
            continue
        told = solves(name)
        status = "problem" if name in DIRECT else "note"
        default = " (the default)" if name == DEFAULT else ""
        if told:
            yield Finding(f"solver {name}", status, told, f"do not use it here, or reinstall it{default}")
        else:
            yield Finding(f"solver {name}", "ok", f"certified{default}")


def solves(solver: Any) -> str:
    """What is wrong with the answer of a solver, by name or object, to one small program; nothing when it is right.

    min x1^2 / 2 + x2^2 / 2 - x2 with x1 + x2 = 1 and x2 <= 3/4: (1/4, 3/4).
    """
    import numpy as np

    from .qp import Problem
    from .solver import answer, make

    stack = np.array([[1.0, 0.0], [0.0, 1.0], [1.0, 1.0]])
    lo, hi = np.array([-np.inf, -np.inf, 1.0]), np.array([np.inf, 0.75, 1.0])
    problem = Problem(stack[:2], np.array([0.0, -1.0]), stack[2:], lo, hi, 1, stack)
    solution = answer(make(solver), problem)
    if not solution.accepted:
        return solution.reason
    error = float(np.abs(solution.x - [0.25, 0.75]).max())
    return "" if error < AGREES else f"certified, and {error:.1e} from the known answer"


def _kernels() -> Iterator[Finding]:
    """Whether what was compiled is kept: else every start compiles for a minute."""
    from .kernels import motion

    stats: Any = motion.log.stats  # type: ignore[attr-defined]
    folder = Path(stats.cache_path)
    if not os.access(folder if folder.exists() else folder.parent, os.W_OK):
        yield Finding(
            "kernels", "note", f"cannot be kept in {folder}", "NUMBA_CACHE_DIR=FOLDER names one that can be written"
        )
    elif sum(stats.cache_misses.values()):
        yield Finding("kernels", "note", f"compiled just now, kept in {folder}", "nothing: the next start is faster")
    else:
        yield Finding("kernels", "ok", f"kept in {folder}")
