"""Discrete time changes the force loop: its poles over the stiffness of what it touches, and the bound on damping.

One axis of effective mass m [kg or kg m^2] presses on an undamped spring kappa [N/m or N m/rad] or on a rigid wall:

    m x'' = u - f,   f = kappa x,   u = -Kp s + Ki I - d x',   s' = s + alpha (f_last - s),   I' = I - dt s

sampled every dt with the force one tick (and the plant's delay) old. The loop is stable where every pole lies inside
the unit circle.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from .qp import Array

STIFFNESS = {"force": np.geomspace(1e3, 1e6, 13), "moment": np.geomspace(1.0, 1e3, 13)}


class Pole(NamedTuple):
    """The slowest-decaying pole of one axis; `stiffness` None is a rigid wall."""

    contact: str
    axis: str
    stiffness: float | None
    radius: float


def loop_matrix(
    mass: float, kp: float, ki: float, damping: float, alpha: float, dt: float, stiffness: float | None, delay: int = 1
) -> Array:
    """Transition matrix of the sampled loop; state (x, v, forces of the last `delay` ticks, s, I), rigid: no x, v."""
    free = 0 if stiffness is None else 2
    n = free + delay + 2
    A = np.zeros((n, n))
    newest, oldest, s, integral = free, free + delay - 1, n - 2, n - 1
    filtered = np.zeros(n)
    filtered[s], filtered[oldest] = 1.0 - alpha, alpha
    u = -kp * filtered
    u[integral] += ki
    A[s] = filtered
    A[integral] = -dt * filtered
    A[integral, integral] += 1.0
    for past in range(delay - 1):
        A[newest + past + 1, newest + past] = 1.0
    if stiffness is None:
        A[newest] = u
        return A
    u[1] -= damping
    A[newest, 0] = stiffness
    omega = math.sqrt(stiffness / mass)
    c, sn = math.cos(omega * dt), math.sin(omega * dt)
    A[0] = (1.0 - c) / stiffness * u
    A[1] = sn / (mass * omega) * u
    A[0, :2] += (c, sn / omega)
    A[1, :2] += (-omega * sn, c)
    return A


def radius(
    mass: float, kp: float, ki: float, damping: float, alpha: float, dt: float, stiffness: float | None, delay: int = 1
) -> float:
    """Largest modulus of the loop's poles; without an integral its own pole at 1 is left out."""
    A = loop_matrix(mass, kp, ki, damping, alpha, dt, stiffness, delay)
    if ki == 0.0:
        A = A[:-1, :-1]
    return float(np.abs(np.linalg.eigvals(A)).max())


def force_poles(
    contact: str,
    axes: tuple[str, ...],
    masses: Array,
    kp: Array,
    ki: Array,
    damping: Array,
    alpha: float,
    dt: float,
    delay: int = 1,
) -> list[Pole]:
    """Poles of every axis over the range of stiffness and on a rigid wall; gains (k, k) by their diagonal."""
    poles = []
    for i, axis in enumerate(axes):
        values: list[float | None] = [*STIFFNESS["moment" if axis.startswith("m") else "force"].tolist(), None]
        for kappa in values:
            r = radius(masses[i], kp[i, i], ki[i, i], damping[i, i], alpha, dt, kappa, delay)
            poles.append(Pole(contact, axis, kappa, r))
    return poles


def damping_margin(mobility: Array, damping: Array, dt: float) -> float:
    """dt max eig(A M_C^-1 A' K_damp): damping is stable below 2."""
    return float(dt * np.abs(np.linalg.eigvals(mobility @ damping)).max(initial=0.0))
