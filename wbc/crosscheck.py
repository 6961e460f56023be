"""MuJoCo's model held against Pinocchio's: that both mean the same robot is measured whenever one is loaded."""

from __future__ import annotations

import mujoco
import numpy as np
import pinocchio as pin

from .convention import acceleration_offset, to_pinocchio, velocity_map
from .errors import ModelMismatch
from .model import object_name
from .qp import Array

AGREEMENT = 1e-8  # worst relative error of M, h, g, J, drift and pose at random states


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
        map_v = velocity_map(model, qpos)
        data.qpos[:], data.qvel[:] = qpos, qvel
        mujoco.mj_forward(model, data)
        M = np.zeros((n, n))
        mujoco.mj_fullM(model, data, M)
        pin.computeAllTerms(other, odata, q, v)
        drift = odata.M @ acceleration_offset(model, q, v)
        _note(worst, "M", map_v.T @ odata.M @ map_v, M)
        _note(worst, "h", map_v.T @ (odata.nle + drift), data.qfrc_bias)
        data.qvel[:] = 0
        mujoco.mj_forward(model, data)
        _note(worst, "g", map_v.T @ pin.computeGeneralizedGravity(other, odata, q), data.qfrc_bias)
        data.qvel[:] = qvel
        mujoco.mj_forward(model, data)
        pin.computeAllTerms(other, odata, q, v)
        for site in range(max(0, model.nsite - 3), model.nsite):
            name = object_name(model, mujoco.mjtObj.mjOBJ_SITE, site)
            frame = other.getFrameId(f"site:{name}" if other.existFrame(f"site:{name}") else name)
            pose = pin.updateFramePlacement(other, odata, frame)
            J = pin.getFrameJacobian(other, odata, frame, pin.LOCAL).reshape(6, n)  # one column comes as a vector
            a = pin.getFrameAcceleration(other, odata, frame, pin.LOCAL).vector
            J_mj, drift_mj = site_jacobian(model, data, site)
            a_free = J @ acceleration_offset(model, q, v)
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
