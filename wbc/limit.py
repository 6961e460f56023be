"""Limits of torque, its rate, and of joint position and velocity, as rows.

Torque and its rate bound the affine torque map. Position and velocity bound `vdot` such that the joint can always
brake in time with a deceleration `a` that builds up at a jerk `j`. With d [rad] the room to the edge and v the speed
towards it, a state is kept where

    v <= w(d) = sqrt(l^2 + 2 a d) - l,     l = 2 a^2 / j        a joint that follows w brakes with at most a
    vdot <= m(w - v) - w'(d) v,     m(e) = sqrt(c^2 + j e) - c,     c = j T / 2

and where vdot <= m(v_max - v). The second line keeps the gap e = w - v from ever closing (de/dt >= -m(e)), and spends
half of the jerk on it; the bend of w takes less than the other half. Near the edge both end exponentially, m with the
time constant T, so that a joint that is pressed into its limit comes to rest there.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from .errors import GainError
from .qp import Array, Rows
from .robot import Robot

SETTLE = 0.01  # T [s]


@dataclass(frozen=True)
class TorqueLimit:
    """tau_min <= tau <= tau_max, and |tau - tau_last| <= rate dt.

    Limits are (nv,) [N m]; `rate` (nv,) [N m/s], infinite for none. They hold for the whole torque of the motors, also
    when the driver adds the gravity part.
    """

    low: Array
    high: Array
    rate: Array
    joints: tuple[str, ...]

    def bounds(self, tau_last: Array, dt: float) -> tuple[Array, Array]:
        """(nv,), (nv,) for this tick; never empty, for `tau_last` lies within the limits (see `inside`)."""
        step = self.rate * dt
        return np.maximum(self.low, tau_last - step), np.minimum(self.high, tau_last + step)

    def inside(self, tau: Array) -> Array:
        """A torque from outside, led into the limits."""
        return np.minimum(np.maximum(tau, self.low), self.high)

    def name(self, i: int, upper: bool, tau_last: Array, dt: float) -> str:
        """What bounds joint i on that side: `torque[joint]` or `torque_rate[joint]`."""
        step = self.rate[i] * dt
        rate = tau_last[i] + step < self.high[i] if upper else tau_last[i] - step > self.low[i]
        return f"{'torque_rate' if rate else 'torque'}[{self.joints[i]}]"

    @property
    def labels(self) -> tuple[str, ...]:
        return tuple(f"torque[{joint}]" for joint in self.joints)


class JointLimit:
    """Position and velocity limits that the joint can always brake to meet.

    q, v are (nv,) [rad, rad/s]; `a` [rad/s^2] the braking deceleration, `j` [rad/s^3] its build-up; all per joint.
    Infinite limits bind nothing.
    """

    def __init__(self, q_min: Array, q_max: Array, v_max: Array, a: Array, j: Array, joints: tuple[str, ...]) -> None:
        both = np.concatenate
        self.n, self.joints = v_max.size, joints
        self._sides = np.concatenate((np.eye(self.n), -np.eye(self.n)))  # towards the upper, then the lower edge
        self._edge, self._v_max, self.j = both((q_max, -q_min)), both((v_max, v_max)), both((j, j))
        # the distance to stop from v_max, v^2 / (2 a) + 2 v a / j, is shortest at this deceleration
        self.a = np.minimum(both((a, a)), 0.5 * np.sqrt(self._v_max * self.j))
        self._lead = np.maximum(2.0 * self.a * self.a / self.j, self.a * SETTLE)  # [rad/s] l, w'(0) <= 1/T
        self._lead2 = self._lead * self._lead
        self._back = -np.minimum(0.1 * self.a, self._v_max)  # [rad/s] the way back from beyond the edge
        self._soft = 0.5 * SETTLE * self.j  # [rad/s^2] c
        self._soft2 = self._soft * self._soft
        self._top, self._slow = self._soft2 + self.j * self._v_max, self.j[:, None] * self._sides
        self._clear = self._edge - self._asks_from()

    def _asks_from(self) -> Array:
        """(2 nv,) room [rad] beyond which position asks nothing, at any speed, that velocity does not ask."""
        far = np.full(2 * self.n, np.inf)
        for i in np.flatnonzero(np.isfinite(self._v_max)):
            top = self._v_max[i]
            w = top * np.linspace(1.0, 9.0, 161)[:, None]
            v = top * np.linspace(0.0, 1.0, 21)
            position, velocity = (np.sqrt(self._soft2[i] + self.j[i] * gap) - self._soft[i] for gap in (w - v, top - v))
            free = (position - self.a[i] * v / (w + self._lead[i]) >= velocity).all(axis=1)
            if free.any():
                first = w[free.argmax(), 0]
                far[i] = first * (first + 2.0 * self._lead[i]) / (2.0 * self.a[i])
        return np.where(np.isfinite(self._edge), far, -np.inf)

    def _curve(self, room: Array) -> tuple[Array, Array]:
        """w(d) [rad/s] and w'(d) [1/s]; beyond the edge w asks the joint to come back, slowly."""
        root = np.sqrt(self._lead2 + 2.0 * self.a * np.maximum(room, 0.0))
        slope = self.a / root
        return root - self._lead + np.maximum(np.minimum(room, 0.0) * slope, self._back), slope

    def _closing(self, gap: Array) -> Array:
        """m(e), and for a gap that is overstepped a return with the time constant T."""
        return np.minimum(np.sqrt(self._soft2 + self.j * np.maximum(gap, 0.0)) - self._soft, gap / SETTLE)

    def viable_speed(self, q: Array) -> Array:
        """(2 nv,) the largest speed towards the upper, then the lower edge from which the joint stops in time.

        It holds for a joint that does not accelerate yet: m(w - v) = w' v.
        """
        w, slope = self._curve(self._edge - self._sides.dot(q))
        w = np.maximum(w, 0.0)
        b = slope * self._soft + 0.5 * self.j
        reach = np.where(np.isfinite(w), w, 0.0)
        speed = self.j * reach / (b + np.sqrt(b * b + self.j * reach * slope * slope))
        return np.minimum(np.where(np.isfinite(w), speed, np.inf), self._v_max)

    def rows(self, q: Array, v: Array, dt: float) -> Rows:
        """Bounds on vdot [rad/s^2] under which the next state is viable."""
        n = self.n
        ahead = self._sides.dot(q + dt * v)
        if min((self._clear - ahead).tolist()) > 0.0:  # only velocity asks: m(v_max - v)
            under_root = self._top - self._slow.dot(v)
            if min(under_root.tolist()) > 0.0:
                most = np.sqrt(under_root)
                most -= self._soft
                if min(most.tolist()) >= 0.0:
                    return Rows("joint", {"vdot": None}, -most[n:], most[:n])
        speed = self._sides.dot(v)
        spare = self._v_max - speed
        w, slope = self._curve(self._edge - ahead)
        most = np.minimum(self._closing(spare), self._closing(w - speed) - slope * speed)
        most = np.maximum(most, -self.a)  # from beyond a limit the model brakes with no more than it has
        return Rows("joint", {"vdot": None}, np.minimum(-most[n:], most[:n]), np.maximum(-most[n:], most[:n]))

    @property
    def labels(self) -> tuple[str, ...]:
        return tuple(f"joint[{joint}]" for joint in self.joints)

    def name(self, i: int, upper: bool, q: Array) -> str:
        """What bounds joint i on that side: `position[joint]` or `velocity[joint]`."""
        i_side = i if upper else i + self.n
        near = self.viable_speed(q)[i_side] < self._v_max[i_side]
        return f"{'position' if near else 'velocity'}[{self.joints[i]}]"


def braking(robot: Robot, tau_min: Array, tau_max: Array, rate: Array, samples: int = 64) -> tuple[Array, Array]:
    """Deceleration (nv,) and its build-up (nv,) that all joints can count on together, over sampled poses.

    The torque that gravity leaves must yield M a, and its rate M j: the joints push one another through M, so an
    inertia of its own would promise each of them too much.
    """
    rng = np.random.default_rng(0)
    low, high = np.maximum(robot.q_min, -np.pi), np.minimum(robot.q_max, np.pi)
    spare, inertia = np.full(robot.nv, np.inf), np.zeros((robot.nv, robot.nv))
    for _ in range(samples):
        state = robot.state(rng.uniform(low, high), np.zeros(robot.nv))
        spare = np.minimum(spare, np.minimum(tau_max - state.h, state.h - tau_min))
        inertia = np.maximum(inertia, np.abs(state.M))
    # a motor that cannot even hold the arm up everywhere still brakes with a tenth of its torque
    spare = np.maximum(spare, 0.1 * np.minimum(tau_max, -tau_min))
    return np.minimum(_fair(inertia, spare), 1e3), np.minimum(_fair(inertia, rate), 1e6)


def _fair(inertia: Array, effort: Array) -> Array:
    """x (nv,) of the largest product with sum_j (inertia_ij x_j)^2 <= effort_i^2 for all i: signs are independent."""
    rows = (inertia / np.clip(effort, 1e-6, 1e9)[:, None]) ** 2
    price = np.ones(len(rows))
    for _ in range(100):
        x2 = 1.0 / (price @ rows)
        price = price * np.sqrt(rows @ x2)
    return np.asarray(np.sqrt(x2 / (rows @ x2).max()))


def make_limits(robot: Robot, limits: Mapping[str, Any]) -> tuple[TorqueLimit, JointLimit | None]:
    """Limits from `torque`, `torque_rate`, `position`, `velocity`: "model", a number or (nv,) within it, or None."""
    n = robot.nv

    def value(name: str, model: Array) -> Array:
        given = limits.get(name, "model")
        if given is None:
            return np.full(n, np.inf)
        if isinstance(given, str):
            return model
        given = np.broadcast_to(np.asarray(given, float), (n,))
        if not (given > 0).all():
            raise GainError(f"limits.{name}: expected positive numbers, got {given}")
        return np.minimum(given, np.abs(model))

    free = np.full(n, np.inf)
    high = value("torque", np.minimum(robot.tau_max, -robot.tau_min))
    if limits.get("torque", "model") is not None:
        low, high = np.maximum(robot.tau_min, -high), np.minimum(robot.tau_max, high)
    else:
        low = -high
    rate = value("torque_rate", free)
    torque = TorqueLimit(low, high, rate, robot.joints)
    position, v_max = limits.get("position", "model"), value("velocity", robot.v_max)
    if robot.nq != n or (position is None and not np.isfinite(v_max).any()):
        return torque, None
    margin = float(position) if isinstance(position, (int, float)) else 0.0
    q_min, q_max = (free * -1, free) if position is None else (robot.q_min + margin, robot.q_max - margin)
    a, j = braking(robot, low, high, rate)
    return torque, JointLimit(q_min, q_max, v_max, a, j, robot.joints)
