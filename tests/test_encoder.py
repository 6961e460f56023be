"""Encoders and what else only the plant knows of a robot's state: closed forms, and truth beside what is measured."""

from __future__ import annotations

import math

import numpy as np
import pinocchio as pin
import pytest

from wbc.build import build
from wbc.encoder import Encoders
from wbc.errors import SpecError
from wbc.run import run
from wbc.sim import Simulator
from wbc.spec import Noise, Plant, load

DT, CUTOFF = 1e-3, 50.0
LEFT = math.exp(-2.0 * math.pi * CUTOFF * DT)  # of the low-pass, a tick


def encoders(model, seed=0, **noise):
    return Encoders(model, Noise(**noise), DT, np.random.default_rng(seed))


def test_without_noise_they_read_what_is(panda):
    exact, q, v = encoders(panda.model), panda.keyframes["home"], np.full(7, 0.3)
    assert exact.exact
    assert exact.read(q, v)[0] is q
    assert exact.read(q, v)[1] is v
    assert not encoders(panda.model, differenced=CUTOFF).exact
    assert not encoders(panda.model, position=1e-5).exact


def test_a_steady_velocity_is_found_as_a_low_pass_finds_it(panda):
    """v_k = (1 - exp(-2 pi f dt k)) c for q = c t; the velocity that is is not looked at."""
    made, rate = encoders(panda.model, differenced=CUTOFF), np.linspace(-1.0, 2.0, 7)
    for k in range(40):
        q, v = made.read(panda.keyframes["home"] + rate * k * DT, np.full(7, np.nan))
        np.testing.assert_allclose(q, panda.keyframes["home"] + rate * k * DT)
        np.testing.assert_allclose(v, (1.0 - LEFT**k) * rate, atol=1e-11)


def test_so_is_the_steady_twist_of_a_floating_base(go2, rng):
    made, q, V = encoders(go2.model, differenced=CUTOFF), go2.keyframes["home"], rng.normal(size=18)
    for k in range(40):
        _, v = made.read(pin.integrate(go2.model, q, V * k * DT), np.zeros(18))
        np.testing.assert_allclose(v, (1.0 - LEFT**k) * V, atol=1e-8)


def test_noise_of_positions_becomes_noise_of_velocities(panda):
    """The impulse response a, -a^2, -a^2 (1 - a), ... over dt has the square a^2 + a^3 / (2 - a)."""
    made, a, sigma = encoders(panda.model, position=2e-5, differenced=CUTOFF), 1.0 - LEFT, 2e-5
    home = panda.keyframes["home"]
    seen = [made.read(home, np.zeros(7)) for _ in range(4000)]
    q, v = (np.array([each[i] for each in seen[100:]]) for i in (0, 1))
    assert (q - home).std() == pytest.approx(sigma, rel=0.02)
    assert v.std() == pytest.approx(sigma / DT * math.sqrt(a**2 + a**3 / (2.0 - a)), rel=0.03)
    again = encoders(panda.model, position=2e-5, differenced=CUTOFF)
    for measured, repeated in zip(seen[:50], [again.read(home, np.zeros(7)) for _ in range(50)], strict=True):
        np.testing.assert_array_equal(np.concatenate(measured), np.concatenate(repeated))


def test_velocities_have_one_source(tmp_path):
    with pytest.raises(
        SpecError, match=r"plant\.noise\.velocity: it is made of the positions; expected either noise of its own or"
    ):
        load("eraser", ["plant.noise.velocity=0.01", "plant.noise.differenced=50"])


@pytest.mark.parametrize(("spec", "task", "frame"), [("eraser", "draw", "eraser"), ("g1_wipe_noisy", "reach", "mitt")])
def test_figures_are_of_what_is_not_of_what_is_measured(spec, task, frame):
    built, places, seen = build(load(spec, ["duration=0.02", "plant.noise.position=1e-3"])), [], []
    finished = run(
        built,
        show=lambda simulator: places.append(simulator.true_motion(frame)[0].translation),
        hook=lambda observed, _: seen.append(observed.q),
    )
    np.testing.assert_allclose(finished.log[f"{task}.position"], places, atol=1e-9)
    error = finished.log[f"{task}.desired"] - places
    np.testing.assert_allclose(
        np.linalg.norm(finished.log[f"{task}.error"][:, 3:], axis=1), np.linalg.norm(error, axis=1), atol=1e-4
    )
    assert 5e-4 < (finished.log["q"] - seen).std() < 2e-3


def test_a_torque_comes_late_by_the_delay(panda):
    simulator = Simulator(panda, panda.keyframes["home"], DT, Plant(delay=3))
    sent = []
    for tick in range(8):
        simulator.observe()
        simulator.apply(np.full(7, float(tick)))
        sent.append(simulator.data.ctrl[0])
    assert sent == [0, 0, 0, 0, 1, 2, 3, 4]


def test_a_wrong_mass_is_that_of_every_link_and_of_nothing_else():
    built = build(load("g1_wipe_noisy"))
    simulator = Simulator(built.robot, built.q, DT, built.spec.plant)
    nominal, own = built.robot.mujoco, built.robot.mujoco.body_weldid > 0
    for name in ("body_mass", "body_inertia"):
        np.testing.assert_allclose(getattr(simulator.model, name)[own], 1.05 * getattr(nominal, name)[own])
    assert simulator.model.body_mass[own].sum() == pytest.approx(
        1.05 * built.robot.state(built.q, np.zeros(35)).M[0, 0]
    )
    assert not nominal.body_mass[~own].any()
