"""A task and a contact of one's own, as the README shows them: short, sound, and at work on an arm and on a walker."""

from __future__ import annotations

import ast
import re
from pathlib import Path

import numpy as np
import pytest

from wbc.contact.foot import RoundFoot
from wbc.controller import Controller
from wbc.friction import unilateral
from wbc.ladder import Status
from wbc.reference import Hold
from wbc.sim import Simulator
from wbc.task.centroidal import WholeBodyPosture
from wbc.task.motion import MotionTask
from wbc.task.posture import PostureTask
from wbc.testing import check_contact, check_task

README = (Path(__file__).resolve().parent.parent / "README.md").read_text()
(SNIPPET,) = [text for text in re.findall(r"```python\n(.*?)```", README, flags=re.S) if "class Height" in text]
FEET = ("FL_foot", "FR_foot", "RL_foot", "RR_foot")
DOWN = np.array([0.0, 0.0, -1.0])


@pytest.fixture(scope="module")
def own():
    """The two classes of the README."""
    tree = ast.parse(SNIPPET)
    tree.body = [node for node in tree.body if isinstance(node, ast.Import | ast.ClassDef)]
    made: dict = {}
    exec(compile(tree, "README.md", "exec"), made)
    return made


def test_they_are_one_class_of_at_most_30_lines_each():
    classes = [node for node in ast.parse(SNIPPET).body if isinstance(node, ast.ClassDef)]
    assert [node.name for node in classes] == ["Height", "Point"]
    assert all(node.end_lineno - node.lineno + 1 <= 30 for node in classes)


@pytest.mark.parametrize(("name", "frame"), [("go2", "base"), ("panda", "eraser")])
def test_they_are_sound(request, own, name, frame):
    robot = request.getfixturevalue(name)
    contacts = {"held": own["Point"]("FL_foot" if robot.base else "flange")}
    check_contact(contacts["held"], robot, states=5)
    check_task(own["Height"](frame, 0.4), robot, contacts, states=5)
    check_task(own["Height"](frame, 0.4), robot, states=5)


def test_the_contact_is_ours_without_a_radius(own, go2):
    """The same accelerations and torques as with the foot of this package."""
    q, v = go2.keyframes["home"], np.zeros(18)
    outs = []
    for kind in (own["Point"], lambda name: RoundFoot(name, np.eye(3))):
        feet = {name: kind(name) for name in FEET}
        state = go2.state(q, v)
        for foot in feet.values():
            foot.pushes = unilateral(foot, state, DOWN, mu=0.6)
        controller = Controller(go2, feet, {"rise": own["Height"]("base", 0.3)}, q=q)
        outs.append(controller.step(0.0, q, v))
    assert outs[0].status is Status.OK
    assert outs[0].vdot[2] == pytest.approx(100.0 * (0.3 - q[2]), rel=1e-6)
    np.testing.assert_allclose(outs[0].vdot, outs[1].vdot, atol=1e-7)
    np.testing.assert_allclose(outs[0].tau, outs[1].tau, atol=1e-6)


def test_a_quadruped_rises_with_them(own, go2):
    """In MuJoCo, on contacts of one's own that push: its base comes to the height that the task asks for."""
    q, v = go2.keyframes["home"], np.zeros(18)
    feet = {name: own["Point"](name) for name in FEET}
    for foot in feet.values():
        foot.pushes = unilateral(foot, go2.state(q, v), DOWN, mu=0.6)
    goal = q[2] + 0.02
    tasks = {
        "rise": (own["Height"]("base", goal, 300.0, 35.0), 1.0, 1),
        "level": MotionTask("base", Hold(go2.state(q, v).frame("base").T), axes=("wx", "wy", "wz", "vx", "vy")),
        "posture": WholeBodyPosture(q, 20.0, 9.0, 12),
    }
    controller, plant = Controller(go2, feet, tasks, q=q), Simulator(go2, q, 1e-3)
    for _ in range(400):
        seen = plant.observe()
        out = controller.step(seen.t, seen.q, seen.v)
        assert out.status is Status.OK, out.reason
        plant.apply(out.tau)
    assert seen.q[2] == pytest.approx(goal, abs=1e-3)


def test_an_arm_lifts_with_its_task(own, bare_panda):
    q = bare_panda.keyframes["home"]
    goal = bare_panda.state(q, np.zeros(7)).frame("flange").p[2] + 0.05
    tasks = {"lift": own["Height"]("flange", goal, 300.0, 35.0), "posture": PostureTask(q)}
    controller, plant = Controller(bare_panda, tasks=tasks), Simulator(bare_panda, q, 1e-3)
    for _ in range(600):
        seen = plant.observe()
        out = controller.step(seen.t, seen.q, seen.v)
        plant.apply(out.tau)
    assert bare_panda.state(seen.q, seen.v).frame("flange").p[2] == pytest.approx(goal, abs=1e-4)
