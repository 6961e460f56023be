"""What every tick of a run leaves in its log: what truly is, what was asked for, what was measured."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from . import analytic
from .build import Built
from .contact import Contact
from .controller import Controller
from .dynamics import mobility, unheld
from .ladder import Status
from .log import Log
from .memory import Output
from .metrics import APART
from .phase import Phase, hold, stored
from .qp import Array
from .sim import Simulator
from .singular import smallest
from .stance import Standing
from .state import State, Terms
from .task.centroidal import MomentumTask
from .task.force import ForceTask
from .task.impedance import Compliance
from .task.motion import MotionTask
from .task.relative import GazeTask
from .touch import Touch
from .transition import STOP

STATUS_NAMES = [status.name for status in Status]
_NUMBER = {name: i for i, name in enumerate(STATUS_NAMES)}
_UNKNOWN: Array = np.full(6, np.nan)

Row = dict[str, Any]


class Recorder:
    """Writes the log of a run, a row a tick; `true`: what each contact's body did to its environment in the last tick.

    Tasks and contacts are recorded at the true state, which with noise of encoders is not the controller's.
    """

    def __init__(self, built: Built, simulator: Simulator, log: Log) -> None:
        self._controller, self._simulator, self._log = built.controller, simulator, log
        self.contacts: dict[str, Contact] = {n: each for phase in built.phases for n, each in phase.contacts.items()}
        self.true: dict[str, Touch] = {}
        self._touched = dict.fromkeys(self.contacts, True)
        self._apart = _apart(built.phases)
        exact = simulator.encoders is None or simulator.encoders.exact
        self._terms = None if exact else Terms(built.robot)
        self._standing = Standing(built.robot, simulator, built.controller.dt) if built.robot.base else None
        self._unheld = {name: np.full(each.k, np.nan) for name, each in self.contacts.items()}

    def record(self, t: float, out: Output, took: float) -> None:
        """The tick at t [s] that has just been simulated; `took` [s]: the controller's step."""
        controller, simulator = self._controller, self._simulator
        self.true = {name: simulator.true_touch(contact.frame) for name, contact in self.contacts.items()}
        state = controller.state if self._terms is None else _true_state(controller, simulator, self._terms)
        row = self._of_tick(t, out, took)
        _of_tasks(row, controller.phase, state)
        _of_values(row, controller, state)
        self._of_contacts(row, state, out)
        self._of_touches(row)
        if self._apart:
            row[APART] = simulator.true_distance(self._apart)
        if simulator.pushes or simulator.moves or controller.phase.compliant:
            _of_pushes(row, controller, simulator)
        if self._standing is not None:
            self._standing.record(row, controller.phase, state, out, self.contacts, self.true)
        for name, task in controller.phase.tanks.items():
            row[f"{name}.tank"] = stored(controller.state, task)
            if isinstance(task, Compliance):
                row[f"{name}.stiffness"] = task.passes(controller.state)[0]
        self._log.append(out.active, **row)
        self._note_phase(t, out)

    def _of_tick(self, t: float, out: Output, took: float) -> Row:
        phase, memory = self._controller.phase, self._controller.memory
        q, v = self._simulator.true_state
        assert memory is not None
        return {
            "t": t, "q": q, "v": v, "vdot": out.vdot, "tau": memory.tau, "tau_min": phase.torque.low,
            "tau_max": phase.torque.high, "torque_rate_limit": phase.torque.rate, "status": _NUMBER[out.status.name],
            "step_us": took * 1e6, "kkt": max(out.certificate), "phase": memory.phase,
        }  # fmt: skip

    def _of_contacts(self, row: Row, state: State, out: Output) -> None:
        """True, predicted and measured wrenches, also of contacts that are not active."""
        for name, contact in self.contacts.items():
            held, (F, points, mu) = state.contacts.get(name), self.true[name]
            if held is None:
                A = contact.A(state)
                inverse, rate = contact.pseudo_inverse(A), self._unheld[name]
            else:
                A, inverse, rate = held.A, held.inverse, held.slip
            lam, predicted = inverse @ F, out.wrenches.get(name, _UNKNOWN)
            row[f"{name}.true"], row[f"{name}.lam"], row[f"{name}.carried"] = F, lam, A.T @ lam
            row[f"{name}.rate"], row[f"{name}.points"], row[f"{name}.mu"] = rate, points, mu
            if held is not None and contact.pushes is not None:
                for quantity, value in contact.pushes.told(contact, state, F).items():
                    row[f"{name}.{quantity}"] = value
            row[f"{name}.predicted"], row[f"{name}.asked"] = predicted, inverse @ predicted
            row[f"{name}.measured"] = state.measured.get(name, _UNKNOWN)

    def _of_touches(self, row: Row) -> None:
        """The predicted peak of an impact that begins."""
        for name, contact in self.contacts.items():
            touching = bool(self.true[name].F.any())
            if touching and not self._touched[name] and name not in self._controller.phase.contacts:
                row[f"{name}.predicted_peak"] = _predicted_peak(self._simulator, self._controller.state, contact)
            self._touched[name] = touching

    def _note_phase(self, t: float, out: Output) -> None:
        """Which phase runs since when and why, or that all has stopped."""
        memory, phase, changes = self._controller.memory, self._controller.phase, self._log.meta["changes"]
        assert memory is not None
        name = STOP if memory.why and out.status is Status.STOPPED else phase.name
        if not changes or changes[-1]["name"] != name:
            changes.append({"name": name, "start": t, "why": memory.why})


def _true_state(controller: Controller, simulator: Simulator, terms: Terms) -> State:
    """The state as it is where the controller only knows it with the noise of encoders, with what it wants there."""
    known = controller.state
    state = State(terms, *simulator.true_state, known.t, known.dt)
    state.starts, state.targets, state.measured = known.starts, known.targets, known.measured
    state.grounds, state.followed = known.grounds, known.followed
    hold(state, controller.phase)
    return state


def _of_tasks(row: Row, phase: Phase, state: State) -> None:
    for name, task in phase.tasks.items():
        if isinstance(task, ForceTask):
            target = row[f"{task.contact}.target"] = task.desired(state)
            row[f"{task.contact}.wanted"] = state.contacts[task.contact].A.T @ target
        elif isinstance(task, MotionTask):
            frame, desired = task.seen(state), task.followed(state)
            along = row[f"{name}.along"] = task.along(state)
            row[f"{name}.error"] = task.lift(state) @ along
            row[f"{name}.position"], row[f"{name}.desired"] = frame.p, desired.p
            row[f"{name}.speed"], row[f"{name}.desired_speed"] = _speed(frame.V), _speed(desired.V)
        elif isinstance(task, GazeTask):
            row[f"{name}.angle"] = task.angle(state)
        elif isinstance(task, MomentumTask):
            row[f"{name}.lacking"] = task.error(state)


def _of_values(row: Row, controller: Controller, state: State) -> None:
    """Singular values of motions; not numbers where nothing was solved."""
    program = None if controller.tick is None else controller.tick.program
    for name, task in controller.phase.tasks.items():
        if isinstance(task, MotionTask):
            known = None if program is None else program.thresholds.get(name)
            row[f"{name}.singular"] = math.nan if known is None else smallest(task, state, known.rank)


def _of_pushes(row: Row, controller: Controller, simulator: Simulator) -> None:
    """The true pushes, and the true motion that compliant tasks answer them with."""
    state = controller.state
    for name, frame in simulator.pushes.items():
        row[f"{name}.true"] = simulator.true_push(name)
        row[f"{name}.mobility"] = unheld(state, state.frame(frame).J)
    for name, task in controller.phase.compliant.items():
        (T, V), desired, S = simulator.true_motion(task.frame), task.followed(state), task.selection(state)
        X_e, V_e, ahead = task.errors(T, V, desired)
        lift = task.lift(state)
        row |= {f"{name}.displacement": -S @ X_e, f"{name}.rate": -S @ V_e, f"{name}.mobility": task.mobility(state)}
        row |= {f"{name}.twist": S @ V, f"{name}.ahead": S @ ahead}
        row |= {f"{name}.external": -lift.T @ simulator.true_external(task.frame), f"{name}.felt": task.push(state)}
        row |= {f"{name}.error": lift @ (S @ X_e), f"{name}.speed": _speed(V)}
        row |= {f"{name}.position": T.translation, f"{name}.desired": desired.p}
    for name, held in state.contacts.items() if simulator.moves else ():
        T, _ = simulator.true_motion(held.frame)
        row |= {f"{name}.place": T.translation, f"{name}.mobility": mobility(state, held.G)}


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


def _apart(phases: Sequence[Phase]) -> list[tuple[int, int]]:
    """Pairs of geoms that some phase keeps apart."""
    limits = [phase.collision for phase in phases if phase.collision is not None]
    found = {
        (limit.pairs.shapes.geoms[a], limit.pairs.shapes.geoms[b]) for limit in limits for a, b in limit.pairs.pairs
    }
    return sorted(found)


def _speed(V: Array) -> float:
    """Of the origin of a frame that moves with V (6,) [m/s]."""
    return math.sqrt(V[3:].dot(V[3:]))
