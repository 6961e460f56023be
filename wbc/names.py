"""The robot, tool and scene that a spec names, and the frames, joints and keyframes that it expects of them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import pinocchio as pin

from . import files
from . import spec as specs
from .errors import ModelError, ModelMismatch, SpecError, did_you_mean
from .faults import Faults, Place
from .model import find
from .resources import shipped_folder
from .robot import Robot
from .urdf import Foot

MOVING = (specs.MotionTask, specs.ImpedanceTask, specs.AdmittanceTask)


def load_robot(spec: specs.Spec, faults: Faults) -> Robot:
    """The robot of a spec with its tool and scene. Raises SpecError."""
    found: dict[str, str] = {}
    named = (
        ("robot", "scenes/robots", spec.robot),
        ("tool", "scenes/tools", spec.tool),
        ("scene", "scenes", spec.scene),
    )
    for key, kind, name in named:
        if name is not None:
            with faults.at(key):
                found[key] = _file(spec, kind, name)
    faults.check()
    folders = _folders(spec, found)
    try:
        places = found["robot"], found.get("tool"), found.get("scene")
        robot = Robot.load(*places, spec.gravity, spec.robot, spec.base, _feet(spec), folders)
    except ModelError as error:
        faults.add(("base",) if "`base`" in str(error) else (_blamed(found, folders),), _told(error))
    else:
        if robot.nv:
            return robot
        faults.add(("robot",), "it has no joint; expected a robot that can move")
    raise SpecError(faults.found)


def _folders(spec: specs.Spec, found: Mapping[str, str]) -> tuple[Path, ...] | None:
    """Where files may be read: the spec's folder and what is shipped; more when asked. None: anywhere."""
    if spec.allow_outside:
        return None
    given = (spec.robot, spec.tool, spec.scene)
    more = [find("", name).parent.parent for name in given if name is not None and name.startswith("erd:")]
    more += [
        Path(name).expanduser().parent for key, name in found.items() if Path(name).suffix and spec.set_by_hand(key)
    ]
    return files.real([Path(spec.file).parent, *more, shipped_folder("scenes")])


def _feet(spec: specs.Spec) -> dict[str, Foot]:
    """What stands, by frame, as its contact says."""
    feet = {}
    for contact in spec.contacts.values():
        size = contact.sole or (0.0, 0.0)
        if contact.edge is not None:
            size = (contact.edge, 0.0) if contact.along == 0 else (0.0, contact.edge)
        if any(size) or contact.radius is not None:
            feet[contact.frame] = Foot(size, contact.radius or 0.0)
    return feet


def _file(spec: specs.Spec, kind: str, name: str) -> str:
    """Beside the spec, else a path, else a shipped one."""
    try:
        beside = Path(spec.file).parent / name
        return str(beside) if not name.startswith("erd:") and beside.is_file() else str(find(kind, name))
    except (OSError, ValueError):
        raise ModelError("expected the name of a file, got one that no file can have") from None


def _blamed(found: Mapping[str, str], folders: tuple[Path, ...] | None) -> str:
    """The first of robot, tool and scene with which they can no longer be put together."""
    given: dict[str, str] = {}
    for key in ("robot", "tool", "scene"):
        if key in found:
            given[key] = found[key]
            try:
                Robot.load(given["robot"], given.get("tool"), given.get("scene"), folders=folders)
            except ModelError:
                return key
    return "robot"


def _told(error: ModelError) -> str:
    """MuJoCo's complaints have line breaks, and do not say what they expected."""
    message = " ".join(str(error).split())
    if isinstance(error, ModelMismatch) or "flange" in message or "; expected" in message:
        return message
    return f"{message}; expected MJCF or URDF that MuJoCo accepts"


def check_names(spec: specs.Spec, robot: Robot, faults: Faults) -> None:
    """Every frame, joint and keyframe that the spec names is one of the robot, its tool or the scene."""
    names = _Names(spec, robot, faults)
    # a reference of a pose seen from a frame may be drawn in that frame, which moves
    seen_from = {task.target: task.to for task in spec.tasks.values() if isinstance(task, specs.RelativeTask)}
    for task in spec.tasks.values():
        if not isinstance(task, specs.RelativeTask):
            seen_from.pop(str(getattr(task, "target", "")), None)
    for name, contact in spec.contacts.items():  # nor is what is drawn on a body that moves
        if contact.with_ is not None:
            where = contact.on or (name if name in robot.frames else contact.with_)
            seen_from |= {str(target): where for target in contact.motion_targets.values()}
    for name, reference in spec.references.items():
        if reference.curve.in_ not in ("world", "self", seen_from.get(name)):
            names.frame(reference.curve.in_, ("references", name, reference.kind, "in"), fixed=True)
    for name, contact in spec.contacts.items():
        names.frame(contact.frame, ("contacts", name, "frame"), moves=True, body=True)
        if contact.ground is not None:
            names.frame(contact.ground, ("contacts", name, "ground"), fixed=True)
        if contact.with_ is not None:
            names.apart(contact.frame, contact.with_, ("contacts", name, "with"))
        places: dict[Place, str] = {("on",): contact.on} if contact.on is not None else {}
        for screw, motion in (contact.free or {}).items():
            if motion.screw.through != "self":
                places["free", screw, "screw", "through"] = motion.screw.through
        for key, place in places.items():
            names.held_by(contact.with_, place, ("contacts", name, *key))
    for name, task in spec.tasks.items():
        if isinstance(task, MOVING) and task.frame is not None:
            names.frame(task.frame, ("tasks", name, "frame"), moves=True, body=not isinstance(task, specs.MotionTask))
        if isinstance(task, specs.RelativeTask | specs.GazeTask):
            names.pair(task, name)
        if isinstance(task, specs.PostureTask):
            names.pose(task.target, ("tasks", name, "target"), "start")
    if spec.plant.payload_at is not None:
        names.frame(spec.plant.payload_at, ("plant", "payload_at"), moves=True)
    for name, push in spec.plant.pushes.items():
        names.frame(push.frame, ("plant", "pushes", name, "frame"), moves=True, body=True)
    for body in spec.plant.moves:
        names.mocap(body, ("plant", "moves", body))
    for body in spec.plant.paths:
        names.carried(body, ("plant", "paths", body))
    if spec.start is not None:
        names.pose(spec.start, ("start",))
    for limit in ("torque", "torque_rate", "velocity", "acceleration"):
        value = getattr(spec.limits, limit)
        if isinstance(value, dict):
            names.joints(value, ("limits", limit))
        elif isinstance(value, tuple) and len(value) != robot.nu:
            faults.add(("limits", limit), f"expected {robot.nu} numbers, one a joint, got {len(value)}")


@dataclass(frozen=True)
class _Names:
    """Names of one spec beside those of its robot."""

    spec: specs.Spec
    robot: Robot
    faults: Faults

    def frame(self, name: str, path: Place, fixed: bool = False, moves: bool = False, body: bool = False) -> None:
        """Frames are named by the robot, its tool and the scene; those that are left out may be what is wrong."""
        if name not in self.robot.frames:
            known = [frame for frame in self.robot.frames if frame != "universe"]
            without = [key for key in ("tool", "scene") if getattr(self.spec, key) is None]
            hint = f" (the spec names no {' and no '.join(without)})" if without else ""
            self.faults.add(path, f"no frame named {name!r}{did_you_mean(name, known)}{hint}")
            return
        frame = self.robot.model.frames[self.robot.frame_id(name)]
        if fixed:
            with self.faults.at(*path):
                self.robot.fixed_pose(name)
        elif moves and not frame.parentJoint:
            self.faults.add(path, f"frame {name!r} is fixed to the world; expected one of the robot or its tool")
        elif body and frame.type == pin.FrameType.JOINT:
            self.faults.add(path, f"frame {name!r} is that of a joint; expected a body or a site")

    def pair(self, task: specs.RelativeTask | specs.GazeTask, name: str) -> None:
        """Two frames that the robot moves against one another."""
        key = "to" if isinstance(task, specs.RelativeTask) else "at"
        other = getattr(task, key)
        self.frame(task.frame, ("tasks", name, "frame"), moves=True)
        if not isinstance(other, str):
            return
        self.frame(other, ("tasks", name, key))
        if not {task.frame, other} <= set(self.robot.frames):
            return
        if self.robot.wrench_map(task.frame, other) is not None:
            message = f"{task.frame!r} and {other!r} are on one link; expected a frame that moves against it"
            self.faults.add(("tasks", name, key), message)

    def apart(self, frame: str, other: str, path: Place) -> None:
        """A frame that the robot moves against another one, and against the world."""
        self.frame(other, path, body=True)
        if not {frame, other} <= set(self.robot.frames):
            return
        if not self.robot.model.frames[self.robot.frame_id(other)].parentJoint:
            self.faults.add(path, f"{other!r} is fixed to the world; expected a frame that moves, or `on: {other}`")
        elif self.robot.wrench_map(frame, other) is not None:
            self.faults.add(path, f"{frame!r} and {other!r} are on one link; expected a frame that moves against it")

    def held_by(self, body: str | None, place: str, path: Place) -> None:
        """A place where a contact is held: fixed to the world, or on the link of `body`."""
        self.frame(place, path, fixed=body is None)
        if body is None or not {body, place} <= set(self.robot.frames):
            return
        if self.robot.wrench_map(body, place) is None:
            self.faults.add(path, f"{place!r} is not on the link of {body!r}; expected a frame that moves with it")

    def mocap(self, name: str, path: Place) -> None:
        """A body that the simulator can move by hand."""
        mj = self.robot.mujoco
        known = [mj.body(i).name for i in range(mj.nbody) if mj.body_mocapid[i] >= 0] if mj is not None else []
        if name not in known:
            hint = did_you_mean(name, known) or '; expected one with mocap="true", of which the scene has none'
            self.faults.add(path, f"no mocap body named {name!r}{hint}")

    def carried(self, name: str, path: Place) -> None:
        """A body of the scene that moves freely in the simulator, and is at rest for the controller."""
        mj = self.robot.plant
        joints = range(0 if mj is None else mj.njnt)
        known = [mj.body(int(mj.jnt_bodyid[joint])).name for joint in joints if mj.jnt_type[joint] == 0]
        known = [body for body in known if not self.robot.model.frames[self.robot.frame_id(body)].parentJoint]
        if name not in known:
            hint = did_you_mean(name, known) or "; expected one with a free joint, of which the scene has none"
            self.faults.add(path, f"no body named {name!r} that moves freely{hint}")

    def pose(self, pose: str | Mapping[str, float], path: Place, *more: str) -> None:
        known = [*self.robot.keyframes, *more]
        if not isinstance(pose, str):
            self.joints(pose, path)
        elif pose not in known:
            self.faults.add(path, f"no keyframe named {pose!r}{did_you_mean(pose, known)}")

    def joints(self, joints: Mapping[str, float], path: Place) -> None:
        for joint in joints:
            if joint not in self.robot.joints:
                self.faults.add((*path, joint), f"no joint named {joint!r}{did_you_mean(joint, self.robot.joints)}")
