"""Screws, along which a contact leaves a frame free."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Annotated, Literal

from pydantic import Field, Tag

from .fields import Model, Number, Text, Vec3, either
from .source import Message

XYZ = Annotated[Literal["x", "y", "z"], Tag("<name>")]
Direction = Annotated[XYZ | Annotated[Vec3, Tag("<list>")], either("x, y, z or a list of three numbers")]


class Screw(Model):
    """A screw axis."""

    axis: Direction = Field(description="direction, in the axes of the frame that it passes through")
    through: Text = Field(default="self", description="frame that the axis passes through; self: the contact frame")
    pitch: Number = Field(default=0.0, description="advance per angle [m/rad]")

    def _faults(self) -> Iterable[Message]:
        if not isinstance(self.axis, str) and not any(self.axis):
            yield ("axis",), "expected a direction, got the zero vector"


class FreeMotion(Model):
    """One motion that the contact leaves free."""

    screw: Screw = Field(description="the screw axis of the motion")
