"""SE(3) and its errors: Lynch & Park, *Modern Robotics*, ch. 3 and section 11.3.3.

Twists are V = (w, v) [rad, m] or [rad/s, m/s], angular part first; poses T (4, 4) are of the task frame in the world.
"""

from __future__ import annotations

from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

Array: TypeAlias = NDArray[np.float64]


def skew(w: Array) -> Array:
    """[w] (3, 3), with [w] x = w cross x; section 3.2.2."""
    x, y, z = w
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])


def exp3(w: Array) -> Array:
    """R = I + sin(a)/a [w] + (1 - cos a)/a^2 [w]^2 with a = |w| [rad]; section 3.2.3."""
    half = np.linalg.norm(w) / (2 * np.pi)
    W = skew(w)
    # np.sinc(x) = sin(pi x)/(pi x): no division by a, no cancellation in 1 - cos a
    return np.asarray(np.eye(3) + np.sinc(2 * half) * W + 0.5 * np.sinc(half) ** 2 * (W @ W))


def log3(R: Array) -> Array:
    """w (3,) [rad] with exp3(w) = R and |w| <= pi; section 3.2.3."""
    t, W = np.trace(R), R - R.T
    w = np.array([W[2, 1], W[0, 2], W[1, 0]])
    # 4 q q' of the unit quaternion q: its longest column is well-conditioned at every angle, pi included
    Q = np.block([[np.array([[1 + t]]), w[None]], [w[:, None], R + R.T + (1 - t) * np.eye(3)]])
    q = Q[:, np.argmax(np.diag(Q))]
    q = q / np.copysign(np.linalg.norm(q), q[0])
    s = np.linalg.norm(q[1:])
    return np.asarray(q[1:] * (2 * np.arctan2(s, q[0]) / s if s > 0 else 2.0))


def exp6(V: Array) -> Array:
    """T = [[exp3(w), G v], [0, 1]] of V = (w, v) [rad, m]; section 3.3.3."""
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = exp3(V[:3]), _translation_map(V[:3]) @ V[3:]
    return T


def log6(T: Array) -> Array:
    """V = (w, G^-1 p) [rad, m] with exp6(V) = T and |w| <= pi; section 3.3.3."""
    w = log3(T[:3, :3])
    # det G = 2 (1 - cos a)/a^2 >= 4/pi^2, so that the solve is safe at every angle
    return np.concatenate([w, np.linalg.solve(_translation_map(w), T[:3, 3])])


def _translation_map(w: Array) -> Array:
    """G = I + (1 - cos a)/a^2 [w] + (a - sin a)/a^3 [w]^2, a = |w|."""
    a, W = np.linalg.norm(w), skew(w)
    if a < 0.3:  # a - sin a cancels: its series, cut below 1e-15
        c = np.polyval([1 / 39916800, -1 / 362880, 1 / 5040, -1 / 120, 1 / 6], a * a)
    else:
        c = (a - np.sin(a)) / a**3
    return np.asarray(np.eye(3) + 0.5 * np.sinc(a / (2 * np.pi)) ** 2 * W + c * (W @ W))


def inverse(T: Array) -> Array:
    """T^-1 = [[R', -R' p], [0, 1]]; section 3.3.1."""
    X = np.eye(4)
    X[:3, :3], X[:3, 3] = T[:3, :3].T, -T[:3, :3].T @ T[:3, 3]
    return X


def adjoint(T: Array) -> Array:
    """Ad_T = [[R, 0], [[p] R, R]] (6, 6): V_a = Ad_{T_ab} V_b and F_b = Ad_{T_ab}' F_a; section 3.3.2."""
    R, X = T[:3, :3], np.zeros((6, 6))
    X[:3, :3], X[3:, 3:], X[3:, :3] = R, R, skew(T[:3, 3]) @ R
    return X


def ad(V: Array) -> Array:
    """ad_V = [[[w], 0], [[v], [w]]] (6, 6), the Lie bracket; section 8.2.2."""
    X, W = np.zeros((6, 6)), skew(V[:3])
    X[:3, :3], X[3:, 3:], X[3:, :3] = W, W, skew(V[3:])
    return X


def pose_error(T: Array, T_d: Array) -> Array:
    """X_e (6,) [rad, m], [X_e] = log(T^-1 T_d)."""
    return log6(inverse(T) @ T_d)


def pose_error_split(T: Array, T_d: Array) -> Array:
    """(log3(R' R_d), R' (p_d - p)) (6,) [rad, m], in the axes of T: rotation and translation each on their own.

    Following it, the frame's origin goes straight to its target while the frame turns about one axis; following
    `pose_error` it goes along a screw, which 0.3 m and 1 rad at right angles bend by 38 mm; section 11.3.3.
    """
    R = T[:3, :3]
    return np.concatenate([log3(R.T @ T_d[:3, :3]), R.T @ (T_d[:3, 3] - T[:3, 3])])


def twist_error(T: Array, V: Array, T_d: Array, V_d: Array) -> Array:
    """V_e = Ad V_d - V (6,) with Ad = Ad_{T^-1 T_d}; V_d is in the axes of T_d, V and V_e in those of T."""
    return np.asarray(adjoint(inverse(T) @ T_d) @ V_d - V)
