"""Robot, tool and scene files become one MuJoCo model and an equal Pinocchio model, or an error that says why not."""

import importlib.metadata
import warnings
from itertools import product
from pathlib import Path

import mujoco
import numpy as np
import pinocchio as pin
import pytest

from wbc import crosscheck
from wbc import model as models
from wbc.errors import ModelError, ModelMismatch
from wbc.robot import Robot

SHIPPED = [
    (robot, *rest)
    for robot, rest in product(("panda", "ur5e", "planar3r"), ((None, None), ("eraser", None), ("eraser", "board")))
] + [(robot, None, scene) for robot, scene in product(("go2", "g1"), (None, "floor"))]


@pytest.mark.parametrize(("robot", "tool", "scene"), SHIPPED)
def test_shipped_robots_mean_the_same_in_both(robot, tool, scene):
    mj = models.compile_model(models.compose(robot, tool, scene)[0])
    worst = crosscheck.disagreement(mj, models.pinocchio_model(mj), states=20, seed=1)
    assert set(worst) == {"M", "h", "g", "J", "drift", "pose"}
    assert max(worst.values()) <= 1e-9, worst


# --- any model ---


def vector(rng, n=3, size=0.4):
    return " ".join(f"{x:.9g}" for x in rng.uniform(-size, size, n))


def random_body(rng, count, free_allowed=False, depth=0):
    """MJCF of a random body with joints, sites and children; `count` hands out names."""
    name = f"b{next(count)}"
    inner = [
        f'<inertial pos="{vector(rng)}" quat="{vector(rng, 4)}" mass="{rng.uniform(0.3, 3):.9g}" '
        'diaginertia="0.02 0.03 0.04"/>'
    ]
    kind = rng.choice(
        ["free", "ball", "hinge", "slide", "many", "fixed"]
        if free_allowed
        else ["ball", "hinge", "slide", "many", "fixed"]
    )
    joints = {"free": ["free"], "ball": ["ball"], "hinge": ["hinge"], "slide": ["slide"], "fixed": []}.get(kind)
    for joint in rng.choice(["hinge", "slide"], rng.integers(2, 4)) if joints is None else joints:
        attributes = f'name="j{next(count)}" type="{joint}"'
        if joint != "free":
            attributes += f' armature="{rng.uniform(0, 0.1):.9g}" pos="{vector(rng)}"'
        if joint in ("hinge", "slide"):
            attributes += f' axis="{vector(rng)}" ref="{rng.uniform(-0.5, 0.5):.9g}"'
        inner.append(f"<joint {attributes}/>")
    if rng.random() < 0.7:
        inner.append(f'<site name="s{next(count)}" pos="{vector(rng)}" quat="{vector(rng, 4)}"/>')
    for _ in range(rng.integers(0, 3) if depth < 3 else 0):
        inner.append(random_body(rng, count, depth=depth + 1))
    return f'<body name="{name}" pos="{vector(rng)}" quat="{vector(rng, 4)}">{"".join(inner)}</body>'


def random_mjcf(seed):
    rng, count = np.random.default_rng(seed), iter(range(1000))
    bodies = "".join(random_body(rng, count, free_allowed=True) for _ in range(rng.integers(1, 4)))
    last = (
        '<body name="last"><inertial pos="0 0 0.1" mass="1" diaginertia="0.01 0.02 0.02"/><joint name="jl"/>'
        '<site name="sl"/></body><site name="world"/>'
    )
    gravity = vector(rng, size=9.81)
    return f'<mujoco><option gravity="{gravity}"/><worldbody>{bodies}{last}</worldbody></mujoco>'


@pytest.mark.parametrize("seed", range(40))
def test_random_models_mean_the_same_in_both(seed):
    mj = models.compile_model(mujoco.MjSpec.from_string(random_mjcf(seed)))
    worst = crosscheck.disagreement(mj, models.pinocchio_model(mj), states=5, seed=seed)
    assert max(worst.values()) <= 1e-9, worst


def test_random_models_hold_every_kind_of_joint():
    kinds = np.concatenate([mujoco.MjSpec.from_string(random_mjcf(seed)).compile().jnt_type for seed in range(40)])
    assert np.bincount(kinds, minlength=4).min() >= 10


def heavier(model):
    model.inertias[3].mass = 1.02 * model.inertias[3].mass


def lighter_world(model):
    model.gravity.linear = 0.99 * model.gravity.linear


def larger_rotors(model):
    model.armature = 1.1 * model.armature


@pytest.mark.parametrize(
    ("tamper", "differs"), [(heavier, {"M", "h", "g"}), (lighter_world, {"h", "g"}), (larger_rotors, {"M"})]
)
def test_a_tampered_model_is_refused_by_the_quantities_that_differ(bare_panda, tamper, differs):
    tampered = bare_panda.model.copy()
    tamper(tampered)
    with pytest.raises(
        ModelMismatch, match=r"disagree beyond 1e-08: .* by .*the conversion does not carry over"
    ) as caught:
        crosscheck.require_agreement(bare_panda.mujoco, tampered)
    assert set(caught.value.differences) == differs


def test_a_moved_joint_or_site_is_refused(bare_panda):
    moved = bare_panda.model.copy()
    moved.jointPlacements[4] = moved.jointPlacements[4] * pin.SE3(np.eye(3), np.array([0.0, 1e-4, 0.0]))
    with pytest.raises(ModelMismatch, match=r"M by .*pose by"):
        crosscheck.require_agreement(bare_panda.mujoco, moved)
    moved = bare_panda.model.copy()
    flange = moved.frames[moved.getFrameId("flange")]
    flange.placement = flange.placement * pin.SE3(pin.exp3(np.array([0.0, 1e-5, 0.0])), np.zeros(3))
    with pytest.raises(ModelMismatch, match=r"J by .*drift by .*pose by") as caught:
        crosscheck.require_agreement(bare_panda.mujoco, moved)
    assert set(caught.value.differences) == {"J", "drift", "pose"}


def test_a_number_that_is_not_one_is_a_disagreement(bare_panda):
    broken = bare_panda.model.copy()
    broken.armature = np.full(7, np.nan)
    with pytest.raises(ModelMismatch, match="M by inf"):
        crosscheck.require_agreement(bare_panda.mujoco, broken)


# --- URDF ---

URDF = """<robot name="arm"><link name="base"/>
{links}
</robot>"""
LINK = """<link name="{name}"><inertial><origin xyz="{com}" rpy="0.3 -0.2 0.5"/><mass value="{mass}"/>
<inertia ixx="0.03" iyy="0.04" izz="0.05" ixy="0.001" ixz="-0.002" iyz="0.003"/></inertial>
<visual><geometry><mesh filename="package://nowhere/{name}.dae"/></geometry></visual></link>
<joint name="{joint}" type="{kind}"><parent link="{parent}"/><child link="{name}"/>
<origin xyz="{at}" rpy="0.4 -0.7 1.1"/><axis xyz="{axis}"/>{limit}</joint>"""


@pytest.fixture
def urdf(tmp_path, rng):
    chain = [  # link, joint, kind, parent, axis, limit
        ("a", "turn", "revolute", "base", "0 0.6 0.8", '<limit lower="-1.5" upper="2.5" effort="40" velocity="1.7"/>'),
        ("b", "slide", "prismatic", "a", "0 0 1", '<limit lower="-0.2" upper="0.4" effort="300" velocity="0.5"/>'),
        ("c", "glue", "fixed", "b", "1 0 0", ""),
        ("d", "spin", "continuous", "c", "1 0 0", '<limit effort="12" velocity="6.28"/>'),
        ("e", "screwed", "fixed", "d", "1 0 0", ""),
    ]
    links = [
        LINK.format(
            name=n, joint=j, kind=k, parent=p, axis=a, limit=li, mass=2.0 - 0.3 * i, com=vector(rng), at=vector(rng)
        )
        for i, (n, j, k, p, a, li) in enumerate(chain)
    ]
    path = tmp_path / "arm.urdf"
    path.write_text(URDF.format(links="\n".join(links)))
    return path


def test_a_urdf_is_what_pinocchio_reads(urdf, rng):
    robot, theirs = Robot.load(str(urdf)), pin.buildModelFromUrdf(str(urdf))
    data = theirs.createData()
    assert robot.joints == ("turn", "slide", "spin")
    for _ in range(10):
        q, v = rng.uniform(-1, 1, 3), rng.uniform(-1, 1, 3)
        # Pinocchio keeps cos and sin of a joint without limits
        q_theirs = np.array([q[0], q[1], np.cos(q[2]), np.sin(q[2])])
        state = robot.state(q, v)
        pin.computeAllTerms(theirs, data, q_theirs, v)
        np.testing.assert_allclose(state.M, data.M, atol=1e-10)
        np.testing.assert_allclose(state.h, data.nle, atol=1e-10)
        np.testing.assert_allclose(state.gravity(), pin.computeGeneralizedGravity(theirs, data, q_theirs), atol=1e-10)
        J = pin.computeFrameJacobian(theirs, data, q_theirs, theirs.getFrameId("e"), pin.LOCAL)
        np.testing.assert_allclose(state.frame("e").J, np.r_[J[3:], J[:3]], atol=1e-10)


def test_a_urdf_keeps_its_limits(urdf):
    robot = Robot.load(str(urdf))
    np.testing.assert_allclose(robot.tau_max, [40, 300, 12])
    np.testing.assert_allclose(robot.tau_min, [-40, -300, -12])
    np.testing.assert_allclose(robot.v_max, [1.7, 0.5, 6.28])
    np.testing.assert_allclose(robot.q_min, [-1.5, -0.2, -np.inf])
    np.testing.assert_allclose(robot.q_max, [2.5, 0.4, np.inf])


# --- motors and their limits ---

ARM = """<mujoco><compiler angle="radian" autolimits="true"/><worldbody><body name="link"><joint name="turn" {joint}/>
<inertial pos="0 0 0.2" mass="1" diaginertia="0.01 0.01 0.01"/><site name="tip" pos="0 0 0.4"/></body></worldbody>
<actuator>{actuator}</actuator></mujoco>"""


def arm(tmp_path, actuator="", joint="", name="arm.xml"):
    path = tmp_path / name
    path.write_text(ARM.format(actuator=actuator, joint=joint))
    return str(path)


@pytest.mark.parametrize(
    ("actuator", "joint", "low", "high"),
    [
        ('<motor joint="turn" gear="10" ctrlrange="-3 2"/>', "", -30, 20),
        ('<motor joint="turn" gear="-10" ctrlrange="-3 2"/>', "", -20, 30),
        ('<motor joint="turn" gear="2" ctrlrange="-9 9" forcerange="-4 5"/>', "", -8, 10),
        ('<motor joint="turn" ctrlrange="-9 9"/>', 'actuatorfrcrange="-7 6"', -7, 6),
        ('<general joint="turn" gainprm="5" ctrlrange="-1 1"/>', "", -5, 5),
        ('<motor joint="turn"/>', "", -np.inf, np.inf),
    ],
)
def test_the_tightest_torque_limit_wins(tmp_path, actuator, joint, low, high):
    robot = Robot.load(arm(tmp_path, actuator, joint))
    assert (robot.tau_min[0], robot.tau_max[0]) == (low, high)


def test_position_servos_become_motors(tmp_path):
    robot = Robot.load(arm(tmp_path, '<position joint="turn" kp="500" kv="20" ctrlrange="-1 1" forcerange="-30 30"/>'))
    assert (robot.tau_min[0], robot.tau_max[0]) == (-30, 30)
    data = mujoco.MjData(robot.mujoco)
    data.qpos[0], data.qvel[0], data.ctrl[0] = 0.4, 1.0, 12.5
    mujoco.mj_forward(robot.mujoco, data)
    assert data.qfrc_actuator[0] == pytest.approx(12.5, abs=1e-12)


# --- files that cannot be used ---


@pytest.mark.parametrize(
    ("files", "message"),
    [
        (("pandas",), "no robot named 'pandas'; did you mean 'panda'"),
        (("zzzzzz",), "no robot named 'zzzzzz'; expected one of g1, go2, panda, panda_dual, planar3r, ur5e"),
        (("panda", "erasor"), "no tool named 'erasor'; did you mean 'eraser'"),
        (("panda", None, "bored"), "no scene named 'bored'; did you mean 'board'"),
        (("nowhere/arm.xml",), "no file 'nowhere/arm.xml'; expected a path, or one of g1"),
        (("",), "no robot named ''"),
    ],
)
def test_missing_files_and_names_are_told(files, message):
    with pytest.raises(ModelError, match=message):
        Robot.load(*files)


BROKEN = {
    "empty.xml": ("", "empty.xml"),
    "noise.xml": ("\x00\x01 not xml", "noise.xml"),
    "element.xml": ("<mujoco><worldbody><bodi/></worldbody></mujoco>", "(?s)element.xml.*bodi"),
    "axis.xml": ('<mujoco><worldbody><body><joint axis="0 0 0"/><geom size="1"/></body></worldbody></mujoco>', "axis"),
    "massless.xml": ("<mujoco><worldbody><body><joint/></body></worldbody></mujoco>", "MuJoCo refuses the model.*mass"),
    "nan.xml": (ARM.format(actuator="", joint='armature="nan"'), "not finite|nan"),
    "mesh.xml": ('<mujoco><asset><mesh name="m" file="gone.stl"/></asset><worldbody/></mujoco>', "gone.stl"),
    "broken.urdf": ("<robot><link", "broken.urdf"),
    "list.urdf": ("<robot name='r'><joint name='j' type='revolute'/></robot>", "list.urdf"),
}


@pytest.mark.parametrize("name", BROKEN)
def test_broken_files_are_model_errors(tmp_path, monkeypatch, name):
    monkeypatch.chdir(tmp_path)
    text, message = BROKEN[name]
    Path(name).write_text(text)
    with pytest.raises(ModelError, match=message):
        Robot.load(name)
    assert [file.name for file in tmp_path.iterdir()] == [name]


def test_a_tool_needs_a_flange(tmp_path):
    with pytest.raises(ModelError, match="has no site 'flange' to carry the tool 'eraser'"):
        Robot.load(arm(tmp_path), "eraser")


def test_an_example_robot_says_what_it_needs():
    with pytest.raises(ModelError, match=r"pip install 'wbc\[robots\]'|example-robot-data has no robot"):
        Robot.load("erd:no_such_robot")


def test_example_robots_are_found_by_the_stem_of_their_urdf(tmp_path, monkeypatch):
    """A package laid out as example-robot-data is: files below `robots/`, URDFs among them."""

    class Package:
        files = tuple(Path("share") / f"{stem}.urdf" for stem in ("panda", "ur5_robot", "talos_reduced", "talos_arm"))

        def locate_file(self, path):
            return tmp_path / path

    monkeypatch.setattr(importlib.metadata, "distribution", lambda name: Package())
    for name, stem in (
        ("panda", "panda"),
        ("ur5", "ur5_robot"),
        ("talos", "talos_reduced"),
        ("talos_arm", "talos_arm"),
    ):
        assert models.find("scenes/robots", f"erd:{name}") == tmp_path / "share" / f"{stem}.urdf"
    with pytest.raises(ModelError, match="has no robot 'pnda'; did you mean 'panda'"):
        models.find("scenes/robots", "erd:pnda")


def test_loading_leaves_no_trace(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        Robot.load("panda", "eraser", "board")
    assert not list(tmp_path.iterdir())
