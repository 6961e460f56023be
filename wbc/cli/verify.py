"""`wbc verify`: a spec's program beside the closed form."""

from __future__ import annotations

import sys
from typing import Any

import click

from .options import JSON, SEED, SET, SOLVER, load
from .output import emit, progress_bar, refusing, terminal


@click.command()
@click.argument("spec")
@SOLVER
@SEED
@SET
@JSON
def verify(spec: str, solver: str | None, seed: int, overrides: tuple[str, ...], as_json: bool) -> None:
    """Hold SPEC's program against the closed form of both laws, at every tick of its run and at random states."""
    with refusing(spec, as_json):
        loaded = load(spec, overrides, solver)
        from ..verify import LAWS
        from ..verify import verify as certify

        ticks = round(loaded.duration * loaded.rate) * len(LAWS)
        with progress_bar(f"verify {spec}", ticks) as progress:
            certificate = certify(loaded, seed=seed, progress=progress)
    emit(certificate.as_json(), as_json, lambda: tell(certificate))
    sys.exit(0 if certificate.ok else 1)


def tell(certificate: Any) -> None:
    from rich.table import Table
    from rich.text import Text

    console = terminal()
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
