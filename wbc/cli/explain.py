"""`wbc explain`: one tick, of a log or of a run."""

from __future__ import annotations

import math
import sys
from pathlib import Path

import click
from click.core import ParameterSource

from ..errors import WbcError
from .options import HIERARCHY, JSON, SEED, SET, SOLVER, load
from .output import emit, progress_bar, refusing, terminal


@click.command()
@click.argument("what", metavar="SPEC|LOG")
@click.option("--at", type=float, metavar="T", help="Which tick, by its time [s].")
@click.option("--tick", type=click.IntRange(min=0), metavar="K", help="Which tick, from 0.")
@SEED
@SOLVER
@HIERARCHY
@SET
@JSON
def explain(
    what: str,
    at: float | None,
    tick: int | None,
    seed: int,
    solver: str | None,
    hierarchy: str | None,
    overrides: tuple[str, ...],
    as_json: bool,
) -> None:
    """Explain one tick, of LOG (a log.npz, or its folder) or a run of SPEC: what conflicts, or what made the torque."""
    if (at is None) == (tick is None):
        raise click.UsageError("expected one of --at and --tick, to name a tick")
    given = click.get_current_context().get_parameter_source("seed") is not ParameterSource.DEFAULT
    with refusing(what, as_json):
        from ..arrive import is_log, logged, simulated
        from ..explained import tell
        from ..explanation import explain as examine

        if at is not None and not 0.0 <= at < math.inf:
            raise WbcError(f"--at {at:g}: expected a time of 0 or more [s]")
        if is_log(what):
            if given:
                raise WbcError("--seed is of a run; the log has its own")
            changes = (*overrides, *([f"hierarchy={hierarchy}"] if hierarchy else []))
            controller, about = logged(what, tick, at, solver, changes)
        else:
            loaded = load(what, overrides, solver, None, hierarchy)
            end = at + 1.0 / loaded.rate if at is not None else ((tick or 0) + 1) / loaded.rate
            loaded = load(what, overrides, solver, end, hierarchy)
            with progress_bar("run to the tick", round(loaded.duration * loaded.rate)) as progress:
                controller = simulated(loaded, seed, progress)
            about = {"spec": Path(loaded.file).stem, "notes": []}
        told = examine(controller)
    for note in about["notes"]:
        click.echo(f"note: {note}", err=True)
    emit(about | told.as_json(), as_json, lambda: tell(told, terminal()))
    sys.exit(0)
