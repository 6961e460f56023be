"""The only place that steps MuJoCo: the plant with its honest errors, true contact wrenches, noisy measurements."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import mujoco
import numpy as np
import pinocchio as pin

from . import material
from .coordinates import Coordinates
from .encoder import Encoders
from .errors import ModelError, SimulationError
from .model import body_name, quietly
from .outside import Outside, Places, has_site
from .qp import Array
from .ride import Ride
from .robot import Robot
from .state import State
from .touch import Impact, Touch, Truth
from .wrench import ForceSensor, Wrench

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
    noise, pushes on the robot, moves of mocap bodies), the seed of the noise, `rides`: how bodies of the scene move.
    """

    def __init__(
        self,
        robot: Robot,
        q: Array,
        dt: float,
        plant: Any = None,
        seed: int = 0,
        rides: Mapping[str, Ride] | None = None,
    ) -> None:
        if robot.mujoco is None:
            raise ModelError("only a robot that was loaded from a file can be simulated")
        self.robot, self.dt = robot, dt
        self._coordinates = Coordinates(robot)
        own = self._coordinates.qvel
        self.model: mujoco.MjModel = _changed(robot, plant, own)
        self.substeps = max(1, round(dt / self.model.opt.timestep))
        self.model.opt.timestep = dt / self.substeps
        self.data = mujoco.MjData(self.model)
        self._coordinates.write(self.data, q)
        self._noise = plant.noise if plant is not None else None
        self._rng = np.random.default_rng(seed)
        self.encoders = Encoders(robot.model, self._noise, dt, self._rng) if self._noise is not None else None
        self._time = 0.0  # of the last observation [s]
        self._delayed: deque[Array] = deque(maxlen=(plant.delay if plant is not None else 0) + 1)
        sensed = all(_has_sensor(self.model, name) for name in SENSORS)
        self._sensor = ForceSensor(robot) if sensed else None
        self._readings = [self.data.sensor(name).data for name in SENSORS] if sensed else []
        self._motors = _actuators(self.model, own[robot.base :])
        self._driver = robot.model.createData()
        self._places = Places(self.model, self.data)
        self._outside = Outside(self._places, plant, rides)
        self._truth = Truth(self.model, self.data, robot.mujoco.body_weldid, self._places)
        self._links = np.flatnonzero(robot.mujoco.body_weldid > 0)  # bodies of the scene may move as well
        self._masses = self.model.body_mass[self._links, None]
        self._mass = float(self._masses.sum())
        # (q, v) that was last observed, without the noise of encoders
        self.true_state = self._coordinates.read(self.data)

    def observe(self) -> Observation:
        """Kinematics at the present state, as the encoders see it."""
        self._outside.move()
        mujoco.mj_step1(self.model, self.data)
        self._truth.forget()
        if self.data.time < self._time:  # MuJoCo itself starts again where a state is not finite
            grown = self.data.warning.number.nonzero()[0]
            self._break_down(self._warning(int(grown[0])) if grown.size else "it was reset", self._time + self.dt)
        self._time = self.data.time
        self.true_state = self._coordinates.read(self.data)
        measured = self.true_state if self.encoders is None else self.encoders.read(*self.true_state)
        return Observation(self.data.time, *measured)

    def apply(self, tau: Array) -> None:
        """Send a torque (nu,) [N m], after the plant's delay, and go on to the next tick.

        A robot whose driver adds gravity does so here, from its nominal model.
        """
        if self.robot.gravity == "robot":
            tau = tau + pin.computeGeneralizedGravity(self.robot.model, self._driver, self.true_state[0])
        self._delayed.append(tau)
        motors, dofs, gear = self._motors
        for step in range(self.substeps):
            if step:
                self._outside.move()
                mujoco.mj_step1(self.model, self.data)
            self._outside.push()
            self.data.ctrl[motors] = self._delayed[0][dofs] / gear
            mujoco.mj_step2(self.model, self.data)
        self._truth.forget()
        grown = self.data.warning.number.nonzero()[0]
        if grown.size or not np.isfinite(self.data.qacc).all():
            why = self._warning(int(grown[0])) if grown.size else "an acceleration that is not finite"
            # a state that is not finite has MuJoCo start again, its clock too
            self._break_down(why, max(self.data.time, self._time))

    @staticmethod
    def _break_down(why: str, t: float) -> None:
        raise SimulationError(f"the simulation broke down at t = {t:.3f} s ({why})", t)

    def spoil(self, joint: int) -> None:
        """A fault on purpose: the position of the robot's joint of that number is not a number."""
        dof = self._coordinates.qvel[self.robot.base + joint]
        self.data.qpos[self.model.jnt_qposadr[self.model.dof_jntid[dof]]] = np.nan

    def restart(self) -> None:
        """A fault on purpose: everything starts again, the clock too."""
        mujoco.mj_resetData(self.model, self.data)

    def body(self, frame: str) -> int:
        """MuJoCo's number of the body that carries a frame."""
        return self._places[frame].body

    def _warning(self, kind: int) -> str:
        text = mujoco.mju_warningText(kind, self.data.warning[kind].lastinfo)
        return f"{mujoco.mjtWarning(kind).name}: {text.rstrip('.')}"

    def measured(self, state: State, vdot: Array) -> Wrench | None:
        """The wrist sensor's wrench of the last tick, tool compensated; None without a sensor.

        `state` and `vdot` are the controller's for that tick: a real sensor's driver knows no more.
        """
        return None if self._sensor is None else self._sensor.compensated(self._reading(), state, vdot)

    def sensed(self, F: Array, frame: str) -> Wrench:
        """A true wrench of the last tick as a sensor in that frame reads it."""
        if self._noise is not None and (self._noise.force or self._noise.moment):
            F = F + np.repeat((self._noise.moment, self._noise.force), 3) * self._rng.normal(0.0, 1.0, 6)
        return Wrench(F, frame)

    def tare(self, state: State) -> None:
        """Take what the wrist sensor reads at `state`, beyond the tool's load, off all later readings."""
        if self._sensor is not None:
            mujoco.mj_forward(self.model, self.data)
            self._truth.forget()
            self._sensor = self._sensor.tare(self._reading(), state, self.data.qacc)

    def _reading(self) -> Array:
        reading = np.concatenate(self._readings)
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
        own, R, p = self._places[frame]
        for name, push in self._outside.pushes.items():
            body, R_push, p_push = self._places[push.frame]
            if body == own:
                m, f = (R_push @ part for part in self.true_push(name).reshape(2, 3))
                F += np.concatenate((R.T @ (m + pin.skew(p_push - p) @ f), R.T @ f))
        return F

    def true_motion(self, frame: str) -> tuple[pin.SE3, Array]:
        """Pose, and body twist (6,), of a frame in the last tick."""
        body, R, p = self._places[frame]
        at_site = has_site(self.model, frame)
        kind = mujoco.mjtObj.mjOBJ_SITE if at_site else mujoco.mjtObj.mjOBJ_XBODY
        twist = np.zeros(6)
        mujoco.mj_objectVelocity(self.model, self.data, kind, self.model.site(frame).id if at_site else body, twist, 1)
        return pin.SE3(R.copy(), p.copy()), twist

    def impact(self, frame: str) -> Impact | None:
        """The one point in which the body of `frame` touches its environment; None where there are none or several."""
        return self._truth.impact(frame)

    def true_wrench(self, frame: str) -> Array:
        """(6,) what the body of `frame` applied to its environment in the last tick, in that frame; unfiltered."""
        return self._truth.touch(frame).F

    def true_touch(self, frame: str) -> Touch:
        """The true wrench of the body of `frame` with what a wrench cannot tell."""
        return self._truth.touch(frame)

    def true_slip(self, frame: str) -> Array:
        """(points, 3) how the body of `frame` slips where it touches, in the last tick (see `Truth.slip`)."""
        return self._truth.slip(frame)

    def true_distance(self, pairs: Sequence[tuple[int, int]]) -> float:
        """The least distance of pairs of geoms in the last tick, of those that meet less than zero [m]."""
        model, data, beyond = self.model, self.data, 1.0
        return min(mujoco.mj_geomDistance(model, data, a, b, beyond, None) for a, b in pairs)

    def true_com(self) -> Array:
        """(3,) the robot's centre of mass at the last tick, in the world."""
        return np.asarray((self.data.xipos[self._links] * self._masses).sum(axis=0) / self._mass)


def _changed(robot: Robot, plant: Any, own: Array) -> mujoco.MjModel:
    """A copy of the model with the plant's errors, which are those of the robot with its tool."""
    import copy

    model = copy.copy(robot.plant or robot.mujoco)
    if plant is None:
        return model
    tree = robot.mujoco.body_rootid
    links = np.isin(tree, tree[robot.mujoco.body_weldid > 0])
    model.body_mass[links] *= 1.0 + plant.mass_error
    model.body_inertia[links] *= 1.0 + plant.mass_error
    if plant.payload:
        at = plant.payload_at
        model.body_mass[carrier(robot, at)[0] if at is not None else _last_body(robot.mujoco)] += plant.payload
    driven = own[robot.base :]
    model.dof_frictionloss[driven] += plant.joint_friction
    if plant.armature is not None:
        model.dof_armature[driven] = plant.armature
    if plant.contact_friction:
        touching = (model.geom_contype | model.geom_conaffinity) > 0
        model.geom_friction[touching, 0] = plant.contact_friction
        model.geom_condim[touching] = 3
        material.settle(model, plant.contact_friction)
    with quietly():
        mujoco.mj_setConst(model, mujoco.MjData(model))
    return model


def carrier(robot: Robot, name: str) -> tuple[int, pin.SE3]:
    """MuJoCo's body that carries a frame, and the frame's place on it; of a joint's frame, a body that moves alike."""
    mj = robot.mujoco
    site = mujoco.mj_name2id(mj, mujoco.mjtObj.mjOBJ_SITE, name.removeprefix("site:"))
    named = mujoco.mj_name2id(mj, mujoco.mjtObj.mjOBJ_BODY, name)
    bodies = [named] if named >= 0 else [int(mj.site_bodyid[site])] if site >= 0 else range(1, mj.nbody)
    frame = robot.model.frames[robot.frame_id(name)]
    for body in bodies:
        own = robot.model.frames[robot.frame_id(body_name(mj, body))]
        if own.parentJoint == frame.parentJoint:
            return body, own.placement.actInv(frame.placement)
    return 0, frame.placement


def _last_body(model: mujoco.MjModel) -> int:
    """The body that carries the load: the tool where there is one, else the last link."""
    if has_site(model, "wrist_sensor"):
        return int(model.site("wrist_sensor").bodyid[0])
    return int(model.jnt_bodyid[-1])


def _has_sensor(model: mujoco.MjModel, name: str) -> bool:
    return bool(mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_SENSOR, name) >= 0)


def _actuators(model: mujoco.MjModel, own: Array) -> tuple[Any, Any, Array]:
    """The motors of the velocities `own`, for each its velocity's number among these, and its gear."""
    dofs = model.jnt_dofadr[model.actuator_trnid[:, 0]]
    motors = np.flatnonzero(np.isin(dofs, own))
    gear = model.actuator_gear[motors, 0] * model.actuator_gainprm[motors, 0]
    return motors, np.array([int(np.flatnonzero(own == dof)[0]) for dof in dofs[motors]], dtype=int), gear
