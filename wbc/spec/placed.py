"""What tasks have in common: where one stands among the others, how it follows, what bounds its energy."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Annotated, Literal

from pydantic import Field, Tag

from .fields import Model, NonNegative, Positive, either
from .source import Message

Error = Literal["log", "split"]
ERROR = "pose error: the SE(3) log of the book, or split into rotation and translation, which moves in straight lines"


class Placed(Model):
    """Where a task stands among the others."""

    level: int = Field(default=1, ge=1, le=20, strict=True, description="priority: 1 comes first, see `hierarchy`")


class Jump(Model):
    """How fast a reference that jumps is led in."""

    speed: Positive = Field(default=0.1, description="of the origin [m/s]")
    turn: Positive = Field(default=0.5, description="about its axis [rad/s]")


class Following(Placed):
    """A task that follows a reference."""

    singular: NonNegative = Field(
        default=0.03, description="smallest singular value of its rows below which it is damped; 0: never"
    )
    jump: Jump = Field(default=Jump(), description="how fast a reference that jumps is led in")


class Tank(Model):
    """What bounds the energy that a task brings in."""

    energy: Positive = Field(description="energy with which it begins [J]")
    most: Positive | None = Field(
        default=None, description="energy that it holds at most; as it begins, if left out [J]"
    )
    delay: Annotated[NonNegative, Field(le=0.1)] = Field(
        default=0.0, description="up to which delay of torques and measured wrenches it pays for what they cost [s]"
    )

    def _faults(self) -> Iterable[Message]:
        if self.most is not None and self.most < self.energy:
            yield ("most",), f"expected at least energy = {self.energy:g} J, got {self.most:g}"


ATank = Annotated[
    Annotated[Positive, Tag("<number>")] | Annotated[Tank, Tag("<map>")],
    either("a number (the energy) or a mapping with energy"),
]
TANK = "bound of the energy that the task brings in: what it is given and dissipates [J]"
