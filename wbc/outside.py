"""What acts on a simulated robot from outside: pushes of a spec's `plant:`, bodies of the scene that are moved."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import mujoco
import numpy as np
import pinocchio as pin

from .axes import WRENCH_AXES
from .qp import Array


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
            body, R, p = carried(self.model, data, push.frame)
            f = R @ F[3:]
            data.xfrc_applied[body, :3] += f
            data.xfrc_applied[body, 3:] += R @ F[:3] + pin.skew(p - data.xipos[body]) @ f

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


def carried(model: mujoco.MjModel, data: mujoco.MjData, frame: str) -> tuple[int, Array, Array]:
    """The body that carries a site, or is called so, and the frame's rotation and place."""
    if has_site(model, frame):
        site = model.site(frame).id
        return int(model.site_bodyid[site]), data.site_xmat[site].reshape(3, 3), data.site_xpos[site]
    body = int(model.body(frame).id)
    return body, data.xmat[body].reshape(3, 3), data.xpos[body]


def has_site(model: mujoco.MjModel, name: str) -> bool:
    return bool(mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_SITE, name) >= 0)
