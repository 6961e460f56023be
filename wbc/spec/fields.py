"""What every entry of a spec is made of: a base class that tells faults in plain words, numbers, names and unions."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping
from itertools import islice
from typing import Annotated, Any, ClassVar, Literal, Self

from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Discriminator,
    Field,
    Strict,
    Tag,
    ValidationError,
    model_validator,
)
from pydantic import ModelWrapValidatorHandler as Handler
from pydantic_core import ErrorDetails, InitErrorDetails, PydanticCustomError

from ..errors import did_you_mean
from .source import MAX_FAULTS, Message, printable

# What was expected, by pydantic's kind of error
_EXPECTED = {
    "float_type": "a number",
    "bool_type": "true or false",
    "int_type": "a whole number",
    "int_from_float": "a whole number",
    "finite_number": "a finite number",
    "greater_than": "a number greater than {gt:g}",
    "greater_than_equal": "a number of at least {ge:g}",
    "less_than": "a number less than {lt:g}",
    "less_than_equal": "a number of at most {le:g}",
    "string_type": "a text",
    "string_too_short": "a text that is not empty",
    "string_pattern_mismatch": "a name of letters, digits and _ that does not begin with a digit",
    "tuple_type": "a list",
    "dict_type": "a mapping",
    "model_type": "a mapping",
    "union_tag_not_found": "a mapping",
    "too_short": "at least {min_length} entries",
    "too_long": "at most {max_length} entries",
}
# Parts of pydantic's paths that are no keys of the file
_TAGS = {"<number>", "<name>", "<list>", "<matrix>", "<map>", "<scale>", "<true>", "[key]"}
_TYPES = (
    "force", "motion", "relative", "gaze", "impedance", "admittance", "com", "momentum", "distribution", "torque",
    "posture",
)  # fmt: skip
_TAGS |= {f"<{each}>" for each in _TYPES}


def shown(value: Any) -> str:
    """What was given, for a message."""
    if isinstance(value, list | tuple):
        return "a list"
    if isinstance(value, Mapping | BaseModel):
        return "a mapping"
    return "nothing" if value is None else printable(str(value) if isinstance(value, float) else repr(value))


def wrong(message: str) -> PydanticCustomError:
    """The one fault of a value that is no entry."""
    return PydanticCustomError("wrong", "{message}", {"message": message})


def faulty(title: str, messages: Iterable[Message]) -> ValidationError:
    """Several faults of one entry at once; inside a validator they join those of the others, with their paths."""
    details: list[InitErrorDetails] = [{"type": wrong(text), "loc": path, "input": None} for path, text in messages]
    return ValidationError.from_exception_data(title, details)


def _spurious(error: ErrorDetails) -> bool:
    """Entries that are wrong do not count as entries; that they are too few then is no fault of its own."""
    return error["type"] == "too_short" and len(error["input"]) >= error["ctx"]["min_length"]


class Model(BaseModel):
    """Frozen, closed, and with messages for people."""

    model_config = ConfigDict(extra="forbid", frozen=True)
    hints: ClassVar[Mapping[str, str]] = {}  # for keys that one might expect here: where they stand instead

    def _faults(self) -> Iterable[Message]:
        """What is wrong between sound fields."""
        return ()

    @model_validator(mode="wrap")
    @classmethod
    def _explain(cls, value: Any, handler: Handler[Self]) -> Self:
        if type(value) is cls:
            return value  # checked when it was made, and frozen since
        try:
            model = handler(value)
        except ValidationError as error:
            details = [each for each in error.errors(include_url=False) if not _spurious(each)][: MAX_FAULTS + 1]
            raise faulty(cls.__name__, map(cls._explained, details)) from None
        if found := list(islice(model._faults(), MAX_FAULTS + 1)):
            raise faulty(cls.__name__, found)
        return model

    @classmethod
    def _explained(cls, error: ErrorDetails) -> Message:
        """The path, in keys of the file, and the message for one error of pydantic."""
        kind, given, bounds, where = error["type"], error["input"], error.get("ctx", {}), error["loc"]
        path = tuple(part for part in where if part not in _TAGS)
        fields = {field.alias or name: field.description or "" for name, field in cls.model_fields.items()}
        described = fields.get(str(path[0]), "") if path else ""
        if kind == "wrong":
            return path, error["msg"]
        if kind == "extra_forbidden":
            key = str(where[-1])
            return where, "unknown key" + (f"; {cls.hints[key]}" if key in cls.hints else did_you_mean(key, fields, 20))
        if kind == "missing":
            return path, f"is missing; expected {described}"
        if kind == "union_tag_invalid":
            named, types = bounds["tag"].strip("<>"), re.findall("<([a-z]+)>", bounds["expected_tags"])
            return (*path, "type"), f"unknown type {shown(named)}{did_you_mean(named, types)}"
        if kind == "union_tag_not_found" and isinstance(given, Mapping):
            return (*path, "type"), f"is missing; expected {', '.join(_TYPES[:-1])} or {_TYPES[-1]}"
        if kind == "literal_error":
            words = re.findall("'([^']*)'", bounds["expected"])
            return path, f"unknown word {shown(given)}{did_you_mean(str(given), words)}"
        expected = _EXPECTED[kind].format(**bounds) if kind in _EXPECTED else error["msg"]
        if kind in ("too_short", "too_long"):
            return path, f"expected {expected}, got {len(given)}"
        unit = "".join(re.findall(r" \[(?!1\])[^]]*\]", described)[:1])
        return path, f"expected {expected}{unit}, got {shown(given)}"


class OneOf(Model):
    """Exactly one of the keys `kinds` is given."""

    kinds: ClassVar[tuple[str, ...]]
    model_config = ConfigDict(
        json_schema_extra=lambda schema, cls: schema.update(oneOf=[{"required": [key]} for key in cls.kinds])
    )

    @property
    def kind(self) -> str:
        return next(key for key in self.kinds if getattr(self, key) is not None)

    def _faults(self) -> Iterable[Message]:
        given = [key for key in self.kinds if getattr(self, key) is not None]
        if len(given) != 1:
            message = f"expected exactly one of {', '.join(self.kinds)}, got {' and '.join(given) or 'none of them'}"
            yield (), message


# --- Values: a union is decided by what the value looks like, so that a fault is told for that member alone -----------


def shape(value: Any) -> str | None:
    """The tag of what a value looks like; None for what no key can take."""
    if isinstance(value, list | tuple):
        return "<matrix>" if value and isinstance(value[0], list | tuple) else "<list>"
    if isinstance(value, Mapping | BaseModel):
        return "<map>"
    if isinstance(value, str):
        return "<name>"
    return "<number>" if isinstance(value, int | float) and not isinstance(value, bool) else None


def either(expected: str, tag: Callable[[Any], str | None] = shape) -> Discriminator:
    return Discriminator(tag, custom_error_type="shape", custom_error_message=expected)


def named(*choices: str) -> BeforeValidator:
    """A list of exactly the numbers that one of these texts names."""
    lengths = {names.count(",") + 1: names for names in choices}

    def check(values: Any) -> Any:
        if isinstance(values, list | tuple) and len(values) not in lengths:
            expected = " or ".join(f"{length} numbers ({names})" for length, names in lengths.items())
            raise wrong(f"expected {expected}, got {len(values)}")
        return values

    return BeforeValidator(check)


def _positive_definite(matrix: tuple[tuple[float, ...], ...]) -> tuple[tuple[float, ...], ...]:
    if any(len(row) != len(matrix) for row in matrix):
        raise wrong(f"expected a square matrix, got rows of {', '.join(str(len(row)) for row in matrix)} numbers")
    largest = max(abs(entry) for row in matrix for entry in row)
    for a, b in ((row[j], matrix[j][i]) for i, row in enumerate(matrix) for j in range(i)):
        if abs(a - b) > 1e-9 * largest:
            raise wrong(f"expected a symmetric matrix, got {a:g} and {b:g} across the diagonal")
    import numpy  # not above: few specs have a matrix

    smallest = numpy.linalg.eigvalsh(matrix)[0]
    if not smallest > 1e-12 * largest:
        raise wrong(f"expected a positive definite matrix, got one whose smallest eigenvalue is {smallest:.3g}")
    return matrix


def _distinct(axes: tuple[str, ...]) -> tuple[str, ...]:
    for i, axis in enumerate(axes):
        if axis in axes[:i]:
            raise wrong(f"{axis} is given twice")
    return axes


Number = Annotated[float, Strict(), Field(allow_inf_nan=False)]
Positive = Annotated[Number, Field(gt=0)]
NonNegative = Annotated[Number, Field(ge=0)]
Text = Annotated[str, Field(min_length=1)]
Name = Annotated[str, Field(pattern=r"^[A-Za-z_][A-Za-z0-9_]*$")]
Vec2 = Annotated[tuple[Number, Number], named("x, y")]
Vec3 = Annotated[tuple[Number, Number, Number], named("x, y, z")]

ANumber = Annotated[Number, Tag("<number>")]
AName = Annotated[Text, Tag("<name>")]
All = Annotated[Literal["all"], Tag("<name>")]
VelocityAxis = Literal["wx", "wy", "wz", "vx", "vy", "vz"]
WrenchAxis = Literal["mx", "my", "mz", "fx", "fy", "fz"]
Axis = Literal[VelocityAxis, WrenchAxis]
AxisList = Annotated[tuple[VelocityAxis, ...], Field(min_length=1), AfterValidator(_distinct), Tag("<list>")]
Axes = Annotated[All | AxisList, either("all or a list of velocity axes")]
MomentumAxis = Literal["kx", "ky", "kz", "lx", "ly", "lz"]
MomentumList = Annotated[tuple[MomentumAxis, ...], Field(min_length=1), AfterValidator(_distinct), Tag("<list>")]
MomentumAxes = Annotated[All | MomentumList, either("all or a list of kx, ky, kz, lx, ly, lz")]
Gain = Annotated[
    Annotated[NonNegative, Tag("<number>")]
    | Annotated[tuple[NonNegative, ...], Field(min_length=1), Tag("<list>")]
    | Annotated[tuple[tuple[Number, ...], ...], AfterValidator(_positive_definite), Tag("<matrix>")],
    either("a number, a list of numbers or a matrix"),
]
Rates = Annotated[
    Annotated[Positive, Tag("<number>")] | Annotated[tuple[Positive, ...], Field(min_length=1), Tag("<list>")],
    either("a number or a list of numbers"),
]
Target = Annotated[ANumber | AName, either("a number or the name of a reference")]
JointValues = Annotated[dict[Text, Number], Field(min_length=1), Tag("<map>")]
Pose = Annotated[AName | JointValues, either("the name of a keyframe or a mapping from joints to angles")]
