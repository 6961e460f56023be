"""Whether what is followed has jumped since the last tick, and how far it may go in one."""

from __future__ import annotations

import math

import numpy as np

from .compiled import TRUTH, Array, F, M, V, compiled, m, v


@compiled(TRUTH, m, m, v, m, F, v, M)
def jumped(last: Array, R: Array, p: Array, motion: Array, h: float, least: Array, told: Array) -> bool:
    """Whether a pose (R, p) that moves as `motion` = [V | Vdot] is not where it was to be, h [s] after `last`.

    told (3, 8) = [R | p | motion in two blocks (3, 4)] of now, `last` the same of then. `least`: differences that are a
    jump, of origin [m], angle [rad], speed [m/s] and turning [rad/s].
    """
    for i in range(3):
        told[i, 3] = p[i]
        for j in range(3):
            told[i, j] = R[i, j]
        for j in range(2):
            told[i, 4 + j], told[i, 6 + j] = motion[i, j], motion[3 + i, j]
    far, bend, speed, turning = 0.0, 0.0, 0.0, 0.0
    w, dv = np.empty(3), np.empty(3)
    for i in range(3):
        w[i] = h * last[i, 4]
        dv[i] = h * last[i, 6]
    for i in range(3):
        x = p[i] - last[i, 3]
        for j in range(3):
            x -= last[i, j] * dv[j]
            k, l = (j + 1) % 3, (j + 2) % 3  # column j of R (1 + [w h])
            c = R[i, j] - last[i, j] - last[i, k] * w[l] + last[i, l] * w[k]
            bend += c * c
        far += x * x
        x = motion[i, 0] - last[i, 4] - h * last[i, 5]
        turning += x * x
        x = motion[3 + i, 0] - last[i, 6] - h * last[i, 7]
        speed += x * x
    # the difference of two rotations by an angle a is 2 sqrt(2) sin(a / 2) long
    return (
        far > least[0] * least[0]
        or bend > 8.0 * math.sin(0.5 * least[1]) ** 2
        or speed > least[2] * least[2]
        or turning > least[3] * least[3]
    )


@compiled(TRUTH, v, v, v, F, V)
def approach(last: Array, target: Array, rate: Array, dt: float, out: Array) -> bool:
    """out = target, from `last` by no more than rate dt. Whether that made a difference."""
    late = False
    for i in range(last.size):
        most = rate[i] * dt
        d = target[i] - last[i]
        if abs(d) <= most:
            out[i] = target[i]
        else:
            out[i] = last[i] + math.copysign(most, d)
            late = True
    return late
