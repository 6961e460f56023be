"""Random arms and matrices for the tests of the closed forms."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
import scipy.linalg

from wbc.analytic import Array

SIZES = [(r, n, k) for r in (3, 6) for n in (r, r + 1, 10) for k in range(r + 1)]
sizes = pytest.mark.parametrize(("r", "n", "k"), SIZES)


def spd(rng: np.random.Generator, n: int) -> Array:
    Q = np.linalg.qr(rng.normal(size=(n, n)))[0]
    return (Q * rng.uniform(0.3, 5.0, n)) @ Q.T


def full_rank(rng: np.random.Generator, m: int, n: int) -> Array:
    U, V = (np.linalg.qr(rng.normal(size=(i, i)))[0] for i in (m, n))
    return (U * rng.uniform(0.5, 2.0, m)) @ V[:m]


def pose(rng: np.random.Generator) -> Array:
    return scipy.linalg.expm(hat(rng.normal(size=6)))


def hat(V: Array) -> Array:
    """[V] (4, 4), spelled out."""
    (a, b, c), v = V[:3], V[3:]
    return np.array([[0, -c, b, v[0]], [c, 0, -a, v[1]], [-b, a, 0, v[2]], [0, 0, 0, 0]])


def tangent(A: Array) -> Array:
    """Columns (r, r - k): an orthonormal basis of the motions that A allows."""
    return np.linalg.svd(A)[2][len(A) :].T if len(A) else np.eye(A.shape[1])


def motion_axes(rng: np.random.Generator, A: Array) -> Array:
    """S (r - k, r) that completes A to a regular matrix, its rows neither unit nor orthogonal to those of A."""
    k, r = A.shape
    return full_rank(rng, r - k, r - k) @ tangent(A).T + 0.5 * rng.normal(size=(r - k, k)) @ A


@dataclass(frozen=True)
class Plant:
    """A rigidly constrained arm at one state; `react` solves its equations of motion whole, in joint space."""

    M: Array
    h: Array
    J: Array
    drift: Array
    A: Array
    Adot_V: Array

    @classmethod
    def random(cls, rng: np.random.Generator, r: int, n: int, k: int) -> Plant:
        h, drift, Adot_V = (rng.normal(size=i) for i in (n, r, k))
        return cls(spd(rng, n), 10 * h, full_rank(rng, r, n), drift, full_rank(rng, k, r), Adot_V)

    def react(self, tau: Array) -> tuple[Array, Array]:
        n, k = len(self.M), len(self.A)
        AJ = self.A @ self.J
        kkt = np.block([[self.M, AJ.T], [AJ, np.zeros((k, k))]])
        x = np.linalg.solve(kkt, np.concatenate([tau - self.h, -self.Adot_V - self.A @ self.drift]))
        return x[:n], x[n:]

    def twist_rate(self, vdot: Array) -> Array:
        return self.J @ vdot + self.drift

    @property
    def M_C(self) -> Array:
        return np.linalg.inv(self.J @ np.linalg.inv(self.M) @ self.J.T)

    @property
    def arm(self) -> tuple[Array, Array, Array, Array, Array]:
        return self.M, self.h, self.J, self.drift, self.A
