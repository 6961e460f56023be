"""Feedback of forces and of postures."""

from __future__ import annotations

import math

from numba import types

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


@compiled(TRUTH, v, v, F, m, v, m, v, F, V, V)
def sense(
    measured: Array, past: Array, alpha: float, inverse: Array, desired: Array, A: Array, target: Array, share: float,
    filtered: Array, error: Array,
) -> bool:  # fmt: skip
    """filtered = past + alpha (measured - past); error = desired - (A')^+ filtered.

    Whether the filtered force has `share` of the target's along it, f'f_d >= share f_d'f_d with f_d of A' target.
    """
    for j in range(6):
        filtered[j] = past[j] + alpha * (measured[j] - past[j])
    for i in range(desired.size):
        s = desired[i]
        for j in range(6):
            s -= inverse[i, j] * filtered[j]
        error[i] = s
    along, square = 0.0, 0.0
    for j in range(3, 6):
        f_d = 0.0
        for i in range(target.size):
            f_d += A[i, j] * target[i]
        along += filtered[j] * f_d
        square += f_d * f_d
    return along >= share * square  # also where no force is wanted


@compiled(TRUTH, v, v, v, v, F, TRUTH, V, V)
def advance(
    lam: Array, command: Array, integral: Array, error: Array, dt: float, pressed: bool, grown: Array, missing: Array
) -> bool:
    """grown = integral + dt error, of what is not `pressed` only as far as towards zero; missing = lam - command.

    Whether nothing is missing but rounding.
    """
    for i in range(error.size):
        grown[i] = integral[i] + dt * error[i]
        if not pressed and grown[i] * error[i] > 0.0:
            grown[i] = integral[i] if integral[i] * error[i] > 0.0 else 0.0
    short, size = 0.0, 1.0
    for i in range(lam.size):
        missing[i] = lam[i] - command[i]
        short += missing[i] * missing[i]
        size += command[i] * command[i]
    return short <= 1e-14 * size


@compiled(types.UniTuple(F, 6), v, m, m, v, v, v, v, F, v, F, F, V, V)  # type: ignore[no-untyped-call]
def press(
    measured: Array, inverse: Array, A: Array, lam: Array, offset: Array, desired: Array, slip: Array, alpha: float,
    tipped: Array, dt: float, fade: float, grown: Array, tips: Array,
) -> tuple[float, float, float, float, float, float]:  # fmt: skip
    """How a reading fits to what was pressed with: measured, asked and wanted force, speed, surprise, tilt.

    Along the force of A' desired [N]: the measured force, that of the last multipliers `lam`, the desired one, and the
    speed [m/s] of the frame; then |f| [N] of A' (lambda_m - lam - offset), lambda_m = (A')^+ F. `grown` = offset +
    alpha (lambda_m - lam - offset). `tips` (3,) = fade (tipped + dt w), w the turning [rad/s] of A^+ slip; the tilt is
    its length.
    """
    k = lam.size
    had, asked, wanted, odd = 0.0, 0.0, 0.0, 0.0
    for j in range(3, 6):
        f_m, f_c, f_d, f_e = 0.0, 0.0, 0.0, 0.0
        for i in range(k):
            read = 0.0
            for n in range(6):
                read += inverse[i, n] * measured[n]
            f_m += A[i, j] * read
            f_c += A[i, j] * lam[i]
            f_d += A[i, j] * desired[i]
            f_e += A[i, j] * (read - lam[i] - offset[i])
        had += f_m * f_d
        asked += f_c * f_d
        wanted += f_d * f_d
        odd += f_e * f_e
    for i in range(k):
        read = 0.0
        for n in range(6):
            read += inverse[i, n] * measured[n]
        grown[i] = offset[i] + alpha * (read - lam[i] - offset[i])
    size = math.sqrt(wanted)
    power = 0.0
    for i in range(k):
        power += desired[i] * slip[i]
    tilt = 0.0
    for j in range(3):
        w = 0.0
        for i in range(k):
            w += slip[i] * inverse[i, j]
        tips[j] = fade * (tipped[j] + dt * w)
        tilt += tips[j] * tips[j]
    if size > 0.0:
        return had / size, asked / size, size, power / size, math.sqrt(odd), math.sqrt(tilt)
    return 0.0, 0.0, 0.0, 0.0, math.sqrt(odd), math.sqrt(tilt)
