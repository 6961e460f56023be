"""Poles of the sampled force loop against the loop itself, simulated tick by tick."""

import math

import numpy as np
import pytest
from scipy.linalg import expm

from wbc.dynamics import mobility
from wbc.stability import STIFFNESS, damping_margin, force_poles, radius


def growth(mass, kp, ki, damping, alpha, dt, stiffness, delay=1, ticks=6000):
    """Growth of the loop's state per tick: the module's equations, one tick after the other, no matrix of the whole."""
    if stiffness is not None:
        # exact over one tick of constant push: d/dt (x, v, u) = (v, (u - kappa x) / m, 0)
        plant = expm(dt * np.array([[0, 1, 0], [-stiffness / mass, 0, 1 / mass], [0, 0, 0]]))
    rng = np.random.default_rng(1)
    x, v = rng.normal(size=2) * (1.0 / (stiffness or 1.0))
    s, integral, forces = 0.0, 0.0, list(rng.normal(size=delay))
    scale, sizes = 0.0, []
    for _ in range(ticks):
        s += alpha * (forces[-1] - s)
        push = -kp * s + ki * integral
        integral -= dt * s
        if stiffness is None:
            force = push
        else:
            force = stiffness * x
            push -= damping * v
            x, v, _ = plant @ (x, v, push)
        forces = [force, *forces[:-1]]
        size = math.sqrt(
            sum(f * f for f in forces)
            + s * s
            + (ki * integral) ** 2
            + (0 if stiffness is None else mass * v * v * stiffness)
        )
        sizes.append(math.log(size) + scale)
        if not 1e-100 < size < 1e100:  # start again from the same direction
            x, v, s, integral, forces = x / size, v / size, s / size, integral / size, [f / size for f in forces]
            scale += math.log(size)
    half = ticks // 2
    return math.exp(np.polyfit(np.arange(half), sizes[half:], 1)[0])


CASES = {  # mass, kp, ki, damping, alpha, dt, stiffness, delay
    "soft and slow": (3.0, 0.3, 10.0, 30.0, 1.0, 1e-3, 2e3, 1),
    "undamped": (3.0, 0.3, 10.0, 0.0, 0.27, 1e-3, 1e4, 1),
    "damped": (3.0, 0.3, 10.0, 300.0, 0.27, 1e-3, 1e4, 1),
    "stiff": (3.0, 0.3, 10.0, 300.0, 0.27, 1e-3, 1e6, 1),
    "late": (3.0, 0.3, 10.0, 300.0, 0.27, 1e-3, 1e5, 3),
    "too much": (3.0, 4.0, 10.0, 50.0, 1.0, 1e-3, 1e5, 1),
    "no integral": (1.5, 0.5, 0.0, 100.0, 0.5, 2e-3, 1e4, 2),
    "moment": (0.02, 0.3, 10.0, 0.5, 0.27, 1e-3, 100.0, 1),
    "rigid": (3.0, 0.3, 10.0, 0.0, 1.0, 1e-3, None, 1),
    "rigid, filtered": (3.0, 2.0, 10.0, 0.0, 0.27, 1e-3, None, 1),
    "rigid, late": (3.0, 0.9, 10.0, 0.0, 0.5, 1e-3, None, 4),
    "rigid, too much": (3.0, 1.3, 10.0, 0.0, 1.0, 1e-3, None, 2),
}


@pytest.mark.parametrize("name", CASES)
def test_radius_is_how_the_loop_grows_or_decays(name):
    assert radius(*CASES[name]) == pytest.approx(growth(*CASES[name]), abs=2e-4)


def test_cases_lie_on_both_sides():
    found = [radius(*case) for case in CASES.values()]
    assert min(found) < 0.9999 < 1.0001 < max(found)


@pytest.mark.parametrize("kp", [0.1, 0.5, 0.99, 1.5])
def test_on_a_rigid_wall_the_proportional_part_has_the_eigenvalue_minus_kp(kp):
    assert radius(3.0, kp, 0.0, 0.0, 1.0, 1e-3, None) == pytest.approx(kp, abs=1e-12)


@pytest.mark.parametrize("cutoff", [20.0, 50.0, 200.0])
def test_a_filter_allows_kp_below_two_over_alpha_less_one(cutoff):
    alpha = 1 - math.exp(-2 * math.pi * cutoff * 1e-3)
    edge = 2 / alpha - 1
    assert radius(3.0, 0.999 * edge, 0.0, 0.0, alpha, 1e-3, None) < 1.0
    assert radius(3.0, edge, 0.0, 0.0, alpha, 1e-3, None) == pytest.approx(1.0, abs=1e-12)
    assert radius(3.0, 1.001 * edge, 0.0, 0.0, alpha, 1e-3, None) > 1.0


def poles(damping, delay=1, axes=("fz",), masses=(3.0,)):
    k = len(axes)
    alpha = 1 - math.exp(-2 * math.pi * 50 * 1e-3)
    return force_poles(
        "board", axes, np.array(masses), 0.3 * np.eye(k), 10 * np.eye(k), damping * np.eye(k), alpha, 1e-3, delay
    )


def test_gains_that_pass_on_a_rigid_wall_diverge_on_an_undamped_spring_and_damping_settles_them():
    bare = {pole.stiffness: pole.radius for pole in poles(0.0)}
    assert bare.pop(None) < 1.0
    assert min(r for kappa, r in bare.items() if kappa >= 2e3) > 1.0
    assert max(pole.radius for pole in poles(300.0)) < 1.0


def test_poles_name_axis_and_stiffness():
    found = poles(300.0, axes=("mx", "fz"), masses=(0.02, 3.0))
    assert [pole.axis for pole in found] == ["mx"] * 14 + ["fz"] * 14
    assert [pole.stiffness for pole in found[:14]] == [*STIFFNESS["moment"], None]
    assert [pole.stiffness for pole in found[14:]] == [*STIFFNESS["force"], None]
    assert {pole.contact for pole in found} == {"board"}
    assert (STIFFNESS["force"][[0, -1]] == [1e3, 1e6]).all()
    assert (STIFFNESS["moment"][[0, -1]] == [1.0, 1e3]).all()
    assert found[20].radius == pytest.approx(poles(300.0)[6].radius, abs=1e-15)


@pytest.mark.parametrize("scale", [0.98, 1.02])
def test_damping_is_stable_below_two(scale, rng):
    """v <- v - dt W K v decays where dt max eig(W K) < 2, also where W couples the axes."""
    X = rng.normal(size=(3, 3))
    W, K, dt = X @ X.T + 0.1 * np.eye(3), np.diag(rng.uniform(5, 50, 3)), 1e-3
    K *= 2 * scale / damping_margin(W, K, dt)
    v = rng.normal(size=3)
    start = np.linalg.norm(v)
    for _ in range(2000):
        v = v - dt * W @ (K @ v)
    assert (np.linalg.norm(v) < start) == (damping_margin(W, K, dt) < 2)
    assert damping_margin(W, K, dt) == pytest.approx(2 * scale)


def test_one_number_for_all_axes_damps_the_wrist_too_much(panda):
    J = panda.state(panda.keyframes["home"], np.zeros(7)).frame("eraser").J[[0, 1, 5]]
    W = mobility(panda.state(panda.keyframes["home"], np.zeros(7)), J)
    assert damping_margin(W, 300.0 * np.eye(3), 1e-3) > 2
    assert damping_margin(W, np.diag([5.0, 5.0, 500.0]), 1e-3) < 2
    assert damping_margin(np.zeros((0, 0)), np.zeros((0, 0)), 1e-3) == 0.0
