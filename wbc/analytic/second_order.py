"""The mass, spring and damper that an impedance renders, in one dimension: *Modern Robotics*, section 11.7.

m xdd + b xd + k x = f with m [kg], b [N s/m], k [N/m], f [N], x [m], and its frequency response at w [rad/s].
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from wbc.errors import GainError

from .se3 import Array


def natural_frequency(m: float, k: float) -> float:
    """wn = sqrt(k/m) [rad/s]."""
    _require(m, 0.0, k)
    return float(np.sqrt(k / m))


def damping_ratio(m: float, b: float, k: float) -> float:
    """zeta = b / (2 sqrt(k m)): critical at 1; without a spring infinite, without a damper 0."""
    _require(m, b, k)
    if b == 0 or k == 0:
        return np.inf if b > 0 else 0.0
    return float(b / (2 * np.sqrt(k * m)))


def impedance(
    m: float, b: float, k: float, w: ArrayLike, *, delay: float = 0.0, cutoff: float | None = None
) -> NDArray[np.complex128]:
    """Z(jw) = F/X = (k - m w^2 + j b w) L(jw) [N/m], of the force commanded from a motion measured through L.

    With a delay or a cutoff, `measurement` L multiplies what the controller adds, here all of Z.
    """
    _require(m, b, k, massless=True)
    w = np.asarray(w, dtype=np.float64)
    return np.asarray((k - m * w**2 + 1j * b * w) * measurement(w, delay, cutoff))


def admittance(
    m: float, b: float, k: float, w: ArrayLike, *, delay: float = 0.0, cutoff: float | None = None
) -> NDArray[np.complex128]:
    """Y(jw) = X/F = L(jw) / (k - m w^2 + j b w) [m/N], of the motion commanded from a force measured through L.

    Y Z = 1 when nothing lies between. Unbounded, hence nan or inf, at w = 0 without a spring and at resonance undamped.
    """
    return np.asarray(measurement(w, delay, cutoff) / impedance(m, b, k, w))


def measurement(w: ArrayLike, delay: float = 0.0, cutoff: float | None = None) -> NDArray[np.complex128]:
    """L(jw) = exp(-jw delay) / (1 + jw/(2 pi cutoff)): a pure delay [s], then a filter of first order, cutoff [Hz]."""
    w = np.asarray(w, dtype=np.float64)
    filtered = 1.0 if cutoff is None else 1 + 1j * w / (2 * np.pi * cutoff)
    return np.asarray(np.exp(-1j * w * delay) / filtered)


def step_response(m: float, b: float, k: float, f: float, t: ArrayLike) -> tuple[Array, Array]:
    """x, xd [m, m/s] at t >= 0 [s], shaped as t, of m xdd + b xd + k x = f from rest; b = 0 and k = 0 included.

    xd = f/m e^(-ct) S,  x = f/k (1 - e^(-ct) (C + c S)),  c = b/(2m),  s^2 = c^2 - k/m
    C, S = cosh(st), sinh(st)/s over-damped;  1, t critically damped;  cos(rt), sin(rt)/r, r^2 = -s^2, under-damped
    k = 0:  x = f/m (t - (1 - e^(-2ct))/(2c))/(2c),  and f t^2/(2m) without a damper
    """
    _require(m, b, k)
    t, c = np.asarray(t, dtype=np.float64), b / (2 * m)
    s2 = c * c - k / m
    if s2 <= 0:
        r = np.sqrt(-s2)
        decay = np.exp(-c * t)
        C, S = decay * np.cos(r * t), decay * t * np.sinc(r * t / np.pi)
        x = 0.5 * t**2 / m if k == 0 else (1 - C - c * S) / k
    else:
        s = np.sqrt(s2)
        slow = k / m / (c + s)  # the poles are -slow and -(c + s); c - s would cancel
        decay, lag = np.exp(-slow * t), -np.expm1(-2 * s * t)
        S = decay * lag / (2 * s)
        if s > 0.5 * c:  # poles well apart, k = 0 among them: one exponential less the other
            x = (_rise(slow, t) - _rise(c + s, t)) / (2 * s * m)
        else:
            x = (1 - decay * (1 - 0.5 * lag) - c * S) / k
    return np.asarray(f * x), np.asarray(f / m * S)


def impact_peak(m: float, b: float, k: float, v: float) -> float:
    """Largest force b xd + k x [N] of a mass that meets spring and damper, side by side, at a speed v >= 0 [m/s].

    With m xdd + b xd + k x = 0, x = 0 and xd = v at first, wn = sqrt(k/m) and zeta = b / (2 sqrt(k m)) = sin(psi):

    b v                                              zeta >= 1/2, at once
    sqrt(k m) v exp(-(pi/2 - 3 psi) tan(psi))        else, at sqrt(1 - zeta^2) wn t = pi/2 - 3 psi
    """
    _require(m, b, k)
    _require_speed(v)
    if b * b >= k * m:
        return b * v
    psi = float(np.arcsin(damping_ratio(m, b, k)))
    return float(np.sqrt(k * m) * v * np.exp(-(np.pi / 2 - 3 * psi) * np.tan(psi)))


def _require_speed(v: float) -> None:
    if not (np.isfinite(v) and v >= 0):
        raise GainError(f"v: got {v:.6g}, expected a finite speed of at least 0")


def _rise(p: float, t: Array) -> Array:
    """int_0^t e^(-ps) ds."""
    return np.asarray(t if p == 0 else -np.expm1(-p * t) / p)


def _require(m: float, b: float, k: float, *, massless: bool = False) -> None:
    for name, value, zero in (("m", m, massless), ("b", b, True), ("k", k, True)):
        if not (np.isfinite(value) and (value > 0 or (zero and value == 0))):
            raise GainError(f"{name}: got {value:.6g}, expected a finite number {'of at least' if zero else 'above'} 0")
