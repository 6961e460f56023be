"""The only place that steps MuJoCo: the plant with its honest errors, true contact wrenches, noisy measurements."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from typing import Any, NamedTuple

import mujoco
import numpy as np
import pinocchio as pin

from .errors import ModelError, SimulationError
from .model import quietly, to_pinocchio
from .qp import Array
from .robot import Robot, State
from .wrench import WRENCH_AXES, ForceSensor, Wrench

SENSORS = ("wrist_torque", "wrist_force")


class Observation(NamedTuple):
    """What the controller is shown at one tick."""

    t: float
    q: Array
    v: Array


class Simulator:
    """A robot's compiled model as a plant, one control tick a step.

    Parameters: the robot (it is not changed), the start `q`, the control period `dt` [s], `plant`: what only the
    simulator knows (payload [kg], mass_error, joint_friction [N m], contact_friction, armature [kg m^2], delay [ticks],
    noise, pushes on the robot, moves of mocap bodies), and the seed of the noise.
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
        self._outside = Outside(self.model, plant)

    def observe(self) -> Observation:
        """Kinematics at the present state, as the encoders see it."""
        self._outside.move(self.data)
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
                self._outside.move(self.data)
                mujoco.mj_step1(self.model, self.data)
            self._outside.push(self.data)
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
        return None if self._sensor is None else self._sensor.compensated(self._reading(), state, vdot)

    def tare(self, state: State) -> None:
        """Take what the wrist sensor reads at `state`, beyond the tool's load, off all later readings."""
        if self._sensor is not None:
            mujoco.mj_forward(self.model, self.data)
            self._sensor = self._sensor.tare(self._reading(), state, self.data.qacc)

    def _reading(self) -> Array:
        reading = np.concatenate([self.data.sensor(name).data for name in SENSORS])
        if self._noise is not None:
            reading += (*self._noise.bias.moment, *self._noise.bias.force)
            if self._noise.force or self._noise.moment:
                reading[:3] += self._rng.normal(0.0, 1.0, 3) * self._noise.moment
                reading[3:] += self._rng.normal(0.0, 1.0, 3) * self._noise.force
        return reading

    @property
    def pushes(self) -> dict[str, str]:
        """Name -> frame of the pushes."""
        return {name: push.frame for name, push in self._outside.pushes.items()}

    @property
    def moves(self) -> bool:
        """Whether a body of the scene is moved."""
        return bool(self._outside.moves)

    def true_push(self, name: str) -> Array:
        """(6,) what the robot applied to whoever pushes it in the last tick, at the frame of the push."""
        return -self._outside.wrenches[name]

    def true_external(self, frame: str) -> Array:
        """(6,) all that the body of `frame` applied to its environment in the last tick, contacts and pushes, there."""
        F = self.true_wrench(frame)
        own, R, p = _body(self.model, self.data, frame)
        for name, push in self._outside.pushes.items():
            body, R_push, p_push = _body(self.model, self.data, push.frame)
            if body == own:
                m, f = (R_push @ part for part in self.true_push(name).reshape(2, 3))
                F += np.concatenate((R.T @ (m + np.cross(p_push - p, f)), R.T @ f))
        return F

    def true_motion(self, frame: str) -> tuple[pin.SE3, Array]:
        """Pose, and body twist (6,), of a frame in the last tick."""
        body, R, p = _body(self.model, self.data, frame)
        at_site = _has_site(self.model, frame)
        kind = mujoco.mjtObj.mjOBJ_SITE if at_site else mujoco.mjtObj.mjOBJ_XBODY
        twist = np.zeros(6)
        mujoco.mj_objectVelocity(self.model, self.data, kind, self.model.site(frame).id if at_site else body, twist, 1)
        return pin.SE3(R.copy(), p.copy()), twist

    def true_wrench(self, frame: str) -> Array:
        """(6,) what the body of `frame` applied to its environment in the last tick, in that frame; unfiltered."""
        body, R, p = _body(self.model, self.data, frame)
        F, force = np.zeros(6), np.zeros(6)
        for i in range(self.data.ncon):
            contact = self.data.contact[i]
            owners = [self.model.geom_bodyid[g] for g in contact.geom]
            if (owners[0] == body) == (owners[1] == body):
                continue
            mujoco.mj_contactForce(self.model, self.data, i, force)
            # the contact frame's force acts on the second geom
            sign = 1.0 if owners[0] == body else -1.0
            axes = contact.frame.reshape(3, 3)
            f, m = sign * (axes.T @ force[:3]), sign * (axes.T @ force[3:])
            F[:3] += R.T @ (m + np.cross(contact.pos - p, f))
            F[3:] += R.T @ f
        return F


class Outside:
    """What acts from outside: wrenches on the robot at their frames, bodies of the scene that are moved by hand.

    `wrenches` name -> (6,) what the environment applies to the robot, at the frame and in its axes, in the last step.
    """

    def __init__(self, model: mujoco.MjModel, plant: Any) -> None:
        self.model = model
        self.pushes = dict(plant.pushes) if plant is not None else {}
        self.moves = dict(plant.moves) if plant is not None else {}
        self._courses = {name: _courses(push.wrench) for name, push in self.pushes.items()}
        self._home = model.body_pos.copy()
        self.wrenches = {name: np.zeros(6) for name in self.pushes}

    def push(self, data: mujoco.MjData) -> None:
        """The forces of this step; in MuJoCo they act at a body's centre of mass, so the moment is moved there."""
        if not self.pushes:
            return
        data.xfrc_applied[:] = 0.0
        for name, push in self.pushes.items():
            F = self.wrenches[name] = np.zeros(6)
            if push.from_ <= data.time < (np.inf if push.to is None else push.to):
                for axis, course in self._courses[name].items():
                    F[WRENCH_AXES.index(axis)] = course(data.time - push.from_)
            body, R, p = _body(self.model, data, push.frame)
            f = R @ F[3:]
            data.xfrc_applied[body, :3] += f
            data.xfrc_applied[body, 3:] += R @ F[:3] + np.cross(p - data.xipos[body], f)

    def move(self, data: mujoco.MjData) -> None:
        for body, move in self.moves.items():
            index = self.model.body(body).id
            along = np.array(move.along) / np.linalg.norm(np.array(move.along))
            shift = sines(move.sine)(data.time - move.from_) if data.time >= move.from_ else 0.0
            data.mocap_pos[self.model.body_mocapid[index]] = self._home[index] + shift * along


def sines(sine: Any) -> Callable[[float], float]:
    """A sum of sines from the spec; the phases of several (Schroeder's, -pi k (k - 1)/n) keep its peak low."""
    omega = 2.0 * np.pi * np.array(sine.frequencies)
    k = np.arange(omega.size)
    phase = -np.pi * k * (k - 1) / k.size if k.size > 1 else np.zeros(1)
    return lambda t: float(sine.amplitude * np.sin(omega * t + phase).sum())


def _courses(wrench: Any) -> dict[str, Callable[[float], float]]:
    return {axis: sines(value.sine) if hasattr(value, "sine") else _always(value) for axis, value in wrench.items()}


def _always(value: float) -> Callable[[float], float]:
    return lambda t: value


def _body(model: mujoco.MjModel, data: mujoco.MjData, frame: str) -> tuple[int, Array, Array]:
    """The body that carries a site, or is called so, and the frame's rotation and place."""
    if _has_site(model, frame):
        site = model.site(frame).id
        return int(model.site_bodyid[site]), data.site_xmat[site].reshape(3, 3), data.site_xpos[site]
    body = int(model.body(frame).id)
    return body, data.xmat[body].reshape(3, 3), data.xpos[body]


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
