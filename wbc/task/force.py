"""The wrench of a contact: feed-forward, feedback, and what a force loop remembers."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from .. import kernels
from ..analytic import gain_matrix
from ..contact import Contact, Held
from ..dynamics import inertia, mobility
from ..errors import GainError
from ..qp import Array, Rows
from ..state import State
from ..tank import Bounded, Tank, pressed
from ..transition import LOST_SHARE

_NOTHING: Array = np.zeros(0)
RATE = 500.0  # [N/s] at which the target of a force is followed


class ForceLoop(NamedTuple):
    """One force loop at a tick; `filtered`, `integral`, `yielded` and `last` are its memory.

    `error` and `integral` are over the multipliers (k,) or, under the book's law, over the whole wrench (6,).
    """

    filtered: Array | None = None  # (6,) measured wrench
    integral: Array = _NOTHING  # [N s, N m s]
    yielded: Array | None = None  # (k,) what limits took from the command, filtered as the wrench is; None: nothing
    last: Array | None = None  # (k,) what they took in the last tick
    error: Array = _NOTHING
    command: Array = _NOTHING  # (k,) the multipliers asked for
    cut: str = ""  # what took from the target or the command because the world only pushes: push or friction
    pressed: bool = True  # whether the measured force is such that the integral may grow
    tank: Tank | None = None


_NEW_LOOP = ForceLoop()


class Released(NamedTuple):
    """A contact that is lost: (k,) what its rows are pulled back by, and the share of its force that it is felt for
    with."""

    pull: Array
    share: float


class ForceTask:
    """Force control on a contact: lambda = lambda_d + Kp e + Ki int e - K_damp A V (book 11.36, multipliers).

    Parameters: `contact` and its object; `target`: lambda_d (k,) [N, N m], or with `wrench` the
    wrench F_d (6,) in the frame's axes, lambda_d = (A')^+ F_d; an array, or t -> array; `kp`, `ki` [1/s], `damping`
    [N s/m, N m s/rad] over the contact's axes; `filter`: cutoff of the measured wrench [Hz] or None; `integral_limit`
    on Ki int e [N, N m]; `rate` at which the target is followed: over the axes, or a number [N/s] of forces, of which a
    tenth [N m/s] is that of moments; `tank`: what bounds the energy that it brings in. The error is that of the
    constrained axes alone, e = lambda_d - (A')^+ F, less what limits took from the command, which is no error; and what
    is waited for is none: without a tenth of the desired force along it the integral only goes back to zero
    (anti-windup; both exactly nothing while no limit is active and the contact holds). `law="book"` projects the whole
    measured F_e by I - P, and leaves the bias Lam Adot V in the force.
    """

    def __init__(
        self,
        contact: str,
        held_by: Contact,
        target: Array | Callable[[float], Array],
        kp: Any = 0.0,
        ki: Any = 0.0,
        damping: Any = 0.0,
        filter: float | None = None,
        integral_limit: float = math.inf,
        law: str = "compensated",
        wrench: bool = False,
        rate: Any = RATE,
        tank: Bounded | None = None,
    ) -> None:
        self.tank = tank
        self.contact, self.law, self._held_by, self.wrench = contact, law, held_by, wrench
        self.target = _copied(target) if callable(target) else _always(np.array(target, float))
        k = held_by.k
        self._book = law == "book"
        self.Kp, self.Ki = (self._gain(K, k, name) for K, name in ((kp, "kp"), (ki, "ki")))
        self.K_damp = gain_matrix(damping, k, "damping")
        self._K, self._brakes = np.hstack((self.Kp, self.Ki)), -self.K_damp if self.K_damp.any() else None
        self.filter, self.integral_limit = filter, integral_limit
        self._smoothed = (-1.0, 1.0)  # the last dt and its alpha
        self.axes = held_by.axes
        self.rate = _rates(held_by.axes, rate)

    def _gain(self, K: Any, k: int, name: str) -> Array:
        if not self._book:
            return gain_matrix(K, k, name)
        if np.ndim(K) == 0 or len(K) == 6:
            return gain_matrix(K, 6, name)
        raise GainError(
            f"{name}: under law: book the gains act on the whole wrench; expected a number or 6 of them, got {len(K)}"
        )

    @cached_property
    def listens(self) -> bool:
        """Whether it goes by what is measured."""
        return bool(self.Kp.any() or self.Ki.any()) or self._held_by.feedforward == "measured"

    def smoothing(self, dt: float) -> float:
        """alpha of the first-order filter s += alpha (F - s)."""
        if self.filter is None:
            return 1.0
        if dt != self._smoothed[0]:  # one exponential a change of dt
            self._smoothed = (dt, 1.0 - math.exp(-2.0 * math.pi * self.filter * dt))
        return self._smoothed[1]

    def desired(self, state: State) -> Array:
        """(k,) lambda_d, with what `targets` overrides; from `wbc.jump` on, what is followed of it."""
        if (followed := state.followed.get(self.contact)) is not None:
            return followed
        lam = self.target(state.since(self))
        if self.wrench:
            lam = state.contacts[self.contact].inverse.dot(lam)
        if state.targets:
            lam = lam.copy()
            for i, axis in enumerate(self.axes):
                lam[i] = state.targets.get(f"{self.contact}.{axis}", lam[i])
        return lam

    def begin(self, state: State, lam: Array) -> ForceLoop:
        """The memory of a loop that begins: its first command is `lam` (k,), from which it moves to the target.

        The filter starts at the raw reading, and the integral makes up what the target and the error leave. Without a
        reading or an integral gain the loop begins at its target.
        """
        held: Held = state.contacts[self.contact]
        measured, desired = state.measured.get(self.contact), self.desired(state)
        if measured is None:
            return _NEW_LOOP
        if held.cone is not None:
            desired, _ = held.cone.cut(desired)
        rest = lam - desired
        error = desired - held.inverse.dot(measured)
        if self._book:
            rest, error = held.A.T.dot(rest), held.A.T.dot(desired) - measured
        return ForceLoop(measured.copy(), self.integral_for(rest - self.Kp.dot(error)))

    def integral_for(self, part: Array) -> Array:
        """What the integral must be for Ki int e to be this part of the command; zero without an integral gain."""
        return np.asarray(np.linalg.solve(self.Ki, part), float) if self.Ki.any() else np.zeros(part.size)

    def sense(self, state: State, target: Array) -> tuple[Array | None, Array, Array | None, Array, bool]:
        """Filtered wrench, integral, what limits took, error, and whether the contact is felt to hold; without a sensor
        the loop is open (book 11.33)."""
        held: Held = state.contacts[self.contact]
        loop, measured = state.loops[self.contact], state.measured.get(self.contact)
        size = 6 if self._book else target.size
        integral = loop.integral if loop.integral.size == size else np.zeros(size)
        yielded = self._yielded(loop, state.dt)
        if measured is None:
            return loop.filtered, integral, yielded, np.zeros(size), False
        # what a limit took is no error: counted as one, it would wind up, and strike when the limit lets go
        desired = target if yielded is None else target + yielded
        past = measured if loop.filtered is None else loop.filtered
        filtered, error = np.empty(6), np.empty(desired.size)
        alpha, A = self.smoothing(state.dt), held.A
        holds = kernels.sense(measured, past, alpha, held.inverse, desired, A, target, LOST_SHARE, filtered, error)
        return filtered, integral, yielded, A.T.dot(desired) - filtered if self._book else error, holds

    def _yielded(self, loop: ForceLoop, dt: float) -> Array | None:
        if loop.yielded is None and loop.last is None:
            return None
        past = np.zeros(self._held_by.k) if loop.yielded is None else loop.yielded
        last = 0.0 if loop.last is None else loop.last
        now: Array = past + self.smoothing(dt) * (last - past)
        return now if now.dot(now) > 1e-20 else None

    def rows(self, state: State) -> Rows:
        held: Held = state.contacts[self.contact]
        if self.contact in state.released:
            return self._let_go(state, held, state.released[self.contact].share)
        command, cut = self.desired(state), ""
        if held.cone is not None:
            command, cut = held.cone.cut(command)  # a target that no contact could answer is no error
        filtered, integral, yielded, error, holds = self.sense(state, command)
        G, _, K = state.primary
        k = command.size
        # a motion task on this contact has computed the mobility already: its rows begin with the contact's
        metric = K[:k, :k] if G is held.stack else mobility(state, held.G)
        if self._book:
            # (I - P) F = A' Lam A M_C^-1 F, and A M_C^-1 F = G M^-1 J' F; the constraint adds Lam Adot V of its own
            feedback = self._K.dot(np.concatenate((error, integral)))
            push = held.G.dot(state.solve_M(held.seen.J.T.dot(feedback)))
            if held.Adot_V is not None:
                push += held.Adot_V
            command = command + inertia(metric).dot(push)
        else:
            command = command.copy()
            kernels.feedback(self._K, error, integral, command)
        tank = None
        if self.tank is not None:
            tank = self.tank.press(state.loops[self.contact].tank, command, held.slip, metric, state.dt)
            shut = (1.0 - tank.valve) * command
        if self._brakes is not None:
            kernels.feedback(self._brakes, held.slip, _NOTHING, command)
        asked = command
        if tank is not None and tank.limited:
            command = asked - shut  # what the valve takes is what a limit takes
        if held.cone is not None:
            command, short = held.cone.cut(command)
            cut = cut or short
        state.loops[self.contact] = ForceLoop(filtered, integral, yielded, None, error, asked, cut, holds, tank)
        return Rows("", {self.contact: None}, command, command, metric)

    def _let_go(self, state: State, held: Held, share: float) -> Rows:
        """A share of the target is asked of a contact that is lost, and nothing is learnt from it."""
        loop, command, error = state.loops[self.contact], share * self.desired(state), np.zeros(self.Kp.shape[0])
        if held.cone is not None:
            command, _ = held.cone.cut(command)
        integral = loop.integral if loop.integral.size == error.size else error
        state.loops[self.contact] = ForceLoop(loop.filtered, integral, error=error, command=command)
        return Rows("", {self.contact: None}, command, command, mobility(state, held.G))

    def advance(self, state: State, lam: Array) -> ForceLoop:
        """The memory for the next tick, from the multipliers (k,) that the limits allowed."""
        loop: ForceLoop = state.loops[self.contact]
        integral, last = np.empty(loop.error.size), np.empty(lam.size)
        nothing = kernels.advance(lam, loop.command, loop.integral, loop.error, state.dt, loop.pressed, integral, last)
        if self.integral_limit < math.inf:
            bound = self.integral_limit / np.maximum(self.Ki.diagonal(), 1e-12)
            integral = np.clip(integral, -bound, bound)
        tank = None if loop.tank is None else pressed(loop.tank, lam)
        return ForceLoop(loop.filtered, integral, loop.yielded, None if nothing else last, tank=tank)


def _rates(axes: tuple[str, ...], rate: Any) -> Array:
    """(k,) over the axes of a contact."""
    given = np.array(rate, float) if np.ndim(rate) else np.array([0.1 * rate if a[0] == "m" else rate for a in axes])
    if given.shape != (len(axes),) or not (given > 0.0).all():
        raise GainError(f"rate: expected a number above 0, or {len(axes)} of them ({', '.join(axes)}), got {rate}")
    return given


def _copied(target: Callable[[float], Array]) -> Callable[[float], Array]:
    """It may answer with the same array again and again, written to in between."""
    return lambda t: np.array(target(t), float)


def _always(value: Array) -> Callable[[float], Array]:
    return lambda t: value
