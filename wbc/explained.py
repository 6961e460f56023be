"""An explanation in words and tables, for the terminal."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from .explanation import Explanation
    from .hardness import Culprit

FEW = 1e-9  # residuals and torques below are rounding


def tell(told: Explanation, console: Any) -> None:
    """Print it on a rich console."""
    console.print(f"t = {told.t:.6g} s: {told.status}{f', {told.reason}' if told.reason else ''}")
    if told.conflict:
        _conflict(told, console)
    if told.split is not None:
        _torque(told, console)
    if told.regulariser is not None:
        _tasks(told, console)
    elif told.split is not None:
        console.print("No answer stands behind this torque: it carries the load, and what moves is damped or let go.")


def _conflict(told: Explanation, console: Any) -> None:
    from rich.table import Table

    first = [each for each in told.conflict if each.frees]
    rest = [each.name for each in told.conflict if not each.frees]
    console.print(f"{len(told.conflict)} constraints conflict; without any one of them the others hold together.")
    if first:
        table = Table("constraint", "asks for", "frees the tick", title="each of these alone frees the tick")
        for each in first:
            table.add_row(each.name, _asked(each), f"{each.needs:.4g} {each.unit} more")
        console.print(table)
        if rest:
            console.print(f"They leave no way around: {', '.join(rest)}.")
        return
    table = Table("constraint", "asks for", title="none of these alone frees the tick, for there are other conflicts")
    for each in told.conflict:
        table.add_row(each.name, _asked(each))
    console.print(table)
    for names in told.others:
        console.print(f"Another conflict: {', '.join(names)}.")


def _asked(culprit: Culprit) -> str:
    """What a constraint wants, in words."""
    side = {"least": "at least", "most": "at most", "exactly": "exactly"}[culprit.side]
    value = f"{culprit.bound:.4g} {culprit.unit}" if math.isfinite(culprit.bound) else "any"
    return f"{side} {value}" + (f", {culprit.told}" if culprit.told else "")


def _torque(told: Explanation, console: Any) -> None:
    from rich.table import Table

    assert told.split is not None
    assert told.tau is not None
    table = Table("joint", *told.split, "torque", title="torque [N m], as the book splits it")
    for i, joint in enumerate(told.joints):
        table.add_row(joint, *(f"{part[i]:+.3f}" for part in told.split.values()), f"{told.tau[i]:+.3f}")
    console.print(table)


def _tasks(told: Explanation, console: Any) -> None:
    from rich.table import Table

    table = Table("task", "weight", "level", "lacks at most", "would add", title="tasks, and what they do not get")
    for each in told.tasks:
        size, torque = each.size, each.torque
        i = int(abs(torque).argmax())
        adds = f"{torque[i]:+.3g} N m on {told.joints[i]}" if abs(torque[i]) > FEW else "nothing"
        lacks = f"{size:.3g} {each.unit}" if size > FEW else "nothing"
        table.add_row(each.name, f"{each.weight:g}", str(each.level), lacks, adds)
    console.print(table)
    for limit in told.limits:
        console.print(f"At its limit: {limit.name}, multiplier {limit.multiplier:.3g} {limit.unit}.")
    if not told.limits:
        console.print("No limit is active.")
    left = told.regulariser
    if left is not None and left.directions:
        most = float(abs(left.torque).max())
        console.print(f"Tasks and constraints leave {left.directions} directions open: {', '.join(left.by)}.")
        console.print(f"The regulariser decides them, with up to {most:.3g} N m.")
    else:
        console.print("Tasks and constraints decide everything; nothing is left to the regulariser.")
