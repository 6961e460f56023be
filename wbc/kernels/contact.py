"""What contacts demand and carry."""

from __future__ import annotations

import math

import numpy as np

from .compiled import COUNT, COUNTS, NOTHING, Array, Counts, F, M, T, V, compiled, m, t, v


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


@compiled(NOTHING, COUNTS, t, m, m, v, F, t, m, t, T, T, M, T, M, V)
def rolling(
    index: Counts, R_p: Array, numbers: Array, normal: Array, level: Array, flies: float, R: Array, p: Array,
    tables: Array, basis: Array, inverse: Array, Adot_V: Array, out: Array, bias: Array, height: Array,
) -> None:  # fmt: skip
    """Of spheres on planes with the axes R_p, whose frames are `index` of all (R, p, tables): A and free rows, (A')^+,
    Adot V; then as `select`, less Adot V and what dies out of those that stand.

    `numbers`: radius, height of the middle where it stands, rate and bound of `settle`. `height`: above the plane,
    which is found `level` above where it was said to be; from `flies` on a foot does not stand.
    """
    X, n = np.empty((3, 3)), tables.shape[2]
    for f in range(index.size):
        radius, lowest, rate, most = numbers[f, 0], numbers[f, 1], numbers[f, 2], numbers[f, 3]
        S, R_f, B, table = R_p[f], R[index[f]], basis[f], tables[index[f]]
        for i in range(3):
            for j in range(3):
                X[i, j] = S[0, i] * R_f[0, j] + S[1, i] * R_f[1, j] + S[2, i] * R_f[2, j]
        for j in range(3):
            B[0, j], B[1, j], B[2, j] = -radius * X[1, j], radius * X[0, j], 0.0
            for i in range(3):
                B[i, 3 + j] = B[3 + i, j] = inverse[f, i, 3 + j] = X[i, j]
                B[3 + i, 3 + j] = inverse[f, i, j] = 0.0
        select(B, table, out[f], bias[f])
        V = table[:, n - 1]
        x = V[1] * V[5] - V[2] * V[4]
        y = V[2] * V[3] - V[0] * V[5]
        z = V[0] * V[4] - V[1] * V[3]
        h = -lowest - level[f]
        for i in range(3):
            h += normal[f, i] * p[index[f], i]
        height[f] = h
        for i in range(3):
            Adot_V[f, i] = X[i, 0] * x + X[i, 1] * y + X[i, 2] * z
            bias[f, i] -= Adot_V[f, i]
            if h <= flies:
                bias[f, i] -= min(max(rate * out[f, i, n - 1], -most), most)


@compiled(NOTHING, v, m, COUNT, F, m, M, V)
def edge(n: Array, R: Array, along: int, radius: float, table: Array, basis: Array, Adot_V: Array) -> None:
    """Of a straight edge on a plane with the normal n, its frame at R: A, then the free row, and Adot V.

    The edge is the frame's axis `along` (0: x, 1: y), and the axis of a cylinder of `radius`. `basis` (6, 6), its rows
    in the order of the axes that are held, is told in the axes of the edge: z is n, the edge lies along x or y.
    """
    V = table[:, table.shape[1] - 1]
    up = n[0] * R[0, along] + n[1] * R[1, along] + n[2] * R[2, along]  # of the edge, which should lie in the plane
    flat = max(math.sqrt(max(1.0 - up * up, 0.0)), 1e-9)
    E, X = np.empty((3, 3)), np.empty((3, 3))  # rows: the axes of the edge in the world, and in the frame
    for i in range(3):
        E[along, i], E[2, i] = (R[i, along] - up * n[i]) / flat, n[i]
    other, sign = 1 - along, 1.0 if along == 1 else -1.0  # x = y x z, y = -(x x z)
    e = E[along]
    E[other, 0] = sign * (e[1] * n[2] - e[2] * n[1])
    E[other, 1] = sign * (e[2] * n[0] - e[0] * n[2])
    E[other, 2] = sign * (e[0] * n[1] - e[1] * n[0])
    for i in range(3):
        for j in range(3):
            X[i, j] = E[i, 0] * R[0, j] + E[i, 1] * R[1, j] + E[i, 2] * R[2, j]
    w, v, a = np.zeros(3), np.zeros(3), np.zeros(3)  # w, v and w x v in the axes of the edge
    for i in range(3):
        for j in range(3):
            w[i] += X[i, j] * V[j]
            v[i] += X[i, j] * V[3 + j]
        a[i] += X[i, 0] * (V[1] * V[5] - V[2] * V[4])
        a[i] += X[i, 1] * (V[2] * V[3] - V[0] * V[5])
        a[i] += X[i, 2] * (V[0] * V[4] - V[1] * V[3])
    basis[:] = 0.0
    for j in range(3):
        basis[0, j], basis[1, j], basis[5, j] = X[other, j], X[2, j], X[along, j]
        basis[2, j], basis[3, j] = -radius * X[1, j], radius * X[0, j]  # w x (-r n)
        for i in range(3):
            basis[2 + i, 3 + j] = X[i, j]
    turning = w[2] - w[along] * up / flat  # of the axes of the edge, about n
    Adot_V[0] = sign * turning * w[along]
    Adot_V[1] = 0.0
    Adot_V[2] = turning * (v[1] + radius * w[0]) + a[0]
    Adot_V[3] = -turning * (v[0] - radius * w[1]) + a[1]
    Adot_V[4] = a[2]


@compiled(F, m, v, v, F, F, F)
def height(R: Array, p: Array, normal: Array, level: float, x: float, y: float) -> float:
    """How far the lowest corner (+-x, +-y, 0) of a frame at (R, p) is above the plane normal . r = level."""
    h, a, b = -level, 0.0, 0.0
    for i in range(3):
        h += normal[i] * p[i]
        a += normal[i] * R[i, 0]
        b += normal[i] * R[i, 1]
    return h - abs(a) * x - abs(b) * y


@compiled(NOTHING, m, v, M, V, V)
def demand(G: Array, rhs: Array, rows: Array, lo: Array, hi: Array) -> None:
    """rows = G and lo = hi = rhs, where they stand in a problem."""
    for i in range(rhs.size):
        lo[i] = hi[i] = rhs[i]
        for j in range(G.shape[1]):
            rows[i, j] = G[i, j]


@compiled(NOTHING, t, m, M, V, V)
def demands(tables: Array, biases: Array, rows: Array, lo: Array, hi: Array) -> None:
    """The same of contacts that hold as many rows each, the first of `tables` and `biases`, one after another."""
    k, n = rows.shape[0] // tables.shape[0], rows.shape[1]
    for f in range(tables.shape[0]):
        for i in range(k):
            row = f * k + i
            lo[row] = hi[row] = biases[f, i]
            for j in range(n):
                rows[row, j] = tables[f, i, j]


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


@compiled(NOTHING, m, v, m, m, v, F, M, V, M, M)
def share(
    push: Array, weight: Array, Y: Array, M_b: Array, bias: Array, scale: float, D: Array, lam: Array, moved: Array,
    metric: Array,
) -> None:  # fmt: skip
    """D = diag(weight)^-1 P' Y, lam -= D (bias + P lam), moved = D M_b of the base's rows M_b (6, n), and the diagonal
    of `metric` is the weight times `scale`."""
    k, n = moved.shape
    r = np.empty(6)
    for a in range(6):
        r[a] = bias[a]
    for i in range(k):
        for a in range(6):
            r[a] += push[i, a] * lam[i]
    for i in range(k):
        metric[i, i] = scale * weight[i]
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
