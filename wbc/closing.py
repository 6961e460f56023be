"""The start pose, closed onto contacts and references by inverse kinematics (book 6.2.2, damped least squares)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from .pair import seen
from .qp import Array
from .robot import Robot

CLOSED = 1e-9  # [m, rad] how well the start pose meets its goals
_ANGULAR_FIRST = [3, 4, 5, 0, 1, 2]


class Goal(NamedTuple):
    """A pose that a frame should have, along some rows of its twist, in the axes of the frame or in those of `axes`."""

    frame: str
    T: pin.SE3
    rows: Array  # (r, 6)
    path: tuple[str | int, ...]  # what asks for it, in the spec
    axes: Array | None = None  # (3, 3) fixed in the world: a plane's, while the frame rolls on it
    to: str | None = None  # T is the pose seen from this frame, not from the world

    def error(self, T: pin.SE3) -> Array:
        """(r,) how far a frame at T is from it [rad, m]."""
        if self.axes is None:
            return np.asarray(self.rows @ pin.log6(T.actInv(self.T)).vector[_ANGULAR_FIRST])
        turn = T.rotation @ pin.log3(T.rotation.T @ self.T.rotation)
        way = self.T.translation - T.translation
        return np.asarray(self.rows @ np.concatenate((self.axes.T @ turn, self.axes.T @ way)))

    def rows_at(self, T: pin.SE3) -> Array:
        """(r, 6) its rows in the axes of the frame."""
        if self.axes is None:
            return self.rows
        X = self.axes.T @ T.rotation
        return np.hstack((self.rows[:, :3] @ X, self.rows[:, 3:] @ X))


class Lying(NamedTuple):
    """An edge that should lie on a plane with the unit normal n (world): its middle at n . p = `level`, its ends alike.

    The edge is the axis `along` (0: x, 1: y) of the frame.
    """

    frame: str
    normal: Array  # (3,)
    level: float  # [m]
    along: int
    path: tuple[str | int, ...]
    to: str | None = None  # it is seen from the world

    def error(self, T: pin.SE3) -> Array:
        """(2,) how far up and how tilted it is, with the sign turned [m, 1]."""
        return -np.array([self.normal @ T.translation - self.level, self.normal @ T.rotation[:, self.along]])

    def rows_at(self, T: pin.SE3) -> Array:
        """(2, 6) what a twist does to them."""
        n, rows = T.rotation.T @ self.normal, np.zeros((2, 6))
        rows[0, 3:], rows[1, :3] = n, np.cross(np.eye(3)[self.along], n)  # n . (w x e)
        return rows


def close(robot: Robot, q: Array, goals: Sequence[Goal | Lying], steps: int = 200) -> tuple[Array, list[float]]:
    """The configuration nearest along the way from `q` (nq,), and how far it is from every goal [m, rad].

    A floating base is set down on its planes first, straight down and as it is; then all moves as far as is left.
    """
    planes = [goal for goal in goals if isinstance(goal, Lying) or goal.axes is not None]
    if robot.base and planes:
        down = np.zeros((robot.nv, 1))
        down[:3, 0] = pin.XYZQUATToSE3(q[:7]).rotation[2]  # the world's z in the axes of the base
        q, _ = _nearer(robot, q, planes, steps, down)
    return _nearer(robot, q, goals, steps, np.eye(robot.nv))


def _nearer(
    robot: Robot, q: Array, goals: Sequence[Goal | Lying], steps: int, moves: Array
) -> tuple[Array, list[float]]:
    """Newton steps along the columns of `moves` (nv, m)."""
    still, q = np.zeros(robot.nv), q.copy()
    errors: list[Array] = [np.zeros(1) for _ in goals]
    for _ in range(steps if goals else 0):
        state = robot.state(q, still)
        frames = [seen(state, goal.frame, goal.to) for goal in goals]
        errors = [goal.error(frame.T) for goal, frame in zip(goals, frames, strict=True)]
        J = np.concatenate([goal.rows_at(frame.T) @ frame.J for goal, frame in zip(goals, frames, strict=True)])
        damped = np.concatenate((J @ moves, 1e-6 * np.eye(moves.shape[1])))
        step = moves @ np.linalg.lstsq(damped, np.concatenate((*errors, still[: moves.shape[1]])), rcond=None)[0]
        largest = float(np.abs(step).max())
        q = pin.integrate(robot.model, q, step * min(1.0, 0.5 / max(largest, 1e-12)))
        if largest < 1e-12:
            break
    return q, [float(np.abs(error).max(initial=0.0)) for error in errors]
