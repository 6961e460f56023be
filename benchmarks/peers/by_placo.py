"""The problems stated with PlaCo. It runs in PlaCo's own environment."""

from __future__ import annotations

import tempfile
from importlib import metadata
from pathlib import Path
from typing import Any

import numpy as np
import placo
from peers.loop import Array, Program, order, serve


def build(problem: dict[str, Any], _: str) -> Program:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "robot.urdf"
        path.write_text(problem["urdf"])
        robot = placo.RobotWrapper(str(path), placo.Flags.ignore_collisions)
    joints = [name for name in robot.joint_names() if name in problem["joints"]]
    own = order(problem["joints"], joints)
    armature = np.array(robot.model.armature)
    armature[6:] = np.array(problem["armature"])[own]
    robot.model.armature = armature
    for name, most in zip(problem["joints"], problem["effort"], strict=True):
        robot.set_torque_limit(name, most)
    solver = placo.DynamicsSolver(robot)
    solver.torque_cost = 0.0
    solver.enable_torque_limits(not problem["unique"])
    solver.enable_joint_limits(False)
    solver.enable_velocity_limits(False)
    solver.mask_fbase(not problem["base"])
    for name, given in problem["contacts"].items():
        _contact(solver, problem, name, given)
    for name, given in problem["tasks"].items():
        _task(solver, problem, name, given)
    floating = bool(problem["base"])
    rest = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0])

    def tick(q: Array, v: Array) -> tuple[Array, bool, tuple[()]]:
        robot.state.q = q if floating else np.concatenate((rest, q))
        robot.state.qd = v if floating else np.concatenate((np.zeros(6), v))
        robot.update_kinematics()
        found = solver.solve(False)
        return found.tau[6:], found.success, ()

    return Program(tick, joints, (7, 6) if floating else (0, 0))


def _contact(solver: Any, problem: dict[str, Any], name: str, given: dict[str, Any]) -> None:
    frame = given["frame"]
    if given["type"] == "point":
        held = solver.add_position_task(frame, np.zeros(3))
        _configure(held, name, True, 1.0, 0.0, 0.0)
        made = solver.add_unilateral_point_contact(held)
    else:
        held = solver.add_frame_task(frame, np.eye(4))
        for part, which in (("position", held.position()), ("orientation", held.orientation())):
            _configure(which, f"{name} {part}", True, 1.0, 0.0, 0.0)
        made = solver.add_planar_contact(held)
        made.length, made.width = given["size"]
        made.weight_moments = 0.0 if problem["unique"] else problem["moments"]
    made.mu = given["mu"]
    made.weight_forces = 0.0 if problem["unique"] else problem["forces"]


def _task(solver: Any, problem: dict[str, Any], name: str, given: dict[str, Any]) -> None:
    gains = given["kp"], given["kd"]
    if given["type"] == "posture":
        made = solver.add_joints_task()
        made.set_joints(dict(zip(problem["joints"], given["q"], strict=True)))
        parts = {name: made}
    elif given["type"] == "com":
        parts = {name: solver.add_com_task(np.array(given["p"]))}
    else:
        parts = {f"{name} orientation": solver.add_orientation_task(given["frame"], np.array(given["R"]))}
        if given["type"] == "se3":
            parts[f"{name} position"] = solver.add_position_task(given["frame"], np.array(given["p"]))
    for part, made in parts.items():
        _configure(made, part, given["hard"], given["weight"], *gains)


def _configure(task: Any, name: str, hard: bool, weight: float, kp: float, kd: float) -> None:
    task.configure(name, "hard" if hard else "soft", weight)
    task.kp, task.kd = kp, kd


if __name__ == "__main__":
    serve(build, f"placo {metadata.version('placo')}")
