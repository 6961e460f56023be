"""Limits of torque, its rate, and of joint position and velocity, as rows.

Torque and its rate bound the affine torque map. Position and velocity bound `vdot` such that the joint can always
brake in time: the braking model has a constant deceleration `a` and a constant jerk `j`, the torque rate over the
joint's inertia, so that a joint at speed v needs the distance  v^2 / (2 a) + v a / j  to stop.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .qp import Array, Rows
from .robot import Robot


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
    """

    def __init__(self, q_min: Array, q_max: Array, v_max: Array, a: Array, j: Array, joints: tuple[str, ...]) -> None:
        both = np.concatenate
        self._edge, self._v_max = both((q_max, -q_min)), both((v_max, v_max))
        self.a, self.j, self.joints = both((a, a)), both((j, j)), joints
        self.n = v_max.size
        self._lead = self.a * self.a / self.j  # [rad/s] speed that is lost on the deceleration's build-up
        # farther than this from the edge, position asks nothing of a speed below its limit
        self._far = self._v_max * (self._v_max + 2.0 * self._lead) / (2.0 * self.a)

    def viable_speed(self, q: Array, room: Array | None = None) -> Array:
        """(2 nv,) the largest speed towards the upper, then the lower edge from which the joint stops in time."""
        room = self._edge - np.concatenate((q, -q)) if room is None else room
        speed = np.sqrt(self._lead * self._lead + 2.0 * self.a * np.maximum(room, 0.0)) - self._lead
        return np.minimum(speed, self._v_max)

    def rows(self, q: Array, v: Array, dt: float) -> Rows:
        """Bounds on vdot [rad/s^2] under which the next state is viable."""
        n = self.n
        speed = np.concatenate((v, -v))
        ahead = q + dt * v
        room = self._edge - np.concatenate((ahead, -ahead))
        near = (room - self._far).min() < 0.0
        allowed = self.viable_speed(q, room) if near else self._v_max
        spare = allowed - speed
        ramp = self.j * dt
        most = np.sqrt(ramp * ramp + 2.0 * self.j * np.maximum(spare, 0.0)) - ramp
        if near or spare.min() < 0.0:
            # beyond the bound: brake with all that the model has, and no more than one tick needs
            most = np.where(spare >= 0.0, most, np.maximum(spare / dt, -self.a))
            # what the bound on speed itself loses while the joint moves towards the edge
            closing = self.a * np.maximum(speed, 0.0) / (allowed + self._lead)
            most -= np.where(allowed < self._v_max, closing, 0.0)
            return Rows("joint", {"vdot": None}, np.minimum(-most[n:], most[:n]), np.maximum(-most[n:], most[:n]))
        return Rows("joint", {"vdot": None}, -most[n:], most[:n])

    @property
    def labels(self) -> tuple[str, ...]:
        return tuple(f"joint[{joint}]" for joint in self.joints)

    def name(self, i: int, upper: bool, q: Array) -> str:
        """What bounds joint i on that side: `position[joint]` or `velocity[joint]`."""
        i_side = i if upper else i + self.n
        near = self.viable_speed(q)[i_side] < self._v_max[i_side]
        return f"{'position' if near else 'velocity'}[{self.joints[i]}]"


def braking(robot: Robot, tau_min: Array, tau_max: Array, rate: Array, share: float = 0.5, samples: int = 64) -> tuple[Array, Array]:
    """Deceleration and jerk that each joint can count on, over sampled poses: the share of the torque that gravity
    leaves, and of the rate, over the joint's inertia M_ii."""
    rng = np.random.default_rng(0)
    low, high = np.maximum(robot.q_min, -np.pi), np.minimum(robot.q_max, np.pi)
    spare, inertia = np.full(robot.nv, np.inf), np.zeros(robot.nv)
    for _ in range(samples):
        state = robot.state(rng.uniform(low, high), np.zeros(robot.nv))
        spare = np.minimum(spare, np.minimum(tau_max - state.h, state.h - tau_min))
        inertia = np.maximum(inertia, state.M.diagonal())
    # a motor that cannot even hold the arm up everywhere still brakes with a tenth of its torque
    spare = np.maximum(spare, 0.1 * np.minimum(tau_max, -tau_min))
    finite = np.minimum(share * spare / inertia, 1e3)
    return finite, np.minimum(share * rate / inertia, 1e6)
