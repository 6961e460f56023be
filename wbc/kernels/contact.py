"""What contacts demand and carry."""

from __future__ import annotations

import numpy as np

from .compiled import NOTHING, Array, F, M, V, compiled, m, v


@compiled(NOTHING, m, m, M, V)
def select(basis: Array, table: Array, out: Array, bias: Array) -> None:
    """out = basis table, and bias its column of drifts with the sign turned."""
    n = table.shape[1]
    for i in range(basis.shape[0]):
        for j in range(n):
            s = 0.0
            for k in range(6):
                s += basis[i, k] * table[k, j]
            out[i, j] = s
        bias[i] = -out[i, n - 2]


@compiled(NOTHING, m, m, F, m, M, M, V, M, V)
def rolling(
    R_p: Array, R_f: Array, radius: float, table: Array, basis: Array, inverse: Array, Adot_V: Array, out: Array,
    bias: Array,
) -> None:  # fmt: skip
    """Of a sphere on a plane with the axes R_p, its frame at R_f: A and free rows, (A')^+, Adot V; then as `select`."""
    V = table[:, table.shape[1] - 1]
    X = np.empty((3, 3))
    for i in range(3):
        for j in range(3):
            X[i, j] = R_p[0, i] * R_f[0, j] + R_p[1, i] * R_f[1, j] + R_p[2, i] * R_f[2, j]
    for j in range(3):
        basis[0, j], basis[1, j], basis[2, j] = -radius * X[1, j], radius * X[0, j], 0.0
        for i in range(3):
            basis[i, 3 + j] = basis[3 + i, j] = inverse[i, 3 + j] = X[i, j]
            basis[3 + i, 3 + j] = inverse[i, j] = 0.0
    x = V[1] * V[5] - V[2] * V[4]
    y = V[2] * V[3] - V[0] * V[5]
    z = V[0] * V[4] - V[1] * V[3]
    for i in range(3):
        Adot_V[i] = X[i, 0] * x + X[i, 1] * y + X[i, 2] * z
    select(basis, table, out, bias)


@compiled(F, m, v, v, F, F, F)
def height(R: Array, p: Array, normal: Array, level: float, x: float, y: float) -> float:
    """How far the lowest corner (+-x, +-y, 0) of a frame at (R, p) is above the plane normal . r = level."""
    h, a, b = -level, 0.0, 0.0
    for i in range(3):
        h += normal[i] * p[i]
        a += normal[i] * R[i, 0]
        b += normal[i] * R[i, 1]
    return h - abs(a) * x - abs(b) * y


@compiled(NOTHING, v, v, F, F, V)
def settle(Adot_V: Array, slip: Array, rate: float, most: float, rhs: Array) -> None:
    """rhs -= Adot V + c with c = rate A V, each at most `most`."""
    for i in range(rhs.size):
        rhs[i] -= Adot_V[i] + min(max(rate * slip[i], -most), most)


@compiled(NOTHING, m, v, v, V)
def wanted(free: Array, y: Array, bias: Array, b: Array) -> None:
    """b = bias, with free y added to its last rows."""
    k = bias.size - free.shape[0]
    for i in range(bias.size):
        b[i] = bias[i]
    for i in range(free.shape[0]):
        for j in range(6):
            b[k + i] += free[i, j] * y[j]


@compiled(NOTHING, m, m, F, V, M)
def carried(push: Array, A: Array, radius: float, weight: Array, S: Array) -> None:
    """weight (k,): 1 of a row of A that is a unit force, 1/radius^2 of a moment; S = P diag(weight)^-1 P'.

    P' (k, 6) are the first columns of `push`: what the multipliers do to a floating base.
    """
    S[:] = 0.0
    for k in range(A.shape[0]):
        size = 0.0
        for j in range(3):
            size += radius * radius * A[k, j] * A[k, j] + A[k, 3 + j] * A[k, 3 + j]
        weight[k] = 1.0 / size
        for i in range(6):
            for j in range(i + 1):
                S[i, j] += push[k, i] * push[k, j] * size
    for i in range(6):
        for j in range(i):
            S[j, i] = S[i, j]


@compiled(NOTHING, m, v, m, m, v, M, V, M)
def share(push: Array, weight: Array, Y: Array, M_b: Array, bias: Array, D: Array, lam: Array, moved: Array) -> None:
    """D = diag(weight)^-1 P' Y, lam -= D (bias + P lam), and moved = D M_b of the base's rows M_b (6, n)."""
    k, n = moved.shape
    r = np.empty(6)
    for a in range(6):
        r[a] = bias[a]
    for i in range(k):
        for a in range(6):
            r[a] += push[i, a] * lam[i]
    for i in range(k):
        for j in range(n):
            moved[i, j] = 0.0
        for a in range(6):
            s = 0.0
            for b in range(6):
                s += push[i, b] * Y[b, a]
            D[i, a] = d = s / weight[i]
            lam[i] -= d * r[a]
            for j in range(n):
                moved[i, j] += d * M_b[a, j]
