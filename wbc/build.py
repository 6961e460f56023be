"""From a spec to a controller: names become frames and joints, tables become contacts, references become motion.

Everything that only the robot can tell is checked here, every fault with its place in the file.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from copy import copy
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from . import spec as specs
from .analytic import damping_limit
from .closing import CLOSED, Goal, Lying, close
from .contact import Contact
from .controller import Controller
from .coordinates import to_mujoco
from .dynamics import mobility
from .errors import did_you_mean
from .exits import exit_of
from .faults import Faults
from .feeling import check_felt
from .free_motion import STABLE, MassRange, following_radius, mass_range
from .geometry import Geometry, components
from .limit import JointLimit, TorqueLimit, make_collision, make_limits
from .metrics import vocabulary
from .model import open_welds
from .names import check_names, load_robot
from .phase import Phase, prioritised
from .qp import Array
from .ride import Ride
from .robot import Robot
from .solver import Solver, make
from .stability import Pole, damping_margin, force_poles
from .task import Task
from .task.force import ForceTask
from .task.impedance import AdmittanceTask, Compliance
from .tracking import Tracking, joint_values
from .wrench import VELOCITY_AXES

if TYPE_CHECKING:
    from .collision import SelfCollision

WELDED = 1e-6  # [m, rad] how well the start pose closes what the scene welds


@dataclass(frozen=True)
class Built:
    """A spec with everything made from it."""

    spec: specs.Spec
    robot: Robot
    controller: Controller
    q: Array  # start
    poles: list[Pole]
    damping_margins: dict[str, float]
    damping_limits: dict[str, dict[str, float]]
    phases: tuple[Phase, ...] = ()
    notes: list[str] = field(default_factory=list)
    masses: list[MassRange] = field(default_factory=list)
    rides: Mapping[str, Ride] = field(default_factory=dict)  # how bodies of the scene move


def build(spec: specs.Spec, robot: Robot | None = None, solver: str | Solver | None = None) -> Built:
    """Everything from a spec. Raises SpecError with all faults that this stage finds."""
    faults, solver = Faults(spec), solver or spec.solver
    with faults.at("solver"):
        make(solver)
    robot = robot if robot is not None else load_robot(spec, faults)
    check_names(spec, robot, faults)
    faults.check()
    geometry = Geometry(spec, robot, faults)
    q_home = _start_joints(spec, robot, faults)
    geometry.at(q_home)
    faults.check()
    rides = {
        body: geometry.ride(path, robot.fixed_pose(body), ("plant", "paths", body))
        for body, path in spec.plant.paths.items()
    }
    notes = _check_followed(geometry) + _unlimited(spec, robot)
    entries: Mapping[str, specs.Phase | None] = spec.phases or {"": None}
    first = replace(geometry, spec=_active(spec, next(iter(entries.values()))))
    q = _close(q_home, first.goals(q_home, *first.at(q_home)), robot, faults)
    _check_welds(robot, q, faults)
    followers = [*list(entries)[1:], ""]
    made = [
        _phase(geometry, name, entry, follower, q)
        for (name, entry), follower in zip(entries.items(), followers, strict=True)
    ]
    phases = [each.phase for each in made]
    _check_metrics(spec, phases, faults)
    faults.check()
    with faults.at("law"):
        controller = Controller(robot, solver=solver, rate=spec.rate, phases=phases, q=q, brakes=spec.brakes)
    faults.check()
    poles = list(dict.fromkeys(pole for each in made for pole in each.poles))
    margins = {name: margin for each in made for name, margin in each.margins.items()}
    masses = [each for phase in made for each in phase.masses]
    most = {name: limits for each in made for name, limits in each.damping_limits.items()}
    notes += controller.notes
    notes += dict.fromkeys(each.phase.collision.note for each in made if each.phase.collision is not None)
    return Built(spec, robot, controller, q, poles, margins, most, controller.phases, notes, masses, rides)


def _start_joints(spec: specs.Spec, robot: Robot, faults: Faults) -> Array:
    start = spec.start or "home"
    if isinstance(start, str):
        return robot.keyframes[start].copy()
    q = joint_values(robot, start, robot.keyframes["home"])
    for joint in start:
        i = robot.joints.index(joint)
        angle = q[i - robot.nu]
        if not robot.q_min[i] <= angle <= robot.q_max[i]:
            range_ = f"{robot.q_min[i]:.4g} to {robot.q_max[i]:.4g}"
            faults.add(
                ("start", joint), f"{angle:g} rad is outside of the joint's range, {range_}; expected one inside"
            )
    return q


def _close(q: Array, goals: Sequence[Goal | Lying], robot: Robot, faults: Faults) -> Array:
    """The start pose moved onto the contacts and references; unmoved where there are faults."""
    if not goals:
        return q
    start, (q, errors) = q, close(robot, q, goals)
    if not max(errors) < CLOSED:
        worst = goals[int(np.argmax(errors))]
        left = f"{max(errors):.2g} m or rad are left"
        message = f"{faults.spec.robot} cannot bring {worst.frame} there from its start pose: {left}"
        faults.add(worst.path, f"{message}; choose another place, start or robot")
    elif robot.nq == robot.nv or robot.base:
        own = q[-robot.nu :]
        for i in np.flatnonzero((own < robot.q_min) | (own > robot.q_max)):
            message = f"closing the contacts puts {robot.joints[i]} at {own[i]:.3f} rad"
            allowed = f"outside [{robot.q_min[i]:.3f}, {robot.q_max[i]:.3f}]"
            faults.add(("start",), f"{message}, {allowed}; choose another start or place")
    return start if faults.found else q


def _check_welds(robot: Robot, q: Array, faults: Faults) -> None:
    """What the scene welds to the robot is closed at the start: a weld does not pull the robot into place."""
    if robot.mujoco is None or not robot.mujoco.neq or faults.found:
        return
    for first, second, gap in open_welds(robot.mujoco, to_mujoco(robot.mujoco, q)):
        if not gap < WELDED:
            message = f"it welds {first} to {second}, which are {gap:.2g} m or rad apart at the start pose"
            faults.add(("scene",), f"{message}; expected a contact that closes one onto the other (`on:`)")


def _check_followed(geometry: Geometry) -> list[str]:
    """A reference that nothing follows is a mistake, unless `--set` has just taken its followers away."""
    spec, notes = geometry.spec, list[str]()
    targets = [("contacts", name, "artificial", axis) for name, c in spec.contacts.items() for axis in c.targets]
    for contact in spec.contacts.values():
        for value in contact.wrench_targets.values():
            if isinstance(value, str):
                geometry.followed.setdefault(value, set()).add(3)
    for task in spec.tasks.values():
        if isinstance(task, specs.ImpedanceTask | specs.AdmittanceTask) and task.K_scale is not None:
            geometry.followed.setdefault(task.K_scale, set()).add(3)
    overridden = any(spec.fault(target, "").file != spec.file for target in targets)
    for name, reference in spec.references.items():
        idle = set(components(reference)) - geometry.followed.get(name, set())
        if name not in geometry.followed and not overridden:
            geometry.faults.add(
                ("references", name), "nothing follows it; expected a target in contacts or tasks to name it"
            )
        elif idle and reference.kind != "profile":
            along = ", ".join(VELOCITY_AXES[i] for i in sorted(idle))
            notes.append(f"{name}: nothing follows its motion along {along}")
    return notes


def _unlimited(spec: specs.Spec, robot: Robot) -> list[str]:
    """Limits that are said to be the model's, and which it does not state."""
    most = {"torque": robot.tau_max, "velocity": robot.v_max, "position": robot.q_max}
    notes = list[str]()
    for name, limit in most.items():
        joints = [robot.joints[i] for i in np.flatnonzero(np.isinf(limit))]
        if joints and getattr(spec.limits, name) == "model":
            few = ", ".join(joints[:6]) + (f" and {len(joints) - 6} others" if len(joints) > 6 else "")
            notes.append(f"limits.{name}: the model states none for {few}")
    return notes


def _check_metrics(spec: specs.Spec, phases: Sequence[Phase], faults: Faults) -> None:
    known = vocabulary(phases, spec.plant)
    for name in spec.expect.bounds:
        if name not in known:
            faults.add(("expect", name), f"no such quantity{did_you_mean(name, [*known, 'settle'])}")


class _Made(NamedTuple):
    """A phase, and the stability of its force loops."""

    phase: Phase
    poles: list[Pole]
    margins: dict[str, float]
    damping_limits: dict[str, dict[str, float]]
    masses: list[MassRange]


def _active(spec: specs.Spec, phase: specs.Phase | None) -> specs.Spec:
    """A spec with the contacts and tasks that are active in a phase."""
    if phase is None:
        return spec
    contacts = {name: spec.contacts[name] for name in phase.active("contacts", spec.contacts)}
    tasks = {name: spec.tasks[name] for name in phase.active("tasks", spec.tasks)}
    return spec.model_copy(update={"contacts": contacts, "tasks": tasks})


def _phase(base: Geometry, name: str, entry: specs.Phase | None, follower: str, q: Array) -> _Made:
    """One phase; a spec without phases is a single one without a name."""
    geometry = base
    if entry is not None:
        spec = base.spec.model_copy(update={"phases": {}})  # which have been checked against one another
        spec = spec.with_set(entry.set) if entry.set else spec
        geometry = replace(base, spec=_active(spec, entry), faults=base.faults.within(name, tuple(entry.set)))
    contacts, references = geometry.at(q)
    if len(contacts) < len(geometry.spec.contacts):
        geometry.faults.check()
    tasks = Tracking(geometry, contacts, references).tasks(q)
    check_felt(geometry, contacts, tasks)
    placed = {task: geometry.spec.tasks[task] for task in tasks}
    weights, levels = prioritised(
        {task: entry.weight for task, entry in placed.items()},
        {task: entry.level for task, entry in placed.items()},
        geometry.spec.hierarchy,
    )
    poles, margins, most = _stability(geometry, contacts, tasks, q)
    key = repr(("limits", geometry.spec.limits))
    if key not in base.made or (entry is not None and any(changed.startswith("limits.") for changed in entry.set)):
        base.made[key] = _limits(geometry.spec, geometry.robot, geometry.faults)
    torque, joint = base.made[key]
    collision = _collision(geometry)
    exit_ = None if entry is None else exit_of(base, name, entry, follower, contacts, tasks, q)
    masses = _masses(geometry, contacts, tasks, q)
    phase = Phase(contacts, tasks, weights, torque, joint, name, exit_, levels, collision)
    return _Made(phase, poles, margins, most, masses)


def _masses(
    geometry: Geometry, contacts: Mapping[str, Contact], tasks: Mapping[str, Task], q: Array
) -> list[MassRange]:
    """What impedance and admittance can render at the start; what is unstable there is a fault."""
    spec, robot, masses = geometry.spec, geometry.robot, list[MassRange]()
    state = robot.state(q, np.zeros(robot.nv))
    for name, contact in contacts.items():
        state.contacts[name] = contact.hold(state)
    for name, task in tasks.items():
        if not isinstance(task, Compliance):
            continue
        found = mass_range(name, _stiffest(spec, name, task), state, 1.0 / spec.rate, spec.plant.delay)
        masses.append(found)
        if not found.stable:
            geometry.faults.add(("tasks", name, "M"), _unrendered(found))
        if isinstance(task, AdmittanceTask) and not task.printed:
            pole = following_radius(task, 1.0 / spec.rate, spec.plant.delay)
            if not pole <= STABLE:
                told = f"the arm cannot follow so stiffly at this rate: the largest pole has modulus {pole:.4f}"
                geometry.faults.add(("tasks", name, "kd"), f"{told}, expected below 1; lower kp or kd")
    return masses


def _stiffest(spec: specs.Spec, name: str, task: Compliance) -> Compliance:
    """A task with the largest stiffness that it is to have."""
    scale = getattr(spec.tasks[name], "K_scale", None)
    if scale is None:
        return task
    profile = spec.references[scale].profile
    assert profile is not None
    task = copy(task)
    task.K = max(profile.values) * task.K
    return task


def _unrendered(found: MassRange) -> str:
    """An unstable mass, and those that would be stable."""
    pole = f"unstable at this rate: the largest pole of free motion has modulus {found.radius:.4f}, expected below 1"
    told = [
        f"{axis} from {low:.3g}{'' if math.isinf(high) else f' to {high:.3g}'}"
        for axis, low, high in zip(found.axes, found.least, found.most, strict=True)
        if low < high
    ]
    return f"{pole}; choose M on {', '.join(told)}" if told else f"{pole}; lower it with K and B, or raise the rate"


def _stability(
    geometry: Geometry, contacts: Mapping[str, Contact], tasks: Mapping[str, Task], q: Array
) -> tuple[list[Pole], dict[str, float], dict[str, dict[str, float]]]:
    """Poles of every force loop; by task, the damping margin and the most that each axis bears on its own."""
    spec, robot, faults = geometry.spec, geometry.robot, geometry.faults
    state, dt = robot.state(q, np.zeros(robot.nv)), 1.0 / spec.rate
    poles: list[Pole] = []
    margins: dict[str, float] = {}
    most: dict[str, dict[str, float]] = {}
    for name, task in tasks.items():
        if not isinstance(task, ForceTask):
            continue
        contact = contacts[task.contact]
        W = mobility(state, contact.hold(state).G)
        k, delay, alpha = contact.k, 1 + spec.plant.delay, task.smoothing(dt)
        Kp, Ki, D = task.Kp[:k, :k], task.Ki[:k, :k], task.K_damp
        masses = 1.0 / np.maximum(W.diagonal(), 1e-12)
        margins[name] = damping_margin(W, D, dt)
        most[name] = {axis: damping_limit(W[i : i + 1, i : i + 1], dt) for i, axis in enumerate(contact.axes)}
        if not margins[name] < 2.0:
            bound = f"dt max eig(A M_C^-1 A' K_damp) = {margins[name]:.3g}, expected below 2"
            advice = "lower it on the axes of small inertia, or raise the rate"
            faults.add(("tasks", name, "damping"), f"damping is unstable at this rate: {bound}; {advice}")
            continue
        if not (Kp.any() or Ki.any()):
            continue  # an open loop has no poles of its own
        found = force_poles(task.contact, contact.axes, masses, Kp, Ki, D, alpha, dt, delay)
        poles += found
        worst = max(found, key=lambda pole: pole.radius, default=None)
        if worst is not None and not worst.radius < 1.0:
            faults.add(("tasks", name, "kp"), _unstable(worst))
    return poles, margins, most


def _limits(spec: specs.Spec, robot: Robot, faults: Faults) -> tuple[TorqueLimit, JointLimit | None]:
    limits = spec.limits
    most = {"torque": np.minimum(robot.tau_max, -robot.tau_min), "velocity": robot.v_max}
    values: dict[str, Any] = {}
    for name in ("torque", "torque_rate", "velocity", "acceleration"):
        given, model = getattr(limits, name), most.get(name, np.full(robot.nu, np.inf))
        if isinstance(given, specs.Scale):
            given = model * given.scale
        elif given is not None and given != "model":
            given = joint_values(robot, given, model) if isinstance(given, dict) else given
            _check_limit(robot, faults, name, np.array(given, float), model, "rad/s" if name == "velocity" else "N m")
        values[name] = given
    values["position"] = limits.position
    if isinstance(limits.position, specs.Margin):
        margin = values["position"] = limits.position.margin
        for i in np.flatnonzero(robot.q_max - robot.q_min <= 2.0 * margin):
            message = f"{margin:g} rad on either side leave {robot.joints[i]} no range"
            range_ = f"expected less than half of {robot.q_max[i] - robot.q_min[i]:.3g} rad"
            faults.add(("limits", "position", "margin"), f"{message}; {range_}")
    return make_limits(robot, values)


def _collision(geometry: Geometry) -> SelfCollision | None:
    """The distances that the robot's own bodies keep."""
    given = geometry.spec.limits.self_collision
    if given is None:
        return None
    with geometry.faults.at("limits", "self_collision"):
        return make_collision(
            geometry.robot, given if isinstance(given, float) else given.model_dump(exclude_none=True)
        )
    return None


def _check_limit(robot: Robot, faults: Faults, name: str, given: Array, model: Array, unit: str) -> None:
    """A limit that the model's own undercuts binds nothing, which is not what its author thinks."""
    tail = "; the model's own limit would bind instead: expected less, or `model`"
    if given.ndim == 0:
        if given > model.max():
            faults.add(("limits", name), f"{given:g} is above the {model.max():g} {unit} of every joint{tail}")
        return
    for i in np.flatnonzero(given > model):
        message = f"{given[i]:g} is above the {model[i]:g} {unit} of {robot.joints[i]}{tail}"
        faults.add(("limits", name, robot.joints[i]), message)


def against(pole: Pole) -> str:
    """What a force loop meets at this pole, in words."""
    unit = "N m/rad" if pole.axis.startswith("m") else "N/m"
    return "a rigid wall" if pole.stiffness is None else f"a stiffness of {pole.stiffness:.3g} {unit}"


def _unstable(worst: Pole) -> str:
    loop = f"the force loop on {worst.axis} is unstable against {against(worst)}"
    pole = f"its largest pole has modulus {worst.radius:.4f}, expected below 1"
    return f"{loop}: {pole}; lower kp or ki, add damping along the axis, or lower the filter's cut-off"
