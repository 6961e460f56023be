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

from typing import Any

import numpy as np

from .centroidal import DistributionTask, WholeBodyPosture
from .dynamics import inertia, mobility, torque_map
from .effort import TorqueTask
from .errors import LawError
from .phase import LAST, Cost, Phase, Program, hold
from .qp import Array, Rows
from .robot import State
from .task import ForceTask, MotionTask, PostureTask, Task

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
        self._together: tuple[Array, Array] | None = None
        super().__init__(phase, start)
        self._together = None

    @property
    def redundant(self) -> bool:
        """Whether the contacts hold the robot by more rows than it takes."""
        return self.rank < self.rows

    def assemble(self, state: State, tau_last: Array, dt: float) -> bool:
        self._together = self._independent(state)
        return super().assemble(state, tau_last, dt)

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

    def _held(self, state: State) -> list[Rows]:
        return self._merged(state) if self.redundant else super()._held(state)

    def _merged(self, state: State) -> list[Rows]:
        G, rhs = self._together or self._independent(state)
        return [Rows("contacts", {"vdot": G}, rhs, rhs)]

    def _dynamic_rows(self, state: State) -> list[Rows]:
        limit = self.phase.torque
        base, joints = torque_map(state).split(state.robot.base)
        nothing = -base.b
        return [Rows("base", base.A, nothing, nothing), joints.rows(limit.low, limit.high, limit.labels)]

    def _dynamics(self, state: State, tau_last: Array, dt: float) -> list[Rows]:
        n, own, base = state.robot.base, self._torque, self.strict.stored["base"]
        self.window = self.phase.torque.window(tau_last, dt, state.bias[n:], own)
        _split(state.M, n, base.A["vdot"], own.A["vdot"])
        for name, held in state.contacts.items():
            _split(held.push.T, n, base.A[name], own.A[name])
        base.lo[:] = base.hi[:] = -state.bias[:n]
        return [base, own]

    def costs(self, state: State) -> list[Cost]:
        weights, levels = self.phase.weights, self.levels
        G, rhs = self._together or self._independent(state)
        wanted = [(name, self._wanted(task, state)) for name, task in self._tasks.items()]
        stack = np.concatenate([G, *(A for _, rows in wanted if (A := rows.A.get("vdot")) is not None)])
        lifted = state.solve_M(stack.T)
        K = stack.dot(lifted)
        k = start = len(G)
        W = inertia(K[:k, :k])
        # no task weighs the held directions: the constraint decides them, the cost is zero where it holds
        costs: list[Cost] = [(Rows("", {"vdot": G}, rhs, rhs, W), 1.0, LAST)] if self.rows else []
        held = W.dot(K[:k, k:])  # M_C of the contacts times what the tasks' forces do to them
        for name, rows in wanted:
            if rows.A.get("vdot") is not None:
                own = slice(start, start + rows.lo.size)
                start = own.stop
                if isinstance(self._tasks[name], MotionTask):
                    free = K[own, own] - K[:k, own].T.dot(held[:, own.start - k : own.stop - k])
                    rows = rows._replace(metric=inertia(free))
            costs.append((rows, weights[name], levels[name]))
        state.primary = (stack, inertia(K) if self.posture else _NO_METRIC, K)
        for name, posture in self.posture.items():
            known = (lifted,) if isinstance(posture, WholeBodyPosture) else ()
            costs.append((posture.rows(state, *known), weights[name], levels[name]))
        costs += [(task.rows(state), weights[name], levels[name]) for name, task in self.effort.items()]
        costs += [(force.rows(state), weights[name], levels[name]) for name, force in self.force.values()]
        if self._sharers:
            costs += [(task.rows(state, self._sharers), weight, at) for task, weight, at in self._sharing]
        return costs

    @staticmethod
    def _wanted(task: Task, state: State) -> Rows:
        """The task's own rows; a motion's without those of the contacts, which all tasks have in common."""
        if not isinstance(task, MotionTask):
            return task.rows(state)
        G, b = task.target(state)
        return Rows("", {"vdot": G}, b, b)

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


def _split(rows: Array, n: int, base: Any, joints: Any) -> None:
    """The first n rows and the others, where they stand."""
    base[:] = rows[:n]
    joints[:] = rows[n:]
