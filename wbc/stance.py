"""What is measured of a robot that stands: where its mass is, how its feet slip, what they carry.

    TASK.position.rms_error, .max_error   distance of the true centre of mass from where a `com` task wants it [m]
    TASK.internal.rms_error, .max_error   `press` of a distribution: internal force of the true wrenches, by
                                          `DistributionTask.internal`, against the one asked for [N]
    CONTACT.slip                          how far a point of contact went across its normal, the farthest of them [m]
    CONTACT.cone.max_excess               how far the true wrench was beyond the controller's cone [N, N m]
    CONTACT.cone.max_asked                the same of the predicted wrench [N, N m]
    CONTACT.rest.error                    predicted wrench against the true one at rest, over m g [1, m]
    CONTACT.motion.error                  the same at every tick after `settle`, whatever moves [1, m]
    weight.rest.error                     sum of the predicted vertical forces against m g at rest, relative [1]

    CONTACT.unnoticed                     longest time for which the controller counted on a contact without force [s]
    TASK.landing                          of a motion that ends where its frame becomes a contact: distance across the
                                          floor, at the first force, from where it was to end, the farthest [m]
    base.tilt.max, base.drop              largest angle of the base from that of the start [deg], its way down [m]
  of a robot that is pushed, after the end of the last push:
    CONTACT.back                          when a contact that had lost its force has it back for good [s]
    recovery                              from when on it is at rest: no velocity exceeds `RECOVERED` [s]

At rest is where no velocity exceeds `REST` after `settle`. Slip is that of the robot's material points where they
touch, less that of what they touch: a foot that rolls does not slip. All are true, of every tick.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from .log import Log
from .qp import Array
from .task.centroidal import ComTask, DistributionTask, load, on_base
from .task.motion import MotionTask

if TYPE_CHECKING:
    from .contact import Contact
    from .memory import Output
    from .phase import Phase
    from .robot import Robot
    from .sim import Simulator
    from .state import State
    from .touch import Touch

REST = 1e-5  # [rad/s, m/s] largest velocity at rest
RECOVERED = 0.02  # [rad/s, m/s] the same after a push
COUNTED = 0.01  # of m g: with more the controller counts on a contact
_ERRORS = ("rms_error", "max_error")
_LOGGED = {"position": "away", "internal": "lacking"}


class Standing:
    """Records how a robot stands, a row a tick; `dt` [s] of a tick."""

    def __init__(self, robot: Robot, simulator: Simulator, dt: float) -> None:
        self._simulator, self._dt = simulator, dt
        gravity = robot.model.gravity.linear
        self._g = float(np.linalg.norm(gravity))
        self._down = gravity / self._g if self._g else gravity
        self._ways: dict[str, Array] = {}  # (points, 3) that the points of each contact have gone so far

    def record(
        self,
        row: dict[str, Any],
        phase: Phase,
        state: State,
        out: Output,
        contacts: Mapping[str, Contact],
        true: Mapping[str, Touch],
    ) -> None:
        """One tick, at its true state; `row` has what the contacts carry, and gets the rest."""
        weight, down = load(state) * self._g, 0.0
        for name, task in phase.tasks.items():
            if isinstance(task, ComTask):
                row[f"{name}.away"] = task.desired(state)[0] - self._simulator.true_com()
            if isinstance(task, DistributionTask) and task.press:
                lam = {contact: row[f"{contact}.lam"] for contact in state.contacts}
                row[f"{name}.lacking"] = np.atleast_1d(np.subtract(*task.internal(state, lam)))
        for name, contact in contacts.items():
            speeds = self._simulator.true_slip(contact.frame)
            way = self._ways[name] = self._ways.get(name, 0.0) + self._dt * speeds
            row[f"{name}.place"], row[f"{name}.way"] = state.frame(contact.frame).p, way
            held = state.contacts.get(name)
            if held is None or name not in out.wrenches:
                continue
            F, asked = true[name].F, out.wrenches[name]
            down += float(self._down.dot(on_base(state, held.seen, asked)))
            counted = math.sqrt(asked[3:].dot(asked[3:])) > COUNTED * weight
            row[f"{name}.unnoticed"] = float(counted and not F.any())
            row[f"{name}.unforeseen"] = np.abs(asked - F).max() / weight
            if held.cone is not None:
                row[f"{name}.excess"] = held.cone.excess(row[f"{name}.lam"])
                row[f"{name}.asked_excess"] = held.cone.excess(row[f"{name}.asked"])
        if out.wrenches:
            row["weight.error"] = abs(down / weight - 1.0)


def _followed(task: Any) -> str:
    """What a task is to follow that is measured here: the centre of mass, or an internal force."""
    if isinstance(task, ComTask):
        return "position"
    return "internal" if isinstance(task, DistributionTask) and task.press else ""


def names(phases: Sequence[Any], plant: Any = None) -> list[str]:
    """Every figure of a run of these phases, under what the plant does to them."""
    pushed, landings = plant is not None and bool(plant.pushes), [f"{name}.landing" for name in _landings(phases)]
    found = ["weight.rest.error", "base.tilt.max", "base.drop", *(["recovery"] if pushed else []), *landings]
    for phase in phases:
        for name, task in phase.tasks.items():
            found += [f"{name}.{_followed(task)}.{figure}" for figure in _ERRORS if _followed(task)]
        for name, contact in phase.contacts.items():
            found += [f"{name}.{figure}" for figure in ("slip", "rest.error", "motion.error", "unnoticed")]
            found += [f"{name}.back"] if pushed else []
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
    followed = {(name, _followed(task)) for each in phases for name, task in each.tasks.items()}
    for name, quantity in [each for each in followed if each[1]]:
        active = [name in each.tasks and _followed(each.tasks[name]) == quantity for each in phases]
        late, logged = log.late(np.array(active)[phase], settle), f"{name}.{_LOGGED[quantity]}"
        away = np.linalg.norm(log[logged][late], axis=1) if logged in log else np.zeros(0)
        out[f"{name}.{quantity}.rms_error"] = float(np.sqrt(np.mean(away**2))) if away.size else math.nan
        out[f"{name}.{quantity}.max_error"] = _largest(away)
    for name in {name for each in phases for name in each.contacts if f"{name}.way" in log}:
        active = np.array([name in each.contacts for each in phases])[phase]
        late = log.late(active, settle)
        out[f"{name}.slip"] = _farthest(log[f"{name}.way"], late)
        if f"{name}.unforeseen" in log:
            out[f"{name}.rest.error"] = _largest(log[f"{name}.unforeseen"][late & resting])
            out[f"{name}.unnoticed"] = _longest(log[f"{name}.unnoticed"] > 0.0) * log.meta["dt"]
            out[f"{name}.motion.error"] = _largest(log[f"{name}.unforeseen"][late])
        if f"{name}.excess" in log:
            out[f"{name}.cone.max_excess"] = float(np.nanmax(log[f"{name}.excess"], initial=0.0))
            out[f"{name}.cone.max_asked"] = float(np.nanmax(log[f"{name}.asked_excess"], initial=0.0))
    return (
        out
        | _upright(log)
        | _landed(log, phases)
        | _recovered(log, [name for name in _contacts(phases) if f"{name}.way" in log])
    )


def _contacts(phases: Sequence[Any]) -> list[str]:
    """All contacts of these phases."""
    return sorted({name for phase in phases for name in phase.contacts})


def _landings(phases: Sequence[Any]) -> dict[str, tuple[str, Array]]:
    """Motion -> the contact that its frame becomes, (phases, phases) whether it does from one to the other."""
    found: dict[str, tuple[str, Array]] = {}
    for i, before in enumerate(phases):
        for j, after in enumerate(phases):
            new = {c.frame: n for n, c in after.contacts.items() if n not in before.contacts and c.footing}
            for name, task in before.tasks.items():
                if isinstance(task, MotionTask) and task.frame in new and name not in after.tasks:
                    nowhere = np.zeros((len(phases), len(phases)), bool)
                    found.setdefault(name, (new[task.frame], nowhere))[1][i, j] = True
    return found


def _landed(log: Log, phases: Sequence[Any]) -> dict[str, float]:
    """Where motions land, at the first force; what never touches the floor has no figure."""
    phase, out = log["phase"].astype(int), dict[str, float]()
    for name, (contact, lands) in _landings(phases).items():
        if f"{contact}.place" not in log:
            continue
        touching = np.flatnonzero(log[f"{contact}.true"].any(axis=1))
        away = []
        for last in np.flatnonzero(lands[phase[:-1], phase[1:]]):
            touched = touching[touching > last][:1]
            here = log[f"{contact}.place"][touched[0]] if touched.size else np.full(3, np.nan)
            away.append(float(np.linalg.norm((here - log[f"{name}.desired"][last])[:2])))
        if away:
            out[f"{name}.landing"] = float(np.max(away))
    return out


def _upright(log: Log) -> dict[str, float]:
    """How far the base is tilted from where it starts, whichever way it heads, and how far it sinks."""
    x, y, z, w = log["q"][:, 3:7].T
    up = np.column_stack((2.0 * (x * z - y * w), 2.0 * (y * z + x * w), 1.0 - 2.0 * (x * x + y * y)))  # R' z
    height = log["q"][:, 2]
    angle = np.arctan2(np.linalg.norm(np.cross(up, up[0]), axis=1), up @ up[0])
    return {"base.tilt.max": float(np.degrees(angle.max())), "base.drop": float(max(0.0, height[0] - height.min()))}


def _recovered(log: Log, contacts: Sequence[str]) -> dict[str, float]:
    """How long it takes until all is as before the pushes; nothing where that does not come."""
    ends = [push["to"] for push in log.meta.get("pushes", {}).values()]
    if not ends or None in ends or max(ends) > log["t"][-1]:
        return {}
    after = log["t"] - max(ends)
    still = {"recovery": np.abs(log["v"]).max(axis=1) < RECOVERED}
    still |= {f"{name}.back": log[f"{name}.true"].any(axis=1) for name in contacts}
    return {name: _since(after, on) for name, on in still.items()}


def _since(t: Array, on: Any) -> float:
    """From when on it is so for good; 0 where it always is, not a number where it is not at the end."""
    never = np.flatnonzero(~on & (t >= 0.0))
    if not on[-1]:
        return math.nan
    return float(t[never[-1] + 1]) if never.size else 0.0


def _longest(on: Any) -> int:
    """The most ticks in a row."""
    edges = np.flatnonzero(np.diff(np.concatenate(([0], on.astype(int), [0]))))
    return int((edges[1::2] - edges[::2]).max(initial=0))


def _largest(values: Array) -> float:
    return float(values.max()) if values.size else math.nan


def _farthest(way: Array, on: Any) -> float:
    """How far any point (N, points, 3) goes from where it is when a stretch of the ticks `on` begins."""
    if not on.any():
        return math.nan
    begins = np.flatnonzero(on & ~np.concatenate(([False], on[:-1])))
    first = begins[np.searchsorted(begins, np.flatnonzero(on), side="right") - 1]
    return float(np.linalg.norm(way[on] - way[first], axis=-1).max(initial=0.0))
