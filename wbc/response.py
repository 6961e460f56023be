"""What a push or a moved wall tells of a run: the mass, spring and damper that is felt, frequency responses, stiffness.

All from true quantities. Along the axes of a compliant task, x and xd are its displacement and velocity relative to the
reference, xdd the acceleration until the next tick less the reference's, f the push. Least squares over the ticks of

    M xdd_i + B xd_i + K x_i = f_i                                            as it is felt
    M xdd_i + B xd_i + K x_i = f_i - c_i,     c_i what law and tick predict:  as the law says

    impedance, wrench one tick old      c = (I - M W)(f_i - f_(i-1))          W = Lam^-1: felt M + B dt (1 - M/Lam)
    impedance, acceleration             c = (Lam - M)(xdd_i - xdd_(i-1))
    impedance, massless                 c = Lam(q) xdd_i, no M
    admittance                          c = f_i - f_(i-1)                     felt M + B dt
    admittance, printed                 c = f_i - f_(i-1) - M W f_i           felt (M^-1 + W)^-1

The second fit finds the numbers of the spec, and so holds the first to its prediction, `analytic.sampled`. Errors are
relative, in the norm in which the asked matrix is the identity.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from .analytic import admittance, force_stiffness, motion_compliance, step_response
from .log import Log
from .observer import errors as observer_errors
from .qp import Array
from .task.force import ForceTask
from .task.impedance import AdmittanceTask, Compliance, ImpedanceTask
from .task.motion import MotionTask
from .wrench import VELOCITY_AXES

Complex = NDArray[np.complex128]
FIT = ("mass_error", "damping_error", "stiffness_error")


class Fit(NamedTuple):
    """Mass, damping and stiffness (s, s) that fit a run; nan where it does not tell."""

    M: Array
    B: Array
    K: Array


def identify(log: Log, name: str, task: Compliance, settle: float = 0.0, law: bool = False) -> Fit:
    """The fit of a task's ticks after `settle` [s]: as felt, or with `law` as the law says. Nan where nothing moves."""
    x, xd, f, xdd = _motion(log, name)
    W, late = log[f"{name}.mobility"][1:-1], log["t"][1:-1] >= settle - 1e-9
    massless = isinstance(task, ImpedanceTask) and task.massless
    f = f[1:] - _predicted(task, xdd, f, W) if law or massless else f[1:]
    columns, s = np.hstack(([] if massless else [xdd[1:]]) + [xd[1:-1], x[1:-1]]), x.shape[1]
    late &= np.isfinite(columns).all(axis=1) & np.isfinite(f).all(axis=1)  # phases without the task say nothing of it
    A, unknown = columns[late], np.full((s, s), np.nan)
    if np.linalg.matrix_rank(A / np.maximum(np.abs(A).max(axis=0, initial=0.0), 1e-12), tol=1e-6) < A.shape[1]:
        return Fit(unknown, unknown, unknown)
    parts = np.asarray(np.linalg.lstsq(A, f[late], rcond=None)[0].T, float)
    return Fit(unknown if massless else parts[:, :s], parts[:, -2 * s : -s], parts[:, -s:])


def _motion(log: Log, name: str) -> tuple[Array, Array, Array, Array]:
    """x, xd (N, s), and f, xdd (N - 1, s)."""
    x, xd, f = (log[f"{name}.{part}"] for part in ("displacement", "rate", "external"))
    return x, xd, f[:-1], np.diff(log[f"{name}.twist"], axis=0) / log.meta["dt"] - log[f"{name}.ahead"][:-1]


def _predicted(task: Compliance, xdd: Array, f: Array, W: Array) -> Array:
    """(N - 2, s) c of ticks 1 .. N - 2."""
    df: Array = np.diff(f, axis=0)
    if isinstance(task, AdmittanceTask):
        return df - _times(task.M @ W, f[1:]) if task.printed else df
    if task.massless:
        return _times(np.asarray(np.linalg.inv(W)), xdd[1:])
    if task.source == "acceleration":
        return _times(np.asarray(np.linalg.inv(W) - task.M), np.diff(xdd, axis=0))
    return df - _times(task.M @ W, df)


def _times(A: Array, x: Array) -> Array:
    return np.einsum("nij,nj->ni", A, x)


def _error(found: Array, asked: Array) -> float:
    """|L^-1 (found - asked) L^-T|, asked = L L'; nan where nothing is asked."""
    if not asked.any() or not np.isfinite(found).all():
        return math.nan
    L = np.linalg.cholesky(0.5 * (asked + asked.T))
    return float(np.linalg.norm(np.linalg.solve(L, np.linalg.solve(L, found - asked).T), 2))


def names(phases: Sequence[Any], plant: Any) -> list[str]:
    """The metrics that `figures` gives of a run of these phases under what the plant does to it."""
    found: list[str] = []
    for phase in phases:
        for name, task in phase.compliant.items():
            fits = (*FIT, *(f"law.{each}" for each in FIT)) if task.K_scale is None else ()  # of what stays as it is
            found += [f"{name}.{figure}" for figure in (*fits, "speed.max")]
            found += [f"{name}.external.{figure}" for figure in ("rms_error", "lag")] if task.observer else []
            if len(task.axes) == 1 and task.K_scale is None:
                found += [f"{name}.{figure}" for figure in ("step_error", "bode.gain_error", "bode.phase_error")]
        if plant is not None and plant.pushes:
            found += [f"{name}.compliance_error" for name, t in phase.tasks.items() if isinstance(t, MotionTask)]
        if plant is not None and plant.moves:
            found += [f"{t.contact}.stiffness_error" for t in phase.tasks.values() if isinstance(t, ForceTask)]
            found += ["stiffness.ratio"] if plant.pushes else []
    return found


def figures(log: Log, phases: Sequence[Any], settle: float) -> dict[str, float]:
    """What a push or a moved wall tells, of tasks that meet one."""
    out: dict[str, float] = {}
    stiffness: dict[str, float] = {}
    for phase in phases:
        for name, task in phase.compliant.items():
            if f"{name}.displacement" in log and log.size > 3:
                out |= _compliant(log, name, task, settle)
        for name, task in phase.tasks.items():
            if isinstance(task, MotionTask) and (found := compliance(log, name, task)):
                out[f"{name}.compliance_error"] = abs(found[0] / found[1] - 1)
                stiffness["high"] = 1 / found[0]
            if isinstance(task, ForceTask) and (found := yielding(log, task)):
                out[f"{task.contact}.stiffness_error"] = abs(found[0] / found[1] - 1)
                stiffness["low"] = found[0]
    if len(stiffness) == 2:
        out["stiffness.ratio"] = stiffness["low"] / stiffness["high"]
    return out


def _compliant(log: Log, name: str, task: Compliance, settle: float) -> dict[str, float]:
    out = {f"{name}.speed.max": float(log[f"{name}.speed"][log["t"] >= settle].max(initial=0.0))}
    for part, law in (("", False), ("law.", True)) if task.K_scale is None else ():
        fit = identify(log, name, task, settle, law)
        out |= {
            f"{name}.{part}{figure}": _error(*pair) for figure, *pair in zip(FIT, fit, task_parts(task), strict=True)
        }
    if task.observer is not None:
        late = log["t"] >= settle
        model, lag = observer_errors(log[f"{name}.felt"], log[f"{name}.external"], task.observer.cutoff, log.meta["dt"])
        out[f"{name}.external.rms_error"], out[f"{name}.external.lag"] = _rms(model[late]), _rms(lag[late])
    if len(task.axes) == 1 and task.K_scale is None:
        out |= _second_order(log, name, task)
    return out


def task_parts(task: Compliance) -> Fit:
    """What a task asks for."""
    return Fit(task.M, task.B, task.K)


# --- one axis: step and frequency response ---


def _second_order(log: Log, name: str, task: Compliance) -> dict[str, float]:
    out: dict[str, float] = {}
    if step := _step(log, task):
        start, end, f = step
        on = (log["t"] >= start - 1e-9) & (log["t"] < end - 1e-9)
        m, b, k = (float(part[0, 0]) for part in task_parts(task))
        if on.any() and m > 0 and k > 0:
            x = step_response(m, b, k, f, log["t"][on] - start)[0]
            out[f"{name}.step_error"] = float(np.abs(log[f"{name}.displacement"][on, 0] - x).max() / abs(f / k))
    if (found := bode(log, name, task)) is not None:
        ratio = found.Y / found.theory
        out[f"{name}.bode.gain_error"] = float(np.abs(20 * np.log10(np.abs(ratio))).max())
        out[f"{name}.bode.phase_error"] = float(np.abs(np.degrees(np.angle(ratio))).max())
    return out


class Bode(NamedTuple):
    """Admittance X/F [m/N] at frequencies w [rad/s]: as measured, and as the theory has it, with its delay."""

    w: Array
    Y: Complex
    theory: Complex


def bode(log: Log, name: str, task: Compliance) -> Bode | None:
    """The response of a task along its one axis to the sines of a push, over their last whole periods.

    The delay is that of the measured wrench, one tick; of it an impedance feels the share 1 - M/Lam, for what moves the
    arm itself is not delayed (`analytic.sampled`).
    """
    for push in log.meta.get("pushes", {}).values():
        amplitude, frequencies = push["axes"].get(_wrench_axis(task), (0.0, ()))
        if push["frame"] != task.frame or not amplitude or not frequencies:
            continue
        m, b, k = (float(part[0, 0]) for part in task_parts(task))
        dt, w = log.meta["dt"], 2 * np.pi * np.array(frequencies)
        ticks = max(1, round(_period(frequencies) / dt))
        count = int((log["t"][-1] - push["from"]) / dt * 0.6) // ticks * ticks  # what remains is left to settle in
        if not 0 < count < log.size or not np.isfinite(log[f"{name}.displacement"][-count:]).all():
            return None
        Lam = 1 / log[f"{name}.mobility"][-count:, 0, 0].mean()
        delay = dt if isinstance(task, AdmittanceTask) else dt * (1 - m / Lam) if m else 0.0
        t = log["t"][-count:]
        X, F = (_phasors(t, log[f"{name}.{part}"][-count:, 0], w) for part in ("displacement", "external"))
        return Bode(w, X / F, admittance(m or Lam, b, k, w, delay=delay))
    return None


def responses(log: Log, phases: Sequence[Any]) -> dict[str, Bode]:
    """The frequency responses that a run measured, by task."""
    tasks = [(n, task) for phase in phases for n, task in phase.compliant.items() if len(task.axes) == 1]
    found = {name: bode(log, name, task) for name, task in tasks if f"{name}.displacement" in log}
    return {name: each for name, each in found.items() if each is not None}


def _step(log: Log, task: Compliance) -> tuple[float, float, float] | None:
    """Begin, end [s] and size of a steady push along the one axis of a task."""
    for push in log.meta.get("pushes", {}).values():
        amplitude, frequencies = push["axes"].get(_wrench_axis(task), (0.0, ()))
        if push["frame"] == task.frame and amplitude and not frequencies:
            return push["from"], push["to"] or math.inf, amplitude
    return None


def _wrench_axis(task: Compliance) -> str:
    return task.axes[0].replace("w", "m").replace("v", "f")


def _period(frequencies: Sequence[float]) -> float:
    """The shortest time that holds whole periods of all, in steps of a millihertz."""
    return 1e3 / math.gcd(*(max(1, round(1e3 * each)) for each in frequencies))


# --- the two ideals: how a motion controller gives way, how a force controller resists ---


def compliance(log: Log, name: str, task: MotionTask) -> tuple[float, float] | None:
    """(dx/f as measured, 1/(kp Lam)) [m/N] under a steady push along one axis, from its last tenth."""
    for label, push in log.meta.get("pushes", {}).items():
        steady = [(axis, size) for axis, (size, frequencies) in push["axes"].items() if size and not frequencies]
        if push["frame"] != task.frame or len(steady) != 1 or f"{label}.mobility" not in log:
            continue
        (axis, f) = steady[0]
        i = ("mx", "my", "mz", "fx", "fy", "fz").index(axis)
        end = min(push["to"] or math.inf, log["t"][-1] + log.meta["dt"])
        last = (log["t"] >= end - 0.1 * (end - push["from"])) & (log["t"] < end)
        if last.any() and task.Kp[i, i] > 0 and VELOCITY_AXES[i] in task.axes:
            dx = -log[f"{name}.error"][last, i].mean()
            Lam = 1 / log[f"{label}.mobility"][last, i, i].mean()
            return float(dx / f), float(motion_compliance(task.Kp[i, i], Lam))
    return None


def yielding(log: Log, task: ForceTask) -> tuple[float, float] | None:
    """(f/dx as measured, Lam w^2/|1 + Kp + Ki/(jw)|) [N/m] at a contact of one axis that is moved by a sine."""
    place = f"{task.contact}.place"
    for move in log.meta.get("moves", {}).values():
        frequencies: Sequence[float] = move["frequencies"]
        if len(frequencies) != 1 or len(task.axes) != 1 or place not in log:
            continue
        dt, w = log.meta["dt"], 2 * np.pi * frequencies[0]
        ticks = max(1, round(1 / frequencies[0] / dt))
        count = int((log["t"][-1] - move["from"]) / dt * 0.6) // ticks * ticks
        if 0 < count < log.size and np.isfinite(log[place][-count:]).all():
            t, at = log["t"][-count:], np.array([w])
            error = (log[f"{task.contact}.lam"] - log[f"{task.contact}.target"])[-count:, 0]
            x = log[place][-count:] @ np.array(move["along"])
            Lam = 1 / log[f"{task.contact}.mobility"][-count:, 0, 0].mean()
            predicted = force_stiffness(w, Lam, float(task.Kp[0, 0]), float(task.Ki[0, 0]))
            return float(abs(_phasors(t, error, at)[0] / _phasors(t, x, at)[0])), float(predicted)
    return None


def _phasors(t: Array, y: Array, w: Array) -> Complex:
    """(n,) Y of y = sum Re(Y e^(jwt)) beside a constant and a drift, by least squares."""
    angle = np.outer(t, w)
    A = np.column_stack((np.cos(angle), np.sin(angle), np.ones(t.size), t - t.mean()))
    a, b = np.linalg.lstsq(A, y, rcond=None)[0][: 2 * w.size].reshape(2, -1)
    return np.asarray(a - 1j * b)


def described(plant: Any) -> dict[str, Mapping[str, Any]]:
    """What the log keeps of pushes and moves."""
    from .spec.push import entries

    if plant is None:
        return {"pushes": {}, "moves": {}}
    pushes = {
        name: {"frame": push.frame, "axes": entries(push.wrench), "from": push.from_, "to": push.to}
        for name, push in plant.pushes.items()
    }
    moves = {
        name: {
            "along": (np.array(move.along) / np.linalg.norm(np.array(move.along))).tolist(),
            "frequencies": move.sine.frequencies, "amplitude": move.sine.amplitude, "from": move.from_,
        }
        for name, move in plant.moves.items()
    }  # fmt: skip
    return {"pushes": pushes, "moves": moves}


def _rms(error: Array) -> float:
    return float(np.sqrt(np.mean(np.sum(error**2, axis=1)))) if error.size else math.nan
