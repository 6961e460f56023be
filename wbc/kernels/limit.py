"""Bounds on the torque and on the acceleration."""

from __future__ import annotations

import math

from .compiled import NOTHING, Array, F, V, compiled, inner, m, v


@inner
def _closing(gap: float, soft: float, j: float, settle: float) -> float:
    """m(e) of `limit`, and for a gap that is overstepped a return with the time constant T."""
    return min(math.sqrt(soft * soft + j * max(gap, 0.0)) - soft, gap / settle)


@inner
def _towards(room: float, speed: float, a: float, lead: float, back: float, j: float, settle: float) -> float:
    """m(w - v) - w' v of `limit`, at a `room` to the edge that is closed with v = `speed`."""
    root = math.sqrt(lead * lead + 2.0 * a * max(room, 0.0))
    w, slope = root - lead, a / root
    if room < 0.0:  # beyond it: back along the same slope, no faster than `back`
        w = room * slope
        if w < back:
            w, slope = back, 0.0
    return _closing(w - speed, 0.5 * settle * j, j, settle) - slope * speed


@compiled(NOTHING, v, v, F, m, F, V, V)
def braking_bounds(q: Array, v: Array, dt: float, sides: Array, settle: float, lo: Array, hi: Array) -> None:
    """Bounds on vdot of `limit`; `sides` (7, 2 n): edge, v_max, a, l, the way back, j, a_max, upper then lower."""
    n = q.size
    for i in range(n):
        for side in range(2):
            sign = 1.0 - 2.0 * side
            k = i + side * n
            edge, v_max, a, lead, back, j = sides[0, k], sides[1, k], sides[2, k], sides[3, k], sides[4, k], sides[5, k]
            speed, room = sign * v[i], edge - sign * (q[i] + dt * v[i])
            most = min(_closing(v_max - speed, 0.5 * settle * j, j, settle), sides[6, k])
            if room < math.inf:
                most = min(most, _towards(room, speed, a, lead, back, j, settle))
            most = max(most, -a)  # from beyond a limit the model brakes with no more than it has
            if side == 0:
                hi[i] = most
            else:
                lo[i], hi[i] = min(-most, hi[i]), max(-most, hi[i])


@compiled(NOTHING, m, v, F, V)
def apart(told: Array, law: Array, dt: float, lo: Array) -> None:
    """lo of dddot - drift of distances, `told` (rows, 3) = d, ddot and drift; of one that is infinite, -infinite.

    `law`: the distance to keep, a, l, the way back, j and T.
    """
    for i in range(told.shape[0]):
        if told[i, 0] == math.inf:
            lo[i] = -math.inf
            continue
        most = _towards(told[i, 0] + dt * told[i, 1] - law[0], -told[i, 1], law[1], law[2], law[3], law[4], law[5])
        lo[i] = -max(most, -law[1]) - told[i, 2]


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
