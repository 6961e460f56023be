"""`wbc check`: all that can be said of a spec without running it."""

from __future__ import annotations

import math
import sys
from typing import Any

import click

from .options import JSON, SET, SOLVER, load
from .output import emit, refusing, terminal

_CHECK: dict[str, Any] = {"model_error": None, "feasible": False, "poles": []}  # of bad input


@click.command()
@click.argument("spec")
@SOLVER
@SET
@JSON
def check(spec: str, solver: str | None, overrides: tuple[str, ...], as_json: bool) -> None:
    """Check SPEC without running it: keys, names, model agreement, feasibility at the start, force-loop poles."""
    with refusing(spec, as_json, _CHECK):
        from ..check import check as examine

        report = examine(load(spec, overrides, solver))
    emit(report.as_json(), as_json, lambda: tell(report))
    sys.exit(0 if report.ok else 1)


def tell(report: Any) -> None:
    from rich.table import Table

    from ..margins import against

    console = terminal()
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
