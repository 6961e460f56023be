"""Bodies of the robot that stay apart: distances against coal and finite differences, and robots driven together."""

from __future__ import annotations

import coal
import mujoco
import numpy as np
import pinocchio as pin
import pytest

from wbc.build import build
from wbc.check import check
from wbc.collision import Pairs, SelfCollision, find_pairs, make_shapes, signed
from wbc.controller import Controller, Status
from wbc.errors import GainError, ModelError, SpecError
from wbc.reference import Hold
from wbc.resources import shipped_folder
from wbc.robot import Robot, State
from wbc.run import run
from wbc.spec import load
from wbc.task import MotionTask, PostureTask

MARGIN = 0.02  # [m]
SLACK = 1e-3  # [m] by which it may be missed
DT = 1e-3


@pytest.fixture(scope="module")
def shaped(tmp_path_factory):
    """A robot of two chains with every kind of shape: box, capsule, sphere, cylinder."""
    xml = """<mujoco><compiler angle="radian"/><default><joint range="-3 3" limited="true"/><geom mass="1"/></default><worldbody>
      <body name="a"><joint axis="0 0 1"/><geom type="box" size=".1 .05 .07"/>
        <body name="b" pos=".3 0 0"><joint axis="0 1 0"/><geom type="capsule" size=".03" fromto="0 0 0 .2 .05 0"/>
          <body name="c" pos=".2 .05 0"><joint axis="1 0 0"/><geom type="sphere" size=".04" pos=".05 0 .05"/></body>
        </body></body>
      <body name="d" pos="0 .4 .1"><joint axis="1 0 0"/><geom type="box" size=".04 .04 .1"/>
        <body name="e" pos=".2 0 0"><joint axis="0 0 1"/><geom type="cylinder" size=".03 .08"/>
          <body name="f" pos=".2 0 0"><joint axis="0 1 0"/><geom type="capsule" size=".02 .1"/></body>
        </body></body>
      </worldbody><actuator/></mujoco>"""
    path = tmp_path_factory.mktemp("shaped") / "shaped.xml"
    spec = mujoco.MjSpec.from_string(xml)
    for body in spec.bodies[1:]:
        joint = body.joints[0]
        joint.name = f"{body.name}_joint"
        spec.add_actuator(name=joint.name, target=joint.name, trntype=mujoco.mjtTrn.mjTRN_JOINT)
    path.write_text(spec.to_xml())
    return Robot.load(str(path))


def some(robot, rng):
    return robot.posed(rng.uniform(np.maximum(robot.q_min, -np.pi), np.minimum(robot.q_max, np.pi)))


def every(robot, **more):
    """A limit that looks at everything, however far apart."""
    found = SelfCollision(robot, **({"distance": MARGIN, "rows": 64} | more))
    found._law[5] = 10.0
    return found


class TestDistance:
    def test_the_least_of_a_pair_is_coals(self, shaped, rng):
        """Of boxes, capsules and spheres that do not meet, at random poses."""
        limit = every(shaped)
        pairs, seen = limit.pairs, 0
        for index in range(len(pairs.pairs)):
            limit.pairs = Pairs(pairs.shapes, pairs.pairs[index : index + 1], pairs.home[index : index + 1])
            for _ in range(40):
                state = shaped.state(some(shaped, rng), np.zeros(shaped.nv))
                exact = limit.pairs.distances(state)[0]
                if exact < 0.005:
                    continue
                told = limit.told(state)[1]
                assert told[0, 0] == pytest.approx(exact, abs=2e-5), limit.pairs.name(limit.pairs.pairs[0])
                seen += 1
        assert seen > 150

    @pytest.mark.parametrize("name", ["g1", "panda"])
    def test_shapes_are_those_of_the_simulator(self, name, request, rng):
        """Also where a cylinder counts as the capsule about it: never farther than MuJoCo has it."""
        robot = request.getfixturevalue({"panda": "bare_panda"}.get(name, name))
        found, mj = robot.pairs(), robot.mujoco
        own = [g for g in range(mj.ngeom) if mj.body_rootid[mj.geom_bodyid[g]]]
        q = some(robot, rng)
        data = mujoco.MjData(mj)
        data.qpos[:] = robot.to_mujoco(q, np.zeros(robot.nv))[0]
        mujoco.mj_kinematics(mj, data)
        ours = found.distances(robot.state(q, np.zeros(robot.nv)))
        for pair, d in list(zip(found.pairs, ours, strict=True))[::7]:
            true = mujoco.mj_geomDistance(mj, data, own[pair[0]], own[pair[1]], 9.0, None)
            capsules = all(mj.geom_type[own[g]] != mujoco.mjtGeom.mjGEOM_CYLINDER.value for g in pair)
            if d > 0.0 and true > 0.0:
                assert d == pytest.approx(true, abs=1e-5) if capsules else d <= true + 1e-5

    def test_gradient_and_drift_are_those_of_finite_differences(self, shaped, rng):
        """d, ddot and dddot of every row, of a motion with a constant v, and ddot = G v."""
        limit, h, checked = every(shaped), 1e-5, 0
        for _ in range(20):
            q, v = some(shaped, rng), rng.uniform(-1.0, 1.0, shaped.nv)
            rows, told, names = limit.told(shaped.state(q, v))
            G = rows.A["vdot"][: len(told)].copy()
            around = [limit.told(shaped.state(pin.integrate(shaped.model, q, s * h * v), v)) for s in (-1.0, 1.0)]
            np.testing.assert_allclose(G @ v, told[:, 1], atol=1e-10)
            for i, (name, row) in enumerate(zip(names, told, strict=True)):
                near = [_same(name, row, each, h) for each in around]
                if any(each is None for each in near) or rows.lo[i] == -np.inf:
                    continue  # its nearest points change features within the step
                (before, after), (d, rate, drift) = near, row
                assert (after[0] - before[0]) / (2 * h) == pytest.approx(rate, abs=1e-6)
                assert (after[1] - before[1]) / (2 * h) == pytest.approx(drift, rel=1e-4, abs=1e-4)
                checked += 1
        assert checked > 400

    def test_on_a_robot_that_floats_too(self, g1, rng):
        """The base moves all bodies alike."""
        limit = every(g1)
        for _ in range(3):
            q, v = some(g1, rng), rng.uniform(-1.0, 1.0, g1.nv)
            rows, told, _ = limit.told(g1.state(q, v))
            moved = np.isfinite(rows.lo)  # the others no joint moves apart
            np.testing.assert_allclose(rows.A["vdot"][:, :6], 0.0, atol=1e-12)
            np.testing.assert_allclose((rows.A["vdot"] @ v)[moved], told[moved[: len(told)], 1], atol=1e-10)

    def test_rows_do_not_jump_where_the_nearest_points_do(self, shaped):
        """Two capsules that tilt through parallel: what their rows allow changes as little as the pose."""
        limit, allowed, nearest = every(shaped), [], []
        for tilt in np.linspace(-0.02, 0.02, 81):
            q = np.array([0.4, 0.3 + tilt, 0.1, 0.2, -0.3, 0.4])
            rows, told, _ = limit.told(shaped.state(q, np.zeros(shaped.nv)))
            push = np.linspace(-1.0, 1.0, shaped.nv)
            allowed.append(min(-(rows.lo[: len(told)]) / np.maximum(-(rows.A["vdot"][: len(told)] @ push), 1e-9)))
            nearest.append(told[0, 0])
        assert np.abs(np.diff(nearest)).max() < 2e-3
        assert np.abs(np.diff(allowed)).max() < 0.2 * np.abs(allowed).max()

    def test_inside_a_box_it_is_the_depth(self, shaped):
        limit, coals = every(shaped), make_shapes(shaped)
        TODO


def _same(name, row, told, h):
    """The row of the same two features nearby: that of the same pair and nearly the same d, ddot and dddot."""
    _, rows, names = told
    close = [
        other
        for other_name, other in zip(names, rows, strict=True)
        if other_name == name and abs(other[0] - row[0]) < 10 * h and abs(other[1] - row[1]) < 1e-2
    ]
    close = [other for other in close if abs(other[2] - row[2]) < 0.05 * (1.0 + abs(row[2]))]
    return close[0] if len(close) == 1 else None


class TestPairs:
    def test_neighbours_and_what_cannot_meet_are_none(self, g1):
        found = find_pairs(g1)
        names = {found.name(pair) for pair in found.pairs}
        assert "torso_link, left_wrist_yaw_link" in names
        assert "left_wrist_yaw_link, right_wrist_yaw_link" in names
        for neighbours in ("pelvis, torso_link", "left_knee_link, left_ankle_roll_link", "torso_link, torso_link"):
            assert neighbours not in names
        assert "left_shoulder_pitch_link, right_shoulder_pitch_link" not in names  # both on the torso

    def test_what_is_near_at_home_is_left_out_and_told(self, g1):
        limit = SelfCollision(g1, MARGIN)
        assert "pelvis, left_hip_roll_link" in limit.near_home
        assert "pelvis, left_hip_roll_link" in limit.note
        assert (limit.pairs.home >= MARGIN).all()

    def test_wrong_numbers_and_robots_without_shapes(self, g1):
        with pytest.raises(GainError, match=r"self_collision.distance: expected a positive number, got -1"):
            SelfCollision(g1, -1.0)
        with pytest.raises(ModelError, match="loaded from a file"):
            SelfCollision(Robot.from_pinocchio(pin.buildSampleModelManipulator()), 0.02)
