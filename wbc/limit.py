"""Limits of torque, its rate, and of joint position, velocity and acceleration, as rows.

Torque and its rate bound the affine torque map. Position and velocity bound `vdot` such that the joint can always
brake in time with a deceleration `a` that builds up at a jerk `j`. With d [rad] the room to the edge and v the speed
towards it, a state is kept where

    v <= w(d) = sqrt(l^2 + 2 a d) - l,     l = 2 a^2 / j        a joint that follows w brakes with at most a
    vdot <= m(w - v) - w'(d) v,     m(e) = sqrt(c^2 + j e) - c,     c = j T / 2

and where vdot <= m(v_max - v). The second line keeps the gap e = w - v from ever closing (de/dt >= -m(e)), and spends
half of the jerk on it; the bend of w takes less than the other half. Near the edge both end exponentially, m with the
time constant T, so that a joint that is pressed into its limit comes to rest there.

An acceleration limit bounds |vdot| <= a_max beside these. No bound is ever empty: `a` is chosen no larger than a_max,
every line above brakes with `a` at most, from beyond a limit too, and so the least that one side asks for and the most
that the other allows always leave [-a, a] in common with [-a_max, a_max].
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from .errors import GainError
from .kernels import braking_bounds, torque_window
from .qp import Array, Rows
from .robot import Robot

if TYPE_CHECKING:
    from .collision import SelfCollision

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

    def window(self, tau_last: Array, dt: float, bias: Array, rows: Rows) -> tuple[Array, Array]:
        """(nv,), (nv,) least and most torque of this tick; `rows` get them as bounds of what is added to `bias`.

        Never empty, for `tau_last` lies within the limits (see `inside`).
        """
        least, most = np.empty(tau_last.size), np.empty(tau_last.size)
        torque_window(self.low, self.high, self.rate, dt, tau_last, bias, least, most, rows.lo, rows.hi)
        return least, most

    def bounds(self, tau_last: Array, dt: float) -> tuple[Array, Array]:
        """(nv,), (nv,) least and most torque of this tick."""
        n = tau_last.size
        return self.window(tau_last, dt, np.zeros(n), Rows("", {}, np.empty(n), np.empty(n)))

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
    """Position, velocity and acceleration limits that the joint can always brake to meet.

    q, v are (nv,) [rad, rad/s]; `a` [rad/s^2] the braking deceleration, `j` [rad/s^3] its build-up; all per joint.
    `a_max` [rad/s^2] bounds the acceleration itself, and with it `a`; None for none. Infinite limits bind nothing. Of a
    floating base (`FloatingJointLimit`) these are the joints alone.
    """

    def __init__(
        self,
        q_min: Array,
        q_max: Array,
        v_max: Array,
        a: Array,
        j: Array,
        joints: tuple[str, ...],
        a_max: Array | None = None,
    ) -> None:
        both = np.concatenate
        self.a_max = np.full(v_max.size, np.inf) if a_max is None else a_max
        a = np.minimum(a, self.a_max)
        self.n, self.joints = v_max.size, joints
        # of each: towards the upper, then the lower edge
        self._edge, self._v_max, self.j = both((q_max, -q_min)), both((v_max, v_max)), both((j, j))
        # the distance to stop from v_max, v^2 / (2 a) + 2 v a / j, is shortest at this deceleration
        self.a = np.minimum(both((a, a)), 0.5 * np.sqrt(self._v_max * self.j))
        self._lead = np.maximum(2.0 * self.a * self.a / self.j, self.a * SETTLE)  # [rad/s] l, w'(0) <= 1/T
        back = -np.minimum(0.1 * self.a, self._v_max)  # [rad/s] the way back from beyond the edge
        self._table = np.stack(
            (self._edge, self._v_max, self.a, self._lead, back, self.j, both((self.a_max, self.a_max)))
        )

    def viable_speed(self, q: Array) -> Array:
        """(2 nv,) the largest speed towards the upper, then the lower edge from which the joint stops in time.

        It holds for a joint that does not accelerate yet: m(w - v) = w' v.
        """
        room = np.maximum(self._edge - np.concatenate((q, -q)), 0.0)
        root = np.sqrt(self._lead**2 + 2.0 * self.a * room)
        w, slope = root - self._lead, self.a / root
        b = 0.5 * self.j * (slope * SETTLE + 1.0)
        reach = np.where(np.isfinite(w), w, 0.0)
        speed = self.j * reach / (b + np.sqrt(b * b + self.j * reach * slope * slope))
        return np.minimum(np.where(np.isfinite(w), speed, np.inf), self._v_max)

    def fill(self, q: Array, v: Array, dt: float, rows: Rows) -> None:
        """Bounds on vdot [rad/s^2] under which the next state is viable."""
        braking_bounds(q, v, dt, self._table, SETTLE, rows.lo, rows.hi)

    def rows(self, q: Array, v: Array, dt: float) -> Rows:
        """Rows of their own with these bounds."""
        rows = Rows("joint", {"vdot": None}, np.empty(self.n), np.empty(self.n))
        self.fill(q, v, dt, rows)
        return rows

    @property
    def labels(self) -> tuple[str, ...]:
        return tuple(f"joint[{joint}]" for joint in self.joints)

    def name(self, i: int, upper: bool, q: Array, bound: float = 0.0) -> str:
        """What bounds joint i on that side: `position[joint]`, `velocity[joint]`, or where `bound`, which is that of
        vdot, is the acceleration limit, `acceleration[joint]`."""
        if abs(bound) >= self.a_max[i]:
            return f"acceleration[{self.joints[i]}]"
        i_side = i if upper else i + self.n
        near = self.viable_speed(q)[i_side] < self._v_max[i_side]
        return f"{'position' if near else 'velocity'}[{self.joints[i]}]"


class FloatingJointLimit(JointLimit):
    """The same of a robot with a floating base, whose six velocities come first and have no limits."""

    def viable_speed(self, q: Array) -> Array:
        return super().viable_speed(q[7:])

    def fill(self, q: Array, v: Array, dt: float, rows: Rows) -> None:
        braking_bounds(q[7:], v[6:], dt, self._table, SETTLE, rows.lo[6:], rows.hi[6:])

    def rows(self, q: Array, v: Array, dt: float) -> Rows:
        rows = Rows("joint", {"vdot": None}, np.full(6 + self.n, -np.inf), np.full(6 + self.n, np.inf))
        self.fill(q, v, dt, rows)
        return rows

    @property
    def labels(self) -> tuple[str, ...]:
        return (*(f"base[{i}]" for i in range(6)), *super().labels)


def braking(robot: Robot, tau_min: Array, tau_max: Array, rate: Array, samples: int = 64) -> tuple[Array, Array]:
    """Deceleration (nv,) and its build-up (nv,) that all joints can count on together, over sampled poses.

    The torque that gravity leaves must yield M a, and its rate M j: the joints push one another through M, so an
    inertia of its own would promise each of them too much. What a floating base loads its joints with is the contacts'
    affair: there half of the torque counts as spare, and the base as held.
    """
    rng = np.random.default_rng(0)
    low, high = np.maximum(robot.q_min, -np.pi), np.minimum(robot.q_max, np.pi)
    spare, inertia = np.full(robot.nu, np.inf), np.zeros((robot.nu, robot.nu))
    for _ in range(samples):
        state = robot.state(robot.posed(rng.uniform(low, high)), np.zeros(robot.nv))
        load = state.h[robot.base :]
        spare = np.minimum(spare, np.minimum(tau_max - load, load - tau_min))
        inertia = np.maximum(inertia, np.abs(state.M[robot.base :, robot.base :]))
    if robot.base:
        spare = 0.5 * np.minimum(tau_max, -tau_min)
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


def make_collision(robot: Robot, given: Any) -> SelfCollision | None:
    """From `self_collision` of the limits: a distance [m], a mapping of `SelfCollision`'s parameters, or None."""
    if given is None:
        return None
    from .collision import SelfCollision  # its arithmetic is loaded where it is used

    if isinstance(given, SelfCollision):
        return given
    given = given if isinstance(given, Mapping) else {"distance": float(given)}
    if not {"distance"} <= set(given) <= {"distance", "deceleration", "rows"}:
        raise GainError(f"limits.self_collision: expected distance, deceleration and rows, got {', '.join(given)}")
    return SelfCollision(robot, **given)


def make_limits(robot: Robot, limits: Mapping[str, Any]) -> tuple[TorqueLimit, JointLimit | None]:
    """Limits from `torque`, `torque_rate`, `position`, `velocity`, `acceleration`.

    Each is "model", a number or (nu,) within the model's, or None.
    """
    n = robot.nu

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
    position, v_max, a_max = (
        limits.get("position", "model"),
        value("velocity", robot.v_max),
        value("acceleration", free),
    )
    unbound = position is None and not (np.isfinite(v_max).any() or np.isfinite(a_max).any())
    if robot.nq != n + (7 if robot.base else 0) or unbound:
        return torque, None
    margin = float(position) if isinstance(position, (int, float)) else 0.0
    q_min, q_max = (free * -1, free) if position is None else (robot.q_min + margin, robot.q_max - margin)
    a, j = braking(robot, low, high, rate)
    kind = FloatingJointLimit if robot.base else JointLimit
    return torque, kind(q_min, q_max, v_max, a, j, robot.joints, a_max)
