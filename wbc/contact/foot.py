"""Round feet: a sphere that stands on a plane, and rolls on it without slipping."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from .. import kernels
from ..footing import LIFTED
from ..kernels.compiled import Counts
from ..qp import Array
from ..state import State
from . import Contact, Held
from .axes import WorldAxesContact

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

    @property
    def alike(self) -> bool:
        """Whether it can be evaluated with others: it stands on ground of the world that does not move."""
        return self.ride is None and self.against is None

    def hold(self, state: State) -> Held:
        return RoundFeet({"": self}).hold(state)[""] if self.alike else Contact.hold(self, state)

    def pseudo_inverse(self, A: Array) -> Array:
        """(3, 6) the force alone tells the multipliers: whatever it acts on, its moment follows."""
        return np.hstack((np.zeros((3, 3)), A[:, 3:]))

    def Adot_V(self, state: State) -> Array:
        V = self.seen(state).V
        return self.turn(state).T @ np.cross(V[:3], V[3:])


class RoundFeet:
    """Round feet that are evaluated in one call: what a quadruped stands on."""

    def __init__(self, feet: Mapping[str, RoundFoot]) -> None:
        self.feet, each = dict(feet), list(feet.values())
        self._feet = tuple(each)
        self._R = np.array([foot._R for foot in each])
        # radius, and the height of the middle that stands; rate and bound of what dies out
        self._numbers = np.array([(foot.radius, *_standing(foot), *(foot.settling or (0.0, 0.0))) for foot in each])
        self._normals = np.array([np.zeros(3) if foot.footing is None else foot.footing.normal for foot in each])
        self._level, self._known = np.zeros(len(each)), False  # whether a level is not zero

    def hold(self, state: State) -> Mapping[str, Held]:
        """Evaluate them at a state."""
        feet, terms = self.feet.values(), state.terms
        stored: _Stored = terms.held.get(self._feet) or _Stored(self._feet, state)
        for held in stored.held:
            held.seen = state.frame(held.frame)
        if state.grounds or self._known:
            self._level[:], self._known = [state.grounds.get(foot, 0.0) for foot in feet], bool(state.grounds)
        frames = terms.frames
        kernels.rolling(
            stored.index, self._R, self._numbers, self._normals, self._level, LIFTED, frames.R, frames.p, frames.table,
            stored.basis, stored.inverse, stored.Adot_V, stored.table, stored.bias, stored.height,
        )  # fmt: skip
        for foot, held, height in zip(feet, stored.held, stored.height.tolist(), strict=True):
            held.lifted = height > LIFTED
            if held.lifted and foot.footing is not None:
                held.rhs -= foot.footing.asked(held.A, held.seen, state.grounds.get(foot, 0.0))
            pushes = foot.pushes
            held.cone = None if pushes is None else pushes.hold(foot, state, held.A, held.G, held.inverse)[2]
        return dict(zip(self.feet, stored.held, strict=True))

    def fill(self, state: State, G: Array, low: Array, high: Array) -> None:
        """Put what was held at this state in rows where they stand, those of one foot after those of another."""
        stored: _Stored = state.terms.held[self._feet]
        kernels.demands(stored.table, stored.bias, G, low, high)


class _Stored:
    """What round feet demand, side by side, and each one's part of it."""

    def __init__(self, feet: tuple[RoundFoot, ...], state: State) -> None:
        f, n = len(feet), state.v.size
        self.index: Counts = np.array([state.robot.frame_id(foot.frame) for foot in feet])
        self.basis, self.inverse, self.Adot_V = np.empty((f, 6, 6)), np.empty((f, 3, 6)), np.empty((f, 3))
        self.table, self.bias, self.height = np.empty((f, 6, n + 2)), np.empty((f, 6)), np.empty(f)
        self.held = [Held(foot.frame, 3, self.table[i], self.bias[i]) for i, foot in enumerate(feet)]
        for i, held in enumerate(self.held):
            held.A, held.free = self.basis[i, :3], self.basis[i, 3:]
            held.inverse, held.Adot_V = self.inverse[i], self.Adot_V[i]
            held.B, held.push = held.A, held.G
        state.terms.held[feet] = self


def _standing(foot: RoundFoot) -> tuple[float, ...]:
    """The height of the middle of a foot that stands; what stands on no plane is never above it."""
    return (math.inf,) if foot.footing is None else (foot.footing.lowest,)
