"""Each closed-form law against a statement of its own: the plant, a derivative, an eigenvalue, another library."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pinocchio as pin
import pytest
import scipy.linalg

from wbc import analytic
from wbc.analytic import Array
from wbc.errors import GainError, NameNotFound, WrenchError

AXES = ("mx", "my", "mz", "fx", "fy", "fz")
ANGULAR_FIRST = np.array([3, 4, 5, 0, 1, 2])  # Pinocchio stacks the linear part first
SIZES = [(r, n, k) for r in (3, 6) for n in (r, r + 1, 10) for k in range(r + 1)]
sizes = pytest.mark.parametrize(("r", "n", "k"), SIZES)


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(11)


def spd(rng: np.random.Generator, n: int) -> Array:
    Q = np.linalg.qr(rng.normal(size=(n, n)))[0]
    return (Q * rng.uniform(0.3, 5.0, n)) @ Q.T


def full_rank(rng: np.random.Generator, m: int, n: int) -> Array:
    U, V = (np.linalg.qr(rng.normal(size=(i, i)))[0] for i in (m, n))
    return (U * rng.uniform(0.5, 2.0, m)) @ V[:m]


def pose(rng: np.random.Generator) -> Array:
    return scipy.linalg.expm(hat(rng.normal(size=6)))


def hat(V: Array) -> Array:
    """[V] (4, 4), spelled out."""
    (a, b, c), v = V[:3], V[3:]
    return np.array([[0, -c, b, v[0]], [c, 0, -a, v[1]], [-b, a, 0, v[2]], [0, 0, 0, 0]])


def tangent(A: Array) -> Array:
    """Columns (r, r - k): an orthonormal basis of the motions that A allows."""
    return np.linalg.svd(A)[2][len(A) :].T if len(A) else np.eye(A.shape[1])


def motion_axes(rng: np.random.Generator, A: Array) -> Array:
    """S (r - k, r) that completes A to a regular matrix, its rows neither unit nor orthogonal to those of A."""
    k, r = A.shape
    return full_rank(rng, r - k, r - k) @ tangent(A).T + 0.5 * rng.normal(size=(r - k, k)) @ A


@dataclass(frozen=True)
class Plant:
    """A rigidly constrained arm at one state; `react` solves its equations of motion whole, in joint space."""

    M: Array
    h: Array
    J: Array
    drift: Array
    A: Array
    Adot_V: Array

    @classmethod
    def random(cls, rng: np.random.Generator, r: int, n: int, k: int) -> Plant:
        h, drift, Adot_V = (rng.normal(size=i) for i in (n, r, k))
        return cls(spd(rng, n), 10 * h, full_rank(rng, r, n), drift, full_rank(rng, k, r), Adot_V)

    def react(self, tau: Array) -> tuple[Array, Array]:
        n, k = len(self.M), len(self.A)
        AJ = self.A @ self.J
        kkt = np.block([[self.M, AJ.T], [AJ, np.zeros((k, k))]])
        x = np.linalg.solve(kkt, np.concatenate([tau - self.h, -self.Adot_V - self.A @ self.drift]))
        return x[:n], x[n:]

    def twist_rate(self, vdot: Array) -> Array:
        return self.J @ vdot + self.drift

    @property
    def M_C(self) -> Array:
        return np.linalg.inv(self.J @ np.linalg.inv(self.M) @ self.J.T)

    @property
    def arm(self) -> tuple[Array, Array, Array, Array, Array]:
        return self.M, self.h, self.J, self.drift, self.A


class TestSE3:
    def test_skew_is_the_cross_product(self, rng: np.random.Generator) -> None:
        a, b = rng.normal(size=(2, 3))
        assert analytic.skew(a) @ b == pytest.approx(np.cross(a, b), abs=1e-15)

    @pytest.mark.parametrize("angle", [0, 1e-12, 1e-6, 1e-3, 0.29999, 0.30001, 1, 3, np.pi - 1e-9, np.pi, 5, 20])
    def test_exponentials_are_matrix_exponentials(self, rng: np.random.Generator, angle: float) -> None:
        w, v = rng.normal(size=(2, 3))
        V = np.concatenate([w / np.linalg.norm(w) * angle, v])
        assert analytic.exp6(V) == pytest.approx(scipy.linalg.expm(hat(V)), abs=2e-14)
        assert analytic.exp3(V[:3]) == pytest.approx(analytic.exp6(V)[:3, :3], abs=0)

    @pytest.mark.parametrize("angle", [0, 1e-200, 1e-12, 1e-6, 0.3, 1, 3, np.pi - 1e-4, np.pi - 1e-8, np.pi - 1e-12])
    def test_logarithms_undo_the_exponentials(self, rng: np.random.Generator, angle: float) -> None:
        for _ in range(50):
            w, v = rng.normal(size=(2, 3))
            V = np.concatenate([w / np.linalg.norm(w) * angle, v])
            assert analytic.log6(analytic.exp6(V)) == pytest.approx(V, abs=1e-14)
            assert analytic.log3(analytic.exp3(V[:3])) == pytest.approx(V[:3], abs=1e-14)

    @pytest.mark.parametrize("axis", [(1, 0, 0), (0, 1, 0), (0, 0, 1), (0.6, 0.8, 0), (0, -0.6, 0.8)])
    def test_logarithm_of_half_a_turn(self, axis: tuple[float, float, float]) -> None:
        a = np.array(axis, dtype=float)
        R = 2 * np.outer(a, a) - np.eye(3)
        w = analytic.log3(R)
        assert np.linalg.norm(w) == pytest.approx(np.pi, abs=1e-15)
        assert np.linalg.norm(np.cross(w, a)) == pytest.approx(0, abs=1e-15)

    def test_inverse_and_adjoint_carry_twists(self, rng: np.random.Generator) -> None:
        T, V = pose(rng), rng.normal(size=6)
        assert analytic.inverse(T) @ T == pytest.approx(np.eye(4), abs=1e-15)
        assert hat(analytic.adjoint(T) @ V) == pytest.approx(T @ hat(V) @ np.linalg.inv(T), abs=1e-14)

    def test_ad_is_the_commutator_and_the_rate_of_the_adjoint(self, rng: np.random.Generator) -> None:
        V, W = rng.normal(size=(2, 6))
        assert hat(analytic.ad(V) @ W) == pytest.approx(hat(V) @ hat(W) - hat(W) @ hat(V), abs=1e-14)
        step = [analytic.adjoint(analytic.exp6(s * V)) for s in (1e-5, -1e-5)]
        assert (step[0] - step[1]) / 2e-5 == pytest.approx(analytic.ad(V), abs=1e-8)

    def test_pinocchio_agrees(self, rng: np.random.Generator) -> None:
        T, V = pose(rng), rng.normal(size=6)
        X, motion = pin.SE3(T), pin.Motion(V[ANGULAR_FIRST])
        swap = np.ix_(ANGULAR_FIRST, ANGULAR_FIRST)
        assert analytic.adjoint(T) == pytest.approx(X.action[swap], abs=1e-14)
        assert analytic.ad(V) == pytest.approx(motion.action[swap], abs=1e-14)
        assert analytic.exp6(V) == pytest.approx(pin.exp6(motion).homogeneous, abs=1e-14)
        assert analytic.log6(T) == pytest.approx(pin.log6(X).vector[ANGULAR_FIRST], abs=1e-13)


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
        assert V @ M_C @ V == pytest.approx(v @ M @ v, rel=1e-12)

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


class TestConstrainedDynamics:
    @sizes
    def test_projectors(self, rng: np.random.Generator, r: int, n: int, k: int) -> None:
        A, M_C = full_rank(rng, k, r), spd(rng, r)
        P, complement = analytic.motion_projector(A, M_C), analytic.force_projector(A, M_C)
        zero = pytest.approx(np.zeros((r, r)), abs=1e-12)
        assert P + complement - np.eye(r) == zero
        assert P @ P - P == zero
        assert P @ M_C - M_C @ P.T == zero
        assert A @ np.linalg.solve(M_C, P) == pytest.approx(np.zeros((k, r)), abs=1e-12)
        assert P @ A.T == pytest.approx(np.zeros((r, k)), abs=1e-12)
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


class TestMotion:
    def test_errors_vanish_on_the_target(self, rng: np.random.Generator) -> None:
        T, V = pose(rng), rng.normal(size=6)
        assert analytic.pose_error(T, T) == pytest.approx(np.zeros(6), abs=1e-15)
        assert analytic.twist_error(T, V, T, V) == pytest.approx(np.zeros(6), abs=1e-15)

    def test_pose_error_is_the_twist_that_arrives_in_one_second(self, rng: np.random.Generator) -> None:
        T, T_d = pose(rng), pose(rng)
        assert T @ scipy.linalg.expm(hat(analytic.pose_error(T, T_d))) == pytest.approx(T_d, abs=1e-13)

    def test_twist_error_is_the_rate_of_a_small_pose_error(self, rng: np.random.Generator) -> None:
        T, (V, V_d) = pose(rng), rng.normal(size=(2, 6))
        ahead, behind = (
            analytic.pose_error(T @ analytic.exp6(s * V), T @ analytic.exp6(s * V_d)) for s in (1e-5, -1e-5)
        )
        assert (ahead - behind) / 2e-5 == pytest.approx(analytic.twist_error(T, V, T, V_d), abs=1e-8)

    def test_feedforward_is_the_derivative_of_the_desired_twist_seen_from_the_frame(
        self, rng: np.random.Generator
    ) -> None:
        T, T_d, (V, V_d, Vdot_d) = pose(rng), pose(rng), rng.normal(size=(3, 6))

        def seen(s: float) -> Array:
            actual, desired = T @ analytic.exp6(s * V), T_d @ analytic.exp6(s * V_d + s * s / 2 * Vdot_d)
            return analytic.twist_error(actual, np.zeros(6), desired, V_d + s * Vdot_d)

        y = analytic.computed_torque(T, V, T_d, V_d, Vdot_d, Kp=0, Kd=0)
        assert y == pytest.approx((seen(1e-5) - seen(-1e-5)) / 2e-5, abs=1e-8)

    def test_closed_loop_on_the_group_converges_to_a_moving_target(self, rng: np.random.Generator) -> None:
        dt, Vdot_d = 1e-3, np.array([0.2, -0.1, 0.3, 0.1, 0.2, -0.2])
        T, T_d, V, V_d = pose(rng), pose(rng), rng.normal(size=6), rng.normal(size=6)
        errors = []
        for _ in range(3000):
            errors.append(np.linalg.norm(analytic.pose_error(T, T_d)))
            y = analytic.computed_torque(T, V, T_d, V_d, Vdot_d, Kp=100, Kd=20)
            T, T_d = T @ analytic.exp6(dt * V + dt**2 / 2 * y), T_d @ analytic.exp6(dt * V_d + dt**2 / 2 * Vdot_d)
            V, V_d = V + dt * y, V_d + dt * Vdot_d
        assert errors[0] > 1
        assert errors[1000] < 0.01 * errors[0]
        assert errors[-1] < 1e-5


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
        with pytest.raises(GainError, match="^K_damp: damping needs the twist V$"):
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


class TestHybrid:
    @sizes
    def test_book_law_on_the_plant(self, rng: np.random.Generator, r: int, n: int, k: int) -> None:
        plant, y, F = Plant.random(rng, r, n, k), rng.normal(size=r), 10 * rng.normal(size=r)
        vdot, lam = plant.react(analytic.hybrid_torque(*plant.arm, y, F))
        bias = analytic.force_bias(plant.A, plant.M_C, plant.Adot_V)
        pressed = analytic.force_projector(plant.A, plant.M_C) @ F
        assert plant.A.T @ lam == pytest.approx(pressed + plant.A.T @ bias, abs=1e-10)
        missed = tangent(plant.A).T @ plant.M_C @ (plant.twist_rate(vdot) - y)
        assert missed == pytest.approx(np.zeros(r - k), abs=1e-10)

    @sizes
    def test_compensated_law_on_the_plant(self, rng: np.random.Generator, r: int, n: int, k: int) -> None:
        plant, y, lam_d = Plant.random(rng, r, n, k), rng.normal(size=r), 10 * rng.normal(size=k)
        friction = rng.normal(size=r)
        F = plant.A.T @ lam_d + friction - plant.A.T @ np.linalg.pinv(plant.A.T) @ friction
        S = motion_axes(rng, plant.A)
        for rows in (S, None):
            tau = analytic.hybrid_torque(*plant.arm, y, F, Adot_V=plant.Adot_V, law="compensated", S=rows)
            vdot, lam = plant.react(tau)
            assert lam == pytest.approx(lam_d, abs=1e-10)
            Vdot = plant.twist_rate(vdot)
            if rows is None:  # the nearest in M_C: what is left of y is M_C-orthogonal to every free motion
                assert plant.A @ Vdot == pytest.approx(-plant.Adot_V, abs=1e-10)
                assert tangent(plant.A).T @ plant.M_C @ (Vdot - y) == pytest.approx(np.zeros(r - k), abs=1e-10)
            else:
                assert S @ Vdot == pytest.approx(S @ y, abs=1e-10)

    @sizes
    def test_laws_coincide_on_a_flat_contact(self, rng: np.random.Generator, r: int, n: int, k: int) -> None:
        plant, y = Plant.random(rng, r, n, k), rng.normal(size=r)
        y = y - np.linalg.pinv(plant.A) @ plant.A @ y
        F, posture = plant.A.T @ rng.normal(size=k), rng.normal(size=n)
        book = analytic.hybrid_torque(*plant.arm, y, F, vdot_posture=posture)
        compensated = analytic.hybrid_torque(*plant.arm, y, F, law="compensated", vdot_posture=posture)
        assert compensated == pytest.approx(book, abs=1e-11)

    @sizes
    def test_joint_space_law_is_the_same_torque(self, rng: np.random.Generator, r: int, n: int, k: int) -> None:
        plant, y, F = Plant.random(rng, r, n, k), rng.normal(size=r), rng.normal(size=r)
        S = motion_axes(rng, plant.A)
        G = np.vstack([plant.A, S])
        posture, target = rng.normal(size=n), np.concatenate([-plant.Adot_V, S @ y])
        vdot = analytic.hybrid_acceleration(plant.M, G @ plant.J, target, G @ plant.drift, posture)
        lam = analytic.multiplier_error(plant.A, F)
        expected = analytic.inverse_dynamics(plant.M, plant.h, vdot, plant.J, plant.A, lam)
        tau = analytic.hybrid_torque(
            *plant.arm, y, F, Adot_V=plant.Adot_V, law="compensated", vdot_posture=posture, S=S
        )
        assert tau == pytest.approx(expected, abs=1e-10)
        assert plant.react(tau)[0] == pytest.approx(vdot, abs=1e-10)

    def test_posture_moves_the_null_space_alone(self, rng: np.random.Generator) -> None:
        plant, y, posture = Plant.random(rng, 6, 9, 3), rng.normal(size=6), rng.normal(size=9)
        rest, moved = (
            plant.react(analytic.hybrid_torque(*plant.arm, y, np.zeros(6), vdot_posture=p)) for p in (None, posture)
        )
        null = scipy.linalg.null_space(plant.J)
        assert plant.J @ (moved[0] - rest[0]) == pytest.approx(np.zeros(6), abs=1e-11)
        assert moved[1] == pytest.approx(rest[1], abs=1e-11)
        assert null.T @ plant.M @ (moved[0] - posture) == pytest.approx(np.zeros(3), abs=1e-11)
        assert null.T @ plant.M @ rest[0] == pytest.approx(np.zeros(3), abs=1e-11)

    def test_contact_and_motion_that_do_not_span_the_task(self, rng: np.random.Generator) -> None:
        # of all accelerations that reach the target, the one M-nearest to the posture; a repeated row changes nothing
        M, G, posture = spd(rng, 9), full_rank(rng, 4, 9), rng.normal(size=9)
        Gdot_v, target = rng.normal(size=(2, 4))
        vdot = analytic.hybrid_acceleration(M, G, target, Gdot_v, posture)
        kkt = np.block([[M, G.T], [G, np.zeros((4, 4))]])
        assert vdot == pytest.approx(
            np.linalg.solve(kkt, np.concatenate([M @ posture, target - Gdot_v]))[:9], abs=1e-12
        )
        twice = [np.concatenate([x, x[:2]]) for x in (G, target, Gdot_v)]
        assert analytic.hybrid_acceleration(M, *twice, posture) == pytest.approx(vdot, abs=1e-12)
        assert analytic.hybrid_acceleration(M, np.zeros((0, 9)), np.zeros(0), np.zeros(0), posture) == pytest.approx(
            posture, abs=0
        )

    def test_inverse_dynamics_undoes_the_plant(self, rng: np.random.Generator) -> None:
        plant, tau = Plant.random(rng, 6, 8, 3), rng.normal(size=8)
        vdot, lam = plant.react(tau)
        again = analytic.inverse_dynamics(plant.M, plant.h, vdot, plant.J, plant.A, lam)
        assert again == pytest.approx(tau, abs=1e-12)

    def test_book_law_leaks_an_error_on_a_held_axis_by_the_metric(self, rng: np.random.Generator) -> None:
        # y errs by e = kp * 1 mrad about the held x axis; the nearest possible motion depends on what "near" means
        plant, e = Plant.random(rng, 6, 7, 1), 100 * 1e-3
        flat = Plant(plant.M, plant.h, plant.J, plant.drift, np.eye(6)[:1], np.zeros(1))
        y = np.append(e, np.zeros(5))
        Vdot = flat.twist_rate(flat.react(analytic.hybrid_torque(*flat.arm, y, np.zeros(6)))[0])

        def nearest(W: Array) -> Array:
            root = np.linalg.cholesky(W).T
            return np.append(0, np.linalg.lstsq(root[:, 1:], root @ y, rcond=None)[0])

        assert nearest(np.eye(6)) == pytest.approx(np.zeros(6), abs=1e-15)
        assert nearest(flat.M_C) == pytest.approx(Vdot, abs=1e-13)
        compliance = np.linalg.inv(flat.M_C)
        assert Vdot[1:] == pytest.approx(-compliance[1:, 0] / compliance[0, 0] * e, abs=1e-13)
        assert np.abs(Vdot[1:]).max() > 0.05 * e

    def test_unknown_law(self, rng: np.random.Generator) -> None:
        plant = Plant.random(rng, 3, 3, 1)
        with pytest.raises(NameNotFound, match="no law named 'boook'; did you mean 'book'"):
            analytic.hybrid_torque(*plant.arm, np.zeros(3), np.zeros(3), law="boook")  # type: ignore[arg-type]
