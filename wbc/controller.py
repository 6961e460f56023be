"""One tick: state, rows, problem, certified solution, torque. Knows no YAML and no simulator.

`Controller.step` depends on its arguments and on `Controller.memory` alone: no clock, no thread, no input or output.
It never raises on data; it answers with a status, and holds when there is no certified answer.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from enum import Enum
from typing import Any, NamedTuple

import numpy as np

from .contact import Contact
from .dynamics import inertia, mobility, torque_map
from .errors import GainError, NameNotFound, SpecError, StateError, did_you_mean
from .limit import JointLimit, TorqueLimit, braking
from .qp import UNCERTIFIED, Array, Certificate, Rows, Variables, Workspace
from .robot import Robot, State
from .solver import DEFAULT, Solution, Solver, answer, make
from .task import ForceLoop, ForceTask, MotionTask, PostureTask, Task
from .wrench import VELOCITY_AXES, Wrench

_NEW_LOOP = ForceLoop()
_NONE: Mapping[str, Any] = {}  # never written to
HOLD_TICKS = 5  # ticks without a certified answer before the safe hold
GOOD_TICKS = 10  # certified ticks in a row until the status is OK again
MISSED_DEGRADED, MISSED_STOPPED = 3, 20
HOLD_DAMPING = 10.0  # [1/s] times M_ii, in the safe hold


class Status(Enum):
    """How good a tick's torque is; the ladder goes down on its own and up from SAFE_HOLD only by `reset`."""

    OK = "OK"  # certified, nothing yielded
    LIMITED = "LIMITED"  # certified, and something named yielded
    DEGRADED = "DEGRADED"  # no certified answer: the last torque is held
    SAFE_HOLD = "SAFE_HOLD"  # gravity, the last contact wrenches and damping
    STOPPED = "STOPPED"  # as SAFE_HOLD, after too many missed ticks


class Output(NamedTuple):
    """What a tick answers. `tau` (nv,) [N m] is what the driver is sent; `wrenches` are predicted, robot on environment."""

    tau: Array
    vdot: Array
    wrenches: dict[str, Array]
    active: tuple[str, ...]
    status: Status
    reason: str
    certificate: Certificate


class Memory(NamedTuple):
    """All that a tick carries to the next: a value, to be kept and restored. Its arrays are never written to."""

    t: float | None = None  # time of the last tick [s]
    start: float = 0.0  # time at which the references began [s]
    phase: int = 0
    phase_start: float = 0.0
    tau: Array = np.zeros(0)  # last torque of the motors, gravity included [N m]
    gravity: Array = np.zeros(0)  # g(q) of the last tick [N m]
    q: Array = np.zeros(0)
    v: Array = np.zeros(0)
    lam: Mapping[str, Array] = _NONE  # last certified multipliers
    loops: Mapping[str, ForceLoop] = _NONE
    targets: Mapping[str, float] = _NONE
    status: Status = Status.OK
    bad: int = 0
    good: int = GOOD_TICKS


@dataclass(frozen=True)
class Phase:
    """What is active for a while: contacts, tasks with weights, limits. `until` [s] is its length, infinite for the last."""

    contacts: Mapping[str, Contact]
    tasks: Mapping[str, Task]
    weights: Mapping[str, float]
    torque: TorqueLimit
    joint: JointLimit | None
    name: str = ""
    until: float = math.inf


class _Structure:
    """Storage of one phase: the problem's shape changes only with the phase."""

    def __init__(self, phase: Phase, state: State) -> None:
        self.phase = phase
        self.motion = {n: t for n, t in phase.tasks.items() if isinstance(t, MotionTask)}
        self.force = {t.contact: (n, t) for n, t in phase.tasks.items() if isinstance(t, ForceTask)}
        self.posture = {n: t for n, t in phase.tasks.items() if isinstance(t, PostureTask)}
        known = (MotionTask, ForceTask, PostureTask)
        self.other = {n: t for n, t in phase.tasks.items() if not isinstance(t, known)}
        self.above = self.motion | self.other  # what the posture stays out of
        # the motion rows hold the contacts' too, so with exactly one task they are all there is above the posture
        self.single = len(self.motion) == 1 and not self.other
        if self.single and next(iter(self.motion.values())).raw:
            self.single = len(phase.contacts) == 1
        hold(state, phase)
        sizes = {"vdot": state.robot.nv} | {name: contact.k for name, contact in phase.contacts.items()}
        hard = [c.rows(name, state.contacts[name])._replace(labels=c.labels(name)) for name, c in phase.contacts.items()]
        hard.append(torque_map(state).rows(phase.torque.low, phase.torque.high, phase.torque.labels))
        joint = phase.joint.rows(state.q, state.v, state.dt)._replace(labels=phase.joint.labels) if phase.joint else None
        self.strict = Workspace(Variables(sizes), [*hard, joint] if joint else hard)
        # the same with joint viability allowed to yield, for ticks that have no answer otherwise
        self.yielding = None
        if joint is not None:
            rows = joint._replace(A=joint.A | {"yield": None})
            self.yielding = Workspace(Variables(sizes | {"yield": state.robot.nv}), [*hard, rows])


def hold(state: State, phase: Phase) -> None:
    """Evaluate the contacts of a phase at a state."""
    for name, contact in phase.contacts.items():
        state.contacts[name] = contact.hold(state)


class Controller:
    """A whole-body contact controller.

    Parameters: the robot; `contacts` name -> Contact; `tasks` name -> Task, or (Task, weight); `limits` with the keys
    `torque`, `torque_rate`, `position`, `velocity` (a number or (nv,), "model", or None); `solver`: a name or an object
    with `solve(problem)`; `rate` [Hz]. `from_spec` makes one from YAML. Everything wrong with these raises here, a
    WbcError that says what; nothing raises later.
    """

    def __init__(
        self,
        robot: Robot,
        contacts: Mapping[str, Contact] | None = None,
        tasks: Mapping[str, Any] | None = None,
        limits: Mapping[str, Any] | None = None,
        solver: str | Solver = DEFAULT,
        rate: float = 1000.0,
        phases: Sequence[Phase] | None = None,
        q: Array | None = None,
    ) -> None:
        self.robot, self.dt = robot, 1.0 / rate
        self._data = robot.model.createData()
        self._solver = make(solver)
        # the yielding problem has another shape: a solver of its own keeps both warm
        self._second = make(solver) if isinstance(solver, str) else self._solver
        start = State(robot, self._data, robot.keyframes["home"] if q is None else np.array(q, float), np.zeros(robot.nv))
        if phases is None:
            phases = [self._phase(contacts or {}, tasks or {}, limits or {}, start)]
        self.notes: list[str] = []
        phases = [self._without_idle_posture(phase, start) for phase in phases]
        self._phases = [_Structure(phase, State(robot, self._data, start.q, start.v)) for phase in phases]
        self._workspace = self._phases[0].strict
        self._memory: Memory | None = None
        self.start = start.q  # the configuration that the tasks and contacts were built at
        self.state = start

    @classmethod
    def from_spec(cls, spec: Any, robot: Robot | None = None, **changes: Any) -> Controller:
        """The controller that a spec describes (`wbc.load`). Raises SpecError with every fault located."""
        from .build import build

        return build(spec, robot=robot, **changes).controller

    # --- construction ---

    def _phase(self, contacts: Mapping[str, Contact], tasks: Mapping[str, Any], limits: Mapping[str, Any], state: State) -> Phase:
        placed = {name: task if isinstance(task, tuple) else (task, 1.0) for name, task in tasks.items()}
        for name, (task, _) in placed.items():
            contact = getattr(task, "contact", None)
            if contact is not None and contact not in contacts:
                raise NameNotFound(f"contact (of task {name!r})", contact, contacts)
            self.robot.frame_id(getattr(task, "frame", self.robot.frames[0]))
        torque, joint = make_limits(self.robot, limits)
        weights = {name: float(weight) for name, (_, weight) in placed.items()}
        return Phase(dict(contacts), {name: task for name, (task, _) in placed.items()}, weights, torque, joint)

    def _without_idle_posture(self, phase: Phase, start: State) -> Phase:
        """A posture has no meaning where contacts and motion leave no null space; without one, self-motion is damped."""
        state = State(self.robot, self._data, start.q, start.v)
        hold(state, phase)
        rows = [held.G for held in state.contacts.values()]
        rows += [task.target(state)[0] for task in phase.tasks.values() if isinstance(task, MotionTask)]
        rank = np.linalg.matrix_rank(np.concatenate(rows)) if rows else 0
        idle = [name for name, task in phase.tasks.items() if isinstance(task, PostureTask)]
        tasks = dict(phase.tasks)
        if rank >= self.robot.nv:
            for name in idle:
                del tasks[name]
                note = f"{name}: dropped, contacts and motion leave no null space of the {self.robot.nv} joints"
                if note not in self.notes:
                    self.notes.append(note)
        elif not idle:
            tasks["self_motion"] = PostureTask(start.q, kp=0.0, kd=10.0)
        weights = {name: phase.weights.get(name, 1.0) for name in tasks}
        return Phase(phase.contacts, tasks, weights, phase.torque, phase.joint, phase.name, phase.until)

    # --- memory ---

    @property
    def memory(self) -> Memory | None:
        """What the next tick will remember; None before the first `reset`. Assign to restore."""
        return self._memory

    @memory.setter
    def memory(self, value: Memory | None) -> None:
        self._memory = value
        for solver in (self._solver, self._second):
            getattr(solver, "restart", lambda: None)()

    @property
    def phases(self) -> tuple[Phase, ...]:
        """All phases, as they run."""
        return tuple(structure.phase for structure in self._phases)

    @property
    def phase(self) -> Phase:
        """The phase of the last tick."""
        return self._phases[self._memory.phase if self._memory else 0].phase

    @property
    def workspace(self) -> Workspace:
        """Holds the last problem until the next tick; an answer's torque is `product("torque", x) + state.h`."""
        return self._workspace

    def reset(self, q: Array, v: Array, tau: Array | None = None) -> None:
        """Start, or start again, at a state; `tau` is what the driver was last sent (default: what holds gravity).

        The first torque then differs from `tau` by no more than the rate limit allows. The only way out of a safe hold.
        Raises StateError.
        """
        for name, value, size in (("q", q, self.robot.nq), ("v", v, self.robot.nv)):
            if fault := _fault(name, value, size):
                raise StateError(fault)
        q, v = np.array(q, float), np.array(v, float)
        gravity = State(self.robot, self._data, q, v).gravity()
        if tau is None:
            total = gravity
        else:
            if fault := _fault("tau", tau, self.robot.nv):
                raise StateError(fault)
            total = np.array(tau, float) + (gravity if self.robot.gravity == "robot" else 0.0)
        self.memory = Memory(tau=total, gravity=gravity, q=q, v=v)

    # --- the tick ---

    def step(
        self,
        t: float,
        q: Array,
        v: Array,
        measured: Mapping[str, Wrench] | None = None,
        targets: Mapping[str, float] | None = None,
        tau_applied: Array | None = None,
        missed: int = 0,
    ) -> Output:
        """One tick at time t [s] of the caller's clock, at state q (nq,), v (nv,) in Pinocchio's convention.

        `measured`: contact -> Wrench; `targets`: `contact.axis` -> number, kept until changed; `tau_applied`: what the
        driver really sent last; `missed`: ticks that the caller left out. Never raises on data.
        """
        try:
            return self._step(t, q, v, measured, targets, tau_applied, missed)
        except Exception as error:  # whatever a task of one's own does, the loop goes on
            return self._hold(f"{type(error).__name__}: {error}")

    def _step(self, t: Any, q: Any, v: Any, measured: Any, targets: Any, tau_applied: Any, missed: int) -> Output:
        fault = _fault("q", q, self.robot.nq) or _fault("v", v, self.robot.nv) or _fault_time(t)
        if self._memory is None:
            if fault:
                raise StateError(f"the first tick needs a valid state: {fault}")
            self.reset(q, v, tau_applied)
        memory = self._memory
        assert memory is not None
        if fault:
            return self._hold(fault)
        if memory.status in (Status.SAFE_HOLD, Status.STOPPED) or missed >= MISSED_STOPPED:
            stopped = missed >= MISSED_STOPPED or memory.status is Status.STOPPED
            return self._safe_hold(q, v, Status.STOPPED if stopped else Status.SAFE_HOLD, f"{missed} ticks missed" if missed else "")
        memory = self._advance_time(memory, t)
        dt = self.dt if memory.t is None else min(max(t - memory.t, 0.0), 2.0 * self.dt)
        state = self.state = State(self.robot, self._data, q, v, t - memory.start, dt)
        refused = self._read(state, memory, measured, targets)
        tau_last = memory.tau
        if tau_applied is not None:
            if fault := _fault("tau_applied", tau_applied, self.robot.nv):
                refused.append(fault)
            else:
                tau_last = tau_applied + memory.gravity if self.robot.gravity == "robot" else tau_applied
        structure = self._phases[memory.phase]
        tau_last = structure.phase.torque.inside(tau_last)
        bounds = structure.phase.torque.bounds(tau_last, self.dt)
        solution, yielded = self._solve(structure, state, bounds)
        if not solution.accepted:
            return self._hold(solution.reason)
        return self._accept(structure, state, solution, yielded, tau_last, bounds, memory, t, refused, missed)

    def _advance_time(self, memory: Memory, t: float) -> Memory:
        if memory.t is None:
            return memory._replace(start=t, phase_start=t)
        while t - memory.phase_start >= self._phases[memory.phase].phase.until - 1e-9 and memory.phase + 1 < len(self._phases):
            memory = memory._replace(phase=memory.phase + 1, phase_start=memory.phase_start + self._phases[memory.phase].phase.until)
        return memory

    def _read(self, state: State, memory: Memory, measured: Any, targets: Any) -> list[str]:
        """Contacts, wrenches, targets and loops of this tick; what is refused is said, and the old value kept."""
        refused: list[str] = []
        phase = self._phases[memory.phase].phase
        hold(state, phase)
        loops = memory.loops
        state.loops = {name: loops.get(name, _NEW_LOOP) for name in phase.contacts}
        for name, wrench in (measured or {}).items():
            if name not in phase.contacts:
                refused.append(f"measured: no contact named {name!r}{did_you_mean(name, phase.contacts)}")
                continue
            F = wrench.at(state, phase.contacts[name].frame) if isinstance(wrench, Wrench) else None
            if F is None or not math.isfinite(F.dot(F)):
                refused.append(f"measured.{name}: expected a finite Wrench, got {type(wrench).__name__ if F is None else F}; the last one stands")
                F = loops[name].filtered if name in loops else None
            if F is not None:
                state.measured[name] = F
        state.targets = memory.targets  # type: ignore[assignment]
        if targets:
            state.targets = dict(memory.targets)
            refused += self._retarget(state, phase, targets)
        return refused

    def _retarget(self, state: State, phase: Phase, targets: Mapping[str, float]) -> list[str]:
        known = [f"{name}.{axis}" for name, contact in phase.contacts.items() for axis in contact.axes]
        refused = []
        for name, value in targets.items():
            if name not in known:
                contact = phase.contacts.get(str(name).split(".")[0])
                hint = did_you_mean(str(name), known)
                if contact is not None:
                    hint = f": that component lies outside the column space of A'; it holds {', '.join(contact.axes)}"
                refused.append(f"targets.{name}: no such target{hint}")
            elif not isinstance(value, (int, float)) or not math.isfinite(value):
                refused.append(f"targets.{name}: expected a finite number, got {value!r}; the old target is kept")
            else:
                state.targets[name] = float(value)
        return refused

    def _solve(self, structure: _Structure, state: State, bounds: tuple[Array, Array]) -> tuple[Solution, bool]:
        """The certified answer, and whether joint viability had to yield for it."""
        phase, strict = structure.phase, structure.strict
        costs = self._costs(structure, state)
        hard = [contact.rows(name, state.contacts[name]) for name, contact in phase.contacts.items()]
        hard.append(torque_map(state).rows(*bounds))
        joint = phase.joint.rows(state.q, state.v, self.dt) if phase.joint is not None else None
        self._workspace = strict
        fault = fill(strict, costs, hard if joint is None else [*hard, joint])
        if fault:
            return _refused(fault), False
        solution = answer(self._solver, strict.problem)
        if solution.accepted or joint is None or structure.yielding is None:
            return solution, False
        # nothing satisfies all: joint viability yields, never dynamics, torque or its rate
        zero = np.zeros(self.robot.nv)
        spring = Rows("", {"yield": None}, zero, zero, np.diag(state.M.diagonal()))
        self._workspace = structure.yielding
        fill(structure.yielding, [*costs, (spring, 1e6)], [*hard, joint._replace(A={"vdot": None, "yield": None})])
        return answer(self._second, structure.yielding.problem), True

    def _costs(self, structure: _Structure, state: State) -> list[tuple[Rows, float]]:
        weights = structure.phase.weights
        costs = [(task.rows(state), weights[name]) for name, task in structure.above.items()]
        if not structure.single:
            costs += self._stack(structure, state, [rows for rows, _ in costs])
        for name, posture in structure.posture.items():
            costs.append((posture.rows(state), weights[name]))
        for contact, held in state.contacts.items():
            if contact in structure.force:
                name, force = structure.force[contact]
                costs.append((force.rows(state), weights[name]))
            elif held.A.shape[0]:
                zero = np.zeros(held.A.shape[0])
                costs.append((Rows("", {contact: None}, zero, zero, mobility(state, held.G)), 1.0))
        return costs

    def _stack(self, structure: _Structure, state: State, above: list[Rows]) -> list[tuple[Rows, float]]:
        """All that the posture stays out of, where it is more than one motion task; a cost that keeps H definite."""
        held = list(state.contacts.values())
        stack = [h.G for h in held] + [rows.A["vdot"] for rows in above if rows.A.get("vdot") is not None]
        if not stack:
            state.primary = (np.zeros((0, self.robot.nv)), np.zeros((0, 0)), np.zeros((0, 0)))
            return []
        G = np.concatenate(stack)
        K = mobility(state, G)
        W = inertia(K)
        state.primary = (G, W, K)
        if above or not held:
            return []
        # no task weighs the held directions: the constraint decides them, the cost is zero where it holds
        rhs = np.concatenate([h.rhs for h in held])
        return [(Rows("", {"vdot": G}, rhs, rhs, W), 1.0)]

    def _accept(
        self, structure: _Structure, state: State, solution: Solution, yielded: bool, tau_last: Array,
        bounds: tuple[Array, Array], memory: Memory, t: float, refused: list[str], missed: int,
    ) -> Output:  # fmt: skip
        workspace = structure.yielding if yielded else structure.strict
        assert workspace is not None
        slices = workspace.variables.slices
        tau = workspace.product("torque", solution.x)
        tau += state.h
        np.maximum(tau, bounds[0], out=tau)  # the certificate's tolerance must not reach the motors
        np.minimum(tau, bounds[1], out=tau)
        wrenches, loops, lam = {}, dict(memory.loops), {}
        for name, held in state.contacts.items():
            lam[name] = solution.x[slices[name]]
            wrenches[name] = lam[name].dot(held.A)
            if name in structure.force:
                loops[name] = structure.force[name][1].advance(state, lam[name])
        found = workspace.active(solution.z)
        active = self._names(structure.phase, workspace, solution.z, found, state, tau_last) if found else ()
        status, reason, good = Status.OK, "", memory.good + 1
        if active or refused or yielded:
            status = Status.LIMITED
            told = ["joint limits yield: nothing satisfies them within the torque limits"] if yielded else []
            reason = "; ".join([*refused, *told] or ["at the limit: " + ", ".join(active)])
        if good < GOOD_TICKS or missed >= MISSED_DEGRADED:
            status = Status.DEGRADED
            reason = reason or (f"{missed} ticks missed" if missed else f"recovering: {good} of {GOOD_TICKS} good ticks")
        by_robot = self.robot.gravity == "robot"
        gravity = state.gravity() if by_robot else memory.gravity
        self._memory = Memory(
            t, memory.start, memory.phase, memory.phase_start, tau, gravity, state.q.copy(), state.v.copy(), lam, loops,
            state.targets, status, 0, good,
        )  # fmt: skip
        sent = tau - gravity if by_robot else tau.copy()
        return Output(sent, solution.x[slices["vdot"]], wrenches, active, status, reason, solution.certificate)

    def _names(self, phase: Phase, workspace: Workspace, z: Array, found: list[int], state: State, tau_last: Array) -> tuple[str, ...]:
        """Names of active rows, with which of two limits it is that binds."""
        names = []
        for i in found:
            label = workspace.labels[i]
            kind, _, joint = label[:-1].partition("[")
            if kind == "torque":
                label = phase.torque.name(self.robot.joints.index(joint), z[i] > 0.0, tau_last, self.dt)
            elif kind == "joint" and phase.joint is not None:
                label = phase.joint.name(self.robot.joints.index(joint), z[i] > 0.0, state.q)
            names.append(label)
        return tuple(names)

    # --- without a certified answer ---

    def _hold(self, reason: str) -> Output:
        """The last torque, for a few ticks; then the safe hold."""
        memory = self._memory
        if memory is None:
            raise StateError(reason)
        bad = memory.bad + 1
        if memory.status in (Status.SAFE_HOLD, Status.STOPPED) or bad > HOLD_TICKS:
            status = Status.STOPPED if memory.status is Status.STOPPED else Status.SAFE_HOLD
            return self._safe_hold(memory.q, memory.v, status, reason)
        self._memory = memory._replace(status=Status.DEGRADED, bad=bad, good=0)
        return self._held_output(memory.tau, Status.DEGRADED, reason)

    def _safe_hold(self, q: Array, v: Array, status: Status, reason: str) -> Output:
        """g(q) + J' F with the last certified wrenches, plus damping, at the last valid state, inside limit and rate."""
        memory = self._memory
        assert memory is not None
        structure = self._phases[memory.phase]
        state = State(self.robot, self._data, q, v, 0.0, self.dt)
        hold(state, structure.phase)
        tau = state.gravity() - HOLD_DAMPING * state.M.diagonal() * v
        for name, lam in memory.lam.items():
            if name in state.contacts:
                tau = tau + state.contacts[name].G.T @ lam
        low, high = structure.phase.torque.bounds(memory.tau, self.dt)
        tau = np.clip(tau, low, high)
        self._memory = memory._replace(tau=tau, gravity=state.gravity(), q=np.array(q), v=np.array(v), status=status, good=0)
        return self._held_output(tau, status, reason or "held until reset")

    def _held_output(self, tau: Array, status: Status, reason: str) -> Output:
        memory = self._memory
        assert memory is not None
        sent = tau - memory.gravity if self.robot.gravity == "robot" else tau.copy()
        return Output(sent, np.zeros(self.robot.nv), {}, (), status, reason, UNCERTIFIED)


def fill(workspace: Workspace, costs: Sequence[tuple[Rows, float]], hard: Sequence[Rows]) -> str:
    """Assemble a problem; answers why it must not be solved, or ""."""
    workspace.clear()
    for rows, weight in costs:
        workspace.minimise(rows, weight)
    for rows in hard:
        workspace.constrain(rows)
    return workspace.fault()


def make_limits(robot: Robot, limits: Mapping[str, Any]) -> tuple[TorqueLimit, JointLimit | None]:
    """Limits from `torque`, `torque_rate`, `position`, `velocity`: "model", a number or (nv,) within it, or None for none."""
    n = robot.nv

    def value(name: str, model: Array) -> Array:
        given = limits.get(name, "model")
        if given is None:
            return np.full(n, np.inf)
        if isinstance(given, str):
            return model
        given = np.broadcast_to(np.asarray(given, float), (n,))
        if not (given > 0).all():
            raise GainError(f"limits.{name}: expected positive numbers, got {given}")
        return np.minimum(given, np.abs(model))

    free = np.full(n, np.inf)
    high = value("torque", np.minimum(robot.tau_max, -robot.tau_min))
    if limits.get("torque", "model") is not None:
        low, high = np.maximum(robot.tau_min, -high), np.minimum(robot.tau_max, high)
    else:
        low = -high
    rate = value("torque_rate", free)
    torque = TorqueLimit(low, high, rate, robot.joints)
    position, v_max = limits.get("position", "model"), value("velocity", robot.v_max)
    if robot.nq != n or (position is None and not np.isfinite(v_max).any()):
        return torque, None
    margin = float(position) if isinstance(position, (int, float)) else 0.0
    q_min, q_max = (free * -1, free) if position is None else (robot.q_min + margin, robot.q_max - margin)
    a, j = braking(robot, low, high, rate)
    return torque, JointLimit(q_min, q_max, v_max, a, j, robot.joints)


def _fault(name: str, value: Any, size: int) -> str:
    """Why an array from outside is refused, or ""."""
    if type(value) is not np.ndarray or value.dtype != np.float64 or value.shape != (size,):
        got = f"{value.dtype} {value.shape}" if isinstance(value, np.ndarray) else type(value).__name__
        return f"{name}: expected a float64 array of shape ({size},), got {got}"
    # a sum of squares is finite only where every entry is
    if not math.isfinite(value.dot(value)):
        return f"{name}: expected finite numbers, got {value}"
    return ""


def _fault_time(t: Any) -> str:
    return "" if isinstance(t, (int, float)) and math.isfinite(t) else f"t: expected a finite time [s], got {t!r}"


def _refused(reason: str) -> Solution:
    return Solution(np.zeros(0), np.zeros(0), UNCERTIFIED, False, reason)
