"""How the world, or another body, holds a frame: natural constraints A(q) V = 0 (book eq. 11.40 ff., our (1) and (2)).

A contact is a class with `frame`, `A(state)` (k, 6) and `Adot_V(state)` (k,) in the body axes of its frame, angular
part first. `A' lambda` is what the robot applies to the environment. One source serves the constraint, the force
variable and the force task; `free(state)` (6 - k, 6) picks the motion that is left, an orthonormal complement unless
the contact knows better. With `against` a second frame takes the place of the world: V, J and the pose are those of the
first seen from the second, and the wrench acts on both bodies.
"""

from __future__ import annotations

import copy
from abc import ABC, abstractmethod
from typing import Any, NamedTuple

import numpy as np

from .. import kernels
from ..errors import WrenchError
from ..footing import Footing
from ..frame import Frame
from ..friction import Cone, Unilateral
from ..pair import seen
from ..qp import Array, Rows
from ..ride import Ride
from ..state import State
from ..wrench import WRENCH_AXES

_ZEROS = np.zeros(6)


class Held:
    """What a contact demands at this tick: G vdot = rhs, with G = A J and rhs = -(A Jdot v + Adot V).

    A (k, 6); `Adot_V` (k,), None where it is always zero; `free` (6 - k, 6): rows that pick the free motion; `inverse`
    (k, 6): (A')^+, multipliers of a wrench; `table` (6, nv + 2): A, then the free rows, times J, Jdot v and V of the
    frame; `stack` (6, nv) and `bias` (6,): what they ask of vdot when the free ones do not accelerate, G and rhs first;
    `slip` (k,): A V, zero while the contact holds; `B` (k, 6) is B': the wrench of the robot on its environment is
    B lambda, A' lambda where friction is not modelled; `push` (k, nv): B' J, so that the torque of the multipliers is
    push' lambda; `cone`: inequalities on them, where the contact only pushes; `lifted`: it is in the air, carries
    nothing and goes back down; `seen`: the frame as what holds it sees it. Its arrays are those of one tick.
    """

    A: Array
    Adot_V: Array | None
    free: Array
    inverse: Array
    B: Array
    push: Array
    cone: Cone | None
    seen: Frame
    lifted: bool = False
    _lift: Array

    def __init__(self, frame: str, k: int, table: Array, bias: Array) -> None:
        self.frame, self.table, self.bias, n = frame, table, bias, table.shape[1] - 2
        self.stack, self.G, self.rhs = self.table[:, :n], self.table[:k, :n], self.bias[:k]
        self.slip = self.table[:k, n + 1]
        self._lifted: Array | None = None  # the free rows that `_lift` is of

    @property
    def lift(self) -> Array:
        """(6, 6 - k) pseudo-inverse of the free rows."""
        if self._lifted is not self.free:
            self._lifted, self._lift = self.free, np.linalg.solve(self.free.dot(self.free.T), self.free).T
        return self._lift

    def unconstrained(self, F: Array) -> Array:
        """(6,) the part of a wrench that the constraint does not cause: F - A' (A')^+ F."""
        return F - self.inverse.dot(F).dot(self.A)


class Settling(NamedTuple):
    """How motion against a contact dies out: A Vdot + Adot V = -c with c = `rate` A V, each row at most `most`.

    Without it a contact that is held by accelerations alone drifts by rounding and by the softness of what it stands
    on. It is damping, never stiffness: where the contact is, there it stays. The bound keeps a contact that starts
    unsettled from asking for more than its environment can give: well below g, a floor need not pull.
    """

    rate: float = 20.0  # [1/s]
    most: float = 1.0  # [rad/s^2, m/s^2]


class Contact(ABC):
    """Base of all contacts. `axes` names the multipliers; by default lambda1, lambda2, ...

    `feedforward`: "measured" counts the part of the measured wrench that the constraint does not cause (friction, the
    load of a hinge) as known; "modelled" counts the drag of sliding friction into the contact's own wrench; "none"
    leaves it to the feedback. `pushes`: the direction in which it only pushes, and friction across it. `settling`: what
    it does about motion against it, by default nothing. `footing`: the plane it stands on, off which it carries
    nothing. `steady`: its multipliers are forces along axes of its own, so that their cone never changes. `against`:
    the frame of another body that holds it, instead of the world; places and fixed axes of a contact are then told in
    the axes of that frame. `ride`: how its ground moves; by default it stands still.
    """

    frame: str
    k: int
    against: str | None = None
    feedforward: str = "none"
    pushes: Unilateral | None = None
    settling: Settling | None = None
    footing: Footing | None = None
    ride: Ride | None = None
    steady = False

    @abstractmethod
    def A(self, state: State) -> Array:
        """(k, 6) natural constraints in the body axes of `frame`."""

    @abstractmethod
    def Adot_V(self, state: State) -> Array:
        """(k,) time derivative of A times the twist of `frame`."""

    def seen(self, state: State) -> Frame:
        """Its frame as what holds it sees it."""
        return seen(state, self.frame, self.against) if self.ride is None else self.ride.seen(state, self.frame)

    def free(self, state: State) -> Array:
        """(6 - k, 6) rows that pick the free motion."""
        return complement(self.A(state))

    def turn(self, state: State) -> Array | None:
        """(3, 3) rotation from the axes in which the contact is given to those of `frame`; None: they are the same."""
        return None

    def known(self, state: State, held: Held, F: Array) -> Array:
        """(6,) what of a measured wrench is fed forward: its part along the free axes, drag within the cone."""
        free = held.unconstrained(F)
        return free if self.pushes is None else self.pushes.capped(free, F, self.turn(state))

    def without_cone(self) -> Contact:
        """The same without its inequalities."""
        if self.pushes is None:
            return self
        same, same.pushes = copy.copy(self), self.pushes.lifted()
        return same

    @property
    def axes(self) -> tuple[str, ...]:
        return tuple(f"lambda{i + 1}" for i in range(self.k))

    @property
    def free_axes(self) -> tuple[str, ...]:
        return tuple(f"free{i + 1}" for i in range(6 - self.k))

    def pseudo_inverse(self, A: Array) -> Array:
        """(k, 6) (A')^+: multipliers of a wrench, lambda = (A')^+ F."""
        return np.asarray(np.linalg.pinv(A).T, float)

    def hold(self, state: State) -> Held:
        """Evaluate at a state."""
        A, free = self.A(state), self.free(state)
        return self._hold(state, A, free, self.pseudo_inverse(A), np.concatenate((A, free)), self.Adot_V(state))

    def _hold(self, state: State, A: Array, free: Array, inverse: Array, basis: Array, Adot_V: Array | None) -> Held:
        held, frame = self._storage(state, len(basis)), self.seen(state)
        kernels.select(basis, frame.table, held.table, held.bias)
        return self._demand(state, held, frame, A, free, inverse, Adot_V)

    def _storage(self, state: State, rows: int = 6) -> Held:
        """What was held at the last tick, to be filled again."""
        held: Held | None = state.terms.held.get(self)
        if held is None or held.bias.size != rows:
            held = Held(self.frame, self.k, np.empty((rows, state.v.size + 2)), np.empty(rows))
            state.terms.held[self] = held
        return held

    def _demand(
        self, state: State, held: Held, frame: Frame, A: Array, free: Array, inverse: Array, Adot_V: Array | None
    ) -> Held:
        """The rest of what is held, once its rows are selected."""
        footing, held.seen = self.footing, frame
        level = state.grounds.get(self, 0.0) if state.grounds else 0.0
        held.lifted = footing is not None and footing.lifted(frame, level)
        if footing is not None and held.lifted:
            held.rhs -= footing.asked(A, frame, level)
            if Adot_V is not None:
                held.rhs -= Adot_V
        elif self.settling is not None:
            kernels.settle(_ZEROS[: self.k] if Adot_V is None else Adot_V, held.slip, *self.settling, held.rhs)
        elif Adot_V is not None:
            held.rhs -= Adot_V
        held.A, held.Adot_V, held.free, held.inverse = A, Adot_V, free, inverse
        if self.pushes is None:
            held.B, held.push, held.cone = A, held.G, None
        else:
            held.B, held.push, held.cone = self.pushes.hold(self, state, A, held.G, inverse)
        return held

    def rows(self, name: str, held: Held) -> Rows:
        """The hard rows A (J vdot + Jdot v) = -Adot V."""
        return Rows(name, {"vdot": held.G}, held.rhs, held.rhs)

    def fill(self, held: Held, rows: Rows) -> None:
        """Put them in rows where they stand."""
        A: Any = rows.A
        kernels.demand(held.G, held.rhs, A["vdot"], rows.lo, rows.hi)

    def labels(self, name: str) -> tuple[str, ...]:
        """Names of its rows and multipliers."""
        return tuple(f"{name}.{axis}" for axis in self.axes)

    def multipliers(self, wrench: Array, state: State, tolerance: float = 1e-9) -> Array:
        """(k,) lambda with A' lambda = wrench (6,). Raises WrenchError when the contact cannot carry it."""
        A = self.A(state)
        lam = self.pseudo_inverse(A) @ wrench
        rest = wrench - A.T @ lam
        bad = np.flatnonzero(np.abs(rest) > tolerance * (1.0 + np.abs(wrench).max()))
        if bad.size:
            names = ", ".join(f"{WRENCH_AXES[i]} ({rest[i]:+.3g})" for i in bad)
            raise WrenchError(
                f"the contact cannot carry {names} of the desired wrench: it lies outside the column space of A'; "
                "ask for a force only where the world holds the frame"
            )
        return lam


def complement(A: Array) -> Array:
    """(6 - k, 6) orthonormal rows that annihilate A'."""
    return np.linalg.svd(A.reshape(-1, 6))[2][np.linalg.matrix_rank(A) if A.size else 0 :]
