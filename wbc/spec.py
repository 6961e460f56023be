"""A task specification: YAML -> frozen objects. It knows names, numbers and units, and no physics.

Every object checks itself, names its own faults in plain words, and refuses keys that it does not know; `Spec` adds
what holds between the entries, and remembers where in the file each key stands. Wrenches are robot on environment;
twists and wrenches are angular part first; units stand in the descriptions, and so in the JSON schema.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import chain, islice
from math import sqrt
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal, Self

from pydantic import (
    AfterValidator,
    BaseModel,
    ConfigDict,
    Discriminator,
    Field,
    GetCoreSchemaHandler,
    GetJsonSchemaHandler,
    ModelWrapValidatorHandler,
    PrivateAttr,
    Strict,
    Tag,
    ValidationError,
    ValidationInfo,
    model_validator,
)
from pydantic.json_schema import GenerateJsonSchema, JsonSchemaValue
from pydantic_core import CoreSchema, ErrorDetails, InitErrorDetails, PydanticCustomError, core_schema

from wbc.errors import Fault, SpecError, did_you_mean
from wbc.resources import find_file, shipped_names
from wbc.source import MAX_BYTES, MAX_FAULTS, KeyPath, NoSuchKey, Source, dotted, parse, printable, put

VELOCITY_AXES = ("wx", "wy", "wz", "vx", "vy", "vz")
WRENCH_AXES = ("mx", "my", "mz", "fx", "fy", "fz")
RECIPROCAL = dict(zip(VELOCITY_AXES + WRENCH_AXES, WRENCH_AXES + VELOCITY_AXES, strict=True))

Axis = Literal["wx", "wy", "wz", "vx", "vy", "vz", "mx", "my", "mz", "fx", "fy", "fz"]
VelocityAxis = Literal["wx", "wy", "wz", "vx", "vy", "vz"]
WrenchAxis = Literal["mx", "my", "mz", "fx", "fy", "fz"]
Message = tuple[KeyPath, str]

# --- What every object shares: faults in plain words ----------------------------------------------------------------

_COMPARED = {"greater_than": "greater than", "greater_than_equal": "of at least"}
_COMPARED |= {"less_than": "less than", "less_than_equal": "of at most"}
_EXPECTED = {"float_type": "a number", "int_type": "a whole number", "int_from_float": "a whole number"}
_EXPECTED |= {
    "finite_number": "a finite number",
    "string_type": "a text",
    "string_too_short": "a text that is not empty",
}
_EXPECTED |= {"tuple_type": "a list", "dict_type": "a mapping", "model_type": "a mapping"}
_EXPECTED |= {"union_tag_not_found": "a mapping"}
_TAGS = {"<number>", "<name>", "<list>", "<matrix>", "<map>", "<scale>", "<force>", "<motion>", "<posture>", "[key]"}


def _shown(value: Any) -> str:
    if isinstance(value, Mapping | list | tuple | BaseModel):
        return "a list" if isinstance(value, list | tuple) else "a mapping"
    return "nothing" if value is None else printable(str(value)) if isinstance(value, float) else printable(repr(value))


def _wrong(message: str) -> PydanticCustomError:
    return PydanticCustomError("wrong", "{message}", {"message": message})


def _faulty(title: str, messages: Iterable[Message]) -> ValidationError:
    """Several faults of one object at once; inside a validator they join those of the others, with their paths."""
    details: list[InitErrorDetails] = [{"type": _wrong(text), "loc": path, "input": None} for path, text in messages]
    return ValidationError.from_exception_data(title, details)


class Model(BaseModel):
    """Frozen, closed, and with messages for people."""

    model_config = ConfigDict(extra="forbid", frozen=True)
    hints: ClassVar[Mapping[str, str]] = {}  # for keys that one might expect here: where they stand instead

    @model_validator(mode="wrap")
    @classmethod
    def _explain(cls, value: Any, handler: ModelWrapValidatorHandler[Self]) -> Self:
        try:
            return handler(value)
        except ValidationError as error:
            raise _faulty(
                cls.__name__, map(cls._explained, error.errors(include_url=False)[: MAX_FAULTS + 1])
            ) from None

    @classmethod
    def _explained(cls, error: ErrorDetails) -> Message:
        """The path, in keys of the file, and the message for one error of pydantic."""
        kind, given, bounds, where = error["type"], error["input"], error.get("ctx", {}), error["loc"]
        path = tuple(part for part in where if part not in _TAGS)
        fields = {field.alias or name: field for name, field in cls.model_fields.items()}
        described = (fields[str(path[0])].description or "") if path and path[0] in fields else ""
        unit = "".join(re.findall(r" \[(?!1\])[^]]*\]", described)[:1])
        if kind == "wrong":
            return path, error["msg"]
        if kind == "extra_forbidden":
            key = str(where[-1])
            return where, "unknown key" + (f"; {cls.hints[key]}" if key in cls.hints else did_you_mean(key, fields, 20))
        if kind == "missing":
            return path, f"is missing; expected {described}"
        if kind == "union_tag_invalid":
            named, types = bounds["tag"].strip("<>"), re.findall("<([a-z]+)>", bounds["expected_tags"])
            return (*path, "type"), f"unknown type {_shown(named)}{did_you_mean(named, types)}"
        if kind == "union_tag_not_found" and isinstance(given, Mapping):
            return (*path, "type"), "is missing; expected force, motion or posture"
        if kind == "literal_error":
            words = re.findall("'([^']*)'", bounds["expected"])
            return path, f"unknown word {_shown(given)}{did_you_mean(str(given), words)}"
        if kind == "string_pattern_mismatch":
            return path, "expected a name of letters, digits and _ that does not begin with a digit"
        if kind in ("too_short", "too_long"):
            bound = f"at least {bounds['min_length']}" if kind == "too_short" else f"at most {bounds['max_length']}"
            return path, f"expected {bound} entries, got {len(given)}"
        if kind in _COMPARED:
            expected = f"a number {_COMPARED[kind]} {next(iter(bounds.values())):g}"
        else:
            expected = error["msg"] if kind == "shape" else _EXPECTED.get(kind, error["msg"])
        return path, f"expected {expected}{unit}, got {_shown(given)}"


def _shape(value: Any) -> str | None:
    """The tag of what a value looks like; None for what no key can take."""
    if isinstance(value, list | tuple):
        return "<matrix>" if value and isinstance(value[0], list | tuple) else "<list>"
    if isinstance(value, Mapping | BaseModel):
        return "<map>"
    if isinstance(value, str):
        return "<name>"
    return "<number>" if isinstance(value, int | float) and not isinstance(value, bool) else None


def _limit_shape(value: Any) -> str | None:
    return "<scale>" if isinstance(value, Scale) or (isinstance(value, Mapping) and "scale" in value) else _shape(value)


def _task_type(value: Any) -> str | None:
    given = value.get("type") if isinstance(value, Mapping) else getattr(value, "type", None)
    return None if given is None else f"<{given}>"


def _either(expected: str, shape: Callable[[Any], str | None] = _shape) -> Discriminator:
    """Chooses a member of a union by what the value looks like, so that a fault is told for that member alone."""
    return Discriminator(shape, custom_error_type="shape", custom_error_message=expected)


@dataclass(frozen=True)
class _Numbers:
    """A list of exactly these numbers."""

    names: str
    also: str = ""  # another length that will do

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        return core_schema.no_info_after_validator_function(self.check, handler(source))

    def __get_pydantic_json_schema__(self, schema: CoreSchema, handler: GetJsonSchemaHandler) -> JsonSchemaValue:
        lengths = [names.count(",") + 1 for names in (self.names, self.also) if names]
        return handler(schema) | {"minItems": min(lengths), "maxItems": max(lengths)}

    def check(self, values: tuple[float, ...]) -> tuple[float, ...]:
        choices = {names.count(",") + 1: names for names in (self.names, self.also) if names}
        if len(values) not in choices:
            expected = " or ".join(f"{length} numbers ({names})" for length, names in choices.items())
            raise _wrong(f"expected {expected}, got {len(values)}")
        return values


def _positive_definite(matrix: tuple[tuple[float, ...], ...]) -> tuple[tuple[float, ...], ...]:
    size = len(matrix)
    if any(len(row) != size for row in matrix):
        raise _wrong(f"expected a square matrix, got rows of {', '.join(str(len(row)) for row in matrix)} numbers")
    largest = max(abs(entry) for row in matrix for entry in row)
    for i in range(size):
        for j in range(i):
            if abs(matrix[i][j] - matrix[j][i]) > 1e-9 * largest:
                raise _wrong(
                    f"expected a symmetric matrix, got {matrix[i][j]:g} and {matrix[j][i]:g} across the diagonal"
                )
    factor: list[list[float]] = []  # Cholesky
    for i, row in enumerate(matrix):
        factor.append([0.0] * size)
        for j in range(i + 1):
            rest = row[j] - sum(a * b for a, b in zip(factor[i][:j], factor[j][:j], strict=True))
            if i == j and not rest > 1e-12 * largest:
                import numpy  # only to name the eigenvalue

                smallest = numpy.linalg.eigvalsh(numpy.array(matrix))[0]
                raise _wrong(
                    f"expected a positive definite matrix, got one whose smallest eigenvalue is {smallest:.3g}"
                )
            factor[i][j] = sqrt(rest) if i == j else rest / factor[j][j]
    return matrix


def _zero(value: float) -> float:
    if value != 0:
        raise _wrong(
            f"expected 0, as the natural constraints are A V = 0 and no wrench along what is free, got {value:g}"
        )
    return value


def _distinct(axes: tuple[str, ...]) -> tuple[str, ...]:
    if twice := [axis for axis, count in Counter(axes).items() if count > 1]:
        raise _wrong(f"{twice[0]} is given twice")
    return axes


Number = Annotated[float, Strict(), Field(allow_inf_nan=False)]
Positive = Annotated[Number, Field(gt=0)]
NonNegative = Annotated[Number, Field(ge=0)]
Text = Annotated[str, Field(min_length=1)]
Name = Annotated[str, Field(pattern=r"^[A-Za-z_][A-Za-z0-9_]*$")]
Vec2 = Annotated[tuple[Number, ...], _Numbers("x, y")]
Size2 = Annotated[tuple[Positive, ...], _Numbers("x, y")]
Vec3 = Annotated[tuple[Number, ...], _Numbers("x, y, z")]
Row6 = Annotated[tuple[Number, ...], _Numbers("wx, wy, wz, vx, vy, vz")]
Waypoint = Annotated[tuple[Number, ...], _Numbers("x, y, z", "x, y, z, rx, ry, rz")]
Axes = Annotated[tuple[VelocityAxis, ...], Field(min_length=1), AfterValidator(_distinct)]
Gain = Annotated[
    Annotated[NonNegative, Tag("<number>")]
    | Annotated[tuple[NonNegative, ...], Field(min_length=1), Tag("<list>")]
    | Annotated[tuple[tuple[Number, ...], ...], AfterValidator(_positive_definite), Tag("<matrix>")],
    _either("a number, a list of numbers or a matrix"),
]
Target = Annotated[
    Annotated[Number, Tag("<number>")] | Annotated[Text, Tag("<name>")],
    _either("a number or the name of a reference"),
]
Pose = Annotated[
    Annotated[Text, Tag("<name>")] | Annotated[dict[Text, Number], Tag("<map>")],
    _either("the name of a keyframe or a mapping from joints to angles [rad]"),
]

# --- References -----------------------------------------------------------------------------------------------------


class Curve(Model):
    in_: Text = Field(default="world", alias="in", description="frame of the scene in which the reference is given")


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
    ease: NonNegative = Field(
        default=1.0, description="time in which the path parameter gets up to speed from rest [s]"
    )


class Lissajous(Curve):
    """Two sines, along x and y of the frame."""

    size: Size2 = Field(description="amplitudes along x and y [m]")
    period: Size2 = Field(description="periods along x and y [s]")
    phase: Vec2 = Field(default=(0.0, 0.0), description="phases along x and y [rad]")
    ease: NonNegative = Field(
        default=1.0, description="time in which the path parameter gets up to speed from rest [s]"
    )


class Quintic(Curve):
    """Quintic polynomials through way points, from rest to rest."""

    waypoints: Annotated[tuple[Waypoint, ...], Field(min_length=2)] = Field(
        description="points x, y, z [m], or with a rotation vector rx, ry, rz [rad]"
    )
    times: tuple[NonNegative, ...] = Field(description="time of each way point, increasing [s]")

    @model_validator(mode="after")
    def _increasing(self) -> Self:
        wrong: list[Message] = []
        if len(self.times) != len(self.waypoints):
            wrong.append((("times",), f"expected {len(self.waypoints)} times, one a way point, got {len(self.times)}"))
        for i in range(1, len(self.times)):
            if not self.times[i] > self.times[i - 1]:
                message = f"expected a time after {self.times[i - 1]:g} s, got {self.times[i]:g}"
                wrong.append((("times", i), message))
        if wrong:
            raise _faulty("Quintic", wrong)
        return self


def _only(model: BaseModel, keys: Sequence[str]) -> str:
    """The one of the keys that is given."""
    given = [key for key in keys if getattr(model, key) is not None]
    if len(given) != 1:
        raise _wrong(f"expected exactly one of {', '.join(keys)}, got {' and '.join(given) or 'none of them'}")
    return given[0]


def _one_required(keys: Sequence[str]) -> ConfigDict:
    return ConfigDict(json_schema_extra={"oneOf": [{"required": [key]} for key in keys]})


_CURVES = ("hold", "line", "circle", "lissajous", "quintic")
_HOLDINGS = ("natural", "free", "holds", "A")


class Reference(Model):
    """A desired motion over time: exactly one kind."""

    model_config = _one_required(_CURVES)

    hold: Hold | None = Field(default=None, description="stay where the motion starts")
    line: Line | None = Field(default=None, description="a straight line from rest to rest")
    circle: Circle | None = Field(default=None, description="a circle in the x-y plane")
    lissajous: Lissajous | None = Field(default=None, description="two sines, along x and y")
    quintic: Quintic | None = Field(default=None, description="quintic polynomials through way points")

    @model_validator(mode="after")
    def _one_kind(self) -> Self:
        _only(self, _CURVES)
        return self

    @property
    def kind(self) -> str:
        return _only(self, _CURVES)

    @property
    def curve(self) -> Hold | Line | Circle | Lissajous | Quintic:
        curve: Hold | Line | Circle | Lissajous | Quintic = getattr(self, self.kind)
        return curve


# --- Contacts -------------------------------------------------------------------------------------------------------


class Screw(Model):
    """A screw axis."""

    axis: Annotated[
        Annotated[Literal["x", "y", "z"], Tag("<name>")] | Annotated[Vec3, Tag("<list>")],
        _either("x, y, z or a list of three numbers"),
    ] = Field(description="direction, in the axes of the frame that it passes through")
    through: Text = Field(default="self", description="frame that the axis passes through; self: the contact frame")
    pitch: Number = Field(default=0.0, description="advance per angle [m/rad]")

    @model_validator(mode="after")
    def _direction(self) -> Self:
        if not isinstance(self.axis, str) and not any(self.axis):
            raise _faulty("Screw", [(("axis",), "expected a direction, got the zero vector")])
        return self


class FreeMotion(Model):
    """One motion that the contact leaves free."""

    screw: Screw = Field(description="the screw axis of the motion")


class Contact(Model):
    """How the world holds a frame of the robot, by exactly one of natural, free, holds and A."""

    model_config = _one_required(_HOLDINGS)

    frame: Text = Field(description="the name of the frame of the robot or tool that is held")
    on: Text | None = Field(
        default=None, description="frame of the scene that it closes against; the contact's own name if left out"
    )
    in_: Literal["frame", "on"] = Field(
        default="frame", alias="in", description="whose axes the rows of A are expressed in"
    )
    natural: dict[Axis, Annotated[Number, AfterValidator(_zero)]] | None = Field(
        default=None,
        description="natural constraints: velocities [rad/s, m/s] and wrenches [N m, N] that the contact keeps at 0",
    )
    free: dict[Name, FreeMotion] | None = Field(default=None, description="free screws, of which A is the annihilator")
    holds: (
        Annotated[
            Annotated[Literal["all"], Tag("<name>")] | Annotated[Axes, Tag("<list>")],
            _either("all or a list of velocity axes"),
        ]
        | None
    ) = Field(default=None, description="velocity axes that are held, or all")
    A: Annotated[tuple[Row6, ...], Field(max_length=6)] | None = Field(
        default=None, description="rows of A V = 0, angular part first"
    )
    artificial: dict[
        str,
        Annotated[
            Annotated[Number, Tag("<number>")]
            | Annotated[Text, Tag("<name>")]
            | Annotated[dict[WrenchAxis, Target], Tag("<map>")],
            _either("a number or the name of a reference"),
        ],
    ] = Field(
        default={}, description="targets: velocities [rad/s, m/s], wrenches on the environment [N m, N], or references"
    )

    @property
    def kind(self) -> str:
        return _only(self, _HOLDINGS)

    @property
    def constrained(self) -> tuple[str, ...]:
        """Velocity axes at rest, in canonical order; empty for `free` and `A`, whose rows lie along no axes."""
        held: Iterable[str] = VELOCITY_AXES if self.holds == "all" else self.holds or self.natural or ()
        return tuple(axis for axis in VELOCITY_AXES if axis in held)

    @property
    def free_axes(self) -> tuple[str, ...]:
        """Velocity axes that can move, in canonical order; the names of the screws for `free`; empty for `A`."""
        if self.natural is not None:
            return tuple(axis for axis in VELOCITY_AXES if RECIPROCAL[axis] in self.natural)
        return tuple(self.free or ()) or tuple(a for a in VELOCITY_AXES if self.holds and a not in self.constrained)

    @property
    def force_axes(self) -> tuple[str, ...]:
        """Wrench axes of the constrained velocities."""
        return tuple(RECIPROCAL[axis] for axis in self.constrained)

    @property
    def wrench_targets(self) -> dict[str, float | str]:
        """Desired wrench on the environment by wrench axis [N m, N], in canonical order."""
        column = self.artificial if self.natural is not None else self.artificial.get("wrench", {})
        given: Mapping[Any, Any] = column if isinstance(column, dict) else {}
        return {axis: given[axis] for axis in WRENCH_AXES if not isinstance(given.get(axis, {}), dict)}

    @property
    def motion_targets(self) -> dict[str, float | str]:
        """Desired motion by free velocity axis or screw [rad/s, m/s, or a reference]."""
        entries = {name: value for name, value in self.artificial.items() if not isinstance(value, dict)}
        order = [*self.free_axes, *entries]
        return {name: entries[name] for name in dict.fromkeys(order) if name in entries and name not in WRENCH_AXES}

    @property
    def targets(self) -> dict[str, float | str]:
        return self.motion_targets | self.wrench_targets

    def gain_names(self, task: str) -> tuple[str, ...] | None:
        """What the entries of a gain of a force or motion task stand for; None where only the robot can tell."""
        if task == "force":
            rows = tuple(f"row {i}" for i in range(len(self.A or ())))
            return rows or (self.force_axes if self.holds != "all" and self.free is None else None)
        return self.free_axes if self.natural is not None or self.free is not None else None

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        wrong = list(self._table() if self.kind == "natural" else self._entries())
        if wrong:
            raise _faulty("Contact", wrong)
        return self

    def _table(self) -> Iterator[Message]:
        """Of every pair that the table names: one natural and one artificial entry, reciprocal (book 11.6)."""
        natural, artificial = self.natural or {}, self.artificial
        for name in artificial:
            if name not in RECIPROCAL:
                yield ("artificial", name), f"unknown axis{did_you_mean(name, RECIPROCAL)}"
            elif isinstance(artificial[name], dict):
                yield ("artificial", name), "expected a number or the name of a reference, got a mapping"
        for velocity, wrench in zip(VELOCITY_AXES, WRENCH_AXES, strict=True):
            left = [axis for axis in natural if axis in (velocity, wrench)]
            right = [axis for axis in artificial if axis in (velocity, wrench)]
            rule = f"of {velocity} and {wrench} one is natural and the other artificial"
            if len(left) == 2:
                yield ("natural", left[1]), f"{left[0]} and {left[1]} are both natural; {rule}"
            elif len(right) == 2:
                yield ("artificial", right[1]), f"{right[0]} and {right[1]} are both artificial; {rule}"
            elif left and not right:
                missing = RECIPROCAL[left[0]]
                yield ("artificial", missing), f"{missing} is missing; natural {left[0]} needs its artificial entry"
            elif right and not left:
                missing = RECIPROCAL[right[0]]
                yield ("natural", missing), f"{missing} is missing; artificial {right[0]} needs its natural entry"
            elif left and left == right:
                yield ("artificial", right[0]), f"{left[0]} is both natural and artificial; {rule}"

    def _entries(self) -> Iterator[Message]:
        """Targets of `free`, `holds` and `A`: free motions by name, forces under `wrench`."""
        names = self.free_axes if self.A is None else VELOCITY_AXES
        for name, value in self.artificial.items():
            if name == "wrench" and not isinstance(value, dict):
                yield ("artificial", name), f"expected a mapping from wrench axes to targets, got {_shown(value)}"
            elif name != "wrench" and isinstance(value, dict):
                yield ("artificial", name), "expected a number or the name of a reference, got a mapping"
            elif name in self.constrained:
                yield ("artificial", name), f"{name} is held, so it has no target of motion"
            elif name != "wrench" and name not in names:
                yield ("artificial", name), f"no such free motion{did_you_mean(name, (*names, 'wrench'))}"
        if "wrench" in (self.free or ()):
            yield ("free", "wrench"), "this word is taken by the forces in `artificial`; expected another name"
        for axis in self.wrench_targets:
            if self.holds and RECIPROCAL[axis] not in self.constrained:
                yield ("artificial", "wrench", axis), f"{RECIPROCAL[axis]} is free, so {axis} cannot be held at a value"


# --- Tasks ----------------------------------------------------------------------------------------------------------


class ForceTask(Model):
    """Track the wrench of a contact: feed-forward, proportional, integral, damping along the constrained axes."""

    hints: ClassVar[Mapping[str, str]] = {"target": "the desired wrench stands in the contact's `artificial`"}

    type: Literal["force"] = Field(description="force")
    contact: Text = Field(description="the contact that gives the axes and the targets")
    kp: Gain = Field(default=0.0, description="proportional gain [1]")
    ki: Gain = Field(default=0.0, description="integral gain [1/s]")
    damping: Gain = Field(default=0.0, description="damping along the constrained axes [N m s/rad, N s/m]")
    filter: Positive | None = Field(default=None, description="cut-off of the low-pass on the measured wrench [Hz]")
    integral_limit: NonNegative | None = Field(
        default=None, description="bound of the integral part, each axis [N m, N]"
    )
    weight: Positive = Field(default=100.0, description="weight of the force cost, relative [1]")


class MotionTask(Model):
    """Track a motion: along the free axes of a contact, or of a frame."""

    type: Literal["motion"] = Field(description="motion")
    contact: Text | None = Field(default=None, description="the contact that gives the axes and the targets")
    frame: Text | None = Field(default=None, description="without a contact: the frame that moves")
    axes: Annotated[
        Annotated[Literal["all"], Tag("<name>")] | Annotated[Axes, Tag("<list>")],
        _either("all or a list of velocity axes"),
    ] = Field(default="all", description="without a contact: the velocity axes that are tracked, or all")
    target: Text | None = Field(default=None, description="without a contact: the name of a reference")
    kp: Gain = Field(description="stiffness [1/s^2]")
    kd: Gain = Field(description="damping [1/s]")
    weight: Positive = Field(default=1.0, description="weight of the motion cost, relative [1]")

    @model_validator(mode="after")
    def _contact_or_frame(self) -> Self:
        own = ("frame", "axes", "target")
        if self.contact is None:
            missing = [key for key in ("frame", "target") if getattr(self, key) is None]
            wrong: list[Message] = [
                ((key,), "is missing; expected a `contact`, or a `frame` and a `target`") for key in missing
            ]
        else:
            message = "comes from the contact; expected either `contact`, or `frame`, `axes` and `target`"
            wrong = [((key,), message) for key in own if key in self.model_fields_set]
        if wrong:
            raise _faulty("MotionTask", wrong)
        return self


class PostureTask(Model):
    """Track joint positions in what the other tasks leave free."""

    type: Literal["posture"] = Field(description="posture")
    target: Pose = Field(default="start", description="start, home, the name of a keyframe, or joint positions [rad]")
    kp: Gain = Field(description="stiffness [1/s^2]")
    kd: Gain = Field(description="damping [1/s]")
    weight: Positive = Field(default=1.0, description="weight of the posture cost; any value keeps the equivalence [1]")


Task = Annotated[
    Annotated[ForceTask, Tag("<force>")]
    | Annotated[MotionTask, Tag("<motion>")]
    | Annotated[PostureTask, Tag("<posture>")],
    Discriminator(_task_type),
]

# --- Limits, phases, plant, expectations ----------------------------------------------------------------------------


class Scale(Model):
    """A fraction of the model's own limits."""

    scale: Annotated[Positive, Field(le=1)] = Field(description="fraction of the model's limit [1]")


class Margin(Model):
    """A distance that is kept from the model's own limits."""

    margin: NonNegative = Field(description="distance from the model's limits [rad]")


Limit = Annotated[
    Annotated[Literal["model"], Tag("<name>")]
    | Annotated[Positive, Tag("<number>")]
    | Annotated[tuple[Positive, ...], Field(min_length=1), Tag("<list>")]
    | Annotated[dict[Text, Positive], Tag("<map>")]
    | Annotated[Scale, Tag("<scale>")],
    _either("model, a number, a list, or a mapping", _limit_shape),
]
RateLimit = Annotated[
    Annotated[Positive, Tag("<number>")]
    | Annotated[tuple[Positive, ...], Field(min_length=1), Tag("<list>")]
    | Annotated[dict[Text, Positive], Tag("<map>")],
    _either("a number, a list, or a mapping from joints to numbers"),
]
PositionLimit = Annotated[
    Annotated[Literal["model"], Tag("<name>")] | Annotated[Margin, Tag("<map>")],
    _either("model or a mapping with margin"),
]


class Limits(Model):
    """Hard limits, the same for all joints, a list, by joint, or of the model."""

    torque: Limit = Field(default="model", description="joint torque [N m]")
    torque_rate: RateLimit | None = Field(default=None, description="change of the joint torque [N m/s]")
    position: PositionLimit | None = Field(default=None, description="joint position [rad]")
    velocity: Limit | None = Field(default=None, description="joint velocity [rad/s]")


class Until(Model):
    """What ends a phase."""

    time: Positive = Field(description="time since the phase began [s]")


class Phase(Model):
    """A stretch of time with values of its own; what `set` does not name is as without phases."""

    set: dict[str, Number] = Field(default={}, description="dotted key -> number, for this phase alone")
    until: Until | None = Field(default=None, description="what ends the phase; the last one may go on")


class Noise(Model):
    """Standard deviations of white noise on what the controller measures."""

    force: NonNegative = Field(default=0.0, description="measured force [N]")
    moment: NonNegative = Field(default=0.0, description="measured moment [N m]")
    position: NonNegative = Field(default=0.0, description="joint position [rad]")
    velocity: NonNegative = Field(default=0.0, description="joint velocity [rad/s]")


class Plant(Model):
    """What only the simulator knows."""

    payload: NonNegative = Field(default=0.0, description="mass added at the tool [kg]")
    mass_error: Annotated[Number, Field(gt=-0.5, lt=1)] = Field(
        default=0.0, description="fraction added to every link's mass [1]"
    )
    joint_friction: NonNegative = Field(default=0.0, description="Coulomb friction of every joint [N m]")
    contact_friction: NonNegative = Field(default=0.0, description="friction coefficient of the contacts [1]")
    armature: NonNegative | None = Field(
        default=None, description="rotor inertia of every joint; the model's if left out [kg m^2]"
    )
    delay: Annotated[int, Strict(), Field(ge=0, le=1000)] = Field(
        default=0, description="extra delay of the torque [ticks]"
    )
    noise: Noise = Field(default_factory=Noise, description="measurement noise, standard deviations")


class Bound(Model):
    """Bounds on a metric."""

    min: Number | None = Field(default=None, description="lower bound, in the unit of the metric")
    max: Number | None = Field(default=None, description="upper bound, in the unit of the metric")
    for_: Positive | None = Field(default=None, alias="for", description="how long it must hold without a break [s]")

    @model_validator(mode="after")
    def _ordered(self) -> Self:
        if self.min is None and self.max is None:
            raise _wrong("expected min, max or both")
        if self.min is not None and self.max is not None and self.min > self.max:
            raise _faulty("Bound", [(("min",), f"expected at most max = {self.max:g}, got {self.min:g}")])
        return self


class Expect(Model):
    """Bounds on metrics; a number is an upper bound."""

    model_config = ConfigDict(extra="allow")
    __pydantic_extra__: dict[
        str,
        Annotated[
            Annotated[Number, Tag("<number>")] | Annotated[Bound, Tag("<map>")],
            _either("a number (an upper bound) or a mapping with min or max"),
        ],
    ] = Field(init=False)

    settle: NonNegative = Field(default=0.0, description="time at the start that is left out of the figures [s]")

    @property
    def bounds(self) -> dict[str, Bound]:
        """Metric name -> its bounds."""
        extra: Mapping[str, float | Bound] = self.__pydantic_extra__ or {}
        return {name: bound if isinstance(bound, Bound) else Bound(max=bound) for name, bound in extra.items()}


# --- The whole ------------------------------------------------------------------------------------------------------

_SECTIONS: tuple[KeyPath, ...] = (("limits",), ("plant",), ("plant", "noise"))  # `--set` makes them when absent
MAX_ENTRIES = 200
_BY_NAME = ("references", "contacts", "tasks", "phases")
_IN_PHASES = ("contacts", "tasks", "limits", "references")


class Spec(Model):
    """What a robot should do, and how well."""

    title: str = Field(default="", description="what is shown above the pictures")
    robot: Text = Field(description="the name of a shipped robot, a path, or erd:NAME")
    tool: Text | None = Field(default=None, description="the name of a shipped tool, or a path")
    scene: Text | None = Field(default=None, description="the name of a shipped scene, or a path")
    rate: Annotated[Positive, Field(le=10_000)] = Field(default=1000.0, description="control rate [Hz]")
    duration: Annotated[Positive, Field(le=3600)] = Field(default=5.0, description="duration of a run [s]")
    law: Literal["compensated", "book"] = Field(
        default="compensated", description="compensated, or the book's law to the letter"
    )
    gravity: Literal["controller", "robot"] = Field(
        default="controller", description="who adds the torque against gravity"
    )
    start: Pose | None = Field(
        default=None, description="keyframe or joint positions to start from [rad]; home if left out"
    )
    solver: Text = Field(default="daqp", description="the name of the QP solver")
    references: Annotated[dict[Name, Reference], Field(max_length=MAX_ENTRIES)] = Field(
        default={}, description="desired motions over time, by name"
    )
    contacts: Annotated[dict[Name, Contact], Field(max_length=MAX_ENTRIES)] = Field(
        default={}, description="contacts by name"
    )
    tasks: Annotated[dict[Name, Task], Field(max_length=MAX_ENTRIES)] = Field(default={}, description="tasks by name")
    limits: Limits = Field(default_factory=Limits, description="hard limits")
    phases: Annotated[dict[Name, Phase], Field(max_length=50)] = Field(
        default={}, description="phases by name, in this order"
    )
    plant: Plant = Field(default_factory=Plant, description="what only the simulator knows")
    expect: Expect = Field(default_factory=Expect, description="bounds that a run must hold")

    _source: Source = PrivateAttr(default_factory=Source)

    @property
    def file(self) -> str:
        """The name of the file as messages show it."""
        return self._source.file

    def where(self, *path: str | int) -> tuple[int, int]:
        """Line and column of the nearest enclosing key that is in the file, from 1; (0, 0) without a file."""
        return self._source.where(path)

    def fault(self, path: Sequence[str | int], message: str) -> Fault:
        """A fault for later stages to report, at its place in the file or at the `--set` that brought it."""
        return self._source.fault(tuple(path), message)

    def with_set(self, changes: Mapping[str, Any]) -> Self:
        """A copy with some values changed, checked anew: {"tasks.press.kp": 0.2}."""
        tree = self.model_dump(by_alias=True, exclude_unset=True)
        wrong: list[Message] = []
        for key, value in changes.items():
            try:
                tree, _ = put(tree, tuple(key.split(".")), value, _SECTIONS)
            except NoSuchKey as missing:
                wrong.append((missing.path, missing.message))
        if wrong:
            raise self._source.error(wrong)
        return self._from(Source(self.file, tree, self._source.marks, self._source.origins))

    @classmethod
    def model_validate(cls, obj: Any, **options: Any) -> Self:
        """A spec from a mapping; raises SpecError with every fault."""
        return obj if isinstance(obj, cls) else cls._from(Source(tree=obj))

    @classmethod
    def _from(cls, source: Source) -> Self:
        spec, wrong = cls._tried(source.tree)
        if spec is None or source.found:
            raise source.error(wrong)
        spec._source = source
        return spec

    @classmethod
    def _tried(cls, tree: Any, whole: Any = None) -> tuple[Self | None, list[Message]]:
        """The spec or its faults. Entries with faults are then left out, to find what is wrong between the others."""
        try:
            return super().model_validate(tree, context=whole), []
        except ValidationError as error:
            wrong = _messages(error)
        if not isinstance(tree, Mapping) or not all(isinstance(key, str) for key in tree):
            return None, wrong
        sound: dict[str, Any] = {"robot": "any", **tree}
        for path, _ in wrong:
            section = sound.get(str(path[0])) if path else None
            if len(path) > 1 and path[0] in _BY_NAME and isinstance(section, Mapping):
                sound[str(path[0])] = {name: entry for name, entry in section.items() if name != path[1]}
            elif path:
                sound.pop(str(path[0]), None)
        try:
            super().model_validate({"robot": "any"} | sound, context=whole or tree)
        except ValidationError as error:
            wrong += _messages(error)
        return None, wrong

    @model_validator(mode="after")
    def _agrees(self, info: ValidationInfo) -> Self:
        """What holds between the entries. `info.context` is the whole tree when entries with faults were left out."""
        whole = info.context if isinstance(info.context, Mapping) else {}
        names = {}
        for section in _BY_NAME:
            given = whole.get(section)
            names[section] = [*getattr(self, section), *(given if isinstance(given, Mapping) else ())]
        faults = chain(self._contact_faults(names["references"]), self._task_faults(names), self._phase_faults(whole))
        wrong = list(islice(faults, MAX_FAULTS + 1))
        if wrong:
            raise _faulty("Spec", wrong)
        return self

    def _contact_faults(self, references: list[str]) -> Iterator[Message]:
        for name, contact in self.contacts.items():
            column: KeyPath = ("contacts", name, "artificial")
            for axis, target in contact.targets.items():
                if isinstance(target, str) and target not in references:
                    under = ("wrench",) if axis in WRENCH_AXES and contact.natural is None else ()
                    yield (*column, *under, axis), _lost("reference", target, references)

    def _task_faults(self, names: Mapping[str, list[str]]) -> Iterator[Message]:
        forced: dict[str, str] = {}
        for name, task in self.tasks.items():
            path: KeyPath = ("tasks", name)
            if isinstance(task, PostureTask):
                continue
            if isinstance(task, MotionTask) and task.target and task.target not in names["references"]:
                yield (*path, "target"), _lost("reference", task.target, names["references"])
            axes: tuple[str, ...] | None = None
            if isinstance(task, MotionTask) and task.axes != "all":
                axes = task.axes
            if task.contact is not None:
                if task.contact not in names["contacts"]:
                    yield (*path, "contact"), _lost("contact", task.contact, names["contacts"])
                if (contact := self.contacts.get(task.contact)) is None:
                    continue
                axes = contact.gain_names(task.type)
                if not (contact.wrench_targets if task.type == "force" else contact.motion_targets):
                    yield (*path, "contact"), f"contact {task.contact!r} has no {task.type} target in its `artificial`"
            if isinstance(task, ForceTask):
                if first := forced.get(task.contact):
                    yield (*path, "contact"), f"contact {task.contact!r} already has the force task {first!r}"
                forced.setdefault(task.contact, name)
            yield from ((path + key, message) for key, message in _gain_faults(task, axes))

    def _phase_faults(self, whole: Mapping[str, Any]) -> Iterator[Message]:
        tree = self.model_dump(by_alias=True, exclude_unset=True, exclude={"phases", "expect"})
        before = Spec._tried(tree, whole)[1] if any(phase.set for phase in self.phases.values()) else []
        for name, phase in self.phases.items():
            path: KeyPath = ("phases", name)
            if phase.until is None and name != list(self.phases)[-1]:
                yield (*path, "until"), "is missing; only the last phase may go on without an end"
            changed, places = tree, {}
            for key, value in phase.set.items():
                parts: KeyPath = tuple(key.split("."))
                try:
                    if parts[0] not in _IN_PHASES:
                        raise NoSuchKey(parts, f"a phase can change {', '.join(_IN_PHASES)} only")
                    changed, place = put(changed, parts, value, _SECTIONS)
                    places[place] = key
                except NoSuchKey as missing:
                    if not _reaches(whole, parts[:2]) or _reaches(tree, parts[:2]):
                        yield (*path, "set", key), f"{dotted(missing.path)}: {missing.message}"
            if places:
                for at, message in (fault for fault in Spec._tried(changed, whole)[1] if fault not in before):
                    key = next((key for place, key in places.items() if at[: len(place)] == place), "")
                    tail = "" if tuple(key.split(".")) == at else f"{dotted(at)}: "
                    yield (*path, "set", *([key] if key else [])), tail + message


def _lost(kind: str, name: str, known: Sequence[str]) -> str:
    return f"no {kind} named {_shown(name)}{did_you_mean(name, known[:MAX_ENTRIES])}"


def _reaches(tree: Any, path: KeyPath) -> bool:
    for part in path:
        if not isinstance(tree, Mapping) or part not in tree:
            return False
        tree = tree[part]
    return True


def _gain_faults(task: ForceTask | MotionTask, axes: Sequence[str] | None) -> Iterator[Message]:
    """Gains of the wrong length, where the spec alone tells the right one."""
    for key in ("kp", "ki", "damping") if isinstance(task, ForceTask) else ("kp", "kd"):
        gain = getattr(task, key)
        if axes is not None and isinstance(gain, tuple) and len(gain) != len(axes):
            expected = "numbers" if isinstance(gain[0], float) else "rows"
            yield (key,), f"expected {len(axes)} {expected} ({', '.join(axes)}), got {len(gain)}"


def _messages(error: ValidationError) -> list[Message]:
    return [(each["loc"], each["msg"]) for each in error.errors(include_url=False)]


def load(
    file: str | Path, overrides: Mapping[str, str] | Sequence[str] = (), types: Mapping[str, type] | None = None
) -> Spec:
    """Read a spec: a path, or the bare name of a shipped one. Raises SpecError with every fault at once.

    `overrides` are `key.path=value` texts, as of `--set`, or a mapping from key path to value text. They are applied
    before anything is checked. `types` is the seam for task and contact classes of one's own; it is not open yet.
    """
    if types:
        raise NotImplementedError("task and contact types of one's own cannot be used in YAML yet")
    found = find_file("tasks", str(file), ".yaml")
    if found is None:
        near = did_you_mean(str(file), shipped_names("tasks", ".yaml"))
        raise SpecError(
            [Fault(printable(str(file), 200), 0, 0, "", f"no such file, and no shipped spec of that name{near}")]
        )
    try:
        with found.open("rb") as stream:
            data = stream.read(MAX_BYTES + 1)
    except OSError as error:
        raise SpecError([Fault(str(found), 0, 0, "", f"cannot be read: {error.strerror}")]) from None
    source = parse(data, str(found))
    pairs = [f"{key}={value}" for key, value in overrides.items()] if isinstance(overrides, Mapping) else overrides
    for text in pairs:
        source = source.override(text, _SECTIONS)
    return Spec._from(source)


class _Schema(GenerateJsonSchema):
    """Unions by shape overlap, so "any of" is what holds for them."""

    def tagged_union_schema(self, schema: core_schema.TaggedUnionSchema) -> JsonSchemaValue:
        return {"anyOf" if key == "oneOf" else key: value for key, value in super().tagged_union_schema(schema).items()}

    def dict_schema(self, schema: core_schema.DictSchema) -> JsonSchemaValue:
        made = super().dict_schema(schema)
        return made | {"additionalProperties": False} if "patternProperties" in made else made


def json_schema() -> dict[str, Any]:
    """The JSON schema of a spec, draft 2020-12, for editors; shipped as tasks/schema.json."""
    dialect = {"$schema": "https://json-schema.org/draft/2020-12/schema"}
    return dialect | Spec.model_json_schema(schema_generator=_Schema)
