"""What acts on a run from outside, and is known to the simulator alone: pushes on the robot, bodies that are moved."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Annotated, Any

from pydantic import Field, Tag

from .fields import ANumber, Model, NonNegative, Number, Positive, Text, Vec3, WrenchAxis, either
from .source import Message

Frequency = Annotated[
    Annotated[Positive, Tag("<number>")] | Annotated[tuple[Positive, ...], Field(min_length=2), Tag("<list>")],
    either("a number or a list of numbers"),
]


class Sine(Model):
    """A sine, or several of one amplitude whose phases keep their sum low."""

    amplitude: Number = Field(description="amplitude of each sine [N m, N, or m]")
    frequency: Frequency = Field(description="frequency of each sine [Hz]")

    @property
    def frequencies(self) -> tuple[float, ...]:
        return self.frequency if isinstance(self.frequency, tuple) else (self.frequency,)


class Wave(Model):
    """A value that changes over time."""

    sine: Sine = Field(description="amplitude and frequency of a sine")


Course = Annotated[ANumber | Annotated[Wave, Tag("<map>")], either("a number or a mapping with sine")]


class Push(Model):
    """A wrench on the robot, at a frame and in its axes, for a while."""

    frame: Text = Field(description="the name of the frame of the robot or tool that is pushed")
    wrench: dict[WrenchAxis, Course] = Field(
        min_length=1, description="what the environment applies to the robot, by wrench axis [N m, N]"
    )
    from_: NonNegative = Field(default=0.0, alias="from", description="when it begins [s]")
    to: Positive | None = Field(default=None, description="when it ends [s]; with the run when left out")

    def _faults(self) -> Iterable[Message]:
        if self.to is not None and self.to <= self.from_:
            yield ("to",), f"expected a time after from = {self.from_:g} s, got {self.to:g}"


class Move(Model):
    """A body of the scene that is moved to and fro; the scene makes it a mocap body."""

    along: Vec3 = Field(description="direction in the world, of any length")
    sine: Sine = Field(description="amplitude [m] and frequency of the displacement")
    from_: NonNegative = Field(default=0.0, alias="from", description="when it begins [s]")

    def _faults(self) -> Iterable[Message]:
        if not any(self.along):
            yield ("along",), "expected a direction, got the zero vector"


class Bias(Model):
    """What a sensor reads when nothing is there."""

    force: Vec3 = Field(default=(0.0, 0.0, 0.0), description="measured force, in the sensor's axes [N]")
    moment: Vec3 = Field(default=(0.0, 0.0, 0.0), description="measured moment, in the sensor's axes [N m]")


def entries(wrench: dict[str, Any]) -> dict[str, tuple[float, tuple[float, ...]]]:
    """Axis -> (amplitude, frequencies); a constant has no frequency."""
    return {
        axis: (value.sine.amplitude, value.sine.frequencies) if isinstance(value, Wave) else (float(value), ())
        for axis, value in wrench.items()
    }
