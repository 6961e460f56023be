"""From a spec to a controller: names become frames and joints, tables become contacts, references become motion.

Everything that only the robot can tell is checked here, every fault with its place in the file.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path as FilePath
from typing import Any

import numpy as np
import pinocchio as pin

from . import spec as specs
from .contact import AxesContact, Contact, MatrixContact, ScrewContact, WorldAxesContact
from .controller import Controller, Phase, make_limits
from .dynamics import mobility
from .errors import Fault, ModelError, NameNotFound, SpecError, WbcError, did_you_mean
from .metrics import vocabulary
from .model import find
from .qp import Array
from .reference import Path, Reference, Scalar, ScrewPath, constant, hold, quintic, ramp, sine
from .robot import Robot
from .solver import Solver, make
from .stability import Pole, damping_margin, force_poles
from .task import ForceTask, MotionTask, PostureTask, Task
from .wrench import VELOCITY_AXES, WRENCH_AXES

CLOSED = 1e-9  # [m, rad] how well the start pose meets the contacts


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
        self.spec, self.faults = spec, list[Fault]()
        self.solver = solver or spec.solver
        self.robot = robot if robot is not None else self._load_robot()
        self.dt = 1.0 / spec.rate

    @contextmanager
    def at(self, *path: str | int) -> Iterator[None]:
        """Whatever is wrong inside is a fault of that place in the spec."""
        try:
            yield
        except SpecError:
            raise
        except WbcError as error:
            self.faults.append(self.spec.fault(path, str(error)))

    def raise_faults(self) -> None:
        if self.faults:
            raise SpecError(self.faults)

    def built(self) -> Built:
        self._check_names()
        self.raise_faults()
        q_home = self._start_joints()
        self.raise_faults()
        contacts, references = self._geometry(self.spec, q_home)
        self.raise_faults()
        q = self._close(q_home, contacts, references)
        with self.at("solver"):
            make(self.solver)
        phases, poles, margins = self._phases(q, q_home)
        self.raise_faults()
        controller = Controller(self.robot, solver=self.solver, rate=self.spec.rate, phases=phases, q=q)
        known = vocabulary(controller.phases)
        for name in self.spec.expect.bounds:
            if name not in known:
                self.faults.append(self.spec.fault(("expect", name), f"no such quantity{did_you_mean(name, known)}"))
        self.raise_faults()
        return Built(self.spec, self.robot, controller, q, poles, margins, controller.phases, controller.notes)

    # --- names ---

    def _load_robot(self) -> Robot:
        spec, files = self.spec, {}
        for key, kind, name in (("robot", "scenes/robots", spec.robot), ("tool", "scenes/tools", spec.tool), ("scene", "scenes", spec.scene)):
            if name is not None:
                beside = FilePath(spec.file).parent / name
                with self.at(key):
                    files[key] = name if name.startswith("erd:") else str(beside if beside.is_file() else find(kind, name))
        self.raise_faults()
        with self.at("robot"):
            return Robot.load(files["robot"], files.get("tool"), files.get("scene"), spec.gravity, name=spec.robot)
        raise SpecError(self.faults)

    def _frame(self, name: str, *path: str | int) -> None:
        with self.at(*path):
            self.robot.frame_id(name)

    def _check_names(self) -> None:
        spec = self.spec
        for name, reference in spec.references.items():
            if reference.curve.in_ != "world":
                with self.at("references", name, reference.kind, "in"):
                    self.robot.fixed_pose(reference.curve.in_)
        for name, contact in spec.contacts.items():
            self._frame(contact.frame, "contacts", name, "frame")
            if contact.on is not None:
                with self.at("contacts", name, "on"):
                    self.robot.fixed_pose(contact.on)
            for screw, motion in (contact.free or {}).items():
                if motion.screw.through != "self":
                    with self.at("contacts", name, "free", screw, "screw", "through"):
                        self.robot.fixed_pose(motion.screw.through)
        for name, task in spec.tasks.items():
            if isinstance(task, specs.MotionTask) and task.frame is not None:
                self._frame(task.frame, "tasks", name, "frame")
            if isinstance(task, specs.PostureTask):
                self._joint_names(task.target, "tasks", name, "target")
        if spec.start is not None:
            self._joint_names(spec.start, "start")
        for limit in ("torque", "torque_rate", "velocity"):
            value = getattr(spec.limits, limit)
            if isinstance(value, dict):
                self._joint_names(value, "limits", limit)
            elif isinstance(value, tuple) and len(value) != self.robot.nv:
                self.faults.append(spec.fault(("limits", limit), f"expected {self.robot.nv} numbers, one a joint, got {len(value)}"))

    def _joint_names(self, pose: str | Mapping[str, float], *path: str | int) -> None:
        if isinstance(pose, str):
            known = [*self.robot.keyframes, "start"]
            if pose not in known:
                self.faults.append(self.spec.fault(path, f"no keyframe named {pose!r}{did_you_mean(pose, known)}"))
            return
        for joint in pose:
            if joint not in self.robot.joints:
                self.faults.append(self.spec.fault((*path, joint), f"no joint named {joint!r}{did_you_mean(joint, self.robot.joints)}"))

    def _joint_values(self, values: Mapping[str, float], base: Array) -> Array:
        out = base.copy()
        for joint, value in values.items():
            out[self.robot.joints.index(joint)] = value
        return out

    # --- geometry ---

    def _start_joints(self) -> Array:
        start = self.spec.start or "home"
        home = self.robot.keyframes["home"]
        if isinstance(start, str):
            if start == "start":
                self.faults.append(self.spec.fault(("start",), "expected a keyframe or joint values, not itself"))
                return home
            return self.robot.keyframes[start].copy()
        return self._joint_values(start, home)

    def _on(self, name: str, contact: specs.Contact, q: Array) -> tuple[pin.SE3, bool]:
        """Where the world holds the frame at the start, and whether the start must be closed onto it."""
        on = contact.on or (name if name in self.robot.frames else None)
        if on is not None:
            return self.robot.fixed_pose(on), True
        return self.robot.state(q, np.zeros(self.robot.nv)).frame(contact.frame).T, False

    def _geometry(self, spec: specs.Spec, q: Array) -> tuple[dict[str, Contact], dict[str, Reference]]:
        """Contacts, and the motion references by task."""
        contacts: dict[str, Contact] = {}
        paths: dict[str, Reference] = {}
        for name, entry in spec.contacts.items():
            with self.at("contacts", name, entry.kind):
                contacts[name], paths[name] = self._contact(spec, name, entry, q)
        references = {}
        for name, task in spec.tasks.items():
            if not isinstance(task, specs.MotionTask):
                continue
            if task.contact is not None:
                if task.contact in paths:
                    references[name] = paths[task.contact]
                continue
            assert task.frame is not None
            here = self.robot.state(q, np.zeros(self.robot.nv)).frame(task.frame).T
            with self.at("tasks", name, "target"):
                references[name] = self._path(spec, task.target, here)
        return contacts, references

    def _contact(self, spec: specs.Spec, name: str, entry: specs.Contact, q: Array) -> tuple[Contact, Reference]:
        origin, _ = self._on(name, entry, q)
        robot_axes = tuple(VELOCITY_AXES[i] for i in self.robot.axes(entry.frame))
        targets = entry.motion_targets
        if entry.kind == "free":
            return self._screws(spec, name, entry, origin)
        if entry.kind == "A":
            contact: Contact = MatrixContact(entry.frame, np.array(entry.A or np.zeros((0, 6))))
            return contact, hold(origin)
        if entry.kind == "natural":
            named = {*entry.constrained, *entry.free_axes}
            if named != set(robot_axes):
                missing = ", ".join(a for a in robot_axes if a not in named)
                extra = ", ".join(a for a in VELOCITY_AXES if a in named and a not in robot_axes)
                said = [f"the table says nothing of {missing}"] * bool(missing) + [f"{self.spec.robot} cannot move along {extra}"] * bool(extra)
                self.faults.append(spec.fault(("contacts", name, "natural"), f"{'; '.join(said)}; expected the axes {', '.join(robot_axes)}"))
        held = robot_axes if entry.holds == "all" else entry.constrained
        free = tuple(a for a in robot_axes if a not in held)
        if entry.in_ == "on":
            contact = WorldAxesContact(entry.frame, held, origin.rotation, free)
        else:
            contact = AxesContact(entry.frame, held, free)
        along = {}
        for axis in free:
            target = targets.get(axis, 0.0)
            with self.at("contacts", name, "artificial", axis):
                along[VELOCITY_AXES.index(axis)] = self._scalar(spec, target, VELOCITY_AXES.index(axis), entry.on or name)
        return contact, Path(origin, along)

    def _screws(self, spec: specs.Spec, name: str, entry: specs.Contact, origin: pin.SE3) -> tuple[Contact, Reference]:
        screws, scalars = [], []
        for label, motion in (entry.free or {}).items():
            screw = motion.screw
            place = origin if screw.through == "self" else self.robot.fixed_pose(screw.through)
            axis = np.eye(3)["xyz".index(screw.axis)] if isinstance(screw.axis, str) else np.array(screw.axis) / np.linalg.norm(screw.axis)
            w = place.rotation @ axis
            p = place.translation - origin.translation
            R = origin.rotation.T  # everything in the axes of the place where the frame is held
            screws.append(np.concatenate((R @ w, R @ (np.cross(p, w) + screw.pitch * w))))
            component = "xyz".index(screw.axis) if isinstance(screw.axis, str) else 2
            with self.at("contacts", name, "artificial", label):
                scalars.append(self._scalar(spec, entry.motion_targets.get(label, 0.0), component, None))
        contact = ScrewContact(entry.frame, np.array(screws).reshape(-1, 6), origin, tuple(entry.free or ()))
        return contact, ScrewPath(origin, screws, scalars, pin.SE3.Identity())

    def _scalar(self, spec: specs.Spec, target: float | str, axis: int, on: str | None) -> Scalar:
        if not isinstance(target, str):
            return ramp(target) if target else constant(0.0)
        reference = spec.references[target]
        if on is not None and reference.curve.in_ not in (on, "world"):
            raise ModelError(f"reference {target!r} is drawn in {reference.curve.in_!r}, but the contact closes on {on!r}")
        return _components(reference).get(axis, constant(0.0))

    def _path(self, spec: specs.Spec, target: str | None, here: pin.SE3) -> Reference:
        if target is None:
            return hold(here)
        reference = spec.references[target]
        in_ = reference.curve.in_
        if reference.kind == "hold" and in_ == "world":
            return hold(here)
        origin = pin.SE3.Identity() if in_ == "world" else self.robot.fixed_pose(in_)
        turns = any(i < 3 for i in _components(reference))
        # a path of positions keeps the orientation that the frame starts with
        offset = None if turns else pin.SE3(origin.rotation.T @ here.rotation, np.zeros(3))
        return Path(origin, _components(reference), offset)

    def _close(self, q: Array, contacts: dict[str, Contact], references: dict[str, Reference]) -> Array:
        """Move the start pose onto the contacts and references by damped least squares."""
        goals: list[tuple[str, pin.SE3, Array, tuple[str, ...]]] = []
        for name, task in self.spec.tasks.items():
            if isinstance(task, specs.MotionTask) and task.contact is None and name in references and task.target is not None:
                assert task.frame is not None
                rows = np.eye(6) if task.axes == "all" else np.eye(6)[[VELOCITY_AXES.index(a) for a in task.axes]]
                goals.append((task.frame, references[name](0.0).T, rows, ("tasks", name, "target")))
        paths = {t.contact: references[n] for n, t in self.spec.tasks.items() if isinstance(t, specs.MotionTask) and t.contact and n in references}
        for name, contact in contacts.items():
            T, closes = self._on(name, self.spec.contacts[name], q)
            if closes:
                held = contact.A(self.robot.state(q, np.zeros(self.robot.nv)))
                goals.append((contact.frame, paths[name](0.0).T if name in paths else T, np.eye(6) if name in paths else held, ("contacts", name)))
        if not goals:
            return q
        start, q = q, q.copy()
        error = np.zeros(0)
        for _ in range(200):
            state = self.robot.state(q, np.zeros(self.robot.nv))
            errors, rows = [], []
            for frame, T, select, _ in goals:
                here = state.frame(frame)
                errors.append(select @ pin.log6(here.T.actInv(T)).vector[[3, 4, 5, 0, 1, 2]])
                rows.append(select @ here.J)
            error, J = np.concatenate(errors), np.concatenate(rows)
            step = np.linalg.lstsq(np.r_[J, 1e-6 * np.eye(self.robot.nv)], np.r_[error, np.zeros(self.robot.nv)], rcond=None)[0]
            q = pin.integrate(self.robot.model, q, step * min(1.0, 0.5 / max(np.abs(step).max(), 1e-12)))
            if np.abs(step).max() < 1e-12:
                break
        reach = np.abs(error).max()
        if not reach < CLOSED:
            self.faults.append(self.spec.fault(goals[0][3], f"the robot cannot reach it from its start pose: {reach:.2g} m or rad are left; choose another start, robot or place"))
        elif self.robot.nq == self.robot.nv:
            for i in np.flatnonzero((q < self.robot.q_min) | (q > self.robot.q_max)):
                message = f"closing the contacts puts {self.robot.joints[i]} at {q[i]:.3f} rad, outside [{self.robot.q_min[i]:.3f}, {self.robot.q_max[i]:.3f}]"
                self.faults.append(self.spec.fault(("start",), message))
        return q if not self.faults else start

    # --- phases ---

    def _phases(self, q: Array, q_home: Array) -> tuple[list[Phase], list[Pole], dict[str, float]]:
        entries = self.spec.phases or {"": None}
        phases, poles, margins = [], [], {}
        for name, entry in entries.items():
            spec = self.spec.with_set(entry.set) if entry is not None and entry.set else self.spec
            contacts, references = self._geometry(spec, q_home)
            self.raise_faults()
            tasks, weights = self._tasks(spec, contacts, references, q)
            self.raise_faults()
            found, margin = self._stability(spec, contacts, tasks, q)
            poles += [pole for pole in found if pole not in poles]
            margins |= margin
            torque, joint = self._limits(spec)
            until = entry.until.time if entry is not None and entry.until is not None else math.inf
            phases.append(Phase(contacts, tasks, weights, torque, joint, name, until))
        return phases, poles, margins

    def _tasks(self, spec: specs.Spec, contacts: dict[str, Contact], references: dict[str, Reference], q: Array) -> tuple[dict[str, Task], dict[str, float]]:
        tasks: dict[str, Task] = {}
        for name, entry in spec.tasks.items():
            with self.at("tasks", name, "kp"):
                if isinstance(entry, specs.ForceTask):
                    tasks[name] = self._force(spec, entry, contacts[entry.contact])
                elif isinstance(entry, specs.MotionTask):
                    tasks[name] = self._motion(spec, entry, contacts, references[name])
                else:
                    target = self._posture_target(entry.target, q)
                    tasks[name] = PostureTask(target, _gain(entry.kp), _gain(entry.kd), self.robot.nv)
        return tasks, {name: spec.tasks[name].weight for name in tasks}

    def _posture_target(self, target: str | Mapping[str, float], q: Array) -> Array:
        if isinstance(target, str):
            return q if target == "start" else self.robot.keyframes[target]
        return self._joint_values(target, q)

    def _motion(self, spec: specs.Spec, entry: specs.MotionTask, contacts: dict[str, Contact], reference: Reference) -> MotionTask:
        frame = contacts[entry.contact].frame if entry.contact is not None else entry.frame
        assert frame is not None
        robot_axes = self.robot.axes(frame)
        if entry.contact is not None:
            axes = contacts[entry.contact].free_axes
        else:
            axes = tuple(VELOCITY_AXES[i] for i in robot_axes) if entry.axes == "all" else entry.axes
        return MotionTask(frame, reference, _gain(entry.kp), _gain(entry.kd), axes, entry.contact, spec.law, robot_axes)

    def _force(self, spec: specs.Spec, entry: specs.ForceTask, contact: Contact) -> ForceTask:
        name = entry.contact
        with self.at("contacts", name, "artificial"):
            state = self.robot.state(self.robot.keyframes["home"], np.zeros(self.robot.nv))
            scalars = {WRENCH_AXES.index(axis): self._force_scalar(spec, value) for axis, value in spec.contacts[name].wrench_targets.items()}
            wrench = np.zeros(6)
            for i, scalar in scalars.items():
                wrench[i] = scalar(0.0)[0] or 1e-300  # a target of zero must be carried as well
            R = contact.A(state)
            if isinstance(contact, AxesContact):
                # the table's own axes: they are the multipliers
                order = [WRENCH_AXES.index(axis) for axis in contact.axes]
                outside = [WRENCH_AXES[i] for i in scalars if i not in order]
                if outside:
                    contact.multipliers(np.eye(6)[[WRENCH_AXES.index(a) for a in outside]].sum(axis=0), state)
                moving = any(isinstance(v, str) for v in spec.contacts[name].wrench_targets.values())
                if not moving:
                    target: Any = np.array([scalars[i](0.0)[0] if i in scalars else 0.0 for i in order])
                else:
                    target = _stacked([scalars.get(i, constant(0.0)) for i in order])
            else:
                contact.multipliers(wrench, state)
                inverse = contact.pseudo_inverse(R)
                full = _stacked([scalars.get(i, constant(0.0)) for i in range(6)])
                target = (lambda t: inverse @ full(t)) if isinstance(contact, MatrixContact) else inverse @ wrench
            return ForceTask(
                name, contact, target, _gain(entry.kp), _gain(entry.ki), _gain(entry.damping), entry.filter,
                entry.integral_limit if entry.integral_limit is not None else math.inf, spec.law,
            )  # fmt: skip
        raise SpecError(self.faults)

    def _force_scalar(self, spec: specs.Spec, value: float | str) -> Scalar:
        if isinstance(value, str):
            return _components(spec.references[value]).get(3, constant(0.0))
        return constant(float(value))

    def _stability(self, spec: specs.Spec, contacts: dict[str, Contact], tasks: dict[str, Task], q: Array) -> tuple[list[Pole], dict[str, float]]:
        state = self.robot.state(q, np.zeros(self.robot.nv))
        poles: list[Pole] = []
        margins: dict[str, float] = {}
        for name, task in tasks.items():
            if not isinstance(task, ForceTask):
                continue
            contact = contacts[task.contact]
            W = mobility(state, contact.hold(state).G)
            k = contact.k
            kp, ki = (K[:k, :k] if K.shape[0] != k else K for K in (task.Kp, task.Ki))
            found = force_poles(
                task.contact, contact.axes, 1.0 / W.diagonal(), kp, ki, task.K_damp, task.smoothing(self.dt), self.dt, 1 + spec.plant.delay
            )
            poles += found
            worst = max(found, key=lambda pole: pole.radius, default=None)
            if worst is not None and not worst.radius < 1.0:
                against = "a rigid wall" if worst.stiffness is None else f"a stiffness of {worst.stiffness:.3g} {'N m/rad' if worst.axis.startswith('m') else 'N/m'}"
                self.faults.append(spec.fault(("tasks", name, "kp"), f"the force loop on {worst.axis} is unstable against {against}: its largest pole has modulus {worst.radius:.4f}, expected below 1; lower kp, add damping along the axis, or lower the filter's cutoff"))
            margins[name] = damping_margin(W, task.K_damp, self.dt)
            if not margins[name] < 2.0:
                self.faults.append(spec.fault(("tasks", name, "damping"), f"damping is unstable at this rate: dt max eig(A M_C^-1 A' K_damp) = {margins[name]:.2f}, expected below 2; lower it on the axes of small inertia"))
        return poles, margins

    def _limits(self, spec: specs.Spec) -> Any:
        limits = spec.limits
        model = {"torque": np.minimum(self.robot.tau_max, -self.robot.tau_min), "velocity": self.robot.v_max}

        def value(name: str) -> Any:
            given = getattr(limits, name)
            if isinstance(given, specs.Scale):
                return model[name] * given.scale
            if isinstance(given, dict):
                return self._joint_values(given, model.get(name, np.full(self.robot.nv, np.inf)))
            return given

        position = limits.position.margin if isinstance(limits.position, specs.Margin) else limits.position
        return make_limits(self.robot, {"torque": value("torque"), "torque_rate": value("torque_rate"), "position": position, "velocity": value("velocity")})


def _gain(value: Any) -> Any:
    return value if isinstance(value, (int, float)) else np.array(value, float)


def _stacked(scalars: list[Scalar]) -> Callable[[float], Array]:
    return lambda t: np.array([scalar(t)[0] for scalar in scalars])


def _components(reference: specs.Reference) -> dict[int, Scalar]:
    """Scalar motions of a reference by axis (0 .. 5: wx, wy, wz, vx, vy, vz)."""
    curve = reference.curve
    if reference.kind == "line":
        return {3 + i: quintic((0.0, curve.time), (curve.from_[i], curve.to[i])) for i in range(3)}
    if reference.kind == "circle":
        x, y = curve.center
        return {3: sine(curve.radius, curve.period, math.pi / 2, x, curve.ease), 4: sine(curve.radius, curve.period, 0.0, y, curve.ease)}
    if reference.kind == "lissajous":
        return {3 + i: sine(curve.size[i] / 2, curve.period[i], curve.phase[i], 0.0, curve.ease) for i in range(2)}
    if reference.kind == "quintic":
        points = [(*p, 0.0, 0.0, 0.0)[:6] for p in curve.waypoints]
        order = (3, 4, 5, 0, 1, 2)
        used = 6 if any(len(p) == 6 for p in curve.waypoints) else 3
        return {order[i]: quintic(curve.times, [p[i] for p in points]) for i in range(used)}
    return {}
