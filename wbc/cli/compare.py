"""`wbc compare`: quadratic programs, given to every solver."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

import click

from ..errors import WbcError
from .options import JSON, SET, load
from .output import emit, plain, progress_bar, refusing, terminal, writable


@click.command()
@click.argument("specs", nargs=-1)
@click.option("--solvers", default="all", show_default=True, metavar="A,B|all", help="Which solvers.")
@click.option(
    "--record",
    type=click.Path(path_type=Path),
    metavar="FILE",
    help="Write the programs to FILE and compare nothing; without SPECS those of the corpus, made again.",
)
@click.option(
    "--timeout",
    type=float,
    metavar="SECONDS",
    help="What a solver has for each program, in a process of its own that is ended when it overruns; 5 when left out.",
)
@click.option("--out", type=click.Path(path_type=Path), metavar="DIR", help="Write compare.png, compare.json there.")
@SET
@JSON
def compare(
    specs: tuple[str, ...],
    solvers: str,
    timeout: float | None,
    record: Path | None,
    out: Path | None,
    overrides: tuple[str, ...],
    as_json: bool,
) -> None:
    """Give quadratic programs to every solver: those that runs of SPECS meet, or that are in files; else the corpus.

    Also to objects of one's own, from Python: wbc.compare.compare(programs, {"mine": object}). One that cannot be
    pickled is asked in the same process, where no limit ends it.
    """
    with refusing(specs[0] if specs else "the corpus", as_json):
        from .. import compare as comparison

        chosen = comparison.offered() if solvers == "all" else [n.strip() for n in solvers.split(",") if n.strip()]
        if not chosen:
            known = ", ".join(comparison.offered())
            raise WbcError(f"--solvers {solvers!r} names none; expected `all` or some of {known}")
        if overrides and not specs:
            raise WbcError("--set changes a spec; expected a SPEC to change, for the corpus is what it is")
        folder = writable(out) if out is not None else None
        recorded = _recorded(specs, overrides, record is not None)
        if record is not None:
            comparison.corpus.save(record, recorded)
            told: dict[str, Any] = {"problems": len(recorded), "file": str(record), "bytes": record.stat().st_size}
            emit(told, as_json, lambda: terminal().print(f"wrote {len(recorded)} quadratic programs to {record}"))
            return
        with progress_bar("compare", len(recorded)) as progress:
            limit = comparison.TIMEOUT if timeout is None else timeout
            result = comparison.compare(recorded, chosen, progress=progress, timeout=limit)
        if folder is not None:
            comparison.picture(result, folder / "compare.png")
            (folder / "compare.json").write_text(json.dumps(plain(result), allow_nan=False) + "\n")
    emit(result, as_json, lambda: terminal().print(comparison.table(result)))
    sys.exit(0 if result["ok"] else 1)


def _recorded(specs: tuple[str, ...], overrides: tuple[str, ...], anew: bool) -> list[Any]:
    """The programs of specs and files; without any those of the corpus, if need be `anew` from its recipe."""
    from .. import compare as comparison
    from ..build import build

    if not specs and anew:
        with progress_bar("record the corpus", len(comparison.corpus.RECIPE)) as progress:
            return comparison.corpus.make(progress=progress)
    found = [] if specs else comparison.corpus.load()
    for name in specs:
        if name.endswith(".npz"):
            found += comparison.corpus.load(name)
            continue
        loaded = load(name, overrides, hierarchy="weighted")  # strict levels are several problems a tick
        with progress_bar(f"record {name}", round(loaded.duration * loaded.rate)) as progress:
            found += comparison.record(build(loaded), progress=progress)
    return found
