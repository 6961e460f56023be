"""The commands. Heavy imports stand inside them, so that `wbc --help` answers at once.

Exit status: 0 all held; 1 it ran and a bound failed; 2 bad input. With `--json` one object goes to stdout, all else to
stderr.
"""

from __future__ import annotations

import json
import math
import os
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn

import click
from click.core import ParameterSource

from . import __version__
from .errors import Fault, LogError, SpecError, WbcError

if TYPE_CHECKING:
    from .spec import Spec

_OVERRIDES = click.option(
    "--set", "overrides", multiple=True, metavar="KEY.PATH=VALUE", help="Change a value of the spec; may be repeated."
)
_OUTSIDE = "wbc.allow_outside"


def _asked(context: click.Context, _: click.Parameter, given: bool) -> None:
    context.meta[_OUTSIDE] = given


def _SET(command: Callable[..., None]) -> Callable[..., None]:
    """What every command has that loads a spec: `--set`, and `--allow-outside`, which `_load` asks for."""
    allowed = "Models may be, and may draw in, files outside of the spec's folder."
    outside = click.option("--allow-outside", is_flag=True, expose_value=False, callback=_asked, help=allowed)
    return _OVERRIDES(outside(command))


_JSON = click.option("--json", "as_json", is_flag=True, help="One JSON object on stdout, all else on stderr.")
_SOLVER = click.option("--solver", metavar="NAME", help="QP solver: daqp, proxqp, or a backend of qpsolvers.")
_HIERARCHY = click.option(
    "--hierarchy",
    type=click.Choice(["weighted", "strict"]),
    help="How levels of tasks count; the spec's when left out.",
)
_SEED = click.option("--seed", type=click.IntRange(min=0), default=0, show_default=True, help="Seed of all noise.")


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
@_HIERARCHY
@_SET
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
@_JSON
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
    with _faults(spec, as_json):
        loaded = _with_faults(_load(spec, overrides, solver, duration, hierarchy), faults)
        from .build import build
        from .run import run as simulate

        built = build(loaded)
        for note in built.notes:
            click.echo(f"note: {note}", err=True)
        folder = _folder(out or Path("runs") / Path(loaded.file).stem)
        ticks = round(loaded.duration * loaded.rate)
        with _progress(f"{loaded.title or spec}", ticks) as progress, _viewer(headless) as show:
            result = simulate(built, seed, progress, show=show)
        result.write(folder)
        for note in result.summary["notes"][len(built.notes) :]:
            click.echo(f"note: {note}", err=True)
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

        report = examine(_load(spec, overrides, solver))
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
        loaded = _load(spec, overrides, solver)
        from .verify import LAWS
        from .verify import verify as certify

        ticks = round(loaded.duration * loaded.rate) * len(LAWS)
        with _progress(f"verify {spec}", ticks) as progress:
            certificate = certify(loaded, seed=seed, progress=progress)
    _emit(certificate.as_json(), as_json, lambda: _tell_verify(certificate))
    sys.exit(0 if certificate.ok else 1)


@main.command()
@click.argument("what", metavar="SPEC|LOG")
@click.option("--at", type=float, metavar="T", help="Which tick, by its time [s].")
@click.option("--tick", type=click.IntRange(min=0), metavar="K", help="Which tick, from 0.")
@_SEED
@_SOLVER
@_HIERARCHY
@_SET
@_JSON
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
    with _faults(what, as_json):
        from .arrive import is_log, logged, simulated
        from .explained import tell
        from .explanation import explain as examine

        if at is not None and not 0.0 <= at < math.inf:
            raise WbcError(f"--at {at:g}: expected a time of 0 or more [s]")
        if is_log(what):
            if given:
                raise WbcError("--seed is of a run; the log has its own")
            changes = (*overrides, *([f"hierarchy={hierarchy}"] if hierarchy else []))
            controller, about = logged(what, tick, at, solver, changes)
        else:
            loaded = _load(what, overrides, solver, None, hierarchy)
            end = at + 1.0 / loaded.rate if at is not None else ((tick or 0) + 1) / loaded.rate
            loaded = _load(what, overrides, solver, end, hierarchy)
            with _progress("run to the tick", round(loaded.duration * loaded.rate)) as progress:
                controller = simulated(loaded, seed, progress)
            about = {"spec": Path(loaded.file).stem, "notes": []}
        told = examine(controller)
    for note in about["notes"]:
        click.echo(f"note: {note}", err=True)
    _emit(about | told.as_json(), as_json, lambda: tell(told, _console()))
    sys.exit(0)


@main.command()
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
@_SET
@_JSON
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
    with _faults(specs[0] if specs else "the corpus", as_json):
        from . import compare as comparison

        chosen = comparison.offered() if solvers == "all" else [n.strip() for n in solvers.split(",") if n.strip()]
        if not chosen:
            known = ", ".join(comparison.offered())
            raise WbcError(f"--solvers {solvers!r} names none; expected `all` or some of {known}")
        if overrides and not specs:
            raise WbcError("--set changes a spec; expected a SPEC to change, for the corpus is what it is")
        folder = _folder(out) if out is not None else None
        recorded = _recorded(specs, overrides, record is not None)
        if record is not None:
            comparison.corpus.save(record, recorded)
            told: dict[str, Any] = {"problems": len(recorded), "file": str(record), "bytes": record.stat().st_size}
            _emit(told, as_json, lambda: _console().print(f"wrote {len(recorded)} quadratic programs to {record}"))
            return
        with _progress("compare", len(recorded)) as progress:
            limit = comparison.TIMEOUT if timeout is None else timeout
            result = comparison.compare(recorded, chosen, progress=progress, timeout=limit)
        if folder is not None:
            comparison.picture(result, folder / "compare.png")
            (folder / "compare.json").write_text(json.dumps(_plain(result), allow_nan=False) + "\n")
    _emit(result, as_json, lambda: _console().print(comparison.table(result)))
    sys.exit(0 if result["ok"] else 1)


def _recorded(specs: tuple[str, ...], overrides: tuple[str, ...], anew: bool) -> list[Any]:
    """The programs of specs and files; without any those of the corpus, if need be `anew` from its recipe."""
    from . import compare as comparison
    from .build import build

    if not specs and anew:
        with _progress("record the corpus", len(comparison.corpus.RECIPE)) as progress:
            return comparison.corpus.make(progress=progress)
    found = [] if specs else comparison.corpus.load()
    for name in specs:
        if name.endswith(".npz"):
            found += comparison.corpus.load(name)
            continue
        loaded = _load(name, overrides, hierarchy="weighted")  # strict levels are several problems a tick
        with _progress(f"record {name}", round(loaded.duration * loaded.rate)) as progress:
            found += comparison.record(build(loaded), progress=progress)
    return found


@main.command()
@click.argument("log", required=False)
@click.option("--tick", type=click.IntRange(min=0), metavar="K", help="Only this tick, from 0.")
@click.option("--at", type=float, metavar="T", help="Only the tick at this time [s].")
@click.option("--bisect", nargs=2, metavar="A B", help="Find the first tick at which two logs part, and in what.")
@_SOLVER
@_SET
@_JSON
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
    with _faults(str(log), as_json):
        from .again import again, tell
        from .replay import Replay

        run = Replay(str(log))
        tick = run.tick_at(at) if at is not None else tick
        with _progress(f"replay {log}", len(run) if tick is None else 1) as progress:
            result = again(run, tick, solver, overrides, progress)
    _emit(result, as_json, lambda: tell(result, _console()))
    sys.exit(0 if result["ok"] else 1)


def _bisect(a: str, b: str, as_json: bool) -> NoReturn:
    with _faults(f"{a}, {b}", as_json):
        from . import part
        from .replay import Replay

        result = part.found(Replay(a), Replay(b))
    _emit(result, as_json, lambda: part.tell(result, _console()))
    sys.exit(0 if result["ok"] else 1)


@main.command()
@click.argument("specs", nargs=-1)
@click.option("--seeds", type=click.IntRange(min=1), default=100, show_default=True, help="How many seeds.")
@click.option("--first", type=click.IntRange(min=0), default=0, show_default=True, help="The first of them.")
@click.option("--seed", type=click.IntRange(min=0), help="Only this one.")
@click.option("--jobs", type=click.IntRange(min=1), default=1, show_default=True, help="How many processes.")
@click.option("--out", type=click.Path(path_type=Path), metavar="DIR", help="Write campaign.json there.")
@_SOLVER
@_HIERARCHY
@_SET
@_JSON
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
    with _faults(specs[0] if specs else "the campaign", as_json):
        from . import campaign as campaigns

        cases = campaigns.cases(specs, overrides, solver, hierarchy)
        for case in cases:
            _load(case.spec, case.changes)
        folder = _folder(out) if out is not None else None
        with _progress("campaign", len(chosen)) as progress:
            result = campaigns.campaign(cases, chosen, jobs, progress)
        if folder is not None:
            (folder / "campaign.json").write_text(json.dumps(_plain(result), allow_nan=False, indent=1) + "\n")
    _emit(result, as_json, lambda: _console().print(campaigns.table(result)))
    sys.exit(0 if result["ok"] else 1)


@main.command()
@click.option("--json", is_flag=True, expose_value=False, help="It is one JSON object anyway.")
def schema() -> None:
    """Print the JSON Schema of a spec, for editors."""
    from .spec import json_schema

    click.echo(json.dumps(json_schema(), indent=1))


@main.command()
@_JSON
def doctor(as_json: bool) -> None:
    """Say what this installation consists of, what is wrong with it, and what to do; exit 1 if it cannot work."""
    from .doctor import examine

    report = examine()
    _emit(report, as_json, lambda: _tell_doctor(report))
    sys.exit(0 if report["ok"] else 1)


# --- helpers of the commands ---

_CHECK: dict[str, Any] = {"model_error": None, "feasible": False, "poles": []}


def _load(
    spec: str,
    overrides: tuple[str, ...],
    solver: str | None = None,
    duration: float | None = None,
    hierarchy: str | None = None,
) -> Spec:
    from .spec import load

    own = {"solver": solver, "duration": None if duration is None else repr(duration), "hierarchy": hierarchy}
    given = (*overrides, *(f"{key}={value}" for key, value in own.items() if value is not None))
    return load(spec, given, click.get_current_context().meta.get(_OUTSIDE, False))


def _with_faults(loaded: Spec, faults: tuple[str, ...]) -> Spec:
    """The spec with more that fails on purpose."""
    if not faults:
        return loaded
    from .spec.fault import planned

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
def _faults(spec: str, as_json: bool, more: dict[str, Any] | None = None) -> Iterator[None]:
    """Bad input becomes one message a fault, and exit status 2."""
    try:
        yield
    except (WbcError, OSError) as error:
        faults = error.faults if isinstance(error, SpecError) else [Fault(spec, 0, 0, "", str(error))]
        if isinstance(error, LogError):
            faults = [Fault(error.file, 0, 0, "", error.message)]
        for fault in faults:
            click.echo(str(fault), err=True)
        if as_json:
            found = {"spec": spec, "ok": False, "faults": [vars(fault) for fault in faults]}
            click.echo(json.dumps(found | (more or {})))
        sys.exit(2)


def _emit(value: dict[str, Any], as_json: bool, tell: Callable[[], None]) -> None:
    if as_json:
        click.echo(json.dumps(_plain(value), allow_nan=False))
    else:
        tell()


def _plain(value: Any) -> Any:
    """The same with null for what is no number: JSON knows neither NaN nor infinity."""
    if isinstance(value, dict):
        return {key: _plain(each) for key, each in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(each) for each in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def _console(err: bool = False) -> Any:
    from rich.console import Console

    return Console(stderr=err, highlight=False, markup=False)  # names and titles are no markup


@contextmanager
def _progress(title: str, total: int) -> Iterator[Callable[[int], None]]:
    from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

    if not sys.stderr.isatty():
        yield _told(title, total)
        return
    with Progress(
        TextColumn("{task.description}", markup=False),
        BarColumn(),
        TextColumn("{task.percentage:3.0f} %"),
        TimeRemainingColumn(),
        console=_console(True),
        transient=True,
    ) as bar:
        task = bar.add_task(title, total=total)
        yield lambda done: bar.update(task, completed=done)


def _told(title: str, total: int, every: float = 10.0) -> Callable[[int], None]:
    """Progress where no bar can be drawn: a line now and then, none of what is done before the first."""
    last = time.monotonic()

    def tell(done: int) -> None:
        nonlocal last
        if time.monotonic() - last >= every:
            last = time.monotonic()
            click.echo(f"{title}: {done / max(total, 1):.0%}", err=True)

    return tell


@contextmanager
def _viewer(headless: bool) -> Iterator[Any]:
    if headless:
        yield None
        return
    from .view import window

    with window() as show:
        yield show


def _folder(folder: Path) -> Path:
    """Made, and found to be writable: better said before the run than after it."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise WbcError(f"--out {folder}: cannot be made: {error.strerror}; choose another folder") from None
    if not os.access(folder, os.W_OK | os.X_OK):
        raise WbcError(f"--out {folder}: no permission to write there; choose another folder")
    return folder


def _tell_run(summary: dict[str, Any], folder: Path) -> None:
    from rich.table import Table
    from rich.text import Text

    console = _console()
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


def _tell_check(report: Any) -> None:
    from rich.table import Table

    from .build import against

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
            table.add_row(f"{contact}.{axis}", f"{pole.radius:.5f}", f"{1 - pole.radius:.1e}", against(pole))
        console.print(table)
    for task, margin in report.damping_margins.items():
        most = ", ".join(f"{axis} {value:.3g}" for axis, value in report.damping_limits[task].items())
        console.print(f"{task}: damping uses {margin / 2:.0%} of what this rate allows; alone, each axis bears {most}")
    for each in report.masses:
        for axis, mass, least, most in zip(each.axes, each.M, each.least, each.most, strict=True):
            stable = f"stable from {least:.3g}" + ("" if math.isinf(most) else f" to {most:.3g}")
            console.print(f"{each.task}.{axis}: " + (f"M = {mass:.3g}, {stable}" if mass else "the arm's own mass"))
    start = "feasible" if report.feasible else f"NOT feasible: {report.reason}"
    console.print(f"MuJoCo and Pinocchio agree to {report.model_error:.0e}; start pose {start}")
    console.print(f"{report.spec}: {'ok' if report.ok else 'FAILED'}")


def _tell_verify(certificate: Any) -> None:
    from rich.table import Table
    from rich.text import Text

    console = _console()
    title = Text(f"{certificate.spec}: worst errors, relative to 1 + the largest entry")
    table = Table("law", "torque", "acceleration", "multipliers", "KKT residual", title=title)
    for law, worst in certificate.laws.items():
        table.add_row(law, *(f"{value:.1e}" for value in vars(worst).values()))
    console.print(table)
    for law, why in certificate.left_out.items():
        console.print(f"law {law} left out: {why}")
    states = f"{certificate.states} random states ({certificate.dropped} ill-conditioned ones dropped)"
    console.print(
        f"{certificate.ticks} ticks ({certificate.lifted} with an active limit lifted), {states}; "
        f"with MuJoCo's M, h, J {certificate.max_tau_error_mujoco:.1e}; "
        f"bar {certificate.tolerance:.0e}: {'holds' if certificate.ok else 'FAILED'}"
    )


def _tell_doctor(report: dict[str, Any]) -> None:
    from rich.table import Table
    from rich.text import Text

    console, styles = _console(), {"ok": "green", "note": "yellow", "problem": "red"}
    table = Table("", "what", "found", "what to do")
    for each in report["findings"]:
        table.add_row(Text(each["status"], styles[each["status"]]), each["name"], each["found"], each["do"])
    console.print(table)
    console.print("nothing that wbc needs is broken" if report["ok"] else "PROBLEMS: wbc cannot be relied on here")
