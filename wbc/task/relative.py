"""How two frames move with respect to one another: a pose seen from a frame, an axis that looks at a point.

Both ends may be moved by the robot, so that neither task says anything of where the pair is in the world.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pinocchio as pin

from ..analytic import gain_matrix
from ..dynamics import weighed
from ..errors import GainError
from ..frame import Frame
from ..pair import seen
from ..qp import Array, Rows
from ..reference import Reference
from ..singular import LEAST
from ..state import State
from ..wrench import VELOCITY_AXES
from .following import SPEEDS
from .motion import MotionTask

NEAREST = 0.01  # [m] from which on a gaze no longer turns faster as its target comes nearer
BEHIND = -0.999  # cosine of the angle up to which a gaze is exact: looking away it does not know which way to turn


class RelativeTask(MotionTask):
    """The pose of `frame` seen from the frame `to`, by computed torque on selected axes (those of `frame`).

    As a `MotionTask` without a contact: the reference is in the axes of `to`, its twist that against `to`; the error is
    the SE(3) logarithm, or `split`.
    """

    def __init__(
        self,
        frame: str,
        to: str,
        reference: Reference,
        kp: Any = 100.0,
        kd: Any = 20.0,
        axes: tuple[str, ...] = VELOCITY_AXES,
        error: str = "log",
        singular: float = LEAST,
        jump: tuple[float, float] | None = SPEEDS,
    ) -> None:
        super().__init__(frame, reference, kp, kd, axes, error=error, singular=singular, jump=jump)
        self.to = to

    def seen(self, state: State) -> Frame:
        return seen(state, self.frame, self.to)


class GazeTask:
    """An axis of a frame points at a fixed point, or at the origin of another frame: two rows.

    With u the direction to the target in the axes of the frame, a the axis and B (2, 3) an orthonormal basis across it,

        y = theta / sin(theta) B u,     cos(theta) = a u,     yddot = -kp y - kd ydot :

    |y| is the angle that is missing [rad], and the axis goes there along a great circle; straight behind it the law
    does not know which way to turn. Parameters: `axis` (3,) in the axes of the frame; `at`: a frame's name, or (3,) in
    the world [m]; `kp` [1/s^2], `kd` [1/s]. The metric is the inertia of the rows in what the contacts leave.
    """

    def __init__(self, frame: str, axis: Any, at: Any, kp: float = 100.0, kd: float = 20.0) -> None:
        self.frame, self.at = frame, at if isinstance(at, str) else np.array(at, float)
        self.axis = np.array(axis, float)
        size = float(np.linalg.norm(self.axis))
        if not size > 0.0:
            raise GainError(f"axis: expected a direction, got {axis}")
        self.axis /= size
        self._across = np.linalg.svd(self.axis[None])[2][1:]
        self.Kp, self.Kd = gain_matrix(kp, 2, "kp"), gain_matrix(kd, 2, "kd")

    def way(self, state: State) -> tuple[Array, Array, Array]:
        """(3,) d to the target in the axes of the frame [m], (3, nv) its Jacobian, (3,) what of dddot is not vdot's."""
        frame = state.frame(self.frame)
        R, turn = frame.R, pin.skew(frame.V[:3])
        if isinstance(self.at, str):
            other = state.frame(self.at)
            X, p = R.T.dot(other.R), other.p
            J, s = X.dot(other.J[3:]), X.dot(other.V[3:])
            moves = X.dot(other.drift[3:] + pin.skew(other.V[:3]).dot(other.V[3:])) - turn.dot(s)
        else:
            p, J, moves = self.at, np.zeros((3, state.v.size)), np.zeros(3)
        d = R.T.dot(p - frame.p)
        across = pin.skew(d)
        J = J + across.dot(frame.J[:3]) - frame.J[3:]
        return d, J, across.dot(frame.drift[:3]) - frame.drift[3:] + moves - turn.dot(J.dot(state.v))

    def angle(self, state: State) -> float:
        """Between the axis and the direction to the target [rad]."""
        d = self.way(state)[0]
        return math.atan2(float(np.linalg.norm(self._across.dot(d))), float(self.axis.dot(d)))

    def target(self, state: State) -> tuple[Array, Array]:
        """The task's own rows G vdot = b: (2, nv) and (2,)."""
        d, J, dd = self.way(state)
        r = max(float(np.linalg.norm(d)), NEAREST)
        u, d1 = d / r, J.dot(state.v)
        away = float(u.dot(d1))
        u1, J = (d1 - away * u) / r, (J - np.outer(u, u.dot(J))) / r
        u2 = (dd - float(u.dot(dd) + u1.dot(d1)) * u - 2.0 * away * u1) / r
        a, B = self.axis, self._across
        f, f1, f2 = _stretch(float(a.dot(u)))
        c1, side = float(a.dot(u1)), B.dot(u)
        G = f * B.dot(J) + f1 * np.outer(side, a.dot(J))
        drift = (f2 * c1 * c1 + f1 * float(a.dot(u2))) * side + 2.0 * f1 * c1 * B.dot(u1) + f * B.dot(u2)
        return G, -self.Kp.dot(f * side) - self.Kd.dot(G.dot(state.v)) - drift

    def rows(self, state: State) -> Rows:
        return weighed(state, *self.target(state))


def _stretch(c: float) -> tuple[float, float, float]:
    """f = theta / sin(theta) of c = cos(theta), and its derivatives by c; constant from `BEHIND` on."""
    if c > 1.0 - 1e-4:
        e = 1.0 - c
        return 1.0 + e * (1 / 3 + e * 2 / 15), -1 / 3 - e * (4 / 15 + e * 6 / 35), 4 / 15 + e * 12 / 35
    s2 = 1.0 - max(c, BEHIND) ** 2
    f = math.acos(max(c, BEHIND)) / math.sqrt(s2)
    if c < BEHIND:
        return f, 0.0, 0.0
    f1 = (c * f - 1.0) / s2
    return f, f1, (f + 3.0 * c * f1) / s2
