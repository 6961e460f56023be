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
from .errors import Fault, GainError, ModelError, ModelMismatch, SpecError, WbcError, did_you_mean
from .limit import JointLimit, TorqueLimit, make_limits
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
        with self.at("law"):
            controller = Controller(self.robot, solver=self.solver, rate=self.spec.rate, phases=phases, q=q)
        self.raise_faults()
        notes = [*self.notes, *controller.notes]
        return Built(self.spec, self.robot, controller, q, poles, margins, controller.phases, notes)

    # --- names ---

    def _load_robot(self) -> Robot:
        spec = self.spec
        files: dict[str, str] = {}
        named = (
            ("robot", "scenes/robots", spec.robot),
            ("tool", "scenes/tools", spec.tool),
            ("scene", "scenes", spec.scene),
        )
        for key, kind, name in named:
            if name is not None:
                with self.at(key):
                    files[key] = self._file(kind, name)
        self.raise_faults()
        try:
            robot = Robot.load(files["robot"], files.get("tool"), files.get("scene"), spec.gravity, name=spec.robot)
        except ModelError as error:
            self.fault((_blamed(files),), _told(error))
        else:
            if robot.nv:
                return robot
            self.fault(("robot",), "it has no joint; expected a robot that can move")
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
                self._check_frame(reference.curve.in_, ("references", name, reference.kind, "in"), fixed=True)
        for name, contact in spec.contacts.items():
            self._check_frame(contact.frame, ("contacts", name, "frame"), moves=True)
            if contact.on is not None:
                self._check_frame(contact.on, ("contacts", name, "on"), fixed=True)
            for screw, motion in (contact.free or {}).items():
                if motion.screw.through != "self":
                    self._check_frame(motion.screw.through, ("contacts", name, "free", screw, "screw", "through"), True)
        for name, task in spec.tasks.items():
            if isinstance(task, specs.MotionTask) and task.frame is not None:
                self._check_frame(task.frame, ("tasks", name, "frame"), moves=True)
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

    def _check_frame(self, name: str, path: Place, fixed: bool = False, moves: bool = False) -> None:
        """Frames are named by the robot, its tool and the scene; those that are left out may be what is wrong."""
        if name not in self.robot.frames:
            known = [frame for frame in self.robot.frames if frame != "universe"]
            without = [key for key in ("tool", "scene") if getattr(self.spec, key) is None]
            hint = f" (the spec names no {' and no '.join(without)})" if without else ""
            self.fault(path, f"no frame named {name!r}{did_you_mean(name, known)}{hint}")
            return
        frame = self.robot.model.frames[self.robot.frame_id(name)]
        if fixed:
            with self.at(*path):
                self.robot.fixed_pose(name)
        elif moves and not frame.parentJoint:
            self.fault(path, f"frame {name!r} is fixed to the world; expected one of the robot or its tool")
        elif path[0] == "contacts" and frame.type == pin.FrameType.JOINT:
            self.fault(path, f"frame {name!r} is that of a joint; expected a body or a site")

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
        spec = self.spec
        targets = [("contacts", name, "artificial", axis) for name, c in spec.contacts.items() for axis in c.targets]
        overridden = any(spec.fault(target, "").file != spec.file for target in targets)
        for name, reference in spec.references.items():
            idle = set(_components(reference)) - self.followed.get(name, set())
            if name not in self.followed and not overridden:
                self.fault(
                    ("references", name), "nothing follows it; expected a target in contacts or tasks to name it"
                )
            elif idle:
                along = ", ".join(VELOCITY_AXES[i] for i in sorted(idle))
                self.notes.append(f"{name}: nothing follows its motion along {along}")

    def _check_metrics(self, phases: Sequence[Phase]) -> None:
        known = vocabulary(phases)
        for name in self.spec.expect.bounds:
            if name not in known:
                self.fault(("expect", name), f"no such quantity{did_you_mean(name, [*known, 'settle'])}")

    # --- geometry ---

    def _joint_values(self, values: Mapping[str, float], base: Array) -> Array:
        out = base.copy()
        for joint, value in values.items():
            out[self.robot.joints.index(joint)] = value
        return out

    def _start_joints(self) -> Array:
        start, robot = self.spec.start or "home", self.robot
        if isinstance(start, str):
            return robot.keyframes[start].copy()
        q = self._joint_values(start, robot.keyframes["home"])
        for joint in start:
            i = robot.joints.index(joint)
            if not robot.q_min[i] <= q[i] <= robot.q_max[i]:
                message = f"{q[i]:g} rad is outside of the joint's range, {robot.q_min[i]:.4g} to {robot.q_max[i]:.4g}"
                self.fault(("start", joint), message)
        return q

    def _on(self, name: str, contact: specs.Contact, q: Array) -> tuple[pin.SE3, str | None]:
        """Where the world holds the frame at the start, and the scene's frame that the start must be closed onto."""
        on = contact.on or (name if name in self.robot.frames else None)
        if on is not None:
            return self.robot.fixed_pose(on), on
        return self.robot.state(q, np.zeros(self.robot.nv)).frame(contact.frame).T, None

    def _geometry(self, spec: specs.Spec, q: Array) -> tuple[dict[str, Contact], dict[str, Reference]]:
        """Contacts, and the motion references by task."""
        contacts: dict[str, Contact] = {}
        paths: dict[str, Reference] = {}
        for name, entry in spec.contacts.items():
            with self.at("contacts", name, entry.kind):
                contacts[name], paths[name] = self._contact(spec, name, entry, q)
        references: dict[str, Reference] = {}
        for name, task in spec.tasks.items():
            if not isinstance(task, specs.MotionTask):
                continue
            if task.contact is not None:
                if task.contact in paths:
                    references[name] = paths[task.contact]
                continue
            assert task.frame is not None
            assert task.target is not None
            here = self.robot.state(q, np.zeros(self.robot.nv)).frame(task.frame).T
            references[name] = self._path(spec.references[task.target], task.target, here)
            axes = VELOCITY_AXES if task.axes == "all" else task.axes
            self.followed.setdefault(task.target, set()).update(VELOCITY_AXES.index(axis) for axis in axes)
            self._check_axes(task.frame, () if task.axes == "all" else task.axes, ("tasks", name, "axes"))
        return contacts, references

    def _check_axes(self, frame: str, axes: Sequence[str], path: Place) -> None:
        able = [VELOCITY_AXES[i] for i in self.robot.axes(frame)]
        if extra := [axis for axis in axes if axis not in able]:
            message = (
                f"{self.spec.robot} cannot move {frame} along {', '.join(extra)}; expected some of {', '.join(able)}"
            )
            self.fault(path, message)

    def _contact(self, spec: specs.Spec, name: str, entry: specs.Contact, q: Array) -> tuple[Contact, Reference]:
        origin, on = self._on(name, entry, q)
        able = tuple(VELOCITY_AXES[i] for i in self.robot.axes(entry.frame))
        if entry.kind == "free":
            return self._screws(spec, name, entry, origin)
        if entry.kind == "A":
            return MatrixContact(entry.frame, np.array(entry.A or np.zeros((0, 6)))), hold(origin)
        if entry.kind == "natural":
            self._check_table(name, entry, able)
        elif entry.holds != "all":
            self._check_axes(entry.frame, entry.constrained, ("contacts", name, "holds"))
        held = able if entry.holds == "all" else entry.constrained
        free = tuple(axis for axis in able if axis not in held)
        contact: Contact = AxesContact(entry.frame, held, free)
        if entry.in_ == "on":
            contact = WorldAxesContact(entry.frame, held, origin.rotation, free)
        along = {}
        for axis in free:
            component, path = VELOCITY_AXES.index(axis), ("contacts", name, "artificial", axis)
            target = entry.motion_targets.get(axis, 0.0)
            along[component] = self._scalar(spec, target, component, path, on or "world")
        return contact, Path(origin, along)

    def _check_table(self, name: str, entry: specs.Contact, able: Sequence[str]) -> None:
        named = {*entry.constrained, *entry.free_axes}
        missing = ", ".join(axis for axis in able if axis not in named)
        extra = ", ".join(axis for axis in VELOCITY_AXES if axis in named and axis not in able)
        said = [f"the table says nothing of {missing}"] if missing else []
        said += [f"{self.spec.robot} cannot move along {extra}"] if extra else []
        if said:
            self.fault(("contacts", name, "natural"), f"{'; '.join(said)}; expected the axes {', '.join(able)}")

    def _screws(self, spec: specs.Spec, name: str, entry: specs.Contact, origin: pin.SE3) -> tuple[Contact, Reference]:
        screws, scalars = [], []
        for label, motion in (entry.free or {}).items():
            screw = motion.screw
            place = origin if screw.through == "self" else self.robot.fixed_pose(screw.through)
            named = isinstance(screw.axis, str)
            component = "xyz".index(screw.axis) if isinstance(screw.axis, str) else 2
            axis = np.eye(3)[component] if named else np.array(screw.axis) / np.linalg.norm(np.array(screw.axis))
            w = place.rotation @ axis
            p = place.translation - origin.translation
            R = origin.rotation.T  # everything in the axes of the place where the frame is held
            screws.append(np.concatenate((R @ w, R @ (np.cross(p, w) + screw.pitch * w))))
            target, path = entry.motion_targets.get(label, 0.0), ("contacts", name, "artificial", label)
            scalars.append(self._scalar(spec, target, component, path, None))
        contact = ScrewContact(entry.frame, np.array(screws).reshape(-1, 6), origin, tuple(entry.free or ()))
        return contact, ScrewPath(origin, screws, scalars, pin.SE3.Identity())

    def _scalar(self, spec: specs.Spec, target: float | str, axis: int, path: Place, on: str | None) -> Scalar:
        """Motion along one axis of what a contact closes on; `on` None: wherever the reference is drawn."""
        if not isinstance(target, str):
            return ramp(target) if target else constant(0.0)
        reference = spec.references[target]
        self.followed.setdefault(target, set()).add(axis)
        if reference.kind == "hold":
            return constant(0.0)
        if on is not None and reference.curve.in_ != on:
            message = f"reference {target!r} is drawn in {reference.curve.in_!r}, but the contact closes on {on!r}"
            self.fault(path, f"{message}; expected `in: {on}` in the reference")
        return self._component(target, reference, axis, path)

    def _component(self, name: str, reference: specs.Reference, axis: int, path: Place) -> Scalar:
        known = _components(reference)
        if axis not in known:
            gives = ", ".join(VELOCITY_AXES[i] for i in known)
            message = f"reference {name!r} does not move along {VELOCITY_AXES[axis]}"
            self.fault(path, f"{message}; expected a number, for a {reference.kind} gives {gives} only")
        return known.get(axis, constant(0.0))

    @staticmethod
    def _stays(reference: specs.Reference) -> bool:
        return reference.kind == "hold" and reference.curve.in_ == "world"

    def _path(self, reference: specs.Reference, name: str, here: pin.SE3) -> Reference:
        in_ = reference.curve.in_
        self.followed.setdefault(name, set())
        if self._stays(reference):
            return hold(here)
        origin = pin.SE3.Identity() if in_ == "world" else self.robot.fixed_pose(in_)
        turns = any(i < 3 for i in _components(reference))
        # a path of positions keeps the orientation that the frame starts with
        offset = None if turns else pin.SE3(origin.rotation.T @ here.rotation, np.zeros(3))
        return Path(origin, _components(reference), offset)

    def _close(self, q: Array, contacts: dict[str, Contact], references: dict[str, Reference]) -> Array:
        """Move the start pose onto the contacts and references; what is to stay where it starts asks for nothing."""
        robot, spec = self.robot, self.spec
        goals, paths = [], {}
        for name, task in spec.tasks.items():
            if not isinstance(task, specs.MotionTask):
                continue
            if task.contact is not None:
                paths[task.contact] = references[name]
            elif task.frame is not None and not self._stays(spec.references[task.target or ""]):
                rows = np.eye(6)[[i for i, a in enumerate(VELOCITY_AXES) if task.axes == "all" or a in task.axes]]
                goals.append(Goal(task.frame, references[name](0.0).T, rows, ("tasks", name, "target")))
        for name, contact in contacts.items():
            T, on = self._on(name, spec.contacts[name], q)
            if on is not None:
                rows = np.eye(6) if name in paths else contact.A(robot.state(q, np.zeros(robot.nv)))
                goals.append(Goal(contact.frame, paths[name](0.0).T if name in paths else T, rows, ("contacts", name)))
        if not goals:
            return q
        start, (q, errors) = q, close(robot, q, goals)
        if not max(errors) < CLOSED:
            worst = goals[int(np.argmax(errors))]
            left = f"{max(errors):.2g} m or rad are left"
            message = f"{spec.robot} cannot bring {worst.frame} there from its start pose: {left}"
            self.fault(worst.path, f"{message}; choose another place, start or robot")
        elif robot.nq == robot.nv:
            for i in np.flatnonzero((q < robot.q_min) | (q > robot.q_max)):
                message = f"closing the contacts puts {robot.joints[i]} at {q[i]:.3f} rad"
                allowed = f"outside [{robot.q_min[i]:.3f}, {robot.q_max[i]:.3f}]"
                self.fault(("start",), f"{message}, {allowed}; choose another start or place")
        return start if self.faults else q

    # --- phases ---

    def _phases(self, q: Array) -> tuple[list[Phase], list[Pole], dict[str, float]]:
        phases: list[Phase] = []
        poles: list[Pole] = []
        margins: dict[str, float] = {}
        entries: Mapping[str, specs.Phase | None] = self.spec.phases or {"": None}
        for name, entry in entries.items():
            spec, self.phase, self.changed = self.spec, name, ()
            if entry is not None and entry.set:
                spec, self.changed = spec.with_set(entry.set), tuple(entry.set)
            contacts, references = self._geometry(spec, q)
            if len(contacts) < len(spec.contacts):
                self.raise_faults()
            tasks, weights = self._tasks(spec, contacts, references, q)
            found, margin = self._stability(spec, contacts, tasks, q)
            poles += [pole for pole in found if pole not in poles]
            margins |= margin
            torque, joint = self._limits(spec)
            until = entry.until.time if entry is not None and entry.until is not None else math.inf
            phases.append(Phase(contacts, tasks, weights, torque, joint, name, until))
        self.phase, self.changed = "", ()
        return phases, poles, margins

    def _tasks(
        self, spec: specs.Spec, contacts: dict[str, Contact], references: dict[str, Reference], q: Array
    ) -> tuple[dict[str, Task], dict[str, float]]:
        tasks: dict[str, Task] = {}
        for name, entry in spec.tasks.items():
            with self.at("tasks", name):
                if isinstance(entry, specs.ForceTask):
                    self._force(tasks, name, spec, entry, contacts[entry.contact])
                elif isinstance(entry, specs.MotionTask):
                    tasks[name] = self._motion(name, spec, entry, contacts, references[name])
                else:
                    kp, kd = (self._gain(entry, name, key, self.robot.joints) for key in ("kp", "kd"))
                    tasks[name] = PostureTask(self._posture_target(entry.target, q), kp, kd, self.robot.nv)
        return tasks, {name: spec.tasks[name].weight for name in tasks}

    def _gain(self, entry: specs.Task, task: str, key: str, axes: Sequence[str]) -> Any:
        """A number, or a vector or matrix over the axes."""
        value = getattr(entry, key)
        if isinstance(value, int | float):
            return value
        if len(value) != len(axes):
            n = len(axes)
            message = f"expected a number, {n} numbers ({', '.join(axes)}) or a matrix {n} x {n}, got {len(value)}"
            self.fault(("tasks", task, key), message)
            return 0.0
        return np.array(value, float)

    def _posture_target(self, target: str | Mapping[str, float], q: Array) -> Array:
        if isinstance(target, str):
            return q if target == "start" else self.robot.keyframes[target]
        return self._joint_values(target, q)

    def _motion(
        self, name: str, spec: specs.Spec, entry: specs.MotionTask, contacts: dict[str, Contact], reference: Reference
    ) -> MotionTask:
        frame = contacts[entry.contact].frame if entry.contact is not None else entry.frame
        assert frame is not None
        able = self.robot.axes(frame)
        if entry.contact is not None:
            axes = contacts[entry.contact].free_axes
        else:
            axes = tuple(VELOCITY_AXES[i] for i in able) if entry.axes == "all" else entry.axes
        kp, kd = (self._gain(entry, name, key, axes) for key in ("kp", "kd"))
        return MotionTask(frame, reference, kp, kd, axes, entry.contact, spec.law, able)

    def _force(
        self, tasks: dict[str, Task], name: str, spec: specs.Spec, entry: specs.ForceTask, contact: Contact
    ) -> None:
        target: Any = None
        with self.at("contacts", entry.contact, "artificial"):
            target = self._force_target(spec, entry.contact, contact)
        if target is None:
            return
        kp, ki, damping = (self._gain(entry, name, key, contact.axes) for key in ("kp", "ki", "damping"))
        limit = math.inf if entry.integral_limit is None else entry.integral_limit
        tasks[name] = ForceTask(entry.contact, contact, target, kp, ki, damping, entry.filter, limit, spec.law)

    def _force_target(self, spec: specs.Spec, name: str, contact: Contact) -> Any:
        """lambda_d (k,), or a function of time. Raises WrenchError for what the contact cannot carry."""
        given = spec.contacts[name].wrench_targets
        scalars = {
            WRENCH_AXES.index(axis): self._force_scalar(spec, name, axis, value) for axis, value in given.items()
        }
        state = self.robot.state(self.robot.keyframes["home"], np.zeros(self.robot.nv))
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
        if not isinstance(contact, AxesContact):
            inverse = contact.pseudo_inverse(contact.A(state))
            return (lambda t: inverse @ target(t)) if isinstance(contact, MatrixContact) else inverse @ wrench
        return target if any(isinstance(value, str) for value in given.values()) else target(0.0)

    def _force_scalar(self, spec: specs.Spec, contact: str, axis: str, value: float | str) -> Scalar:
        """A number, or the motion along x of a reference, in newtons."""
        if not isinstance(value, str):
            return constant(float(value))
        self.followed.setdefault(value, set()).add(3)
        if spec.references[value].kind == "hold":
            return constant(0.0)
        return self._component(value, spec.references[value], 3, ("contacts", contact, "artificial", axis))

    def _stability(
        self, spec: specs.Spec, contacts: dict[str, Contact], tasks: dict[str, Task], q: Array
    ) -> tuple[list[Pole], dict[str, float]]:
        state = self.robot.state(q, np.zeros(self.robot.nv))
        poles: list[Pole] = []
        margins: dict[str, float] = {}
        for name, task in tasks.items():
            if not isinstance(task, ForceTask):
                continue
            contact = contacts[task.contact]
            W = mobility(state, contact.hold(state).G)
            k, delay, alpha = contact.k, 1 + spec.plant.delay, task.smoothing(self.dt)
            Kp, Ki, D = task.Kp[:k, :k], task.Ki[:k, :k], task.K_damp
            masses = 1.0 / np.maximum(W.diagonal(), 1e-12)
            margins[name] = damping_margin(W, D, self.dt)
            if not margins[name] < 2.0:
                bound = f"dt max eig(A M_C^-1 A' K_damp) = {margins[name]:.3g}, expected below 2"
                advice = "lower it on the axes of small inertia, or raise the rate"
                self.fault(("tasks", name, "damping"), f"damping is unstable at this rate: {bound}; {advice}")
                continue
            found = force_poles(task.contact, contact.axes, masses, Kp, Ki, D, alpha, self.dt, delay)
            poles += found
            worst = max(found, key=lambda pole: pole.radius, default=None)
            if worst is not None and not worst.radius < 1.0:
                self.fault(("tasks", name, "kp"), _unstable(worst))
        return poles, margins

    def _limits(self, spec: specs.Spec) -> tuple[TorqueLimit, JointLimit | None]:
        limits, robot = spec.limits, self.robot
        most = {"torque": np.minimum(robot.tau_max, -robot.tau_min), "velocity": robot.v_max}
        values: dict[str, Any] = {}
        for name in ("torque", "torque_rate", "velocity"):
            given, model = getattr(limits, name), most.get(name, np.full(robot.nv, np.inf))
            if isinstance(given, specs.Scale):
                given = model * given.scale
            elif given is not None and given != "model":
                given = self._joint_values(given, model) if isinstance(given, dict) else given
                self._check_limit(name, np.array(given, float), model, "rad/s" if name == "velocity" else "N m")
            values[name] = given
        values["position"] = limits.position
        if isinstance(limits.position, specs.Margin):
            margin = values["position"] = limits.position.margin
            for i in np.flatnonzero(robot.q_max - robot.q_min <= 2.0 * margin):
                message = f"{margin:g} rad on either side leave {robot.joints[i]} no range"
                range_ = f"expected less than half of {robot.q_max[i] - robot.q_min[i]:.3g} rad"
                self.fault(("limits", "position", "margin"), f"{message}; {range_}")
        return make_limits(robot, values)

    def _check_limit(self, name: str, given: Array, model: Array, unit: str) -> None:
        """A limit that the model's own undercuts binds nothing, which is not what its author thinks."""
        tail = "; the model's own limit would bind instead: expected less, or `model`"
        if given.ndim == 0:
            if given > model.max():
                self.fault(("limits", name), f"{given:g} is above the {model.max():g} {unit} of every joint{tail}")
            return
        for i in np.flatnonzero(given > model):
            message = f"{given[i]:g} is above the {model[i]:g} {unit} of {self.robot.joints[i]}{tail}"
            self.fault(("limits", name, self.robot.joints[i]), message)


def _blamed(files: Mapping[str, str]) -> str:
    """The first of robot, tool and scene with which they can no longer be put together."""
    given: dict[str, str] = {}
    for key in ("robot", "tool", "scene"):
        if key in files:
            given[key] = files[key]
            try:
                Robot.load(**given)
            except ModelError:
                return key
    return "robot"


def _told(error: ModelError) -> str:
    """MuJoCo's complaints have line breaks, and do not say what they expected."""
    message = " ".join(str(error).split())
    if isinstance(error, ModelMismatch) or "flange" in message:
        return message
    return f"{message}; expected MJCF or URDF that MuJoCo accepts"


def against(pole: Pole) -> str:
    """What a force loop meets at this pole, in words."""
    unit = "N m/rad" if pole.axis.startswith("m") else "N/m"
    return "a rigid wall" if pole.stiffness is None else f"a stiffness of {pole.stiffness:.3g} {unit}"


def _unstable(worst: Pole) -> str:
    loop = f"the force loop on {worst.axis} is unstable against {against(worst)}"
    pole = f"its largest pole has modulus {worst.radius:.4f}, expected below 1"
    return f"{loop}: {pole}; lower kp or ki, add damping along the axis, or lower the filter's cut-off"


def _stacked(scalars: list[Scalar]) -> Callable[[float], Array]:
    return lambda t: np.array([scalar(t)[0] for scalar in scalars])


def _components(reference: specs.Reference) -> dict[int, Scalar]:
    """Scalar motions of a reference by axis (0 .. 5: wx, wy, wz, vx, vy, vz)."""
    curve = reference.curve
    if isinstance(curve, specs.Line):
        return {3 + i: quintic((0.0, curve.time), (curve.from_[i], curve.to[i])) for i in range(3)}
    if isinstance(curve, specs.Circle):
        (x, y), r, T, ease = curve.center, curve.radius, curve.period, curve.ease
        return {3: sine(r, T, math.pi / 2, x, ease), 4: sine(r, T, 0.0, y, ease)}
    if isinstance(curve, specs.Lissajous):
        sines = zip(curve.size, curve.period, curve.phases, strict=True)
        return {3 + i: sine(size / 2, period, phase, 0.0, curve.ease) for i, (size, period, phase) in enumerate(sines)}
    if isinstance(curve, specs.Quintic):
        points = [(*p, 0.0, 0.0, 0.0)[:6] for p in curve.waypoints]
        order = (3, 4, 5, 0, 1, 2)
        used = 6 if any(len(p) == 6 for p in curve.waypoints) else 3
        return {order[i]: quintic(curve.times, [p[i] for p in points]) for i in range(used)}
    return {}
