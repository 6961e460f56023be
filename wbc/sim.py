"""The only place that steps MuJoCo: the plant with its honest errors, true contact wrenches, noisy measurements."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import mujoco
import numpy as np
import pinocchio as pin

from . import material
from . import model as models
from .encoder import Encoders
from .errors import ModelError, SimulationError
from .model import body_name, quietly, to_pinocchio
from .outside import Outside, carried, has_site
from .qp import Array
from .ride import Ride
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
        # the robot's own coordinates among those of the scene and of passive joints of the tool
        self._own_q, self._own_v = own_coordinates(robot)
        self.model: mujoco.MjModel = _changed(robot, plant, self._own_v)
        self.substeps = max(1, round(dt / self.model.opt.timestep))
        self.model.opt.timestep = dt / self.substeps
        self.data = mujoco.MjData(self.model)
        self.data.qpos[self._own_q] = to_mujoco(robot.mujoco, q)
        self._noise = plant.noise if plant is not None else None
        self._rng = np.random.default_rng(seed)
        self.encoders = Encoders(robot.model, self._noise, dt, self._rng) if self._noise is not None else None
        self._delayed: deque[Array] = deque(maxlen=(plant.delay if plant is not None else 0) + 1)
        self._sensor = ForceSensor(robot) if all(_has_sensor(self.model, name) for name in SENSORS) else None
        self._motors = _actuators(self.model, self._own_v[robot.base :])
        self._driver = robot.model.createData()
        self._outside = Outside(self.model, plant, rides)
        self.true_state = self._state()  # (q, v) that was last observed, without the noise of encoders

    def observe(self) -> Observation:
        """Kinematics at the present state, as the encoders see it."""
        self._outside.move(self.data)
        mujoco.mj_step1(self.model, self.data)
        self.true_state = self._state()
        measured = self.true_state if self.encoders is None else self.encoders.read(*self.true_state)
        return Observation(self.data.time, *measured)

    def _state(self) -> tuple[Array, Array]:
        return to_pinocchio(self.robot.mujoco, self.data.qpos[self._own_q], self.data.qvel[self._own_v])

    def apply(self, tau: Array) -> None:
        """Send a torque (nu,) [N m], after the plant's delay, and go on to the next tick.

        A robot whose driver adds gravity does so here, from its nominal model.
        """
        if self.robot.gravity == "robot":
            tau = tau + pin.computeGeneralizedGravity(self.robot.model, self._driver, self._state()[0])
        self._delayed.append(tau)
        for step in range(self.substeps):
            if step:
                self._outside.move(self.data)
                mujoco.mj_step1(self.model, self.data)
            self._outside.push(self.data)
            motors, dofs, gear = self._motors
            self.data.ctrl[motors] = self._delayed[0][dofs] / gear
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

    def sensed(self, F: Array, frame: str) -> Wrench:
        """A true wrench of the last tick as a sensor in that frame reads it."""
        if self._noise is not None and (self._noise.force or self._noise.moment):
            F = F + np.repeat((self._noise.moment, self._noise.force), 3) * self._rng.normal(0.0, 1.0, 6)
        return Wrench(F, frame)

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
        own, R, p = carried(self.model, self.data, frame)
        for name, push in self._outside.pushes.items():
            body, R_push, p_push = carried(self.model, self.data, push.frame)
            if body == own:
                m, f = (R_push @ part for part in self.true_push(name).reshape(2, 3))
                F += np.concatenate((R.T @ (m + pin.skew(p_push - p) @ f), R.T @ f))
        return F

    def true_motion(self, frame: str) -> tuple[pin.SE3, Array]:
        """Pose, and body twist (6,), of a frame in the last tick."""
        body, R, p = carried(self.model, self.data, frame)
        at_site = has_site(self.model, frame)
        kind = mujoco.mjtObj.mjOBJ_SITE if at_site else mujoco.mjtObj.mjOBJ_XBODY
        twist = np.zeros(6)
        mujoco.mj_objectVelocity(self.model, self.data, kind, self.model.site(frame).id if at_site else body, twist, 1)
        return pin.SE3(R.copy(), p.copy()), twist

    def impact(self, frame: str) -> Impact | None:
        """The one point in which the body of `frame` touches its environment; None where there are none or several."""
        (body, *_), found = carried(self.model, self.data, frame), list[Impact]()
        for i in range(self.data.ncon):
            contact = self.data.contact[i]
            owners = [self.model.geom_bodyid[g] for g in contact.geom]
            if (owners[0] == body) != (owners[1] == body) and contact.efc_address >= 0:
                stiffness, damping, impedance, _ = self.data.efc_KBIP[contact.efc_address]
                normal = contact.frame[:3] * (1.0 if owners[0] == body else -1.0)
                R = float(self.data.efc_R[contact.efc_address])
                found.append(Impact(normal, float(stiffness * impedance), float(damping), R))
        return found[0] if len(found) == 1 else None

    def true_wrench(self, frame: str) -> Array:
        """(6,) what the body of `frame` applied to its environment in the last tick, in that frame; unfiltered.

        The body is all that moves as one with the frame, with the passive parts of a tool; its environment touches it
        or is welded to it.
        """
        return self.true_touch(frame).F

    def true_touch(self, frame: str) -> Touch:
        """The true wrench of the body of `frame` with what a wrench cannot tell."""
        body, R, p = carried(self.model, self.data, frame)
        F, force, points, mu = np.zeros(6), np.zeros(6), 0, 0.0
        rigid = self.robot.mujoco.body_weldid
        for i in range(self.data.ncon):
            contact = self.data.contact[i]
            inside = [rigid[self.model.geom_bodyid[g]] == rigid[body] for g in contact.geom]
            if inside[0] == inside[1]:
                continue
            mujoco.mj_contactForce(self.model, self.data, i, force)
            if force[0] > 0.0:
                points, mu = points + 1, max(mu, float(contact.friction[0]) if contact.dim > 1 else 0.0)
            # the contact frame's force acts on the second geom
            sign = 1.0 if inside[0] else -1.0
            axes = contact.frame.reshape(3, 3)
            f, m = sign * (axes.T @ force[:3]), sign * (axes.T @ force[3:])
            F[:3] += R.T @ (m + pin.skew(contact.pos - p) @ f)
            F[3:] += R.T @ f
        for at, m, f, bodies in self._equalities():
            inside = [rigid[b] == rigid[body] for b in bodies]
            if inside[0] != inside[1]:
                sign = 1.0 if inside[1] else -1.0
                F[:3] += sign * (R.T @ (m + pin.skew(at - p) @ f))
                F[3:] += sign * (R.T @ f)
        return Touch(F, points, mu)

    def true_distance(self, pairs: Sequence[tuple[int, int]]) -> float:
        """The least distance of pairs of geoms in the last tick, of those that meet less than zero [m]."""
        model, data, beyond = self.model, self.data, 1.0
        return min(mujoco.mj_geomDistance(model, data, a, b, beyond, None) for a, b in pairs)

    def true_com(self) -> Array:
        """(3,) the robot's centre of mass at the last tick, in the world."""
        moving = self.robot.mujoco.body_weldid > 0  # the plant has bodies of the scene that move as well
        return np.asarray(np.average(self.data.xipos[moving], axis=0, weights=self.model.body_mass[moving]))

    def true_slip(self, frame: str) -> Array:
        """(points, 3) velocity across the contact of each touching geom of the body of `frame`, where it touches, less
        that of what it touches, in the world; zero where nothing is touched."""
        (body, *_), rigid = carried(self.model, self.data, frame), self.robot.mujoco.body_weldid
        model, data = self.model, self.data
        touching = (model.geom_contype | model.geom_conaffinity) > 0
        geoms_of_body = np.flatnonzero((rigid[model.geom_bodyid] == rigid[body]) & touching).tolist()
        own = {geom: row for row, geom in enumerate(geoms_of_body)}
        out, force = np.zeros((len(own), 3)), np.zeros(6)
        for i in range(data.ncon):
            contact = data.contact[i]
            pair = contact.geom.tolist()
            inside = [geom in own for geom in pair]
            if inside[0] == inside[1]:
                continue
            mujoco.mj_contactForce(model, data, i, force)
            if force[0] <= 0.0:
                continue
            geoms = pair if inside[0] else pair[::-1]
            v = self._velocity_at(geoms[0], contact.pos) - self._velocity_at(geoms[1], contact.pos)
            n = contact.frame[:3]
            out[own[geoms[0]]] = v - n * (n @ v)
        return out

    def _velocity_at(self, geom: int, place: Array) -> Array:
        """(3,) velocity of a geom's material point."""
        J = np.zeros((3, self.model.nv))
        mujoco.mj_jac(self.model, self.data, J, None, place, int(self.model.geom_bodyid[geom]))
        return np.asarray(J @ self.data.qvel)

    def _equalities(self) -> Iterator[tuple[Array, Array, Array, Array]]:
        """Of every weld and connection of two sites: its place, moment and force on the body of the first site, in the
        world's axes, and both bodies.

        The rows of a weld are s vec(q_2^* q_1), whose rate is s/2 vec(q_2^* w q_1) for a relative angular velocity w:
        the moment follows from the multipliers by the transpose.
        """
        model, data = self.model, self.data
        if not model.neq or not data.ne:
            return
        rows = np.flatnonzero(data.efc_type[: data.ne] == mujoco.mjtConstraint.mjCNSTR_EQUALITY)
        for i in np.flatnonzero(model.eq_objtype == mujoco.mjtObj.mjOBJ_SITE):
            own = rows[data.efc_id[rows] == i]
            if not own.size:
                continue
            sites = model.eq_obj1id[i], model.eq_obj2id[i]
            m, f = np.zeros(3), data.efc_force[own[:3]].copy()
            if model.eq_type[i] == mujoco.mjtEq.mjEQ_WELD:
                q = np.empty((2, 4))
                for k, site in enumerate(sites):
                    # not from the rotation matrix: the sign of the quaternion counts
                    mujoco.mju_mulQuat(q[k], data.xquat[model.site_bodyid[site]], model.site_quat[site])
                back, turn, product = q[1] * (1, -1, -1, -1), np.empty(4), np.empty(4)
                for k in range(3):
                    mujoco.mju_mulQuatAxis(turn, back, np.eye(3)[k])
                    mujoco.mju_mulQuat(product, turn, q[0])
                    m[k] = 0.5 * model.eq_data[i, 10] * product[1:] @ data.efc_force[own[3:]]
            yield data.site_xpos[sites[0]], m, f, model.site_bodyid[list(sites)]


def to_mujoco(model: mujoco.MjModel, q: Array) -> Array:
    """Pinocchio's q as MuJoCo's qpos: quaternions wxyz."""
    return models.to_mujoco(model, q, np.zeros(model.nv))[0]


def own_coordinates(robot: Robot) -> tuple[Array, Array]:
    """Where the robot's qpos (nq,) and qvel (nv,) stand among those of the plant, whose other joints are passive."""
    ours, plant = robot.mujoco, robot.plant or robot.mujoco
    if plant.njnt == ours.njnt:
        return np.arange(ours.nq), np.arange(ours.nv)
    q: list[int] = []
    v: list[int] = []
    for joint in range(ours.njnt):
        there = plant.joint(ours.joint(joint).name)
        q += range(there.qposadr[0], there.qposadr[0] + ours.joint(joint).qpos0.size)
        v += range(there.dofadr[0], there.dofadr[0] + ours.joint(joint).damping.shape[0])
    return np.array(q), np.array(v)


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
