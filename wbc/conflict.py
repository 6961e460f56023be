"""Which constraints cannot hold together: an irreducible infeasible set of named rows, and what would free it.

    lo <= C x <= hi  by name,     E x = e  always (the dynamics)

A set is infeasible when no x satisfies it, and irreducible when it is feasible without any one of its names. The rows
of a contradiction at a vertex (see `contradiction`) are an irreducible set of rows; as a name may have several, a
deletion filter (Chinneck and Dravnieks, 1991) goes through their names, the smallest share first: towards the least
share that a name has among the contradictions of what is left. Where that is 0 the name drops out, with whatever else
the contradiction does without. Where it is not, the others hold without the name, and the least tells by how much it
would have to give way.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from .contradiction import Contradictions, Mask
from .errors import SolverError
from .qp import Array


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

    Rows of one name come and go together. All that is asked of it raises SolverError where it has no answer that
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
        self._of = self._named[self._row]
        give = 1.0 / norm[self._row]
        self._A = np.concatenate((C[upper], -C[lower])) * give[:, None]
        self._b = np.concatenate((hi[upper], -lo[lower])) * give
        self._E, self._e = E, e
        self._share = np.where(self._of == np.arange(len(self.names))[:, None], give, 0.0)  # (names, rows of A)

    def rows(self, names: Sequence[str]) -> Mask:
        """(m,) the rows of some names."""
        return self._counting(names)[self._named]

    def feasible(self, names: Sequence[str]) -> bool:
        """Whether some x satisfies the rows of these names."""
        return not self._contradict(names)

    def conflict(self, among: Sequence[str] | None = None) -> tuple[str, ...]:
        """Names of an irreducible infeasible set, the largest share first; none where all hold together."""
        if not self._contradict(among):
            return ()
        return tuple(self.names[i] for i in self._irreducible({}))

    def members(self, among: Sequence[str] | None = None) -> list[Member]:
        """The same with what is to be told of each, those first that stand in every conflict."""
        found = list[Member]()
        if not self._contradict(among):
            return found
        frees = self._frees()
        numbers, y = self._irreducible(frees), self._contradictions.y
        for i in sorted(numbers, key=lambda each: each not in frees):
            most = int(np.argmax(np.where(self._of == i, y, -1.0)))
            row, upper = int(self._row[most]), bool(self._upper[most])
            found.append(Member(self.names[i], row, upper, frees.get(i, np.inf), i in frees))
        return found

    @cached_property
    def _contradictions(self) -> Contradictions:
        return Contradictions(self._A, self._b, self._E, self._e)

    def _contradict(self, among: Sequence[str] | None) -> bool:
        """Whether rows of these names contradict one another; then one stands at a vertex where they do."""
        every, counting = self._contradictions, self._counting(self.names if among is None else among)
        if every.empty:
            return False
        every.within(np.ones(self._of.size, bool))
        cost = self._share[~counting].sum(axis=0)
        for _ in range(2):
            for y in every.walk(cost):
                if not y @ cost and every.proves(y):
                    every.within(counting[self._of])
                    return True
            if np.isfinite(every.needs(cost[None])[0]):
                return False
            every.refresh()
        raise SolverError(f"it was not shown whether {', '.join(among or self.names)} hold together")

    def _frees(self) -> dict[int, float]:
        """Names without which all others hold, and what each needs: they stand in every contradiction."""
        left, needs = self._involved(self._contradictions.y), dict[int, float]()
        while left.size:
            left = self._judged(left, needs)
        return needs

    def _irreducible(self, needed: Mapping[int, float]) -> NDArray[np.intp]:
        """Names of an irreducible set among those of the contradiction where one stands, the largest share first; then
        one stands where it is shown. Of `needed` it is known that nothing contradicts without them."""
        every, known = self._contradictions, dict(needed)
        while True:
            names = self._involved(every.proven())
            every.within(self._mask(names)[self._of])
            left = names[[i not in known for i in names]]
            if not left.size:
                return names[::-1]
            self._judged(left, known)

    def _judged(self, names: NDArray[np.intp], needs: dict[int, float]) -> NDArray[np.intp]:
        """Those of the names that are left to judge, on the way to a contradiction without the first: some drop out as
        another contradiction does without them, or as it is known what they need, the first at the latest."""
        every, shares = self._contradictions, self._share[names]
        for _ in range(2):
            for y in every.walk(shares[0]):
                there = shares @ y > 0.0
                if not there.all() and every.proves(y):
                    return names[there]
            found = every.needs(shares)
            shown = np.isfinite(found)
            if shown[0]:
                needs.update(zip(names[shown].tolist(), found[shown].tolist(), strict=True))
                return names[~shown]
            every.refresh()
        raise SolverError(f"it was not shown whether all contradict {self.names[names[0]]}")

    def _involved(self, y: Array) -> NDArray[np.intp]:
        """Names with a share in a contradiction, the smallest first."""
        share = np.zeros(len(self.names))
        np.maximum.at(share, self._of, y)
        order = np.argsort(share)
        return order[share[order] > 0.0]

    def _counting(self, names: Sequence[str]) -> Mask:
        """(names,) whether each is among these."""
        return self._mask(np.array([self._number[name] for name in names], np.intp))

    def _mask(self, numbers: NDArray[np.intp]) -> Mask:
        mask = np.zeros(len(self.names), bool)
        mask[numbers] = True
        return mask
