"""A floor that is not where it is believed to be: feet that land early on a plate, or late in a hole, and go on."""

from __future__ import annotations

import os
import re

import numpy as np
import pinocchio as pin
import pytest
from bars import GROUND

from wbc.build import build
from wbc.footing import LIFTED, Footing
from wbc.grounds import COUNTED, MISSING, TOUCHED, Ground
from wbc.resources import shipped_folder
from wbc.run import run
from wbc.spec import load

LARGE = os.environ.get("WBC_CAMPAIGN") == "large"
STEP = 0.01  # [m] a plate is so high, a hole so deep
X, Y, AHEAD = 0.1934, 0.142, 0.05


def stones(early, late):
    """A floor of stones, a centimetre above a plane: one under each foot, one where it steps to; `early` has a higher
    one there, `late` none."""
    floor = (shipped_folder("scenes") / "floor.xml").read_text()
    places = {"FL": (X, Y), "FR": (X, -Y), "RL": (-X, Y), "RR": (-X, -Y)}
    boxes = []
    for foot, (x, y) in places.items():
        top = {early: STEP, late: None}.get(foot, 0.0)
        for along, height in ((x, 0.0), (x + AHEAD, top)):
            if height is not None:
                half = 0.5 * (height + STEP)
                boxes.append(
                    f'<geom type="box" pos="{along} {y} {height - half}" size="0.0245 0.06 {half}" contype="2" '
                    'conaffinity="1" condim="3" friction="0.8" solref="0.004 1"/>'
                )
    low = floor.replace('<geom name="floor" type="plane"', f'<geom name="floor" type="plane" pos="0 0 {-STEP}"')
    assert low != floor
    return low.replace("</worldbody>", "\n".join((*boxes, "</worldbody>")))


def walking(tmp_path, early, late, feet, *more):
    """go2_step with feet that end their steps when they touch, and go on down where they do not."""
    text = (shipped_folder("tasks") / "go2_step.yaml").read_text().partition("expect:")[0]
    (tmp_path / "stones.xml").write_text(stones(early, late))
    text = text.replace("scene: floor", "scene: stones.xml")
    text, n = re.subn(
        r"\[([-\d.]+), ([-\d.]+), 0\.022\]\], times: \[0, 0\.3, 0\.6\]",
        r"[\1, \2, 0.022], [\1, \2, 0.002]], times: [0, 0.3, 0.6, 1.2]",
        text,
    )
    assert n == 4
    text, n = re.subn(
        r"until: \{(\w\w)_swing\.done: true\}",
        r"until: {\1.fz: {max: -1, for: 0.003}, time: 0.3}\n    timeout: 1.5\n    else: stop",
        text,
    )
    assert n == 4
    if feet < 4:  # then it rests
        head, tail = text.split("  unload_RL:")
        text = head + "  rest:" + tail.split("  rest:")[1]
        text = re.sub(r"  R[LR]_swing: .*\n|  R[LR]_ahead: .*\n", "", text)
    text = text.replace("duration: 10", f"duration: {11 if feet == 4 else 5.4}")
    (tmp_path / "stones.yaml").write_text(text)
    return build(load(tmp_path / "stones.yaml", list(more)))


@pytest.mark.parametrize("solver", ["daqp", "proxqp"] if LARGE else ["daqp"])
@pytest.mark.parametrize(("early", "late"), [("FL", "FR"), ("RL", "RR")] if LARGE else [("FL", "FR")])
def test_a_foot_lands_on_a_plate_and_one_in_a_hole_and_the_run_goes_on(tmp_path, solver, early, late):
    finished = run(walking(tmp_path, early, late, 4 if LARGE else 2, f"solver={solver}"))
    log, figures = finished.log, finished.summary["metrics"]
    began = {change["name"]: change["start"] for change in finished.summary["phases"]}
    assert "stop" not in began
    assert set(finished.summary["status"]) <= {"OK", "LIMITED"}
    following = dict(zip(began, [*list(began)[1:], ""], strict=True))
    swing = {foot: began[following[f"step_{foot}"]] - began[f"step_{foot}"] for foot in (early, late)}
    assert swing[early] < 0.57 < 0.63 < swing[late]  # [s] on the floor it is 0.6
    for foot, height in ((early, STEP), (late, -STEP)):
        assert log[f"{foot}.place"][-1][2] == pytest.approx(0.022 + height, abs=1e-3)
        at_rest = log[f"{foot}.true"][-500:]
        assert np.linalg.norm(at_rest[:, 3:], axis=1).min() > 20.0  # [N] it stands there
        assert figures[f"{foot}.slip"] <= GROUND["slip"]
    assert figures["base.tilt.max"] <= GROUND["tilt"]
    assert figures["base.drop"] <= GROUND["drop"]
    for foot in ("FL", "FR", "RL", "RR"):
        assert figures[f"{foot}.unnoticed"] <= GROUND["unnoticed"]
        assert figures[f"{foot}.cone.max_asked"] <= 1e-6
    assert figures["torque_rate.max"] <= 1500.001
    if LARGE:
        print(solver, early, late, {k: figures[k] for k in ("base.tilt.max", "base.drop", "torque_rate.max")}, swing)


class _At:
    """A frame at a pose."""

    def __init__(self, z):
        self.T = pin.SE3(np.eye(3), np.array([0.0, 0.0, z]))
        self.R, self.p = self.T.rotation, self.T.translation


class TestGround:
    FOOT = Footing(np.array([0.0, 0.0, 1.0]), 0.0, 0.02)
    NOTHING, PRESSES = np.zeros(6), np.array([0.0, 0.0, 0.0, 0.0, 0.0, -TOUCHED - 1e-9])

    def test_what_presses_stands_wherever_it_is(self):
        for height in (0.01, -0.01, 0.0):
            ground = Ground(missing=3).felt(self.FOOT, _At(0.02 + height), self.PRESSES, 10.0)
            assert ground.level == pytest.approx(height)
            assert ground.missing == 0
            assert not self.FOOT.lifted(_At(0.02 + height), ground.level)
        # within the softness of the floor nothing moves
        assert Ground().felt(self.FOOT, _At(0.02 - 0.4 * LIFTED), self.PRESSES, 0.0).level == 0.0

    def test_what_is_counted_on_and_does_not_press_is_in_the_air_after_some_ticks(self):
        ground, at = Ground(), _At(0.02)
        for tick in range(MISSING):
            assert not self.FOOT.lifted(at, ground.level), tick
            ground = ground.felt(self.FOOT, at, self.NOTHING, COUNTED + 1.0)
        assert self.FOOT.lifted(at, ground.level)
        assert self.FOOT.down(at, ground.level)[5] < 0.0
        # down to what it looks for it stands, and is lost again
        below = _At(0.02 - 2.0 * LIFTED)
        assert not self.FOOT.lifted(below, ground.level)
        for _ in range(MISSING):
            ground = ground.felt(self.FOOT, below, self.NOTHING, COUNTED + 1.0)
        assert self.FOOT.lifted(below, ground.level)

    def test_a_foot_that_nothing_is_asked_of_may_carry_nothing(self):
        ground = Ground(missing=MISSING - 1).felt(self.FOOT, _At(0.02), self.NOTHING, COUNTED - 1.0)
        assert ground == Ground()


def test_forces_of_round_feet_are_told_along_the_axes_of_the_floor(tmp_path):
    """A calf is not upright: its own z is not what presses on the floor."""
    built = walking(tmp_path, "", "", 2)
    exit_ = built.phases[2].exit
    state = built.robot.state(built.q, np.zeros(18))
    R = state.frame("FL_foot").R
    state.measured["FL"] = np.concatenate((np.zeros(3), R.T @ (1.0, 2.0, -30.0)))
    assert exit_.until[1].read(state) == pytest.approx(-30.0)
    assert abs(state.measured["FL"][5]) < 29.0
