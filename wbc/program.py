"""The quadratic program that a phase makes of a state: its storage, and the rows that a tick puts in."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any, TypeAlias

import numpy as np

from .dynamics import fill, gauss, inertia, inertia_of_what_moves, mobility, torque_map
from .errors import LawError
from .friction import Cone
from .hierarchy import level
from .hierarchy import solve as descend
from .ladder import fewest
from .phase import LAST, Phase, hold, settle_posture
from .qp import Array, Rows, Variables, Workspace
from .singular import BACK, ease, threshold
from .solver import ProxQP, Solution, Solver, answer
from .state import State, Terms
from .task import Task
from .task.centroidal import WholeBodyPosture
from .task.effort import TorqueTask
from .task.force import ForceTask
from .task.impedance import AdmittanceTask, ImpedanceTask
from .task.motion import MotionTask
from .task.posture import PostureTask

_NO_METRIC = np.zeros((0, 0))
Cost: TypeAlias = tuple[
    Rows, float, int
]  # rows, their weight, and the level at which they stand where priorities are strict
YIELD_WEIGHT = 1e6  # of viability, in ticks that have no answer otherwise
_VIABLE = {"joint": "joint limits", "collision": "distances"}


class Program:
    """The program of one phase. Its structure is fixed here; `assemble` fills in the numbers of a tick."""

    notes: tuple[str, ...] = ()  # what its structure has to tell

    def __init__(self, phase: Phase, start: State) -> None:
        self.phase = phase
        self.motion = {n: t for n, t in phase.tasks.items() if isinstance(t, MotionTask)}
        self.force = {t.contact: (n, t) for n, t in phase.tasks.items() if isinstance(t, ForceTask)}
        self.posture = {n: t for n, t in phase.tasks.items() if isinstance(t, PostureTask)}
        self.effort = {n: t for n, t in phase.tasks.items() if isinstance(t, TorqueTask)}
        known = (MotionTask, ForceTask, PostureTask, TorqueTask)
        other = {n: t for n, t in phase.tasks.items() if not isinstance(t, known)}
        self.above: dict[str, Task] = {**self.motion, **other}  # what the posture stays out of
        # one motion task's rows hold the contacts' as well: then they are all that stands above the posture
        self.single = len(self.motion) == 1 and not other
        if any(task.raw for task in self.motion.values()) and not (self.single and len(phase.contacts) == 1):
            raise LawError(
                "the book's is for one contact and one motion task on it; there are "
                f"{len(phase.contacts)} contacts and {len(self.above)} tasks of motion; expected compensated"
            )
        # motion and posture of equal weight are one least squares problem in M
        self.merged: tuple[list[Any], PostureTask, float] | None = None
        compliant = bool(phase.compliant) and len(self.motion) + len(phase.compliant) == len(self.above)
        self.levels = dict.fromkeys(phase.tasks, 1) if phase.levels is None else phase.levels
        self._first = sum(contact.k for contact in phase.contacts.values())  # rows of the contacts
        if (self.single or compliant) and len(self.posture) == 1 and phase.levels is None:
            names = [*self.above, *self.posture]
            own = {type(phase.tasks[name]) for name in names} <= {
                MotionTask,
                ImpedanceTask,
                AdmittanceTask,
                PostureTask,
            }
            if own and len({phase.weights[name] for name in names}) == 1:
                self.merged = (list(self.above.values()), self.posture[names[-1]], phase.weights[names[0]])
        state = State(start.terms, start.q, start.v)
        hold(state, phase)
        sizes = {"vdot": state.robot.nv} | {name: contact.k for name, contact in phase.contacts.items()}
        hard = self._contact_rows(state)
        self.pushing = {name: c.pushes for name, c in phase.contacts.items() if c.pushes is not None}
        hard += self._cones(state)
        hard += self._dynamic_rows(state)
        viable = self._viable_rows(state)
        self.strict = self.last = Workspace(Variables(sizes), [*hard, *viable])
        # the same with viability allowed to yield, for ticks that have no answer otherwise
        self.yielding = None
        if viable:
            slack = {f"{rows.name} yield": rows.lo.size for rows in viable}
            self.yielding = Workspace(Variables(sizes | slack), [*hard, *map(_softened, viable)])
        again = partial(hold, phase=phase)
        self.thresholds = {n: threshold(t, state, again) for n, t in self.above.items() if hasattr(t, "target")}
        self._back = (WholeBodyPosture if start.robot.base else PostureTask)(start.q, *BACK, start.robot.nu)
        self._rescue = ProxQP()  # of levels that the solver refuses
        self._starts: tuple[Mapping[str, Any], Mapping[Any, Any]] = ({}, {})
        self._costs: list[Cost] = []
        self._torque, self._joint = self.strict.stored["torque"], self.strict.stored.get("joint")
        self._apart = self.strict.stored.get("collision")
        self._hard, self._viable = ([self.strict.stored[rows.name] for rows in some] for some in (hard, viable))
        self._standing: dict[str, tuple[Cone, bool]] = {}  # whose rows stand in the problem, and whether lifted
        self.window: tuple[Array, Array] = (phase.torque.low, phase.torque.high)  # [N m] of the torque at this tick

    def named(self, starts: Mapping[str, Any]) -> Mapping[Any, Any]:
        """Task -> its start, from those by name."""
        if starts is not self._starts[0]:
            tasks = self.phase.tasks
            self._starts = (starts, {tasks[name]: start for name, start in starts.items() if name in tasks})
        return self._starts[1]

    @property
    def yielded(self) -> bool:
        """Whether the last problem let viability yield."""
        return self.last is not self.strict

    def assemble(self, state: State, tau_last: Array, dt: float) -> bool:
        """The problem of a tick, in `strict`; False when it must not be solved."""
        joint = self.phase.joint
        self._fill_contacts(state)
        self._fill_dynamics(state, tau_last, dt)
        if self._joint is not None and joint is not None:
            joint.fill(state.q, state.v, dt, self._joint)
        if self._apart is not None and self.phase.collision is not None:
            self.phase.collision.fill(state, dt, self._apart)
        self._costs = self.costs(state)
        self.last = self.strict
        return _fill(self.strict, self._summed)

    def spare(self, start: State) -> dict[tuple[str, ...], Program]:
        """Programs of the same phase without some contacts, and without what is asked of them: in the order in which
        they are to be tried, built at a state before any tick needs one."""
        start, spare = State(Terms(start.robot), start.q.copy(), start.v.copy()), {}
        for dropped in fewest(list(self.phase.contacts)):
            start.contacts = {}
            spare[dropped] = type(self)(settle_posture(self.phase.without(dropped), start, []), start)
        return spare

    def _contact_rows(self, state: State) -> list[Rows]:
        """The constraints of the contacts, with the names of their rows."""
        contacts = self.phase.contacts.items()
        return [c.rows(name, state.contacts[name])._replace(labels=c.labels(name)) for name, c in contacts]

    def _dynamic_rows(self, state: State) -> list[Rows]:
        """Equations of motion, with the torque within its limits."""
        limit = self.phase.torque
        return [torque_map(state).rows(limit.low, limit.high, limit.labels)]

    def _viable_rows(self, state: State) -> list[Rows]:
        """What joints and bodies can still brake from, where it is limited."""
        joint, collision, rows = self.phase.joint, self.phase.collision, []
        if joint is not None:
            rows.append(joint.rows(state.q, state.v, state.dt)._replace(labels=joint.labels))
        if collision is not None:
            rows.append(collision.sample(state.robot.nv))
        return rows

    def _fill_contacts(self, state: State) -> None:
        """The constraints of the contacts at a tick, and what they do not pull."""
        for name, contact in self.phase.contacts.items():
            contact.fill(state.contacts[name], self.strict.stored[name])
        self._fill_cones(state)

    def _fill_cones(self, state: State) -> None:
        for name, pushes in self.pushing.items():
            held = state.contacts[name]
            cone, stands = held.cone, self._standing.get(name)
            if cone is not None and (stands is None or stands[0] is not cone or stands[1] is not held.lifted):
                pushes.fill(name, cone, self.strict.stored[f"{name}.push"], not held.lifted)
                self._standing[name] = (cone, held.lifted)

    def _fill_dynamics(self, state: State, tau_last: Array, dt: float) -> None:
        """Equations of motion at a tick, with the torque within its window."""
        self.window = self.phase.torque.window(tau_last, dt, state.bias, self._torque)
        fill(state, self._torque)

    def rest(self, state: State) -> Array:
        """(nu,) the torque that holds the robot's weight at a state [N m]."""
        return state.gravity()

    def _cones(self, state: State) -> list[Rows]:
        """Inequalities of the contacts that only push."""
        cones = ((name, pushes, state.contacts[name].cone) for name, pushes in self.pushing.items())
        return [pushes.rows(name, cone) for name, pushes, cone in cones if cone is not None]

    def relax(self, state: State) -> bool:
        """The problem with viability yielding; dynamics, torque and rate never do. False where nothing can yield."""
        if self.yielding is None:
            return False
        self.last, springs = self.yielding, list[Cost]()
        for rows in self._viable:
            zero, G = np.zeros(rows.lo.size), rows.A["vdot"]
            weight = state.M.diagonal() if G is None else 1.0 / np.maximum(mobility(state, G).diagonal(), 1e-6)
            springs.append((Rows("", {f"{rows.name} yield": None}, zero, zero, np.diag(weight)), YIELD_WEIGHT, 0))
        self._costs = [*springs, *self._costs]
        return _fill(self.yielding, self._summed, [*self._hard, *map(_softened, self._viable)])

    def gave_way(self, x: Array) -> str:
        """What of viability yields in an answer of the yielding problem, or ""."""
        slices = self.last.variables.slices
        gave = [_VIABLE[r.name] for r in self._viable if np.abs(x[slices[f"{r.name} yield"]]).max() > 1e-6]
        return " and ".join(gave)

    @property
    def _summed(self) -> list[Cost]:
        """The costs that make one sum; where priorities are strict there is none."""
        return self._costs if self.phase.levels is None else []

    def solve(self, solver: Solver) -> Solution:
        """A certified answer of the last problem: of its one sum of costs, or level by level."""
        if self.phase.levels is None:
            return answer(solver, self.last.problem)
        by_level = sorted({at for _, _, at in self._costs})
        levels = [
            level([(rows, w) for rows, w, at in self._costs if at == one], self.last.variables) for one in by_level
        ]
        self._rescue.restart()  # what it answers must not depend on the ticks before
        return descend(self.last.problem, levels, solver, self._rescue)[0]

    def costs(self, state: State) -> list[Cost]:
        """Rows of all tasks with their weights and levels."""
        weights, levels = self.phase.weights, self.levels
        if self.merged is not None:
            above, posture, weight = self.merged
            G, b = above[0].stack(state) if self.single else self._stacked(state)
            if self.single:
                b = self._eased(state, next(iter(self.above)), G, b)
            rows, K = gauss(state, G, b, posture.acceleration(state))
            state.primary = (G, _NO_METRIC, K)
            costs = [(rows, weight, 1)]
        else:
            costs = [(self._rows(state, name), weights[name], levels[name]) for name in self.above]
            if not self.single:
                costs += self._stack(state, [rows for rows, _, _ in costs])
            for name, posture in self.posture.items():
                costs.append((posture.rows(state), weights[name], levels[name]))
        costs += [(task.rows(state), weights[name], levels[name]) for name, task in self.effort.items()]
        for contact, held in state.contacts.items():
            if contact in self.force:
                name, force = self.force[contact]
                costs.append((force.rows(state), weights[name], levels[name]))
            elif held.A.shape[0]:
                zero = np.zeros(held.A.shape[0])
                costs.append((Rows("", {contact: None}, zero, zero, mobility(state, held.G)), 1.0, LAST))
        return costs

    def _rows(self, state: State, name: str) -> Rows:
        """The rows of a task, damped near a singularity."""
        task = self.above[name]
        rows, whole = task.rows(state), isinstance(task, MotionTask)
        b = self._eased(state, name, rows.A.get("vdot"), rows.lo, whole)
        if b is rows.lo:
            return rows
        if not whole:
            return rows._replace(lo=b, hi=b)
        G, _, K = state.primary
        if self.single and not self.posture and self.phase.levels is None:  # all joints are the task's, in M
            return gauss(state, G, b, self._idle(state))[0]
        state.primary = (G, W := inertia_of_what_moves(K), K)
        return Rows("", {"vdot": G}, b, b, W)

    def _eased(self, state: State, name: str, G: Array | None, b: Array, whole: bool = True) -> Array:
        """The target of a task's rows, damped near a singularity; `whole`: with the contacts' rows first."""
        law = self.thresholds.get(name)
        if law is None or not law.least or G is None or not self.phase.damped:
            return b
        if whole:
            told, value = ease(state, G, b, self._first, law, self._idle)
        else:
            held, rhs = self._held(state)
            told, value = ease(state, np.concatenate((held, G)), np.concatenate((rhs, b)), len(held), law, self._idle)
        if value == np.inf:
            return b
        state.gave[f"{name}.singular"] = f"{name} is damped: its smallest singular value is {value:.2g}"
        return told if whole else told[len(held) :]

    def _held(self, state: State) -> tuple[Array, Array]:
        """Rows G vdot = rhs of the contacts."""
        held = list(state.contacts.values())
        rows, rhs = [np.zeros((0, state.v.size)), *(h.G for h in held)], [np.zeros(0), *(h.rhs for h in held)]
        return np.concatenate(rows), np.concatenate(rhs)

    def _idle(self, state: State) -> Array:
        """(nv,) the acceleration of joints that no task moves: what the postures ask for, or back to the start."""
        postures = {name: each for name, each in self.posture.items() if each.Kp.any()}
        if not postures:
            return self._back.acceleration(state)
        weights = [self.phase.weights[name] for name in postures]
        return np.average([each.acceleration(state) for each in postures.values()], axis=0, weights=weights)

    def _stacked(self, state: State) -> tuple[Array, Array]:
        """Rows of the contacts, then of all tasks: G vdot = b."""
        rows, rhs = self._held(state)
        own = [(name, *task.target(state)) for name, task in self.above.items()]  # type: ignore[attr-defined]
        G = np.concatenate([rows, *(A for _, A, _ in own)])
        return G, np.concatenate([rhs, *(self._eased(state, name, A, b, whole=False) for name, A, b in own)])

    def _stack(self, state: State, above: list[Rows]) -> list[Cost]:
        """All that the posture stays out of, where it is more than one motion task; a cost that keeps H definite."""
        held = list(state.contacts.values())
        stack = [h.G for h in held] + [A for rows in above if (A := rows.A.get("vdot")) is not None]
        if not stack:
            state.primary = (np.zeros((0, state.robot.nv)), np.zeros((0, 0)), np.zeros((0, 0)))
            return []
        G = np.concatenate(stack)
        K = mobility(state, G)
        W = inertia_of_what_moves(K) if state.gave else inertia(K)
        state.primary = (G, W, K)
        if self.motion or self.phase.compliant or not held:
            return []
        # no task weighs the held directions: the constraint decides them, the cost is zero where it holds
        rhs = np.concatenate([h.rhs for h in held])
        k = rhs.size
        return [(Rows("", {"vdot": G[:k]}, rhs, rhs, inertia(K[:k, :k])), 1.0, LAST)]

    def names(self, z: Array, found: list[int], state: State, tau_last: Array, dt: float) -> tuple[str, ...]:
        """Names of active rows of the last problem, with which of two limits it is that binds."""
        names = [f"{name}.lifted" for name in self.pushing if state.contacts[name].lifted]
        names += [f"{name}.{state.loops[name].cut}" for name in self.force if state.loops[name].cut]
        names += state.gave
        for name, task in self.phase.tanks.items():
            memory = state.loops[task.contact] if isinstance(task, ForceTask) else state.felt[task]
            if memory.tank is not None and memory.tank.limited:
                names.append(f"{name}.tank")
        names += [self.name(self.last.labels[i], bool(z[i] > 0.0), state, tau_last, dt) for i in found]
        return tuple(dict.fromkeys(names)) if self.pushing else tuple(names)

    def name(self, label: str, upper: bool, state: State, tau_last: Array, dt: float) -> str:
        """The name of a row of the last tick on that side: of a joint, which of its limits it is that binds."""
        kind, _, joint = label[:-1].partition("[")
        if kind == "torque":
            return self.phase.torque.name(state.robot.joints.index(joint), upper, tau_last, dt)
        if kind == "joint" and self.phase.joint is not None:
            number, rows = state.robot.joints.index(joint), self.strict.stored["joint"]
            side = rows.hi if upper else rows.lo
            return self.phase.joint.name(number, upper, state.q, side[state.robot.base + number])
        if kind == "collision" and self.phase.collision is not None:
            return self.phase.collision.name(int(joint), state)
        return label


def _softened(rows: Rows) -> Rows:
    """Rows that may give way, each by a slack of its own."""
    return rows._replace(A={**rows.A, f"{rows.name} yield": None})


def _fill(workspace: Workspace, costs: Sequence[Cost], hard: Sequence[Rows] = ()) -> bool:
    """Costs, and the hard rows that do not stand there yet. Whether all is finite."""
    workspace.clear()
    for rows, weight, _ in costs:
        workspace.minimise(rows, weight)
    for rows in hard:
        workspace.constrain(rows)
    return workspace.finite()
