"""Impedance and admittance as tasks of the quadratic program (book 11.7), on any axes, beside any other task.

    M (xdd - xdd_d) = B xd_e + K x_e + f_ext,     x_e, xd_e: pose and twist error along the axes of the task

f_ext is what the environment applies to the robot, minus the wrench F of the robot on it. An impedance asks for this
acceleration, with F counted among the known loads, so that the answer of the arm is exact. Without a mass it asks for

    xdd = xdd_d + Lam^-1 (B xd_e + K x_e),     Lam^-1 = S J M(q)^-1 J' S', within the contacts,

and the arm's own Lam is felt; f_ext need not be known. An admittance moves a reference by the first equation, and the
arm follows it. Along the other axes other tasks decide. K may change over time (`K_scale`); then, and where answers
come late, a tank bounds the energy that this brings in (`tank`), with K and f_ext as it lets them pass.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin

from ..analytic import gain_matrix
from ..dynamics import inertia, mobility, unheld
from ..errors import GainError
from ..observer import MomentumObserver, Observed, smoothing
from ..qp import Array, Rows
from ..reference import Reference, Sample, Scalar
from ..singular import LEAST
from ..state import State
from ..tank import Bounded, Tank
from ..wrench import VELOCITY_AXES
from .following import SPEEDS, Following
from .motion import pose_errors

SOURCES = ("measured", "observer", "acceleration", "none")


class Felt(NamedTuple):
    """What a task knows of the push at a tick, and remembers of it at the next: a value."""

    F: Array | None = None  # (6,) robot on environment, filtered, at the frame and in its axes
    V: Array | None = None  # (6,) twist of the frame
    Vdot: Array | None = None  # (6,) measured acceleration, one tick old
    observed: Observed | None = None
    T: Array | None = None  # (4, 4) pose of the mass that an admittance moves
    motion: Array | None = None  # (6, 2) its twist and acceleration
    tank: Tank | None = None


NEW = Felt()


class Compliance(Following):
    """What impedance and admittance share: where, along what, from which source the push is known.

    Parameters: `frame`; `reference` (t -> Sample); `M`, `B`, `K`: numbers, vectors over the axes, or matrices, all zero
    or positive definite; `axes` from wx ... vz, or with `contact` the names of its free motions; `error`: "log" or
    "split"; `source`: "measured", "observer" (a MomentumObserver stands in `observer`), "acceleration", or "none";
    `filter` [Hz] of the measured wrench; `K_scale`: by what K is multiplied at a time [1], `tank`.
    """

    carries = True  # whether the push counts among the known loads
    lag = 0.0  # [s] with which the arm follows the mass, where that is not the arm itself

    def __init__(
        self,
        frame: str,
        reference: Reference,
        M: Any,
        B: Any,
        K: Any,
        axes: tuple[str, ...] = VELOCITY_AXES,
        contact: str | None = None,
        error: str = "log",
        source: str = "measured",
        filter: float | None = None,
        observer: MomentumObserver | None = None,
        singular: float = LEAST,
        jump: tuple[float, float] | None = SPEEDS,
        K_scale: Scalar | None = None,
        tank: Bounded | None = None,
    ) -> None:
        super().__init__(reference, singular, jump)
        self.K_scale, self.tank = K_scale, tank
        self.frame, self.axes, self.contact = frame, axes, contact
        self.split, self.source, self.filter, self.observer = error == "split", source, filter, observer
        if source not in SOURCES or (source == "observer") != (observer is not None):
            raise GainError(f"external: expected one of {', '.join(SOURCES)}, the second with an observer")
        n = len(axes)
        self.M, self.B, self.K = gain_matrix(M, n, "M"), gain_matrix(B, n, "B"), gain_matrix(K, n, "K")
        self.massless = not self.M.any()
        self._inverse = np.zeros((n, n)) if self.massless else np.linalg.inv(self.M)
        self._S = None if contact is not None else np.eye(6)[[VELOCITY_AXES.index(a) for a in axes]]

    @property
    def feels(self) -> bool:
        """Whether the task needs to know of the push."""
        return self.source != "none"

    def selection(self, state: State) -> Array:
        """(s, 6) rows S that pick the axes of the task."""
        return self._S if self._S is not None else state.contacts[self.contact].free  # type: ignore[index]

    def lift(self, state: State) -> Array:
        """(6, s) pseudo-inverse of these rows."""
        return self._S.T if self._S is not None else state.contacts[self.contact].lift  # type: ignore[index]

    def errors(self, T: pin.SE3, V: Array, desired: Sample) -> tuple[Array, Array, Array]:
        """(6,), (6,), (6,): X_e, V_e and d/dt(Ad V_d) of a frame at T that moves with V."""
        return pose_errors(T, V, desired, self.split)

    def mobility(self, state: State) -> Array:
        """(s, s) Lam^-1: the acceleration along the axes that unit forces along them cause, within the contacts."""
        return unheld(state, self.selection(state).dot(state.frame(self.frame).J))

    def push(self, state: State) -> Array:
        """(s,) f_ext along the axes of the task; zero while nothing is known of it."""
        F = state.felt.get(self, NEW).F
        S = self.selection(state)
        if F is None:
            return np.zeros(S.shape[0])
        return -self.lift(state).T.dot(F)

    def wanted(self, state: State) -> Array:
        """(s, s) the stiffness of this tick, as long as no tank has to pay for it."""
        if self.K_scale is None:
            return self.K
        return self.K_scale(state.since(self))[0] * self.K

    def passes(self, state: State) -> tuple[Array, float, float]:
        """(s, s) the stiffness that acts, what share of the push is answered, and how the motion is braked [1/s]."""
        tank = state.felt.get(self, NEW).tank
        return (self.wanted(state), 1.0, 0.0) if tank is None else (tank.K, tank.valve, tank.brake)

    def fill(self, state: State, felt: Felt, last: Felt, T: pin.SE3, V: Array, late: bool) -> Felt:
        """The tank at a tick, of a mass at T that moves with V (6,)."""
        if self.tank is None:
            return felt
        state.felt[self] = felt
        S, frame, desired = self.selection(state), state.frame(self.frame), self.followed(state)
        X_e, V_e, _ = self.errors(T, V, desired)
        rate = S.dot(V_e) if late else S.dot(self.errors(frame.T, frame.V, desired)[1])
        known = self.source in ("measured", "observer") and not self.massless and felt.F is not None
        tank = self.tank.comply(
            last.tank, S.dot(X_e), S.dot(V_e), self.wanted(state), self.B,
            inertia(self.mobility(state)) if self.massless else self.M, self.push(state) if known else None,
            -state.dt * rate, state.dt, late, self.lag,
        )  # fmt: skip
        state.felt[self] = felt = felt._replace(tank=tank)
        return felt

    def feel(self, state: State, measured: Array | None, tau: Array, last: Felt) -> Felt:
        """The push of this tick; `measured` (6,) at the frame, `tau` what acted since the last tick."""
        F, V, Vdot, observed = last.F, state.frame(self.frame).V.copy(), None, None
        if self.source == "measured" and measured is not None:
            alpha = 1.0 if self.filter is None or F is None else smoothing(self.filter, state.dt)
            F = measured if F is None else F + alpha * (measured - F)
        elif self.observer is not None:
            observed = self.observer.update(state, tau, last.observed)
            F = self.observer.wrench(state, observed.residual, self.frame)
        elif self.source == "acceleration" and last.V is not None and state.dt > 0.0:
            Vdot = (V - last.V) / state.dt
        return Felt(F, V, Vdot, observed)

    def acceleration(self, state: State) -> Array:
        """(s,) the acceleration that is asked for, along the axes of the task."""
        raise NotImplementedError

    def target(self, state: State) -> tuple[Array, Array]:
        """The task's own rows G vdot = b: (s, nv) and (s,)."""
        frame, S = state.frame(self.frame), self.selection(state)
        return S.dot(frame.J), self.acceleration(state) - S.dot(frame.drift)

    def rows(self, state: State) -> Rows:
        G, b = self.target(state)
        return Rows("", {"vdot": G}, b, b, inertia(mobility(state, G)))


class ImpedanceTask(Compliance):
    """Force out of motion (book 11.65 to 11.67). `compensate="gravity"` leaves the arm's velocity terms to be felt."""

    def __init__(self, *arguments: Any, compensate: str = "dynamics", **more: Any) -> None:
        super().__init__(*arguments, **more)
        self.gravity_only = compensate == "gravity"
        self.carries = self.source in ("measured", "observer")

    def feel(self, state: State, measured: Array | None, tau: Array, last: Felt) -> Felt:
        frame = state.frame(self.frame)
        return self.fill(state, super().feel(state, measured, tau, last), last, frame.T, frame.V, late=True)

    def acceleration(self, state: State) -> Array:
        frame, S = state.frame(self.frame), self.selection(state)
        X_e, V_e, ahead = self.errors(frame.T, frame.V, self.followed(state))
        K, share, brake = self.passes(state)
        ahead, spring = S.dot(ahead), self.B.dot(S.dot(V_e)) + K.dot(S.dot(X_e))
        if brake:
            ahead = ahead + brake * S.dot(V_e)
        if self.massless:
            return np.asarray(ahead + self.mobility(state).dot(spring))
        if self.source != "acceleration":
            return np.asarray(ahead + self._inverse.dot(spring + share * self.push(state)))
        # what the arm did in the last tick tells the push: Lam y = (Lam - M) (xdd - xdd_d) + B xd_e + K x_e
        W, Vdot = self.mobility(state), state.felt.get(self, NEW).Vdot
        past = np.zeros(len(ahead)) if Vdot is None else S.dot(Vdot) - ahead
        return np.asarray(ahead + past + W.dot(spring - self.M.dot(past)))

    def target(self, state: State) -> tuple[Array, Array]:
        G, b = super().target(state)
        return G, b + self.selection(state).dot(state.frame(self.frame).drift) if self.gravity_only else b


class AdmittanceTask(Compliance):
    """Motion out of force (book 11.68 ff.): the mass, spring and damper is integrated, the arm follows it by kp, kd.

    `law="printed"` takes the arm itself for the mass and leaves f_ext uncancelled, as the book does; kp and kd then
    meet no error. The push still moves the arm: `analytic.rendered_as_printed` is felt.
    """

    def __init__(self, *arguments: Any, kp: Any = 100.0, kd: Any = 20.0, law: str = "compensated", **more: Any) -> None:
        super().__init__(*arguments, **more)
        if self.massless:
            raise GainError("M: an admittance moves a mass, expected it above 0")
        self.printed = law == "printed"
        self.carries = not self.printed
        self.Kp, self.Kd = (gain_matrix(gain, len(self.axes), name) for gain, name in ((kp, "kp"), (kd, "kd")))
        self.lag = 0.0 if self.printed else float(self.Kd.trace() / max(self.Kp.trace(), 1e-9))

    def feel(self, state: State, measured: Array | None, tau: Array, last: Felt) -> Felt:
        felt = super().feel(state, measured, tau, last)
        state.felt[self] = felt
        frame, S = state.frame(self.frame), self.selection(state)
        T, V = frame.T, frame.V
        if not self.printed and last.T is not None and last.motion is not None:
            T, V = self._moved(state, last.T, last.motion)
        felt = self.fill(state, felt, last, T, V, late=self.printed)
        K, share, brake = self.passes(state)
        X_e, V_e, ahead = self.errors(T, V, self.followed(state))
        spring = self.B.dot(S.dot(V_e)) + K.dot(S.dot(X_e))
        along = S.dot(ahead) + self._inverse.dot(spring + share * self.push(state))
        if brake:
            along = along + brake * S.dot(V_e)
        motion = np.column_stack((V, ahead + self.lift(state).dot(along - S.dot(ahead))))
        return felt._replace(T=T.homogeneous, motion=motion)

    def _moved(self, state: State, pose: Array, motion: Array) -> tuple[pin.SE3, Array]:
        """Pose and twist of the mass one tick on; along the axes that are not the task's it goes with the frame."""
        V = motion[:, 0] + state.dt * motion[:, 1]
        step = pin.exp6(pin.Motion(V[3:] * state.dt, V[:3] * state.dt))
        T = pin.SE3(pose) * step
        S = self.selection(state)
        if S.shape[0] == 6:
            return T, V
        frame = state.frame(self.frame)
        P, still = self.lift(state).dot(S), Sample(T, np.column_stack((V, np.zeros(6))))
        X, V_e, _ = self.errors(frame.T, frame.V, still)
        X, V = P.dot(X), frame.V + P.dot(V_e)
        if self.split:
            return pin.SE3(frame.T.rotation @ pin.exp3(X[:3]), frame.T.translation + frame.T.rotation @ X[3:]), V
        return frame.T * pin.exp6(pin.Motion(X[3:], X[:3])), V

    def acceleration(self, state: State) -> Array:
        frame, S, felt = state.frame(self.frame), self.selection(state), state.felt.get(self, NEW)
        if felt.T is None or felt.motion is None:  # nothing has been felt yet
            return np.zeros(S.shape[0])
        X_e, V_e, ahead = self.errors(frame.T, frame.V, Sample(pin.SE3(felt.T), felt.motion))
        return np.asarray(S.dot(ahead) + self.Kp.dot(S.dot(X_e)) + self.Kd.dot(S.dot(V_e)))
