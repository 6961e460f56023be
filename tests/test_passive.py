"""Joints that are the plant's alone: a hinge of the scene, a wheel of the tool. MuJoCo at their rest is the oracle."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pytest

from wbc.build import build
from wbc.coordinates import own_coordinates, to_mujoco
from wbc.crosscheck import site_jacobian
from wbc.errors import ModelError, SpecError
from wbc.model import open_welds
from wbc.robot import Robot
from wbc.run import run
from wbc.sim import Simulator
from wbc.spec import load

TOOL = """
<mujoco model="roller">
  <compiler angle="radian"/>
  <worldbody>
    <body name="fork">
      <inertial mass="0.3" pos="0.01 0 0.03" diaginertia="2e-4 3e-4 1e-4"/>
      <site name="wrist_sensor"/>
      <site name="hook" pos="0 0 0.1" quat="0 1 0 0"/>
      <body name="wheel" pos="0 0 0.08">
        <inertial mass="0.1" pos="0 0 0" diaginertia="4e-5 8e-5 4e-5"/>
        <joint type="hinge" axis="0 1 0" armature="1e-4" ref="0.3"/>
        <geom name="tyre" type="sphere" size="0.02" mass="0" contype="1" conaffinity="2"/>
      </body>
      <body name="finger" pos="0.02 0 0.05">
        <inertial mass="0.05" pos="0 0 0.01" diaginertia="1e-5 1e-5 1e-5"/>
        <joint name="finger" type="slide" axis="1 0 0" range="0 0.03" limited="true"/>
      </body>
    </body>
  </worldbody>
  <actuator><motor name="finger" joint="finger"/></actuator>
</mujoco>
"""


@pytest.fixture(scope="module")
def tool(tmp_path_factory) -> Path:
    file = tmp_path_factory.mktemp("tool") / "roller.xml"
    file.write_text(TOOL)
    return file


@pytest.fixture(scope="module")
def opener() -> Robot:
    return Robot.load("panda", "hook", "door")


@pytest.fixture(scope="module")
def roller(tool) -> Robot:
    return Robot.load("panda", str(tool), "door")


def test_a_scene_without_joints_has_one_model(panda):
    assert panda.plant is panda.mujoco
    np.testing.assert_array_equal(own_coordinates(panda)[0], np.arange(7))


def test_the_robot_has_its_own_joints_and_the_plant_all(opener, roller):
    assert opener.joints == tuple(f"joint{i}" for i in range(1, 8))
    assert opener.plant.nv == 8
    # a joint of the tool with a motor is the robot's; one without, and without a name, is not
    assert roller.joints == (*opener.joints, "finger")
    assert {roller.plant.joint(i).name for i in range(roller.plant.njnt)} == {
        *roller.joints,
        "wheel_joint",
        "door_hinge",
    }
    assert roller.tau_max.size == roller.nv == 8
    assert roller.q_max[-1] == 0.03


def test_a_part_that_the_plant_moves_is_a_fixed_frame_of_the_scene(opener):
    np.testing.assert_allclose(opener.fixed_pose("handle").translation, [0.5, 0, 0.3], atol=1e-12)
    np.testing.assert_allclose(opener.fixed_pose("handle").rotation, np.eye(3), atol=1e-12)


@pytest.mark.parametrize("which", ["opener", "roller"])
def test_dynamics_are_those_of_the_plant_with_its_own_joints_at_rest(which, request, rng):
    robot = request.getfixturevalue(which)
    plant, (at_q, at_v) = robot.plant, own_coordinates(robot)
    data, M = mujoco.MjData(plant), np.zeros((plant.nv, plant.nv))
    assert robot.model_error < 1e-9
    for _ in range(20):
        q, v = rng.uniform(-1.5, 1.5, robot.nv), rng.uniform(-1, 1, robot.nv)
        state = robot.state(q, v)
        data.qpos[:], data.qvel[:] = plant.qpos0, 0
        data.qpos[at_q], data.qvel[at_v] = to_mujoco(robot.mujoco, q), v
        mujoco.mj_forward(plant, data)
        mujoco.mj_fullM(plant, data, M)
        np.testing.assert_allclose(state.M, M[np.ix_(at_v, at_v)], atol=1e-10)
        np.testing.assert_allclose(state.h, data.qfrc_bias[at_v], atol=1e-9)
        J, drift = site_jacobian(plant, data, plant.site("hook").id)
        np.testing.assert_allclose(state.frame("hook").J, J[:, at_v], atol=1e-10)
        np.testing.assert_allclose(state.frame("hook").drift, drift, atol=1e-9)


def test_a_sensor_carries_the_wheel_but_not_what_a_motor_moves(roller, tmp_path):
    with pytest.raises(ModelError, match="a joint moves the load below sensor"):
        roller.inertia_below("wrist_sensor")
    (tmp_path / "passive.xml").write_text(TOOL.replace('<motor name="finger" joint="finger"/>', ""))
    assert Robot.load("panda", str(tmp_path / "passive.xml")).inertia_below("wrist_sensor").mass == pytest.approx(0.45)


def test_errors_of_the_plant_are_the_robots(opener):
    spec = load("door", ["plant.mass_error=0.1", "plant.armature=0.2", "plant.joint_friction=0.5", "plant.payload=1"])
    model = Simulator(opener, opener.keyframes["home"], 1e-3, spec.plant).model
    hinge = model.joint("door_hinge")
    assert model.body("door").mass[0] == 8.0
    assert model.body("hook_body").mass[0] == pytest.approx(1.1 * 0.2 + 1)
    assert model.dof_armature[hinge.dofadr[0]] == 0.0
    assert model.dof_frictionloss[hinge.dofadr[0]] == 3.0
    own = own_coordinates(opener)[1]
    assert (model.dof_armature[own] == 0.2).all()
    assert (model.dof_frictionloss[own] == 0.5).all()


def test_a_payload_sits_where_it_is_said_to():
    built = build(load("force_pi", ["plant.payload_at=link4"]))
    model = Simulator(built.robot, built.q, 1e-3, built.spec.plant).model
    grown = {model.body(i).name: model.body_mass[i] - built.robot.plant.body_mass[i] for i in range(model.nbody)}
    assert {name: round(mass, 12) for name, mass in grown.items() if mass} == {"link4": 0.15}


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ("plant.payload_at=flnge", r"plant\.payload_at: no frame named 'flnge'; did you mean 'flange'"),
        ("plant.payload_at=anchor", r"plant\.payload_at: frame 'anchor' is fixed to the world"),
        ("plant.payload=0", r"plant\.payload_at: there is no payload; expected"),
    ],
)
def test_a_payload_nowhere_is_refused(change, message):
    with pytest.raises(SpecError, match=message):
        build(load("force_pi", [change]))


def test_a_weld_that_the_start_leaves_open_is_refused():
    # the frame of the contact is another than the one that the scene holds
    with pytest.raises(
        SpecError, match=r"scene: it welds hook to anchor, which are 3.1 m or rad apart at .* expected a"
    ):
        build(load("force_feedforward", ["contacts.anchor.frame=wrist_sensor", "contacts.anchor.on=anchor"]))


def test_gaps_of_welds_and_connections():
    model = mujoco.MjModel.from_xml_string("""<mujoco><worldbody><site name="a"/><site name="b" pos="0 0.3 0"/>
      <body><freejoint/><geom size="0.1"/><site name="c" pos="0.2 0 0" euler="0 0 90"/></body></worldbody><equality>
      <weld site1="a" site2="b"/><weld site1="c" site2="a"/><connect site1="a" site2="c"/>
      <weld site1="a" site2="b" active="false"/></equality></mujoco>""")
    assert open_welds(model, model.qpos0) == [
        ("a", "b", pytest.approx(0.3)),
        ("c", "a", pytest.approx(np.pi / 2)),
        ("a", "c", pytest.approx(0.2)),
    ]


def test_equalities_of_another_tool_are_left_out():
    assert Robot.load("panda", "hook", "anchor").plant.neq == 1
    assert Robot.load("panda", "eraser", "anchor").plant.neq == 0
    assert Robot.load("panda", None, "door").plant.neq == 0


# --- true wrenches ---

HUNG = """
<mujoco><option timestep="0.001" integrator="implicitfast"/><worldbody>
  <site name="hold" pos="0.15 0.15 1.15" quat="0.5 0.3 -0.2 0.7"/>
  <body name="base" pos="0 0 1"><freejoint name="float"/>
    <inertial mass="2" pos="0.03 0.02 0.01" diaginertia="0.02 0.03 0.04"/>
    <site name="flange"/><site name="grip" pos="0.15 0.15 0.15" quat="0.5 0.3 -0.2 0.7"/>
  </body>
</worldbody><equality>{}</equality></mujoco>
"""
WELDS = {
    "tool first": '<weld site1="grip" site2="hold" solref="0.005 1"/>',
    "scene first": '<weld site1="hold" site2="grip" solref="0.005 1" torquescale="3"/>',
    "two": '<weld site1="grip" site2="hold" solref="0.005 1"/><connect site1="flange" site2="hold" active="false"/>'
    '<weld site1="hold" site2="grip" solref="0.005 1"/>',
}


@pytest.mark.parametrize("which", WELDS)
def test_a_weld_carries_a_weight(which, tmp_path):
    """A body hangs on one point: what it applies there is its weight, with the lever of its centre of mass."""
    (tmp_path / "hung.xml").write_text(HUNG.format(WELDS[which]))
    robot = Robot.load(str(tmp_path / "hung.xml"))
    simulator = Simulator(robot, robot.keyframes["home"], 1e-3)
    for _ in range(2000):
        simulator.observe()
        simulator.apply(np.zeros(6))
    R, p = simulator.data.site("grip").xmat.reshape(3, 3), simulator.data.site("grip").xpos
    weight = np.array([0, 0, -2 * 9.81])
    moment = np.cross(simulator.data.xipos[1] - p, weight)
    np.testing.assert_allclose(simulator.true_wrench("grip"), np.r_[R.T @ moment, R.T @ weight], atol=1e-6)
    seen = simulator.true_wrench("base")  # the same about another point, in other axes
    R0, p0 = simulator.data.xmat[1].reshape(3, 3), simulator.data.xpos[1]
    np.testing.assert_allclose(
        seen, np.r_[R0.T @ np.cross(simulator.data.xipos[1] - p0, weight), R0.T @ weight], atol=1e-5
    )


def test_in_motion_it_is_what_the_sensor_reads_less_the_tools_own():
    """The door moves while its friction changes: the multipliers of the weld against the wrist's force sensor."""
    errors, built = [], build(load("door", ["duration=1"]))

    def look(simulator):
        reading = simulator.measured(built.controller.state, simulator.data.qacc[own_coordinates(built.robot)[1]])
        state = built.controller.state
        errors.append(reading.at(state, "hook") - simulator.true_wrench("hook"))

    finished = run(built, show=look)
    assert np.abs(finished.log["handle.true"]).max() > 2
    assert np.abs(errors).max() < 1e-4
