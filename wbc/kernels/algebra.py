"""Symmetric definite matrices of the size of a robot: factors, inverses, mobilities G M^-1 G'."""

from __future__ import annotations

import math

import numpy as np

from .compiled import COUNT, TRUTH, Array, F, M, V, compiled, inner, m, v


@inner
def _factor(A: Array, L: Array) -> float:
    """A = L'L, L lower, with 1/L_ii on its diagonal. The smallest over the largest pivot, 0 where A is not definite.

    From the last row up: of a tree's mass matrix the zeros stay zeros, and are left out (Featherstone 2008, 6.5).
    """
    n = A.shape[0]
    for i in range(n):
        for j in range(i + 1):
            L[i, j] = A[i, j]
    small, large = math.inf, 0.0
    for k in range(n - 1, -1, -1):
        pivot = L[k, k]
        if not pivot > 0.0:
            return 0.0
        small, large = min(small, pivot), max(large, pivot)
        root = 1.0 / math.sqrt(pivot)
        L[k, k] = root
        for j in range(k):
            L[k, j] *= root
        for i in range(k):
            l = L[k, i]
            if l != 0.0:
                for j in range(i + 1):
                    L[i, j] -= l * L[k, j]
    return small / large if n else 1.0


@inner
def _forward(L: Array, B: Array) -> None:
    """B := L^-T B, rows of B at a time."""
    n, m = B.shape
    for k in range(n - 1, -1, -1):
        for j in range(m):
            B[k, j] *= L[k, k]
        for i in range(k):
            l = L[k, i]
            if l != 0.0:
                for j in range(m):
                    B[i, j] -= l * B[k, j]


@inner
def _backward(L: Array, B: Array) -> None:
    """B := L^-1 B."""
    n, m = B.shape
    for k in range(n):
        for i in range(k):
            l = L[k, i]
            if l != 0.0:
                for j in range(m):
                    B[k, j] -= l * B[i, j]
        for j in range(m):
            B[k, j] *= L[k, k]


@inner
def _gram(X: Array, K: Array) -> None:
    """K = X'X."""
    n, m = X.shape
    S = np.zeros((m, m))
    for k in range(n):
        for i in range(m):
            x = X[k, i]
            if x != 0.0:
                for j in range(i + 1):
                    S[i, j] += x * X[k, j]
    for i in range(m):
        for j in range(i + 1):
            K[i, j] = K[j, i] = S[i, j]


@compiled(TRUTH, m, M)
def inverse(A: Array, out: Array) -> bool:
    """out = A^-1, symmetric. False, and out is what it was, where A is nearly singular or not definite."""
    n = A.shape[0]
    L, X = np.empty((n, n)), np.zeros((n, n))
    if not _factor(A, L) > 1e-14:
        return False
    for i in range(n):
        X[i, i] = 1.0
    _backward(L, X)  # A^-1 = L^-1 L^-T
    for i in range(n):
        for j in range(i + 1):
            s = 0.0
            for k in range(j + 1):
                s += X[i, k] * X[j, k]
            out[i, j] = out[j, i] = s
    return True


@compiled(TRUTH, m, m, M, M)
def mobility(M: Array, G: Array, lifted: Array, K: Array) -> bool:
    """lifted (n, m) = M^-1 G', where it has columns, and K = G M^-1 G'. False where M is not definite."""
    m, n = G.shape
    L, X = np.empty((n, n)), np.empty((n, m))
    for i in range(n):
        for j in range(m):
            X[i, j] = G[j, i]
    if not _factor(M, L) > 0.0:
        K[:] = math.nan
        lifted[:] = math.nan
        return False
    _forward(L, X)
    _gram(X, K)
    if lifted.size:
        _backward(L, X)
        lifted[:] = X
    return True


@compiled(TRUTH, m, m, v, v, V, M)
def gauss(M: Array, G: Array, b: Array, vdot: Array, x: Array, K: Array) -> bool:
    """x = vdot + M^-1 G' K^-1 (b - G vdot) and K = G M^-1 G'. False, with K alone, where K is nearly singular."""
    m, n = G.shape
    L, X, S = np.empty((n, n)), np.empty((n, m)), np.empty((m, m))
    for i in range(n):
        for j in range(m):
            X[i, j] = G[j, i]
    if not _factor(M, L) > 0.0:
        K[:] = math.nan
        return False
    _forward(L, X)  # K = (L^-T G')' (L^-T G')
    _gram(X, K)
    if not _factor(K, S) > 1e-14:
        return False
    r = np.empty((m, 1))
    for i in range(m):
        s = b[i]
        for j in range(n):
            s -= G[i, j] * vdot[j]
        r[i, 0] = s
    _forward(S, r)
    _backward(S, r)
    f = np.empty((n, 1))
    for i in range(n):
        s = 0.0
        for j in range(m):
            s += X[i, j] * r[j, 0]
        f[i, 0] = s
    _backward(L, f)
    for i in range(n):
        x[i] = vdot[i] + f[i, 0]
    return True


@compiled(TRUTH, m, m, COUNT, M, M)
def within(K: Array, W: Array, first: int, out: Array, inertia: Array) -> bool:
    """out = K_oo - K_ho' W K_ho: a mobility of the rows `first` and on, in what those of W, the first, leave.

    `inertia` becomes its inverse; False as of `inverse`.
    """
    m, k = out.shape[0], W.shape[0]
    for j in range(m):
        for i in range(j + 1):
            s = K[first + i, first + j]
            for a in range(k):
                t = 0.0
                for b in range(k):
                    t += W[a, b] * K[b, first + j]
                s -= K[a, first + i] * t
            out[i, j] = out[j, i] = s
    return inverse(out, inertia)


@compiled(TRUTH, m, v, v, v, COUNT, F, V, V)
def minimum(stack: Array, g: Array, lo: Array, hi: Array, n_eq: int, most: float, x: Array, z: Array) -> bool:
    """x (n,), z (n + m,) of least x'Hx / 2 + g'x under the equalities E x = b alone, `stack` = [H; C] of the `Problem`.

    False where another row or bound is missed by more than `most`, or where rounding would show: then it is no answer.
    With H = L'L and Y = L^-T E':  x = L^-1 (y - Y z_E),  y = -L^-T g,  Y'Y z_E = Y'y - b.
    """
    n, k, rows = g.size, n_eq, lo.size
    C = np.empty((rows, n))
    for i in range(rows):
        for j in range(n):
            C[i, j] = stack[i, j]
    L, S, Y = np.empty((n, n)), np.empty((k, k)), np.empty((n, k))
    if not _factor(C[:n], L) > 1e-14:
        return False
    for i in range(k):
        for j in range(n):
            Y[j, i] = C[n + i, j]
    _forward(L, Y)
    _gram(Y, S)
    if not _factor(S, S) > 1e-14:
        return False
    value, r, s = np.zeros(rows), np.empty(n), np.empty(k)  # the rows' values, the gradient, what the equalities lack
    x[:] = 0.0
    z[:] = 0.0
    for _ in range(3):  # the later ones for what rounding leaves
        for i in range(n):
            r[i] = g[i]
        for i in range(n):
            for j in range(n):
                r[j] += C[i, j] * x[i]  # H is symmetric
        for i in range(k):
            s[i] = value[n + i] - lo[n + i]
            for j in range(n):
                r[j] += C[n + i, j] * z[n + i]
        for i in range(n - 1, -1, -1):
            r[i] *= L[i, i]
            for j in range(i):
                r[j] -= L[i, j] * r[i]
        for i in range(n):
            for j in range(k):
                s[j] -= Y[i, j] * r[i]
        for i in range(k - 1, -1, -1):
            s[i] *= S[i, i]
            for j in range(i):
                s[j] -= S[i, j] * s[i]
        for i in range(k):
            for j in range(i):
                s[i] -= S[i, j] * s[j]
            s[i] *= S[i, i]
            z[n + i] += s[i]
        for i in range(n):
            for j in range(k):
                r[i] += Y[i, j] * s[j]
            for j in range(i):
                r[i] -= L[i, j] * r[j]
            r[i] *= L[i, i]
            x[i] -= r[i]
        rest = 0.0
        for i in range(rows):
            value[i] = x[i] if i < n else 0.0
            if i >= n:
                for j in range(n):
                    value[i] += C[i, j] * x[j]
                if i < n + k:
                    rest = max(rest, abs(value[i] - lo[i]) / (1.0 + abs(lo[i])))
        if rest <= 1e-12:
            break
    inside = True
    for i in range(rows):
        inside = inside and lo[i] - most <= value[i] <= hi[i] + most
    return inside
