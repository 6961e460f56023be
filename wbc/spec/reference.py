"""Desired motions over time, in a frame of the scene."""

from __future__ import annotations

from collections.abc import Iterable
from itertools import pairwise
from typing import Annotated, ClassVar

from pydantic import Field

from .fields import Model, NonNegative, Number, OneOf, Positive, Text, Vec2, Vec3, named
from .source import Message

Sizes = Annotated[tuple[Positive, ...], Field(min_length=1, max_length=2), named("x", "x, y")]
Phases = Annotated[tuple[Number, ...], Field(min_length=1, max_length=2), named("x", "x, y")]
Waypoint = Annotated[tuple[Number, ...], Field(min_length=3, max_length=6), named("x, y, z", "x, y, z, rx, ry, rz")]


class Curve(Model):
    in_: Text = Field(
        default="world",
        alias="in",
        description="frame of the scene in which the reference is given; self: it goes out from where its frame is",
    )


class Hold(Curve):
    """Stay where the motion starts."""


class Line(Curve):
    """A straight line, from rest to rest."""

    from_: Vec3 = Field(alias="from", description="first point [m]")
    to: Vec3 = Field(description="last point [m]")
    time: Positive = Field(description="duration [s]")


class Circle(Curve):
    """A circle in the x-y plane of the frame."""

    radius: Positive = Field(description="radius [m]")
    period: Positive = Field(description="time of one turn [s]")
    center: Vec2 = Field(default=(0.0, 0.0), description="centre in the plane [m]")
    ease: NonNegative = Field(default=1.0, description="time in which the path gets up to speed from rest [s]")


class Lissajous(Curve):
    """Sines along x and y of the frame, or along x alone."""

    size: Sizes = Field(description="from end to end, along x and y [m]")
    period: Sizes = Field(description="periods along x and y [s]")
    phase: Phases | None = Field(default=None, description="phases along x and y [rad]; 0 when left out")
    ease: NonNegative = Field(default=1.0, description="time in which the path gets up to speed from rest [s]")

    @property
    def phases(self) -> tuple[float, ...]:
        return self.phase or (0.0,) * len(self.size)

    def _faults(self) -> Iterable[Message]:
        n = max(len(self.size), len(self.period))
        for key in ("size", "period", "phase"):
            value = getattr(self, key)
            if value is not None and len(value) != n:
                expected = ("1 number (x)", "2 numbers (x, y)")[n - 1]
                yield (key,), f"expected {expected}, got {len(value)}; size, period and phase are equally long"


class Quintic(Curve):
    """Quintic polynomials through way points, from rest to rest."""

    waypoints: tuple[Waypoint, ...] = Field(min_length=2, description="x, y, z [m], or with a rotation vector [rad]")
    times: tuple[NonNegative, ...] = Field(description="time of each way point, increasing [s]")

    def _faults(self) -> Iterable[Message]:
        if len(self.times) != len(self.waypoints):
            yield ("times",), f"expected {len(self.waypoints)} times, one a way point, got {len(self.times)}"
        yield from _increasing(self.times)


class Profile(Model):
    """A number over time, a quintic from rest to rest between neighbours: for one axis, screw or force."""

    in_: ClassVar = "world"
    values: tuple[Number, ...] = Field(min_length=2, description="values [rad, m, N m or N, as what follows it]")
    times: tuple[NonNegative, ...] = Field(description="time of each value, increasing [s]")

    def _faults(self) -> Iterable[Message]:
        if len(self.times) != len(self.values):
            yield ("times",), f"expected {len(self.values)} times, one a value, got {len(self.times)}"
        yield from _increasing(self.times)


class Arc(Curve):
    """Forth and back along an arc in the x-y plane of the frame, heading along it, as a wheel rolls.

    At the angle 0 it passes the frame's origin along x; the centre of the arc is on the y axis.
    """

    radius: Number = Field(description="radius; negative: the arc turns right [m]")
    angles: tuple[Number, ...] = Field(min_length=2, description="headings from rest to rest [rad]")
    times: tuple[NonNegative, ...] = Field(description="time of each heading, increasing [s]")

    def _faults(self) -> Iterable[Message]:
        if not self.radius:
            yield ("radius",), "expected a radius other than 0"
        if len(self.times) != len(self.angles):
            yield ("times",), f"expected {len(self.angles)} times, one a heading, got {len(self.times)}"
        yield from _increasing(self.times)


def _increasing(times: tuple[float, ...]) -> Iterable[Message]:
    for i, (before, time) in enumerate(pairwise(times), 1):
        if time <= before:
            yield ("times", i), f"expected a time after {before:g} s, got {time:g}"


class Reference(OneOf):
    """A desired motion over time: exactly one kind."""

    kinds: ClassVar = ("hold", "line", "circle", "lissajous", "quintic", "arc", "profile")

    hold: Hold | None = Field(default=None, description="stay where the motion starts")
    line: Line | None = Field(default=None, description="a straight line from rest to rest")
    circle: Circle | None = Field(default=None, description="a circle in the x-y plane")
    lissajous: Lissajous | None = Field(default=None, description="two sines, along x and y")
    quintic: Quintic | None = Field(default=None, description="quintic polynomials through way points")

    arc: Arc | None = Field(default=None, description="along an arc in the x-y plane, heading along it")
    profile: Profile | None = Field(default=None, description="a number over time, for one axis")

    @property
    def curve(self) -> Hold | Line | Circle | Lissajous | Quintic | Arc | Profile:
        curve: Hold | Line | Circle | Lissajous | Quintic | Arc | Profile = getattr(self, self.kind)
        return curve
