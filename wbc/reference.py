"""Desired motion over time: pose, body twist and body acceleration of a frame.

A reference is any callable `t [s] -> Sample`. `Path` builds one from scalar motions along unit screws of a fixed
frame, by the product of exponentials (book 4.1): T_d = T_in exp([S_1] s_1) exp([S_2] s_2) ...; translations come
first, then rotations about z, y, x.

Beside that a reference may have `ends` [s], when it has come to rest for good (never, when left out), and `relative`:
whether it goes out from wherever the frame is when the reference is taken up, along its axes.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Callable, Mapping, Sequence

import numpy as np
import pinocchio as pin

from .kernels import shift
from .qp import Array

_ORDER = [3, 4, 5, 0, 1, 2]
_ANGULAR_FIRST = np.ix_(_ORDER, _ORDER)
Scalar = Callable[[float], tuple[float, float, float]]  # t -> position, velocity, acceleration


class Sample:
    """Desired motion at one time: a pose, and `motion` (6, 2) with V_d and its time derivative as columns, in its axes.

    `T` is the pose in the world; R (3, 3) and p (3,) are its parts.
    """

    __slots__ = ("R", "_T", "motion", "p")

    def __init__(self, T: pin.SE3, motion: Array) -> None:
        self._T, self.R, self.p, self.motion = T, T.rotation, T.translation, motion

    @classmethod
    def at(cls, R: Array, p: Array, motion: Array) -> Sample:
        """The same from the parts of the pose."""
        sample = cls.__new__(cls)
        sample._T, sample.R, sample.p, sample.motion = None, R, p, motion
        return sample

    @property
    def T(self) -> pin.SE3:
        if self._T is None:
            self._T = pin.SE3(self.R, self.p)
        return self._T

    @property
    def V(self) -> Array:
        """(6,) desired body twist [rad/s, m/s]."""
        return self.motion[:, 0]

    @property
    def Vdot(self) -> Array:
        """(6,) its derivative [rad/s^2, m/s^2]."""
        return self.motion[:, 1]


Reference = Callable[[float], Sample]


def constant(value: float) -> Scalar:
    return lambda t: (value, 0.0, 0.0)


def ramp(rate: float, start: float = 0.0) -> Scalar:
    return lambda t: (start + rate * t, rate, 0.0)


def sine(amplitude: float, period: float, phase: float = 0.0, centre: float = 0.0, ease: float = 0.0) -> Scalar:
    """centre + amplitude sin(2 pi tau / period + phase), with tau(t) easing in from rest over `ease` [s]."""
    omega = 2 * math.pi / period

    def sample(t: float) -> tuple[float, float, float]:
        tau, rate, bend = (t - ease / 2, 1.0, 0.0) if t >= ease else _ease(t, ease)
        angle = omega * tau + phase
        s, c = amplitude * math.sin(angle), amplitude * omega * math.cos(angle)
        return centre + s, c * rate, -omega * omega * s * rate * rate + c * bend

    return sample


def _ease(t: float, over: float) -> tuple[float, float, float]:
    """Path time and its derivatives: its rate rises as a quintic from 0 to 1."""
    if t >= over or over == 0.0:
        return t - over / 2, 1.0, 0.0
    u = max(t / over, 0.0)
    return over * u**4 * (2.5 - 3 * u + u * u), u**3 * (10 - 15 * u + 6 * u * u), 30 * (u * (1 - u)) ** 2 / over


def quintic(times: Sequence[float], values: Sequence[float]) -> Scalar:
    """Rest to rest through `values` at `times`, a quintic between neighbours (book 9.2.2)."""
    times, values = [float(t) for t in times], [float(v) for v in values]

    def sample(t: float) -> tuple[float, float, float]:
        i = bisect_right(times, t) - 1
        if i < 0:
            return values[0], 0.0, 0.0
        if i >= len(times) - 1:
            return values[-1], 0.0, 0.0
        T, d = times[i + 1] - times[i], values[i + 1] - values[i]
        u = (t - times[i]) / T
        return (
            values[i] + d * u**3 * (10 - 15 * u + 6 * u * u),
            d * 30 * (u * (1 - u)) ** 2 / T,
            d * 60 * u * (1 - u) * (1 - 2 * u) / T**2,
        )

    return sample


def arc(radius: float, heading: Scalar) -> dict[int, Scalar]:
    """wz, vx, vy of a motion along an arc through the origin, headed along it: x = r sin a, y = r (1 - cos a)."""

    def x(t: float) -> tuple[float, float, float]:
        a, rate, bend = heading(t)
        s, c = radius * math.sin(a), radius * math.cos(a)
        return s, c * rate, c * bend - s * rate * rate

    def y(t: float) -> tuple[float, float, float]:
        a, rate, bend = heading(t)
        s, c = radius * math.sin(a), radius * math.cos(a)
        return radius - c, s * rate, s * bend + c * rate * rate

    return {2: heading, 3: x, 4: y}


_ROTATIONS = (2, 1, 0)  # about z, then y, then x
ALL_AXES = frozenset(range(6))


class Path:
    """Motion along the axes of a fixed pose `origin`: `along[i]` moves axis i of (wx, wy, wz, vx, vy, vz).

    `offset` is a constant pose applied last, so that a frame may keep its own orientation against `origin`. `placed`:
    the axes along which the reference has a place of its own; along the others it only says how fast to move, and keeps
    the place in which it is taken up.
    """

    def __init__(
        self,
        origin: pin.SE3,
        along: Mapping[int, Scalar],
        offset: pin.SE3 | None = None,
        ends: float = math.inf,
        relative: bool = False,
        placed: frozenset[int] = ALL_AXES,
    ) -> None:
        self.origin, self.along = origin.copy(), dict(along)
        self.offset, self.ends, self.relative, self.placed = offset, ends, relative, placed
        self._place = origin.homogeneous[:3].copy()
        self._R = self._place[:, :3].copy()
        self._turns = [(i, self.along[i]) for i in _ROTATIONS if i in self.along]
        self._x, self._y, self._z = (self.along.get(i, constant(0.0)) for i in (3, 4, 5))

    def __call__(self, t: float) -> Sample:
        R, p, motion = self._R, np.empty(3), np.empty((6, 2))
        shift(self._place, *self._x(t), *self._y(t), *self._z(t), p, motion)
        for axis, turn in self._turns:
            s, rate, bend = turn(t)
            if s != 0.0 or rate != 0.0 or bend != 0.0:
                R = R @ self._turn(axis, s, rate, bend, motion)
        sample = Sample.at(R, p, motion)
        return sample if self.offset is None else Sample(sample.T * self.offset, seen_from(self.offset, motion))

    @staticmethod
    def _turn(axis: int, s: float, rate: float, bend: float, motion: Array) -> Array:
        """`motion` in turned axes, with the turn: V' = Ad V + S sdot, Vdot' = Ad Vdot - ad_S Ad V sdot + S sddot."""
        unit = np.eye(3)[axis]
        step = pin.exp3(s * unit)
        motion[:3], motion[3:] = step.T @ motion[:3], step.T @ motion[3:]
        motion[:3, 1] -= rate * np.cross(unit, motion[:3, 0])
        motion[3:, 1] -= rate * np.cross(unit, motion[3:, 0])
        motion[axis, 0] += rate
        motion[axis, 1] += bend
        return step


def seen_from(T: pin.SE3, motion: Array) -> Array:
    """Twist columns in the axes of a frame that stands at T, rigidly."""
    return T.inverse().toActionMatrix()[_ANGULAR_FIRST] @ motion


class SpherePath:
    """Motion on a sphere around the fixed pose `origin`, in its orientation: x(t) and y(t), and z of the upper half.

    z^2 = r^2 - x^2 - y^2, so that z zdot = -(x xdot + y ydot), and its derivative.
    """

    def __init__(self, origin: pin.SE3, radius: float, x: Scalar, y: Scalar, ends: float = math.inf) -> None:
        self._origin, self.radius, self._x, self._y, self.ends = origin.copy(), radius, x, y, ends

    def __call__(self, t: float) -> Sample:
        (x, vx, ax), (y, vy, ay) = self._x(t), self._y(t)
        z = math.sqrt(max(self.radius**2 - x * x - y * y, 1e-12))
        vz = -(x * vx + y * vy) / z
        az = -(vx * vx + x * ax + vy * vy + y * ay + vz * vz) / z
        motion = np.zeros((6, 2))
        motion[3:] = (vx, ax), (vy, ay), (vz, az)
        return Sample(self._origin * pin.SE3(np.eye(3), np.array([x, y, z])), motion)


class ScrewPath:
    """Motion along screws (6,) of the fixed pose `origin`: T_d = origin exp([S_1] s_1(t)) ... start."""

    def __init__(
        self,
        origin: pin.SE3,
        screws: Sequence[Array],
        scalars: Sequence[Scalar],
        start: pin.SE3,
        ends: float = math.inf,
        relative: bool = False,
    ) -> None:
        self._origin, self._start, self.ends, self.relative = origin.copy(), start.copy(), ends, relative
        self._screws, self._scalars = [np.array(S, float) for S in screws], list(scalars)

    def __call__(self, t: float) -> Sample:
        sample = Sample(self._origin, np.zeros((6, 2)))
        for S, scalar in zip(self._screws, self._scalars, strict=True):
            sample = advanced(S, *scalar(t), sample)
        return Sample(sample.T * self._start, seen_from(self._start, sample.motion))


def advanced(S: Array, s: float, rate: float, bend: float, sample: Sample) -> Sample:
    """T exp([S] s) along a screw (6,): V' = Ad V + S sdot, Vdot' = Ad Vdot - ad_S Ad V sdot + S sddot."""
    step = pin.exp6(pin.Motion(S[3:] * s, S[:3] * s))
    motion = seen_from(step, sample.motion)
    w, v = motion[:3, 0], motion[3:, 0]
    turn = pin.skew(S[:3])
    motion[:3, 1] -= rate * turn.dot(w)
    motion[3:, 1] -= rate * (pin.skew(S[3:]).dot(w) + turn.dot(v))
    motion[:, 0] += S * rate
    motion[:, 1] += S * bend
    return Sample(sample.T * step, motion)


class Hold:
    """Stay at a pose; `relative`: where the frame is when this is taken up."""

    ends = 0.0

    def __init__(self, T: pin.SE3, relative: bool = False) -> None:
        self._sample, self.relative = Sample(T.copy(), np.zeros((6, 2))), relative

    def __call__(self, t: float) -> Sample:
        return self._sample


def hold(T: pin.SE3) -> Reference:
    """Stay at a pose."""
    return Hold(T)
