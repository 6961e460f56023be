"""What it takes to solve any tick again: the arguments of every `step`, and now and then the controller's memory.

A tape is what of a log makes a tick come back bit for bit. It holds numbers and JSON, never objects: to read it
executes nothing.
"""

from __future__ import annotations

import hashlib
import json
import platform
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from . import __version__
from .arguments import Arguments, called_as
from .controller import Controller
from .ladder import Status
from .memory import Memory, Output
from .pack import Codec, Kinds, Stream
from .robot import Robot
from .wrench import Wrench

if TYPE_CHECKING:
    from .spec import Spec

PREFIX = "tape/"  # of the arrays in a log; no name of a spec has a slash
FORMAT = 1
EVERY = 100  # ticks from one checkpoint of the memory to the next, at most
CODEC = Codec(Memory, Wrench, Status)
_PACKAGES = ("numpy", "numba", "pin", "mujoco", "daqp", "proxsuite", "qpsolvers")  # on which the last bits may depend


class Tape:
    """Records a controller's ticks. `step` is the controller's own; `save` writes what `wbc replay` reads.

    Parameters: the controller; the spec that it was made from (None: who replays has to bring the controller);
    `every`: ticks between checkpoints of the memory. There is one also wherever the phase has changed, and wherever
    somebody else has reset or restored the controller. At each the solver is told to forget (one that can: what ProxQP
    answers depends on its past, within its tolerance), so that from each all that follows is the same again.
    """

    def __init__(self, controller: Controller, spec: Spec | None = None, every: int = EVERY) -> None:
        self._controller, self._spec, self._every = controller, spec, max(1, every)
        kinds = self._kinds = Kinds()
        self._given, self._answered, self._kept = (Stream(CODEC, kinds) for _ in range(3))
        self._checkpoints: list[int] = []
        self._last: Memory | None = None
        self._phase = -1

    def __len__(self) -> int:
        return len(self._answered)

    @called_as(Controller.step)
    def step(self, given: Arguments) -> Output:
        """`Controller.step`, recorded."""
        self.begin(*given)
        return self.end(self._controller.step(*given))

    @called_as(Controller.step)
    def begin(self, given: Arguments) -> None:
        """Before a tick with these arguments; for who calls `Controller.step` with a clock running. Then `end`."""
        memory, tick = self._controller.memory, len(self._given)
        phase = memory.phase if memory is not None else -1
        due = not self._checkpoints or tick - self._checkpoints[-1] >= self._every
        if due or memory is not self._last or phase != self._phase:
            self._controller.memory = memory  # solvers forget
            self._checkpoints.append(tick)
            self._kept.append(memory)
        self._phase = phase
        self._given.append(tuple(given))

    def end(self, out: Output) -> Output:
        """After the tick that was begun."""
        self._answered.append((out.tau, out.status, out.active))
        self._last = self._controller.memory
        return out

    def arrays(self) -> dict[str, NDArray[Any]]:
        """All of it, by name, as it stands in an npz file."""
        robot, spec = self._controller.robot, self._spec
        told = {
            "format": FORMAT, "wbc": __version__, "spec": None if spec is None else text(spec),
            "file": "" if spec is None else str(Path(spec.file).absolute()), "model": fingerprint(robot),
            "gravity": robot.gravity, "solver": self._controller.solver, "robot": robot.name,
            "joints": list(robot.joints), "machine": machine(),
        }  # fmt: skip
        found: dict[str, NDArray[Any]] = {
            "about": np.array(json.dumps(told)),
            "kinds": np.array(json.dumps(self._kinds.listed, separators=(",", ":"))),
            "checkpoints": np.array(self._checkpoints, np.int32),
        }
        for name, stream in (("given", self._given), ("answered", self._answered), ("memory", self._kept)):
            found |= stream.arrays(name)
        return {f"{PREFIX}{name}": array for name, array in found.items()}

    def save(self, path: str | Path) -> None:
        """Write `path` (npz)."""
        np.savez_compressed(path, **self.arrays())  # type: ignore[arg-type]


def text(spec: Spec) -> str:
    """The spec as it runs, with all that was changed: JSON, which is YAML."""
    return json.dumps(spec.model_dump(mode="json", by_alias=True, exclude_unset=True), indent=1, ensure_ascii=False)


def fingerprint(robot: Robot) -> str:
    """SHA-256 of the compiled model that a controller computes with; of a model of one's own, of Pinocchio's."""
    if robot.mujoco is None:
        return hashlib.sha256(robot.model.saveToString().encode()).hexdigest()
    import mujoco

    buffer = np.zeros(mujoco.mj_sizeModel(robot.mujoco), np.uint8)
    mujoco.mj_saveModel(robot.mujoco, None, buffer)
    return hashlib.sha256(buffer.tobytes()).hexdigest()


def machine() -> dict[str, str]:
    """What the last bits of a torque may depend on."""
    found = {"python": platform.python_version(), "machine": platform.machine(), "system": platform.system()}
    for package in _PACKAGES:
        try:
            found[package] = version(package)
        except PackageNotFoundError:
            continue
    return found
