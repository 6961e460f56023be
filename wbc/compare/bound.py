"""How far the torque of an answer can be from the true one, by its own residuals.

With d = x - x*, r = H x + g + G'z, G = [I; C], the conditions at both give

    d'H d <= d'r + sum of gaps + (|z| + |z*|) . violations,      E d = E x - e for the equalities,

so d = Z w + E^+ (E x - e), and the first line bounds w in the metric of Z'H Z, definite where the answer is one. Where
weights lie far apart that metric is flat in some direction, and residuals that any solver leaves move the torque: this
says by how much.
"""

from __future__ import annotations

import math

import numpy as np

from ..qp import Array
from .record import Recorded


class Bound:
    """The bound of one problem; what does not depend on the answer is computed once."""

    def __init__(self, item: Recorded) -> None:
        p = self._problem = item.problem
        n = p.g.size
        self._E, self._e = p.C[: p.n_eq], p.lo[n : n + p.n_eq]
        self._pinv = np.linalg.pinv(self._E)
        _, s, Vt = np.linalg.svd(self._E) if p.n_eq else (None, np.zeros(0), np.eye(n))
        Z = Vt[int((s > 1e-10 * s.max(initial=0.0)).sum()) :].T
        values, V = np.linalg.eigh(Z.T @ p.H @ Z)
        root = 1.0 / np.sqrt(np.maximum(values, 1e-15 * np.abs(p.H).max()))  # less is rounding
        self._metric = (V * root).T @ Z.T  # (Z'H Z)^-1/2 Z'
        self._torque = float(np.linalg.norm(item.T @ Z @ V * root, axis=1).max(initial=0.0))
        self._T, self._G = item.T, np.concatenate((np.eye(n), p.C))

    def __call__(self, x: Array, z: Array, best: Array) -> float:
        """[N m] most that any joint's torque of (x, z) can be off; `best` (n + m,) are the true multipliers."""
        p, n = self._problem, x.size
        at = self._G @ x
        off = np.maximum(0.0, np.maximum(p.lo - at, at - p.hi))
        free = np.ones(at.size, bool)
        free[n : n + p.n_eq] = False
        held = (z != 0.0) & free
        bounds = np.where(z > 0.0, p.hi, p.lo)
        gaps = float(np.abs(z[held] * (at - bounds)[held]).sum())
        moved = self._pinv @ (at[n : n + p.n_eq] - self._e)
        r = p.H @ x + p.g + self._G.T @ z
        slope = float(np.linalg.norm(self._metric @ (r - 2.0 * p.H @ moved)))
        room = gaps + float((np.abs(z) + np.abs(best)) @ off) + abs(float(moved @ (r - p.H @ moved)))
        return self._torque * (slope + math.sqrt(room)) + float(np.abs(self._T @ moved).max(initial=0.0))
