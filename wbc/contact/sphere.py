"""Contacts with curved surfaces: a point on a sphere."""

from __future__ import annotations

import math

import numpy as np

from ..qp import Array
from ..state import State
from . import Contact

_ZERO = np.zeros(3)


class SphereContact(Contact):
    """The origin of the frame stays on a sphere around `centre` c [m, world]: a row along n = (p - c)/|p - c|.

    A = [0, n' R];   Adot V = n' R (w x v) + ndot' R v   with   ndot = (I - n n') R v / |p - c|. Its multiplier is the
    force of the robot on the sphere along the outward normal: pressing is negative.
    """

    k = 1

    def __init__(self, frame: str, centre: Array) -> None:
        self.frame, self._centre = frame, np.array(centre, float)

    def _normal(self, state: State) -> tuple[Array, float]:
        """n in the axes of the frame, and the distance from the centre."""
        T = self.seen(state).T
        from_centre = T.rotation.T @ (T.translation - self._centre)
        radius = math.sqrt(from_centre @ from_centre)
        return from_centre / radius, radius

    def A(self, state: State) -> Array:
        return np.concatenate((_ZERO, self._normal(state)[0]))[None]

    def free(self, state: State) -> Array:
        """The rotations, then the two tangents that a reflection of the frame's axes onto n leaves."""
        n, _ = self._normal(state)
        pole = int(np.abs(n).argmax())
        u = n.copy()
        u[pole] += math.copysign(1.0, n[pole])
        reflection = np.eye(3) - np.outer(u, u) * (2.0 / (u @ u))
        free = np.eye(6)[:5]
        free[3:, 3:] = np.delete(reflection, pole, axis=0)
        return free

    def turn(self, state: State) -> Array:
        """Two tangents, and z the outward normal."""
        return np.vstack((self.free(state)[3:, 3:], self._normal(state)[0])).T

    def pseudo_inverse(self, A: Array) -> Array:
        return A  # its row is a unit vector

    def Adot_V(self, state: State) -> Array:
        V = self.seen(state).V
        (w0, w1, w2, v0, v1, v2), v = V.tolist(), V[3:]
        n, radius = self._normal(state)
        turning = n @ (w1 * v2 - w2 * v1, w2 * v0 - w0 * v2, w0 * v1 - w1 * v0)
        return np.array([turning + (v @ v - (n @ v) ** 2) / radius])

    @property
    def axes(self) -> tuple[str, ...]:
        return ("normal",)
