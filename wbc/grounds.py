"""Where feet that measure their force have found the floor, whatever plane was believed."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, NamedTuple

from .footing import LIFTED, Footing
from .qp import Array

if TYPE_CHECKING:
    from .frame import Frame
    from .phase import Phase
    from .state import State

TOUCHED, COUNTED = 2.0, 5.0  # [N] with so much a foot stands; with more it is counted on
MISSING = 5  # ticks in a row in which what is counted on does not come, until it is in the air


class Ground(NamedTuple):
    """Where a foot that measures its force has found the floor: `level` [m] above its plane, wherever that is believed
    to be; `missing`: ticks in a row without the force that was counted on."""

    level: float = 0.0
    missing: int = 0

    def felt(self, footing: Footing, frame: Frame, F: Array, asked: float) -> Ground:
        """After a tick in which F (6,) was measured and a push of `asked` [N] was counted on.

        What presses stands, also on a plate or in a hole; what is counted on and does not press is in the air, and has
        to look for the floor further down.
        """
        height = footing.height(frame)
        if footing.push(frame, F) >= TOUCHED:
            return Ground(height if abs(height - self.level) > 0.5 * LIFTED else self.level)
        if asked < COUNTED:
            return self._replace(missing=0)
        if self.missing + 1 < MISSING:
            return self._replace(missing=self.missing + 1)
        return Ground(min(self.level, height - 2.0 * LIFTED))


def floors(
    state: State, phase: Phase, before: Mapping[str, Ground], asked: Mapping[str, Array]
) -> Mapping[str, Ground]:
    """Where the feet of a phase have found the floor, those that measure their force; `asked`: wrenches by contact."""
    if not state.measured and not before:
        return before
    grounds = {name: ground for name, ground in before.items() if name in phase.contacts}
    for name in phase.standing:
        footing = phase.contacts[name].footing
        if name in state.measured and footing is not None:
            frame = state.frame(phase.contacts[name].frame)
            push = footing.push(frame, asked[name]) if name in asked else 0.0
            grounds[name] = grounds.get(name, Ground()).felt(footing, frame, state.measured[name], push)
    return grounds


def levels(phase: Phase, grounds: Mapping[str, Ground]) -> dict[Any, float]:
    """The same by contact, in metres above their planes."""
    return {phase.contacts[name]: ground.level for name, ground in grounds.items() if name in phase.contacts}
