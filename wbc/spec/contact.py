"""How the world, or another body, holds a frame: the book's table (11.6), free screws, held axes, or a matrix."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from typing import Annotated, Any, ClassVar, Literal

from pydantic import AfterValidator, Field, Tag

from ..axes import RECIPROCAL, VELOCITY_AXES, WRENCH_AXES
from ..errors import did_you_mean
from .fields import (
    AName,
    ANumber,
    Axes,
    Axis,
    Model,
    Name,
    NonNegative,
    Number,
    OneOf,
    Positive,
    Target,
    Text,
    WrenchAxis,
    either,
    named,
    shown,
    wrong,
)
from .friction import Coefficient, Friction, Pushes, Unilateral
from .screw import FreeMotion
from .source import Message

NORMAL = ("normal",)  # the multiplier of a surface: the force [N] along its outward normal


class Sphere(Model):
    """A sphere around a frame of the scene."""

    radius: Positive = Field(description="distance that the contact frame keeps from the centre [m]")


class Surface(OneOf):
    """A curved surface that the frame slides on: exactly one kind."""

    kinds: ClassVar = ("sphere",)

    sphere: Sphere | None = Field(default=None, description="a sphere; its centre is the frame that is closed against")


def _zero(value: float) -> float:
    if value != 0:
        raise wrong(f"expected 0, as A V = 0 and no wrench acts along what is free, got {value:g}")
    return value


Zero = Annotated[Number, AfterValidator(_zero)]
Row = Annotated[tuple[Number, ...], Field(min_length=6, max_length=6), named(", ".join(VELOCITY_AXES))]
Sole = Annotated[tuple[Positive, Positive], named("length, width")]
Wrench = Annotated[dict[WrenchAxis, Target], Tag("<map>")]
Artificial = Annotated[ANumber | AName | Wrench, either("a number or the name of a reference")]


class Contact(OneOf):
    """How the world holds a frame of the robot, by exactly one of natural, free, holds, A and surface."""

    kinds: ClassVar = ("natural", "free", "holds", "A", "surface")

    frame: Text = Field(description="the name of the frame of the robot or tool that is held")
    with_: Text | None = Field(
        default=None, alias="with", description="frame of another body that holds it, instead of the world"
    )
    on: Text | None = Field(
        default=None,
        description="frame of the scene, or on the body of `with`, that it closes against; else the contact's name",
    )
    in_: Literal["frame", "on"] = Field(default="frame", alias="in", description="whose axes A is expressed in")
    natural: dict[Axis, Zero] | None = Field(
        default=None, description="velocities [rad/s, m/s] and wrenches [N m, N] that the contact keeps at 0"
    )
    free: dict[Name, FreeMotion] | None = Field(default=None, description="free screws, of which A is the annihilator")
    holds: Axes | None = Field(default=None, description="velocity axes that are held, or all")
    A: tuple[Row, ...] | None = Field(default=None, max_length=6, description="rows of A V = 0, angular part first")
    surface: Surface | None = Field(
        default=None, description="a curved surface that holds the frame along its outward normal"
    )
    pushes: Pushes | None = Field(
        default=None, description="direction in which the world only pushes back: -z, +x, ..."
    )
    friction: Coefficient | None = Field(default=None, description="Coulomb friction across the push [1]")
    sole: Sole | None = Field(
        default=None, description="length along x and width along y of a flat sole, its middle the frame [m]"
    )
    edge: Positive | None = Field(
        default=None,
        description="length of a straight edge, its middle the frame, along x or y: that about which it turns [m]",
    )
    radius: Positive | None = Field(
        default=None, description="of a round foot or edge that rolls, its centre the frame; else a point or line [m]"
    )
    ground: Text | None = Field(
        default=None,
        description="frame of the scene on whose plane z = 0 it stands, wherever the start has it; floor, where there "
        "is one, for what pushes on a robot with a floating base",
    )
    rides: Name | None = Field(default=None, description="the reference by which its ground moves from where it is")
    settling: NonNegative | None = Field(
        default=None, description="damping of motion against it; 20 on a robot with a floating base, else 0 [1/s]"
    )
    feedforward: Literal["none", "measured", "modelled"] = Field(
        default="none",
        description="along the free axes: nothing, the measured wrench, or the friction of sliding in the model",
    )
    artificial: dict[str, Artificial] = Field(
        default={}, description="targets: velocities [rad/s, m/s], wrenches on the environment [N m, N], or references"
    )

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
        held = self.constrained
        return tuple(self.free or ()) or tuple(axis for axis in VELOCITY_AXES if self.holds and axis not in held)

    @property
    def force_axes(self) -> tuple[str, ...]:
        """Wrench axes of the constrained velocities."""
        return tuple(RECIPROCAL[axis] for axis in self.constrained)

    @property
    def wrench_targets(self) -> dict[str, float | str]:
        """Desired wrench on the environment by wrench axis [N m, N], in canonical order."""
        table = self.natural is not None or self.surface is not None
        column = self.artificial if table else self.artificial.get("wrench")
        given: Mapping[Any, Any] = column if isinstance(column, dict) else {}
        axes = NORMAL if self.surface is not None else WRENCH_AXES
        return {axis: given[axis] for axis in axes if not isinstance(given.get(axis, {}), dict)}

    @property
    def motion_targets(self) -> dict[str, float | str]:
        """Desired motion by free velocity axis or screw [rad/s, m/s, or a reference]."""
        order = dict.fromkeys([*self.free_axes, *self.artificial])
        given = {name: self.artificial.get(name, {}) for name in order if name not in WRENCH_AXES + NORMAL}
        return {name: value for name, value in given.items() if not isinstance(value, dict)}

    @property
    def targets(self) -> dict[str, float | str]:
        return self.motion_targets | self.wrench_targets

    def gain_names(self, task: str) -> tuple[str, ...] | None:
        """What the entries of a gain of a force or motion task stand for; None where only the robot can tell."""
        if self.surface is not None:
            return NORMAL if task == "force" else None
        if task == "force":
            rows = tuple(f"row {i}" for i in range(len(self.A or ())))
            return rows or (self.force_axes if self.holds != "all" and self.free is None else None)
        return self.free_axes if self.natural is not None or self.free is not None else None

    @property
    def along(self) -> int:
        """Number of the axis of the frame that its edge lies along: 0 or 1."""
        return 1 if "wx" in self.constrained else 0

    @property
    def push(self) -> Unilateral | None:
        """`pushes` in full."""
        return Unilateral(along=self.pushes) if isinstance(self.pushes, str) else self.pushes

    @property
    def coulomb(self) -> Friction | None:
        """`friction` in full."""
        return self.friction if isinstance(self.friction, Friction | None) else Friction(mu=self.friction)

    def _faults(self) -> Iterable[Message]:
        rules = {"natural": self._table, "surface": self._of_surface}
        return list(super()._faults()) or list(rules.get(self.kind, self._entries)()) or self._across()

    def _across(self) -> Iterator[Message]:
        """The push and its friction, beside what the contact holds."""
        if self.push is None:
            if self.friction is not None:
                yield ("friction",), "needs the direction of the push; expected `pushes: -z` beside it, or another side"
        else:
            side = self.push.along
            axis, force = f"v{side[-1]}", f"f{side[-1]}"
            path = ("pushes",) if isinstance(self.pushes, str) else ("pushes", "along")
            held = ", ".join(f"-{name[-1]}" for name in self.constrained if name.startswith("v"))
            if self.constrained and axis not in self.constrained:
                yield path, f"{axis} is free, so nothing is pushed along {side}; expected a side that is held: {held}"
            target = self.wrench_targets.get(force)
            pushed = -1 if side.startswith("-") else 1
            if isinstance(target, float) and pushed * target < self.push.least:
                under = () if self.natural is not None else ("wrench",)
                bound = f"at {'most' if pushed < 0 else 'least'} {pushed * self.push.least:g}"
                message = f"{target:g} N is less than the least push along {side}; expected {bound}"
                yield ("artificial", *under, force), message
        if self.rides is not None and self.motion_targets:
            message = (
                "its ground moves, and a motion drawn on it does not follow; expected no target of motion beside it"
            )
            yield ("rides",), message
        yield from self._standing()
        if self.with_ == self.frame:
            yield ("with",), f"{self.frame!r} is the frame itself; expected one of another body"
        if self.with_ is not None and self.ground is not None:
            yield ("ground",), "a body holds it, not the ground; expected either `with` or `ground`"
        if self.feedforward == "modelled" and self.friction is None:
            yield ("feedforward",), "modelled friction needs its coefficient; expected `friction: MU` beside it"
        elif self.feedforward == "modelled" and {"vx", "vy", "vz"} <= set(self.constrained):
            message = "nothing slides, for vx, vy and vz are held; expected none or measured"
            yield ("feedforward",), f"modelled friction is that of sliding, but {message}"

    def _standing(self) -> Iterator[Message]:
        """Soles hold all, edges all but a turn, with friction of four faces; round feet hold a point."""
        for key in ("sole", "edge", "radius", "ground"):
            if getattr(self, key) is not None and self.push is None:
                yield (key,), "it only pushes; expected `pushes: -z` beside it"
        if self.ground is not None and self.on is not None:
            yield ("ground",), "it closes on one frame of the scene; expected either `on` or `ground`"
        if self.radius is not None and self.sole is not None:
            yield ("radius",), "a sole is flat; expected either `sole` or `radius`"
        if self.edge is not None:
            yield from self._on_edge()
            return
        if self.radius is not None and (self.kind != "holds" or set(self.constrained) != {"vx", "vy", "vz"}):
            yield ("radius",), "a round foot holds a point; expected `holds: [vx, vy, vz]`"
        if self.radius is not None and self.push is not None and self.push.along != "-z":
            yield (
                ("radius",),
                f"a round foot pushes along -z of its plane; expected `pushes: -z`, got {self.push.along}",
            )
        if self.sole is None:
            return
        if self.holds != "all":
            yield ("sole",), "a sole holds every axis; expected `holds: all`"
        if self.push is not None and self.push.along[-1] != "z":
            yield ("sole",), f"a sole pushes along z; expected `pushes: -z`, got {self.push.along}"
        yield from self._four_faces("sole", "a sole", "corners")

    def _on_edge(self) -> Iterator[Message]:
        """An edge holds all but the turn about itself, along x or y of its frame."""
        if self.sole is not None:
            yield ("edge",), "a sole has edges of its own; expected either `sole` or `edge`"
        held = ("wx", "wz", "vx", "vy", "vz"), ("wy", "wz", "vx", "vy", "vz")
        if self.kind != "holds" or self.constrained not in held:
            yield ("edge",), f"an edge along y turns about it; expected `holds: [{', '.join(held[0])}]`, or wy along x"
        if self.push is not None and self.push.along != "-z":
            yield ("edge",), f"an edge pushes along -z of its plane; expected `pushes: -z`, got {self.push.along}"
        yield from self._four_faces("edge", "an edge", "ends")

    def _four_faces(self, key: str, what: str, ends: str) -> Iterator[Message]:
        if self.friction is None:
            yield (key,), f"{what} needs its friction; expected `friction: MU` beside it"
        given = self.friction if isinstance(self.friction, Friction) else None
        if given is not None and given.faces != 4 and "faces" in given.model_fields_set:
            yield ("friction", "faces"), f"the {ends} of {what} have 4 faces each; expected 4, got {given.faces}"

    def _of_surface(self) -> Iterator[Message]:
        """A surface holds the frame along its normal, and leaves one motion on it."""
        for name, value in self.artificial.items():
            if name not in (*NORMAL, "motion"):
                yield ("artificial", name), f"unknown target{did_you_mean(name, (*NORMAL, 'motion'))}"
            elif isinstance(value, dict):
                yield ("artificial", name), "expected a number or the name of a reference, got a mapping"
            elif name == "motion" and not isinstance(value, str):
                yield ("artificial", name), f"expected the name of a reference, got {shown(value)}"

    def _table(self) -> Iterator[Message]:
        """Of every pair that the table names: one natural and one artificial entry, reciprocal (book 11.6)."""
        natural, artificial = self.natural or {}, self.artificial
        for name in artificial:
            if name not in RECIPROCAL:
                yield ("artificial", name), f"unknown axis{did_you_mean(name, RECIPROCAL)}"
            elif isinstance(artificial[name], dict):
                yield ("artificial", name), "expected a number or the name of a reference, got a mapping"
        for pair in zip(VELOCITY_AXES, WRENCH_AXES, strict=True):
            rule = f"of {pair[0]} and {pair[1]} one is natural and the other artificial"
            left, right = ([axis for axis in column if axis in pair] for column in (natural, artificial))
            if len(left) == 2:
                yield ("natural", left[1]), f"{left[0]} and {left[1]} are both natural; {rule}"
            elif len(right) == 2:
                yield ("artificial", right[1]), f"{right[0]} and {right[1]} are both artificial; {rule}"
            elif left and left == right:
                yield ("artificial", right[0]), f"{left[0]} is both natural and artificial; {rule}"
            elif len(left) != len(right):
                here, there = ("natural", "artificial") if left else ("artificial", "natural")
                axis, lost = (left or right)[0], RECIPROCAL[(left or right)[0]]
                yield (there, lost), f"{lost} is missing; {here} {axis} needs its {there} entry"

    def _entries(self) -> Iterator[Message]:
        """Targets of `free`, `holds` and `A`: free motions by name, forces under `wrench`."""
        names = self.free_axes if self.A is None else VELOCITY_AXES
        for name, value in self.artificial.items():
            if name == "wrench" and not isinstance(value, dict):
                yield ("artificial", name), f"expected a mapping from wrench axes to targets, got {shown(value)}"
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
