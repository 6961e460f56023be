"""The closed loop: controller and simulator tick by tick, a log, figures against the bounds of the spec."""

from __future__ import annotations

import gc
import json
import math
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin

from .build import Built
from .controller import Controller, Output, Status
from .errors import SimulationError
from .log import Log
from .metrics import metrics
from .model import quietly
from .qp import Array
from .sim import Observation, Simulator
from .task import ForceTask, MotionTask

STATUS_NAMES = [status.name for status in Status]


@dataclass(frozen=True)
class Result:
    """A finished run: its log, its figures, and the verdict on every bound."""

    log: Log
    summary: dict[str, Any]

    @property
    def ok(self) -> bool:
        return bool(self.summary["ok"])

    def write(self, folder: Path) -> None:
        """`log.npz`, `summary.json` and `report.png` in `folder`."""
        from .plot import report

        folder.mkdir(parents=True, exist_ok=True)
        self.log.save(folder / "log.npz")
        (folder / "summary.json").write_text(json.dumps(self.summary, indent=1) + "\n")
        report(self.log, self.summary, folder / "report.png")


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
    simulator = Simulator(built.robot, built.q, dt, spec.plant, seed)
    log = Log(ticks, _meta(built, seed))
    controller.reset(built.q, np.zeros(built.robot.nv))
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
    return Result(log, _summary(built, log, time.perf_counter() - began, broken))


def _loop(
    built: Built, simulator: Simulator, log: Log, ticks: int, progress: Any, hook: Hook | None, show: Any
) -> None:
    controller, measured = built.controller, None
    contacts = sorted({name for phase in built.phases for name in phase.contacts})
    for tick in range(ticks):
        seen = simulator.observe()
        given = dict.fromkeys(controller.phase.contacts, measured) if measured is not None else None
        before = time.perf_counter()
        out = controller.step(seen.t, seen.q, seen.v, measured=given)
        took = time.perf_counter() - before
        simulator.apply(out.tau)
        true = {
            name: simulator.true_wrench(controller.phase.contacts[name].frame)
            for name in contacts
            if name in controller.phase.contacts
        }
        measured = simulator.measured(controller.state, out.vdot)
        _record(log, controller, seen, out, took, true)
        if hook is not None:
            hook(seen, out)
        if show is not None:
            show(simulator)
        if progress is not None and tick % 50 == 49:
            progress(tick + 1)


def _record(
    log: Log, controller: Controller, seen: Observation, out: Output, took: float, true: dict[str, Array]
) -> None:
    state, phase, memory = controller.state, controller.phase, controller.memory
    assert memory is not None
    row: dict[str, Any] = {
        "t": seen.t, "q": seen.q, "v": seen.v, "vdot": out.vdot, "tau": memory.tau, "tau_min": phase.torque.low,
        "tau_max": phase.torque.high, "torque_rate_limit": phase.torque.rate,
        "status": STATUS_NAMES.index(out.status.name),
        "step_us": took * 1e6, "kkt": max(out.certificate),
    }  # fmt: skip
    for name, wrench in true.items():
        held = state.contacts[name]
        row |= {f"{name}.true": wrench, f"{name}.lam": held.inverse @ wrench}
        row[f"{name}.predicted"] = out.wrenches.get(name, np.full(6, np.nan))
        row[f"{name}.slip"] = held.slip
        row[f"{name}.carried"] = held.A.T @ row[f"{name}.lam"]
        row[f"{name}.measured"] = state.measured.get(name, np.full(6, np.nan))
    for name, task in phase.tasks.items():
        if isinstance(task, ForceTask):
            row[f"{task.contact}.target"] = task.desired(state)
            row[f"{task.contact}.wanted"] = state.contacts[task.contact].A.T @ row[f"{task.contact}.target"]
        elif isinstance(task, MotionTask):
            frame, desired = state.frame(task.frame), task.reference(state.t)
            error = pin.log6(frame.T.actInv(desired.T)).vector[[3, 4, 5, 0, 1, 2]]
            select = state.contacts[task.contact].free if task.contact is not None else task.selection
            row |= {f"{name}.error": np.linalg.pinv(select) @ (select @ error), f"{name}.along": select @ error}
            row |= {f"{name}.position": frame.T.translation, f"{name}.desired": desired.T.translation}
            row[f"{name}.speed"] = np.linalg.norm(frame.V[3:])
    log.append(out.active, **row)


def _name(built: Built) -> str:
    return Path(built.spec.file).stem


def _meta(built: Built, seed: int) -> dict[str, Any]:
    robot = built.robot
    finite = bool(robot.nq == robot.nv)
    return {
        "title": built.spec.title, "spec": _name(built), "seed": seed, "dt": built.controller.dt, "robot": robot.name,
        "joints": list(robot.joints), "status_names": STATUS_NAMES, "settle": built.spec.expect.settle,
        "q_min": np.maximum(robot.q_min, -1e9).tolist() if finite else [],
        "q_max": np.minimum(robot.q_max, 1e9).tolist() if finite else [],
        "contacts": {name: list(c.axes) for phase in built.phases for name, c in phase.contacts.items()},
        "motions": [name for phase in built.phases[:1] for name, t in phase.tasks.items() if isinstance(t, MotionTask)],
    }  # fmt: skip


def _summary(built: Built, log: Log, wall: float, broken: str) -> dict[str, Any]:
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
        "notes": built.notes,
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
