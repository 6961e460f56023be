"""How kernels are compiled, and the types of their arguments."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar

import numpy as np
from numba import njit, types
from numpy.typing import NDArray

Array = NDArray[np.float64]
Indices = NDArray[np.int32]
Counts = NDArray[np.int64]
_Function = TypeVar("_Function", bound=Callable[..., Any])

NOTHING: Any = types.void
TRUTH: Any = types.boolean
COUNT: Any = types.int64
F: Any = types.float64
THREE: Any = types.UniTuple(F, 3)  # type: ignore[no-untyped-call]
v, m, t = (types.Array(F, ndim, "A", readonly=True) for ndim in (1, 2, 3))  # read only, any strides
V, M, T = (types.Array(F, ndim, "A") for ndim in (1, 2, 3))  # written to
COUNTS: Any = types.Array(COUNT, 1, "A", readonly=True)
INDICES, PAIRS = (types.Array(types.int32, ndim, "A", readonly=True) for ndim in (1, 2))  # as MuJoCo numbers things


def compiled(result: Any, *arguments: Any) -> Callable[[_Function], _Function]:
    """Compiled for these types when its module is first imported, and kept on disk: never inside a tick."""
    compiler: Any = njit([result(*arguments)], cache=True, nogil=True)
    return compiler


def inner(function: _Function) -> _Function:
    """Compiled into those that call it, which are in the same file: caches follow one file each."""
    inlined: Any = njit(cache=True, nogil=True)(function)
    return inlined
