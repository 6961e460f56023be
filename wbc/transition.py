"""When a phase ends, and what comes next: a state machine over measured quantities, its memory a value.

A phase is left by the first of these that is so at a tick: a contact that pressed is `lost`; all of its conditions
hold; its time is up. The machine knows neither robot nor contacts; a `Reading` is how it looks at them.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

STOP = "stop"  # where a phase may lead to instead of another phase: the safe hold
LOST_SHARE = 0.1  # of the desired force: with less a contact is lost,
LOST_TICKS = 5  # when it carried more before and this many ticks in a row confirm it
PULLS = -0.3  # of the desired force: what reads less tells of its sensor, not of the contact
_ROUNDING = 1e-9  # [s]

Reading = Callable[[Any], float]  # of a State; not a number where nothing is measured, and no bound holds


class Condition(NamedTuple):
    """`low <= quantity <= high`, for `duration` [s] without a gap. `read` None is the time since the phase began."""

    name: str
    read: Reading | None
    low: float = -math.inf
    high: float = math.inf
    duration: float = 0.0

    def told(self, value: float) -> str:
        """What holds, in words."""
        if self.name.endswith(".done"):
            return self.name
        low = f"{self.low:g} <= " if self.low > -math.inf else ""
        high = f" <= {self.high:g}" if self.high < math.inf else ""
        return f"{low}{self.name} = {value:.4g}{high}" + (f" for {self.duration:g} s" if self.duration else "")


class Watch(NamedTuple):
    """The machine's memory: since when each condition holds [s of the phase, infinite: it does not], and for each
    pressing contact the ticks in a row without its force, -1 before it has been touched."""

    since: tuple[float, ...] = ()
    loose: tuple[int, ...] = ()


class Change(NamedTuple):
    """The phase that comes next, or `stop`; why; and the contact that was lost, if one was."""

    to: str
    why: str
    lost: str = ""


@dataclass(frozen=True)
class Exit:
    """The ways out of a phase; without any it lasts.

    `until`: all of them lead to `then`. `timeout` [s] leads to `otherwise`. `pressing`: by contact, the share of its
    desired force that it carries; where one is lost, the way is `lost` ("": the phase goes on).
    """

    until: tuple[Condition, ...] = ()
    then: str = STOP
    timeout: float = math.inf
    otherwise: str = STOP
    lost: str = ""
    pressing: tuple[tuple[str, Reading], ...] = ()

    @property
    def targets(self) -> tuple[str, ...]:
        """All that the phase may lead to."""
        ways = ((self.then, self.until), (self.otherwise, self.timeout < math.inf), (self.lost, self.lost))
        return tuple(dict.fromkeys(name for name, open_ in ways if open_))

    def step(self, watch: Watch, elapsed: float, state: Any) -> tuple[Watch, Change | None]:
        """One tick, `elapsed` [s] after the phase began."""
        loose = self._loose(watch.loose, state) if self.lost else ()
        if LOST_TICKS in loose:
            name = self.pressing[loose.index(LOST_TICKS)][0]
            return Watch(), Change(self.lost, f"{name} lost, with less than {LOST_SHARE:.0%} of its force", name)
        values = [elapsed if c.read is None else c.read(state) for c in self.until]
        since = _since(self.until, values, watch.since, elapsed)
        if values and all(elapsed - s >= c.duration - _ROUNDING for s, c in zip(since, self.until, strict=True)):
            why = ", ".join(c.told(value) for c, value in zip(self.until, values, strict=True))
            return Watch(), Change(self.then, why)
        if elapsed >= self.timeout - _ROUNDING:
            return Watch(), Change(self.otherwise, f"timeout after {self.timeout:g} s{self._missing(since, values)}")
        return Watch(since, loose), None

    def _loose(self, before: Sequence[int], state: Any) -> tuple[int, ...]:
        known = before or (-1,) * len(self.pressing)
        return tuple(
            0 if share >= LOST_SHARE else count + 1 if count >= 0 and PULLS < share < LOST_SHARE else count
            for count, share in ((n, read(state)) for n, (_, read) in zip(known, self.pressing, strict=True))
        )

    def _missing(self, since: Sequence[float], values: Sequence[float]) -> str:
        waited = [f"{c.name} = {v:.4g}" for c, v, s in zip(self.until, values, since, strict=True) if math.isinf(s)]
        return f" with {', '.join(waited)}" if waited else ""


def after(time: float, then: str) -> Exit:
    """The exit of a phase that lasts for a time [s]."""
    return Exit((Condition("time", None, time),), then)


def _since(
    conditions: Sequence[Condition], values: Sequence[float], before: Sequence[float], elapsed: float
) -> tuple[float, ...]:
    known = before or (math.inf,) * len(conditions)
    return tuple(
        min(since, elapsed) if c.low - _slack(c) <= value <= c.high else math.inf
        for c, value, since in zip(conditions, values, known, strict=True)
    )


def _slack(condition: Condition) -> float:
    return _ROUNDING if condition.read is None else 0.0
