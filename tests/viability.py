"""Which states a joint can be stopped from in time: theory, by no code of the package.

A joint is a double integrator whose acceleration |vdot| <= a is held for a tick; it has to stay within its range and
its speed. After Del Prete (2018), "Joint position and velocity bounds in discrete-time acceleration/torque control of
robot arms", IEEE RA-L 3(1): a state is viable when the hardest brake, tick by tick, stops within the room that is left;
a command is viable when the state after its tick is. All of one side, that of the positive direction: `room` [rad] to
the edge, `v` [rad/s] towards it. The other side is the same with the signs turned.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def stopping(v: Array, a: Array, dt: float) -> Array:
    """Way of the shortest stop [rad]: whole ticks at -a, and one with what is left of the speed."""
    v = np.maximum(v, 0.0)
    last = v - np.floor(v / (a * dt)) * (a * dt)
    return np.asarray((v * v - last * last) / (2.0 * a) + 0.5 * last * dt)


def smooth_stopping(v: Array, a: Array, j: Array) -> Array:
    """The same of a brake that builds up and lets go at a jerk j, from vdot = 0, in continuous time."""
    v = np.maximum(v, 0.0)
    full = v * v / (2.0 * a) + v * a / (2.0 * j)  # reaches a
    return np.where(v * j < a * a, np.sqrt(v**3 / j), full)


def viable(room: Array, v: Array, a: Array, v_max: Array, dt: float, slack: float = 0.0) -> NDArray[np.bool_]:
    """Whether a joint can stay within its edge and speed from here on."""
    return np.asarray((stopping(v, a, dt) <= room + slack) & (v <= v_max + slack))


def most(room: Array, v: Array, a: Array, v_max: Array, dt: float) -> Array:
    """The largest acceleration within [-a, a] after whose tick the state is viable; below -a where none is."""

    def allowed(vdot: Array) -> NDArray[np.bool_]:
        after = v + dt * vdot
        turned = (v > 0.0) & (after < 0.0)  # it turns within the tick: that is as far as it gets
        way = np.where(turned, v * v / (2.0 * np.maximum(-vdot, 1e-300)), dt * v + 0.5 * dt * dt * vdot)
        return viable(room - way, np.where(turned, 0.0, after), a, v_max, dt)

    low, high = -a * np.ones_like(v), a * np.ones_like(v)
    none, all_ = ~allowed(low), allowed(high)
    for _ in range(60):
        middle = 0.5 * (low + high)
        good = allowed(middle)
        low, high = np.where(good, middle, low), np.where(good, high, middle)
    return np.where(none, -np.inf, np.where(all_, a, low))
