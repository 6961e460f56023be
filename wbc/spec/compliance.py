"""Tasks that give way: a mass, spring and damper between a frame and its reference."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, Literal

from pydantic import Field

from .fields import Axes, Gain, Positive, Text
from .placed import ERROR, TANK, ATank, Error, Following
from .source import Message


class _Compliance(Following):
    """A mass, spring and damper between a frame and its reference: M xdd_e + B xd_e + K x_e = f_ext."""

    contact: Text | None = Field(default=None, description="the contact along whose free axes it is felt")
    frame: Text | None = Field(default=None, description="without a contact: the frame at which it is felt")
    axes: Axes = Field(default="all", description="without a contact: the velocity axes, or all")
    target: Text | None = Field(default=None, description="without a contact: a reference; else where it starts")
    M: Gain = Field(description="mass; 0 of an impedance: the arm's own is felt [kg m^2, kg]")
    B: Gain = Field(description="damping [N m s/rad, N s/m]")
    K: Gain = Field(description="stiffness [N m/rad, N/m]")
    error: Error = Field(default="log", description=ERROR)
    filter: Positive | None = Field(default=None, description="cut-off of the low-pass on the external wrench [Hz]")
    K_scale: Text | None = Field(default=None, description="a profile over time, by which K is multiplied [1]")
    tank: ATank | None = Field(default=None, description=TANK)
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
