"""Whether a foot stands: how far it is above its plane, and how it goes back down where it has left it."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from . import kernels
from .qp import Array

if TYPE_CHECKING:
    from .frame import Frame

LIFTED = 5e-4  # [m] above its plane from which a foot carries nothing
RATE, MOST = 20.0, 20.0  # [1/s], [m/s^2, rad/s^2] of the way down
SLOWEST, FASTEST, SLOWING = 0.05, 0.3, 5.0  # [m/s], [m/s], [1/s] speed of the way down, by the height left
FLATTEN = 5.0  # [1/s] with which a sole turns flat


class Footing:
    """What a foot stands on, and with what: a plane with the unit normal n (world), and a sphere or a rectangle.

    Parameters: `normal` (3,) and the height `level` of the plane, n . p = level [m]; `radius` of a round foot about the
    origin of its frame, or the `size` of a sole in the plane z = 0 of its frame, along x and y [m]. A size of 0 one way
    makes an edge, which may be round as well.
    """

    def __init__(self, normal: Array, level: float, radius: float = 0.0, size: tuple[float, float] | None = None):
        self.normal, self.level, self.radius = np.array(normal, float), float(level), radius
        self.size, self._edge = size, None if size is None or all(size) else int(np.argmax(size))
        self.lowest = self.level + radius  # of the middle of a foot that stands
        self._half = (0.5 * size[0], 0.5 * size[1]) if size else (0.0, 0.0)

    def height(self, frame: Frame) -> float:
        """How far the lowest point of the foot is above the plane [m]."""
        return kernels.height(frame.R, frame.p, self.normal, self.lowest, *self._half)

    def lifted(self, frame: Frame, level: float = 0.0) -> bool:
        """Whether it is in the air, over a floor that it has found `level` above the plane."""
        return self.height(frame) - level > LIFTED

    def push(self, frame: Frame, F: Array) -> float:
        """What a wrench (6,) of the robot on its environment presses on the plane with [N]."""
        return -float(self.normal.dot(frame.R.dot(F[3:])))

    def down(self, frame: Frame, level: float = 0.0) -> Array:
        """(6,) twist of the frame with which it goes back to the plane: straight down and turning flat."""
        n = frame.R.T.dot(self.normal)
        speed = min(max(SLOWING * (self.height(frame) - level), SLOWEST), FASTEST)
        V = np.zeros(6)
        V[3:] = -speed * n
        if self._edge is not None:
            V[:3] = -FLATTEN * n[self._edge] * np.cross(np.eye(3)[self._edge], n)  # about what is across it
        elif self.size is not None:
            z = 1.0 if n[2] > 0.0 else -1.0
            V[:3] = FLATTEN * np.array((-z * n[1], z * n[0], 0.0))  # z x n: turns z into n
        return V

    def asked(self, A: Array, frame: Frame, level: float = 0.0) -> Array:
        """(k,) c of A Vdot + Adot V = -c, with which a lifted foot comes down."""
        return np.clip(RATE * A.dot(frame.V - self.down(frame, level)), -MOST, MOST)
