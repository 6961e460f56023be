"""The corpus of recorded programs: what it holds, and every installed solver on it."""

from __future__ import annotations

import os
from collections import Counter
from contextlib import suppress

import numpy as np
import pytest
from scipy.optimize import linprog

from wbc.compare import compare, corpus, offered, picture
from wbc.compare.bound import Bound
from wbc.compare.record import INFEASIBLE
from wbc.errors import ProblemError, SolverError
from wbc.qp import certify
from wbc.solver import TOLERANCE, Daqp, answer, make

LARGE = os.environ.get("WBC_CAMPAIGN") == "large"
AGREE = 1e-6  # [N m]
EXACT = ("daqp", "daqp (plain)", "proxqp", "quadprog")  # within it whatever the scale... of all but ill-scaled ones
KINDS = {"easy": 60, "saturated": 60, "changing": 30, "redundant": 30, "ill-scaled": 30, INFEASIBLE: 30}  # at least


@pytest.fixture(scope="module")
def whole():
    return corpus.load()


@pytest.fixture(scope="module")
def sample(whole):
    """All of it at the full size, else one in eleven: every kind is among them."""
    chosen = whole if LARGE else whole[::11]
    assert {item.kind for item in chosen} == set(KINDS)
    return chosen


def feasible(problem):
    """By a linear program, which knows nothing of costs."""
    n, n_eq = problem.g.size, problem.n_eq
    G, equal = np.concatenate((np.eye(n), problem.C)), np.zeros(problem.lo.size, bool)
    equal[n : n + n_eq] = True
    up, down = np.isfinite(problem.hi) & ~equal, np.isfinite(problem.lo) & ~equal
    rows, most = np.concatenate((G[up], -G[down])), np.concatenate((problem.hi[up], -problem.lo[down]))
    E, e = (G[equal], problem.lo[equal]) if n_eq else (None, None)
    return linprog(np.zeros(n), rows, most, E, e, bounds=(None, None)).status == 0


# --- what it holds ---


def test_every_kind_is_there_and_it_is_small(whole):
    assert 200 <= len(whole) <= 500
    assert corpus.FILE.stat().st_size < 3e6
    count = Counter(item.kind for item in whole)
    assert set(count) == set(KINDS)
    assert all(count[kind] >= least for kind, least in KINDS.items()), count
    assert {item.problem.g.size for item in whole} >= {5, 7, 10, 27, 30, 47, 59}
    assert all(item.active for item in whole if item.kind == "saturated")


def test_what_is_called_infeasible_is_and_nothing_else(whole):
    for i, item in enumerate(whole if LARGE else whole[::7] + [x for x in whole if x.kind == INFEASIBLE][::4]):
        assert feasible(item.problem) == (item.kind != INFEASIBLE), (i, item.spec, item.kind)


def test_redundant_points_share_what_twelve_rows_could_hold(whole):
    eight = [item for item in whole if item.spec == "g1_points"]
    assert eight
    for item in eight:
        n, nv = item.problem.g.size, 35
        assert n - nv == 24
        assert np.linalg.matrix_rank(item.T[:, nv:]) <= 12


def test_a_file_holds_problems_bit_for_bit(whole, tmp_path):
    some = whole[::9]
    corpus.save(tmp_path / "some.npz", some)
    for one, other in zip(some, corpus.load(tmp_path / "some.npz"), strict=True):
        for before, after in zip(
            (*one.problem[:5], one.problem.stack, one.T, one.h),
            (*other.problem[:5], other.problem.stack, other.T, other.h),
            strict=True,
        ):
            assert before.tobytes() == after.tobytes()
        assert one.problem.n_eq == other.problem.n_eq
        assert (one.t, one.spec, one.active, one.kind) == (other.t, other.spec, other.active, other.kind)
        assert np.shares_memory(other.problem.H, other.problem.stack)


def test_its_recipe_makes_it_again(whole):
    """One run of the recipe, up to what another machine rounds otherwise."""
    number = [entry.spec for entry in corpus.RECIPE].index("planar")
    entry = corpus.RECIPE[number]
    again = corpus.make([entry])
    shipped = [item for item in whole if item.spec == entry.spec]
    assert len(again) == len(shipped) == entry.most
    for one, other in zip(again, shipped, strict=True):
        assert (one.t, one.kind, one.active) == (other.t, other.kind, other.active)
        np.testing.assert_allclose(one.problem.stack, other.problem.stack, atol=1e-8)
        np.testing.assert_allclose(one.problem.g, other.problem.g, atol=1e-6)


def test_it_loads_as_problems_of_qpsolvers(sample):
    import qpsolvers

    for item in sample:
        problem = item.qpsolvers()
        assert isinstance(problem, qpsolvers.Problem)
        if item.kind not in (INFEASIBLE, "ill-scaled") and problem.P.shape[0] < 40:
            x = qpsolvers.solve_problem(problem, "quadprog").x
            np.testing.assert_allclose(item.torque(x), item.torque(answer(Daqp(), item.problem).x), atol=AGREE)


@pytest.mark.parametrize("content", [b"", b"no npz", b"PK\x03\x04 broken"])
def test_a_file_that_is_none_is_said(tmp_path, content):
    (tmp_path / "x.npz").write_bytes(content)
    with pytest.raises(ProblemError, match=r"x\.npz: not a file of recorded problems"):
        corpus.load(tmp_path / "x.npz")
    with pytest.raises(ProblemError, match="not a file of recorded problems"):
        corpus.load(tmp_path / "missing.npz")
    with pytest.raises(ProblemError, match="no problems to write"):
        corpus.save(tmp_path / "y.npz", [])


# --- every solver ---


@pytest.mark.parametrize("name", offered())
def test_nothing_wrong_is_accepted_and_certified_answers_agree(sample, name):
    """With the settings of the controller and with the solver's own; DAQP answers beside it."""
    result = compare(sample, {"reference": "daqp", name: name}, passes=1)
    row = result["solvers"][name]
    assert result["ok"]
    assert row["accepted_wrong"] == 0
    assert list(row["growth"]) == [str(n) for n in sorted({i.problem.g.size for i in sample if i.kind != INFEASIBLE})]
    infeasible = row["kinds"][INFEASIBLE]
    assert infeasible["solved"] == 0
    assert infeasible["problems"] == sum(item.kind == INFEASIBLE for item in sample)
    if row["certified"]["tau_error"] is not None:
        assert row["certified"]["tau_error"] <= row["tolerance"]
    assert row["crashed"] == 0
    well = [item for item in sample if item.kind not in (INFEASIBLE, "ill-scaled")]
    solver = make(name)
    for item in well:
        found, best = answer(solver, item.problem), answer(Daqp(), item.problem)
        if found.accepted and not name.endswith("(default)"):
            most = AGREE if name in EXACT else 2e-5
            assert np.abs(item.torque(found.x) - item.torque(best.x)).max() <= most, (item.spec, item.t)
    if name.startswith("daqp"):
        assert row["solved"] == result["problems"] - result["infeasible"]


@pytest.mark.parametrize("name", [name for name in offered() if name != "proxqp (default)"])
def test_no_solver_writes_to_a_problem(sample, name):
    """Those that the controller trusts in this, and all others; of infeasible ones too."""
    solver = make(name)
    for item in sample:
        kept = item.problem.copy()
        with suppress(SolverError):
            solver.solve(item.problem)
        for before, after in zip(kept, item.problem, strict=True):
            assert np.array_equal(before, after), (item.spec, item.t)


def test_a_liar_on_the_corpus_is_never_accepted(sample, rng):
    """Mutated answers, and claims where there is no answer at all: each is refused, and told as wrong."""

    class Liar:
        def __init__(self):
            self.inner = Daqp()

        def solve(self, problem):
            try:
                x, z = self.inner.solve(problem)
            except Exception:
                return np.zeros(problem.g.size), np.zeros(problem.lo.size)
            return x + 1e-2 * rng.choice([-1.0, 1.0], x.size), z

    result = compare(sample, {"daqp": "daqp", "liar": Liar()}, passes=1)
    row = result["solvers"]["liar"]
    assert (row["solved"], row["wrong"], row["accepted_wrong"]) == (0, len(sample), 0)


def test_what_is_accepted_on_an_infeasible_program_is_told(sample):
    """Were a certificate to hold there, the comparison would say so: the same program, said to be infeasible."""
    lied = [item._replace(kind=INFEASIBLE) for item in sample if item.kind == "easy"]
    result = compare(lied, ["daqp"], passes=1)
    assert not result["ok"]
    assert result["solvers"]["daqp"]["accepted_wrong"] == len(lied)


# --- the bound ---


def test_no_answer_is_off_by_more_than_its_residuals_allow(sample, rng):
    """Perturbed in x and in z, along the weakest directions too; and where it is accepted the bound means something."""
    tight = []
    for item in sample:
        if item.kind == INFEASIBLE:
            continue
        p, bound = item.problem, Bound(item)
        best = answer(Daqp(), p)
        H = p.H + p.C[: p.n_eq].T @ p.C[: p.n_eq]
        weak = np.linalg.eigh(H)[1][:, 0]
        for size in 10.0 ** rng.uniform(-7, 0, 6):
            for direction in (rng.normal(size=p.g.size), weak):
                x, z = best.x + size * direction, best.z.copy()
                if rng.random() < 0.5:  # an inequality's multiplier that it should not have
                    n = p.g.size
                    free = np.flatnonzero(np.isfinite(p.hi) & (np.arange(p.hi.size) >= n + p.n_eq))
                    if free.size:
                        z[rng.choice(free)] += size
                off = np.abs(item.torque(x) - item.torque(best.x)).max()
                allowed = bound(x, z, best.z) + bound(best.x, best.z, best.z)
                assert off <= allowed * (1 + 1e-6) + 1e-9, (item.spec, item.t, size)
        if item.kind == "easy":
            tight.append(bound(best.x, best.z, best.z))
            assert certify(p, best.x, best.z).holds(TOLERANCE)
    assert max(tight) < AGREE


# --- the picture ---


def test_the_picture_is_drawn(sample, tmp_path):
    from matplotlib.image import imread

    result = compare(sample[::3], ["daqp", "daqp (plain)", "proxqp", "osqp (default)"], passes=1)
    picture(result, tmp_path / "compare.png")
    pixels = imread(tmp_path / "compare.png")
    assert pixels.shape[:2] == (700, 1600)
    assert pixels[..., :3].std() > 0.05
    for row in result["solvers"].values():
        assert len(row["profile"]) == len(result["ratios"])
        assert (np.diff(row["profile"]) >= 0).all()
    assert sum(row["profile"][0] for row in result["solvers"].values()) >= 1.0  # someone is the fastest
