"""The cone of a rectangle against what it is made of: forces at its corners, found or refused by a linear program."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import linprog

from wbc import analytic
from wbc.analytic.surface import FRICTION, PRESSURE, YAW

SIZES = [(0.6, 0.085, 0.03), (0.3, 0.1, 0.1), (1.1, 0.02, 0.06)]  # mu, a, b


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(23)


def corners(mu: float) -> np.ndarray:
    """Rows (5, 3) with rows f >= 0: the pyramid of one corner."""
    return np.array([[0, 0, 1], [-1, 0, mu], [1, 0, mu], [0, -1, mu], [0, 1, mu]], float)


def carried(F: np.ndarray, mu: float, a: float, b: float) -> bool:
    """Whether corner forces exist for a wrench."""
    rows = np.kron(np.eye(4), corners(mu))
    found = linprog(
        np.zeros(12), A_ub=-rows, b_ub=np.zeros(len(rows)), A_eq=analytic.corner_forces_map(a, b), b_eq=F,
        bounds=[(None, None)] * 12, method="highs",
    )  # fmt: skip
    return bool(found.status == 0)


class TestSurfaceCone:
    def test_the_map_of_the_corners_is_force_and_moment(self, rng: np.random.Generator) -> None:
        a, b, forces = 0.085, 0.03, rng.normal(size=(4, 3))
        places = [(x, y, 0.0) for x in (a, -a) for y in (b, -b)]
        m = sum(np.cross(p, f) for p, f in zip(places, forces, strict=True))
        F = analytic.corner_forces_map(a, b) @ forces.ravel()
        np.testing.assert_allclose(F, np.r_[m, forces.sum(axis=0)], atol=1e-15)

    @pytest.mark.parametrize(("mu", "a", "b"), SIZES)
    def test_corner_forces_make_wrenches_inside(self, rng: np.random.Generator, mu: float, a: float, b: float) -> None:
        U = analytic.surface_cone(mu, a, b)
        for _ in range(300):
            N = rng.uniform(0.0, 50.0, (4, 1)) * (rng.random((4, 1)) < 0.7)
            f = np.hstack((mu * N * rng.uniform(-1.0, 1.0, (4, 2)).round(rng.integers(0, 3)), N))
            assert (U @ (analytic.corner_forces_map(a, b) @ f.ravel())).min() >= -1e-12

    @pytest.mark.parametrize(("mu", "a", "b"), SIZES)
    def test_it_is_exact(self, rng: np.random.Generator, mu: float, a: float, b: float) -> None:
        """Just inside its edge a wrench has corner forces, just outside it has none; every face is met."""
        U, push, met = analytic.surface_cone(mu, a, b), np.eye(6)[5], set()
        for trial in range(400):
            away = rng.normal(size=6) * (b, a, a * mu, mu, mu, 0.0)
            away *= rng.permuted([0.1, 0.1, 1.0, 1.0, 1.0, 1.0]) if trial % 2 else 1.0
            share = -(U @ push) / np.minimum(U @ away, -1e-300)
            edge = share.min()  # U (push + edge away) = 0 in one row
            met.add(int(share.argmin()))
            assert carried(push + 0.999 * edge * away, mu, a, b)
            assert not carried(push + 1.001 * edge * away, mu, a, b)
        assert met >= {*range(17)[FRICTION], *range(17)[PRESSURE], *range(17)[YAW]}

    def test_a_line_has_no_moment_along_itself(self) -> None:
        U = analytic.surface_cone(0.5, 0.1, 0.0)
        F = np.array([0.0, 0.05, 0.0, 0.1, 0.0, 1.0])
        assert (U @ F).min() >= 0.0
        assert (U @ (F + 1e-6 * np.eye(6)[0])).min() < 0.0

    def test_a_pull_is_outside(self) -> None:
        assert (analytic.surface_cone(0.5, 0.1, 0.1) @ [0, 0, 0, 0, 0, -1.0]).min() < 0.0
