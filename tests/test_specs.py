"""Every shipped spec meets its bars, with both solvers, from true quantities; its `expect:` is never looser."""

from __future__ import annotations

import os

import bars
import numpy as np
import pytest
from runs import result

from wbc import analytic
from wbc.build import build
from wbc.resources import shipped_folder, shipped_names
from wbc.run import run
from wbc.spec import load

LARGE = os.environ.get("WBC_CAMPAIGN") == "large"
SHIPPED = shipped_names("tasks", ".yaml")
RUN = [name for name in SHIPPED if not load(name).robot.startswith("erd:")]  # the others run by hand: test_urdf.py
# [s] then they only stand, draw the same figure once more, or go back to where they began
STILL = dict.fromkeys(("go2_stand", "g1_stand", "g1_line_foot", "g1_slopes", "go2_ride"), 4)
ENOUGH = {**STILL, "g1_sway": 6, "g1_squat": 5, "panda_dual_box": 6, "g1_wipe": 3, "g1_wipe_noisy": 3}


def hold(name, finished):
    figures = finished.summary["metrics"]
    missed = {
        metric: (figures[metric], bound)
        for metric, bound in (bars.SPECS[name] | bars.ALWAYS).items()
        if not figures[metric] <= bound
    }
    missed |= {
        metric: (figures[metric], least)
        for metric, least in bars.AT_LEAST.get(name, {}).items()
        if not figures[metric] >= least
    }
    assert not missed
    assert finished.ok


def test_every_spec_has_bars_and_every_bar_a_spec():
    assert set(bars.SPECS) == set(SHIPPED)


@pytest.mark.parametrize("name", SHIPPED)
def test_expectations_are_never_looser_than_the_bars(name):
    expect = load(name).expect
    assert expect.settle <= 1.0
    for metric, bound in bars.SPECS[name].items():
        assert expect.bounds[metric].max <= bound
    for metric, bound in bars.AT_LEAST.get(name, {}).items():
        assert expect.bounds[metric].min >= bound


@pytest.mark.parametrize("name", RUN)
def test_spec_meets_its_bars(name):
    enough = {} if LARGE else ENOUGH
    hold(name, result(name, f"duration={enough[name]}") if name in enough else result(name))


# with daqp above; the other solver runs as long only in a large campaign
@pytest.mark.parametrize("name", RUN if LARGE else ["chalk_liftoff", "eraser", "eraser_weak"])
def test_spec_meets_its_bars_with_proxqp(name):
    short = [] if LARGE or name == "chalk_liftoff" else ["duration=4"]
    hold(name, result(name, "solver=proxqp", *short))


def test_another_arm_is_one_word():
    finished = result("eraser", "robot=ur5e", "duration=5")
    hold("eraser", finished)
    assert [note for note in finished.summary["notes"] if note.startswith("posture: dropped")]


def test_the_book_and_the_default_coincide_on_a_flat_frictionless_board():
    ours, book = result("eraser", "duration=2"), result("eraser", "duration=2", "law=book")
    hold("eraser", book)
    np.testing.assert_allclose(ours.log["board.true"][1500:], book.log["board.true"][1500:], atol=1e-3)


def test_a_driver_that_adds_gravity_changes_nothing_of_what_the_robot_does():
    ours, theirs = result("eraser", "duration=1.5"), result("eraser", "duration=1.5", "gravity=robot")
    hold("eraser", theirs)
    np.testing.assert_allclose(ours.log["q"], theirs.log["q"], atol=1e-9)


class TestWeakMotors:
    """`eraser_weak`: limits are cut while the figure needs more, and come back while they bind."""

    finished = staticmethod(lambda: result("eraser_weak"))

    def binding(self):
        return np.array([any(name.startswith("torque[") for name in active) for active in self.finished().log.active])

    def test_a_torque_limit_binds_often_enough_and_is_named(self):
        assert self.binding().mean() >= bars.WEAK_SATURATED
        assert "torque[joint2]" in {name for active in self.finished().log.active for name in active}

    def test_the_status_is_limited_while_it_binds(self):
        log = self.finished().log
        limited = log["status"] == log.meta["status_names"].index("LIMITED")
        assert limited[self.binding()].all()

    def test_the_way_back_does_not_overshoot(self):
        log = self.finished().log
        back = 2400
        assert self.binding()[back - 1]
        force, error = log["board.lam"][:, 2] + 10.0, log["draw.error"][:, 3]
        after = slice(back, back + round(bars.WEAK_RECOVERY * 1000))
        for value in (force, error):
            step = value[back - 1]
            assert (-np.sign(step) * value[after]).max() <= bars.WEAK_OVERSHOOT * abs(step)


class TestLiftoff:
    """`chalk_liftoff`: the impact is foretold from the scene, the model and the speed of the approach alone."""

    def foretold(self, speed):
        built = build(load("chalk_liftoff"))
        robot, mj = built.robot, built.robot.mujoco
        state = robot.state(built.q, np.zeros(7))
        row = state.frame("chalk").J[5]
        mass = 1.0 / float(row @ np.linalg.solve(state.M, row))
        board = mj.geom("board").id
        (time, ratio), (d_min, d_max) = mj.geom_solref[board], mj.geom_solimp[board][:2]
        # x'' = d (-b x' - k x) at the first touch, where d is d_min
        b, k = 2.0 / (d_max * time), 1.0 / (d_max * time * ratio) ** 2
        return analytic.impact_peak(mass, mass * d_min * b, mass * d_min * k, speed)

    @pytest.mark.parametrize(("speed", "more"), [(0.02, ()), (0.05, ("references.down.line.time=1.5", "duration=1.5"))])
    def test_the_peak_is_foretold_within_the_bar(self, speed, more):
        peak = result("chalk_liftoff", *more).summary["metrics"]["board.peak"]
        assert abs(self.foretold(speed) / peak - 1.0) <= bars.SPECS["chalk_liftoff"]["board.impact_error"]
        assert 2.0 * speed / 0.01 * 3.0 < peak < 2.0 * speed / 0.01 * 6.0  # of a mass of 3 to 6 kg

    def test_faster_the_bar_is_missed(self):
        finished = result("chalk_liftoff", "references.down.line.time=1.5", "duration=1.5")
        assert "board.peak" in [check["name"] for check in finished.summary["checks"] if not check["ok"]]

    def test_only_a_contact_that_pushes_is_never_asked_to_pull(self, tmp_path):
        text = (shipped_folder("tasks") / "chalk_liftoff.yaml").read_text()
        (tmp_path / "pulls.yaml").write_text(text.replace("    pushes: -z\n", "").replace("duration: 9", "duration: 2"))
        assert run(build(load(tmp_path / "pulls.yaml"))).summary["metrics"]["board.asked_pull"] > 0.5

    def test_contacts_come_and_go(self):
        log = result("chalk_liftoff").log
        assert [log.meta["phases"][int(i)] for i in sorted(set(log["phase"]))] == ["approach", "write", "leave"]
        assert [entry["name"] for entry in log.meta["changes"]] == ["approach", "write", "leave"]
        leave = np.flatnonzero(log["phase"] == 2)
        assert (log["board.true"][leave[20:]] == 0.0).all()  # gone, and not to come back
        assert log["lift.position"][-1][2] == pytest.approx(0.35, abs=1e-4)


def test_a_hand_that_meets_the_board_early_does_not_hit_it_hard():
    """1.5 cm before the slow part of its way, at 0.06 m/s: `until` sees the force, nothing peaks."""
    sooner = "references.ahead.quintic.waypoints=[[0, 0, 0.025], [0, 0, -0.01], [0, 0, -0.035]]"
    finished = result("g1_wipe", sooner, "duration=1")
    assert [change["name"] for change in finished.log.meta["changes"]] == ["approach", "wipe"]
    assert finished.log.meta["changes"][1]["start"] < 0.8
    figures = finished.summary["metrics"]
    assert figures["board.impact"] < figures["board.peak"] <= bars.SPECS["g1_wipe"]["board.peak"]
    assert figures["board.pull"] == figures["ticks.degraded"] == 0.0
    assert (finished.log["board.true"][700:, 5] < 0.0).all()  # it does not bounce


def test_a_run_is_repeated_bit_for_bit_by_its_seed():
    one, two = (run(build(load("eraser_noisy", ["duration=0.3"])), seed=3) for _ in range(2))
    other = run(build(load("eraser_noisy", ["duration=0.3"])), seed=4)
    np.testing.assert_array_equal(one.log["tau"], two.log["tau"])
    assert np.abs(one.log["tau"] - other.log["tau"]).max() > 0


@pytest.mark.parametrize(
    ("change", "metric", "least"),
    [
        ("plant.payload=0.5", "draw.position.rms_error", 1e-4),
        ("plant.mass_error=0.05", "draw.position.rms_error", 1e-4),
        ("plant.joint_friction=0.5", "draw.position.rms_error", 1e-4),
        ("plant.armature=0.2", "draw.position.rms_error", 1.1e-5),
        ("plant.noise.position=1e-4", "board.fz.rms_error", 1e-3),
        ("plant.noise.differenced=50", "draw.position.rms_error", 2e-5),
        ("plant.noise.velocity=1e-2", "draw.position.rms_error", 1.1e-5),
        ("plant.noise.moment=0.02", "board.mx.rms_error", 1e-4),
        ("plant.contact_friction=0.2", "board.fz.rms_error", 1e-3),
        ("plant.delay=2", "board.fz.rms_error", 2.1e-4),
    ],
)
def test_what_only_the_plant_knows_shows_in_the_truth(change, metric, least):
    assert result("eraser", change, "duration=2").summary["metrics"][metric] > least
