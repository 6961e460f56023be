"""`wbc campaign`: everything goes wrong, and every tick is held against what must always hold."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import click

from .options import HIERARCHY, JSON, SET, SOLVER, load
from .output import emit, plain, progress_bar, refusing, terminal, writable


@click.command()
@click.argument("specs", nargs=-1)
@click.option("--seeds", type=click.IntRange(min=1), default=100, show_default=True, help="How many seeds.")
@click.option("--first", type=click.IntRange(min=0), default=0, show_default=True, help="The first of them.")
@click.option("--seed", type=click.IntRange(min=0), help="Only this one.")
@click.option("--jobs", type=click.IntRange(min=1), default=1, show_default=True, help="How many processes.")
@click.option("--out", type=click.Path(path_type=Path), metavar="DIR", help="Write campaign.json there.")
@SOLVER
@HIERARCHY
@SET
@JSON
def campaign(
    specs: tuple[str, ...],
    seeds: int,
    first: int,
    seed: int | None,
    jobs: int,
    out: Path | None,
    solver: str | None,
    hierarchy: str | None,
    overrides: tuple[str, ...],
    as_json: bool,
) -> None:
    """Let everything go wrong on SPECS (some of the shipped ones when left out), and hold every tick against what must
    always hold."""
    chosen = range(first, first + seeds) if seed is None else range(seed, seed + 1)
    with refusing(specs[0] if specs else "the campaign", as_json):
        from .. import campaign as campaigns

        cases = campaigns.cases(specs, overrides, solver, hierarchy)
        for case in cases:
            load(case.spec, case.changes)
        folder = writable(out) if out is not None else None
        with progress_bar("campaign", len(chosen)) as progress:
            result = campaigns.campaign(cases, chosen, jobs, progress)
        if folder is not None:
            (folder / "campaign.json").write_text(json.dumps(plain(result), allow_nan=False, indent=1) + "\n")
    emit(result, as_json, lambda: terminal().print(campaigns.table(result)))
    sys.exit(0 if result["ok"] else 1)
