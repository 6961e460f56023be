"""Which masses impedance and admittance can render at a rate: the poles of the free tick, f_ext = 0, within contacts.

Along the axes of the task the arm of mobility W = Lam^-1 does, every dt, v += dt a, x += dt v with

    wrench (or admittance)   a = -M^-1 (B v + K x)
    massless                 a = -W (B v + K x)
    acceleration             a = a_last - W (M a_last + B v + K x)

`delay` ticks later. In one dimension the bounds are `analytic.least_stable_mass` and `acceleration_feedback_limit`.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from .qp import Array
from .state import State
from .task.impedance import AdmittanceTask, Compliance

STABLE = 1.0 + 1e-6  # a free mass has a double pole at 1, which rounding splits by the root of its error
SCALES = (1e-5, 1e5)


class MassRange(NamedTuple):
    """The masses of a task, those between which it is stable with all axes scaled alike, and its largest pole."""

    task: str
    axes: tuple[str, ...]
    M: tuple[float, ...]  # [kg, kg m^2]
    least: tuple[float, ...]  # as M where there is no mass
    most: tuple[float, ...]  # infinite: no bound
    radius: float

    @property
    def stable(self) -> bool:
        return self.radius <= STABLE


def free_matrix(W: Array, M: Array, B: Array, K: Array, dt: float, acceleration: bool, delay: int = 0) -> Array:
    """Transition matrix of the free tick; state (x, v, accelerations of the last `delay` + 1 ticks), each (s,)."""
    s = W.shape[0]
    past = delay + 1
    A = np.zeros(((2 + past) * s, (2 + past) * s))
    inverse = W if acceleration or not M.any() else np.linalg.inv(M)
    command = np.zeros((s, (2 + past) * s))
    command[:, :s], command[:, s : 2 * s] = -inverse @ K, -inverse @ B
    if acceleration:
        command[:, 2 * s : 3 * s] = np.eye(s) - W @ M
    # what was asked for `delay` ticks ago is what the arm does now
    done = command if not delay else np.eye(s, (2 + past) * s, (1 + delay) * s)
    A[s : 2 * s] = dt * done
    A[s : 2 * s, s : 2 * s] += np.eye(s)
    A[:s] = dt * A[s : 2 * s]
    A[:s, :s] += np.eye(s)
    A[2 * s : 3 * s] = command
    for i in range(3, 2 + past):
        A[i * s : (i + 1) * s, (i - 1) * s : i * s] = np.eye(s)
    return A


def radius(W: Array, M: Array, B: Array, K: Array, dt: float, acceleration: bool = False, delay: int = 0) -> float:
    """Largest modulus of the poles of the free tick."""
    return float(np.abs(np.linalg.eigvals(free_matrix(W, M, B, K, dt, acceleration, delay))).max(initial=0.0))


def mass_range(name: str, task: Compliance, state: State, dt: float, delay: int = 0) -> MassRange:
    """The masses that a task can render at a state."""
    W, accelerated = task.mobility(state), task.source == "acceleration"
    if isinstance(task, AdmittanceTask) and not task.printed:
        delay = 0  # the mass is moved inside the controller, without the delay of the motors

    def worst(scale: float) -> float:
        return radius(W, scale * task.M, task.B, task.K, dt, accelerated, delay)

    largest = worst(1.0)
    M: tuple[float, ...] = tuple(task.M.diagonal().tolist())
    if task.massless:
        return MassRange(name, task.axes, M, M, M, largest)
    least, most = stable_range(worst)
    return MassRange(name, task.axes, M, tuple(least * m for m in M), tuple(most * m for m in M), largest)


def following_radius(task: AdmittanceTask, dt: float, delay: int = 0) -> float:
    """Largest modulus of the poles with which an arm follows the mass of an admittance."""
    one = np.eye(len(task.axes))
    return radius(one, one, task.Kd, task.Kp, dt, delay=delay)


def stable_range(worst: Callable[[float], float]) -> tuple[float, float]:
    """The scales between which `worst(scale)` is stable: around 1, or what is stable nearest to it. Nan when none."""
    scales = [1.0, *np.geomspace(*SCALES, 101).tolist()]
    good = [scale for scale in scales if worst(scale) <= STABLE]
    if not good:
        return math.nan, math.nan
    inside = min(good, key=lambda scale: abs(math.log(scale)))
    below = [scale for scale in scales if scale < inside and scale not in good]
    above = [scale for scale in scales if scale > inside and scale not in good]
    least = _edge(worst, inside, max(below)) if below else 0.0
    return least, _edge(worst, inside, min(above)) if above else math.inf


def _edge(worst: Callable[[float], float], inside: float, outside: float) -> float:
    """Where stability ends, to 1e-6."""
    while abs(math.log(outside / inside)) > 1e-6:
        middle = math.sqrt(inside * outside)
        inside, outside = (middle, outside) if worst(middle) <= STABLE else (inside, middle)
    return inside
