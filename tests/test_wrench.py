"""Wrenches: signs, frames, and a wrist sensor that does not feel its own tool."""

import mujoco
import numpy as np
import pinocchio as pin
import pytest

from wbc import analytic
from wbc.errors import WrenchError
from wbc.sim import Simulator
from wbc.wrench import ForceSensor, Wrench


def test_signs_and_order():
    on_robot = Wrench.on_robot(f=[1, 2, 3], m=[4, 5, 6], frame="eraser")
    np.testing.assert_array_equal(on_robot.F, [-4, -5, -6, -1, -2, -3])
    on_environment = Wrench.on_environment(f=[1, 2, 3], m=[4, 5, 6], frame="eraser")
    np.testing.assert_array_equal(on_environment.F, [4, 5, 6, 1, 2, 3])
    assert on_environment.frame == "eraser"


@pytest.mark.parametrize(("f", "m"), [([1, 2], [3, 4, 5]), ([1, 2, 3], 4.0), ([1, 2, 3, 4], [1, 2])])
def test_three_forces_and_three_moments(f, m):
    with pytest.raises(WrenchError, match="needs three forces and three moments, got"):
        Wrench.on_environment(f, m, "eraser")


def test_another_frame_sees_it_through_the_adjoint(panda, draw, rng):
    """F_b = Ad_{T_ab}' F_a, on one link and across joints; the power is the same for every common motion."""
    F = rng.normal(size=6)
    for other in ("eraser", "flange", "link4", "board"):
        state = draw(panda)
        T = pin.SE3(state.frame("wrist_sensor").T).actInv(state.frame(other).T)
        moved = Wrench(F, "wrist_sensor").at(state, other)
        np.testing.assert_allclose(moved, analytic.adjoint(T.homogeneous).T @ F, atol=1e-12)
        V = rng.normal(size=6)  # of the other frame
        assert moved @ V == pytest.approx(F @ (analytic.adjoint(T.homogeneous) @ V), abs=1e-12)
    np.testing.assert_array_equal(Wrench(F, "eraser").at(state, "eraser"), F)


def test_a_hanging_weight_read_at_the_tip(panda, draw):
    """10 N along world -z at the tip are what the other end of the tool calls them."""
    state = draw(panda)
    R = state.frame("eraser").T.rotation
    wrench = Wrench.on_environment(R.T @ [0, 0, -10.0], np.zeros(3), "eraser")
    F = wrench.at(state, "wrist_sensor")
    lever = state.frame("wrist_sensor").T.actInv(state.frame("eraser").T).translation
    np.testing.assert_allclose(F[:3], np.cross(lever, F[3:]), atol=1e-12)
    np.testing.assert_allclose(state.frame("wrist_sensor").T.rotation @ F[3:], [0, 0, -10.0], atol=1e-12)


# --- the sensor ---


def reading(model, data):
    return np.concatenate([data.sensor(name).data for name in ("wrist_torque", "wrist_force")])


def test_in_free_air_the_sensor_feels_nothing(panda, rng):
    """Random poses, speeds and torques: what MuJoCo's sensor reads is all weight and inertia of the tool."""
    model = panda.mujoco
    data, sensor = mujoco.MjData(model), ForceSensor(panda)
    felt = []
    for _ in range(50):
        data.qpos[:] = panda.keyframes["home"] + rng.uniform(-0.5, 0.5, 7) + [0, -0.3, 0, 0, 0, 0, 0]
        data.qvel[:], data.ctrl[:] = rng.uniform(-2, 2, 7), rng.uniform(-10, 10, 7)
        mujoco.mj_forward(model, data)
        if data.ncon:
            continue
        state = panda.state(data.qpos.copy(), data.qvel.copy())
        felt.append(reading(model, data))
        F = sensor.compensated(felt[-1], state, data.qacc.copy())
        assert F.frame == "wrist_sensor"
        np.testing.assert_allclose(F.F, 0.0, atol=1e-6)
    assert len(felt) > 25
    assert np.abs(felt).max() > 1.0


def test_pressing_the_sensor_feels_the_true_wrench(panda, rng):
    """The eraser pressed into the board, resting and moving: the reading minus the tool is the contact's wrench."""
    start = close_to_the_board(panda, -2e-4)
    simulator, sensor = Simulator(panda, start, 1e-3), ForceSensor(panda)
    simulator.data.qvel[:] = rng.uniform(-0.05, 0.05, 7)
    pressed = 0
    for _ in range(40):
        seen = simulator.observe()
        state = panda.state(seen.q, seen.v)
        simulator.apply(state.gravity() + state.frame("eraser").J.T @ [0, 0, 0, 0, 0, -20.0] + rng.uniform(-2, 2, 7))
        true = simulator.true_wrench("eraser")
        F = sensor.compensated(reading(simulator.model, simulator.data), state, simulator.data.qacc.copy())
        np.testing.assert_allclose(F.at(state, "eraser"), true, atol=1e-6 * (1 + np.abs(true).max()))
        pressed += true[5] < -1.0
    assert pressed >= 20  # the robot pushes the board along -z, out of the board is +z


def close_to_the_board(robot, height):
    """Home, with the eraser's face at that height over the board."""
    q, goal = robot.keyframes["home"].copy(), None
    for _ in range(50):
        frame = robot.state(q, np.zeros(7)).frame("eraser")
        goal = pin.SE3(np.eye(3), np.array([0.5, 0.0, 0.3 + height])) if goal is None else goal
        error = pin.log6(frame.T.actInv(goal)).vector
        q = q + np.linalg.pinv(frame.J) @ np.r_[error[3:], error[:3]]
    assert np.abs(error).max() < 1e-10
    return q


def test_a_sensor_that_forgets_the_tool_is_wrong_by_its_weight(panda):
    """What the compensation is worth: 0.2 kg weigh 1.96 N."""
    state = panda.state(panda.keyframes["home"], np.zeros(7))
    F = ForceSensor(panda).compensated(np.zeros(6), state, np.zeros(7)).F
    assert np.linalg.norm(F[3:]) == pytest.approx(0.2 * 9.81, abs=1e-9)
