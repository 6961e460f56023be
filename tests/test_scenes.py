"""The shipped robots, tools and scenes against published numbers, computed here without any of our own code."""

import warnings
from contextlib import contextmanager
from pathlib import Path

import mujoco
import numpy as np
import pytest

from wbc.robot import Robot

SCENES = Path(__file__).resolve().parents[1] / "scenes"
PI = np.pi

# Modified DH, Craig: T = prod Rx(alpha) Tx(a) Rz(q) Tz(d); the last row is the flange, which does not turn.
PANDA_DH = [  # alpha, a, d
    (0, 0, 0.333),
    (-PI / 2, 0, 0),
    (PI / 2, 0, 0.316),
    (PI / 2, 0.0825, 0),
    (-PI / 2, -0.0825, 0.384),
    (PI / 2, 0, 0),
    (PI / 2, 0.088, 0),
    (0, 0, 0.107),
]
# Standard DH: T = prod Rz(q) Tz(d) Tx(a) Rx(alpha). The scene turns the table's base by pi about z.
UR5E_DH = [  # d, a, alpha
    (0.1625, 0, PI / 2),
    (0, -0.425, 0),
    (0, -0.3922, 0),
    (0.1333, 0, PI / 2),
    (0.0997, 0, -PI / 2),
    (0.0996, 0, 0),
]
UR5E_JOINTS = [f"{name}_joint" for name in ("shoulder_pan", "shoulder_lift", "elbow", "wrist_1", "wrist_2", "wrist_3")]
ROBOTS = {
    "panda": {
        "joints": [f"joint{i}" for i in range(1, 8)],
        "masses": [4.970684, 0.646926, 3.228604, 3.587895, 1.225946, 1.666555, 0.735522],  # [kg], moving links
        "torque": [87, 87, 87, 87, 12, 12, 12],  # [N m]
        "velocity": [2.175, 2.175, 2.175, 2.175, 2.61, 2.61, 2.61],  # [rad/s]
        "lower": [-2.8973, -1.7628, -2.8973, -3.0718, -2.8973, -0.0175, -2.8973],  # [rad]
        "upper": [2.8973, 1.7628, 2.8973, -0.0698, 2.8973, 3.7525, 2.8973],
    },
    "ur5e": {
        "joints": UR5E_JOINTS,
        "masses": [3.761, 8.058, 2.846, 1.37, 1.3, 0.365],
        "torque": [150, 150, 150, 28, 28, 28],
        "velocity": [PI] * 6,
        "lower": [-2 * PI, -2 * PI, -PI, -2 * PI, -2 * PI, -2 * PI],
        "upper": [2 * PI, 2 * PI, PI, 2 * PI, 2 * PI, 2 * PI],
    },
    "planar3r": {  # chosen, not published: the numbers of the file's header
        "joints": ["joint1", "joint2", "joint3"],
        "masses": [2, 1.5, 0.5],
        "torque": [60, 25, 6],
        "velocity": [3, 3, 6],
        "lower": [-2.8] * 3,
        "upper": [2.8] * 3,
    },
}
COND_MAX = 2e3
TIPS = [f"eraser_{i}" for i in range(1, 5)]

each_robot = pytest.mark.parametrize("name", ROBOTS)


@contextmanager
def unprefixed():
    """Let MuJoCo 4 say that an unprefixed composition may not survive saving as XML: it is compiled, never saved.

    Said to its default handler, it would go to a log file in the working folder. Anything else it says is an error.
    """
    said, before = [], mujoco.get_mju_user_warning()
    mujoco.set_mju_user_warning(said.append)
    try:
        with warnings.catch_warnings():
            warnings.filterwarnings("ignore", message="Attaching a spec with an empty prefix")
            yield
    finally:
        mujoco.set_mju_user_warning(before)
    assert all("empty prefix" in message for message in said), said


def compose(name, tool=True, scene=True):
    """Compile a robot of `scenes/robots`, with the eraser on its flange, at the origin of the board's world."""
    robot = mujoco.MjSpec.from_file(str(SCENES / "robots" / f"{name}.xml"))
    world = mujoco.MjSpec.from_file(str(SCENES / "board.xml")) if scene else robot
    with unprefixed():
        if tool:
            eraser = mujoco.MjSpec.from_file(str(SCENES / "tools" / "eraser.xml"))
            robot.attach(eraser, site="flange", prefix="")
        if scene:
            world.attach(robot, frame=world.worldbody.add_frame(), prefix="")
        return world.compile()


def at_home(model):
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, model.key("home").id)
    mujoco.mj_forward(model, data)
    return data


def pose(data, site):
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = data.site(site).xmat.reshape(3, 3), data.site(site).xpos
    return T


def turn(axis, angle):
    """Rotation about x (0) or z (2) as a homogeneous matrix."""
    T, (i, j) = np.eye(4), ((axis + 1) % 3, (axis + 2) % 3)
    T[i, i] = T[j, j] = np.cos(angle)
    T[j, i], T[i, j] = np.sin(angle), -np.sin(angle)
    return T


def shift(x, z):
    T = np.eye(4)
    T[0, 3], T[2, 3] = x, z
    return T


def panda_flange(q):
    T = np.eye(4)
    for (alpha, a, d), angle in zip(PANDA_DH, [*q, 0], strict=True):
        T = T @ turn(0, alpha) @ shift(a, 0) @ turn(2, angle) @ shift(0, d)
    return T


def ur5e_flange(q):
    T = turn(2, PI)
    for (d, a, alpha), angle in zip(UR5E_DH, q, strict=True):
        T = T @ turn(2, angle) @ shift(a, d) @ turn(0, alpha)
    return T


def planar3r_flange(q):
    """The sums of the header of the file; z of the site along the last link, its y opposite to world y."""
    angles, lengths = np.cumsum(q), np.array([0.4, 0.4, 0.12])
    c, s = np.cos(angles[-1]), np.sin(angles[-1])
    T = np.eye(4)
    T[:3, :3] = np.array([[-s, 0, c], [0, -1, 0], [c, 0, s]])
    T[:3, 3] = lengths @ np.cos(angles), 0, 0.4 + lengths @ np.sin(angles)
    return T


def task_inertia(model, data, site):
    """J M^-1 J' of a site in its own axes, angular part first; an arm in the plane y = 0 has the axes wy, vx, vz."""
    J, M = np.zeros((6, model.nv)), np.zeros((model.nv, model.nv))
    mujoco.mj_jacSite(model, data, J[3:], J[:3], model.site(site).id)
    mujoco.mj_fullM(model, data, M)
    J = np.kron(np.eye(2), data.site(site).xmat.reshape(3, 3).T) @ J
    J = J[[1, 3, 5]] if model.nv == 3 else J
    return J @ np.linalg.solve(M, J.T)


@each_robot
@pytest.mark.parametrize("tool", [False, True])
@pytest.mark.parametrize("scene", [False, True])
def test_compiles_alone_and_composed(name, tool, scene):
    model = compose(name, tool, scene)
    assert [model.joint(i).name for i in range(model.njnt)] == ROBOTS[name]["joints"]
    assert [model.key(i).name for i in range(model.nkey)] == ["home"]
    assert model.nsensor == (2 if tool else 0)
    assert np.all(np.isfinite(at_home(model).qacc))


@each_robot
def test_names_of_frames_are_unique(name):
    """Bodies, joints and sites all become frames of one Pinocchio model, and share one set of names there."""
    model = compose(name)
    names = [model.body(i).name for i in range(model.nbody)] + [model.site(i).name for i in range(model.nsite)]
    names += [model.joint(i).name for i in range(model.njnt)]
    assert "" not in names
    assert len(names) == len(set(names))


@pytest.mark.parametrize(
    ("name", "flange"), [("panda", panda_flange), ("ur5e", ur5e_flange), ("planar3r", planar3r_flange)]
)
def test_flange_follows_the_published_kinematics(name, flange):
    model, rng = compose(name, tool=False, scene=False), np.random.default_rng(1)
    data = mujoco.MjData(model)
    for _ in range(20):
        data.qpos[:] = rng.uniform(*model.jnt_range.T)
        mujoco.mj_kinematics(model, data)
        np.testing.assert_allclose(pose(data, "flange"), flange(data.qpos), rtol=0, atol=1e-9)


@each_robot
def test_masses_are_the_published_ones(name):
    model = compose(name, tool=False, scene=False)
    moving = model.body_mass[model.jnt_bodyid]
    np.testing.assert_allclose(moving, ROBOTS[name]["masses"], rtol=0, atol=1e-12)
    composed = compose(name)
    first = composed.jnt_bodyid[0]
    assert composed.body_subtreemass[first] == pytest.approx(sum(ROBOTS[name]["masses"]) + 0.2, abs=1e-12)


@each_robot
def test_limits_are_the_published_ones(name):
    model, published = compose(name), ROBOTS[name]
    assert np.all(model.jnt_limited)
    np.testing.assert_allclose(model.jnt_range, np.c_[published["lower"], published["upper"]], rtol=0, atol=1e-12)
    np.testing.assert_allclose(model.jnt_user[:, 0], published["velocity"], rtol=0, atol=1e-12)
    torque = np.array(published["torque"])
    np.testing.assert_allclose(model.actuator_ctrlrange, np.c_[-torque, torque], rtol=0, atol=1e-12)


@each_robot
def test_actuators_are_plain_motors_named_as_the_joints(name):
    model = compose(name)
    assert [model.actuator(i).name for i in range(model.nu)] == ROBOTS[name]["joints"]
    np.testing.assert_array_equal(model.actuator_trnid[:, 0], np.arange(model.njnt))
    data = at_home(model)
    data.ctrl[:] = np.array(ROBOTS[name]["torque"]) * np.linspace(-0.9, 0.9, model.nu)
    mujoco.mj_forward(model, data)
    np.testing.assert_allclose(data.qfrc_actuator, data.ctrl, rtol=1e-14)


@each_robot
def test_joints_lose_nothing_and_shapes_of_the_robot_touch_nothing(name):
    model = compose(name, tool=False, scene=False)
    assert not model.dof_damping.any()
    assert not model.dof_frictionloss.any()
    assert not model.geom_contype.any()
    assert not model.geom_conaffinity.any()


@pytest.mark.parametrize(("name", "least"), [("panda", 1e-3), ("planar3r", 1e-4)])
def test_mass_matrix_needs_no_armature(name, least):
    model, rng = compose(name, tool=False, scene=False), np.random.default_rng(2)
    model.dof_armature[:] = 0
    data, M = mujoco.MjData(model), np.zeros((model.nv, model.nv))
    for _ in range(200):
        data.qpos[:] = rng.uniform(*model.jnt_range.T)
        mujoco.mj_forward(model, data)
        mujoco.mj_fullM(model, data, M)
        assert np.linalg.eigvalsh(M)[0] > least


@each_robot
def test_home_points_down_above_the_board_away_from_limits(name):
    model = compose(name)
    data = at_home(model)
    T = np.linalg.inv(pose(data, "board")) @ pose(data, "eraser")  # eraser in the board's frame: axes agree
    np.testing.assert_allclose(T[:3, :3], np.eye(3), rtol=0, atol=1e-9)
    np.testing.assert_allclose(T[:2, 3], 0, atol=1e-5)
    assert 0 < T[2, 3] < 0.15
    np.testing.assert_allclose(pose(data, "flange")[:3, 2], [0, 0, -1], rtol=0, atol=1e-9)
    lower, upper = model.jnt_range.T
    assert np.minimum(data.qpos - lower, upper - data.qpos).min() > 0.5
    assert np.all(np.abs(data.qfrc_bias) < 0.7 * model.actuator_ctrlrange[:, 1])
    assert np.linalg.cond(task_inertia(model, data, "eraser")) < COND_MAX
    assert data.ncon == 0


@each_robot
def test_arm_reaches_12_cm_to_both_sides_of_the_centre(name):
    """The planar arm along x, the others along x and y, with the eraser flat on the board."""
    model = compose(name)
    site, goals = model.site("eraser").id, [(0.12, 0), (-0.12, 0)] + ([] if model.nv == 3 else [(0, 0.12), (0, -0.12)])
    for goal in goals:
        data = at_home(model)
        J, error = np.zeros((6, model.nv)), np.ones(6)
        for _ in range(50):
            mujoco.mj_forward(model, data)
            mujoco.mj_jacSite(model, data, J[3:], J[:3], site)
            R = data.site("eraser").xmat.reshape(3, 3)
            error[:3] = -0.5 * np.array([R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]])
            error[3:] = data.site("board").xpos + np.array([*goal, 0]) - data.site("eraser").xpos
            data.qpos += np.linalg.pinv(J, rcond=1e-9) @ error
        assert np.abs(error).max() < 1e-9
        assert np.all((data.qpos > model.jnt_range[:, 0]) & (data.qpos < model.jnt_range[:, 1]))


def test_eraser_rests_on_its_four_spheres():
    model = mujoco.MjSpec.from_file(str(SCENES / "tools" / "eraser.xml")).compile()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    T = np.linalg.inv(pose(data, "eraser"))
    centres = np.array([data.geom(tip).xpos for tip in TIPS]) @ T[:3, :3].T + T[:3, 3]
    radii = np.array([model.geom(tip).size[0] for tip in TIPS])
    np.testing.assert_allclose(radii, 0.004, rtol=0, atol=1e-12)
    np.testing.assert_allclose(centres[:, 2] - radii, 0, atol=1e-12)
    assert {(round(x, 9), round(y, 9)) for x, y, _ in centres} == {
        (x, y) for x in (0.05, -0.05) for y in (0.025, -0.025)
    }
    sensor_T_eraser = np.linalg.inv(pose(data, "wrist_sensor")) @ pose(data, "eraser")
    np.testing.assert_allclose(sensor_T_eraser, shift(0, 0.08) @ turn(0, PI), rtol=0, atol=1e-12)


# mass [kg], radius, from, to [m] of the cylinders along z that a tool is made of
CHALK = (0.09, 0.016, 0.0, 0.05), (0.01, 0.005, 0.05, 0.12)  # holder, stick
MITT = ((0.1, 0.03, 0.0, 0.12),)


@pytest.mark.parametrize(
    ("name", "cylinders", "com_bar", "inertia_bar"), [("chalk", CHALK, 1e-4, 1e-7), ("mitt", MITT, 1e-12, 1e-9)]
)
def test_a_tip_touches_with_one_ball_whose_lowest_point_is_the_task_frame(name, cylinders, com_bar, inertia_bar):
    model = mujoco.MjSpec.from_file(str(SCENES / "tools" / f"{name}.xml")).compile()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    (tip,) = [i for i in range(model.ngeom) if model.geom_contype[i] or model.geom_conaffinity[i]]
    centre = np.linalg.inv(pose(data, name)) @ [*data.geom_xpos[tip], 1]
    np.testing.assert_allclose(centre[:3], [0, 0, model.geom_size[tip, 0]], rtol=0, atol=1e-12)
    np.testing.assert_allclose(pose(data, name), shift(0, 0.12) @ turn(0, PI), rtol=0, atol=1e-12)
    np.testing.assert_allclose(pose(data, "wrist_sensor"), np.eye(4), rtol=0, atol=1e-12)
    assert model.body_mass[1] == pytest.approx(sum(m for m, *_ in cylinders), abs=1e-12)
    com = sum(m * (a + b) / 2 for m, _, a, b in cylinders) / model.body_mass[1]
    np.testing.assert_allclose(model.body_ipos[1], [0, 0, com], atol=com_bar)
    across = sum(m * ((3 * r**2 + (b - a) ** 2) / 12 + ((a + b) / 2 - com) ** 2) for m, r, a, b in cylinders)
    along = sum(m * r**2 / 2 for m, r, *_ in cylinders)
    np.testing.assert_allclose(model.body_inertia[1], [across, across, along], atol=inertia_bar)


def test_a_whiteboard_stands_before_a_humanoid_whose_hand_points_at_it():
    robot = Robot.load("g1", "mitt", "whiteboard")
    board = robot.fixed_pose("board")
    np.testing.assert_allclose(board.rotation, [[0, 0, -1], [-1, 0, 0], [0, 1, 0]], atol=1e-12)
    np.testing.assert_allclose(board.translation, [0.42, -0.15, 0.9], atol=1e-12)
    mj = robot.mujoco
    centre = mj.body("board_body").pos + board.rotation @ mj.geom("board").pos  # its face is where the site is
    np.testing.assert_allclose(centre + board.rotation[:, 2] * mj.geom("board").size[2], board.translation, atol=1e-12)
    hand = robot.model.frames[robot.frame_id("right_wrist_yaw_link")].placement
    mitt = robot.model.frames[robot.frame_id("mitt")].placement
    np.testing.assert_allclose(hand.rotation.T @ mitt.rotation, board.rotation, atol=1e-12)
    np.testing.assert_allclose(hand.actInv(mitt).translation, [0.17, 0, 0], atol=1e-12)


@each_robot
def test_only_the_spheres_touch_and_only_the_board(name):
    model = compose(name)
    solid = [i for i in range(model.ngeom) if model.geom_contype[i] or model.geom_conaffinity[i]]
    assert {model.geom(i).name for i in solid} == {"board", *TIPS}
    assert {int(model.geom_contype[i]) for i in solid if model.geom(i).name != "board"} == {1}
    assert np.all(model.geom_condim[solid] == 1)
    data = at_home(model)
    gap = data.site("eraser").xpos[2] - data.site("board").xpos[2]
    model.body("board_body").pos[2] += gap + 1e-5
    mujoco.mj_forward(model, data)
    assert {frozenset(model.geom(i).name for i in pair) for pair in data.contact.geom} == {
        frozenset(("board", tip)) for tip in TIPS
    }


@each_robot
def test_wrist_sensor_carries_the_tool_at_rest(name):
    """Parent on child, in the axes of the sensor: the force holds the weight up wherever the arm is."""
    model, rng = compose(name, scene=False), np.random.default_rng(3)
    data, weight = mujoco.MjData(model), 0.2 * 9.81
    for _ in range(5):
        data.qpos[:] = rng.uniform(*model.jnt_range.T)
        mujoco.mj_forward(model, data)
        data.qfrc_applied[:] = data.qfrc_bias
        mujoco.mj_forward(model, data)
        np.testing.assert_allclose(data.qacc, 0, atol=1e-8)
        up = pose(data, "wrist_sensor")[:3, :3].T @ [0, 0, 1]
        np.testing.assert_allclose(data.sensor("wrist_force").data, weight * up, rtol=0, atol=1e-8)
        torque = np.cross([0, 0, 0.041], weight * up)
        np.testing.assert_allclose(data.sensor("wrist_torque").data, torque, rtol=0, atol=1e-8)
        data.qfrc_applied[:] = 0


def test_board_is_horizontal_at_the_stated_height_and_frictionless():
    model = mujoco.MjSpec.from_file(str(SCENES / "board.xml")).compile()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    board = shift(0.5, 0.3)
    np.testing.assert_allclose(pose(data, "board"), board, rtol=0, atol=1e-12)
    size = model.geom("board").size
    np.testing.assert_allclose(size, [0.25, 0.25, 0.02], rtol=0, atol=1e-12)
    assert data.geom("board").xpos[2] + size[2] == pytest.approx(0.3, abs=1e-12)
    assert model.opt.timestep == 0.001
    assert model.opt.integrator == mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    assert model.opt.cone == mujoco.mjtCone.mjCONE_ELLIPTIC
    assert model.opt.disableflags == mujoco.mjtDisableBit.mjDSBL_AUTORESET
    assert model.camera("overview").id == 0
    np.testing.assert_allclose(model.opt.gravity, [0, 0, -9.81])
