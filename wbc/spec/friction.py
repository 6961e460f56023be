"""Where the world only lets itself be pushed, and the friction there."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, Strict, Tag

from .fields import Model, NonNegative, Positive, either

Side = Literal["x", "y", "z", "+x", "+y", "+z", "-x", "-y", "-z"]


class Unilateral(Model):
    """The direction in which the world only lets itself be pushed."""

    along: Side = Field(
        description="direction of the push on the world, in the axes of A (z: a surface's normal): -z, ..."
    )
    least: NonNegative = Field(default=0.0, description="smallest push [N]")


class Friction(Model):
    """Coulomb friction across the push."""

    mu: Positive = Field(description="friction coefficient [1]")
    faces: Annotated[int, Strict()] = Field(
        default=8, ge=3, le=64, description="faces of the inner cone; 4 lose up to 29 % of the friction, 8 up to 7.6 %"
    )
    slip: Positive = Field(
        default=0.005, description="speed below which the drag follows the desired velocity instead of the own [m/s]"
    )


Pushes = Annotated[
    Annotated[Side, Tag("<name>")] | Annotated[Unilateral, Tag("<map>")], either("a direction such as -z")
]
Coefficient = Annotated[
    Annotated[Positive, Tag("<number>")] | Annotated[Friction, Tag("<map>")],
    either("a friction coefficient or a mapping with mu"),
]
