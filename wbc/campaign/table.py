"""What a campaign found, for a terminal."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from ..ladder import Status

if TYPE_CHECKING:
    from rich.console import Group


def table(result: Mapping[str, Any]) -> Group:
    """Which faults led to which status, what was checked, and every failure with the command that repeats it."""
    from rich.console import Group
    from rich.table import Table
    from rich.text import Text

    from . import INVARIANTS

    names = [status.name for status in Status]
    faults = Table("what went wrong", *names, title="ticks, by what went wrong in them and how they ended")
    checked = Table("what must hold", "checked", "violated", title=f"{result['seeds']} seeds, {result['ticks']} ticks")
    for column in (*faults.columns[1:], *checked.columns[1:]):
        column.justify = "right"
    for kind, statuses in result["statuses"].items():
        faults.add_row(kind, *(str(statuses.get(name, "")) for name in names))
    violated = [failure["invariant"] for failure in result["failures"]]
    for name, told in INVARIANTS.items():
        count = violated.count(name)
        row = f"{name}: {told}", str(result["invariants"].get(name, 0))
        checked.add_row(*row, Text(str(count), "red" if count else "green"))
    next_good = result["next_good"]
    lines = [Text(f"{next_good['accepted']} of {next_good['of']} good ticks after bad ones were accepted")]
    for failure in result["failures"]:
        lines.append(Text(f"{failure['invariant']}: {failure['told']}, at tick {failure['tick']}", "red"))
        if "repeat" in failure:
            lines.append(Text(f"  {failure['repeat']}"))
    lines.append(Text("all held" if result["ok"] else f"FAILED: {len(violated)} violated"))
    return Group(faults, checked, *lines)
