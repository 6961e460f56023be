"""Mass, spring and damper against the matrix exponential and a steady sinusoid integrated in time."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.linalg
from scipy.integrate import solve_ivp

from wbc import analytic
from wbc.errors import GainError

SYSTEMS = {
    "under-damped": (2.0, 3.0, 200.0),
    "almost undamped": (2.0, 1e-6, 200.0),
    "undamped": (2.0, 0.0, 200.0),
    "critically damped": (2.0, 40.0, 200.0),
    "barely under-damped": (2.0, 40.0 * (1 - 1e-9), 200.0),
    "barely over-damped": (2.0, 40.0 * (1 + 1e-9), 200.0),
    "over-damped": (2.0, 60.0, 200.0),
    "heavily over-damped": (2.0, 1e5, 200.0),
    "nearly no spring": (2.0, 3.0, 1e-9),
    "no spring": (2.0, 3.0, 0.0),
    "mass alone": (2.0, 0.0, 0.0),
}
systems = pytest.mark.parametrize(("m", "b", "k"), SYSTEMS.values(), ids=SYSTEMS)


class TestStepResponse:
    @systems
    def test_is_the_matrix_exponential(self, m: float, b: float, k: float) -> None:
        # d/dt (x, xd, f) = X (x, xd, f)
        X = np.array([[0, 1, 0], [-k / m, -b / m, 1 / m], [0, 0, 0]])
        t = np.array([0, 1e-6, 1e-3, 0.05, 0.3, 1, 7])
        x, xd = analytic.step_response(m, b, k, 5.0, t)
        exact = np.array([5 * scipy.linalg.expm(X * s)[:2, 2] for s in t])
        assert x == pytest.approx(exact[:, 0], rel=1e-9, abs=1e-15)
        assert xd == pytest.approx(exact[:, 1], rel=1e-9, abs=1e-14)

    @systems
    def test_satisfies_its_equation_from_rest(self, m: float, b: float, k: float) -> None:
        dt = 1e-6 if b > 1e3 else 1e-4
        t = np.linspace(0, 1000 * dt, 50)[1:]
        x, xd = analytic.step_response(m, b, k, 5.0, t)
        (x_ahead, xd_ahead), (x_behind, xd_behind) = (analytic.step_response(m, b, k, 5.0, t + s) for s in (dt, -dt))
        assert (x_ahead - x_behind) / (2 * dt) == pytest.approx(xd, rel=1e-2, abs=1e-7)
        assert m * (xd_ahead - xd_behind) / (2 * dt) + b * xd + k * x == pytest.approx(5.0, rel=1e-3)
        assert analytic.step_response(m, b, k, 5.0, 0.0) == (pytest.approx(0, abs=0), pytest.approx(0, abs=0))

    def test_rests_at_the_deflection_of_the_spring(self) -> None:
        for b in (3.0, 40.0, 60.0):
            x, xd = analytic.step_response(2.0, b, 200.0, 5.0, 100.0)
            assert (x, xd) == (pytest.approx(5 / 200), pytest.approx(0, abs=1e-15))

    def test_shape_is_that_of_the_time(self) -> None:
        assert [a.shape for a in analytic.step_response(1, 1, 1, 1, np.zeros((2, 3)))] == [(2, 3), (2, 3)]

    def test_frequency_and_damping_are_read_off_the_oscillation(self) -> None:
        m, b, k = 2.0, 3.0, 200.0
        t = np.linspace(0, 3, 300_001)
        xd = analytic.step_response(m, b, k, 1.0, t)[1]
        extreme = t[:-1][(xd[:-1] > 0) != (xd[1:] > 0)][1:]  # peaks of x, half a period apart
        overshoot = np.abs(analytic.step_response(m, b, k, k, extreme[:2])[0] - 1)
        decrement = np.log(overshoot[0] / overshoot[1])
        zeta = decrement / np.hypot(np.pi, decrement)
        assert analytic.damping_ratio(m, b, k) == pytest.approx(zeta, rel=1e-4)
        wd = np.pi / np.diff(extreme).mean()
        assert analytic.natural_frequency(m, k) == pytest.approx(wd / np.sqrt(1 - zeta**2), rel=1e-4)

    def test_damping_ratio_of_the_limits(self) -> None:
        assert analytic.damping_ratio(2, 40, 200) == pytest.approx(1)
        assert analytic.damping_ratio(2, 0, 200) == 0
        assert analytic.damping_ratio(2, 40, 0) == np.inf
        assert analytic.damping_ratio(2, 0, 0) == 0

    @pytest.mark.parametrize(
        ("system", "message"),
        [
            ((0, 1, 1), r"^m: got 0, expected a finite number above 0$"),
            ((1, -1, 1), r"^b: got -1, expected a finite number of at least 0$"),
            ((1, 1, np.nan), r"^k: got nan, expected"),
            ((np.inf, 1, 1), r"^m: got inf, expected"),
        ],
    )
    def test_refused(self, system: tuple[float, float, float], message: str) -> None:
        with pytest.raises(GainError, match=message):
            analytic.step_response(*system, 1.0, 0.0)


class TestFrequencyResponse:
    w = np.array([0.1, 1, 5, 30, 500])

    @pytest.mark.parametrize("system", [(2.0, 3.0, 200.0), (2.0, 60.0, 200.0), (0.0, 3.0, 20.0), (2.0, 3.0, 0.0)])
    def test_impedance_and_admittance_are_inverse(self, system: tuple[float, float, float]) -> None:
        Z, Y = analytic.impedance(*system, self.w), analytic.admittance(*system, self.w)
        assert pytest.approx(np.ones(5), abs=1e-14) == Z * Y

    def test_what_comes_between_counts_twice_round_the_loop(self) -> None:
        through = {"delay": 2e-3, "cutoff": 50.0}
        Z, Y = (law(2, 3, 200, self.w, **through) for law in (analytic.impedance, analytic.admittance))
        assert pytest.approx(analytic.measurement(self.w, **through) ** 2, abs=1e-14) == Z * Y

    @pytest.mark.parametrize(("delay", "cutoff"), [(0.0, None), (0.05, None), (0.0, 2.0), (0.05, 2.0)])
    def test_admittance_is_a_steady_sinusoid(self, delay: float, cutoff: float | None) -> None:
        # f = cos wt goes through the delay and the filter, and moves the mass; after 20 s all else has died
        m, b, k, w = 2.0, 12.0, 80.0, 7.0
        rate = 1e9 if cutoff is None else 2 * np.pi * cutoff

        def law(t: float, z: np.ndarray) -> list[float]:
            force = np.cos(w * (t - delay))
            measured = force if cutoff is None else z[2]
            return [z[1], (measured - b * z[1] - k * z[0]) / m, 0.0 if cutoff is None else rate * (force - z[2])]

        t = 20 + np.linspace(0, 2 * np.pi / w, 9)[:-1]
        run = solve_ivp(law, (0, t[-1]), np.zeros(3), t_eval=t, rtol=1e-9, atol=1e-12)
        X = 2 * np.mean(run.y[0] * np.exp(-1j * w * t))
        assert analytic.admittance(m, b, k, w, delay=delay, cutoff=cutoff) == pytest.approx(X, rel=1e-6)

    def test_impedance_is_the_force_of_a_moved_mass(self) -> None:
        # x = cos wt: F = m xdd + b xd + k x
        m, b, k, w, t = 2.0, 3.0, 200.0, 7.0, np.linspace(0, 2 * np.pi / 7, 9)[:-1]
        force = (k - m * w**2) * np.cos(w * t) - b * w * np.sin(w * t)
        F = 2 * np.mean(force * np.exp(-1j * w * t))
        assert analytic.impedance(m, b, k, w) == pytest.approx(F, rel=1e-13)
        late = analytic.impedance(m, b, k, w, delay=0.1)
        assert late == pytest.approx(F * np.exp(-0.7j), rel=1e-13)

    def test_filter_halves_the_power_at_its_cutoff(self) -> None:
        L = analytic.measurement(2 * np.pi * 30, cutoff=30.0)
        assert abs(L) ** 2 == pytest.approx(0.5)
        assert np.angle(L) == pytest.approx(-np.pi / 4)


class TestImpact:
    @pytest.mark.parametrize("zeta", [0.0, 1e-6, 0.05, 0.3, 0.49, 0.5, 0.51, 0.9, 1.0, 1.5, 6.0])
    def test_is_the_largest_force_on_the_way(self, zeta: float) -> None:
        m, k, v = 4.0, 9e4, 0.02
        b = 2 * zeta * np.sqrt(k * m)
        X = np.array([[0.0, 1.0], [-k / m, -b / m]])
        step, state, forces = scipy.linalg.expm(1e-5 * X), np.array([0.0, v]), []
        for _ in range(3000):  # to beyond a quarter of a period
            forces.append(k * state[0] + b * state[1])
            state = step @ state
        assert analytic.impact_peak(m, b, k, v) == pytest.approx(max(forces), rel=1e-6)

    def test_grows_with_speed_and_is_v_sqrt_km_without_damping(self) -> None:
        assert analytic.impact_peak(4.0, 0.0, 9e4, 0.02) == pytest.approx(0.02 * np.sqrt(4.0 * 9e4))
        assert analytic.impact_peak(4.0, 300.0, 9e4, 0.06) == pytest.approx(
            3 * analytic.impact_peak(4.0, 300, 9e4, 0.02)
        )
        assert analytic.impact_peak(4.0, 300.0, 9e4, 0.0) == 0.0
        assert analytic.impact_peak(4.0, 300.0, 0.0, 0.02) == pytest.approx(6.0)

    @pytest.mark.parametrize(
        ("arguments", "name"),
        [((0, 1, 1, 1), "m"), ((1, -1, 1, 1), "b"), ((1, 1, np.nan, 1), "k"), ((1, 1, 1, -1), "v")],
    )
    def test_what_is_no_mass_spring_damper_or_speed_is_refused(self, arguments, name) -> None:
        with pytest.raises(GainError, match=f"^{name}: got"):
            analytic.impact_peak(*arguments)
