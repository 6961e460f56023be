"""The whole spec: its sections, where each key stands in the file, and every fault at once."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from os.path import exists
from pathlib import Path
from typing import Annotated, Any, Literal, Self

from pydantic import Field, PrivateAttr, Strict, ValidationError, ValidationInfo, model_validator
from pydantic.json_schema import GenerateJsonSchema, JsonSchemaValue
from pydantic_core import core_schema

from ..errors import Fault, SpecError, did_you_mean
from ..resources import find_file, shipped_names
from .agreement import SECTIONS, LeftOut, disagreements, with_sound
from .contact import Contact
from .fields import Model, Name, Number, Pose, Positive, Text, faulty
from .limit import Expect, Limits, Plant
from .phase import Phase
from .reference import Reference
from .source import MAX_BYTES, KeyPath, Message, NoSuchKey, Source, parse, printable, put
from .task import Task

MAX_ENTRIES = 200
Law = Literal["compensated", "book"]
Base = Literal["fixed", "floating"]
Gravity = Literal["controller", "robot"]
Hierarchy = Literal["weighted", "strict"]
_BY_NAME = (("references",), ("contacts",), ("tasks",), ("phases",))


class Spec(Model):
    """What a robot should do, and how well."""

    title: str = Field(default="", description="what is shown above the pictures")
    robot: Text = Field(description="the name of a shipped robot, a path, or erd:NAME")
    base: Base | None = Field(
        default=None, description="how a URDF stands in the world; else floating where its SRDF has a root_joint"
    )
    tool: Text | None = Field(default=None, description="the name of a shipped tool, or a path")
    scene: Text | None = Field(default=None, description="the name of a shipped scene, or a path")
    rate: Number = Field(default=1000.0, ge=1, le=10_000, description="control rate [Hz]")
    duration: Positive = Field(default=5.0, le=3600, description="duration of a run [s]")
    law: Law = Field(default="compensated", description="compensated, or the book's law to the letter")
    hierarchy: Hierarchy = Field(
        default="weighted", description="strict levels of tasks, or weights alone: each level a thousandth of the last"
    )
    gravity: Gravity = Field(default="controller", description="who adds the torque against gravity")
    start: Pose | None = Field(default=None, description="keyframe or joint positions to start from [rad]; else home")
    brakes: Annotated[bool, Strict()] = Field(
        default=False, description="the robot has brakes that hold it: once stopped, its motors let go"
    )
    tare: Annotated[bool, Strict()] = Field(
        default=False, description="what the wrist sensor reads at the start counts as nothing"
    )
    solver: Text = Field(default="daqp", description="the name of the QP solver")
    references: dict[Name, Reference] = Field(default={}, max_length=MAX_ENTRIES, description="desired motions by name")
    contacts: dict[Name, Contact] = Field(default={}, max_length=MAX_ENTRIES, description="contacts by name")
    tasks: dict[Name, Task] = Field(default={}, max_length=MAX_ENTRIES, description="tasks by name")
    limits: Limits = Field(default_factory=Limits, description="hard limits")
    phases: dict[Name, Phase] = Field(default={}, max_length=50, description="phases by name, in this order")
    plant: Plant = Field(default_factory=Plant, description="what only the simulator knows")
    expect: Expect = Field(default_factory=Expect, description="bounds that a run must hold")

    _source: Source = PrivateAttr(default_factory=Source)

    @property
    def file(self) -> str:
        """The name of the file as messages show it."""
        return self._source.file

    def set_by_hand(self, key: str) -> bool:
        """Whether the value of `key` was not read in the file: a `--set` brought it."""
        return self.fault((key,), "").file != self.file

    @property
    def allow_outside(self) -> bool:
        """Whether the models may draw in files from anywhere."""
        return self._source.allow_outside

    def where(self, *path: str | int) -> tuple[int, int]:
        """Line and column of the nearest enclosing key that is in the file, from 1; (0, 0) without a file."""
        fault = self.fault(path, "")
        return fault.line, fault.column

    def fault(self, path: Sequence[str | int], message: str) -> Fault:
        """A fault for later stages to report, at its place in the file or at the `--set` that brought it."""
        return self._source.fault(tuple(path), message)

    def with_set(self, changes: Mapping[str, Any]) -> Self:
        """A copy with some values changed, checked anew: {"tasks.press.kp": 0.2}."""
        tree: Any = self.model_dump(by_alias=True, exclude_unset=True)
        wrong: list[Message] = []
        places: list[KeyPath] = []
        for key, value in changes.items():
            try:
                tree, place = put(tree, tuple(key.split(".")), value, SECTIONS)
                places.append(place)
            except NoSuchKey as missing:
                wrong.append((missing.path, missing.message))
        if wrong:
            raise self._source.error(wrong)
        return self.from_source(replace(self._source, tree=with_sound(self, tree, places)))

    @classmethod
    def model_validate(cls, obj: Any, **options: Any) -> Self:
        """A spec from a mapping; raises SpecError with every fault."""
        return obj if isinstance(obj, cls) else cls.from_source(Source(tree=obj))

    @classmethod
    def from_source(cls, source: Source) -> Self:
        """A spec from what was read; raises SpecError with every fault, those of the reading too."""
        spec, wrong = cls._tried(source.tree)
        if spec is None or source.found:
            raise source.error(wrong)
        spec._source = source
        return spec

    @classmethod
    def _tried(cls, tree: Any, left_out: LeftOut = frozenset()) -> tuple[Self | None, list[Message]]:
        """The spec or its faults. What has faults is then left out, to find what is wrong between the other entries."""
        try:
            return super().model_validate(tree, context=left_out), []
        except ValidationError as error:
            wrong = _messages(error)
        if not isinstance(tree, Mapping):
            return None, wrong
        bad = {path[: 2 if path[:1] in _BY_NAME else 1] for path, _ in wrong}
        sound = {"robot": "any"} | {key: value for key, value in tree.items() if (key,) not in bad}
        for (section,) in _BY_NAME:
            if isinstance(entries := sound.get(section), Mapping):
                sound[section] = {name: entry for name, entry in entries.items() if (section, name) not in bad}
        try:
            super().model_validate(sound, context=left_out | bad)
        except ValidationError as error:
            wrong += _messages(error)
        return None, wrong

    @model_validator(mode="after")
    def _agrees(self, info: ValidationInfo) -> Self:
        """The entries agree; the context tells what was left out."""
        if wrong := disagreements(self, info.context or frozenset(), lambda *changed: self._tried(*changed)[1]):
            raise faulty("Spec", wrong)
        return self


def _messages(error: ValidationError) -> list[Message]:
    return [(each["loc"], each["msg"]) for each in error.errors(include_url=False)]


def load(file: str | Path, overrides: Mapping[str, str] | Sequence[str] = (), allow_outside: bool = False) -> Spec:
    """Read a spec: a path, or the bare name of a shipped one. Raises SpecError with every fault at once.

    `overrides` are `key.path=value` texts, as of `--set`, or a mapping from key path to value text. They are applied
    before anything is checked. `allow_outside`: the models may be, and draw in, files outside of the spec's folder.
    """
    source = replace(_read(str(file)), allow_outside=allow_outside)
    pairs = [f"{key}={value}" for key, value in overrides.items()] if isinstance(overrides, Mapping) else overrides
    for text in pairs:
        source = source.override(text, SECTIONS)
    return Spec.from_source(source)


def _read(name: str) -> Source:
    found = find_file("tasks", name, ".yaml")
    if found is None:
        near = did_you_mean(name, shipped_names("tasks", ".yaml"))
        lost = "is not a regular file" if exists(name) else f"no such file, and no shipped spec of that name{near}"
        raise SpecError([Fault(printable(name, 200), 0, 0, "", lost)])
    shows = found.suffix in (".yaml", ".yml")  # of another file, which may be no spec at all, messages quote nothing
    try:
        with found.open("rb") as stream:
            source = parse(stream.read(MAX_BYTES + 1), str(found))
        if source.tree is None:
            empty = "the file is empty; a spec needs at least the line `robot: NAME`"
            raise SpecError([Fault(str(found), 1, 1, "", empty)])
        if shows or isinstance(source.whole().tree, dict):
            return source
    except OSError as error:
        raise SpecError([Fault(str(found), 0, 0, "", f"cannot be read: {error.strerror}")]) from None
    except SpecError:
        if shows:
            raise
    why = "not readable as a YAML mapping; name the file .yaml or .yml to see where"
    raise SpecError([Fault(str(found), 0, 0, "", why)])


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
