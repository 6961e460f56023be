"""The closed-form laws of force and hybrid motion-force control, one small function an equation.

Lynch & Park, *Modern Robotics*, ch. 11. A rigid contact holds k of the r <= 6 axes of a task frame (0 <= k <= r):

    A V = 0                                        (1)      A Vdot + Adot V = 0                               (2)
    F = M_C Vdot + h_C                             (3)      F = M_C Vdot + h_C + A' lambda                    (4)
    lambda = Lam (A M_C^-1 (F - h_C) + Adot V)     (5)      Lam = (A M_C^-1 A')^-1

Everywhere: twist V = (w, v) [rad/s, m/s] and wrench F = (m, f) [N m, N] of the task frame in its own axes (body frame),
angular part first; wrenches are applied by the robot to the environment; poses T (4, 4) are of the task frame in the
world. M (n, n) is symmetric positive definite, J (r, n) and A (k, r) have full row rank: more rows than columns raise
LinAlgError, and near a singularity results grow as the inverse does, so look at cond(J M^-1 J') first. `X'` is the
transpose, `X^+` the pseudo-inverse.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from wbc.errors import GainError, NameNotFound, WrenchError

Array: TypeAlias = NDArray[np.float64]
Law: TypeAlias = Literal["book", "compensated"]

# --- SE(3): Modern Robotics ch. 3 ---


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


# --- dynamics seen by the task: section 8.6 and equation (3) ---


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


# --- motion: section 11.4.3 ---


def pose_error(T: Array, T_d: Array) -> Array:
    """X_e (6,) [rad, m], [X_e] = log(T^-1 T_d)."""
    return log6(inverse(T) @ T_d)


def twist_error(T: Array, V: Array, T_d: Array, V_d: Array) -> Array:
    """V_e = Ad V_d - V (6,) with Ad = Ad_{T^-1 T_d}; V_d is in the axes of T_d, V and V_e in those of T."""
    return np.asarray(adjoint(inverse(T) @ T_d) @ V_d - V)


def computed_torque(T: Array, V: Array, T_d: Array, V_d: Array, Vdot_d: Array, Kp: ArrayLike, Kd: ArrayLike) -> Array:
    """y = d/dt(Ad V_d) + Kp X_e + Kd V_e (6,) [rad/s^2, m/s^2], in the axes of T; Kp [1/s^2], Kd [1/s].

    The feedforward is d/dt(Ad V_d) = Ad Vdot_d - ad_V (Ad V_d), since d/dt(T^-1 T_d) = T^-1 T_d [V_d] - [V] T^-1 T_d.
    """
    Ad = adjoint(inverse(T) @ T_d)
    feedforward = Ad @ Vdot_d - ad(V) @ (Ad @ V_d)
    motion = gain_matrix(Kp, 6, "Kp") @ pose_error(T, T_d) + gain_matrix(Kd, 6, "Kd") @ twist_error(T, V, T_d, V_d)
    return np.asarray(feedforward + motion)


# --- force: section 11.5 ---


def gain_matrix(K: ArrayLike, n: int, name: str) -> Array:
    """K (n, n) from a number, a diagonal (n,) or a matrix; all zero, or x' K x > 0 for every x, else GainError."""
    K = np.asarray(K, dtype=np.float64)
    if K.shape not in {(), (n,), (n, n)}:
        raise GainError(f"{name}: got shape {K.shape}, expected a number, ({n},) or ({n}, {n})")
    if not np.isfinite(K).all():
        raise GainError(f"{name}: not finite")
    matrix = K if K.ndim == 2 else np.diag(np.broadcast_to(K, n))
    smallest = min(np.linalg.eigvalsh(0.5 * (matrix + matrix.T)), default=0.0)
    if matrix.any() and not smallest > 0:
        raise GainError(f"{name}: not positive definite: smallest eigenvalue {smallest:.6g}, expected above 0")
    return np.array(matrix)


def force_command(
    F_d: Array,
    F_e: Array,
    integral: Array,
    Kp: ArrayLike,
    Ki: ArrayLike,
    K_damp: ArrayLike | None = None,
    V: Array | None = None,
) -> Array:
    """F = F_d + Kp F_e + Ki int F_e dt [- K_damp V], F_e = F_d - F_tip; equally in multiplier coordinates, V then A V.

    Kp [1], Ki [1/s], K_damp [N m s/rad, N s/m], which needs V.
    """
    n = len(F_d)
    F = F_d + gain_matrix(Kp, n, "Kp") @ F_e + gain_matrix(Ki, n, "Ki") @ integral
    if K_damp is None:
        return np.asarray(F)
    if V is None:
        raise GainError("K_damp: damping needs the twist V")
    return np.asarray(F - gain_matrix(K_damp, n, "K_damp") @ V)


def force_torque(J: Array, g: Array, F: Array) -> Array:
    """tau = g + J' F (n,) [N m]: pure force control, open loop with F = F_d, PI control with F of `force_command`."""
    return np.asarray(g + J.T @ F)


def force_error_matrix(Kp: ArrayLike, Ki: ArrayLike) -> Array:
    """-(I + Kp)^-1 Ki (n, n) [1/s], of (Kp + I) Fdot_e + Ki F_e = 0; eigenvalues are real, < 0 for symmetric gains > 0.

    Two gains that are positive definite but not symmetric can make it unstable.
    """
    n = max(np.atleast_1d(Kp).shape[0], np.atleast_1d(Ki).shape[0])
    return np.asarray(-np.linalg.solve(np.eye(n) + gain_matrix(Kp, n, "Kp"), gain_matrix(Ki, n, "Ki")))


def force_error(t: ArrayLike, F_e0: Array, Kp: ArrayLike, Ki: ArrayLike) -> Array:
    """F_e(t) = exp(-(I + Kp)^-1 Ki t) F_e0, (n,) for a time t [s] and (N, n) for N times."""
    n, t = len(F_e0), np.asarray(t, dtype=np.float64)
    X = force_error_matrix(gain_matrix(Kp, n, "Kp"), gain_matrix(Ki, n, "Ki"))
    return np.array([_expm(X * s) @ F_e0 for s in t.ravel()]).reshape(*t.shape, n)


def _expm(X: Array) -> Array:
    """exp(X) by its series at X / 2^s, |X| / 2^s <= 1/2, squared s times; works for defective X too."""
    s = max(0, int(np.frexp(np.abs(X).sum(axis=0).max(initial=0.0))[1]) + 1)
    E = term = np.eye(len(X))
    for j in range(1, 16):
        term = term @ X / (j * 2.0**s)
        E = E + term
    for _ in range(s):
        E = E @ E
    return E


# --- which wrenches a contact carries: F_tip = A' lambda, section 11.6.1 ---


def multiplier_error(A: Array, F_e: Array) -> Array:
    """(A')^+ F_e = (A A')^-1 A F_e (k,): a wrench error along the constrained axes alone, whatever the inertia."""
    Q, R = np.linalg.qr(A.T)
    return np.linalg.solve(R, Q.T @ F_e)


def project_wrench(A: Array, F: Array) -> Array:
    """A' (A')^+ F (r,): the wrench of the column space of A' that is nearest to F."""
    return np.asarray(A.T @ multiplier_error(A, F))


def wrench_residual(A: Array, F_d: Array) -> Array:
    """F_d - A' (A')^+ F_d (r,): the part of F_d that the contact cannot carry."""
    return F_d - project_wrench(A, F_d)


def require_wrench(A: Array, F_d: Array, axes: Sequence[str]) -> None:
    """Hold F_d (r,) to the column space of A'; WrenchError names each of `axes` that sticks out, by how much."""
    residual = wrench_residual(A, F_d)
    allowed = 1e-9 * max(1.0, float(np.linalg.norm(F_d)))
    bad = [f"{axis} by {x:.6g}{_unit(axis)}" for axis, x in zip(axes, residual, strict=True) if not abs(x) <= allowed]
    if bad:
        raise WrenchError(f"the contact cannot carry the desired wrench: {', '.join(bad)} outside the range of A'")


def _unit(axis: str) -> str:
    return {"m": " N m", "f": " N"}.get(axis[:1], "")


# --- the hybrid motion-force law: section 11.6.2 ---


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


def inverse_dynamics(M: Array, h: Array, vdot: Array, J: Array, A: Array, lam: Array) -> Array:
    """tau = M vdot + h + J' A' lambda (n,) [N m]."""
    return np.asarray(M @ vdot + h + J.T @ (A.T @ lam))
