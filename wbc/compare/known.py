"""The best answer known to a problem, which torques are held against.

Among the certified answers and their polished version (the same active constraints, their KKT system solved directly)
it is the one with the lowest residual.
"""

from __future__ import annotations

import math

import numpy as np

from ..qp import Array, Problem, certify
from ..solver import Solution
from .bound import Bound
from .record import INFEASIBLE, Recorded


class Known:
    """What is known of the answer to a problem: the best of all that were certified, or polished from those."""

    def __init__(self, item: Recorded) -> None:
        self._item, self.infeasible = item, item.kind == INFEASIBLE
        self._residual, self._z = math.inf, item.problem.lo
        self.tau: Array | None = None  # [N m]
        self._bound: Bound | None = None

    def learn(self, solutions: list[Solution]) -> None:
        problem = self._item.problem
        certified = [solution for solution in solutions if solution.accepted and max(solution.certificate) < math.inf]
        if not certified:
            return
        best = min(certified, key=lambda solution: max(solution.certificate))
        if max(best.certificate) >= self._residual:
            return
        self._residual, x, self._z = max(best.certificate), best.x, best.z
        polished = certify(problem, *(found := _polished(problem, best.z)))
        if max(polished) < self._residual:  # False also for NaN
            self._residual, (x, self._z) = max(polished), found
        self.tau = self._item.torque(x)

    def error(self, x: Array) -> float:
        """[N m] of the torque of x; NaN where there is nothing to compare."""
        if self.tau is None or x.shape != self._item.problem.g.shape:
            return math.nan
        return float(np.abs(self._item.torque(x) - self.tau).max())

    def allowed(self, x: Array, z: Array) -> float:
        """[N m] what the residuals of (x, z) leave open, and the known answer with them."""
        self._bound = self._bound or Bound(self._item)
        return self._bound(x, z, self._z)


def _polished(problem: Problem, z: Array, least: float = 1e-9) -> tuple[Array, Array]:
    """The answer whose active constraints are those of `z`, with one step of iterative refinement."""
    H, g, C, lo, hi, n_eq, _ = problem
    n = g.size
    active = np.abs(z) > least
    active[n : n + n_eq] = True
    G = np.concatenate((np.eye(n), C))[active]
    K = np.block([[H, G.T], [G, np.zeros((len(G), len(G)))]])
    rhs = np.concatenate((-g, np.where(z > 0.0, hi, lo)[active]))
    solution = np.linalg.lstsq(K, rhs)[0]
    solution += np.linalg.lstsq(K, rhs - K @ solution)[0]
    multipliers = np.zeros(lo.size)
    multipliers[active] = solution[n:]
    return solution[:n], multipliers
