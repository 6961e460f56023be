"""Which constraints cannot hold together: an irreducible infeasible set of named rows, and what would free it.

    lo <= C x <= hi  by name,     E x = e  always (the dynamics)

Whether the rows of some names hold together is asked of one linear program, which HiGHS's simplex solves,

    min t     s.t.     lo - s - r t <= C x <= hi + s + r t,     E x = e,     s, t >= 0

with r the norms of the rows, and s one number a name: zero where it counts, free where it is left out. It always has an
answer, so nothing hangs on a solver's word that there is none. At t = 0 its x satisfies them; at t > 0 its multipliers
y >= 0 are Farkas's certificate (y'C = 0 beside E, and y'd < 0) that nothing does. Either is measured on the rows.

A set is infeasible when no x satisfies it, and irreducible when it is feasible without any one of its names. The rows
with y > 0 at a vertex are an irreducible set of rows (Gleeson and Ryan, 1990); as a name may have several, a deletion
filter (Chinneck and Dravnieks, 1991) goes through their names, the smallest y first: drop one; if the rest is still
infeasible, it stays out.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from .errors import SolverError
from .qp import Array

Mask = NDArray[np.bool_]
TOLERANCE = 1e-6  # of rows of norm 1 that together still have an answer
FAR = 1e6  # [rad/s^2, m/s^2, N, N m] a certificate excludes every x within
SHARE = 1e-9  # of the largest y: less is rounding
# of HiGHS; a number of threads would be that of all its programs in the process
OPTIONS: dict[str, Any] = {
    "output_flag": False, "presolve": "off", "parallel": "off", "simplex_scale_strategy": 0,
    "simplex_dual_edge_weight_strategy": 1,
    "small_matrix_value": 1e-12, "primal_feasibility_tolerance": 1e-9, "dual_feasibility_tolerance": 1e-9,
}  # fmt: skip


class Member(NamedTuple):
    """A name of a conflict. `upper`: the side on which it conflicts. `frees`: whether all other constraints, not those
    of the conflict alone, hold without it; `needs`: by how much its rows must then give way, in their unit."""

    name: str
    row: int  # the row with the largest share in the conflict
    upper: bool
    needs: float
    frees: bool


class Shown(NamedTuple):
    """That some rows contradict one another: their multipliers y (rows,), and the point (n,) that misses them least."""

    y: Array
    x: Array


class System:
    """Named rows lo <= C x <= hi (m,), beside equalities that always hold; `names` (m,) may repeat.

    Rows of one name come and go together. All that is asked of it raises SolverError where HiGHS has no answer that
    holds on the rows themselves.
    """

    def __init__(self, C: Array, lo: Array, hi: Array, names: Sequence[str], E: Array, e: Array) -> None:
        self.names = tuple(dict.fromkeys(names))
        self._number = {name: i for i, name in enumerate(self.names)}
        self._named = np.array([self._number[name] for name in names], np.intp)
        upper, lower = np.flatnonzero(np.isfinite(hi)), np.flatnonzero(np.isfinite(lo))
        norm = np.linalg.norm(C, axis=1)
        norm[norm == 0.0] = 1.0
        self._row = np.concatenate((upper, lower))  # of each of A x <= b, rows of norm 1
        self._upper = np.arange(self._row.size) < upper.size
        self._give = 1.0 / norm[self._row]  # what s gives to each
        self._A = np.concatenate((C[upper], -C[lower])) * self._give[:, None]
        self._b = np.concatenate((hi[upper], -lo[lower])) * self._give
        self._of = self._named[self._row]
        self._E, self._e = E, e
        self._slack = C.shape[1] + np.arange(len(self.names) + 1, dtype=np.int32)  # columns of s, at last that of t
        self._highs = self._program()

    def rows(self, names: Sequence[str]) -> Mask:
        """(m,) the rows of some names."""
        return self._counting(names)[self._named]

    def feasible(self, names: Sequence[str]) -> bool:
        """Whether some x satisfies the rows of these names."""
        return self._contradiction(names) is None

    def conflict(self, among: Sequence[str] | None = None) -> tuple[str, ...]:
        """Names of an irreducible infeasible set, the largest share first; none where all hold together."""
        shown = self._contradiction(self.names if among is None else among)
        return () if shown is None else self._irreducible(shown, ())[0]

    def members(self, among: Sequence[str] | None = None) -> list[Member]:
        """The same with what is to be told of each, those first that stand in every conflict."""
        among = self.names if among is None else among
        shown, found = self._contradiction(among), list[Member]()
        if shown is None:
            return found
        frees = self._frees(shown, among)
        names, y = self._irreducible(shown, frees)
        for name in sorted(names, key=lambda each: each not in frees):
            own = np.flatnonzero(self._of == self._number[name])
            most = own[np.argmax(y[own])]
            row, upper = int(self._row[most]), bool(self._upper[most])
            found.append(Member(name, row, upper, frees.get(name, np.inf), name in frees))
        return found

    def _frees(self, shown: Shown, among: Sequence[str]) -> dict[str, float]:
        """Names without which all others hold, and what each needs: they stand in every contradiction."""
        everywhere, needs = self._involved(shown.y), dict[str, float]()
        seen = self._pointed(shown, among)
        for name in tuple(everywhere):
            if name not in everywhere:
                continue
            other = None if name in seen else self._contradiction([each for each in among if each != name])
            if other is not None:
                everywhere = self._shared(everywhere, other)
            else:
                needs[name] = self._relaxation(name, among)
        return needs

    def _shared(self, names: Sequence[str], shown: Shown) -> list[str]:
        """Those of the names that stand in another contradiction as well."""
        involved = set(self._involved(shown.y))
        return [each for each in names if each in involved]

    def _relaxation(self, name: str, names: Sequence[str]) -> float:
        """By how much the rows of one name must give way for those of the others to hold, where they can."""
        counting, number = self._counting(names), self._number[name]
        give = np.where(self._of == number, self._give, 0.0)
        for z, y, w in self._answers(counting, number):
            s = float(z[self._slack[number]])
            bound, _ = self._bound(y, w)
            if self._missed(z, counting, give * s) <= TOLERANCE and s - bound <= TOLERANCE * (1.0 + s):
                return s
        raise SolverError(f"HiGHS found no least relaxation of {name} that holds")

    def _irreducible(self, shown: Shown, needed: Collection[str]) -> tuple[tuple[str, ...], Array]:
        """Names of an irreducible set among those of a contradiction, the largest share first, and its multipliers;
        of `needed` it is known that nothing contradicts without them."""
        left = self._involved(shown.y)
        known = {*needed, *self._pointed(shown, left)}
        for name in tuple(left):
            if name in left and name not in known:
                less = self._contradiction([each for each in left if each != name])
                if less is not None:
                    shown, left = less, self._involved(less.y)
                    known = {*needed, *self._pointed(shown, left)}
        return tuple(reversed(left)), shown.y

    def _pointed(self, shown: Shown, names: Sequence[str]) -> set[str]:
        """Those of the names without which the others hold, as a point shows that is easily had: the nearest at which
        all rows of the contradiction are at their bounds but one, which makes up for it all."""
        y, x = shown
        counts = self._counting(names)[self._of]
        rows = np.flatnonzero(y > SHARE * y.max())
        K = np.concatenate((self._A[rows], self._E))
        # y'A x = 0 beside E: what the others lack, y'b < 0 in all, one row of multiplier y_i has to give
        w = np.linalg.lstsq(self._E.T, -(y[rows] @ self._A[rows]), rcond=None)[0]
        lack = -float(y[rows] @ self._b[rows] + w @ self._e)
        bounds = np.tile(np.concatenate((self._b[rows], self._e))[:, None], rows.size)
        bounds[np.arange(rows.size), np.arange(rows.size)] += lack / y[rows]
        points = x[:, None] + np.linalg.pinv(K) @ (bounds - (K @ x)[:, None])
        over = np.where(counts[:, None], self._A @ points - self._b[:, None], -np.inf)
        over[self._of[:, None] == self._of[rows]] = -np.inf
        holds = (over.max(axis=0) <= TOLERANCE) & (
            np.abs(self._E @ points - self._e[:, None]).max(axis=0, initial=0.0) <= TOLERANCE
        )
        return {self.names[i] for i in self._of[rows[holds]]}

    def _involved(self, y: Array) -> list[str]:
        """Names with a share in a contradiction, the smallest first."""
        share = np.zeros(len(self.names))
        np.maximum.at(share, self._of, y)
        order = np.argsort(share)
        return [self.names[i] for i in order[share[order] > SHARE * share[order[-1]]]]

    def _contradiction(self, names: Sequence[str]) -> Shown | None:
        """That rows of these names contradict one another; None where some x satisfies them."""
        counting = self._counting(names)
        for z, y, w in self._answers(counting, len(self.names)):
            if self._missed(z, counting) <= TOLERANCE:
                return None
            bound, rounding = self._bound(y, w)
            if bound > rounding:
                return Shown(y, z[: self._A.shape[1]])
        raise SolverError(f"HiGHS neither satisfied {', '.join(names)} nor showed that nothing does")

    def _counting(self, names: Sequence[str]) -> Mask:
        """(names,) whether each is among these."""
        counting = np.zeros(len(self.names), bool)
        counting[[self._number[name] for name in names]] = True
        return counting

    def _missed(self, z: Array, counting: Mask, more: Array | float = 0.0) -> float:
        """By how much an answer misses the rows of names that count, which get `more`, and the equalities."""
        x = z[: self._A.shape[1]]
        over = (self._A @ x - self._b - more)[counting[self._of]]
        return max(float(over.max(initial=0.0)), float(np.abs(self._E @ x - self._e).max(initial=0.0)))

    def _bound(self, y: Array, w: Array) -> tuple[float, float]:
        """The least value that multipliers y >= 0 of rows and w of equalities prove of the program, and how far off
        their rounding may put it where no |x| exceeds `FAR`."""
        return -float(y @ self._b + w @ self._e), FAR * float(np.abs(y @ self._A + w @ self._E).sum())

    def _answers(self, counting: Mask, least: int) -> Iterator[tuple[Array, Array, Array]]:
        """z = (x, s, t) of the least of one slack, and multipliers of rows and equalities: from the last vertex, then
        from none."""
        most, cost = np.append(np.where(counting, 0.0, np.inf), 0.0), np.zeros(self._slack.size)
        most[least], cost[least] = np.inf, 1.0
        self._highs.changeColsBounds(most.size, self._slack, np.zeros(most.size), most)
        self._highs.changeColsCost(most.size, self._slack, cost)
        for _ in range(2):
            self._highs.run()
            if self._highs.getModelStatus() == self._optimal:
                found = self._highs.getSolution()
                y = -np.array(found.row_dual)
                of_rows = np.where(counting[self._of], np.maximum(y[: len(self._A)], 0.0), 0.0)
                yield np.array(found.col_value), of_rows, y[len(self._A) :]
            self._highs.clearSolver()

    def _program(self) -> Any:
        """The linear program, which differs from question to question only in the bounds and costs of s and t."""
        import highspy  # as in `solver`: where it is used

        m, n = self._A.shape
        rows = np.zeros((m + len(self._E), n + self._slack.size))
        rows[:m, :n], rows[m:, :n] = self._A, self._E
        rows[np.arange(m), self._slack[self._of]], rows[:m, -1] = -self._give, -1.0
        program, there = highspy.HighsLp(), rows != 0.0
        program.num_row_, program.num_col_ = rows.shape
        program.col_cost_ = np.zeros(rows.shape[1])
        program.col_lower_ = np.concatenate((np.full(n, -np.inf), np.zeros(self._slack.size)))
        program.col_upper_ = np.full(rows.shape[1], np.inf)
        program.row_lower_ = np.concatenate((np.full(m, -np.inf), self._e))
        program.row_upper_ = np.concatenate((self._b, self._e))
        program.a_matrix_.format_ = highspy.MatrixFormat.kRowwise
        program.a_matrix_.start_ = np.concatenate(([0], there.sum(axis=1).cumsum())).astype(np.int32)
        program.a_matrix_.index_ = there.nonzero()[1].astype(np.int32)
        program.a_matrix_.value_ = rows[there]
        self._optimal = highspy.HighsModelStatus.kOptimal
        highs: Any = highspy.Highs()  # type: ignore[no-untyped-call]
        for option, value in OPTIONS.items():
            highs.setOptionValue(option, value)
        highs.passModel(program)
        return highs
