"""How rows A x <= b contradict one another, beside equalities E x = e: one polyhedron, along whose edges one walks.

Nothing satisfies them if and only if some y >= 0 and w have (Farkas)

    A'y + E'w = 0,     b'y + e'w = -t < 0

Those of one t are a polyhedron. The rows with y > 0 at one of its vertices are an irreducible infeasible set of rows
(Gleeson and Ryan, 1990); to lower c'y, c >= 0, is to look for one that does without the rows of c. Where the least is 0
there is one. Otherwise all rows hold that have no c, and the others must give way, for by duality

    min c'y = t / s     with     s = min { s : A x <= b + c s, E x = e }

Whatever is asked is such a cost, and each walk begins where the last one ended. The first vertex is had from HiGHS's
simplex: the multipliers of min t, A x <= b + t, E x = e, which always has an answer x0. From there on it is a primal
simplex on a tableau in which w, of any sign, is basic once and for all, so that rows of y are all it needs:

    A'y + E'w = 0,     (b - A x0)'y = -t

Nothing hangs on that arithmetic: multipliers y and points x are measured on the rows as they were given.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .errors import SolverError
from .kernels.simplex import PIVOT, lower, pivot, slopes
from .qp import Array

Mask = NDArray[np.bool_]
TOLERANCE = 1e-6  # of rows of norm 1 that together still have an answer
FAR = 1e6  # [rad/s^2, m/s^2, N, N m] a certificate excludes every x within
SHARE = 1e-9  # of the largest y, or cost: less is rounding
INDEPENDENT = 1e-8  # an entry of what is left of a column of norm 1, at least
ROUNDING = 1e-7  # of a cost: what slopes may be short of 0 at its least, for what they show is measured
# of HiGHS; a number of threads would be that of all its programs in the process
OPTIONS: dict[str, Any] = {
    "output_flag": False, "presolve": "off", "parallel": "off", "simplex_scale_strategy": 0,
    "simplex_dual_edge_weight_strategy": 1,
    "small_matrix_value": 1e-12, "primal_feasibility_tolerance": 1e-9, "dual_feasibility_tolerance": 1e-9,
}  # fmt: skip


class Contradictions:
    """Those of rows A x <= b (m,) of norm 1, beside E x = e; one stands at a vertex of them, unless they are `empty`.

    Raises SolverError where HiGHS has no answer that holds on the rows themselves.
    """

    def __init__(self, A: Array, b: Array, E: Array, e: Array) -> None:
        self._A, self._b, self._E, self._e = A, b, E, e
        self._on, self._inverse = np.ones(len(b), bool), np.linalg.pinv(E)
        for strategy in (1, 4):  # the dual simplex, then the primal
            if (found := self._least_missed(strategy)) is None:
                continue
            self._x, y = found
            missed = float(self._missed(self._x[:, None])[0])
            self.empty = missed <= TOLERANCE
            if not self.empty and self.proves(y):
                self._tabulate(y, missed)
            if self.empty or self.proves(y):
                return
        raise SolverError("HiGHS neither satisfied the constraints nor showed that nothing does")

    def proves(self, y: Array) -> bool:
        """Whether multipliers of the rows, as measured, exclude every |x| <= `FAR`."""
        bound, residual = self._bound(y)
        return bound > FAR * residual

    @property
    def y(self) -> Array:
        """(m,) the multipliers at the vertex where one stands."""
        level = -self._table[:-1, -1]
        y = np.zeros(self._b.size)
        y[self._basis] = np.where(level > SHARE * level.max(), level, 0.0)
        return np.where(self._on, y, 0.0)

    def within(self, rows: Mask) -> None:
        """From now on it is contradictions among these rows, such as the one where one stands."""
        self._on = rows
        for i in np.flatnonzero(~rows[self._basis]):  # their y is 0: what takes their place moves nothing
            entries = np.where(rows, np.abs(self._table[i, : rows.size]), 0.0)
            if entries[q := int(entries.argmax())] > PIVOT:
                pivot(self._table, self._basis, int(i), q)

    def walk(self, cost: Array) -> Iterator[Array]:
        """y here, and at each vertex on the way to the least cost'y; cost (m,) >= 0."""
        slopes(cost[None], self._table, self._basis, self._table[-1:])
        yield self.y
        while lower(self._table, self._basis, self._on, SHARE * cost.max(initial=0.0)):
            yield self.y

    def needs(self, costs: Array) -> Array:
        """(k,) the least s of each cost (k, m); nan where it is not shown here, as c'y is not at its least."""
        m, y = self._b.size, self.y
        sloping, share = np.empty((len(costs), self._table.shape[1])), costs @ y
        slopes(costs, self._table, self._basis, sloping)
        rising = sloping[:, :m][:, self._on].min(axis=1) >= -ROUNDING * costs.max(axis=1)
        here = np.flatnonzero(rising & (share > 0.0))
        given, xi = costs[here].T, -sloping[here, m:].T  # multipliers of A'y + E'w = 0, and at last of what is -t
        s = self._t / -xi[-1]
        z = xi[:-1] * s
        x = self._x[:, None] + z
        x -= self._inverse @ (self._E @ x - self._e[:, None])
        over = (self._A @ x - self._b[:, None] - given * s)[self._basis]  # what rounding leaves of 0 where x is far
        back = self._table[:-1, m:].T @ over
        x -= back[:-1] + z * back[-1] / self._t
        s *= 1.0 - back[-1] / self._t
        shown = self._missed(x, given * s) <= TOLERANCE
        shown &= s - self._bound(y)[0] / share[here] <= TOLERANCE * (1.0 + s)
        found = np.full(len(costs), np.nan)
        found[here[shown]] = s[shown]
        return found

    def proven(self) -> Array:
        """y, which proves it. Raises SolverError where it does not, with a tableau made anew either."""
        if not self.proves(self.y):
            self.refresh()
            if not self.proves(self.y):
                raise SolverError("no contradiction was shown where one was had")
        return self.y

    def refresh(self) -> None:
        """The tableau anew, without what rounding added to it."""
        self._enter(self._basis)

    def _bound(self, y: Array) -> tuple[float, float]:
        """-(b'y + e'w) and the sum of |A'y + E'w|, with the w that makes it least."""
        pull = y @ self._A
        w = -(pull @ self._inverse)
        return -float(y @ self._b + w @ self._e), float(np.abs(pull + w @ self._E).sum())

    def _missed(self, x: Array, more: Array | float = 0.0) -> Array:
        """(k,) by how much each x (n, k) misses the rows, which get `more` (m, k), and the equalities."""
        over = (self._A @ x - self._b[:, None] - more)[self._on]
        return np.maximum(
            over.max(axis=0, initial=0.0), np.abs(self._E @ x - self._e[:, None]).max(axis=0, initial=0.0)
        )

    def _tabulate(self, y: Array, missed: float) -> None:
        """The tableau at the vertex of these multipliers."""
        self._t, (m, n) = missed, self._A.shape
        self._whole = np.zeros((n + 2, m + n + 1 + len(self._e)))
        self._whole[:n, :m], self._whole[n, :m] = self._A.T, (self._b - self._A @ self._x) / missed
        self._whole[: n + 1, m : m + n + 1], self._whole[:n, m + n + 1 :] = np.eye(n + 1), self._E.T
        order = np.argsort(-y)
        self._enter(order[y[order] > SHARE * y.max()])

    def _enter(self, first: NDArray[np.intp]) -> None:
        """The tableau B^-1 [M, 1] of M (y, w) = (0, .., -1), and a row for slopes. B is of w and of these columns as
        far as they are independent; rows of w are left out, and those that have no column."""
        table, m, w = self._whole.copy(), self._b.size, self._whole.shape[1] - len(self._e)
        basis = np.full(len(table) - 1, -1)
        for q in (*range(w, table.shape[1]), *first):
            i = int(np.where(basis < 0, np.abs(table[:-1, q]), 0.0).argmax())
            if abs(table[i, q]) > INDEPENDENT:
                pivot(table, basis, i, int(q))
        while (entries := np.where(basis[:, None] < 0, np.abs(table[:-1, :m]), 0.0)).max() > INDEPENDENT:
            i, q = divmod(int(entries.argmax()), m)
            pivot(table, basis, i, q)
        kept = np.flatnonzero((basis >= 0) & (basis < m))
        self._table, self._basis = table[np.append(kept, -1), :w], basis[kept]

    def _least_missed(self, strategy: int) -> tuple[Array, Array] | None:
        """The x of the least t and the multipliers of the rows; None where HiGHS finds none."""
        import highspy  # as in `solver`: where it is used

        m, n = self._A.shape
        rows = np.zeros((m + len(self._E), n + 1))
        rows[:m, :n], rows[:m, n], rows[m:, :n] = self._A, -1.0, self._E
        program, there = highspy.HighsLp(), rows != 0.0
        program.num_row_, program.num_col_ = rows.shape
        program.col_cost_ = np.append(np.zeros(n), 1.0)
        program.col_lower_ = np.append(np.full(n, -np.inf), 0.0)
        program.col_upper_ = np.full(n + 1, np.inf)
        program.row_lower_ = np.concatenate((np.full(m, -np.inf), self._e))
        program.row_upper_ = np.concatenate((self._b, self._e))
        program.a_matrix_.format_ = highspy.MatrixFormat.kRowwise
        program.a_matrix_.start_ = np.concatenate(([0], there.sum(axis=1).cumsum())).astype(np.int32)
        program.a_matrix_.index_ = there.nonzero()[1].astype(np.int32)
        program.a_matrix_.value_ = rows[there]
        highs: Any = highspy.Highs()  # type: ignore[no-untyped-call]
        for option, value in {**OPTIONS, "simplex_strategy": strategy}.items():
            highs.setOptionValue(option, value)
        highs.passModel(program)
        highs.run()
        if highs.getModelStatus() != highspy.HighsModelStatus.kOptimal:
            return None
        found = highs.getSolution()
        return np.array(found.col_value)[:n], np.maximum(-np.array(found.row_dual)[:m], 0.0)
