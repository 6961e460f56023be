"""`wbc replay`: the ticks of a log, solved again."""

from __future__ import annotations

import sys
from typing import NoReturn

import click

from .options import JSON, SET, SOLVER
from .output import emit, progress_bar, refusing, terminal


@click.command()
@click.argument("log", required=False)
@click.option("--tick", type=click.IntRange(min=0), metavar="K", help="Only this tick, from 0.")
@click.option("--at", type=float, metavar="T", help="Only the tick at this time [s].")
@click.option("--bisect", nargs=2, metavar="A B", help="Find the first tick at which two logs part, and in what.")
@SOLVER
@SET
@JSON
def replay(
    log: str | None,
    tick: int | None,
    at: float | None,
    bisect: tuple[str, str] | None,
    solver: str | None,
    overrides: tuple[str, ...],
    as_json: bool,
) -> None:
    """Solve the ticks of LOG (a log.npz, or its folder) again: bit for bit, or with another solver, weight or limit."""
    if (log is None) == (bisect is None):
        raise click.UsageError("expected one LOG, or --bisect with two")
    if bisect is not None:
        if tick is not None or at is not None or solver is not None or overrides:
            raise click.UsageError("--bisect compares two logs as they are: expected no other option but --json")
        _bisect(*bisect, as_json)
    if tick is not None and at is not None:
        raise click.UsageError("--tick and --at both name a tick: expected one of them")
    with refusing(str(log), as_json):
        from ..again import again, tell
        from ..replay import Replay

        run = Replay(str(log))
        tick = run.tick_at(at) if at is not None else tick
        with progress_bar(f"replay {log}", len(run) if tick is None else 1) as progress:
            result = again(run, tick, solver, overrides, progress)
    emit(result, as_json, lambda: tell(result, terminal()))
    sys.exit(0 if result["ok"] else 1)


def _bisect(a: str, b: str, as_json: bool) -> NoReturn:
    with refusing(f"{a}, {b}", as_json):
        from .. import part
        from ..replay import Replay

        result = part.found(Replay(a), Replay(b))
    emit(result, as_json, lambda: part.tell(result, terminal()))
    sys.exit(0 if result["ok"] else 1)
