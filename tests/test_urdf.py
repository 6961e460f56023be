"""Robots in URDF: base, poses and feet that the file leaves out; those of example-robot-data where it is installed."""

from __future__ import annotations

import importlib.metadata
import os

import bars
import mujoco
import numpy as np
import pinocchio as pin
import pytest

from wbc import model as models
from wbc.build import build
from wbc.check import check
from wbc.errors import ModelError, SpecError
from wbc.robot import Robot
from wbc.run import run
from wbc.spec import load
from wbc.urdf import TIP, Foot

LARGE = os.environ.get("WBC_CAMPAIGN") == "large"


def installed() -> bool:
    try:
        return bool(importlib.metadata.distribution("example-robot-data"))
    except importlib.metadata.PackageNotFoundError:
        return False


needs_examples = pytest.mark.skipif(not installed(), reason="needs example-robot-data: pip install 'wbc[robots]'")

LINK = """<link name="{0}"><inertial><origin xyz="0 0 -0.1"/><mass value="{1}"/>
  <inertia ixx="0.02" iyy="0.02" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial></link>"""
JOINT = """<joint name="{0}" type="{1}"><parent link="{2}"/><child link="{3}"/><origin xyz="{4}"/><axis xyz="0 1 0"/>
  <limit lower="-1" upper="2" effort="30" velocity="7"/></joint>"""
URDF = "".join((
    '<robot name="hopper">', *(LINK.format(*each) for each in (("trunk", 5), ("thigh", 1), ("foot", 0.3))),
    JOINT.format("hip", "revolute", "trunk", "thigh", "0 0.05 0"),
    JOINT.format("ankle", "fixed", "thigh", "foot", "0 0 -0.3"), "</robot>",
))  # fmt: skip
SRDF = """<robot name="hopper">
  <group_state name="crouched" group="all"><joint name="root_joint" value="0.1 0.2 0.5 0 0 0.6 0.8"/>
    <joint name="hip" value="0.7"/></group_state>
  <group_state name="of another" group="all"><joint name="knee" value="0.7"/></group_state></robot>"""


@pytest.fixture
def hopper(tmp_path):
    """hopper(srdf) -> the path of a URDF with an SRDF in the folder beside its own."""

    def one(srdf=SRDF):
        for folder in ("robots", "srdf"):
            (tmp_path / folder).mkdir(exist_ok=True)
        (tmp_path / "robots" / "hopper.urdf").write_text(URDF)
        (tmp_path / "srdf" / "some.srdf").write_text(srdf)
        return str(tmp_path / "robots" / "hopper.urdf")

    return one


class TestBase:
    def test_it_floats_where_the_srdf_has_a_root_joint(self, hopper):
        robot = Robot.load(hopper())
        assert (robot.base, robot.joints) == (6, ("hip",))
        assert set(robot.keyframes) == {"home", "crouched"}
        np.testing.assert_allclose(robot.keyframes["home"], [0.1, 0.2, 0.5, 0, 0, 0.6, 0.8, 0.7], atol=1e-12)

    def test_it_is_fixed_otherwise(self, hopper):
        robot = Robot.load(hopper(SRDF.replace("root_joint", "no_joint")))
        assert (robot.base, robot.nv, set(robot.keyframes)) == (0, 1, {"home"})

    def test_it_is_what_it_is_told_to_be(self, hopper):
        assert Robot.load(hopper(), base="fixed").base == 0
        assert Robot.load(hopper(), base="fixed").keyframes["crouched"] == pytest.approx([0.7])
        assert Robot.load(hopper("<robot name='r'/>"), base="floating").base == 6

    def test_limits_survive(self, hopper):
        robot = Robot.load(hopper())
        assert (robot.tau_max, robot.q_min, robot.q_max, robot.v_max) == ([30.0], [-1.0], [2.0], [7.0])

    def test_of_mjcf_it_is_in_the_file(self, tmp_path):
        text = "robot: go2\nbase: fixed\nscene: floor\ntasks: {hold: {type: posture, target: start, kp: 1, kd: 1}}\n"
        (tmp_path / "spec.yaml").write_text(text)
        with pytest.raises(SpecError, match="`base` is for URDF: an MJCF file says it by a free joint; expected none"):
            build(load(tmp_path / "spec.yaml"))


class TestFeet:
    def test_are_spheres_where_the_contact_says(self, hopper):
        for foot, radius, places in (
            (Foot(radius=0.02), 0.02, [(0, 0, 0)]),
            (Foot((0.2, 0.1)), TIP, [(x, y, TIP) for x in (-0.1, 0.1) for y in (-0.05, 0.05)]),
            (Foot((0.0, 0.06)), TIP, [(0, -0.03, TIP), (0, 0.03, TIP)]),
            (Foot((0.0, 0.06), 0.01), 0.01, [(0, -0.03, 0), (0, 0.03, 0)]),
        ):
            robot = Robot.load(hopper(), scene="floor", feet={"foot": foot, "not a link": foot})
            mj = robot.mujoco
            own = np.flatnonzero(mj.geom_bodyid == mj.body("foot").id)
            np.testing.assert_allclose(mj.geom_pos[own], places, atol=1e-12)
            np.testing.assert_allclose(mj.geom_size[own, 0], radius + 1e-6, atol=1e-12)
            assert pin.computeTotalMass(robot.model) == pytest.approx(6.3)

    def test_it_lands_on_them(self, hopper):
        robot = Robot.load(hopper(), scene="floor", feet={"foot": Foot(radius=0.02)})
        data = mujoco.MjData(robot.mujoco)
        data.qpos[:] = robot.to_mujoco(np.r_[0, 0, 0.33, 0, 0, 0, 1, 0.0], np.zeros(7))[0]
        for _ in range(100):
            mujoco.mj_step(robot.mujoco, data)
        assert {data.contact[i].geom[1] for i in range(data.ncon)} == {robot.mujoco.geom("foot_tip0").id}
        assert data.site("floor").xpos[2] == 0.0
        assert data.geom("foot_tip0").xpos[2] == pytest.approx(0.02, abs=1e-3)


def test_what_a_model_does_not_limit_is_told(tmp_path, hopper):
    path = hopper(SRDF.replace("root_joint", "no_joint"))
    text = URDF.replace('effort="30" velocity="7"', 'effort="0" velocity="0"').replace("revolute", "continuous")
    (tmp_path / "robots" / "hopper.urdf").write_text(text)
    (tmp_path / "spec.yaml").write_text(
        f"robot: {path}\nlimits: {{torque: model, velocity: model}}\n"
        "tasks: {posture: {type: posture, target: start, kp: 10, kd: 5}}\n"
    )
    notes = build(load(tmp_path / "spec.yaml")).notes
    assert "limits.torque: the model states none for hip" in notes
    assert "limits.velocity: the model states none for hip" in notes
    assert not [note for note in build(load("eraser")).notes if "states none" in note]


PLACE = """<link name="place"><inertial><mass value="{0}"/>
  <inertia ixx="{1}" iyy="{1}" izz="{1}" ixy="{1}" ixz="{1}" iyz="{1}"/></inertial></link>"""


@pytest.mark.parametrize(("mass", "inertia"), [(0, 0), (1e-6, 0), (1e-6, 1e-6)])
def test_links_that_stand_for_places_load(hopper, mass, inertia):
    """Without an inertia about some axis MuJoCo would refuse them; of a robot that falls apart they are no part."""
    path, more = hopper(), PLACE.format(mass, inertia) + JOINT.format("at", "fixed", "foot", "place", "0 0 0")
    text = URDF.replace("</robot>", more + "</robot>")
    with open(path, "w") as file:
        file.write(text)
    robot = Robot.load(path)
    assert "place" in robot.frames
    assert pin.computeTotalMass(robot.model) == pytest.approx(6.3 + mass, abs=1e-12)


def test_an_inertia_that_cannot_be_is_refused_by_name(hopper):
    path = hopper()
    with open(path, "w") as file:
        file.write(URDF.replace('izz="0.01" ixy="0"', 'izz="0.01" ixy="0.5"'))
    with pytest.raises(ModelError, match=r"positive eigenvalues[^$]*trunk"):
        Robot.load(path)


@needs_examples
class TestExamples:
    @pytest.mark.parametrize("name", ["talos", "solo12", "go2", "ur5"])
    def test_mean_the_same_as_to_the_reader_of_pinocchio(self, name, rng):
        """M and g at random states, whatever order the joints have."""
        robot = Robot.load(f"erd:{name}")
        root = [pin.JointModelFreeFlyer()] if robot.base else []
        theirs = pin.buildModelFromUrdf(str(models.find("scenes/robots", f"erd:{name}")), *root)
        assert (robot.nv, robot.nq) == (theirs.nv, theirs.nq)
        for _ in range(3):
            q = pin.integrate(robot.model, robot.keyframes["home"], rng.uniform(-0.5, 0.5, robot.nv))
            q_theirs, own = pin.neutral(theirs), np.arange(robot.nv)
            q_theirs[: 7 if robot.base else 0] = q[: 7 if robot.base else 0]
            for joint in robot.joints:
                mine, other = (m.joints[m.getJointId(joint)] for m in (robot.model, theirs))
                q_theirs[other.idx_q], own[other.idx_v] = q[mine.idx_q], mine.idx_v
            state, data = robot.state(q, np.zeros(robot.nv)), theirs.createData()
            M = pin.crba(theirs, data, q_theirs)
            M = np.triu(M) + np.triu(M, 1).T - np.diag(robot.model.armature[own])
            np.testing.assert_allclose(state.M[np.ix_(own, own)], M, atol=1e-9 * np.abs(M).max())
            g = pin.computeGeneralizedGravity(theirs, data, q_theirs)
            np.testing.assert_allclose(state.gravity()[own], g, atol=1e-9 * np.abs(g).max())

    def test_a_typo_is_met_with_the_nearest_name(self):
        for name, nearest in (
            ("tallos", "talos"),
            ("solo21", "solo12"),
            ("hyq", "hyq_no_sensors"),
            ("panda7", "panda"),
        ):
            with pytest.raises(ModelError, match=f"has no robot '{name}'; did you mean '{nearest}"):
                models.find("scenes/robots", f"erd:{name}")

    def test_talos_stand_loads_and_checks(self):
        told = check(load("talos_stand"))
        assert told.feasible
        assert told.model_error < 1e-9

    @pytest.mark.skipif(not LARGE, reason="runs by hand, and with WBC_CAMPAIGN=large")
    @pytest.mark.parametrize("solver", ["daqp", "proxqp"])
    def test_talos_stand_meets_its_bars(self, solver):
        finished = run(build(load("talos_stand", [f"solver={solver}"])))
        for metric, bound in (bars.SPECS["talos_stand"] | bars.ALWAYS).items():
            assert finished.summary["metrics"][metric] <= bound
        assert finished.ok

    def test_solo12_stands_on_its_round_feet(self, tmp_path):
        feet = "\n".join(
            f"  {leg}: {{frame: {leg}_FOOT, holds: [vx, vy, vz], pushes: -z, friction: 0.6, radius: 0.016}}"
            for leg in ("FL", "FR", "HL", "HR")
        )
        (tmp_path / "spec.yaml").write_text(f"""
robot: erd:solo12
scene: floor
duration: 0.5
references: {{level: {{hold: {{}}}}}}
contacts:
{feet}
tasks:
  balance: {{type: com, target: {{over: [FL, FR, HL, HR]}}, kp: 100, kd: 20}}
  trunk: {{type: motion, frame: base_link, axes: [wx, wy, wz], target: level, kp: 100, kd: 20}}
limits: {{torque: 3, torque_rate: 500, position: model}}
expect: {{settle: 0.2, balance.position.rms_error: 5.0e-4, FL.slip: 2.0e-4, HR.slip: 2.0e-4}}
""")
        assert run(build(load(tmp_path / "spec.yaml"))).ok
