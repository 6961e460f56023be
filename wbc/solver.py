"""Solvers behind one interface: `solve(problem) -> (x, z)`; whatever they claim, the certificate decides.

`x` (n,) is the minimiser, `z` (n + m,) the multipliers of the bounds, then of the rows, positive at an upper bound.
An object of one's own needs only `solve(problem)`, which writes to none of the problem's arrays: what it writes is
undone and its answer refused, for the certificate would be that of another problem. `restart()`, when it has one, is
called after a refused answer: what it remembers then leads astray.
"""

from __future__ import annotations

import importlib.util
import warnings
from contextlib import redirect_stdout
from io import StringIO
from typing import Any, NamedTuple, Protocol

import numpy as np

from .errors import SolverError, did_you_mean
from .kernels import minimum
from .qp import UNCERTIFIED, Array, Certificate, Problem, certify

DEFAULT = "daqp"  # the README tells the measurement behind this choice
TOLERANCE = Certificate(primal=1e-6, dual=1e-6, gap=1e-6)
_RAISED = "the solver raised "


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

    @property
    def broken(self) -> bool:
        """Whether the solver itself failed, which says nothing of the problem (a SolverError does)."""
        return self.reason.startswith(_RAISED) and not self.reason.startswith(f"{_RAISED}{SolverError.__name__}")


def answer(solver: Solver, problem: Problem, tolerance: Certificate = TOLERANCE) -> Solution:
    """Solve and certify; a solver that can restart gets one more chance, from cold. Never raises."""
    solution = _attempt(solver, problem, tolerance)
    if not solution.accepted and _restart(solver):
        solution = _attempt(solver, problem, tolerance)
        if not solution.accepted:
            _restart(solver)
    return solution


def _attempt(solver: Solver, problem: Problem, tolerance: Certificate) -> Solution:
    if type(solver) is Daqp or type(solver) is ProxQP:  # others may do anything
        return _certified(solver, problem, tolerance)
    parts = (problem.stack, problem.g, problem.lo, problem.hi)
    kept = [part.copy() for part in parts]
    solution = _certified(solver, problem, tolerance)
    if all(part.tobytes() == before.tobytes() for part, before in zip(parts, kept, strict=True)):
        # plain arrays of our own: its next answer may overwrite these, and a mask would leave out what is certified
        return solution._replace(x=np.array(solution.x), z=np.array(solution.z)) if solution.accepted else solution
    for part, before in zip(parts, kept, strict=True):
        part[...] = before
    return refused("the solver wrote to the arrays of the problem")


def _certified(solver: Solver, problem: Problem, tolerance: Certificate) -> Solution:
    try:
        found = solver.solve(problem)
    except Exception as error:  # a foreign object must not take the loop down
        return refused(f"{_RAISED}{type(error).__name__}: {error}")
    try:
        x, z = found
        certificate = certify(problem, x, z)
    except Exception as error:
        return refused(f"the solver answered no (x, z) of float arrays: {type(error).__name__}: {error}")
    primal, dual, gap = certificate
    if primal <= tolerance.primal and dual <= tolerance.dual and gap <= tolerance.gap:  # False also for NaN
        return Solution(x, z, certificate, True)
    if x.shape != problem.g.shape or z.shape != problem.lo.shape:
        expected = f"expected {problem.g.shape}, {problem.lo.shape}"
        return refused(f"the solver answered arrays of shapes {x.shape}, {z.shape}; {expected}")
    reason = f"no certified answer: primal {primal:.1e}, dual {dual:.1e}, gap {gap:.1e}"
    return Solution(x, z, certificate, False, reason)


def refused(reason: str) -> Solution:
    """No answer, and why."""
    return Solution(np.zeros(0), np.zeros(0), UNCERTIFIED, False, reason)


def _restart(solver: Any) -> bool:
    """Whether the solver forgot its past."""
    try:
        solver.restart()
    except Exception:  # it has no past, or cannot forget it
        return False
    return True


class Daqp:
    """DAQP (dual active set) on one persistent model.

    Every call starts from the empty active set, so that an answer is bit for bit a function of its problem. That
    costs nothing on an arm's problems; the storage is what is worth keeping (a new model takes twice the time).
    Whether the empty set is the answer already is found without DAQP, which would first transform every row: most ticks
    have no limit active, and then it is a third of the work. `first=False` leaves that out: DAQP alone, for comparing.
    """

    def __init__(self, first: bool = True, **settings: Any) -> None:
        import daqp  # here, not in the first tick

        self._first = first
        self._Model = daqp.Model
        # equality reduction chooses by the history of the model: off
        self._settings = {"primal_tol": 1e-9, "iter_limit": 1000, "eq_reduction": -1} | settings
        self._problem: Problem | None = None  # the last one: the same object needs no look at its shape
        self._shape: tuple[int, int, int] | None = None
        self._model: Any = None
        self._sense: Any = None

    def solve(self, problem: Problem) -> tuple[Array, Array]:
        if self._first:
            x, z = np.empty(problem.g.size), np.empty(problem.lo.size)
            tol = self._settings["primal_tol"]
            if minimum(problem.stack, problem.g, problem.lo, problem.hi, problem.n_eq, tol, x, z):
                return x, z
        if problem is self._problem:  # the model reads the arrays where they stand: H alone says that all are new
            flag = self._model.update(problem.H, None, None, None, None, self._sense)
        elif (problem.g.size, problem.lo.size, problem.n_eq) != self._shape:
            flag = self._setup(problem)
        else:
            flag = self._model.update(problem.H, problem.g, problem.C, problem.hi, problem.lo, self._sense)
        if flag < 0:
            raise self._failed(flag)
        if problem is not self._problem:  # an array that it had to copy it would not see change
            self._problem = problem if all(each.flags.c_contiguous for each in problem[:5]) else None
        x, _, flag, info = self._model.solve()
        if flag < 1:
            raise self._failed(flag)
        return x, info["lam"]

    def _setup(self, problem: Problem) -> int:
        n, size, n_eq = shape = problem.g.size, problem.lo.size, problem.n_eq
        self._sense = np.zeros(size, dtype=np.int32)
        self._sense[n : n + n_eq] = 5  # an equality, always active
        self._model = self._Model()
        self._model.settings = self._settings
        flag, _ = self._model.setup(problem.H, problem.g, problem.C, problem.hi, problem.lo, self._sense)
        self._shape = shape
        return int(flag)

    def _failed(self, flag: int) -> SolverError:
        self._problem = self._shape = None  # whatever the model holds now, the next call gets a new one
        return SolverError(f"DAQP: {_DAQP_FLAGS.get(flag, f'exit flag {flag}')}")


_DAQP_FLAGS = {
    -1: "infeasible", -2: "cycling", -3: "unbounded", -4: "iteration limit", -5: "nonconvex", -6: "contradiction",
}  # fmt: skip


class ProxQP:
    """ProxQP (dense) as one persistent object: warm only after an accepted answer, capped iterations, all nine arrays.

    `warm`, `cold`: most outer and inner iterations. Warm answers depend on the past within the tolerance (measured:
    1e-9 of the torque); an accepted one need not have reached `eps_abs`, which lies near the rounding of some problems.
    So every answer is handed over; `claims` says whether ProxQP itself called the last one solved.
    """

    _BIG = 1e20

    def __init__(self, eps_abs: float = 1e-9, warm: tuple[int, int] = (20, 20), cold: tuple[int, int] = (40, 40)):
        from proxsuite import proxqp

        guess = proxqp.InitialGuess
        self._QP = proxqp.dense.QP
        self._guess = {True: guess.WARM_START_WITH_PREVIOUS_RESULT, False: guess.EQUALITY_CONSTRAINED_INITIAL_GUESS}
        self._eps, self._caps = eps_abs, {True: warm, False: cold}
        self._solved, self.claims = proxqp.QPSolverOutput.PROXQP_SOLVED, False
        self._qp: Any = None
        self._shape: tuple[int, int, int] | None = None

    def restart(self) -> None:
        self._qp = None

    def solve(self, problem: Problem) -> tuple[Array, Array]:
        H, g, C, lo, hi, n_eq, _ = problem
        n, m = g.size, C.shape[0]
        lo, hi = np.maximum(lo, -self._BIG), np.minimum(hi, self._BIG)
        first = n + n_eq
        warm = self._qp is not None and self._shape == (n, m, n_eq)
        qp = self._qp if warm else self._fresh(n, m, n_eq)
        qp.settings.initial_guess = self._guess[warm]
        qp.settings.max_iter, qp.settings.max_iter_in = self._caps[warm]
        (qp.update if warm else qp.init)(H, g, C[:n_eq], lo[n:first], C[n_eq:], lo[first:], hi[first:], lo[:n], hi[:n])
        qp.solve()
        results = qp.results
        self.claims = results.info.status == self._solved
        x, z, rows = np.array(results.x), np.empty(n + m), np.array(results.z)
        z[:n], z[n:first], z[first:] = rows[m - n_eq :], results.y, rows[: m - n_eq]
        return x, _held(z, problem)

    def _fresh(self, n: int, m: int, n_eq: int) -> Any:
        qp = self._QP(n, n_eq, m - n_eq, True)
        qp.settings.eps_abs, qp.settings.eps_rel = self._eps, 0.0
        # without it a large multiplier times a residual of eps_abs fails the certificate (1 tick in 100 under noise)
        qp.settings.check_duality_gap = True
        qp.settings.eps_duality_gap_abs, qp.settings.eps_duality_gap_rel = 100.0 * self._eps, 0.0
        # the default of 1e-4 calls 27 of 2 000 random feasible problems infeasible
        qp.settings.eps_primal_inf = qp.settings.eps_dual_inf = 1e-12
        self._qp, self._shape = qp, (n, m, n_eq)
        return qp


# what a backend needs beyond its defaults for answers that the certificate accepts
_TUNED: dict[str, dict[str, Any]] = {
    "clarabel": {"tol_gap_abs": 1e-11, "tol_gap_rel": 1e-11, "tol_feas": 1e-11},
    "highs": {"qp_regularization_value": 0.0, "primal_feasibility_tolerance": 1e-6, "time_limit": 0.5},
    "osqp": {"eps_abs": 1e-6, "eps_rel": 0.0, "polishing": True},
    "piqp": {"eps_abs": 1e-10, "eps_rel": 0.0, "eps_duality_gap_abs": 1e-10, "eps_duality_gap_rel": 0.0},
    "scs": {"eps_abs": 1e-9, "eps_rel": 0.0, "max_iters": 5000, "time_limit_secs": 0.5},
}


class QpSolvers:
    """Any backend of `qpsolvers`, by its name: for comparing; it rebuilds the problem in every call.

    `settings` are the backend's own, on top of those that it needs for a certified answer; not `tuned`, these are left
    to its defaults.
    """

    def __init__(self, name: str, tuned: bool = True, **settings: Any) -> None:
        import qpsolvers

        if name not in qpsolvers.available_solvers:
            raise SolverError(f"no solver named {name!r}{did_you_mean(name, installed())}")
        self._solve = qpsolvers.solve_problem
        self._name, self._settings = name, (_TUNED.get(name, {}) if tuned else {}) | settings

    def solve(self, problem: Problem) -> tuple[Array, Array]:
        if not (np.isfinite(problem.stack).all() and np.isfinite(problem.g).all() and (problem.lo <= problem.hi).all()):
            raise SolverError("not solved: a coefficient is not finite, or bounds cross")  # some backends never return
        with warnings.catch_warnings(), redirect_stdout(StringIO()):  # OSQP prints what it did not polish
            warnings.simplefilter("ignore")  # of sparse copies, and of failures, which raise here
            solution = self._solve(as_qpsolvers(problem), solver=self._name, **self._settings)
        if not solution.found or solution.x is None:
            raise SolverError(f"{self._name}: no solution found")
        n = problem.g.size
        first, z = n + problem.n_eq, np.zeros(problem.lo.size)
        up, down = np.isfinite(problem.hi[first:]), np.isfinite(problem.lo[first:])
        if solution.z_box is not None and solution.z_box.size:
            z[:n] = solution.z_box
        if problem.n_eq:
            z[n:first] = solution.y
        if (up.any() or down.any()) and solution.z is not None:
            z[first:][up] += solution.z[: up.sum()]
            z[first:][down] -= solution.z[up.sum() :]
        return np.asarray(solution.x, float), _held(z, problem)


def as_qpsolvers(problem: Problem) -> Any:
    """The same as a `qpsolvers.Problem`; G has the rows with an upper bound, then minus those with a lower one."""
    import qpsolvers

    H, g, C, lo, hi, n_eq, _ = problem
    n = g.size
    first = n + n_eq
    up, down = np.isfinite(hi[first:]), np.isfinite(lo[first:])
    rows, box = up.any() or down.any(), np.isfinite(lo[:n]).any() or np.isfinite(hi[:n]).any()
    return qpsolvers.Problem(
        H, g,
        np.concatenate((C[n_eq:][up], -C[n_eq:][down])) if rows else None,
        np.concatenate((hi[first:][up], -lo[first:][down])) if rows else None,
        C[:n_eq] if n_eq else None, hi[n:first] if n_eq else None,
        lo[:n] if box else None, hi[:n] if box else None,
    )  # fmt: skip


def _held(z: Array, problem: Problem) -> Array:
    """z without the rounding that iterative methods leave at bounds that do not exist; what matters shows in `dual`."""
    z[((z > 0.0) & (problem.hi == np.inf)) | ((z < 0.0) & (problem.lo == -np.inf))] = 0.0
    return z


def make(solver: str | Solver) -> Solver:
    """A solver from its name, or the object itself when it has `solve(problem)`.

    For comparing, `NAME (default)` is that backend of qpsolvers with its own settings, `daqp (plain)` DAQP alone.
    Raises SolverError when the name is unknown or the object has no `solve`.
    """
    if isinstance(solver, type):
        raise SolverError(f"expected an object of the class {solver.__name__}, got the class itself")
    if not isinstance(solver, str):
        if not callable(getattr(solver, "solve", None)):
            raise SolverError(f"a solver needs a method solve(problem), got {type(solver).__name__}")
        return solver
    if solver == "daqp":
        return Daqp()
    if solver == "daqp (plain)":
        return Daqp(first=False)
    if solver == "proxqp":
        return ProxQP()
    name, _, default = solver.partition(" (default)")
    return QpSolvers(name, tuned=False) if " (default)" in solver and not default else QpSolvers(solver)


def tuned() -> list[str]:
    """Names of installed solvers that `make` gives other settings than their own."""
    return [name for name in installed() if name in ("daqp", "proxqp") or name in _TUNED]


def installed() -> list[str]:
    """Names that `make` takes on this machine: the two direct ones, then those that qpsolvers finds."""
    import qpsolvers

    packages = {"daqp": "daqp", "proxqp": "proxsuite"}
    direct = [name for name, package in packages.items() if importlib.util.find_spec(package)]
    return direct + [name for name in sorted(qpsolvers.available_solvers) if name not in direct]
