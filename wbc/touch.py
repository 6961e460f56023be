"""The true contacts of a tick: who touches whom, with what force, and how it slips. One pass serves every frame.

A body is all that moves as one with a frame, with the passive parts of a tool; its environment touches it or is welded
to it.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import cached_property
from typing import Any, NamedTuple

import mujoco
import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from . import kernels
from .outside import Places
from .qp import Array

_ZERO, _CONJUGATE = np.zeros(1), np.array([1.0, -1.0, -1.0, -1.0])


class Impact(NamedTuple):
    """A point that touches: MuJoCo's contact is a_n = -b v_n - k r wherever the force, less a_n R f, allows it."""

    normal: Array  # (3,) world, from the robot into its environment
    stiffness: float  # k [1/s^2]
    damping: float  # b [1/s]
    regularisation: float  # R [1/kg]


class Touch(NamedTuple):
    """What a body of the robot applied to its environment in a tick."""

    F: Array  # (6,) in the axes of the frame asked for
    points: int  # points of contact with a force along their normal
    mu: float  # their coefficient of friction, 0 without


class Weld(NamedTuple):
    """What a weld or connection of two sites did in a tick."""

    place: Array  # (3,)
    m: Array  # (3,) moment and
    f: Array  # (3,) force on the body of the first site, in the axes of the world
    bodies: Array  # both


class Points:
    """The contacts of one tick, read once: arrays over them, and the motion of all bodies where it is asked for."""

    def __init__(self, model: mujoco.MjModel, data: mujoco.MjData, moves: Array) -> None:
        self._model, self._data, self._moves = model, data, moves
        contact = data.contact
        self.geoms, self.places, self.axes = contact.geom, contact.pos, contact.frame
        self.mu = np.where(contact.dim > 1, contact.friction[:, 0], 0.0)
        self.forces = np.zeros((data.ncon, 6))
        for i in range(data.ncon):
            mujoco.mj_contactForce(model, data, i, self.forces[i])

    @cached_property
    def twists(self) -> Array:
        """(bodies, 6) of the points of the bodies at `origins`, angular part first, in the axes of the world."""
        return np.asarray(self._moves @ (self._data.cdof * self._data.qvel[:, None]))

    @cached_property
    def origins(self) -> Array:
        """(bodies, 3) centre of mass of the tree that a body belongs to, where MuJoCo tells motions."""
        return np.asarray(self._data.subtree_com[self._model.body_rootid])


class Truth:
    """What the bodies of a plant truly do to one another; `rigid` (bodies,): bodies of one number move as one.

    `forget` when the plant has moved on: a tick is read when something of it is asked for.
    """

    def __init__(self, model: mujoco.MjModel, data: mujoco.MjData, rigid: NDArray[Any], places: Places) -> None:
        self.model, self.data, self.places = model, data, places
        self._rigid = rigid
        self._moves = _moves(model)
        self._welds = [int(i) for i in np.flatnonzero(model.eq_objtype == mujoco.mjtObj.mjOBJ_SITE)]
        self._inside: dict[str, NDArray[np.int32]] = {}
        self._rows: dict[str, tuple[int, NDArray[np.int32]]] = {}
        self._points: Points | None = None

    def forget(self) -> None:
        """The plant has moved on."""
        self._points = None

    @property
    def points(self) -> Points:
        """The contacts of this tick."""
        if self._points is None:
            self._points = Points(self.model, self.data, self._moves)
        return self._points

    def touch(self, frame: str) -> Touch:
        """What the body of `frame` applies to its environment, there."""
        body, R, p = self.places[frame]
        F, points, mu = np.zeros(6), 0.0, 0.0
        if self.data.ncon:
            at = self.points
            inside = self._inside.get(frame)
            if inside is None:
                inside = self._inside[frame] = self._geoms(body).astype(np.int32)
            points, mu = kernels.touch(inside, at.geoms, at.places, at.axes, at.forces, at.mu, R, p, F)
        for weld in self._of_welds():
            own = self._rigid[weld.bodies] == self._rigid[body]
            if own[0] != own[1]:
                sign = 1.0 if own[1] else -1.0
                F[:3] += sign * (R.T @ (weld.m + pin.skew(weld.place - p) @ weld.f))
                F[3:] += sign * (R.T @ weld.f)
        return Touch(F, int(points), mu)

    def slip(self, frame: str) -> Array:
        """(points, 3) velocity across the contact of each geom of the body of `frame`, where it touches, less that of
        what it touches, in the world; zero of those that touch nothing."""
        size, rows = self._rows.get(frame) or self._rows.setdefault(frame, self._numbered(self.places[frame].body))
        out = np.zeros((size, 3))
        if self.data.ncon:
            at, bodies = self.points, self.model.geom_bodyid
            kernels.slip(rows, at.geoms, bodies, at.places, at.axes, at.forces, at.twists, at.origins, out)
        return out

    def impact(self, frame: str) -> Impact | None:
        """The one point in which the body of `frame` touches its environment; None where there are none or several."""
        body, found = self.places[frame].body, list[Impact]()
        for i in range(self.data.ncon):
            contact = self.data.contact[i]
            owners = [self.model.geom_bodyid[g] for g in contact.geom]
            if (owners[0] == body) != (owners[1] == body) and contact.efc_address >= 0:
                stiffness, damping, impedance, _ = self.data.efc_KBIP[contact.efc_address]
                normal = contact.frame[:3] * (1.0 if owners[0] == body else -1.0)
                R = float(self.data.efc_R[contact.efc_address])
                found.append(Impact(normal, float(stiffness * impedance), float(damping), R))
        return found[0] if len(found) == 1 else None

    def _geoms(self, body: int) -> NDArray[np.bool_]:
        """(geoms,) those that move as one with a body."""
        return np.asarray(self._rigid[self.model.geom_bodyid] == self._rigid[body])

    def _numbered(self, body: int) -> tuple[int, NDArray[np.int32]]:
        """How many geoms of a body can touch something, and (geoms,) the number of each, -1 of all others."""
        own = np.flatnonzero(self._geoms(body) & ((self.model.geom_contype | self.model.geom_conaffinity) > 0))
        rows = np.full(self.model.ngeom, -1, np.int32)
        rows[own] = np.arange(own.size)
        return own.size, rows

    def _of_welds(self) -> Iterator[Weld]:
        """Every weld and connection of two sites.

        The rows of a weld are s vec(q_2^* q_1), whose rate is s/2 vec(q_2^* w q_1) for a relative angular velocity w:
        the moment follows from the multipliers by the transpose, s/2 vec(q_2 lambda q_1^*).
        """
        model, data = self.model, self.data
        if not self._welds or not data.ne:
            return
        rows = np.flatnonzero(data.efc_type[: data.ne] == mujoco.mjtConstraint.mjCNSTR_EQUALITY)
        ids, forces = data.efc_id[rows], data.efc_force[rows]
        for i in self._welds:
            lam = forces[ids == i]
            if not lam.size:
                continue
            sites, m = [model.eq_obj1id[i], model.eq_obj2id[i]], np.zeros(3)
            if model.eq_type[i] == mujoco.mjtEq.mjEQ_WELD:
                # not from the rotation matrices: the signs of the quaternions count
                q_1, q_2 = (self._quaternion(site) for site in sites)
                turned = np.concatenate((_ZERO, lam[3:]))
                mujoco.mju_mulQuat(turned, q_2, turned.copy())
                mujoco.mju_mulQuat(turned, turned.copy(), q_1 * _CONJUGATE)
                m = 0.5 * model.eq_data[i, 10] * turned[1:]
            yield Weld(data.site_xpos[sites[0]], m, lam[:3], model.site_bodyid[sites])

    def _quaternion(self, site: int) -> Array:
        """(4,) of a site in the world, wxyz."""
        q = np.empty(4)
        mujoco.mju_mulQuat(q, self.data.xquat[self.model.site_bodyid[site]], self.model.site_quat[site])
        return q


def _moves(model: mujoco.MjModel) -> Array:
    """(bodies, nv) 1 where a velocity moves a body."""
    moves = np.zeros((model.nbody, model.nv))
    for body in range(1, model.nbody):
        first = model.body_dofadr[body]
        moves[body] = moves[model.body_parentid[body]]
        moves[body, first : first + model.body_dofnum[body]] = 1.0
    return moves
