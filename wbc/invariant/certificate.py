"""Residuals of an answer once more, in plain numpy."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from ..qp import Array


def certificate(problem: Any, x: Array, z: Array) -> tuple[float, float, float]:
    """Primal, dual and gap residuals of `qp.Certificate`, in plain numpy."""
    H, g, C, lo, hi, n_eq, _ = problem
    n = g.size
    if x.shape != g.shape or z.shape != lo.shape:
        return math.inf, math.inf, math.inf
    value = np.concatenate((x, C @ x))
    outside = np.maximum(value - hi, 0.0) + np.maximum(lo - value, 0.0)
    dual = H @ x + g + z[:n] + C.T @ z[n:]
    free = np.ones(lo.size, bool)
    free[n : n + n_eq] = False
    up, down = free & (z > 0.0), free & (z < 0.0)
    gaps = np.concatenate((z[up] * (hi - value)[up], z[down] * (lo - value)[down], [0.0]))
    return float(np.linalg.norm(outside)), float(np.linalg.norm(dual)), float(np.abs(gaps).max())
