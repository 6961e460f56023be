"""The arm seen from the task, free and in contact: *Modern Robotics*, sections 8.6 and 11.6, equations (3) to (5)."""

from __future__ import annotations

import numpy as np

from .se3 import Array


def _whiten(M: Array, J: Array) -> tuple[Array, Array, Array]:
    """L, Q, R with M = L L' and L^-1 J' = Q R, hence J M^-1 J' = R' R without ever squaring its condition."""
    L = np.linalg.cholesky(M)
    Q, R = np.linalg.qr(np.linalg.solve(L, J.T))
    return np.asarray(L), Q, R


def task_inertia(M: Array, J: Array) -> Array:
    """M_C = (J M^-1 J')^-1 (r, r), exactly symmetric; equation (3)."""
    R = _whiten(M, J)[2]
    X = np.linalg.solve(R, np.eye(len(R)))
    M_C = X @ X.T
    return np.asarray(0.5 * (M_C + M_C.T))


def dynamically_consistent_inverse(M: Array, J: Array) -> Array:
    """Jbar = M^-1 J' M_C (n, r): J Jbar = I, and of all such inverses the one of least kinetic energy."""
    L, Q, R = _whiten(M, J)
    return np.linalg.solve(L.T, np.linalg.solve(R, Q.T).T)


def task_bias(M: Array, J: Array, h: Array, drift: Array) -> Array:
    """h_C = Jbar' h - M_C drift (r,) [N m, N], with h (n,) [N m] and drift = Jdot v (r,); equation (3)."""
    return np.asarray(dynamically_consistent_inverse(M, J).T @ h - task_inertia(M, J) @ drift)


def inverse_dynamics(M: Array, h: Array, vdot: Array, J: Array, A: Array, lam: Array) -> Array:
    """tau = M vdot + h + J' A' lambda (n,) [N m]."""
    return np.asarray(M @ vdot + h + J.T @ (A.T @ lam))


# --- constrained dynamics: section 11.6.1 and 11.6.2, equations (4) and (5) ---


def constraint_inertia(A: Array, M_C: Array) -> Array:
    """Lam = (A M_C^-1 A')^-1 (k, k): the inertia felt along the constraints."""
    return task_inertia(M_C, A)


def motion_projector(A: Array, M_C: Array) -> Array:
    """P = I - A' Lam A M_C^-1 (r, r), rank r - k: keeps of a wrench what moves the frame along the constraints."""
    return np.eye(A.shape[1]) - force_projector(A, M_C)


def force_projector(A: Array, M_C: Array) -> Array:
    """I - P = A' Lam A M_C^-1 (r, r), rank k: keeps of a wrench what acts against the constraints."""
    return np.asarray((dynamically_consistent_inverse(M_C, A) @ A).T)


def multipliers(A: Array, M_C: Array, F: Array, h_C: Array, Adot_V: Array) -> Array:
    """lambda = Lam (A M_C^-1 (F - h_C) + Adot V) (k,), equation (5); A' lambda is the wrench on the environment."""
    return np.asarray(dynamically_consistent_inverse(M_C, A).T @ (F - h_C) + constraint_inertia(A, M_C) @ Adot_V)


def constrained_acceleration(A: Array, M_C: Array, F: Array, h_C: Array, Adot_V: Array) -> Array:
    """Vdot = M_C^-1 (F - h_C - A' lambda) (r,) [rad/s^2, m/s^2]: equation (4) with the lambda of (5)."""
    return np.asarray(np.linalg.solve(M_C, F - h_C - A.T @ multipliers(A, M_C, F, h_C, Adot_V)))


def force_bias(A: Array, M_C: Array, Adot_V: Array) -> Array:
    """Lam Adot V (k,): what the book's law presses too much on a moving, curved contact; zero on a flat one."""
    return np.asarray(constraint_inertia(A, M_C) @ Adot_V)
