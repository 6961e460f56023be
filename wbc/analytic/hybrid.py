"""The hybrid motion-force law, a motion and a force law in their own subspaces: *Modern Robotics*, section 11.6.2."""

from __future__ import annotations

from typing import Literal, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from wbc.errors import NameNotFound

from .dynamics import dynamically_consistent_inverse, force_projector, motion_projector, task_bias, task_inertia
from .force import gain_matrix, project_wrench
from .se3 import Array, ad, adjoint, inverse, pose_error, twist_error

Law: TypeAlias = Literal["book", "compensated"]


def computed_torque(T: Array, V: Array, T_d: Array, V_d: Array, Vdot_d: Array, Kp: ArrayLike, Kd: ArrayLike) -> Array:
    """y = d/dt(Ad V_d) + Kp X_e + Kd V_e (6,) [rad/s^2, m/s^2], in the axes of T; Kp [1/s^2], Kd [1/s].

    The feedforward is d/dt(Ad V_d) = Ad Vdot_d - ad_V (Ad V_d), since d/dt(T^-1 T_d) = T^-1 T_d [V_d] - [V] T^-1 T_d.
    """
    Ad = adjoint(inverse(T) @ T_d)
    feedforward = Ad @ Vdot_d - ad(V) @ (Ad @ V_d)
    motion = gain_matrix(Kp, 6, "Kp") @ pose_error(T, T_d) + gain_matrix(Kd, 6, "Kd") @ twist_error(T, V, T_d, V_d)
    return np.asarray(feedforward + motion)


def hybrid_torque(
    M: Array,
    h: Array,
    J: Array,
    drift: Array,
    A: Array,
    y: Array,
    F: Array,
    *,
    Adot_V: Array | None = None,
    law: Law = "book",
    vdot_posture: Array | None = None,
    S: Array | None = None,
) -> Array:
    """tau (n,) [N m] that moves by y (r,) [rad/s^2, m/s^2] and presses by F (r,) [N m, N], the force law's output.

    book:         tau = J' (P M_C y + (I - P) F + h_C); on the plant lambda = Lam A M_C^-1 F + Lam Adot V
    compensated:  tau = J' (M_C y_c + A' (A')^+ F + h_C); on the plant lambda = (A')^+ F and Vdot = y_c, where
                  y_c = y - Gbar (G y - (-Adot V, S y)), G = [A; S], is the M_C-nearest point to y with A y_c = -Adot V
                  that keeps the motion axes S (s, r), k + s <= r: [A; S]^-1 (-Adot V, S y) when k + s = r

    When n > r, tau gets + (I - J' Jbar')(M vdot_posture + h), the task's null space, vdot_posture (n,) being 0 by
    default. drift = Jdot v (r,). Adot_V (k,), by default 0, and S, by default no rows, play no part in the book's law.
    """
    M_C, h_C = task_inertia(M, J), task_bias(M, J, h, drift)
    if law == "book":
        P = motion_projector(A, M_C)
        wrench = P @ (M_C @ y) + force_projector(A, M_C) @ F
    elif law == "compensated":
        wrench = M_C @ _constrained_target(A, M_C, y, Adot_V, S) + project_wrench(A, F)
    else:
        raise NameNotFound("law", law, ("book", "compensated"))
    tau = J.T @ (wrench + h_C)
    if J.shape[1] > J.shape[0]:
        posture = h if vdot_posture is None else M @ vdot_posture + h
        tau = tau + posture - J.T @ (dynamically_consistent_inverse(M, J).T @ posture)
    return np.asarray(tau)


def _constrained_target(A: Array, M_C: Array, y: Array, Adot_V: Array | None, S: Array | None) -> Array:
    """y_c of `hybrid_torque`; S y is kept, so that the error of G y has no motion rows."""
    G = A if S is None else np.vstack([A, S])
    error = np.zeros(len(G))
    error[: len(A)] = A @ y if Adot_V is None else A @ y + Adot_V
    return np.asarray(y - dynamically_consistent_inverse(M_C, G) @ error)


def hybrid_acceleration(M: Array, G: Array, target: Array, Gdot_v: Array, vdot_posture: Array | None = None) -> Array:
    """vdot = Gbar (target - Gdot v) + (I - Gbar G) vdot_posture (n,) [rad/s^2].

    G (p, n) stacks the contact rows A J on the motion rows S J; target (p,) stacks -Adot V on S y; Gdot_v (p,) stacks
    A drift on S drift. Gbar = L^-T (G L^-T)^+, M = L L', is the M-weighted pseudo-inverse, so that the rows need
    neither span the task space nor be independent. With [A; S] square and regular this is the law of `hybrid_torque`.
    """
    L_T = np.linalg.cholesky(M).T
    white = np.linalg.solve(L_T.T, G.T).T
    Gbar = np.linalg.solve(L_T, np.linalg.pinv(white, rcond=max(G.shape) * np.finfo(np.float64).eps))
    posture = np.zeros(len(M)) if vdot_posture is None else vdot_posture
    return np.asarray(posture + Gbar @ (target - Gdot_v - G @ posture))
