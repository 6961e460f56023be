"""The problems that all contestants are given: plain data, in words that each of the libraries knows.

Every task is a row block A vdot = b weighed by the identity, a cost w/2 |A vdot - b|^2; of a frame the *classical*
acceleration of its origin is meant, its error is split (position, and logarithm of the rotation). Contacts are held by
equalities without feedback; forces stay in pyramids of four faces along the axes, a sole's also within its rectangle;
joint torques within their limits. Costs w/2 |f|^2 on forces and w/2 |m|^2 on moments; none on torques, for TSID's
binding has no way to state one, and PlaCo's can be switched off.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import pinocchio as pin

from wbc.robot import Robot

from .urdf import write_urdf

FEET = ("FL_foot", "FR_foot", "RL_foot", "RR_foot")
SOLES = ("left_sole", "right_sole")
SIZE = (0.17, 0.05)  # [m] of a sole
LOADED = {
    "panda": ("panda", "eraser", None), "ur5e": ("ur5e", "eraser", None),
    "go2": ("go2", None, "floor"), "g1": ("g1", None, "floor"),
}  # fmt: skip


def load(name: str) -> Robot:
    return Robot.load(*LOADED[name])


def problems() -> dict[str, dict[str, Any]]:
    """Name -> problem. In the ones called `unique` constraints and tasks leave nothing to a regulariser."""
    return {
        "arm": arm("panda"),
        "arm, unique": arm("ur5e", unique=True),
        "quadruped": quadruped(),
        "humanoid": humanoid(SOLES),
        "humanoid, unique": humanoid(SOLES[:1], unique=True),
    }


def _problem(robot: Robot, frames: tuple[str, ...], /, **more: Any) -> dict[str, Any]:
    base = robot.base
    return {
        "robot": robot.name,
        "urdf": write_urdf(robot.model, frames),
        "joints": list(robot.joints),
        "base": base,
        "armature": np.asarray(robot.model.armature)[base:].tolist(),
        "effort": np.minimum(robot.tau_max, -robot.tau_min).tolist(),
        "contacts": {},
        "forces": 0.0,
        "moments": 0.0,
        "unique": False,
    } | more


def _task(type: str, kp: float, kd: float, weight: float, hard: bool = False, **more: Any) -> dict[str, Any]:
    return {"type": type, "kp": kp, "kd": kd, "weight": weight, "hard": hard} | more


def _at(robot: Robot, frame: str) -> dict[str, Any]:
    q = robot.keyframes["home"]
    T = robot.state(q, np.zeros(robot.nv)).frame(frame).T
    return {"frame": frame, "R": T.rotation.tolist(), "p": T.translation.tolist()}


def arm(name: str, unique: bool = False) -> dict[str, Any]:
    """A tool holds its pose, the joints their posture; `unique`: the tool alone, exactly, on six joints."""
    robot = load(name)
    tasks = {"tool": _task("se3", 100.0, 20.0, 1.0, unique, **_at(robot, "eraser"))}
    if not unique:
        tasks["posture"] = _task("posture", 50.0, 10.0, 1e-2, q=robot.keyframes["home"].tolist())
    return _problem(robot, ("eraser",), robot=name, tasks=tasks, unique=unique)


def quadruped() -> dict[str, Any]:
    """The centre of mass and the trunk's orientation, on four points."""
    robot = load("go2")
    tasks = {
        "balance": _task("com", 100.0, 20.0, 1.0, p=_com(robot)),
        "trunk": _task("orientation", 100.0, 20.0, 1.0, **_at(robot, "base")),
    }
    contacts = {name: {"type": "point", "frame": name, "mu": 0.6} for name in FEET}
    return _problem(robot, ("base", *FEET), robot="go2", tasks=tasks, contacts=contacts, forces=1e-4)


def humanoid(soles: tuple[str, ...], unique: bool = False) -> dict[str, Any]:
    """The centre of mass, the pelvis' orientation and the posture, on soles; `unique`: the posture alone, exactly."""
    robot = load("g1")
    tasks = {"posture": _task("posture", 20.0, 9.0, 1e-2, unique, q=robot.keyframes["home"][7:].tolist())}
    if not unique:
        tasks["balance"] = _task("com", 40.0, 12.0, 1.0, p=_com(robot))
        tasks["pelvis"] = _task("orientation", 100.0, 20.0, 1.0, **_at(robot, "pelvis"))
    # on one sole nothing is left to choose: it gets room to carry whatever the posture needs
    mu, size = (5.0, (2.0, 2.0)) if unique else (0.6, SIZE)
    contacts = {name: {"type": "sole", "frame": name, "mu": mu, "size": list(size)} for name in soles}
    more = {"robot": "g1", "tasks": tasks, "contacts": contacts, "unique": unique}
    return _problem(robot, ("pelvis", *soles), forces=1e-5, moments=1e-4, **more)


def _com(robot: Robot) -> list[float]:
    return pin.centerOfMass(robot.model, robot.model.createData(), robot.keyframes["home"]).tolist()


def states(robot: Robot, count: int, seed: int = 0) -> Iterator[tuple[Any, Any]]:
    """(q, v) about the home pose; every fourth is far enough from it for limits and cones to bind."""
    rng = np.random.default_rng(seed)
    for i in range(count):
        far = 0.05 if i % 4 == 3 else 0.01
        q = pin.integrate(robot.model, robot.keyframes["home"], far * rng.standard_normal(robot.nv))
        yield q, 3.0 * far * rng.standard_normal(robot.nv)
