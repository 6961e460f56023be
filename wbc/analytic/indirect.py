"""Indirect force control, by impedance and by admittance: *Modern Robotics*, section 11.7.

    M xdd + B xd + K x_e = f_ext,   x_e = x - x_d,   xd_d = xdd_d = 0

in m minimal coordinates x, xd = J v, xdd = J vdot + Jdot v. Unlike the wrenches of force control, f_ext (m,) [N, N m]
is applied by the environment to the robot: M(q) vdot + h = tau + J' f_ext. M, B, K (m, m) are numbers, diagonals or
matrices, all zero or positive definite. Their letters in one dimension are m [kg], b [N s/m], k [N/m].

An impedance controller measures motion and commands force, an admittance controller measures force and commands motion.
Which stiffness is high and which low is told by `motion_compliance` and `force_stiffness`.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from .force import gain_matrix
from .se3 import Array

# --- impedance controller: section 11.7.1 ---


def impedance_torque(
    J: Array, M_C: Array, h_C: Array, xdd: Array, xd: Array, x_e: Array, M: ArrayLike, B: ArrayLike, K: ArrayLike
) -> Array:
    """tau = J' (M_C xdd + h_C - (M xdd + B xd + K x_e)) (n,) [N m], xdd measured (m,); J (m, n).

    The arm, M_C xdd + h_C = J'^+ tau + f_ext, then has M xdd + B xd + K x_e = f_ext, whatever its own inertia.
    """
    inertia = M_C - gain_matrix(M, len(xdd), "M")
    return np.asarray(J.T @ (inertia @ xdd)) + impedance_torque_massless(J, h_C, xd, x_e, B, K)


def impedance_torque_massless(J: Array, h_C: Array, xd: Array, x_e: Array, B: ArrayLike, K: ArrayLike) -> Array:
    """tau = J' (h_C - (B xd + K x_e)) (n,) [N m]: no acceleration measured, M_C xdd + B xd + K x_e = f_ext remains."""
    return np.asarray(J.T @ (h_C - gain_matrix(B, len(xd), "B") @ xd - gain_matrix(K, len(xd), "K") @ x_e))


def impedance_torque_gravity(J: Array, g: Array, x: Array, x_d: Array, xd: Array, B: ArrayLike, K: ArrayLike) -> Array:
    """tau = J' (K (x_d - x) - B xd) + g (n,) [N m]: the massless law at small velocities, h_C = g_C; g (n,) [N m]."""
    return impedance_torque_massless(J, np.zeros(len(x)), xd, x - x_d, B, K) + g


def impedance_acceleration(
    M: ArrayLike, B: ArrayLike, K: ArrayLike, xd: Array, x_e: Array, f_ext: Array, Lam: Array
) -> Array:
    """y = M^-1 (f_ext - B xd - K x_e) - Lam^-1 f_ext (m,) [m/s^2]: the target of a motion task that renders M, B, K.

    An arm that tracks y under tau = J' (Lam y + h_C), no wrench fed forward, answers xdd = y + Lam^-1 f_ext. For the m
    rows J of the impedance, among whatever other tasks, Lam = task_inertia(M(q), J). With M = Lam, the massless law, y
    is -Lam^-1 (B xd + K x_e) and needs no measured force; as a plain wrench beside other tasks it is another law.
    """
    return admittance_acceleration(M, B, K, f_ext, xd, x_e) - np.linalg.solve(Lam, f_ext)


# --- admittance controller: section 11.7.2 ---


def admittance_acceleration(M: ArrayLike, B: ArrayLike, K: ArrayLike, f_ext: Array, xd: Array, x_e: Array) -> Array:
    """xdd = M^-1 (f_ext - B xd - K x_e) (m,) [m/s^2], f_ext measured."""
    n = len(f_ext)
    force = f_ext - gain_matrix(B, n, "B") @ xd - gain_matrix(K, n, "K") @ x_e
    return np.asarray(np.linalg.solve(gain_matrix(M, n, "M"), force))


def admittance_torque(M_q: Array, h: Array, J: Array, drift: Array, xdd: Array, f_ext: Array | None = None) -> Array:
    """tau = M(q) J^+ (xdd - Jdot v) + h [- J' f_ext] (n,) [N m]; drift = Jdot v (m,), J^+ the least-squares inverse.

    Without f_ext this is the law as printed: f_ext still pushes the arm, which answers xdd + Lam^-1 f_ext, and renders
    `rendered_as_printed`. With the measured f_ext cancelled it answers xdd exactly.
    """
    tau = M_q @ (np.linalg.pinv(J) @ (xdd - drift)) + h
    return np.asarray(tau if f_ext is None else tau - J.T @ f_ext)


def printed_scale(M: ArrayLike, Lam: ArrayLike) -> Array:
    """S = (I + M Lam^-1)^-1 (m, m): the printed admittance law renders S M, S B and S K in place of M, B and K.

    The arm of inertia Lam, moved by f_ext itself, answers xdd = M^-1 (f_ext - B xd - K x_e) + Lam^-1 f_ext, so that
    (M^-1 + Lam^-1)^-1 (xdd + M^-1 (B xd + K x_e)) = f_ext, and (M^-1 + Lam^-1)^-1 = S M. Numbers give 1/(1 + M/Lam).
    """
    M, Lam = (np.asarray(X, dtype=np.float64) for X in (M, Lam))
    X, Y = np.atleast_2d(M), np.atleast_2d(Lam)
    S = np.linalg.solve((X + Y).T, Y.T).T  # (I + M Lam^-1)^-1 = Lam (Lam + M)^-1
    return np.asarray(S.reshape(M.shape))


def rendered_as_printed(M: ArrayLike, Lam: ArrayLike) -> Array:
    """(M^-1 + Lam^-1)^-1 [kg], M / (1 + M/Lam) of numbers: mass rendered by the printed law; half of M when M = Lam."""
    S, M = printed_scale(M, Lam), np.asarray(M, dtype=np.float64)
    return np.asarray(S * M if S.ndim == 0 else S @ M)


# --- the ideal controllers are opposite limits: section 11.7 ---


def motion_compliance(kp: ArrayLike, Lam: ArrayLike) -> Array:
    """dx/f = 1/(kp Lam) [m/N]: a computed-torque motion controller, kp [1/s^2], gives way by dx under a steady f.

    At rest Lam xdd = -Lam kp dx + f = 0. High impedance is a large kp, or a large effective mass Lam [kg].
    """
    kp, Lam = np.asarray(kp, dtype=np.float64), np.asarray(Lam, dtype=np.float64)
    return np.asarray(1 / (kp * Lam))


def force_stiffness(w: ArrayLike, Lam: ArrayLike, Kp: float, Ki: float) -> Array:
    """f/dx = Lam w^2 / |1 + Kp + Ki/(jw)| [N/m]: force error f of a PI loop at a contact moving by dx.

    The arm follows the contact, at w [rad/s]: Lam s^2 X = -(1 + Kp + Ki/s) F. Low impedance is a large gain, a small
    mass, a slow motion: zero at w = 0, where the arm gives way without limit.
    """
    w, Lam = np.abs(np.asarray(w, dtype=np.float64)), np.asarray(Lam, dtype=np.float64)
    gain = np.hypot((1 + Kp) * w, Ki)  # |1 + Kp + Ki/(jw)| w
    return np.asarray(Lam * w**2 * np.divide(w, gain, out=np.zeros_like(w), where=gain > 0))
