"""Tasks of a whole body: where its mass is, how the contacts share what that needs, its posture.

By Newton and Euler the wrenches of all contacts add up to what the motion of the centre of mass needs; how they share
it is free where they have more than six components.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pinocchio as pin

from . import kernels
from .analytic import gain_matrix
from .dynamics import inertia
from .errors import GainError
from .qp import Array, Rows
from .reference import Reference
from .robot import State
from .task import PostureTask

_ALONG = np.eye(3)
BASE_SHARE = 1e-3  # what a posture's base weighs against its joints
SOLE_RADIUS = 0.05  # [m] at which a moment of a contact weighs as much as a force


def mass(state: State) -> float:
    """Of the whole robot [kg]."""
    return state.terms.mass


def com(state: State) -> tuple[Array, Array, Array]:
    """(3,) the centre of mass in the world [m], (3, nv) its Jacobian, (3,) Jdot v [m/s^2]."""
    robot, terms = state.robot, state.terms
    c, J, R, g = terms.com
    if robot.base:  # its acceleration is what the base's equations of force say, over the mass
        drift = R.dot(terms.h[:3]) / terms.mass + g
    else:
        pin.centerOfMass(robot.model, terms.data, state.q, state.v, np.zeros(state.v.size))
        drift = terms.data.acom[0].copy()
    return c, J, drift


class ComTask:
    """The centre of mass c on its path: cddot = cddot_d + kp (c_d - c) + kd (cdot_d - cdot) along the world's axes.

    Parameters: `path` (t -> Sample, whose origin is c_d in the world); `kp` [1/s^2], `kd` [1/s]: numbers, vectors over
    (x, y, z) or matrices. The metric is the mass: the cost is that of the force which is missing.
    """

    def __init__(self, path: Reference, kp: Any = 40.0, kd: Any = 12.0) -> None:
        self.path = path
        self.Kp, self.Kd = gain_matrix(kp, 3, "kp"), gain_matrix(kd, 3, "kd")
        self._K = np.hstack((self.Kp, self.Kd))

    def desired(self, state: State) -> tuple[Array, Array, Array]:
        """(3,) c_d, its velocity and its acceleration in the world."""
        sample = self.path(state.since(self))
        R, (w, v), (_, vdot) = sample.T.rotation, sample.V.reshape(2, 3), sample.Vdot.reshape(2, 3)
        return sample.T.translation, R.dot(v), R.dot(vdot + pin.skew(w).dot(v))

    def target(self, state: State) -> tuple[Array, Array]:
        """The task's own rows G vdot = b: (3, nv) and (3,)."""
        (c, J, drift), sample, b = com(state), self.path(state.since(self)), np.empty(3)
        kernels.point_target(sample.R, sample.p, sample.motion, c, J, state.v, drift, self._K, b)
        return J, b

    def rows(self, state: State) -> Rows:
        G, b = self.target(state)
        return Rows("", {"vdot": G}, b, b, mass(state) * _ALONG)


class DistributionTask:
    """How the contacts share what the motion needs: evenly, or from given shares of the weight.

    Together they carry w = -(M_b vdot + bias_b) = P lambda, the base's six equations. Asked for is, of all that carry
    w, the nearest to lambda_0,

        lambda = lambda_0 + D (w - P lambda_0),      D = W^-1 P' (P W^-1 P')^+,

    in the metric W: 1 for a force, 1/r^2 for a moment, r = `SOLE_RADIUS`, over the mass. At rest that is the static
    distribution. As w is that of the very motion, the cost is zero while no inequality is active and competes with no
    task; a cost that drew lambda towards zero, or towards the weight alone, would bend the motion.
    `shares`: contact -> share of the weight [1] that lambda_0 presses with; where nothing is given lambda_0 is zero.
    """

    def __init__(self, shares: Mapping[str, float] | None = None) -> None:
        self.shares = dict(shares or {})
        if any(not share >= 0.0 for share in self.shares.values()):
            raise GainError(f"shares: expected 0 or more of each, got {self.shares}")

    def rows(self, state: State, among: Sequence[str] | None = None) -> Rows:
        """Rows over `vdot` and the multipliers; `among`: the contacts that share, by default all."""
        contacts, names = state.contacts, state.contacts if among is None else among
        held = [contacts[name] for name in names]
        push = np.concatenate([each.push for each in held])
        k = len(push)
        weight, S, D, lam, one = np.empty(k), np.empty((6, 6)), np.empty((k, 6)), np.zeros(k), np.eye(k)
        # a row of A is a unit force, or a unit moment
        kernels.carried(push, np.concatenate([each.A for each in held]), SOLE_RADIUS, weight, S)
        A: dict[str, Array | None] = {}
        start = 0
        for name, each in zip(names, held, strict=True):
            own = slice(start, start + each.G.shape[0])
            if share := self.shares.get(name, 0.0):
                f = share * mass(state) * state.frame(each.frame).T.rotation.T.dot(state.robot.model.gravity.linear)
                lam[own] = each.inverse[:, 3:].dot(f)
            A[name] = one[:, own]
            start = own.stop
        kernels.share(push, weight, inertia(S), state.bias, D, lam)
        for name in contacts.keys() - A.keys():
            A[name] = D.dot(contacts[name].push[:, :6].T)
        A["vdot"] = D.dot(state.M[:6])
        return Rows("", A, lam, lam, one * (weight / mass(state)))


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
