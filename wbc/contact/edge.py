"""Edges: a straight edge of a foot on a plane. It holds all but the turn about itself, and rolls if it is rounded."""

from __future__ import annotations

import math
from typing import ClassVar

import numpy as np

from .. import kernels
from ..analytic import edge_cone
from ..analytic.surface import ALONG, ENDS, PUSH
from ..errors import WrenchError
from ..friction import SLIP, Cone, Unilateral
from ..qp import Array, Rows
from ..state import State
from ..surface import SoleCone
from . import Contact, Held
from .axes import AxesContact

HELD = (("wy", "wz", "vx", "vy", "vz"), ("wx", "wz", "vx", "vy", "vz"))  # by an edge along x, along y


class EdgeContact(AxesContact):
    """The line of a straight edge that touches a plane is at rest; the body may turn about it (k = 5).

    The edge lies along x (`along` 0) or y (1) of the frame, whose origin is in its middle; with a `radius` it is the
    axis of a cylinder that rolls on the plane, whose unit normal is n (world), and which is touched at -r n. In the
    axes of the edge, E = (x, y, z) in the world with z = n and the edge projected onto the plane along x or y, the rows
    are w across the edge and about n, and v + w x (-r n), each times E' R:

        A = [S, 0; r [z]x, I] blkdiag(E'R, E'R)

    so that the multipliers are the wrench at the middle of the line of contact, in the axes of the edge, without the
    moment along it: a moment across, one about the normal, a force. E turns about n with psidot = w_z - w_e tan(tilt),
    where the tilt of the edge against the plane is 0 while it lies there.
    """

    def __init__(self, frame: str, normal: Array, along: int = 1, radius: float = 0.0) -> None:
        super().__init__(frame, HELD[along])
        self.normal, self.along, self.radius = np.array(normal, float), along, radius

    def _rows(self, state: State) -> tuple[Array, Array]:
        """A with the free row below (6, 6), and Adot V (5,)."""
        frame, basis, Adot_V = self.seen(state), np.empty((6, 6)), np.empty(5)
        kernels.edge(self.normal, frame.R, self.along, self.radius, frame.table, basis, Adot_V)
        return basis, Adot_V

    def hold(self, state: State) -> Held:
        basis, Adot_V = self._rows(state)
        return self._hold(state, basis[:5], basis[5:], self.pseudo_inverse(basis[:5]), basis, Adot_V)

    def A(self, state: State) -> Array:
        return self._rows(state)[0][:5]

    def free(self, state: State) -> Array:
        return self._rows(state)[0][5:]

    def Adot_V(self, state: State) -> Array:
        return self._rows(state)[1]

    def turn(self, state: State) -> Array:
        return self._rows(state)[0][2:5, 3:].T

    def pseudo_inverse(self, A: Array) -> Array:
        """(5, 6) the wrench at the line of contact: of a moment along the edge the multipliers know nothing."""
        inverse = np.zeros((5, 6))
        inverse[:2, :3], inverse[2:, 3:] = A[:2, :3], A[2:, 3:]
        inverse[0, 3:] = A[3 - self.along, :3]  # r n x f
        return inverse


class EdgeCone(SoleCone):
    """As that of a sole: rows (7, 5) lambda >= least, the push first, `up` in the middle of the edge."""

    __slots__ = ()

    parts: ClassVar = {"push": PUSH, "friction": ALONG, "ends": ENDS}


class Edge(Unilateral):
    """Where the world only pushes, along -z of its plane, on an edge of a `length` [m] of an `EdgeContact`.

    `mu` of the round cone of friction, of which both ends keep a pyramid of four faces inside (`analytic.edge_cone`).
    """

    def __init__(self, length: float, along: int, mu: float, least: float = 0.0) -> None:
        super().__init__(np.array([0.0, 0.0, -1.0]), np.eye(3)[:2], np.zeros((0, 3)), least, mu, 4, SLIP, None)
        if not length > 0.0:
            raise WrenchError(f"an edge has a length; expected more than 0 m, got {length:g}")
        self.length = float(length)
        # of a push along +z; turned over, force and moment change their signs together
        U = -edge_cone(mu / math.sqrt(2.0), 0.5 * self.length, along)[:, [1 - along, 2, 3, 4, 5]]
        self._least = np.concatenate(([least], np.zeros(len(U) - 1)))
        self._most = np.full(len(U), np.inf)
        nothing = (np.zeros((0, 5)), np.zeros((5, 0)))
        self.border = EdgeCone(U, self._least, *nothing, -np.eye(5)[4])

    def hold(
        self, contact: Contact, state: State, A: Array, G: Array, inverse: Array
    ) -> tuple[Array, Array, Cone | None]:
        return A, G, None if self._lifted else self.border

    def rows(self, name: str, cone: Cone) -> Rows:
        labels = (f"{name}.push", *[f"{name}.friction"] * 2, *[f"{name}.ends"] * 4)
        return Rows(f"{name}.push", {name: cone.rows}, cone.least, self._most, None, labels)
