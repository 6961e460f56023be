"""Momentum, relative pose, gaze and least torque: rows against finite differences, quantities against MuJoCo's, and
closed loops that follow their targets."""

from __future__ import annotations

import math

import mujoco
import numpy as np
import pinocchio as pin
import pytest
from test_floating import contacts_of

from wbc.axes import MOMENTUM_AXES
from wbc.contact.axes import AxesContact
from wbc.controller import Controller
from wbc.errors import GainError, NameNotFound
from wbc.ladder import Status
from wbc.pair import RelativeFrame, relative_axes
from wbc.reference import Hold, Path, sine
from wbc.task.centroidal import ComTask, MomentumTask, WholeBodyPosture, com, mass, momentum
from wbc.task.effort import TorqueTask
from wbc.task.motion import MotionTask
from wbc.task.posture import PostureTask
from wbc.task.relative import BEHIND, GazeTask, RelativeTask, _stretch
from wbc.testing import check_task
from wbc.wrench import VELOCITY_AXES

TILTED = pin.SE3(pin.exp3(np.array([0.2, -0.3, 0.5])), np.array([0.1, -0.2, 0.3]))
FREE = {"torque": None, "torque_rate": None, "position": None, "velocity": None}
MOVING = Path(TILTED, {i: sine(0.1 + 0.05 * i, 1.0 + 0.3 * i, 0.4 * i) for i in range(6)})
# robots with two frames of theirs
PAIRS = {"g1": ("left_palm", "right_palm"), "go2": ("FL_foot", "RR_foot"), "ur5e": ("flange", "upper_arm_link")}


@pytest.fixture(params=PAIRS)
def pair(request):
    return request.getfixturevalue(request.param), *PAIRS[request.param]


def driven(robot, tasks, seconds, contacts=None, q=None, dt=1e-3, levels=None):
    """The state after a tick's answer has been integrated for so long, as a robot without any error would move."""
    q, v = robot.keyframes["home"] if q is None else q, np.zeros(robot.nv)
    controller = Controller(robot, contacts, tasks, FREE, q=q, hierarchy="strict" if levels else "weighted")
    controller.reset(q, v)
    for tick in range(round(seconds / dt)):
        out = controller.step(tick * dt, q, v)
        assert out.status is Status.OK, out.reason
        q = pin.integrate(robot.model, q, dt * v + 0.5 * dt * dt * out.vdot)
        v = v + dt * out.vdot
    return robot.state(q, v, t=seconds), out


# --- momentum ---


class TestMomentum:
    @pytest.mark.parametrize("name", ["go2", "g1", "panda"])
    def test_by_finite_differences(self, request, name):
        robot = request.getfixturevalue(name)
        check_task(MomentumTask(5.0), robot, states=5)
        check_task(MomentumTask([5.0, 3.0], axes=("kz", "lx")), robot, states=5)

    @pytest.mark.parametrize("name", ["go2", "panda"])
    def test_it_is_mujocos(self, request, draw, name):
        robot = request.getfixturevalue(name)
        state, data = draw(robot), mujoco.MjData(robot.mujoco)
        data.qpos[:], data.qvel[:] = robot.to_mujoco(state.q, state.v)
        mujoco.mj_forward(robot.mujoco, data)
        mujoco.mj_subtreeVel(robot.mujoco, data)
        h, A, _ = momentum(state)
        root = 1 if robot.base else 0
        np.testing.assert_allclose(A @ state.v, h, atol=1e-12)
        if robot.base:
            np.testing.assert_allclose(h[:3], data.subtree_angmom[root], atol=1e-11)
        np.testing.assert_allclose(h[3:], _mass(robot) * data.subtree_linvel[root], atol=1e-10)

    def test_its_change_is_what_pushes_from_outside(self, g1, draw, rng):
        """Newton and Euler: whatever the joints do, in the air only the weight changes the momentum."""
        state = draw(g1)
        tau = np.r_[np.zeros(6), rng.uniform(-20, 20, g1.nu)]
        vdot = np.linalg.solve(state.M, tau - state.h)
        _, A, drift = momentum(state)
        change = A @ vdot + drift
        np.testing.assert_allclose(change[:3], 0.0, atol=1e-8)
        np.testing.assert_allclose(change[3:], mass(state) * g1.model.gravity.linear, atol=1e-8)

    def test_the_linear_part_is_the_centre_of_mass(self, g1, draw):
        state = draw(g1)
        _, J, drift = com(state)
        _, A, ours = momentum(state)
        np.testing.assert_allclose(A[3:], mass(state) * J, atol=1e-9)
        np.testing.assert_allclose(ours[3:], mass(state) * drift, atol=1e-9)

    def test_it_follows_its_target(self, g1):
        """A humanoid on its soles turns its body so that the angular momentum about z is a sine."""

        def desired(t):
            w = 2.0 * math.pi
            h, hdot = np.zeros(6), np.zeros(6)
            h[2], hdot[2] = 0.2 * math.sin(w * t), 0.2 * w * math.cos(w * t)
            return h, hdot

        q = g1.keyframes["home"]
        tasks = {
            "balance": ComTask(Hold(pin.SE3(np.eye(3), com(g1.state(q, np.zeros(g1.nv)))[0].copy()))),
            "spin": MomentumTask(20.0, ("kz",), desired),
            "posture": (WholeBodyPosture(q, 20.0, 9.0, g1.nu), 1.0),
        }
        state, _ = driven(g1, tasks, 0.3, contacts_of(g1, bound=False))
        assert momentum(state)[0][2] == pytest.approx(0.2 * math.sin(0.6 * math.pi), abs=2e-3)

    def test_angular_momentum_dies_out(self, go2):
        """By its law, h(t) = h(0) exp(-kp t), whatever else moves."""
        robot, kp, dt = go2, 8.0, 1e-3
        q, v = robot.keyframes["home"], np.random.default_rng(3).uniform(-0.5, 0.5, robot.nv)
        controller = Controller(robot, {}, {"calm": MomentumTask(kp, ("kx", "ky", "kz"))}, FREE, q=q)
        controller.reset(q, v)
        state = robot.state(q, v)
        assert np.abs(momentum(state)[0][:3]).max() > 0.1
        out = controller.step(0.0, q, v)
        # in the air no torque changes it: the task asks for what its six equations refuse, and nothing breaks
        assert out.status is Status.OK
        assert np.abs(momentum(state)[1][:3] @ out.vdot + momentum(state)[2][:3]).max() < 1e-7
        contacts = contacts_of(robot, bound=False)
        v = np.linalg.lstsq(np.eye(robot.nv), v, rcond=None)[0]
        G = np.concatenate([c.A(state) @ state.frame(c.frame).J for c in contacts.values()])
        v -= np.linalg.pinv(G) @ G @ v
        controller = Controller(robot, contacts, {"calm": MomentumTask(kp, ("kx", "ky", "kz"))}, FREE, q=q)
        controller.reset(q, v)
        before = momentum(robot.state(q, v))[0][:3].copy()
        for tick in range(200):
            out = controller.step(tick * dt, q, v)
            q, v = pin.integrate(robot.model, q, dt * v + 0.5 * dt * dt * out.vdot), v + dt * out.vdot
        after = momentum(robot.state(q, v))[0][:3]
        np.testing.assert_allclose(after, before * math.exp(-kp * 0.2), atol=0.01 * np.abs(before).max())

    def test_axes_have_names(self):
        assert MOMENTUM_AXES == ("kx", "ky", "kz", "lx", "ly", "lz")
        with pytest.raises(GainError, match="kp"):
            MomentumTask([1.0, 2.0], ("kx",))


def _mass(robot):
    return float(robot.mujoco.body_mass.sum())


# --- the base ---


class TestBase:
    """A motion task of the base frame is its pose, its orientation, its position."""

    @pytest.mark.parametrize("axes", [VELOCITY_AXES, ("wx", "wy", "wz"), ("vx", "vy", "vz")])
    def test_by_finite_differences(self, go2, axes):
        check_task(MotionTask("base", MOVING, axes=axes), go2, contacts_of(go2, bound=False), states=3)

    @pytest.mark.parametrize(("axes", "error"), [(VELOCITY_AXES, "log"), (("wx", "wy", "wz"), "log"),
                                                 (("vx", "vy", "vz"), "split")])  # fmt: skip
    def test_it_follows_its_target(self, go2, axes, error):
        start = go2.state(go2.keyframes["home"], np.zeros(18))
        path = Path(start.frame("base").T, {0: sine(0.1, 1.0, ease=0.3), 2: sine(0.1, 1.0, ease=0.3),
                                            3: sine(0.02, 1.0, ease=0.3), 5: sine(0.02, 0.8, ease=0.3)})  # fmt: skip
        task = MotionTask("base", path, axes=axes, error=error)
        posture = WholeBodyPosture(start.q, 20.0, 9.0, 12)
        state, _ = driven(go2, {"base": task, "posture": posture}, 0.35, contacts_of(go2, bound=False))
        T, goal = state.frame("base").T, path(0.35).T
        if "wx" in axes:
            assert np.linalg.norm(pin.log3(T.rotation.T @ goal.rotation)) < 3e-4  # of 0.13
        if "vx" in axes:
            np.testing.assert_allclose(T.translation, goal.translation, atol=1e-4)
        assert np.linalg.norm(goal.translation - start.frame("base").p) > 5e-3


# --- relative ---


class TestRelative:
    def test_by_finite_differences(self, pair):
        robot, frame, to = pair
        check_task(RelativeTask(frame, to, MOVING), robot, states=5)
        check_task(RelativeTask(frame, to, MOVING, axes=("wz", "vx")), robot, states=5)
        check_task(RelativeTask(frame, to, MOVING, error="split"), robot, states=2, drift=False)

    def test_its_frame_by_finite_differences(self, pair, draw):
        """Pose, twist and drift of one frame against the other, along an integrated motion."""
        robot, name, to = pair
        h = 1e-6
        state = draw(robot)
        seen = RelativeFrame(state.frame(name), state.frame(to))
        T = state.frame(to).T.actInv(state.frame(name).T)
        assert (seen.T.actInv(T)).isIdentity(1e-12)
        np.testing.assert_allclose(seen.V, seen.J @ state.v, atol=1e-12)
        ends = []
        for s in (h, -h):
            moved = robot.state(pin.integrate(robot.model, state.q, s * state.v), state.v)
            ends.append(RelativeFrame(moved.frame(name), moved.frame(to)))
        twist = pin.log6(ends[1].T.actInv(ends[0].T)).vector[[3, 4, 5, 0, 1, 2]] / (2 * h)
        np.testing.assert_allclose(seen.V, twist, atol=1e-7)
        np.testing.assert_allclose(seen.drift, (ends[0].V - ends[1].V) / (2 * h), atol=1e-6)

    def test_against_a_fixed_frame_it_is_a_motion_task(self, panda, draw):
        """Of the same reference, moved into the axes of that frame."""
        state = draw(panda, t=0.3)
        place = panda.fixed_pose("board")
        world = Path(place * TILTED, MOVING.along)
        ours, theirs = RelativeTask("eraser", "board", MOVING), MotionTask("eraser", world)
        for one, other in zip(ours.target(state), theirs.target(state), strict=True):
            np.testing.assert_allclose(one, other, atol=1e-9)

    def test_two_palms_follow_while_the_robot_walks_by(self, g1):
        """Closed loop on two soles: the palm moves against the other one, and stays on its path."""
        q = g1.keyframes["home"]
        start = g1.state(q, np.zeros(g1.nv))
        here = start.frame("right_palm").T.actInv(start.frame("left_palm").T)
        path = Path(here, {3: sine(0.02, 1.0, ease=0.3), 5: sine(0.01, 0.7, ease=0.3)})
        tasks = {
            "balance": ComTask(Hold(pin.SE3(np.eye(3), com(start)[0].copy()))),
            "sway": MotionTask("right_palm", Path(start.frame("right_palm").T, {4: sine(0.02, 1.0, ease=0.3)})),
            "carry": RelativeTask("left_palm", "right_palm", path),
            "posture": WholeBodyPosture(q, 20.0, 9.0, g1.nu),
        }
        state, _ = driven(g1, tasks, 0.4, contacts_of(g1, bound=False))
        assert np.abs(tasks["carry"].error(state)).max() < 1e-4
        assert np.linalg.norm(state.frame("right_palm").p - start.frame("right_palm").p) > 5e-3

    def test_on_an_arm(self, bare_panda):
        start = bare_panda.state(bare_panda.keyframes["home"], np.zeros(7))
        here = start.frame("link1").T.actInv(start.frame("flange").T)
        task = RelativeTask("flange", "link1", Path(here, {3: sine(0.03, 1.0, ease=0.3)}))
        state, _ = driven(bare_panda, {"fold": task, "posture": PostureTask(start.q)}, 0.4)
        assert np.abs(task.error(state)).max() < 1e-4
        assert np.abs(state.frame("flange").p - start.frame("flange").p).max() > 5e-3

    def test_axes_that_a_pair_can_move_along(self, planar3r, panda):
        assert relative_axes(planar3r, "flange", planar3r.model.frames[2].name) == ("wy", "vx", "vz")
        assert relative_axes(panda, "eraser", "flange") == ()

    def test_frames_have_names(self, ur5e):
        with pytest.raises(NameNotFound, match="flnge"):
            Controller(ur5e, tasks={"fold": RelativeTask("flange", "flnge", MOVING)})


# --- gaze ---


class TestGaze:
    def test_by_finite_differences(self, pair):
        robot, frame, to = pair
        check_task(GazeTask(frame, (0.0, 0.0, 1.0), to), robot, states=8)
        check_task(GazeTask(frame, (1.0, -2.0, 0.5), (0.7, -0.2, 0.9)), robot, states=8)

    def test_the_stretch_by_finite_differences(self):
        h = 1e-5
        for c in (0.99995, 0.9998, 0.9, 0.3, 0.0, -0.5, -0.99):
            (low, *_), (f, f1, f2), (high, *_) = (_stretch(c + s) for s in (-h, 0.0, h))
            assert f == pytest.approx(math.acos(c) / math.sin(math.acos(c)), rel=1e-9)
            assert f1 == pytest.approx((high - low) / (2 * h), rel=1e-5)
            assert f2 == pytest.approx((_stretch(c + h)[1] - _stretch(c - h)[1]) / (2 * h), rel=1e-4)
        assert _stretch(1.0)[0] == 1.0
        assert _stretch(-1.0) == _stretch(BEHIND - 1e-6)

    def test_it_turns_by_the_angle_that_is_missing(self, ur5e):
        """From rest without damping the direction comes closer by kp times the angle, however large it is."""
        state = ur5e.state(ur5e.keyframes["home"], np.zeros(6))
        T = state.frame("flange").T
        for angle in (0.2, 1.5, 2.9):
            at = T.act(pin.exp3(np.array([angle, 0.0, 0.0])) @ np.array([0.0, 0.0, 0.5]))
            task = GazeTask("flange", (0, 0, 1), at, 10.0)
            assert task.angle(state) == pytest.approx(angle, abs=1e-9)
            assert np.linalg.norm(task.target(state)[1]) == pytest.approx(10.0 * angle, rel=1e-9)

    @pytest.mark.parametrize("at", [(0.4, 0.5, 0.9), (0.5, -0.3, 0.2)])
    def test_an_arm_looks_at_a_point(self, ur5e, at):
        task = GazeTask("flange", (0, 0, 1), at, 100.0, 20.0)
        before = task.angle(ur5e.state(ur5e.keyframes["home"], np.zeros(6)))
        state, _ = driven(ur5e, {"look": task, "posture": PostureTask(ur5e.keyframes["home"])}, 1.0)
        assert before > 0.3
        assert task.angle(state) == pytest.approx(before * 11.0 * math.exp(-10.0), abs=2e-4)  # critically damped

    def test_a_humanoid_looks_at_its_moving_hand(self, g1):
        q = g1.keyframes["home"]
        start = g1.state(q, np.zeros(g1.nv))
        task = GazeTask("torso_link", (1, 0, 0), "left_palm", 400.0, 40.0)
        wave = Path(start.frame("left_palm").T, {5: sine(0.05, 1.0, ease=0.2)})
        tasks = {
            "balance": ComTask(Hold(pin.SE3(np.eye(3), com(start)[0].copy()))),
            "wave": MotionTask("left_palm", wave, axes=("vx", "vy", "vz")),
            "look": task,
            "posture": WholeBodyPosture(q, 20.0, 9.0, g1.nu),
        }
        state, _ = driven(g1, tasks, 0.8, contacts_of(g1, bound=False))
        assert task.angle(start) > 0.3
        assert task.angle(state) < 1e-3

    def test_what_contacts_hold_weighs_nothing(self, ur5e):
        """A held frame cannot look elsewhere: the task yields without a weight, and the torque stays finite."""
        contacts = {"wall": AxesContact("flange", VELOCITY_AXES)}
        q = ur5e.keyframes["home"]
        controller = Controller(ur5e, contacts, {"look": GazeTask("flange", (0, 0, 1), (1.0, 1.0, 1.0))}, q=q)
        out = controller.step(0.0, q, np.zeros(6))
        assert out.status in (Status.OK, Status.LIMITED), out.reason
        assert np.abs(out.vdot).max() < 1e-6

    def test_an_axis_is_a_direction(self):
        with pytest.raises(GainError, match="expected a direction"):
            GazeTask("flange", (0, 0, 0), (1, 0, 0))


# --- torque ---


class TestTorque:
    def test_its_rows_are_the_torque(self, g1, draw, rng):
        contacts = contacts_of(g1, bound=False)
        check_task(TorqueTask(), g1, contacts, states=3)
        state = draw(g1)
        state.contacts = {name: contact.hold(state) for name, contact in contacts.items()}
        rows = TorqueTask().rows(state)
        vdot, lam = rng.normal(size=g1.nv), {name: rng.normal(size=6) for name in contacts}
        tau = rows.A["vdot"] @ vdot + sum(rows.A[name] @ value for name, value in lam.items()) - rows.lo
        F = {name: state.contacts[name].A.T @ value for name, value in lam.items()}
        acting = pin.StdVec_Force([pin.Force.Zero() for _ in range(g1.model.njoints)])
        for name, value in F.items():  # on the robot, in the axes of its joint
            frame = g1.model.frames[g1.frame_id(contacts[name].frame)]
            acting[frame.parentJoint] += frame.placement.act(pin.Force(-value[3:], -value[:3]))
        oracle = pin.rnea(g1.model, g1.model.createData(), state.q, state.v, vdot, acting)
        np.testing.assert_allclose(tau, oracle[6:], atol=1e-9)

    def test_of_an_arm_it_is_a_share_of_the_posture(self, ur5e, draw):
        """vdot = (vdot_p - w M^-1 h) / (1 + w): a share w / (1 + w) of the torque is let go."""
        state, w = draw(ur5e), 0.01
        posture = PostureTask(ur5e.keyframes["home"], 50.0, 10.0)
        controller = Controller(ur5e, tasks={"posture": posture, "ease": (TorqueTask(), w)}, limits=FREE)
        controller.reset(state.q, state.v)
        out = controller.step(0.0, state.q, state.v)
        wanted = state.M @ posture.acceleration(state) + state.h
        np.testing.assert_allclose(out.tau, wanted / (1.0 + w), rtol=1e-7, atol=1e-7)

    def test_strict_below_it_moves_nothing_above(self, ur5e, draw):
        """Of all motions that keep the flange on its path, that of the least torque: a null space found another way."""
        state = draw(ur5e)
        task = MotionTask("flange", Hold(state.frame("flange").T), axes=("vx", "vy", "vz"))
        tasks = {"reach": (task, 1.0, 1), "ease": (TorqueTask(), 1.0, 2)}
        controller = Controller(ur5e, tasks=tasks, limits=FREE, hierarchy="strict")
        controller.reset(state.q, state.v)
        out = controller.step(0.0, state.q, state.v)
        G, b = task.target(state)
        np.testing.assert_allclose(G @ out.vdot, b, atol=1e-7 * (1.0 + np.abs(b).max()))
        tau = out.tau
        Z = np.linalg.svd(G)[2][3:].T
        # the gradient of tau' M^-1 tau along the motions that are free
        np.testing.assert_allclose(Z.T @ tau, 0.0, atol=1e-6 * (1.0 + np.abs(tau).max()))

    def test_a_humanoid_takes_less_of_it(self, g1):
        """On two soles the internal forces are free: with the task the torque is smaller, and the motion the same."""
        q, size, slope, moved = g1.keyframes["home"], [], [], []
        start = g1.state(q, np.zeros(g1.nv))
        tasks = {
            "balance": (ComTask(Hold(pin.SE3(np.eye(3), com(start)[0].copy()))), 1.0, 1),
            "posture": (WholeBodyPosture(q, 20.0, 9.0, g1.nu), 1.0, 2),
        }
        for more in ({}, {"ease": (TorqueTask(), 1.0, 3)}):
            controller = Controller(g1, contacts_of(g1, bound=False), tasks | more, FREE, q=q, hierarchy="strict")
            controller.reset(q, np.zeros(g1.nv))
            out = controller.step(0.0, q, np.zeros(g1.nv))
            assert out.status is Status.OK, out.reason
            push = np.concatenate([held.push for held in controller.state.contacts.values()]).T
            inside = np.linalg.svd(push[:6])[2][6:].T  # forces of the feet against one another
            cost = np.linalg.solve(start.M[6:, 6:], out.tau)
            size.append(out.tau @ cost)
            slope.append(np.abs(inside.T @ push[6:].T @ cost).max())
            moved.append(out.vdot)
        np.testing.assert_allclose(moved[1], moved[0], atol=1e-6)
        assert size[1] < size[0]
        assert slope[0] > 1.0
        assert slope[1] < 1e-5
