"""What a tick does to impedance and admittance, against arms simulated tick by tick."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from wbc import analytic
from wbc.analytic import Array

M, B, K, dt = 2.0, 20.0, 100.0, 1e-3
W = np.array([1.0, 2, 3, 5, 7, 10, 13])


def push(order: int, t: Array) -> Array:
    """A force of many frequencies, cos at each, and its integrals once and twice."""
    phase = np.multiply.outer(t, W) + 1.7 * np.arange(len(W)) - order * np.pi / 2
    return np.sum(np.cos(phase) / W**order, axis=-1)


def rendered(Lam: float, *, hold: bool) -> tuple[Array, Array]:
    """t (N,) and f, xdd, v, x (N, 4) at the ticks of an arm under the law, after 20 s: a wrench one tick old.

    hold: the force goes on between ticks, and the motion is integrated exactly; otherwise semi-implicit Euler.
    """
    t = dt * np.arange(40_001)
    f, f1, f2 = (push(order, t) for order in range(3))
    ticks, x, v, measured = np.zeros((40_000, 4)), 0.0, 0.0, 0.0
    for i in range(40_000):
        u = Lam * (measured - B * v - K * x) / M - measured
        xdd, measured = (u + f[i]) / Lam, f[i]
        ticks[i] = f[i], xdd, v, x
        if hold:
            x += v * dt + (u * dt**2 / 2 + f2[i + 1] - f2[i] - f1[i] * dt) / Lam
            v += (u * dt + f1[i + 1] - f1[i]) / Lam
        else:
            v += dt * xdd
            x += dt * v
    return t[20_000:-1], ticks[20_000:]


class TestRenderedMass:
    @pytest.mark.parametrize("Lam", [1.5, 5.0, 20.0])
    @pytest.mark.parametrize("hold", [False, True])
    def test_values_of_a_tick_obey_it(self, Lam: float, hold: bool) -> None:
        f, xdd, v, x = rendered(Lam, hold=hold)[1].T
        jerk = np.diff(xdd, prepend=xdd[0]) / dt
        mass, damping, stiffness, _ = np.linalg.lstsq(np.stack([xdd, v, x, jerk], axis=1)[1:], f[1:], rcond=None)[0]
        assert mass - M == pytest.approx(analytic.rendered_mass(M, B, dt, Lam) - M, rel=0.015)
        assert damping - B == pytest.approx(K * dt * (1 - M / Lam), rel=0.015)
        assert stiffness == pytest.approx(K, rel=1e-4)

    @pytest.mark.parametrize("Lam", [1.5, 5.0, 20.0])
    def test_a_hand_feels_it(self, Lam: float) -> None:
        t, ticks = rendered(Lam, hold=True)
        waves = np.exp(1j * np.multiply.outer(t, W))
        parts = np.concatenate([waves.real, -waves.imag], axis=1)
        F, _, _, X = np.linalg.lstsq(parts, ticks, rcond=None)[0].T
        Z = (F[: len(W)] + 1j * F[len(W) :]) / (X[: len(W)] + 1j * X[len(W) :])
        mass = -np.polyfit(W**2, Z.real, 2)[1]
        assert mass - M == pytest.approx(analytic.rendered_mass(M, B, dt, Lam, hold=True) - M, rel=0.015)

    def test_an_arm_of_the_mass_asked_for_is_exact(self) -> None:
        f, xdd, v, x = rendered(M, hold=False)[1].T
        assert analytic.rendered_mass(M, B, dt, M) == M
        assert M * xdd + B * v + K * x == pytest.approx(f, abs=1e-12)


def edge(stable: Callable[[float], bool], low: float, high: float) -> float:
    """Where `stable` changes its answer, to 0.1 %."""
    below = stable(low)
    assert stable(high) != below
    while high - low > 1e-3 * low:
        middle = (low + high) / 2
        low, high = (middle, high) if stable(middle) == below else (low, middle)
    return low


def settles(mass: float, B: float, K: float, dt: float, *, hold: bool = False, Lam: float | None = None) -> bool:
    """Free motion from 1 m; with an arm Lam, the mass is asked for by an acceleration one tick old."""
    x, v, xdd = 1.0, 0.0, 0.0
    for _ in range(4000):
        xdd = (-B * v - K * x) / mass if Lam is None else ((Lam - mass) * xdd - B * v - K * x) / Lam
        x += dt * v + (0.5 if hold else 1.0) * dt**2 * xdd
        v += dt * xdd
        if abs(v * dt) + abs(x) > 1e3:
            return False
    return abs(v * dt) + abs(x) < 1.0


class TestStability:
    @pytest.mark.parametrize(
        ("B", "K", "dt"), [(100, 0.1, 1e-3), (100, 500, 1e-3), (50, 20_000, 1e-3), (10, 3e4, 1e-3), (30, 10, 0.02)]
    )
    def test_least_stable_mass(self, B: float, K: float, dt: float) -> None:
        expected = analytic.least_stable_mass(B, K, dt)
        # a motion that stays neither settles nor grows within the run: the edge is good to 2 %
        found = edge(lambda mass: settles(mass, B, K, dt), 0.3 * expected, 1.5 * expected)
        assert found == pytest.approx(expected, rel=0.02)

    @pytest.mark.parametrize(("B", "K", "dt"), [(100, 500, 1e-3), (30, 10, 0.02)])
    def test_least_stable_mass_of_a_real_arm_is_the_damping_alone(self, B: float, K: float, dt: float) -> None:
        found = edge(lambda mass: settles(mass, B, K, dt, hold=True), 0.2 * B * dt, B * dt)
        assert found == pytest.approx(B * dt / 2, rel=0.02)
        assert settles(1.02 * analytic.least_stable_mass(B, K, dt), B, K, dt, hold=True)

    @pytest.mark.parametrize(("mass", "K", "dt"), [(1.0, 2e3, 5e-3), (2.0, 1e4, 2e-3)])
    def test_least_stable_damping_of_a_real_arm(self, mass: float, K: float, dt: float) -> None:
        expected = analytic.least_stable_damping(K, dt)
        found = edge(lambda B: settles(mass, B, K, dt, hold=True), 0.3 * expected, 2 * expected)
        assert found == pytest.approx(expected, rel=0.02)
        assert settles(mass, 0.3 * expected, K, dt)  # the simulator's integrator does not show it

    @pytest.mark.parametrize(("B", "K", "dt"), [(100, 500, 1e-3), (1000, 500, 1e-3), (500, 1e5, 5e-3)])
    def test_acceleration_feedback_limit(self, B: float, K: float, dt: float) -> None:
        Lam = 3.0
        expected = analytic.acceleration_feedback_limit(Lam, B, K, dt)
        found = edge(lambda mass: settles(mass, B, K, dt, Lam=Lam), 0.8 * expected, 1.5 * expected)
        assert found == pytest.approx(expected, rel=0.005)

    def test_acceleration_feedback_limit_of_a_short_tick(self) -> None:
        assert analytic.acceleration_feedback_limit(3.0) == 6.0
        assert edge(lambda m: settles(m, 100, 500, 1e-4, Lam=3.0), 4, 9) == pytest.approx(6, rel=0.005)
