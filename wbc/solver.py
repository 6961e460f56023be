"""Solvers behind one interface: `solve(problem) -> (x, z)`; whatever they claim, the certificate decides.

`x` (n,) is the minimiser, `z` (n + m,) the multipliers of the bounds, then of the rows, positive at an upper bound.
An object of one's own needs only `solve(problem)`; `restart()`, when it has one, is called after a refused answer.
"""

from __future__ import annotations

import importlib.util
from typing import Any, NamedTuple, Protocol

import numpy as np

from .errors import SolverError, did_you_mean
from .qp import UNCERTIFIED, Array, Certificate, Problem, certify

DEFAULT = "daqp"  # the README tells the measurement behind this choice
TOLERANCE = Certificate(primal=1e-6, dual=1e-6, gap=1e-6)


class Solver(Protocol):
    """What the controller asks of a solver."""

    def solve(self, problem: Problem) -> tuple[Array, Array]: ...


class Solution(NamedTuple):
    """An answer with its certificate; `accepted` is the certificate's word, never the solver's."""

    x: Array
    z: Array
    certificate: Certificate
    accepted: bool
    reason: str = ""


def answer(solver: Solver, problem: Problem, tolerance: Certificate = TOLERANCE) -> Solution:
    """Solve and certify; a refused answer gets one more chance from a cold start."""
    reason = ""
    for attempt in range(2):
        try:
            x, z = solver.solve(problem)
            certificate = certify(problem, x, z)
        except Exception as error:  # a foreign object must not take the loop down
            x, z, certificate = problem.g, problem.lo, UNCERTIFIED
            reason = f"the solver raised {type(error).__name__}: {error}"
        if certificate.holds(tolerance):
            return Solution(x, z, certificate, True)
        restart = getattr(solver, "restart", None)
        if restart is None or attempt:
            break
        restart()
    reason = reason or "no certified answer: primal {:.1e}, dual {:.1e}, gap {:.1e}".format(*certificate)
    return Solution(x, z, certificate, False, reason)


class Daqp:
    """DAQP (dual active set) on one persistent model, warm-started from the last accepted active set."""

    def __init__(self, **settings: Any) -> None:
        self._settings = {"primal_tol": 1e-9, "iter_limit": 1000} | settings
        self._model: Any = None
        self._shape: tuple[int, int, int] = (0, 0, 0)

    def restart(self) -> None:
        self._model = None

    def solve(self, problem: Problem) -> tuple[Array, Array]:
        n, m, n_eq = problem.g.size, problem.C.shape[0], problem.n_eq
        if self._model is None or self._shape != (n, m, n_eq):
            import daqp

            sense = np.zeros(n + m, dtype=np.int32)
            sense[n : n + n_eq] = 5
            self._model = daqp.Model()
            self._model.settings = self._settings
            self._model.setup(problem.H, problem.g, problem.C, problem.hi, problem.lo, sense)
            self._shape = (n, m, n_eq)
        else:
            self._model.update(problem.H, problem.g, problem.C, problem.hi, problem.lo)
        x, _, flag, info = self._model.solve()
        if flag < 1:
            raise SolverError(f"exit flag {flag} ({_DAQP_FLAGS.get(flag, 'see its manual')})")
        return x, info["lam"]


_DAQP_FLAGS = {-1: "infeasible", -2: "cycling", -3: "unbounded", -4: "iteration limit", -5: "nonconvex"}


class ProxQP:
    """ProxQP (dense) as one persistent object: warm only after an accepted answer, capped iterations, all nine arrays."""

    _BIG = 1e20

    def __init__(self, eps_abs: float = 1e-9, warm: tuple[int, int] = (50, 50), cold: tuple[int, int] = (200, 200)):
        from proxsuite import proxqp

        self._proxqp = proxqp
        self._eps, self._caps = eps_abs, {True: warm, False: cold}
        self._qp: Any = None
        self._shape: tuple[int, int, int] = (0, 0, 0)

    def restart(self) -> None:
        self._qp = None

    def solve(self, problem: Problem) -> tuple[Array, Array]:
        n, m, n_eq = problem.g.size, problem.C.shape[0], problem.n_eq
        lo, hi = np.maximum(problem.lo, -self._BIG), np.minimum(problem.hi, self._BIG)
        arrays = (problem.H, problem.g, problem.C[:n_eq], lo[n : n + n_eq], problem.C[n_eq:])
        arrays += (lo[n + n_eq :], hi[n + n_eq :], lo[:n], hi[:n])
        guess = self._proxqp.InitialGuess
        warm = self._qp is not None and self._shape == (n, m, n_eq)
        if not warm:
            self._qp = self._proxqp.dense.QP(n, n_eq, m - n_eq, True)
            self._qp.settings.eps_abs, self._qp.settings.eps_rel = self._eps, 0.0
            self._shape = (n, m, n_eq)
        settings = self._qp.settings
        settings.max_iter, settings.max_iter_in = self._caps[warm]
        settings.initial_guess = (
            guess.WARM_START_WITH_PREVIOUS_RESULT if warm else guess.EQUALITY_CONSTRAINED_INITIAL_GUESS
        )
        (self._qp.update if warm else self._qp.init)(*arrays)
        self._qp.solve()
        results = self._qp.results
        x, z, rows = np.array(results.x), np.empty(n + m), np.array(results.z)
        z[:n], z[n : n + n_eq], z[n + n_eq :] = rows[m - n_eq :], results.y, rows[: m - n_eq]
        return x, z


class QpSolvers:
    """Any backend of `qpsolvers`, by its name: for comparing; it rebuilds the problem in every call."""

    def __init__(self, name: str, **settings: Any) -> None:
        import qpsolvers

        if name not in qpsolvers.available_solvers:
            raise SolverError(f"no solver named {name!r}{did_you_mean(name, installed())}")
        self._solve, self._problem = qpsolvers.solve_problem, qpsolvers.Problem
        self._name, self._settings = name, settings

    def solve(self, problem: Problem) -> tuple[Array, Array]:
        n, n_eq = problem.g.size, problem.n_eq
        C, lo, hi = problem.C[n_eq:], problem.lo[n + n_eq :], problem.hi[n + n_eq :]
        up, down = np.isfinite(hi), np.isfinite(lo)
        given = self._problem(
            problem.H, problem.g, np.r_[C[up], -C[down]], np.r_[hi[up], -lo[down]],
            problem.C[:n_eq], problem.hi[n : n + n_eq], problem.lo[:n], problem.hi[:n],
        )  # fmt: skip
        solution = self._solve(given, solver=self._name, **self._settings)
        if not solution.found or solution.x is None:
            raise SolverError("no solution found")
        z = np.zeros(problem.lo.size)
        if solution.z_box is not None and solution.z_box.size:
            z[:n] = solution.z_box
        z[n : n + n_eq] = solution.y if n_eq else 0.0
        if solution.z is not None and solution.z.size:
            z[n + n_eq :][up] += solution.z[: up.sum()]
            z[n + n_eq :][down] -= solution.z[up.sum() :]
        return np.asarray(solution.x, float), z


def make(solver: str | Solver) -> Solver:
    """A solver from its name, or the object itself when it has `solve(problem)`.

    Raises SolverError when the name is unknown or the object has no `solve`.
    """
    if not isinstance(solver, str):
        if not callable(getattr(solver, "solve", None)):
            raise SolverError(f"a solver needs a method solve(problem), got {type(solver).__name__}")
        return solver
    if solver == "daqp":
        return Daqp()
    if solver == "proxqp":
        return ProxQP()
    return QpSolvers(solver)


def installed() -> list[str]:
    """Names that `make` takes on this machine: the two direct ones, then those that qpsolvers finds."""
    import qpsolvers

    direct = [name for name, package in (("daqp", "daqp"), ("proxqp", "proxsuite")) if importlib.util.find_spec(package)]
    return direct + [name for name in sorted(qpsolvers.available_solvers) if name not in direct]
