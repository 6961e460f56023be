"""Stretches of time: which contacts and tasks are active, what ends them, and what comes then."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Annotated, Any, ClassVar

from pydantic import AfterValidator, ConfigDict, Field, Strict, Tag

from .fields import ANumber, Model, Name, NonNegative, Number, Positive, either, wrong
from .source import Message

STOP = "stop"


class Within(Model):
    """Bounds on a measured quantity, and for how long it must keep them."""

    min: Number | None = Field(default=None, description="lower bound, in the unit of the quantity")
    max: Number | None = Field(default=None, description="upper bound, in the unit of the quantity")
    for_: NonNegative = Field(default=0.0, alias="for", description="time without a gap for which it holds [s]")

    def _faults(self) -> Iterable[Message]:
        if self.min is None and self.max is None:
            yield (), "expected min, max or both"
        if self.min is not None and self.max is not None and self.min > self.max:
            yield ("min",), f"expected at most max = {self.max:g}, got {self.min:g}"


def _condition(value: Any) -> str | None:
    if isinstance(value, bool):
        return "<true>"
    if isinstance(value, Mapping | Within):
        return "<map>"
    return "<number>" if isinstance(value, int | float) else None


def _true(value: bool) -> bool:
    if not value:
        raise wrong("expected true, got False")
    return value


ATrue = Annotated[bool, Strict(), AfterValidator(_true), Tag("<true>")]
_KINDS = either("a number (an upper bound), a mapping with min, max or for, or true for what is done", _condition)
Condition = Annotated[ANumber | Annotated[Within, Tag("<map>")] | ATrue, _KINDS]


class Until(Model):
    """What ends a phase: all of these together."""

    model_config = ConfigDict(extra="allow")
    __pydantic_extra__: dict[str, Condition] = Field(init=False)

    time: Positive | None = Field(default=None, description="time since the phase began [s]")

    @property
    def conditions(self) -> dict[str, Within]:
        """Quantity -> its bounds, those of the time first; what is done is at least 1."""
        extra: Mapping[str, Any] = self.__pydantic_extra__ or {}
        found = {"time": Within(min=self.time)} if self.time is not None else {}
        for name, value in extra.items():
            if isinstance(value, Within):
                found[name] = value
            else:
                found[name] = Within(min=1.0) if value is True else Within(max=value)
        return found

    def _faults(self) -> Iterable[Message]:
        if not self.conditions:
            yield (), "is empty; expected at least one quantity, such as time"
        for name, value in (self.__pydantic_extra__ or {}).items():
            done = name.endswith(".done")
            if done and value is not True:
                yield (name,), "expected true"
            elif not done and value is True:
                yield (name,), "expected a number or a mapping with min, max or for; only what is done is true"


class Phase(Model):
    """A stretch of time with contacts, tasks and values of its own; what it does not name is as without phases."""

    hints: ClassVar[Mapping[str, str]] = {"time": "it stands in `until`", "then": "the next phase follows; see `else`"}

    contacts: tuple[Name, ...] | None = Field(default=None, description="names of the active contacts; else all")
    tasks: tuple[Name, ...] | None = Field(default=None, description="names of the active tasks; else all")
    set: dict[str, Number] = Field(default={}, description="dotted key -> number, for this phase alone")
    until: Until | None = Field(default=None, description="what ends the phase; the last one has none")
    timeout: Positive | None = Field(default=None, description="time after which the phase is given up [s]")
    else_: Name | None = Field(default=None, alias="else", description="the phase after the timeout, or stop (default)")
    lost: Name | None = Field(default=None, description="the phase after a contact lost its force, or stop; else on")

    def active(self, section: str, names: Iterable[str]) -> tuple[str, ...]:
        """The active entries of `contacts` or `tasks`, of all that there are."""
        named: tuple[str, ...] | None = getattr(self, section)
        return tuple(name for name in names if named is None or name in named)

    def _faults(self) -> Iterable[Message]:
        for key in ("contacts", "tasks"):
            names = getattr(self, key) or ()
            for i, name in enumerate(names):
                if name in names[:i]:
                    yield (key, i), f"{name} is given twice"
        if self.else_ is not None and self.timeout is None:
            yield ("else",), "expected a timeout beside it: else is what comes after that"
