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
    kernels.sense(*layout(F, past), 0.3, *layout(inverse, desired), filtered, error)
    np.testing.assert_allclose(filtered, past + 0.3 * (F - past), rtol=1e-13, atol=1e-15)
    np.testing.assert_allclose(error, desired - inverse @ filtered, rtol=1e-12, atol=1e-14)

    lam, command, integral, step = (rng.normal(size=3) for _ in range(4))
    grown, missing = np.empty(3), np.empty(3)
    assert not kernels.advance(*layout(lam, command, integral, step), 0.1, grown, missing)
    np.testing.assert_allclose(grown, integral + 0.1 * step)
    np.testing.assert_allclose(missing, lam - command)
    assert kernels.advance(command * (1 + 1e-12), command, integral, step, 0.1, grown, missing)

    A, x, h = rng.normal(size=(3, 4)), rng.normal(size=4), rng.normal(size=3)
    tau, value = np.empty(3), A @ x + h
    lo, hi = np.array([-9.0, value[1] + 0.1, -9.0]), np.array([9.0, 9.0, value[2] - 0.1])
    kernels.torque(*layout(A, x, h, lo, hi), tau)
    np.testing.assert_allclose(tau, [value[0], lo[1], hi[2]], rtol=1e-13)


def test_total_is_a_number_only_where_all_are():
    assert kernels.total(np.array([1.0, 2.0])) == 3.0
    assert not np.isfinite(kernels.total(np.array([np.inf, 1.0, -np.inf])))
