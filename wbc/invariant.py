"""What must hold at every tick, whatever goes wrong around the controller, held against it from outside.

Nothing here asks the controller whether it did well: residuals, the torque of an answer, the torque of a hold and the
ladder are worked out again from the tick's arguments, with numbers of their own where the controller has constants.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin

from .controller import Controller
from .errors import InvariantError
from .ladder import FOLLOWS, Status
from .memory import Memory, Output
from .qp import Array
from .robot import Robot
from .wrench import Wrench

# name -> what must hold
INVARIANTS = {
    "raises": "no exception leaves `step`",
    "status": "a named status; with a reason and a name for all that is not OK",
    "finite": "torque of the right shape, all of it finite",
    "limit": "torque within its limits, the part that the robot's driver adds included",
    "rate": "change of the torque within its rate limit",
    "transition": "a status that may follow the last one",
    "ladder": "5 bad ticks, then SAFE_HOLD; OK after 10 good ones; STOPPED after 20 missed or stale; up by reset alone",
    "certificate": "no torque is accepted but that of an answer whose residuals are within 1e-6",
    "dynamics": "the torque is that of the certified answer: M vdot + h + J'F = S'tau",
    "hold": "a held torque is g + J'F of the last wrenches, with what is left to decay, or damping",
    "refused": "what is not valid is refused, naming it, and changes nothing that is remembered",
    "targets": "a target stands until a valid one takes its place",
    "integral": "integrators take two periods at most",
    "clock": "the controller's time is the caller's and does not run backwards",
    "memory": "what is remembered, and what the caller owns, is not written to",
}
TOLERANCE, ROUNDING = 1e-6, 2e-15  # of the residuals; of a multiplier times a row
HOLD, GOOD, DEGRADED_AT, STOPPED_AT, DAMPING, UNIT = 5, 10, 3, 20, 10.0, 1e-3  # the ladder's numbers, as promised
_HELD = (Status.SAFE_HOLD, Status.STOPPED)
_KEPT = ("loops", "targets", "felt", "grounds", "starts", "phase", "watch", "t", "start", "followed", "grips")


class Known(NamedTuple):
    """What is known of the ticks before."""

    status: Status | None = None  # None: a reset came last
    bad: int = 0
    good: int = GOOD
    stale: int = 0
    wrenches: Mapping[str, Array] | None = None  # the last certified ones; None: there are none yet
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

    def step(
        self,
        t: Any,
        q: Any,
        v: Any,
        measured: Any = None,
        targets: Any = None,
        tau_applied: Any = None,
        missed: Any = 0,
    ) -> Output:
        """`Controller.step`. Raises InvariantError."""
        self.tick += 1
        controller, known = self.controller, self.known
        before = controller.memory
        owned = [(x, x.copy()) for x in (q, v, tau_applied, *_wrenches(measured)) if isinstance(x, np.ndarray)]
        if known.mark is not None:
            self._hold("memory", mark(before) == known.mark, "what was remembered has changed since the last tick")
        self.checked["raises"] += 1
        try:
            out = controller.step(t, q, v, measured, targets, tau_applied, missed)
        except Exception as error:
            raise self._violated("raises", f"{type(error).__name__}: {error}") from error
        after = controller.memory
        same = all(x.tobytes() == was.tobytes() for x, was in owned)
        self._hold("memory", same, "an argument was written to")
        shared = [
            x for x, _ in owned if after is not None for kept in (after.q, after.v, after.tau) if _shares(x, kept)
        ]
        self._hold("memory", not shared, "an argument's own storage is remembered")
        call = Call(t, q, v, measured, targets, tau_applied, missed, self._body)
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
        wrenches = {name: F.copy() for name, F in out.wrenches.items()} if certified else known.wrenches
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
        pull = np.zeros(robot.nv)
        for name in after.lam:
            if name in wrenches and name in controller.phase.contacts:
                pull += self._body.carried(controller.phase.contacts[name], wrenches[name])
        load = (self._body.gravity(q) + pull)[robot.base :]
        inertia = self._body.inertia.diagonal()[robot.base :]
        if out.status is Status.DEGRADED:
            tau = load + (before.tau - load) * (1.0 - 1.0 / (HOLD + 1 - self.known.bad))
        else:
            tau = load if v is None else load - DAMPING * inertia * v[robot.base :]
            if out.status is Status.STOPPED and controller.brakes:
                tau = self._body.gravity(q)[robot.base :] if robot.gravity == "robot" else np.zeros(robot.nu)
        low, high, rate = self._limits[after.phase]
        step = rate * controller.dt
        tau = np.clip(tau, np.maximum(low, before.tau - step), np.minimum(high, before.tau + step))
        error = np.abs(tau - after.tau)
        # axes of a contact may have turned since, and drag that is modelled follows the velocity
        drags = any(c.pushes is not None and c.pushes.modelled for c in controller.phase.contacts.values())
        allowed = 1e-6 + (0.5 if drags else 0.02) * np.abs(pull).max(initial=0.0)
        what = f"{robot.joints[int(error.argmax())]} off by {error.max():.3g} N m"
        self._hold("hold", bool((error <= allowed).all()), f"{out.status.name}: {what}")

    def _hold(self, invariant: str, holds: bool, told: str) -> None:
        self.checked[invariant] += 1
        if not holds:
            raise self._violated(invariant, told)

    def _violated(self, invariant: str, told: str) -> InvariantError:
        return InvariantError(invariant, self.tick, told, self.repeat)


class Call:
    """The arguments of a tick, judged: `wrong` says what of the state is not valid, "" if all is; `q`, `v`, `t` are
    those that hold then."""

    def __init__(
        self, t: Any, q: Any, v: Any, measured: Any, targets: Any, applied: Any, missed: Any, body: Body
    ) -> None:
        robot = body.robot
        self.t, self.q, self.v, self.measured, self.targets = t, q, v, measured, targets
        whole = isinstance(missed, (int, np.integer)) and missed >= 0
        self.missed, self._missed = (int(missed), True) if whole else (0, False)
        self.applied: Array | None
        self.applied, self._applied = (applied, True) if _sound(applied, robot.nu) else (None, applied is None)
        self.wrong = next((name for name, x, n in (("q", q, robot.nq), ("v", v, robot.nv)) if not _sound(x, n)), "")
        if not self.wrong:
            self.q = q.copy()
            for part in robot.unit_parts:
                norm = float(np.linalg.norm(q[part]))
                if not abs(norm - 1.0) <= UNIT:
                    self.wrong = f"q, with a norm of {norm:g}"
                    break
                self.q[part] /= norm
        if not self.wrong and not (isinstance(t, (int, float)) and math.isfinite(t)):
            self.wrong = "t"

    def refused(self, controller: Controller) -> list[str]:
        """The fields, other than of the state, that are not valid."""
        found = [] if self._missed else ["missed"]
        found += [] if self._applied else ["tau_applied"]
        for name, given in (("measured", self.measured), ("targets", self.targets)):
            if given is not None and not isinstance(given, Mapping):
                found.append(name)
        frames = controller.robot.frames
        for name, wrench in self.measured.items() if isinstance(self.measured, Mapping) else ():
            felt = any(name in phase.feeling for phase in controller.phases)
            good = isinstance(wrench, Wrench) and _sound(wrench.F, 6) and wrench.frame in frames
            if not (felt and good):
                found.append(f"measured.{name}" if felt else "measured")
        good_ones = self.valid_targets(controller)
        given = self.targets if isinstance(self.targets, Mapping) else {}
        return found + [f"targets.{name}" for name in given if name not in good_ones]

    def valid_targets(self, controller: Controller) -> dict[str, float]:
        known = {f"{name}.{axis}" for p in controller.phases for name, c in p.contacts.items() for axis in c.axes}
        given = self.targets if isinstance(self.targets, Mapping) else {}
        return {
            name: float(value)
            for name, value in given.items()
            if name in known and isinstance(value, (int, float)) and math.isfinite(value)
        }


class Body:
    """Pinocchio's storage of its own for a robot: its equations of motion, apart from the controller's."""

    def __init__(self, robot: Robot) -> None:
        self.robot, self.data = robot, robot.model.createData()
        self.inertia = np.zeros((robot.nv, robot.nv))

    def at(self, q: Array, v: Array) -> Array:
        """h (nv,) [N m], of a state that from now on is the one."""
        model, data = self.robot.model, self.data
        M = np.triu(pin.crba(model, data, q))
        self.inertia = M + np.triu(M, 1).T
        h = np.array(pin.nonLinearEffects(model, data, q, v))
        pin.computeJointJacobians(model, data, q)
        pin.updateFramePlacements(model, data)
        return h if self.robot.damping is None else h + self.robot.damping * v

    def torque(self, q: Array, v: Array, vdot: Array) -> Array:
        """(nv,) M vdot + h [N m]."""
        h = self.at(q, v)
        return self.inertia.dot(vdot) + h

    def gravity(self, q: Array) -> Array:
        return np.array(pin.computeGeneralizedGravity(self.robot.model, self.data, q))

    def carried(self, contact: Any, F: Array) -> Array:
        """(nv,) J' F of a wrench on what the contact is with, and of its reaction where that is a body of the robot."""
        here = self.robot.frame_id(contact.frame)
        tau = self._pulled(here, pin.Force(F[3:], F[:3]))
        if contact.against is None:
            return tau
        there = self.robot.frame_id(contact.against)
        T = self.data.oMf[there].actInv(self.data.oMf[here])
        return tau - self._pulled(there, T.act(pin.Force(F[3:], F[:3])))

    def _pulled(self, frame: int, force: Any) -> Array:
        J = pin.getFrameJacobian(self.robot.model, self.data, frame, pin.ReferenceFrame.LOCAL)
        return np.asarray(J.T.dot(force.vector))


def certificate(problem: Any, x: Array, z: Array) -> tuple[float, float, float]:
    """Primal, dual and gap residuals of `qp.Certificate`, in plain numpy."""
    H, g, C, lo, hi, n_eq, _ = problem
    n = g.size
    if x.shape != g.shape or z.shape != lo.shape:
        return math.inf, math.inf, math.inf
    value = np.concatenate((x, C @ x))
    outside = np.maximum(value - hi, 0.0) + np.maximum(lo - value, 0.0)
    dual = H @ x + g + z[:n] + C.T @ z[n:]
    free = np.ones(lo.size, bool)
    free[n : n + n_eq] = False
    up, down = free & (z > 0.0), free & (z < 0.0)
    gaps = np.concatenate((z[up] * (hi - value)[up], z[down] * (lo - value)[down], [0.0]))
    return float(np.linalg.norm(outside)), float(np.linalg.norm(dual)), float(np.abs(gaps).max())


def mark(value: Any) -> Any:
    """What tells two values apart to the last bit, however they are nested."""
    if isinstance(value, np.ndarray):
        return value.tobytes(), value.shape
    if isinstance(value, pin.SE3):
        return value.homogeneous.tobytes()
    if isinstance(value, Mapping):
        return tuple((name, mark(each)) for name, each in value.items())
    if isinstance(value, tuple | list):
        return tuple(map(mark, value))
    if is_dataclass(value) and not isinstance(value, type):
        return tuple(mark(getattr(value, each.name)) for each in fields(value))
    if isinstance(value, float):
        return value.hex()
    return value if isinstance(value, str | int | bool | None | Status) else id(value)


def _sound(x: Any, n: int) -> bool:
    """Whether it is a finite float64 array of n numbers, in one piece and writeable."""
    if not isinstance(x, np.ndarray) or x.dtype != np.float64 or not x.dtype.isnative or x.shape != (n,):
        return False
    # whose square is no number is as good as none
    return x.flags.c_contiguous and x.flags.aligned and x.flags.writeable and bool((np.abs(x) < 1e150).all())


def _wrenches(measured: Any) -> list[Any]:
    if not isinstance(measured, Mapping):
        return []
    return [wrench.F for wrench in measured.values() if isinstance(wrench, Wrench)]


def _shares(one: Array, other: Array) -> bool:
    return np.shares_memory(one, other)
