"""The arithmetic of a tick, compiled: one call for what would take numpy ten, each of which costs more than its work.

Plain loops over small dense arrays; the theory is told where they are called. Signatures are explicit, so that all is
compiled when the module is first imported (and kept on disk), never inside a tick.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, TypeVar

import numpy as np
from numba import njit, types
from numpy.typing import NDArray

Array = NDArray[np.float64]
_Function = TypeVar("_Function", bound=Callable[..., Any])

_F: Any = types.float64
_THREE: Any = types.UniTuple(_F, 3)  # type: ignore[no-untyped-call]
_v, _m = (types.Array(_F, ndim, "A", readonly=True) for ndim in (1, 2))  # read only, any strides
_V, _M = (types.Array(_F, ndim, "A") for ndim in (1, 2))  # written to


def _compiled(result: Any, *arguments: Any) -> Callable[[_Function], _Function]:
    compiler: Any = njit([result(*arguments)], cache=True, nogil=True)
    return compiler


def _inner(function: _Function) -> _Function:
    """Compiled into those that call it."""
    compiled: Any = njit(cache=True, nogil=True)(function)
    return compiled


@_compiled(types.void, _m, _v, _v, _v, _m, _m, _v, _v, _M, _V, _M)
def frame(
    R_j: Array, p_j: Array, a_j: Array, alpha_j: Array, place: Array, J_0: Array, moves: Array, v: Array,
    R: Array, p: Array, table: Array,
) -> None:  # fmt: skip
    """A frame at `place` = [R | p] (3, 4) of a joint at (R_j, p_j) that accelerates by (alpha_j, a_j) in its own axes.

    R, p: its pose; table = [J | drift | J v] (6, n + 2) of its body twist, angular part first. `J_0` (6, n) are
    Pinocchio's columns in the world's axes and origin, linear part first; `moves` (n,) is 1 for those that move it.
    """
    n = v.size
    for i in range(3):
        p[i] = p_j[i]
        for j in range(3):
            p[i] += R_j[i, j] * place[j, 3]
            R[i, j] = 0.0
            for k in range(3):
                R[i, j] += R_j[i, k] * place[k, j]
    x, y, z = p[0], p[1], p[2]
    for i in range(6):
        table[i, n + 1] = 0.0
    for j in range(n):
        if moves[j] == 0.0:
            for i in range(6):
                table[i, j] = 0.0
            continue
        w0, w1, w2 = J_0[3, j], J_0[4, j], J_0[5, j]
        v0 = J_0[0, j] + w1 * z - w2 * y
        v1 = J_0[1, j] + w2 * x - w0 * z
        v2 = J_0[2, j] + w0 * y - w1 * x
        for i in range(3):
            table[i, j] = R[0, i] * w0 + R[1, i] * w1 + R[2, i] * w2
            table[3 + i, j] = R[0, i] * v0 + R[1, i] * v1 + R[2, i] * v2
        for i in range(6):
            table[i, n + 1] += table[i, j] * v[j]
    x, y, z = place[0, 3], place[1, 3], place[2, 3]
    b0 = a_j[0] + alpha_j[1] * z - alpha_j[2] * y
    b1 = a_j[1] + alpha_j[2] * x - alpha_j[0] * z
    b2 = a_j[2] + alpha_j[0] * y - alpha_j[1] * x
    for i in range(3):
        table[i, n] = place[0, i] * alpha_j[0] + place[1, i] * alpha_j[1] + place[2, i] * alpha_j[2]
        table[3 + i, n] = place[0, i] * b0 + place[1, i] * b1 + place[2, i] * b2


@_inner
def _select(basis: Array, table: Array, out: Array, bias: Array) -> None:
    n = table.shape[1]
    for i in range(basis.shape[0]):
        for j in range(n):
            s = 0.0
            for k in range(6):
                s += basis[i, k] * table[k, j]
            out[i, j] = s
        bias[i] = -out[i, n - 2]


@_compiled(types.void, _m, _m, _M, _V)
def select(basis: Array, table: Array, out: Array, bias: Array) -> None:
    """out = basis table, and bias its column of drifts with the sign turned."""
    _select(basis, table, out, bias)


@_compiled(types.void, _m, _m, _F, _m, _M, _M, _V, _M, _V)
def rolling(
    R_p: Array, R_f: Array, radius: float, table: Array, basis: Array, inverse: Array, Adot_V: Array, out: Array,
    bias: Array,
) -> None:  # fmt: skip
    """Of a sphere on a plane with the axes R_p, its frame at R_f: A and free rows, (A')^+, Adot V; then as `select`."""
    V = table[:, table.shape[1] - 1]
    X = np.empty((3, 3))
    for i in range(3):
        for j in range(3):
            X[i, j] = R_p[0, i] * R_f[0, j] + R_p[1, i] * R_f[1, j] + R_p[2, i] * R_f[2, j]
    for j in range(3):
        basis[0, j], basis[1, j], basis[2, j] = -radius * X[1, j], radius * X[0, j], 0.0
        for i in range(3):
            basis[i, 3 + j] = basis[3 + i, j] = inverse[i, 3 + j] = X[i, j]
            basis[3 + i, 3 + j] = inverse[i, j] = 0.0
    x = V[1] * V[5] - V[2] * V[4]
    y = V[2] * V[3] - V[0] * V[5]
    z = V[0] * V[4] - V[1] * V[3]
    for i in range(3):
        Adot_V[i] = X[i, 0] * x + X[i, 1] * y + X[i, 2] * z
    _select(basis, table, out, bias)


@_compiled(types.void, _v, _v, _F, _F, _V)
def settle(Adot_V: Array, slip: Array, rate: float, most: float, rhs: Array) -> None:
    """rhs -= Adot V + c with c = rate A V, each at most `most`."""
    for i in range(rhs.size):
        rhs[i] -= Adot_V[i] + min(max(rate * slip[i], -most), most)


@_compiled(types.void, _m, _v, _v, _V)
def wanted(free: Array, y: Array, bias: Array, b: Array) -> None:
    """b = bias, with free y added to its last rows."""
    k = bias.size - free.shape[0]
    for i in range(bias.size):
        b[i] = bias[i]
    for i in range(free.shape[0]):
        for j in range(6):
            b[k + i] += free[i, j] * y[j]


@_compiled(types.void, _m, *9 * [_F], _V, _M)
def shift(
    place: Array,
    x: float,
    vx: float,
    ax: float,
    y: float,
    vy: float,
    ay: float,
    z: float,
    vz: float,
    az: float,
    p: Array,
    motion: Array,
) -> None:
    """p = R (x, y, z) + p_0 of place = [R | p_0]; motion (6, 2) = the linear velocity and acceleration."""
    for i in range(3):
        p[i] = place[i, 0] * x + place[i, 1] * y + place[i, 2] * z + place[i, 3]
        motion[i, 0] = motion[i, 1] = 0.0
    motion[3, 0], motion[4, 0], motion[5, 0] = vx, vy, vz
    motion[3, 1], motion[4, 1], motion[5, 1] = ax, ay, az


@_inner
def _log(R: Array, p: Array, X: Array) -> None:
    """X (6,) with exp [X] = (R, p), angular part first (book 3.92), by way of the quaternion: exact for any angle."""
    big, trace = 0, R[0, 0] + R[1, 1] + R[2, 2]
    for i in range(1, 3):
        if R[i, i] > R[big, big]:
            big = i
    q = np.empty(3)
    if trace > R[big, big]:
        root = math.sqrt(1.0 + trace)
        c = 0.5 * root
        for i in range(3):
            q[i] = (R[(i + 2) % 3, (i + 1) % 3] - R[(i + 1) % 3, (i + 2) % 3]) * 0.5 / root
    else:
        i, j, k = big, (big + 1) % 3, (big + 2) % 3
        root = math.sqrt(1.0 + R[i, i] - R[j, j] - R[k, k])
        q[i] = 0.5 * root
        q[j] = (R[j, i] + R[i, j]) * 0.5 / root
        q[k] = (R[k, i] + R[i, k]) * 0.5 / root
        c = (R[k, j] - R[j, k]) * 0.5 / root
    sine = math.sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2])
    if c < 0.0:  # the shorter way round
        c, q[0], q[1], q[2] = -c, -q[0], -q[1], -q[2]
    angle = 2.0 * math.atan2(sine, c)
    scale = angle / sine if sine > 1e-8 else 2.0 / c
    square = angle * angle
    if angle < 0.1:
        beta = 1.0 / 12.0 + square * (1.0 / 720.0 + square * (1.0 / 30240.0 + square / 1209600.0))
    else:
        beta = (1.0 - 0.5 * angle * c / sine) / square
    for i in range(3):
        X[i] = scale * q[i]
    a = X[1] * p[2] - X[2] * p[1], X[2] * p[0] - X[0] * p[2], X[0] * p[1] - X[1] * p[0]
    X[3] = p[0] - 0.5 * a[0] + beta * (X[1] * a[2] - X[2] * a[1])
    X[4] = p[1] - 0.5 * a[1] + beta * (X[2] * a[0] - X[0] * a[2])
    X[5] = p[2] - 0.5 * a[2] + beta * (X[0] * a[1] - X[1] * a[0])


@_compiled(types.void, _m, _v, _V)
def log(R: Array, p: Array, X: Array) -> None:
    """X (6,) with exp [X] = (R, p), angular part first."""
    _log(R, p, X)


@_inner
def _errors(
    R: Array,
    p: Array,
    V: Array,
    R_d: Array,
    p_d: Array,
    motion: Array,
    split: bool,
    X_e: Array,
    V_e: Array,
    ahead: Array,
) -> None:
    E, e, V_d = np.empty((3, 3)), np.empty(3), np.empty(6)
    for i in range(3):
        e[i] = 0.0
        for k in range(3):
            e[i] += R[k, i] * (p_d[k] - p[k])
        for j in range(3):
            E[i, j] = R[0, i] * R_d[0, j] + R[1, i] * R_d[1, j] + R[2, i] * R_d[2, j]
    _log(E, e, X_e)
    for i in range(3):
        V_d[i] = V_d[3 + i] = ahead[i] = ahead[3 + i] = 0.0
        for k in range(3):
            V_d[i] += E[i, k] * motion[k, 0]
            V_d[3 + i] += E[i, k] * motion[3 + k, 0]
            ahead[i] += E[i, k] * motion[k, 1]
            ahead[3 + i] += E[i, k] * motion[3 + k, 1]
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        if split:  # the straight way, and the acceleration of the origin less what the frame turns
            X_e[3 + i] = e[i]
            ahead[3 + i] += V_d[j] * V_d[3 + k] - V_d[k] * V_d[3 + j] - (V[j] * V[3 + k] - V[k] * V[3 + j])
        else:
            ahead[3 + i] += e[j] * ahead[k] - e[k] * ahead[j]
    if not split:
        for i in range(3):
            j, k = (i + 1) % 3, (i + 2) % 3
            V_d[3 + i] += e[j] * V_d[k] - e[k] * V_d[j]
        for i in range(3):
            j, k = (i + 1) % 3, (i + 2) % 3
            turned = V[j] * V_d[3 + k] - V[k] * V_d[3 + j]
            ahead[3 + i] -= turned + V[3 + j] * V_d[k] - V[3 + k] * V_d[j]
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        ahead[i] -= V[j] * V_d[k] - V[k] * V_d[j]
    for i in range(6):
        V_e[i] = V_d[i] - V[i]


@_compiled(types.void, _m, _v, _v, _m, _v, _m, types.boolean, _V, _V, _V)
def pose_errors(
    R: Array,
    p: Array,
    V: Array,
    R_d: Array,
    p_d: Array,
    motion: Array,
    split: bool,
    X_e: Array,
    V_e: Array,
    ahead: Array,
) -> None:
    """X_e, V_e and d/dt(Ad V_d) of a frame at (R, p) that moves with V; `motion` = [V_d | Vdot_d]."""
    _errors(R, p, V, R_d, p_d, motion, split, X_e, V_e, ahead)


@_compiled(types.void, _m, _v, _v, _m, _v, _m, _m, _V)
def computed_torque(R: Array, p: Array, V: Array, R_d: Array, p_d: Array, motion: Array, K: Array, y: Array) -> None:
    """y = d/dt(Ad V_d) + [Kp, Kd] (X_e, V_e) of a frame at (R, p)."""
    X_e, V_e = np.empty(6), np.empty(6)
    _errors(R, p, V, R_d, p_d, motion, False, X_e, V_e, y)
    for i in range(6):
        for j in range(6):
            y[i] += K[i, j] * X_e[j] + K[i, 6 + j] * V_e[j]


@_inner
def _factor(A: Array, L: Array) -> float:
    """A = L'L, L lower, with 1/L_ii on its diagonal. The smallest over the largest pivot, 0 where A is not definite.

    From the last row up: of a tree's mass matrix the zeros stay zeros, and are left out (Featherstone 2008, 6.5).
    """
    n = A.shape[0]
    for i in range(n):
        for j in range(i + 1):
            L[i, j] = A[i, j]
    small, large = math.inf, 0.0
    for k in range(n - 1, -1, -1):
        pivot = L[k, k]
        if not pivot > 0.0:
            return 0.0
        small, large = min(small, pivot), max(large, pivot)
        root = 1.0 / math.sqrt(pivot)
        L[k, k] = root
        for j in range(k):
            L[k, j] *= root
        for i in range(k):
            l = L[k, i]
            if l != 0.0:
                for j in range(i + 1):
                    L[i, j] -= l * L[k, j]
    return small / large if n else 1.0


@_inner
def _forward(L: Array, B: Array) -> None:
    """B := L^-T B, rows of B at a time."""
    n, m = B.shape
    for k in range(n - 1, -1, -1):
        for j in range(m):
            B[k, j] *= L[k, k]
        for i in range(k):
            l = L[k, i]
            if l != 0.0:
                for j in range(m):
                    B[i, j] -= l * B[k, j]


@_inner
def _backward(L: Array, B: Array) -> None:
    """B := L^-1 B."""
    n, m = B.shape
    for k in range(n):
        for i in range(k):
            l = L[k, i]
            if l != 0.0:
                for j in range(m):
                    B[k, j] -= l * B[i, j]
        for j in range(m):
            B[k, j] *= L[k, k]


@_inner
def _gram(X: Array, K: Array) -> None:
    """K = X'X."""
    n, m = X.shape
    S = np.zeros((m, m))
    for k in range(n):
        for i in range(m):
            x = X[k, i]
            if x != 0.0:
                for j in range(i + 1):
                    S[i, j] += x * X[k, j]
    for i in range(m):
        for j in range(i + 1):
            K[i, j] = K[j, i] = S[i, j]


@_compiled(types.boolean, _m, _M)
def inverse(A: Array, out: Array) -> bool:
    """out = A^-1, symmetric. False, and out is what it was, where A is nearly singular or not definite."""
    n = A.shape[0]
    L, X = np.empty((n, n)), np.zeros((n, n))
    if not _factor(A, L) > 1e-14:
        return False
    for i in range(n):
        X[i, i] = 1.0
    _backward(L, X)  # A^-1 = L^-1 L^-T
    for i in range(n):
        for j in range(i + 1):
            s = 0.0
            for k in range(j + 1):
                s += X[i, k] * X[j, k]
            out[i, j] = out[j, i] = s
    return True


@_compiled(types.boolean, _m, _m, _M, _M)
def mobility(M: Array, G: Array, lifted: Array, K: Array) -> bool:
    """lifted (n, m) = M^-1 G', where it has columns, and K = G M^-1 G'. False where M is not definite."""
    m, n = G.shape
    L, X = np.empty((n, n)), np.empty((n, m))
    for i in range(n):
        for j in range(m):
            X[i, j] = G[j, i]
    if not _factor(M, L) > 0.0:
        K[:] = math.nan
        lifted[:] = math.nan
        return False
    _forward(L, X)
    _gram(X, K)
    if lifted.size:
        _backward(L, X)
        lifted[:] = X
    return True


@_compiled(types.boolean, _m, _m, _v, _v, _V, _M)
def gauss(M: Array, G: Array, b: Array, vdot: Array, x: Array, K: Array) -> bool:
    """x = vdot + M^-1 G' K^-1 (b - G vdot) and K = G M^-1 G'. False, with K alone, where K is nearly singular."""
    m, n = G.shape
    L, X, S = np.empty((n, n)), np.empty((n, m)), np.empty((m, m))
    for i in range(n):
        for j in range(m):
            X[i, j] = G[j, i]
    if not _factor(M, L) > 0.0:
        K[:] = math.nan
        return False
    _forward(L, X)  # K = (L^-T G')' (L^-T G')
    _gram(X, K)
    if not _factor(K, S) > 1e-14:
        return False
    r = np.empty((m, 1))
    for i in range(m):
        s = b[i]
        for j in range(n):
            s -= G[i, j] * vdot[j]
        r[i, 0] = s
    _forward(S, r)
    _backward(S, r)
    f = np.empty((n, 1))
    for i in range(n):
        s = 0.0
        for j in range(m):
            s += X[i, j] * r[j, 0]
        f[i, 0] = s
    _backward(L, f)
    for i in range(n):
        x[i] = vdot[i] + f[i, 0]
    return True


@_compiled(_THREE, _m, _v, _v, _v, types.int64, _v, _v)
def residuals(
    stack: Array, g: Array, lo: Array, hi: Array, n_eq: int, x: Array, z: Array
) -> tuple[float, float, float]:
    """Primal, dual (2-norms) and gap (largest) of the conditions of `qp.Certificate`, `stack` = [H; C]."""
    n = g.size
    primal, dual, gap = 0.0, 0.0, 0.0
    r = np.empty(n)
    for j in range(n):
        r[j] = g[j] + z[j]
    for i in range(n):
        for j in range(n):
            r[j] += stack[i, j] * x[i]  # H is symmetric
    for i in range(lo.size):
        value = x[i] if i < n else 0.0
        if i >= n:
            for j in range(n):
                value += stack[i, j] * x[j]
                r[j] += stack[i, j] * z[i]
        if not (lo[i] <= value <= hi[i]):  # also where bounds cross, or one is not a number
            outside = np.maximum(value, lo[i]) - np.minimum(value, hi[i])
            primal += outside * outside
        if z[i] != 0.0 and (i < n or i >= n + n_eq):
            power = abs(z[i] * (value - (hi[i] if z[i] > 0.0 else lo[i])))
            if not (power <= gap or math.isnan(gap)):
                gap = power
    for j in range(n):
        dual += r[j] * r[j]
    return math.sqrt(primal), math.sqrt(dual), gap


@_compiled(types.boolean, _v, types.int64, types.int64, _F)
def active(z: Array, first: int, last: int, least: float) -> bool:
    """Whether a multiplier exceeds `least`, those from `first` to `last` aside."""
    most = 0.0
    for i in range(z.size):
        if i < first or i >= last:
            most = max(most, abs(z[i]))
    return most > least


@_compiled(types.void, _m, _v, _F, _M, _V)
def add_square(metric: Array, target: Array, weight: float, H: Array, g: Array) -> None:
    """Adds weight / 2 |x - target|^2 in the metric to H and g."""
    n = target.size
    for i in range(n):
        s = 0.0
        for j in range(n):
            H[i, j] += weight * metric[i, j]
            s += metric[i, j] * target[j]
        g[i] -= weight * s


@_compiled(types.void, _m, _m, _v, _M, _M, _V)
def equations(M: Array, push: Array, bias: Array, base: Array, joints: Array, nothing: Array) -> None:
    """[M, push'], its first rows in `base` and the others in `joints`; nothing = -bias of the first."""
    n, k, b = M.shape[0], push.shape[0], base.shape[0]
    for i in range(b):
        for j in range(n):
            base[i, j] = M[i, j]
        for j in range(k):
            base[i, n + j] = push[j, i]
        nothing[i] = -bias[i]
    for i in range(n - b):
        for j in range(n):
            joints[i, j] = M[b + i, j]
        for j in range(k):
            joints[i, n + j] = push[j, b + i]


@_compiled(types.void, _m, _m, types.int64, _M)
def within(K: Array, W: Array, first: int, out: Array) -> None:
    """out = K_oo - K_ho' W K_ho: a mobility of the rows `first` and on, in what those of W, the first, leave."""
    m, k = out.shape[0], W.shape[0]
    for j in range(m):
        for i in range(j + 1):
            s = K[first + i, first + j]
            for a in range(k):
                t = 0.0
                for b in range(k):
                    t += W[a, b] * K[b, first + j]
                s -= K[a, first + i] * t
            out[i, j] = out[j, i] = s


@_compiled(types.void, _m, _v, _m, _v, _m, _v, _v, _m, _V)
def point_target(
    R: Array, p: Array, motion: Array, c: Array, J: Array, v: Array, drift: Array, K: Array, b: Array
) -> None:
    """b = pddot + [Kp, Kd] (p - c, pdot - J v) - drift of a point that follows p, which moves as `motion` in axes R."""
    w0, w1, w2 = motion[0, 0], motion[1, 0], motion[2, 0]
    u0, u1, u2 = motion[3, 0], motion[4, 0], motion[5, 0]
    a = (motion[3, 1] + w1 * u2 - w2 * u1, motion[4, 1] + w2 * u0 - w0 * u2, motion[5, 1] + w0 * u1 - w1 * u0)
    e = np.empty(6)
    for i in range(3):
        e[i] = p[i] - c[i]
        e[3 + i] = R[i, 0] * u0 + R[i, 1] * u1 + R[i, 2] * u2
        for j in range(v.size):
            e[3 + i] -= J[i, j] * v[j]
        b[i] = R[i, 0] * a[0] + R[i, 1] * a[1] + R[i, 2] * a[2] - drift[i]
    for i in range(3):
        for j in range(6):
            b[i] += K[i, j] * e[j]


@_compiled(types.void, _m, _m, _F, _V, _M)
def carried(push: Array, A: Array, radius: float, weight: Array, S: Array) -> None:
    """weight (k,): 1 of a row of A that is a unit force, 1/radius^2 of a moment; S = P diag(weight)^-1 P'.

    P' (k, 6) are the first columns of `push`: what the multipliers do to a floating base.
    """
    S[:] = 0.0
    for k in range(A.shape[0]):
        size = 0.0
        for j in range(3):
            size += radius * radius * A[k, j] * A[k, j] + A[k, 3 + j] * A[k, 3 + j]
        weight[k] = 1.0 / size
        for i in range(6):
            for j in range(i + 1):
                S[i, j] += push[k, i] * push[k, j] * size
    for i in range(6):
        for j in range(i):
            S[j, i] = S[i, j]


@_compiled(types.void, _m, _v, _m, _v, _M, _V)
def share(push: Array, weight: Array, Y: Array, bias: Array, D: Array, lam: Array) -> None:
    """D = diag(weight)^-1 P' Y, and lam -= D (bias + P lam)."""
    k = weight.size
    r = np.empty(6)
    for a in range(6):
        r[a] = bias[a]
    for i in range(k):
        for a in range(6):
            r[a] += push[i, a] * lam[i]
    for i in range(k):
        for a in range(6):
            s = 0.0
            for b in range(6):
                s += push[i, b] * Y[b, a]
            D[i, a] = s / weight[i]
            lam[i] -= D[i, a] * r[a]


@_compiled(types.void, _m, _m, _v, _F, _M, _V)
def add_rows(A: Array, metric: Array, target: Array, weight: float, H: Array, g: Array) -> None:
    """Adds weight / 2 |A x - target|^2 in the metric to H and g."""
    m, n = A.shape
    C, WA, S = np.empty((m, n)), np.zeros((m, n)), np.zeros((n, n))
    for i in range(m):
        for j in range(n):
            C[i, j] = A[i, j]
    for i in range(m):
        for k in range(m):
            w = weight * metric[i, k]
            if w != 0.0:
                for j in range(n):
                    WA[i, j] += w * C[k, j]
    for k in range(m):
        t = target[k]
        for j in range(n):
            g[j] -= t * WA[k, j]
        for i in range(n):
            c = C[k, i]
            if c != 0.0:
                for j in range(i + 1):
                    S[i, j] += c * WA[k, j]
    for i in range(n):
        H[i, i] += S[i, i]
        for j in range(i):
            H[i, j] += S[i, j]
            H[j, i] += S[i, j]


@_inner
def _closing(gap: float, soft: float, j: float, settle: float) -> float:
    """m(e) of `limit`, and for a gap that is overstepped a return with the time constant T."""
    return min(math.sqrt(soft * soft + j * max(gap, 0.0)) - soft, gap / settle)


@_inner
def _towards(room: float, speed: float, a: float, lead: float, back: float, j: float, settle: float) -> float:
    """m(w - v) - w' v of `limit`, at a `room` to the edge that is closed with v = `speed`."""
    root = math.sqrt(lead * lead + 2.0 * a * max(room, 0.0))
    w, slope = root - lead, a / root
    if room < 0.0:  # beyond it: back along the same slope, no faster than `back`
        w = room * slope
        if w < back:
            w, slope = back, 0.0
    return _closing(w - speed, 0.5 * settle * j, j, settle) - slope * speed


@_compiled(types.void, _v, _v, _F, _m, _F, _V, _V)
def braking_bounds(q: Array, v: Array, dt: float, sides: Array, settle: float, lo: Array, hi: Array) -> None:
    """Bounds on vdot of `limit`; `sides` (7, 2 n): edge, v_max, a, l, the way back, j, a_max, upper then lower."""
    n = q.size
    for i in range(n):
        for side in range(2):
            sign = 1.0 - 2.0 * side
            k = i + side * n
            edge, v_max, a, lead, back, j = sides[0, k], sides[1, k], sides[2, k], sides[3, k], sides[4, k], sides[5, k]
            speed, room = sign * v[i], edge - sign * (q[i] + dt * v[i])
            most = min(_closing(v_max - speed, 0.5 * settle * j, j, settle), sides[6, k])
            if room < math.inf:
                most = min(most, _towards(room, speed, a, lead, back, j, settle))
            most = max(most, -a)  # from beyond a limit the model brakes with no more than it has
            if side == 0:
                hi[i] = most
            else:
                lo[i], hi[i] = min(-most, hi[i]), max(-most, hi[i])


@_compiled(types.void, _v, _v, _v, _F, _v, _v, _V, _V, _V, _V)
def torque_window(
    low: Array, high: Array, rate: Array, dt: float, last: Array, bias: Array, least: Array, most: Array,
    lo: Array, hi: Array,
) -> None:  # fmt: skip
    """Limits of the torque after one tick from `last`; lo and hi are those of what is added to `bias`."""
    for i in range(last.size):
        least[i] = max(low[i], last[i] - rate[i] * dt)
        most[i] = min(high[i], last[i] + rate[i] * dt)
        lo[i], hi[i] = least[i] - bias[i], most[i] - bias[i]


@_compiled(types.void, _m, _v, _v, _V)
def feedback(K: Array, a: Array, b: Array, out: Array) -> None:
    """out += K [a; b]."""
    n = a.size
    for i in range(K.shape[0]):
        s = 0.0
        for j in range(n):
            s += K[i, j] * a[j]
        for j in range(b.size):
            s += K[i, n + j] * b[j]
        out[i] += s


@_compiled(types.void, _m, _v, _v, _v, _V)
def spring(K: Array, goal: Array, at: Array, rate: Array, out: Array) -> None:
    """out = K [goal - at; rate]."""
    n = goal.size
    for i in range(K.shape[0]):
        s = 0.0
        for j in range(n):
            s += K[i, j] * (goal[j] - at[j])
        for j in range(rate.size):
            s += K[i, n + j] * rate[j]
        out[i] = s


@_compiled(types.void, _v, _v, _F, _m, _v, _V, _V)
def sense(
    measured: Array, past: Array, alpha: float, inverse: Array, desired: Array, filtered: Array, error: Array
) -> None:
    """filtered = past + alpha (measured - past); error = desired - (A')^+ filtered."""
    for j in range(6):
        filtered[j] = past[j] + alpha * (measured[j] - past[j])
    for i in range(desired.size):
        s = desired[i]
        for j in range(6):
            s -= inverse[i, j] * filtered[j]
        error[i] = s


@_compiled(_F, _v)
def total(values: Array) -> float:
    """The sum: a number only where all of them are."""
    s, t, u, w = 0.0, 0.0, 0.0, 0.0  # four at a time: each waits for its own last sum alone
    last = values.size - values.size % 4
    for i in range(0, last, 4):
        s += values[i]
        t += values[i + 1]
        u += values[i + 2]
        w += values[i + 3]
    for i in range(last, values.size):
        s += values[i]
    return (s + t) + (u + w)


@_compiled(types.void, _m, _v, _v, _v, _v, _V)
def torque(A: Array, x: Array, b: Array, lo: Array, hi: Array, tau: Array) -> None:
    """tau = A x + b, led into its bounds."""
    for i in range(tau.size):
        s = b[i]
        for j in range(x.size):
            s += A[i, j] * x[j]
        tau[i] = min(max(s, lo[i]), hi[i])


@_compiled(types.boolean, _v, _v, _v, _v, _F, _V, _V)
def advance(lam: Array, command: Array, integral: Array, error: Array, dt: float, grown: Array, missing: Array) -> bool:
    """grown = integral + dt error; missing = lam - command. Whether nothing is missing but rounding."""
    for i in range(error.size):
        grown[i] = integral[i] + dt * error[i]
    short, size = 0.0, 1.0
    for i in range(lam.size):
        missing[i] = lam[i] - command[i]
        short += missing[i] * missing[i]
        size += command[i] * command[i]
    return short <= 1e-14 * size
