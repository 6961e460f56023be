"""Equations of motion: the affine map (vdot, lambda) -> tau that eliminates the torque, and inertias of row stacks.

tau = M vdot + bias + sum_c J_c' B_c lambda_c,     B_c = A_c' or, with modelled friction, A_c' + mu t n'
bias = h + J' F of the wrenches that are known
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from . import kernels
from .qp import Array, Rows
from .state import State

_NOTHING = np.empty((0, 0))


class TorqueMap(NamedTuple):
    """tau = sum_k A[k] x[k] + b over the named unknowns.

    Its rows stand in every problem, so `Workspace.product("torque", x) + b` is the torque of an answer.
    """

    A: dict[str, Array]
    b: Array  # (nv,) [N m]

    def rows(self, low: Array, high: Array, labels: tuple[str, ...] = ()) -> Rows:
        """low <= tau <= high [N m]."""
        return Rows("torque", self.A, low - self.b, high - self.b, labels=labels)

    def split(self, base: int) -> tuple[TorqueMap, TorqueMap]:
        """The first `base` equations, whose torque is zero, and those of the joints."""
        return TorqueMap({k: A[:base] for k, A in self.A.items()}, self.b[:base]), TorqueMap(
            {k: A[base:] for k, A in self.A.items()}, self.b[base:]
        )


def torque_map(state: State) -> TorqueMap:
    """The map at a state whose contacts are evaluated."""
    A = {"vdot": state.M}
    for name, held in state.contacts.items():
        A[name] = held.push.T
    return TorqueMap(A, state.bias)


def fill(state: State, rows: Rows) -> None:
    """Put the coefficients of the map in rows where they stand."""
    A: Any = rows.A
    A["vdot"][:] = state.M
    for name, held in state.contacts.items():
        A[name][:] = held.push.T


def mobility(state: State, G: Array) -> Array:
    """(m, m) G M^-1 G', the acceleration that unit forces along the rows of G cause."""
    K = np.empty(2 * G.shape[:1])
    kernels.mobility(state.M, G, _NOTHING, K)
    return K


def unheld(state: State, G: Array) -> Array:
    """(m, m) the same within the contacts of the state: what unit forces cause while the world holds on."""
    held = [each.G for each in state.contacts.values() if each.G.shape[0]]
    k = sum(each.shape[0] for each in held)
    W = mobility(state, np.concatenate([*held, G]))
    return np.asarray(W[k:, k:] - W[k:, :k] @ inertia(W[:k, :k]) @ W[:k, k:] if k else W)


def weighed(state: State, G: Array, b: Array) -> Rows:
    """Rows G vdot = b in the inertia that they show within the contacts; what these hold weighs nothing."""
    K = unheld(state, G)
    values, vectors = np.linalg.eigh(0.5 * (K + K.T))
    keep = values > 1e-9 * max(float(mobility(state, G).trace()), 1e-300)
    return Rows("", {"vdot": G}, b, b, (vectors[:, keep] / values[keep]) @ vectors[:, keep].T)


def gauss(state: State, G: Array, b: Array, vdot: Array) -> tuple[Rows, Array]:
    """Rows G vdot = b in their inertia, and an acceleration wanted in what they leave free, as one cost; and G M^-1 G'.

    By Gauss's principle, with G Gbar = I and N = I - Gbar G, both of weight one,

        |G x - b|^2_W + |N (x - vdot)|^2_M = |x - x*|^2_M,     x* = vdot + Gbar (b - G vdot),  Gbar = M^-1 G' W
    """
    m, n = G.shape
    x, K = np.empty(n), np.empty((m, m))
    if not kernels.gauss(state.M, G, b, vdot, x, K):
        x = vdot + state.solve_M(G.T.dot(inertia(K).dot(b - G.dot(vdot))))
    return Rows("", {"vdot": None}, x, x, state.M), K


def reaction(state: State, tau: Array) -> dict[str, Array]:
    """Multipliers (k,) by contact with which rigid contacts answer a torque (nv,), after (5) of the chapter:

    lambda = (G M^-1 G')^-1 (G M^-1 (tau - bias) + A Jdot v + Adot V)

    Where sliding friction is modelled its drag stands in the place of the second G.
    """
    held = state.contacts
    G = np.concatenate([np.zeros((0, tau.size)), *(each.G for each in held.values())])
    rhs = np.concatenate([np.zeros(0), *(each.rhs for each in held.values())])
    wanted = G.dot(state.solve_M((tau - state.bias)[:, None])[:, 0]) - rhs
    if any(each.push is not each.G for each in held.values()):
        push = np.concatenate([each.push for each in held.values()])
        answer = np.linalg.lstsq(G.dot(state.solve_M(push.T)), wanted, rcond=1e-10)[0]
    else:
        answer = inertia(mobility(state, G)).dot(wanted)
    lam, start = {}, 0
    for name, each in held.items():
        lam[name] = answer[start : start + each.rhs.size]
        start += each.rhs.size
    return lam


def inertia_within(K: Array, W: Array, first: int, m: int) -> Array:
    """(m, m) inertia of the rows `first` and on of those of a mobility K, while the first, of the inertia W, hold."""
    free, found = np.empty((m, m)), np.empty((m, m))
    return found if kernels.within(K, W, first, free, found) else inertia_of_what_moves(free)


def inertia(mobility_of_rows: Array) -> Array:
    """(m, m) inverse of a mobility: M_C of the rows (book 8.6). Directions that cannot move weigh nothing."""
    W = np.empty(mobility_of_rows.shape)
    return W if kernels.inverse(mobility_of_rows, W) else inertia_of_what_moves(mobility_of_rows)


def inertia_of_what_moves(mobility_of_rows: Array) -> Array:
    """The same of dependent rows (redundant contacts, a singular pose): the inverse of what can move."""
    values, vectors = np.linalg.eigh(mobility_of_rows)
    keep = values > 1e-10 * values.max()
    return (vectors[:, keep] / values[keep]) @ vectors[:, keep].T
