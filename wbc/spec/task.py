"""What the controller tracks: a wrench, a motion, a posture, each with its gains."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Annotated, Any, ClassVar, Literal

from pydantic import Discriminator, Field, Tag

from .fields import (
    AName,
    Axes,
    Gain,
    Model,
    MomentumAxes,
    MomentumAxis,
    NonNegative,
    Pose,
    Positive,
    Rates,
    Target,
    Text,
    Vec3,
    either,
)
from .source import Message

Error = Literal["log", "split"]
_ERROR = "pose error: the SE(3) log of the book, or split into rotation and translation, which moves in straight lines"


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
_TANK = "bound of the energy that the task brings in: what it is given and dissipates [J]"


class ForceTask(Placed):
    """Track the wrench of a contact: feed-forward, proportional, integral, damping along the constrained axes."""

    hints: ClassVar[Mapping[str, str]] = {"target": "the desired wrench stands in the contact's `artificial`"}

    type: Literal["force"] = Field(description="force")
    contact: Text = Field(description="the contact that gives the axes and the targets")
    kp: Gain = Field(default=0.0, description="proportional gain [1]")
    ki: Gain = Field(default=0.0, description="integral gain [1/s]")
    damping: Gain = Field(default=0.0, description="damping along the constrained axes [N m s/rad, N s/m]")
    filter: Positive | None = Field(default=None, description="cut-off of the low-pass on the measured wrench [Hz]")
    rate: Rates = Field(
        default=500.0,
        description="bound on how fast the target is followed; a number holds for forces [N/s], and a "
        "tenth of it for moments [N m/s]",
    )
    integral_limit: NonNegative | None = Field(
        default=None, description="bound of ki times the integral, each axis [N m, N]"
    )
    tank: ATank | None = Field(default=None, description=_TANK)
    weight: Positive = Field(
        default=1.0, description="weight of the force cost against the motion's, where a limit makes them compete [1]"
    )


class MotionTask(Following):
    """Track a motion: along the free axes of a contact, or of a frame."""

    type: Literal["motion"] = Field(description="motion")
    contact: Text | None = Field(default=None, description="the contact that gives the axes and the targets")
    frame: Text | None = Field(default=None, description="without a contact: the frame that moves")
    axes: Axes = Field(default="all", description="without a contact: the velocity axes that are tracked, or all")
    target: Text | None = Field(default=None, description="without a contact: the name of a reference")
    kp: Gain = Field(description="stiffness [1/s^2]")
    kd: Gain = Field(description="damping [1/s]")
    error: Error = Field(default="log", description=_ERROR)
    weight: Positive = Field(default=1.0, description="weight of the motion cost, relative [1]")

    def _faults(self) -> Iterable[Message]:
        for key in ("frame", "axes", "target"):
            if self.contact is not None and key in self.model_fields_set:
                yield (key,), "comes from the contact; expected either `contact`, or `frame`, `axes` and `target`"
            if self.contact is None and getattr(self, key) is None:
                yield (key,), "is missing; expected a `contact`, or a `frame` and a `target`"


class _Compliance(Following):
    """A mass, spring and damper between a frame and its reference: M xdd_e + B xd_e + K x_e = f_ext."""

    contact: Text | None = Field(default=None, description="the contact along whose free axes it is felt")
    frame: Text | None = Field(default=None, description="without a contact: the frame at which it is felt")
    axes: Axes = Field(default="all", description="without a contact: the velocity axes, or all")
    target: Text | None = Field(default=None, description="without a contact: a reference; else where it starts")
    M: Gain = Field(description="mass; 0 of an impedance: the arm's own is felt [kg m^2, kg]")
    B: Gain = Field(description="damping [N m s/rad, N s/m]")
    K: Gain = Field(description="stiffness [N m/rad, N/m]")
    error: Error = Field(default="log", description=_ERROR)
    filter: Positive | None = Field(default=None, description="cut-off of the low-pass on the external wrench [Hz]")
    K_scale: Text | None = Field(default=None, description="a profile over time, by which K is multiplied [1]")
    tank: ATank | None = Field(default=None, description=_TANK)
    weight: Positive = Field(default=1.0, description="weight of the cost, relative [1]")

    @property
    def source(self) -> str:
        """Where the external wrench comes from."""
        raise NotImplementedError

    def _faults(self) -> Iterable[Message]:
        for key in ("frame", "axes", "target"):
            if self.contact is not None and key in self.model_fields_set:
                yield (key,), "comes from the contact; expected either `contact`, or `frame`, `axes` and `target`"
        if self.contact is None and self.frame is None:
            yield ("frame",), "is missing; expected a `contact` or a `frame`"
        for key in ("M", "B", "K"):
            gain = getattr(self, key)
            # what is zero along some axes is a task along fewer axes
            if isinstance(gain, tuple) and not isinstance(gain[0], tuple) and any(gain) and not all(gain):
                yield (key,), "expected all of them above 0, or all of them 0"
        if self.filter is None and self.source == "observer":
            yield ("filter",), "is missing; expected the bandwidth of the observer [Hz]"


class ImpedanceTask(_Compliance):
    """Render a mass, spring and damper by the force that a motion calls for (book 11.7.1)."""

    type: Literal["impedance"] = Field(description="impedance")
    external: Literal["measured", "observer", "acceleration", "none"] | None = Field(
        default=None,
        description="where the external wrench comes from: the sensor, a momentum observer, the acceleration, or "
        "nowhere; measured when left out, none without a mass",
    )
    compensate: Literal["dynamics", "gravity"] = Field(
        default="dynamics", description="what of the arm is cancelled: all of its dynamics, or its weight alone"
    )

    @property
    def source(self) -> str:
        """Where the external wrench comes from."""
        return self.external or ("measured" if _any(self.M) else "none")

    def _faults(self) -> Iterable[Message]:
        yield from super()._faults()
        if _any(self.M) and self.source == "none":
            yield ("external",), "a mass needs the external wrench; expected measured, observer or acceleration"
        if not _any(self.M) and self.source != "none":
            yield ("external",), "without a mass no external wrench is needed; expected none, or a mass"
        if _any(self.M) and self.compensate == "gravity":
            yield ("compensate",), "a mass needs the arm's dynamics cancelled; expected dynamics, or M: 0"
        if self.filter is not None and self.source not in ("measured", "observer"):
            yield ("filter",), f"nothing is filtered with external: {self.source}; remove it, or choose measured"


class AdmittanceTask(_Compliance):
    """Move as a mass, spring and damper would under the measured wrench (book 11.7.2)."""

    type: Literal["admittance"] = Field(description="admittance")
    kp: Gain = Field(default=100.0, description="stiffness with which the arm follows the moving mass [1/s^2]")
    kd: Gain = Field(default=20.0, description="damping with which it follows [1/s]")
    external: Literal["measured", "observer"] = Field(
        default="measured", description="where the external wrench comes from: the sensor, or a momentum observer"
    )
    law: Literal["compensated", "printed"] = Field(
        default="compensated", description="compensated, or the book's: the wrench uncancelled, the arm as the mass"
    )

    @property
    def source(self) -> str:
        """Where the external wrench comes from."""
        return self.external

    def _faults(self) -> Iterable[Message]:
        yield from super()._faults()
        if not _any(self.M):
            yield ("M",), "an admittance moves a mass: expected it above 0, or type: impedance"


def _any(gain: Any) -> bool:
    """Whether a gain is not zero."""
    return any(map(_any, gain)) if isinstance(gain, tuple) else gain != 0


class PostureTask(Placed):
    """Track joint positions in what the other tasks leave free."""

    type: Literal["posture"] = Field(description="posture")
    target: Pose = Field(default="start", description="start, home, the name of a keyframe, or joint positions [rad]")
    kp: Gain = Field(description="stiffness [1/s^2]")
    kd: Gain = Field(description="damping [1/s]")
    weight: Positive = Field(default=1.0, description="weight of the posture cost; any value keeps the equivalence [1]")


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
    error: Error = Field(default="log", description=_ERROR)
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


def _type(value: Any) -> str | None:
    given = value.get("type") if isinstance(value, Mapping) else getattr(value, "type", None)
    return None if given is None else f"<{given}>"


Task = Annotated[
    Annotated[ForceTask, Tag("<force>")]
    | Annotated[MotionTask, Tag("<motion>")]
    | Annotated[ImpedanceTask, Tag("<impedance>")]
    | Annotated[AdmittanceTask, Tag("<admittance>")]
    | Annotated[PostureTask, Tag("<posture>")]
    | Annotated[ComTask, Tag("<com>")]
    | Annotated[RelativeTask, Tag("<relative>")]
    | Annotated[GazeTask, Tag("<gaze>")]
    | Annotated[MomentumTask, Tag("<momentum>")]
    | Annotated[TorqueTask, Tag("<torque>")]
    | Annotated[DistributionTask, Tag("<distribution>")],
    Discriminator(_type),
]
