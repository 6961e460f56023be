"""Contacts whose A is constant in the axes of the frame, or of the world: a matrix, or the axes of the book's table."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from ..errors import WrenchError
from ..qp import Array
from ..state import State
from ..wrench import VELOCITY_AXES, WRENCH_AXES
from . import Contact, Held, complement


class MatrixContact(Contact):
    """Any constant A (k, 6) in the body axes of the frame; its rows must be independent."""

    steady = True

    def __init__(self, frame: str, A: Array) -> None:
        self.frame, self._A = frame, np.array(A, float).reshape(-1, 6)
        self.k = self._A.shape[0]
        if self.k and np.linalg.matrix_rank(self._A) < self.k:
            raise WrenchError(f"the {self.k} rows of A are not independent (rank {np.linalg.matrix_rank(self._A)})")
        self._inverse = np.linalg.pinv(self._A).T if self.k else self._A
        self._zero = np.zeros(self.k)
        self._set_free(complement(self._A))

    def _set_free(self, free: Array) -> None:
        self._free, self._basis = free, np.concatenate((self._A, free))

    def hold(self, state: State) -> Held:
        return self._hold(state, self._A, self._free, self._inverse, self._basis, None)

    def A(self, state: State) -> Array:
        return self._A

    def Adot_V(self, state: State) -> Array:
        return self._zero

    def free(self, state: State) -> Array:
        return self._free

    def pseudo_inverse(self, A: Array) -> Array:
        return self._inverse


class AxesContact(MatrixContact):
    """The book's table: the world holds some axes of the frame (`wx` ... `vz`) and leaves the others free.

    `free`: the free axes; by default all that are not held (a planar arm names fewer).
    """

    def __init__(self, frame: str, held: tuple[str, ...], free: tuple[str, ...] | None = None) -> None:
        free = tuple(a for a in VELOCITY_AXES if a not in held) if free is None else free
        self._held_axes, self._free_axes = held, free
        super().__init__(frame, np.eye(6)[[VELOCITY_AXES.index(a) for a in held]])
        self._set_free(np.eye(6)[[VELOCITY_AXES.index(a) for a in free]])

    @property
    def axes(self) -> tuple[str, ...]:
        return tuple(WRENCH_AXES[VELOCITY_AXES.index(a)] for a in self._held_axes)

    @property
    def free_axes(self) -> tuple[str, ...]:
        return self._free_axes


class WorldAxesContact(AxesContact):
    """The table with its axes fixed to the world (those of `R`), while the frame may turn: a point on a board.

    A = A_0 blkdiag(R'R_f, R'R_f);   Adot V = A_0 [0; R'R_f (w x v)].
    """

    def __init__(self, frame: str, held: tuple[str, ...], R: Array, free: tuple[str, ...] | None = None) -> None:
        super().__init__(frame, held, free)
        self._R = np.array(R, float)

    hold = Contact.hold  # its rows turn with the frame

    def turn(self, state: State) -> Array:
        return np.asarray(self.seen(state).T.rotation.T @ self._R)

    def _turned(self, rows: Array, state: State) -> Array:
        X, R = np.zeros((6, 6)), self.turn(state).T
        X[:3, :3] = X[3:, 3:] = R
        return rows @ X

    def A(self, state: State) -> Array:
        return self._turned(self._A, state)

    def free(self, state: State) -> Array:
        return self._turned(self._free, state)

    def pseudo_inverse(self, A: Array) -> Array:
        return A  # its rows are orthonormal

    def Adot_V(self, state: State) -> Array:
        V = self.seen(state).V
        return self._turned(self._A, state)[:, 3:] @ (pin.skew(V[:3]) @ V[3:])  # numpy's cross is slow
