"""What is active for a while: contacts, tasks with weights, limits; and what of it stands at a state."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from .contact import Contact, Held
from .contact.foot import RoundFeet, RoundFoot
from .errors import LawError, NameNotFound
from .limit import JointLimit, TorqueLimit, make_collision, make_limits
from .qp import Array
from .robot import Robot
from .state import State
from .task import Task
from .task.centroidal import ComTask, MomentumTask, WholeBodyPosture
from .task.force import ForceLoop, ForceTask
from .task.impedance import Compliance, Felt, ImpedanceTask
from .task.motion import MotionTask
from .task.posture import PostureTask
from .task.relative import GazeTask
from .transition import Exit

if TYPE_CHECKING:
    from .collision import SelfCollision

_NONE: Mapping[str, Held] = {}  # never written to
HIERARCHIES = ("weighted", "strict")
LEVEL_RATIO = 1e-3  # of the weights from one level to the next, where priorities are not strict
LAST = 1_000_000  # the level of what decides only what no task does


@dataclass(frozen=True)
class Phase:
    """Contacts, tasks with weights, limits, and the ways out (none: it lasts)."""

    contacts: Mapping[str, Contact]
    tasks: Mapping[str, Task]
    weights: Mapping[str, float]
    torque: TorqueLimit
    joint: JointLimit | None
    name: str = ""
    exit: Exit | None = None
    levels: Mapping[str, int] | None = None  # of the tasks, 1 first: strict priorities. None: the weights decide
    collision: SelfCollision | None = None
    damped: bool = True  # near singularities

    @cached_property
    def fed(self) -> tuple[str, ...]:
        """Contacts whose measured wrench is fed forward along the free axes."""
        return tuple(name for name, contact in self.contacts.items() if contact.feedforward == "measured")

    @cached_property
    def standing(self) -> tuple[str, ...]:
        """Contacts that are feet on a plane."""
        return tuple(name for name, contact in self.contacts.items() if contact.footing is not None)

    @cached_property
    def frames(self) -> tuple[str, ...]:
        """Frames of the robot that its contacts and tasks read at every tick."""
        of: list[Any] = [*self.contacts.values(), *self.tasks.values()]
        read = [getattr(each, key, None) for each in of for key in ("frame", "against", "to")]
        return tuple(dict.fromkeys(name for name in read if isinstance(name, str)))

    @cached_property
    def feet(self) -> RoundFeet | None:
        """Its round feet, which are evaluated together."""
        feet = {name: c for name, c in self.contacts.items() if isinstance(c, RoundFoot) and c.alike}
        return RoundFeet(feet) if feet else None

    @cached_property
    def compliant(self) -> dict[str, Compliance]:
        """Impedance and admittance tasks, by name."""
        return {name: task for name, task in self.tasks.items() if isinstance(task, Compliance)}

    @cached_property
    def following(self) -> dict[str, Any]:
        """Tasks whose reference is led in where it jumps, by name."""
        return {name: task for name, task in self.tasks.items() if getattr(task, "jump", None) is not None}

    @cached_property
    def tanks(self) -> dict[str, ForceTask | Compliance]:
        """Tasks whose energy is bounded, by name."""
        bounded = {n: t for n, t in self.tasks.items() if isinstance(t, ForceTask | Compliance) and t.tank is not None}
        return bounded

    @cached_property
    def feeling(self) -> dict[str, str]:
        """What a measured wrench may be given for, and the frame at which it is wanted: contacts, and tasks without."""
        tasks = {n: t.frame for n, t in self.compliant.items() if t.contact is None and t.source == "measured"}
        return {name: contact.frame for name, contact in self.contacts.items()} | tasks

    def without(self, dropped: Sequence[str]) -> Phase:
        """The same without some contacts, and without the tasks that are about them."""

        def about(task: Any) -> bool:
            named = (getattr(task, "contact", None), *getattr(task, "shares", ()), *getattr(task, "press", ()))
            return any(name in dropped for name in named)

        contacts = {name: contact for name, contact in self.contacts.items() if name not in dropped}
        return replace(self, contacts=contacts, tasks={n: task for n, task in self.tasks.items() if not about(task)})

    @cached_property
    def gravity_only(self) -> bool:
        """Whether a task wants the arm's weight cancelled and nothing else."""
        return any(isinstance(task, ImpedanceTask) and task.gravity_only for task in self.compliant.values())


def prioritised(
    weights: Mapping[str, float], levels: Mapping[str, int], hierarchy: str
) -> tuple[dict[str, float], dict[str, int] | None]:
    """Weights and levels of a phase's tasks: strict levels, or all on one with every level a thousandth of the last."""
    if hierarchy == "strict":
        return dict(weights), dict(levels)
    return {name: weight * LEVEL_RATIO ** (levels[name] - 1) for name, weight in weights.items()}, None


def place(
    robot: Robot,
    contacts: Mapping[str, Contact],
    tasks: Mapping[str, Any],
    limits: Mapping[str, Any],
    hierarchy: str = "weighted",
) -> Phase:
    """A phase from what `Controller` is given: tasks, or a task with its weight and level. Raises WbcError."""
    if hierarchy not in HIERARCHIES:
        raise LawError(f"hierarchy: expected one of {', '.join(HIERARCHIES)}, got {hierarchy!r}")
    given = {name: task if isinstance(task, tuple) else (task,) for name, task in tasks.items()}
    placed = {name: (*task, *(1.0, 1)[len(task) - 1 :]) for name, task in given.items()}
    for name, (task, _, _) in placed.items():
        contact = getattr(task, "contact", None)
        if contact is not None and contact not in contacts:
            raise NameNotFound(f"contact (of task {name!r})", contact, contacts)
        for key in ("frame", "to", "at"):
            if isinstance(named := getattr(task, key, None), str):
                robot.frame_id(named)
        for shared in (*getattr(task, "shares", ()), *getattr(task, "press", ())):
            if shared not in contacts:
                raise NameNotFound(f"contact (of task {name!r})", shared, contacts)
    torque, joint = make_limits(robot, limits)
    weights, levels = prioritised(
        {name: float(weight) for name, (_, weight, _) in placed.items()},
        {name: int(level) for name, (_, _, level) in placed.items()},
        hierarchy,
    )
    only = {name: task for name, (task, _, _) in placed.items()}
    collision = make_collision(robot, limits.get("self_collision"))
    return Phase(dict(contacts), only, weights, torque, joint, levels=levels, collision=collision)


def settle_posture(phase: Phase, start: State, notes: list[str]) -> Phase:
    """Drop a posture where contacts and motion leave no null space; damp the self-motion that nothing else holds."""
    state = State(start.terms, start.q, start.v)
    hold(state, phase)
    rows = [held.G for held in state.contacts.values()]
    moving = MotionTask | Compliance | ComTask | MomentumTask | GazeTask
    rows += [task.target(state)[0] for task in phase.tasks.values() if isinstance(task, moving)]
    rank = np.linalg.matrix_rank(np.concatenate(rows)) if rows else 0
    postures = [name for name, task in phase.tasks.items() if isinstance(task, PostureTask)]
    tasks = dict(phase.tasks)
    if rank >= start.robot.nv:
        for name in postures:
            del tasks[name]
            note = f"{name}: dropped, contacts and motion leave no null space of the {start.robot.nu} joints"
            if note not in notes:
                notes.append(note)
    elif not postures:
        robot = start.robot
        still = WholeBodyPosture(start.q, 0.0, 10.0, robot.nu) if robot.base else PostureTask(start.q, 0.0, 10.0)
        tasks["self_motion"] = still
    weights = {name: phase.weights.get(name, 1.0) for name in tasks}
    levels = phase.levels and {name: phase.levels.get(name, LAST) for name in tasks}
    return replace(phase, tasks=tasks, weights=weights, levels=levels)


def hold(state: State, phase: Phase) -> None:
    """Evaluate the contacts of a phase at a state."""
    state.prepare(phase.frames)
    together = phase.feet.hold(state) if phase.feet is not None else _NONE
    for name, contact in phase.contacts.items():
        state.contacts[name] = together[name] if name in together else contact.hold(state)
    for name, released in state.released.items():
        if name in state.contacts:
            state.contacts[name].rhs -= released.pull


def carry(state: State, phase: Phase) -> None:
    """Count what contacts feed forward of their measured wrenches as known."""
    for name in phase.fed:
        if name in state.measured:
            held = state.contacts[name]
            state.carry(held.seen, phase.contacts[name].known(state, held, state.measured[name]))


def carry_felt(state: State, phase: Phase, felt: Mapping[str, Felt]) -> None:
    """Count what compliant tasks feel as known: on each link once, and not again what its contact has fed forward."""
    counted = [state.contacts[name].frame for name in phase.fed if name in state.measured]
    for name, task in phase.compliant.items():
        F = felt[name].F
        if F is None or not task.carries or any(state.robot.wrench_map(task.frame, at) is not None for at in counted):
            continue
        counted.append(task.frame)
        state.carry(*_unheld(state, task.frame, F))


def recall(state: State, phase: Phase, loops: Mapping[str, ForceLoop], felt: Mapping[str, Felt]) -> None:
    """What tasks with a tank remember of the last tick, for what asks for it before this one is filled in."""
    for name, task in phase.tanks.items():
        if isinstance(task, ForceTask):
            if task.contact in loops:
                state.loops[task.contact] = loops[task.contact]
        elif name in felt:
            state.felt[task] = felt[name]


def stored(state: State, task: ForceTask | Compliance) -> float:
    """The energy in the tank of a task [J]; not a number before its first tick."""
    memory = state.loops.get(task.contact) if isinstance(task, ForceTask) else state.felt.get(task)
    tank = None if memory is None else memory.tank
    return math.nan if tank is None else tank.energy


def _unheld(state: State, frame: str, F: Array) -> tuple[str, Array]:
    """The part of a wrench (6,) at a frame that no contact of its link causes, and the frame at which it is told."""
    robot = state.robot
    held = [each for each in state.contacts.values() if robot.wrench_map(frame, each.frame) is not None]
    if not held:
        return frame, F
    at = held[0].frame
    F = robot.wrench_map(frame, at).dot(F)  # type: ignore[union-attr]
    if len(held) == 1:
        return at, held[0].unconstrained(F)
    A = np.concatenate([each.A.dot(robot.wrench_map(each.frame, at).T) for each in held])  # type: ignore[union-attr]
    return at, F - A.T.dot(np.linalg.lstsq(A.T, F, rcond=None)[0])
