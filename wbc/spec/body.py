"""Tasks of the whole body: centre of mass, momentum, frames seen from one another, what efforts and loads cost."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Annotated, Literal

from pydantic import Field, Tag

from .fields import (
    AName,
    Axes,
    Gain,
    Model,
    MomentumAxes,
    MomentumAxis,
    NonNegative,
    Positive,
    Target,
    Text,
    Vec3,
    either,
)
from .placed import ERROR, Error, Following, Placed
from .source import Message


class Over(Model):
    """A point between contacts."""

    over: Annotated[
        Annotated[tuple[Text, ...], Field(min_length=1), Tag("<list>")]
        | Annotated[dict[Text, NonNegative], Field(min_length=1), Tag("<map>")],
        either("a list of contacts, or a mapping from contacts to shares"),
    ] = Field(description="contacts over whose middle it is, or their shares [1]; its height is that of the start")

    @property
    def shares(self) -> dict[str, float]:
        """Contact -> share, which add up to one."""
        given = self.over if isinstance(self.over, dict) else dict.fromkeys(self.over, 1.0)
        total = sum(given.values())
        return {name: share / total for name, share in given.items()}

    def _faults(self) -> Iterable[Message]:
        if isinstance(self.over, dict) and not any(self.over.values()):
            yield ("over",), "expected a share above 0, got none"


class ComTask(Following):
    """Hold or move the centre of mass."""

    type: Literal["com"] = Field(description="com")
    target: Annotated[
        Annotated[Text, Tag("<name>")] | Annotated[Over, Tag("<map>")],
        either("start, the name of a reference, or a mapping with over"),
    ] = Field(default="start", description="start, the name of a reference, or over some contacts")
    kp: Gain = Field(description="stiffness along the world's x, y, z [1/s^2]")
    kd: Gain = Field(description="damping along the world's x, y, z [1/s]")
    weight: Positive = Field(default=1.0, description="weight of the cost, relative [1]")

    @property
    def reference(self) -> str | None:
        """The name of the reference that it follows."""
        return self.target if isinstance(self.target, str) and self.target != "start" else None


class RelativeTask(Following):
    """Track the pose of one frame seen from another, both moved by the robot."""

    type: Literal["relative"] = Field(description="relative")
    frame: Text = Field(description="the frame that moves, along whose axes it is tracked")
    to: Text = Field(description="the frame from which it is seen")
    axes: Axes = Field(default="all", description="the velocity axes that are tracked, or all")
    target: Text | None = Field(
        default=None, description="a reference `in: self`, or in the frame `to`; else where it starts"
    )
    kp: Gain = Field(description="stiffness [1/s^2]")
    kd: Gain = Field(description="damping [1/s]")
    error: Error = Field(default="log", description=ERROR)
    weight: Positive = Field(default=1.0, description="weight of the cost, relative [1]")

    def _faults(self) -> Iterable[Message]:
        if self.frame == self.to:
            yield ("to",), f"{self.to!r} is the frame itself; expected another one"


class GazeTask(Placed):
    """Turn an axis of a frame towards a point."""

    type: Literal["gaze"] = Field(description="gaze")
    frame: Text = Field(description="the frame that turns")
    axis: Annotated[
        Annotated[Literal["+x", "-x", "+y", "-y", "+z", "-z"], Tag("<name>")] | Annotated[Vec3, Tag("<list>")],
        either("+x, -x, +y, -y, +z, -z, or a list of 3 numbers"),
    ] = Field(default="+z", description="the axis of the frame that points")
    at: Annotated[AName | Annotated[Vec3, Tag("<list>")], either("the name of a frame, or a list of 3 numbers")] = (
        Field(description="a frame, to whose origin it points, or a point in the world [m]")
    )
    kp: NonNegative = Field(description="stiffness [1/s^2]")
    kd: NonNegative = Field(description="damping [1/s]")
    weight: Positive = Field(default=1.0, description="weight of the cost, relative [1]")

    @property
    def direction(self) -> tuple[float, float, float]:
        """The axis in the axes of the frame."""
        if not isinstance(self.axis, str):
            return self.axis
        sign = -1.0 if self.axis[0] == "-" else 1.0
        x, y, z = (sign * (self.axis[1] == each) for each in "xyz")
        return x, y, z

    def _faults(self) -> Iterable[Message]:
        if not any(self.direction):
            yield ("axis",), "expected a direction, got zeros"
        if self.frame == self.at:
            yield ("at",), f"{self.at!r} is the frame itself; expected another one, or a point"


class MomentumTask(Placed):
    """Hold or track the linear and angular momentum about the centre of mass."""

    type: Literal["momentum"] = Field(description="momentum")
    axes: MomentumAxes = Field(default="all", description="axes of the world: kx, ky, kz angular, lx, ly, lz linear")
    target: dict[MomentumAxis, Target] = Field(
        default={}, description="by axis, a number or the name of a reference; 0 when left out [N m s, N s]"
    )
    kp: Gain = Field(description="how fast the error dies out, along the axes [1/s]")
    weight: Positive = Field(default=1.0, description="weight of the cost, relative [1]")

    def _faults(self) -> Iterable[Message]:
        for axis in self.target:
            if self.axes != "all" and axis not in self.axes:
                yield ("target", axis), f"is not tracked; expected one of {', '.join(self.axes)}"


class TorqueTask(Placed):
    """Take little torque."""

    type: Literal["torque"] = Field(description="torque")
    weight: Positive = Field(
        default=1e-3, description="weight of the cost: the share of gravity that is let go, where it competes [1]"
    )


class DistributionTask(Placed):
    """Share what the motion needs among the contacts."""

    type: Literal["distribution"] = Field(description="distribution")
    shares: Annotated[dict[Text, NonNegative], Field(min_length=1)] | None = Field(
        default=None, description="shares of the weight that contacts carry at rest [1]; else evenly"
    )
    press: Annotated[dict[Text, NonNegative], Field(min_length=1)] | None = Field(
        default=None, description="forces with which contacts press along their `pushes` beyond what is shared [N]"
    )
    weight: Positive = Field(default=1.0, description="weight of the cost, where inequalities make it compete [1]")
