"""The closed loop: controller and simulator tick by tick, a log, figures against the bounds of the spec."""

from __future__ import annotations

import gc
import json
import math
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from . import analytic, material, stance
from .build import Built
from .centroidal import MomentumTask
from .contact import Contact
from .controller import Controller, Output, Status
from .dynamics import mobility, unheld
from .errors import SimulationError
from .feeling import unfelt
from .impedance import Compliance
from .log import Log
from .metrics import APART, metrics
from .model import quietly
from .phase import Phase, hold
from .relative import GazeTask
from .response import Bode, described, responses
from .robot import State, Terms
from .sim import Observation, Simulator, carrier
from .task import ForceTask, MotionTask
from .touch import Touch
from .transition import STOP
from .wrench import WRENCH_AXES, Wrench

STATUS_NAMES = [status.name for status in Status]


@dataclass(frozen=True)
class Result:
    """A finished run: its log, its figures, and the verdict on every bound."""

    log: Log
    summary: dict[str, Any]
    responses: dict[str, Bode] = field(default_factory=dict)

    @property
    def ok(self) -> bool:
        return bool(self.summary["ok"])

    def write(self, folder: Path) -> None:
        """`log.npz`, `summary.json`, `report.png`, and where there are frequency responses `bode.png`, in `folder`."""
        from .plot import bode_plot, report

        folder.mkdir(parents=True, exist_ok=True)
        self.log.save(folder / "log.npz")
        (folder / "summary.json").write_text(json.dumps(self.summary, indent=1) + "\n")
        report(self.log, self.summary, folder / "report.png")
        if self.responses:
            bode_plot(self.responses, str(self.log.meta.get("title", "")), folder / "bode.png")


Hook = Callable[[Observation, Output], None]


def run(
    built: Built,
    seed: int = 0,
    progress: Callable[[int], None] | None = None,
    hook: Hook | None = None,
    show: Callable[[Simulator], None] | None = None,
) -> Result:
    """Simulate a built spec for its duration.

    `progress` is told the number of ticks done, `hook` sees every tick, `show` draws the simulator.
    """
    spec, controller = built.spec, built.controller
    dt = controller.dt
    ticks = max(1, round(spec.duration * spec.rate))
    simulator = Simulator(built.robot, built.q, dt, spec.plant, seed, built.rides)
    log = Log(ticks, _meta(built, seed))
    controller.reset(built.q, np.zeros(built.robot.nv))
    if spec.tare:
        simulator.tare(controller.state)
    broken, began = "", time.perf_counter()
    gc.collect()
    gc.freeze()  # what is built stays: the collector need not look at it every tick
    try:
        with quietly():  # what MuJoCo warns of ends the run, with the warning in the error
            _loop(built, simulator, log, ticks, progress, hook, show)
    except SimulationError as error:
        broken = str(error)
    finally:
        gc.unfreeze()
    notes = [*built.notes, *_deaf(built), *_validity(built, log, simulator.model)]
    summary = _summary(built, log, time.perf_counter() - began, broken, notes)
    return Result(log, summary, responses(log, built.phases) if not broken else {})


def _loop(
    built: Built, simulator: Simulator, log: Log, ticks: int, progress: Any, hook: Hook | None, show: Any
) -> None:
    controller = built.controller
    before: tuple[Observation, Output, State] | None = None
    contacts = {name: contact for phase in built.phases for name, contact in phase.contacts.items()}
    deaf = unfelt(built.robot, built.phases)
    feeling = [name for phase in built.phases for name in phase.feeling if name not in deaf]
    feet, apart = _sensitive(built.phases), _apart(built.phases)
    touched = dict.fromkeys(contacts, True)
    true: dict[str, Touch] = {}
    terms = None if simulator.encoders is None or simulator.encoders.exact else Terms(built.robot)
    for tick in range(ticks):
        seen = simulator.observe()
        measured = _measured(simulator, controller, before, seen)
        given = dict.fromkeys(feeling, measured) if measured is not None else None
        if true and feet:
            given = (given or {}) | {name: simulator.sensed(true[name].F, frame) for name, frame in feet.items()}
        began = time.perf_counter()
        out = controller.step(seen.t, seen.q, seen.v, measured=given)
        took = time.perf_counter() - began
        simulator.apply(out.tau)
        true = {name: simulator.true_touch(contact.frame) for name, contact in contacts.items()}
        before = (seen, out, controller.state)
        state = controller.state if terms is None else _true_state(controller, simulator, terms)
        true_seen = Observation(seen.t, *simulator.true_state)
        row = _row(controller, state, true_seen, out, took) | _contact_rows(state, out, contacts, true)
        for name, contact in contacts.items():
            touching = bool(true[name].F.any())
            if touching and not touched[name] and name not in controller.phase.contacts:
                row[f"{name}.predicted_peak"] = _predicted_peak(simulator, controller.state, contact)
            touched[name] = touching
        if apart:
            row[APART] = simulator.true_distance(apart)
        log.append(out.active, **row)
        _record_pushes(log, controller, simulator)
        if built.robot.base:
            stance.record(log, controller, state, simulator, out, contacts)
        _note_phase(log, controller, seen.t, out)
        if hook is not None:
            hook(seen, out)
        if show is not None:
            show(simulator)
        if progress is not None and tick % 50 == 49:
            progress(tick + 1)


def _true_state(controller: Controller, simulator: Simulator, terms: Terms) -> State:
    """The state as it is where the controller only knows it with the noise of encoders, with what it wants there."""
    known = controller.state
    state = State(terms, *simulator.true_state, known.t, known.dt)
    state.starts, state.targets, state.measured = known.starts, known.targets, known.measured
    state.grounds = known.grounds
    hold(state, controller.phase)
    return state


def _predicted_peak(simulator: Simulator, state: State, contact: Contact) -> float:
    """The closed form of the impact that begins at this tick [N]; not a number unless it is one point that touches."""
    impact = simulator.impact(contact.frame)
    if impact is None:
        return math.nan
    row = state.frame(contact.frame).R.T @ impact.normal @ contact.seen(state).J[3:]
    mass = 1.0 / float(row @ state.solve_M(row[:, None])[:, 0])  # [kg]
    share = 1.0 / (1.0 / mass + impact.regularisation)
    speed = max(float(row @ state.v), 0.0)
    return analytic.impact_peak(mass, share * impact.damping, share * impact.stiffness, speed)


def _note_phase(log: Log, controller: Controller, t: float, out: Output) -> None:
    """Which phase runs since when and why, or that all has stopped."""
    memory, phase, changes = controller.memory, controller.phase, log.meta["changes"]
    assert memory is not None
    name = STOP if memory.why and out.status is Status.STOPPED else phase.name
    if not changes or changes[-1]["name"] != name:
        changes.append({"name": name, "start": t, "why": memory.why})


def _measured(
    simulator: Simulator, controller: Controller, before: tuple[Observation, Output, State] | None, seen: Observation
) -> Wrench | None:
    """The wrist sensor's wrench of the last tick. A push that the model cannot predict moves the tool as well: then
    its acceleration is that of the joints' velocities, else the one that the controller asked for."""
    if before is None:
        return None
    then, out, state = before
    vdot = (seen.v - then.v) / (seen.t - then.t) if controller.phase.compliant else out.vdot
    return simulator.measured(state, vdot)


def _record_pushes(log: Log, controller: Controller, simulator: Simulator) -> None:
    """The true pushes, and the true motion that compliant tasks answer them with."""
    state, row = controller.state, dict[str, Any]()
    for name in simulator.pushes:
        row[f"{name}.true"] = simulator.true_push(name)
        row[f"{name}.mobility"] = unheld(state, state.frame(simulator.pushes[name]).J)
    for name, task in controller.phase.compliant.items():
        (T, V), desired, S = simulator.true_motion(task.frame), task.desired(state), task.selection(state)
        X_e, V_e, ahead = task.errors(T, V, desired)
        lift = task.lift(state)
        row |= {f"{name}.displacement": -S @ X_e, f"{name}.rate": -S @ V_e, f"{name}.mobility": task.mobility(state)}
        row |= {f"{name}.twist": S @ V, f"{name}.ahead": S @ ahead}
        row |= {f"{name}.external": -lift.T @ simulator.true_external(task.frame), f"{name}.felt": task.push(state)}
        row |= {f"{name}.error": lift @ (S @ X_e), f"{name}.speed": np.linalg.norm(V[3:])}
        row |= {f"{name}.position": T.translation, f"{name}.desired": desired.T.translation}
    for name, held in state.contacts.items() if simulator.moves else ():
        T, _ = simulator.true_motion(held.frame)
        row |= {f"{name}.place": T.translation, f"{name}.mobility": mobility(state, held.G)}
    log.put(**row)


def _row(controller: Controller, state: State, seen: Observation, out: Output, took: float) -> dict[str, Any]:
    """What a tick leaves in the log, of what truly is, all but what the contacts do."""
    phase, memory = controller.phase, controller.memory
    assert memory is not None
    row: dict[str, Any] = {
        "t": seen.t, "q": seen.q, "v": seen.v, "vdot": out.vdot, "tau": memory.tau, "tau_min": phase.torque.low,
        "tau_max": phase.torque.high, "torque_rate_limit": phase.torque.rate,
        "status": STATUS_NAMES.index(out.status.name),
        "step_us": took * 1e6, "kkt": max(out.certificate), "phase": memory.phase,
    }  # fmt: skip
    for name, task in phase.tasks.items():
        if isinstance(task, ForceTask):
            row[f"{task.contact}.target"] = task.desired(state)
            row[f"{task.contact}.wanted"] = state.contacts[task.contact].A.T @ row[f"{task.contact}.target"]
        elif isinstance(task, MotionTask):
            frame, desired = task.seen(state), task.desired(state)
            row |= {f"{name}.error": task.error(state), f"{name}.along": task.along(state)}
            row |= {f"{name}.position": frame.T.translation, f"{name}.desired": desired.T.translation}
            row[f"{name}.speed"] = np.linalg.norm(frame.V[3:])
            row[f"{name}.desired_speed"] = np.linalg.norm(desired.V[3:])
        elif isinstance(task, GazeTask):
            row[f"{name}.angle"] = task.angle(state)
        elif isinstance(task, MomentumTask):
            row[f"{name}.lacking"] = task.error(state)
    return row


def _contact_rows(
    state: State, out: Output, contacts: Mapping[str, Contact], true: Mapping[str, Touch]
) -> dict[str, Any]:
    """True, predicted and measured wrenches, also of contacts that are not active."""
    row, unknown = dict[str, Any](), np.full(6, np.nan)
    for name, contact in contacts.items():
        held = state.contacts.get(name)
        inverse = contact.pseudo_inverse(contact.A(state)) if held is None else held.inverse
        row |= {f"{name}.true": true[name].F, f"{name}.lam": inverse @ true[name].F}
        row[f"{name}.carried"] = (contact.A(state) if held is None else held.A).T @ row[f"{name}.lam"]
        row[f"{name}.rate"] = np.full(contact.k, np.nan) if held is None else held.slip
        row |= {f"{name}.points": true[name].points, f"{name}.mu": true[name].mu}
        if held is not None and contact.pushes is not None:
            told = contact.pushes.told(contact, state, true[name].F)
            row |= {f"{name}.{quantity}": value for quantity, value in told.items()}
        row[f"{name}.predicted"] = out.wrenches.get(name, unknown)
        row[f"{name}.asked"] = inverse @ row[f"{name}.predicted"]
        row[f"{name}.measured"] = state.measured.get(name, unknown)
    return row


def _apart(phases: Sequence[Phase]) -> list[tuple[int, int]]:
    """Pairs of geoms that some phase keeps apart."""
    limits = [phase.collision for phase in phases if phase.collision is not None]
    found = {
        (limit.pairs.shapes.geoms[a], limit.pairs.shapes.geoms[b]) for limit in limits for a, b in limit.pairs.pairs
    }
    return sorted(found)


def _sensitive(phases: Sequence[Phase]) -> dict[str, str]:
    """Feet, and their frames, whose forces some phase waits for: the robot has a sensor in each of them."""
    conditions = [each.name for phase in phases if phase.exit is not None for each in phase.exit.until]
    asked = {name.rpartition(".")[0] for name in conditions if name.rpartition(".")[2] in WRENCH_AXES}
    return {name: phase.contacts[name].frame for phase in phases for name in phase.standing if name in asked}


def _name(built: Built) -> str:
    return Path(built.spec.file).stem


def _meta(built: Built, seed: int) -> dict[str, Any]:
    robot = built.robot
    finite = bool(robot.nq == robot.nv or robot.base)
    return {
        "title": built.spec.title, "spec": _name(built), "seed": seed, "dt": built.controller.dt, "robot": robot.name,
        "joints": list(robot.joints), "status_names": STATUS_NAMES, "settle": built.spec.expect.settle,
        "q_min": np.maximum(robot.q_min, -1e9).tolist() if finite else [],
        "q_max": np.minimum(robot.q_max, 1e9).tolist() if finite else [],
        "contacts": {name: list(c.axes) for phase in built.phases for name, c in phase.contacts.items()},
        "motions": list(
            {name: 0 for phase in built.phases for name, t in phase.tasks.items()
             if isinstance(t, MotionTask | Compliance)}
        ),
        "pushed": {name: list(task.axes) for phase in built.phases for name, task in phase.compliant.items()},
        "phases": [phase.name for phase in built.phases], "changes": [],
        **described(built.spec.plant),
    }  # fmt: skip


def _deaf(built: Built) -> Iterator[str]:
    """Force loops, feedforward and tasks that are asked to feel what the wrist sensor does not read."""
    for name, frame in unfelt(built.robot, built.phases).items():
        if any(_listens(phase, name) for phase in built.phases):
            yield f"{name}: nothing is measured there, for the wrist sensor does not read what acts on {frame}"


def _listens(phase: Phase, name: str) -> bool:
    """Whether something in a phase goes by the wrench measured for a contact or task."""
    loops = [task for task in phase.tasks.values() if isinstance(task, ForceTask) and task.contact == name]
    gains = any(loop.Kp.any() or loop.Ki.any() for loop in loops)
    felt = any((task.contact or each) == name and task.source == "measured" for each, task in phase.compliant.items())
    return gains or felt or name in phase.fed


def _validity(built: Built, log: Log, model: Any) -> Iterator[str]:
    """Where the contact parameters of declared surfaces were not made for what the run did."""
    frames = {name: contact.frame for phase in built.phases for name, contact in phase.contacts.items()}
    for name in sorted(name for name in frames if f"{name}.slip" in log):
        body, _ = carrier(built.robot, frames[name])
        late = log.late(np.isfinite(log[f"{name}.push"]), built.spec.expect.settle)
        speed = np.linalg.norm(log[f"{name}.slip"][late], axis=1)
        for surface in material.of_model(model):
            push, points = log[f"{name}.push"][late], log[f"{name}.points"][late]
            if note := material.worst(surface, model, push, speed, points, body):
                yield note


def _summary(built: Built, log: Log, wall: float, broken: str, notes: list[str]) -> dict[str, Any]:
    figures = metrics(log, built.phases, built.spec.expect.settle) if log.size else {}
    figures = {name: value for name, value in figures.items() if math.isfinite(value)}
    checks = _checks(built, figures)
    status = {name: int((log["status"] == i).sum()) for i, name in enumerate(STATUS_NAMES)} if log.size else {}
    us = np.percentile(log["step_us"], [50, 99, 100]).tolist() if log.size else [0.0, 0.0, 0.0]
    summary: dict[str, Any] = {
        "spec": _name(built),
        "ok": not broken and all(check["ok"] for check in checks),
        "ticks": log.size,
        "sim_seconds": log.size * log.meta["dt"],
        "wall_seconds": wall,
        "metrics": figures,
        "checks": checks,
        "status": {name: count for name, count in status.items() if count},
        "step_us": dict(zip(("p50", "p99", "max"), us, strict=True)),
        "phases": log.meta["changes"] if built.spec.phases else [],
        "notes": notes,
    }
    return summary | ({"broken": broken} if broken else {})


# what holds for every run, asked or not: torque limits, their rate, a certified answer in every tick
ALWAYS = {"torque.max_excess": 1e-6, "torque_rate.max_excess": 1e-3, "ticks.degraded": 0.0}


def _checks(built: Built, figures: dict[str, float]) -> list[dict[str, Any]]:
    """Every bound with its verdict; what was not measured (a run that ended while settling) does not hold."""
    checks = []
    bounds = {name: (bound.min, bound.max) for name, bound in built.spec.expect.bounds.items()}
    bounds |= {name: (None, most) for name, most in ALWAYS.items() if name not in bounds}
    for name, (low, high) in bounds.items():
        value = figures.get(name)
        told = high if low is None else {k: v for k, v in (("min", low), ("max", high)) if v is not None}
        above = value is not None and (low is None or value >= low)
        holds = above and (high is None or value <= high)  # type: ignore[operator]
        checks.append({"name": name, "value": value, "bound": told, "ok": bool(holds)})
    return checks
