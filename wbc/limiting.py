"""Limits of the joints and distances of the bodies from the entries of a spec, beside what the model states."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from . import spec as specs
from .faults import Faults
from .geometry import Geometry
from .limit import JointLimit, TorqueLimit, make_collision, make_limits
from .qp import Array
from .robot import Robot
from .tracking import joint_values

if TYPE_CHECKING:
    from .collision import SelfCollision


def limits_of(spec: specs.Spec, robot: Robot, faults: Faults) -> tuple[TorqueLimit, JointLimit | None]:
    """Limits of torques, and of joints where there are any."""
    limits = spec.limits
    most = {"torque": np.minimum(robot.tau_max, -robot.tau_min), "velocity": robot.v_max}
    values: dict[str, Any] = {}
    for name in ("torque", "torque_rate", "velocity", "acceleration"):
        given, model = getattr(limits, name), most.get(name, np.full(robot.nu, np.inf))
        if isinstance(given, specs.Scale):
            given = model * given.scale
        elif given is not None and given != "model":
            given = joint_values(robot, given, model) if isinstance(given, dict) else given
            _check_limit(robot, faults, name, np.array(given, float), model, "rad/s" if name == "velocity" else "N m")
        values[name] = given
    values["position"] = limits.position
    if isinstance(limits.position, specs.Margin):
        margin = values["position"] = limits.position.margin
        for i in np.flatnonzero(robot.q_max - robot.q_min <= 2.0 * margin):
            message = f"{margin:g} rad on either side leave {robot.joints[i]} no range"
            range_ = f"expected less than half of {robot.q_max[i] - robot.q_min[i]:.3g} rad"
            faults.add(("limits", "position", "margin"), f"{message}; {range_}")
    return make_limits(robot, values)


def collision_of(geometry: Geometry) -> SelfCollision | None:
    """The distances that the robot's own bodies keep."""
    given = geometry.spec.limits.self_collision
    if given is None:
        return None
    with geometry.faults.at("limits", "self_collision"):
        return make_collision(
            geometry.robot, given if isinstance(given, float) else given.model_dump(exclude_none=True)
        )
    return None


def _check_limit(robot: Robot, faults: Faults, name: str, given: Array, model: Array, unit: str) -> None:
    """A limit that the model's own undercuts binds nothing, which is not what its author thinks."""
    tail = "; the model's own limit would bind instead: expected less, or `model`"
    if given.ndim == 0:
        if given > model.max():
            faults.add(("limits", name), f"{given:g} is above the {model.max():g} {unit} of every joint{tail}")
        return
    for i in np.flatnonzero(given > model):
        message = f"{given[i]:g} is above the {model[i]:g} {unit} of {robot.joints[i]}{tail}"
        faults.add(("limits", name, robot.joints[i]), message)


def unlimited(spec: specs.Spec, robot: Robot) -> list[str]:
    """Limits that are said to be the model's, and which it does not state."""
    most = {"torque": robot.tau_max, "velocity": robot.v_max, "position": robot.q_max}
    notes = list[str]()
    for name, limit in most.items():
        joints = [robot.joints[i] for i in np.flatnonzero(np.isinf(limit))]
        if joints and getattr(spec.limits, name) == "model":
            few = ", ".join(joints[:6]) + (f" and {len(joints) - 6} others" if len(joints) > 6 else "")
            notes.append(f"limits.{name}: the model states none for {few}")
    return notes
