"""Checks for a contact or a task of one's own: what it says against finite differences, at random states.

    wbc.testing.check_contact(MyContact(...), robot)
    wbc.testing.check_task(MyTask(...), robot, contacts={"board": ...})

Each raises AssertionError with a sentence that says what is wrong, at which state, what was expected, and what it got.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np
import pinocchio as pin

from .contact import Contact
from .dynamics import inertia, mobility
from .pair import movable
from .qp import Array, Rows
from .robot import Robot
from .state import State
from .task import Task
from .task.force import ForceLoop

STEP = 1e-6  # [s] of the central differences
TOLERANCE = 1e-6  # of 1 + the largest number expected


def check_contact(contact: Contact, robot: Robot, states: int = 20, seed: int = 0) -> None:
    """Hold A, Adot V, `free` and `hold` of a contact to their meaning, at `states` random states.

    A (k, 6) is finite and has k independent rows; Adot V is dA/dt V along q(t), with V kept; A and the free rows
    together span every axis that the robot can move the frame along.
    """
    k, axes = contact.k, list(movable(robot, contact.frame, contact.against))
    _equal("len(axes)", "in its names", len(contact.axes), k)
    for where, q, v in _states(robot, states, seed):
        state = robot.state(q, v)
        frame, A, Adot_V = contact.seen(state), contact.A(state), contact.Adot_V(state)
        _shaped("A", where, A, (k, 6))
        _shaped("Adot_V", where, Adot_V, (k,))
        _equal("the rank of A", where, _rank(A), k)
        free, held = contact.free(state), contact.hold(state)
        _shaped("free", where, free, (len(contact.free_axes), 6))
        _equal("the rank of A and free on the axes of the robot", where, _rank(np.r_[A, free][:, axes]), len(axes))
        before, after = (contact.A(_moved(robot, q, v, h)) for h in (-STEP, STEP))
        _close("Adot_V", where, Adot_V, (after - before) @ frame.V / (2 * STEP))
        _close("G of hold, A J", where, held.G, A @ frame.J)
        _close("rhs of hold, -(A drift + Adot_V)", where, held.rhs, -(A @ frame.drift + Adot_V))
        _close("slip of hold, A V", where, held.slip, A @ frame.V)
        _close("inverse of hold times A', the identity", where, held.inverse @ A.T, np.eye(k))


def check_task(
    task: Task,
    robot: Robot,
    contacts: Mapping[str, Contact] | None = None,
    states: int = 20,
    seed: int = 0,
    drift: bool = True,
) -> None:
    """Hold the rows of a task to the protocol, at `states` random states with `contacts` held.

    Shapes fit the unknowns, numbers are finite, the metric is symmetric and positive semidefinite. With `drift`, rows
    G vdot = b over the acceleration are held to d/dt (G v) = G vdot + Gdot v: feedback is odd in the velocity, so the
    even part of b, less what it is at rest, is -Gdot v. Switch it off for feedback that is not odd in v, and for
    free rows that turn with the state (their own change is no motion of the frame).
    """
    contacts = dict(contacts or {})
    for where, q, v in _states(robot, states, seed):
        rows = task.rows(_ready(robot.state(q, v, t=0.7), contacts))
        sizes = {"vdot": robot.nv} | {name: contact.k for name, contact in contacts.items()}
        _check_rows(rows, sizes, where)
        if not drift or "vdot" not in rows.A or len(rows.A) > 1:
            continue
        ahead, back, still = (task.rows(_ready(robot.state(q, s * v, t=0.7), contacts)) for s in (1.0, -1.0, 0.0))
        moved = (task.rows(_ready(_moved(robot, q, v, h), contacts)).A["vdot"] for h in (STEP, -STEP))
        after, before = (np.eye(robot.nv) if G is None else G for G in moved)
        even = 0.5 * (ahead.lo + back.lo) - still.lo
        _close("the part of the target that is even in v, -Gdot v", where, even, -(after - before) @ v / (2 * STEP))


def _check_rows(rows: Rows, sizes: Mapping[str, int], where: str) -> None:
    m = rows.lo.size
    _shaped("lo", where, rows.lo, (m,))
    _shaped("hi", where, rows.hi, (m,))
    _require(bool(rows.A), f"rows {where}: expected coefficients of an unknown, got none")
    for name, A in rows.A.items():
        _require(name in sizes, f"rows {where}: expected unknowns among {', '.join(sizes)}, got {name!r}")
        if A is None:
            _equal(f"the number of rows with the identity on {name}", where, m, sizes[name])
        else:
            _shaped(f"A[{name!r}]", where, A, (m, sizes[name]))
    if rows.metric is not None:
        _shaped("metric", where, rows.metric, (m, m))
        _close("metric, its transpose", where, rows.metric, rows.metric.T)
        values = np.linalg.eigvalsh(rows.metric) if m else np.zeros(1)
        _require(
            values[0] >= -1e-9 * (1.0 + values[-1]), f"metric {where}: expected eigenvalues >= 0, got {values[0]:.3g}"
        )


def _states(robot: Robot, states: int, seed: int) -> Iterator[tuple[str, Array, Array]]:
    rng = np.random.default_rng(seed)
    for i in range(states):
        q = pin.integrate(robot.model, robot.keyframes["home"], rng.uniform(-1.0, 1.0, robot.nv))
        yield f"at state {i} of seed {seed}", q, rng.uniform(-1.0, 1.0, robot.nv)


def _moved(robot: Robot, q: Array, v: Array, h: float) -> State:
    return robot.state(pin.integrate(robot.model, q, h * v), v, t=0.7)


def _ready(state: State, contacts: Mapping[str, Contact]) -> State:
    """What the controller fills in before it asks a task."""
    state.contacts = {name: contact.hold(state) for name, contact in contacts.items()}
    state.loops = {name: ForceLoop() for name in contacts}
    G = np.concatenate([np.zeros((0, state.v.size)), *(held.G for held in state.contacts.values())])
    K = mobility(state, G)
    state.primary = (G, inertia(K), K)
    return state


def _rank(rows: Array) -> int:
    return int(np.linalg.matrix_rank(rows)) if rows.size else 0


def _require(holds: bool, message: str) -> None:
    if not holds:
        raise AssertionError(message)


def _equal(what: str, where: str, got: int, expected: int) -> None:
    _require(got == expected, f"{what} {where}: expected {expected}, got {got}")


def _shaped(what: str, where: str, got: Array, shape: tuple[int, ...]) -> None:
    _require(np.shape(got) == shape, f"{what} {where}: expected shape {shape}, got {np.shape(got)}")
    _require(bool(np.isfinite(got).all()), f"{what} {where}: expected finite numbers, got {got}")


def _close(what: str, where: str, got: Array, expected: Array) -> None:
    error, bound = np.abs(got - expected).max(initial=0.0), TOLERANCE * (1.0 + np.abs(expected).max(initial=0.0))
    _require(error <= bound, f"{what} {where}: expected {expected}, got {got} ({error:.2g} off, {bound:.0e} allowed)")
