"""Robot, tool and scene become one compiled `MjModel`, and the Pinocchio model is built from it.

The compiled model is the single source: MuJoCo simulates it, Pinocchio computes with it, and `disagreement` measures
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
from .errors import ModelError, ModelMismatch, did_you_mean
from .qp import Array
from .resources import shipped, shipped_names

_FINITE = (
    "body_mass", "body_inertia", "body_pos", "body_ipos", "jnt_axis", "jnt_pos", "jnt_range", "dof_armature",
    "body_quat", "body_iquat", "dof_damping", "dof_frictionloss", "actuator_gear", "actuator_ctrlrange",
    "actuator_forcerange", "actuator_gainprm", "jnt_actfrcrange", "jnt_stiffness", "jnt_user", "qpos0", "qpos_spring",
    "site_pos", "site_quat", "geom_pos", "geom_quat", "geom_size", "geom_friction", "eq_data", "key_qpos",
)  # fmt: skip
AGREEMENT = 1e-8  # worst relative error of M, h, g, J, drift and pose at random states


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
    rotation = np.zeros(9)
    mujoco.mju_quat2Mat(rotation, np.asarray(quaternion, float))
    return pin.SE3(rotation.reshape(3, 3), np.array(position, float))


def _name(model: mujoco.MjModel, kind: mujoco.mjtObj, index: int) -> str:
    return mujoco.mj_id2name(model, kind, index) or f"{kind.name.removeprefix('mjOBJ_').lower()}{index}"


def body_name(model: mujoco.MjModel, body: int) -> str:
    """The name of a body's frame, also of a body without one."""
    return _name(model, mujoco.mjtObj.mjOBJ_BODY, body)


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
        name = _name(model, mujoco.mjtObj.mjOBJ_SITE, site)
        name = f"site:{name}" if out.existFrame(name) else name
        X = place_of[body] * _pose(model.site_pos[site], model.site_quat[site])
        out.addFrame(pin.Frame(name, joint_of[body], frame_of[body], X, pin.FrameType.OP_FRAME), False)
    return out


def _add_joint(out: pin.Model, model: mujoco.MjModel, joint: int, parent: int, X: pin.SE3) -> tuple[int, pin.SE3]:
    """Append one joint at `X`; answers its index and the body's place in the frame of the new joint."""
    kind, axis = model.jnt_type[joint], model.jnt_axis[joint].copy()
    anchor = pin.SE3(np.eye(3), model.jnt_pos[joint].copy())
    reference = model.qpos0[model.jnt_qposadr[joint]]
    name = _name(model, mujoco.mjtObj.mjOBJ_JOINT, joint)
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


def to_pinocchio(model: mujoco.MjModel, qpos: Array, qvel: Array) -> tuple[Array, Array]:
    """MuJoCo's (qpos, qvel) as Pinocchio's (q, v): quaternions xyzw, linear base velocity in the body's axes."""
    q, v = qpos.copy(), qvel.copy()
    for joint in np.flatnonzero(model.jnt_type < 2):
        at, dof = model.jnt_qposadr[joint], model.jnt_dofadr[joint]
        at += 3 if model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_FREE else 0
        q[at : at + 4] = np.roll(qpos[at : at + 4], -1)
        if model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_FREE:
            v[dof : dof + 3] = _pose(np.zeros(3), qpos[at : at + 4]).rotation.T @ qvel[dof : dof + 3]
    return q, v


def to_mujoco(model: mujoco.MjModel, q: Array, v: Array) -> tuple[Array, Array]:
    """Pinocchio's (q, v) as MuJoCo's (qpos, qvel): quaternions wxyz, linear base velocity in the world's axes."""
    qpos, qvel = np.array(q, float), np.array(v, float)
    for joint in np.flatnonzero(model.jnt_type < 2):
        at, dof = model.jnt_qposadr[joint], model.jnt_dofadr[joint]
        free = model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_FREE
        at += 3 if free else 0
        qpos[at : at + 4] = np.roll(qpos[at : at + 4], 1)
        if free:
            qvel[dof : dof + 3] = _pose(np.zeros(3), qpos[at : at + 4]).rotation @ qvel[dof : dof + 3]
    return qpos, qvel


def acceleration_to_pinocchio(model: mujoco.MjModel, qpos: Array, qvel: Array, qacc: Array) -> Array:
    """MuJoCo's qacc as Pinocchio's vdot: of a free base T qacc - w x v, its linear velocity seen from turning axes."""
    q, v = to_pinocchio(model, qpos, qvel)
    return np.asarray(_velocity_map(model, qpos) @ qacc + _acceleration_offset(model, q, v))


def acceleration_to_mujoco(model: mujoco.MjModel, q: Array, v: Array, vdot: Array) -> Array:
    """Pinocchio's vdot as MuJoCo's qacc."""
    qpos, _ = to_mujoco(model, q, v)
    return np.asarray(_velocity_map(model, qpos).T @ (vdot - _acceleration_offset(model, q, v)))


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
        one, other = (_name(model, mujoco.mjtObj.mjOBJ_SITE, site) for site in sites)
        found.append((one, other, gap))
    return found


def disagreement(model: mujoco.MjModel, other: pin.Model, states: int = 4, seed: int = 0) -> dict[str, float]:
    """Worst relative difference between MuJoCo and Pinocchio over random states, per quantity.

    M, h (Coriolis and gravity), g, and for the last sites of the model the body Jacobian, its drift and the pose.
    """
    rng = np.random.default_rng(seed)
    data, odata = mujoco.MjData(model), other.createData()
    worst = dict.fromkeys(("M", "h", "g", "J", "drift", "pose"), 0.0)
    n = model.nv
    for _ in range(states):
        qpos = model.qpos0.copy()
        mujoco.mj_integratePos(model, qpos, rng.uniform(-1.5, 1.5, n), 1.0)
        qvel = rng.uniform(-1.0, 1.0, n)
        q, v = to_pinocchio(model, qpos, qvel)
        map_v = _velocity_map(model, qpos)
        data.qpos[:], data.qvel[:] = qpos, qvel
        mujoco.mj_forward(model, data)
        M = np.zeros((n, n))
        mujoco.mj_fullM(model, data, M)
        pin.computeAllTerms(other, odata, q, v)
        drift = odata.M @ _acceleration_offset(model, q, v)
        _note(worst, "M", map_v.T @ odata.M @ map_v, M)
        _note(worst, "h", map_v.T @ (odata.nle + drift), data.qfrc_bias)
        data.qvel[:] = 0
        mujoco.mj_forward(model, data)
        _note(worst, "g", map_v.T @ pin.computeGeneralizedGravity(other, odata, q), data.qfrc_bias)
        data.qvel[:] = qvel
        mujoco.mj_forward(model, data)
        pin.computeAllTerms(other, odata, q, v)
        for site in range(max(0, model.nsite - 3), model.nsite):
            name = _name(model, mujoco.mjtObj.mjOBJ_SITE, site)
            frame = other.getFrameId(f"site:{name}" if other.existFrame(f"site:{name}") else name)
            pose = pin.updateFramePlacement(other, odata, frame)
            J = pin.getFrameJacobian(other, odata, frame, pin.LOCAL).reshape(6, n)  # one column comes as a vector
            a = pin.getFrameAcceleration(other, odata, frame, pin.LOCAL).vector
            J_mj, drift_mj = site_jacobian(model, data, site)
            a_free = J @ _acceleration_offset(model, q, v)
            _note(worst, "J", np.r_[J[3:], J[:3]] @ map_v, J_mj)
            _note(worst, "drift", np.r_[(a + a_free)[3:], (a + a_free)[:3]], drift_mj)
            here = np.c_[data.site_xmat[site].reshape(3, 3), data.site_xpos[site]]
            _note(worst, "pose", np.c_[pose.rotation, pose.translation], here)
    return worst


def require_agreement(model: mujoco.MjModel, other: pin.Model) -> float:
    """The worst of `disagreement`; raises ModelMismatch beyond `AGREEMENT`."""
    worst = disagreement(model, other)
    wrong = {name: error for name, error in worst.items() if not error <= AGREEMENT}
    if wrong:
        raise ModelMismatch(wrong, AGREEMENT)
    return max(worst.values())


def _note(worst: dict[str, float], name: str, ours: Array, theirs: Array) -> None:
    error = float(np.abs(ours - theirs).max(initial=0.0) / (1.0 + np.abs(theirs).max(initial=0.0)))
    worst[name] = max(worst[name], error) if error == error else np.inf


def site_jacobian(model: mujoco.MjModel, data: mujoco.MjData, site: int) -> tuple[Array, Array]:
    """Body Jacobian (6, nv) of a site and its drift Jdot v (6,), angular first, from MuJoCo alone."""
    R, p = data.site_xmat[site].reshape(3, 3), data.site_xpos[site].copy()
    return point_jacobian(model, data, model.site_bodyid[site], R, p)


def point_jacobian(model: mujoco.MjModel, data: mujoco.MjData, body: int, R: Array, p: Array) -> tuple[Array, Array]:
    """The same of a frame at (R, p) in the world that is fixed to a body."""
    Jp, Jr, dJp, dJr = (np.zeros((3, model.nv)) for _ in range(4))
    mujoco.mj_jac(model, data, Jp, Jr, p, body)
    mujoco.mj_jacDot(model, data, dJp, dJr, p, body)
    w, v = R.T @ Jr @ data.qvel, R.T @ Jp @ data.qvel
    # body axes turn with the body: d/dt(R' x) = R' xdot - w x (R' x)
    drift = np.r_[R.T @ dJr @ data.qvel, R.T @ dJp @ data.qvel - np.cross(w, v)]
    return np.r_[R.T @ Jr, R.T @ Jp], drift


def _velocity_map(model: mujoco.MjModel, qpos: Array) -> Array:
    """T with v_pinocchio = T v_mujoco."""
    T = np.eye(model.nv)
    for joint in np.flatnonzero(model.jnt_type == mujoco.mjtJoint.mjJNT_FREE):
        dof, at = model.jnt_dofadr[joint], model.jnt_qposadr[joint] + 3
        T[dof : dof + 3, dof : dof + 3] = _pose(np.zeros(3), qpos[at : at + 4]).rotation.T
    return T


def _acceleration_offset(model: mujoco.MjModel, q: Array, v: Array) -> Array:
    """b with a_pinocchio = T a_mujoco + b: the linear base velocity is seen from turning axes."""
    b = np.zeros(model.nv)
    for joint in np.flatnonzero(model.jnt_type == mujoco.mjtJoint.mjJNT_FREE):
        dof = model.jnt_dofadr[joint]
        b[dof : dof + 3] = -np.cross(v[dof + 3 : dof + 6], v[dof : dof + 3])
    return b
