"""Near a singularity a task asks only for what the robot can still do: damped along the directions that it loses.

With the singular values s_i and left singular vectors u_i of a task's rows G in what the contacts leave free, the
target b of G vdot = b gives way, for every s_i below s_0, along u_i to what happens without the task:

    u_i' b  becomes  u_i' r + (s_i / s_0)^2 u_i' (b - r),      r = G vdot_c,

vdot_c being what postures (where there are none, a soft pull back to the start) and contacts make of vdot. Above s_0
nothing is changed, to the bit. An acceleration that meets it along u_i is (s_i / s_0^2) u_i' (b - r) beyond vdot_c, at
most |b - r| / s_0: damped least squares whose factor s_0^2 - s_i^2 varies and acts on those directions alone (Nakamura,
Hanafusa 1986; Chiaverini 1997). At the singularity itself the joints do what they do in a null space, so that nothing
jumps there. Angles count as metres do: units are those of the rows, over rad/s and m/s of the joints.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin

from . import kernels
from .dynamics import inertia, mobility
from .qp import Array
from .state import State

LEAST = 0.03  # s_0, the singular value below which a task is damped
BACK = (25.0, 10.0)  # [1/s^2], [1/s] with which joints that no posture holds go back to the start
LOST = 1e-7  # of the largest: a direction that is none


class Threshold(NamedTuple):
    """s_0 of a task, 0 for none, and how many of its rows are independent at most: of an arm in a plane three."""

    least: float
    rank: int


def threshold(task: Any, start: State, hold: Callable[[State], None]) -> Threshold:
    """Of a task, at a state whose contacts are held, as `hold` does it. The law of the book is as it is printed."""
    least = 0.0 if getattr(task, "raw", False) else getattr(task, "singular", 0.0)
    G, first = rows(task, start)
    rank, wanted = _rank(G, first), min(len(G) - first, max(G.shape[1] - first, 0))
    rng = np.random.default_rng(0)
    for _ in range(3 if rank < wanted else 0):  # of a start that is singular, or a task of more than the robot has
        q = pin.integrate(start.robot.model, start.q, 0.1 * rng.uniform(-1.0, 1.0, start.v.size))
        state = start.robot.state(q, start.v)
        hold(state)
        rank = max(rank, _rank(*rows(task, state)))
    return Threshold(float(least), rank)


def rows(task: Any, state: State) -> tuple[Array, int]:
    """Rows of the contacts, then of the task, and how many the first are."""
    held = [each.G for each in state.contacts.values()]
    return np.concatenate([*held, task.target(state)[0]]), sum(map(len, held))


def smallest(task: Any, state: State, rank: int) -> float:
    """The smallest of the `rank` largest singular values of a task's rows in what the contacts leave free."""
    values = _values(*rows(task, state))
    return float(np.sort(values)[values.size - rank]) if rank else np.inf


def _rank(G: Array, first: int) -> int:
    values = _values(G, first)
    return int((values > LOST * values.max(initial=0.0)).sum())


def _values(G: Array, first: int) -> Array:
    r = len(G) - first
    values, U = np.empty(r), np.empty((r, r))
    kernels.singular(G, first, values, U)
    return values


def ease(
    state: State, G: Array, b: Array, first: int, law: Threshold, free: Callable[[State], Array]
) -> tuple[Array, float]:
    """Targets (first + r,) of the rows G, contacts first, and the smallest singular value where it is below s_0.

    Away from there they are those that were given, and infinity. `free`: (nv,) vdot without task and contacts.
    """
    if kernels.far(G, first, law.least):
        return b, np.inf
    r = b.size - first
    values, U = np.empty(r), np.empty((r, r))
    kernels.singular(G, first, values, U)
    order = np.argsort(values)[r - law.rank :]
    lost = order[values[order] < law.least]
    if not lost.size:
        return b, np.inf
    vdot, held = free(state), G[:first]
    if first:
        pull = inertia(mobility(state, held)).dot(b[:first] - held.dot(vdot))
        vdot = vdot + state.solve_M(held.T.dot(pull)[:, None])[:, 0]
    U, share = U[:, lost], (values[lost] / law.least) ** 2
    eased = b.copy()
    eased[first:] -= U.dot((1.0 - share) * U.T.dot(b[first:] - G[first:].dot(vdot)))
    return eased, float(values[lost[0]])
