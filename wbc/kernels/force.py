"""Feedback of forces and of postures."""

from __future__ import annotations

from .compiled import NOTHING, TRUTH, Array, F, V, compiled, m, v


@compiled(NOTHING, m, v, v, V)
def feedback(K: Array, a: Array, b: Array, out: Array) -> None:
    """out += K [a; b]."""
    n = a.size
    for i in range(K.shape[0]):
        s = 0.0
        for j in range(n):
            s += K[i, j] * a[j]
        for j in range(b.size):
            s += K[i, n + j] * b[j]
        out[i] += s


@compiled(NOTHING, m, v, v, v, V)
def spring(K: Array, goal: Array, at: Array, rate: Array, out: Array) -> None:
    """out = K [goal - at; rate]."""
    n = goal.size
    for i in range(K.shape[0]):
        s = 0.0
        for j in range(n):
            s += K[i, j] * (goal[j] - at[j])
        for j in range(rate.size):
            s += K[i, n + j] * rate[j]
        out[i] = s


@compiled(NOTHING, v, v, F, m, v, V, V)
def sense(
    measured: Array, past: Array, alpha: float, inverse: Array, desired: Array, filtered: Array, error: Array
) -> None:
    """filtered = past + alpha (measured - past); error = desired - (A')^+ filtered."""
    for j in range(6):
        filtered[j] = past[j] + alpha * (measured[j] - past[j])
    for i in range(desired.size):
        s = desired[i]
        for j in range(6):
            s -= inverse[i, j] * filtered[j]
        error[i] = s


@compiled(TRUTH, v, v, v, v, F, V, V)
def advance(lam: Array, command: Array, integral: Array, error: Array, dt: float, grown: Array, missing: Array) -> bool:
    """grown = integral + dt error; missing = lam - command. Whether nothing is missing but rounding."""
    for i in range(error.size):
        grown[i] = integral[i] + dt * error[i]
    short, size = 0.0, 1.0
    for i in range(lam.size):
        missing[i] = lam[i] - command[i]
        short += missing[i] * missing[i]
        size += command[i] * command[i]
    return short <= 1e-14 * size
