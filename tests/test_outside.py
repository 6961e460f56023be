"""Pushes, moved bodies, the sensor that feels them and its tare, with MuJoCo as the truth; the momentum observer."""

from __future__ import annotations

import bars
import mujoco
import numpy as np
import pytest

from wbc.build import build
from wbc.observer import MomentumObserver, errors, filtered, smoothing
from wbc.outside import sines
from wbc.robot import Robot
from wbc.run import run
from wbc.sim import Simulator
from wbc.spec import Sine, Spec, load
from wbc.wrench import ForceSensor

DT = 1e-3
PUSH = {"mx": 0.3, "my": -0.2, "mz": 0.1, "fx": 4, "fy": -3, "fz": 5}


@pytest.fixture(scope="module")
def handled():
    return Robot.load("panda", tool="handle")


def plant(**given):
    return Spec.model_validate({"robot": "panda", "plant": given}).plant


def at_rest(robot, **given):
    simulator = Simulator(robot, robot.keyframes["home"], DT, plant(**given))
    seen = simulator.observe()
    state = robot.state(seen.q, seen.v)
    simulator.apply(state.gravity())
    return simulator, state


@pytest.mark.parametrize("frame", ["tip", "handle_body", "link5"])
def test_a_push_acts_as_its_wrench_at_its_frame_does(handled, frame):
    """Not at the centre of mass of the body, where MuJoCo would have the force act."""
    simulator, state = at_rest(handled, pushes={"hand": {"frame": frame, "wrench": PUSH}})
    F = -np.array(list(PUSH.values()))  # of the robot on the one that pushes
    vdot = np.linalg.solve(state.M, -state.frame(frame).J.T @ F)
    np.testing.assert_allclose(simulator.data.qacc, vdot, atol=1e-9)
    np.testing.assert_allclose(simulator.true_push("hand"), F)


def test_a_push_has_its_time(handled):
    pushes = {"a": {"frame": "tip", "wrench": {"fx": 2}, "from": 0.002, "to": 0.004}}
    simulator, state = at_rest(handled, pushes=pushes)
    felt = []
    for _ in range(6):
        felt.append(simulator.true_push("a")[3])
        simulator.observe()
        simulator.apply(state.gravity())
    assert felt == [0, 0, -2, -2, 0, 0]


def test_pushes_at_one_body_add_up_and_are_moved(handled):
    pushes = {
        "a": {"frame": "tip", "wrench": {"fx": 2}},
        "b": {"frame": "wrist_sensor", "wrench": {"fy": 3}},
        "far": {"frame": "link4", "wrench": {"fz": 3}},
    }
    simulator, state = at_rest(handled, pushes=pushes)
    a, b = simulator.true_push("a"), simulator.true_push("b")
    X = handled.wrench_map("wrist_sensor", "tip")
    np.testing.assert_allclose(simulator.true_external("tip"), a + X @ b, atol=1e-12)
    J = state.frame("tip").J.T @ simulator.true_external("tip") + state.frame("link4").J.T @ simulator.true_push("far")
    np.testing.assert_allclose(simulator.data.qacc, np.linalg.solve(state.M, -J), atol=1e-9)


def test_sines_of_several_frequencies_keep_their_peak_low():
    frequencies = tuple(np.arange(1, 11) * 0.5)
    wave = sines(Sine(amplitude=2.0, frequency=frequencies))
    t = np.arange(0, 2, DT)
    values = np.array([wave(each) for each in t])
    for f in frequencies:
        assert 2 * abs(np.exp(-2j * np.pi * f * t) @ values) / t.size == pytest.approx(2.0)
    assert np.abs(values).max() < 0.6 * 2.0 * len(frequencies)
    assert sines(Sine(amplitude=2.0, frequency=0.25))(1.0) == pytest.approx(2.0)


def test_a_body_is_moved(panda):
    robot = Robot.load("panda", tool="handle", scene="moving_board")
    move = {"along": [0, 0, 2], "sine": {"amplitude": 0.01, "frequency": 25}, "from": 0.005}
    simulator = Simulator(robot, robot.keyframes["home"], DT, plant(moves={"board_body": move}))
    heights = []
    for _ in range(30):
        seen = simulator.observe()
        simulator.apply(robot.state(seen.q, seen.v).gravity())
        heights.append(simulator.true_motion("board")[0].translation[2])
    t = np.arange(30) * DT
    expected = 0.315 + np.where(t >= 0.005, 0.01 * np.sin(50 * np.pi * (t - 0.005)), 0.0)
    np.testing.assert_allclose(heights, expected, atol=1e-9)


def test_true_motion_is_the_state_s(handled, rng):
    simulator = Simulator(handled, handled.keyframes["home"], DT)
    simulator.data.qvel[:] = rng.normal(size=7)
    seen = simulator.observe()
    state = handled.state(seen.q, seen.v)
    simulator.apply(np.zeros(7))
    for name in ("tip", "link5"):
        T, V = simulator.true_motion(name)
        np.testing.assert_allclose(T.homogeneous, state.frame(name).T.homogeneous, atol=1e-12)
        np.testing.assert_allclose(V, state.frame(name).V, atol=1e-12)


# --- the sensor ---


def test_the_sensor_feels_a_push_through_the_weight_and_inertia_of_the_tool(handled, rng):
    simulator = Simulator(
        handled, handled.keyframes["home"], DT, plant(pushes={"hand": {"frame": "tip", "wrench": PUSH}})
    )
    simulator.data.qvel[:] = rng.normal(size=7)
    seen = simulator.observe()
    state = handled.state(seen.q, seen.v)
    simulator.apply(state.gravity())
    felt = simulator.measured(state, simulator.data.qacc.copy()).at(state, "tip")
    np.testing.assert_allclose(felt, -np.array(list(PUSH.values())), atol=1e-9)


def test_what_a_sensor_reads_of_nothing_is_tared(handled):
    bias = {"force": [1.0, -2.0, 0.5], "moment": [0.1, 0.0, -0.2]}
    simulator, state = at_rest(handled, noise={"bias": bias})
    still = np.zeros(7)
    np.testing.assert_allclose(simulator.measured(state, still).F, [0.1, 0.0, -0.2, 1.0, -2.0, 0.5], atol=1e-9)
    simulator.tare(state)
    falling = simulator.data.qacc.copy()  # of one tick more
    np.testing.assert_allclose(simulator.measured(state, falling).F, np.zeros(6), atol=1e-4)


def test_a_tare_takes_the_mean_of_several_readings(handled, rng):
    state = handled.state(handled.keyframes["home"], np.zeros(7))
    sensor = ForceSensor(handled)
    readings = rng.normal(size=(50, 6))
    tared = sensor.tare(readings, state, np.zeros(7))
    np.testing.assert_allclose(tared.compensated(readings.mean(axis=0), state, np.zeros(7)).F, np.zeros(6), atol=1e-12)
    np.testing.assert_allclose(sensor.bias, np.zeros(6))


def test_a_run_with_a_bias_needs_the_tare():
    biased = ["duration=1.5", "plant.noise.bias.force=[3, 0, 0]"]
    wrong, tared = (run(build(load("impedance", [*biased, *more]))) for more in ([], ["tare=true"]))
    assert abs(wrong.log["feel.displacement"][400, 0]) > 1e-3  # before the push begins
    np.testing.assert_allclose(tared.log["feel.displacement"][:500], 0.0, atol=1e-6)


# --- the observer ---


@pytest.fixture(scope="module")
def observed():
    return run(build(load("impedance", ["duration=4", "tasks.feel.external=observer", "tasks.feel.filter=30"])))


def test_the_observer_is_the_lag_filtered_truth(observed):
    """In each force along the axes of the task, at every single tick; the summary tells it and the lag apart."""
    log = observed.log
    model, lag = errors(log["feel.felt"], log["feel.external"], 30.0, DT)
    assert np.abs(model).max() <= bars.OBSERVER_ERROR
    assert np.abs(lag).max() > 5 * bars.OBSERVER_ERROR
    figures = observed.summary["metrics"]
    assert figures["feel.external.rms_error"] <= bars.OBSERVER_ERROR
    assert figures["feel.external.lag"] > 2 * bars.OBSERVER_ERROR


def test_an_error_of_the_model_shows_as_one_and_the_lag_stays(observed):
    wrong = ["duration=4", "tasks.feel.external=observer", "tasks.feel.filter=30", "plant.mass_error=0.02"]
    figures, true = run(build(load("impedance", wrong))).summary["metrics"], observed.summary["metrics"]
    assert figures["feel.external.rms_error"] > 10 * true["feel.external.rms_error"]
    assert figures["feel.external.lag"] == pytest.approx(true["feel.external.lag"], rel=0.05)


def test_the_residual_against_mujoco_in_any_motion(handled, rng):
    """A thrown arm under random torque: the residual is the push's torque through the low-pass."""
    simulator = Simulator(handled, handled.keyframes["home"], DT, plant(pushes={"a": {"frame": "tip", "wrench": PUSH}}))
    simulator.data.qvel[:] = 0.5 * rng.normal(size=7)
    watching, last, tau = MomentumObserver(handled, 40.0), None, np.zeros(7)
    truth, residual = [], []
    for i in range(600):
        seen = simulator.observe()
        state = handled.state(seen.q, seen.v)
        last = watching.update(state, tau, last)
        tau = state.gravity() - 2.0 * seen.v + 3.0 * np.sin(0.02 * i + np.arange(7))
        simulator.apply(tau)
        residual.append(last.residual)
        truth.append(-state.frame("tip").J.T @ simulator.true_push("a"))
    late = np.vstack((np.zeros((1, 7)), filtered(np.array(truth), 40.0, DT)[:-1]))
    # of some 5 N m; the simulator's tick has the forces of its beginning, a real arm's those of its middle
    assert np.abs(np.array(residual) - late).max() < 5e-2
    assert np.abs(np.array(truth)).max() > 2.0
    wrench = watching.wrench(state, truth[-1], "tip")
    np.testing.assert_allclose(wrench, simulator.true_push("a"), atol=1e-6)


def test_the_low_pass_is_the_first_order_one():
    step = filtered(np.ones((1000, 1)), 10.0, DT)[:, 0]
    np.testing.assert_allclose(step, 1 - np.exp(-2 * np.pi * 10.0 * DT * np.arange(1, 1001)))
    assert smoothing(10.0, DT) == pytest.approx(step[0])


def test_mocap_bodies_stay_out_of_the_robot_s_model():
    robot = Robot.load("panda", tool="handle", scene="moving_board")
    assert robot.nv == 7
    assert robot.mujoco.body_mocapid[mujoco.mj_name2id(robot.mujoco, mujoco.mjtObj.mjOBJ_BODY, "board_body")] == 0
    np.testing.assert_allclose(robot.fixed_pose("board").translation, [0.5, 0.0, 0.315])
