"""What comes from outside, looked at before a tick uses it: why it is refused, naming the field, or ""."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from .kernels import square
from .qp import Array

_ARRAY, _FLOAT64 = np.ndarray, np.dtype(np.float64)
UNIT = 1e-3  # a quaternion's norm may be off by this; more is no rounding (1 % is 2.5 N m of a humanoid's gravity)
_ROUNDING = 1e-12


def array_fault(name: str, value: Any, size: int) -> str:
    """Expected is a finite float64 array of shape (size,), in one piece and writeable, as compiled code takes it."""
    if type(value) is _ARRAY and value.dtype is _FLOAT64 and value.shape == (size,) and value.flags.carray:
        if math.isfinite(square(value)):
            return ""
        return f"{name}: expected finite numbers, got {value}"
    if type(value) is not _ARRAY or value.dtype != _FLOAT64 or value.shape != (size,):
        got = f"{value.dtype} {value.shape}" if isinstance(value, np.ndarray) else type(value).__name__
        return f"{name}: expected a float64 array of shape ({size},), got {got}"
    if not value.flags.carray:
        got = f"one with strides {value.strides}" if value.flags.writeable else "a read-only one"
        return f"{name}: expected a contiguous, writeable array, got {got}; give a copy"
    return array_fault(name, value.view(_FLOAT64), size)  # a dtype object of its own, as a pickle has


def time_fault(t: Any) -> str:
    return "" if isinstance(t, (int, float)) and math.isfinite(t) else f"t: expected a finite time [s], got {t!r}"


def missed_fault(missed: Any) -> str:
    whole = isinstance(missed, (int, np.integer)) and missed >= 0
    return "" if whole else f"missed: expected a number of ticks, 0 or more, got {missed!r}"


def unit(q: Array, parts: tuple[slice, ...]) -> tuple[Array, str]:
    """q with the parts that are unit vectors (quaternions) brought to norm 1, and why it is refused, or "".

    The same array where nothing is to be done.
    """
    for part in parts:
        size = square(q[part])
        if abs(size - 1.0) <= _ROUNDING:
            continue
        norm = math.sqrt(size)
        if not abs(norm - 1.0) <= UNIT:
            what = "quaternion" if part.stop - part.start == 4 else "vector"
            return q, f"q[{part.start}:{part.stop}]: expected a unit {what} within {UNIT:g}, got norm {norm:.6g}"
        q = q.copy()
        q[part] /= norm
    return q, ""
