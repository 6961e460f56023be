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


def close(robot: Robot, q: Array, goals: Sequence[Goal], steps: int = 200) -> tuple[Array, list[float]]:
    """The configuration nearest along the way from `q` (nq,), and how far it is from every goal [m, rad]."""
    still, q = np.zeros(robot.nv), q.copy()
    errors: list[Array] = [np.zeros(1) for _ in goals]
    for _ in range(steps if goals else 0):
        state = robot.state(q, still)
        frames = [seen(state, goal.frame, goal.to) for goal in goals]
        errors = [goal.error(frame.T) for goal, frame in zip(goals, frames, strict=True)]
        J = np.concatenate([goal.rows_at(frame.T) @ frame.J for goal, frame in zip(goals, frames, strict=True)])
        damped = np.concatenate((J, 1e-6 * np.eye(robot.nv)))
        step = np.linalg.lstsq(damped, np.concatenate((*errors, still)), rcond=None)[0]
        largest = float(np.abs(step).max())
        q = pin.integrate(robot.model, q, step * min(1.0, 0.5 / max(largest, 1e-12)))
        if largest < 1e-12:
            break
    return q, [float(np.abs(error).max(initial=0.0)) for error in errors]
