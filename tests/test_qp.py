"""Assembly against a dense naive one, and the certificate against every way to be wrong."""

from __future__ import annotations

import numpy as np
import pytest

from wbc.errors import ProblemError
from wbc.qp import UNCERTIFIED, Certificate, Problem, Rows, Variables, Workspace, certify

TOLERANCE = Certificate(1e-6, 1e-6, 1e-6)
SIZES = {"vdot": 7, "left": 3, "right": 4, "slack": 3}


def spd(rng, m):
    A = rng.normal(size=(m, m))
    return A @ A.T / m + 0.1 * np.eye(m)


def random_rows(rng, name, m, names, kind):
    """m rows over `names`, the identity where a variable has that size and luck has it."""
    A = {v: None if SIZES[v] == m and rng.random() < 0.5 else rng.normal(size=(m, SIZES[v])) for v in names}
    lo = rng.normal(size=m)
    if kind == "cost":
        return Rows(name, A, lo, lo, spd(rng, m) if rng.random() < 0.7 else None)
    if kind == "equality":
        return Rows(name, A, lo, lo)
    hi = lo + rng.uniform(0.1, 2.0, m)
    lo[rng.random(m) < 0.3], hi[rng.random(m) < 0.3] = -np.inf, np.inf
    return Rows(name, A, lo, hi)


def some(rng):
    return list(rng.permutation(list(SIZES))[: rng.integers(1, 4)])


def random_blocks(rng):
    """Hard rows of all kinds in any order; a second box on one variable is an inequality."""
    sizes = rng.integers(1, 5, size=6)
    hard = [random_rows(rng, f"equal{i}", m, some(rng), "equality") for i, m in enumerate(sizes[:2])]
    hard += [random_rows(rng, f"range{i}", m, [*some(rng), "vdot"], "range") for i, m in enumerate(sizes[2:])]
    for name, variable in (("box", "left"), ("again", "left"), ("other", "slack")):
        lo = rng.normal(size=SIZES[variable])
        hard.append(Rows(name, {variable: None}, lo, lo + 1.0))
    return [hard[i] for i in rng.permutation(len(hard))]


def dense(A, m):
    """(m, n) of named blocks, spelled out."""
    blocks = []
    for name, size in SIZES.items():
        block = A.get(name, np.zeros((m, size)))
        blocks.append(np.eye(m) if block is None else block)
    return np.concatenate(blocks, axis=1)


def naive(soft, hard):
    """The problem of weighted costs and hard rows, all of it dense, and the names of the rows of C."""
    n = sum(SIZES.values())
    H, g, lo, hi = np.zeros((n, n)), np.zeros(n), np.full(n, -np.inf), np.full(n, np.inf)
    for rows, weight in soft:
        A, W = dense(rows.A, rows.lo.size), np.eye(rows.lo.size) if rows.metric is None else rows.metric
        H += weight * A.T @ W @ A
        g -= weight * A.T @ W @ rows.lo
    equal, ranges, boxed = [], [], set()
    for rows in hard:
        variable, A = next(iter(rows.A.items()))
        if rows.lo is rows.hi:
            equal.append(rows)
        elif len(rows.A) == 1 and A is None and variable not in boxed:
            boxed.add(variable)
            place = Variables(SIZES)[variable]
            lo[place], hi[place] = rows.lo, rows.hi
        else:
            ranges.append(rows)
    stacked = equal + ranges
    C = np.concatenate([dense(rows.A, rows.lo.size) for rows in stacked])
    lo, hi = (
        np.concatenate([box, *(getattr(rows, side) for rows in stacked)]) for box, side in ((lo, "lo"), (hi, "hi"))
    )
    n_eq = sum(rows.lo.size for rows in equal)
    return Problem(H, g, C, lo, hi, n_eq, np.concatenate((H, C))), stacked


@pytest.mark.parametrize("seed", range(30))
def test_assembly_is_the_dense_one(seed):
    rng = np.random.default_rng(seed)
    hard = random_blocks(rng)
    workspace = Workspace(Variables(SIZES), hard)
    for _ in range(3):  # storage is reused: the second tick must not remember the first
        hard = [
            rows._replace(lo=(lo := rows.lo + 0.1), hi=lo if rows.hi is rows.lo else rows.hi + 0.1) for rows in hard
        ]
        soft = [(random_rows(rng, "", rng.integers(1, 8), some(rng), "cost"), rng.uniform(0.1, 9)) for _ in range(4)]
        soft.append((random_rows(rng, "", 7, ["vdot"], "cost"), 1.0))
        workspace.clear()
        for rows, weight in soft:
            workspace.minimise(rows, weight)
        for rows in hard:
            workspace.constrain(rows)
        expected, stacked = naive(soft, hard)
        for name, value, wanted in zip(Problem._fields, workspace.problem, expected, strict=True):
            np.testing.assert_allclose(value, wanted, atol=1e-12, err_msg=name)
        x = rng.normal(size=sum(SIZES.values()))
        for rows in stacked:
            np.testing.assert_allclose(workspace.product(rows.name, x), dense(rows.A, rows.lo.size) @ x, atol=1e-12)
        assert workspace.fault() == ""


def test_a_copy_outlives_the_tick(rng):
    workspace = Workspace(Variables(SIZES), random_blocks(rng))
    workspace.minimise(random_rows(rng, "", 7, ["vdot"], "cost"), 1.0)
    kept = workspace.problem.copy()
    before = [np.array(value) for value in kept]
    workspace.clear()
    workspace.problem.lo[:] = 7.0
    for old, new in zip(before, kept, strict=True):
        np.testing.assert_array_equal(old, new)
    assert kept.stack.base is None
    assert np.shares_memory(kept.stack, kept.H)
    assert not np.shares_memory(kept.stack, workspace.problem.stack)


ZERO, ONE = np.zeros(2), np.ones(2)
BAD_ROWS = {
    "no variable named 'foot'; there are vdot, left": [Rows("r", {"foot": np.ones((2, 3))}, ZERO, ONE)],
    r"rows 'r': A\['vdot'\] has shape \(2, 6\), expected \(2, 7\)": [Rows("r", {"vdot": np.ones((2, 6))}, ZERO, ONE)],
    r"rows 'r': A\['vdot'\] has shape \(7,\), expected \(2, 7\)": [Rows("r", {"vdot": np.ones(7)}, ZERO, ZERO)],
    r"rows 'b': A\['left'\] the identity has shape \(2, 2\), expected": [Rows("b", {"left": None}, ZERO, ONE)],
    r"rows 'r': lo has shape \(2,\), hi \(3,\)": [Rows("r", {"vdot": np.ones((2, 7))}, ZERO, np.ones(3))],
    r"rows 'r': lo has shape \(2, 1\)": [Rows("r", {"vdot": np.ones((2, 7))}, ZERO[:, None], ONE[:, None])],
    "rows 'r': 1 labels for 2 rows": [Rows("r", {"vdot": np.ones((2, 7))}, ZERO, ONE, labels=("a",))],
    "need names of their own, got r, r": [Rows("r", {"vdot": np.ones((2, 7))}, ZERO, ONE)] * 2,
}


@pytest.mark.parametrize("message", BAD_ROWS)
def test_rows_that_do_not_fit_are_refused_at_construction(message):
    with pytest.raises(ProblemError, match=message):
        Workspace(Variables(SIZES), BAD_ROWS[message])


def labelled():
    torque = Rows("torque", {"vdot": np.eye(2), "foot": np.eye(2)}, ZERO, ONE, labels=("torque[a]", "torque[b]"))
    held = Rows("foot", {"vdot": np.ones((1, 2))}, (zero := np.zeros(1)), zero)
    bound = Rows("joint", {"vdot": None}, ZERO, ONE, labels=("joint[a]", "joint[b]"))
    workspace = Workspace(Variables({"vdot": 2, "foot": 2}), [torque, bound, held])
    for rows in (torque, held, bound):
        workspace.constrain(rows)
    return workspace


def test_labels_name_bounds_then_equalities_then_the_rest():
    bounds = ["joint[a]", "joint[b]", "foot[0]", "foot[1]"]
    assert labelled().labels == [*bounds, "foot[0]", "torque[a]", "torque[b]"]


@pytest.mark.parametrize("place", ["lo", "hi"])
@pytest.mark.parametrize("value", ["nan", "crossed"])
def test_fault_names_the_row_that_no_value_satisfies(place, value):
    for i, label in ((1, "joint[b]"), (6, "torque[b]")):
        workspace = labelled()
        assert workspace.fault() == ""
        wrong = np.nan if value == "nan" else 2.0 if place == "lo" else -1.0
        getattr(workspace.problem, place)[i] = wrong
        assert workspace.fault() == f"no value satisfies {label}: its bounds cross or are not numbers"


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("name", ["H", "g", "C"])
def test_fault_sees_a_coefficient_that_is_not_finite(name, value):
    workspace = labelled()
    array = getattr(workspace.problem, name)
    for i in range(array.size):
        array.flat[i] = value
        assert workspace.fault() == "a coefficient of the problem is not finite"
        array.flat[i] = 0.0
    assert workspace.fault() == ""


def test_active_leaves_out_equalities_and_rounding():
    workspace = labelled()
    z = np.array([0.0, -2.0, 0.0, 1e-12, 5.0, 0.0, 3.0])  # foot[0] (4) is an equality
    assert [workspace.labels[i] for i in workspace.active(z)] == ["joint[b]", "torque[b]"]


# --- the certificate ---


def certain(rng, n=8, n_eq=2, m=8):
    """A problem built around its answer (x, z): every bound and row that z holds is met with equality."""
    x, z = rng.normal(size=n), np.zeros(n + m)
    stack = np.concatenate((spd(rng, n), rng.normal(size=(m, n))))
    H, C = stack[:n], stack[n:]
    value = np.concatenate((x, C @ x))
    lo, hi = value - rng.uniform(0.1, 2.0, n + m), value + rng.uniform(0.1, 2.0, n + m)
    lo[n : n + n_eq] = hi[n : n + n_eq] = value[n : n + n_eq]
    z[n : n + n_eq] = rng.normal(size=n_eq)
    for i in (0, 1, n + n_eq, n + n_eq + 1):
        z[i] = rng.uniform(0.5, 2.0) * (-1) ** i
        (hi if z[i] > 0 else lo)[i] = value[i]
    lo[2], hi[3] = -np.inf, np.inf
    g = -H @ x - z[:n] - C.T @ z[n:]
    return Problem(H, g, C, lo, hi, n_eq, stack), x, z


@pytest.mark.parametrize("seed", range(20))
def test_the_answer_passes_and_every_mutation_of_it_is_refused(seed):
    rng = np.random.default_rng(seed)
    problem, x, z = certain(rng)
    n, first = x.size, x.size + problem.n_eq
    assert max(certify(problem, x, z)) < 1e-12

    def refused(x, z):
        return not certify(problem, x, z).holds(TOLERANCE)

    for i in range(n):
        for step in (1e-4, -1e-4):
            assert refused(x + step * np.eye(n)[i], z), f"x[{i}] moved by {step}"
    for i in range(z.size):
        for step in (1e-4, -1e-4):
            assert refused(x, z + step * np.eye(z.size)[i]), f"z[{i}] moved by {step}"
    for i in z.nonzero()[0]:
        flipped = z.copy()
        flipped[i] *= -1
        assert refused(x, flipped), f"z[{i}] of the other sign"
    assert refused(x, -z)
    assert refused(x, np.zeros_like(z))
    assert refused(np.zeros_like(x), np.zeros_like(z))
    other = certain(rng)
    assert refused(other[1], z)
    assert refused(other[1], other[2])
    later = problem._replace(g=problem.g + 0.01)
    assert not certify(later, x, z).holds(TOLERANCE), "a stale answer"
    # a multiplier of the wrong sign with x and the stationarity made to fit: only the sign tells
    i = next(i for i in z.nonzero()[0] if i >= first)
    wrong = z.copy()
    wrong[i] *= -1
    fitting = problem._replace(g=problem.g + 2 * z[i] * problem.C[i - n])
    certificate = certify(fitting, x, wrong)
    assert max(certificate.primal, certificate.dual) < 1e-12
    assert certificate.gap > 0.01


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_what_is_not_finite_is_refused_wherever_it_stands(rng, value):
    problem, x, z = certain(rng)
    with np.errstate(invalid="ignore"):
        for array in (x, z, problem.g, problem.stack):
            for i in range(array.size):
                kept, array.flat[i] = array.flat[i], value
                assert not certify(problem, x, z).holds(TOLERANCE)
                array.flat[i] = kept
        for array in (problem.lo, problem.hi):
            for i in range(array.size):
                if np.isnan(value):
                    kept, array[i] = array[i], value
                    assert not certify(problem, x, z).holds(TOLERANCE), "a bound that is not a number is no bound"
                    array[i] = kept
    assert certify(problem, x, z).holds(TOLERANCE)


def test_where_bounds_cross_no_answer_holds(rng):
    problem, x, z = certain(rng)
    value = np.concatenate((x, problem.C @ x))
    for i in range(value.size):
        for low, high in ((value[i] + 1, value[i]), (value[i], value[i] - 1), (value[i] + 1, value[i] - 1)):
            lo, hi = problem.lo.copy(), problem.hi.copy()
            lo[i], hi[i] = low, high
            assert certify(problem._replace(lo=lo, hi=hi), x, z).primal > 0.9


def test_shapes_that_do_not_fit_are_uncertified(rng):
    problem, x, z = certain(rng)
    for bad_x, bad_z in ((x[:-1], z), (x, z[:-1]), (x[:, None], z), (np.zeros(0), np.zeros(0))):
        assert certify(problem, bad_x, bad_z) is UNCERTIFIED
    assert not UNCERTIFIED.holds(TOLERANCE)


def test_infinite_bounds_hold_nothing(rng):
    problem, x, z = certain(rng)
    z[2] = -1.0  # at the lower bound, of which there is none
    fitting = problem._replace(g=-problem.H @ x - z[: x.size] - problem.C.T @ z[x.size :])
    assert certify(fitting, x, z).gap == np.inf
