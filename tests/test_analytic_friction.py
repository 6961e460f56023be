"""Cones and sliding friction against the plant, solved whole, and against the cone itself."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.linalg
from plants import full_rank, spd

from wbc import analytic

DOWN = np.array([0.0, 0.0, -1.0])
ACROSS = np.eye(3)[:2]


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(17)


class TestCones:
    @pytest.mark.parametrize(("faces", "loss"), [(3, 0.5), (4, 0.293), (8, 0.0761), (16, 0.0192)])
    def test_an_inner_cone_holds_the_true_one_and_loses_what_is_said(self, faces: int, loss: float) -> None:
        mu, N, rows = 0.6, 7.0, analytic.inner_cone(0.6, faces)
        angles = np.linspace(0, 2 * np.pi, 721)
        longest = [
            min(-N * c[2] / s for c in rows if (s := c[0] * np.cos(a) + c[1] * np.sin(a)) > 1e-9) for a in angles
        ]
        assert max(longest) == pytest.approx(mu * N, rel=1e-9)  # its edges lie on the cone
        assert min(longest) / (mu * N) == pytest.approx(1 - loss, abs=1e-3)

    def test_two_faces_are_exact_along_one_axis(self) -> None:
        rows = analytic.inner_cone(0.4, 2)
        assert (rows @ [3.9, 0, 10] <= 0).all()
        assert not (rows @ [4.1, 0, 10] <= 0).all()
        assert not (rows @ [-4.1, 0, 10] <= 0).all()

    def test_what_is_cut_points_the_same_way_and_ends_on_the_cone(self, rng: np.random.Generator) -> None:
        for _ in range(50):
            f, N, mu = rng.normal(size=2) * 10, rng.uniform(-1, 10), rng.uniform(0.1, 1.0)
            for faces in (None, 8):
                cut = analytic.cut_to_cone(f, N, mu, faces)
                assert np.linalg.norm(cut) <= mu * max(N, 0.0) + 1e-12
                assert cut @ np.array([-f[1], f[0]]) == pytest.approx(0.0, abs=1e-9)
                rows = analytic.inner_cone(mu, 8)
                inside = np.linalg.norm(f) <= mu * N if faces is None else (rows @ [*f, max(N, 0.0)] <= 0).all()
                assert inside == (cut is f or bool((cut == f).all()))

    def test_a_measured_wrench_is_capped_as_a_whole(self) -> None:
        F = np.array([0, 0, 0.4, 3.0, 4.0, 0.0])
        np.testing.assert_allclose(analytic.capped_friction(F, ACROSS, 2.5), F / 2)
        np.testing.assert_array_equal(analytic.capped_friction(F, ACROSS, 5.1), F)
        np.testing.assert_array_equal(analytic.capped_friction(F, ACROSS, -1.0), 0 * F)


class TestDirection:
    def test_it_is_that_of_the_velocity_and_at_rest_that_of_the_desired_one(self) -> None:
        v_d = np.array([0.0, 0.2])
        np.testing.assert_allclose(analytic.sliding_direction(np.array([0.3, 0.4]), v_d, 0.01), [0.6, 0.8])
        np.testing.assert_allclose(analytic.sliding_direction(np.zeros(2), v_d, 0.01), [0, 1])
        np.testing.assert_array_equal(analytic.sliding_direction(np.zeros(2), np.zeros(2), 0.01), 0)

    def test_it_is_continuous_and_never_longer_than_one(self, rng: np.random.Generator) -> None:
        for _ in range(200):
            v, v_d = rng.normal(size=2) * 0.01, rng.normal(size=2) * 0.02
            u = analytic.sliding_direction(v, v_d, 0.01)
            assert np.linalg.norm(u) <= 1 + 1e-12
            moved = analytic.sliding_direction(v + 1e-9, v_d + 1e-9, 0.01)
            assert np.abs(moved - u).max() < 1e-6


class Sliding:
    """An arm whose contact answers B lambda, all its equations solved at once in joint space."""

    def __init__(self, rng: np.random.Generator, k: int, mu: float) -> None:
        n = 7
        self.M, self.h, self.J, self.drift = (
            spd(rng, n),
            10 * rng.normal(size=n),
            full_rank(rng, 6, n),
            rng.normal(size=6),
        )
        # z is held, x and y are free: those across the push
        self.A = np.eye(6)[{1: [5], 3: [0, 1, 5], 4: [0, 1, 2, 5]}[k]]
        self.Adot_V, self.mu = rng.normal(size=k), mu
        angle = rng.uniform(0, 2 * np.pi)
        self.u = np.array([np.cos(angle), np.sin(angle), 0.0])
        self.B = analytic.sliding_map(self.A, DOWN, self.u, mu)
        self.M_C = analytic.task_inertia(self.M, self.J)
        self.h_C = analytic.task_bias(self.M, self.J, self.h, self.drift)

    def react(self, tau: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        k, n = len(self.A), len(self.M)
        KKT = np.block([[self.M, self.J.T @ self.B], [self.A @ self.J, np.zeros((k, k))]])
        x = scipy.linalg.solve(KKT, np.r_[tau - self.h, -self.Adot_V - self.A @ self.drift])
        return self.J @ x[:n] + self.drift, x[n:]


@pytest.mark.parametrize("k", [1, 3, 4])
class TestSliding:
    def test_the_map_adds_the_drag_of_the_push(self, rng: np.random.Generator, k: int) -> None:
        plant, lam = Sliding(rng, k, 0.3), rng.normal(size=k)
        F = plant.B @ lam
        N = DOWN @ F[3:]
        np.testing.assert_allclose(F[3:5], 0.3 * N * plant.u[:2], atol=1e-13)
        np.testing.assert_allclose(plant.A @ F, lam, atol=1e-13)

    def test_multipliers_and_acceleration_are_the_plants(self, rng: np.random.Generator, k: int) -> None:
        plant, F = Sliding(rng, k, 0.2), rng.normal(size=6)
        Vdot, lam = plant.react(plant.J.T @ F)
        given = (plant.A, plant.B, plant.M_C, F, plant.h_C, plant.Adot_V)
        np.testing.assert_allclose(analytic.sliding_multipliers(*given), lam, atol=1e-10)
        np.testing.assert_allclose(analytic.sliding_acceleration(*given), Vdot, atol=1e-10)
        frictionless = (plant.A, plant.M_C, F, plant.h_C, plant.Adot_V)
        same = analytic.sliding_multipliers(plant.A, plant.A.T, *frictionless[1:])
        np.testing.assert_allclose(same, analytic.multipliers(*frictionless), atol=1e-10)

    @pytest.mark.parametrize("law", ["compensated", "book"])
    def test_the_law_with_the_drag_moves_and_presses_as_without_friction(
        self, rng: np.random.Generator, k: int, law: analytic.Law
    ) -> None:
        plant, y, F = Sliding(rng, k, 0.2), rng.normal(size=6), 5 * rng.normal(size=6)
        arm = (plant.M, plant.h, plant.J, plant.drift, plant.A)
        tau = analytic.hybrid_torque(*arm, y, F, Adot_V=plant.Adot_V, law=law)
        rigid = Sliding.__new__(Sliding)
        vars(rigid).update(vars(plant) | {"B": plant.A.T})
        Vdot, lam = rigid.react(tau)
        pressed = analytic.multiplier_error(plant.A, F)
        if law == "book":
            pressed = analytic.multipliers(plant.A, plant.M_C, F, np.zeros(6), plant.Adot_V)
        np.testing.assert_allclose(lam, pressed, atol=1e-9)
        again, felt = plant.react(tau + analytic.sliding_torque(plant.J, plant.A, plant.B, pressed))
        np.testing.assert_allclose(again, Vdot, atol=1e-9)
        np.testing.assert_allclose(felt, lam, atol=1e-9)

    def test_the_critical_friction_is_the_first_that_makes_it_singular(self, rng: np.random.Generator, k: int) -> None:
        plant = Sliding(rng, k, 0.3)
        mobility = np.linalg.inv(plant.M_C)
        critical = analytic.critical_friction(plant.A, mobility, DOWN, ACROSS)

        def least(mu: float) -> float:
            """Smallest determinant over all directions of sliding, relative to that without friction."""
            angles = np.linspace(0, 2 * np.pi, 3601)
            maps = [analytic.sliding_map(plant.A, DOWN, np.array([np.cos(a), np.sin(a), 0]), mu) for a in angles]
            return float(min(np.linalg.det(plant.A @ mobility @ B) for B in maps))

        whole = float(np.linalg.det(plant.A @ mobility @ plant.A.T))
        assert least(0.99 * critical) > 0
        assert least(critical) == pytest.approx(0.0, abs=1e-5 * whole)
        assert least(1.01 * critical) < 0
