"""A controller beside the equations of motion alone, which Pinocchio integrates: no simulator, no contact model."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pinocchio as pin
from invariants import Watched

DT = 1e-3


class Flown(NamedTuple):
    """Every tick of a flight, rows of arrays."""

    q: np.ndarray
    v: np.ndarray
    vdot: np.ndarray
    tau: np.ndarray
    active: list[tuple[str, ...]]
    status: list[str]
    reasons: list[str]

    @property
    def rate(self):
        """Largest change of a torque [N m/s]."""
        return float(np.abs(np.diff(self.tau, axis=0)).max() / DT)

    @property
    def acceleration(self):
        """Largest of a joint [rad/s^2]: of the velocities that came of the torque, not of a prediction."""
        return float(np.abs(np.diff(self.v, axis=0)).max() / DT)


def fly(controller, q, seconds, repeat, clock=lambda tick: DT * tick, held=False, after=None):
    """From rest at q; `held`: the contacts of the phase are rigid, else there are none. `after(tick)` may look on."""
    robot, watched = controller.robot, Watched(controller, repeat)
    v, data, rows = np.zeros(robot.nv), robot.model.createData(), []
    watched.reset(q, v)
    for tick in range(round(seconds / DT)):
        out = watched.step(clock(tick), q.copy(), v.copy())
        rows.append((q.copy(), v.copy(), out.vdot, out.tau, out.active, out.status.name, out.reason))
        if after is not None:
            after(tick)
        vdot = constrained(controller, q, v, out.tau) if held else pin.aba(robot.model, data, q, v, out.tau)
        v = v + DT * vdot
        q = pin.integrate(robot.model, q, DT * v)
    return Flown(*(np.array(each) for each in list(zip(*rows, strict=True))[:4]), *list(zip(*rows, strict=True))[4:])


def constrained(controller, q, v, tau):
    """vdot of the robot whose contacts are rigid, from the KKT system of its equations of motion."""
    state = controller.robot.state(q, v)
    held = [contact.hold(state) for contact in controller.phase.contacts.values()]
    G, rhs = np.concatenate([each.G for each in held]), np.concatenate([each.rhs - 50.0 * each.slip for each in held])
    k = rhs.size
    system = np.block([[state.M, G.T], [G, np.zeros((k, k))]])
    return np.linalg.lstsq(system, np.concatenate([tau - state.h, rhs]), rcond=1e-12)[0][: v.size]
