"""The vocabulary of measured quantities: what `expect` bounds and `summary.json` reports, all true, every tick.

    CONTACT.AXIS.rms_error, .max_error, .mean      wrench of the robot on the environment against its target [N, N m]
        of screws and matrices also along the wrench axes mx ... fz, of what the constraint causes: A' lambda
    CONTACT.AXIS.slip                              how far the frame went along an axis that is held [m, rad]
    CONTACT.AXIS.speed.max                         speed along an axis that is held, from the first tick [m/s, rad/s]
    CONTACT.lost                                   ticks after first touch in which the contact carried no force
    TASK.position.rms_error, .max_error            distance to the reference along the task's free axes [m]
    TASK.rotation.rms_error, .max_error            angle to the reference about the task's free axes [rad]
    TASK.SCREW.rms_error, .max_error               distance along a free screw of the contact [rad; m of a slide]
    TASK.speed.max                                 speed of the task frame [m/s]
    torque.max_excess, torque.max_share            torque beyond its limit [N m], largest share of a limit used
    torque_rate.max, torque_rate.max_excess        [N m/s]
    joint.max_excess                               position beyond its limit [rad]
    ticks.not_ok, .limited, .degraded              number of ticks by status

Figures leave out the first `settle` seconds, all but those of torque, joints and ticks, which hold from the first tick.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from .contact import AxesContact, Contact
from .log import Log
from .qp import Array
from .task import ForceTask, MotionTask
from .wrench import VELOCITY_AXES, WRENCH_AXES

ALWAYS = (
    "torque.max_excess", "torque.max_share", "torque_rate.max", "torque_rate.max_excess", "joint.max_excess",
    "ticks.not_ok", "ticks.limited", "ticks.degraded",
)  # fmt: skip


def vocabulary(phases: Sequence[Any]) -> list[str]:
    """Every metric that a run of these phases reports."""
    names = list(ALWAYS)
    for phase in phases:
        for task in phase.tasks.values():
            if isinstance(task, ForceTask):
                names += [
                    f"{task.contact}.{axis}.{figure}"
                    for axis in (*task.axes, *(WRENCH_AXES if task.wrench else ()))
                    for figure in ("rms_error", "max_error", "mean")
                ]
        names += [f"{contact}.lost" for contact in phase.contacts]
        for name, contact in phase.contacts.items():
            names += [f"{name}.{axis}.{figure}" for axis in _held_axes(contact) for figure in ("slip", "speed.max")]
        for name, task in phase.tasks.items():
            if isinstance(task, MotionTask):
                names += [f"{name}.{figure}" for figure in _MOTION]
                names += [
                    f"{name}.{screw}.{figure}" for screw in _screws(task) for figure in ("rms_error", "max_error")
                ]
    return sorted(set(names))


_MOTION = ("position.rms_error", "position.max_error", "rotation.rms_error", "rotation.max_error", "speed.max")


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
    late = log["t"] >= settle - 1e-9
    out: dict[str, float] = {}
    for phase in phases:
        for name, task in phase.tasks.items():
            if isinstance(task, ForceTask):
                pairs = [("lam", "target", task.axes)]
                pairs += [("carried", "wanted", WRENCH_AXES)] if task.wrench else []  # where both have names, this
                for got, wanted, axes in pairs:
                    value = log[f"{task.contact}.{got}"][late]
                    error = value - log[f"{task.contact}.{wanted}"][late]
                    for i, axis in enumerate(axes):
                        out |= _errors(f"{task.contact}.{axis}", error[:, i])
                        out[f"{task.contact}.{axis}.mean"] = float(value[:, i].mean()) if late.any() else math.nan
            elif isinstance(task, MotionTask):
                error = log[f"{name}.error"][late]
                out |= _errors(f"{name}.position", np.linalg.norm(error[:, 3:], axis=1))
                out |= _errors(f"{name}.rotation", np.linalg.norm(error[:, :3], axis=1))
                for i, screw in enumerate(_screws(task)):
                    out |= _errors(f"{name}.{screw}", log[f"{name}.along"][late][:, i])
                out[f"{name}.speed.max"] = float(log[f"{name}.speed"][late].max()) if late.any() else math.nan
        for contact, held in phase.contacts.items():
            for i, axis in enumerate(_held_axes(held)):
                way = np.cumsum(log[f"{contact}.slip"][late][:, i]) * log.meta["dt"]
                out[f"{contact}.{axis}.speed.max"] = float(np.nanmax(np.abs(log[f"{contact}.slip"][:, i])))
                out[f"{contact}.{axis}.slip"] = float(np.abs(way).max(initial=0.0)) if late.any() else math.nan
            force = np.linalg.norm(log[f"{contact}.true"], axis=1) > 0.0
            touched = np.maximum.accumulate(force) & late
            out[f"{contact}.lost"] = float((touched & ~force).sum())
    return out | _limits(log)


def _errors(name: str, error: Array) -> dict[str, float]:
    if not error.size:
        return {f"{name}.rms_error": math.nan, f"{name}.max_error": math.nan}  # nothing was measured: no bound holds
    return {f"{name}.rms_error": float(np.sqrt(np.mean(error**2))), f"{name}.max_error": float(np.abs(error).max())}


def _limits(log: Log) -> dict[str, float]:
    tau, low, high = log["tau"], log["tau_min"], log["tau_max"]
    rate = np.abs(np.diff(tau, axis=0)) / log.meta["dt"]
    limit = log["torque_rate_limit"][1:]
    joint = (
        np.maximum(log["q"] - log.meta["q_max"], np.array(log.meta["q_min"]) - log["q"])
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
