"""From a spec to a controller: names become frames and joints, tables become contacts, references become motion.

Everything that only the robot can tell is checked here, every fault with its place in the file.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from . import spec as specs
from .closing import CLOSED, Goal, Lying, close
from .controller import Controller
from .coordinates import to_mujoco
from .curve import components
from .errors import did_you_mean
from .exits import exit_of
from .faults import Faults
from .feeling import check_felt
from .free_motion import MassRange
from .geometry import Geometry
from .limiting import collision_of, limits_of, unlimited
from .margins import force_loops, masses_at
from .metrics import vocabulary
from .model import open_welds
from .names import check_names, load_robot
from .phase import Phase, prioritised
from .qp import Array
from .ride import Ride
from .robot import Robot
from .solver import Solver, make
from .stability import Pole
from .tracking import Tracking, joint_values
from .wrench import VELOCITY_AXES

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
    notes = _check_followed(geometry) + unlimited(spec, robot)
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
    poles, margins, most = force_loops(geometry, contacts, tasks, q)
    key = repr(("limits", geometry.spec.limits))
    if key not in base.made or (entry is not None and any(changed.startswith("limits.") for changed in entry.set)):
        base.made[key] = limits_of(geometry.spec, geometry.robot, geometry.faults)
    torque, joint = base.made[key]
    collision = collision_of(geometry)
    exit_ = None if entry is None else exit_of(base, name, entry, follower, contacts, tasks, q)
    masses = masses_at(geometry, contacts, tasks, q)
    phase = Phase(contacts, tasks, weights, torque, joint, name, exit_, levels, collision)
    return _Made(phase, poles, margins, most, masses)
