"""Every solver asked for the answer to every problem, and what became of the answers.

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
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from itertools import product
from typing import Any, NamedTuple

import numpy as np

from ..errors import ProblemError, SolverError
from ..qp import Array, Problem, certify
from ..solver import Solution, Solver, answer, installed, make, tuned
from .bound import Bound
from .record import INFEASIBLE, Progress, Recorded

_BLOCK = 10  # problems in a row: as in a control loop, a solver finds some of its code in the cache
_FATES = ("solved", "wrong", "refused")
_CERTIFIED = ("tau_error", "primal", "dual", "gap")
RATIOS = np.logspace(0.0, 3.0, 31).round(3)  # to the fastest solver, at which a performance profile is told

AGREES = 1e-6  # [N m] what certified torques may always differ by from the best answer


def offered() -> list[str]:
    """Names of all solvers that are installed, tuned as the controller has them and as they come (`(default)`), and
    DAQP without the minimiser that is tried first (`(plain)`)."""
    names = []
    for name in installed():
        names.append(name)
        if name == "daqp":
            names.append("daqp (plain)")
        if name in tuned():
            names.append(f"{name} (default)")
    return names


def compare(
    recorded: Sequence[Recorded],
    solvers: Sequence[str | Solver] | Mapping[str, str | Solver] | None = None,
    passes: int = 3,
    progress: Progress | None = None,
) -> dict[str, Any]:
    """Give every problem to every solver: names, objects with `solve(problem)`, or a mapping; default all `offered`.

    Answers `{"problems", "infeasible", "tau_max", "ok", "solvers": {name: {"solved", "wrong", "refused", "retried",
    "max_tau_error", "max_kkt_residual", "us": {"p50", "p99", "max"}, ...}}}`. Each problem is one of: solved, certified
    in every pass; wrong, answered as if solved, but not certified; refused, by the solver's own word. `retried` had a
    second attempt from cold. `max_tau_error` [N m], against torques of at most `tau_max`, and the KKT residual are the
    worst over all answers, certified or not; None where there is none, or it is not finite.

    Of every solver also: `certified`, the worst of certified answers alone, `{"tau_error", "primal", "dual", "gap"}`;
    `accepted_wrong`, problems with a certified answer that is wrong (`ok`: no solver has any): of a problem that is
    infeasible, or farther from the best one than 1e-6 N m and all that its residuals leave open (`bound.Bound`);
    `tolerance` [N m], what they allowed at the worst error; `kinds`, the fates of each kind of problem; `growth`,
    the median [us] of feasible ones by number of unknowns; `profile`, the share of feasible problems that it solves
    within each of `ratios` times the time of the fastest (Dolan and More, 2002).

    Raises ProblemError without problems, SolverError without solvers and for one that does not exist.
    """
    if not recorded:
        raise ProblemError("no problems to compare solvers on")
    tallies = {name: _Tally(make(solver), len(recorded)) for name, solver in _named(solvers).items()}
    if not tallies:
        raise SolverError("no solvers to compare")
    order, tau_max, bounds = list(tallies), 0.0, dict[int, Known]()
    for tally in tallies.values():
        tally.ask(recorded[0].problem)  # imports and allocates: not what is measured
    with _frozen():
        for turn, start in product(range(passes), range(0, len(recorded), _BLOCK)):
            block = recorded[start : start + _BLOCK]
            answers = {name: [tallies[name].ask(item.problem) for item in block] for name in order}
            for i, item in enumerate(block):
                known = bounds[start + i] = bounds.get(start + i) or Known(item)
                known.learn([answers[name][i].solution for name in order])
                for name in order:
                    tallies[name].judge(start + i, answers[name][i], known)
                tau_max = max(tau_max, 0.0 if known.tau is None else float(np.abs(known.tau).max()))
            order = order[1:] + order[:1]
            if progress is not None and turn == passes - 1:
                progress(start + len(block))
    times = {name: tally.times() for name, tally in tallies.items()}
    fastest = np.min(list(times.values()), axis=0)
    told = {name: tally.told(recorded) for name, tally in tallies.items()}
    feasible = np.array([item.kind != INFEASIBLE for item in recorded])
    for name, row in told.items():
        row["profile"] = _profile(times[name][feasible], fastest[feasible])
    return {
        "problems": len(recorded), "infeasible": int((~feasible).sum()), "tau_max": tau_max,
        "ok": not any(row["accepted_wrong"] for row in told.values()), "ratios": RATIOS.tolist(), "solvers": told,
    }  # fmt: skip


def _profile(times: Array, fastest: Array) -> list[float]:
    """Share of problems solved within each of `RATIOS` times the fastest; what is not solved took for ever."""
    solved = np.isfinite(times)
    ratio = np.full(times.size, np.inf)
    ratio[solved] = times[solved] / fastest[solved]
    return [float((ratio <= most).mean()) if times.size else 0.0 for most in RATIOS * (1.0 + 1e-12)]


def _named(solvers: Sequence[str | Solver] | Mapping[str, str | Solver] | None) -> dict[str, str | Solver]:
    if isinstance(solvers, Mapping):
        return dict(solvers)
    named: dict[str, str | Solver] = {}
    for solver in offered() if solvers is None else solvers:
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
    claimed: bool  # the solver answered, in its last attempt, and did not say that it failed
    attempts: int
    us: float  # of all attempts


class _Tally:
    """One solver with a clock, and what became of its answers."""

    def __init__(self, solver: Solver, problems: int) -> None:
        self._solver = solver
        restart = getattr(solver, "restart", None)
        if restart is not None:
            self.restart = restart
        self._fate, self._retried, self._deceived = ["solved"] * problems, [False] * problems, [False] * problems
        self._tau_error, self._residual = [list[float]() for _ in range(problems)], list[float]()
        self._certified: list[tuple[float, ...]] = []  # torque error, allowed, primal, dual, gap
        self._times = [list[float]() for _ in range(problems)]  # [us]

    def ask(self, problem: Problem) -> _Asked:
        """As the controller asks, with the clock running."""
        self._seconds, self._attempts, self._claimed = 0.0, 0, False
        solution = answer(self, problem)
        return _Asked(solution, self._claimed, self._attempts, 1e6 * self._seconds)

    def solve(self, problem: Problem) -> tuple[Array, Array]:
        self._claimed, self._attempts = False, self._attempts + 1
        began = time.perf_counter()
        try:
            found = self._solver.solve(problem)
        finally:
            self._seconds += time.perf_counter() - began
        self._claimed = bool(getattr(self._solver, "claims", True))
        return found

    def judge(self, i: int, asked: _Asked, known: Known) -> None:
        """Count the answer to problem i; the worst of its passes stands."""
        x, z, certificate, accepted, _ = asked.solution
        self._retried[i] |= asked.attempts > 1
        self._times[i].append(asked.us)
        if not accepted and self._fate[i] != "wrong":
            self._fate[i] = "wrong" if asked.claimed else "refused"
        error = known.error(x)
        if asked.claimed or accepted:
            self._residual.append(float(np.max(certificate)))
            if known.tau is not None:
                self._tau_error[i].append(error)
        if accepted:
            allowed = AGREES if error <= AGREES else max(AGREES, known.allowed(x, z))
            self._certified.append((error, allowed, *certificate))
            self._deceived[i] |= known.infeasible or not error <= allowed

    def times(self) -> Array:
        """(problems,) [us] the least of the passes; infinite where it is not solved."""
        solved = [fate == "solved" for fate in self._fate]
        return np.where(solved, [min(us) for us in self._times], np.inf)

    def told(self, recorded: Sequence[Recorded]) -> dict[str, Any]:
        certified = np.max([each[:1] + each[2:] for each in self._certified], axis=0) if self._certified else None
        return self._counts(range(len(recorded))) | {
            "retried": sum(self._retried),
            "max_kkt_residual": _worst(self._residual),
            "us": dict(zip(("p50", "p99", "max"), self._percentiles(range(len(recorded))), strict=True)),
            "tolerance": max(self._certified)[1] if self._certified else AGREES,
            "accepted_wrong": sum(self._deceived),
            "certified": dict(zip(_CERTIFIED, [None] * 4 if certified is None else certified.tolist(), strict=True)),
            "kinds": {kind: {"problems": len(of)} | self._counts(of) for kind, of in _by([r.kind for r in recorded])},
            "growth": {str(n): self._percentiles(of)[0] for n, of in sorted(_by([r.problem.g.size for r in recorded]))},
        }

    def _counts(self, members: Sequence[int]) -> dict[str, Any]:
        fates = [self._fate[i] for i in members]
        worst = _worst([error for i in members for error in self._tau_error[i]])
        return {fate: fates.count(fate) for fate in _FATES} | {"max_tau_error": worst}

    def _percentiles(self, members: Sequence[int]) -> list[float]:
        found: list[float] = np.percentile([us for i in members for us in self._times[i]], [50, 99, 100]).tolist()
        return found


def _by(keys: Sequence[Any]) -> list[tuple[Any, list[int]]]:
    """Each key with the numbers of its places, in order of appearance."""
    return [(key, [i for i, each in enumerate(keys) if each == key]) for key in dict.fromkeys(keys)]


def _worst(values: list[float]) -> float | None:
    """The largest; None without values, and where one is not finite (JSON has no word for it)."""
    worst = float(np.max(values)) if values else math.nan
    return worst if math.isfinite(worst) else None


class Known:
    """What is known of the answer to a problem: the best of all that were certified, or polished from those."""

    def __init__(self, item: Recorded) -> None:
        self._item, self.infeasible = item, item.kind == INFEASIBLE
        self._residual, self._z = math.inf, item.problem.lo
        self.tau: Array | None = None  # [N m]
        self._bound: Bound | None = None

    def learn(self, solutions: list[Solution]) -> None:
        problem = self._item.problem
        certified = [solution for solution in solutions if solution.accepted and max(solution.certificate) < math.inf]
        if not certified:
            return
        best = min(certified, key=lambda solution: max(solution.certificate))
        if max(best.certificate) >= self._residual:
            return
        self._residual, x, self._z = max(best.certificate), best.x, best.z
        polished = certify(problem, *(found := _polished(problem, best.z)))
        if max(polished) < self._residual:  # False also for NaN
            self._residual, (x, self._z) = max(polished), found
        self.tau = self._item.torque(x)

    def error(self, x: Array) -> float:
        """[N m] of the torque of x; NaN where there is nothing to compare."""
        if self.tau is None or x.shape != self._item.problem.g.shape:
            return math.nan
        return float(np.abs(self._item.torque(x) - self.tau).max())

    def allowed(self, x: Array, z: Array) -> float:
        """[N m] what the residuals of (x, z) leave open, and the known answer with them."""
        self._bound = self._bound or Bound(self._item)
        return self._bound(x, z, self._z)


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
