"""The dynamics of the task against the plant, solved whole in joint space."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.linalg
from plants import Plant, full_rank, sizes, spd

from wbc import analytic


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(11)


class TestTaskDynamics:
    @sizes
    def test_equation_3_is_the_free_plant(self, rng: np.random.Generator, r: int, n: int, k: int) -> None:
        plant, F = Plant.random(rng, r, n, 0), rng.normal(size=r)
        Vdot = plant.twist_rate(plant.react(plant.J.T @ F)[0])
        h_C = analytic.task_bias(plant.M, plant.J, plant.h, plant.drift)
        assert analytic.task_inertia(plant.M, plant.J) @ Vdot + h_C == pytest.approx(F, abs=1e-11)

    def test_task_inertia_is_symmetric_and_keeps_kinetic_energy(self, rng: np.random.Generator) -> None:
        M, J, v = spd(rng, 6), full_rank(rng, 6, 6), rng.normal(size=6)
        M_C, V = analytic.task_inertia(M, J), J @ v
        assert np.array_equal(M_C, M_C.T)
        assert pytest.approx(v @ M @ v, rel=1e-12) == V @ M_C @ V

    def test_consistent_inverse_is_the_one_of_least_energy(self, rng: np.random.Generator) -> None:
        M, J, V = spd(rng, 9), full_rank(rng, 6, 9), rng.normal(size=6)
        v = analytic.dynamically_consistent_inverse(M, J) @ V
        assert J @ v == pytest.approx(V, abs=1e-13)
        null = scipy.linalg.null_space(J)
        assert null.T @ M @ v == pytest.approx(np.zeros(3), abs=1e-13)

    def test_null_space_torque_does_not_move_the_task(self, rng: np.random.Generator) -> None:
        M, J, tau = spd(rng, 9), full_rank(rng, 6, 9), rng.normal(size=9)
        Jbar = analytic.dynamically_consistent_inverse(M, J)
        assert J @ np.linalg.solve(M, tau - J.T @ Jbar.T @ tau) == pytest.approx(np.zeros(6), abs=1e-13)

    def test_accuracy_does_not_square_the_condition(self) -> None:
        # J = diag is inverted exactly: M_C = diag(d^-2), condition 1e16, still good to the last digits entry by entry
        d = np.array([1.0, 1e-4, 1e-8])
        assert np.diag(analytic.task_inertia(np.eye(3), np.diag(d))) == pytest.approx(d**-2.0, rel=1e-14)

    def test_more_task_axes_than_joints(self, rng: np.random.Generator) -> None:
        with pytest.raises(np.linalg.LinAlgError, match="square"):
            analytic.task_inertia(spd(rng, 5), rng.normal(size=(6, 5)))

    def test_inverse_dynamics_undoes_the_plant(self, rng: np.random.Generator) -> None:
        plant, tau = Plant.random(rng, 6, 8, 3), rng.normal(size=8)
        vdot, lam = plant.react(tau)
        again = analytic.inverse_dynamics(plant.M, plant.h, vdot, plant.J, plant.A, lam)
        assert again == pytest.approx(tau, abs=1e-12)


class TestConstrainedDynamics:
    @sizes
    def test_projectors(self, rng: np.random.Generator, r: int, n: int, k: int) -> None:
        A, M_C = full_rank(rng, k, r), spd(rng, r)
        P, complement = analytic.motion_projector(A, M_C), analytic.force_projector(A, M_C)
        zero = pytest.approx(np.zeros((r, r)), abs=1e-12)
        assert P + complement - np.eye(r) == zero
        assert zero == P @ P - P
        assert zero == P @ M_C - M_C @ P.T
        assert A @ np.linalg.solve(M_C, P) == pytest.approx(np.zeros((k, r)), abs=1e-12)
        assert pytest.approx(np.zeros((r, k)), abs=1e-12) == P @ A.T
        assert np.trace(P) == pytest.approx(r - k, abs=1e-12)
        assert np.linalg.matrix_rank(P, tol=1e-9) == r - k
        assert np.linalg.matrix_rank(complement, tol=1e-9) == k

    @sizes
    def test_equations_4_and_5_are_the_plant(self, rng: np.random.Generator, r: int, n: int, k: int) -> None:
        plant, F = Plant.random(rng, r, n, k), 10 * rng.normal(size=r)
        vdot, lam = plant.react(plant.J.T @ F)
        M_C = analytic.task_inertia(plant.M, plant.J)
        h_C = analytic.task_bias(plant.M, plant.J, plant.h, plant.drift)
        task = (plant.A, M_C, F, h_C, plant.Adot_V)
        assert analytic.multipliers(*task) == pytest.approx(lam, abs=1e-10)
        assert analytic.constrained_acceleration(*task) == pytest.approx(plant.twist_rate(vdot), abs=1e-10)

    def test_constraint_inertia_of_one_axis_is_the_effective_mass(self, rng: np.random.Generator) -> None:
        # the force that gives a unit acceleration along z, all else free to follow
        M_C, A = spd(rng, 6), np.eye(6)[5:]
        assert analytic.constraint_inertia(A, M_C)[0, 0] == pytest.approx(1 / np.linalg.inv(M_C)[5, 5], rel=1e-13)

    def test_force_bias_is_the_extra_multiplier_of_a_moving_contact(self, rng: np.random.Generator) -> None:
        plant, tau = Plant.random(rng, 6, 8, 2), rng.normal(size=8)
        still = Plant(*plant.arm, np.zeros(2))
        extra = plant.react(tau)[1] - still.react(tau)[1]
        assert analytic.force_bias(plant.A, plant.M_C, plant.Adot_V) == pytest.approx(extra, abs=1e-11)
