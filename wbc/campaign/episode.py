"""One episode: a simulated robot, a scenario's faults and wrong arguments, and the invariants at every tick."""

from __future__ import annotations

import hashlib
from collections import Counter
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from ..errors import InvariantError, SimulationError
from ..fault import FaultPlan
from ..holding import HELD
from ..invariant import Watched
from ..invariant.mark import mark
from ..invariant.watched import STOPPED_AT
from ..model import quietly
from ..qp import Array
from ..run import felt_names, wrist
from ..sim import Observation, Simulator
from ..solver import ProxQP
from .arguments import ARGUMENTS, Given
from .scenario import ENDING, Scenario

if TYPE_CHECKING:
    from ..build import Built
    from ..controller import Controller
    from ..ladder import Status
    from ..memory import Output

# name -> what must hold, of several ticks
INVARIANTS = {
    "swallowed": "nothing raises inside a tick either, that it then holds for",
    "untouched": "a refused call leaves no trace: the next good tick is bit for bit that of a run without it",
    "recovery": "a tick is accepted as soon as what went wrong is over",
    "simulator": "a simulator that breaks down ends the run and says when, and no other does",
    "repeated": "an episode run twice is the same to the last bit",
}
# of the controller's memory, what a refused call leaves as it is
KEPT = ("tau", "loops", "lam", "felt", "phase", "grounds", "watch", "followed", "grips")


class Failure(NamedTuple):
    """A violated invariant."""

    invariant: str
    tick: int
    told: str


class Outcome(NamedTuple):
    """What came of an episode. `faults`: kind -> status -> ticks in which it acted; `next_good`: good ticks after bad
    ones that were accepted, and all of them; `digest` of every torque and status."""

    ticks: int
    failure: Failure | None
    faults: dict[str, dict[str, int]]
    checked: dict[str, int]
    next_good: tuple[int, int]
    digest: str


def rounding(controller: Controller) -> float:
    """[N m] by which the torque of the same tick may differ: ProxQP's last bits depend on where its storage lies."""
    return 2e-12 if controller.solver == ProxQP.__name__ else 0.0


class Episode:
    """Runs one scenario of a built spec, whose controller is left without a memory. `repeat`: the command for it."""

    def __init__(self, built: Built, made: Scenario, repeat: str = "") -> None:
        self._built, self._made, self._controller = built, made, built.controller
        self._watched = Watched(built.controller, repeat)
        self._rounding = rounding(built.controller)
        self._simulator = Simulator(built.robot, built.q, built.controller.dt, made.plant, made.seed, built.rides)
        self._plan = FaultPlan(made.faults, built.controller.dt, made.seed)
        self._rng = np.random.default_rng([made.seed, 0xC0])  # of what is not the plan's
        self._faults: dict[str, Counter[str]] = {}
        self._checked: Counter[str] = Counter()
        self._next = [0, 0]
        self._digest = hashlib.sha256()
        self._sent: Array | None = None
        self._held = 0  # ticks in a row
        self._was_bad = False
        self._lent: list[Array] = []
        self._before: tuple[Observation, Output, Any] | None = None

    def run(self) -> Outcome:
        """Run it. Never raises for what the controller does."""
        controller, solvers, failure, tick = self._controller, self._controller.solvers, None, -1
        breaks = [int(line.split()[3]) for line in self._made.faults if line.startswith(ENDING)]
        controller.memory = None
        self._plan.spoil(controller)
        try:
            with quietly():
                self._start()
                for tick in range(self._made.ticks):
                    self._tick(tick)
            self._check("simulator", not breaks, tick, "it went on after it had broken down")
        except InvariantError as error:
            failure = Failure(error.invariant, tick, error.told)
        except SimulationError as error:
            self._checked["simulator"] += 1
            due = bool(breaks) and 0 <= tick - breaks[0] <= 1 and f"t = {error.time:.3f} s" in str(error)
            if not due:
                failure = Failure("simulator", tick, str(error))
        finally:
            self._plan.mend(controller)
            controller.solvers = solvers
            controller.memory = None
        checked = dict(self._checked + self._watched.checked)
        faults = {kind: dict(found) for kind, found in self._faults.items()}
        return Outcome(tick + 1, failure, faults, checked, (self._next[0], self._next[1]), self._digest.hexdigest())

    def _start(self) -> None:
        built = self._built
        self._feeling = felt_names(built)
        self._watched.reset(built.q, np.zeros(built.robot.nv))

    def _tick(self, tick: int) -> None:
        made, plan, simulator = self._made, self._plan, self._simulator
        plan.begin(tick, simulator)
        seen = simulator.observe()
        F = wrist(simulator, self._controller, self._before, seen)
        given: Any = dict.fromkeys(self._feeling, F) if F is not None else None
        for x in self._lent:  # the caller writes over what it gave and got
            x[:] = np.nan
        if plan.late and self._before is not None:
            tau = self._sent  # the motors go on with what they have
        else:
            shown, measured, missed = plan.seen(seen, self._built.robot), plan.measured(given), plan.told()
            q = shown.q.copy()
            for part in self._built.robot.unit_parts if q.size == self._built.robot.nq else ():
                q[part] *= made.norm
            call: Given = {
                "t": shown.t + made.clock,
                "q": q,
                "v": shown.v.copy(),
                "measured": measured,
                "missed": missed,
            }
            call["targets"] = {each.name: each.value for each in made.targets if each.tick == tick} or None
            call["tau_applied"] = self._applied()
            out = self._step(tick, call)
            tau = out.tau.copy()
            self._note(tick, call, out)
            self._lent = [call["q"], call["v"], out.tau, out.vdot, *out.wrenches.values()]
            self._before = (Observation(seen.t, seen.q.copy(), seen.v.copy()), out, self._controller.state)
        assert tau is not None
        self._sent = tau
        simulator.apply(tau)

    def _applied(self) -> Array | None:
        if self._made.applied == "" or self._sent is None:
            return None
        off = self._rng.uniform(-0.5, 0.5, self._sent.size) if self._made.applied == "off" else 0.0
        return self._sent + off

    def _step(self, tick: int, call: Given) -> Output:
        """The tick with whatever the caller gets wrong in it, or an operator's reset before it."""
        wrong = [kind for at, kind in self._made.calls if at == tick]
        if self._held > self._made.patience and self._resettable():
            self._watched.reset(call["q"].copy(), call["v"].copy(), self._sent)
            self._held, self._was_bad = 0, False
        if wrong and self._controller.memory is not None:
            return self._twin(tick, wrong[0], call)
        return self._watched.step(**call)

    def _resettable(self) -> bool:
        return not any(kind.startswith("state.") or kind in ENDING for kind in self._plan.now)

    def _twin(self, tick: int, kind: str, call: Given) -> Output:
        """A wrong call, and the same as if it had never been made."""
        watched, argument = self._watched, ARGUMENTS[kind]
        lies = any(each.startswith("solver.") for each in self._plan.now)
        bad = dict(call)
        if argument.field:
            bad[argument.field] = argument.spoil(self._rng, self._controller, call)
        clean = dict(call)
        if argument.state or not argument.field:
            clean["tau_applied"] = bad["tau_applied"] = self._sent  # whatever was held is not what was sent
        else:
            clean[argument.field] = 0 if argument.field == "missed" else None
        memory, known = self._controller.memory, watched.known
        assert memory is not None
        self._controller.memory = memory
        watched.step(**clean)
        never = self._controller.memory
        assert never is not None
        watched.known, self._controller.memory = known, memory
        out = watched.step(**bad) if argument.field else self._between(call)
        self._count(kind, out.status)
        self._swallowed(tick, out)
        if not argument.field:
            watched.known, self._controller.memory = known, memory
        if argument.state or not argument.field:
            out = watched.step(**clean)
        after = self._controller.memory
        assert after is not None
        # a robot held until reset, maybe by the refused call as the last that it took, reads no targets
        kept = memory if after.status in HELD else never
        self._check("untouched", dict(after.targets) == dict(kept.targets), tick, f"{kind}: another target")
        ended = after.status in HELD or never.status in HELD
        if lies or ended or (kind == "argument.measured" and self._felt(bad["measured"])):
            return out
        if not np.isfinite(max(out.certificate)):
            return out  # of a refused tick the ladder goes on
        for name in ("tau",) if self._rounding else KEPT:
            same = mark(getattr(after, name)) == mark(getattr(never, name))
            told = f"{kind}: another {name}"
            if name == "tau" and not same:
                off = np.abs(after.tau - never.tau).max()
                same, told = off <= self._rounding, f"{told}, off by {off:.3g} N m"
            self._check("untouched", same, tick, told)
        return out

    def _between(self, call: Given) -> Output:
        """Ticks of another state, that are then forgotten."""
        out = None
        for k in range(3):
            q = self._built.q.copy()
            v = self._rng.uniform(-0.1, 0.1, self._built.robot.nv)
            out = self._watched.step(**(call | {"t": call["t"] + 1e-3 * k, "q": q, "v": v}))
        assert out is not None
        return out

    def _felt(self, measured: Any) -> bool:
        """Whether a wrench is given for something that feels it: what stands in its place is the last one, not none."""
        names = {name for phase in self._controller.phases for name in phase.feeling}
        return isinstance(measured, Mapping) and bool(names & set(measured))

    def _note(self, tick: int, call: Given, out: Output) -> None:
        self._swallowed(tick, out)
        for kind in self._plan.now:
            self._count(kind, out.status)
        certified = bool(np.isfinite(max(out.certificate)))
        self._held = self._held + 1 if out.status in HELD else 0
        wrong = any(kind.startswith(("state.", "solver.")) for kind in self._plan.now) or call["missed"] >= STOPPED_AT
        if self._was_bad and not wrong and not self._held:
            self._next[1] += 1
            self._next[0] += certified
        self._checked["recovery"] += 1
        self._was_bad = not certified and not self._held
        self._digest.update(out.tau.tobytes() + out.status.name.encode())

    def _swallowed(self, tick: int, out: Output) -> None:
        kind = out.reason.partition(": ")[0]  # of one that the solver raised it says so
        raised = kind.isidentifier() and kind.endswith(("Error", "Exception", "Warning"))
        self._check("swallowed", not raised, tick, out.reason)

    def _count(self, kind: str, status: Status) -> None:
        self._faults.setdefault(kind, Counter())[status.name] += 1

    def _check(self, invariant: str, holds: bool, tick: int, told: str) -> None:
        self._checked[invariant] += 1
        if not holds:
            raise InvariantError(invariant, tick, told)
