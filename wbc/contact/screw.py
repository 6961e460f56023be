"""Contacts that leave given screws free: hinges and slides."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from ..errors import WrenchError
from ..qp import Array
from ..state import State
from ..wrench import WRENCH_AXES
from . import Contact

_ANGULAR_FIRST = np.ix_((3, 4, 5, 0, 1, 2), (3, 4, 5, 0, 1, 2))  # Pinocchio's order is linear first


class ScrewContact(Contact):
    """The world leaves a frame free along given screws only (a hinge, a slide), fixed to the world.

    `screws` (f, 6) are twists in the axes of the pose `origin`; with A_0 their annihilator, A = A_0 Ad(origin^-1 T).
    Its Adot V is zero, for d/dt Ad_T = Ad_T ad_V and ad_V V = 0. Each row of A_0 is one axis of the origin less what
    the screws move it by, so that the multipliers are wrenches along these axes: a hinge along z leaves mx, my, fx, fy,
    fz, its forces taken by the axis.
    """

    def __init__(self, frame: str, screws: Array, origin: pin.SE3, names: tuple[str, ...] = ()) -> None:
        self.frame, self._origin = frame, origin.copy()
        self._screws = np.array(screws, float).reshape(-1, 6)
        if np.linalg.matrix_rank(self._screws) < len(self._screws):
            raise WrenchError("the free screws are not independent")
        self._A0, self._held_axes = _annihilator(self._screws)
        self.k = self._A0.shape[0]
        self._names = names
        self._zero = np.zeros(self.k)

    def A(self, state: State) -> Array:
        X = self._origin.actInv(self.seen(state).T)
        return self._A0.dot(X.toActionMatrix()[_ANGULAR_FIRST])

    def pseudo_inverse(self, A: Array) -> Array:
        return np.linalg.solve(A.dot(A.T), A)  # its rows are independent, each with a one of its own

    def Adot_V(self, state: State) -> Array:
        return self._zero

    def free(self, state: State) -> Array:
        back = self._origin.actInv(self.seen(state).T).toActionMatrixInverse()[_ANGULAR_FIRST]
        screws = self._screws.dot(back.T)
        return np.linalg.solve(screws.dot(screws.T), screws)

    @property
    def axes(self) -> tuple[str, ...]:
        return self._held_axes

    @property
    def free_axes(self) -> tuple[str, ...]:
        return self._names or super().free_axes


def _annihilator(screws: Array) -> tuple[Array, tuple[str, ...]]:
    """A_0 (6 - f, 6) with A_0 screws' = 0, and its axes: all but those that tell how far along each screw (f, 6).

    A turn is told by an axis of rotation, whatever its lever: angular axes are taken first.
    """
    rest, taken = screws.copy(), list[int]()
    for _ in screws:
        angular = np.abs(rest[:, :3]).max() > 1e-6 * np.abs(rest).max()
        size = np.abs(rest[:, :3] if angular else rest)
        i, j = np.unravel_index(int(np.argmax(size)), size.shape)
        rest = rest - np.outer(rest[:, j] / rest[i, j], rest[i])  # what is left of the others, this axis taken
        taken.append(int(j))
    kept = [j for j in range(6) if j not in taken]
    A = np.eye(6)[kept]
    A[:, taken] = -np.linalg.solve(screws[:, taken], screws[:, kept]).T
    return A, tuple(WRENCH_AXES[j] for j in kept)
