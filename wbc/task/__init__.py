"""Tasks: what the robot should do, each as rows over the unknowns `vdot` and the contacts' multipliers.

A task is a class with `rows(state) -> Rows`; its residual is minimised with the weight given where it is placed. The
metric of a motion task is the inertia M_C of its rows together with the contacts', that of a force task the inverse
inertia: both costs are then a power over time (Gauss), so that weights are plain ratios, and the answer without active
limits is the closed form of the book (11.6) for every weight.
"""

from __future__ import annotations

from typing import Protocol

from ..qp import Rows
from ..state import State


class Task(Protocol):
    """What the controller asks of a task."""

    def rows(self, state: State) -> Rows: ...
