"""The commands. Heavy imports stand inside them, so that `wbc --help` answers at once.

Exit status: 0 all held; 1 it ran and a bound failed; 2 bad input. With `--json` one object goes to stdout, all else to
stderr.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from . import __version__
from .errors import SpecError, WbcError

if TYPE_CHECKING:
    from .spec import Spec

_SET = click.option(
    "--set", "overrides", multiple=True, metavar="KEY.PATH=VALUE", help="Change a value of the spec; may be repeated."
)
_JSON = click.option("--json", "as_json", is_flag=True, help="One JSON object on stdout, all else on stderr.")
_SOLVER = click.option("--solver", metavar="NAME", help="QP solver: daqp, proxqp, or a backend of qpsolvers.")
_SEED = click.option("--seed", type=int, default=0, show_default=True, help="Seed of all noise.")


@click.group(context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 110})
@click.version_option(__version__, prog_name="wbc")
def main() -> None:
    """Whole-body contact control from a YAML spec: run it, check it, verify it against the closed form."""


@main.command()
@click.argument("spec")
@click.option("--headless", is_flag=True, help="No viewer window.")
@click.option("--duration", type=float, metavar="S", help="Simulated seconds; the spec's own when left out.")
@_SEED
@_SOLVER
@_SET
@click.option(
    "--out",
    type=click.Path(file_okay=False, path_type=Path),
    metavar="DIR",
    help="Where to write; runs/SPEC when left out.",
)
@_JSON
def run(
    spec: str,
    headless: bool,
    duration: float | None,
    seed: int,
    solver: str | None,
    overrides: tuple[str, ...],
    out: Path | None,
    as_json: bool,
) -> None:
    """Simulate SPEC (a shipped name or a file) and hold it against its bounds."""
    with _faults(spec, as_json):
        extra = [f"duration={duration!r}"] if duration is not None else []
        loaded = _load(spec, [*overrides, *extra, *([f"solver={solver}"] if solver else [])])
        from .build import build
        from .run import run as simulate

        built = build(loaded)
        for note in built.notes:
            click.echo(f"note: {note}", err=True)
        ticks = round(loaded.duration * loaded.rate)
        with _progress(f"{loaded.title or spec}", ticks) as progress, _viewer(headless) as show:
            result = simulate(built, seed, progress, show=show)
        folder = out or Path("runs") / result.summary["spec"]
        _write(result, folder)
    summary = result.summary
    _emit(summary, as_json, lambda: _tell_run(summary, folder))
    sys.exit(0 if summary["ok"] else 1)


@main.command()
@click.argument("spec")
@_SOLVER
@_SET
@_JSON
def check(spec: str, solver: str | None, overrides: tuple[str, ...], as_json: bool) -> None:
    """Check SPEC without running it: keys, names, model agreement, feasibility at the start, force-loop poles."""
    with _faults(spec, as_json, _CHECK):
        from .check import check as examine

        report = examine(_load(spec, [*overrides, *([f"solver={solver}"] if solver else [])]))
    _emit(report.as_json(), as_json, lambda: _tell_check(report))
    sys.exit(0 if report.ok else 1)


@main.command()
@click.argument("spec")
@_SOLVER
@_SEED
@_SET
@_JSON
def verify(spec: str, solver: str | None, seed: int, overrides: tuple[str, ...], as_json: bool) -> None:
    """Hold SPEC's program against the closed form of both laws, at every tick of its run and at random states."""
    with _faults(spec, as_json):
        loaded = _load(spec, overrides)
        from .verify import LAWS
        from .verify import verify as certify

        ticks = round(loaded.duration * loaded.rate) * len(LAWS)
        with _progress(f"verify {spec}", ticks) as progress:
            certificate = certify(loaded, solver, seed=seed, progress=progress)
    _emit(certificate.as_json(), as_json, lambda: _tell_verify(certificate))
    sys.exit(0 if certificate.ok else 1)


@main.command()
@click.argument("specs", nargs=-1)
@click.option("--solvers", default="all", show_default=True, metavar="A,B|all", help="Which solvers.")
@_SET
@_JSON
def compare(specs: tuple[str, ...], solvers: str, overrides: tuple[str, ...], as_json: bool) -> None:
    """Give the programs that runs of SPECS meet to every solver; eraser when none is named."""
    names = specs or ("eraser",)
    with _faults(names[0], as_json):
        from . import compare as comparison
        from .build import build
        from .solver import installed

        chosen = installed() if solvers == "all" else [name.strip() for name in solvers.split(",") if name.strip()]
        recorded = []
        for name in names:
            loaded = _load(name, overrides)
            with _progress(f"record {name}", round(loaded.duration * loaded.rate)) as progress:
                recorded += comparison.record(build(loaded), progress=progress)
        with _progress("compare", len(recorded)) as progress:
            result = comparison.compare(recorded, chosen, progress=progress)
    _emit(result, as_json, lambda: _console().print(comparison.table(result)))
    sys.exit(0)


@main.command()
def schema() -> None:
    """Print the JSON Schema of a spec, for editors."""
    from .spec import json_schema

    click.echo(json.dumps(json_schema(), indent=1))


@main.command()
@_JSON
def doctor(as_json: bool) -> None:
    """Say what this installation consists of: versions, solvers, where each package was found."""
    from .doctor import examine

    report = examine()
    _emit(report, as_json, lambda: _tell_doctor(report))


# --- helpers of the commands ---

_CHECK: dict[str, Any] = {"model_error": None, "feasible": False, "poles": []}


def _load(spec: str, overrides: Any) -> Spec:
    from .spec import load

    return load(spec, tuple(overrides))


@contextmanager
def _faults(spec: str, as_json: bool, more: dict[str, Any] | None = None) -> Iterator[None]:
    """Bad input becomes one message a fault, and exit status 2."""
    try:
        yield
    except SpecError as error:
        for fault in error.faults:
            click.echo(str(fault), err=True)
        if as_json:
            click.echo(
                json.dumps(
                    {"spec": spec, "ok": False, "faults": [vars(fault) for fault in error.faults]} | (more or {})
                )
            )
        sys.exit(2)
    except (WbcError, OSError) as error:
        click.echo(f"{spec}: {error}", err=True)
        if as_json:
            fault = {"file": spec, "line": 0, "column": 0, "key": "", "message": str(error)}
            click.echo(json.dumps({"spec": spec, "ok": False, "faults": [fault]} | (more or {})))
        sys.exit(2)


def _emit(value: dict[str, Any], as_json: bool, tell: Callable[[], None]) -> None:
    if as_json:
        click.echo(json.dumps(value))
    else:
        tell()


def _console(err: bool = False) -> Any:
    from rich.console import Console

    return Console(stderr=err, highlight=False)


@contextmanager
def _progress(title: str, total: int) -> Iterator[Callable[[int], None]]:
    from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

    with Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        TextColumn("{task.percentage:3.0f} %"),
        TimeRemainingColumn(),
        console=_console(True),
        transient=True,
    ) as bar:
        task = bar.add_task(title, total=total)
        yield lambda done: bar.update(task, completed=done)


@contextmanager
def _viewer(headless: bool) -> Iterator[Any]:
    if headless:
        yield None
        return
    from .view import window

    with window() as show:
        yield show


def _write(result: Any, folder: Path) -> None:
    try:
        result.write(folder)
    except OSError as error:
        raise WbcError(f"--out {folder}: cannot write there: {error.strerror or error}") from error


def _tell_run(summary: dict[str, Any], folder: Path) -> None:
    from rich.table import Table

    console = _console()
    table = Table(
        "quantity", "value", "bound", "", title=f"{summary['spec']}: {'all held' if summary['ok'] else 'FAILED'}"
    )
    for entry in summary["checks"]:
        table.add_row(
            entry["name"],
            "not measured" if entry["value"] is None else f"{entry['value']:.4g}",
            str(entry["bound"]),
            "[green]ok[/]" if entry["ok"] else "[red]missed[/]",
        )
    console.print(table)
    if "broken" in summary:
        console.print(f"[red]{summary['broken']}[/]")
    status = ", ".join(f"{name} {count}" for name, count in summary["status"].items())
    us = summary["step_us"]
    console.print(f"{summary['ticks']} ticks: {status}; tick {us['p50']:.0f} us median, {us['p99']:.0f} us p99")
    console.print(f"wrote {folder / 'report.png'}, summary.json, log.npz")


def _tell_check(report: Any) -> None:
    from rich.table import Table

    console = _console()
    for note in report.notes:
        console.print(f"note: {note}")
    worst: dict[tuple[str, str], Any] = {}
    for pole in report.poles:
        key = (pole.contact, pole.axis)
        if key not in worst or pole.radius > worst[key].radius:
            worst[key] = pole
    if worst:
        table = Table("force loop", "largest pole", "margin", "against", title="poles over the stiffness range")
        for (contact, axis), pole in worst.items():
            against = (
                "a rigid wall"
                if pole.stiffness is None
                else f"{pole.stiffness:.3g} {'N m/rad' if axis.startswith('m') else 'N/m'}"
            )
            table.add_row(f"{contact}.{axis}", f"{pole.radius:.5f}", f"{1 - pole.radius:.1e}", against)
        console.print(table)
    for task, margin in report.damping_margins.items():
        console.print(f"{task}: damping uses {margin / 2:.0%} of what this rate allows")
    console.print(
        f"MuJoCo and Pinocchio agree to {report.model_error:.0e}; start pose {'feasible' if report.feasible else 'NOT feasible: ' + report.reason}"
    )
    console.print(f"{report.spec}: {'ok' if report.ok else 'FAILED'}")


def _tell_verify(certificate: Any) -> None:
    from rich.table import Table

    console = _console()
    table = Table(
        "law",
        "torque",
        "acceleration",
        "multipliers",
        "KKT residual",
        title=f"{certificate.spec}: worst errors, relative to 1 + the largest entry",
    )
    for law, worst in certificate.laws.items():
        table.add_row(law, *(f"{value:.1e}" for value in vars(worst).values()))
    console.print(table)
    console.print(
        f"{certificate.ticks} ticks ({certificate.lifted} with an active limit lifted), {certificate.states} random states "
        f"({certificate.dropped} ill-conditioned ones dropped); with MuJoCo's M, h, J {certificate.max_tau_error_mujoco:.1e}; "
        f"bar {certificate.tolerance:.0e}: {'holds' if certificate.ok else 'FAILED'}"
    )


def _tell_doctor(report: dict[str, Any]) -> None:
    from rich.table import Table

    table = Table("what", "found", show_header=False)
    for key, value in report.items():
        if isinstance(value, dict):
            for name, found in value.items():
                table.add_row(f"{key}: {name}", str(found))
        else:
            table.add_row(key, ", ".join(map(str, value)) if isinstance(value, list) else str(value))
    _console().print(table)
