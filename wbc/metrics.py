"""The vocabulary of measured quantities: what `expect` bounds and `summary.json` reports, all true, every tick.

    CONTACT.AXIS.rms_error, .max_error, .mean      wrench of the robot on the environment against its target [N, N m]
        of screws and matrices also along the wrench axes mx ... fz, of what the constraint causes: A' lambda
    CONTACT.AXIS.slip                              how far the frame went along an axis that is held [m, rad]
    CONTACT.AXIS.speed.max                         speed along an axis that is held, from the first tick [m/s, rad/s]
    CONTACT.lost                                   ticks after first touch in which the contact carried no force
    CONTACT.peak, .pull                            largest force along its target, and against it, at any time [N]
    CONTACT.asked_pull                             the latter of what the controller asks for and predicts [N]
    CONTACT.impact                                 largest force along its target within 0.02 s of a touch of one point,
                                                   between phases without the contact and with it [N]
    CONTACT.impact_error                           of the predicted peak of such a touch, as a share of the true one [1]
    CONTACT.corners                                least number of points of contact that carried a force
  of a contact that `pushes`, and with `friction` the next three:
    CONTACT.tilt                                   largest angle between the frame and the face it closes on [deg]
    CONTACT.creep                                  where it sticks: largest speed across the push [m/s]
    CONTACT.friction.angle                         where it slides, above 0.01 m/s: largest angle between the friction
                                                   on the robot and minus its velocity [deg]
    CONTACT.friction.mu_error                      there: largest error of |f_t|/f_n, relative to the surface's mu [1]
    CONTACT.friction.share                         at any speed: mean of |f_t|/f_n, over the surface's mu [1]
    TASK.position.rms_error, .max_error            distance to the reference along the task's free axes [m]
    TASK.rotation.rms_error, .max_error            angle to the reference about the task's free axes [rad]
    TASK.singular.min                              smallest singular value of the task in what the contacts leave free
    TASK.speed.max, TASK.overshoot                 speed of the task frame, and beyond that of its reference [m/s]
    TASK.angle.rms_error, .max_error               gaze: between the axis and the direction to its target [rad]
    TASK.kx.rms_error, .max_error ... TASK.lz ...  momentum: against its target, along its axes [N m s, N s]
    TASK.SCREW.rms_error, .max_error               distance along a free screw of the contact [rad; m of a slide]
    TASK.mass_error, .damping_error, .stiffness_error      what a push feels against M, B, K of a compliant task [1]
    TASK.law.mass_error, ...                       the same, with what law and tick predict taken off (`response`)
    TASK.external.rms_error, .lag                  observer: error of its model, and of its lag [N]
    TASK.step_error, .bode.gain_error, .phase_error        one axis: against the closed form [1], [dB], [deg]
    TASK.compliance_error, CONTACT.stiffness_error, stiffness.ratio     the two ideals (`response`) [1]
    TASK.tank.min                                  least energy in its tank, from the first tick [J]
  of a robot with a floating base also what `stance` tells.
    torque.max_excess, torque.max_share            torque beyond its limit [N m], largest share of a limit used
    torque_rate.max, torque_rate.max_excess        [N m/s]
    joint.max_excess                               position beyond its limit [rad]
    self_collision.distance.min                    least distance of the pairs of bodies that are kept apart [m]
    ticks.not_ok, .limited, .degraded              number of ticks by status

Figures of a contact or a task are of the ticks in which it is active, less `settle` seconds after each of its begins;
peaks, pulls, impacts, overshoots, and what is said of torque, joints and ticks count from the first tick.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from . import response, stance
from .contact import Contact
from .contact.axes import AxesContact
from .log import Log
from .qp import Array
from .task.centroidal import MomentumTask
from .task.force import ForceTask
from .task.motion import MotionTask
from .task.relative import GazeTask
from .wrench import VELOCITY_AXES, WRENCH_AXES

_LOGGED: dict[type, str] = {GazeTask: "angle", MomentumTask: "lacking"}
SLIDING = 0.01  # [m/s] from which the direction of friction is judged
APART = "self_collision.distance"
ALWAYS = (
    "torque.max_excess", "torque.max_share", "torque_rate.max", "torque_rate.max_excess", "joint.max_excess",
    "ticks.not_ok", "ticks.limited", "ticks.degraded",
)  # fmt: skip


def vocabulary(phases: Sequence[Any], plant: Any = None) -> list[str]:
    """Every metric that a run of these phases reports, under what the plant does to them."""
    names = [*ALWAYS, *response.names(phases, plant)]
    names += [f"{APART}.min" for phase in phases if phase.collision is not None]
    for phase in phases:
        for task in phase.tasks.values():
            if isinstance(task, ForceTask):
                names += [
                    f"{task.contact}.{axis}.{figure}"
                    for axis in (*task.axes, *(WRENCH_AXES if task.wrench else ()))
                    for figure in ("rms_error", "max_error", "mean")
                ]
                names += [f"{task.contact}.{figure}" for figure in _PEAKS]
        for name, contact in phase.contacts.items():
            names += [f"{name}.{figure}" for figure in ("lost", "corners", *_of_push(contact))]
            names += [f"{name}.{axis}.{figure}" for axis in _held_axes(contact) for figure in ("slip", "speed.max")]
        for name, task in phase.tasks.items():
            if isinstance(task, MotionTask):
                names += [f"{name}.{figure}" for figure in _MOTION]
                names += [
                    f"{name}.{screw}.{figure}" for screw in _screws(task) for figure in ("rms_error", "max_error")
                ]
            if name in phase.tanks:
                names.append(f"{name}.tank.min")
            names += [f"{name}.{each}.{figure}" for each in _of_body(task) for figure in ("rms_error", "max_error")]
    return sorted({*names, *stance.names(phases, plant)})


_PEAKS = ("peak", "pull", "asked_pull", "impact", "impact_error")
_MOTION = (
    "position.rms_error", "position.max_error", "rotation.rms_error", "rotation.max_error", "speed.max", "overshoot",
    "singular.min",
)  # fmt: skip


def _of_body(task: Any) -> tuple[str, ...]:
    """Quantities of a gaze and of a momentum."""
    return ("angle",) if isinstance(task, GazeTask) else task.axes if isinstance(task, MomentumTask) else ()


IMPACT = 0.02  # [s] after a touch in which its force is at its peak


def _held_axes(contact: Contact) -> tuple[str, ...]:
    """Velocity axes that a contact holds, where these are its rows."""
    if not isinstance(contact, AxesContact):
        return ()
    return tuple(VELOCITY_AXES[WRENCH_AXES.index(axis)] for axis in contact.axes)


def _screws(task: MotionTask) -> tuple[str, ...]:
    """Names of the free screws that a task moves along; the axes of a frame are in the figures of its pose."""
    return () if task.contact is None or set(task.axes) <= set(VELOCITY_AXES) else task.axes


def metrics(log: Log, phases: Sequence[Any], settle: float) -> dict[str, float]:
    """All figures of a log."""
    out: dict[str, float] = {}
    tasks = {name: task for phase in phases for name, task in phase.tasks.items()}
    for task in {task.contact: task for task in tasks.values() if isinstance(task, ForceTask)}.values():
        name = task.contact
        if f"{name}.target" not in log:
            continue  # never active
        late = _late(log, [task.contact in map(_pressed, phase.tasks.values()) for phase in phases], settle)
        pairs = [("lam", "target", task.axes)]
        pairs += [("carried", "wanted", WRENCH_AXES)] if task.wrench else []  # where both have names, this
        for got, wanted, axes in pairs:
            value, target = log[f"{name}.{got}"], log[f"{name}.{wanted}"]
            for i, axis in enumerate(axes):
                out |= _errors(f"{name}.{axis}", (value - target)[late, i])
                out[f"{name}.{axis}.mean"] = float(value[late, i].mean()) if late.any() else math.nan
        out |= _peaks(log, name, [i for i, axis in enumerate(task.axes) if axis[0] == "f" or axis == "normal"])
    for name in [name for name, task in tasks.items() if isinstance(task, MotionTask)]:
        if f"{name}.error" not in log:
            continue
        active = [name in phase.tasks for phase in phases]
        late, always = _late(log, active, settle), _late(log, active, 0.0)
        error, speed = log[f"{name}.error"][late], log[f"{name}.speed"]
        out |= _errors(f"{name}.position", np.linalg.norm(error[:, 3:], axis=1))
        out |= _errors(f"{name}.rotation", np.linalg.norm(error[:, :3], axis=1))
        for i, screw in enumerate(_screws(tasks[name])):
            out |= _errors(f"{name}.{screw}", log[f"{name}.along"][late][:, i])
        out[f"{name}.speed.max"] = float(speed[late].max()) if late.any() else math.nan
        beyond = (speed - log[f"{name}.desired_speed"])[always]
        if f"{name}.singular" in log:
            told = log[f"{name}.singular"][always]
            out[f"{name}.singular.min"] = float(np.nanmin(told)) if np.isfinite(told).any() else math.nan
        out[f"{name}.overshoot"] = float(max(0.0, beyond.max())) if always.any() else math.nan
    for name, task in tasks.items():
        if isinstance(task, GazeTask | MomentumTask) and f"{name}.{_LOGGED[type(task)]}" in log:
            late = _late(log, [name in phase.tasks for phase in phases], settle)
            error = log[f"{name}.{_LOGGED[type(task)]}"][late].reshape(-1, len(_of_body(task)))
            for i, quantity in enumerate(_of_body(task)):
                out |= _errors(f"{name}.{quantity}", error[:, i])
    for name in {name for phase in phases for name in phase.contacts}:
        force = np.linalg.norm(log[f"{name}.true"], axis=1) > 0.0
        active = [name in phase.contacts for phase in phases]
        held = _late(log, active, 0.0)
        if not held.any():
            continue
        late = _late(log, active, settle)
        touched = np.maximum.accumulate(force & held) & late
        out[f"{name}.lost"] = float((touched & ~force).sum())
        contact = next(phase.contacts[name] for phase in phases if name in phase.contacts)
        out |= _push(log, name, contact, late)
        for i, axis in enumerate(_held_axes(contact) if f"{name}.rate" in log else ()):
            rate = log[f"{name}.rate"][:, i]
            way = np.cumsum(rate[late]) * log.meta["dt"]
            out[f"{name}.{axis}.speed.max"] = float(np.abs(rate[held]).max()) if held.any() else math.nan
            out[f"{name}.{axis}.slip"] = float(np.abs(way).max()) if late.any() else math.nan
    out |= response.figures(log, phases, settle) | _limits(log)
    for name in {name for phase in phases for name in phase.tanks if f"{name}.tank" in log}:
        energy = log[f"{name}.tank"]
        out[f"{name}.tank.min"] = float(np.nanmin(energy)) if np.isfinite(energy).any() else math.nan
    if APART in log:
        out[f"{APART}.min"] = float(log[APART].min())
    return out | stance.figures(log, phases, settle) if any(f"{name}.way" in log for name in _contacts(phases)) else out


def _contacts(phases: Sequence[Any]) -> set[str]:
    return {name for phase in phases for name in phase.contacts}


def _pressed(task: Any) -> str | None:
    """The contact of a force task."""
    return task.contact if isinstance(task, ForceTask) else None


def _late(log: Log, active: Sequence[bool], settle: float) -> NDArray[np.bool_]:
    """(N,) ticks of the active phases, less `settle` [s] after each time that they begin."""
    return log.late(np.array(active)[log["phase"].astype(int)], settle)


def _peaks(log: Log, name: str, linear: list[int]) -> dict[str, float]:
    """Force along and against the target, every tick; and how well an impact was predicted."""
    target = log[f"{name}.target"][:, linear]
    known = target[np.isfinite(target).all(axis=1)]
    size = float(np.linalg.norm(known.mean(axis=0))) if known.size else 0.0
    if not size:
        return {}
    force, asked = (log[f"{name}.{which}"][:, linear] @ (known.mean(axis=0) / size) for which in ("lam", "asked"))
    out = {f"{name}.peak": float(force.max()), f"{name}.pull": float(max(0.0, -force.min()))}
    out[f"{name}.asked_pull"] = float(max(0.0, -np.nanmin(asked))) if np.isfinite(asked).any() else math.nan
    if f"{name}.predicted_peak" not in log:
        return out
    predicted, steps = log[f"{name}.predicted_peak"], round(IMPACT / log.meta["dt"])
    true = {i: force[i : i + steps].max() for i in np.flatnonzero(np.isfinite(predicted))}
    if true:
        out[f"{name}.impact"] = float(max(true.values()))
        out[f"{name}.impact_error"] = float(max(abs(predicted[i] / true[i] - 1.0) for i in true))
    return out


def _of_push(contact: Contact) -> tuple[str, ...]:
    """Figures of a contact that only pushes."""
    pushes = contact.pushes
    if pushes is None:
        return ()
    tilt = () if pushes.place is None else ("tilt",)
    if not pushes.mu:
        return tilt
    sliding = () if len(pushes.held) else ("friction.angle", "friction.mu_error", "friction.share")
    return (*tilt, *(("creep",) if len(pushes.slides) == 0 else sliding))


def _push(log: Log, name: str, contact: Contact, late: NDArray[np.bool_]) -> dict[str, float]:
    points = log[f"{name}.points"]
    touched = np.maximum.accumulate(points > 0) & late & np.isfinite(points)  # not a number: not this phase's contact
    out = {f"{name}.corners": float(points[touched].min()) if touched.any() else math.nan}
    wanted = _of_push(contact)
    if "tilt" in wanted:
        out[f"{name}.tilt"] = float(np.degrees(_largest(log[f"{name}.tilt"][touched])))
    if "creep" in wanted or "friction.angle" in wanted:
        slip, drag, push = (log[f"{name}.{key}"][touched] for key in ("slip", "drag", "push"))
        speed = np.linalg.norm(slip, axis=1)
        if "creep" in wanted:
            out[f"{name}.creep"] = _largest(speed)
        else:
            mu, pressed = log[f"{name}.mu"][touched], push > 0.0
            used = np.linalg.norm(drag, axis=1)[pressed] / (mu * push)[pressed]
            out[f"{name}.friction.share"] = float(used.mean()) if used.size else math.nan
            fast = (speed > SLIDING) & pressed
            slip, drag, push, mu = slip[fast], drag[fast], push[fast], mu[fast]
            turned = slip[:, 0] * drag[:, 1] - slip[:, 1] * drag[:, 0]
            angle = np.arctan2(np.abs(turned), (slip * drag).sum(axis=1))
            out[f"{name}.friction.angle"] = float(np.degrees(_largest(angle)))
            out[f"{name}.friction.mu_error"] = _largest(np.abs(np.linalg.norm(drag, axis=1) / push - mu) / mu)
    return out


def _largest(values: Array) -> float:
    return float(values.max()) if values.size else math.nan


def _errors(name: str, error: Array) -> dict[str, float]:
    if not error.size:
        return {f"{name}.rms_error": math.nan, f"{name}.max_error": math.nan}  # nothing was measured: no bound holds
    return {f"{name}.rms_error": float(np.sqrt(np.mean(error**2))), f"{name}.max_error": float(np.abs(error).max())}


def _joints(log: Log) -> Array:
    """(N, nu) positions of the joints; a floating base comes before them."""
    return log["q"][:, -len(log.meta["q_max"]) :]


def _limits(log: Log) -> dict[str, float]:
    tau, low, high = log["tau"], log["tau_min"], log["tau_max"]
    rate = np.abs(np.diff(tau, axis=0)) / log.meta["dt"]
    limit = log["torque_rate_limit"][1:]
    joint = (
        np.maximum(_joints(log) - log.meta["q_max"], np.array(log.meta["q_min"]) - _joints(log))
        if log.meta.get("q_max")
        else np.zeros(1)
    )
    status = np.array([log.meta["status_names"][int(s)] for s in log["status"]])
    with np.errstate(invalid="ignore", divide="ignore"):
        share = np.where(np.isfinite(high), np.maximum(tau / high, tau / low), 0.0)
    return {
        "torque.max_excess": float(max(0.0, np.maximum(tau - high, low - tau).max())),
        "torque.max_share": float(share.max()),
        "torque_rate.max": float(rate.max(initial=0.0)),
        "torque_rate.max_excess": float(max(0.0, (rate - limit).max(initial=0.0))),
        "joint.max_excess": float(max(0.0, joint.max())),
        "ticks.not_ok": float((status != "OK").sum()),
        "ticks.limited": float((status == "LIMITED").sum()),
        "ticks.degraded": float(np.isin(status, ("DEGRADED", "SAFE_HOLD", "STOPPED")).sum()),
    }
