"""Pure force control (book 11.5) in the simulator: bias of a load, pole and limit of the sampled loop; the door."""

from __future__ import annotations

import math
from dataclasses import replace

import bars
import numpy as np
import pytest
from plants import Plant
from runs import ran, result
from scipy.optimize import brentq

from wbc import analytic
from wbc.axes import VELOCITY_AXES, WRENCH_AXES
from wbc.build import Built, build
from wbc.check import check
from wbc.controller import Controller
from wbc.errors import SpecError
from wbc.run import run
from wbc.sim import Simulator
from wbc.spec import load
from wbc.stability import loop_matrix, radius
from wbc.task.force import ForceTask
from wbc.verify import _unlimited
from wbc.wrench import Wrench

DT, G = 1e-3, 9.81
F_D = np.array([1.0, -0.5, 0.5, 6.0, -4.0, -10.0])  # of the specs


# --- the model alone ---


def test_the_law_is_gravity_and_the_wrench():
    built = build(load("force_feedforward", ["duration=1.5"]))
    finished = run(built)
    state = built.robot.state(finished.log["q"][-1], np.zeros(7))
    tau = analytic.force_torque(state.frame("hook").J, state.gravity(), F_D)
    np.testing.assert_allclose(finished.log["tau"][-1], tau, atol=1e-6)


@pytest.mark.parametrize(("payload", "at"), [(0.15, None), (0.15, "flange"), (0.3, "link5")])
def test_an_unknown_load_biases_the_wrench_as_predicted(payload, at):
    """The load's weight at the centre of mass of its body, mapped through the arm."""
    built = build(load("force_feedforward", [f"plant.payload={payload}", *([f"plant.payload_at={at}"] if at else [])]))
    finished = run(built)
    state, mj = built.robot.state(built.q, np.zeros(7)), built.robot.mujoco
    body = {None: "hook_body", "flange": "link7", "link5": "link5"}[at]
    frame = state.frame(body)
    weight = frame.T.rotation.T @ [0, 0, -payload * G]
    dg = -frame.J.T @ np.r_[np.cross(mj.body(body).ipos, weight), weight]
    predicted = analytic.unmodelled_bias(state.M, state.frame("hook").J, dg)
    bias = finished.log["anchor.true"][-500:].mean(axis=0) - F_D
    assert np.abs(predicted).max() > 0.1
    np.testing.assert_allclose(bias, predicted, atol=bars.FEEDFORWARD_BIAS * np.abs(predicted[3:]).max())
    if at is None:  # carried by the hand itself: its weight, whatever the arm
        assert bias[5] == pytest.approx(-payload * G, rel=bars.FEEDFORWARD_BIAS)


def test_bias_is_that_of_a_held_arm_solved_whole(rng):
    """J vdot = 0 and the equations of motion, at rest."""
    for r, n in ((3, 3), (3, 4), (6, 7)):
        plant = replace(Plant.random(rng, r, n, r), A=np.eye(r), drift=np.zeros(r), Adot_V=np.zeros(r))
        F_d, dg = rng.normal(size=r), rng.normal(size=n)
        known = replace(plant, h=plant.h)
        vdot, F = replace(plant, h=plant.h + dg).react(analytic.force_torque(plant.J, known.h, F_d))
        np.testing.assert_allclose(plant.J @ vdot, 0, atol=1e-9)
        np.testing.assert_allclose(F - F_d, analytic.unmodelled_bias(plant.M, plant.J, dg), atol=1e-9)


# --- with a sensor ---


def test_a_load_below_the_sensor_reads_as_contact():
    """The sensor cannot tell it from what it presses on: the wrench at the contact keeps the load's weight."""
    finished = result("force_pi", "plant={payload: 0.15}")
    assert finished.log["anchor.true"][-1, 5] - F_D[5] == pytest.approx(-0.15 * G, rel=1e-3)


def pressed(kp, ki, filter, delay, ticks, lifted=False) -> np.ndarray:
    """(ticks, 6) wrench error of `force_pi` with other gains, by hand: a spec with such gains is refused."""
    built: Built = build(load("force_pi"))
    phase = _unlimited(built.phases[0]) if lifted else built.phases[0]
    own = phase.tasks["press"]
    press = ForceTask("anchor", phase.contacts["anchor"], own.target, kp, ki, own.K_damp, filter, wrench=own.wrench)
    phase = replace(phase, tasks=dict(phase.tasks) | {"press": press})
    controller = Controller(built.robot, phases=[phase], q=built.q)
    plant = built.spec.plant.model_copy(update={"delay": delay, "payload": 0.002 if lifted else 0.15})
    simulator = Simulator(built.robot, built.q, DT, plant)
    controller.reset(built.q, np.zeros(7))
    errors, measured = np.empty((ticks, 6)), None
    for i in range(ticks):
        seen = simulator.observe()
        out = controller.step(seen.t, seen.q, seen.v, measured=None if measured is None else {"anchor": measured})
        simulator.apply(out.tau)
        errors[i] = simulator.true_wrench("hook") - F_D
        measured = simulator.measured(controller.state, out.vdot)
    return errors


def smoothing(cutoff):
    return 1.0 - math.exp(-2 * math.pi * cutoff * DT)


@pytest.mark.parametrize(
    ("kp", "ki", "cutoff", "delay"), [(0.3, 20.0, 50.0, 0), (0.3, 40.0, 50.0, 3), (0.1, 30.0, 20.0, 1)]
)
def test_the_error_decays_by_the_discrete_pole(kp, ki, cutoff, delay):
    poles = np.linalg.eigvals(loop_matrix(1.0, kp, ki, 0.0, smoothing(cutoff), DT, None, 1 + delay))
    rate = -math.log(np.abs(poles).max()) / DT
    naive = -np.linalg.eigvals(analytic.force_error_matrix(kp, ki))[0]
    errors = pressed(kp, ki, cutoff, delay, 250)[60:]
    for axis in (1, 3, 5):  # my, fx and fz, where the load shows most
        measured = -np.polyfit(DT * np.arange(len(errors)), np.log(np.abs(errors[:, axis])), 1)[0]
        assert measured == pytest.approx(rate, rel=bars.FORCE_POLE)
        assert measured != pytest.approx(naive, rel=bars.NAIVE_POLE_OFF)


@pytest.mark.parametrize(("cutoff", "delay"), [(50.0, 0), (10.0, 5)])
def test_the_edge_of_stability_is_where_it_is_computed(cutoff, delay):
    def worst(ki):
        return radius(1.0, 0.3, ki, 0.0, smoothing(cutoff), DT, None, 1 + delay)

    limit = brentq(lambda ki: worst(ki) - 1.0, 1.0, 5000.0)
    for share in bars.FORCE_EDGE:
        size = np.abs(pressed(0.3, share * limit, cutoff, delay, 500, lifted=True)).reshape(10, 50, 6).max(axis=1)
        growth = (size[6] / size[2]) ** (1 / 200)  # per tick, of each axis
        assert ((growth < 1) == (share < 1)).all()
        assert growth[5] == pytest.approx(worst(share * limit), abs=2e-3)


def test_such_a_spec_is_refused():
    with pytest.raises(SpecError, match="the force loop on fz is unstable against a stiffness of"):
        build(load("force_pi", ["tasks.press.ki=1365"]))


# --- with nothing to push against ---


def test_the_hand_drifts_at_the_terminal_speed_until_it_meets_the_board():
    finished = result("force_damped")
    log, speed = finished.log, finished.log["wall.rate"][:, 2]
    touched = int(np.flatnonzero(np.abs(log["wall.true"][:, 5]) > 0)[0])
    expected = analytic.terminal_velocity(np.array([-10.0]), 250.0)[0]
    assert touched > 500
    np.testing.assert_allclose(speed[300:touched], expected, rtol=bars.TERMINAL_SPEED)
    assert finished.summary["metrics"]["wall.vz.speed.max"] >= (1 - bars.TERMINAL_SPEED) * abs(expected)
    assert np.abs(speed[-500:]).max() < 1e-6
    assert log["wall.true"][-500:, 5] == pytest.approx(-10.0, abs=1e-3)


AIR = """
robot: panda
tool: eraser
contacts: {{wall: {{frame: eraser, holds: [{held}], artificial: {{wrench: {{{axis}: 0.1}}}}}}}}
tasks: {{press: {{type: force, contact: wall}}}}
"""


def drift(file, axis, ticks=40, **gains) -> tuple[np.ndarray, float]:
    """Speed along the only axis that a contact holds, where nothing resists; and the largest damping told by check."""
    file.write_text(AIR.format(axis=axis, held=VELOCITY_AXES[WRENCH_AXES.index(axis)]))
    built = build(load(file))
    phase = _unlimited(built.phases[0])
    press = ForceTask("wall", phase.contacts["wall"], np.array([0.1]), **gains)
    controller = Controller(built.robot, phases=[replace(phase, tasks=phase.tasks | {"press": press})], q=built.q)
    simulator, speed, nothing = Simulator(built.robot, built.q, DT), [], Wrench(np.zeros(6), "eraser")
    controller.reset(built.q, np.zeros(7))
    for _ in range(ticks):
        seen = simulator.observe()
        simulator.apply(controller.step(seen.t, seen.q, seen.v, measured={"wall": nothing}).tau)
        speed.append(controller.state.contacts["wall"].slip[0])
    return np.array(speed), check(load(file)).damping_limits["press"][axis]


def test_a_proportional_part_doubles_as_force_where_nothing_resists(tmp_path):
    """There F_e = F_d: the speed is (1 + Kp) F_d / K_damp."""
    speed, _ = drift(tmp_path / "air.yaml", "fz", 300, kp=0.5, damping=100.0)
    expected = analytic.terminal_velocity(np.array([0.1]), 100.0, 0.5)[0]
    assert speed[-1] == pytest.approx(expected, rel=bars.TERMINAL_SPEED)


@pytest.mark.parametrize("axis", ["mx", "mz", "fx", "fz"])
def test_the_largest_stable_damping_of_an_axis_is_where_check_says(axis, tmp_path):
    """In a tick v becomes (1 - dt W K_damp) v, which is -v at the edge."""
    _, limit = drift(tmp_path / "air.yaml", axis, 1)
    for share in bars.FORCE_EDGE:
        swing = np.abs(np.diff(drift(tmp_path / "air.yaml", axis, damping=share * limit)[0]))
        growth = (swing[-1] / swing[8]) ** (1 / (swing.size - 9))
        assert growth == pytest.approx(abs(1 - 2 * share), abs=0.02)
        assert (growth < 1) == (share < 1)


def test_more_damping_than_an_axis_bears_is_refused():
    limit = check(load("force_damped")).damping_limits["press"]["fz"]  # alone: the other axes couple with it
    built = build(load("force_damped"))
    state = built.robot.state(built.q, np.zeros(7))
    J = state.frame("eraser").J[5:]
    assert limit == pytest.approx(2 / (DT * (J @ np.linalg.solve(state.M, J.T)).item()))
    check(load("force_damped", [f"tasks.press.damping=[1e-3, 1e-3, {0.99 * limit}]"]))
    with pytest.raises(SpecError, match="damping is unstable at this rate"):
        check(load("force_damped", [f"tasks.press.damping=[1e-3, 1e-3, {1.01 * limit}]"]))


# --- a wheel ---


def test_a_wheel_rolls_where_it_heads():
    """Nonholonomic: it moves across its first heading by turning, and never sideways."""
    finished = result("wheel")
    path, speed = finished.log["roll.position"], np.abs(finished.log["board.rate"])
    assert np.ptp(path[:, 0]) > 0.15
    assert np.ptp(path[:, 1]) > 0.015
    assert speed[1000:].max() < 1e-4
    assert finished.log["roll.speed"].max() > 0.05
    desired = finished.log["roll.desired"]  # also across, where nothing but the rolling brings it
    assert np.abs(path - desired)[1000:].max() < 1e-3


def test_its_axle_turns_and_is_no_joint_of_the_robot():
    turned = ran("wheel").joint("axle")[:3000]
    assert build(load("wheel")).robot.nv == 7
    way = 0.2 * 0.8 * (0.6**3 * (10 - 15 * 0.6 + 6 * 0.36))  # of the arc, after 3 of 5 s [m]
    assert np.ptp(turned) == pytest.approx(way / 0.016, rel=0.02)


# --- a door ---


def test_without_the_measured_wrench_the_door_is_missed():
    finished = result("door", "contacts.handle.feedforward=none", "duration=4")  # its way there is enough
    missed = {check["name"] for check in finished.summary["checks"] if not check["ok"]}
    assert {"open.swing.rms_error", "handle.mz.rms_error"} <= missed
    assert finished.summary["metrics"]["open.swing.rms_error"] > 10 * bars.SPECS["door"]["open.swing.rms_error"]


def test_the_hinge_turns_by_what_was_asked():
    """The angle of the simulator's own hinge, not of the hook."""
    door = ran("door")
    t, angle = door.finished.log["t"][1000:] + DT, door.joint("door_hinge")[1000:]
    u = np.where(t < 4, t, 8 - t) / 4
    assert (
        np.sqrt(np.mean((angle + 0.6 * u**3 * (10 - 15 * u + 6 * u * u)) ** 2))
        < bars.SPECS["door"]["open.swing.rms_error"]
    )
    assert angle.min() == pytest.approx(-0.6, abs=1e-3)
