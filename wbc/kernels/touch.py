"""What a body of the plant does to what it touches: MuJoCo's contacts of a tick, added up."""

from __future__ import annotations

import math

from numba import types

from .compiled import INDICES, NOTHING, PAIRS, Array, F, Indices, M, V, compiled, m, v


@compiled(types.UniTuple(F, 2), INDICES, PAIRS, m, m, m, v, m, v, V)  # type: ignore[no-untyped-call]
def touch(
    inside: Indices,
    geoms: Indices,
    places: Array,
    axes: Array,
    forces: Array,
    mu: Array,
    R: Array,
    p: Array,
    out: Array,
) -> tuple[float, float]:
    """out (6,) += the wrench, at (R, p) and in its axes, of the geoms `inside` on those outside.

    `geoms` (n, 2), `places` (n, 3), `axes` (n, 9) rows of the contact's own axes, `forces` (n, 6) in these, force
    first, on the second geom; `mu` (n,). Answers how many carry a force along their normal, and their largest mu.
    """
    points, most = 0.0, 0.0
    for i in range(geoms.shape[0]):
        if inside[geoms[i, 0]] == inside[geoms[i, 1]]:
            continue
        if forces[i, 0] > 0.0:
            points, most = points + 1.0, max(most, mu[i])
        sign = 1.0 if inside[geoms[i, 0]] else -1.0
        x, y, z = places[i, 0] - p[0], places[i, 1] - p[1], places[i, 2] - p[2]
        fx, fy, fz, mx, my, mz = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        for k in range(3):
            f, c = sign * forces[i, k], sign * forces[i, 3 + k]
            fx, fy, fz = fx + f * axes[i, 3 * k], fy + f * axes[i, 3 * k + 1], fz + f * axes[i, 3 * k + 2]
            mx, my, mz = mx + c * axes[i, 3 * k], my + c * axes[i, 3 * k + 1], mz + c * axes[i, 3 * k + 2]
        mx, my, mz = mx + y * fz - z * fy, my + z * fx - x * fz, mz + x * fy - y * fx
        for k in range(3):
            out[k] += R[0, k] * mx + R[1, k] * my + R[2, k] * mz
            out[3 + k] += R[0, k] * fx + R[1, k] * fy + R[2, k] * fz
    return points, most


@compiled(NOTHING, INDICES, PAIRS, INDICES, m, m, m, m, m, M)
def slip(
    rows: Indices,
    geoms: Indices,
    bodies: Indices,
    places: Array,
    axes: Array,
    forces: Array,
    twists: Array,
    origins: Array,
    out: Array,
) -> None:
    """out[rows[geom]] = the velocity across its contact of a geom with a row, less that of what it touches.

    `rows` (geoms,), -1 of those without; `bodies` (geoms,) whose geom it is; `twists` (bodies, 6), angular part first,
    of the points of the bodies that are at `origins` (bodies, 3). Of several contacts of a geom the last one counts.
    """
    for i in range(geoms.shape[0]):
        first = rows[geoms[i, 0]] >= 0
        if first == (rows[geoms[i, 1]] >= 0) or forces[i, 0] <= 0.0:
            continue
        row, u0, u1, u2 = rows[geoms[i, 0 if first else 1]], 0.0, 0.0, 0.0
        for k in range(2):
            sign, b = (1.0 if (k == 0) == first else -1.0), bodies[geoms[i, k]]
            w0, w1, w2 = twists[b, 0], twists[b, 1], twists[b, 2]
            x, y, z = places[i, 0] - origins[b, 0], places[i, 1] - origins[b, 1], places[i, 2] - origins[b, 2]
            u0 += sign * (twists[b, 3] + w1 * z - w2 * y)
            u1 += sign * (twists[b, 4] + w2 * x - w0 * z)
            u2 += sign * (twists[b, 5] + w0 * y - w1 * x)
        along = axes[i, 0] * u0 + axes[i, 1] * u1 + axes[i, 2] * u2
        out[row, 0], out[row, 1] = u0 - along * axes[i, 0], u1 - along * axes[i, 1]
        out[row, 2] = u2 - along * axes[i, 2]


@compiled(F, v, v)
def angle(a: Array, b: Array) -> float:
    """Between two vectors (3,) [rad]."""
    x, y, z = a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]
    return math.atan2(math.sqrt(x * x + y * y + z * z), a[0] * b[0] + a[1] * b[1] + a[2] * b[2])
