"""The primal simplex on a tableau: a row for each basic column, a last one of slopes; -levels in the last column."""

from __future__ import annotations

import math

import numpy as np
from numba import types
from numpy.typing import NDArray

from .compiled import COUNT, NOTHING, TRUTH, Array, Counts, F, compiled, inner, m

PIVOT = 1e-9  # the least that a row is divided by
LEVEL = 1e-12  # less is no step
STUCK = 30  # pivots without a step, after which they are chosen such that none comes back (Bland, 1977)
MOST = 1000  # of those

TABLE, BASIS = (types.Array(kind, ndim, "C") for kind, ndim in ((F, 2), (COUNT, 1)))
ON = types.Array(types.boolean, 1, "C", readonly=True)


@inner
def _exchange(table: Array, basis: Counts, i: int, q: int) -> None:
    per = 1.0 / table[i, q]
    for j in range(table.shape[1]):
        table[i, j] *= per
    for k in range(table.shape[0]):
        s = table[k, q]
        if k != i and s != 0.0:
            for j in range(table.shape[1]):
                table[k, j] -= s * table[i, j]
    basis[i] = q


@compiled(NOTHING, TABLE, BASIS, COUNT, COUNT)
def pivot(table: Array, basis: Counts, i: int, q: int) -> None:
    """Column q takes the place of the i-th of the basis."""
    _exchange(table, basis, i, q)


@compiled(NOTHING, m, TABLE, BASIS, TABLE)
def slopes(costs: Array, table: Array, basis: Counts, out: Array) -> None:
    """The row of slopes of each cost; `out` may be that of the tableau."""
    for k in range(costs.shape[0]):
        for j in range(out.shape[1]):
            out[k, j] = costs[k, j] if j < costs.shape[1] else 0.0
        for i in range(basis.size):
            cost = costs[k, basis[i]]
            if cost != 0.0:
                for j in range(out.shape[1]):
                    out[k, j] -= cost * table[i, j]


@compiled(TRUTH, TABLE, BASIS, ON, F)
def lower(table: Array, basis: Counts, on: NDArray[np.bool_], slope: float) -> bool:
    """Pivots, to columns that are `on`, until levels change: whether they did, or no slope is below -`slope`."""
    last, idle = table.shape[1] - 1, 0
    while idle < MOST:
        bland, q, least = idle > STUCK, -1, -slope
        for j in range(on.size):
            if on[j] and table[-1, j] < least:
                q, least = j, table[-1, j]
                if bland:
                    break
        if q < 0:
            return False
        step = math.inf
        for k in range(basis.size):
            if table[k, q] > PIVOT:
                step = min(step, max(-table[k, last], 0.0) / table[k, q])
        i = -1
        for k in range(basis.size):
            if table[k, q] <= PIVOT or -table[k, last] > (step + LEVEL) * table[k, q]:
                continue
            if i < 0 or (basis[k] < basis[i] if bland else table[k, q] > table[i, q]):
                i = k
        if i < 0:
            return False
        moved = -table[i, last] > LEVEL * table[i, q]
        _exchange(table, basis, i, q)
        if moved:
            return True
        idle += 1
    return False
