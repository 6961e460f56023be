"""The problems stated with TSID. It runs in TSID's own environment."""

from __future__ import annotations

from importlib import metadata
from typing import Any

import numpy as np
import pinocchio as pin
import tsid
from peers.loop import Array, Program, order, serve

MOST = 1e5  # [N] on a contact


def build(problem: dict[str, Any], _: str) -> Program:
    floating = problem["base"] > 0
    base = (7, 6) if floating else (0, 0)
    model = pin.buildModelFromXML(problem["urdf"], *((pin.JointModelFreeFlyer(),) if floating else ()))
    joints = [name for name in model.names if name in problem["joints"]]
    own = order(problem["joints"], joints)
    armature = np.array(model.armature)
    armature[base[1] :] = np.array(problem["armature"])[own]
    model.armature = armature
    kind = tsid.FLOATING_BASE_SYSTEM if floating else tsid.FIXED_BASE_SYSTEM
    robot = tsid.RobotWrapper(model, kind, False)
    inverse = tsid.InverseDynamicsFormulationAccForce("tsid", robot, False)
    q = pin.neutral(model)
    inverse.computeProblemData(0.0, q, np.zeros(model.nv))
    kept = [_contact(inverse, robot, problem, name, given) for name, given in problem["contacts"].items()]
    kept += [_task(inverse, robot, own, name, given) for name, given in problem["tasks"].items()]
    if not problem["unique"]:
        bounds = tsid.TaskActuationBounds("torque", robot)
        most = np.array(problem["effort"])[own]
        bounds.setBounds(-most, most)
        inverse.addActuationTask(bounds, 1.0, 0, 0.0)
        kept.append(bounds)
    solver = tsid.SolverHQuadProgFast("solver")
    solver.resize(inverse.nVar, inverse.nEq, inverse.nIn)
    kept += [robot, model]

    def tick(q: Array, v: Array) -> tuple[Array, bool, tuple[()]]:
        found = solver.solve(inverse.computeProblemData(0.0, q, v))
        return inverse.getActuatorForces(found), found.status == 0, ()

    tick.kept = kept  # type: ignore[attr-defined]  # TSID only points to them
    return Program(tick, joints, base)


def _contact(inverse: Any, robot: Any, problem: dict[str, Any], name: str, given: dict[str, Any]) -> Any:
    frame, mu, up = given["frame"], given["mu"], np.array([0.0, 0.0, 1.0])
    if given["type"] == "point":
        made = tsid.ContactPoint(name, robot, frame, up, mu, 0.0, MOST)
        made.useLocalFrame(False)
        made.setRegularizationTaskWeightVector(np.ones(3))
        made.setKp(np.zeros(3))
        made.setKd(np.zeros(3))
        weight = problem["forces"]
    else:
        x, y = 0.5 * np.array(given["size"])
        corners = np.array([[x, x, -x, -x], [y, -y, y, -y], [0.0, 0.0, 0.0, 0.0]])
        made = tsid.Contact6d(name, robot, frame, corners, up, mu, 0.0, MOST)
        weight = problem["forces"]
        moment = np.sqrt(problem["moments"] / weight)
        made.setRegularizationTaskWeightVector(np.array([1.0, 1.0, 1.0, moment, moment, moment]))
        made.setKp(np.zeros(6))
        made.setKd(np.zeros(6))
    made.setReference(pin.SE3.Identity())
    inverse.addRigidContact(made, weight, 1.0, 0)
    return made


def _task(inverse: Any, robot: Any, own: Array, name: str, given: dict[str, Any]) -> Any:
    if given["type"] == "posture":
        made, size = tsid.TaskJointPosture(name, robot), robot.na
        made.setReference(_at(np.array(given["q"])[own], size))
    elif given["type"] == "com":
        made, size = tsid.TaskComEquality(name, robot), 3
        made.setReference(_at(np.array(given["p"]), 3))
    else:
        made, size = tsid.TaskSE3Equality(name, robot, given["frame"]), 6
        if given["type"] == "orientation":
            made.setMask(np.array([0.0, 0.0, 0.0, 1.0, 1.0, 1.0]))
        pose = pin.SE3(np.array(given["R"]), np.array(given["p"]))
        made.setReference(tsid.TrajectorySE3Constant(name, pose).computeNext())
    made.setKp(np.full(size, given["kp"]))
    made.setKd(np.full(size, given["kd"]))
    inverse.addMotionTask(made, given["weight"], 0 if given["hard"] else 1, 0.0)
    return made


def _at(value: Array, size: int) -> Any:
    sample = tsid.TrajectorySample(size)
    sample.value(value)
    sample.derivative(np.zeros(size))
    sample.second_derivative(np.zeros(size))
    return sample


if __name__ == "__main__":
    serve(build, f"tsid {metadata.version('tsid')}")
