"""Tasks, from the entries of a spec: gains over the axes of contacts and frames, targets as functions of time."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from . import spec as specs
from .axes import MOMENTUM_AXES
from .contact import Contact
from .contact.axes import AxesContact
from .contact.sphere import SphereContact
from .geometry import Geometry
from .observer import MomentumObserver
from .pair import movable, relative_axes
from .qp import Array
from .reference import Reference, Scalar, constant
from .robot import Robot
from .tank import Bounded
from .task import Task
from .task.centroidal import ComTask, DistributionTask, MomentumTask, WholeBodyPosture
from .task.effort import TorqueTask
from .task.force import RATE, ForceTask
from .task.impedance import AdmittanceTask, Compliance, ImpedanceTask
from .task.motion import MotionTask
from .task.posture import PostureTask
from .task.relative import GazeTask, RelativeTask
from .wrench import VELOCITY_AXES, WRENCH_AXES

Axes = tuple[str, ...]


@dataclass(frozen=True)
class Tracking:
    """The tasks of a spec, or of one of its phases, on its contacts and motion references (by task)."""

    geometry: Geometry
    contacts: Mapping[str, Contact]
    references: Mapping[str, Reference]

    def tasks(self, q: Array) -> dict[str, Task]:
        """Tasks by name, without those that are at fault; a posture may be the start `q` (nq,)."""
        spec, faults, robot = self.geometry.spec, self.geometry.faults, self.geometry.robot
        tasks: dict[str, Task] = {}
        for name, entry in spec.tasks.items():
            with faults.at("tasks", name):
                if isinstance(entry, specs.ForceTask):
                    if (force := self._force(name, entry)) is not None:
                        tasks[name] = force
                elif isinstance(entry, specs.MotionTask):
                    tasks[name] = self._motion(name, entry)
                elif isinstance(entry, specs.ImpedanceTask | specs.AdmittanceTask):
                    tasks[name] = self._compliance(name, entry)
                elif isinstance(entry, specs.ComTask):
                    kp, kd = (self._gain(entry, name, key, ("x", "y", "z")) for key in ("kp", "kd"))
                    tasks[name] = ComTask(
                        self.geometry.com_path(name, entry, self.contacts, q), kp, kd, self.geometry.over(entry),
                        *_follows(entry),
                    )  # fmt: skip
                elif isinstance(entry, specs.RelativeTask):
                    tasks[name] = self._relative(name, entry)
                elif isinstance(entry, specs.GazeTask):
                    tasks[name] = GazeTask(entry.frame, entry.direction, entry.at, entry.kp, entry.kd)
                elif isinstance(entry, specs.MomentumTask):
                    tasks[name] = self._momentum(name, entry)
                elif isinstance(entry, specs.TorqueTask):
                    tasks[name] = TorqueTask()
                elif isinstance(entry, specs.DistributionTask):
                    tasks[name] = self._distribution(name, entry)
                else:
                    kp, kd = (self._gain(entry, name, key, robot.joints) for key in ("kp", "kd"))
                    kind = WholeBodyPosture if robot.base else PostureTask
                    tasks[name] = kind(_posture(robot, entry.target, q), kp, kd, robot.nu)
        return tasks

    def _gain(self, entry: specs.Task, task: str, key: str, axes: Sequence[str]) -> Any:
        """A number, or a vector or matrix over the axes."""
        value = getattr(entry, key)
        if isinstance(value, int | float):
            return value
        if len(value) != len(axes):
            n = len(axes)
            message = f"expected a number, {n} numbers ({', '.join(axes)}) or a matrix {n} x {n}, got {len(value)}"
            self.geometry.faults.add(("tasks", task, key), message)
            return 0.0
        return np.array(value, float)

    def _distribution(self, name: str, entry: specs.DistributionTask) -> DistributionTask:
        if not self.geometry.robot.base:
            message = "the contacts of a robot that stands on its base share nothing; expected a floating base"
            self.geometry.faults.add(("tasks", name, "type"), message)
        forced = [task.contact for task in self.geometry.spec.tasks.values() if isinstance(task, specs.ForceTask)]
        for contact in entry.press or ():
            path = ("tasks", name, "press", contact)
            if contact in self.contacts and self.contacts[contact].pushes is None:
                message = f"contact {contact!r} does not push; expected `pushes: -z` in it, or another side"
                self.geometry.faults.add(path, message)
            if contact in forced:
                message = f"contact {contact!r} has a force task, which says how it presses; expected one of the two"
                self.geometry.faults.add(path, message)
        return DistributionTask(entry.shares, entry.press)

    def _relative(self, name: str, entry: specs.RelativeTask) -> RelativeTask:
        able = relative_axes(self.geometry.robot, entry.frame, entry.to)
        axes = able if entry.axes == "all" else entry.axes
        kp, kd = (self._gain(entry, name, key, axes) for key in ("kp", "kd"))
        return RelativeTask(entry.frame, entry.to, self.references[name], kp, kd, axes, entry.error, *_follows(entry))

    def _momentum(self, name: str, entry: specs.MomentumTask) -> MomentumTask:
        axes = MOMENTUM_AXES if entry.axes == "all" else entry.axes
        return MomentumTask(self._gain(entry, name, "kp", axes), axes, self.geometry.momentum(name, entry))

    def _motion(self, name: str, entry: specs.MotionTask) -> MotionTask:
        frame, axes = self._place(entry)
        kp, kd = (self._gain(entry, name, key, axes) for key in ("kp", "kd"))
        against = None if entry.contact is None else self.contacts[entry.contact].against
        law, able = self.geometry.spec.law, movable(self.geometry.robot, frame, against)
        task = MotionTask(
            frame, self.references[name], kp, kd, axes, entry.contact, law, able, entry.error, *_follows(entry)
        )
        if entry.contact is not None and (pushes := self.contacts[entry.contact].pushes) is not None:
            pushes.guide = task.followed
        return task

    def _place(self, entry: specs.MotionTask | specs.ImpedanceTask | specs.AdmittanceTask) -> tuple[str, Axes]:
        """The frame of a task, and the axes or free motions along which it acts."""
        if entry.contact is not None:
            return self.contacts[entry.contact].frame, self.contacts[entry.contact].free_axes
        assert entry.frame is not None
        able = self.geometry.robot.axes(entry.frame)
        return entry.frame, tuple(VELOCITY_AXES[i] for i in able) if entry.axes == "all" else entry.axes

    def _compliance(self, name: str, entry: specs.ImpedanceTask | specs.AdmittanceTask) -> Compliance:
        frame, axes = self._place(entry)
        M, B, K = (self._gain(entry, name, key, axes) for key in ("M", "B", "K"))
        source, cutoff = entry.source, entry.filter
        observer = None
        if source == "observer":
            assert cutoff is not None
            observer, cutoff = MomentumObserver(self.geometry.robot, cutoff), None
        K_scale = None if entry.K_scale is None else self.geometry.profile(entry.K_scale)
        place = (
            frame, self.references[name], M, B, K, axes, entry.contact, entry.error, source, cutoff, observer,
            *_follows(entry), K_scale, self._tank(entry.tank),
        )  # fmt: skip
        if isinstance(entry, specs.ImpedanceTask):
            return ImpedanceTask(*place, compensate=entry.compensate)
        kp, kd = (self._gain(entry, name, key, axes) for key in ("kp", "kd"))
        return AdmittanceTask(*place, kp=kp, kd=kd, law=entry.law)

    def _force(self, name: str, entry: specs.ForceTask) -> ForceTask | None:
        contact = self.contacts[entry.contact]
        target: Any = None
        with self.geometry.faults.at("contacts", entry.contact, "artificial"):
            target = self._force_target(entry.contact, contact)
        if target is None:
            return None
        kp, ki, damping = (self._gain(entry, name, key, contact.axes) for key in ("kp", "ki", "damping"))
        limit = math.inf if entry.integral_limit is None else entry.integral_limit
        rate = self._gain(entry, name, "rate", contact.axes)
        rate = rate if np.any(rate) else RATE  # which is at fault
        wrench = not isinstance(contact, AxesContact | SphereContact)  # their multipliers have names
        law, tank = self.geometry.spec.law, self._tank(entry.tank)
        return ForceTask(entry.contact, contact, target, kp, ki, damping, entry.filter, limit, law, wrench, rate, tank)

    def _tank(self, entry: specs.Tank | float | None) -> Bounded | None:
        if not isinstance(entry, specs.Tank):
            return None if entry is None else Bounded(entry)
        return Bounded(entry.energy, entry.most, math.ceil(entry.delay * self.geometry.spec.rate - 1e-9))

    def _force_target(self, name: str, contact: Contact) -> Any:
        """lambda_d (k,) of a table, else the wrench (6,), or a function of time. Raises WrenchError for what the
        contact cannot carry."""
        given = self.geometry.spec.contacts[name].wrench_targets
        if isinstance(contact, SphereContact):
            held = [self.geometry.force(name, axis, given[axis]) for axis in contact.axes]
            return _stacked(held) if any(isinstance(value, str) for value in given.values()) else _stacked(held)(0.0)
        scalars = {WRENCH_AXES.index(axis): self.geometry.force(name, axis, value) for axis, value in given.items()}
        state = self.geometry.robot.state(self.geometry.robot.keyframes["home"], np.zeros(self.geometry.robot.nv))
        if isinstance(contact, AxesContact):  # the table's own axes: they are the multipliers
            order = [WRENCH_AXES.index(axis) for axis in contact.axes]
            if outside := [i for i in scalars if i not in order]:
                contact.multipliers(np.eye(6)[outside].sum(axis=0), state)
            held = [scalars.get(i, constant(0.0)) for i in order]
        else:
            wrench = np.zeros(6)
            for i, scalar in scalars.items():
                wrench[i] = scalar(0.0)[0] or 1e-300  # a target of zero must be carried as well
            contact.multipliers(wrench, state)
            held = [scalars.get(i, constant(0.0)) for i in range(6)]
        target = _stacked(held)
        return target if any(isinstance(value, str) for value in given.values()) else target(0.0)


def _follows(entry: specs.Following) -> tuple[float, tuple[float, float]]:
    """What a task does near a singularity, and where its reference jumps."""
    return entry.singular, (entry.jump.speed, entry.jump.turn)


def joint_values(robot: Robot, values: Mapping[str, float], base: Array) -> Array:
    """`base`, over joints or as a configuration, with the values of some joints, which come last."""
    out, first = base.copy(), base.size - robot.nu
    for joint, value in values.items():
        out[first + robot.joints.index(joint)] = value
    return out


def _posture(robot: Robot, target: str | Mapping[str, float], q: Array) -> Array:
    if isinstance(target, str):
        return q if target == "start" else robot.keyframes[target]
    return joint_values(robot, target, q)


def _stacked(scalars: list[Scalar]) -> Callable[[float], Array]:
    return lambda t: np.array([scalar(t)[0] for scalar in scalars])
