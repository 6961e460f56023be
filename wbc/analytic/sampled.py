"""What one tick dt [s] does to impedance and admittance, on an arm of effective mass Lam [kg] along one axis.

The arm is Lam xdd = u + f. At tick i the law sets u from v_i, x_i and a measurement one tick old, and holds it:

    wrench:        u = Lam a - f_(i-1),  a = (f_(i-1) - B v_i - K x_i)/M       so xdd_i = a + (f_i - f_(i-1))/Lam
    acceleration:  u = (Lam - M) xdd_(i-1) - B v_i - K x_i

Free motion is judged by the poles of the tick, v += dt xdd, then x += dt v (semi-implicit Euler, as simulators do).
Between ticks a real arm moves x by dt v + dt^2 xdd/2 with the old v; where that matters, it is said.
"""

from __future__ import annotations


def rendered_mass(M: float, B: float, dt: float, Lam: float, *, hold: bool = False) -> float:
    """M + B dt (1 - M/Lam) [kg] to first order in dt: the mass that a wrench one tick old renders.

    M xdd_i + B v_i + K x_i = f_i - (1 - M/Lam)(f_i - f_(i-1)), and f_i - f_(i-1) = dt (M jerk + B xdd + K v): among the
    values of one tick, f_i is this mass times xdd_i, B + K dt (1 - M/Lam) times v_i, K times x_i, and a little jerk.

    hold: what a hand feels, M + B dt (1 - 3/2 M/Lam), the w^2 part of F/X of the smooth motion of a real arm. There,
    on average over the tick, v_i and x_i are dt/2 old and the measured f is 3/2 dt old, but not the f that moves it:
    M xdd = f - 3/2 dt fdot (1 - M/Lam) - B (xd - dt/2 xdd) - K (x - dt/2 xd).
    """
    return M + B * dt * (1 - (1.5 if hold else 1.0) * M / Lam)


def least_stable_mass(B: float, K: float, dt: float) -> float:
    """B dt/2 + K dt^2/4 [kg]: below it free motion, f = 0, alternates from tick to tick and grows.

    With beta = B dt/M, kappa = K dt^2/M the poles are those of z^2 - (2 - beta - kappa) z + 1 - beta, and the first to
    leave the unit circle does so at z = -1: 4 - 2 beta - kappa = 0. A real arm has B dt/2 alone, and a spring's own
    bound, `least_stable_damping`, under which both are stable at this mass.
    """
    return 0.5 * B * dt + 0.25 * K * dt**2


def least_stable_damping(K: float, dt: float) -> float:
    """K dt/2 [N s/m]: a spring held over the tick feeds energy to a real arm, which needs more than this damping.

    With beta and kappa as above its poles are those of z^2 - (2 - beta - kappa/2) z + 1 - beta + kappa/2: product 1.
    """
    return 0.5 * K * dt


def acceleration_feedback_limit(Lam: float, B: float = 0.0, K: float = 0.0, dt: float = 0.0) -> float:
    """2 Lam - B dt/2 - K dt^2/4 [kg]: the mass above which an acceleration one tick old is unstable, 2 Lam as dt -> 0.

    Lam xdd_i = (Lam - M) xdd_(i-1) - B v_i - K x_i: the acceleration alone repeats itself by the factor 1 - M/Lam,
    below 1 in size for 0 < M < 2 Lam. With all terms (z - 1 + M/Lam)(z - 1)^2 + beta z (z - 1) + kappa z^2 = 0 with
    beta = B dt/Lam, kappa = K dt^2/Lam, at z = -1.
    """
    return 2 * Lam - least_stable_mass(B, K, dt)
