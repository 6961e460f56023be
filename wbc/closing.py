"""The start pose, closed onto contacts and references by inverse kinematics (book 6.2.2, damped least squares)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from .qp import Array
from .robot import Robot

CLOSED = 1e-9  # [m, rad] how well the start pose meets its goals
_ANGULAR_FIRST = [3, 4, 5, 0, 1, 2]


class Goal(NamedTuple):
    """A pose that a frame should have, along some rows of its twist."""

    frame: str
    T: pin.SE3
    rows: Array  # (r, 6)
    path: tuple[str | int, ...]  # what asks for it, in the spec


def close(robot: Robot, q: Array, goals: Sequence[Goal], steps: int = 200) -> tuple[Array, list[float]]:
    """The configuration nearest along the way from `q` (nq,), and how far it is from every goal [m, rad]."""
    still, q = np.zeros(robot.nv), q.copy()
    errors: list[Array] = [np.zeros(1) for _ in goals]
    for _ in range(steps if goals else 0):
        state = robot.state(q, still)
        frames = [state.frame(goal.frame) for goal in goals]
        errors = [
            goal.rows @ pin.log6(frame.T.actInv(goal.T)).vector[_ANGULAR_FIRST]
            for goal, frame in zip(goals, frames, strict=True)
        ]
        J = np.concatenate([goal.rows @ frame.J for goal, frame in zip(goals, frames, strict=True)])
        damped = np.concatenate((J, 1e-6 * np.eye(robot.nv)))
        step = np.linalg.lstsq(damped, np.concatenate((*errors, still)), rcond=None)[0]
        largest = float(np.abs(step).max())
        q = pin.integrate(robot.model, q, step * min(1.0, 0.5 / max(largest, 1e-12)))
        if largest < 1e-12:
            break
    return q, [float(np.abs(error).max(initial=0.0)) for error in errors]
