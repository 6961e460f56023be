"""Wrenches with their sign and frame said, and the wrist sensor that measures them through the weight of a tool."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from .axes import VELOCITY_AXES as VELOCITY_AXES
from .axes import WRENCH_AXES as WRENCH_AXES
from .errors import WrenchError
from .qp import Array
from .robot import Robot
from .state import State


@dataclass(frozen=True)
class Wrench:
    """A measured wrench, kept as F = (m, f) of the robot on its environment, in the axes and at the origin of `frame`.

    Use `on_robot` for what most sensors and drivers report, `on_environment` for the book's F_tip.
    """

    F: Array  # (6,) [N m, N]
    frame: str

    @classmethod
    def on_environment(cls, f: Array, m: Array, frame: str) -> Wrench:
        """Force f [N] and moment m [N m] that the robot applies to the environment."""
        if np.size(f) != 3 or np.size(m) != 3:
            raise WrenchError(f"a wrench needs three forces and three moments, got {np.shape(f)} and {np.shape(m)}")
        return cls(np.concatenate((np.ravel(m), np.ravel(f))).astype(float), frame)

    @classmethod
    def on_robot(cls, f: Array, m: Array, frame: str) -> Wrench:
        """Force f [N] and moment m [N m] that the environment applies to the robot."""
        return cls.on_environment(-np.asarray(f, float), -np.asarray(m, float), frame)

    def at(self, state: State, frame: str) -> Array:
        """(6,) the same wrench in the axes and at the origin of another frame: F_b = Ad_{T_ab}' F_a."""
        if frame == self.frame:
            return self.F
        X = state.robot.wrench_map(self.frame, frame)
        if X is not None:
            return X.dot(self.F)
        T = state.frame(self.frame).T.actInv(state.frame(frame).T)  # the other frame, seen from ours
        m, f = T.rotation.T @ (self.F[:3] - np.cross(T.translation, self.F[3:])), T.rotation.T @ self.F[3:]
        return np.concatenate((m, f))


class ForceSensor:
    """A six-axis sensor at `frame` between the robot and everything that hangs below it (the tool).

    It reads what the robot applies to the tool; the tool's weight and inertia are taken off, so that what remains is
    what the tool applies to the environment:  F = F_read - bias - (I (a - a_g) + V x* I V). `bias` (6,) is what it
    reads of nothing, in its axes; `tare` finds it.
    """

    def __init__(self, robot: Robot, frame: str = "wrist_sensor", bias: Array | None = None) -> None:
        self.robot, self.frame = robot, frame
        self.bias = np.zeros(6) if bias is None else np.array(bias, float)
        self._inertia = robot.inertia_below(frame)
        self._gravity = pin.Motion(robot.model.gravity.vector)

    def compensated(self, reading: Array, state: State, vdot: Array) -> Wrench:
        """The wrench of the tool on the environment, at the sensor.

        Parameters: `reading` (6,) = (m, f) of the robot on the tool in the sensor's axes, the state at the time of the
        reading, `vdot` (nv,) the acceleration at that time [rad/s^2].
        """
        frame = state.frame(self.frame)
        a, V = frame.J @ vdot + frame.drift, frame.V
        spatial = pin.Motion(a[3:], a[:3]) - frame.T.actInv(self._gravity)
        motion = pin.Motion(V[3:], V[:3])
        load = self._inertia * spatial + motion.cross(self._inertia * motion)
        return Wrench(reading - self.bias - np.concatenate((load.angular, load.linear)), self.frame)

    def tare(self, readings: Array, state: State, vdot: Array) -> ForceSensor:
        """A sensor that calls what it reads now zero: the tool must touch nothing.

        Parameters: one reading (6,) or several (N, 6), of which the mean counts, at one state.
        """
        mean = np.asarray(readings, float).reshape(-1, 6).mean(axis=0)
        bias = ForceSensor(self.robot, self.frame).compensated(mean, state, vdot).F
        return ForceSensor(self.robot, self.frame, bias)
