"""What a tick answers without a certified answer: the last torque whose load stays, then the safe hold."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from .grounds import levels
from .ladder import HOLD_DAMPING, HOLD_TICKS, Status, decayed
from .memory import Memory, Output
from .phase import hold
from .program import Program
from .qp import UNCERTIFIED, Array
from .robot import Robot
from .state import State, Terms
from .task.force import ForceLoop

HELD = (Status.SAFE_HOLD, Status.STOPPED)
_NEW_LOOP = ForceLoop()


class Answer(NamedTuple):
    """The answer of such a tick, what is remembered of it, and the state at which the torque was made."""

    output: Output
    memory: Memory
    state: State


class Holding:
    """Makes these answers of what a controller remembers.

    Parameters: the robot and its terms, the programs of the phases, the period `dt` [s], whether the robot has brakes.
    """

    def __init__(self, robot: Robot, terms: Terms, programs: Sequence[Program], dt: float, brakes: bool) -> None:
        self._robot, self._terms, self._programs, self._dt, self._brakes = robot, terms, programs, dt, brakes

    def unknown(self, reason: str) -> Output:
        """Before anything is known of the robot nothing is asked of it."""
        nothing, still = np.zeros(self._robot.nu), np.zeros(self._robot.nv)
        return Output(nothing, still, {}, (), Status.DEGRADED, f"not started: {reason}", UNCERTIFIED)

    def degraded(self, memory: Memory, reason: str, state: State | None = None) -> Answer:
        """The last torque, of which all but the load decays, for a few ticks; then the safe hold. `state`: of this
        tick, where it is valid."""
        q, v = (memory.q, None) if state is None else (state.q, state.v)
        bad = memory.bad + 1
        if memory.status in HELD or bad > HOLD_TICKS:
            return self.safe(memory, q, v, memory.status if memory.status in HELD else Status.SAFE_HOLD, reason)
        state, load, _, gravity = self._load(memory, q, v)
        memory = memory._replace(status=Status.DEGRADED, bad=bad, good=0)
        return self._answer(memory, state, decayed(memory.tau, load, bad), gravity, v, reason)

    def safe(self, memory: Memory, q: Array, v: Array | None, status: Status, reason: str = "") -> Answer:
        """g(q) + J' F with the last certified wrenches, plus damping, in limit and rate; `v` None: not known now.

        A velocity of the past damps nothing: it would push on until the robot runs the other way.
        """
        state, load, inertia, gravity = self._load(memory, q, v)
        tau = load
        if status is Status.STOPPED and self._brakes:
            tau = gravity if self._robot.gravity == "robot" else np.zeros(load.size)
        elif v is not None:
            tau = load - HOLD_DAMPING * inertia * v[self._robot.base :]
        memory = memory._replace(status=status, good=0)
        return self._answer(memory, state, tau, gravity, v, reason or memory.why or "held until reset")

    def _load(self, memory: Memory, q: Array, v: Array | None) -> tuple[State, Array, Array, Array]:
        """The state at q, and (nu,) each: the torque that carries the weight and the last certified wrenches there, the
        diagonal of M, and g(q)."""
        base, program = self._robot.base, self._programs[memory.phase]
        t = 0.0 if memory.t is None else memory.t - memory.start
        state = State(self._terms, q, memory.v if v is None else v, t, self._dt)
        state.starts, state.grounds = program.named(memory.starts), levels(program.phase, memory.grounds)
        state.targets = memory.targets  # type: ignore[assignment]
        state.loops = {name: memory.loops.get(name, _NEW_LOOP) for name in program.phase.contacts}
        tau = gravity = state.gravity()
        inertia = state.M.diagonal()[base:].copy()
        try:
            hold(state, program.phase)
            if memory.t is None:  # no wrench has been certified yet
                return state, program.rest(state), inertia, gravity[base:].copy()
            for name, lam in memory.lam.items():
                if name in state.contacts:
                    tau = tau + state.contacts[name].push.T @ lam
        except Exception:  # a contact of one's own that fails where it did not before
            return state, memory.tau, inertia, gravity[base:].copy()
        return state, tau[base:], inertia, gravity[base:].copy()

    def _answer(self, memory: Memory, state: State, tau: Array, gravity: Array, v: Array | None, reason: str) -> Answer:
        """A torque that no answer stands behind, led into the limits and their rate."""
        limit = self._programs[memory.phase].phase.torque
        low, high = limit.bounds(memory.tau, self._dt)
        tau = np.minimum(np.maximum(np.where(np.isfinite(tau), tau, memory.tau), low), high)
        v = memory.v if v is None else v.copy()
        memory = memory._replace(tau=tau, gravity=gravity, q=state.q.copy(), v=v)
        sent = tau - gravity if self._robot.gravity == "robot" else tau.copy()
        out = Output(sent, np.zeros(self._robot.nv), {}, (), memory.status, reason, UNCERTIFIED)
        return Answer(out, memory, state)
