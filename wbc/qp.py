"""The quadratic program of one tick: rows over named variables, their assembly, and the certificate of an answer.

    min  1/2 x' H x + g' x     subject to     lo <= [x; C x] <= hi        (the first `n_eq` rows of C: lo = hi)

Every task, contact, limit and dynamics equation speaks one language, `Rows` over *named* variables. Only `Workspace`
knows column numbers; names of rows travel to the multipliers, so that an answer can say which of them are active.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from .errors import ProblemError
from .kernels import active, add_rows, add_square, residuals, total

Array = NDArray[np.float64]


class Rows(NamedTuple):
    """`lo <= sum_k A[k] x[k] <= hi` over named variables; as a cost, `1/2 |sum_k A[k] x[k] - lo|^2` in `metric`.

    `A[k]` is (m, size of k), or None for the identity. `metric` is (m, m), symmetric and positive semidefinite;
    None is the identity. An equality passes one array as `lo` and `hi`.
    """

    name: str
    A: Mapping[str, Array | None]
    lo: Array
    hi: Array
    metric: Array | None = None
    labels: tuple[str, ...] = ()


class Problem(NamedTuple):
    """What a solver sees. The arrays are views of the workspace, valid until the next tick."""

    H: Array  # (n, n)
    g: Array  # (n,)
    C: Array  # (m, n)
    lo: Array  # (n + m,)
    hi: Array  # (n + m,)
    n_eq: int
    stack: Array  # (n + m, n), H over C: one product gives H x and C x

    def copy(self) -> Problem:
        """The same problem in arrays of its own, to keep beyond the tick."""
        stack = self.stack.copy()
        n = self.g.size
        return Problem(stack[:n], self.g.copy(), stack[n:], self.lo.copy(), self.hi.copy(), self.n_eq, stack)


class Certificate(NamedTuple):
    """Residuals of the Karush-Kuhn-Tucker conditions, measured on the problem itself, whatever a solver says.

    primal: violation of a bound or row; dual: |H x + g + C' z|; gap: multiplier times distance to its bound, with the
    sign that makes it a certificate (z > 0 only at the upper bound, z < 0 only at the lower).
    """

    primal: float
    dual: float
    gap: float

    def holds(self, tolerance: Certificate) -> bool:
        """False also when a residual is not a number."""
        return self.primal <= tolerance.primal and self.dual <= tolerance.dual and self.gap <= tolerance.gap


_NO_BLOCK = np.zeros((0, 0))
UNCERTIFIED = Certificate(math.inf, math.inf, math.inf)


def certify(problem: Problem, x: Array, z: Array) -> Certificate:
    """KKT residuals (2-norms) of `x` (n,) with multipliers `z` (n + m,) of the bounds, then the rows.

    A number that is not finite anywhere makes a residual that no tolerance holds.
    """
    _, g, _, lo, hi, n_eq, stack = problem
    if x.shape != g.shape or z.shape != lo.shape:
        return UNCERTIFIED
    return Certificate(*residuals(stack, g, lo, hi, n_eq, x, z))


class Variables:
    """Names of the unknowns and where each stands in `x`."""

    def __init__(self, sizes: Mapping[str, int]) -> None:
        self.slices: dict[str, slice] = {}
        start = 0
        for name, size in sizes.items():
            self.slices[name] = slice(start, start + size)
            start += size
        self.size = start

    def __getitem__(self, name: str) -> slice:
        try:
            return self.slices[name]
        except KeyError:
            raise ProblemError(f"no variable named {name!r}; there are {', '.join(self.slices)}") from None


def _check(rows: Rows, variables: Variables) -> None:
    """Raises ProblemError where rows fit neither the variables nor each other."""
    m = np.size(rows.lo)
    if np.shape(rows.lo) != (m,) or np.shape(rows.hi) != (m,):
        raise ProblemError(
            f"rows {rows.name!r}: lo has shape {np.shape(rows.lo)}, hi {np.shape(rows.hi)}; expected (m,)"
        )
    for name, A in rows.A.items():
        place = variables[name]
        expected, got = (m, place.stop - place.start), (m, m) if A is None else np.shape(A)
        if got != expected:
            what = "the identity has" if A is None else "has"
            raise ProblemError(f"rows {rows.name!r}: A[{name!r}] {what} shape {got}, expected {expected}")
    if rows.labels and len(rows.labels) != m:
        raise ProblemError(f"rows {rows.name!r}: {len(rows.labels)} labels for {m} rows")


class Workspace:
    """Storage of one structure of the problem, filled in place tick by tick.

    Parameters: the variables, and one sample of every hard row block. Blocks keep their shape and kind: equalities
    (`lo is hi`), bounds on one variable (`A = {name: None}`), inequalities. `stored[name]` are the rows of a block as
    they stand in the storage: to be written to. Raises ProblemError when rows do not fit.
    """

    def __init__(self, variables: Variables, hard: Sequence[Rows]) -> None:
        self.variables = variables
        n = variables.size
        bounded: set[str] = set()
        kinds: dict[str, list[Rows]] = {"equality": [], "bound": [], "inequality": []}
        for rows in hard:
            _check(rows, variables)
            kinds[self._kind(rows, bounded)].append(rows)
        names = [rows.name for rows in hard]
        if len(set(names)) < len(names):
            raise ProblemError(f"hard rows need names of their own, got {', '.join(names)}")
        m = sum(rows.lo.size for kind in ("equality", "inequality") for rows in kinds[kind])
        n_eq = sum(rows.lo.size for rows in kinds["equality"])
        buffer = np.zeros(n + (n + m) * n)  # g, then H over C: one sum finds a number that is not finite
        stack = buffer[n:].reshape(n + m, n)
        self.labels = [f"{name}[{i}]" for name, s in variables.slices.items() for i in range(s.stop - s.start)]
        g, lo, hi = buffer[:n], np.full(n + m, -np.inf), np.full(n + m, np.inf)
        self.stored: dict[str, Rows] = {}
        self._blocks: dict[str, Array] = {}
        for rows in kinds["bound"]:
            (name,) = rows.A
            place = variables[name]
            self.stored[rows.name] = rows._replace(lo=lo[place], hi=hi[place])
            self.labels[place] = rows.labels or self.labels[place]
        start = n
        for rows in kinds["equality"] + kinds["inequality"]:
            stop = start + rows.lo.size
            columns: dict[str, Array | None] = {}
            for name, A in rows.A.items():
                columns[name] = block = stack[start:stop, variables[name]]
                if A is None:  # the identity stays in place for good
                    block[:], columns[name] = np.eye(rows.lo.size), None
            self.stored[rows.name] = rows._replace(A=columns, lo=lo[start:stop], hi=hi[start:stop])
            self._blocks[rows.name] = stack[start:stop]
            self.labels += rows.labels or [f"{rows.name}[{i}]" for i in range(stop - start)]
            start = stop
        self._joined: dict[tuple[Any, ...], tuple[Array, list[Array | None]]] = {}
        self._buffer, self._cost = buffer, buffer[: n + n * n]
        self._H = {name: stack[place, place] for name, place in variables.slices.items()}
        self._g = {name: g[place] for name, place in variables.slices.items()}
        self.problem = Problem(stack[:n], g, stack[n:], lo, hi, n_eq, stack)

    @staticmethod
    def _kind(rows: Rows, bounded: set[str]) -> str:
        if rows.lo is rows.hi:
            return "equality"
        if len(rows.A) == 1 and next(iter(rows.A.values())) is None:
            (name,) = rows.A
            if name not in bounded:
                bounded.add(name)
                return "bound"
        return "inequality"

    def clear(self) -> None:
        """Forget the costs of the last tick; hard rows are overwritten in place."""
        self._cost.fill(0.0)

    def minimise(self, rows: Rows, weight: float) -> None:
        """Add `weight / 2 |A x - lo|^2` in the metric of the rows."""
        _, coefficients, target, _, metric, _ = rows
        if metric is None:
            metric = np.eye(target.size)
        if len(coefficients) == 1:
            ((name, A),) = coefficients.items()
            H, g = self._H[name], self._g[name]
        else:
            A, H, g = self._joint(coefficients, target.size), self.problem.H, self.problem.g
        if A is None:
            add_square(metric, target, weight, H, g)
        else:
            add_rows(A, metric, target, weight, H, g)

    def _joint(self, coefficients: Mapping[str, Array | None], m: int) -> Array:
        """(m, n) over all variables."""
        names = (m, *coefficients)
        A, blocks = self._joined.get(names) or (np.zeros((m, self.variables.size)), [_NO_BLOCK] * len(coefficients))
        for i, (name, block) in enumerate(coefficients.items()):
            if block is None or block is not blocks[i] or block.flags.writeable:  # else it stands there already
                A[:, self.variables.slices[name]] = np.eye(m) if block is None else block
                blocks[i] = block
        self._joined[names] = (A, blocks)
        return A

    def constrain(self, rows: Rows) -> None:
        """Put a hard block in its place."""
        name, A, lo, hi, _, _ = rows
        _, columns, low, high, _, _ = self.stored[name]
        low[:] = lo
        high[:] = hi
        for variable, place in columns.items():
            if place is not None:
                place[:] = A[variable]

    def product(self, name: str, x: Array) -> Array:
        """C x of the hard block `name`; for columns x (n, k) those of C x."""
        value: Array = self._blocks[name].dot(x)
        return value

    def coefficients(self, name: str) -> Array:
        """C of the hard block `name`."""
        return self._blocks[name]

    def finite(self) -> bool:
        """Whether every coefficient is a number; a solver given one that is not may run for minutes."""
        return math.isfinite(total(self._buffer))

    def fault(self) -> str:
        """Why the assembled problem has no answer, where that can be seen, or ""."""
        if not self.finite():
            return "a coefficient of the problem is not finite"
        ordered = self.problem.lo <= self.problem.hi  # False also for NaN
        if not ordered.all():
            return f"no value satisfies {self.labels[int(np.argmin(ordered))]}: its bounds cross or are not numbers"
        return ""

    def active(self, z: Array, least: float = 1e-9) -> list[int]:
        """Numbers of the inequalities whose multiplier exceeds `least`; `labels` names them."""
        n = self.problem.g.size
        first = n + self.problem.n_eq
        if not active(z, n, first, least):
            return []
        return [i for i in z.nonzero()[0].tolist() if (i < n or i >= first) and abs(z[i]) > least]
