"""The state of a tick against finite differences and against MuJoCo alone; names, limits and frames of a robot."""

import mujoco
import numpy as np
import pinocchio as pin
import pytest

from wbc.convention import to_pinocchio
from wbc.crosscheck import site_jacobian
from wbc.errors import ModelError, NameNotFound
from wbc.robot import Robot

FRAMES = {"panda on the board": "eraser", "panda": "flange", "ur5e": "flange", "planar3r": "flange"}
H = 1e-6


@pytest.fixture(params=FRAMES)
def arm(request, robots):
    """(robot, a frame of it)."""
    return robots[request.param], FRAMES[request.param]


@pytest.fixture
def written(tmp_path):
    """written(bodies, rest) -> the robot of that MJCF."""

    def load(bodies, rest=""):
        path = tmp_path / "written.xml"
        compiler = "<compiler angle='radian' autolimits='true'/>"
        path.write_text(f"<mujoco>{compiler}<worldbody>{bodies}</worldbody>{rest}</mujoco>")
        return Robot.load(str(path))

    return load


def load_of(mass, at):
    return f"<inertial pos='0 0 {at}' mass='{mass}' diaginertia='1 1 1'/>"


def angular_first(x):
    return np.r_[x[3:], x[:3]]


def test_twist_and_jacobian_are_the_pose_differentiated(arm, draw):
    robot, name = arm
    for _ in range(10):
        state = draw(robot)
        frame = state.frame(name)
        T = frame.T.copy()
        before, after = (
            robot.state(pin.integrate(robot.model, state.q, h * state.v), state.v).frame(name).T for h in (-H, H)
        )
        twist = angular_first((pin.log6(T.actInv(after)).vector - pin.log6(T.actInv(before)).vector) / (2 * H))
        np.testing.assert_allclose(frame.V, twist, atol=1e-8)
        np.testing.assert_allclose(frame.J @ state.v, frame.V, atol=1e-14)
        for i in range(robot.nv):
            after = robot.state(pin.integrate(robot.model, state.q, H * np.eye(robot.nv)[i]), state.v).frame(name).T
            np.testing.assert_allclose(frame.J[:, i], angular_first(pin.log6(T.actInv(after)).vector) / H, atol=3e-6)


def test_drift_is_the_jacobian_differentiated(arm, draw):
    robot, name = arm
    for _ in range(10):
        state = draw(robot)
        before, after = (
            robot.state(pin.integrate(robot.model, state.q, h * state.v), state.v).frame(name).J for h in (-H, H)
        )
        np.testing.assert_allclose(state.frame(name).drift, (after - before) @ state.v / (2 * H), atol=1e-8)


def test_state_is_what_mujoco_alone_says(arm, rng):
    robot, name = arm
    mj, data = robot.mujoco, mujoco.MjData(robot.mujoco)
    M = np.zeros((robot.nv, robot.nv))
    for _ in range(10):
        data.qpos[:], data.qvel[:] = rng.uniform(-1.5, 1.5, mj.nq), rng.uniform(-1, 1, mj.nv)
        mujoco.mj_forward(mj, data)
        mujoco.mj_fullM(mj, data, M)
        state = robot.state(*to_pinocchio(mj, data.qpos, data.qvel))
        frame, site = state.frame(name), mj.site(name).id
        J, drift = site_jacobian(mj, data, site)
        np.testing.assert_allclose(state.M, M, atol=1e-12)
        np.testing.assert_allclose(state.h, data.qfrc_bias, atol=1e-11)
        np.testing.assert_allclose(frame.J, J, atol=1e-12)
        np.testing.assert_allclose(frame.drift, drift, atol=1e-12)
        np.testing.assert_allclose(frame.T.translation, data.site_xpos[site], atol=1e-12)
        np.testing.assert_allclose(frame.table, np.c_[J, drift, J @ data.qvel], atol=1e-12)


def test_gravity_is_h_at_rest_and_asking_for_it_changes_nothing_else(arm, draw):
    robot, name = arm
    state = draw(robot)
    untouched = robot.state(state.q, state.v)
    np.testing.assert_allclose(state.gravity(), robot.state(state.q, 0 * state.v).h, atol=1e-12)
    for a, b in (
        (state.h, untouched.h),
        (state.M, untouched.M),
        (state.frame(name).table, untouched.frame(name).table),
    ):
        np.testing.assert_array_equal(a, b)


def test_solve_M_is_the_inverse(arm, draw):
    robot, _ = arm
    state = draw(robot)
    np.testing.assert_allclose(state.M @ state.solve_M(np.eye(robot.nv)), np.eye(robot.nv), atol=1e-11)


def test_joint_damping_is_in_h(written):
    robot = written(f"<body><joint damping='3'/>{load_of(1, 0.2)}</body>")
    q, v = np.array([0.3]), np.array([2.0])
    np.testing.assert_allclose(robot.state(q, v).h - robot.state(q, 0 * v).h, [6.0], atol=1e-12)


def test_one_joint_is_a_robot(written):
    robot = written(f"<body><joint axis='0 0 1'/>{load_of(1, 0)}<site name='tip' pos='0.5 0 0'/></body>")
    frame = robot.state(np.zeros(1), np.array([2.0])).frame("tip")
    np.testing.assert_allclose(frame.J, [[0], [0], [1], [0], [0.5], [0]], atol=1e-15)
    np.testing.assert_allclose(frame.V, [0, 0, 2, 0, 1, 0], atol=1e-15)


# --- names ---


def test_a_missing_frame_is_named_with_the_nearest(panda, draw):
    state = draw(panda)
    with pytest.raises(NameNotFound, match="no frame named 'erasor'; did you mean 'eraser'") as caught:
        state.frame("erasor")
    assert (caught.value.kind, caught.value.nearest) == ("frame", "eraser")
    with pytest.raises(NameNotFound, match="no frame named 'flangee'"):
        panda.wrench_map("flangee", "eraser")


def test_who_adds_gravity_is_one_of_two():
    with pytest.raises(ModelError, match=r"gravity: expected 'controller' or 'robot'.*got 'nobody'"):
        Robot.load("planar3r", gravity="nobody")


def test_keyframes_and_limits_are_the_published_ones(robots):
    panda, ur5e = robots["panda"], robots["ur5e"]
    np.testing.assert_allclose(panda.tau_max, [87, 87, 87, 87, 12, 12, 12])
    np.testing.assert_allclose(panda.tau_min, -panda.tau_max)
    np.testing.assert_allclose(panda.v_max, [2.175] * 4 + [2.61] * 3)
    np.testing.assert_allclose(panda.q_min, [-2.8973, -1.7628, -2.8973, -3.0718, -2.8973, -0.0175, -2.8973])
    np.testing.assert_allclose(panda.q_max, [2.8973, 1.7628, 2.8973, -0.0698, 2.8973, 3.7525, 2.8973])
    np.testing.assert_allclose(ur5e.tau_max, [150] * 3 + [28] * 3)
    np.testing.assert_allclose(ur5e.v_max, [np.pi] * 6)
    assert panda.joints == tuple(f"joint{i}" for i in range(1, 8))
    for robot in robots.values():
        home = robot.state(robot.keyframes["home"], np.zeros(robot.nv)).frame("flange").T
        np.testing.assert_allclose(home.translation, [0.5, 0, 0.41], atol=2e-5)
        assert (robot.q_min < robot.keyframes["home"]).all()
        assert (robot.keyframes["home"] < robot.q_max).all()
        assert robot.model_error <= 1e-9


def test_home_is_the_reference_pose_where_no_keyframe_says_so(written):
    robot = written(
        f"<body><joint ref='0.5'/>{load_of(1, 0)}</body>", "<keyframe><key name='up' qpos='1.5'/></keyframe>"
    )
    assert {name: q.tolist() for name, q in robot.keyframes.items()} == {"home": [0.5], "up": [1.5]}


def test_limits_have_one_entry_a_motor(written):
    leg = f"<body name='leg'><joint name='knee' axis='0 1 0' range='-1 2'/>{load_of(1, -0.1)}</body>"
    motor = "<actuator><motor joint='knee' ctrlrange='-9 9'/></actuator>"
    robot = written(f"<body name='base'><freejoint/>{load_of(5, 0)}{leg}</body>", motor)
    assert (robot.base, robot.nu, robot.nv, robot.joints) == (6, 1, 7, ("knee",))
    np.testing.assert_array_equal(robot.q_max, [2])
    np.testing.assert_array_equal(-robot.q_min, [1])
    np.testing.assert_array_equal(robot.tau_max, [9])


# --- a Pinocchio model of one's own ---


def test_from_pinocchio_keeps_the_model_and_its_limits():
    model = pin.buildSampleModelManipulator()
    model.upperEffortLimit = np.full(6, 20.0)
    model.lowerEffortLimit = np.full(6, -15.0)
    model.lowerPositionLimit = np.full(6, -1.0)
    model.referenceConfigurations["ready"] = np.full(6, 0.1)
    robot = Robot.from_pinocchio(model)
    assert robot.joints == tuple(model.names)[1:]
    np.testing.assert_array_equal(robot.tau_max, np.full(6, 20.0))
    np.testing.assert_array_equal(robot.tau_min, np.full(6, -15.0))
    np.testing.assert_array_equal(robot.q_min, np.full(6, -1.0))
    np.testing.assert_array_equal(robot.keyframes["ready"], np.full(6, 0.1))
    np.testing.assert_array_equal(robot.keyframes["home"], pin.neutral(model))
    state = robot.state(np.full(6, 0.3), np.full(6, 0.2))
    data = model.createData()
    np.testing.assert_allclose(state.h, pin.rnea(model, data, state.q, state.v, np.zeros(6)), atol=1e-12)
    assert robot.mujoco is None


def test_from_pinocchio_says_infinite_where_nothing_is_stated():
    model = pin.Model()
    model.addJoint(0, pin.JointModelRZ(), pin.SE3.Identity(), "turn")
    model.addJoint(1, pin.JointModelRUBZ(), pin.SE3.Identity(), "spin")  # two coordinates, one velocity
    robot = Robot.from_pinocchio(model)
    for limit in (robot.tau_max, -robot.tau_min, robot.q_max, -robot.q_min, robot.v_max):
        np.testing.assert_array_equal(limit, [np.inf, np.inf])


# --- frames ---


def test_axes_of_a_planar_arm(planar3r, panda):
    # the flange's y is normal to the plane: it turns about y and moves along x and z
    assert planar3r.axes("flange") == (1, 3, 5)
    assert panda.axes("eraser") == (0, 1, 2, 3, 4, 5)
    assert panda.axes("board") == ()


def test_fixed_pose(panda):
    np.testing.assert_allclose(
        panda.fixed_pose("board").homogeneous, [[1, 0, 0, 0.5], [0, 1, 0, 0], [0, 0, 1, 0.3], [0, 0, 0, 1]]
    )
    with pytest.raises(ModelError, match="frame 'eraser' moves with joint 'joint7'"):
        panda.fixed_pose("eraser")


def test_wrench_map_keeps_the_power(panda, draw, rng):
    X, F = panda.wrench_map("wrist_sensor", "eraser"), rng.normal(size=6)
    for _ in range(3):
        state = draw(panda)
        seen = (X @ F) @ state.frame("eraser").V
        assert seen == pytest.approx(F @ state.frame("wrist_sensor").V, abs=1e-12)
    assert panda.wrench_map("link6", "eraser") is None


def test_inertia_below_the_sensor_is_the_tool(panda):
    load = panda.inertia_below("wrist_sensor")
    assert load.mass == pytest.approx(0.2, abs=1e-12)
    np.testing.assert_allclose(load.lever, [0, 0, 0.041], atol=1e-12)
    np.testing.assert_allclose(load.inertia, np.diag([0.0001365, 0.0001865, 0.0001073]), atol=1e-12)


def test_inertia_below_takes_in_what_the_tool_carries(written):
    def tool(joint):
        """1 kg that carries a nameless body of 2 kg."""
        nested = f"<body pos='0 0 0.5'>{joint}{load_of(2, 0.1)}</body>"
        carried = f"<body name='tool'>{load_of(1, 0.1)}<site name='sensor'/>{nested}</body>"
        return written(f"<body name='arm'><joint/>{load_of(1, 0)}{carried}</body>")

    load = tool("").inertia_below("sensor")
    assert load.mass == pytest.approx(3.0)
    np.testing.assert_allclose(load.lever, [0, 0, (1.0 * 0.1 + 2.0 * 0.6) / 3.0], atol=1e-12)
    with pytest.raises(ModelError, match="a joint moves the load below sensor"):
        tool("<joint/>").inertia_below("sensor")


def test_inertia_below_needs_the_compiled_model():
    robot = Robot.from_pinocchio(pin.buildSampleModelManipulator())
    with pytest.raises(ModelError, match="read from the compiled model"):
        robot.inertia_below(robot.frames[-1])
