"""Round feet: a sphere that stands on a plane, and rolls on it without slipping."""

from __future__ import annotations

import numpy as np

from . import kernels
from .contact import Held, WorldAxesContact
from .qp import Array
from .robot import State

_POINT = ("vx", "vy", "vz")


class RoundFoot(WorldAxesContact):
    """The point of a sphere that touches a plane is at rest; `radius` 0 is a point.

    The frame is in the centre, the plane's axes are those of `R` (world), its normal n their z, and the point stands at
    -r n from the centre. In the plane's axes R_p' w and v + w x (-r n) make

        A = [r [n]x, I] blkdiag(R'R_f, R'R_f),     Adot V = [0, I] (R'R_f (w x v)),

    so that A' lambda is the force lambda at the point of contact, with its moment about the centre.
    """

    def __init__(self, frame: str, R: Array, radius: float = 0.0) -> None:
        super().__init__(frame, _POINT, R)
        self.radius = radius
        # w x (-r n) = r n x w
        self._A = np.hstack((radius * np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 0.0]]), np.eye(3)))

    def hold(self, state: State) -> Held:
        frame, held, basis = state.frame(self.frame), self._storage(state), np.empty((6, 6))
        inverse, Adot_V = np.empty((3, 6)), np.empty(3)
        kernels.rolling(self._R, frame.R, self.radius, frame.table, basis, inverse, Adot_V, held.table, held.bias)
        return self._demand(state, held, frame, basis[:3], basis[3:], inverse, Adot_V)

    def pseudo_inverse(self, A: Array) -> Array:
        """(3, 6) the force alone tells the multipliers: whatever it acts on, its moment follows."""
        return np.hstack((np.zeros((3, 3)), A[:, 3:]))

    def Adot_V(self, state: State) -> Array:
        V = state.frame(self.frame).V
        return self.turn(state).T @ np.cross(V[:3], V[3:])
