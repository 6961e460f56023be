"""What the campaign is worth: bugs planted in the package, one at a time, are caught and named; without one it is
silent. One: `pytest tests/test_planted.py -k "no limit of the torque rate"`."""

from __future__ import annotations

import pytest
from planted import BUGS, planted

from wbc.campaign import CASES, INVARIANTS
from wbc.campaign.runner import built_of, case_of, run_one

SEEDS = range(1, 41)


def hunted(bug, seeds=SEEDS):
    """(seed, failure) of the first seed that catches a bug, or None."""
    cases = [case._replace(changes=(*case.changes, *bug.changes)) for case in CASES]
    for seed in seeds:
        case = case_of(cases, seed)
        built_of(case)
        with planted(bug):
            failure = run_one(case, seed).failure
        if failure is not None:
            return seed, failure
    return None


@pytest.mark.row("planted")
@pytest.mark.parametrize("bug", BUGS, ids=lambda bug: bug.name)
def test_a_planted_bug_is_caught_and_named(bug, record_property):
    found = hunted(bug)
    assert found is not None, f"{bug.name}: not found in {len(SEEDS)} seeds"
    seed, failure = found
    record_property("named", failure.invariant)
    print(f"{bug.name}: {failure.invariant}, seed {seed}: {failure.told}")
    assert failure.invariant in bug.by.split(), failure


def test_there_are_enough_of_them_and_each_has_a_name():
    assert len(BUGS) >= 20
    assert len({bug.name for bug in BUGS}) == len(BUGS)
    assert all(name in INVARIANTS for bug in BUGS for name in bug.by.split())


def test_without_a_bug_the_same_seeds_are_silent():
    for changes in {bug.changes for bug in BUGS}:
        for seed in (1, 2, 3, 4):
            case = case_of(CASES, seed)
            case = case._replace(changes=(*case.changes, *changes))
            assert run_one(case, seed).failure is None, case.repeat(seed)
