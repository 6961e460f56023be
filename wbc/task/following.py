"""What tasks that follow a reference have in common: it is led in where they begin under way, and where it jumps."""

from __future__ import annotations

from typing import Any

from ..reference import Reference, Sample
from ..singular import LEAST
from ..state import State

SPEEDS = (0.1, 0.5)  # [m/s], [rad/s] at which a reference that jumps is led in


class Following:
    """A task with a reference.

    Parameters: `reference` (t -> Sample); `singular`: the singular value below which the task is damped
    (`wbc.singular`), 0 for none; `jump`: how fast a reference that jumps is led in (`wbc.jump`), [m/s] and [rad/s],
    None: followed as it is.
    """

    def __init__(
        self, reference: Reference, singular: float = LEAST, jump: tuple[float, float] | None = SPEEDS
    ) -> None:
        self.reference, self.singular, self.jump = reference, singular, jump
        self._told: tuple[State, Any, Sample] | None = None  # at which state, since which start, what

    def followed(self, state: State) -> Sample:
        """The reference as it is followed at this tick: since the task began, led in from where the frame was then."""
        start = state.starts.get(self)
        if self._told is None or self._told[0] is not state or self._told[1] is not start:
            sample = self.reference(state.t) if start is None else start.sample(self.reference, state.t)
            self._told = (state, start, sample)
        return self._told[2]
