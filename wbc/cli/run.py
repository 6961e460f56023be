"""`wbc run`: the closed loop in MuJoCo, held against its bounds."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from ..errors import Fault, SpecError
from .options import HIERARCHY, JSON, SEED, SET, SOLVER, load
from .output import emit, progress_bar, refusing, terminal, writable

if TYPE_CHECKING:
    from ..spec import Spec


@click.command()
@click.argument("spec")
@click.option("--headless", is_flag=True, help="No viewer window.")
@click.option("--duration", type=float, metavar="S", help="Simulated seconds; the spec's own when left out.")
@SEED
@SOLVER
@HIERARCHY
@SET
@click.option(
    "--fault",
    "faults",
    multiple=True,
    metavar="TEXT",
    help='What fails on purpose, as in plant.faults: "sensor.dropout at 1.2 for 0.1"; may be repeated.',
)
@click.option(
    "--out",
    type=click.Path(path_type=Path),
    metavar="DIR",
    help="Where to write; runs/SPEC when left out.",
)
@JSON
def run(
    spec: str,
    headless: bool,
    duration: float | None,
    seed: int,
    solver: str | None,
    hierarchy: str | None,
    overrides: tuple[str, ...],
    faults: tuple[str, ...],
    out: Path | None,
    as_json: bool,
) -> None:
    """Simulate SPEC (a shipped name or a file) and hold it against its bounds."""
    with refusing(spec, as_json):
        loaded = _with_faults(load(spec, overrides, solver, duration, hierarchy), faults)
        from ..build import build
        from ..run import run as simulate

        built = build(loaded)
        for note in built.notes:
            click.echo(f"note: {note}", err=True)
        folder = writable(out or Path("runs") / Path(loaded.file).stem)
        ticks = round(loaded.duration * loaded.rate)
        with progress_bar(f"{loaded.title or spec}", ticks) as progress, _viewer(headless) as show:
            result = simulate(built, seed, progress, show=show)
        result.write(folder)
        for note in result.summary["notes"][len(built.notes) :]:
            click.echo(f"note: {note}", err=True)
    summary = result.summary
    emit(summary, as_json, lambda: tell(summary, folder))
    sys.exit(0 if summary["ok"] else 1)


def _with_faults(loaded: Spec, faults: tuple[str, ...]) -> Spec:
    """The spec with more that fails on purpose."""
    if not faults:
        return loaded
    from ..spec.fault import planned

    wrong = []
    for text in faults:
        try:
            planned(text)
        except ValueError as error:
            wrong.append(Fault("--fault", 0, 0, "", str(error)))
    if wrong:
        raise SpecError(wrong)
    return loaded.with_set({"plant.faults": [*loaded.plant.faults, *faults]})


@contextmanager
def _viewer(headless: bool) -> Iterator[Any]:
    if headless:
        yield None
        return
    from ..view import window

    with window() as show:
        yield show


def tell(summary: dict[str, Any], folder: Path) -> None:
    from rich.table import Table
    from rich.text import Text

    console = terminal()
    title = Text(f"{summary['spec']}: {'all held' if summary['ok'] else 'FAILED'}")
    table = Table("quantity", "value", "bound", "", title=title)
    for entry in summary["checks"]:
        value = "not measured" if entry["value"] is None else f"{entry['value']:.4g}"
        verdict = Text("ok", "green") if entry["ok"] else Text("missed", "red")
        table.add_row(entry["name"], value, str(entry["bound"]), verdict)
    console.print(table)
    if "broken" in summary:
        console.print(Text(summary["broken"], "red"))
    for phase in summary["phases"]:
        console.print(
            Text(f"{phase['start']:7.3f} s  {phase['name']}" + (f"  ({why})" if (why := phase["why"]) else ""))
        )
    status = ", ".join(f"{name} {count}" for name, count in summary["status"].items())
    us = summary["step_us"]
    console.print(f"{summary['ticks']} ticks: {status}; tick {us['p50']:.0f} us median, {us['p99']:.0f} us p99")
    console.print(f"wrote {folder / 'report.png'}, summary.json, log.npz")
