"""Runs of shipped specs that several tests look at: each is run once, also where several processes share the tests."""

from __future__ import annotations

import hashlib
import os
import pickle
from functools import lru_cache
from pathlib import Path
from typing import NamedTuple

import numpy as np

from wbc.build import build
from wbc.run import Result, run
from wbc.spec import load

FOLDER = "WBC_TEST_RUNS"  # of the environment: where processes leave their runs to one another, as `conftest` says


class Ran(NamedTuple):
    """A finished run, and what the simulator alone knows of it."""

    finished: Result
    qpos: np.ndarray  # (ticks, nq) of the simulator, after each tick: also of joints that the robot does not have
    names: dict[str, int]  # joint -> its first entry

    def joint(self, name: str) -> np.ndarray:
        """(ticks,) position of a hinge or slide [rad, m]."""
        return self.qpos[:, self.names[name]]


@lru_cache(maxsize=8)
def ran(name: str, *overrides: str) -> Ran:
    """A run of a shipped spec with some changes. Nobody changes it."""
    folder = os.environ.get(FOLDER)
    file = Path(folder or ".") / hashlib.sha1("\n".join((name, *overrides)).encode()).hexdigest()
    if folder and file.exists():
        return pickle.loads(file.read_bytes())
    made = _run(name, overrides)
    if folder:
        written = file.with_suffix(f".{os.getpid()}")
        written.write_bytes(pickle.dumps(made))
        written.replace(file)  # at once, so that nobody reads half of it
    return made


def result(name: str, *overrides: str) -> Result:
    """What `ran` has finished."""
    return ran(name, *overrides).finished


def _run(name: str, overrides: tuple[str, ...]) -> Ran:
    seen: list[np.ndarray] = []
    names: dict[str, int] = {}

    def look(simulator):
        if not names:
            model = simulator.model
            names.update({model.joint(i).name: int(model.jnt_qposadr[i]) for i in range(model.njnt)})
        seen.append(simulator.data.qpos.copy())

    finished = run(build(load(name, overrides)), show=look)
    return Ran(finished, np.array(seen), names)
