"""The quadratic programs that a run of a spec meets, kept by value."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from ..errors import ProblemError
from ..ladder import Status
from ..memory import Output
from ..qp import Array, Problem, Workspace
from ..solver import Daqp, answer, as_qpsolvers

if TYPE_CHECKING:
    from ..build import Built

CHANGED = 10  # ticks after a change of phase that count as part of it
INFEASIBLE = "infeasible"  # the kind of a program that no value satisfies

Progress = Callable[[int], None]


class Recorded(NamedTuple):
    """A problem met at time `t` [s] of a run, and the torque of its answer, tau = T x + h [N m]; all by value.

    `kind`: easy (no limit is active), saturated (one is), changing (contacts or tasks just changed) or infeasible; in
    the corpus also redundant (contacts carry what the motion does not decide) and ill-scaled (weights far apart).
    """

    problem: Problem
    T: Array  # (nu, n)
    h: Array  # (nu,)
    t: float
    spec: str
    active: tuple[str, ...]  # limits that were active
    kind: str = ""

    def torque(self, x: Array) -> Array:
        """(nu,) [N m]"""
        tau: Array = self.T.dot(x) + self.h
        return tau

    def qpsolvers(self) -> Any:
        """The same as a `qpsolvers.Problem`: P, q, G x <= h, A x = b, lb <= x <= ub."""
        return as_qpsolvers(self.problem)


def record(built: Built, every: int | None = None, most: int = 200, progress: Progress | None = None) -> list[Recorded]:
    """Simulate a built spec and keep problems that it meets, in order of time.

    Half of `most` are spread evenly over the run (`every` n ticks, or more), at most half over the ticks at which a
    limit is active, as many over those at which a phase begins, and over those at which viability had to yield: what is
    kept of these is the program that nothing satisfies. `progress` is told the number of ticks done. Raises
    ProblemError for strict priorities.
    """
    from ..run import run

    if built.spec.hierarchy == "strict":
        raise ProblemError("strict levels are several problems a tick; expected hierarchy: weighted")
    controller, half = built.controller, max(1, most // 2)
    every = max(every or 1, math.ceil(built.spec.duration * built.spec.rate / half))
    even, fresh = _Spread(every, half), _Fresh()
    special = {kind: _Spread(1, half) for kind in ("saturated", "changing", INFEASIBLE)}

    def keep(seen: Any, out: Output) -> None:
        program = controller._program
        changing = fresh.look(program)
        if out.status in (Status.SAFE_HOLD, Status.STOPPED) or program.last.fault():
            return  # no problem of this tick

        def met(workspace: Workspace, kind: str) -> Recorded:
            T = workspace.product("torque", np.eye(workspace.variables.size))
            h, name = controller.state.bias[built.robot.base :].copy(), Path(built.spec.file).stem
            problem = workspace.problem.copy()
            if out.status is Status.DEGRADED and not answer(Daqp(), problem).accepted:
                kind = INFEASIBLE
            return Recorded(problem, T, h, seen.t, name, out.active, kind)

        kind = "changing" if changing else "saturated" if out.active else "easy"
        if not even.offer(lambda: met(program.last, kind)) and kind in special:
            special[kind].offer(lambda: met(program.last, kind))
        if program.yielded:  # what was asked first, and nothing satisfies
            special[INFEASIBLE].offer(lambda: met(program.strict, INFEASIBLE))

    run(built, progress=progress, hook=keep)
    kept = [*even.kept, *(item for each in special.values() for item in each.kept)]
    return sorted(kept, key=lambda item: item.t)


class _Fresh:
    """Whether the program of a phase is in its first ticks; that of the first phase of a run is not."""

    def __init__(self) -> None:
        self._program: object | None = None
        self._age = CHANGED

    def look(self, program: object) -> bool:
        self._age = self._age + 1 if self._program in (None, program) else 0
        self._program = program
        return self._age < CHANGED


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
