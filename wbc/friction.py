"""Contacts that only push, and friction across the push: cones where they stick, drag where they slide.

A contact that pushes along d (a unit vector, in which the robot presses on the world) answers N = n' lambda >= 0. With
friction, the force across d that the contact holds stays in an inner pyramid of the cone |f_t| <= mu N; what slides
freely across d drags the world along with mu N, which `feedforward` may put into the model. Theory and formulas:
`wbc.analytic.friction`.
"""

from __future__ import annotations

import copy
from typing import TYPE_CHECKING, Any, NamedTuple, TypeAlias

import numpy as np

from . import kernels
from .analytic import capped_friction, critical_friction, inner_cone, sliding_direction, sliding_map
from .errors import WrenchError
from .qp import Array, Rows

if TYPE_CHECKING:
    from collections.abc import Callable

    from .contact import Contact
    from .frame import Frame
    from .reference import Sample
    from .state import State

Guide: TypeAlias = "Callable[[State], Sample]"  # the desired motion at a state
FACES = 8
SLIP = 0.005  # [m/s]


class Cone(NamedTuple):
    """What a unilateral contact asks of its multipliers at a tick: rows lambda >= least, the push first, then faces."""

    rows: Array  # (1 + faces, k): N, then mu' N - c f_t
    least: Array  # (1 + faces,) [N]
    across: Array  # (m, k) f_t, the force that is held across the push
    lift: Array  # (k, m) multipliers of unit forces across
    up: Array  # (k,) multipliers of a unit push

    def excess(self, lam: Array) -> float:
        """How far multipliers (k,) are beyond it [N, N m]."""
        return max(0.0, float((self.least - self.rows.dot(lam)).max()))

    def cut(self, lam: Array) -> tuple[Array, str]:
        """(k,) the multipliers with the least push or more, then f_t scaled into the cone; what cut them, or ""."""
        N, by = self.rows.dot(lam), ""
        if self.least[0] - N[0] > 1e-12:
            lam, by = lam + self.up * (self.least[0] - N[0]), "push"
            N = self.rows.dot(lam)
        if not (N[1:] < -1e-12).any():
            return lam, by
        f = self.across.dot(lam)
        side = self.rows[1:].dot(self.lift).dot(f)  # -c f_t
        room = N[1:] - side  # mu' N
        s = float(np.min(room[side < 0.0] / -side[side < 0.0], initial=1.0))
        return lam + self.lift.dot(f) * (max(s, 0.0) - 1.0), "friction"


class Unilateral:
    """Where the world only pushes, along the unit vector `d` (3,) of the contact's axes; mu 0 has no friction.

    `held` (m, 3): directions across d in which the contact holds a force (m = 2: it sticks); `slides` (2 - m, 3): those
    in which it moves. `least` [N]: the smallest push. `faces`: of the cone of what is held; 4 lose up to 29 % of the
    friction, 8 up to 7.6 %. Below the speed `slip` [m/s] the drag of what slides follows the desired velocity, that of
    `guide`, which the motion task on the contact sets. `place` (3, 3): axes, in the world, of what it closes on.
    `modelled`: whether the drag is in the model. `unilateral` makes one.
    """

    def __init__(
        self,
        d: Array,
        held: Array,
        slides: Array,
        least: float,
        mu: float,
        faces: int,
        slip: float,
        place: Array | None,
    ) -> None:
        self.d, self.held, self.slides = d, held, slides
        self.least, self.mu, self.slip, self.place = least, mu, slip, place
        self.guide: Guide | None = None
        self.modelled = False
        cone = inner_cone(mu, 2 if len(held) == 1 else faces) if mu and len(held) else np.zeros((0, 3))
        self._sides, self._share = cone[:, : len(held)], -cone[:, 2]
        self._least = np.concatenate(([least], np.zeros(len(cone))))
        self._most = np.full(1 + len(cone), np.inf)
        self._across = np.concatenate((held, slides))
        self._lifted = False
        self._kept: Cone | None = None  # of a contact whose cone never changes

    @property
    def faces(self) -> int:
        """Number of faces of the cone; 0 where nothing is held across the push."""
        return len(self._sides)

    def turned(self, contact: Contact, state: State) -> tuple[Array, Array, Array]:
        """`d`, `held` and `slides` in the axes of the frame."""
        turn = contact.turn(state)
        if turn is None:
            return self.d, self.held, self.slides
        return turn.dot(self.d), self.held.dot(turn.T), self.slides.dot(turn.T)

    def hold(
        self, contact: Contact, state: State, A: Array, G: Array, inverse: Array
    ) -> tuple[Array, Array, Cone | None]:
        """B' (k, 6), B' J (k, nv) and the cone of a contact at a tick, from A, A J and (A')^+."""
        if contact.steady and self._kept is not None:
            return A, G, None if self._lifted else self._kept
        d, held, slides = self.turned(contact, state)
        cone = None if self._lifted else self._cone(d, held, A, inverse)
        if not self.modelled:
            self._kept = cone if contact.steady else None
            return A, G, cone
        frame = contact.seen(state)
        B = sliding_map(A, d, self.direction(state, frame, slides).dot(slides), self.mu).T
        return B, B.dot(frame.J), cone

    def _cone(self, d: Array, held: Array, A: Array, inverse: Array) -> Cone:
        across = held.dot(A[:, 3:].T)
        rows = np.empty((1 + self.faces, A.shape[0]))
        rows[0] = A[:, 3:].dot(d)
        rows[1:] = self._share[:, None] * rows[0] - self._sides.dot(across)
        return Cone(rows, self._least, across, inverse[:, 3:].dot(held.T), inverse[:, 3:].dot(d))

    def direction(self, state: State, frame: Frame, slides: Array) -> Array:
        """(s,) in which it slides along the rows `slides`, in the axes of the frame: the velocity's, or the guide's."""
        v, v_d = slides.dot(frame.V[3:]), np.zeros(len(slides))
        if self.guide is not None and v.dot(v) < self.slip**2:
            desired = self.guide(state)
            v_d = slides.dot(frame.T.rotation.T.dot(desired.T.rotation.dot(desired.V[3:])))
        return sliding_direction(v, v_d, self.slip)

    def lifted(self) -> Unilateral:
        """The same without its inequalities."""
        same = copy.copy(self)
        same._lifted = True
        return same

    def rows(self, name: str, cone: Cone) -> Rows:
        """The hard rows: NAME.push, and NAME.friction for every face."""
        labels = (f"{name}.push", *[f"{name}.friction"] * self.faces)
        return Rows(f"{name}.push", {name: cone.rows}, cone.least, self._most, None, labels)

    def fill(self, name: str, cone: Cone, rows: Rows, touches: bool = True) -> None:
        """Put them in rows where they stand; where nothing is touched: no push, and so nothing across it."""
        A: Any = rows.A
        A[name][:] = cone.rows
        rows.lo[:] = cone.least if touches else 0.0
        rows.hi[:] = self._most
        if not touches:
            rows.hi[0] = 0.0

    def told(self, contact: Contact, state: State, F: Array) -> dict[str, Any]:
        """What a wrench (6,) means at a surface: push [N], drag (2,) and the slip (2,) [m/s] across it, tilt [rad]."""
        frame, turn, d, across = contact.seen(state), contact.turn(state), self.d, self._across
        if turn is not None:
            d, across = turn.dot(d), across.dot(turn.T)
        told = {"push": d.dot(F[3:]), "drag": across.dot(F[3:]), "slip": across.dot(frame.V[3:])}
        if self.place is not None:
            told["tilt"] = kernels.angle(self.place.dot(self.d), frame.R.dot(self.d))
        return told

    def capped(self, free: Array, measured: Array, turn: Array | None) -> Array:
        """(6,) the free part of a measured wrench, its drag within the cone of the measured push."""
        if not self.mu:
            return free
        d, slides = (self.d, self.slides) if turn is None else (turn.dot(self.d), self.slides.dot(turn.T))
        return capped_friction(free, slides, self.mu * float(d.dot(measured[3:])))


def unilateral(
    contact: Contact,
    state: State,
    d: Array,
    least: float = 0.0,
    mu: float = 0.0,
    faces: int = FACES,
    slip: float = SLIP,
    place: Array | None = None,
) -> Unilateral:
    """What a contact that pushes along d holds and where it slides, told from its A at a state; parameters as there.

    Raises WrenchError when the contact holds no force along d, when friction is modelled of what does not slide, or
    when the friction is so high that it could not be solved for.
    """
    turn = contact.turn(state)
    d = d / np.linalg.norm(d)
    A = contact.A(state)[:, 3:] if turn is None else contact.A(state)[:, 3:].dot(turn)  # its columns in its own axes
    if not np.linalg.norm(A.dot(d)) > 1e-9:
        raise WrenchError("the contact holds no force along this direction; expected one that it holds")
    aligned = np.abs(d).max() > 1.0 - 1e-9
    across = np.eye(3)[np.abs(d) < 0.5] if aligned else np.linalg.svd(d[None])[2][1:]
    _, strength, basis = np.linalg.svd(A.dot(across.T))
    rank = int((strength > 1e-9).sum())
    if rank == 1:  # one way it holds, the other way it slides
        across = basis.dot(across)
    held, slides = across[:rank], across[rank:]
    made = Unilateral(d, held, slides, least, mu, faces, slip, place)
    if contact.feedforward == "modelled":
        made.modelled = True
        if not len(slides):
            raise WrenchError("modelled friction is that of sliding, but the contact holds every direction across")
        J = contact.seen(state).J
        body = (d, slides) if turn is None else (turn @ d, slides @ turn.T)
        most = critical_friction(contact.A(state), J @ state.solve_M(J.T), *body)
        if not mu < most:
            raise WrenchError(
                f"friction of {mu:g} cannot be solved for: sliding one way, A M_C^-1 (A' + mu t) is singular at "
                f"{most:.3g} in the start pose; expected less"
            )
    return made
