"""Robot, tool and scene become one compiled `MjModel`, and the Pinocchio model is built from it.

The compiled model is the single source: MuJoCo simulates it, Pinocchio computes with it, and `crosscheck` measures
at load that both mean the same robot. Pinocchio's own MJCF reader is never used: it drops fixed bodies, sites and
limits without a word.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import mujoco
import numpy as np
import pinocchio as pin

from . import files, material, urdf
from .convention import rotation
from .errors import ModelError, did_you_mean
from .qp import Array
from .resources import shipped, shipped_names

_FINITE = (
    "body_mass", "body_inertia", "body_pos", "body_ipos", "jnt_axis", "jnt_pos", "jnt_range", "dof_armature",
    "body_quat", "body_iquat", "dof_damping", "dof_frictionloss", "actuator_gear", "actuator_ctrlrange",
    "actuator_forcerange", "actuator_gainprm", "jnt_actfrcrange", "jnt_stiffness", "jnt_user", "qpos0", "qpos_spring",
    "site_pos", "site_quat", "geom_pos", "geom_quat", "geom_size", "geom_friction", "eq_data", "key_qpos",
)  # fmt: skip


def find(kind: str, name: str) -> Path:
    """The file of a robot, tool or scene given by shipped name, path, or `erd:NAME`. Raises ModelError."""
    if name.startswith("erd:"):
        return urdf.find_example(name[4:])
    path = Path(name).expanduser()
    if path.suffix:
        if path.is_file():
            return path
        raise ModelError(f"no file {name!r}; expected a path, or one of {', '.join(shipped_names(kind, '.xml'))}")
    if found := shipped(kind, name, ".xml"):
        return found
    raise ModelError(
        f"no {kind.split('/')[-1].rstrip('s')} named {name!r}{did_you_mean(name, shipped_names(kind, '.xml'))}"
    )


class Composition(NamedTuple):
    """One specification of robot, tool and scene; the robot's keyframes; the joints that are not the robot's."""

    spec: mujoco.MjSpec
    keys: dict[str, Array]  # name -> qpos in MuJoCo's order
    passive: tuple[str, ...]  # the scene's joints and the tool's without an actuator: a hinge, a wheel


def compose(
    robot: str | Path,
    tool: str | None = None,
    scene: str | None = None,
    base: str | None = None,
    feet: Mapping[str, urdf.Foot] | None = None,
    folders: Sequence[Path] | None = None,
) -> Composition:
    """Robot, tool and scene put together.

    Of a robot in URDF, `base` is "fixed" or "floating", and `feet` are by frame what it stands on (see `urdf`).
    `folders`: where files may be read (see `files`); None: anywhere.

    The scene is the parent, so that its options hold; the robot stands at the world's origin or at the scene's site
    `robot`; the tool hangs on the robot's site `flange`. Position servos become motors. Equalities of the scene that
    name a site which is not there (of another tool) are left out.
    """
    arm = _read(file := find("scenes/robots", str(robot)), folders, base)
    if file.suffix == ".urdf":
        urdf.add_feet(arm, feet or {})
    keys = {key.name: np.array(key.qpos, float) for key in arm.keys}
    for key in list(arm.keys):
        arm.delete(key)
    _torque_motors(arm)
    passive: list[str] = []
    with _composing():
        if tool:
            if arm.site("flange") is None:
                raise ModelError(f"robot {str(robot)!r} has no site 'flange' to carry the tool {tool!r}")
            hand = _read(find("scenes/tools", tool), folders)
            driven = {actuator.target for actuator in hand.actuators}
            passive += _named(joint for joint in hand.joints if joint.name not in driven)
            arm.attach(hand, prefix="", site="flange")
        if not scene:
            arm.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
            return Composition(arm, keys, tuple(passive))
        world = _read(find("scenes", scene), folders)
        passive += _named(world.joints)
        mount = world.site("robot")
        place = {"site": mount} if mount is not None else {"frame": world.worldbody.add_frame()}
        world.attach(arm, prefix="", **place)
        for equality in list(world.equalities):
            ends = (equality.name1, equality.name2)
            if equality.objtype == mujoco.mjtObj.mjOBJ_SITE and any(world.site(end) is None for end in ends):
                world.delete(equality)
        material.add_pairs(world)
        return Composition(world, keys, tuple(passive))


def _named(joints: Iterable[Any]) -> list[str]:
    """Names of joints; one without a name is called after its body."""
    names = []
    for joint in joints:
        joint.name = joint.name or f"{joint.parent.name or 'body'}_joint"
        names.append(joint.name)
    return names


def lock(composition: Composition) -> mujoco.MjSpec:
    """The specification without the joints that are not the robot's: their bodies stay where they are at rest.

    What drives, senses or couples these joints goes with them.
    """
    spec, gone = composition.spec, set(composition.passive)
    for element in [*spec.actuators, *spec.equalities, *spec.sensors]:
        kind = type(element).__name__
        ends = {getattr(element, key, None) for key in ("target", "name1", "name2", "objname")}
        of_joint = kind == "MjsActuator" or element.objtype in (mujoco.mjtObj.mjOBJ_JOINT, mujoco.mjtObj.mjOBJ_UNKNOWN)
        if of_joint and ends & gone:
            spec.delete(element)
    for name in composition.passive:
        spec.delete(spec.joint(name))
    return spec


@contextmanager
def quietly() -> Iterator[None]:
    """Without MuJoCo's warnings, which its default handler would write to a file in the working folder."""
    before = mujoco.get_mju_user_warning()
    mujoco.set_mju_user_warning(lambda message: None)
    try:
        yield
    finally:
        mujoco.set_mju_user_warning(before)


@contextmanager
def _composing() -> Iterator[None]:
    """MuJoCo warns that a composition without prefixes may not survive saving as XML; it is compiled, never saved."""
    with quietly(), warnings.catch_warnings():
        warnings.filterwarnings("ignore", message="Attaching a spec with an empty prefix")
        warnings.filterwarnings("ignore", message="Attach conflict when attaching")  # the scene's options hold
        yield


def compile_model(spec: mujoco.MjSpec) -> mujoco.MjModel:
    """Compile; MuJoCo's complaint becomes a ModelError. A simulator that goes on after a NaN is not wanted."""
    spec.option.disableflags |= mujoco.mjtDisableBit.mjDSBL_AUTORESET
    try:
        with _composing():
            model = spec.compile()
    except (ValueError, RuntimeError) as error:
        raise ModelError(f"MuJoCo refuses the model: {error}") from error
    material.settle(model)
    numbers = {name: getattr(model, name) for name in _FINITE}
    for name, values in (numbers | {"timestep": model.opt.timestep, "gravity": model.opt.gravity}).items():
        if not np.isfinite(values).all():
            raise ModelError(f"the model holds a number that is not finite, in {name}; expected finite ones")
    return model


def _read(path: Path, folders: Sequence[Path] | None, base: str | None = None) -> mujoco.MjSpec:
    if base is not None and path.suffix != ".urdf":
        raise ModelError("`base` is for URDF: an MJCF file says it by a free joint; expected none")
    try:
        files.judge(path, folders)
        with _composing():
            return urdf.read(path, base, folders) if path.suffix == ".urdf" else mujoco.MjSpec.from_file(str(path))
    except OSError as error:
        raise ModelError(f"{path}: cannot be read: {error.strerror or error}; expected a file that can") from error
    except (ValueError, RuntimeError) as error:
        raise ModelError(f"{path}: {error}") from error


def _torque_motors(spec: mujoco.MjSpec) -> None:
    for actuator in spec.actuators:
        if actuator.biastype != mujoco.mjtBias.mjBIAS_NONE:
            actuator.biastype = mujoco.mjtBias.mjBIAS_NONE
            actuator.gaintype = mujoco.mjtGain.mjGAIN_FIXED
            actuator.gainprm = np.eye(1, actuator.gainprm.size)[0]
            actuator.biasprm = np.zeros(actuator.biasprm.size)
            actuator.ctrllimited = False


def _pose(position: Array, quaternion: Array) -> pin.SE3:
    return pin.SE3(rotation(quaternion), np.array(position, float))


def object_name(model: mujoco.MjModel, kind: mujoco.mjtObj, index: int) -> str:
    """The name of an object of the model, also of one without."""
    return mujoco.mj_id2name(model, kind, index) or f"{kind.name.removeprefix('mjOBJ_').lower()}{index}"


def body_name(model: mujoco.MjModel, body: int) -> str:
    """The name of a body's frame, also of a body without one."""
    return object_name(model, mujoco.mjtObj.mjOBJ_BODY, body)


def pinocchio_model(model: mujoco.MjModel) -> pin.Model:
    """The same tree in Pinocchio: one joint for each of MuJoCo's, in its order; bodies and sites as frames.

    A site whose name a body already has is called `site:NAME`, for Pinocchio looks frames up by name alone.
    """
    out = pin.Model()
    out.gravity.linear = (
        np.zeros(3) if model.opt.disableflags & mujoco.mjtDisableBit.mjDSBL_GRAVITY else model.opt.gravity.copy()
    )
    joint_of = [0] * model.nbody  # the last joint that moves a body
    place_of = [pin.SE3.Identity()] * model.nbody  # the body in that joint's frame
    frame_of = [0] * model.nbody
    for body in range(1, model.nbody):
        above = model.body_parentid[body]
        parent, X = joint_of[above], place_of[above] * _pose(model.body_pos[body], model.body_quat[body])
        first = model.body_jntadr[body]
        for joint in range(first, first + model.body_jntnum[body]):
            parent, X = _add_joint(out, model, joint, parent, X)
        joint_of[body], place_of[body] = parent, X
        inertia = pin.Inertia(model.body_mass[body], np.zeros(3), np.diag(model.body_inertia[body]))
        if parent:
            out.appendBodyToJoint(parent, inertia, X * _pose(model.body_ipos[body], model.body_iquat[body]))
        frame_of[body] = int(out.addBodyFrame(body_name(model, body), parent, X, -1))
    for site in range(model.nsite):
        body = model.site_bodyid[site]
        name = object_name(model, mujoco.mjtObj.mjOBJ_SITE, site)
        name = f"site:{name}" if out.existFrame(name) else name
        X = place_of[body] * _pose(model.site_pos[site], model.site_quat[site])
        out.addFrame(pin.Frame(name, joint_of[body], frame_of[body], X, pin.FrameType.OP_FRAME), False)
    return out


def _add_joint(out: pin.Model, model: mujoco.MjModel, joint: int, parent: int, X: pin.SE3) -> tuple[int, pin.SE3]:
    """Append one joint at `X`; answers its index and the body's place in the frame of the new joint."""
    kind, axis = model.jnt_type[joint], model.jnt_axis[joint].copy()
    anchor = pin.SE3(np.eye(3), model.jnt_pos[joint].copy())
    reference = model.qpos0[model.jnt_qposadr[joint]]
    name = object_name(model, mujoco.mjtObj.mjOBJ_JOINT, joint)
    free, ball, slide = mujoco.mjtJoint.mjJNT_FREE, mujoco.mjtJoint.mjJNT_BALL, mujoco.mjtJoint.mjJNT_SLIDE
    if kind == free:
        index, X = out.addJoint(parent, pin.JointModelFreeFlyer(), pin.SE3.Identity(), name), pin.SE3.Identity()
    elif kind == ball:
        index, X = out.addJoint(parent, pin.JointModelSpherical(), X * anchor, name), anchor.inverse()
    elif kind == slide:
        back = pin.SE3(np.eye(3), -reference * axis)
        index, X = out.addJoint(parent, pin.JointModelPrismaticUnaligned(axis), X * back, name), pin.SE3.Identity()
    else:
        back = pin.SE3(pin.exp3(-reference * axis), np.zeros(3))
        index = out.addJoint(parent, pin.JointModelRevoluteUnaligned(axis), X * anchor * back, name)
        X = anchor.inverse()
    out.addJointFrame(index)
    place = out.joints[index]
    first = model.jnt_dofadr[joint]
    for k in range(place.nv):
        out.armature[place.idx_v + k] = model.dof_armature[first + k]
    return int(index), X


def torque_limits(model: mujoco.MjModel) -> tuple[Array, Array]:
    """(nv,), (nv,) lowest and highest torque of each velocity [N m]: the tightest of all that the model states."""
    high = np.full(model.nv, np.inf)
    low = -high
    for actuator in range(model.nu):
        if model.actuator_trntype[actuator] != mujoco.mjtTrn.mjTRN_JOINT:
            continue
        dof, gear = model.jnt_dofadr[model.actuator_trnid[actuator, 0]], model.actuator_gear[actuator, 0]
        ranges = []
        if model.actuator_forcelimited[actuator]:
            ranges.append(gear * model.actuator_forcerange[actuator])
        if model.actuator_ctrllimited[actuator]:
            ranges.append(gear * model.actuator_gainprm[actuator, 0] * model.actuator_ctrlrange[actuator])
        for bounds in ranges:
            low[dof], high[dof] = max(low[dof], min(bounds)), min(high[dof], max(bounds))
    for joint in np.flatnonzero(model.jnt_actfrclimited):
        dof, bounds = model.jnt_dofadr[joint], model.jnt_actfrcrange[joint]
        low[dof], high[dof] = max(low[dof], bounds[0]), min(high[dof], bounds[1])
    return low, high


def open_welds(model: mujoco.MjModel, qpos: Array) -> list[tuple[str, str, float]]:
    """Of every weld or connection of two sites, their names and how far they are apart at `qpos` [m, rad]."""
    data = mujoco.MjData(model)
    data.qpos[:] = qpos
    mujoco.mj_kinematics(model, data)
    found = []
    for i in np.flatnonzero((model.eq_objtype == mujoco.mjtObj.mjOBJ_SITE) & model.eq_active0):
        sites = model.eq_obj1id[i], model.eq_obj2id[i]
        first, second = (pin.SE3(data.site_xmat[s].reshape(3, 3), data.site_xpos[s]) for s in sites)
        apart = first.actInv(second)
        turn = 0.0 if model.eq_type[i] == mujoco.mjtEq.mjEQ_CONNECT else np.linalg.norm(pin.log3(apart.rotation))
        gap = float(max(np.linalg.norm(apart.translation), turn))
        one, other = (object_name(model, mujoco.mjtObj.mjOBJ_SITE, site) for site in sites)
        found.append((one, other, gap))
    return found
