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
        """(nv,), (nv,) for this tick; never empty: a last torque outside its limits is led back at the rate."""
        step = self.rate * dt
        low, high = np.maximum(self.low, tau_last - step), np.minimum(self.high, tau_last + step)
        return np.minimum(low, self.high), np.maximum(high, self.low)

    def names(self, tau_last: Array, dt: float, upper: Array) -> list[str]:
        """What bounds each joint: `torque[joint]` or `torque_rate[joint]`."""
        step = self.rate * dt
        rate = np.where(upper, tau_last + step < self.high, tau_last - step > self.low)
        return [f"{'torque_rate' if r else 'torque'}[{joint}]" for r, joint in zip(rate, self.joints, strict=True)]


class JointLimit:
    """Position and velocity limits that the joint can always brake to meet.

    q, v are (nv,) [rad, rad/s]; `a` [rad/s^2] the braking deceleration, `j` [rad/s^3] its build-up; all per joint.
    """

    def __init__(self, q_min: Array, q_max: Array, v_max: Array, a: Array, j: Array, joints: tuple[str, ...]) -> None:
        both = np.concatenate
        self._edge, self._v_max = both((q_max, -q_min)), both((v_max, v_max))
        self.a, self.j, self.joints = both((a, a)), both((j, j)), joints
        self._lag = self.a / self.j  # [s] until the deceleration stands
        self.n = v_max.size

    def viable_speed(self, q: Array) -> Array:
        """(2 nv,) the largest speed towards the upper, then the lower edge from which the joint stops in time."""
        room = np.maximum(self._edge - np.concatenate((q, -q)), 0.0)
        lead = self.a * self._lag
        return np.minimum(np.sqrt(lead * lead + 2.0 * self.a * room) - lead, self._v_max)

    def rows(self, q: Array, v: Array, dt: float) -> Rows:
        """Bounds on vdot [rad/s^2] under which the next state is viable."""
        speed = np.concatenate((v, -v))
        allowed = self.viable_speed(q + dt * v)
        # what the bound on speed itself loses while the joint moves towards the edge
        closing = np.where(allowed < self._v_max, self.a * np.maximum(speed, 0.0) / (allowed + self.a * self._lag), 0.0)
        spare = allowed - speed
        ramp = self.j * dt
        gain = np.sqrt(ramp * ramp + 2.0 * self.j * np.maximum(spare, 0.0)) - ramp
        # beyond the bound: brake with all that the model has, and no more than one tick needs
        most = np.where(spare >= 0.0, gain, np.maximum(spare / dt, -self.a)) - closing
        n = self.n
        high, low = most[:n], -most[n:]
        return Rows("joint", {"vdot": None}, np.minimum(low, high), np.maximum(high, low), labels=self.labels)

    @property
    def labels(self) -> tuple[str, ...]:
        return tuple(f"joint[{joint}]" for joint in self.joints)

    def names(self, q: Array, upper: Array) -> list[str]:
        """What bounds each joint: `velocity[joint]` or `position[joint]`."""
        slow = self.viable_speed(q) < self._v_max
        side = np.where(upper, slow[: self.n], slow[self.n :])
        return [f"{'position' if s else 'velocity'}[{joint}]" for s, joint in zip(side, self.joints, strict=True)]


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
