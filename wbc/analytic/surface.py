"""What a flat rectangle, or an edge, can carry that only pushes and rubs: its exact cone of wrenches, in closed form.

Forces at the four corners, each within the pyramid |fx|, |fy| <= mu fz, are equivalent to a wrench (m, f) in the middle
of a rectangle of half lengths a along x and b along y, z being the direction of the push. All such wrenches are, with
N = fz (S. Caron, Q.-C. Pham, Y. Nakamura, "Stability of surface contacts for humanoid robots: closed-form formulae of
the contact wrench cone for rectangular support areas", ICRA 2015),

    N >= 0,    |fx| <= mu N,   |fy| <= mu N,    |mx| <= b N,   |my| <= a N       push, friction, centre of pressure
    mz >= -mu (a + b) N + |b fx - mu mx| + |a fy - mu my|                        yaw
    mz <=  mu (a + b) N - |b fx + mu mx| - |a fy + mu my|

A straight edge along y, of half length b, takes forces anywhere between its ends. One at s is that at the ends in the
shares (b + s)/2b and (b - s)/2b, and its pyramid is convex: two forces f+, f- at the ends make every wrench. With
N = f+z + f-z, mx = b (f+z - f-z), fx = f+x + f-x, mz = -b (f+x - f-x) each end is told, and so are both pyramids;
fy alone can be shared at will, within the sum of what both ends hold. So the wrenches are, exactly,

    N >= 0,    |fy| <= mu N,    |b fx - mz| <= mu (b N + mx),    |b fx + mz| <= mu (b N - mx),    my = 0
"""

from __future__ import annotations

import itertools

import numpy as np

from .se3 import Array

PUSH, FRICTION, PRESSURE, YAW = slice(0, 1), slice(1, 5), slice(5, 9), slice(9, 17)  # rows of `surface_cone`
ALONG, ENDS = slice(1, 3), slice(3, 7)  # rows of `edge_cone`, after that of the push


def surface_cone(mu: float, a: float, b: float) -> Array:
    """Rows U (17, 6) with U F >= 0 for the wrenches F = (m, f) that the rectangle carries, a, b [m]; see the module.

    Give mu/sqrt(2) to stay within the round cone of mu at every corner.
    """
    N = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 1.0])
    mx, my, mz, fx, fy, _ = np.eye(6)
    rows = [N]
    rows += [mu * N - s * f for f in (fx, fy) for s in (1.0, -1.0)]
    rows += [b * N - s * mx for s in (1.0, -1.0)] + [a * N - s * my for s in (1.0, -1.0)]
    for s, t in itertools.product((1.0, -1.0), repeat=2):
        rows.append(mz + mu * (a + b) * N - s * (b * fx - mu * mx) - t * (a * fy - mu * my))
        rows.append(-mz + mu * (a + b) * N - s * (b * fx + mu * mx) - t * (a * fy + mu * my))
    return np.array(rows)


def edge_cone(mu: float, half: float, along: int = 1) -> Array:
    """Rows U (7, 6) with U F >= 0 for the wrenches F = (m, f) in the middle of an edge of 2 `half` [m]; see the module.

    `along`: 0 for an edge along x, 1 along y. The moment along the edge, which it cannot carry, has no row. Give
    mu/sqrt(2) to stay within the round cone of mu everywhere.
    """
    N = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 1.0])
    m, f, mz = np.eye(6)[:3], np.eye(6)[3:], np.eye(6)[2]
    side = 1.0 if along == 1 else -1.0  # a push at s along x makes -s about y, a force across it +s about z
    tilt, turn, across = side * m[1 - along], -side * mz, f[1 - along]  # s times the push, and times the force across
    rows = [N, *(mu * N - s * f[along] for s in (1.0, -1.0))]
    for end, s in itertools.product((1.0, -1.0), repeat=2):
        rows.append(mu * (half * N + end * tilt) - s * (half * across + end * turn))
    return np.array(rows)


def corner_forces_map(a: float, b: float) -> Array:
    """(6, 12) the wrench in the middle of the rectangle of forces (fx, fy, fz) at its corners (+-a, +-b)."""
    blocks = []
    for x, y in itertools.product((a, -a), (b, -b)):
        # m = (x, y, 0) x f
        blocks.append(np.array([[0, 0, y], [0, 0, -x], [-y, x, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], float))
    return np.hstack(blocks)
