"""One tick: state, rows, problem, certified solution, torque. Knows no YAML and no simulator.

`Controller.step` depends on its arguments and on `Controller.memory` alone: no clock, no thread, no input or output.
It never raises on data; it answers with a status, and holds when there is no certified answer.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from .contact import Contact
from .errors import NameNotFound, StateError
from .grounds import floors, levels
from .guard import Guarded, gripped, watch
from .handover import Start, hand_over
from .holding import HELD, Answer, Holding
from .inputs import Inputs
from .jump import kept, lead_in
from .kernels import torque
from .ladder import GOOD_TICKS, MISSED_DEGRADED, MISSED_STOPPED, Status
from .memory import NEW_WATCH, NOTHING, Memory, Output
from .phase import Phase, carry, carry_felt, hold, place, recall, settle_posture
from .program import Program
from .qp import Array, Workspace
from .robot import Robot
from .solver import DEFAULT, Solution, Solver, make
from .state import State, Terms
from .task.force import ForceLoop
from .task.impedance import NEW, Felt
from .transition import STOP, Change
from .valid import array_fault, missed_fault, time_fault, unit
from .whole_body import WholeBodyProgram
from .wrench import Wrench

_NEW_LOOP = ForceLoop()


class Tick(NamedTuple):
    """The last problem that was solved, for `explain`: of which program, at which state and last torque, and the
    answer; `refused` where contacts were dropped: the problem with all of them."""

    program: Program
    state: State
    tau_last: Array
    solution: Solution
    refused: Tick | None = None


class Controller:
    """A whole-body contact controller.

    Parameters: the robot; `contacts` name -> Contact; `tasks` name -> Task, or (Task, weight); `limits` with the keys
    `torque`, `torque_rate`, `position`, `velocity`, `acceleration` (a number or (nu,), "model", or None) and
    `self_collision` (a distance [m], or a mapping: `SelfCollision`); `solver`: a
    name or an object with `solve(problem)`; `rate` [Hz]; `brakes`: whether the robot has some that hold it
    without torque, once it is STOPPED. `from_spec` makes one from YAML. Everything wrong with these
    raises here, a WbcError that says what; nothing raises later.
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
        hierarchy: str = "weighted",
        brakes: bool = False,
    ) -> None:
        self.robot, self.dt, self.brakes = robot, 1.0 / rate, brakes
        self._terms = Terms(robot)
        self._solver = make(solver)
        # the yielding problem has another shape: a solver of its own keeps both warm
        self._second = make(solver) if isinstance(solver, str) else self._solver
        q = robot.keyframes["home"] if q is None else np.array(q, float)
        start = State(self._terms, q, np.zeros(robot.nv))
        if phases is None:
            phases = [place(robot, contacts or {}, tasks or {}, limits or {}, hierarchy)]
        self.notes: list[str] = []
        program = WholeBodyProgram if robot.base else Program
        self._programs: list[Program] = [program(settle_posture(phase, start, self.notes), start) for phase in phases]
        self._spare = [each.spare(start) for each in self._programs]
        self.notes += dict.fromkeys(note for each in self._programs for note in each.notes)
        self._holding = Holding(robot, self._terms, self._programs, self.dt, brakes)
        self._inputs = Inputs(
            {name: contact for phase in phases for name, contact in phase.contacts.items()},
            {name: frame for phase in phases for name, frame in phase.feeling.items()},
        )
        self._index = {phase.name: i for i, phase in enumerate(phases)}
        for to in (to for phase in phases if phase.exit is not None for to in phase.exit.targets):
            if to != STOP and to not in self._index:
                raise NameNotFound("phase", to, [*self._index, STOP])
        self._memory: Memory | None = None
        self._dropped: Program | None = None  # what answered the last tick, where contacts were dropped
        self.recalled = Memory()  # what the last tick began with, after a change of phase
        self.start = start.q  # the configuration that the tasks and contacts were built at
        self.state = start
        self.output: Output | None = None  # of the last tick
        self.tick: Tick | None = None  # None where the last tick solved nothing

    @classmethod
    def from_spec(cls, spec: Any, robot: Robot | None = None, **changes: Any) -> Controller:
        """The controller that a spec describes (`wbc.load`). Raises SpecError with every fault located."""
        from .build import build

        return build(spec, robot=robot, **changes).controller

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
    def solver(self) -> str:
        """The class of the solver."""
        return type(self._solver).__name__

    @property
    def solvers(self) -> tuple[Solver, Solver]:
        """Of the problem as it stands, and of the one in which viability yields. Assign to have others answer."""
        return self._solver, self._second

    @solvers.setter
    def solvers(self, value: tuple[Solver, Solver]) -> None:
        self._solver, self._second = value

    @property
    def _remembered(self) -> Memory:
        assert self._memory is not None
        return self._memory

    @property
    def phases(self) -> tuple[Phase, ...]:
        """All phases, as they run."""
        return tuple(program.phase for program in self._programs)

    @property
    def phase(self) -> Phase:
        """The phase of the last tick."""
        return self._program.phase

    @property
    def _program(self) -> Program:
        return self._programs[self._memory.phase if self._memory else 0]

    @property
    def workspace(self) -> Workspace:
        """Holds the last problem until the next tick.

        An answer's torque is `product("torque", x) + state.bias`, of a floating base without the first six.
        """
        return (self._dropped or self._program).last

    def reset(self, q: Array, v: Array, tau: Array | None = None) -> None:
        """Start, or start again, at a state; `tau` is what the driver was last sent (default: what holds gravity).

        The first torque then differs from `tau` by no more than the rate limit allows. The only way out of a safe hold.
        Raises StateError.
        """
        q, fault = self._checked(q, v)
        if fault:
            raise StateError(fault)
        q, v = np.array(q, float), np.array(v, float)
        state = State(self._terms, q, v)
        gravity = state.gravity()[self.robot.base :]
        if tau is None:
            total = self._programs[0].rest(state)
        else:
            if fault := array_fault("tau", tau, self.robot.nu):
                raise StateError(fault)
            total = np.array(tau, float) + (gravity if self.robot.gravity == "robot" else 0.0)
        self.memory = Memory(tau=self._programs[0].phase.torque.inside(total), gravity=gravity, q=q, v=v)

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

        `measured`: contact, or task that has none -> Wrench; `targets`: `contact.axis` -> number, kept until changed;
        `tau_applied`: what the driver really sent last; `missed`: ticks that the caller left out. Never raises on data.
        """
        self.tick = None
        try:
            out = self._step(t, q, v, measured, targets, tau_applied, missed)
        except Exception as error:  # whatever a task of one's own does, the loop goes on
            out = self._hold(f"{type(error).__name__}: {error}")
        self.output = out
        return out

    def _step(self, t: Any, q: Any, v: Any, measured: Any, targets: Any, tau_applied: Any, missed: int) -> Output:
        q, fault = self._checked(q, v)
        fault = fault or time_fault(t)
        unread = missed_fault(missed)
        missed = 0 if unread else missed
        if self._memory is None:
            if fault:
                return self._hold(fault)
            self.reset(q, v, tau_applied)
        memory = self._remembered
        if missed >= MISSED_STOPPED:
            at, moving = (memory.q, None) if fault else (q, v)
            return self._safe_hold(at, moving, Status.STOPPED, f"{missed} ticks missed")
        if fault:
            return self._hold(fault)
        if memory.status in HELD:
            return self._safe_hold(q, v, memory.status)
        dt = self.dt
        if memory.t is None:
            memory = memory._replace(start=t, phase_start=t)
        else:
            past, most = t - memory.t, 2.0 * dt
            dt = 0.0 if past < 0.0 else past if past < most else most
            if past <= 0.0:  # no new tick, as far as the caller's clock goes, which does not run backwards
                t, stale = memory.t, memory.stale + 1
                if stale >= MISSED_STOPPED:
                    why = f"stale: the time has not gone on from {t:g} s for {stale} ticks"
                    return self._safe_hold(q, v, Status.STOPPED, why)
                memory = memory._replace(stale=stale)
            elif memory.stale:
                memory = memory._replace(stale=0)
        program = self._programs[memory.phase]
        state = self.state = State(self._terms, q, v, t - memory.start, dt)
        state.starts = program.named(memory.starts)
        if memory.grounds:
            state.grounds = levels(program.phase, memory.grounds)
        hold(state, program.phase)
        refused = self._inputs.read(state, memory, measured, targets)
        if unread:
            refused.append(unread)
        tau_last = memory.tau
        if tau_applied is not None:
            if fault := array_fault("tau_applied", tau_applied, self.robot.nu):
                refused.append(fault)
            else:
                tau_last = tau_applied + memory.gravity if self.robot.gravity == "robot" else tau_applied
        change = None
        if program.phase.exit is not None:
            if program.phase.tanks:
                recall(state, program.phase, memory.loops, memory.felt)
            watched, change = program.phase.exit.step(memory.watch, t - memory.phase_start, state)
            memory = memory._replace(watch=watched)
        self.recalled = memory
        if change is None:
            followed, starts = self._led(state, program, memory, t)
            found = watch(state, program.force, memory.grips, memory.lam)
            memory = memory._replace(followed=followed, starts=starts, grips=found.grips)
            if found.told:
                refused += found.told
                change = _left(program.phase, found)
        if change is None:
            carry(state, program.phase)
        elif change.to == STOP:
            return self._stop(q, v, change)
        else:
            memory = self._enter(state, memory, change, t, tau_last)
            program = self._programs[memory.phase]
        if change is not None or tau_applied is not None:
            tau_last = program.phase.torque.inside(tau_last)  # of the phase that answers
        if change is not None:
            self.recalled = memory
            followed, starts = self._led(state, program, memory, t)
            memory = memory._replace(followed=followed, starts=starts)
        if program.phase.compliant:
            memory = memory._replace(felt=self._feel(state, program.phase, memory, tau_last))
        if not program.assemble(state, tau_last, self.dt):
            return self._hold(program.last.fault(), state)
        solution = program.solve(self._solver)
        if not solution.accepted and program.relax(state):
            solution = program.solve(self._second)
        self.tick = Tick(program, state, tau_last, solution)
        dropped: tuple[str, ...] = ()
        if not solution.accepted:
            reason = program.last.fault() or solution.reason
            without = None if solution.broken else self._drop(program, state, memory, tau_last)
            if without is None:
                return self._hold(reason, state)
            program, solution, dropped = without
            self.tick = Tick(program, state, tau_last, solution, self.tick)
        self._dropped = program if dropped else None
        return self._accept(program, state, solution, tau_last, memory, t, refused, missed, dropped)

    def _checked(self, q: Any, v: Any) -> tuple[Any, str]:
        """q with its quaternions of norm 1, and why the state is refused, or ""."""
        fault = array_fault("q", q, self.robot.nq) or array_fault("v", v, self.robot.nv)
        return (q, fault) if fault or not self.robot.unit_parts else unit(q, self.robot.unit_parts)

    def _drop(
        self, program: Program, state: State, memory: Memory, tau_last: Array
    ) -> tuple[Program, Solution, tuple[str, ...]] | None:
        """The tick without the contacts that cannot be held, as few of them as it takes; None where none can be."""
        gone = [name for name in program.phase.contacts if name not in memory.lam]  # dropped at the last tick
        spare = self._spare[memory.phase]
        for dropped in sorted(spare, key=lambda names: (len(names), *(name not in gone for name in names))):
            less = spare[dropped]
            state.contacts = {}
            hold(state, less.phase)
            state.starts = less.named(memory.starts)
            if not less.assemble(state, tau_last, self.dt):
                continue
            solution = less.solve(self._second)
            if not solution.accepted and less.relax(state):
                solution = less.solve(self._second)
            if solution.accepted:
                return less, solution, dropped
        state.contacts, state.starts = {}, program.named(memory.starts)
        hold(state, program.phase)
        return None

    def _enter(self, state: State, memory: Memory, change: Change, t: float, tau: Array) -> Memory:
        """Another phase begins at this tick: its contacts are held, and it is handed what goes on."""
        before, index = self._programs[memory.phase], self._index[change.to]
        after = self._programs[index]
        state.contacts, state.followed = {}, {}
        grounds = floors(state, after.phase, memory.grounds, {}) if after.phase.standing else NOTHING
        state.grounds = levels(after.phase, grounds)
        hold(state, after.phase)
        carry(state, after.phase)
        tau = np.concatenate((np.zeros(self.robot.base), after.phase.torque.inside(tau)))  # of all velocities
        starts, loops = hand_over(before, after, state, memory.starts, memory.loops, tau, memory.lam)
        why = _told(before.phase, change)
        felt = {name: memory.felt[name] for name in after.phase.compliant if name in memory.felt}
        return memory._replace(
            phase=index, phase_start=t, starts=starts, loops=loops, watch=NEW_WATCH, why=why, felt=felt,
            grounds=grounds, followed=kept(memory.followed, before.phase, after, starts, state.t),
            grips=gripped(memory.grips, after.force, before.phase.contacts),
        )  # fmt: skip

    def _stop(self, q: Array, v: Array, change: Change) -> Output:
        """A phase that leads nowhere: the safe hold, without the wrench of a contact that is lost."""
        memory, why = self._remembered, _told(self.phase, change)
        lam = {name: value for name, value in memory.lam.items() if name != change.lost}
        self._memory = memory._replace(lam=lam, why=why)
        return self._safe_hold(q, v, Status.STOPPED, why)

    def _feel(self, state: State, phase: Phase, memory: Memory, tau: Array) -> dict[str, Felt]:
        """The pushes of this tick, by task."""
        felt: dict[str, Felt] = {}
        if phase.gravity_only:
            state.bias = state.bias + (state.gravity() - state.h)
        for name, task in phase.compliant.items():
            at = task.contact or name
            felt[name] = state.felt[task] = task.feel(state, state.measured.get(at), tau, memory.felt.get(name, NEW))
        carry_felt(state, phase, felt)
        return felt

    def _led(
        self, state: State, program: Program, memory: Memory, t: float
    ) -> tuple[Mapping[str, Array], Mapping[str, Start]]:
        """What the tasks follow at this tick, and their starts; the loops of its contacts are put into the state."""
        past = 0.0 if memory.t is None else t - memory.t
        state.followed, state.gave = {}, {}
        state.loops = {name: memory.loops.get(name, _NEW_LOOP) for name in program.phase.contacts}
        return lead_in(program, state, memory.followed, memory.starts, past, self.dt)

    def _accept(
        self, program: Program, state: State, solution: Solution, tau_last: Array, memory: Memory, t: float,
        refused: list[str], missed: int, dropped: tuple[str, ...],
    ) -> Output:  # fmt: skip
        workspace, force = program.last, program.force
        slices = workspace.variables.slices
        tau = np.empty(tau_last.size)  # in its bounds: the certificate's tolerance must not reach the motors
        torque(workspace.coefficients("torque"), solution.x, state.bias[self.robot.base :], *program.window, tau)
        wrenches, loops, lam = {}, dict(memory.loops), {}
        for name, held in state.contacts.items():
            lam[name] = solution.x[slices[name]]
            wrenches[name] = lam[name].dot(held.B)
            if name in force:
                loops[name] = force[name][1].advance(state, lam[name])
        found = workspace.active(solution.z)
        names = found or program.pushing or state.gave or program.phase.tanks
        active = program.names(solution.z, found, state, tau_last, self.dt) if names else ()
        if dropped:  # they are told of as before, but carry nothing
            active = (*(f"{name}.dropped" for name in dropped), *active)
            hold(state, self._programs[memory.phase].phase)
        good = 0 if missed >= MISSED_DEGRADED else memory.good + 1
        status, reason = Status.OK, ""
        if active or refused or good < GOOD_TICKS or program.yielded:
            status, reason = _rated(program, solution, active, dropped, refused, [*state.gave.values()], missed, good)
        grounds = floors(state, program.phase, memory.grounds, wrenches) if program.phase.standing else NOTHING
        by_robot = self.robot.gravity == "robot"
        gravity = state.gravity() if by_robot else memory.gravity
        self._memory = Memory(
            t, memory.start, memory.phase, memory.phase_start, tau, gravity, state.q.copy(), state.v.copy(), lam, loops,
            state.targets, status, 0, good, memory.starts, memory.watch, memory.why, memory.felt, grounds,
            memory.stale, memory.followed, memory.grips,
        )  # fmt: skip
        sent = tau - gravity if by_robot else tau.copy()
        return Output(sent, solution.x[slices["vdot"]], wrenches, active, status, reason, solution.certificate)

    # --- without a certified answer ---

    def _hold(self, reason: str, state: State | None = None) -> Output:
        if self._memory is None:
            return self._holding.unknown(reason)
        return self._take(self._holding.degraded(self._memory, reason, state))

    def _safe_hold(self, q: Array, v: Array | None, status: Status, reason: str = "") -> Output:
        return self._take(self._holding.safe(self._remembered, q, v, status, reason))

    def _take(self, held: Answer) -> Output:
        self._memory, self.state = held.memory, held.state
        return held.output


def _rated(
    program: Program, solution: Solution, active: Sequence[str], dropped: Sequence[str], refused: list[str],
    gave: list[str], missed: int, good: int,
) -> tuple[Status, str]:  # fmt: skip
    """How good a certified tick is at which something is to be told, and what."""
    status, reason = Status.OK, ""
    if active or refused or program.yielded:
        status, told = Status.LIMITED, list(refused)
        if dropped:
            told.append(f"{' and '.join(dropped)} dropped: not to be held within the torque limits")
        if program.yielded:
            yielded = program.gave_way(solution.x)
            why = f"{yielded} yield: nothing satisfies them within the torque limits"
            told.append(why if yielded else "nothing yields, but the first answer was refused")
        reason = "; ".join([*told, *gave] or ["at the limit: " + ", ".join(active)])
    if good < GOOD_TICKS:
        late = missed >= MISSED_DEGRADED
        status = Status.DEGRADED
        reason = reason or (f"{missed} ticks missed" if late else f"recovering: {good} of {GOOD_TICKS} good ticks")
    return status, reason


def _left(phase: Phase, found: Guarded) -> Change | None:
    """The phase's way out, where a contact has just been lost."""
    lost = phase.exit.lost if phase.exit is not None and found.lost else ""
    return Change(lost, found.told[0], found.lost) if lost else None


def _told(phase: Phase, change: Change) -> str:
    return f"{phase.name}: {change.why}" if phase.name else change.why
