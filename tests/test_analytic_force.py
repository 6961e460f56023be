"""Pure force control and contact wrenches against their own equations of motion."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.linalg
from plants import full_rank, sizes, spd

from wbc import analytic
from wbc.analytic import Array
from wbc.errors import GainError, WrenchError

AXES = ("mx", "my", "mz", "fx", "fy", "fz")


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(11)


class TestForce:
    def test_gain_from_number_diagonal_and_matrix(self) -> None:
        full = np.array([[2.0, 1.0], [0.0, 2.0]])
        assert np.array_equal(analytic.gain_matrix(3, 2, "kp"), 3 * np.eye(2))
        assert np.array_equal(analytic.gain_matrix([1, 2], 2, "kp"), np.diag([1, 2]))
        assert np.array_equal(analytic.gain_matrix(full, 2, "kp"), full)
        assert np.array_equal(analytic.gain_matrix(0, 2, "kp"), np.zeros((2, 2)))
        assert analytic.gain_matrix(3, 0, "kp").shape == (0, 0)

    @pytest.mark.parametrize(
        ("K", "message"),
        [
            (-1.5, r"^kp: not positive definite: smallest eigenvalue -1\.5, expected above 0$"),
            ([1, 0], r"^kp: not positive definite: smallest eigenvalue 0,"),
            ([[1, 2], [2, 1]], r"^kp: .* smallest eigenvalue -1,"),
            ([[1, 4], [0, 1]], r"^kp: .* smallest eigenvalue -1,"),
            ([[0, 1], [-1, 0]], r"^kp: .* smallest eigenvalue 0,"),
            ([1, 2, 3], r"^kp: got shape \(3,\), expected a number, \(2,\) or \(2, 2\)$"),
            ([1, np.nan], r"^kp: not finite$"),
        ],
    )
    def test_gain_refused(self, K: object, message: str) -> None:
        with pytest.raises(GainError, match=message):
            analytic.gain_matrix(K, 2, "kp")  # type: ignore[arg-type]

    def test_pi_command_holds_a_static_arm_at_the_wrench_it_commands(self, rng: np.random.Generator) -> None:
        # at rest tau = g + J' F_tip; the PI loop's claim is (Kp + I) F_e + Ki int F_e = 0 then
        J, g, F_d, integral = full_rank(rng, 6, 6), rng.normal(size=6), rng.normal(size=6), rng.normal(size=6)
        Kp, Ki = spd(rng, 6), spd(rng, 6)
        F_e = np.linalg.solve(Kp + np.eye(6), -Ki @ integral)
        tau = analytic.force_torque(J, g, analytic.force_command(F_d, F_e, integral, Kp, Ki))
        assert np.linalg.solve(J.T, tau - g) == pytest.approx(F_d - F_e, abs=1e-12)

    def test_damping_takes_power_from_the_motion(self, rng: np.random.Generator) -> None:
        F_d, V, zero, damp = rng.normal(size=6), rng.normal(size=6), np.zeros(6), [5, 5, 5, 300, 300, 300]
        free = analytic.force_command(F_d, zero, zero, 0, 0)
        assert free == pytest.approx(F_d, abs=0)
        power = V @ (analytic.force_command(F_d, zero, zero, 0, 0, damp, V) - free)
        assert power == pytest.approx(-5 * V[:3] @ V[:3] - 300 * V[3:] @ V[3:])

    def test_damping_without_a_twist(self) -> None:
        with pytest.raises(GainError, match=r"^K_damp: damping needs the twist V$"):
            analytic.force_command(np.ones(1), np.ones(1), np.ones(1), 0, 1, K_damp=2)

    def test_pole_of_equal_gains(self) -> None:
        assert analytic.force_error_matrix(0.3, 10) == pytest.approx(np.array([[-10 / 1.3]]))
        assert np.linalg.eigvals(analytic.force_error_matrix(0.3, 10 * np.eye(3))) == pytest.approx(-10 / 1.3)

    def test_force_error_satisfies_its_equation(self, rng: np.random.Generator) -> None:
        Kp, Ki, F0, t, dt = spd(rng, 4), spd(rng, 4), rng.normal(size=4), 0.4, 1e-5
        before, now, after = analytic.force_error([t - dt, t, t + dt], F0, Kp, Ki)
        residual = (Kp + np.eye(4)) @ (after - before) / (2 * dt) + Ki @ now
        assert residual == pytest.approx(np.zeros(4), abs=1e-9)
        assert analytic.force_error(0, F0, Kp, Ki) == pytest.approx(F0, abs=0)

    def test_force_error_is_the_matrix_exponential(self, rng: np.random.Generator) -> None:
        Kp, Ki, F0 = spd(rng, 6), 30 * spd(rng, 6), rng.normal(size=6)
        for t in (1e-6, 0.01, 1.0, 100.0):
            exact = scipy.linalg.expm(analytic.force_error_matrix(Kp, Ki) * t) @ F0
            assert analytic.force_error(t, F0, Kp, Ki) == pytest.approx(exact, abs=1e-13)

    def test_force_error_of_a_defective_loop(self) -> None:
        # Kp = 0, Ki = [[1, 1], [0, 1]]: one eigenvector; F_e = e^-t (a - t b, b)
        error = analytic.force_error(2.0, np.array([1.0, 3.0]), 0, [[1, 1], [0, 1]])
        assert error == pytest.approx(np.exp(-2) * np.array([1 - 2 * 3, 3]), rel=1e-14)

    def test_force_error_of_no_axis(self) -> None:
        assert analytic.force_error([0, 1], np.zeros(0), 0.3, 10).shape == (2, 0)

    def test_symmetric_positive_definite_gains_decay(self, rng: np.random.Generator) -> None:
        for _ in range(100):
            Kp, Ki, F0 = spd(rng, 3), spd(rng, 3), rng.normal(size=3)
            poles = np.linalg.eigvals(analytic.force_error_matrix(Kp, Ki))
            assert poles.real.max() < 0
            assert np.abs(poles.imag).max() < 1e-12
            assert np.linalg.norm(analytic.force_error(500, F0, Kp, Ki)) < 1e-9

    def test_positive_definite_is_not_enough_without_symmetry(self) -> None:
        def turn(a: float) -> Array:
            return np.array([[np.cos(a), -np.sin(a)], [np.sin(a), np.cos(a)]])

        Kp, Ki = 50 * turn(1.4), turn(-1.4)
        assert np.linalg.eigvals(analytic.force_error_matrix(Kp, Ki)).real.max() > 0


class TestWrench:
    @sizes
    def test_multiplier_error_is_the_least_squares_solution(
        self, rng: np.random.Generator, r: int, n: int, k: int
    ) -> None:
        A, F = full_rank(rng, k, r), rng.normal(size=r)
        lam = analytic.multiplier_error(A, F)
        assert lam.shape == (k,)
        assert lam == pytest.approx(np.linalg.pinv(A.T) @ F, abs=1e-13)
        assert analytic.project_wrench(A, F) + analytic.wrench_residual(A, F) == pytest.approx(F, abs=1e-14)
        assert A @ analytic.wrench_residual(A, F) == pytest.approx(np.zeros(k), abs=1e-13)

    def test_carried_wrench_passes(self, rng: np.random.Generator) -> None:
        A = full_rank(rng, 3, 6)
        analytic.require_wrench(A, A.T @ (1e6 * rng.normal(size=3)), AXES)
        analytic.require_wrench(np.zeros((0, 6)), np.zeros(6), AXES)

    def test_refused_wrench_names_its_components(self) -> None:
        board = np.eye(6)[[0, 1, 5]]
        with pytest.raises(WrenchError, match=r": fx by 3 N outside the range of A'$"):
            analytic.require_wrench(board, np.array([1.0, 2, 0, 3, 0, -10]), AXES)
        with pytest.raises(WrenchError, match=r": mz by -0\.5 N m, fy by 2 N outside"):
            analytic.require_wrench(board, np.array([0, 0, -0.5, 0, 2, -10]), AXES)
        with pytest.raises(WrenchError, match=": mx by nan"):
            analytic.require_wrench(board, np.full(6, np.nan), AXES)

    def test_friction_is_read_as_normal_force_only_by_the_oblique_projection(self, rng: np.random.Generator) -> None:
        M_C, A, friction = spd(rng, 6), np.eye(6)[5:], np.array([0, 0, 0, 3.0, 0, 0])
        # what a wall at z carries of 3 N along x pushing a free body: its share, by the block equations of (4) and (2)
        kkt = np.block([[M_C, A.T], [A, np.zeros((1, 1))]])
        share = np.linalg.solve(kkt, np.append(friction, 0))[6]
        read = analytic.force_projector(A, M_C) @ friction
        assert abs(share) > 0.1
        assert read == pytest.approx([0, 0, 0, 0, 0, share], abs=1e-12)
        assert analytic.multiplier_error(A, friction) == pytest.approx([0], abs=1e-16)


class TestDampedLoop:
    def test_frame_in_free_space_drifts_at_the_terminal_velocity(self, rng: np.random.Generator) -> None:
        M_C, F_d, Kp, K_damp, V = spd(rng, 6), rng.normal(size=6), spd(rng, 6), 40 * spd(rng, 6), np.zeros(6)
        for gain in (0.0, Kp):
            for _ in range(5000):
                V = V + 1e-3 * np.linalg.solve(M_C, analytic.force_command(F_d, F_d, np.zeros(6), gain, 0, K_damp, V))
            assert analytic.terminal_velocity(F_d, K_damp, gain) == pytest.approx(V, abs=1e-9)

    def test_terminal_velocity_of_numbers(self) -> None:
        assert analytic.terminal_velocity(np.array([-10.0]), 300) == pytest.approx([-10 / 300])
        assert analytic.terminal_velocity(np.array([-10.0]), 300, Kp=0.3) == pytest.approx([-13 / 300])

    def test_damping_limit_is_where_a_tick_stops_decaying(self, rng: np.random.Generator) -> None:
        M, J, dt = spd(rng, 7), full_rank(rng, 3, 7), 1e-3
        limit = analytic.damping_limit(J @ np.linalg.solve(M, J.T), dt)

        def left(K_damp: float) -> float:
            v = rng.normal(size=7)
            for _ in range(4000):
                v = v - dt * np.linalg.solve(M, J.T @ (K_damp * (J @ v)))
            return float(np.linalg.norm(J @ v))

        assert left(0.98 * limit) < 1e-6
        assert left(1.02 * limit) > 1e6

    def test_damping_limit_of_one_mass_and_of_no_axis(self) -> None:
        assert analytic.damping_limit(np.array([[1 / 3.0]]), 1e-3) == pytest.approx(2 * 3 / 1e-3)
        assert analytic.damping_limit(np.zeros((0, 0)), 1e-3) == np.inf
