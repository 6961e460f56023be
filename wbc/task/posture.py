"""Joint positions in what the other tasks leave free."""

from __future__ import annotations

from typing import Any

import numpy as np
import pinocchio as pin

from .. import kernels
from ..analytic import gain_matrix
from ..qp import Array, Rows
from ..state import State


class PostureTask:
    """Joint posture in the null space: vdot_p = kp (q_d - q) - kd v.

    Its metric is N'M N = M - G' (G M^-1 G')^-1 G, with G all rows of contacts and motion tasks: it cannot disturb
    them, whatever its weight (Khatib's dynamically consistent null space).
    """

    def __init__(self, q: Array, kp: Any = 50.0, kd: Any = 10.0, robot_nv: int | None = None) -> None:
        self.q = np.array(q, float)
        n = robot_nv or self.q.size
        self.Kp, self.Kd = gain_matrix(kp, n, "kp"), gain_matrix(kd, n, "kd")
        self._K = np.hstack((self.Kp, -self.Kd))

    def acceleration(self, state: State) -> Array:
        """(nv,) vdot_p [rad/s^2]."""
        model, vdot = state.robot.model, np.empty(state.v.size)
        if model.nq == model.nv:
            kernels.spring(self._K, self.q, state.q, state.v, vdot)
        else:
            kernels.spring(self._K, pin.difference(model, state.q, self.q), np.zeros(state.v.size), state.v, vdot)
        return vdot

    def rows(self, state: State) -> Rows:
        G, W, _ = state.primary
        vdot = self.acceleration(state)
        return Rows("", {"vdot": None}, vdot, vdot, state.M - G.T.dot(W.dot(G)))
