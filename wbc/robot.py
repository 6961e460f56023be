"""The robot as the controller sees it: its model, names and limits."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin

from . import model as models
from .convention import acceleration_to_mujoco, acceleration_to_pinocchio, to_mujoco, to_pinocchio
from .crosscheck import require_agreement
from .errors import ModelError, NameNotFound
from .frame import Mounts, mounts
from .qp import Array
from .state import State, Terms
from .urdf import Foot


@dataclass(frozen=True)
class Robot:
    """A robot's model, names and limits. Make one with `load` or `from_pinocchio`.

    `gravity`: who adds g(q) to the torque, "controller" (this package) or "robot" (its driver; limits hold for the
    sum).
    `base`: how many of the velocities, the first ones, no motor drives: 0, or 6 of a floating base, whose q begins with
    (x, y, z, quaternion xyzw) and whose v with (v, w) in the axes of the base: a robot's own, or a free body that comes
    first in the model and that arms are to carry. `joints` are the nu = nv - base others.
    Limits are (nu,): tau [N m], q [rad or m], v [rad/s or m/s], infinite where the model states none.
    """

    name: str
    model: pin.Model
    joints: tuple[str, ...]
    tau_min: Array
    tau_max: Array
    q_min: Array
    q_max: Array
    v_max: Array
    keyframes: dict[str, Array] = field(default_factory=dict)
    gravity: str = "controller"
    damping: Array | None = None  # (nv,) [N m s/rad]
    mujoco: Any = None  # the compiled MjModel of the robot's own joints, where there is one
    plant: Any = None  # the same with the joints of the scene and the tool's passive ones, for the simulator alone
    model_error: float = 0.0  # worst disagreement of MuJoCo and Pinocchio at load
    has_scene: bool = False
    base: int = 0
    _ids: dict[str, int] = field(default_factory=dict, init=False, repr=False)
    _maps: dict[tuple[str, str], Array | None] = field(default_factory=dict, init=False, repr=False)
    _axes: dict[str, tuple[int, ...]] = field(default_factory=dict, init=False, repr=False)
    _pairs: list[Any] = field(default_factory=list, init=False, repr=False)

    def __post_init__(self) -> None:
        if self.gravity not in ("controller", "robot"):
            raise ModelError(f"gravity: expected 'controller' or 'robot' (who adds it), got {self.gravity!r}")
        if self.base and self.gravity == "robot":
            raise ModelError("gravity: no driver adds it for a robot with a floating base; expected 'controller'")
        self._ids.update({frame.name: i for i, frame in enumerate(self.model.frames)})

    @classmethod
    def load(
        cls,
        robot: str,
        tool: str | None = None,
        scene: str | None = None,
        gravity: str = "controller",
        name: str = "",
        base: str | None = None,
        feet: Mapping[str, Foot] | None = None,
        folders: Sequence[Path] | None = None,
    ) -> Robot:
        """A robot with its tool, in its scene, from shipped names, paths or `erd:NAME`.

        Of a URDF `base` is "fixed" or "floating" (None: floating where an SRDF beside it gives `root_joint` a pose),
        and `feet` tell by frame what the simulator has it stand on, as shapes are dropped.
        `folders`: where model files and what they name may be read (see `files`); None: anywhere.
        Raises ModelError for files that cannot be used, ModelMismatch when MuJoCo and Pinocchio disagree.
        """
        composed = models.compose(robot, tool, scene, base, feet, folders)
        plant = mj = models.compile_model(composed.spec)
        if composed.passive:
            mj = models.compile_model(models.lock(composed))
        model = models.pinocchio_model(mj)
        error = require_agreement(mj, model)
        low, high = models.torque_limits(mj)
        q_min, q_max = _position_limits(mj)
        keyframes = {"home": mj.qpos0} | {name: qpos for name, qpos in composed.keys.items() if qpos.size == mj.nq}
        damping = np.array([np.ravel(d)[0] for d in mj.dof_damping]) if mj.nv else np.zeros(0)
        floating = _floating(model)
        return cls(
            name=name or str(robot),
            model=model,
            joints=_driven(model),
            tau_min=low[floating:],
            tau_max=high[floating:],
            q_min=q_min[floating:],
            q_max=q_max[floating:],
            v_max=_velocity_limits(mj)[floating:],
            keyframes={name: to_pinocchio(mj, qpos, np.zeros(mj.nv))[0] for name, qpos in keyframes.items()},
            gravity=gravity,
            damping=damping if damping.any() else None,
            mujoco=mj,
            plant=plant,
            model_error=error,
            has_scene=scene is not None,
            base=floating,
        )

    @classmethod
    def from_pinocchio(cls, model: pin.Model, gravity: str = "controller") -> Robot:
        """A robot from a Pinocchio model of one's own; limits are the model's."""
        damping = np.array(model.damping) if np.any(model.damping) else None
        base = _floating(model)
        return cls(
            name=model.name,
            model=model,
            joints=_driven(model),
            tau_min=_stated(model.lowerEffortLimit)[base:],
            tau_max=_stated(model.upperEffortLimit)[base:],
            q_min=_per_velocity(model, model.lowerPositionLimit, -np.inf)[base:],
            q_max=_per_velocity(model, model.upperPositionLimit, np.inf)[base:],
            v_max=_stated(model.upperVelocityLimit)[base:],
            keyframes={"home": pin.neutral(model)}
            | {k.key(): np.array(k.data()) for k in model.referenceConfigurations},
            gravity=gravity,
            damping=damping,
            base=base,
        )

    @cached_property
    def nu(self) -> int:
        """Number of motors."""
        return len(self.joints)

    @cached_property
    def nv(self) -> int:
        return int(self.model.nv)

    @cached_property
    def floats(self) -> bool:
        """Whether all of it moves with a floating base: not of arms that stand on the world and carry one."""
        return bool(self.base) and all(1 in self.model.supports[i] for i in range(1, self.model.njoints))

    @cached_property
    def unit_parts(self) -> tuple[slice, ...]:
        """Where in q unit vectors stand: quaternions, and (cos, sin) of joints that turn without end."""
        parts = []
        for joint in list(self.model.joints)[1:]:
            if joint.nq > joint.nv:
                stop = joint.idx_q + joint.nq  # they come last
                parts.append(slice(stop - (4 if joint.nv in (3, 6) else 2), stop))
        return tuple(parts)

    @cached_property
    def mounts(self) -> Mounts:
        """Where its frames sit, by Pinocchio's index."""
        return mounts(self.model)

    @cached_property
    def nq(self) -> int:
        return int(self.model.nq)

    @property
    def frames(self) -> tuple[str, ...]:
        return tuple(self._ids)

    def frame_id(self, name: str) -> int:
        """Pinocchio's index of a frame. Raises NameNotFound: a missing index would crash Pinocchio later."""
        index = self._ids.get(name)
        if index is None:
            raise NameNotFound("frame", name, self.frames)
        return int(index)

    def wrench_map(self, source: str, target: str) -> Array | None:
        """(6, 6) X with F_target = X F_source for two frames of one link, or None when a joint lies between them."""
        key = (source, target)
        if key not in self._maps:
            a, b = (self.model.frames[self.frame_id(name)] for name in key)
            X = None
            if a.parentJoint == b.parentJoint:
                T = a.placement.actInv(b.placement)  # the target, seen from the source
                R, p = T.rotation.T, T.translation
                X = np.zeros((6, 6))
                X[:3, :3] = X[3:, 3:] = R
                X[:3, 3:] = -R @ pin.skew(p)
            self._maps[key] = X
        return self._maps[key]

    def posed(self, joints: Array) -> Array:
        """(nq,) the configuration with these joint positions (nu,); a floating base is where `home` has it."""
        return np.concatenate((self.keyframes["home"][:7], joints)) if self.base else joints

    def from_mujoco(self, qpos: Array, qvel: Array, qacc: Array | None = None) -> tuple[Array, ...]:
        """MuJoCo's (qpos, qvel) or (qpos, qvel, qacc) of this robot as (q, v) or (q, v, vdot). Exact."""
        mj = self._compiled()
        found = to_pinocchio(mj, qpos, qvel)
        return found if qacc is None else (*found, acceleration_to_pinocchio(mj, qpos, qvel, qacc))

    def to_mujoco(self, q: Array, v: Array, vdot: Array | None = None) -> tuple[Array, ...]:
        """(q, v) or (q, v, vdot) as MuJoCo's (qpos, qvel) or (qpos, qvel, qacc). Exact."""
        mj = self._compiled()
        found = to_mujoco(mj, q, v)
        return found if vdot is None else (*found, acceleration_to_mujoco(mj, q, v, vdot))

    def _compiled(self) -> Any:
        if self.mujoco is None:
            raise ModelError("only a robot that was loaded from a file has a MuJoCo model")
        return self.mujoco

    def state(self, q: Array, v: Array, t: float = 0.0, dt: float = 1e-3) -> State:
        """A `State` with storage of its own."""
        return State(Terms(self), np.asarray(q, float), np.asarray(v, float), t, dt)

    def fixed_pose(self, name: str) -> pin.SE3:
        """World pose of a frame that does not move. Raises NameNotFound, or ModelError when the robot moves it."""
        frame = self.model.frames[self.frame_id(name)]
        if frame.parentJoint != 0:
            raise ModelError(
                f"frame {name!r} moves with joint {self.model.names[frame.parentJoint]!r}; "
                "expected one fixed to the world"
            )
        return frame.placement.copy()

    def pairs(self) -> Any:
        """The shapes that can meet one another (`collision.Pairs`), found once."""
        from .collision import find_pairs

        if not self._pairs:
            self._pairs.append(find_pairs(self))
        return self._pairs[0]

    def inertia_below(self, frame_name: str) -> pin.Inertia:
        """Inertia, in that frame, of everything that the body which carries `frame_name` holds up."""
        frame = self.model.frames[self.frame_id(frame_name)]
        mj = self.mujoco
        if mj is None:
            raise ModelError("the load below a sensor is read from the compiled model; this robot has none")
        root = mj.site(frame_name).bodyid[0]
        total = pin.Inertia.Zero()
        for body in range(root, mj.nbody):
            above = body
            while above > root:
                above = mj.body_parentid[above]
            if above != root:
                continue
            if body != root and mj.body_jntnum[body]:
                raise ModelError(f"a joint moves the load below sensor {frame_name!r}; expected a rigid tool")
            joint_T_body = self.model.frames[self.frame_id(models.body_name(mj, body))].placement
            at = models._pose(mj.body_ipos[body], mj.body_iquat[body])
            own = pin.Inertia(mj.body_mass[body], np.zeros(3), np.diag(mj.body_inertia[body]))
            total += (frame.placement.actInv(joint_T_body) * at).act(own)
        return total

    def axes(self, frame_name: str, states: int = 8) -> tuple[int, ...]:
        """Counts of the body axes (wx .. vz) that the robot can ever move the frame along: fewer than 6 in a plane."""
        if frame_name not in self._axes:
            rng = np.random.default_rng(0)
            reach = np.zeros(6)
            for _ in range(states):
                q = pin.integrate(self.model, self.keyframes["home"], rng.uniform(-1.5, 1.5, self.nv))
                reach = np.maximum(reach, np.abs(self.state(q, np.zeros(self.nv)).frame(frame_name).J).max(axis=1))
            self._axes[frame_name] = tuple(int(i) for i in np.flatnonzero(reach > 1e-9))
        return self._axes[frame_name]


def _floating(model: pin.Model) -> int:
    """How many velocities no motor drives: the six of a floating base, which is the first joint. Raises ModelError."""
    free = [model.names[i] for i in range(2, model.njoints) if model.joints[i].nv == 6]
    if free:
        message = f"joint {free[0]!r} leaves a body free that is not the first one of the robot"
        raise ModelError(f"{message}; expected one free body, which comes first: a walker's trunk, or what arms carry")
    return 6 if model.njoints > 1 and model.joints[1].nv == 6 else 0


def _driven(model: pin.Model) -> tuple[str, ...]:
    """Names of the joints, but for that of a floating base."""
    return tuple(model.names)[2 if _floating(model) else 1 :]


def _position_limits(mj: Any) -> tuple[Array, Array]:
    """(nv,), (nv,) ranges of hinges and slides."""
    low, high = np.full(mj.nv, -np.inf), np.full(mj.nv, np.inf)
    for joint in np.flatnonzero(mj.jnt_limited):
        if mj.jnt_type[joint] >= 2:  # a ball's range is an angle, not a coordinate's
            low[mj.jnt_dofadr[joint]], high[mj.jnt_dofadr[joint]] = mj.jnt_range[joint]
    return low, high


def _stated(limit: Array) -> Array:
    """Pinocchio's largest number means that nothing is stated."""
    return np.where(np.abs(limit) > 1e300, np.copysign(np.inf, limit), limit)


def _per_velocity(model: pin.Model, limit: Array, none: float) -> Array:
    """(nv,) of a (nq,) limit; joints with more coordinates than velocities have none."""
    out = np.full(model.nv, none)
    for joint in list(model.joints)[1:]:
        if joint.nq == joint.nv:
            out[joint.idx_v : joint.idx_v + joint.nv] = limit[joint.idx_q : joint.idx_q + joint.nq]
    return _stated(out)


def _velocity_limits(mj: Any) -> Array:
    """(nv,) [rad/s]: a joint's first user number, where the model gives one."""
    v_max = np.full(mj.nv, np.inf)
    for joint in range(mj.njnt if mj.nuser_jnt else 0):
        if mj.jnt_user[joint, 0] > 0:
            v_max[mj.jnt_dofadr[joint]] = mj.jnt_user[joint, 0]
    return v_max
