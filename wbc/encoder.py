"""What encoders make of a motion: positions with noise, and velocities, of a sensor of their own or made of these."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pinocchio as pin

from .qp import Array


class Encoders:
    """Noisy readings of (q, v), one a tick of `dt` [s].

    Parameters: Pinocchio's `model`; `noise` with standard deviations `position` [rad, m] and `velocity` [rad/s, m/s] of
    all velocities, those of a floating base too, and `differenced` [Hz] or None: with it the velocity is made of the
    measured positions, as a drive without a tachometer makes it, by differences that are low-passed at this cut-off,

        v_k = v_(k-1) + alpha ((q_k - q_(k-1)) / dt - v_(k-1)),     alpha = 1 - exp(-2 pi f dt),     v_0 = 0
    """

    def __init__(self, model: pin.Model, noise: Any, dt: float, rng: np.random.Generator) -> None:
        self._model, self._noise, self._dt, self._rng = model, noise, dt, rng
        self._alpha = 0.0 if noise.differenced is None else 1.0 - math.exp(-2.0 * math.pi * noise.differenced * dt)
        self._q: Array | None = None  # measured at the last tick
        self._v = np.zeros(model.nv)

    @property
    def exact(self) -> bool:
        """Whether what they read is what is."""
        return not (self._noise.position or self._noise.velocity or self._alpha)

    def read(self, q: Array, v: Array) -> tuple[Array, Array]:
        """What is measured of q (nq,) and v (nv,)."""
        if self._noise.position or self._noise.velocity:
            away = self._rng.normal(0.0, 1.0, v.size) * self._noise.position
            q = pin.integrate(self._model, q, away) if q.size != v.size else q + away
            v = v + self._rng.normal(0.0, 1.0, v.size) * self._noise.velocity
        if self._alpha:
            last = q if self._q is None else self._q
            rate = pin.difference(self._model, last, q) / self._dt
            self._q, self._v = q, self._v + self._alpha * (rate - self._v)
            v = self._v
        return q, v
