"""Bodies of the robot that stay apart: distances against coal and finite differences, and robots driven together."""

from __future__ import annotations

import re
from typing import ClassVar

import mujoco
import numpy as np
import pinocchio as pin
import pytest

from wbc.build import build
from wbc.check import check
from wbc.collision import Pairs, SelfCollision, find_pairs, signed
from wbc.controller import Controller
from wbc.errors import GainError, ModelError, SpecError
from wbc.ladder import Status
from wbc.limit import make_collision
from wbc.resources import shipped_folder
from wbc.robot import Robot
from wbc.run import run
from wbc.sim import Simulator
from wbc.spec import load
from wbc.task.posture import PostureTask

MARGIN = 0.02  # [m]
SLACK = 1e-3  # [m] by which it may be missed
DT = 1e-3
BOUND = f"expect: {{self_collision.distance.min: {{min: {MARGIN - SLACK}}}}}\n"


SHAPED = """<mujoco><compiler angle="radian"/><default><joint range="-3 3" limited="true"/><geom mass="1"/></default>
  <worldbody>
    <body name="a"><joint axis="0 0 1"/><geom type="box" size=".1 .05 .07"/>
      <body name="b" pos=".3 0 0"><joint axis="0 1 0"/><geom type="capsule" size=".03" fromto="0 0 0 .2 .05 0"/>
        <body name="c" pos=".2 .05 0"><joint axis="1 0 0"/><geom type="sphere" size=".04" pos=".05 0 .05"/></body>
      </body></body>
    <body name="d" pos="0 .4 .1"><joint axis="1 0 0"/><geom type="box" size=".04 .04 .1"/>
      <body name="e" pos=".2 0 0"><joint axis="0 0 1"/><geom type="cylinder" size=".03 .08"/>
        <body name="f" pos=".2 0 0"><joint axis="0 1 0"/><geom type="capsule" size=".02 .1"/></body>
      </body></body>
  </worldbody></mujoco>"""
# two carts of 1 kg on one rail, 0.8 m between them
CARTS = """<mujoco><default><joint type="slide" axis="1 0 0" range="-2 2" limited="true"/><geom mass="1"/></default>
  <worldbody>
    <body name="box" pos="-.5 0 0"><joint/><geom type="box" size=".1 .1 .1"/></body>
    <body name="ball" pos=".5 0 0"><joint/><geom type="sphere" size=".1"/></body>
  </worldbody></mujoco>"""


# a bar on a hinge over a beam that goes up and down
SEESAW = """<mujoco><compiler angle="radian"/><default><geom mass="1"/></default>
  <worldbody>
    <body name="beam"><joint type="slide" axis="0 0 1" range="-.1 .1"/>
      <geom type="capsule" size=".03" fromto="-.2 0 0 .2 0 0"/></body>
    <body name="bar" pos="0 0 .12"><joint axis="0 1 0" range="-1 1"/>
      <geom type="capsule" size=".03" fromto="-.15 0 0 .15 0 0"/></body>
  </worldbody></mujoco>"""


def made(xml, path):
    """A robot with a motor in every joint."""
    spec = mujoco.MjSpec.from_string(xml)
    for body in spec.bodies[1:]:
        joint = body.joints[0]
        joint.name = f"{body.name}_joint"
        spec.add_actuator(name=joint.name, target=joint.name, trntype=mujoco.mjtTrn.mjTRN_JOINT)
    spec.option.gravity = [0.0, 0.0, 0.0]
    path.write_text(spec.to_xml())
    return Robot.load(str(path))


@pytest.fixture(scope="module")
def shaped(tmp_path_factory):
    """Two chains with every kind of shape: box, capsule, sphere, cylinder."""
    return made(SHAPED, tmp_path_factory.mktemp("shaped") / "shaped.xml")


@pytest.fixture(scope="module")
def carts(tmp_path_factory):
    return made(CARTS, tmp_path_factory.mktemp("carts") / "carts.xml")


@pytest.fixture(scope="module")
def seesaw(tmp_path_factory):
    return made(SEESAW, tmp_path_factory.mktemp("seesaw") / "seesaw.xml")


def some(robot, rng):
    return robot.posed(rng.uniform(np.maximum(robot.q_min, -np.pi), np.minimum(robot.q_max, np.pi)))


def every(robot, **more):
    """A limit that looks at everything, however far apart."""
    found = SelfCollision(robot, **({"distance": MARGIN, "rows": 64} | more))
    found._law[6] = 10.0
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
                (before, after), (_, rate, drift) = near, row
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

    def test_rows_do_not_jump_where_the_nearest_points_do(self, seesaw):
        """A bar that tilts through parallel over a beam: its nearest end changes sides, what its turning may be not."""
        limit, bounds, sides = SelfCollision(seesaw, MARGIN), [], []
        for tilt in np.linspace(-0.02, 0.02, 81):
            state = seesaw.state(np.array([0.0, tilt]), np.zeros(2))
            rows, told, _ = limit.told(state)
            G, lo = rows.A["vdot"][: len(told), 1], rows.lo[: len(told)]
            bounds.append((np.max(lo[G > 0.01] / G[G > 0.01]), np.min(lo[G < -0.01] / G[G < -0.01])))
            sides.append(np.sign(G[0]))
        assert set(sides) == {-1.0, 1.0}  # of the nearest alone it would jump from one bound to the other
        assert np.abs(np.diff(bounds, axis=0)).max() < 0.05 * np.abs(bounds).max()

    def test_inside_a_box_it_is_the_depth(self, carts):
        """The same function, continued: a ball whose middle is in the box."""
        limit = SelfCollision(carts, MARGIN)
        for x in (0.75, 0.85, 0.95):  # of the box; the ball touches it at 0.8
            state = carts.state(np.array([x, 0.0]), np.array([1.0, 0.25]))
            rows, told, names = limit.told(state)
            assert names[0] == "collision[box, ball]"
            np.testing.assert_allclose(told[0], [0.8 - x, -0.75, 0.0], atol=1e-9)
            np.testing.assert_allclose(rows.A["vdot"][0], [-1.0, 1.0], atol=1e-9)
            assert signed(limit.pairs.shapes, limit.pairs.pairs, state)[0] == pytest.approx(0.8 - x, abs=1e-6)


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
        with pytest.raises(GainError, match="expected distance, deceleration and rows, got margin"):
            make_collision(g1, {"margin": 0.02})
        with pytest.raises(ModelError, match="loaded from a file"):
            SelfCollision(Robot.from_pinocchio(pin.buildSampleModelManipulator()), 0.02)


def drive(robot, limits, q, v, tasks, ticks, **more):
    """A controlled robot in MuJoCo: distances, outputs."""
    controller = Controller(robot, tasks=tasks, limits=limits, **more)
    plant = Simulator(robot, q, DT)
    plant.data.qvel[:] = v
    controller.reset(q, v)
    limit, near, told = controller.phase.collision, [], []
    for _ in range(ticks):
        seen = plant.observe()
        out = controller.step(seen.t, seen.q, seen.v)
        near.append(limit.pairs.distances(robot.state(seen.q, seen.v)).min())
        told.append(out)
        plant.apply(out.tau)
    return np.array(near), told


class TestCarts:
    """One distance, d = 0.8 - x_box + x_ball, and nothing else."""

    LIMITS: ClassVar = {"torque": 50.0, "torque_rate": 2000.0, "self_collision": MARGIN}

    @pytest.mark.parametrize("hierarchy", ["weighted", "strict"])
    def test_pressed_together_they_stop_and_rest(self, carts, rng, hierarchy):
        """From any speed that can be braked, however hard they are pulled: one approach, no chatter."""
        for _ in range(4):
            gap, speed = rng.uniform(0.1, 0.5), rng.uniform(0.0, 0.5)
            tasks = {"meet": PostureTask(np.array([2.0, -2.0]), rng.choice([10.0, 200.0]), 10.0)}
            q = np.array([0.4, gap + MARGIN - 0.4])
            near, told = drive(
                carts, self.LIMITS, q, speed * np.array([1.0, -1.0]) / 2, tasks, 1500, hierarchy=hierarchy
            )
            assert near.min() >= MARGIN - 1e-6
            assert near[-1] == pytest.approx(MARGIN, abs=1e-5)
            tau = np.array([out.tau for out in told])
            assert np.abs(np.diff(tau[-500:], axis=0)).max() < 0.02  # [N] a tick, and smooth:
            assert np.abs(np.diff(tau[-500:], 2, axis=0)).max() < 1e-4
            assert "collision[box, ball]" in told[-1].active
            assert {out.status for out in told} <= {Status.OK, Status.LIMITED}
            assert not any("yield" in out.reason for out in told)

    def test_from_nearer_they_come_apart_and_say_so(self, carts):
        tasks = {"stay": PostureTask(np.array([0.4, -0.395]), 100.0, 20.0)}
        near, told = drive(carts, self.LIMITS, np.array([0.4, -0.395]), np.zeros(2), tasks, 2000)
        assert near[0] == pytest.approx(0.005, abs=1e-6)
        assert near.min() >= 0.005 - 1e-6
        assert near[-1] == pytest.approx(MARGIN, abs=1e-4)
        assert "collision[box, ball]" in told[0].active

    def test_what_no_torque_can_brake_yields_and_says_so(self, carts):
        """Far too fast for motors of 0.2 N: the torque stays within its limits, the tick goes on."""
        limits = self.LIMITS | {"torque": 0.2}
        near, told = drive(carts, limits, np.array([0.3, -0.3]), np.array([1.5, -1.5]), {}, 120)
        assert near.min() < MARGIN
        yields = [out for out in told if "distances yield: nothing satisfies them" in out.reason]
        assert yields
        assert {out.status for out in told} == {Status.LIMITED}
        assert max(np.abs(out.tau).max() for out in told) <= 0.2 + 1e-9

    def test_what_is_not_limited_has_no_rows(self, carts):
        assert "collision" not in Controller(carts).workspace.stored
        assert Controller(carts).phase.collision is None


# --- a humanoid whose hand is pulled into its body ---


def hugging(tmp_path, *more):
    """g1_stand with its left palm sent to the pelvis and back: the spec, built."""
    text = (shipped_folder("tasks") / "g1_stand.yaml").read_text()
    out, into = "[0.102, 0.211, 0.597]", "[0.052, 0.02, 0.647]"
    reach = "reach: {type: motion, frame: left_palm, axes: [vx, vy, vz], target: into, kp: 100, kd: 20}"
    course = f"into: {{quintic: {{waypoints: [{out}, {into}, {into}, {out}], times: [0, 0.6, 0.9, 1.5]}}}}"
    for old, new in (
        ("  level: {hold: {}}", f"  level: {{hold: {{}}}}\n  {course}"),
        ("  posture:", f"  {reach}\n  posture:"),
        ("velocity: model}", f"velocity: model, self_collision: {MARGIN}}}"),
        ("duration: 10", "duration: 1.8"),
    ):  # fmt: skip
        assert old in text
        text = text.replace(old, new)
    (tmp_path / "hug.yaml").write_text(text.partition("expect:")[0] + BOUND)
    return build(load(tmp_path / "hug.yaml", list(more)))


@pytest.mark.parametrize("solver", ["daqp", "proxqp"])
def test_a_hand_sent_into_the_body_stops_before_it_and_goes_on_when_its_target_leaves(tmp_path, solver):
    """The distance is the simulator's, between its own shapes."""
    built, seen = hugging(tmp_path, f"solver={solver}"), set()
    finished = run(built, hook=lambda _, out: seen.update(out.active))
    least = finished.summary["metrics"]["self_collision.distance.min"]
    log, tau = finished.log, finished.log["tau"]
    assert finished.ok
    assert MARGIN - SLACK <= least <= MARGIN + SLACK
    assert any(name.startswith("collision[") and "left_wrist_yaw_link" in name for name in seen)
    assert set(finished.summary["status"]) <= {"OK", "LIMITED"}
    away = np.linalg.norm(log["reach.position"] - log["reach.desired"], axis=1)
    assert away[800] > 0.02  # it is kept from there
    assert away[-1] < 2e-3  # it is where it should be, once it may
    steps = np.abs(np.diff(tau, axis=0)).max(axis=1)
    assert steps[50:].max() < 0.5  # [N m] a tick
    assert steps[750:900].max() < 0.05  # pressed against the margin


class TestSpec:
    def test_pairs_are_told_and_those_too_near_at_the_start_are_named(self, tmp_path):
        text = (shipped_folder("tasks") / "g1_stand.yaml").read_text().partition("expect:")[0]
        text = text.replace("velocity: model}", "velocity: model, self_collision: {distance: 0.02, rows: 20}}")
        (tmp_path / "spec.yaml").write_text(text)
        report = check(load(tmp_path / "spec.yaml"))
        assert report.feasible, report.reason
        assert any(note.startswith("self_collision: ") and "left out: " in note for note in report.notes)
        bent = "start: {left_shoulder_roll_joint: -0.05, left_elbow_joint: 0.9}\nreferences:"
        (tmp_path / "spec.yaml").write_text(text.replace("references:", bent))
        report = check(load(tmp_path / "spec.yaml"))
        assert not report.feasible
        assert "too near at the start: " in report.reason
        assert "left_" in report.reason.partition("too near at the start: ")[2]

    @pytest.mark.parametrize(
        ("given", "message"),
        [
            ("-0.1", "limits.self_collision: expected a number greater than 0 [m], got -0.1"),
            ("{deceleration: 1}", "limits.self_collision.distance: is missing"),
            ("{distance: 0.02, row: 3}", "did you mean 'rows'"),
            ("model", "limits.self_collision: expected a number"),
        ],
    )
    def test_faults_are_located(self, tmp_path, given, message):
        text = (shipped_folder("tasks") / "g1_stand.yaml").read_text()
        text = text.replace("velocity: model}", f"velocity: model, self_collision: {given}}}")
        (tmp_path / "spec.yaml").write_text(text)
        with pytest.raises(SpecError, match=re.escape(message)):
            load(tmp_path / "spec.yaml")
