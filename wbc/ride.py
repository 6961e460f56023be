"""Ground that moves on a known path: seen from it, a contact is what it would be on ground that stands still.

With D(t) the ground's displacement since the start, a frame at T is seen at D^-1 T, and with the ground's own twist at
the frame, V_g = Ad_{T^-1 T_r} V_r of the path's T_r, V_r, it moves by V - V_g. So

    A V_rel = 0,    A (J vdot + (Jdot v - d/dt V_g)) = -Adot V_rel,    d/dt V_g = Ad Vdot_r - ad_V V_g

and every contact works as it is, given the frame as the ground sees it: its pose, its twist, its drift.
"""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from .frame import Frame
from .qp import Array
from .reference import Reference, Sample, seen_from
from .state import State


class Ride:
    """The motion of the ground: that of a body that is carried along by `path`, a reference in the world."""

    def __init__(self, path: Reference) -> None:
        self.path, self._start = path, path(0.0).T.copy()
        self._last: tuple[float, Sample] = (0.0, path(0.0))  # all feet ask for the same time

    def displacement(self, t: float) -> pin.SE3:
        """D(t): where the ground at the origin of the world at the start has gone, as a motion of the world's axes."""
        return self._sample(t).T * self._start.inverse()

    def motion(self, t: float, T: pin.SE3) -> Array:
        """(6, 2) twist, and its derivative on the ground, of what the ground carries at T, in the axes of T."""
        sample = self._sample(t)
        return seen_from(sample.T.actInv(T), sample.motion)

    def _sample(self, t: float) -> Sample:
        if self._last[0] != t:
            self._last = (t, self.path(t))
        return self._last[1]

    def seen(self, state: State, name: str) -> Frame:
        """A frame as the ground sees it; computed once a tick. Raises NameNotFound."""
        frame, kept = state.frame(name), state.terms.pairs
        out: Frame | None = kept.get((name, self))
        if out is None:
            out = kept[name, self] = Frame(np.empty((3, 3)), np.empty(3), np.empty(frame.table.shape))
        if out.of != state.count:
            ground = self.motion(state.t, frame.T)
            (w, v), (w_g, v_g) = frame.V.reshape(2, 3), ground[:, 0].reshape(2, 3)
            turning = np.concatenate((_cross(w, w_g), _cross(w, v_g) + _cross(v, w_g)))  # ad_V V_g
            T = self.displacement(state.t).actInv(frame.T)
            out.R[:], out.p[:], out.table[:], out.of, out._T = T.rotation, T.translation, frame.table, state.count, None
            out.V -= ground[:, 0]
            out.drift -= ground[:, 1] - turning
        return out


def _cross(a: Array, b: Array) -> Array:
    return np.asarray(pin.skew(a).dot(b))
