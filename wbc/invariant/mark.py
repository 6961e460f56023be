"""Whether what is remembered has changed."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from typing import Any

import numpy as np
import pinocchio as pin

from ..ladder import Status


def mark(value: Any) -> Any:
    """What tells two values apart to the last bit, however they are nested."""
    if isinstance(value, np.ndarray):
        return value.tobytes(), value.shape
    if isinstance(value, pin.SE3):
        return value.homogeneous.tobytes()
    if isinstance(value, Mapping):
        return tuple((name, mark(each)) for name, each in value.items())
    if isinstance(value, tuple | list):
        return tuple(map(mark, value))
    if is_dataclass(value) and not isinstance(value, type):
        return tuple(mark(getattr(value, each.name)) for each in fields(value))
    if isinstance(value, float):
        return value.hex()
    return value if isinstance(value, str | int | bool | None | Status) else id(value)
