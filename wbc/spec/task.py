"""What the controller tracks: a wrench, a motion, a posture, each with its gains; and which tasks there are."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Annotated, Any, ClassVar, Literal

from pydantic import Discriminator, Field, Tag

from .body import ComTask, DistributionTask, GazeTask, MomentumTask, RelativeTask, TorqueTask
from .compliance import AdmittanceTask, ImpedanceTask
from .fields import Axes, Gain, NonNegative, Pose, Positive, Rates, Text
from .placed import ERROR, TANK, ATank, Error, Following, Placed
from .source import Message


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
    tank: ATank | None = Field(default=None, description=TANK)
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
    error: Error = Field(default="log", description=ERROR)
    weight: Positive = Field(default=1.0, description="weight of the motion cost, relative [1]")

    def _faults(self) -> Iterable[Message]:
        for key in ("frame", "axes", "target"):
            if self.contact is not None and key in self.model_fields_set:
                yield (key,), "comes from the contact; expected either `contact`, or `frame`, `axes` and `target`"
            if self.contact is None and getattr(self, key) is None:
                yield (key,), "is missing; expected a `contact`, or a `frame` and a `target`"


class PostureTask(Placed):
    """Track joint positions in what the other tasks leave free."""

    type: Literal["posture"] = Field(description="posture")
    target: Pose = Field(default="start", description="start, home, the name of a keyframe, or joint positions [rad]")
    kp: Gain = Field(description="stiffness [1/s^2]")
    kd: Gain = Field(description="damping [1/s]")
    weight: Positive = Field(default=1.0, description="weight of the posture cost; any value keeps the equivalence [1]")


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
