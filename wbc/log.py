"""Records of a run: one array a quantity, one row a tick, in one `npz` that numpy alone can read."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .qp import Array

LIMITED_TICKS = 64  # names of active limits kept for one tick


class Log:
    """Grows tick by tick into preallocated arrays; `meta` is anything that JSON can hold."""

    def __init__(self, ticks: int, meta: Mapping[str, Any] | None = None) -> None:
        self.ticks, self.size, self.meta = ticks, 0, dict(meta or {})
        self._arrays: dict[str, Array] = {}
        self.tape: dict[str, NDArray[Any]] = {}  # what solves its ticks again (`Tape.arrays`), stored as it is
        self.active: list[tuple[str, ...]] = []

    def append(self, active: tuple[str, ...], **values: Any) -> None:
        """One tick: numbers and vectors by name (`board__true` is stored as `board.true`)."""
        self.active.append(active)
        self.size += 1
        self._put(values)

    def put(self, **values: Any) -> None:
        """More of the same tick."""
        self._put(values)

    def _put(self, values: Mapping[str, Any]) -> None:
        i, arrays = self.size - 1, self._arrays
        for name, value in values.items():
            if name not in arrays:
                arrays[name] = np.full((self.ticks, *np.shape(value)), np.nan)
            arrays[name][i] = value

    def __contains__(self, name: str) -> bool:
        return name in self._arrays

    def __getitem__(self, name: str) -> Array:
        """All recorded rows of a quantity."""
        return self._arrays[name][: self.size]

    def late(self, on: NDArray[np.bool_], settle: float) -> NDArray[np.bool_]:
        """(N,) the ticks `on`, less `settle` [s] after each time that they begin."""
        begins = on & ~np.concatenate((np.zeros(min(1, on.size), bool), on[:-1]))
        since = self["t"] - np.maximum.accumulate(np.where(begins, self["t"], -np.inf))
        return np.asarray(on & (since >= settle - 1e-9))

    @property
    def names(self) -> list[str]:
        return sorted(self._arrays)

    def save(self, path: Path) -> None:
        """Write `path` (npz): the arrays, `meta` as JSON, and active limits as names and a (ticks, names) mask."""
        names = sorted({name for active in self.active for name in active})
        mask = np.zeros((self.size, len(names)), dtype=bool)
        for i, active in enumerate(self.active):
            for name in active:
                mask[i, names.index(name)] = True
        arrays: dict[str, Any] = {name: self[name] for name in self._arrays}
        np.savez_compressed(
            path, meta=np.array(json.dumps(self.meta)), active_names=np.array(names, dtype=str), active=mask,
            **(arrays | self.tape),
        )  # fmt: skip

    @classmethod
    def load(cls, path: Path) -> Log:
        """Read what `save` wrote."""
        with np.load(path) as file:
            names, mask = file["active_names"].tolist(), file["active"]
            log = cls(mask.shape[0], json.loads(str(file["meta"])))
            own = [name for name in file.files if name not in ("meta", "active", "active_names")]
            log._arrays = {name: file[name] for name in own if "/" not in name}
            log.tape = {name: file[name] for name in own if "/" in name}
        log.size = mask.shape[0]
        log.active = [tuple(name for name, on in zip(names, row, strict=True) if on) for row in mask]
        return log
