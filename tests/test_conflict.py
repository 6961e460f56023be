"""Irreducible infeasible sets of rows, against scipy's HiGHS."""

import numpy as np
import pytest
from conflicts import answered

from wbc.conflict import System

INF = np.inf


def system(C, lo, hi, names, E=None, e=None):
    n = C.shape[1]
    return System(C, lo, hi, names, np.zeros((0, n)) if E is None else E, np.zeros(0) if e is None else e)


def drawn(seed):
    """Twice as many one-sided rows as make an answer likely, some equalities among them, two rows a name."""
    rng = np.random.default_rng(seed)
    n = int(rng.integers(3, 20))
    C, hi = rng.normal(size=(3 * n, n)), rng.normal(size=3 * n)
    lo = np.where(np.arange(3 * n) < rng.integers(0, n // 2 + 1), hi, -INF)
    return C, lo, hi, [f"row{i // 2}" for i in range(3 * n)]


@pytest.mark.parametrize("seed", range(40))
def test_a_conflict_is_infeasible_and_each_of_its_names_is_needed(seed):
    C, lo, hi, names = drawn(seed)
    made = system(C, lo, hi, names)
    found = made.conflict()
    assert bool(found) != answered(C, lo, hi)
    if found:
        on = made.rows(found)
        assert not answered(C[on], lo[on], hi[on])
        for name in found:
            on = made.rows([each for each in found if each != name])
            assert answered(C[on], lo[on], hi[on])


@pytest.mark.parametrize("seed", range(40))
def test_what_a_name_needs_is_the_least_that_frees_all(seed):
    C, lo, hi, names = drawn(seed)
    made = system(C, lo, hi, names)
    for member in made.members():
        own = made.rows([member.name])
        rest = ~own
        assert member.frees == answered(C[rest], lo[rest], hi[rest])
        if member.frees:
            for share, holds in ((1.0 + 1e-5, True), (0.999, False)):
                room = own * (share * member.needs)
                assert answered(C, lo - room, hi + room) == holds


def test_dynamics_are_never_named():
    """x = y always, x <= 0 and y >= 1: the two bounds, each with the side on which it conflicts."""
    made = system(
        np.eye(2), np.array([-5.0, 1.0]), np.array([0.0, 9.0]), ["x", "y"], np.array([[1.0, -1.0]]), np.zeros(1)
    )
    found = made.members()
    assert {each.name: each.upper for each in found} == {"x": True, "y": False}
    assert [each.needs for each in found] == pytest.approx([1.0, 1.0], abs=1e-6)


def test_bounds_that_cross_are_a_conflict_of_one():
    made = system(np.eye(2), np.array([1.0, 0.0]), np.array([0.0, 1.0]), ["x", "y"])
    assert made.conflict() == ("x",)


def test_two_equalities_that_contradict_one_another():
    C, b = np.array([[1.0, 2.0], [2.0, 4.0], [0.0, 1.0]]), np.array([1.0, 3.0, 0.0])
    made = system(C, b, b.copy(), ["a", "b", "c"])
    assert set(made.conflict()) == {"a", "b"}
    assert {each.name: each.needs for each in made.members()} == pytest.approx({"a": 0.5, "b": 1.0}, abs=1e-5)


def test_all_that_hold_together_are_no_conflict():
    assert system(np.eye(2), -np.ones(2), np.ones(2), ["x", "y"]).conflict() == ()
