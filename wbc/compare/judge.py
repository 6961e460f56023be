"""Every solver asked for the answer to every problem, and what became of the answers.

Every solver answers as it would in the controller, warm from the problem before. The solvers take turns, a block of
problems each and in an order that rotates, so that what else the machine does falls on all of them alike. The time is
that of `solve` alone, of both attempts where a refused answer was asked for again.

A solver that is named, or can be pickled, answers in a process of its own, and has a time limit for each problem: what
does not answer is refused, and the rest goes on.

A torque is held against the best answer known (`known`).
"""

from __future__ import annotations

import gc
import math
import pickle
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from itertools import product
from typing import Any

import numpy as np

from ..errors import ProblemError, SolverError
from ..qp import Array, Problem
from ..solver import Solver, installed, make, tuned
from .ask import Asked, Asker, Timed
from .known import Known
from .process import Isolated
from .record import INFEASIBLE, Progress, Recorded

_BLOCK = 10  # problems in a row: as in a control loop, a solver finds some of its code in the cache
_FATES = ("solved", "wrong", "refused")
_CERTIFIED = ("tau_error", "primal", "dual", "gap")
RATIOS = np.logspace(0.0, 3.0, 31).round(3)  # to the fastest solver, at which a performance profile is told

TIMEOUT = 5.0  # [s] for a problem: fifty times what the slowest takes that come to an end
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
    timeout: float | None = TIMEOUT,
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

    `timeout` [s] is for each problem: a process that has not answered by then is ended, and the problem counts as
    refused (`timed_out` of them; `crashed` those at which a process ended by itself); after five in a row the solver is
    asked no more, and the rest counts as the last. An object that cannot be pickled, or not rebuilt in another process,
    is asked in this one, where nothing ends it (`timeout` of its row is None); with `timeout=None` every solver is.
    `progress` is told the number of problems done.

    Raises ProblemError without problems, SolverError without solvers, for one that does not exist, and for a `timeout`
    that is none.
    """
    if not recorded:
        raise ProblemError("no problems to compare solvers on")
    named = _named(solvers)
    if not named:
        raise SolverError("no solvers to compare")
    if timeout is not None and not 0.0 < timeout < 1e6:  # also for NaN
        raise SolverError(f"timeout {timeout:g}: expected a time above 0 [s]")
    tallies = dict[str, _Tally]()
    try:
        for name, solver in named.items():
            made = make(solver)  # better said before than by a process
            asker = _asker(solver, made, timeout, recorded[0].problem)
            tallies[name] = _Tally(asker, timeout if isinstance(asker, Isolated) else None, len(recorded))
        tau_max = _ask_all(tallies, recorded, passes, progress)
    finally:
        for tally in tallies.values():
            tally.asker.close()
    times = {name: tally.times() for name, tally in tallies.items()}
    fastest = np.min(list(times.values()), axis=0)
    told = {name: tally.told(recorded) for name, tally in tallies.items()}
    feasible = np.array([item.kind != INFEASIBLE for item in recorded])
    for name, row in told.items():
        row["profile"] = _profile(times[name][feasible], fastest[feasible])
    return {
        "problems": len(recorded), "infeasible": int((~feasible).sum()), "tau_max": tau_max,
        "ok": not any(row["accepted_wrong"] for row in told.values()), "ratios": RATIOS.tolist(), "timeout": timeout,
        "solvers": told,
    }  # fmt: skip


def _asker(solver: str | Solver, made: Solver, timeout: float | None, first: Problem) -> Asker:
    """In a process of its own where that can be; warm: what it imports and allocates is not what is measured."""
    if timeout is not None:
        try:
            return Isolated(solver if isinstance(solver, str) else pickle.dumps(solver), timeout, first)
        except Exception:  # whatever pickling raises
            if isinstance(solver, str):
                raise
    timed = Timed(made)
    timed.one(first)
    return timed


def _ask_all(
    tallies: Mapping[str, _Tally], recorded: Sequence[Recorded], passes: int, progress: Progress | None
) -> float:
    """Every problem to every solver, `passes` times; the largest torque [N m]."""
    order, tau_max, bounds = list(tallies), 0.0, dict[int, Known]()
    done, whole = 0, passes * len(tallies) * len(recorded)
    with _frozen():
        for _, start in product(range(passes), range(0, len(recorded), _BLOCK)):
            block = recorded[start : start + _BLOCK]
            answers: dict[str, dict[int, Asked]] = {}
            for name in order:
                answers[name] = tallies[name].ask(start, block)
                done += len(block)
                if progress is not None:
                    progress(done * len(recorded) // whole)
            for i, item in enumerate(block, start):
                known = bounds[i] = bounds.get(i) or Known(item)
                known.learn([answers[name][i].solution for name in order if i in answers[name]])
                for name in order:
                    if i in answers[name]:
                        tallies[name].judge(i, answers[name][i], known)
                tau_max = max(tau_max, 0.0 if known.tau is None else float(np.abs(known.tau).max()))
            order = order[1:] + order[:1]
    return tau_max


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


class _Tally:
    """One solver, and what became of its answers."""

    def __init__(self, asker: Asker, timeout: float | None, problems: int) -> None:
        self.asker, self._timeout = asker, timeout
        self._fate, self._retried, self._deceived = ["solved"] * problems, [False] * problems, [False] * problems
        self._timed_out, self._crashed = [False] * problems, [False] * problems
        self._tau_error, self._residual = [list[float]() for _ in range(problems)], list[float]()
        self._certified: list[tuple[float, ...]] = []  # torque error, allowed, primal, dual, gap
        self._times = [list[float]() for _ in range(problems)]  # [us]

    def ask(self, start: int, block: Sequence[Recorded]) -> dict[int, Asked]:
        """Answers by the number of their problem; what once ended the process is not asked again."""
        members = [i for i in range(start, start + len(block)) if not (self._timed_out[i] or self._crashed[i])]
        return dict(zip(members, self.asker.ask([block[i - start].problem for i in members]), strict=True))

    def judge(self, i: int, asked: Asked, known: Known) -> None:
        """Count the answer to problem i; the worst of its passes stands."""
        x, z, certificate, accepted, _ = asked.solution
        self._retried[i] |= asked.attempts > 1
        self._timed_out[i], self._crashed[i] = asked.timed_out, asked.crashed
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
        sizes = [0 if item.kind == INFEASIBLE else item.problem.g.size for item in recorded]
        return self._counts(range(len(recorded))) | {
            "retried": sum(self._retried), "timed_out": sum(self._timed_out), "crashed": sum(self._crashed),
            "timeout": self._timeout,
            "max_kkt_residual": _worst(self._residual),
            "us": dict(zip(("p50", "p99", "max"), self._percentiles(range(len(recorded))), strict=True)),
            "tolerance": max(self._certified)[1] if self._certified else AGREES,
            "accepted_wrong": sum(self._deceived),
            "certified": dict(zip(_CERTIFIED, [None] * 4 if certified is None else certified.tolist(), strict=True)),
            "kinds": {kind: {"problems": len(of)} | self._counts(of) for kind, of in _by([r.kind for r in recorded])},
            "growth": {str(n): self._percentiles(of)[0] for n, of in sorted(_by(sizes)) if n},
        }  # fmt: skip

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
