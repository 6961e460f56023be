"""Pure force control, and which wrenches a contact carries: *Modern Robotics*, sections 11.5 and 11.6.1."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from wbc.errors import GainError, WrenchError

from .dynamics import dynamically_consistent_inverse
from .se3 import Array


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


def unmodelled_bias(M: Array, J: Array, dg: Array) -> Array:
    """-Jbar' dg (r,) [N m, N], Jbar' = M_C J M^-1: what gravity that the model does not know adds to F_tip.

    A held hand under tau = g + J' F_d obeys M vdot + g + dg + J' F_tip = tau with J vdot = 0, hence
    J M^-1 J' (F_d - F_tip) = J M^-1 dg. A load of weight w = (m, f) at the task frame has dg = -J' w: F_tip = F_d + w.
    """
    return -dynamically_consistent_inverse(M, J).T @ dg


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


# --- the damped loop ---


def terminal_velocity(F_d: Array, K_damp: ArrayLike, Kp: ArrayLike = 0) -> Array:
    """V = K_damp^-1 (I + Kp) F_d (n,) [rad/s, m/s]: how fast the frame drifts with nothing to push on.

    There F_tip = 0, F_e = F_d, and the command F_d + Kp F_e - K_damp V comes to rest. With Ki > 0 it grows without end.
    """
    n = len(F_d)
    return np.asarray(np.linalg.solve(gain_matrix(K_damp, n, "K_damp"), F_d + gain_matrix(Kp, n, "Kp") @ F_d))


def damping_limit(mobility: Array, dt: float) -> float:
    """2 / (dt max eig) [N s/m]: the number K_damp that turns V into -V in a tick along the lightest direction.

    A tick of dt [s] is V += -dt mobility K_damp V, stable for dt max eig(mobility K_damp) < 2; mobility = J M^-1 J'
    (r, r), or A M_C^-1 A' (k, k) for damping along the constrained axes. Without axes there is no limit.
    """
    largest = float(np.linalg.eigvalsh(mobility).max(initial=0.0))
    return 2 / (dt * largest) if largest > 0 else np.inf


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
