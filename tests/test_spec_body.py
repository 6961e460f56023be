"""Momentum, relative pose, gaze and least torque in the spec: what is made of them, and faults with a remedy."""

from __future__ import annotations

import numpy as np
import pytest
import yaml

from wbc.build import build
from wbc.errors import SpecError
from wbc.resources import shipped_folder
from wbc.run import run
from wbc.spec import Spec, load
from wbc.task.centroidal import MomentumTask
from wbc.task.effort import TorqueTask
from wbc.task.relative import GazeTask, RelativeTask
from wbc.verify import verify

WALKER = (shipped_folder("tasks") / "g1_stand.yaml").read_text()
ARM = """
robot: panda
references:
  fold: {quintic: {in: self, waypoints: [[0, 0, 0], [0.03, 0, 0.02]], times: [0, 0.3]}}
  place: {line: {in: link3, from: [0, 0, 0], to: [0, 0, 0.01], time: 1}}
tasks:
  posture: {type: posture, kp: 50, kd: 10}
  hand: {type: relative, frame: flange, to: link1, axes: [vx, vy, vz], target: fold, kp: 100, kd: 20}
"""


def spec_of(text, tasks, **more):
    tree = yaml.safe_load(text)
    tree["tasks"] |= tasks
    for key, value in more.items():
        tree[key] = tree.get(key, {}) | value if isinstance(value, dict) else value
    if not any(task.get("target") == "place" for task in tree["tasks"].values()):
        tree.get("references", {}).pop("place", None)
    return Spec.model_validate(tree)


def made(text, tasks, **more):
    return build(spec_of(text, tasks, **more)).phases[0].tasks


class TestMade:
    def test_relative(self):
        tasks = made(ARM, {})
        hand = tasks["hand"]
        assert isinstance(hand, RelativeTask)
        assert (hand.frame, hand.to, hand.axes, hand.split) == ("flange", "link1", ("vx", "vy", "vz"), False)
        start, end = (hand.reference(t).T for t in (0.0, 0.3))
        np.testing.assert_allclose(start.actInv(end).translation, [0.03, 0.0, 0.02], atol=1e-12)

    def test_relative_where_it_starts(self):
        task = {"type": "relative", "frame": "left_palm", "to": "right_palm", "kp": 100, "kd": 20}
        tasks = made(WALKER, {"carry": task})
        built = build(spec_of(WALKER, {"carry": task}))
        state = built.robot.state(built.q, np.zeros(35))
        here = state.frame("right_palm").T.actInv(state.frame("left_palm").T)
        assert tasks["carry"].reference(0.0).T.isApprox(here, 1e-9)
        assert len(tasks["carry"].axes) == 6

    def test_relative_in_the_frame_that_it_is_seen_from(self):
        task = {"type": "relative", "frame": "flange", "to": "link3", "target": "place", "kp": 100, "kd": 20}
        tasks = made(ARM, {"hand": task, "fold": {"type": "relative", "frame": "flange", "to": "link2", "axes": ["vx"],
                                                  "target": "fold", "kp": 1, "kd": 1}})  # fmt: skip
        np.testing.assert_allclose(tasks["hand"].reference(1.0).T.translation, [0.0, 0.0, 0.01], atol=1e-12)

    def test_gaze(self):
        tasks = made(ARM, {"look": {"type": "gaze", "frame": "flange", "axis": "-y", "at": "link2", "kp": 10, "kd": 5}})
        assert isinstance(tasks["look"], GazeTask)
        np.testing.assert_array_equal(tasks["look"].axis, [0.0, -1.0, 0.0])
        assert tasks["look"].at == "link2"
        there = made(ARM, {"look": {"type": "gaze", "frame": "flange", "at": [1, 0, 0.5], "kp": 10, "kd": 5}})["look"]
        np.testing.assert_array_equal(there.at, [1.0, 0.0, 0.5])
        np.testing.assert_array_equal(there.axis, [0.0, 0.0, 1.0])

    def test_momentum(self):
        spin = {"spin": {"profile": {"values": [0, 0.2], "times": [0, 1]}}}
        task = {"type": "momentum", "axes": ["kz", "lx"], "target": {"kz": "spin", "lx": 0.3}, "kp": [10, 5]}
        calm = made(WALKER, {"calm": task}, references=spin)["calm"]
        assert isinstance(calm, MomentumTask)
        assert calm.axes == ("kz", "lx")
        h, hdot = calm._desired(0.5)
        assert (h[2], h[3]) == (pytest.approx(0.1), 0.3)
        assert hdot[2] == pytest.approx(0.2 * 1.875)
        assert made(WALKER, {"calm": {"type": "momentum", "kp": 10}})["calm"].axes[:3] == ("kx", "ky", "kz")

    def test_torque(self):
        built = build(spec_of(ARM, {"ease": {"type": "torque", "level": 3}}, hierarchy="strict"))
        assert isinstance(built.phases[0].tasks["ease"], TorqueTask)
        assert built.phases[0].levels["ease"] == 3
        assert built.phases[0].weights["ease"] == 1e-3


def test_an_arm_folds_and_looks_in_the_simulator():
    """The figures of a relative pose are those of any motion."""
    look = {"type": "gaze", "frame": "flange", "at": [0.8, 0.0, 0.1], "kp": 100, "kd": 20, "level": 2}
    expect = {"settle": 0.05, "hand.position.max_error": 1e-3, "hand.speed.max": 1.0}
    result = run(build(spec_of(ARM, {"look": look}, duration=0.4, expect=expect)))
    assert result.ok, result.summary["checks"]
    assert result.summary["metrics"]["hand.speed.max"] > 0.05


def test_a_fold_begins_and_ends_phases_without_a_jump():
    """A relative pose is taken up where the robot is when its phase begins, and its phase ends when it is done."""
    tree = yaml.safe_load(ARM)
    tree["references"]["place"]["line"]["in"] = "link1"
    tree["references"]["place"]["line"]["time"] = 0.1
    for task in ("hand", "back"):
        tree["tasks"][task] = tree["tasks"]["hand"] | {"error": "split"}
    tree["tasks"]["hand"]["target"] = "place"
    tree["tasks"]["back"]["target"] = "fold"
    tree["phases"] = {
        "bend": {"tasks": ["back", "posture"], "until": {"back.done": True}},
        "away": {"tasks": ["hand", "posture"]},
    }
    tree |= {"duration": 0.36, "limits": {"torque": "model"}}
    result = run(build(Spec.model_validate(tree)))
    log, first = result.log, int(np.flatnonzero(result.log["phase"] == 1)[0])
    assert first == pytest.approx(300, abs=2)
    assert np.abs(log["hand.error"][first]).max() < 1e-9  # though `place` is most of a metre away
    assert np.abs(log["tau"][first] - log["tau"][first - 1]).max() < 0.5


def test_a_humanoid_does_all_of_it():
    """Relative palms, a gaze, calm about the vertical and little torque, on two soles in MuJoCo."""
    tasks = {
        "carry": {"type": "relative", "frame": "left_palm", "to": "right_palm", "kp": 100, "kd": 20},
        "look": {"type": "gaze", "frame": "torso_link", "axis": "+x", "at": [2, 0.5, 1], "kp": 100, "kd": 20},
        "calm": {"type": "momentum", "axes": ["kz"], "kp": 5, "weight": 0.1},
        "ease": {"type": "torque", "weight": 1e-5},
    }
    expect = {"settle": 0.0, "carry.position.max_error": 1e-3, "look.angle.max_error": 0.3, "calm.kz.max_error": 0.2}
    spec = spec_of(WALKER, tasks).model_copy(update={"duration": 0.25})
    tree = spec.model_dump(by_alias=True, exclude_unset=True) | {"expect": expect, "duration": 0.25}
    result = run(build(Spec.model_validate(tree)))
    figures = result.summary["metrics"]
    assert result.ok, result.summary["checks"]
    assert figures["ticks.degraded"] == 0.0
    assert result.log["look.angle"][-1] < 0.5 * result.log["look.angle"][0]
    assert figures["calm.kz.max_error"] > 0.0


def test_acceleration_limits_reach_the_joints():
    for given, wanted in ((4.0, [4.0] * 7), ([1, 2, 3, 4, 5, 6, 7], [1, 2, 3, 4, 5, 6, 7]), ({"joint2": 3.0}, None)):
        joint = build(spec_of(ARM, {}, limits={"acceleration": given})).phases[0].joint
        np.testing.assert_array_equal(joint.a_max, [np.inf, 3.0, *[np.inf] * 5] if wanted is None else wanted)
    for given, message in (
        ({"joint8": 3.0}, "no joint named 'joint8'; did you mean"),
        ([1.0, 2.0], "expected 7 numbers, one a joint, got 2"),
        (0.0, "expected a number greater than 0 .rad/s.2., got 0"),
        ("model", "expected a number, a list, or a mapping from joints to numbers"),
    ):
        with pytest.raises(SpecError, match=message):
            build(spec_of(ARM, {}, limits={"acceleration": given}))


LOOK = {"type": "gaze", "frame": "flange", "at": [1, 0, 0], "kp": 10, "kd": 5}
HAND = {"type": "relative", "frame": "flange", "to": "link1", "target": "fold", "kp": 10, "kd": 5}
CALM = {"type": "momentum", "kp": 10}
FAULTS = {
    "the frame itself": ("hand", HAND | {"to": "flange"}, "is the frame itself; expected another one"),
    "one link": ("hand", HAND | {"frame": "link2", "to": "joint2"}, "on one link; expected a frame that moves against"),
    "no frame": ("hand", HAND | {"to": "flnge"}, "no frame named 'flnge'; did you mean 'flange'"),
    "no axis": ("hand", HAND | {"frame": "link3", "to": "link2", "axes": ["vy"]}, "against link2 along vy; expected"),
    "no reference": ("hand", HAND | {"target": "fld"}, "no reference named 'fld'; did you mean 'fold'"),
    "gains": ("hand", HAND | {"axes": ["vx", "vy"], "kp": [1, 2, 3]}, r"expected 2 numbers \(vx, vy\), got 3"),
    "looks at itself": ("look", LOOK | {"at": "flange"}, "is the frame itself; expected another one, or a point"),
    "looks at its link": ("look", LOOK | {"frame": "link2", "at": "joint2"}, "on one link; expected a frame"),
    "looks at nothing": ("look", LOOK | {"at": "flnge"}, "no frame named 'flnge'"),
    "no direction": ("look", LOOK | {"axis": [0, 0, 0]}, "expected a direction, got zeros"),
    "no such axis": ("look", LOOK | {"axis": "up"}, "axis: unknown word 'up'"),
    "axis of nothing": ("look", LOOK | {"axis": 3}, "expected .x, -x, .y, -y, .z, -z, or a list of 3 numbers, got 3"),
    "two numbers": ("look", LOOK | {"at": [1, 0]}, r"expected 3 numbers \(x, y, z\), got 2"),
    "frames that stand": ("look", LOOK | {"frame": "universe"}, "is fixed to the world; expected one of the robot"),
    "momentum along": ("calm", CALM | {"axes": ["kx", "mz"]}, "unknown word 'mz'; did you mean 'lz'"),
    "momentum twice": ("calm", CALM | {"axes": ["kx", "kx"]}, "kx is given twice"),
    "untracked": ("calm", CALM | {"axes": ["kx"], "target": {"lz": 1}}, "is not tracked; expected one of kx"),
    "momentum of whom": ("calm", CALM | {"target": {"kz": "spin"}}, "no reference named 'spin'"),
    "what does not move": ("calm", CALM | {"target": {"kz": "fold"}}, "does not move along wz"),
    "five gains": ("calm", CALM | {"kp": [1, 2, 3, 4, 5]}, r"expected 6 numbers \(kx, .*\), got 5"),
    "no weight": ("ease", {"type": "torque", "weight": 0}, "expected a number greater than 0"),
}  # fmt: skip


@pytest.mark.parametrize("what", FAULTS)
def test_faults_have_a_place_and_a_remedy(what):
    name, task, message = FAULTS[what]
    with pytest.raises(SpecError, match=message) as caught:
        made(ARM, {name: task})
    assert any(fault.key.startswith(f"tasks.{name}") for fault in caught.value.faults)


def test_a_relative_pose_is_not_drawn_in_the_world():
    text = ARM.replace("in: link3", "in: world")
    with pytest.raises(SpecError, match="seen from 'link1'; expected `in: link1` or `in: self` in the reference"):
        made(text, {"hand": HAND | {"target": "place"}})


def test_a_moving_frame_is_no_place_for_other_references():
    move = {"type": "motion", "frame": "flange", "target": "place", "kp": 10, "kd": 5}
    with pytest.raises(SpecError, match="expected one fixed to the world"):
        made(ARM, {"hand": HAND | {"to": "link3", "target": "place"}, "move": move})


def test_the_chapter_has_no_closed_form_of_them():
    with pytest.raises(SpecError, match="no closed form with a task of type relative; expected it left out"):
        verify(spec_of(ARM, {}))


def test_nothing_that_was_shipped_has_them():
    assert not any(isinstance(task, RelativeTask) for task in build(load("eraser")).phases[0].tasks.values())
