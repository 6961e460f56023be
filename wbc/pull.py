"""What tasks ask for beyond what they get, and what is left to decide when all of them have had their say."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from .dynamics import inertia, weighed
from .hierarchy import shortest
from .qp import Array, Rows
from .task.force import ForceTask
from .task.posture import PostureTask

if TYPE_CHECKING:
    from .controller import Tick

OWN = "self_motion"  # the damping that a phase adds where nothing holds the null space


class Pull(NamedTuple):
    """A task at a tick: `residual` (m,), wanted less got, in its own units, and `torque` (nu,) [N m], what it would add
    to the torque if it were alone: that of the force which removes its residual (J' M_C (y - Vdot) of a motion, push'
    (lambda_d - lambda) of a force). Both are zero where it has its way."""

    name: str
    weight: float
    level: int
    residual: Array
    unit: str
    torque: Array

    @property
    def size(self) -> float:
        """Largest entry of the residual."""
        return float(np.abs(self.residual).max(initial=0.0))

    def as_json(self) -> dict[str, Any]:
        return self._asdict() | {"residual": self.residual.tolist(), "torque": self.torque.tolist()}


class Regulariser(NamedTuple):
    """`directions` of the unknowns that neither tasks nor active constraints decide, `by` what they are decided, and
    `torque` (nu,) [N m], that of the answer's part along them."""

    directions: int
    by: tuple[str, ...]
    torque: Array

    def as_json(self) -> dict[str, Any]:
        return {"directions": self.directions, "by": list(self.by), "torque": self.torque.tolist()}


def _rows(tick: Tick) -> dict[str, Rows]:
    """Each task's own rows and metric, without the contacts' that a program may join to them."""
    program, state = tick.program, tick.state
    G, W, K = state.primary
    if W.shape != K.shape:  # left out where the costs are one
        state.primary = (G, inertia(K), K)
    found = {}
    for name, task in program.phase.tasks.items():
        if isinstance(task, ForceTask):
            loop = state.loops[task.contact]
            metric = np.eye(loop.command.size)
            found[name] = Rows("", {task.contact: None}, loop.command, loop.command, metric)
        elif hasattr(task, "target") and not isinstance(task, PostureTask):
            found[name] = weighed(state, *task.target(state))
        else:
            found[name] = task.rows(state)
    return found


def pulls(tick: Tick) -> tuple[Pull, ...]:
    """Of all tasks of the phase."""
    program, state, slices = tick.program, tick.state, tick.program.last.variables.slices
    found = []
    for name, rows in _rows(tick).items():
        got, lo, hi = np.zeros(rows.lo.size), rows.lo, rows.hi
        for variable, A in rows.A.items():
            x = tick.solution.x[slices[variable]]
            got = got + (x if A is None else A.dot(x))
        residual = np.where(got < lo, lo - got, np.where(got > hi, hi - got, 0.0))
        if isinstance(program.phase.tasks[name], PostureTask) and rows.metric is not None:
            residual = state.solve_M(rows.metric.dot(residual)[:, None])[:, 0]  # what is in its own space
            rows = rows._replace(metric=state.M)
        torque, unit = np.zeros(state.v.size), "rad/s^2, m/s^2"
        if (A := rows.A.get("vdot", np.zeros((0, 0)))) is None or len(A):
            force = residual if rows.metric is None else rows.metric.dot(residual)
            torque = force if A is None else A.T.dot(force)
        carried = [each for each in rows.A if each in state.contacts]
        if carried:  # forces themselves, or the torque of them
            unit, torque = "N m, N", np.zeros(state.v.size)
            for each in carried:
                B = rows.A[each]
                lam = residual if B is None else np.linalg.pinv(B).dot(residual)
                torque = torque + state.contacts[each].push.T.dot(lam)
        weight = program.phase.weights.get(name, 1.0)
        found.append(Pull(name, weight, program.levels.get(name, 1), residual, unit, torque[state.robot.base :]))
    return tuple(found)


def decided(tick: Tick) -> Regulariser:
    """What is left when equalities, active limits and tasks have decided theirs."""
    program, workspace, state = tick.program, tick.program.last, tick.state
    n, slices, problem = workspace.variables.size, workspace.variables.slices, workspace.problem
    blocks = [problem.C[: problem.n_eq]]
    active = workspace.active(tick.solution.z)
    blocks += [np.eye(n)[[i for i in active if i < n]], problem.C[[i - n for i in active if i >= n]]]
    for name, rows in _rows(tick).items():
        if name == OWN:
            continue
        block = np.zeros((rows.lo.size, n))
        for variable, A in rows.A.items():
            block[:, slices[variable]] = np.eye(rows.lo.size) if A is None else A
        task = program.phase.tasks[name]
        if isinstance(task, PostureTask) and rows.metric is not None:
            block = rows.metric.dot(block)  # only in the null space of what stands above it
        blocks.append(block / max(np.abs(block).max(initial=0.0), 1e-300))
    for name in slices:
        if name.endswith(" yield"):
            blocks.append(np.eye(n)[slices[name]])
    C = np.concatenate(blocks)
    N = shortest(C, np.zeros(len(C)), 1e3)[1]  # its rank to 1e-6
    by = [OWN] if OWN in program.phase.tasks else []
    free = [name for name in state.contacts if np.abs(N[slices[name]]).max(initial=0.0) > 1e-6]
    by += [f"least {name}.lambda" for name in free]
    torque = workspace.coefficients("torque").dot(N.dot(N.T.dot(tick.solution.x)))
    return Regulariser(N.shape[1], tuple(by) if N.shape[1] else (), torque)
