"""Coulomb friction: the cone that a sticking contact must stay in, and sliding friction inside the contact model.

Cones are those of *Modern Robotics*, section 12.2. A contact that pushes along the unit vector d with N = d' f >= 0
[N] sticks while |f_t| <= mu N, f_t the force across d; where it slides, the robot drags the world along with it,

    f_t = mu N u,     u = v_t / |v_t|,     so that the whole wrench is B lambda,   B = A' + mu [0; u] n',  N = n' lambda

B takes the place of A' in the dynamics (4), while the constraint A V = 0 stays as it is:

    F = M_C Vdot + h_C + B lambda            lambda = (A M_C^-1 B)^-1 (A M_C^-1 (F - h_C) + Adot V)
"""

from __future__ import annotations

import numpy as np

from .se3 import Array


def inner_cone(mu: float, faces: int) -> Array:
    """Rows c (faces, 3) with c (f_1, f_2, N) <= 0: a pyramid of that many faces whose edges lie on the cone of mu.

    What satisfies it also satisfies the cone; the middle of a face gives away 1 - cos(pi/faces) of the friction: 29 %
    with 4 faces, 7.6 % with 8, 1.9 % with 16. Two faces are exact for one axis, f_1.
    """
    if faces == 2:
        return np.array([[1.0, 0.0, -mu], [-1.0, 0.0, -mu]])
    angle = (2 * np.arange(faces) + 1) * np.pi / faces
    return np.column_stack((np.cos(angle), np.sin(angle), np.full(faces, -mu * np.cos(np.pi / faces))))


def cut_to_cone(f_t: Array, N: float, mu: float, faces: int | None = None) -> Array:
    """The longest s f_t, 0 <= s <= 1, inside the cone at the same N, or inside the pyramid of `inner_cone`; N kept."""
    if faces is None:
        used = float(np.linalg.norm(f_t))
        most = mu * max(N, 0.0)
    else:
        rows = inner_cone(mu, faces)
        used = float((rows[:, : f_t.size] @ f_t).max())
        most = -rows[0, 2] * max(N, 0.0)
    return np.asarray(f_t * (most / used) if used > most else f_t)


def sliding_direction(v: Array, v_d: Array, slip: float) -> Array:
    """u, |u| <= 1: v/|v| from the speed `slip` [m/s] on; below, as far as v falls short of it, that of the desired v_d.

    u = v/slip + (1 - |v|/slip) v_d/max(|v_d|, slip): continuous, and zero where nothing moves and nothing is to.
    """
    speed = float(np.linalg.norm(v))
    if speed >= slip:
        return np.asarray(v / speed)
    return np.asarray(v / slip + (1.0 - speed / slip) * v_d / max(float(np.linalg.norm(v_d)), slip))


def sliding_map(A: Array, d: Array, u: Array, mu: float) -> Array:
    """B = A' + mu [0; u] n' (6, k): the wrench of unit multipliers on a contact that slides along u (3,), n = A [0; d].

    A (k, 6); d (3,) is the direction in which the robot pushes, u across it, both in the axes of the frame.
    """
    return np.asarray(A.T + mu * np.outer(np.concatenate((np.zeros(3), u)), A[:, 3:] @ d))


def sliding_multipliers(A: Array, B: Array, M_C: Array, F: Array, h_C: Array, Adot_V: Array) -> Array:
    """lambda = (A M_C^-1 B)^-1 (A M_C^-1 (F - h_C) + Adot V) (k,): equation (5) where the contact answers B lambda."""
    mobility = A @ np.linalg.solve(M_C, B)
    return np.asarray(np.linalg.solve(mobility, A @ np.linalg.solve(M_C, F - h_C) + Adot_V))


def sliding_acceleration(A: Array, B: Array, M_C: Array, F: Array, h_C: Array, Adot_V: Array) -> Array:
    """Vdot = M_C^-1 (F - h_C - B lambda) (6,): equation (4) where the contact answers B lambda."""
    lam = sliding_multipliers(A, B, M_C, F, h_C, Adot_V)
    return np.asarray(np.linalg.solve(M_C, F - h_C - B @ lam))


def sliding_torque(J: Array, A: Array, B: Array, lam: Array) -> Array:
    """J' (B - A') lambda (n,) [N m]: added to a frictionless law that presses with lambda, it slides as that law says.

    The constraint and the equation of motion then hold with the same Vdot and lambda, and A M_C^-1 B is regular, so
    that nothing else can answer. lambda is (A')^+ F of the compensated law, Lam (A M_C^-1 F + Adot V) of the book's.
    """
    return np.asarray(J.T @ ((B - A.T) @ lam))


def critical_friction(A: Array, mobility: Array, d: Array, across: Array) -> float:
    """The mu at which A M_C^-1 B is first singular, for some direction of sliding u in the span of `across` (m, 3).

    det(A M_C^-1 B) = det(A M_C^-1 A') (1 + mu n' Lam A M_C^-1 [0; u]): with w = [0; across] M_C^-1 A' Lam n the worst
    u is -w/|w|, and mu = 1/|w|. Beyond it, pressing harder lifts the tool in that direction (Painleve's paradox).
    `mobility` (6, 6) = J M^-1 J' is M_C^-1, of any arm.
    """
    push = A.T @ np.linalg.solve(A @ mobility @ A.T, A[:, 3:] @ d)
    size = float(np.linalg.norm(across @ (mobility @ push)[3:]))
    return 1.0 / size if size > 0.0 else np.inf


def capped_friction(F: Array, across: Array, most: float) -> Array:
    """F (6,), scaled down where its force along the rows `across` (m, 3) exceeds `most` = mu N [N].

    A measured wrench that is fed forward has loop gain 1: against a contact that sticks it would grow without end.
    """
    used = float(np.linalg.norm(across @ F[3:]))
    return np.asarray(F * (max(most, 0.0) / used) if used > max(most, 0.0) else F)
