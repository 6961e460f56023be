"""Any tick of a log is solved again: the controller as it was before the tick, and the arguments that it was given.

From the checkpoint before a tick the controller steps through at most `tape.EVERY` ticks to it. With the solver,
weights and limits of the log every torque comes back bit for bit; with others it is the answer to the same question.
"""

from __future__ import annotations

import json
import zipfile
import zlib
from bisect import bisect_right
from collections.abc import Iterator, Sequence
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from .arguments import Arguments
from .controller import Controller
from .errors import LogError
from .ladder import Status
from .log import Log
from .memory import Memory, Output
from .pack import Packed, Structure
from .qp import Array
from .solver import Solver
from .spec import Spec
from .tape import CODEC, FORMAT, PREFIX, Tape, fingerprint, machine

_WRONG = (ValueError, TypeError, LookupError, AttributeError, OverflowError, RecursionError, MemoryError)
_UNREADABLE = (*_WRONG, OSError, EOFError, zipfile.BadZipFile, zlib.error, NotImplementedError)


class Recorded(NamedTuple):
    """What a tick answered when it was recorded."""

    tau: Array
    status: Status
    active: tuple[str, ...]

    def same(self, out: Output) -> bool:
        """Whether another answer is this one, bit for bit."""
        bits = out.tau.tobytes() == self.tau.tobytes()
        return bits and out.status is self.status and out.active == self.active


class Replay:
    """The ticks of one log. Parameters: a file (or the folder of a run), a `Log`, or a `Tape`; `controller`: the one
    that was recorded, where the log has no spec to build it from. Raises LogError, and SpecError for its spec.

    `notes` tell what is not as it was: the model, the solver, the machine.
    """

    def __init__(self, log: str | Path | Log | Tape, controller: Controller | None = None) -> None:
        self.name = str(log) if isinstance(log, str | Path) else type(log).__name__.lower()
        arrays = _arrays(log)
        try:
            self._read(arrays)
        except _WRONG as error:
            raise LogError(self.name, f"not a log that can be replayed: {_told(error)}") from None
        self._given_controller = controller

    def _read(self, arrays: dict[str, NDArray[Any]]) -> None:
        self.about = about = json.loads(str(arrays["about"]))
        if about["format"] != FORMAT:
            raise ValueError(f"its format is {about['format']!r}, expected {FORMAT}")
        kinds = json.loads(str(arrays["kinds"]))
        self.given, self.answered, self.memory = (
            Packed(CODEC, kinds, arrays[f"{name}.kind"], arrays[name]) for name in ("given", "answered", "memory")
        )
        self.checkpoints: list[int] = [int(tick) for tick in arrays["checkpoints"]]
        ordered = all(a < b for a, b in zip(self.checkpoints, self.checkpoints[1:], strict=False))
        begins = self.checkpoints[:1] == [0][: len(self.given)]
        if len(self.memory) != len(self.checkpoints) or not ordered or not begins:
            raise ValueError("its checkpoints are not in order")
        if len(self.answered) > len(self.given):
            raise ValueError("it has more answers than ticks")

    def __len__(self) -> int:
        return len(self.answered)

    # --- what was recorded ---

    @cached_property
    def spec(self) -> Spec | None:
        """The spec as it ran, from the log's own text. Raises SpecError."""
        return _spec(self.about, ()) if self.about.get("spec") is not None else None

    def arguments(self, tick: int) -> Arguments:
        """What the tick was given. Raises LogError."""
        self._check(tick)
        found = self._unpack(self.given, tick, tuple)
        if len(found) != len(Arguments._fields):
            raise LogError(self.name, f"tick {tick} has not the arguments of a step")
        return Arguments(*found)

    def recorded(self, tick: int) -> Recorded:
        """What the tick answered. Raises LogError."""
        self._check(tick)
        found = self._unpack(self.answered, tick, tuple)
        if [type(each) for each in found] != [np.ndarray, Status, tuple]:
            raise LogError(self.name, f"tick {tick} has no torque, status and active limits")
        return Recorded(*found)

    def tick_at(self, t: float) -> int:
        """The last tick not after the time t [s]."""
        times = [self.arguments(tick).t for tick in range(len(self))]
        numbers = [time if isinstance(time, int | float) else np.nan for time in times]
        before = np.flatnonzero(np.array(numbers) <= t + 1e-9)
        if not before.size:
            raise LogError(self.name, f"no tick at {t:g} s; expected from {numbers[0] if numbers else 0:g} s")
        return int(before[-1])

    # --- solved again ---

    @cached_property
    def controller(self) -> Controller:
        """The controller that was recorded, built again. Raises LogError, SpecError."""
        if self._given_controller is not None:
            return self._given_controller
        return self._build(self.spec, None)

    def other(self, solver: str | Solver | None = None, overrides: Sequence[str] = ()) -> Controller:
        """One with another solver, or with changes as of `--set`; give it the memory of the one that was recorded."""
        spec = _spec(self.about, overrides) if self.about.get("spec") is not None else None
        made, own = self._build(spec, solver), self.controller.robot
        if (made.robot.nq, made.robot.joints) != (own.nq, own.joints):
            raise LogError(self.name, f"the log is of {own.name}, with other joints than {made.robot.name}")
        if [phase.name for phase in made.phases] != [phase.name for phase in self.controller.phases]:
            raise LogError(self.name, "the phases are not those of the log; expected the same ones")
        return made

    @property
    def notes(self) -> list[str]:
        """What is not as it was when the log was written."""
        told, controller, now = list[str](), self.controller, machine()
        if fingerprint(controller.robot) != self.about.get("model"):
            told.append(f"the model of {controller.robot.name} is not the one of the log: torques may differ")
        if controller.solver != self.about.get("solver"):
            told.append(f"the log was recorded with the solver {self.about.get('solver')}, not {controller.solver}")
        before = self.about.get("machine")
        before = before if isinstance(before, dict) else {}
        changed = [f"{key} {before.get(key)}, now {now[key]}" for key in now if before.get(key) != now[key]]
        if changed:
            told.append("the last bits may differ on another installation: " + ", ".join(changed))
        return told

    def at(self, tick: int) -> tuple[Controller, Arguments]:
        """The controller set to what it was before a tick, and what that tick was given.

        `controller.step(*arguments)` is the tick. Raises LogError.
        """
        self._check(tick)
        begin = self.checkpoints[bisect_right(self.checkpoints, tick) - 1]
        controller = self._restored(begin)
        for before in range(begin, tick):
            controller.step(*self.arguments(before))
        return controller, self.arguments(tick)

    def each(self, first: int = 0) -> Iterator[tuple[int, Controller, Arguments]]:
        """As `at`, tick by tick from `first`; who iterates must do each step (`controller.step(*arguments)`)."""
        controller, begins = self.at(first)[0], set(self.checkpoints)
        for tick in range(first, len(self)):
            if tick in begins and tick > first:
                self._restored(tick)
            yield tick, controller, self.arguments(tick)

    def _restored(self, checkpoint: int) -> Controller:
        memory, controller = self.remembered(checkpoint), self.controller
        if memory is not None:
            robot, phases = controller.robot, len(controller.phases)
            sizes = [np.shape(each) for each in (memory.q, memory.v, memory.tau)]
            if sizes != [(robot.nq,), (robot.nv,), (robot.nu,)] or memory.phase not in range(phases):
                raise LogError(self.name, f"the memory of the log is not that of {robot.name} with these phases")
        controller.memory = memory
        return controller

    def _build(self, spec: Spec | None, solver: str | Solver | None) -> Controller:
        if spec is None:
            raise LogError(self.name, "the log has no spec; replay it in Python, `wbc.Replay(log, controller)`")
        from .build import build

        return build(spec, solver=solver).controller

    def _check(self, tick: int) -> None:
        if not 0 <= tick < len(self):
            raise LogError(self.name, f"no tick {tick}; expected one from 0 to {len(self) - 1}")

    def _unpack(self, packed: Packed, i: int, kind: Any) -> Any:
        try:
            found = packed[i]
        except _WRONG as error:
            raise LogError(self.name, f"cannot be replayed: {_told(error)}") from None
        if not isinstance(found, kind):
            raise LogError(self.name, f"cannot be replayed: it holds a {type(found).__name__} out of place")
        return found

    @property
    def solvable(self) -> bool:
        """Whether there is a controller, or a spec to build one from."""
        return self._given_controller is not None or self.about.get("spec") is not None

    def remembered(self, checkpoint: int) -> Memory | None:
        """What the controller remembered before the tick of a checkpoint. Raises LogError."""
        found = self._unpack(self.memory, self.checkpoints.index(checkpoint), (Memory, type(None)))
        return found if isinstance(found, Memory) else None

    def kept(self, checkpoint: int) -> tuple[Structure, bytes]:
        """The same as it was kept."""
        return self.memory.raw(self.checkpoints.index(checkpoint))

    def raw(self, tick: int) -> tuple[tuple[Structure, bytes], tuple[Structure, bytes]]:
        """What a tick was given and answered, as kept: the same bits are the same tick."""
        return self.given.raw(tick), self.answered.raw(tick)


def _arrays(log: str | Path | Log | Tape) -> dict[str, NDArray[Any]]:
    """What a tape left, by its own names."""
    if isinstance(log, Tape | Log):
        found = log.arrays() if isinstance(log, Tape) else log.tape
    else:
        path = Path(log)
        path = path / "log.npz" if path.is_dir() else path
        try:
            if path.is_file() and not zipfile.is_zipfile(path):
                raise ValueError("it is no npz file")
            with np.load(path, allow_pickle=False) as file:
                found = {name: file[name] for name in file.files if name.startswith(PREFIX)}
        except _UNREADABLE as error:
            raise LogError(str(log), f"not a log: {_told(error)}") from None
    if not found:
        raise LogError(str(log) if isinstance(log, str | Path) else "log", "no ticks to replay are recorded in it")
    return {name.removeprefix(PREFIX): array for name, array in found.items()}


def _spec(about: dict[str, Any], overrides: Sequence[str]) -> Spec:
    from .spec.agreement import SECTIONS
    from .spec.source import parse

    source = parse(str(about["spec"]), str(about.get("file") or "spec"))
    of_driver = [f"gravity={about['gravity']}"] if about.get("gravity") in ("controller", "robot") else []
    for text in (*of_driver, *overrides):  # a robot that was loaded apart may have a driver that the spec does not know
        source = source.override(text, SECTIONS)
    return Spec.from_source(source.whole())


def _told(error: BaseException) -> str:
    if isinstance(error, OSError) and error.strerror:
        return error.strerror
    if isinstance(error, KeyError):
        return f"{error} is missing"
    return " ".join(str(error).split())[:200] or type(error).__name__
