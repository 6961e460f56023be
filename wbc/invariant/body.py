"""The robot's equations of motion once more, for the torque of an answer and that of a hold."""

from __future__ import annotations

from typing import Any

import numpy as np
import pinocchio as pin

from ..qp import Array
from ..robot import Robot


class Body:
    """Pinocchio's storage of its own for a robot: its equations of motion, apart from the controller's."""

    def __init__(self, robot: Robot) -> None:
        self.robot, self.data = robot, robot.model.createData()
        self.inertia = np.zeros((robot.nv, robot.nv))

    def at(self, q: Array, v: Array) -> Array:
        """h (nv,) [N m], of a state that from now on is the one."""
        model, data = self.robot.model, self.data
        M = np.triu(pin.crba(model, data, q))
        self.inertia = M + np.triu(M, 1).T
        h = np.array(pin.nonLinearEffects(model, data, q, v))
        pin.computeJointJacobians(model, data, q)
        pin.updateFramePlacements(model, data)
        return h if self.robot.damping is None else h + self.robot.damping * v

    def torque(self, q: Array, v: Array, vdot: Array) -> Array:
        """(nv,) M vdot + h [N m]."""
        h = self.at(q, v)
        return self.inertia.dot(vdot) + h

    def gravity(self, q: Array) -> Array:
        return np.array(pin.computeGeneralizedGravity(self.robot.model, self.data, q))

    def carried(self, contact: Any, F: Array) -> Array:
        """(nv,) J' F of a wrench on what the contact is with, and of its reaction where that is a body of the robot."""
        here = self.robot.frame_id(contact.frame)
        tau = self._pulled(here, pin.Force(F[3:], F[:3]))
        if contact.against is None:
            return tau
        there = self.robot.frame_id(contact.against)
        T = self.data.oMf[there].actInv(self.data.oMf[here])
        return tau - self._pulled(there, T.act(pin.Force(F[3:], F[:3])))

    def axes(self, contact: Any) -> Array:
        """(3, 3) of a contact's frame in the world, at the state of `at`."""
        return np.array(self.data.oMf[self.robot.frame_id(contact.frame)].rotation)

    def _pulled(self, frame: int, force: Any) -> Array:
        J = pin.getFrameJacobian(self.robot.model, self.data, frame, pin.ReferenceFrame.LOCAL)
        return np.asarray(J.T.dot(force.vector))
