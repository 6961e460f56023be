"""What a spec says of robots with a floating base: feet in one line, tasks of the whole body, faults with a remedy."""

from __future__ import annotations

import numpy as np
import pytest

from wbc.build import build
from wbc.contact import Settling
from wbc.contact.axes import AxesContact, WorldAxesContact
from wbc.contact.foot import RoundFoot
from wbc.errors import SpecError
from wbc.resources import shipped_folder
from wbc.spec import load
from wbc.surface import Sole

G1, GO2 = ((shipped_folder("tasks") / f"{name}.yaml").read_text() for name in ("g1_stand", "go2_stand"))
LEFT = "left_foot:  {frame: left_sole,  holds: all, pushes: -z, friction: 0.6, sole: [0.17, 0.05]}"
FL = "FL: {frame: FL_foot, holds: [vx, vy, vz], pushes: -z, friction: 0.6, radius: 0.022}"


@pytest.fixture
def made(tmp_path):
    """made(text, (old, new), ...) -> the built spec."""

    def one(text, *changes):
        for old, new in changes:
            assert old in text
            text = text.replace(old, new)
        (tmp_path / "spec.yaml").write_text(text)
        return build(load(tmp_path / "spec.yaml"))

    return one


def test_a_foot_is_one_line(made):
    soles = made(G1).phases[0].contacts
    assert all(isinstance(contact, AxesContact) and isinstance(contact.pushes, Sole) for contact in soles.values())
    assert soles["left_foot"].pushes.size == (0.17, 0.05)
    assert soles["left_foot"].settling == Settling(20.0)
    feet = made(GO2).phases[0].contacts
    assert all(isinstance(contact, RoundFoot) and contact.radius == 0.022 for contact in feet.values())


def test_settling_is_said_or_left_out(made):
    built = made(G1, (LEFT, LEFT.replace("}", ", settling: 5}")))
    assert built.phases[0].contacts["left_foot"].settling == Settling(5.0)
    off = made(GO2, (FL, FL.replace("}", ", settling: 0}")))
    assert off.phases[0].contacts["FL"].settling is None
    assert build(load("eraser")).phases[0].contacts["board"].settling is None


def test_what_only_pushes_stands_on_the_floor_wherever_it_is(made):
    """The start pose comes to stand: a home that floats and leans is moved onto the plane, and nowhere else."""
    joints = "start: {FL_thigh_joint: 0.8, RR_calf_joint: -1.7}\n"
    built = made(GO2, ("rate: 1000", joints + "rate: 1000"))
    state = built.robot.state(built.q, np.zeros(18))
    for name in ("FL", "FR", "RL", "RR"):
        assert state.frame(f"{name}_foot").T.translation[2] == pytest.approx(0.022, abs=1e-9)
    bent = made(G1, ("rate: 1000", "start: {left_ankle_pitch_joint: -0.3, right_ankle_roll_joint: 0.1}\nrate: 1000"))
    state = bent.robot.state(bent.q, np.zeros(35))
    for name in ("left_sole", "right_sole"):
        T = state.frame(name).T
        assert T.translation[2] == pytest.approx(0.0, abs=1e-9)
        np.testing.assert_allclose(T.rotation[:, 2], [0.0, 0.0, 1.0], atol=1e-9)


def test_a_point_without_a_radius_is_a_point_in_the_axes_of_the_ground(made):
    foot = made(GO2, (FL, FL.replace(", radius: 0.022", ", ground: floor"))).phases[0].contacts["FL"]
    assert isinstance(foot, RoundFoot)
    assert foot.radius == 0.0
    held = (
        made(GO2, (FL, FL.replace("[vx, vy, vz]", "[vx, vz]").replace(", radius: 0.022", ""))).phases[0].contacts["FL"]
    )
    assert type(held) is WorldAxesContact


def test_the_centre_of_mass_has_a_place(made):
    spec = made(G1, ("{over: [left_foot, right_foot]}", "{over: {left_foot: 0.7, right_foot: 0.3}}"))
    state = spec.robot.state(spec.q, np.zeros(35))
    feet = [state.frame(name).T.translation for name in ("left_sole", "right_sole")]
    goal = spec.phases[0].tasks["balance"].reference(0.0).T.translation
    np.testing.assert_allclose(goal[:2], (0.7 * feet[0] + 0.3 * feet[1])[:2], atol=1e-12)
    still = made(G1, ("target: {over: [left_foot, right_foot]}", "target: start"))
    here = still.phases[0].tasks["balance"].reference(0.0).T.translation
    assert goal[2] == pytest.approx(here[2], abs=1e-12)
    sway = "  level: {hold: {}}\n  sway: {line: {in: self, from: [0, 0, 0], to: [0, 0.02, -0.01], time: 2}}"
    moved = made(G1, ("  level: {hold: {}}", sway), ("target: {over: [left_foot, right_foot]}", "target: sway"))
    path = moved.phases[0].tasks["balance"].reference
    np.testing.assert_allclose(path(0.0).T.translation, here, atol=1e-12)
    np.testing.assert_allclose(path(2.0).T.translation, here + np.array([0, 0.02, -0.01]), atol=1e-12)


def test_shares_reach_the_distribution(made):
    share = "  share: {type: distribution, shares: {left_foot: 0.7, right_foot: 0.3}}\n  posture:"
    tasks = made(G1, ("  posture:", share)).phases[0].tasks
    assert tasks["share"].shares == {"left_foot": 0.7, "right_foot": 0.3}


FAULTS = {
    "sole without pushing": (G1, LEFT, LEFT.replace(" pushes: -z, friction: 0.6,", ""), "expected `pushes: -z` beside"),
    "sole of a point": (G1, LEFT, LEFT.replace("holds: all", "holds: [vx, vy, vz]"), "expected `holds: all`"),
    "sole without friction": (G1, LEFT, LEFT.replace(" friction: 0.6,", ""), "expected `friction: MU` beside it"),
    "sole sideways": (G1, LEFT, LEFT.replace("-z", "-x"), "a sole pushes along z; expected `pushes: -z`"),
    "faces of a sole": (G1, LEFT, LEFT.replace("0.6", "{mu: 0.6, faces: 8}"), "4 faces each; expected 4, got 8"),
    "a flat round foot": (G1, LEFT, LEFT.replace("}", ", radius: 0.1}"), "expected either `sole` or `radius`"),
    "three numbers": (G1, LEFT, LEFT.replace("0.05", "0.05, 0.1"), r"expected 2 numbers \(length, width\), got 3"),
    "a round foot that is held": (GO2, FL, FL.replace("[vx, vy, vz]", "all"), r"expected `holds: \[vx, vy, vz\]`"),
    "a round foot that pulls": (GO2, FL, FL.replace("-z", "+z"), r"expected `pushes: -z`, got \+z"),
    "two places": (GO2, FL, FL.replace("}", ", on: floor, ground: floor}"), "expected either `on` or `ground`"),
    "no such ground": (GO2, FL, FL.replace("}", ", ground: flor}"), "no frame named 'flor'; did you mean 'floor'"),
    "ground that moves": (GO2, FL, FL.replace("}", ", ground: base}"), "expected one fixed to the world"),
    "over nothing": (G1, "[left_foot, right_foot]", "[left_fot]", "no contact named 'left_fot'; did you mean"),
    "over none": (G1, "[left_foot, right_foot]", "{left_foot: 0}", "expected a share above 0, got none"),
    "no reference": (G1, "{over: [left_foot, right_foot]}", "levl", "no reference named 'levl'; did you mean 'level'"),
    "four gains": (G1, "kp: 40", "kp: [1, 2, 3, 4]", r"3 numbers \(x, y, z\)"),
    "shares of none": (
        G1, "  posture:", "  share: {type: distribution, shares: {hand: 1}}\n  posture:",
        "no contact named 'hand'; expected one of left_foot, right_foot",
    ),
    "gravity of the driver": (G1, "rate: 1000", "gravity: robot\nrate: 1000", "floating base; expected 'controller'"),
}  # fmt: skip


@pytest.mark.parametrize("what", FAULTS)
def test_faults_have_a_place_and_a_remedy(made, what):
    text, old, new, message = FAULTS[what]
    with pytest.raises(SpecError, match=message) as caught:
        made(text, (old, new))
    assert all(fault.line and fault.column for fault in caught.value.faults)


def test_a_centre_of_mass_does_not_turn(made):
    turn = "  level: {hold: {}}\n  turn: {arc: {radius: 0.3, times: [0, 2], angles: [0, 1]}}"
    with pytest.raises(SpecError, match="does not turn; expected a reference without wz"):
        made(G1, ("  level: {hold: {}}", turn), ("target: {over: [left_foot, right_foot]}", "target: turn"))


def test_an_arm_shares_nothing():
    share = {"type": "distribution"}
    spec = load("eraser")
    with pytest.raises(SpecError, match="expected a floating base"):
        build(_with_task(spec, share))


def _with_task(spec, task):
    from wbc.spec import Spec

    tree = spec.model_dump(by_alias=True, exclude_unset=True)
    tree["tasks"]["share"] = task
    return Spec.model_validate(tree)
