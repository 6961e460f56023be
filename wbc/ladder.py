"""The ladder: how good a tick's torque is, and what may follow what."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from enum import Enum
from itertools import chain, combinations, islice

from .qp import Array

HOLD_TICKS = 5  # ticks without a certified answer before the safe hold
GOOD_TICKS = 10  # certified ticks in a row until the status is OK again
MISSED_DEGRADED, MISSED_STOPPED = 3, 20  # ticks; the second also of a time stamp that does not go on
MOST_DROPS = 14  # ways to drop contacts that one tick tries: all of them for four
HOLD_DAMPING = 10.0  # [1/s] times M_ii, in the safe hold


class Status(Enum):
    """How good a tick's torque is; the ladder goes down on its own and up from SAFE_HOLD only by `reset`."""

    OK = "OK"  # certified, nothing yielded
    LIMITED = "LIMITED"  # certified, and something named yielded
    DEGRADED = "DEGRADED"  # no certified answer: the last torque, of which all but the load decays; or recovering
    SAFE_HOLD = "SAFE_HOLD"  # gravity, the last contact wrenches and damping
    STOPPED = "STOPPED"  # as SAFE_HOLD, after too many missed ticks; with brakes no torque at all


_HELD = frozenset({Status.SAFE_HOLD, Status.STOPPED})
_GOOD = frozenset({Status.OK, Status.LIMITED, Status.DEGRADED, Status.STOPPED})
# From one tick to the next; `reset` begins anew with any that a first tick may have: OK, LIMITED, DEGRADED, STOPPED.
FOLLOWS: Mapping[Status, frozenset[Status]] = {
    Status.OK: _GOOD,
    Status.LIMITED: _GOOD,
    Status.DEGRADED: frozenset(Status),
    Status.SAFE_HOLD: _HELD,
    Status.STOPPED: frozenset({Status.STOPPED}),
}


def decayed(tau: Array, load: Array, bad: int) -> Array:
    """(nu,) the torque of the `bad`-th tick in a row without an answer, 1 first: of what is no load, a straight line
    from all of it to nothing at the last tick before the safe hold."""
    return load + (tau - load) * (1.0 - 1.0 / max(HOLD_TICKS + 1 - bad, 1))


def fewest(contacts: Sequence[str]) -> Iterator[tuple[str, ...]]:
    """Which contacts to drop, in the order in which it is tried: fewer before more, later ones first, never all."""
    last_first = tuple(reversed(contacts))
    ways = chain.from_iterable(combinations(last_first, k) for k in range(1, len(contacts)))
    return islice(ways, MOST_DROPS)
