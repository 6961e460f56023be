"""Frames of a robot at one tick: poses, twists, Jacobians and drifts, as many as are wanted in one call."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import pinocchio as pin
from numpy.lib.stride_tricks import as_strided

from . import kernels
from .errors import ModelError
from .kernels.compiled import Counts
from .qp import Array


class Frame:
    """One frame of the robot at this tick; twists and wrenches are body quantities, angular part first.

    R (3, 3), p (3,): pose in the world; V (6,) body twist [rad/s, m/s]; J (6, nv) body Jacobian, V = J v; drift (6,)
    Jdot v, so that Vdot = J vdot + drift; `table` (6, nv + 2): J, drift and V side by side, one product selects rows of
    all three. Its arrays are filled again at the next tick.
    """

    __slots__ = ("J", "R", "V", "_T", "drift", "of", "p", "table")

    def __init__(self, R: Array, p: Array, table: Array) -> None:
        n = table.shape[1] - 2
        self.R, self.p, self.table, self.of, self._T = R, p, table, 0, None
        self.J, self.drift, self.V = table[:, :n], table[:, n], table[:, n + 1]

    @property
    def T(self) -> pin.SE3:
        """Pose in the world."""
        if self._T is None:
            self._T = pin.SE3(self.R, self.p)
        return self._T


class Mounts(NamedTuple):
    """Where the frames of a model sit: what never changes."""

    joint: Counts  # (frames,) that carries them
    place: Array  # (frames, 3, 4) [R | p] in it
    moves: Array  # (frames, nv) 1 for velocities that move them


def mounts(model: pin.Model) -> Mounts:
    """Those of all frames of a model, by Pinocchio's index."""
    supported = np.zeros((model.njoints, model.nv))
    for joint in range(1, model.njoints):
        for index in list(model.supports[joint])[1:]:
            first = model.joints[index].idx_v
            supported[joint, first : first + model.joints[index].nv] = 1.0
    carriers = np.array([frame.parentJoint for frame in model.frames], np.int64)
    poses = [np.column_stack((frame.placement.rotation, frame.placement.translation)) for frame in model.frames]
    return Mounts(carriers, np.array(poses), supported[carriers])


class Frames:
    """Storage of all frames of a robot, one row each, by Pinocchio's index. What nobody asks for is never computed."""

    def __init__(self, mounted: Mounts, data: pin.Data, J: Array) -> None:
        count, n = mounted.moves.shape
        self.R, self.p, self.table = np.empty((count, 3, 3)), np.empty((count, 3)), np.empty((count, 6, n + 2))
        poses = _rows([(pose.rotation, pose.translation) for pose in data.oMi], 12)
        # computeAllTerms leaves the accelerations at vdot = 0 in data.a: they are the drift
        drifts = _rows([(a.linear, a.angular) for a in data.a], 6)
        self._source = (poses, drifts, mounted.joint, mounted.place, mounted.moves, J)

    def frame(self, index: int) -> Frame:
        """One of them."""
        return Frame(self.R[index], self.p[index], self.table[index])

    def fill(self, wanted: Counts, v: Array) -> None:
        """Compute these, after Pinocchio's terms at the velocities v (nv,)."""
        poses, drifts, joint, place, moves, J = self._source
        kernels.frames(wanted, poses, drifts, joint, place, moves, J, v, self.R, self.p, self.table)


def _rows(parts: Sequence[tuple[Array, Array]], size: int) -> Array:
    """(joints, size) what Pinocchio keeps for its joints in one piece of memory, seen as the rows of one array.

    `parts`: the numbers of one joint, in two views that follow one another.
    """
    starts = [first.ctypes.data for first, _ in parts]
    step, inside = starts[1] - starts[0], {second.ctypes.data - first.ctypes.data for first, second in parts}
    if inside != {8 * parts[0][0].size} or starts != [starts[0] + i * step for i in range(len(parts))]:
        raise ModelError("this version of pinocchio keeps its joints in another layout; expected 3 or a later 3.x")
    return as_strided(parts[0][0].reshape(-1, order="F"), (len(parts), size), (step, 8), writeable=False)
