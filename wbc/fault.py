"""A fault plan carried out: simulator, sensor, solver and state fail when the spec says so, the same for one seed.

Only the simulated loop knows of it; the controller is told nothing but what it would be told of the real fault.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from .controller import Controller
from .qp import Array, Problem
from .sim import Observation, Simulator
from .solver import Solver
from .spec.fault import PlannedFault, planned
from .wall import Wall
from .wrench import Wrench

Measured = dict[str, Wrench]
_TURN = np.eye(3)[[1, 2, 0]]


class FaultPlan:
    """The faults of a run, `texts` as in `spec.fault`. `begin` is told every tick, before the simulator is observed.

    `pressed`: frames of the contacts that press, whose walls may be taken away.
    """

    def __init__(self, texts: Sequence[str], dt: float, seed: int, pressed: Sequence[str] = ()) -> None:
        self._planned: list[tuple[PlannedFault, int, float]] = []
        for text in texts:
            fault = planned(text)
            self._planned.append((fault, *fault.window(dt)))
        self._rng, self._dt = np.random.default_rng((seed, 0xFA)), dt
        self.now: dict[str, PlannedFault] = {}
        self._since: dict[str, float] = {}
        self._t, self.late = 0.0, False
        self.missed = 0  # ticks in a row, so far
        self._resume = -1
        self._pressed = pressed
        self._wall: Wall | None = None

    def begin(self, tick: int, simulator: Simulator) -> None:
        """Which faults act at this tick; the simulator's own are done to it now."""
        self.now = {}
        for fault, first, stop in self._planned:
            if first <= tick < stop:
                self.now[fault.kind] = fault
                self._since[fault.kind] = (tick - first) * self._dt
                if fault.kind == "simulator.missed" and tick == first:
                    self._resume = tick + round(fault.value)
        if "simulator.nan" in self.now:
            simulator.spoil(int(self._rng.integers(simulator.robot.nu)))
        if "simulator.reset" in self.now:
            simulator.restart()
        self._take_away(simulator)
        self.late = tick < self._resume
        self.missed = self.missed + 1 if self.late else self.missed

    def _take_away(self, simulator: Simulator) -> None:
        """The wall that the robot presses on; one that is not touched yet, as soon as it is."""
        lost, away = "contact.lost" in self.now, self.now.get("contact.away")
        if not lost and away is None:
            if self._wall is not None:
                self._wall.restore()
                self._wall = None
            return
        if not self._wall:
            self._wall = Wall(simulator, self._pressed)
        if lost:
            self._wall.remove()
        if away is not None:
            self._wall.shift(away.value * (self._since[away.kind] + self._dt))

    def told(self) -> int:
        """How many ticks the controller was not asked for since it last was."""
        missed, self.missed = self.missed, 0
        return missed

    def seen(self, true: Observation, robot: Any) -> Observation:
        """What the controller is shown instead."""
        t, q, v = true
        if "state.repeated" in self.now:
            t = self._t
        else:
            self._t = t
        if fault := self.now.get("state.time"):
            t = t + fault.value
        if "state.nan" in self.now:
            x = np.concatenate((q, v))
            x[self._rng.integers(x.size)] = math.nan
            q, v = x[: q.size].copy(), x[q.size :].copy()
        if fault := self.now.get("state.quaternion"):
            q = q.copy()
            for part in robot.unit_parts:
                q[part] *= fault.value
        if "state.shape" in self.now:
            q = q[:-1].copy()
        return Observation(t, q, v)

    def measured(self, given: Measured | None) -> Measured | None:
        """What the sensors say instead; wrenches are (m, f)."""
        if not given or not any(kind.startswith("sensor.") for kind in self.now):
            return given
        if "sensor.dropout" in self.now:
            return None
        wrong = {id(wrench): Wrench(self._misread(wrench.F.copy()), wrench.frame) for wrench in given.values()}
        return {name: wrong[id(wrench)] for name, wrench in given.items()}

    def _misread(self, F: Array) -> Array:
        if "sensor.frame" in self.now:
            F = np.concatenate((_TURN @ F[:3], _TURN @ F[3:]))
        if "sensor.sign" in self.now:
            F = -F
        if fault := self.now.get("sensor.bias"):
            F[3:] += fault.value
        if fault := self.now.get("sensor.drift"):
            F[3:] += fault.value * self._since[fault.kind]
        if fault := self.now.get("sensor.spikes"):
            axis, size, hit = self._rng.integers(3), self._rng.uniform(-1.0, 1.0), self._rng.random()
            F[3 + axis] += fault.value * size if hit < 0.1 else 0.0
        if fault := self.now.get("sensor.saturation"):
            F[3:] = np.clip(F[3:], -fault.value, fault.value)
        if "sensor.nan" in self.now:
            F[self._rng.integers(6)] = math.nan
        return F

    # --- the solver ---

    def spoil(self, controller: Controller) -> None:
        """Have the controller's solvers fail as planned; `mend` undoes it."""
        if any(fault.kind.startswith("solver.") for fault, _, _ in self._planned):
            controller.solvers = (self._unreliable(controller.solvers[0]), self._unreliable(controller.solvers[1]))

    def mend(self, controller: Controller) -> None:
        first, second = controller.solvers
        controller.solvers = (getattr(first, "inner", first), getattr(second, "inner", second))

    def _unreliable(self, solver: Solver) -> Solver:
        return Unreliable(solver, self, self._rng)


class Unreliable:
    """A solver that raises or lies while its plan says so."""

    def __init__(self, inner: Solver, plan: FaultPlan, rng: np.random.Generator) -> None:
        self.inner, self._plan, self._rng = inner, plan, rng
        self._last: tuple[Array, Array] | None = None

    def restart(self) -> None:
        """Whatever it remembers is forgotten; its faults are not."""
        getattr(self.inner, "restart", lambda: None)()

    def solve(self, problem: Problem) -> tuple[Array, Array]:
        now = self._plan.now
        if "solver.fail" in now:
            raise RuntimeError("failed as planned")
        if "solver.stale" in now and self._last is not None and self._last[0].size == problem.g.size:
            return self._last
        x, z = self.inner.solve(problem)
        self._last = (x.copy(), z.copy())
        if fault := now.get("solver.x"):
            x = x.copy()
            x[self._rng.integers(x.size)] += fault.value
        if fault := now.get("solver.leans"):
            x, z = leaning(problem, x, z, fault.value, self._rng)
        if "solver.nan" in now:
            x = x.copy()
            x[self._rng.integers(x.size)] = math.nan
        if "solver.shape" in now:
            x = x[:-1]
        return x, -z if "solver.signs" in now else z


def leaning(problem: Problem, x: Array, z: Array, force: float, rng: np.random.Generator) -> tuple[Array, Array]:
    """A lie that only the gap gives away: (x, z) with a multiplier of that size on a limit that does not bind.

    All other conditions still hold: H dx + E' dz + c force = 0 and E dx = 0, with E the equalities and what binds.
    """
    n, first = x.size, x.size + problem.n_eq
    rows = np.concatenate((np.eye(n), problem.C))
    inner = np.ones(z.size, bool)
    inner[n:first] = False
    room = np.minimum(rows @ x - problem.lo, problem.hi - rows @ x)
    loose = np.flatnonzero(inner & (np.abs(z) < 1e-9) & np.isfinite(room) & (room > 1e-3))
    if not loose.size:
        return x, z
    i = int(loose[rng.integers(loose.size)])
    push = force if np.isfinite(problem.hi[i]) else -force
    bound = np.flatnonzero(~inner | (np.abs(z) >= 1e-9))
    E = rows[bound]
    kkt = np.block([[problem.H, E.T], [E, np.zeros((bound.size, bound.size))]])
    answer = np.linalg.lstsq(kkt, np.concatenate((-push * rows[i], np.zeros(bound.size))), rcond=None)[0]
    z = z.copy()
    z[bound] += answer[n:]
    z[i] = push
    return x + answer[:n], z
