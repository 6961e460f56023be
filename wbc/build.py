"""From a spec to a controller: names become frames and joints, tables become contacts, references become motion.

Everything that only the robot can tell is checked here, every fault with its place in the file.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path as FilePath
from typing import Any

import numpy as np
import pinocchio as pin

from . import spec as specs
from .closing import CLOSED, Goal, close
from .contact import AxesContact, Contact, MatrixContact, ScrewContact, WorldAxesContact
from .controller import Controller, Phase
from .dynamics import mobility
from .errors import Fault, GainError, ModelError, SpecError, WbcError, did_you_mean
from .limit import JointLimit, TorqueLimit
from .limit import make_limits
from .metrics import vocabulary
from .model import find
from .qp import Array
from .reference import Path, Reference, Scalar, ScrewPath, constant, hold, quintic, ramp, sine
from .robot import Robot
from .solver import Solver, make
from .stability import Pole, damping_margin, force_poles
from .task import ForceTask, MotionTask, PostureTask, Task
from .wrench import VELOCITY_AXES, WRENCH_AXES

Place = tuple[str | int, ...]


@dataclass(frozen=True)
class Built:
    """A spec with everything made from it."""

    spec: specs.Spec
    robot: Robot
    controller: Controller
    q: Array  # start
    poles: list[Pole]
    damping_margins: dict[str, float]
    phases: tuple[Phase, ...] = ()
    notes: list[str] = field(default_factory=list)


def build(spec: specs.Spec, robot: Robot | None = None, solver: str | Solver | None = None) -> Built:
    """Everything from a spec. Raises SpecError with all faults that this stage finds."""
    return _Builder(spec, robot, solver).built()


class _Builder:
    """One pass over a spec; `faults` grows, and is raised where going on would only repeat it."""

    def __init__(self, spec: specs.Spec, robot: Robot | None, solver: str | Solver | None) -> None:
        self.spec, self.faults, self.notes = spec, list[Fault](), list[str]()
        self.phase, self.changed = "", tuple[str, ...]()  # the phase being built, and the keys that it changes
        self.followed: dict[str, set[int]] = {}  # reference -> the axes along which something follows it
        self.solver = solver or spec.solver
        with self.at("solver"):
            make(self.solver)
        self.robot = robot if robot is not None else self._load_robot()
        self.dt = 1.0 / spec.rate

    @contextmanager
    def at(self, *path: str | int) -> Iterator[None]:
        """Whatever is wrong inside is a fault of that place in the spec."""
        try:
            yield
        except SpecError:
            raise
        except GainError as error:  # its message begins with the key
            key, _, message = str(error).partition(": ")
            self.fault((*path, key), message)
        except WbcError as error:
            self.fault(path, str(error))

    def fault(self, path: Place, message: str) -> None:
        """Something wrong in one place; what a phase has changed is told where the phase says so."""
        at = tuple(map(str, path))
        for key in self.changed:
            if all(ours == theirs for ours, theirs in zip(key.split("."), at, strict=False)):
                path, message = ("phases", self.phase, "set", key), f"{'.'.join(at)}: {message}"
                break
        self.faults.append(self.spec.fault(path, message))

    def raise_faults(self) -> None:
        if self.faults:
            raise SpecError(dict.fromkeys(self.faults))

    def built(self) -> Built:
        self._check_names()
        self.raise_faults()
        q_home = self._start_joints()
        contacts, references = self._geometry(self.spec, q_home)
        self.raise_faults()
        self._check_followed()
        q = self._close(q_home, contacts, references)
        phases, poles, margins = self._phases(q)
        self._check_metrics(phases)
        self.raise_faults()
        controller = Controller(self.robot, solver=self.solver, rate=self.spec.rate, phases=phases, q=q)
        notes = [*self.notes, *controller.notes]
        return Built(self.spec, self.robot, controller, q, poles, margins, controller.phases, notes)

    # --- names ---

    def _load_robot(self) -> Robot:
        spec = self.spec
        files: dict[str, str] = {}
        named = (("robot", "scenes/robots", spec.robot), ("tool", "scenes/tools", spec.tool), ("scene", "scenes", spec.scene))
        for key, kind, name in named:
            if name is not None:
                with self.at(key):
                    files[key] = self._file(kind, name)
        self.raise_faults()
        try:
            return Robot.load(files["robot"], files.get("tool"), files.get("scene"), spec.gravity, name=spec.robot)
        except ModelError as error:
            blamed = [key for key, file in files.items() if str(error).startswith(f"{file}: ")]
            self.fault((*blamed, "robot")[:1], str(error))
        raise SpecError(self.faults)

    def _file(self, kind: str, name: str) -> str:
        """Beside the spec, else a path, else a shipped one."""
        try:
            beside = FilePath(self.spec.file).parent / name
            return str(beside) if not name.startswith("erd:") and beside.is_file() else str(find(kind, name))
        except (OSError, ValueError):
            raise ModelError("expected the name of a file, got one that no file can have") from None

    def _check_names(self) -> None:
        spec = self.spec
        for name, reference in spec.references.items():
            if reference.curve.in_ != "world":
                with self.at("references", name, reference.kind, "in"):
                    self.robot.fixed_pose(reference.curve.in_)
        for name, contact in spec.contacts.items():
            with self.at("contacts", name, "frame"):
                self.robot.frame_id(contact.frame)
            if contact.on is not None:
                with self.at("contacts", name, "on"):
                    self.robot.fixed_pose(contact.on)
            for screw, motion in (contact.free or {}).items():
                if motion.screw.through != "self":
                    with self.at("contacts", name, "free", screw, "screw", "through"):
                        self.robot.fixed_pose(motion.screw.through)
        for name, task in spec.tasks.items():
            if isinstance(task, specs.MotionTask) and task.frame is not None:
                with self.at("tasks", name, "frame"):
                    self.robot.frame_id(task.frame)
            if isinstance(task, specs.PostureTask):
                self._check_pose(task.target, ("tasks", name, "target"), "start")
        if spec.start is not None:
            self._check_pose(spec.start, ("start",))
        for limit in ("torque", "torque_rate", "velocity"):
            value = getattr(spec.limits, limit)
            if isinstance(value, dict):
                self._check_joints(value, ("limits", limit))
            elif isinstance(value, tuple) and len(value) != self.robot.nv:
                self.fault(("limits", limit), f"expected {self.robot.nv} numbers, one a joint, got {len(value)}")

    def _check_pose(self, pose: str | Mapping[str, float], path: Place, *more: str) -> None:
        known = [*self.robot.keyframes, *more]
        if not isinstance(pose, str):
            self._check_joints(pose, path)
        elif pose not in known:
            self.fault(path, f"no keyframe named {pose!r}{did_you_mean(pose, known)}")

    def _check_joints(self, joints: Mapping[str, float], path: Place) -> None:
        for joint in joints:
            if joint not in self.robot.joints:
                self.fault((*path, joint), f"no joint named {joint!r}{did_you_mean(joint, self.robot.joints)}")

    def _check_followed(self) -> None:
        """A reference that nothing follows is a mistake, unless `--set` has just taken its followers away."""
        for name, reference in self.spec.references.items():
            if name not in self.followed:
                message = "nothing follows it; expected a target in contacts or tasks that names it"
                if any(self.spec.fault(("contacts", c), "").file != self.spec.file for c in self.spec.contacts):
                    self.notes.append(f"{name}: {message}")
                elif not any(self._overridden(contact) for contact in self.spec.contacts):
                    self.fault(("references", name), message)
            elif idle := set(_components(reference)) - self.followed[name]:
                axes = ", ".join(VELOCITY_AXES[i] for i in sorted(idle))
                self.notes.append(f"{name}: nothing follows its motion along {axes}")

    def _check_metrics(self, phases: Sequence[Phase]) -> None:
        known = vocabulary(phases)
        for name in self.spec.expect.bounds:
            if name not in known:
                self.fault(("expect", name), f"no such quantity{did_you_mean(name, known)}")
