"""Tasks of a whole body: where its mass is, its momentum, how the contacts share what that needs, its posture.

By Newton and Euler the wrenches of all contacts add up to what the motion of the centre of mass needs; how they share
it is free where they have more than six components.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin

from .. import kernels
from ..analytic import gain_matrix
from ..axes import MOMENTUM_AXES
from ..dynamics import inertia
from ..errors import GainError
from ..frame import Frame
from ..qp import Array, Rows
from ..reference import Reference
from ..singular import LEAST
from ..state import State
from .following import SPEEDS, Following
from .posture import PostureTask

_ORDER = [3, 4, 5, 0, 1, 2]
BASE_SHARE = 1e-3  # what a posture's base weighs against its joints
FADE = 0.5  # [s] in which contacts change what they share
SOLE_RADIUS = 0.05  # [m] at which a moment of a contact weighs as much as a force


def mass(state: State) -> float:
    """Of the whole robot [kg]."""
    return state.terms.mass


def load(state: State) -> float:
    """Of all that moves with the base, which the contacts carry [kg]."""
    return state.terms.load


def on_base(state: State, seen: Frame, F: Array) -> Array:
    """(3,) force that a wrench F (6,) of `seen` on its environment takes from the base, in the world [N].

    A foot presses what it takes; a palm that holds the base from outside gives to it.
    """
    return np.asarray(state.terms.com[2].dot(seen.J[:, :3].T.dot(F)))


def com(state: State) -> tuple[Array, Array, Array]:
    """(3,) the centre of mass in the world [m], (3, nv) its Jacobian, (3,) Jdot v [m/s^2]."""
    robot, terms = state.robot, state.terms
    c, J, R, g = terms.com
    if robot.floats:  # its acceleration is what the base's equations of force say, over the mass
        drift = np.empty(3)
        kernels.carried_along(R, terms.h, g, terms.mass, drift)
    else:
        pin.centerOfMass(robot.model, terms.data, state.q, state.v, np.zeros(state.v.size))
        drift = terms.data.acom[0].copy()
    return c, J, drift


def middle(state: State, shares: Mapping[str, float]) -> Array:
    """(3,) the point between frames, by their shares of one [m]."""
    return np.asarray(sum(share * state.frame(frame).T.translation for frame, share in shares.items()))


class ComTask(Following):
    """The centre of mass c on its path: cddot = cddot_d + kp (c_d - c) + kd (cdot_d - cdot) along the world's axes.

    Parameters: `path` (t -> Sample, whose origin is c_d in the world); `kp` [1/s^2], `kd` [1/s]: numbers, vectors over
    (x, y, z) or matrices. `over`: frame -> share of one: where the task begins while the robot moves, the path is
    shifted so that it starts over their middle as they stand then. The metric is the mass: the cost is that of the
    force which is missing.
    """

    def __init__(
        self,
        path: Reference,
        kp: Any = 40.0,
        kd: Any = 12.0,
        over: Mapping[str, float] | None = None,
        singular: float = LEAST,
        jump: tuple[float, float] | None = SPEEDS,
    ) -> None:
        super().__init__(path, singular, jump)
        self.over = dict(over or {})
        self.Kp, self.Kd = gain_matrix(kp, 3, "kp"), gain_matrix(kd, 3, "kd")
        self._K = np.hstack((self.Kp, self.Kd))

    def desired(self, state: State) -> tuple[Array, Array, Array]:
        """(3,) c_d, its velocity and its acceleration in the world."""
        sample = self.followed(state)
        R, (w, v), (_, vdot) = sample.T.rotation, sample.V.reshape(2, 3), sample.Vdot.reshape(2, 3)
        return sample.T.translation, R.dot(v), R.dot(vdot + pin.skew(w).dot(v))

    def target(self, state: State) -> tuple[Array, Array]:
        """The task's own rows G vdot = b: (3, nv) and (3,)."""
        (c, J, drift), sample, b = com(state), self.followed(state), np.empty(3)
        kernels.point_target(sample.R, sample.p, sample.motion, c, J, state.v, drift, self._K, b)
        return J, b

    def rows(self, state: State) -> Rows:
        G, b = self.target(state)
        return Rows("", {"vdot": G}, b, b, state.terms.masses)


def momentum(state: State) -> tuple[Array, Array, Array]:
    """(6,) h = (k, l) about the centre of mass in the axes of the world [N m s, N s], (6, nv) its map, (6,) what of
    hdot is not vdot's [N m, N]."""
    robot, data = state.robot, state.terms.data
    if robot.floats:  # as of `com`: the base's six equations say what moves all of the robot
        R, f = data.oMi[1].rotation, data.nle[:6]
        l_dot = R.dot(f[:3])
        k_dot = R.dot(f[3:]) + pin.skew(data.oMi[1].translation - data.com[0]).dot(l_dot)
        drift = np.concatenate((k_dot, l_dot + data.mass[0] * robot.model.gravity.linear))
    else:
        still = np.zeros(state.v.size)
        drift = pin.computeCentroidalMomentumTimeVariation(robot.model, data, state.q, state.v, still).vector[_ORDER]
    A = data.Ag.reshape(6, state.v.size)[_ORDER]
    return A.dot(state.v), A, drift


class MomentumTask:
    """The centroidal momentum h = (k, l): hdot = hdot_d + kp (h_d - h), on selected axes of the world.

    Parameters: `kp` [1/s], a number, a vector over the axes or a matrix; `axes`: names from kx ky kz (angular, about
    the centre of mass) and lx ly lz (linear); `desired`: t -> (6,) h_d, (6,) hdot_d, by default zero. The metric is the
    inverse of the inertia that the robot has as one rigid body: the cost is a power over time, as of a motion.
    """

    def __init__(
        self,
        kp: Any = 10.0,
        axes: tuple[str, ...] = MOMENTUM_AXES,
        desired: Callable[[float], tuple[Array, Array]] | None = None,
    ) -> None:
        self.axes, self._desired = axes, desired
        self._own = [MOMENTUM_AXES.index(axis) for axis in axes]
        self.Kp = gain_matrix(kp, len(axes), "kp")

    def desired(self, state: State) -> tuple[Array, Array]:
        """(s,) h_d [N m s, N s] and (s,) its derivative [N m, N] along the axes."""
        if self._desired is None:
            return np.zeros(len(self.axes)), np.zeros(len(self.axes))
        h, hdot = self._desired(state.since(self))
        return h[self._own], hdot[self._own]

    def error(self, state: State) -> Array:
        """(s,) h_d - h [N m s, N s]."""
        return np.asarray(self.desired(state)[0] - momentum(state)[0][self._own])

    def target(self, state: State) -> tuple[Array, Array]:
        """The task's own rows G vdot = b: (s, nv) and (s,)."""
        (h, A, drift), (h_d, hdot_d), own = momentum(state), self.desired(state), self._own
        return A[own], hdot_d + self.Kp.dot(h_d - h[own]) - drift[own]

    def rows(self, state: State) -> Rows:
        G, b = self.target(state)
        whole = np.zeros((6, 6))
        whole[:3, :3], whole[3:, 3:] = state.terms.data.Ig.inertia, mass(state) * np.eye(3)
        return Rows("", {"vdot": G}, b, b, inertia(whole[np.ix_(self._own, self._own)]))


class DistributionTask:
    """How the contacts share what the motion needs: evenly, or from given shares of the weight.

    Together they carry w = -(M_b vdot + bias_b) = P lambda, the base's six equations. Asked for is, of all that carry
    w, the nearest to lambda_0,

        lambda = lambda_0 + D (w - P lambda_0),      D = W^-1 P' (P W^-1 P')^+,

    in the metric W: 1 for a force, 1/r^2 for a moment, r = `SOLE_RADIUS`, over the mass. At rest that is the static
    distribution. As w is that of the very motion, the cost is zero while no inequality is active and competes with no
    task; a cost that drew lambda towards zero, or towards the weight alone, would bend the motion.
    Where the task begins while the robot stands, lambda_0 leads from what the contacts carried then to what is asked
    for, within `FADE`: the contacts take up and lay down their loads without a step.
    `shares`: contact -> share of the weight [1] that lambda_0 presses with; where nothing is given lambda_0 is zero.
    `press`: contact that pushes -> force [N] that is added to lambda_0 along its push. Of two palms on a box these are
    the internal force: P lambda_0 = 0, so that it stays as it is whatever w they share.
    """

    def __init__(self, shares: Mapping[str, float] | None = None, press: Mapping[str, float] | None = None) -> None:
        self.shares, self.press = dict(shares or {}), dict(press or {})
        for key, given in (("shares", self.shares), ("press", self.press)):
            if any(not value >= 0.0 for value in given.values()):
                raise GainError(f"{key}: expected 0 or more of each, got {given}")

    def rows(self, state: State, among: Sequence[str] | None = None) -> Rows:
        """Rows over `vdot` and the multipliers; `among`: the contacts that share, by default all."""
        contacts, begun = state.contacts, state.starts.get(self)
        names = tuple(contacts if among is None else among)
        fade = 1.0 if begun is None else min(max((state.t - begun.t) / FADE, 0.0), 1.0)
        held = [contacts[name] for name in names]
        push, A = np.concatenate([each.push for each in held]), np.concatenate([each.A for each in held])
        k, n = push.shape
        stored: _Shared | None = state.terms.held.get((self, names))
        if stored is None or stored.moved.shape != (k, n):
            stored = state.terms.held[self, names] = _Shared.of({name: len(contacts[name].G) for name in names}, n)
        weight, S, D, moved, metric, columns = stored
        lam = np.zeros(k)
        # a row of A is a unit force, or a unit moment
        kernels.carried(push, A, SOLE_RADIUS, weight, S)
        if self.shares or self.press or fade < 1.0:
            start = 0
            for name, each in zip(names, held, strict=True):
                own = slice(start, start + len(each.G))
                if share := self.shares.get(name, 0.0):
                    f = share * load(state) * state.terms.com[2].T.dot(state.robot.model.gravity.linear)
                    lam[own] = fade * each.inverse[:, 3:].dot(each.seen.J[3:, :3].dot(f))
                if (force := self.press.get(name, 0.0)) and each.cone is not None:
                    lam[own] += fade * force * each.cone.up
                if begun is not None and fade < 1.0 and (before := begun.loads.get(name)) is not None:
                    lam[own] += (1.0 - fade) * before
                start = own.stop
        kernels.share(push, weight, inertia(S), state.M[:6], state.bias, 1.0 / load(state), D, lam, moved, metric)
        if len(contacts) > len(names):
            columns = columns | {o: D.dot(contacts[o].push[:, :6].T) for o in contacts if o not in columns}
        return Rows("", columns, lam, lam, metric)

    def internal(self, state: State, lam: Mapping[str, Array]) -> tuple[float, float]:
        """Internal force that `press` asks for, and that of multipliers by contact (k,) [N].

        N lambda, N = I - D P, moves nothing. Of `press` that is u, whose mean push is what is asked for; of lambda it
        counts along u: (u, lambda)_W / (u, u)_W of it, for N projects orthogonally in W. Not numbers where u is zero.
        """
        held = list(state.contacts.values())
        push = np.concatenate([each.push for each in held])
        weight, S = np.empty(len(push)), np.empty((6, 6))
        kernels.carried(push, np.concatenate([each.A for each in held]), SOLE_RADIUS, weight, S)
        ups = [np.zeros(len(each.A)) if each.cone is None else each.cone.up for each in held]
        asked = np.concatenate([self.press.get(name, 0.0) * up for name, up in zip(state.contacts, ups, strict=True)])
        P = push[:, :6].T
        u = asked - P.T.dot(inertia(S).dot(P.dot(asked))) / weight
        size = float(u.dot(weight * u))
        if size <= 1e-6 * float(asked.dot(weight * asked)):
            return math.nan, math.nan
        pressing = [name in self.press for name in state.contacts for _ in range(len(state.contacts[name].A))]
        mean = float(np.concatenate(ups)[pressing].dot(u[pressing])) / len(self.press)
        return mean, mean * float(u.dot(weight * np.concatenate([lam[name] for name in state.contacts]))) / size


class _Shared(NamedTuple):
    """Storage of what contacts share: filled again at every tick, but for the columns that pick the multipliers."""

    weight: Array  # (k,)
    S: Array  # (6, 6)
    D: Array  # (k, 6)
    moved: Array  # (k, nv)
    metric: Array  # (k, k)
    columns: dict[str, Array | None]

    @classmethod
    def of(cls, sizes: Mapping[str, int], n: int) -> _Shared:
        """Of contacts with that many multipliers each, of a robot with n velocities."""
        k = sum(sizes.values())
        moved, one, start = np.empty((k, n)), np.eye(k), 0
        one.flags.writeable = False
        columns: dict[str, Array | None] = {"vdot": moved}
        for name, size in sizes.items():
            columns[name] = one[:, start : start + size]
            start += size
        return cls(np.empty(k), np.empty((6, 6)), np.empty((k, 6)), moved, np.zeros((k, k)), columns)


class WholeBodyPosture(PostureTask):
    """Joint posture of a robot with a floating base, vdot = kp (q_d - q) - kd v, in what contacts and tasks leave free.

    Its metric is N' D N with N = I - Gbar G, G all rows of contacts and tasks, and D the mass matrix with the part of
    the base scaled down by `BASE_SHARE`: the base goes where the joints take it; in the air it is damped.
    `kp`, `kd`: numbers, vectors over the joints (nu,) or matrices.
    """

    def __init__(self, q: Array, kp: Any = 50.0, kd: Any = 10.0, nu: int = 0) -> None:
        self.q = np.array(q, float)
        self.Kp, self.Kd = gain_matrix(kp, nu, "kp"), gain_matrix(kd, nu, "kd")
        self._K = np.hstack((self.Kp, -self.Kd))
        self._damping = float(self.Kd.trace()) / nu
        share = np.ones(6 + nu)
        share[:6] = BASE_SHARE
        self._share = np.sqrt(np.outer(share, share))

    def acceleration(self, state: State) -> Array:
        """(nv,) vdot_p [rad/s^2]; the base's is damping alone."""
        vdot = np.empty(state.v.size)
        vdot[:6] = -self._damping * state.v[:6]
        kernels.spring(self._K, self.q[7:], state.q[7:], state.v[6:], vdot[6:])
        return vdot

    def rows(self, state: State, lifted: Array | None = None) -> Rows:
        """`lifted` (nv, m): M^-1 G', where it is known already."""
        G, W, _ = state.primary
        vdot = self.acceleration(state)
        N = np.eye(vdot.size) - (state.solve_M(G.T) if lifted is None else lifted).dot(W.dot(G))
        D = self._share * state.M
        return Rows("", {"vdot": None}, vdot, vdot, N.T.dot(D).dot(N))
