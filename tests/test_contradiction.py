"""The polyhedron of contradictions, its walks and what they show, against scipy's HiGHS on the primal side."""

import itertools

import numpy as np
import pytest
from scipy.optimize import linprog

from wbc.contradiction import Contradictions
from wbc.errors import SolverError
from wbc.kernels.simplex import lower


def drawn(seed, whole=False):
    """Rows A x <= b of norm 1 and E x = e that hold together in no x; of small whole numbers many meet in a vertex. Of
    every other seed two columns are the same, and so are two of the equalities."""
    rng = np.random.default_rng(seed)
    n, k = int(rng.integers(3, 12)), int(rng.integers(0, 3))
    while True:
        if whole:
            A, b = rng.integers(-1, 2, (4 * n, n)).astype(float), rng.integers(-1, 2, 4 * n).astype(float)
        else:
            A, b = rng.normal(size=(3 * n, n)), rng.normal(size=3 * n)
        E = rng.normal(size=(k, n))
        if seed % 2:
            A[:, 0], E[:, 0] = A[:, 1], E[:, 1]
            E = np.concatenate((E, E[:1]))
        norm = np.linalg.norm(A, axis=1)
        A, b = A[norm > 0.0] / norm[norm > 0.0, None], b[norm > 0.0] / norm[norm > 0.0]
        e = E @ rng.normal(size=n)
        if linprog(np.zeros(n), A, b, E if len(E) else None, e if len(E) else None, (None, None)).status == 2:
            return A, b, E, e


def least(cost, A, b, E, e):
    """min s with A x <= b + cost s, E x = e; None where no s is enough."""
    n = A.shape[1]
    more = (np.c_[E, np.zeros(len(E))], e) if len(E) else (None, None)
    found = linprog(np.eye(n + 1)[n], np.c_[A, -cost], b, *more, [(None, None)] * n + [(0, None)])
    assert found.status in (0, 2)
    return found.x[n] if found.status == 0 else None


@pytest.mark.parametrize("whole", [False, True], ids=["apart", "together"])
@pytest.mark.parametrize("seed", range(20))
def test_each_walk_ends_at_the_least(seed, whole):
    """Also after other walks, and among some of the rows."""
    A, b, E, e = drawn(seed, whole)
    every, rng, m = Contradictions(A, b, E, e), np.random.default_rng(seed), len(b)
    on = np.ones(m, bool)
    for k in range(12):
        if k == 6:
            on = (every.y > 0.0) | (rng.random(m) < 0.3)
            every.within(on)
        cost = np.where(rng.random(m) < 0.2, rng.uniform(0.1, 2.0, m), 0.0)
        cost[rng.integers(m)] = 1.0
        shares = []
        for y in every.walk(cost):
            assert every.proves(y)
            assert not y[~on].any()
            shares.append(y @ cost)
        assert all(after <= before + 1e-12 for before, after in itertools.pairwise(shares))
        s = least(cost[on], A[on], b[on], E, e)
        if s is None:
            assert shares[-1] == 0.0
            assert np.isnan(every.needs(cost[None])[0])
        else:
            assert every.needs(cost[None])[0] == pytest.approx(s, rel=1e-6, abs=1e-6)


@pytest.mark.parametrize("seed", range(10))
def test_nothing_is_shown_short_of_the_least(seed):
    """Where one stands costs are either at their least, which scipy confirms, or nothing is said of them."""
    A, b, E, e = drawn(seed)
    every, costs = Contradictions(A, b, E, e), np.eye(len(b))
    told = every.needs(costs)
    assert np.isnan(told[every.y == 0.0]).all()
    for k in np.flatnonzero(np.isfinite(told)):
        assert told[k] == pytest.approx(least(costs[k], A, b, E, e), rel=1e-6, abs=1e-6)


@pytest.mark.parametrize("seed", range(10))
def test_a_spoiled_tableau_shows_nothing_and_is_made_anew(seed):
    A, b, E, e = drawn(seed)
    every = Contradictions(A, b, E, e)
    costs = np.eye(len(b))[every.y > 0.0]
    told = every.needs(costs)
    every._table *= 1.0 + 1e-3 * np.random.default_rng(seed).normal(size=every._table.shape)
    assert not every.proves(every.y)
    assert np.isnan(every.needs(costs)).all()
    every.proven()
    np.testing.assert_allclose(every.needs(costs), told, rtol=1e-9)
    every._whole *= 1.0 + 1e-3 * np.random.default_rng(seed).normal(size=every._whole.shape)
    every.refresh()
    with pytest.raises(SolverError):
        every.proven()


def test_rows_that_hold_together_do_not_contradict():
    assert Contradictions(np.eye(2), np.ones(2), np.zeros((0, 2)), np.zeros(0)).empty


def test_equalities_that_contradict_one_another_are_told():
    """They always hold, by what they say of themselves: no row is at fault."""
    with pytest.raises(SolverError):
        Contradictions(np.eye(2), np.ones(2), np.array([[1.0, 0.0], [1.0, 0.0]]), np.array([0.0, 1.0]))


def test_pivots_do_not_go_round():
    """Beale's program (1955), at whose first vertex pivots of no step can go round in circles."""
    A = np.array([[0.25, -60.0, -0.04, 9.0], [0.5, -90.0, -0.02, 3.0], [0.0, 0.0, 1.0, 0.0]])
    cost, b = np.array([-0.75, 150.0, -0.02, 6.0]), np.array([0.0, 0.0, 1.0])
    table = np.zeros((4, 8))
    table[:3, :4], table[:3, 4:7], table[:3, 7], table[3, :4] = A, np.eye(3), -b, cost
    basis = np.array([4, 5, 6])
    while lower(table, basis, np.ones(7, bool), 1e-9):
        pass
    x = np.zeros(7)
    x[basis] = -table[:3, -1]
    assert cost @ x[:4] == pytest.approx(linprog(cost, A, b).fun)
    assert linprog(cost, A, b).fun == pytest.approx(-0.05)
