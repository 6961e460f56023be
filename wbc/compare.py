"""Solvers side by side on the quadratic programs that runs of specs meet; the certificate and the clock decide.

Every solver answers as it would in the controller, warm from the problem before. The solvers take turns, a block of
problems each and in an order that rotates, so that what else the machine does falls on all of them alike. The time is
that of `solve` alone, of both attempts where a refused answer was asked for again.

A torque is held against the best answer known: among the certified ones and their polished version (the same active
constraints, their KKT system solved directly) the one with the lowest residual.
"""

from __future__ import annotations

import gc
import math
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from .controller import Output, Status
from .errors import ProblemError, SolverError
from .qp import Array, Problem, certify
from .solver import TOLERANCE, Solution, Solver, answer, installed, make

if TYPE_CHECKING:
    from rich.table import Table

    from .build import Built

_BLOCK = 10  # problems in a row: as in a control loop, a solver finds some of its code in the cache
_FATES = ("solved", "wrong", "refused")

Progress = Callable[[int], None]


class Recorded(NamedTuple):
    """A problem met at time `t` [s] of a run, and the torque of its answer, tau = T x + h [N m]; all by value."""

    problem: Problem
    T: Array  # (nv, n)
    h: Array  # (nv,)
    t: float
    spec: str
    active: tuple[str, ...]  # limits that were active

    def torque(self, x: Array) -> Array:
        """(nv,) [N m]"""
        tau: Array = self.T.dot(x) + self.h
        return tau


def record(built: Built, every: int | None = None, most: int = 200, progress: Progress | None = None) -> list[Recorded]:
    """Simulate a built spec and keep problems that it meets, in order of time.

    Half of at most `most` are spread evenly over the run (`every` n ticks, or more), half over the ticks at which
    a limit is active. `progress` is told the number of ticks done. Raises ProblemError for strict priorities.
    """
    from .run import run

    if built.spec.hierarchy == "strict":
        raise ProblemError("strict levels are several problems a tick; expected hierarchy: weighted")
    controller, half = built.controller, max(1, most // 2)
    every = max(every or 1, math.ceil(built.spec.duration * built.spec.rate / half))
    even, limited = _Spread(every, half), _Spread(1, half)

    def keep(seen: Any, out: Output) -> None:
        workspace = controller.workspace
        if out.status in (Status.SAFE_HOLD, Status.STOPPED) or workspace.fault():
            return  # no problem of this tick

        def met() -> Recorded:
            T = workspace.product("torque", np.eye(workspace.variables.size))
            h, name = controller.state.bias[built.robot.base :].copy(), Path(built.spec.file).stem
            return Recorded(workspace.problem.copy(), T, h, seen.t, name, out.active)

        if not even.offer(met) and out.active:
            limited.offer(met)

    run(built, progress=progress, hook=keep)
    return sorted(even.kept + limited.kept, key=lambda item: item.t)


class _Spread:
    """At most `most` of what is offered, evenly spread however long the offers go on: when full, every second goes."""

    def __init__(self, stride: int, most: int) -> None:
        self._stride, self._most, self._offered = stride, most, 0
        self.kept: list[Recorded] = []

    def offer(self, made: Callable[[], Recorded]) -> bool:
        """Whether it was kept."""
        taken = self._offered % self._stride == 0
        self._offered += 1
        if taken:
            self.kept.append(made())
            if len(self.kept) > self._most:
                del self.kept[1::2]
                self._stride *= 2
        return taken


def compare(
    recorded: Sequence[Recorded],
    solvers: Sequence[str | Solver] | Mapping[str, str | Solver] | None = None,
    passes: int = 3,
    progress: Progress | None = None,
) -> dict[str, Any]:
    """Give every problem to every solver: names, objects with `solve(problem)`, or a mapping; default all installed.

    Answers `{"problems", "tau_max", "solvers": {name: {"solved", "wrong", "refused", "retried", "max_tau_error",
    "max_kkt_residual", "us": {"p50", "p99", "max"}}}}`. Each problem is one of: solved, certified in every pass;
    wrong, answered as if solved, but not certified; refused, by the solver's own word. `retried` had a second attempt
    from cold. `max_tau_error` [N m], against torques of at most `tau_max`, and the KKT residual are the worst over all
    answers, certified or not; None where there is none, or it is not finite.

    Raises ProblemError without problems, SolverError without solvers and for one that does not exist.
    """
    if not recorded:
        raise ProblemError("no problems to compare solvers on")
    tallies = {name: _Tally(make(solver), len(recorded)) for name, solver in _named(solvers).items()}
    if not tallies:
        raise SolverError("no solvers to compare")
    order, tau_max = list(tallies), 0.0
    for tally in tallies.values():
        tally.ask(recorded[0].problem)  # imports and allocates: not what is measured
        tally.us.clear()
    with _frozen():
        for turn, start in product(range(passes), range(0, len(recorded), _BLOCK)):
            block = recorded[start : start + _BLOCK]
            answers = {name: [tallies[name].ask(item.problem) for item in block] for name in order}
            for i, item in enumerate(block):
                best = _best(item.problem, [answers[name][i].solution for name in order])
                tau = None if best is None else item.torque(best)
                for name in order:
                    tallies[name].judge(start + i, answers[name][i], item, tau)
                tau_max = max(tau_max, 0.0 if tau is None else float(np.abs(tau).max()))
            order = order[1:] + order[:1]
            if progress is not None and turn == passes - 1:
                progress(start + len(block))
    told = {name: tally.told() for name, tally in tallies.items()}
    return {"problems": len(recorded), "tau_max": tau_max, "solvers": told}


def _named(solvers: Sequence[str | Solver] | Mapping[str, str | Solver] | None) -> dict[str, str | Solver]:
    if isinstance(solvers, Mapping):
        return dict(solvers)
    named: dict[str, str | Solver] = {}
    for solver in installed() if solvers is None else solvers:
        name = label = solver if isinstance(solver, str) else type(solver).__name__
        while name in named and not isinstance(solver, str):
            name = f"{label} {2 if name == label else int(name.rsplit(' ', 1)[1]) + 1}"
        named[name] = solver
    return named


@contextmanager
def _frozen() -> Iterator[None]:
    """What exists stays: the collector need not look at it while a clock runs."""
    gc.collect()
    gc.freeze()
    try:
        yield
    finally:
        gc.unfreeze()


class _Asked(NamedTuple):
    solution: Solution
    claimed: bool  # the solver answered, in its last attempt, and did not raise
    attempts: int


class _Tally:
    """One solver with a clock, and what became of its answers."""

    def __init__(self, solver: Solver, problems: int) -> None:
        self._solver = solver
        restart = getattr(solver, "restart", None)
        if restart is not None:
            self.restart = restart
        self._fate, self._retried = ["solved"] * problems, [False] * problems
        self._tau_error: list[float] = []
        self._residual: list[float] = []
        self.us: list[float] = []

    def ask(self, problem: Problem) -> _Asked:
        """As the controller asks, with the clock running."""
        self._seconds, self._attempts, self._claimed = 0.0, 0, False
        solution = answer(self, problem)
        self.us.append(1e6 * self._seconds)
        return _Asked(solution, self._claimed, self._attempts)

    def solve(self, problem: Problem) -> tuple[Array, Array]:
        self._claimed, self._attempts = False, self._attempts + 1
        began = time.perf_counter()
        try:
            found = self._solver.solve(problem)
        finally:
            self._seconds += time.perf_counter() - began
        self._claimed = True
        return found

    def judge(self, i: int, asked: _Asked, item: Recorded, tau: Array | None) -> None:
        """Count the answer to problem i; the worst of its passes stands."""
        x, _, certificate, accepted, _ = asked.solution
        self._retried[i] |= asked.attempts > 1
        if not accepted and self._fate[i] != "wrong":
            self._fate[i] = "wrong" if asked.claimed else "refused"
        if asked.claimed:
            self._residual.append(float(np.max(certificate)))
            if tau is not None:
                fits = x.shape == item.problem.g.shape
                self._tau_error.append(float(np.abs(item.torque(x) - tau).max()) if fits else math.nan)

    def told(self) -> dict[str, Any]:
        p50, p99, worst = np.percentile(self.us, [50, 99, 100]).tolist()
        return {fate: self._fate.count(fate) for fate in _FATES} | {
            "retried": sum(self._retried),
            "max_tau_error": _worst(self._tau_error),
            "max_kkt_residual": _worst(self._residual),
            "us": {"p50": p50, "p99": p99, "max": worst},
        }


def _worst(values: list[float]) -> float | None:
    """The largest; None without values, and where one is not finite (JSON has no word for it)."""
    worst = float(np.max(values)) if values else math.nan
    return worst if math.isfinite(worst) else None


def _best(problem: Problem, solutions: list[Solution]) -> Array | None:
    """x of the lowest residual among the certified answers and the polished best of them."""
    certified = [solution for solution in solutions if solution.accepted]
    if not certified:
        return None
    best = min(certified, key=lambda solution: max(solution.certificate))
    x, z = _polished(problem, best.z)
    polished = certify(problem, x, z)
    return x if polished.holds(TOLERANCE) and max(polished) < max(best.certificate) else best.x


def _polished(problem: Problem, z: Array, least: float = 1e-9) -> tuple[Array, Array]:
    """The answer whose active constraints are those of `z`, with one step of iterative refinement."""
    H, g, C, lo, hi, n_eq, _ = problem
    n = g.size
    active = np.abs(z) > least
    active[n : n + n_eq] = True
    G = np.concatenate((np.eye(n), C))[active]
    K = np.block([[H, G.T], [G, np.zeros((len(G), len(G)))]])
    rhs = np.concatenate((-g, np.where(z > 0.0, hi, lo)[active]))
    solution = np.linalg.lstsq(K, rhs)[0]
    solution += np.linalg.lstsq(K, rhs - K @ solution)[0]
    multipliers = np.zeros(lo.size)
    multipliers[active] = solution[n:]
    return solution[:n], multipliers


def table(result: Mapping[str, Any]) -> Table:
    """What `compare` answers, for a terminal."""
    from rich.table import Table

    shown = Table("solver", title=f"{result['problems']} quadratic programs, torques up to {result['tau_max']:.3g} N m")
    for heading in (*_FATES, "retried", "torque error [N m]", "KKT residual", "p50 [us]", "p99", "max"):
        shown.add_column(heading, justify="right")
    for name, row in result["solvers"].items():
        counts = [str(row[fate]) if fate == "solved" or not row[fate] else f"[red]{row[fate]}[/]" for fate in _FATES]
        errors = ["-" if row[key] is None else f"{row[key]:.0e}" for key in ("max_tau_error", "max_kkt_residual")]
        times = [f"{us:.0f}" for us in row["us"].values()]
        shown.add_row(name, *counts, str(row["retried"]), *errors, *times)
    return shown
