"""How what is followed leads into a reference from somewhere else, and comes to rest on it: quintics in time.

With u = s / T, all zero with their first two derivatives at u = 1, at u = 0 position, velocity and acceleration are

    fall   1, 0, 0      1 - u^3 (10 - 15 u + 6 u^2)             slope at most 1.875 / T, bend 5.78 / T^2
    run    0, 1, 0      T u (1 - u^2 (6 - 8 u + 3 u^2))
    turn   0, 0, 1      T^2 u^2 (1 - u)^3 / 2
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pinocchio as pin

from .kernels import log
from .qp import Array
from .reference import Sample, advanced

SLOPE = 1.875  # the largest of `fall`, times T
SETTLE = 0.5  # [s] in which a difference in twist and acceleration dies out; a way takes as long, or longer

Values = tuple[float, float, float]


def fall(u: float, T: float) -> Values:
    """Value, slope and bend."""
    return (
        1.0 - u**3 * (10.0 - 15.0 * u + 6.0 * u * u),
        -30.0 * (u * (1.0 - u)) ** 2 / T,
        -60.0 * u * (1.0 - u) * (1.0 - 2.0 * u) / T**2,
    )


def run(u: float, T: float) -> Values:
    """The same."""
    return (
        T * u * (1.0 - u * u * (6.0 - 8.0 * u + 3.0 * u * u)),
        1.0 - u * u * (18.0 - 32.0 * u + 15.0 * u * u),
        -u * (36.0 - 96.0 * u + 60.0 * u * u) / T,
    )


def turn(u: float, T: float) -> Values:
    """The same."""
    w = 1.0 - u
    return (
        0.5 * T * T * u * u * w**3,
        0.5 * T * u * w * w * (2.0 - 5.0 * u),
        w * (1.0 - 8.0 * u + 10.0 * u * u),
    )


class Lead(NamedTuple):
    """What was followed until the time `t` [s], on the clock of `State.t`, leads into a reference that has jumped.

    `way` (6,): rotation vector and origin of what was followed, seen from the reference: it comes straight, and turns
    about one axis, the shorter way; half a turn has two, of which one is chosen here, once. `twist`, `bend` (6,): what
    its twist and acceleration had beside. `time` [s] that the way takes.
    """

    t: float
    way: Array
    twist: Array
    bend: Array
    time: float

    @classmethod
    def of(cls, t: float, T: pin.SE3, motion: Array, target: Sample, speeds: tuple[float, float]) -> Lead:
        """From the pose T and its motion (6, 2), along a way no faster than `speeds` [m/s], [rad/s]."""
        X = target.T.actInv(T)
        vector = np.empty(6)
        log(X.rotation, np.zeros(3), vector)
        way, nothing = np.concatenate((vector[:3], X.translation)), np.zeros(6)
        far = max(float(np.linalg.norm(way[3:])) / speeds[0], float(np.linalg.norm(way[:3])) / speeds[1])
        lead = cls(t, way, nothing, nothing, max(SETTLE, SLOPE * far))
        lead = lead._replace(twist=motion[:, 0] - lead.onto(target, t).motion[:, 0])
        return lead._replace(bend=motion[:, 1] - lead.onto(target, t).motion[:, 1])

    @property
    def ends(self) -> float:
        """When nothing is left of it [s]."""
        return self.t + self.time

    def onto(self, target: Sample, t: float) -> Sample:
        """What is followed at time t [s], while the reference is at `target`."""
        if t >= self.ends:
            return target
        s = max(t - self.t, 0.0)
        a, u = fall(s / self.time, self.time), min(s / SETTLE, 1.0)
        sample = advanced(np.concatenate((np.zeros(3), self.way[3:])), *a, target)
        sample = advanced(np.concatenate((self.way[:3], np.zeros(3))), *a, sample)
        if u < 1.0:
            sample = advanced(self.bend, *turn(u, SETTLE), advanced(self.twist, *run(u, SETTLE), sample))
        return sample
