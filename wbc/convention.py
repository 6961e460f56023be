"""MuJoCo's coordinates and Pinocchio's: the order of a quaternion, and in which axes a free base's velocity stands."""

from __future__ import annotations

import mujoco
import numpy as np

from .qp import Array


def rotation(quaternion: Array) -> Array:
    """(3, 3) of a quaternion wxyz."""
    R = np.zeros(9)
    mujoco.mju_quat2Mat(R, np.asarray(quaternion, float))
    return R.reshape(3, 3)


def to_pinocchio(model: mujoco.MjModel, qpos: Array, qvel: Array) -> tuple[Array, Array]:
    """MuJoCo's (qpos, qvel) as Pinocchio's (q, v): quaternions xyzw, linear base velocity in the body's axes."""
    q, v = qpos.copy(), qvel.copy()
    for joint in np.flatnonzero(model.jnt_type < 2):
        at, dof = model.jnt_qposadr[joint], model.jnt_dofadr[joint]
        at += 3 if model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_FREE else 0
        q[at : at + 4] = np.roll(qpos[at : at + 4], -1)
        if model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_FREE:
            v[dof : dof + 3] = rotation(qpos[at : at + 4]).T @ qvel[dof : dof + 3]
    return q, v


def to_mujoco(model: mujoco.MjModel, q: Array, v: Array) -> tuple[Array, Array]:
    """Pinocchio's (q, v) as MuJoCo's (qpos, qvel): quaternions wxyz, linear base velocity in the world's axes."""
    qpos, qvel = np.array(q, float), np.array(v, float)
    for joint in np.flatnonzero(model.jnt_type < 2):
        at, dof = model.jnt_qposadr[joint], model.jnt_dofadr[joint]
        free = model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_FREE
        at += 3 if free else 0
        qpos[at : at + 4] = np.roll(qpos[at : at + 4], 1)
        if free:
            qvel[dof : dof + 3] = rotation(qpos[at : at + 4]) @ qvel[dof : dof + 3]
    return qpos, qvel


def acceleration_to_pinocchio(model: mujoco.MjModel, qpos: Array, qvel: Array, qacc: Array) -> Array:
    """MuJoCo's qacc as Pinocchio's vdot: of a free base T qacc - w x v, its linear velocity seen from turning axes."""
    q, v = to_pinocchio(model, qpos, qvel)
    return np.asarray(velocity_map(model, qpos) @ qacc + acceleration_offset(model, q, v))


def acceleration_to_mujoco(model: mujoco.MjModel, q: Array, v: Array, vdot: Array) -> Array:
    """Pinocchio's vdot as MuJoCo's qacc."""
    qpos, _ = to_mujoco(model, q, v)
    return np.asarray(velocity_map(model, qpos).T @ (vdot - acceleration_offset(model, q, v)))


def velocity_map(model: mujoco.MjModel, qpos: Array) -> Array:
    """T with v_pinocchio = T v_mujoco."""
    T = np.eye(model.nv)
    for joint in np.flatnonzero(model.jnt_type == mujoco.mjtJoint.mjJNT_FREE):
        dof, at = model.jnt_dofadr[joint], model.jnt_qposadr[joint] + 3
        T[dof : dof + 3, dof : dof + 3] = rotation(qpos[at : at + 4]).T
    return T


def acceleration_offset(model: mujoco.MjModel, q: Array, v: Array) -> Array:
    """b with a_pinocchio = T a_mujoco + b: the linear base velocity is seen from turning axes."""
    b = np.zeros(model.nv)
    for joint in np.flatnonzero(model.jnt_type == mujoco.mjtJoint.mjJNT_FREE):
        dof = model.jnt_dofadr[joint]
        b[dof : dof + 3] = -np.cross(v[dof + 3 : dof + 6], v[dof : dof + 3])
    return b
