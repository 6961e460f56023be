"""The program of a robot with a floating base: six equations without a motor, contacts that may be redundant.

    min   sum of the tasks  +  posture in their null space  +  distribution of the contacts' wrenches
    s.t.  G vdot = rhs            all contacts, as many rows as are independent
          M_b vdot + P lambda = -bias_b                    the base, which no motor drives
          tau_min <= M_j vdot + push_j' lambda + bias_j <= tau_max,    cones, joint viability

Rows of redundant contacts (eight points on two soles: rank 12 of 24) contradict one another by rounding and while they
move; they are replaced by those along the `rank` largest axes of their mobility G M^-1 G'. The rank is that of the
start, and is told in `notes`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from . import kernels
from .dynamics import inertia, inertia_within, mobility, torque_map
from .errors import LawError
from .handover import SHARING
from .kernels.compiled import Counts
from .phase import LAST, Phase, hold
from .program import Cost, Program
from .qp import Array, Rows
from .state import State
from .task import Task
from .task.centroidal import DistributionTask, WholeBodyPosture, load
from .task.effort import TorqueTask
from .task.force import ForceTask
from .task.motion import MotionTask
from .task.posture import PostureTask

_NO_METRIC = np.zeros((0, 0))
RANK_TOLERANCE = 1e-8  # of the largest eigenvalue of the contacts' mobility


class WholeBodyProgram(Program):
    """As `Program`, for a floating base."""

    def __init__(self, phase: Phase, start: State) -> None:
        if any(getattr(task, "law", "") == "book" or getattr(task, "raw", False) for task in phase.tasks.values()):
            raise LawError("law: book is for a fixed base; use law: compensated")
        state = State(start.terms, start.q, start.v)
        hold(state, phase)
        self.rows = sum(held.G.shape[0] for held in state.contacts.values())
        self.rank = self.rows
        if self.rows:
            values = np.linalg.eigvalsh(mobility(state, np.concatenate([h.G for h in state.contacts.values()])))
            self.rank = int((values > RANK_TOLERANCE * values[-1]).sum())
        if self.redundant:
            self.notes = (f"contacts hold {self.rows} axes, of which {self.rank} are independent",)
        own = (ForceTask, PostureTask, DistributionTask, TorqueTask)
        self._tasks: dict[str, Task] = {n: t for n, t in phase.tasks.items() if not isinstance(t, own)}
        given = [(n, t) for n, t in phase.tasks.items() if isinstance(t, DistributionTask)]
        levels = phase.levels or {}
        self._sharing = [(t, phase.weights[n], levels.get(n, 1)) for n, t in given] or [(DistributionTask(), 1.0, LAST)]
        forced = {task.contact for task in phase.tasks.values() if isinstance(task, ForceTask)}
        self._sharers = [name for name, contact in phase.contacts.items() if contact.k and name not in forced]
        self._moving: list[tuple[str, int]] = []  # tasks that move joints, and how many rows they have
        self._sizes: Counts = np.zeros(0, np.int64)
        self._least: Array = np.zeros(0)  # their thresholds
        super().__init__(phase, start)
        # their rows stand first in the problem, and are read where they stand
        problem, n = self.strict.problem, self.strict.problem.g.size
        self._G, stop = problem.C[: self.rank, : start.robot.nv], n + self.rank
        self._rhs, self._top = problem.lo[n:stop], problem.hi[n:stop]
        self._joints, self._base = (self.strict.coefficients(name) for name in ("torque", "base"))

    def named(self, starts: Mapping[str, Any]) -> Mapping[Any, Any]:
        if starts is not self._starts[0]:
            super().named(starts)
            if SHARING in starts:
                own = {task: starts[SHARING] for task, _, _ in self._sharing if task not in self._starts[1]}
                self._starts = (starts, {**self._starts[1], **own})
        return self._starts[1]

    @property
    def redundant(self) -> bool:
        """Whether the contacts hold the robot by more rows than it takes."""
        return self.rank < self.rows

    def _independent(self, state: State) -> tuple[Array, Array]:
        """Independent rows G vdot = rhs of all contacts."""
        held = list(state.contacts.values())
        if not self.rows:
            return np.zeros((0, state.v.size)), np.zeros(0)
        G, rhs = np.concatenate([h.G for h in held]), np.concatenate([h.rhs for h in held])
        if not self.redundant:
            return G, rhs
        values, vectors = np.linalg.eigh(mobility(state, G))
        U = vectors[:, -self.rank :] / np.sqrt(values[-self.rank :])
        return U.T.dot(G), U.T.dot(rhs)

    def _contact_rows(self, state: State) -> list[Rows]:
        return self._merged(state) if self.redundant else super()._contact_rows(state)

    def _merged(self, state: State) -> list[Rows]:
        G, rhs = self._independent(state)
        return [Rows("contacts", {"vdot": G}, rhs, rhs)]

    def _fill_contacts(self, state: State) -> None:
        feet = self.phase.feet
        if self.redundant:
            self._G[:], self._rhs[:] = self._independent(state)
            self._top[:] = self._rhs
            self._fill_cones(state)
        elif feet is not None and len(feet.feet) == len(self.phase.contacts):
            feet.fill(state, self._G, self._rhs, self._top)
            self._fill_cones(state)
        else:
            super()._fill_contacts(state)

    def _dynamic_rows(self, state: State) -> list[Rows]:
        limit = self.phase.torque
        base, joints = torque_map(state).split(state.robot.base)
        nothing = -base.b
        return [Rows("base", base.A, nothing, nothing), joints.rows(limit.low, limit.high, limit.labels)]

    def _fill_dynamics(self, state: State, tau_last: Array, dt: float) -> None:
        base, held = self.strict.stored["base"], state.contacts.values()
        self.window = self.phase.torque.window(tau_last, dt, state.bias[state.robot.base :], self._torque)
        push = self._G
        if self.redundant or any(each.push is not each.G for each in held):
            push = np.concatenate([each.push for each in held])
        kernels.equations(state.M, push, state.bias, self._base, self._joints, base.lo)
        base.hi[:] = base.lo

    def costs(self, state: State) -> list[Cost]:
        weights, levels = self.phase.weights, self.levels
        G, rhs = self._G, self._rhs
        wanted = [(name, self._wanted(task, state)) for name, task in self._tasks.items()]
        stack = np.concatenate([G, *(A for _, rows in wanted if (A := rows.A.get("vdot")) is not None)])
        if self._near(stack, wanted):
            wanted = [(name, self._damped(name, rows, state)) for name, rows in wanted]
        lifted, K = np.empty((stack.shape[1], len(stack) if self.posture else 0)), np.empty(2 * stack.shape[:1])
        kernels.mobility(state.M, stack, lifted, K)
        k = start = len(G)
        W = inertia(K[:k, :k])
        # no task weighs the held directions: the constraint decides them, the cost is zero where it holds
        costs: list[Cost] = [(Rows("", {"vdot": G}, rhs, rhs, W), 1.0, LAST)] if self.rows else []
        for name, rows in wanted:
            if rows.A.get("vdot") is not None:
                m = rows.lo.size
                if isinstance(self._tasks[name], MotionTask):  # what it moves while the contacts hold
                    rows = Rows("", rows.A, rows.lo, rows.lo, inertia_within(K, W, start, m))
                start += m
            costs.append((rows, weights[name], levels[name]))
        state.primary = (stack, inertia(K) if self.posture else _NO_METRIC, K)
        for name, posture in self.posture.items():
            known = (lifted,) if isinstance(posture, WholeBodyPosture) else ()
            costs.append((posture.rows(state, *known), weights[name], levels[name]))
        costs += [(task.rows(state), weights[name], levels[name]) for name, task in self.effort.items()]
        costs += [(force.rows(state), weights[name], levels[name]) for name, force in self.force.values()]
        if self._sharers:
            standing = [name for name in self._sharers if not state.contacts[name].lifted]
            if standing:
                costs += [(task.rows(state, standing), weight, at) for task, weight, at in self._sharing]
            costs += [(_nothing(state, name), 1.0, LAST) for name in self._sharers if name not in standing]
        return costs

    def _wanted(self, task: Task, state: State) -> Rows:
        """The task's own rows; a motion's without those of the contacts, which all tasks have in common."""
        if isinstance(task, MotionTask):
            G, b = task.target(state)
            return Rows("", {"vdot": G}, b, b)
        return task.rows(state)

    def _near(self, stack: Array, wanted: Sequence[tuple[str, Rows]]) -> bool:
        """Whether a task may be near a singularity: of all of them in one elimination of the contacts' rows."""
        if not self.phase.damped:
            return False
        moving = [(name, rows.lo.size) for name, rows in wanted if rows.A.get("vdot") is not None]
        if self._moving != moving:
            least = [self.thresholds[name].least if name in self.thresholds else 0.0 for name, _ in moving]
            self._moving, self._sizes, self._least = moving, np.array([m for _, m in moving], np.int64), np.array(least)
        return not kernels.all_far(stack, len(self._G), self._sizes, self._least)

    def _damped(self, name: str, rows: Rows, state: State) -> Rows:
        b = self._eased(state, name, rows.A.get("vdot"), rows.lo, whole=False)
        return rows if b is rows.lo else rows._replace(lo=b, hi=b)

    def _held(self, state: State) -> tuple[Array, Array]:
        return self._G, self._rhs

    def rest(self, state: State) -> Array:
        """(nu,) the torque with which the contacts carry the weight, shared as the phase shares it [N m]."""
        hold(state, self.phase)
        base, tau = state.robot.base, state.gravity()
        state.bias = tau
        if self._sharers:
            rows = self._sharing[0][0].rows(state, self._sharers)
            start = 0
            for name in self._sharers:
                held = state.contacts[name]
                k = held.G.shape[0]
                tau = tau + held.push.T.dot(rows.lo[start : start + k])
                start += k
        return np.asarray(tau[base:])


def _nothing(state: State, name: str) -> Rows:
    """The cost of the multipliers of a contact in the air, which its cone makes zero."""
    zero = np.zeros(state.contacts[name].A.shape[0])
    return Rows("", {name: None}, zero, zero, np.eye(zero.size) / load(state))
