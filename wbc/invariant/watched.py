"""A controller whose every tick is held against what must hold."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from ..arguments import Arguments, called_as
from ..controller import Controller
from ..errors import InvariantError
from ..ladder import FOLLOWS, Status
from ..memory import Memory, Output
from ..qp import Array
from ..wrench import Wrench
from .body import Body
from .call import Call
from .certificate import certificate
from .mark import mark

TOLERANCE, ROUNDING = 1e-6, 2e-15  # of the residuals; of a multiplier times a row
HOLD, GOOD, DEGRADED_AT, STOPPED_AT, DAMPING = 5, 10, 3, 20, 10.0  # the ladder's numbers, as promised
_HELD = (Status.SAFE_HOLD, Status.STOPPED)
_KEPT = ("loops", "targets", "felt", "grounds", "starts", "phase", "watch", "t", "start", "followed", "grips")


class Known(NamedTuple):
    """What is known of the ticks before."""

    status: Status | None = None  # None: a reset came last
    bad: int = 0
    good: int = GOOD
    stale: int = 0
    wrenches: Mapping[str, tuple[Array, Array]] | None = None  # the last certified ones (6,), and the axes (3, 3) they
    # were in; None: there are none yet
    mark: tuple[Any, ...] | None = None  # of the memory


class Watched:
    """A controller whose every tick is held against the invariants; the first that is violated raises InvariantError.

    `step` and `reset` are the controller's. `repeat` is the command that repeats a failure, `checked` counts how often
    each invariant was held against something, `known` may be kept and restored beside the controller's memory.
    """

    def __init__(self, controller: Controller, repeat: str = "") -> None:
        self.controller, self.repeat, self.tick = controller, repeat, -1
        self.checked: Counter[str] = Counter()
        self._body = Body(controller.robot)
        names = [phase.torque for phase in controller.phases]
        self._limits = [(limit.low.copy(), limit.high.copy(), limit.rate.copy()) for limit in names]
        memory = controller.memory
        self.known = Known()
        if memory is not None:
            self.known = Known(None, memory.bad, memory.good, memory.stale)

    @property
    def status(self) -> Status | None:
        """Of the last tick; None after a reset."""
        return self.known.status

    @status.setter
    def status(self, status: Status | None) -> None:
        self.known = self.known._replace(status=status)

    def reset(self, q: Array, v: Array, tau: Array | None = None) -> None:
        """Start again: `Controller.reset`."""
        self.known = Known()
        self.controller.reset(q, v, tau)

    @called_as(Controller.step)
    def step(self, given: Arguments) -> Output:
        """`Controller.step`. Raises InvariantError."""
        self.tick += 1
        controller, known = self.controller, self.known
        before = controller.memory
        arrays = (given.q, given.v, given.tau_applied, *_wrenches(given.measured))
        owned = [(x, x.copy()) for x in arrays if isinstance(x, np.ndarray)]
        if known.mark is not None:
            self._hold("memory", mark(before) == known.mark, "what was remembered has changed since the last tick")
        self.checked["raises"] += 1
        try:
            out = controller.step(*given)
        except Exception as error:
            raise self._violated("raises", f"{type(error).__name__}: {error}") from error
        after = controller.memory
        same = all(x.tobytes() == was.tobytes() for x, was in owned)
        self._hold("memory", same, "an argument was written to")
        shared = [
            x for x, _ in owned if after is not None for kept in (after.q, after.v, after.tau) if _shares(x, kept)
        ]
        self._hold("memory", not shared, "an argument's own storage is remembered")
        call = Call(given, self.controller.robot)
        self._answered(out)
        if after is None:
            self._hold("refused", call.wrong != "", "a controller that was never reset started without being started")
            return out
        if before is None:
            before, known = after._replace(status=Status.OK, bad=0, good=GOOD, t=None, stale=0), Known()
            self.known = known
        certified = math.isfinite(max(out.certificate))
        self._laddered(call, out, before, after, certified)
        self._bounded(call, out, before, after, certified)
        if certified:
            self._certified(out)
            self._moved(call, out, after)
            self._named(call, out)
            self._advanced(call, before, after)
        else:
            self._held(call, out, before, after)
        wrenches = known.wrenches
        if certified:  # at the state of `_moved`
            contacts = controller.phase.contacts
            wrenches = {name: (F.copy(), self._body.axes(contacts[name])) for name, F in out.wrenches.items()}
        self.known = self.known._replace(status=out.status, wrenches=wrenches, mark=mark(after))
        return out

    # --- what must hold ---

    def _answered(self, out: Output) -> None:
        self._hold("status", isinstance(out.status, Status), f"{out.status!r} is no status")
        self._hold("status", out.status is Status.OK or bool(out.reason), f"{out.status.name} without a reason")
        tau, nu = out.tau, self.controller.robot.nu
        good = isinstance(tau, np.ndarray) and tau.shape == (nu,) and tau.dtype == np.float64
        self._hold("finite", good and bool(np.isfinite(tau).all()), "a torque that is none")

    def _laddered(self, call: Call, out: Output, before: Memory, after: Memory, certified: bool) -> None:
        known, status = self.known, out.status
        if known.status is not None:
            told = f"{known.status.name} to {status.name}"
            self._hold("transition", status in FOLLOWS[known.status], told)
        bad, good, stale = known.bad, known.good, known.stale
        if certified:
            passed = before.t is None or call.t > before.t
            stale = 0 if passed else stale + 1
            bad, good = 0, 0 if call.missed >= DEGRADED_AT else good + 1
            expected = (Status.OK, Status.LIMITED) if good >= GOOD else (Status.DEGRADED,)
            self._hold("ladder", known.status not in _HELD, f"{status.name} after {known.status}")
            self._hold("ladder", stale < STOPPED_AT, f"{stale} ticks whose time did not go on")
            self._hold("ladder", call.missed < STOPPED_AT, f"{call.missed} ticks missed, and {status.name}")
            self._hold("refused", not call.wrong, f"{call.wrong}, and accepted as {status.name}")
        else:
            why, good = out.reason, 0
            stopped = call.missed >= STOPPED_AT or (stale + 1 >= STOPPED_AT and not call.wrong)
            led = not call.wrong and self.controller.phases[before.phase].exit is not None
            if stopped and known.status is not Status.SAFE_HOLD:
                expected = (Status.STOPPED,)
            elif known.status in _HELD:
                expected = (known.status, Status.STOPPED) if call.missed >= STOPPED_AT else (known.status,)
            else:
                bad += 1
                expected = (Status.DEGRADED if bad <= HOLD else Status.SAFE_HOLD,)
                if led and status is Status.STOPPED:  # a phase that leads to `stop`
                    expected = (Status.STOPPED,)
            self._hold("status", bool(why), "held without a reason")
        told = " or ".join(each.name for each in expected)
        self._hold("ladder", status in expected, f"{status.name} after {bad} bad, {good} good ticks; expected {told}")
        self.known = known._replace(bad=bad, good=good, stale=stale)

    def _bounded(self, call: Call, out: Output, before: Memory, after: Memory, certified: bool) -> None:
        robot, (low, high, rate) = self.controller.robot, self._limits[after.phase]
        total = out.tau
        if robot.gravity == "robot":
            total = total + self._body.gravity(after.q)[robot.base :]
        slack = 1e-9 * (1.0 + np.abs(total))
        over = np.maximum(total - high, low - total) - slack
        self._hold("limit", bool((over <= 0.0).all()), f"{robot.joints[int(over.argmax())]} by {over.max():.3g} N m")
        last = before.tau
        if certified and call.applied is not None:
            last = call.applied + (before.gravity if robot.gravity == "robot" else 0.0)
        change = np.abs(total - np.clip(last, low, high)) - rate * self.controller.dt - slack
        joint = robot.joints[int(change.argmax())]
        self._hold("rate", bool((change <= 0.0).all()), f"{joint} by {change.max():.3g} N m beyond it")
        apart = np.abs(total - after.tau).max(initial=0.0)
        self._hold(
            "memory", bool(apart <= slack.max(initial=1e-9)), f"another torque is remembered, off by {apart:.3g}"
        )
        self._hold("memory", not np.shares_memory(out.tau, after.tau), "the torque that is given out is remembered")

    def _certified(self, out: Output) -> None:
        controller = self.controller
        self._hold("certificate", controller.tick is not None, "an answer of no problem")
        assert controller.tick is not None
        program, solution = controller.tick.program, controller.tick.solution
        given = np.array_equal(out.vdot, solution.x[program.last.variables["vdot"]]) if solution.x.size else False
        self._hold("certificate", given, "the answer that is given out is another one")
        if program.phase.levels is None:
            residuals = certificate(program.last.problem, solution.x, solution.z)
        else:  # of strict levels each has a problem of its own; they share the hard rows
            primal = certificate(program.last.problem, solution.x, solution.z)[0]
            residuals = (primal / (1.0 + np.abs(solution.x).max()), 0.0, 0.0)
        told = ", ".join(f"{r:.2e}" for r in residuals)
        problem = program.last.problem
        size = float(np.abs(solution.z).max() * max(np.abs(problem.C).dot(np.abs(solution.x)).max(initial=1.0), 1.0))
        holds = all(r <= 1.01 * TOLERANCE + ROUNDING * size for r in residuals)  # two ways to sum differ by as much
        self._hold(
            "certificate",
            holds,
            f"primal, dual, gap {told}, accepted as {', '.join(f'{r:.2e}' for r in out.certificate)}",
        )

    def _moved(self, call: Call, out: Output, after: Memory) -> None:
        controller, state = self.controller, self.controller.state
        known = state.bias - state.h  # of wrenches that are known
        asked = self._body.torque(call.q, call.v, out.vdot) + known
        for name, F in out.wrenches.items():
            asked = asked + self._body.carried(controller.phase.contacts[name], F)
        base = controller.robot.base
        off = asked - np.concatenate((np.zeros(base), after.tau))
        allowed = 1e-5 + 1e-7 * np.abs(asked).max(initial=0.0)
        worst = int(np.abs(off).argmax())
        what = "the base" if worst < base else controller.robot.joints[worst - base]
        self._hold("dynamics", bool(np.abs(off).max() <= allowed), f"{what} is off by {off[worst]:.3g} N m")

    def _named(self, call: Call, out: Output) -> None:
        controller = self.controller
        assert controller.tick is not None
        program, solution = controller.tick.program, controller.tick.solution
        missing = [name for name in controller.phase.contacts if name not in out.wrenches]
        for name in missing:
            told = f"{name}.dropped" in out.active and f"{name} " in out.reason and out.status is not Status.OK
            self._hold("status", told, f"{name} was dropped and is not named")
        for field in call.refused(controller):
            told = out.status is not Status.OK and field in out.reason
            self._hold("refused", told, f"{field} is not valid and is not named: {out.reason!r}")
        if program.phase.levels is not None:
            return
        n, n_eq, labels = program.last.problem.g.size, program.last.problem.n_eq, program.last.labels
        for i in np.flatnonzero(np.abs(solution.z) > 1e-6):
            if n <= i < n + n_eq or labels[i].startswith("collision"):
                continue
            part = labels[i].rpartition("[")[2] if labels[i].startswith(("torque[", "joint[")) else labels[i]
            told = out.status is not Status.OK and any(name.endswith(part) for name in out.active)
            self._hold("status", told, f"{labels[i]} is active and not named")

    def _advanced(self, call: Call, before: Memory, after: Memory) -> None:
        controller, state = self.controller, self.controller.state
        dt = controller.dt
        self._hold("integral", 0.0 <= state.dt <= 2.0 * dt * (1.0 + 1e-9), f"a period of {state.dt:g} s")
        for name, loop in after.loops.items():
            was, now = before.loops.get(name), state.loops.get(name)
            if name in before.grips and before.grips[name].lost >= 0 > after.grips[name].lost:
                continue  # pressed on again: it begins with what presses
            if name in after.grips and after.grips[name].calm >= 0 and not loop.integral.any():
                continue  # nothing is kept of what a wrong sensor made
            if was is not None and now is not None and was.integral.shape == loop.integral.shape == now.error.shape:
                grown = np.abs(loop.integral - was.integral) - 2.0 * dt * np.abs(now.error) * (1.0 + 1e-9)
                rounding = 1e-12 * (1.0 + np.abs(loop.integral).max(initial=0.0))
                self._hold("integral", bool((grown <= rounding).all()), f"{name} by {grown.max():.3g} beyond it")
        if before.t is not None:
            expected = max(call.t, before.t)
            self._hold("clock", after.t == expected, f"{after.t!r} for {call.t!r} after {before.t!r}")
        wanted = dict(before.targets) | call.valid_targets(controller)
        self._hold("targets", dict(after.targets) == wanted, f"{dict(after.targets)} for {wanted}")

    def _held(self, call: Call, out: Output, before: Memory, after: Memory) -> None:
        controller, robot, wrenches = self.controller, self.controller.robot, self.known.wrenches
        for name in _KEPT:
            same = mark(getattr(before, name)) == mark(getattr(after, name))
            self._hold("refused", same, f"{name} changed in a tick without an answer")
        # what fails at a state that looks valid is held at the last one as well
        fell_back = not call.wrong and np.array_equal(after.q, before.q) and not np.array_equal(call.q, before.q)
        q, v = (before.q, None) if call.wrong or fell_back else (call.q, call.v)
        off = np.abs(after.q - q).max(initial=0.0)
        self._hold("hold", off <= 1e-12, f"at another q, off by {off:.3g}")
        if wrenches is None or after.t is None:
            return
        self._body.at(q, np.zeros(robot.nv))
        gravity, inertia = self._body.gravity(q), self._body.inertia.diagonal()[robot.base :]
        low, high, rate = self._limits[after.phase]
        step = rate * controller.dt
        # drag that is modelled follows the velocity; axes that belong to neither may have turned a little
        contacts = controller.phase.contacts
        drags = any(c.pushes is not None and c.pushes.modelled for c in contacts.values())
        found = []
        for stay in (False, True):  # axes of a contact are the frame's, or stay as they are in the world
            pull = np.zeros(robot.nv)
            for name in after.lam:
                if name in wrenches and name in contacts:
                    F, R = wrenches[name]
                    F = (F.reshape(2, 3) @ R.T @ self._body.axes(contacts[name])).ravel() if stay else F
                    pull += self._body.carried(contacts[name], F)
            load = (gravity + pull)[robot.base :]
            if out.status is Status.DEGRADED:
                tau = load + (before.tau - load) * (1.0 - 1.0 / (HOLD + 1 - self.known.bad))
            else:
                tau = load if v is None else load - DAMPING * inertia * v[robot.base :]
                if out.status is Status.STOPPED and controller.brakes:
                    tau = gravity[robot.base :] if robot.gravity == "robot" else np.zeros(robot.nu)
            tau = np.clip(tau, np.maximum(low, before.tau - step), np.minimum(high, before.tau + step))
            error = np.abs(tau - after.tau)
            allowed = 1e-6 + (0.5 if drags else 0.02) * np.abs(pull).max(initial=0.0)
            found.append((float((error - allowed).max()), robot.joints[int(error.argmax())], error.max()))
        beyond, joint, most = min(found)
        self._hold("hold", beyond <= 0.0, f"{out.status.name}: {joint} off by {most:.3g} N m")

    def _hold(self, invariant: str, holds: bool, told: str) -> None:
        self.checked[invariant] += 1
        if not holds:
            raise self._violated(invariant, told)

    def _violated(self, invariant: str, told: str) -> InvariantError:
        return InvariantError(invariant, self.tick, told, self.repeat)


def _wrenches(measured: Any) -> list[Any]:
    if not isinstance(measured, Mapping):
        return []
    return [wrench.F for wrench in measured.values() if isinstance(wrench, Wrench)]


def _shares(one: Array, other: Array) -> bool:
    return np.shares_memory(one, other)
