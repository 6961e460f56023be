"""What a push tells of a run: fits of made-up ticks, and of the shipped specs, against what law and tick predict."""

from __future__ import annotations

from functools import lru_cache

import bars
import numpy as np
import pinocchio as pin
import pytest

from wbc import analytic
from wbc.build import build
from wbc.log import Log
from wbc.reference import hold
from wbc.response import bode, identify
from wbc.run import run
from wbc.spec import load
from wbc.task.impedance import AdmittanceTask, ImpedanceTask

DT, W = 1e-3, np.array([[0.3, 0.05], [0.05, 0.2]])
M, B, K = (
    np.array(part) for part in ([[2.0, 0.3], [0.3, 3.0]], [[60.0, 5.0], [5.0, 40.0]], [[300.0, 0.0], [0.0, 200.0]])
)
AXES = ("vx", "vy")


def wave(frequency, t):
    return np.sin(2 * np.pi * frequency * t)


def made_up(task, ticks=4000):
    """A log of an arm of mobility W under two pushes, semi-implicit Euler, the wrench one tick old."""
    log = Log(ticks, {"dt": DT})
    x, v, past = np.zeros(2), np.zeros(2), np.zeros(2)
    acceleration, X, V = np.zeros(2), np.zeros(2), np.zeros(2)
    for i in range(ticks):
        t = i * DT
        f = np.array([5 * wave(0.7, t) + 3 * wave(2.1, t), 4 * wave(0.4, t) + 3 * wave(1.3, t)])
        if isinstance(task, AdmittanceTask) and task.printed:
            a = np.linalg.solve(M, past - B @ v - K @ x) + W @ f
        elif isinstance(task, AdmittanceTask):
            a = np.linalg.solve(M, past - B @ V - K @ X)  # an arm that follows at once
            V = V + DT * a
            X = X + DT * V
        elif task.massless:
            a = W @ (f - B @ v - K @ x)
        elif task.source == "acceleration":
            a = acceleration + W @ (f - M @ acceleration - B @ v - K @ x)
        else:
            a = np.linalg.solve(M, past - B @ v - K @ x) + W @ (f - past)
        parts = {"displacement": x, "rate": v, "twist": v, "ahead": np.zeros(2), "external": f, "mobility": W}
        log.append((), t=t, **{f"feel.{name}": value for name, value in parts.items()})
        v = v + DT * a
        x = x + DT * v
        past, acceleration = f, a
    return log


def of(kind, mass=M, **more):
    return kind("tip", hold(pin.SE3.Identity()), mass, B, K, axes=AXES, **more)


CASES = {
    "wrench": of(ImpedanceTask),
    "acceleration": of(ImpedanceTask, source="acceleration"),
    "massless": of(ImpedanceTask, 0.0, source="none"),
    "admittance": of(AdmittanceTask),
    "printed": of(AdmittanceTask, law="printed"),
}


@pytest.mark.parametrize("case", CASES)
def test_the_law_s_own_numbers_are_found_again(case):
    task = CASES[case]
    fit = identify(made_up(task), "feel", task, settle=1.0, law=True)
    for found, asked in zip(fit[1:] if task.massless else fit, (B, K) if task.massless else (M, B, K), strict=True):
        np.testing.assert_allclose(found, asked, rtol=1e-6, atol=1e-6)


def test_and_as_felt_what_is_predicted_to_be_felt():
    wrench = identify(made_up(CASES["wrench"]), "feel", CASES["wrench"], settle=1.0)
    np.testing.assert_allclose(wrench.M, M + DT * (np.eye(2) - M @ W) @ B, rtol=0.01, atol=2e-3)
    printed = identify(made_up(CASES["printed"]), "feel", CASES["printed"], settle=1.0)
    Lam = np.linalg.inv(W)
    np.testing.assert_allclose(printed.M, analytic.rendered_as_printed(M, Lam), rtol=0.02, atol=5e-3)
    S = analytic.printed_scale(M, Lam)
    np.testing.assert_allclose(printed.K, S @ K, rtol=0.01, atol=0.5)


def test_what_does_not_move_tells_nothing():
    log = made_up(CASES["wrench"], 200)
    for part in ("displacement", "rate", "twist", "external"):
        log[f"feel.{part}"][:] = 0.0
    assert np.isnan(identify(log, "feel", CASES["wrench"]).M).all()


# --- the shipped specs ---


@lru_cache
def built_run(name, *overrides):
    made = build(load(name, overrides))
    return made, run(made)


def fits(name, *overrides):
    made, finished = built_run(name, *overrides)
    task = made.phases[0].tasks["feel"]
    Lam = np.linalg.inv(finished.log["feel.mobility"][1000:].mean(axis=0))
    return identify(finished.log, "feel", task, 1.0), task, Lam


def test_from_a_measured_acceleration():
    figures = built_run("impedance", "tasks.feel.external=acceleration", "duration=5")[1].summary["metrics"]
    for metric, bound in bars.SPECS["impedance"].items():
        assert figures[metric] <= bound


def test_a_small_mass_of_an_admittance_feels_as_predicted():
    fit, task, _ = fits("admittance", "tasks.feel.M=0.3", "duration=5")
    predicted = task.M + DT * task.B
    np.testing.assert_allclose(np.diag(fit.M) / np.diag(predicted), 1.0, atol=bars.SMALL_MASS_ERROR)
    assert (np.abs(np.diag(fit.M) / 0.3 - 1) > 0.1).all()  # which is not what was asked for


def test_the_printed_admittance_feels_as_predicted():
    gentle = [f"plant.pushes.hand.wrench.{axis}.sine.amplitude=0.4" for axis in ("fx", "fy", "fz")]  # Lam(q) stays
    fit, task, Lam = fits("admittance", "tasks.feel.law=printed", "duration=5", *gentle)
    S = analytic.printed_scale(task.M, Lam)
    np.testing.assert_allclose(S @ task.M, analytic.rendered_as_printed(task.M, Lam), atol=1e-9)
    for found, asked in zip(fit, (task.M, task.B, task.K), strict=True):
        predicted = S @ asked
        scale = np.sqrt(np.outer(np.diag(predicted), np.diag(predicted)))
        assert (np.abs(found - predicted) / scale).max() <= bars.PRINTED_ERROR
        assert (np.diag(found) / np.diag(asked)).max() < 0.8
    figures = built_run("admittance", "tasks.feel.law=printed", "duration=5")[1].summary["metrics"]
    assert max(figures[f"feel.law.{part}"] for part in ("mass_error", "damping_error", "stiffness_error")) < 2e-3


def test_impedance_and_admittance_are_each_others_inverse():
    made, finished = built_run("mass_spring_damper")
    spring, follower = (bode(finished.log, name, made.phases[0].tasks[name]) for name in ("spring", "follower"))
    assert spring.w.size >= bars.BODE_FREQUENCIES
    assert spring.w.max() == pytest.approx(2 * np.pi * 5)
    delays = follower.theory / spring.theory  # an admittance has the whole tick of delay, an impedance a part of it
    ZY = follower.Y / spring.Y
    assert np.abs(ZY / delays - 1).max() <= bars.ZY_ERROR
    assert np.abs(np.abs(ZY) - 1).max() <= bars.ZY_ERROR


def test_the_bode_picture_is_among_the_pictures(tmp_path):
    _, finished = built_run("mass_spring_damper")
    finished.write(tmp_path)
    assert (tmp_path / "bode.png").stat().st_size > 20_000


def test_a_speed_beyond_small_ones_shows_what_gravity_compensation_leaves_out():
    """The same with four times the push: the terms in v v that only `compensate: dynamics` cancels."""
    more = [f"plant.pushes.hand.wrench.{axis}.sine.amplitude=12" for axis in ("fx", "fy", "fz")]
    weight = built_run("impedance_gravity", "duration=5", *more)[1].summary["metrics"]
    all_of_it = built_run("impedance_massless", "duration=5", *more)[1].summary["metrics"]
    assert weight["feel.speed.max"] > 0.4
    assert weight["feel.damping_error"] > 5 * all_of_it["feel.damping_error"]
    assert all_of_it["feel.damping_error"] <= bars.SPECS["impedance_massless"]["feel.damping_error"]
