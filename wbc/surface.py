"""Flat soles: the friction, centre of pressure and yaw moment that a rectangle can carry, as one cone of wrenches."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from .analytic import surface_cone
from .analytic.surface import FRICTION, PRESSURE, PUSH, YAW
from .errors import WrenchError
from .friction import SLIP, Cone, Unilateral
from .qp import Array, Rows

if TYPE_CHECKING:
    from .contact import Contact
    from .state import State


class SoleCone(Cone):
    """What a sole asks of its multipliers at a tick: rows (17, k) lambda >= least, the push first, `up` in its middle.

    There is no force across by itself: what is held across the push comes with moments.
    """

    __slots__ = ()

    parts: ClassVar = {"push": PUSH, "friction": FRICTION, "pressure": PRESSURE, "yaw": YAW}

    def cut(self, lam: Array) -> tuple[Array, str]:
        """(k,) the multipliers with the least push or more, the rest of them scaled into the cone; what cut them."""
        N, by = self.rows.dot(lam), ""
        if self.least[0] - N[0] > 1e-12:
            lam, by = lam + self.up * (self.least[0] - N[0]), "push"
            N = self.rows.dot(lam)
        if not (N[1:] < -1e-12).any():
            return lam, by
        push = self.rows.dot(self.up * N[0])  # a push in the middle is inside
        away = N - push
        s = float(np.min(push[away < 0.0] / -away[away < 0.0], initial=1.0))
        lam = self.up * N[0] + (lam - self.up * N[0]) * max(s, 0.0)
        return lam, next(name for name, part in self.parts.items() if (N[part] < -1e-12).any())


class Sole(Unilateral):
    """Where the world only pushes on a rectangle in the plane z = 0 of the contact's frame, its middle the origin.

    `d`: the push, (0, 0, 1) or (0, 0, -1); `size`: length along x, width along y [m]; `mu` of the round cone of
    friction, of which every corner keeps the pyramid of four faces inside (`analytic.surface_cone`).
    """

    def __init__(self, d: Array, size: tuple[float, float], mu: float, least: float = 0.0, place: Array | None = None):
        if abs(float(d[2])) < 1.0 - 1e-9:
            raise WrenchError("a sole lies in the plane z = 0 of its frame; expected it to push along z")
        super().__init__(d, np.eye(3)[:2], np.zeros((0, 3)), least, mu, 4, SLIP, place)
        self.size = (float(size[0]), float(size[1]))
        # the cone is that of a push along +z; turned over, force and moment change their signs together
        self._wrenches = float(d[2]) * surface_cone(mu / math.sqrt(2.0), 0.5 * self.size[0], 0.5 * self.size[1])
        m = len(self._wrenches)
        self._least = np.concatenate(([least], np.zeros(m - 1)))
        self._most = np.full(m, np.inf)
        self._labels = tuple(part for part, rows in SoleCone.parts.items() for _ in range(rows.stop - rows.start))

    def hold(
        self, contact: Contact, state: State, A: Array, G: Array, inverse: Array
    ) -> tuple[Array, Array, Cone | None]:
        if self._lifted:
            return A, G, None
        cone = self._kept
        if cone is None or not contact.steady:
            k = len(A)
            nothing = (np.zeros((0, k)), np.zeros((k, 0)))
            cone = self._kept = SoleCone(self._wrenches.dot(A.T), self._least, *nothing, inverse[:, 3:].dot(self.d))
        return A, G, cone

    def rows(self, name: str, cone: Cone) -> Rows:
        labels = tuple(f"{name}.{part}" for part in self._labels)
        return Rows(f"{name}.push", {name: cone.rows}, cone.least, self._most, None, labels)
