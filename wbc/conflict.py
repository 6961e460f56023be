"""Which constraints cannot hold together: an irreducible infeasible set of named rows, and what would free it.

    lo <= C x <= hi  by name,     E x = e  always (the dynamics)

A set is infeasible when no x satisfies it, and irreducible when it is feasible without any one of its names. It is
found by a deletion filter (Chinneck and Dravnieks, 1991): drop a name; if the rest is still infeasible, it stays out.
The filter starts from the names with a share in the certificate of Farkas, y >= 0 with y'C = 0 and y'd < 0, which the
least violation of all rows at once approximates, from the smallest share on. Solved by DAQP as least distances: no cost
has a say in what is feasible.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from .hierarchy import shortest
from .qp import Array

Mask = NDArray[np.bool_]
CONTRADICTED = 1e-6  # of equalities, relative to 1 + their right hand side
NOTHING = 1e-9  # a row whose norm is less, relative to what it was, does not depend on what is left free
SOFT = 1e-6  # of violations against distance, where all rows may give way
PULLS = (1e-6, 1e-4, 1e-2)  # towards the last iterate, where one name gives way: the next where one has no answer
SETTLED = 1e-8
TOLERANCE = 1e-6  # of rows of norm 1 that together still have an answer
STEPS = 30
_SOFT_ROW = 8  # DAQP's flag


class Member(NamedTuple):
    """A name of a conflict. `upper`: the side on which it conflicts. `frees`: whether all other constraints, not those
    of the conflict alone, hold without it; `needs`: by how much its rows must then give way, in their unit."""

    name: str
    row: int  # the row with the largest share in the conflict
    upper: bool
    needs: float
    frees: bool


class System:
    """Named rows lo <= C x <= hi (m,), beside equalities that always hold; `names` (m,) may repeat.

    Rows of one name come and go together.
    """

    def __init__(self, C: Array, lo: Array, hi: Array, names: Sequence[str], E: Array, e: Array) -> None:
        x, Z = shortest(E, e)
        at = C @ x
        self.C, self.lo, self.hi, self._size = C @ Z, lo - at, hi - at, np.linalg.norm(C, axis=1)
        self.names = tuple(dict.fromkeys(names))
        numbers = {name: i for i, name in enumerate(self.names)}
        self._number = np.array([numbers[name] for name in names], np.intp)
        self._of = {name: self._number == i for name, i in numbers.items()}
        # equalities -> C of what solves them, C of what they leave free, and which rows that moves
        self._solved: dict[bytes, tuple[Array, Array, Mask]] = {}

    def rows(self, names: Sequence[str]) -> Mask:
        """(m,) the rows of some names."""
        return np.logical_or.reduce([np.zeros(self.lo.size, bool), *(self._of[name] for name in names)])

    def feasible(self, names: Sequence[str]) -> bool:
        """Whether some x satisfies the rows of these names."""
        reduced = self._reduced(self.rows(names))
        return reduced is not None and (_nearest(*reduced) is not None or _violation(*reduced) <= TOLERANCE)

    def conflict(self, among: Sequence[str] | None = None) -> tuple[str, ...]:
        """Names of an irreducible infeasible set; none where all hold together."""
        left = list(self.names if among is None else among)
        if self.feasible(left):
            return ()
        share = self._shares(left)
        involved = [name for name in left if share[name] > 0.0]
        if len(involved) < len(left) and not self.feasible(involved):
            left = involved
        for name in sorted(left, key=lambda each: share[each]):
            rest = [each for each in left if each != name]
            if not self.feasible(rest):
                left = rest
        return tuple(sorted(left, key=lambda each: -share[each]))

    def members(self, names: Sequence[str], among: Sequence[str]) -> list[Member]:
        """What is to be told of every name of a conflict, those first that stand in every conflict `among` names."""
        y = self._multipliers(self.rows(names))
        found = []
        for name in names:
            own = np.flatnonzero(self._of[name])
            row = int(own[np.argmax(np.abs(y[own]))])
            needs = self.relaxation(name, among)
            found.append(Member(name, row, bool(y[row] > 0.0), np.inf if needs is None else needs, needs is not None))
        return sorted(found, key=lambda each: not each.frees)

    def relaxation(self, name: str, names: Sequence[str]) -> float | None:
        """By how much the rows of one name must give way for those of the others to hold; None where they never do.

        min t over z: that alone decides neither; a pull towards the last z vanishes as it converges.
        """
        others, own = self.rows([each for each in names if each != name]), self._of[name]
        reduced = self._reduced(others, own)
        if reduced is None or _nearest(*reduced[:3]) is None:
            return None
        C, lo, hi, B, low, high = reduced
        d, up, down = C.shape[1], np.isfinite(high), np.isfinite(low)
        give = np.concatenate((B[up], -B[down]))
        rows = np.zeros((len(C) + len(give) + 1, d + 1))
        rows[: len(C), :d], rows[len(C) : -1, :d], rows[len(C) : -1, d], rows[-1, d] = C, give, -1.0, 1.0
        most = np.concatenate((hi, high[up], -low[down], [np.inf]))
        least = np.concatenate((lo, np.full(len(give), -np.inf), [0.0]))
        return next((t for pull in PULLS if (t := _least(d, rows, least, most, pull)) is not None), None)

    def _reduced(self, on: Mask, more: Mask | None = None) -> Any:
        """Rows and bounds of the inequalities among some rows, with the equalities among them solved for, and the same
        of `more` rows, whatever they are; None where equalities contradict one another, or bounds cross."""
        lo, hi = self.lo, self.hi
        if not (lo[on] <= hi[on]).all():
            return None
        equal, rest, C = on & (lo == hi), on & (lo != hi), self.C
        key = equal.tobytes()
        if key not in self._solved:
            x, N = shortest(C[equal], lo[equal])
            left = C @ N
            self._solved[key] = C @ x, left, np.linalg.norm(left, axis=1) > NOTHING * self._size
        at, C, free = self._solved[key]
        if (np.abs(at - lo)[equal] > CONTRADICTED * (1.0 + np.abs(lo[equal]))).any():
            return None
        lo, hi = lo - at, hi - at
        fixed = rest & ~free
        slack = CONTRADICTED * (1.0 + np.where(np.isfinite(lo), np.abs(lo), 0.0))
        if (lo[fixed] > slack[fixed]).any() or (hi[fixed] < -slack[fixed]).any():
            return None
        rest &= free
        reduced = C[rest], lo[rest], hi[rest]
        return reduced if more is None else (*reduced, C[more], lo[more], hi[more])

    def _shares(self, names: Sequence[str]) -> dict[str, float]:
        """Largest share of any row of each name in the least violation of all; what rounding leaves is zero."""
        y = np.abs(self._multipliers(self.rows(names))) * self._size
        y[y < 1e-7 * y.max(initial=0.0)] = 0.0
        most = np.zeros(len(self.names))
        np.maximum.at(most, self._number, y)
        return dict(zip(self.names, most.tolist(), strict=True))

    def _multipliers(self, on: Mask) -> Array:
        """(m,) multipliers of the rows when all of them may give way; positive at an upper bound."""
        y, C, lo, hi = np.zeros(self.lo.size), self.C[on], self.lo[on], self.hi[on]
        crossed = lo > hi
        if crossed.any():
            y[np.flatnonzero(on)[crossed]] = 1.0
            return y
        _, flag, info = _daqp(np.eye(C.shape[1]), np.zeros(C.shape[1]), C, lo, hi, _SOFT_ROW)
        y[on] = info["lam"] if flag >= 1 else 1.0
        return y


def _nearest(C: Array, lo: Array, hi: Array) -> Array | None:
    """The shortest z with lo <= C z <= hi, or None."""
    d = C.shape[1]
    if not len(C):
        return np.zeros(d)
    z, flag, _ = _daqp(np.eye(d), np.zeros(d), C, lo, hi)
    return None if flag < 1 else z


def _violation(C: Array, lo: Array, hi: Array) -> float:
    """The least t by which all rows, scaled to a norm of 1, must give way: a solver may miss an answer far away."""
    size = np.linalg.norm(C, axis=1)
    C, lo, hi = C / size[:, None], lo / size, hi / size
    d, up, down = C.shape[1], np.isfinite(hi), np.isfinite(lo)
    give = np.concatenate((C[up], -C[down]))
    rows = np.zeros((len(give) + 1, d + 1))
    rows[:-1, :d], rows[:-1, d], rows[-1, d] = give, -1.0, 1.0
    most = np.concatenate((hi[up], -lo[down], [np.inf]))
    least = np.concatenate((np.full(len(give), -np.inf), [0.0]))
    return next((t for pull in PULLS if (t := _least(d, rows, least, most, pull)) is not None), np.inf)


def _least(d: int, rows: Array, lo: Array, hi: Array, pull: float) -> float | None:
    """The least t of (z, t) (d + 1,) within the rows, or None where the solver has no answer."""
    H, z, t = np.diag(np.concatenate((np.full(d, pull), [1.0]))), np.zeros(d + 1), np.inf
    for _ in range(STEPS):
        found, flag, _ = _daqp(H, -pull * np.concatenate((z[:d], [0.0])), rows, lo, hi)
        if flag < 1:
            return None if t == np.inf else t
        z, before, t = found, t, float(found[d])
        if abs(before - t) <= SETTLED * (1.0 + t):
            break
    return t


def _daqp(H: Array, g: Array, C: Array, lo: Array, hi: Array, sense: int = 0) -> tuple[Array, int, Any]:
    import daqp  # as in `solver`: where it is used

    model = daqp.Model()
    model.settings = {"primal_tol": 1e-9, "iter_limit": 2000, "eq_reduction": -1, "rho_soft": SOFT}
    ones = np.ascontiguousarray
    flag, _ = model.setup(ones(H), ones(g), ones(C), ones(hi), ones(lo), np.full(len(C), sense, dtype=np.int32))
    if flag < 0:
        return np.zeros(g.size), int(flag), {}
    z, _, flag, info = model.solve()
    return z, int(flag), info
