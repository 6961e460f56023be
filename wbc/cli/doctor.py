"""`wbc doctor`: what this installation consists of, and what is wrong with it."""

from __future__ import annotations

import sys
from typing import Any

import click

from .options import JSON
from .output import emit, terminal


@click.command()
@JSON
def doctor(as_json: bool) -> None:
    """Say what this installation consists of, what is wrong with it, and what to do; exit 1 if it cannot work."""
    from ..doctor import examine

    report = examine()
    emit(report, as_json, lambda: tell(report))
    sys.exit(0 if report["ok"] else 1)


def tell(report: dict[str, Any]) -> None:
    from rich.table import Table
    from rich.text import Text

    console, styles = terminal(), {"ok": "green", "note": "yellow", "problem": "red"}
    table = Table("", "what", "found", "what to do")
    for each in report["findings"]:
        table.add_row(Text(each["status"], styles[each["status"]]), each["name"], each["found"], each["do"])
    console.print(table)
    console.print("nothing that wbc needs is broken" if report["ok"] else "PROBLEMS: wbc cannot be relied on here")
