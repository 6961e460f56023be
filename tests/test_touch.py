"""The true contacts of a tick, read in one pass, against MuJoCo's own functions contact by contact."""

from __future__ import annotations

import mujoco
import numpy as np
import pinocchio as pin
import pytest

from wbc import convention, kernels
from wbc.coordinates import Coordinates
from wbc.robot import Robot
from wbc.sim import Simulator

FRAMES = ("FL_foot", "RR_foot", "base")


@pytest.fixture
def sliding(go2: Robot, rng) -> Simulator:
    """A robot that has come down on its feet, thrown sideways and turning."""
    home = go2.keyframes["home"].copy()
    home[3:7] = pin.Quaternion(pin.exp3(np.array([0.02, -0.03, 0.7]))).coeffs()
    simulator = Simulator(go2, home, 1e-3)
    for tick in range(150):
        if tick == 140:
            simulator.data.qvel[:] += rng.normal(size=go2.nv) * 0.3
        seen = simulator.observe()
        simulator.apply((20.0 * (home[7:] - seen.q[7:]) - 1.0 * seen.v[6:]) + go2.state(seen.q, seen.v).gravity()[6:])
    assert any(simulator.true_touch(frame).points for frame in FRAMES[:2])
    return simulator


def one_by_one(simulator: Simulator, frame: str) -> tuple[np.ndarray, np.ndarray, int]:
    """Wrench, slips by geom, and number of points of a frame's body."""
    model, data, rigid = simulator.model, simulator.data, simulator.model.body_weldid
    site = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_SITE, frame)
    body = model.site_bodyid[site] if site >= 0 else model.body(frame).id
    p = data.site_xpos[site] if site >= 0 else data.xpos[body]
    R = (data.site_xmat[site] if site >= 0 else data.xmat[body]).reshape(3, 3)
    own = [g for g in range(model.ngeom) if rigid[model.geom_bodyid[g]] == rigid[body]]
    own = [g for g in own if model.geom_contype[g] or model.geom_conaffinity[g]]
    F, slips, points = np.zeros(6), np.zeros((len(own), 3)), 0
    for i in range(data.ncon):
        contact, force = data.contact[i], np.zeros(6)
        if (contact.geom[0] in own) == (contact.geom[1] in own):
            continue
        mujoco.mj_contactForce(model, data, i, force)
        sign = 1.0 if contact.geom[0] in own else -1.0
        axes = contact.frame.reshape(3, 3)
        f, m = sign * axes.T @ force[:3], sign * axes.T @ force[3:]
        F += np.r_[R.T @ (m + np.cross(contact.pos - p, f)), R.T @ f]
        if force[0] > 0:
            points, v = points + 1, []
            for geom in contact.geom:
                J = np.zeros((3, model.nv))
                mujoco.mj_jac(model, data, J, None, contact.pos, model.geom_bodyid[geom])
                v.append(J @ data.qvel)
            moved = sign * (v[0] - v[1])
            mine = contact.geom[0] if sign > 0 else contact.geom[1]
            slips[own.index(mine)] = moved - axes[0] * (axes[0] @ moved)
    return F, slips, points


@pytest.mark.parametrize("frame", FRAMES)
def test_wrench_slip_and_points_are_those_of_the_contacts_one_by_one(sliding, frame):
    F, slips, points = one_by_one(sliding, frame)
    touch = sliding.true_touch(frame)
    np.testing.assert_allclose(touch.F, F, atol=1e-10 * (1.0 + np.abs(F).max()))
    np.testing.assert_allclose(sliding.true_slip(frame), slips, atol=1e-12)
    assert touch.points == points
    if points:
        assert np.abs(slips).max() > 1e-3  # it does slide
        assert touch.mu == pytest.approx(sliding.data.contact.friction[0, 0])
    else:
        assert touch.mu == 0.0


def test_a_tick_later_they_are_told_anew(sliding):
    before = [sliding.true_touch(frame).F for frame in FRAMES[:2]], [sliding.true_slip(frame) for frame in FRAMES[:2]]
    sliding.observe()
    sliding.true_slip(FRAMES[0])
    sliding.apply(np.zeros(sliding.robot.nu))
    for frame, F, slips in zip(FRAMES[:2], *before, strict=True):
        now, moved, points = one_by_one(sliding, frame)
        np.testing.assert_allclose(sliding.true_touch(frame).F, now, atol=1e-10 * (1.0 + np.abs(now).max()))
        np.testing.assert_allclose(sliding.true_slip(frame), moved, atol=1e-12)
        if points:
            assert np.abs(now - F).max() > 1e-3
            assert np.abs(moved - slips).max() > 1e-6


def test_the_mass_is_where_mujoco_has_it(sliding):
    own = sliding.model.body("base").id
    np.testing.assert_allclose(sliding.true_com(), sliding.data.subtree_com[own], atol=1e-12)


@pytest.mark.parametrize("name", ["go2", "panda"])
def test_coordinates_are_read_as_the_model_converts_them(go2, name, rng):
    robot = go2 if name == "go2" else Robot.load("panda", scene="board")
    mj, data, coordinates = robot.mujoco, mujoco.MjData(robot.plant or robot.mujoco), Coordinates(robot)
    for _ in range(5):
        q = pin.integrate(robot.model, robot.keyframes["home"], rng.normal(size=robot.nv))
        coordinates.write(data, q)
        data.qvel[coordinates.qvel] = rng.normal(size=robot.nv)
        wanted = convention.to_pinocchio(mj, data.qpos[coordinates.qpos], data.qvel[coordinates.qvel])
        found = coordinates.read(data)
        np.testing.assert_allclose(found[0], wanted[0], atol=1e-15)
        np.testing.assert_allclose(found[1], wanted[1], atol=1e-14)
        np.testing.assert_allclose(found[0], q, atol=1e-12)


def test_the_angle_between_vectors(rng):
    for angle in (0.0, 1e-9, 0.3, np.pi / 2, 3.1, np.pi):
        R = pin.exp3(rng.normal(size=3))
        a, b = R @ [2.0, 0, 0], R @ [np.cos(angle), np.sin(angle), 0]
        assert kernels.angle(a, b) == pytest.approx(angle, abs=1e-14)
