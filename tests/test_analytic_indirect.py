"""Impedance and admittance laws against the arm that they drive, solved in joint space or simulated in time."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.linalg
from plants import Plant, full_rank, spd
from scipy.integrate import solve_ivp

from wbc import analytic
from wbc.analytic import Array

sizes = pytest.mark.parametrize(("m", "n"), [(1, 1), (1, 7), (3, 3), (3, 7), (6, 6), (6, 9)])


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(11)


class Pushed:
    """A free arm pushed by f_ext at m task coordinates, and the M, B, K it is to show there."""

    def __init__(self, rng: np.random.Generator, m: int, n: int) -> None:
        self.plant = Plant.random(rng, m, n, 0)
        self.M, self.B, self.K = (spd(rng, m) for _ in range(3))
        self.x_e, self.xd, self.f_ext = rng.normal(size=(3, m))

    def answer(self, tau: Array) -> Array:
        """xdd (m,) of M vdot + h = tau + J' f_ext."""
        return self.plant.twist_rate(self.plant.react(tau + self.plant.J.T @ self.f_ext)[0])

    def shows(self, xdd: Array, M: Array) -> Array:
        return M @ xdd + self.B @ self.xd + self.K @ self.x_e

    @property
    def h_C(self) -> Array:
        return analytic.task_bias(self.plant.M, self.plant.J, self.plant.h, self.plant.drift)


class TestImpedanceController:
    @sizes
    def test_book_law_shows_the_impedance(self, rng: np.random.Generator, m: int, n: int) -> None:
        # the law needs the very xdd it causes: for which push does the arm answer with it?
        arm, xdd = Pushed(rng, m, n), rng.normal(size=m)
        arm.f_ext = arm.shows(xdd, arm.M)
        tau = analytic.impedance_torque(arm.plant.J, arm.plant.M_C, arm.h_C, xdd, arm.xd, arm.x_e, arm.M, arm.B, arm.K)
        assert arm.answer(tau) == pytest.approx(xdd, abs=1e-9)

    @sizes
    def test_massless_law_leaves_the_arm(self, rng: np.random.Generator, m: int, n: int) -> None:
        arm = Pushed(rng, m, n)
        tau = analytic.impedance_torque_massless(arm.plant.J, arm.h_C, arm.xd, arm.x_e, arm.B, arm.K)
        assert arm.shows(arm.answer(tau), arm.plant.M_C) == pytest.approx(arm.f_ext, abs=1e-9)

    def test_massless_law_is_the_book_law_of_the_arm_itself(self, rng: np.random.Generator) -> None:
        arm, xdd = Pushed(rng, 3, 7), rng.normal(size=3)
        J, M_C, h_C = arm.plant.J, arm.plant.M_C, arm.h_C
        book = analytic.impedance_torque(J, M_C, h_C, xdd, arm.xd, arm.x_e, M_C, arm.B, arm.K)
        massless = analytic.impedance_torque_massless(J, h_C, arm.xd, arm.x_e, arm.B, arm.K)
        assert book == pytest.approx(massless, abs=1e-12)

    def test_gravity_law_holds_an_arm_at_rest_as_a_spring(self, rng: np.random.Generator) -> None:
        # at rest g = tau + J' f_ext, so that f_ext = K (x - x_d); n = m, or the posture would fall
        J, g, K, f_ext, x_d = full_rank(rng, 3, 3), 10 * rng.normal(size=3), spd(rng, 3), *rng.normal(size=(2, 3))
        x = x_d + np.linalg.solve(K, f_ext)
        tau = analytic.impedance_torque_gravity(J, g, x, x_d, np.zeros(3), 5, K)
        assert tau + J.T @ f_ext == pytest.approx(g, abs=1e-12)

    def test_gravity_law_damps(self, rng: np.random.Generator) -> None:
        J, v, B, zero = full_rank(rng, 3, 7), rng.normal(size=7), spd(rng, 3), np.zeros(3)
        tau = analytic.impedance_torque_gravity(J, np.zeros(7), zero, zero, J @ v, B, 0)
        assert v @ tau == pytest.approx(-(J @ v) @ B @ (J @ v))

    @sizes
    def test_acceleration_target_shows_the_impedance(self, rng: np.random.Generator, m: int, n: int) -> None:
        arm = Pushed(rng, m, n)
        Lam = analytic.task_inertia(arm.plant.M, arm.plant.J)
        y = analytic.impedance_acceleration(arm.M, arm.B, arm.K, arm.xd, arm.x_e, arm.f_ext, Lam)
        xdd = arm.answer(arm.plant.J.T @ (Lam @ y + arm.h_C))
        assert arm.shows(xdd, arm.M) == pytest.approx(arm.f_ext, abs=1e-9)

    def test_acceleration_target_of_three_rows_beside_a_task_of_orientation(self, rng: np.random.Generator) -> None:
        arm, turn = Pushed(rng, 6, 7), rng.normal(size=3)
        J, (M, B, K), f = arm.plant.J, (spd(rng, 3) for _ in range(3)), arm.f_ext[3:]
        arm.f_ext[:3] = 0
        Lam = analytic.task_inertia(arm.plant.M, J[3:])
        for mass in (M, Lam):
            y = analytic.impedance_acceleration(mass, B, K, arm.xd[3:], arm.x_e[3:], f, Lam)
            xdd = arm.answer(J.T @ (arm.plant.M_C @ np.append(turn, y) + arm.h_C))[3:]
            assert mass @ xdd + B @ arm.xd[3:] + K @ arm.x_e[3:] == pytest.approx(f, abs=1e-9)
        # the last, massless, asks for no measured force
        assert y == pytest.approx(-np.linalg.solve(Lam, B @ arm.xd[3:] + K @ arm.x_e[3:]), abs=1e-12)
        # a plain wrench in the place of M_C y is another law: the two axes of a rigid body couple
        wrench = np.append(arm.plant.M_C[:3, :3] @ turn, -B @ arm.xd[3:] - K @ arm.x_e[3:])
        plain = arm.answer(J.T @ (wrench + arm.h_C))[3:]
        assert np.abs(plain - xdd).max() > 0.02 * np.abs(xdd).max()


class TestAdmittanceController:
    @sizes
    def test_exact_law_shows_the_admittance(self, rng: np.random.Generator, m: int, n: int) -> None:
        arm = Pushed(rng, m, n)
        xdd = analytic.admittance_acceleration(arm.M, arm.B, arm.K, arm.f_ext, arm.xd, arm.x_e)
        assert arm.shows(xdd, arm.M) == pytest.approx(arm.f_ext, abs=1e-12)
        p = arm.plant
        assert arm.answer(analytic.admittance_torque(p.M, p.h, p.J, p.drift, xdd, arm.f_ext)) == pytest.approx(
            xdd, abs=1e-9
        )

    @sizes
    def test_printed_law_answers_with_the_push_itself_added(self, rng: np.random.Generator, m: int, n: int) -> None:
        arm = Pushed(rng, m, n)
        xdd = analytic.admittance_acceleration(arm.M, arm.B, arm.K, arm.f_ext, arm.xd, arm.x_e)
        p = arm.plant
        answer = arm.answer(analytic.admittance_torque(p.M, p.h, p.J, p.drift, xdd))
        assert answer - xdd == pytest.approx(np.linalg.solve(p.M_C, arm.f_ext), abs=1e-9)
        S = analytic.printed_scale(arm.M, p.M_C)
        assert S @ arm.shows(answer, arm.M) == pytest.approx(arm.f_ext, abs=1e-8)
        assert pytest.approx(analytic.rendered_as_printed(arm.M, p.M_C), abs=1e-12) == S @ arm.M

    def test_least_squares_joints_move_least(self, rng: np.random.Generator) -> None:
        p, xdd = Plant.random(rng, 3, 7, 0), rng.normal(size=3)
        vdot = np.linalg.solve(p.M, analytic.admittance_torque(p.M, p.h, p.J, p.drift, xdd) - p.h)
        assert p.J @ vdot + p.drift == pytest.approx(xdd, abs=1e-12)
        assert scipy.linalg.null_space(p.J).T @ vdot == pytest.approx(np.zeros(4), abs=1e-12)

    def test_rendered_as_printed_is_the_sum_of_the_mobilities(self, rng: np.random.Generator) -> None:
        M, Lam = spd(rng, 3), spd(rng, 3)
        both = np.linalg.inv(np.linalg.inv(M) + np.linalg.inv(Lam))
        assert analytic.rendered_as_printed(M, Lam) == pytest.approx(both, abs=1e-13)
        assert analytic.rendered_as_printed(4.0, 4.0) == 2.0
        assert analytic.rendered_as_printed(4.0, 12.0) == pytest.approx(4 / (1 + 4 / 12))
        assert analytic.printed_scale(4.0, 12.0) == pytest.approx(0.75)

    def test_printed_law_in_time_is_the_scaled_impedance(self, rng: np.random.Generator) -> None:
        # a pushed arm under the printed law, at 1 kHz, against the impedance that it is said to show
        m, b, k, Lam, f, dt, x, v = 4.0, 40.0, 200.0, 6.0, 10.0, 1e-3, np.zeros(1), np.zeros(1)
        one, none, steps = np.eye(1), np.zeros(1), []
        for _ in range(1000):
            xdd = analytic.admittance_acceleration(m, b, k, np.array([f]), v, x)
            tau = analytic.admittance_torque(Lam * one, none, one, none, xdd)
            a = (tau + f) / Lam
            x, v = x + dt * v + dt**2 / 2 * a, v + dt * a
            steps.append(x[0])
        S = float(analytic.printed_scale(m, Lam))
        shown = analytic.step_response(S * m, S * b, S * k, f, dt * np.arange(1, 1001))[0]
        asked = analytic.step_response(m, b, k, f, dt * np.arange(1, 1001))[0]
        assert np.array(steps) == pytest.approx(shown, abs=2e-3 * shown.max())
        assert steps[-1] / asked[-1] == pytest.approx(1 + m / Lam, rel=0.02)

    def test_printed_law_in_time_of_matrices(self, rng: np.random.Generator) -> None:
        M, B, K, Lam, f = spd(rng, 2), 4 * spd(rng, 2), spd(rng, 2), spd(rng, 2), np.array([1.0, -2.0])
        J, M_q = np.eye(2), Lam

        def arm(_: float, z: Array) -> Array:
            xdd = analytic.admittance_acceleration(M, B, K, f, z[2:], z[:2])
            tau = analytic.admittance_torque(M_q, np.zeros(2), J, np.zeros(2), xdd)
            return np.append(z[2:], np.linalg.solve(M_q, tau + f))

        S = analytic.printed_scale(M, Lam)
        X = np.block([[np.zeros((2, 2)), np.eye(2)], [-np.linalg.solve(S @ M, S @ np.hstack([K, B]))]])
        rest = np.append(np.linalg.solve(S @ K, f), np.zeros(2))
        z = solve_ivp(arm, (0, 2), np.zeros(4), rtol=1e-9, atol=1e-12).y[:, -1]
        assert z == pytest.approx(rest - scipy.linalg.expm(2 * X) @ rest, abs=1e-7)


class TestHighAndLow:
    def test_motion_controller_gives_way_by_its_compliance(self) -> None:
        kp, kd, Lam, f, x, v = 100.0, 20.0, 3.0, 6.0, 0.0, 0.0
        for _ in range(3000):
            v += 1e-3 * ((-Lam * (kp * x + kd * v) + f) / Lam)
            x += 1e-3 * v
        assert analytic.motion_compliance(kp, Lam) == pytest.approx(x / f, rel=1e-9)
        assert analytic.motion_compliance([100, 400], 3) == pytest.approx([1 / 300, 1 / 1200])

    @pytest.mark.parametrize("w", [2.0, 20.0, 200.0])
    def test_force_controller_on_a_moving_contact(self, w: float) -> None:
        # the contact moves by dx cos wt: Lam xdd = -(1 + Kp) f - Ki int f, integrated for f until the start has died
        Lam, Kp, Ki, dx = 3.0, 0.3, 10.0, 1e-3

        def loop(t: float, z: Array) -> Array:  # z = int f
            return (Lam * dx * w**2 * np.cos(w * t) - Ki * z) / (1 + Kp)

        t = 4.0 + np.linspace(0, 2 * np.pi / w, 13)[:-1]
        z = solve_ivp(loop, (0, t[-1]), [0.0], t_eval=t, rtol=1e-10, atol=1e-13, max_step=0.1 / w).y[0]
        F = 2 * np.mean(np.array([loop(s, a) for s, a in zip(t, z, strict=True)]) * np.exp(-1j * w * t))
        assert analytic.force_stiffness(w, Lam, Kp, Ki) == pytest.approx(abs(F) / dx, rel=1e-5)

    def test_force_controller_at_rest_and_without_integral(self) -> None:
        assert analytic.force_stiffness([0.0, 2.0], 3.0, 0.5, 0.0) == pytest.approx([0, 3 * 4 / 1.5])
        assert analytic.force_stiffness(0.0, 3.0, 0.5, 10.0) == 0
