"""Bounds on the torque and on the acceleration."""

from __future__ import annotations

import math

from .compiled import NOTHING, Array, F, V, compiled, inner, m, v


@inner
def _closing(gap: float, soft: float, j: float, settle: float) -> float:
    """m(e) of `limit`, and for a gap that is overstepped a return with the time constant T."""
    return min(math.sqrt(soft * soft + j * max(gap, 0.0)) - soft, gap / settle)


@compiled(NOTHING, v, v, F, m, F, V, V)
def braking_bounds(q: Array, v: Array, dt: float, sides: Array, settle: float, lo: Array, hi: Array) -> None:
    """Bounds on vdot of `limit`; `sides` (7, 2 n): edge, v_max, a, l, the way back, j, a_max, upper then lower."""
    n = q.size
    for i in range(n):
        for side in range(2):
            sign = 1.0 - 2.0 * side
            k = i + side * n
            edge, v_max, a, lead, back, j = sides[0, k], sides[1, k], sides[2, k], sides[3, k], sides[4, k], sides[5, k]
            soft = 0.5 * settle * j
            speed, room = sign * v[i], edge - sign * (q[i] + dt * v[i])
            most = min(_closing(v_max - speed, soft, j, settle), sides[6, k])
            if room < math.inf:
                root = math.sqrt(lead * lead + 2.0 * a * max(room, 0.0))
                slope = a / root
                w = root - lead + max(min(room, 0.0) * slope, back)
                most = min(most, _closing(w - speed, soft, j, settle) - slope * speed)
            most = max(most, -a)  # from beyond a limit the model brakes with no more than it has
            if side == 0:
                hi[i] = most
            else:
                lo[i], hi[i] = min(-most, hi[i]), max(-most, hi[i])


@compiled(NOTHING, v, v, v, F, v, v, V, V, V, V)
def torque_window(
    low: Array, high: Array, rate: Array, dt: float, last: Array, bias: Array, least: Array, most: Array,
    lo: Array, hi: Array,
) -> None:  # fmt: skip
    """Limits of the torque after one tick from `last`; lo and hi are those of what is added to `bias`."""
    for i in range(last.size):
        least[i] = max(low[i], last[i] - rate[i] * dt)
        most[i] = min(high[i], last[i] + rate[i] * dt)
        lo[i], hi[i] = least[i] - bias[i], most[i] - bias[i]
