"""The external wrench without a sensor, from a generalised-momentum observer (De Luca and Mattone, ICRA 2005).

With p = M v the equations of motion read  pdot = tau + C'v - g - D v + tau_ext,  D the joints' damping. The residual

    r += alpha ((p - p_last)/dt - (tau_last + C'v - g - D v at the last tick) - r),   alpha = 1 - exp(-2 pi cutoff dt)

is tau_ext through a low-pass of first order, whatever tau does; no acceleration is needed. It errs by its lag and by
what the model does not know, and `errors` tells the two apart.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from .qp import Array
from .robot import Robot
from .state import State


class Observed(NamedTuple):
    """The observer's memory: a value."""

    residual: Array  # (nv,) r, the torque that the environment applies [N m]
    momentum: Array  # (nv,) p
    free: Array  # (nv,) pdot without any torque, C'v - g - D v


class MomentumObserver:
    """A residual for one robot. Parameters: the robot, and `cutoff`, the bandwidth [Hz]."""

    def __init__(self, robot: Robot, cutoff: float) -> None:
        self.robot, self.cutoff = robot, cutoff
        self._data = robot.model.createData()

    def update(self, state: State, tau: Array, last: Observed | None) -> Observed:
        """The residual at a state, `tau` (nv,) being what acted since the last one; it starts at zero."""
        model = self.robot.model
        momentum = state.M @ state.v
        C = pin.computeCoriolisMatrix(model, self._data, state.q, state.v)
        free = C.T @ state.v - pin.computeGeneralizedGravity(model, self._data, state.q)
        if self.robot.damping is not None:
            free = free - self.robot.damping * state.v
        if last is None or not state.dt > 0.0:
            return Observed(np.zeros(state.v.size) if last is None else last.residual, momentum, free)
        alpha = smoothing(self.cutoff, state.dt)
        # over the tick pdot is that of its middle: the mean of both ends leaves an error of order dt^2
        now = (momentum - last.momentum) / state.dt - tau - 0.5 * (last.free + free)
        return Observed(last.residual + alpha * (now - last.residual), momentum, free)

    def wrench(self, state: State, residual: Array, frame: str) -> Array:
        """(6,) the wrench of the robot on its environment at `frame` that explains the residual best: -(J')^+ r."""
        J: Array = state.frame(frame).J
        return np.asarray(-np.linalg.lstsq(J.T, residual, rcond=None)[0])


def smoothing(cutoff: float, dt: float) -> float:
    """alpha of the first-order low-pass s += alpha (x - s)."""
    return 1.0 - math.exp(-2.0 * math.pi * cutoff * dt)


def filtered(values: Array, cutoff: float, dt: float) -> Array:
    """(N, m) through the low-pass of the observer, from zero: what it would tell of a true model."""
    out, s, alpha = np.empty_like(values), np.zeros(values.shape[1]), smoothing(cutoff, dt)
    for i, value in enumerate(values):
        s = s + alpha * (value - s)
        out[i] = s
    return out


def errors(estimate: Array, truth: Array, cutoff: float, dt: float) -> tuple[Array, Array]:
    """(N, m), (N, m): error of the model, estimate less the lag-filtered truth, and of the lag, that less the truth.

    `estimate` at a tick is of the tick before; `truth` is what acted during each tick.
    """
    late = np.vstack((np.zeros((1, truth.shape[1])), filtered(truth, cutoff, dt)[:-1]))
    return estimate - late, late - truth
