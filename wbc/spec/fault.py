"""What fails on purpose in a run, one line each, the same in a spec and on the command line:

    WHAT.HOW [VALUE] at TIME [for DURATION | for ever]        as in  sensor.dropout at 1.2 for 0.1

TIME and DURATION in seconds, or as `tick N` and `N ticks`; without a duration it fails for one tick (a contact:
for ever).
"""

from __future__ import annotations

import math
import re
from typing import Annotated, NamedTuple

from pydantic import AfterValidator

from ..errors import did_you_mean
from .fields import Text, wrong


class Kind(NamedTuple):
    """A way to fail: the value that it takes where none is given (None: it takes none), and what that is."""

    value: float | None
    told: str
    lasts: bool = False  # for ever, where no duration is given


KINDS = {
    "simulator.nan": Kind(None, "a joint's position becomes NaN in the simulator"),
    "simulator.reset": Kind(None, "the simulator starts again from its first state"),
    "simulator.missed": Kind(3.0, "ticks that the controller is not asked for"),
    "sensor.dropout": Kind(None, "no wrench is measured"),
    "sensor.nan": Kind(None, "a component of every measured wrench is NaN"),
    "sensor.bias": Kind(5.0, "force on every axis [N]"),
    "sensor.drift": Kind(5.0, "rate of a force on every axis [N/s]"),
    "sensor.spikes": Kind(50.0, "largest force on a random axis, in one tick of ten [N]"),
    "sensor.saturation": Kind(5.0, "largest force that is measured [N]"),
    "sensor.sign": Kind(None, "every wrench is turned round"),
    "sensor.frame": Kind(None, "its axes are taken for one another: x for y, y for z, z for x"),
    "contact.lost": Kind(None, "what the robot presses on is gone", lasts=True),
    "contact.away": Kind(0.3, "speed at which what the robot presses on moves away [m/s]", lasts=True),
    "solver.fail": Kind(None, "it raises"),
    "solver.x": Kind(1e-3, "what is added to an entry of its answer"),
    "solver.signs": Kind(None, "its multipliers have the other sign"),
    "solver.stale": Kind(None, "it answers what it last did"),
    "solver.leans": Kind(1.0, "a multiplier on a limit that does not bind, and the answer that goes with it"),
    "solver.nan": Kind(None, "an entry of its answer is NaN"),
    "solver.shape": Kind(None, "its answer lacks the last entry"),
    "state.nan": Kind(None, "an entry of q or v is NaN"),
    "state.shape": Kind(None, "q lacks its last entry"),
    "state.quaternion": Kind(0.9, "norm of the quaternion in q [1]"),
    "state.time": Kind(-1.0, "what is added to the time stamp [s]"),
    "state.repeated": Kind(None, "the time stamp stays as it was"),
}
_FORM = re.compile(
    r"(?P<kind>[a-z_.]+)(?: (?P<value>[^ ]+))? at (?:tick (?P<tick>\d+)|(?P<at>[^ ]+)(?: s)?)"
    r"(?: for (?:(?P<ever>ever)|(?P<ticks>\d+) ticks?|(?P<span>[^ ]+)(?: s)?))?"
)
_EXAMPLE = "`sensor.dropout at 1.2 for 0.1`, `solver.fail at tick 500 for ever` or `sensor.bias 5 at 1`"


class PlannedFault(NamedTuple):
    """A line of a plan, read. Times in seconds, or in ticks where these are not -1."""

    kind: str
    value: float
    start: float = 0.0
    tick: int = -1
    duration: float = 0.0
    ticks: int = -1

    def window(self, dt: float) -> tuple[int, float]:
        """The first tick, and that after the last one, which may be infinite."""
        first = self.tick if self.tick >= 0 else round(self.start / dt)
        if self.ticks >= 0:
            return first, first + self.ticks
        return first, first + max(1.0, math.inf if math.isinf(self.duration) else round(self.duration / dt))


def planned(text: str) -> PlannedFault:
    """A line of a fault plan. Raises ValueError that says what was expected."""
    found = _FORM.fullmatch(" ".join(text.split()))
    if found is None:
        raise ValueError(f"expected WHAT.HOW [VALUE] at TIME [for DURATION], such as {_EXAMPLE}, got {text[:80]!r}")
    part = found.groupdict()
    kind = KINDS.get(part["kind"])
    if kind is None:
        raise ValueError(f"nothing fails as {part['kind']!r}{did_you_mean(part['kind'], KINDS, 30)}")
    if kind.value is None and part["value"] is not None:
        raise ValueError(f"{part['kind']} takes no value ({kind.told}), got {part['value']!r}; expected `at`")
    value = _number(part["value"], kind.told, -math.inf) if part["value"] is not None else kind.value
    return PlannedFault(
        part["kind"],
        math.nan if value is None else value,
        start=_number(part["at"], "a time [s]") if part["at"] else 0.0,
        tick=int(part["tick"] or -1),
        duration=math.inf
        if part["ever"] or (kind.lasts and not (part["span"] or part["ticks"]))
        else _number(part["span"], "a duration [s]")
        if part["span"]
        else 0.0,
        ticks=int(part["ticks"] or -1),
    )


def _number(text: str, told: str, least: float = 0.0) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not (math.isfinite(value) and value >= least):
        bound = " of at least 0" if least == 0.0 else ""
        raise ValueError(f"expected a number{bound}: {told}, got {text!r}")
    return value


def _check(text: str) -> str:
    try:
        planned(text)
    except ValueError as error:
        raise wrong(str(error)) from None
    return text


FaultText = Annotated[Text, AfterValidator(_check)]
