"""The robot's coordinates among those of the plant, and in Pinocchio's order."""

from __future__ import annotations

import mujoco
import numpy as np

from . import convention
from .qp import Array
from .robot import Robot


class Coordinates:
    """What is the same at every tick of how a plant's (qpos, qvel) are read as the robot's (q, v).

    `qpos` (nq,), `qvel` (nv,): where the robot's own are, whatever is passive beside it.
    """

    def __init__(self, robot: Robot) -> None:
        self._robot = robot
        self.qpos, self.qvel = own_coordinates(robot)
        self._q = self.qpos.copy()  # the same in Pinocchio's order: quaternions xyzw
        self._bases: list[tuple[Array, slice]] = []  # quaternion, linear velocity
        mj = robot.mujoco
        for joint in np.flatnonzero(mj.jnt_type < 2):
            free = mj.jnt_type[joint] == mujoco.mjtJoint.mjJNT_FREE
            at, dof = mj.jnt_qposadr[joint] + (3 if free else 0), mj.jnt_dofadr[joint]
            self._q[at : at + 4] = np.roll(self._q[at : at + 4], -1)
            if free:
                self._bases.append((self.qpos[at : at + 4], slice(dof, dof + 3)))

    def read(self, data: mujoco.MjData) -> tuple[Array, Array]:
        """(nq,) q and (nv,) v: quaternions xyzw, linear velocity of a base in its own axes."""
        qpos = data.qpos
        q, v = qpos[self._q], data.qvel[self.qvel]
        for quaternion, linear in self._bases:
            back, R = np.empty(4), np.empty(9)
            mujoco.mju_negQuat(back, qpos[quaternion])
            mujoco.mju_quat2Mat(R, back)
            v[linear] = R.reshape(3, 3) @ v[linear]
        return q, v

    def write(self, data: mujoco.MjData, q: Array) -> None:
        """Put the robot at q (nq,)."""
        data.qpos[self.qpos] = to_mujoco(self._robot.mujoco, q)


def to_mujoco(model: mujoco.MjModel, q: Array) -> Array:
    """Pinocchio's q as MuJoCo's qpos: quaternions wxyz."""
    return convention.to_mujoco(model, q, np.zeros(model.nv))[0]


def own_coordinates(robot: Robot) -> tuple[Array, Array]:
    """Where the robot's qpos (nq,) and qvel (nv,) stand among those of the plant, whose other joints are passive."""
    ours, plant = robot.mujoco, robot.plant or robot.mujoco
    if plant.njnt == ours.njnt:
        return np.arange(ours.nq), np.arange(ours.nv)
    q: list[int] = []
    v: list[int] = []
    for joint in range(ours.njnt):
        there = plant.joint(ours.joint(joint).name)
        q += range(there.qposadr[0], there.qposadr[0] + ours.joint(joint).qpos0.size)
        v += range(there.dofadr[0], there.dofadr[0] + ours.joint(joint).damping.shape[0])
    return np.array(q), np.array(v)
