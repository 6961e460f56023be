"""Strict priorities: each level at its best within what the levels above leave free.

Level p minimises |A_p x - b_p|^2, or the distance of A_p x from an interval, among all x that satisfy the hard rows and
are optimal for the levels before. What a level has decided is never asked again but kept by construction,

    x = x_p + Z_p z,     Z_p a basis of the null space of the rows decided so far,

so that no later level can be refused because an earlier one was frozen too hard: z = 0 is always an answer. Of an
interval the rows that are violated at the optimum are decided too (their distance is unique); the others stay
inequalities for the levels below.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from . import kernels
from .qp import UNCERTIFIED, Array, Certificate, Problem, Rows, Variables
from .solver import TOLERANCE, Solution, Solver, answer

RANK = 1e-9  # singular values below this part of the largest row move nothing
# Towards the last iterate, of a level's largest curvature, and room given to the inequalities, relative: the next where
# no solver has an answer.
TRIES = ((1e-4, 0.0), (1e-3, 0.0), (1e-2, 0.0), (1e-3, 1e-8), (1e-3, 1e-7))
INSIDE = 1e-11  # rounding allowed where nothing bends a level, relative
STEPS = 100  # most iterations of a level; two to four are usual
SETTLED = 1e-10  # change of a level's residual, relative, at which it is at its optimum


class Level(NamedTuple):
    """Rows of one level in the metric's square root: lo <= A x <= hi, equalities where lo = hi."""

    A: Array  # (m, n)
    lo: Array  # (m,)
    hi: Array  # (m,)


def level(costs: Sequence[tuple[Rows, float]], variables: Variables) -> Level:
    """One level from weighted rows. A row of an interval keeps its own scale: its metric must be diagonal."""
    A, lo, hi = [], [], []
    for rows, weight in costs:
        equal, m = rows.lo is rows.hi, rows.lo.size
        metric = np.eye(m) if rows.metric is None else rows.metric
        R = np.sqrt(weight) * (_root(metric) if equal else np.diag(np.sqrt(metric.diagonal())))
        dense = np.zeros((len(R), variables.size))
        for name, block in rows.A.items():
            dense[:, variables[name]] = R if block is None else R.dot(block)
        A.append(dense)
        lo.append(R.dot(rows.lo) if equal else R.diagonal() * rows.lo)  # it may be infinite
        hi.append(lo[-1] if equal else R.diagonal() * rows.hi)
    return Level(np.concatenate(A), np.concatenate(lo), np.concatenate(hi))


def _root(W: Array) -> Array:
    """R with R'R = W, for W positive semidefinite."""
    R = np.empty(W.shape)
    return R[: kernels.root(W, 1e-13, R)]  # what is less is rounding, whose root would not be small


class _Free:
    """What is left of the problem: x = `x` + `Z` z, and the inequalities lo <= C x <= hi that still bind it."""

    def __init__(self, problem: Problem) -> None:
        n, n_eq, self.rows = problem.g.size, problem.n_eq, problem.lo.size
        E, e = problem.C[:n_eq], problem.lo[n : n + n_eq]
        self.x, self.Z = shortest(E, e)
        self.gap = float(np.abs(E @ self.x - e).max(initial=0.0))  # of equalities that contradict one another
        C, lo, hi = (
            np.concatenate((np.eye(n), problem.C[n_eq:])),
            _without(problem.lo, n, n_eq),
            _without(problem.hi, n, n_eq),
        )
        bound = np.isfinite(lo) | np.isfinite(hi)
        self.C, self.lo, self.hi = C[bound], lo[bound], hi[bound]
        self.place = np.concatenate((np.arange(n), np.arange(n + n_eq, problem.lo.size)))[bound]  # of hard rows

    def decide(self, rows: Array) -> None:
        """Keep what these rows make of x."""
        if self.Z.shape[1] and len(rows):
            self.Z = self.Z @ shortest(rows @ self.Z, np.zeros(len(rows)), np.abs(rows).max())[1]

    def descend(self, A: Array, b: Array, level: Level, tolerance: Certificate) -> Certificate | None:
        """Go to the least |A x - b| and keep it. None, and nothing is done, where that breaks an inequality."""
        B = A @ self.Z
        r = b - A @ self.x
        z, N = shortest(B, r, np.abs(A).max(initial=0.0))
        x = self.x + self.Z @ z
        at, own = self.C @ x, level.A @ x
        slack = INSIDE * (1.0 + np.abs(at))
        within = (at >= self.lo - slack).all() and (at <= self.hi + slack).all()
        soft = level.lo != level.hi
        if not (within and (own >= level.lo)[soft].all() and (own <= level.hi)[soft].all()):
            return None
        found = Certificate(self.gap, float(np.linalg.norm((B @ z - r) @ B)), 0.0)
        if not found.holds(tolerance):
            return None
        self.x, self.Z = x, self.Z @ N
        return found

    def bind(self, A: Array, lo: Array, hi: Array) -> None:
        """More inequalities; x as it stands satisfies them to rounding, which is allowed for."""
        at = A @ self.x
        self.C = np.concatenate((self.C, A))
        self.lo, self.hi = np.concatenate((self.lo, np.minimum(lo, at))), np.concatenate((self.hi, np.maximum(hi, at)))

    def inequalities(self, room: float) -> tuple[NDArray[np.intp], Array, Array, Array]:
        """Numbers of the rows that z moves, their C Z and its bounds on z: of the others rounding alone is left."""
        rows, at = self.C @ self.Z, self.C @ self.x
        moves = np.flatnonzero(np.linalg.norm(rows, axis=1) > RANK * np.linalg.norm(self.C, axis=1))
        more = room * (1.0 + np.abs(at))
        return moves, rows[moves], (self.lo - at - more)[moves], (self.hi - at + more)[moves]

    def settle(self) -> None:
        """Let z = 0 be an answer exactly."""
        at = self.C @ self.x
        self.lo, self.hi = np.minimum(self.lo, at), np.maximum(self.hi, at)


def _without(bound: Array, n: int, n_eq: int) -> Array:
    return np.concatenate((bound[:n], bound[n + n_eq :]))


def shortest(A: Array, b: Array, scale: float | None = None) -> tuple[Array, Array]:
    """The shortest x (n,) of the least |A x - b|, and (n, n - rank) an orthonormal basis of what A maps to nothing.

    `scale`: the size that its rank is judged by, by default the largest number of A.
    """
    n = A.shape[1]
    x, N = np.empty(n), np.empty((n, n))
    size = float(np.abs(A).max(initial=0.0)) if scale is None else scale
    rank = kernels.least_squares(A, b, RANK * max(size, 1e-300), x, N)
    return x, N[: n - rank].T


def solve(
    problem: Problem, levels: Sequence[Level], *solvers: Solver, tolerance: Certificate = TOLERANCE
) -> tuple[Solution, list[Array]]:
    """The lexicographic optimum over the hard rows of `problem`, and what is left of every level, (m,) each.

    Where the first solver has no certified answer for a level the next is asked: rows that meet in z = 0 and all but
    coincide, as the torques of two ankles that one internal force drives, are hard on an active set method. Where none
    has, the level stays with what those above make of it: only the first can refuse the whole. The levels should end
    with one that decides everything. The certificate is the worst of all levels' own. The multipliers of the solution
    are the sums of all levels': not those of one problem, but nonzero where a hard row bends any of them.
    """
    free, worst, left = _Free(problem), Certificate(0.0, 0.0, 0.0), list[Array]()
    z = np.zeros(problem.lo.size)
    if not all(np.isfinite(rows.A).all() and not np.isnan((rows.lo, rows.hi)).any() for rows in levels):
        return _refused("a coefficient of the problem is not finite"), left
    if not free.gap <= tolerance.primal:
        return _refused(f"hard equalities contradict one another by {free.gap:.1e}"), left
    for number, rows in enumerate(levels):
        hard = rows.lo == rows.hi
        found = free.descend(rows.A[hard], rows.lo[hard], rows, tolerance)
        if found is not None:
            worst = Certificate(*map(max, worst, found))
        elif free.Z.shape[1]:
            for (pull, room), one in product(TRIES, solvers):
                solution = _optimum(free, rows, pull, room, one, tolerance)
                if solution.accepted:
                    worst = Certificate(*map(max, worst, solution.certificate))
                    z += solution.z
                    free.x = free.x + free.Z @ solution.x[: free.Z.shape[1]]
                    break
            else:
                if number == 0:
                    return _refused(f"level 1: {solution.reason}"), left
        at = rows.A @ free.x
        off = np.where(at > rows.hi, at - rows.hi, np.where(at < rows.lo, at - rows.lo, 0.0))
        left.append(np.where(hard, at - rows.lo, off))
        # what a certified answer may be off by is no violation: decided, it would take a direction from levels below
        decided = hard | (np.abs(off) > tolerance.primal * (1.0 + np.abs(at)))
        free.settle()
        free.bind(rows.A[~decided], rows.lo[~decided], rows.hi[~decided])
        if found is None:
            free.decide(rows.A[decided])
    return Solution(free.x, z, worst, True), left


def _refused(reason: str) -> Solution:
    return Solution(np.zeros(0), np.zeros(0), UNCERTIFIED, False, reason)


def _optimum(free: _Free, rows: Level, pull: float, room: float, solver: Solver, tolerance: Certificate) -> Solution:
    """z, then the distances s of the intervals, at the optimum of one level.

    A level alone does not decide z: a proximal pull towards the last iterate makes each problem definite, and vanishes
    as they converge.
    """
    d, soft = free.Z.shape[1], np.flatnonzero(rows.lo != rows.hi)
    B, hard = rows.A @ free.Z, rows.lo == rows.hi
    r = rows.lo - rows.A @ free.x
    size = d + soft.size
    H = np.zeros((size, size))
    H[:d, :d] = B[hard].T @ B[hard]
    H[d:, d:] = np.eye(soft.size)
    pull *= max(float(H.diagonal().max(initial=0.0)), 1e-12)
    H[np.arange(d), np.arange(d)] += pull
    moves, binding, least, most = free.inequalities(room)
    m, total = len(binding), np.zeros(free.rows)
    if not m + soft.size:
        return Solution(shortest(B, r, np.abs(rows.A).max(initial=0.0))[0], total, Certificate(0.0, 0.0, 0.0), True)
    C = np.zeros((m + soft.size, size))
    C[:m, :d], C[m:, :d], C[m:, d:] = binding, B[soft], -np.eye(soft.size)
    own, unbound = rows.A[soft] @ free.x, np.full(size, np.inf)
    lo = np.concatenate((-unbound, least, rows.lo[soft] - own))
    hi = np.concatenate((unbound, most, rows.hi[soft] - own))
    z, solution = np.zeros(size), _refused("no iteration")
    for _ in range(STEPS):
        g = np.zeros(size)
        g[:d] = -(B[hard].T @ r[hard]) - pull * z[:d]
        stack = np.concatenate((H, C))
        solution = answer(solver, Problem(stack[:size], g, stack[size:], lo, hi, 0, stack), tolerance)
        if not solution.accepted:
            return solution
        moved = np.concatenate((B[hard] @ (solution.x[:d] - z[:d]), solution.x[d:] - z[d:]))
        z = np.array(solution.x, float)
        if not np.abs(moved).max(initial=0.0) > SETTLED * (1.0 + np.abs(r[hard]).max(initial=0.0)):
            break
    known = moves < free.place.size  # the others are of the levels above
    total[free.place[moves[known]]] = solution.z[size : size + m][known]
    return solution._replace(x=z, z=total)
