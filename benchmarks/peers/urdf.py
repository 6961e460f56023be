"""A Pinocchio model as URDF, for libraries that read nothing else: kinematics, inertias, limits and some frames.

URDF has no armature: hand that over beside it. A floating base becomes the root link, for the reader to let free.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Iterable
from typing import Any

import numpy as np
import pinocchio as pin

ROOT = "root_link"


def write_urdf(model: pin.Model, frames: Iterable[str] = ()) -> str:
    """The model with revolute and prismatic joints, its `frames` as massless links of their names; all digits kept.

    The link that joint X moves is called X_link. Raises ValueError for a joint that has more than one axis.
    """
    root = ET.Element("robot", name=model.name or "robot")
    floating = model.njoints > 1 and model.joints[1].nq == 7
    links = {0: ROOT, 1: ROOT} if floating else {0: ROOT}
    _link(root, ROOT, model.inertias[1] if floating else None)
    data = model.createData()
    for i in range(2 if floating else 1, model.njoints):
        joint = model.joints[i]
        if joint.nq != 1 or joint.nv != 1:
            raise ValueError(f"joint {model.names[i]!r}: expected one axis, got {joint.shortname()}")
        name = links[i] = f"{model.names[i]}_link"
        _link(root, name, model.inertias[i])
        S = _axis(joint, data.joints[i])
        turns = bool(np.any(S[3:]))
        placed = _joint(
            root, model.names[i], "revolute" if turns else "prismatic", links[model.parents[i]], name,
            model.jointPlacements[i],
        )  # fmt: skip
        ET.SubElement(placed, "axis", xyz=_numbers(S[3:] if turns else S[:3]))
        at, v = joint.idx_q, joint.idx_v
        limits = {
            "lower": model.lowerPositionLimit[at], "upper": model.upperPositionLimit[at],
            "effort": model.upperEffortLimit[v], "velocity": model.upperVelocityLimit[v],
        }  # fmt: skip
        ET.SubElement(placed, "limit", {key: _number(np.clip(value, -1e9, 1e9)) for key, value in limits.items()})
    for name in frames:
        frame = model.frames[model.getFrameId(name)]
        _link(root, name, None)
        _joint(root, f"{name}_fixed", "fixed", links[frame.parentJoint], name, frame.placement)
    return ET.tostring(root, encoding="unicode")


def _axis(joint: Any, data: Any) -> Any:
    """(6,) the twist that a unit velocity of the joint makes in its own frame, linear part first."""
    joint.calc(data, np.zeros(joint.idx_q + joint.nq), np.ones(joint.idx_v + joint.nv))
    return np.asarray(data.v.vector if hasattr(data.v, "vector") else data.v).ravel()


def _link(root: ET.Element, name: str, inertia: Any) -> None:
    link = ET.SubElement(root, "link", name=name)
    if inertia is None:
        return
    part, I = ET.SubElement(link, "inertial"), inertia.inertia
    ET.SubElement(part, "origin", xyz=_numbers(inertia.lever), rpy="0 0 0")
    ET.SubElement(part, "mass", value=_number(inertia.mass))
    parts = {"ixx": (0, 0), "ixy": (0, 1), "ixz": (0, 2), "iyy": (1, 1), "iyz": (1, 2), "izz": (2, 2)}
    ET.SubElement(part, "inertia", {key: _number(I[place]) for key, place in parts.items()})


def _joint(root: ET.Element, name: str, kind: str, parent: str, child: str, place: Any) -> ET.Element:
    joint = ET.SubElement(root, "joint", name=name, type=kind)
    ET.SubElement(joint, "parent", link=parent)
    ET.SubElement(joint, "child", link=child)
    rpy = pin.rpy.matrixToRpy(place.rotation)
    ET.SubElement(joint, "origin", xyz=_numbers(place.translation), rpy=_numbers(rpy))
    return joint


def _number(value: float) -> str:
    return repr(float(value))


def _numbers(values: Any) -> str:
    return " ".join(_number(value) for value in values)
