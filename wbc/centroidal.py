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

BASE_SHARE = 1e-3  # what a posture's base weighs against its joints
FADE = 0.5  # [s] in which contacts change what they share
SOLE_RADIUS = 0.05  # [m] at which a moment of a contact weighs as much as a force


def mass(state: State) -> float:
    """Of the whole robot [kg]."""
    return float(state.terms.data.mass[0])


def com(state: State) -> tuple[Array, Array, Array]:
    """(3,) the centre of mass in the world [m], (3, nv) its Jacobian, (3,) Jdot v [m/s^2]."""
    robot, data = state.robot, state.terms.data
    if robot.base:  # its acceleration is what the base's equations of force say, over the mass
        drift = data.oMi[1].rotation.dot(data.nle[:3]) / data.mass[0] + robot.model.gravity.linear
    else:
        pin.centerOfMass(robot.model, data, state.q, state.v, np.zeros(state.v.size))
        drift = data.acom[0].copy()
    return data.com[0], data.Jcom, drift


def middle(state: State, shares: Mapping[str, float]) -> Array:
    """(3,) the point between frames, by their shares of one [m]."""
    return np.asarray(sum(share * state.frame(frame).T.translation for frame, share in shares.items()))


class ComTask:
    """The centre of mass c on its path: cddot = cddot_d + kp (c_d - c) + kd (cdot_d - cdot) along the world's axes.

    Parameters: `path` (t -> Sample, whose origin is c_d in the world); `kp` [1/s^2], `kd` [1/s]: numbers, vectors over
    (x, y, z) or matrices. `over`: frame -> share of one: where the task begins while the robot moves, the path is
    shifted so that it starts over their middle as they stand then. The metric is the mass: the cost is that of the
    force which is missing.
    """

    def __init__(
        self, path: Reference, kp: Any = 40.0, kd: Any = 12.0, over: Mapping[str, float] | None = None
    ) -> None:
        self.path, self.over = path, dict(over or {})
        self.Kp, self.Kd = gain_matrix(kp, 3, "kp"), gain_matrix(kd, 3, "kd")

    def desired(self, state: State) -> tuple[Array, Array, Array]:
        """(3,) c_d, its velocity and its acceleration in the world."""
        start = state.starts.get(self)
        sample = self.path(state.t) if start is None else start.sample(self.path, state.t)
        R, (w, v), (_, vdot) = sample.T.rotation, sample.V.reshape(2, 3), sample.Vdot.reshape(2, 3)
        return sample.T.translation, R.dot(v), R.dot(vdot + pin.skew(w).dot(v))

    def target(self, state: State) -> tuple[Array, Array]:
        """The task's own rows G vdot = b: (3, nv) and (3,)."""
        c, J, drift = com(state)
        p, v, a = self.desired(state)
        return J, a + self.Kp.dot(p - c) + self.Kd.dot(v - J.dot(state.v)) - drift

    def rows(self, state: State) -> Rows:
        G, b = self.target(state)
        return Rows("", {"vdot": G}, b, b, mass(state) * np.eye(3))


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
    """

    def __init__(self, shares: Mapping[str, float] | None = None) -> None:
        self.shares = dict(shares or {})
        if any(not share >= 0.0 for share in self.shares.values()):
            raise GainError(f"shares: expected 0 or more of each, got {self.shares}")

    def rows(self, state: State, among: Sequence[str] | None = None) -> Rows:
        """Rows over `vdot` and the multipliers; `among`: the contacts that share, by default all."""
        base, contacts, names = state.robot.base, state.contacts, list(among if among is not None else state.contacts)
        push = {name: held.push[:, :base].T for name, held in contacts.items()}
        begun = state.starts.get(self)
        fade = 1.0 if begun is None else min(max((state.t - begun.t) / FADE, 0.0), 1.0)
        P = np.concatenate([push[name] for name in names], axis=1)  # (6, k)
        weight, lam = np.empty(P.shape[1]), np.zeros(P.shape[1])
        A: dict[str, Array | None] = {}
        start = 0
        for name in names:
            held = contacts[name]
            k = held.A.shape[0]
            own = slice(start, start + k)
            # a row of A is a unit force, or a unit moment
            weight[own] = 1.0 / (np.square(held.A) @ _SCALE)
            if share := self.shares.get(name, 0.0):
                f = share * mass(state) * state.frame(held.frame).T.rotation.T.dot(state.robot.model.gravity.linear)
                lam[own] = fade * held.inverse[:, 3:].dot(f)
            if begun is not None and fade < 1.0 and (before := begun.loads.get(name)) is not None:
                lam[own] += (1.0 - fade) * before
            A[name] = np.eye(P.shape[1])[:, own]
            start += k
        D = (P / weight).T.dot(inertia((P / weight).dot(P.T)))
        A["vdot"] = D.dot(state.M[:base])
        for name in contacts.keys() - set(names):
            A[name] = D.dot(push[name])
        lam -= D.dot(state.bias[:base] + P.dot(lam))
        return Rows("", A, lam, lam, np.diag(weight / mass(state)))


_SCALE = np.repeat((SOLE_RADIUS**2, 1.0), 3)


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
