"""Compiled kernels against the formula in numpy, on contiguous, strided and read-only arrays."""

import numpy as np
import pinocchio as pin
import pytest

from wbc import kernels


def layouts(a):
    """The same numbers in all memory layouts that callers may bring."""
    strided = np.zeros([2 * s for s in a.shape])[tuple(slice(None, None, 2) for _ in a.shape)]
    strided[:] = a
    frozen = a.copy()
    frozen.flags.writeable = False
    return [a, np.asfortranarray(a), strided, frozen]


@pytest.fixture(params=range(4), ids=["C", "Fortran", "strided", "read-only"])
def layout(request):
    return lambda *arrays: [layouts(np.asarray(a, float))[request.param] for a in arrays]


def test_select_and_wanted(rng, layout):
    basis, table, out, bias = rng.normal(size=(5, 6)), rng.normal(size=(6, 9)), np.empty((5, 9)), np.empty(5)
    kernels.select(*layout(basis, table), out, bias)
    np.testing.assert_allclose(out, basis @ table, rtol=1e-12, atol=1e-14)
    np.testing.assert_array_equal(bias, -out[:, 7])
    free, y, b = rng.normal(size=(3, 6)), rng.normal(size=6), np.empty(5)
    kernels.wanted(*layout(free, y, bias), b)
    np.testing.assert_allclose(b, bias + np.r_[0, 0, free @ y], rtol=1e-12, atol=1e-14)


def test_spring(rng, layout):
    K, goal, at, rate, out = rng.normal(size=(3, 5)), *rng.normal(size=(2, 2)), rng.normal(size=3), np.empty(3)
    kernels.spring(*layout(K, goal, at, rate), out)
    np.testing.assert_allclose(out, K @ np.r_[goal - at, rate], rtol=1e-12, atol=1e-14)


@pytest.mark.parametrize("angle", [0.0, 1e-12, 1e-5, 0.0999, 0.1001, 1.0, 2.0, 3.0, np.pi - 1e-3, np.pi - 1e-7])
def test_log(rng, layout, angle):
    for axis in (*np.eye(3), *-np.eye(3), *rng.normal(size=(20, 3))):
        w, v, X = angle * axis / np.linalg.norm(axis), rng.normal(size=3), np.empty(6)
        T = pin.exp6(np.r_[v, w])
        kernels.log(*layout(T.rotation, T.translation), X)
        np.testing.assert_allclose(X, np.r_[w, v], atol=1e-13 if angle < 3.0 else 1e-8)
        np.testing.assert_allclose(pin.exp6(np.r_[X[3:], X[:3]]).homogeneous, T.homogeneous, atol=1e-14)


def test_active():
    z = np.array([0.0, 5.0, -5.0, 0.0, 1e-10])
    assert not kernels.active(z, 1, 3, 1e-9)
    assert kernels.active(z, 2, 3, 1e-9)
    assert kernels.active(-z, 1, 2, 1e-9)


def test_gauss(rng, layout):
    n, m = 9, 5
    B, G, b, vdot = rng.normal(size=(n, n)), rng.normal(size=(m, n)), rng.normal(size=m), rng.normal(size=n)
    M, x, K = B @ B.T + np.eye(n), np.empty(n), np.empty((m, m))
    assert kernels.gauss(*layout(M, G, b, vdot), x, K)
    Gbar = np.linalg.solve(M, G.T) @ np.linalg.inv(G @ np.linalg.solve(M, G.T))
    np.testing.assert_allclose(x, vdot + Gbar @ (b - G @ vdot), rtol=1e-11, atol=1e-12)
    np.testing.assert_allclose(K, G @ np.linalg.solve(M, G.T), rtol=1e-12, atol=1e-13)


@pytest.mark.parametrize("rows", [[0, 0], [0, 1, 0], [3]])
def test_gauss_says_when_rows_depend_on_one_another(rng, rows):
    G = np.vstack((rng.normal(size=(3, 6)), np.zeros((1, 6))))[rows]
    K = np.empty((len(rows), len(rows)))
    assert not kernels.gauss(np.eye(6), G, np.zeros(len(rows)), np.zeros(6), np.empty(6), K)
    np.testing.assert_allclose(K, G @ G.T, atol=1e-14)


def test_gauss_refuses_what_is_not_a_number(rng):
    for place in ("M", "G"):
        M, G = np.eye(3), rng.normal(size=(2, 3))
        {"M": M, "G": G}[place][1, 1] = np.nan
        assert not kernels.gauss(M, G, np.zeros(2), np.zeros(3), np.empty(3), np.empty((2, 2)))


def test_feedback_sense_advance_torque(rng, layout):
    K, a, b, out = rng.normal(size=(3, 5)), rng.normal(size=2), rng.normal(size=3), np.ones(3)
    kernels.feedback(*layout(K, a, b), out)
    np.testing.assert_allclose(out, 1.0 + K @ np.r_[a, b], rtol=1e-13)

    F, past, inverse, desired = (rng.normal(size=s) for s in (6, 6, (2, 6), 2))
    filtered, error = np.empty(6), np.empty(2)
    A, target = rng.normal(size=(2, 6)), rng.normal(size=2)
    given = layout(F, past), layout(inverse, desired, A, target)
    f_d = (A.T @ target)[3:]
    share = (past + 0.3 * (F - past))[3:] @ f_d / (f_d @ f_d)
    for least in (share - 1e-6, share + 1e-6):
        assert kernels.sense(*given[0], 0.3, *given[1], least, filtered, error) == (least < share)
    assert kernels.sense(*given[0], 0.3, *given[1][:3], np.zeros(2), 0.1, filtered, error)  # no force is wanted
    np.testing.assert_allclose(filtered, past + 0.3 * (F - past), rtol=1e-13, atol=1e-15)
    np.testing.assert_allclose(error, desired - inverse @ filtered, rtol=1e-12, atol=1e-14)

    lam, command, integral, step = (rng.normal(size=3) for _ in range(4))
    grown, missing = np.empty(3), np.empty(3)
    assert not kernels.advance(*layout(lam, command, integral, step), 0.1, True, grown, missing)
    np.testing.assert_allclose(grown, integral + 0.1 * step)
    np.testing.assert_allclose(missing, lam - command)
    assert kernels.advance(command * (1 + 1e-12), command, integral, step, 0.1, True, grown, missing)
    waiting, goes = np.array([2.0, -2.0, -0.01, 0.0]), np.array([1.0, 1.0, 1.0, 1.0])
    grown = np.empty(4)
    kernels.advance(command, command, *layout(waiting, goes), 0.1, False, grown, missing)
    np.testing.assert_allclose(grown, [2.0, -1.9, 0.0, 0.0])  # only towards zero, and no further

    A, x, h = rng.normal(size=(3, 4)), rng.normal(size=4), rng.normal(size=3)
    tau, value = np.empty(3), A @ x + h
    lo, hi = np.array([-9.0, value[1] + 0.1, -9.0]), np.array([9.0, 9.0, value[2] - 0.1])
    kernels.torque(*layout(A, x, h, lo, hi), tau)
    np.testing.assert_allclose(tau, [value[0], lo[1], hi[2]], rtol=1e-13)


def test_total_is_a_number_only_where_all_are():
    for n in range(10):
        assert kernels.total(np.arange(float(n))) == n * (n - 1) / 2
    for i in range(7):
        values = np.ones(7)
        values[i] = np.nan
        assert not np.isfinite(kernels.total(values))
        values[i], values[i - 1] = np.inf, -np.inf
        assert not np.isfinite(kernels.total(values))


def tree_inertia(rng, n):
    """A mass matrix with the zeros of two branches on one trunk."""
    L = np.tril(rng.normal(size=(n, n)), -1) + np.diag(rng.uniform(1.0, 2.0, n))
    half = n // 2
    L[half + 1 :, 2 : half + 1] = 0.0
    return L.T @ L


@pytest.mark.parametrize("n", [1, 2, 7, 18])
def test_inverse(rng, layout, n):
    A, out = tree_inertia(rng, n), np.empty((n, n))
    assert kernels.inverse(*layout(A), out)
    np.testing.assert_allclose(out @ A, np.eye(n), atol=1e-8 * np.linalg.cond(A))
    np.testing.assert_array_equal(out, out.T)


def test_inverse_says_what_has_none(rng):
    G, out = rng.normal(size=(4, 3)), np.full((4, 4), 7.0)
    for A in (G @ G.T, -np.eye(4), np.diag([1.0, np.nan, 1.0, 1.0])):
        assert not kernels.inverse(A, out)
    np.testing.assert_array_equal(out, 7.0)
    assert kernels.inverse(np.empty((0, 0)), np.empty((0, 0)))


@pytest.mark.parametrize("m", [0, 1, 5])
def test_mobility(rng, layout, m):
    n = 9
    M, G, lifted, K = tree_inertia(rng, n), rng.normal(size=(m, n)), np.empty((n, m)), np.empty((m, m))
    assert kernels.mobility(*layout(M, G), lifted, K)
    expected = np.linalg.solve(M, G.T)
    np.testing.assert_allclose(lifted, expected, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(K, G @ expected, rtol=1e-9, atol=1e-9)
    again = np.empty((m, m))
    assert kernels.mobility(M, G, np.empty((0, 0)), again)
    np.testing.assert_allclose(again, K, rtol=1e-13, atol=1e-13)
    assert not kernels.mobility(-M, G, lifted, K)
    assert np.isnan(lifted).all()
    assert np.isnan(K).all()


def test_within(rng, layout):
    """The Schur complement: the mobility of the last rows is that of the rows less what the first hold."""
    G, M, out = rng.normal(size=(7, 9)), tree_inertia(rng, 9), np.empty((2, 2))
    K = G @ np.linalg.solve(M, G.T)
    W, inertia = np.linalg.inv(K[:3, :3]), np.zeros((2, 2))
    assert kernels.within(*layout(K, W), 4, out, inertia)
    np.testing.assert_allclose(out, K[4:6, 4:6] - K[4:6, :3] @ W @ K[:3, 4:6], rtol=1e-10, atol=1e-10)
    np.testing.assert_allclose(inertia @ out, np.eye(2), atol=1e-9)
    assert not kernels.within(*layout(K, W), 2, out, inertia)  # a row that the first ones hold cannot move


def test_demand(rng, layout):
    G, rhs, rows, lo, hi = rng.normal(size=(3, 8)), rng.normal(size=3), np.empty((3, 8)), np.empty(3), np.empty(3)
    kernels.demand(*layout(G, rhs), rows, lo, hi)
    for got, wanted in ((rows, G), (lo, rhs), (hi, rhs)):
        np.testing.assert_array_equal(got, wanted)


def test_demands(rng, layout):
    tables, biases, rows = rng.normal(size=(4, 6, 10)), rng.normal(size=(4, 6)), np.empty((12, 8))
    lo, hi = np.empty((2, 12))
    kernels.demands(*layout(tables, biases), rows, lo, hi)
    np.testing.assert_array_equal(rows, tables[:, :3, :8].reshape(12, 8))
    np.testing.assert_array_equal([lo, hi], [biases[:, :3].ravel()] * 2)


def test_carried_along(rng, layout):
    R, h, g, drift = pin.exp3(rng.normal(size=3)), rng.normal(size=9), rng.normal(size=3), np.empty(3)
    kernels.carried_along(*layout(R, h, g), 12.0, drift)
    np.testing.assert_allclose(drift, R @ h[:3] / 12.0 + g, atol=1e-14)


def test_add_rows(rng, layout):
    A, B, target = rng.normal(size=(4, 6)), rng.normal(size=(4, 4)), rng.normal(size=4)
    A[:, 2], H, g = 0.0, np.ones((6, 6)), np.ones(6)
    for W in (B @ B.T, np.diag(rng.uniform(size=4))):
        before = H.copy(), g.copy()
        kernels.add_rows(*layout(A, W, target), 0.3, H, g)
        np.testing.assert_allclose(H - before[0], 0.3 * A.T @ W @ A, rtol=1e-12, atol=1e-13)
        np.testing.assert_allclose(g - before[1], -0.3 * A.T @ W @ target, rtol=1e-12, atol=1e-13)
    np.testing.assert_array_equal(H, H.T)


def test_settle(rng, layout):
    Adot_V, slip, start = rng.normal(size=4), np.array([-9.0, -0.01, 0.02, 9.0]), rng.normal(size=4)
    rhs = start.copy()
    kernels.settle(*layout(Adot_V, slip), 3.0, 0.5, rhs)
    np.testing.assert_allclose(rhs, start - Adot_V - np.clip(3.0 * slip, -0.5, 0.5), rtol=1e-13)


def test_equations(rng, layout):
    M, push, bias = rng.normal(size=(9, 9)), rng.normal(size=(4, 9)), rng.normal(size=9)
    base, joints, nothing = np.empty((6, 13)), np.empty((3, 13)), np.empty(6)
    kernels.equations(*layout(M, push, bias), base, joints, nothing)
    np.testing.assert_array_equal(np.r_[base, joints], np.c_[M, push.T])
    np.testing.assert_array_equal(nothing, -bias[:6])


def quadratic(rng, n=9, n_eq=4, others=3):
    """[H; C], g, lo, hi, and the minimiser under the equalities with its multipliers."""
    stack, g, n_all = rng.normal(size=(n + n_eq + others, n)), rng.normal(size=n), n + n_eq + others
    stack[:n] = stack[:n] @ stack[:n].T + 0.1 * np.eye(n)
    H, E, b = stack[:n], stack[n : n + n_eq], rng.normal(size=n_eq)
    answer = np.linalg.solve(np.block([[H, E.T], [E, np.zeros((n_eq, n_eq))]]), np.r_[-g, b])
    value = np.r_[answer[:n], stack[n:] @ answer[:n]]
    lo, hi = value - rng.uniform(0.1, 1.0, n_all), value + rng.uniform(0.1, 1.0, n_all)
    lo[n : n + n_eq] = hi[n : n + n_eq] = b
    z = np.zeros(n_all)
    z[n : n + n_eq] = answer[n:]
    return stack, g, lo, hi, answer[:n], z


def test_minimum(rng, layout):
    stack, g, lo, hi, expected, multipliers = quadratic(rng)
    x, z = np.empty(9), np.empty(16)
    assert kernels.minimum(*layout(stack, g, lo, hi), 4, 1e-9, x, z)
    np.testing.assert_allclose(x, expected, atol=1e-11)
    np.testing.assert_allclose(z, multipliers, atol=1e-11)


@pytest.mark.parametrize("row", [2, 13, 15])  # a bound, and rows that are no equalities
@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_no_minimum_where_a_limit_is_missed(rng, row, side):
    stack, g, lo, hi, expected, _ = quadratic(rng)
    value = np.r_[expected, stack[9:] @ expected][row]
    (lo if side > 0.0 else hi)[row] = value + 2e-9 * side
    assert not kernels.minimum(stack, g, lo, hi, 4, 1e-9, np.empty(9), np.empty(16))
    assert kernels.minimum(stack, g, lo, hi, 4, 4e-9, np.empty(9), np.empty(16))


@pytest.mark.parametrize("change", ["dependent", "indefinite", "crossing", "nan"])
def test_no_minimum_that_rounding_would_spoil(rng, change):
    stack, g, lo, hi, _, _ = quadratic(rng)
    if change == "dependent":
        stack[12] = stack[9] + stack[10]
    elif change == "indefinite":
        stack[:9] -= np.linalg.eigvalsh(stack[:9])[0] * np.eye(9)
    elif change == "crossing":
        lo[14], hi[14] = hi[14], lo[14]
    else:
        stack[11, 3] = np.nan
    assert not kernels.minimum(stack, g, lo, hi, 4, 1e-9, np.empty(9), np.empty(16))


def test_point_target(rng, layout):
    R, p, c, v, drift = pin.exp3(rng.normal(size=3)), *rng.normal(size=(2, 3)), rng.normal(size=8), rng.normal(size=3)
    motion, J, K, b = rng.normal(size=(6, 2)), rng.normal(size=(3, 8)), rng.normal(size=(3, 6)), np.empty(3)
    kernels.point_target(*layout(R, p, motion, c, J, v, drift, K), b)
    (w, u), (_, udot) = motion[:, 0].reshape(2, 3), motion[:, 1].reshape(2, 3)
    wanted = R @ (udot + np.cross(w, u)) + K @ np.r_[p - c, R @ u - J @ v] - drift
    np.testing.assert_allclose(b, wanted, rtol=1e-12, atol=1e-13)


def test_how_contacts_share_a_wrench(rng, layout):
    """lambda_0 + D (w - P lambda_0) carries w, and no lambda that does lies nearer to lambda_0."""
    push, A, weight, S = rng.normal(size=(9, 12)), rng.normal(size=(9, 6)), np.empty(9), np.empty((6, 6))
    kernels.carried(*layout(push, A), 0.05, weight, S)
    P = push[:, :6].T
    np.testing.assert_allclose(1.0 / weight, A**2 @ np.repeat([0.05**2, 1.0], 3), rtol=1e-13)
    np.testing.assert_allclose(S, (P / weight) @ P.T, rtol=1e-12, atol=1e-13)
    bias, start, D = rng.normal(size=6), rng.normal(size=9), np.empty((9, 6))
    lam, M_b, moved, metric = start.copy(), rng.normal(size=(6, 11)), np.empty((9, 11)), np.zeros((9, 9))
    kernels.share(*layout(push, weight, np.linalg.inv(S), M_b, bias), 0.5, D, lam, moved, metric)
    np.testing.assert_array_equal(metric, np.diag(0.5 * weight))
    np.testing.assert_allclose(moved, D @ M_b, rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(P @ D, np.eye(6), atol=1e-9)
    np.testing.assert_allclose(P @ lam, -bias, atol=1e-9)
    away = weight * (lam - start)  # in the rows of P: orthogonal to what moves nothing
    np.testing.assert_allclose(away, P.T @ np.linalg.lstsq(P.T, away, rcond=None)[0], atol=1e-9)


@pytest.mark.parametrize("rank", [0, 1, 4, 7])
def test_root(rng, layout, rank):
    B, R = rng.normal(size=(rank, 7)) * np.logspace(0, -3, 7), np.empty((7, 7))
    assert kernels.root(*layout(B.T @ B), 1e-13, R) == rank
    np.testing.assert_allclose(R[:rank].T @ R[:rank], B.T @ B, atol=1e-13)
    np.testing.assert_array_equal(R[rank:], 0.0)
