"""What bounds a run: hard limits of the joints, what only the simulator knows, and what a run must hold."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Annotated, Any, Literal

from pydantic import ConfigDict, Field, Strict, Tag

from .fault import FaultText
from .fields import ANumber, Model, Name, NonNegative, Number, Positive, Text, either, shape
from .push import Bias, Move, Push
from .source import Message


class Scale(Model):
    """A fraction of the model's own limits."""

    scale: Positive = Field(le=1, description="fraction of the model's limit [1]")


class Margin(Model):
    """A distance that is kept from the model's own limits."""

    margin: NonNegative = Field(description="distance from the model's limits [rad]")


def _limit(value: Any) -> str | None:
    return "<scale>" if isinstance(value, Scale) or (isinstance(value, Mapping) and "scale" in value) else shape(value)


OfModel = Annotated[Literal["model"], Tag("<name>")]
PerJoint = (
    Annotated[Positive, Tag("<number>")]
    | Annotated[tuple[Positive, ...], Field(min_length=1), Tag("<list>")]
    | Annotated[dict[Text, Positive], Field(min_length=1), Tag("<map>")]
)
OfScale = Annotated[Scale, Tag("<scale>")]
Limit = Annotated[OfModel | PerJoint | OfScale, either("model, a number, a list, or a mapping", _limit)]
RateLimit = Annotated[PerJoint, either("a number, a list, or a mapping from joints to numbers")]
PositionLimit = Annotated[OfModel | Annotated[Margin, Tag("<map>")], either("model or a mapping with margin")]


class Collision(Model):
    """How the robot's own bodies stay apart."""

    distance: Positive = Field(description="distance that they keep [m]")
    deceleration: Positive | None = Field(default=None, description="with which they brake; 2 by default [m/s^2]")
    rows: Annotated[int, Strict()] | None = Field(
        default=None, ge=1, le=64, description="most distances that are bounded at a tick; 16 by default"
    )


ACollision = Annotated[Collision, Tag("<map>")]
Apart = Annotated[
    Annotated[Positive, Tag("<number>")] | ACollision, either("a number (the distance) or a mapping with distance")
]


class Limits(Model):
    """Hard limits, the same for all joints, a list, by joint, or of the model."""

    torque: Limit = Field(default="model", description="joint torque [N m]")
    torque_rate: RateLimit | None = Field(default=None, description="change of the joint torque [N m/s]")
    position: PositionLimit | None = Field(default=None, description="joint position [rad]")
    velocity: Limit | None = Field(default=None, description="joint velocity [rad/s]")
    acceleration: RateLimit | None = Field(default=None, description="joint acceleration [rad/s^2]")
    self_collision: Apart | None = Field(default=None, description="distance of the robot's own bodies [m]")


class Noise(Model):
    """Standard deviations of white noise on what the controller measures."""

    force: NonNegative = Field(default=0.0, description="measured force [N]")
    moment: NonNegative = Field(default=0.0, description="measured moment [N m]")
    position: NonNegative = Field(default=0.0, description="joint position [rad]")
    velocity: NonNegative = Field(default=0.0, description="joint velocity [rad/s]")
    differenced: Positive | None = Field(
        default=None,
        description="the velocity is the difference of the measured positions, low-passed at this cut-off [Hz]",
    )
    bias: Bias = Field(default_factory=Bias, description="what the force sensor reads without a force")

    def _faults(self) -> Iterable[Message]:
        if self.differenced is not None and self.velocity:
            yield ("velocity",), "it is made of the positions; expected either noise of its own or `differenced`"


class Plant(Model):
    """What only the simulator knows."""

    payload: NonNegative = Field(default=0.0, description="mass added at the tool [kg]")
    payload_at: Text | None = Field(
        default=None, description="frame whose body carries the payload in its centre of mass; else the tool's"
    )
    mass_error: Number = Field(default=0.0, gt=-0.5, lt=1, description="fraction added to every link's mass [1]")
    joint_friction: NonNegative = Field(default=0.0, description="Coulomb friction of every joint [N m]")
    contact_friction: NonNegative = Field(default=0.0, description="friction coefficient of the contacts [1]")
    armature: NonNegative | None = Field(default=None, description="rotor inertia; else the model's [kg m^2]")
    delay: Annotated[int, Strict()] = Field(default=0, ge=0, le=100, description="extra delay of the torque [ticks]")
    noise: Noise = Field(default_factory=Noise, description="measurement noise, standard deviations")
    pushes: dict[Name, Push] = Field(default={}, max_length=50, description="wrenches on the robot, by name")
    moves: dict[Text, Move] = Field(default={}, max_length=50, description="how mocap bodies of the scene are moved")

    faults: tuple[FaultText, ...] = Field(
        default=(), max_length=100, description="what fails on purpose, such as `sensor.dropout at 1.2 for 0.1` [s]"
    )
    paths: dict[Text, Name] = Field(
        default={},
        max_length=50,
        description="the references on which bodies of the scene move, each with a free joint",
    )

    def _faults(self) -> Iterable[Message]:
        if self.payload_at is not None and not self.payload:
            yield ("payload_at",), "there is no payload; expected a mass in payload, or no payload_at"


class Bound(Model):
    """Bounds on a metric."""

    min: Number | None = Field(default=None, description="lower bound, in the unit of the metric")
    max: Number | None = Field(default=None, description="upper bound, in the unit of the metric")

    def _faults(self) -> Iterable[Message]:
        if self.min is None and self.max is None:
            yield (), "expected min, max or both"
        if self.min is not None and self.max is not None and self.min > self.max:
            yield ("min",), f"expected at most max = {self.max:g}, got {self.min:g}"


ABound = Annotated[Bound, Tag("<map>")]
Bounded = Annotated[ANumber | ABound, either("a number (an upper bound) or a mapping with min or max")]


class Expect(Model):
    """Bounds on metrics; a number is an upper bound."""

    model_config = ConfigDict(extra="allow")
    __pydantic_extra__: dict[str, Bounded] = Field(init=False)

    settle: NonNegative = Field(
        default=0.0, description="time that is left out of the figures after each begin of a contact or task [s]"
    )

    @property
    def bounds(self) -> dict[str, Bound]:
        """Metric name -> its bounds."""
        extra: Mapping[str, float | Bound] = self.__pydantic_extra__ or {}
        return {name: bound if isinstance(bound, Bound) else Bound(max=bound) for name, bound in extra.items()}
