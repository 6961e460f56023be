"""The table of the rows: what is missing, what failed, and the largest of each number."""

from __future__ import annotations

from types import SimpleNamespace

import pytest
from rows import ROWS, Rows, told


def report(row, outcome="passed", when="call", **numbers):
    properties = [("row", row), *numbers.items()]
    return SimpleNamespace(when=when, outcome=outcome, user_properties=properties, skipped=outcome == "skipped")


def test_a_row_without_a_test_that_ran_is_missing():
    rows = Rows()
    assert all(rows.verdict(row) == "MISSING" for row in ROWS)
    rows.pytest_runtest_logreport(report(9, "skipped"))
    assert rows.verdict(9) == "MISSING"
    rows.pytest_runtest_logreport(report(9, when="setup"))  # the call counts
    assert rows.verdict(9) == "MISSING"
    rows.pytest_runtest_logreport(report(9))
    assert rows.verdict(9) == "holds, 1 tests"
    assert rows.verdict(8) == "MISSING"


@pytest.mark.parametrize("when", ["setup", "call"])
def test_one_that_fails_fails_its_row(when):
    rows = Rows()
    for outcome in ("passed", "failed"):
        rows.pytest_runtest_logreport(report(9, outcome, when if outcome == "failed" else "call"))
    assert rows.verdict(9) == "FAILED 1 of 2"


def test_numbers_show_their_largest_and_words_how_often():
    rows = Rows()
    for over, word in ((1e-4, "fast"), (3e-4, "fast"), (2e-4, "slow")):
        rows.pytest_runtest_logreport(report(9, overshoot=over, how=word))
    assert rows.numbers(9) == "overshoot 0.0003, how fast (2), slow"
    assert rows.numbers(8) == ""


@pytest.mark.parametrize(("asked", "told", "expected"), [("row", [], 1), ("row", list(ROWS), 0), ("", [], 0)])
def test_a_missing_row_fails_the_run_that_asks_for_all(asked, told, expected):
    rows = Rows()
    for row in told:
        rows.pytest_runtest_logreport(report(row))
    config = SimpleNamespace(option=SimpleNamespace(markexpr=asked, collectonly=False))
    session = SimpleNamespace(config=config, exitstatus=0)
    rows.pytest_sessionfinish(session)
    assert session.exitstatus == expected


@pytest.mark.parametrize(("asked", "told", "printed"), [("row", [], True), ("", list(ROWS), True), ("", [9], False)])
def test_the_table_is_printed_where_it_is_asked_for_or_full(asked, told, printed):
    rows, lines = Rows(), []
    for row in told:
        rows.pytest_runtest_logreport(report(row))
    reporter = SimpleNamespace(section=lines.append, write_line=lambda line, **colour: lines.append(line))
    config = SimpleNamespace(option=SimpleNamespace(markexpr=asked, collectonly=False))
    rows.pytest_terminal_summary(reporter, config)
    assert len(lines) == (1 + 2 * len(ROWS) if printed else 0)


def test_a_number_is_told_with_its_bound_and_held_to_it():
    rows = Rows()
    for value in (3e-4, 1e-4):
        numbers = {}
        told(numbers.__setitem__, "speed", value, most=0.05)
        told(numbers.__setitem__, "named", value, least=1e-5)
        rows.pytest_runtest_logreport(report(9, **numbers))
    assert rows.numbers(9) == "speed (<= 0.05) 0.0003, named (>= 1e-05) 0.0001"
    for bound in ({"most": 0.5}, {"least": 2.0}):
        for value in (1.0, float("nan")):
            with pytest.raises(AssertionError, match="again"):
                told({}.__setitem__, "speed", value, **bound, why="again")


def test_a_row_that_there_is_not_is_refused():
    item = SimpleNamespace(nodeid="mine", user_properties=[], iter_markers=lambda name: [SimpleNamespace(args=(99,))])
    with pytest.raises(pytest.UsageError, match="no row 99"):
        Rows().pytest_collection_modifyitems([item])
