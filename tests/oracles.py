"""What a tick is held against from outside: MuJoCo's and Pinocchio's own dynamics, and the closed form of the law."""

from __future__ import annotations

import copy
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import mujoco
import numpy as np
import pinocchio as pin

from wbc.controller import Controller
from wbc.ladder import Status
from wbc.memory import Memory, Output
from wbc.oracle import Dynamics, closed_form
from wbc.robot import Robot
from wbc.state import State
from wbc.task.force import ForceLoop
from wbc.wrench import Wrench

Array = np.ndarray


def first_tick(controller: Controller, q: Array, v: Array) -> tuple[Output, State]:
    controller.reset(q, v)
    out = controller.step(0.0, q, v)
    return out, controller.state


# --- MuJoCo ---


def unconstrained(robot: Robot) -> tuple[Any, Any]:
    """The robot in MuJoCo without contacts and joint limits: nothing but its dynamics."""
    mj = copy.copy(robot.mujoco)
    mj.opt.disableflags = int(mj.opt.disableflags) | int(mujoco.mjtDisableBit.mjDSBL_CONSTRAINT)
    return mj, mujoco.MjData(mj)


def accelerated(mj: Any, data: Any, controller: Controller, out: Output, q: Array, v: Array) -> Array:
    """(nv,) vdot by MuJoCo of a floating robot, its contacts off: the torque of a tick, and each of its wrenches from
    outside, on both of the bodies that touch."""
    robot, state = controller.robot, controller.state
    data.qpos[:], data.qvel[:] = robot.to_mujoco(q, v)
    data.qfrc_applied[:] = np.r_[np.zeros(6), out.tau]
    mujoco.mj_kinematics(mj, data)
    mujoco.mj_comPos(mj, data)
    for name, F in out.wrenches.items():
        contact = controller.phase.contacts[name]
        T = state.frame(contact.frame).T
        np.testing.assert_allclose(data.site(contact.frame).xpos, T.translation, atol=1e-12)
        f, m = T.rotation @ F[3:], T.rotation @ F[:3]  # on the environment
        body = int(mj.site(contact.frame).bodyid[0])
        mujoco.mj_applyFT(mj, data, -f, -m, T.translation, body, data.qfrc_applied)
        if contact.against is not None:
            mujoco.mj_applyFT(mj, data, f, m, T.translation, _body(mj, contact.against), data.qfrc_applied)
    mujoco.mj_forward(mj, data)
    return robot.from_mujoco(data.qpos, data.qvel, data.qacc)[2]


def _body(mj: Any, frame: str) -> int:
    site = mujoco.mj_name2id(mj, mujoco.mjtObj.mjOBJ_SITE, frame)
    return mj.body(frame).id if site < 0 else int(mj.site_bodyid[site])


# --- Pinocchio ---


def constrained(
    robot: Robot, kind: pin.ContactType, frames: Mapping[str, str], on: str | None = None, iterations: int = 10
) -> Callable[[Array, Array, Array], tuple[Array, dict[str, Array]]]:
    """(q, v, tau) -> vdot (nv,) and wrenches on the environment (6,) by name, by Pinocchio's solver of rigid contacts.

    `frames` by name are held where they are in the world; or on the body `on`, where they are at home.
    """
    models, datas = pin.StdVec_RigidConstraintModel(), pin.StdVec_RigidConstraintData()
    q = robot.keyframes["home"]
    here = robot.state(q, np.zeros(robot.nv))
    for frame in frames.values():
        one, there = robot.model.frames[robot.frame_id(frame)], ()
        if on is not None:
            other = robot.model.frames[robot.frame_id(on)]
            seen = here.frame(on).T.actInv(here.frame(frame).T)
            there = (other.parentJoint, other.placement * seen)
        local = pin.ReferenceFrame.LOCAL
        models.append(pin.RigidConstraintModel(kind, robot.model, one.parentJoint, one.placement, *there, local))
    for each in models:
        datas.append(each.createData())
    data = robot.model.createData()
    pin.initConstraintDynamics(robot.model, data, models, datas)
    settings = pin.ProximalSettings(1e-14, 1e-14, iterations)

    def dynamics(q: Array, v: Array, tau: Array) -> tuple[Array, dict[str, Array]]:
        vdot = pin.constraintDynamics(robot.model, data, q, v, tau, models, datas, settings)
        forces = [each.contact_force for each in datas]  # on the robot
        wrenches = {name: -np.r_[f.angular, f.linear] for name, f in zip(frames, forces, strict=True)}
        return vdot.copy(), wrenches

    return dynamics


# --- the closed form ---


class Step(NamedTuple):
    """A tick, and what the closed form has for it."""

    out: Output
    tau: Array  # (nu,)
    vdot: Array  # (nv,)
    F: Array  # (6,) wrench on the environment, of lambda alone
    measured: Array  # (6,)


def closed_form_step(
    controller: Controller, frame: str, state: State, rng: np.random.Generator, law: str, contact: str = "board"
) -> Step:
    """A tick at a state with a random measured wrench at a frame, and a random memory of the force loop."""
    held = controller.phases[0].contacts[contact]
    F = np.array([1, 1, 1, 10, 10, 10]) * rng.normal(size=6)
    size = 6 if law == "book" else held.k
    loops = {contact: ForceLoop(F + rng.normal(size=6), 0.1 * rng.normal(size=size))}
    memory = Memory(t=state.t - 0.001, tau=np.zeros(state.robot.nu), q=state.q, v=state.v, loops=loops)
    controller.memory, given = memory, {contact: Wrench(F, frame)}
    out = controller.step(state.t, state.q, state.v, measured=given)
    assert out.status is Status.OK, out.reason

    def dynamics(name: str) -> Dynamics:
        at = state.frame(name)
        return Dynamics(state.M, state.h, at.J, at.drift, at.V, at.T.homogeneous)

    tau, vdot, lam = closed_form(state.robot, controller.phases[0], law, state, dynamics, memory, given)
    return Step(out, tau, vdot, held.hold(state).B.T @ lam[contact], F)
