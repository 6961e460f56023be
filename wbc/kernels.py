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


@_compiled(types.void, _m, _v, _v, _M)
def frame_table(J: Array, drift: Array, v: Array, table: Array) -> None:
    """table = [J | drift | J v], angular part first, of a Jacobian (6, n) and a drift (6,), linear part first."""
    n = v.size
    for i in range(6):
        source = (i + 3) % 6
        twist = 0.0
        for j in range(n):
            table[i, j] = J[source, j]
            twist += J[source, j] * v[j]
        table[i, n] = drift[source]
        table[i, n + 1] = twist


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


@_compiled(types.void, _m, _m, _v, _v, _m, _V)
def computed_torque(action: Array, motion: Array, V: Array, e: Array, K: Array, y: Array) -> None:
    """y = Ad Vdot_d - ad_V (Ad V_d) + [Kp, Kd] (X_e, V_e), `action` = Ad and X_e = `e` with the linear part first."""
    V_d = np.empty(6)
    for i in range(6):
        source = (i + 3) % 6
        velocity, acceleration = 0.0, 0.0
        for j in range(6):
            velocity += action[source, (j + 3) % 6] * motion[j, 0]
            acceleration += action[source, (j + 3) % 6] * motion[j, 1]
        V_d[i], y[i] = velocity, acceleration
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        y[i] -= V[j] * V_d[k] - V[k] * V_d[j]
        y[3 + i] -= V[3 + j] * V_d[k] - V[3 + k] * V_d[j] + V[j] * V_d[3 + k] - V[k] * V_d[3 + j]
    for i in range(6):
        for j in range(6):
            y[i] += K[i, j] * e[j] + K[i, 6 + j] * (V_d[j] - V[j])


@_inner
def _factor(A: Array, L: Array) -> float:
    """A = L L', with 1/L_ii on the diagonal of L. The smallest over the largest pivot, 0 where A is not definite."""
    n = A.shape[0]
    small, large = math.inf, 0.0
    for i in range(n):
        for j in range(i + 1):
            s = A[i, j]
            for k in range(j):
                s -= L[i, k] * L[j, k]
            if i == j:
                if not s > 0.0:
                    return 0.0
                small, large = min(small, s), max(large, s)
                L[i, i] = 1.0 / math.sqrt(s)
            else:
                L[i, j] = s * L[j, j]
    return small / large


@_inner
def _forward(L: Array, B: Array) -> None:
    """B := L^-1 B, rows of B at a time."""
    n, m = B.shape
    for i in range(n):
        for k in range(i):
            l = L[i, k]
            for j in range(m):
                B[i, j] -= l * B[k, j]
        for j in range(m):
            B[i, j] *= L[i, i]


@_inner
def _backward(L: Array, B: Array) -> None:
    """B := L^-T B."""
    n, m = B.shape
    for i in range(n - 1, -1, -1):
        for j in range(m):
            B[i, j] *= L[i, i]
        for k in range(i):
            l = L[i, k]
            for j in range(m):
                B[k, j] -= l * B[i, j]


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
    _forward(L, X)  # K = (L^-1 G')' (L^-1 G')
    for i in range(m):
        for j in range(i + 1):
            s = 0.0
            for k in range(n):
                s += X[k, i] * X[k, j]
            K[i, j] = K[j, i] = s
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


@_inner
def _closing(gap: float, soft: float, j: float, settle: float) -> float:
    """m(e) of `limit`, and for a gap that is overstepped a return with the time constant T."""
    return min(math.sqrt(soft * soft + j * max(gap, 0.0)) - soft, gap / settle)


@_compiled(types.void, _v, _v, _F, _m, _F, _V, _V)
def braking_bounds(q: Array, v: Array, dt: float, sides: Array, settle: float, lo: Array, hi: Array) -> None:
    """Bounds on vdot of `limit`; `sides` (6, 2 n) are edge, v_max, a, l, the way back, j of upper, then lower sides."""
    n = q.size
    for i in range(n):
        for side in range(2):
            sign = 1.0 - 2.0 * side
            k = i + side * n
            edge, v_max, a, lead, back, j = sides[0, k], sides[1, k], sides[2, k], sides[3, k], sides[4, k], sides[5, k]
            soft = 0.5 * settle * j
            speed, room = sign * v[i], edge - sign * (q[i] + dt * v[i])
            most = _closing(v_max - speed, soft, j, settle)
            if room < math.inf:
                root = math.sqrt(lead * lead + 2.0 * a * max(room, 0.0))
                slope = a / root
                w = root - lead + max(min(room, 0.0) * slope, back)
                most = min(most, _closing(w - speed, soft, j, settle) - slope * speed)
            most = max(most, -a)  # from beyond a limit the model brakes with no more than it has
            if side == 0:
                hi[i] = most
            else:
                lo[i], hi[i] = min(-most, hi[i]), max(-most, hi[i])


@_compiled(types.void, _v, _v, _v, _F, _v, _V, _V)
def torque_window(low: Array, high: Array, rate: Array, dt: float, last: Array, lo: Array, hi: Array) -> None:
    """Limits of the torque after one tick from `last`."""
    for i in range(last.size):
        lo[i] = max(low[i], last[i] - rate[i] * dt)
        hi[i] = min(high[i], last[i] + rate[i] * dt)


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
    s = 0.0
    for value in values:
        s += value
    return s


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
