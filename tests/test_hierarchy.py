"""Strict priorities against a cascade of their own: an elastic problem at a time, each solved by another method."""

import os

import numpy as np
import pytest

from wbc.build import build
from wbc.controller import Controller
from wbc.errors import LawError
from wbc.hierarchy import Level, level, shortest, solve
from wbc.ladder import Status
from wbc.qp import Problem, Rows, Variables, certify
from wbc.reference import hold
from wbc.robot import Robot
from wbc.solver import TOLERANCE, Daqp, make
from wbc.spec import load
from wbc.task.motion import MotionTask
from wbc.task.posture import PostureTask

LARGE = os.environ.get("WBC_CAMPAIGN") == "large"
COUNT = 500 if LARGE else 60


def hierarchy(seed):
    """Random hard rows that a known point satisfies, and 2 to 4 levels that quarrel; some rows are intervals."""
    rng = np.random.default_rng([seed, 7])
    n, depth = int(rng.integers(6, 16)), int(rng.integers(2, 5))
    inside, m, n_eq = rng.normal(size=n), int(rng.integers(4, 12)), int(rng.integers(0, 4))
    C = rng.normal(size=(m, n))
    if n_eq > 1 and rng.random() < 0.5:
        C[n_eq - 1] = C[0] * 2.0  # redundant
    at, width = C @ inside, rng.exponential(0.7, size=m)
    lo, hi = at - width * rng.random(m), at + width * rng.random(m)
    lo[:n_eq] = hi[:n_eq] = at[:n_eq]
    big = np.full(n, np.inf)
    stack = np.concatenate((np.eye(n), C))
    problem = Problem(stack[:n], np.zeros(n), stack[n:], np.r_[-big, lo], np.r_[big, hi], n_eq, stack)
    levels = []
    for i in range(depth):
        rows = int(rng.integers(1, 6)) if i < depth - 1 else n
        A, b = rng.normal(size=(rows, n)), rng.normal(size=rows) * 2.0
        if levels and rng.random() < 0.3:
            A[0] = levels[-1].A[0]  # asks what the level above has decided, for something else
        up = b.copy()
        up[rng.random(rows) < (0.4 if i < depth - 1 else 0.0)] += rng.exponential(1.0)
        levels.append(Level(A, b, up))
    return problem, levels


def cascade(problem, levels):
    """What is left of each level by an interior point method on the whole problem, with a slack for every row.

    Nothing is eliminated: levels above are held as rows, at what was left of them.
    """
    n, n_eq = problem.g.size, problem.n_eq
    E, e = [problem.C[:n_eq]], [problem.lo[n : n + n_eq]]
    G, lo, hi = [problem.C[n_eq:]], [problem.lo[n + n_eq :]], [problem.hi[n + n_eq :]]
    left = []
    for rows in levels:
        m, equal = len(rows.lo), rows.lo == rows.hi
        own = np.hstack((rows.A, -np.eye(m)))
        equalities = np.concatenate((widened(np.concatenate(E), m), own[equal]))
        unequal = np.concatenate((widened(np.concatenate(G), m), own[~equal]))
        x = interior_point(
            np.diag(np.r_[np.zeros(n), np.ones(m)]),
            np.concatenate((equalities, unequal, -unequal)),
            np.concatenate((*e, rows.lo[equal], *hi, rows.hi[~equal], -np.concatenate(lo), -rows.lo[~equal])),
            len(equalities),
        )[:n]
        at = rows.A @ x
        off = np.where(equal, at - rows.lo, at - np.clip(at, rows.lo, rows.hi))
        left.append(off)
        fixed = equal | (np.abs(off) > 1e-7)
        E.append(rows.A[fixed])
        e.append(at[fixed])
        G.append(rows.A[~fixed])
        lo.append(rows.lo[~fixed])
        hi.append(rows.hi[~fixed])
    return left


def interior_point(P, A, b, n_eq):
    clarabel, sparse = pytest.importorskip("clarabel"), pytest.importorskip("scipy.sparse")
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    settings.tol_gap_abs = settings.tol_gap_rel = settings.tol_feas = 1e-12
    cones = [clarabel.ZeroConeT(n_eq), clarabel.NonnegativeConeT(len(b) - n_eq)]
    found = clarabel.DefaultSolver(
        sparse.csc_matrix(P), np.zeros(len(P)), sparse.csc_matrix(A), b, cones, settings
    ).solve()
    x, z = np.array(found.x), np.array(found.z)
    # the rows that bind, as equalities: exact where the method stops at 1e-8
    bind = np.r_[np.ones(n_eq, bool), z[n_eq:] > 1e-6]
    K = np.block([[P, A[bind].T], [A[bind], np.zeros((bind.sum(), bind.sum()))]])
    exact = np.linalg.lstsq(K, np.r_[np.zeros(len(P)), b[bind]], rcond=1e-13)[0][: len(P)]
    sound = (A[n_eq:] @ exact <= b[n_eq:] + 1e-9).all() and np.abs(A[:n_eq] @ exact - b[:n_eq]).max(initial=0.0) < 1e-9
    return exact if sound and np.abs(P @ (exact - x)).max() < 1e-4 else x


def widened(A, m):
    return np.hstack((A, np.zeros((len(A), m))))


@pytest.mark.parametrize("name", ["daqp", "proxqp"])
def test_each_level_is_at_the_lexicographic_optimum(name):
    worst, refused = 0.0, []
    for seed in range(COUNT if name == "daqp" else COUNT // 4):
        problem, levels = hierarchy(seed)
        solution, left = solve(problem, levels, make(name))
        if not solution.accepted:
            refused.append((seed, solution.reason))
            continue
        for ours, theirs in zip(left, cascade(problem, levels), strict=True):
            worst = max(worst, float(np.abs(ours - theirs).max()))
        n = problem.g.size
        value = problem.C @ solution.x
        assert (value >= problem.lo[n:] - 1e-8).all()
        assert (value <= problem.hi[n:] + 1e-8).all()
    assert not refused
    assert worst < (1e-6 if name == "daqp" else 1e-5)  # ProxQP stops at 1e-9 of the gradient, not of the residual


class Edge:
    """DAQP, as far off as the certificate lets it: along the weakest direction, or a random one."""

    def __init__(self, rng):
        self.inner, self.rng = Daqp(), rng

    def solve(self, problem):
        x, z = self.inner.solve(problem)
        weakest = np.linalg.eigh(problem.H)[1][:, 0] * self.rng.choice([-1.0, 1.0])
        d = weakest if self.rng.random() < 0.5 else self.rng.normal(size=x.size)
        most = 0.0
        for size in np.logspace(-12, 3, 46):
            if not certify(problem, x + size * d, z).holds(TOLERANCE):
                break
            most = size
        return x + most * d, z


def test_what_the_certificate_lets_through_at_one_level_takes_nothing_from_another(rng):
    """An interval that an answer only just leaves is not decided: the levels below keep what it leaves free."""
    for seed in range(COUNT):
        problem, levels = hierarchy(seed)
        _, exact = solve(problem, levels, Daqp())
        solution, left = solve(problem, levels, Edge(rng))
        assert solution.accepted
        assert max(np.abs(ours - theirs).max() for ours, theirs in zip(left, exact, strict=True)) < 1e-3, seed


def test_a_lower_level_moves_no_residual_above(rng):
    for seed in range(10):
        problem, levels = hierarchy(seed)
        _, before = solve(problem, levels, make("daqp"))
        last = levels[-1]
        _, after = solve(problem, [*levels[:-1], last._replace(lo=last.lo + 5.0, hi=last.hi + 5.0)], make("daqp"))
        for one, other in zip(before[:-1], after[:-1], strict=True):
            np.testing.assert_allclose(one, other, atol=1e-8)


def test_multipliers_tell_the_hard_rows_that_bend_a_level():
    n = 2
    stack = np.concatenate((np.eye(n), [[1.0, 0.0], [0.0, 1.0]]))
    big = np.full(n, np.inf)
    problem = Problem(stack[:n], np.zeros(n), stack[n:], np.r_[-big, -1, -1], np.r_[big, 1, 1], 0, stack)
    goal = np.array([3.0, 0.5])
    solution, (left,) = solve(problem, [Level(np.eye(n), goal, goal)], make("daqp"))
    np.testing.assert_allclose(solution.x, [1.0, 0.5], atol=1e-9)
    np.testing.assert_allclose(left, [-2.0, 0.0], atol=1e-9)
    np.testing.assert_allclose(solution.z, [0, 0, 2.0, 0], atol=1e-9)


def test_weights_stand_within_a_level():
    problem, _ = hierarchy(0)
    n = problem.g.size
    free = problem._replace(lo=np.full(problem.lo.size, -np.inf), hi=np.full(problem.hi.size, np.inf), n_eq=0)
    variables, goal = Variables({"x": n}), np.ones(n)
    costs = [(Rows("", {"x": None}, goal, goal), 3.0), (Rows("", {"x": None}, -goal, -goal, np.diag(goal)), 1.0)]
    solution, _ = solve(free, [level(costs, variables)], make("daqp"))
    np.testing.assert_allclose(solution.x, 0.5 * goal, atol=1e-9)


def test_contradicting_equalities_are_said():
    n = 3
    stack = np.concatenate((np.eye(n), [[1.0, 0, 0], [1.0, 0, 0]]))
    big = np.full(n, np.inf)
    problem = Problem(stack[:n], np.zeros(n), stack[n:], np.r_[-big, 0, 1], np.r_[big, 0, 1], 2, stack)
    solution, _ = solve(problem, [Level(np.eye(n), np.zeros(n), np.zeros(n))], make("daqp"))
    assert not solution.accepted
    assert "contradict" in solution.reason


@pytest.mark.parametrize(
    ("m", "n", "rank"), [(4, 9, 4), (4, 9, 3), (9, 4, 4), (9, 4, 2), (5, 5, 5), (3, 6, 0), (0, 3, 0)]
)
@pytest.mark.parametrize("size", [1e-6, 1.0, 1e6])
def test_shortest(rng, m, n, rank, size):
    """As numpy's singular values have it, whatever the rank."""
    A, b = size * rng.normal(size=(m, rank)) @ rng.normal(size=(rank, n)), rng.normal(size=m)
    x, Z = shortest(A, b)
    assert Z.shape == (n, n - rank)
    np.testing.assert_allclose(x, np.linalg.lstsq(A, b, rcond=1e-10)[0], rtol=1e-9, atol=1e-11 / size)
    np.testing.assert_allclose(A @ Z, 0.0, atol=1e-12 * size)
    np.testing.assert_allclose(Z.T @ Z, np.eye(n - rank), atol=1e-13)


# --- in the tick ---


@pytest.mark.parametrize("name", ["eraser", "go2_stand"])
def test_strict_levels_that_do_not_quarrel_are_the_weighted_answer(name):
    spec = load(name)
    weighted, strict = (build(spec.model_copy(update={"hierarchy": kind})) for kind in ("weighted", "strict"))
    q, v = weighted.q, np.zeros(weighted.robot.nv)
    for built in (weighted, strict):
        built.controller.reset(q, v)
    one, other = (built.controller.step(0.0, q, v) for built in (weighted, strict))
    assert other.status in (Status.OK, Status.LIMITED), other.reason
    np.testing.assert_allclose(other.tau, one.tau, atol=1e-6 * (1 + np.abs(one.tau).max()))


def test_what_a_lower_task_wants_moves_no_higher_one():
    """Two motions of one frame that contradict each other: strict, the second gets what the first leaves."""
    made = {}
    for kind in ("weighted", "strict"):
        robot = Robot.load("panda")
        q = robot.keyframes["home"]
        here = robot.state(q, np.zeros(7)).frame("flange").T
        tasks = {}
        for i, x in enumerate((0.1, -0.3)):
            goal = here.copy()
            goal.translation = here.translation + np.array([x, 0.0, 0.0])
            tasks[f"go{i}"] = (MotionTask("flange", hold(goal), 50.0, 14.0), 1.0, 1 + i)
        tasks["posture"] = (PostureTask(q), 1.0, 3)
        controller = Controller(robot, tasks=tasks, hierarchy=kind)
        controller.reset(q, np.zeros(7))
        out = controller.step(0.0, q, np.zeros(7))
        assert out.status is Status.OK, out.reason
        first = tasks["go0"][0]
        state = robot.state(q, np.zeros(7))
        made[kind] = np.abs(
            state.frame("flange").J @ out.vdot + state.frame("flange").drift - first.acceleration(state)
        ).max()
    assert made["strict"] < 1e-6
    assert made["weighted"] > 1e-4  # a thousandth of the weight still pulls


def test_levels_need_a_known_hierarchy():
    with pytest.raises(LawError, match="strict"):
        Controller(Robot.load("panda"), hierarchy="lexicographic")
