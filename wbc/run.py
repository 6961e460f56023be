"""The closed loop: controller and simulator tick by tick, a log, figures against the bounds of the spec."""

from __future__ import annotations

import gc
import json
import math
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from . import material
from .build import Built
from .controller import Controller
from .errors import SimulationError
from .fault import FaultPlan
from .feeling import unfelt
from .log import Log
from .memory import Output
from .metrics import metrics
from .model import quietly
from .phase import Phase
from .record import STATUS_NAMES, Recorder
from .response import Bode, described, responses
from .sim import Observation, Simulator, carrier
from .state import State
from .tape import Tape
from .task.force import ForceTask
from .task.impedance import Compliance
from .task.motion import MotionTask
from .wrench import WRENCH_AXES, Wrench


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
        from .bode import bode_plot
        from .plot import report

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
    tape = Tape(controller, spec)
    plan = FaultPlan(spec.plant.faults, dt, seed, _pressed(built.phases)) if spec.plant.faults else None
    if plan is not None:
        plan.spoil(controller)
    broken, began = "", time.perf_counter()
    gc.freeze()  # what is built stays: the collector need not look at it every tick
    try:
        with quietly():  # what MuJoCo warns of ends the run, with the warning in the error
            _loop(built, simulator, log, tape, ticks, progress, hook, show, plan)
    except SimulationError as error:
        broken = str(error)
    finally:
        gc.unfreeze()
        if plan is not None:
            plan.mend(controller)
    log.tape = tape.arrays()
    notes = [*built.notes, *_deaf(built), *_validity(built, log, simulator.model)]
    summary = _summary(built, log, time.perf_counter() - began, broken, notes)
    return Result(log, summary, responses(log, built.phases) if not broken else {})


def _loop(
    built: Built, simulator: Simulator, log: Log, tape: Tape, ticks: int, progress: Any, hook: Hook | None, show: Any,
    plan: FaultPlan | None,
) -> None:  # fmt: skip
    controller = built.controller
    before: tuple[Observation, Output, State] | None = None
    feeling = felt_names(built)
    feet, recorder = _sensitive(built.phases), Recorder(built, simulator, log)
    for tick in range(ticks):
        if plan is not None:
            plan.begin(tick, simulator)
        seen = simulator.observe()
        measured = wrist(simulator, controller, before, seen)
        given = dict.fromkeys(feeling, measured) if measured is not None else None
        if recorder.true and feet:
            felt = {name: simulator.sensed(recorder.true[name].F, frame) for name, frame in feet.items()}
            given = (given or {}) | felt
        if plan is not None and plan.late and before is not None:
            out, took = before[1], 0.0  # the motors go on with what they have
        else:
            shown, missed = seen, 0
            if plan is not None:
                shown, given, missed = plan.seen(seen, built.robot), plan.measured(given), plan.told()
            tape.begin(*shown, given, missed=missed)
            began = time.perf_counter()
            out = controller.step(*shown, measured=given, missed=missed)
            took = time.perf_counter() - began
            tape.end(out)
        simulator.apply(out.tau)
        before = (seen, out, controller.state)
        recorder.record(seen.t, out, took)
        if hook is not None:
            hook(seen, out)
        if show is not None:
            show(simulator)
        if progress is not None and tick % 50 == 49:
            progress(tick + 1)


def felt_names(built: Built) -> list[str]:
    """What is told the wrench of the wrist sensor: contacts, and tasks that have none."""
    deaf = unfelt(built.robot, built.phases)
    return [name for phase in built.phases for name in phase.feeling if name not in deaf]


def wrist(
    simulator: Simulator, controller: Controller, before: tuple[Observation, Output, State] | None, seen: Observation
) -> Wrench | None:
    """The wrist sensor's wrench of the last tick. A push that the model cannot predict moves the tool as well: then
    its acceleration is that of the joints' velocities, else the one that the controller asked for."""
    if before is None:
        return None
    then, out, state = before
    vdot = (seen.v - then.v) / (seen.t - then.t) if controller.phase.compliant else out.vdot
    return simulator.measured(state, vdot)


def _sensitive(phases: Sequence[Phase]) -> dict[str, str]:
    """Feet, and their frames, whose forces some phase waits for: the robot has a sensor in each of them."""
    conditions = [each.name for phase in phases if phase.exit is not None for each in phase.exit.until]
    asked = {name.rpartition(".")[0] for name in conditions if name.rpartition(".")[2] in WRENCH_AXES}
    return {name: phase.contacts[name].frame for phase in phases for name in phase.standing if name in asked}


def _pressed(phases: Sequence[Phase]) -> list[str]:
    """Frames of the contacts at which a force is held."""
    pressing = {task.contact for phase in phases for task in phase.tasks.values() if isinstance(task, ForceTask)}
    found = [contact.frame for phase in phases for name, contact in phase.contacts.items() if name in pressing]
    return list(dict.fromkeys(found))


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
        "phases": [phase.name for phase in built.phases], "changes": [], "faults": list(built.spec.plant.faults),
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
