"""What `compare` answers, for a terminal."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from rich.console import Group
    from rich.table import Table

_FATES = ("solved", "refused", "wrong")


def table(result: Mapping[str, Any]) -> Group:
    """What became of the answers, by solver; by kind of problem; the time by size."""
    from rich.console import Group

    return Group(_answers(result), _kinds(result), _growth(result))


def _answers(result: Mapping[str, Any]) -> Table:
    none = f", {result['infeasible']} of them infeasible" if result["infeasible"] else ""
    late = "" if result["timeout"] is None else f", at most {result['timeout']:g} s each"
    shown = _table(
        f"{result['problems']} quadratic programs{none}{late}; torques up to {result['tau_max']:.3g} N m; "
        "certified answers:",
        *(*_FATES, "wrong but accepted", "torque error [N m]", "allowed", "primal", "dual", "gap"),
        *("p50 [us]", "p99", "max"),
    )
    for name, row in result["solvers"].items():
        counts = [str(row["solved"]), _refused(row), _red(row["wrong"]), _red(row["accepted_wrong"])]
        certified = row["certified"]
        errors = [certified["tau_error"], row["tolerance"], *(certified[key] for key in ("primal", "dual", "gap"))]
        shown.add_row(name, *counts, *map(_size, errors), *(f"{us:.0f}" for us in row["us"].values()))
    return shown


def _kinds(result: Mapping[str, Any]) -> Table:
    rows = result["solvers"]
    kinds = {kind: found["problems"] for kind, found in next(iter(rows.values()))["kinds"].items()}
    shown = _table(
        "solved, and the worst torque error of all answers, certified or not [N m]",
        *(f"{kind} ({count})" for kind, count in kinds.items()),
    )
    for name, row in rows.items():
        found = [row["kinds"][kind] for kind in kinds]
        shown.add_row(name, *(f"{each['solved']}  {_size(each['max_tau_error'])}" for each in found))
    return shown


def _growth(result: Mapping[str, Any]) -> Table:
    rows = result["solvers"]
    sizes = list(next(iter(rows.values()))["growth"])
    shown = _table("median [us] of feasible programs by number of unknowns", *sizes)
    for name, row in rows.items():
        shown.add_row(name, *(f"{row['growth'][n]:.0f}" for n in sizes))
    return shown


def _table(title: str, *headings: str) -> Table:
    from rich.table import Table

    shown = Table("solver", title=title)
    for heading in headings:
        shown.add_column(heading, justify="right")
    return shown


def _refused(row: Mapping[str, Any]) -> str:
    """With those of them that no word of the solver refused."""
    of_them = [f"{row[key]} {told}" for key, told in (("timed_out", "too late"), ("crashed", "crashed")) if row[key]]
    return str(row["refused"]) + (f" ({', '.join(of_them)})" if of_them else "")


def _red(count: int) -> Any:
    from rich.text import Text

    return Text(str(count), "red" if count else "")


def _size(value: float | None) -> str:
    return "-" if value is None else f"{value:.0e}"
