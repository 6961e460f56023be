"""The quadratic program: its rows, costs and certificate, and the torque that comes of it."""

from __future__ import annotations

import math

import numpy as np

from .compiled import COUNT, NOTHING, THREE, TRUTH, Array, F, M, V, compiled, m, v


@compiled(NOTHING, m, v, F, M, V)
def add_square(metric: Array, target: Array, weight: float, H: Array, g: Array) -> None:
    """Adds weight / 2 |x - target|^2 in the metric to H and g."""
    n = target.size
    for i in range(n):
        s = 0.0
        for j in range(n):
            H[i, j] += weight * metric[i, j]
            s += metric[i, j] * target[j]
        g[i] -= weight * s


@compiled(NOTHING, m, m, v, F, M, V)
def add_rows(A: Array, metric: Array, target: Array, weight: float, H: Array, g: Array) -> None:
    """Adds weight / 2 |A x - target|^2 in the metric to H and g."""
    m, n = A.shape
    C, WA, S = np.empty((m, n)), np.zeros((m, n)), np.zeros((n, n))
    for i in range(m):
        for j in range(n):
            C[i, j] = A[i, j]
    for i in range(m):
        for k in range(m):
            w = weight * metric[i, k]
            if w != 0.0:
                for j in range(n):
                    WA[i, j] += w * C[k, j]
    for k in range(m):
        t = target[k]
        for j in range(n):
            g[j] -= t * WA[k, j]
        for i in range(n):
            c = C[k, i]
            if c != 0.0:
                for j in range(i + 1):
                    S[i, j] += c * WA[k, j]
    for i in range(n):
        H[i, i] += S[i, i]
        for j in range(i):
            H[i, j] += S[i, j]
            H[j, i] += S[i, j]


@compiled(NOTHING, m, m, v, M, M, V)
def equations(M: Array, push: Array, bias: Array, base: Array, joints: Array, nothing: Array) -> None:
    """[M, push'], its first rows in `base` and the others in `joints`; nothing = -bias of the first."""
    n, k, b = M.shape[0], push.shape[0], base.shape[0]
    for i in range(b):
        for j in range(n):
            base[i, j] = M[i, j]
        for j in range(k):
            base[i, n + j] = push[j, i]
        nothing[i] = -bias[i]
    for i in range(n - b):
        for j in range(n):
            joints[i, j] = M[b + i, j]
        for j in range(k):
            joints[i, n + j] = push[j, b + i]


@compiled(THREE, m, v, v, v, COUNT, v, v)
def residuals(
    stack: Array, g: Array, lo: Array, hi: Array, n_eq: int, x: Array, z: Array
) -> tuple[float, float, float]:
    """Primal, dual (2-norms) and gap (largest) of the conditions of `qp.Certificate`, `stack` = [H; C]."""
    n = g.size
    primal, dual, gap = 0.0, 0.0, 0.0
    r = np.empty(n)
    for j in range(n):
        r[j] = g[j] + z[j]
    for i in range(n):
        for j in range(n):
            r[j] += stack[i, j] * x[i]  # H is symmetric
    for i in range(lo.size):
        value = x[i] if i < n else 0.0
        if i >= n:
            for j in range(n):
                value += stack[i, j] * x[j]
                r[j] += stack[i, j] * z[i]
        if not (lo[i] <= value <= hi[i]):  # also where bounds cross, or one is not a number
            outside = np.maximum(value, lo[i]) - np.minimum(value, hi[i])
            primal += outside * outside
        if z[i] != 0.0 and (i < n or i >= n + n_eq):
            power = abs(z[i] * (value - (hi[i] if z[i] > 0.0 else lo[i])))
            if not (power <= gap or math.isnan(gap)):
                gap = power
    for j in range(n):
        dual += r[j] * r[j]
    return math.sqrt(primal), math.sqrt(dual), gap


@compiled(TRUTH, v, COUNT, COUNT, F)
def active(z: Array, first: int, last: int, least: float) -> bool:
    """Whether a multiplier exceeds `least`, those from `first` to `last` aside."""
    most = 0.0
    for i in range(z.size):
        if i < first or i >= last:
            most = max(most, abs(z[i]))
    return most > least


@compiled(F, v)
def square(values: Array) -> float:
    """The sum of squares: a number only where all of them are."""
    s = 0.0
    for i in range(values.size):
        s += values[i] * values[i]
    return s


@compiled(F, v)
def total(values: Array) -> float:
    """The sum: a number only where all of them are."""
    s, t, u, w = 0.0, 0.0, 0.0, 0.0  # four at a time: each waits for its own last sum alone
    last = values.size - values.size % 4
    for i in range(0, last, 4):
        s += values[i]
        t += values[i + 1]
        u += values[i + 2]
        w += values[i + 3]
    for i in range(last, values.size):
        s += values[i]
    return (s + t) + (u + w)


@compiled(NOTHING, m, v, v, v, v, V)
def torque(A: Array, x: Array, b: Array, lo: Array, hi: Array, tau: Array) -> None:
    """tau = A x + b, led into its bounds."""
    for i in range(tau.size):
        s = b[i]
        for j in range(x.size):
            s += A[i, j] * x[j]
        tau[i] = min(max(s, lo[i]), hi[i])
