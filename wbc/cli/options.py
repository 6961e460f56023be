"""Options that several commands share, and the spec that they name."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import click

from .output import aside

if TYPE_CHECKING:
    from ..spec import Spec


_OVERRIDES = click.option(
    "--set", "overrides", multiple=True, metavar="KEY.PATH=VALUE", help="Change a value of the spec; may be repeated."
)
_OUTSIDE = "wbc.allow_outside"


def _asked(context: click.Context, _: click.Parameter, given: bool) -> None:
    context.meta[_OUTSIDE] = given


def SET(command: Callable[..., None]) -> Callable[..., None]:
    """What every command has that loads a spec: `--set`, and `--allow-outside`, which `load` asks for."""
    allowed = "Models may be, and may draw in, files outside of the spec's folder."
    outside = click.option("--allow-outside", is_flag=True, expose_value=False, callback=_asked, help=allowed)
    return _OVERRIDES(outside(command))


def _alone(context: click.Context, _: click.Parameter, given: bool) -> bool:
    if given:
        context.with_resource(aside())
    return given


JSON = click.option(
    "--json", "as_json", is_flag=True, callback=_alone, help="One JSON object on stdout, all else on stderr."
)
SOLVER = click.option("--solver", metavar="NAME", help="QP solver: daqp, proxqp, or a backend of qpsolvers.")
HIERARCHY = click.option(
    "--hierarchy",
    type=click.Choice(["weighted", "strict"]),
    help="How levels of tasks count; the spec's when left out.",
)
SEED = click.option("--seed", type=click.IntRange(min=0), default=0, show_default=True, help="Seed of all noise.")


def load(
    spec: str,
    overrides: tuple[str, ...],
    solver: str | None = None,
    duration: float | None = None,
    hierarchy: str | None = None,
) -> Spec:
    """The spec, changed as the options say. Raises SpecError."""
    from ..spec import load as read

    own = {"solver": solver, "duration": None if duration is None else repr(duration), "hierarchy": hierarchy}
    given = (*overrides, *(f"{key}={value}" for key, value in own.items() if value is not None))
    return read(spec, given, click.get_current_context().meta.get(_OUTSIDE, False))
