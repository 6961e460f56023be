"""Robots described in URDF, of which MuJoCo reads the tree: with the base, the poses and the feet that URDF leaves out.

- The base. A URDF does not say whether its first link is bolted to the world. It floats where an SRDF beside it gives
  `root_joint` a pose, or where it is told to.
- Poses. `group_state` of these SRDF files become keyframes, the first of them also `home`.
- Feet. Shapes are dropped (they are meshes, in foreign formats); what stands is given by its contact: a sphere of its
  radius, or four of `TIP` at the corners of its sole, with the contact of things that stand (`scenes/floor.xml`).
"""

from __future__ import annotations

import importlib.metadata
import math
import xml.etree.ElementTree as ET
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import mujoco
import numpy as np

from . import files
from .errors import ModelError, did_you_mean
from .qp import Array

ROOT = "root_joint"  # what an SRDF calls the joint of a floating base
LEAST = 1e-9  # [kg m^2] added where a link with a mass has an inertia of zero about an axis
TIP = 0.005  # [m] radius of the spheres under a sole
SUNK = 1e-6  # [m] and more, so that what starts on a floor touches it whatever rounding says


class Foot(NamedTuple):
    """What stands at a frame: a sphere of `radius` around it, or a rectangle in its plane z = 0 [m].

    Of a rectangle without a length or a width, an edge, the radius is that of its ends, which the frame lies between.
    """

    size: tuple[float, float] = (0.0, 0.0)
    radius: float = 0.0

    def spheres(self) -> tuple[float, list[Array]]:
        """Their radius and their centres."""
        rounded = self.radius if self.size == (0.0, 0.0) or self.radius else TIP
        up = 0.0 if self.radius else TIP
        corners = {(x * self.size[0], y * self.size[1]) for x in (0.5, -0.5) for y in (0.5, -0.5)}
        return rounded, [np.array([x, y, up]) for x, y in sorted(corners)]


def find_example(name: str) -> Path:
    """The URDF of that name in the package example-robot-data; `ur5` finds `ur5_robot`, `talos` `talos_reduced`."""
    try:
        package = importlib.metadata.distribution("example-robot-data")
    except importlib.metadata.PackageNotFoundError:
        message = f"erd:{name} needs the package example-robot-data: pip install 'wbc[robots]'"
        raise ModelError(message) from None
    files = {path.stem: path for path in map(Path, package.files or ()) if path.suffix == ".urdf"}
    for stem in (name, f"{name}_robot", f"{name}_reduced"):
        if stem in files:
            return Path(str(package.locate_file(str(files[stem]))))
    alike = sorted(stem for stem in files if name and stem.lower().startswith(name.lower()))
    short = (stem.removesuffix(tail) for tail in ("_robot", "_reduced") for stem in files)
    hint = f"; did you mean {alike[0]!r}?" if alike else did_you_mean(name, dict.fromkeys([*short, *files]))
    raise ModelError(f"example-robot-data has no robot {name!r}{hint}")


def read(path: Path, base: str | None = None, folders: Sequence[Path] | None = None) -> mujoco.MjSpec:
    """The tree of a URDF with a motor for each joint, its limits of velocity, and its poses as keyframes.

    `base`: "fixed" or "floating"; None: as an SRDF has it. `folders`: where an SRDF may be read; None: anywhere.
    Raises what MuJoCo and the parser raise. The file has passed `files.judge`.
    """
    root = ET.parse(path).getroot()
    for link in root.iter("link"):
        for shape in [*link.findall("visual"), *link.findall("collision")]:
            link.remove(shape)
        _settle_inertia(link)
    _check(root)
    for extension in [each for each in root if each.tag not in ("link", "joint")]:  # of ROS, of Gazebo, of MuJoCo
        root.remove(extension)
    ET.SubElement(
        ET.SubElement(root, "mujoco"), "compiler", strippath="false", fusestatic="false", balanceinertia="true"
    )
    spec = mujoco.MjSpec.from_string(ET.tostring(root, encoding="unicode"))
    spec.nuser_jnt = max(spec.nuser_jnt, 1)
    velocity = {
        joint.get("name"): limit.get("velocity") for joint in root.iter("joint") for limit in joint.findall("limit")
    }
    for joint in spec.joints:
        if velocity.get(joint.name):
            joint.userdata = [float(velocity[joint.name] or 0.0)]
        actuator = spec.add_actuator(name=joint.name, target=joint.name, trntype=mujoco.mjtTrn.mjTRN_JOINT)
        actuator.gainprm[0] = 1.0
    poses = _poses(path, {joint.name for joint in spec.joints}, folders)
    if base == "floating" or (base is None and any(ROOT in pose for pose in poses.values())):
        spec.worldbody.first_body().add_freejoint(name=ROOT)
    if poses:
        _add_keys(spec, poses)
    return spec


def _check(root: ET.Element) -> None:
    """What MuJoCo takes without a word: limits that are no numbers, or less than none, and links in several pieces."""
    for joint in root.iter("joint"):
        for key, text in [item for limit in joint.findall("limit") for item in limit.items()]:
            if not math.isfinite(number := float(text)) or (number < 0 and key in ("effort", "velocity")):
                kind = "finite number" if key in ("lower", "upper") else "number of at least 0"
                raise ModelError(f"joint {joint.get('name')!r} has the limit {key}={text[:40]!r}; expected a {kind}")
    children = {child.get("link") for joint in root.iter("joint") for child in joint.findall("child")}
    roots = [name for link in root.findall("link") if (name := link.get("name")) not in children]
    if len(roots) > 1:
        raise ModelError(f"links {roots[0]!r} and {roots[1]!r} hang on no joint; expected one root of the tree")


def _settle_inertia(link: ET.Element) -> None:
    """What MuJoCo refuses of links that stand for places: an inertia of zero is left out, or `LEAST` beside a mass.

    Out of what no body can have MuJoCo makes that of a sphere (`balanceinertia`): of 1e-6 kg m^2 it matters not.
    """
    for inertial in link.findall("inertial"):
        mass, inertia = inertial.find("mass"), inertial.find("inertia")
        if mass is None or inertia is None:
            continue
        I = np.array([[float(inertia.get(f"i{min(a, b)}{max(a, b)}", 0.0)) for a in "xyz"] for b in "xyz"])
        if float(mass.get("value", 0.0)) == 0.0 and not I.any():
            link.remove(inertial)
        elif abs(np.linalg.eigvalsh(I)[0]) <= 1e-9 * np.trace(I) or not I.any():
            for axis in "xyz":
                inertia.set(f"i{axis}{axis}", repr(float(inertia.get(f"i{axis}{axis}", 0.0)) + LEAST))


def _poses(path: Path, joints: set[str], allowed: Sequence[Path] | None) -> dict[str, dict[str, list[float]]]:
    """Poses of the SRDF that belongs to a URDF: of its name, else the one that places most of its joints."""
    best: tuple[tuple[bool, int], dict[str, dict[str, list[float]]]] = ((False, 0), {})
    folders = [path.parent, path.parent.parent / "srdf"]
    for file in sorted(file for folder in folders if folder.is_dir() for file in folder.glob("*.srdf")):
        if not files.readable(file, allowed):
            continue
        files.elements(file)
        poses = {}
        for state in ET.parse(file).getroot().iter("group_state"):
            pose = {str(j.get("name")): [float(x) for x in str(j.get("value")).split()] for j in state.iter("joint")}
            if all(name in joints and len(x) == 1 for name, x in pose.items() if name != ROOT):
                poses[str(state.get("name"))] = pose
        placed = max((len(pose) for pose in poses.values()), default=0)
        if poses:
            best = max(best, ((file.stem == path.stem, placed), poses), key=lambda found: found[0])
    return best[1]


def _add_keys(spec: mujoco.MjSpec, poses: Mapping[str, Mapping[str, list[float]]]) -> None:
    """Keyframes; what a pose leaves out stands at zero."""
    model = spec.compile()
    for name, pose in [("home", next(iter(poses.values()))), *poses.items()]:
        qpos = model.qpos0.copy()
        for joint, value in pose.items():
            if mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_JOINT, joint) < 0:
                continue  # the root of a base that is fixed
            at = int(model.joint(joint).qposadr[0])
            # SRDF has x y z, then the quaternion x y z w
            values = [*value[:3], value[6], *value[3:6]] if joint == ROOT else value
            qpos[at : at + len(values)] = values
        if not any(key.name == name for key in spec.keys):
            spec.add_key(name=name, qpos=qpos)


def add_feet(spec: mujoco.MjSpec, feet: Mapping[str, Foot]) -> None:
    """Spheres without mass where a robot stands; a frame that is no link of it is left to those who check names."""
    for frame, foot in feet.items():
        body = spec.body(frame)
        if body is None:
            continue
        radius, centres = foot.spheres()
        for i, centre in enumerate(centres):
            geom = body.add_geom(name=f"{frame}_tip{i}", type=mujoco.mjtGeom.mjGEOM_SPHERE, pos=centre, mass=0.0)
            geom.size[0], geom.friction[0], geom.condim = radius + SUNK, 0.8, 3
            geom.solref, geom.contype, geom.conaffinity = [0.004, 1.0], 1, 2
            geom.rgba = [0.15, 0.16, 0.18, 1.0]
