"""Singular values of a task's rows in what the contacts' rows leave free."""

from __future__ import annotations

import math

import numpy as np

from .compiled import COUNT, COUNTS, NOTHING, TRUTH, Array, Counts, F, M, V, compiled, inner, m, v

_DEPENDENT = 1e-10  # of a row's square: what is left of it then is rounding


@inner
def _within(G: Array, first: int, E: Array) -> None:
    """E = T (I - C^+ C) T' of the rows C, the first, and T, the others, of G: by elimination in G G'."""
    rows, n = G.shape
    S, column, square = np.zeros((rows, rows)), np.empty(rows), np.empty(first)
    for k in range(n):
        for i in range(rows):
            column[i] = G[i, k]
        for i in range(rows):
            x = column[i]
            if x != 0.0:
                for j in range(i + 1):
                    S[i, j] += x * column[j]
    for k in range(first):
        square[k] = S[k, k]
    for k in range(first):
        pivot = S[k, k]
        if not pivot > _DEPENDENT * square[k]:  # redundant contacts
            continue
        for i in range(k + 1, rows):
            l = S[i, k] / pivot
            if l != 0.0:
                for j in range(k + 1, i + 1):
                    S[i, j] -= l * S[j, k]
    for i in range(first, rows):
        for j in range(first, i + 1):
            E[i - first, j - first] = E[j - first, i - first] = S[i, j]


@inner
def _surely(E: Array, least: float) -> bool:
    """Whether all eigenvalues of E exceed `least`, by the trace of E^-1, which none of their inverses exceeds."""
    r = E.shape[0]
    L, X, trace = np.empty((r, r)), np.zeros((r, r)), 0.0
    for i in range(r):
        for j in range(i + 1):
            s = E[i, j]
            for k in range(j):
                s -= L[i, k] * L[j, k]
            if i > j:
                L[i, j] = s / L[j, j]
            elif s > 1e-14 * E[i, i]:
                L[i, i] = math.sqrt(s)
            else:
                return False
        X[i, i] = 1.0 / L[i, i]
        trace += X[i, i] * X[i, i]
        for j in range(i):
            s = 0.0
            for k in range(j, i):
                s -= L[i, k] * X[k, j]
            X[i, j] = s / L[i, i]
            trace += X[i, j] * X[i, j]
    return trace * least < 1.0


@inner
def _eigen(E: Array, U: Array) -> None:
    """E becomes diagonal and U, by columns, its eigenvectors: Jacobi's rotations (Golub, Van Loan 2013, 8.5)."""
    r = E.shape[0]
    for i in range(r):
        for j in range(r):
            U[i, j] = 1.0 if i == j else 0.0
    for _ in range(30):
        off, size = 0.0, 0.0
        for i in range(r):
            size += E[i, i] * E[i, i]
            for j in range(i):
                off += E[i, j] * E[i, j]
        if not off > 1e-32 * size:
            break
        for p in range(r):
            for q in range(p + 1, r):
                if E[p, q] == 0.0:
                    continue
                theta = (E[q, q] - E[p, p]) / (2.0 * E[p, q])
                t = math.copysign(1.0, theta) / (abs(theta) + math.sqrt(theta * theta + 1.0))
                c = 1.0 / math.sqrt(t * t + 1.0)
                s = t * c
                for k in range(r):
                    a, b = E[k, p], E[k, q]
                    E[k, p], E[k, q] = c * a - s * b, s * a + c * b
                for k in range(r):
                    a, b = E[p, k], E[q, k]
                    E[p, k], E[q, k] = c * a - s * b, s * a + c * b
                for k in range(r):
                    a, b = U[k, p], U[k, q]
                    U[k, p], U[k, q] = c * a - s * b, s * a + c * b


@compiled(TRUTH, m, COUNT, F)
def far(G: Array, first: int, least: float) -> bool:
    """Whether all singular values of the rows `first` and on of G (first + r, n), within what the others leave free,
    surely exceed `least`."""
    r = G.shape[0] - first
    E = np.empty((r, r))
    _within(G, first, E)
    return _surely(E, least * least)


@compiled(TRUTH, m, COUNT, COUNTS, v)
def all_far(G: Array, first: int, sizes: Counts, leasts: Array) -> bool:
    """The same of each of several tasks, of `sizes` rows one below the other, with a `least` of its own; 0: of none."""
    r = G.shape[0] - first
    E, start = np.empty((r, r)), 0
    _within(G, first, E)
    for size, least in zip(sizes, leasts):  # noqa: B905
        stop = start + size
        if least > 0.0 and not _surely(E[start:stop, start:stop], least * least):
            return False
        start = stop
    return True


@compiled(NOTHING, m, COUNT, V, M)
def singular(G: Array, first: int, values: Array, U: Array) -> None:
    """These singular values (r,), and U (r, r) by columns the directions of the rows that belong to them, unsorted."""
    r = values.size
    E = np.empty((r, r))
    _within(G, first, E)
    _eigen(E, U)
    for i in range(r):
        values[i] = math.sqrt(max(E[i, i], 0.0))
