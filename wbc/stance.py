"""What is measured of a robot that stands: where its mass is, how its feet slip, what they carry.

    TASK.position.rms_error, .max_error   distance of the true centre of mass from where a `com` task wants it [m]
    CONTACT.slip                          how far a point of contact went across its normal, the farthest of them [m]
    CONTACT.cone.max_excess               how far the true wrench was beyond the controller's cone [N, N m]
    CONTACT.cone.max_asked                the same of the predicted wrench [N, N m]
    CONTACT.rest.error                    predicted wrench against the true one at rest, over m g [1, m]
    weight.rest.error                     sum of the predicted vertical forces against m g at rest, relative [1]

At rest is where no velocity exceeds `REST` after `settle`. Slip is that of the robot's material points where they
touch, less that of what they touch: a foot that rolls does not slip. All are true, of every tick.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from .centroidal import ComTask, mass
from .log import Log
from .qp import Array

if TYPE_CHECKING:
    from .contact import Contact
    from .controller import Controller, Output
    from .sim import Simulator

REST = 1e-5  # [rad/s, m/s] largest velocity at rest


def record(
    log: Log, controller: Controller, simulator: Simulator, out: Output, contacts: Mapping[str, Contact]
) -> None:
    """One tick."""
    state, row = controller.state, dict[str, Any]()
    gravity = state.robot.model.gravity.linear
    weight = mass(state) * float(np.linalg.norm(gravity))
    carried, dt = np.zeros(3), controller.dt
    for name, task in controller.phase.tasks.items():
        if isinstance(task, ComTask):
            row[f"{name}.away"] = task.desired(state)[0] - simulator.true_com()
    for name, contact in contacts.items():
        speeds = simulator.true_slip(contact.frame)
        past = log[f"{name}.way"][-2] if f"{name}.way" in log and log.size > 1 else np.zeros(speeds.shape)
        row[f"{name}.way"] = past + dt * speeds
        held = state.contacts.get(name)
        if held is None or name not in out.wrenches:
            continue
        true, asked = log[f"{name}.true"][-1], out.wrenches[name]
        carried += state.frame(held.frame).T.rotation @ asked[3:]
        row[f"{name}.unforeseen"] = np.abs(asked - true).max() / weight
        if held.cone is not None:
            for which, F in (("excess", true), ("asked_excess", asked)):
                beyond = held.cone.least - held.cone.rows @ (held.inverse @ F)
                row[f"{name}.{which}"] = max(0.0, float(beyond.max()))
    if out.wrenches:
        row["weight.error"] = abs(float(carried @ gravity) / (weight * float(np.linalg.norm(gravity))) - 1.0)
    log.put(**row)


def names(phases: Sequence[Any]) -> list[str]:
    """Every figure of a run of these phases."""
    found = ["weight.rest.error"]
    for phase in phases:
        for name, task in phase.tasks.items():
            if isinstance(task, ComTask):
                found += [f"{name}.position.{figure}" for figure in ("rms_error", "max_error")]
        for name, contact in phase.contacts.items():
            found += [f"{name}.{figure}" for figure in ("slip", "rest.error")]
            if contact.pushes is not None:
                found += [f"{name}.cone.{figure}" for figure in ("max_excess", "max_asked")]
    return found


def figures(log: Log, phases: Sequence[Any], settle: float) -> dict[str, float]:
    """All of them."""
    out: dict[str, float] = {}
    phase = log["phase"].astype(int)
    resting = np.abs(log["v"]).max(axis=1) < REST
    all_late = log.late(np.ones(log.size, bool), settle)
    if "weight.error" in log:
        out["weight.rest.error"] = _largest(log["weight.error"][resting & all_late])
    for name in {name for each in phases for name, task in each.tasks.items() if isinstance(task, ComTask)}:
        late = log.late(np.array([name in each.tasks for each in phases])[phase], settle)
        away = np.linalg.norm(log[f"{name}.away"][late], axis=1) if f"{name}.away" in log else np.zeros(0)
        out[f"{name}.position.rms_error"] = float(np.sqrt(np.mean(away**2))) if away.size else math.nan
        out[f"{name}.position.max_error"] = _largest(away)
    for name in {name for each in phases for name in each.contacts if f"{name}.way" in log}:
        active = np.array([name in each.contacts for each in phases])[phase]
        late = log.late(active, settle)
        out[f"{name}.slip"] = _farthest(log[f"{name}.way"], late)
        if f"{name}.unforeseen" in log:
            out[f"{name}.rest.error"] = _largest(log[f"{name}.unforeseen"][late & resting])
        if f"{name}.excess" in log:
            out[f"{name}.cone.max_excess"] = float(np.nanmax(log[f"{name}.excess"], initial=0.0))
            out[f"{name}.cone.max_asked"] = float(np.nanmax(log[f"{name}.asked_excess"], initial=0.0))
    return out


def _largest(values: Array) -> float:
    return float(values.max()) if values.size else math.nan


def _farthest(way: Array, on: Any) -> float:
    """How far any point (N, points, 3) goes from where it is when a stretch of the ticks `on` begins."""
    if not on.any():
        return math.nan
    begins = np.flatnonzero(on & ~np.concatenate(([False], on[:-1])))
    first = begins[np.searchsorted(begins, np.flatnonzero(on), side="right") - 1]
    return float(np.linalg.norm(way[on] - way[first], axis=-1).max(initial=0.0))
