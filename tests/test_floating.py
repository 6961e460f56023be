"""Robots with a floating base against MuJoCo and Pinocchio: conversions, accelerations, wrenches, the optimum."""

from __future__ import annotations

import mujoco
import numpy as np
import pinocchio as pin
import pytest
from oracles import accelerated, constrained, first_tick, unconstrained

from wbc.contact import Settling
from wbc.contact.axes import AxesContact
from wbc.contact.foot import RoundFoot
from wbc.controller import Controller
from wbc.errors import ModelError
from wbc.friction import unilateral
from wbc.ladder import Status
from wbc.reference import Hold
from wbc.robot import Robot
from wbc.surface import Sole
from wbc.task.centroidal import ComTask, WholeBodyPosture, com, mass
from wbc.task.motion import MotionTask
from wbc.wrench import VELOCITY_AXES

DOWN = np.array([0.0, 0.0, -1.0])
FEET = ("FL_foot", "FR_foot", "RL_foot", "RR_foot")
SOLES = ("left_sole", "right_sole")
FREE = {"torque": None, "torque_rate": None, "position": None, "velocity": None}


def contacts_of(robot, bound=True, radius=0.022):
    """Feet of a robot; `bound`: within their cones, and damped."""
    state = robot.state(robot.keyframes["home"], np.zeros(robot.nv))
    made = {}
    for frame in FEET if robot.name == "go2" else SOLES:
        made[frame] = RoundFoot(frame, np.eye(3), radius) if robot.name == "go2" else AxesContact(frame, VELOCITY_AXES)
        if bound:
            sole = robot.name == "g1"
            made[frame].pushes = Sole(DOWN, (0.17, 0.05), 0.6) if sole else unilateral(made[frame], state, DOWN, mu=0.6)
            made[frame].settling = Settling()
    return made


def tasks_of(robot, q):
    state = robot.state(q, np.zeros(robot.nv))
    trunk = "base" if robot.name == "go2" else "pelvis"
    goal = pin.SE3(np.eye(3), com(state)[0] + (0.01, -0.02, 0.015))
    tasks = {
        "balance": ComTask(Hold(goal), 40.0, 12.0),
        "trunk": MotionTask(trunk, Hold(state.frame(trunk).T), 100.0, 20.0, axes=("wx", "wy", "wz")),
    }
    return tasks | ({} if robot.name == "go2" else {"posture": WholeBodyPosture(q, 20.0, 9.0, robot.nu)})


@pytest.fixture(params=["go2", "g1"])
def walker(request):
    return request.getfixturevalue(request.param)


@pytest.fixture
def at_random(rng):
    """at_random(robot, speed) -> q near home, v with components up to `speed`."""

    def one(robot, speed=1.0, size=0.3):
        q = pin.integrate(robot.model, robot.keyframes["home"], rng.uniform(-size, size, robot.nv))
        return q, rng.uniform(-speed, speed, robot.nv)

    return one


def free_controller(robot):
    q = robot.keyframes["home"]
    controller = Controller(robot, contacts_of(robot, bound=False), tasks_of(robot, q), FREE, q=q)
    controller.reset(q, np.zeros(robot.nv))
    return controller


# --- the robot ---


class TestRobot:
    def test_joints_are_those_with_a_motor(self, walker):
        n = {"go2": 12, "g1": 29}[walker.name]
        assert (walker.nu, walker.nv, walker.nq, walker.base) == (n, n + 6, n + 7, 6)
        assert walker.joints == tuple(walker.mujoco.actuator(i).name for i in range(n))
        for limit in (walker.tau_min, walker.tau_max, walker.q_min, walker.q_max, walker.v_max):
            assert limit.shape == (n,)
            assert np.isfinite(limit).all()
        home = walker.keyframes["home"][7:]
        assert (walker.q_min < home).all()
        assert (home < walker.q_max).all()

    def test_home_stands_on_the_plane(self, walker):
        data = mujoco.MjData(walker.mujoco)
        data.qpos[:] = walker.to_mujoco(walker.keyframes["home"], np.zeros(walker.nv))[0]
        mujoco.mj_kinematics(walker.mujoco, data)
        feet = [g for g in range(walker.mujoco.ngeom) if walker.mujoco.geom_contype[g] == 1]
        low = [data.geom_xpos[g][2] - walker.mujoco.geom_size[g, 0] for g in feet]
        assert len(feet) == {"go2": 4, "g1": 8}[walker.name]
        np.testing.assert_allclose(low, 0.0, atol=1e-8)

    def test_feet_touch_the_floor_and_never_one_another(self, walker):
        mj = walker.mujoco
        robot = [g for g in range(mj.ngeom) if mj.geom_contype[g] | mj.geom_conaffinity[g] and mj.geom_bodyid[g]]
        for a in robot:
            for b in robot:
                assert not mj.geom_contype[a] & mj.geom_conaffinity[b]
            assert mj.geom_contype[a] & mj.geom_conaffinity[mj.geom("floor").id]

    @pytest.mark.parametrize(("name", "kg"), [("go2", 16.085), ("g1", 33.341)])
    def test_masses(self, request, name, kg):
        robot = request.getfixturevalue(name)
        state = robot.state(robot.keyframes["home"], np.zeros(robot.nv))
        assert mass(state) == pytest.approx(kg, abs=1e-3)
        assert mass(state) == pytest.approx(robot.mujoco.body_mass.sum(), rel=1e-12)

    def test_no_driver_adds_its_gravity(self):
        with pytest.raises(ModelError, match="floating base; expected 'controller'"):
            Robot.load("go2", gravity="robot")

    def test_a_pinocchio_model_of_ones_own(self):
        robot = Robot.from_pinocchio(pin.buildSampleModelHumanoid())
        assert (robot.base, robot.nu) == (6, robot.nv - 6)
        assert len(robot.q_min) == len(robot.tau_max) == robot.nu
        with pytest.raises(ModelError, match="loaded from a file"):
            robot.to_mujoco(np.zeros(robot.nq), np.zeros(robot.nv))


class TestConversions:
    def test_there_and_back(self, walker, at_random):
        for _ in range(20):
            q, v = at_random(walker, 3.0)
            vdot = v[::-1].copy()
            back = walker.from_mujoco(*walker.to_mujoco(q, v, vdot))
            for got, wanted in zip(back, (q, v, vdot), strict=True):
                np.testing.assert_allclose(got, wanted, atol=1e-13)

    def test_velocity_is_the_change_of_position(self, walker, at_random):
        """One Euler step in MuJoCo is one in Pinocchio."""
        q, v = at_random(walker, 3.0)
        qpos, qvel = walker.to_mujoco(q, v)
        mujoco.mj_integratePos(walker.mujoco, qpos, qvel, 1e-6)
        np.testing.assert_allclose(
            walker.from_mujoco(qpos, qvel)[0], pin.integrate(walker.model, q, 1e-6 * v), atol=1e-11
        )

    def test_acceleration_is_that_of_the_same_torque(self, walker, at_random, rng):
        """MuJoCo's qacc of a torque is Pinocchio's vdot of it, with the term -w x v of the turning base."""
        (mj, data), largest = unconstrained(walker), 0.0
        for _ in range(20):
            (q, v), tau = at_random(walker, 3.0), rng.uniform(-10.0, 10.0, walker.nu)
            data.qpos[:], data.qvel[:] = walker.to_mujoco(q, v)
            data.qfrc_applied[6:] = tau
            mujoco.mj_forward(mj, data)
            vdot = walker.from_mujoco(data.qpos, data.qvel, data.qacc)[2]
            wanted = pin.aba(walker.model, walker.model.createData(), q, v, np.r_[np.zeros(6), tau])
            np.testing.assert_allclose(vdot, wanted, atol=1e-9 * (1.0 + np.abs(wanted).max()))
            np.testing.assert_allclose(walker.to_mujoco(q, v, vdot)[2], data.qacc, atol=1e-9 * np.abs(wanted).max())
            largest = max(largest, np.abs(np.cross(v[3:6], v[:3])).max())
        assert largest > 3.0  # without the term this would be off by as much


# --- the oracle of a tick ---


class TestOracle:
    def test_mujoco_accelerates_as_predicted(self, walker, at_random):
        """Contacts off, the predicted wrenches applied from outside, at random velocities."""
        (mj, data), controller = unconstrained(walker), free_controller(walker)
        for _ in range(20):
            q, v = at_random(walker)
            out, _ = first_tick(controller, q, v)
            assert out.status is Status.OK
            vdot = accelerated(mj, data, controller, out, q, v)
            np.testing.assert_allclose(vdot, out.vdot, atol=1e-9 * (1.0 + np.abs(vdot).max()))

    def test_vdot_and_lambda_are_pinocchios_constrained_dynamics(self, walker, at_random):
        """Of the torque that is sent, Pinocchio's own solver of rigid contacts finds the same."""
        q = walker.keyframes["home"]
        contacts = contacts_of(walker, bound=False, radius=0.0)
        controller = Controller(walker, contacts, tasks_of(walker, q), FREE, q=q)
        kind = pin.ContactType.CONTACT_3D if walker.name == "go2" else pin.ContactType.CONTACT_6D
        dynamics = constrained(walker, kind, {name: contact.frame for name, contact in contacts.items()})
        for _ in range(20):
            q, v = at_random(walker)
            out, _ = first_tick(controller, q, v)
            vdot, wrenches = dynamics(q, v, np.r_[np.zeros(6), out.tau])
            np.testing.assert_allclose(out.vdot, vdot, atol=1e-9 * (1.0 + np.abs(vdot).max()))
            for name, F in wrenches.items():
                size = 1e-9 * (1.0 + np.abs(F).max())
                np.testing.assert_allclose(out.wrenches[name][3:], F[3:], atol=size)
                if walker.name == "g1":
                    np.testing.assert_allclose(out.wrenches[name], F, atol=size)

    def test_the_optimum_is_a_closed_form_of_the_stacked_tasks(self, walker, at_random):
        """No inequality is active: contacts and tasks hold exactly, the posture in their null space, found another way;
        of all wrenches that the motion needs these are the smallest."""
        controller = free_controller(walker)
        for _ in range(10):
            q, v = at_random(walker)
            out, state = first_tick(controller, q, v)
            tasks = controller.phase.tasks
            held = list(state.contacts.values())
            stack = [(h.G, h.rhs) for h in held] + [tasks[name].target(state) for name in ("balance", "trunk")]
            G, b = (np.concatenate(each) for each in zip(*stack, strict=True))
            np.testing.assert_allclose(G @ out.vdot, b, atol=1e-8 * (1.0 + np.abs(b).max()))
            if "posture" in tasks:
                vdot = np.linalg.lstsq(G, b, rcond=None)[0]
                Z = np.linalg.svd(G)[2][len(G) :].T  # motions that all of these leave free
                share = np.r_[np.full(6, 1e-3), np.ones(walker.nu)]
                D = np.sqrt(np.outer(share, share)) * state.M
                # N' D N of the task's own acceleration: only its part within the null space counts, in the metric of M
                wanted = tasks["posture"].acceleration(state)
                inside = Z @ np.linalg.solve(Z.T @ state.M @ Z, Z.T @ state.M @ wanted)
                own = Z @ np.linalg.solve(Z.T @ state.M @ Z, Z.T @ state.M @ vdot)
                z = np.linalg.solve(Z.T @ D @ Z, Z.T @ D @ (inside - own))
                np.testing.assert_allclose(out.vdot, vdot + Z @ z, atol=1e-7 * (1.0 + np.abs(out.vdot).max()))
            P = np.concatenate([h.push[:, :6] for h in held]).T
            w = -(state.M[:6] @ out.vdot + state.bias[:6])
            lam = np.concatenate([h.inverse @ out.wrenches[name] for name, h in state.contacts.items()])
            np.testing.assert_allclose(P @ lam, w, atol=1e-9 * (1.0 + np.abs(w).max()))
            scale = np.concatenate([np.sqrt(h.A**2 @ np.repeat((0.05**2, 1.0), 3)) for h in held])
            smallest = np.linalg.lstsq(P * scale, w, rcond=1e-12)[0] * scale
            np.testing.assert_allclose(lam, smallest, atol=1e-7 * (1.0 + np.abs(lam).max()))
