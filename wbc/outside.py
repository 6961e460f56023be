"""What acts on a simulated robot from outside: pushes of a spec's `plant:`, bodies of the scene that are moved."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import mujoco
import numpy as np
import pinocchio as pin

from .axes import WRENCH_AXES
from .qp import Array
from .ride import Ride


class Place(NamedTuple):
    """Where a frame is, as the plant has it: R and p are those of the tick, whichever it is."""

    body: int  # that carries it
    R: Array  # (3, 3)
    p: Array  # (3,)


class Places:
    """Frames of a plant by name, of a site or else of a body; found once."""

    def __init__(self, model: mujoco.MjModel, data: mujoco.MjData) -> None:
        self.model, self.data = model, data
        self._found: dict[str, Place] = {}

    def __getitem__(self, frame: str) -> Place:
        found = self._found.get(frame)
        if found is None:
            found = self._found[frame] = self._find(frame)
        return found

    def _find(self, frame: str) -> Place:
        model, data = self.model, self.data
        if has_site(model, frame):
            site = model.site(frame).id
            return Place(int(model.site_bodyid[site]), data.site_xmat[site].reshape(3, 3), data.site_xpos[site])
        body = int(model.body(frame).id)
        return Place(body, data.xmat[body].reshape(3, 3), data.xpos[body])


class Outside:
    """What acts from outside: wrenches on the robot at their frames, bodies of the scene that are moved by hand.

    `wrenches` name -> (6,) what the environment applies to the robot, at the frame and in its axes, in the last step.
    """

    def __init__(self, places: Places, plant: Any, rides: Mapping[str, Ride] | None = None) -> None:
        model = places.model
        self.places, self.data = places, places.data
        self.rides = [_Carried(model, body, ride) for body, ride in (rides or {}).items()]
        self.pushes = dict(plant.pushes) if plant is not None else {}
        self.moves = dict(plant.moves) if plant is not None else {}
        self._courses = {name: _courses(push.wrench) for name, push in self.pushes.items()}
        self._moved = [_Moved(model, body, move) for body, move in self.moves.items()]
        self.wrenches = {name: np.zeros(6) for name in self.pushes}

    def push(self) -> None:
        """The forces of this step; in MuJoCo they act at a body's centre of mass, so the moment is moved there."""
        data = self.data
        for ride in self.rides:
            ride.drive(data)
        if not self.pushes:
            return
        data.xfrc_applied[:] = 0.0
        for name, push in self.pushes.items():
            F = self.wrenches[name] = np.zeros(6)
            if push.from_ <= data.time < (np.inf if push.to is None else push.to):
                for axis, course in self._courses[name].items():
                    F[WRENCH_AXES.index(axis)] = course(data.time - push.from_)
            body, R, p = self.places[push.frame]
            f = R @ F[3:]
            data.xfrc_applied[body, :3] += f
            data.xfrc_applied[body, 3:] += R @ F[:3] + pin.skew(p - data.xipos[body]) @ f

    def move(self) -> None:
        """Put bodies of the scene where they are to be at this step."""
        for ride in self.rides:
            ride.move(self.data)
        for moved in self._moved:
            moved.move(self.data)


class _Moved:
    """A mocap body that is shifted along a line."""

    def __init__(self, model: mujoco.MjModel, body: str, move: Any) -> None:
        index = model.body(body).id
        self._mocap, self._home = model.body_mocapid[index], model.body_pos[index].copy()
        self._along = np.array(move.along) / np.linalg.norm(np.array(move.along))
        self._from, self._course = move.from_, sines(move.sine)

    def move(self, data: mujoco.MjData) -> None:
        shift = self._course(data.time - self._from) if data.time >= self._from else 0.0
        data.mocap_pos[self._mocap] = self._home + shift * self._along


class _Carried:
    """A body with a free joint on its path: put there with its velocity at every step, and driven by what that takes.

    A mocap body would have no velocity in MuJoCo, and what stands on it would slip. It should be far heavier than
    whatever stands on it.
    """

    def __init__(self, model: mujoco.MjModel, body: str, ride: Ride) -> None:
        joint = model.body_jntadr[model.body(body).id]
        self.model, self.ride = model, ride
        self._q = slice(model.jnt_qposadr[joint], model.jnt_qposadr[joint] + 7)
        self._v = slice(model.jnt_dofadr[joint], model.jnt_dofadr[joint] + 6)
        at, turn = model.qpos0[self._q][:3], np.empty(9)
        mujoco.mju_quat2Mat(turn, model.qpos0[self._q][3:])
        self._home = pin.SE3(turn.reshape(3, 3), at.copy())
        self._qacc, self._needed = np.zeros(model.nv), np.zeros(model.nv)

    def move(self, data: mujoco.MjData) -> None:
        """Pose, velocity and acceleration of this step."""
        T = self.ride.displacement(data.time) * self._home
        (w, v), (wdot, vdot) = (each.reshape(2, 3) for each in self.ride.motion(data.time, T).T)
        quaternion, q = np.empty(4), data.qpos[self._q]
        mujoco.mju_mat2Quat(quaternion, T.rotation.ravel())
        q[:3], q[3:] = T.translation, quaternion
        data.qvel[self._v] = np.concatenate((T.rotation @ v, w))
        self._qacc[self._v] = np.concatenate((T.rotation @ (vdot + np.cross(w, v)), wdot))

    def drive(self, data: mujoco.MjData) -> None:
        """M qacc and what else acts, on its own six velocities."""
        mujoco.mj_mulM(self.model, data, self._needed, self._qacc)
        data.qfrc_applied[self._v] = (self._needed + data.qfrc_bias - data.qfrc_passive)[self._v]


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


def has_site(model: mujoco.MjModel, name: str) -> bool:
    return bool(mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_SITE, name) >= 0)
