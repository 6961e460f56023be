"""A solver with a clock: it is asked as the controller asks, and what it took and claimed is told with the answer."""

from __future__ import annotations

import time
from typing import NamedTuple, Protocol

from ..qp import Array, Problem
from ..solver import Solution, Solver, answer


class Asked(NamedTuple):
    """One answer; `timed_out` and `crashed` of a process that had to be ended, or ended by itself."""

    solution: Solution
    claimed: bool  # the solver answered, in its last attempt, and did not say that it failed
    attempts: int
    us: float  # of all attempts
    timed_out: bool = False
    crashed: bool = False


class Asker(Protocol):
    """Who asks a solver: `Timed` in this process, `process.Isolated` in one of its own."""

    def ask(self, problems: list[Problem]) -> list[Asked]: ...

    def close(self) -> None: ...


class Timed:
    """A solver in this process: nothing ends it when it does not answer."""

    def __init__(self, solver: Solver) -> None:
        self._solver = solver
        restart = getattr(solver, "restart", None)
        if restart is not None:
            self.restart = restart

    def ask(self, problems: list[Problem]) -> list[Asked]:
        return [self.one(problem) for problem in problems]

    def one(self, problem: Problem) -> Asked:
        """As the controller asks, with the clock running."""
        self._seconds, self._attempts, self._claimed = 0.0, 0, False
        solution = answer(self, problem)
        return Asked(solution, self._claimed, self._attempts, 1e6 * self._seconds)

    def solve(self, problem: Problem) -> tuple[Array, Array]:
        """Called by `answer`."""
        self._claimed, self._attempts = False, self._attempts + 1
        began = time.perf_counter()
        try:
            found = self._solver.solve(problem)
        finally:
            self._seconds += time.perf_counter() - began
        self._claimed = bool(getattr(self._solver, "claims", True))
        return found

    def close(self) -> None:
        pass
