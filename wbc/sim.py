"""The only place that steps MuJoCo: the plant with its honest errors, true contact wrenches, noisy measurements."""

from __future__ import annotations

from collections import deque
from typing import Any, NamedTuple

import mujoco
import numpy as np
import pinocchio as pin

from . import material
from .errors import ModelError, SimulationError
from .model import quietly, to_pinocchio
from .qp import Array
from .robot import Robot, State
from .wrench import ForceSensor, Wrench

SENSORS = ("wrist_torque", "wrist_force")


class Observation(NamedTuple):
    """What the controller is shown at one tick."""

    t: float
    q: Array
    v: Array


class Impact(NamedTuple):
    """A point that touches: MuJoCo's contact is a_n = -b v_n - k r wherever the force, less a_n R f, allows it."""

    normal: Array  # (3,) world, from the robot into its environment
    stiffness: float  # k [1/s^2]
    damping: float  # b [1/s]
    regularisation: float  # R [1/kg]


class Touch(NamedTuple):
    """What a body of the robot applied to its environment in a tick."""

    F: Array  # (6,) in the axes of the frame asked for
    points: int  # points of contact with a force along their normal
    mu: float  # their coefficient of friction, 0 without


class Simulator:
    """A robot's compiled model as a plant, one control tick a step.

    Parameters: the robot (it is not changed), the start `q`, the control period `dt` [s], `plant`: what only the
    simulator knows (payload [kg], mass_error, joint_friction [N m], contact_friction, armature [kg m^2], delay [ticks],
    noise), and the seed of the noise.
    """

    def __init__(self, robot: Robot, q: Array, dt: float, plant: Any = None, seed: int = 0) -> None:
        if robot.mujoco is None:
            raise ModelError("only a robot that was loaded from a file can be simulated")
        self.robot, self.dt = robot, dt
        self.model: mujoco.MjModel = _changed(robot, plant)
        self.substeps = max(1, round(dt / self.model.opt.timestep))
        self.model.opt.timestep = dt / self.substeps
        self.data = mujoco.MjData(self.model)
        self.data.qpos[:] = to_mujoco(self.model, q)
        self._noise = plant.noise if plant is not None else None
        self._rng = np.random.default_rng(seed)
        self._delayed: deque[Array] = deque(maxlen=(plant.delay if plant is not None else 0) + 1)
        self._sensor = ForceSensor(robot) if all(_has_sensor(self.model, name) for name in SENSORS) else None
        self._gear = _actuators(self.model)
        self._driver = robot.model.createData()

    def observe(self) -> Observation:
        """Kinematics at the present state, as the encoders see it."""
        mujoco.mj_step1(self.model, self.data)
        q, v = to_pinocchio(self.model, self.data.qpos, self.data.qvel)
        if self._noise is not None and (self._noise.position or self._noise.velocity):
            q = q + self._rng.normal(0.0, 1.0, q.size) * self._noise.position
            v = v + self._rng.normal(0.0, 1.0, v.size) * self._noise.velocity
        return Observation(self.data.time, q, v)

    def apply(self, tau: Array) -> None:
        """Send a torque (nv,) [N m], after the plant's delay, and go on to the next tick.

        A robot whose driver adds gravity does so here, from its nominal model.
        """
        if self.robot.gravity == "robot":
            q, _ = to_pinocchio(self.model, self.data.qpos, self.data.qvel)
            tau = tau + pin.computeGeneralizedGravity(self.robot.model, self._driver, q)
        self._delayed.append(tau)
        for step in range(self.substeps):
            if step:
                mujoco.mj_step1(self.model, self.data)
            self.data.ctrl[:] = self._delayed[0][self._gear[0]] / self._gear[1]
            mujoco.mj_step2(self.model, self.data)
        grown = [w for w in range(len(self.data.warning)) if self.data.warning[w].number]
        if grown or not np.isfinite(self.data.qacc).all():
            why = self._warning(grown[0]) if grown else "an acceleration that is not finite"
            raise SimulationError(f"the simulation broke down at t = {self.data.time:.3f} s ({why})", self.data.time)

    def _warning(self, kind: int) -> str:
        text = mujoco.mju_warningText(kind, self.data.warning[kind].lastinfo)
        return f"{mujoco.mjtWarning(kind).name}: {text.rstrip('.')}"

    def measured(self, state: State, vdot: Array) -> Wrench | None:
        """The wrist sensor's wrench of the last tick, tool compensated; None without a sensor.

        `state` and `vdot` are the controller's for that tick: a real sensor's driver knows no more.
        """
        if self._sensor is None:
            return None
        reading = np.concatenate([self.data.sensor(name).data for name in SENSORS])
        if self._noise is not None and (self._noise.force or self._noise.moment):
            reading[:3] += self._rng.normal(0.0, 1.0, 3) * self._noise.moment
            reading[3:] += self._rng.normal(0.0, 1.0, 3) * self._noise.force
        return self._sensor.compensated(reading, state, vdot)

    def impact(self, frame: str) -> Impact | None:
        """The one point in which the body of `frame` touches its environment; None where there are none or several."""
        body, found = self._body(frame), list[Impact]()
        for i in range(self.data.ncon):
            contact = self.data.contact[i]
            owners = [self.model.geom_bodyid[g] for g in contact.geom]
            if (owners[0] == body) != (owners[1] == body) and contact.efc_address >= 0:
                stiffness, damping, impedance, _ = self.data.efc_KBIP[contact.efc_address]
                normal = contact.frame[:3] * (1.0 if owners[0] == body else -1.0)
                R = float(self.data.efc_R[contact.efc_address])
                found.append(Impact(normal, float(stiffness * impedance), float(damping), R))
        return found[0] if len(found) == 1 else None

    def _body(self, frame: str) -> int:
        return int(self.model.site(frame).bodyid[0] if _has_site(self.model, frame) else self.model.body(frame).id)

    def true_wrench(self, frame: str) -> Array:
        """(6,) what the body of `frame` applied to its environment in the last tick, in that frame; unfiltered."""
        return self.true_touch(frame).F

    def true_touch(self, frame: str) -> Touch:
        """The true wrench of the body of `frame` with what a wrench cannot tell."""
        body = self._body(frame)
        if _has_site(self.model, frame):
            site = self.model.site(frame)
            R, p = self.data.site_xmat[site.id].reshape(3, 3), self.data.site_xpos[site.id]
        else:
            R, p = self.data.xmat[body].reshape(3, 3), self.data.xpos[body]
        F, force, points, mu = np.zeros(6), np.zeros(6), 0, 0.0
        for i in range(self.data.ncon):
            contact = self.data.contact[i]
            owners = [self.model.geom_bodyid[g] for g in contact.geom]
            if (owners[0] == body) == (owners[1] == body):
                continue
            mujoco.mj_contactForce(self.model, self.data, i, force)
            if force[0] > 0.0:
                points, mu = points + 1, max(mu, float(contact.friction[0]) if contact.dim > 1 else 0.0)
            # the contact frame's force acts on the second geom
            sign = 1.0 if owners[0] == body else -1.0
            axes = contact.frame.reshape(3, 3)
            f, m = sign * (axes.T @ force[:3]), sign * (axes.T @ force[3:])
            F[:3] += R.T @ (m + np.cross(contact.pos - p, f))
            F[3:] += R.T @ f
        return Touch(F, points, mu)


def to_mujoco(model: mujoco.MjModel, q: Array) -> Array:
    """Pinocchio's q as MuJoCo's qpos: quaternions wxyz."""
    qpos = np.array(q, float)
    for joint in np.flatnonzero(model.jnt_type < 2):
        at = model.jnt_qposadr[joint] + (3 if model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_FREE else 0)
        qpos[at : at + 4] = np.roll(q[at : at + 4], 1)
    return qpos


def _changed(robot: Robot, plant: Any) -> mujoco.MjModel:
    """A copy of the model with the plant's errors."""
    import copy

    model = copy.copy(robot.mujoco)
    if plant is None:
        return model
    model.body_mass[:] *= 1.0 + plant.mass_error
    model.body_inertia[:] *= 1.0 + plant.mass_error
    if plant.payload:
        model.body_mass[_last_body(model)] += plant.payload
    model.dof_frictionloss[:] += plant.joint_friction
    if plant.armature is not None:
        model.dof_armature[:] = plant.armature
    if plant.contact_friction:
        touching = (model.geom_contype | model.geom_conaffinity) > 0
        model.geom_friction[touching, 0] = plant.contact_friction
        model.geom_condim[touching] = 3
        material.settle(model, plant.contact_friction)
    with quietly():
        mujoco.mj_setConst(model, mujoco.MjData(model))
    return model


def _last_body(model: mujoco.MjModel) -> int:
    """The body that carries the load: the tool where there is one, else the last link."""
    if _has_site(model, "wrist_sensor"):
        return int(model.site("wrist_sensor").bodyid[0])
    return int(model.jnt_bodyid[-1])


def _has_site(model: mujoco.MjModel, name: str) -> bool:
    return bool(mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_SITE, name) >= 0)


def _has_sensor(model: mujoco.MjModel, name: str) -> bool:
    return bool(mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_SENSOR, name) >= 0)


def _actuators(model: mujoco.MjModel) -> tuple[Array, Array]:
    """For every motor, its velocity's number and gear."""
    dofs = np.array([model.jnt_dofadr[j] for j in model.actuator_trnid[:, 0]], dtype=int)
    return dofs, model.actuator_gear[:, 0] * model.actuator_gainprm[:, 0]
