"""The affine map (vdot, lambda) -> tau against MuJoCo's inverse dynamics, and inertias of row stacks."""

import copy

import mujoco
import numpy as np
import pytest

from wbc import analytic
from wbc.contact.axes import AxesContact
from wbc.contact.sphere import SphereContact
from wbc.dynamics import inertia, mobility, torque_map
from wbc.wrench import Wrench


def test_torque_map_without_contacts_is_mujocos_inverse_dynamics(robot, rng):
    mj = copy.copy(robot.mujoco)
    mj.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONSTRAINT
    data = mujoco.MjData(mj)
    for _ in range(10):
        data.qpos[:], data.qvel[:], data.qacc[:] = (rng.uniform(-1, 1, mj.nv) for _ in range(3))
        mujoco.mj_inverse(mj, data)
        found = torque_map(robot.state(data.qpos.copy(), data.qvel.copy()))
        np.testing.assert_allclose(found.A["vdot"] @ data.qacc + found.b, data.qfrc_inverse, atol=1e-10)


def test_torque_map_carries_the_contacts_wrenches(panda, draw, rng):
    """tau = M vdot + h + sum J' A' lambda, and MuJoCo, pushed back by those wrenches, accelerates by vdot."""
    contacts = {"board": AxesContact("eraser", ("wx", "wy", "vz")), "ball": SphereContact("link4", np.zeros(3))}
    state, vdot = draw(panda), rng.normal(size=7)
    state.contacts = {name: contact.hold(state) for name, contact in contacts.items()}
    lam = {"board": rng.normal(size=3), "ball": rng.normal(size=1)}
    found = torque_map(state)
    tau = found.A["vdot"] @ vdot + found.b + sum(found.A[name] @ lam[name] for name in lam)
    by_hand = state.h + state.M @ vdot
    mj, data = panda.mujoco, mujoco.MjData(panda.mujoco)
    data.qpos[:], data.qvel[:] = state.q, state.v
    mujoco.mj_forward(mj, data)
    for name, contact in contacts.items():
        J, A = state.frame(contact.frame).J, contact.A(state)
        by_hand = by_hand + analytic.inverse_dynamics(0 * state.M, 0 * state.h, vdot, J, A, lam[name])
        body = mj.body("eraser_body" if name == "board" else "link4").id
        # what the environment does to the robot, about the body's centre of mass, in world axes
        T = state.frame(contact.frame).T
        F = Wrench.on_environment(f=(A.T @ lam[name])[3:], m=(A.T @ lam[name])[:3], frame=contact.frame).F
        f = -T.rotation @ F[3:]
        m = -T.rotation @ F[:3] + np.cross(T.translation - data.xipos[body], f)
        data.xfrc_applied[body] = np.r_[f, m]
    np.testing.assert_allclose(tau, by_hand, atol=1e-12)
    data.qfrc_applied[:] = tau
    mujoco.mj_forward(mj, data)
    assert data.ncon == 0
    np.testing.assert_allclose(data.qacc, vdot, atol=1e-8)


def test_torque_rows_bound_the_torque(planar3r, draw, rng):
    state = draw(planar3r)
    low, high, vdot = np.full(3, -2.0), np.full(3, 5.0), rng.normal(size=3)
    found = torque_map(state)
    rows = found.rows(low, high, ("torque[a]", "torque[b]", "torque[c]"))
    tau = state.M @ vdot + state.h
    np.testing.assert_allclose(rows.A["vdot"] @ vdot - rows.lo, tau - low, atol=1e-13)
    np.testing.assert_allclose(rows.hi - rows.A["vdot"] @ vdot, high - tau, atol=1e-13)
    assert rows.name == "torque"
    assert rows.labels == ("torque[a]", "torque[b]", "torque[c]")


def test_mobility_and_inertia_of_a_frame(panda, draw):
    state = draw(panda)
    J = state.frame("eraser").J
    np.testing.assert_allclose(mobility(state, J), J @ np.linalg.inv(state.M) @ J.T, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(inertia(mobility(state, J)), analytic.task_inertia(state.M, J), rtol=1e-8, atol=1e-10)


def test_inertia_of_no_rows_is_empty():
    assert inertia(np.zeros((0, 0))).shape == (0, 0)


@pytest.mark.parametrize("repeated", [1, 2, 4])
def test_inertia_of_dependent_rows_is_the_pseudo_inverse(repeated, rng):
    """Redundant contacts and singular poses: directions that cannot move weigh nothing."""
    G = rng.normal(size=(4, 7))
    G = np.r_[G, rng.normal(size=(repeated, 4)) @ G]
    K = G @ G.T
    W = inertia(K)
    np.testing.assert_allclose(W, np.linalg.pinv(K, rcond=1e-10), atol=1e-8)
    np.testing.assert_allclose(W, W.T, atol=1e-12)


def test_inertia_is_symmetric_and_positive(panda, draw):
    W = inertia(mobility(state := draw(panda), state.frame("eraser").J))
    np.testing.assert_allclose(W, W.T, rtol=1e-9, atol=1e-12)
    assert np.linalg.eigvalsh(W).min() > 0
