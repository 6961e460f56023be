"""The rows of the faults that a controller meets, and the table of them: `pytest -m row` fills it in.

A test that belongs to a row is marked `@pytest.mark.row(9)`, a whole file with `pytestmark = pytest.mark.row(9)`; what
it measured it tells by the fixture `tell("overshoot [rad]", value, most=1e-3)`, which holds it to its bound, or by
`record_property` where there is none. Numbers of one name show their largest, those with a lower bound their smallest.
At the full size: `WBC_CAMPAIGN=large pytest -m row`.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Hashable
from typing import Any, NamedTuple

import numpy as np
import pytest

ROWS: dict[Hashable, tuple[str, str]] = {
    1: ("NaN or inf at every index of q, v, wrench, target", "refused 100 %, old target kept"),
    2: ("wrong shape, dtype, stride, read-only, list", "refused by name; the next good torque bit-equal"),
    3: ("quaternion norm 1 +- 1e-6 ... 0, sign flip", "normalised to 1e-3, refused beyond; sign flip changes nothing"),
    4: ("dt zero, negative, NaN, jump, repeated stamp", "integrators at most 2 dt; stale after 20 ticks"),
    5: ("force sensor dropout, bias, drift, spikes, ...", "<= 0.05 m/s, <= 5 mm; wrong sign before 5 N, in 100 ms"),
    6: ("solver fails at tick N, once and for ever", "hold, then safe hold; next good tick accepted >= 99.9 %"),
    7: ("solver lies", "no accepted lie moves a torque by more than 1e-3 N m"),
    8: ("contact lost, or moving away at 0.1-0.5 m/s", "noticed in <= 5 ticks; <= 0.15 m/s, <= 10 mm"),
    9: ("joint at or beyond a limit", "overshoot <= 1e-3 rad, no empty bound; from outside back inside"),
    10: ("infeasible task sets of known cause", "culprits named in >= 95 % of 1000; dynamics never relaxed"),
    11: ("1, 3, 20 missed ticks in a row", "3: DEGRADED; 20: STOPPED"),
    12: ("singularity crossed slowly and fast", "bounded acceleration, damped, smallest singular value told"),
    13: ("target jump of 0.5 m, 180 degrees, 100 N", "reference limited; torque rate within 1000 N m/s"),
    14: ("10 s of wind-up, then contact", "impact <= 1.3 times that without the wait"),
    15: ("varying stiffness, 1-20 ms of delay", "tank never below zero on 1000 seeds"),
    16: ("YAML: mutated files and attacks", "exit 2, located, 0 tracebacks, <= 1 s"),
    17: ("model files: includes, meshes, NaN, nonsense", "a clear error; nothing read outside unless asked"),
    18: ("simulator NaN or reset", "the run ends, non-zero, and says when"),
    "all": ("all of it at once, by seed", "every invariant at every tick"),
    "planted": ("bugs planted in the package", "at least 19 of 20 caught, each named"),
}  # fmt: skip


AT_LEAST = "(>= "


def told(
    record: Callable[[str, Any], None], name: str, value: float, most: float | None = None, least: float | None = None,
    why: str = "",
) -> None:  # fmt: skip
    """A number for the table, with the bound that it is held to here; `why`: the command that repeats it."""
    bound = f"(<= {most:g})" if most is not None else f"{AT_LEAST}{least:g})"
    record(f"{name} {bound}", float(value))
    holds = value <= most if most is not None else value >= least
    assert holds, f"{name}: {value:g} {bound}  {why}"


def _plain(value: Any) -> Any:
    if isinstance(value, tuple | list):
        return tuple(map(_plain, value))
    return value.item() if isinstance(value, np.generic) else value


class Told(NamedTuple):
    row: Hashable
    outcome: str
    numbers: tuple[tuple[str, Any], ...]


class Rows:
    """Collects what marked tests tell, also those of other processes, and prints one table of it."""

    def __init__(self) -> None:
        self.told: list[Told] = []

    @pytest.hookimpl(trylast=True)
    def pytest_collection_modifyitems(self, items: list[Any]) -> None:
        for item in items:
            rows = [row for mark in item.iter_markers("row") for row in mark.args]
            unknown = [row for row in rows if row not in ROWS]
            if unknown:
                raise pytest.UsageError(f"{item.nodeid}: no row {unknown[0]!r}; expected one of {list(ROWS)}")
            item.user_properties += [("row", row) for row in dict.fromkeys(rows)]

    @pytest.hookimpl(tryfirst=True)
    def pytest_runtest_makereport(self, item: Any) -> None:
        """Numbers of numpy as those of Python: others do not travel between processes."""
        item.user_properties[:] = [(name, _plain(value)) for name, value in item.user_properties]

    def pytest_runtest_logreport(self, report: Any) -> None:
        if report.when == "call" or (report.when == "setup" and report.outcome != "passed"):
            numbers = tuple((name, value) for name, value in report.user_properties if name != "row")
            self.told += [Told(row, report.outcome, numbers) for name, row in report.user_properties if name == "row"]

    def verdict(self, row: Hashable) -> str:
        outcomes = Counter(told.outcome for told in self.told if told.row == row)
        if not outcomes["passed"] + outcomes["failed"]:
            return "MISSING"
        if outcomes["failed"]:
            return f"FAILED {outcomes['failed']} of {sum(outcomes.values())}"
        return f"holds, {outcomes['passed']} tests"

    def numbers(self, row: Hashable) -> str:
        """The largest of each number (the smallest of one with a lower bound), and every word."""
        found: dict[str, list[Any]] = {}
        for told in self.told:
            for name, value in told.numbers if told.row == row else ():
                found.setdefault(name, []).append(value)
        worst = {name: min if AT_LEAST in name else max for name in found}
        return ", ".join(f"{name} {_summary(values, worst[name])}" for name, values in found.items())

    def pytest_sessionfinish(self, session: Any) -> None:
        config = session.config
        if _asked(config) and not hasattr(config, "workerinput") and not session.exitstatus:
            missing = [row for row in ROWS if self.verdict(row) == "MISSING"]
            session.exitstatus = pytest.ExitCode.TESTS_FAILED if missing else session.exitstatus

    def pytest_terminal_summary(self, terminalreporter: Any, config: Any) -> None:
        if not _asked(config) and any(self.verdict(row) == "MISSING" for row in ROWS):
            return  # a part of the tests; the whole of them fills it in as well
        terminalreporter.section("the faults, row by row")
        for row, (injected, holds) in ROWS.items():
            terminalreporter.write_line(f"{row!s:>7}  {injected}: {holds}")
            verdict = self.verdict(row)
            numbers = self.numbers(row)
            bad = verdict.startswith(("MISSING", "FAILED"))
            terminalreporter.write_line(
                f"         {verdict}{': ' + numbers if numbers else ''}", red=bad, green=not bad
            )


def _asked(config: Any) -> bool:
    return config.option.markexpr == "row" and not config.option.collectonly


def _summary(values: list[Any], worst: Callable[[list[Any]], Any]) -> str:
    if all(isinstance(value, int | float) for value in values):
        return f"{worst(values):.4g}"
    return ", ".join(f"{word} ({count})" if count > 1 else str(word) for word, count in Counter(values).most_common())
