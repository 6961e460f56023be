"""Least squares and null spaces of any rank, by reflections with pivoting (Golub, Van Loan 2013, 5.4, 5.5)."""

from __future__ import annotations

import math

import numpy as np

from .compiled import COUNT, Array, F, M, V, compiled, inner, m, v


@inner
def _reflect(x: Array, u: Array) -> float:
    """u, tau with (I - tau u u') x = (alpha, 0, ..., 0); x becomes the right side. Returns tau, 0 where x is zero."""
    norm = 0.0
    for i in range(x.size):
        u[i] = x[i]
        norm += x[i] * x[i]
    if norm == 0.0:
        return 0.0
    alpha = -math.sqrt(norm) if x[0] > 0.0 else math.sqrt(norm)
    u[0] -= alpha
    tau = 1.0 / (norm - alpha * x[0])
    x[:] = 0.0
    x[0] = alpha
    return tau


@inner
def _apply(tau: float, u: Array, x: Array) -> None:
    """x := (I - tau u u') x."""
    s = 0.0
    for i in range(u.size):
        s += u[i] * x[i]
    s *= tau
    for i in range(u.size):
        x[i] -= s * u[i]


@compiled(COUNT, m, v, F, V, M)
def least_squares(B: Array, r: Array, least: float, z: Array, N: Array) -> int:
    """z (d,) = B^+ r, the shortest of least squares, and the rank of B (m, d): pivots up to `least` are nothing.

    The first d - rank rows of N (d, d) are an orthonormal basis of what B maps to nothing.
    """
    rows, d = B.shape
    W, U, tau, order = np.empty((rows, d)), np.zeros((min(rows, d), d)), np.zeros(min(rows, d)), np.arange(rows)
    for i in range(rows):
        for j in range(d):
            W[i, j] = B[i, j]
    rank = 0
    for k in range(min(rows, d)):  # B = L Q', its rows from the longest on
        far, longest = k, -1.0
        for i in range(k, rows):
            norm = 0.0
            for j in range(k, d):
                norm += W[i, j] * W[i, j]
            if norm > longest:
                far, longest = i, norm
        if not math.sqrt(longest) > least:
            break
        if far != k:
            order[far], order[k] = order[k], order[far]
            for j in range(d):
                W[far, j], W[k, j] = W[k, j], W[far, j]
        tau[k] = _reflect(W[k, k:], U[k, k:])
        for i in range(k + 1, rows):
            _apply(tau[k], U[k, k:], W[i, k:])
        rank += 1
    b, y = np.empty(rows), np.zeros(d)
    for i in range(rows):
        b[i] = r[order[i]]
    if rank == rows:  # L y = b
        for i in range(rank):
            s = b[i]
            for j in range(i):
                s -= W[i, j] * y[j]
            y[i] = s / W[i, i]
    else:
        T, u = np.empty((rank, rows)), np.empty(rows)
        for i in range(rank):
            for j in range(rows):
                T[i, j] = W[j, i] if i <= j else 0.0
        for k in range(rank):
            t = _reflect(T[k, k:], u[k:])
            for i in range(k + 1, rank):
                _apply(t, u[k:], T[i, k:])
            _apply(t, u[k:], b[k:])
        for i in range(rank - 1, -1, -1):
            s = b[i]
            for j in range(i + 1, rank):
                s -= T[j, i] * y[j]
            y[i] = s / T[i, i]
    for i in range(d):
        z[i] = y[i]
        for j in range(d):
            N[i, j] = 1.0 if j == rank + i else 0.0
    for k in range(rank - 1, -1, -1):
        _apply(tau[k], U[k, k:], z[k:])
        for i in range(d - rank):
            _apply(tau[k], U[k, k:], N[i, k:])
    return rank


@compiled(COUNT, m, F, M)
def root(W: Array, least: float, R: Array) -> int:
    """The rank of W (n, n), positive semidefinite; the first rows of R (n, n) then have R'R = W.

    Cholesky's factor with pivoting, ended where no pivot exceeds `least` of the first.
    """
    n = W.shape[0]
    S, order = np.empty((n, n)), np.arange(n)
    for i in range(n):
        for j in range(n):
            S[i, j] = 0.5 * (W[i, j] + W[j, i])
            R[i, j] = 0.0
    first = 0.0
    for k in range(n):
        far = k
        for i in range(k + 1, n):
            if S[order[i], order[i]] > S[order[far], order[far]]:
                far = i
        order[k], order[far] = order[far], order[k]
        p = order[k]
        pivot = S[p, p]
        first = max(first, pivot)
        if not pivot > least * first:
            return k
        scale = 1.0 / math.sqrt(pivot)
        for i in range(k, n):
            R[k, order[i]] = S[p, order[i]] * scale
        for i in range(k + 1, n):
            a = R[k, order[i]]
            if a != 0.0:
                for j in range(k + 1, n):
                    S[order[i], order[j]] -= a * R[k, order[j]]
    return n
