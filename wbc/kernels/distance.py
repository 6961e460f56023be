"""Distances of the shapes that a robot is made of, with their first and second derivatives in time, compiled.

A shape is a core with a radius: a point (sphere), a segment (capsule) or a box. The core is given by its half lengths
along the axes of its frame, some of them zero. The distance of two cores is the least of

- a corner of one to the other core, and
- an edge of one to an edge of the other, where both nearest points lie inside their edges.

Each of these is a smooth function of the pose where it is positive, and they meet in value and gradient where one takes
over from another, as two parallel capsules that tilt. So what bounds all of them at once never jumps, while the nearest
points of the bodies do. One of them: nearest points x_1, x_2 on flat features with tangents u_k, r = x_2 - x_1,
n = r/|r|. They slide such that r stays perpendicular to every tangent, rdot . u_k + r . (w_k x u_k) = 0, which gives

    ddot = n . (v_2 - v_1),     dddot = n . (a_2 - a_1 + sum of w x slide) + ndot . (v_2 - v_1),     ndot = P_n rdot/|r|

with v, a of the material points under x_1, x_2; a is J vdot and what of it is not vdot's.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numba import njit, types
from numpy.typing import NDArray

from .compiled import COUNT, NOTHING, Array, F, M, _Function, compiled, m

Ints = NDArray[np.int64]
# in one piece, as all but a program's own storage is
_c, _n, _t = (types.Array(F, ndim, "C", readonly=True) for ndim in (1, 2, 3))
_C, _N, _T = (types.Array(F, ndim, "C") for ndim in (1, 2, 3))
_i1, _i2 = (types.Array(COUNT, ndim, "C", readonly=True) for ndim in (1, 2))
_I1, _I2 = (types.Array(COUNT, ndim, "C") for ndim in (1, 2))


def _inner(function: _Function) -> _Function:
    """Compiled into those that call it; a division by zero is infinite, and costs no branch."""
    inlined: Any = njit(cache=True, nogil=True, error_model="numpy")(function)
    return inlined


_NOTHING = 1e-9  # [m] half lengths and distances below this are none
_STILL = 1e-3  # [m/rad] distances that change by less with every joint are given
_PARALLEL = 0.0025  # squared sine of the angle between edges; nearer to parallel their ends say enough


@_inner
def _placed(poses: Array, joint: Ints, place: Array, R: Array, p: Array) -> None:
    """World poses of the shapes at `place` [R | p] of their joints; a row of `poses` is R by columns, then p."""
    for g in range(joint.size):
        pose = poses[joint[g]]
        for i in range(3):
            p[g, i] = pose[9 + i]
            for k in range(3):
                p[g, i] += pose[i + 3 * k] * place[g, k, 3]
                s = 0.0
                for l in range(3):
                    s += pose[i + 3 * l] * place[g, l, k]
                R[g, i, k] = s


@_inner
def _keep(
    d: float, stop: float, a: int, b: int, x: Array, y: Array, m: int, tangents: Array, owners: Ints,
    count: int, rank: Array, dist: Array, which: Ints, points: Array, along: Array,
) -> int:  # fmt: skip
    """Put one distance, of points x on shape a and y on b, into the list of the most urgent, sorted by what is left
    of it after the way to `stop`; how many it holds."""
    most = dist.size
    at = count
    while at > 0 and rank[at - 1] > d - stop:
        at -= 1
    if at >= most:
        return count
    for i in (at - 1, at):  # two corners: the same from both sides
        same = 0 <= i < count and which[i, 0] == a and which[i, 1] == b and which[i, 2] == m
        if same and abs(points[i, 0, 0] - x[0]) + abs(points[i, 1, 2] - y[2]) + abs(dist[i] - d) < _NOTHING:
            return count
    count = min(count + 1, most)
    for i in range(count - 1, at, -1):
        rank[i], dist[i] = rank[i - 1], dist[i - 1]
        for k in range(5):
            which[i, k] = which[i - 1, k]
        for k in range(3):
            points[i, 0, k], points[i, 1, k] = points[i - 1, 0, k], points[i - 1, 1, k]
            along[i, 0, k], along[i, 1, k] = along[i - 1, 0, k], along[i - 1, 1, k]
    rank[at], dist[at] = d - stop, d
    which[at, 0], which[at, 1], which[at, 2] = a, b, m
    which[at, 3], which[at, 4] = owners[0], owners[1]
    for k in range(3):
        points[at, 0, k], points[at, 1, k] = x[k], y[k]
        along[at, 0, k], along[at, 1, k] = tangents[0, k], tangents[1, k]
    return count


@_inner
def _corners(
    a: int, b: int, first: int, R: Array, p: Array, half: Array, radius: float, reach: float, stop: float,
    count: int, rank: Array, dist: Array, which: Ints, points: Array, along: Array,
) -> int:  # fmt: skip
    """Corners of core a against core b; `first` is 0 where a is the first of the pair, 1 where it is the second.

    Inside of a box it is the depth below the nearest face, with the sign turned."""
    v, y, at = np.empty(3), np.empty(3), np.empty(3)
    tangents, owners = np.empty((2, 3)), np.empty(2, np.int64)
    for corner in range(8):
        skip = False
        for k in range(3):
            v[k] = p[a, k]
        for axis in range(3):
            turned = (corner >> axis) & 1
            if half[a, axis] < _NOTHING:
                skip = skip or turned == 1
                continue
            sign = 1.0 - 2.0 * turned
            for k in range(3):
                v[k] += sign * half[a, axis] * R[a, k, axis]
        if skip:
            continue
        m, shallow, depth = 0, -1, math.inf
        for axis in range(3):
            at[axis] = 0.0
            for k in range(3):
                at[axis] += R[b, k, axis] * (v[k] - p[b, k])
            h = half[b, axis]
            if -h < at[axis] < h:
                m += 1
                if h - abs(at[axis]) < depth:
                    shallow, depth = axis, h - abs(at[axis])
        inside, m = m == 3, 0
        for k in range(3):
            y[k] = p[b, k]
        for axis in range(3):
            h = half[b, axis]
            if -h < at[axis] < h and not (inside and axis == shallow):
                owners[m] = 1 - first
                for k in range(3):
                    tangents[m, k] = R[b, k, axis]
                m += 1
            else:
                at[axis] = h if at[axis] > 0.0 else -h
            for k in range(3):
                y[k] += at[axis] * R[b, k, axis]
        square = 0.0
        for k in range(3):
            square += (y[k] - v[k]) ** 2
        d = -math.sqrt(square) if inside else math.sqrt(square)
        if abs(d) < _NOTHING or d - radius > reach:
            continue
        if first == 0:
            count = _keep(d - radius, stop, a, b, v, y, m, tangents, owners, count, rank, dist, which, points, along)
        else:
            count = _keep(d - radius, stop, b, a, y, v, m, tangents, owners, count, rank, dist, which, points, along)
    return count


@_inner
def _edges(
    a: int, b: int, R: Array, p: Array, half: Array, radius: float, reach: float, stop: float,
    count: int, rank: Array, dist: Array, which: Ints, points: Array, along: Array,
) -> int:  # fmt: skip
    """Edges of core a against edges of core b, where both nearest points are inside."""
    x, y = np.empty(3), np.empty(3)
    tangents, owners = np.empty((2, 3)), np.array((0, 1), np.int64)
    for i in range(3):
        if half[a, i] < _NOTHING:
            continue
        for j in range(3):
            if half[b, j] < _NOTHING:
                continue
            c = 0.0
            for k in range(3):
                c += R[a, k, i] * R[b, k, j]
                tangents[0, k], tangents[1, k] = R[a, k, i], R[b, k, j]
            sine = 1.0 - c * c
            if sine < _PARALLEL:
                continue
            i1, i2, j1, j2 = (i + 1) % 3, (i + 2) % 3, (j + 1) % 3, (j + 2) % 3
            for edge in range(16):
                s1, s2 = 1.0 - 2.0 * (edge & 1), 1.0 - 2.0 * ((edge >> 1) & 1)
                t1, t2 = 1.0 - 2.0 * ((edge >> 2) & 1), 1.0 - 2.0 * ((edge >> 3) & 1)
                if (half[a, i1] < _NOTHING and s1 < 0.0) or (half[a, i2] < _NOTHING and s2 < 0.0):
                    continue
                if (half[b, j1] < _NOTHING and t1 < 0.0) or (half[b, j2] < _NOTHING and t2 < 0.0):
                    continue
                ra, rb = 0.0, 0.0
                for k in range(3):
                    x[k] = p[a, k] + s1 * half[a, i1] * R[a, k, i1] + s2 * half[a, i2] * R[a, k, i2]
                    y[k] = p[b, k] + t1 * half[b, j1] * R[b, k, j1] + t2 * half[b, j2] * R[b, k, j2]
                    ra += (y[k] - x[k]) * R[a, k, i]
                    rb += (y[k] - x[k]) * R[b, k, j]
                s, t = (ra - c * rb) / sine, (c * ra - rb) / sine
                if not (abs(s) < half[a, i] and abs(t) < half[b, j]):
                    continue
                square = 0.0
                for k in range(3):
                    x[k] += s * R[a, k, i]
                    y[k] += t * R[b, k, j]
                    square += (y[k] - x[k]) ** 2
                d = math.sqrt(square)
                if d < _NOTHING or d - radius > reach:
                    continue
                count = _keep(
                    d - radius, stop, a, b, x, y, 2, tangents, owners, count, rank, dist, which, points, along
                )
    return count


@_inner
def _pair(
    a: int, b: int, R: Array, p: Array, half: Array, radius: Array, reach: float, stop: float,
    count: int, rank: Array, dist: Array, which: Ints, points: Array, along: Array,
) -> int:  # fmt: skip
    """All distances of one pair of shapes that are within reach."""
    both = radius[a] + radius[b]
    point_a = half[a, 0] + half[a, 1] + half[a, 2] < _NOTHING
    point_b = half[b, 0] + half[b, 1] + half[b, 2] < _NOTHING
    if point_a or not point_b:  # of a point and a core the point says all
        count = _corners(a, b, 0, R, p, half, both, reach, stop, count, rank, dist, which, points, along)
    if not point_a:
        count = _corners(b, a, 1, R, p, half, both, reach, stop, count, rank, dist, which, points, along)
        if not point_b:
            count = _edges(a, b, R, p, half, both, reach, stop, count, rank, dist, which, points, along)
    return count


@_inner
def _sticks(R: Array, p: Array, half: Array, radius: Array, ends: Array, around: Array) -> None:
    """A capsule about every shape: both ends of its segment, and its radius."""
    for g in range(radius.size):
        axis = 0
        for k in range(1, 3):
            if half[g, k] > half[g, axis]:
                axis = k
        across = 0.0
        for k in range(3):
            ends[g, 0, k] = p[g, k] - half[g, axis] * R[g, k, axis]
            ends[g, 1, k] = p[g, k] + half[g, axis] * R[g, k, axis]
            if k != axis:
                across += half[g, k] * half[g, k]
        around[g] = radius[g] + math.sqrt(across)


@_inner
def _between(a: int, b: int, ends: Array) -> float:
    """Distance of two segments (Ericson 2005, Real-Time Collision Detection, 5.1.9)."""
    aa, bb, ab, ar, br, rr = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for k in range(3):
        u, v = ends[a, 1, k] - ends[a, 0, k], ends[b, 1, k] - ends[b, 0, k]
        r = ends[a, 0, k] - ends[b, 0, k]
        aa, bb, ab = aa + u * u, bb + v * v, ab + u * v
        ar, br, rr = ar + u * r, br + v * r, rr + r * r
    s = 0.0
    if aa > 0.0:
        det = aa * bb - ab * ab
        s = min(max((ab * br - ar * bb) / det, 0.0), 1.0) if det > 1e-12 * aa * bb else 0.0
    t = (ab * s + br) / bb if bb > 0.0 else 0.0
    if not 0.0 <= t <= 1.0 or bb == 0.0:
        t = min(max(t, 0.0), 1.0)
        s = min(max((t * ab - ar) / aa, 0.0), 1.0) if aa > 0.0 else 0.0
    square = rr + s * s * aa + t * t * bb - 2.0 * s * t * ab + 2.0 * s * ar - 2.0 * t * br
    return math.sqrt(max(square, 0.0))


@_inner
def _outside(a: int, b: int, R: Array, p: Array, half: Array) -> float:
    """How far the middle of b is outside of core a."""
    square = 0.0
    for axis in range(3):
        s = 0.0
        for k in range(3):
            s += R[a, k, axis] * (p[b, k] - p[a, k])
        square += max(abs(s) - half[a, axis], 0.0) ** 2
    return math.sqrt(square)


@compiled(NOTHING, _n, _i1, _t, _n, _c, _i2, F, _I1)
def meet(
    poses: Array, joint: Ints, place: Array, half: Array, radius: Array, pairs: Ints, reach: float, seen: Ints
) -> None:
    """Marks with 1 the pairs whose capsules about them are nearer than `reach` [m]."""
    n = joint.size
    R, p, ends, around = np.empty((n, 3, 3)), np.empty((n, 3)), np.empty((n, 2, 3)), np.empty(n)
    _placed(poses, joint, place, R, p)
    _sticks(R, p, half, radius, ends, around)
    for i in range(pairs.shape[0]):
        a, b = pairs[i, 0], pairs[i, 1]
        if _between(a, b, ends) - around[a] - around[b] < reach:
            seen[i] = 1


@_inner
def _twists(joint: int, poses: Array, motions: Array, out: Array) -> None:
    """out (9,) = w, v of the world's axes at the joint's origin, and that origin; `motions` are (v, w) in its axes."""
    for i in range(3):
        out[i] = out[3 + i] = 0.0
        out[6 + i] = poses[joint, 9 + i]
        for k in range(3):
            out[i] += poses[joint, i + 3 * k] * motions[joint, 3 + k]
            out[3 + i] += poses[joint, i + 3 * k] * motions[joint, k]


@_inner
def _cross(a: Array, b: Array, out: Array) -> None:
    out[0] = a[1] * b[2] - a[2] * b[1]
    out[1] = a[2] * b[0] - a[0] * b[2]
    out[2] = a[0] * b[1] - a[1] * b[0]


@_inner
def _material(joint: int, x: Array, poses: Array, v: Array, a: Array, w: Array, vel: Array, acc: Array) -> None:
    """Angular velocity w, velocity and acceleration at vdot = 0 of the material point at x of a joint's body."""
    V, A, away, turn = np.empty(9), np.empty(9), np.empty(3), np.empty(3)
    _twists(joint, poses, v, V)
    _twists(joint, poses, a, A)
    for k in range(3):
        w[k] = V[k]
        away[k] = x[k] - V[6 + k]
    _cross(V[:3], away, turn)
    for k in range(3):
        vel[k] = V[3 + k] + turn[k]
    _cross(A[:3], away, turn)
    for k in range(3):
        acc[k] = A[3 + k] + turn[k]
    _cross(V[:3], vel, turn)  # from the spatial to the classical acceleration
    for k in range(3):
        acc[k] += turn[k]


@_inner
def _derivatives(
    x: Array, y: Array, length: float, m: int, tangents: Array, owners: Ints, joint_x: int, joint_y: int,
    poses: Array, v: Array, a: Array, n: Array,
) -> tuple[float, float]:  # fmt: skip
    """ddot, and what of dddot is not vdot's, of the distance of x and y, `length` n = y - x; n is filled."""
    w = np.empty((2, 3))
    v_x, v_y, a_x, a_y = np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    _material(joint_x, x, poses, v, a, w[0], v_x, a_x)
    _material(joint_y, y, poses, v, a, w[1], v_y, a_y)
    r, rel, rdot, turned = np.empty(3), np.empty(3), np.empty(3), np.empty((2, 3))
    for k in range(3):
        r[k] = y[k] - x[k]
        rel[k] = v_y[k] - v_x[k]
        rdot[k] = rel[k]
    lack, slide = np.zeros(2), np.zeros(2)
    for i in range(m):
        _cross(w[owners[i]], tangents[i], turned[i])
        for k in range(3):
            lack[i] -= rel[k] * tangents[i, k] + r[k] * turned[i, k]
    if m == 1:
        slide[0] = lack[0]
    elif m == 2:
        c = 0.0
        for k in range(3):
            c += tangents[0, k] * tangents[1, k]
        slide[0] = (lack[0] - c * lack[1]) / (1.0 - c * c)
        slide[1] = (lack[1] - c * lack[0]) / (1.0 - c * c)
    rate, drift = 0.0, 0.0
    for k in range(3):
        n[k] = r[k] / length
        rate += n[k] * rel[k]
        drift += n[k] * (a_y[k] - a_x[k])
        for i in range(m):
            rdot[k] += slide[i] * tangents[i, k]
            drift += n[k] * slide[i] * turned[i, k]
    for k in range(3):
        drift += (rdot[k] - n[k] * rate) / length * rel[k]
    return rate, drift


@compiled(COUNT, _n, _n, _n, m, _n, _c, _i1, _t, _n, _c, _c, _i2, _c, _C, _I2, _T, _T, _N, M)
def nearest(
    poses: Array, v: Array, a: Array, J: Array, moves: Array, idle: Array, joint: Ints, place: Array, half: Array,
    radius: Array, bound: Array, pairs: Ints, law: Array,
    dist: Array, which: Ints, points: Array, along: Array, told: Array, G: Array,
) -> int:  # fmt: skip
    """Gradients G of the most urgent distances, as many as there is room for; how many there are.

    `poses` (joints, 12): R by columns, then p; `v`, `a` (joints, 6): twists, and accelerations at vdot = 0, in the
    joints' axes, linear first; `J` (6, nv): the world's columns at its origin, linear first; `moves` (joints, nv): 1
    for those that move a joint; `idle` (nv,): a row that is not used. Shapes: joint, place [R | p], half lengths,
    radius, and the radius of a sphere about all of it. `law`: distance to keep, a, l, the way back, j, T, and the speed
    [m/s] beyond its own with which a pair is looked at. `told` (rows, 3): d, ddot and drift; d is infinite where a row
    is not used.
    """
    shapes, rows, nv = joint.size, dist.size, G.shape[1]
    R, p = np.empty((shapes, 3, 3)), np.empty((shapes, 3))
    ends, around, moving = np.empty((shapes, 2, 3)), np.empty(shapes), np.empty((shapes, 4))
    _placed(poses, joint, place, R, p)
    _sticks(R, p, half, radius, ends, around)
    margin, brake, lead, ahead = law[0], law[1], law[2], law[6]
    V = np.empty(9)
    for g in range(shapes):  # velocity of its middle, and what turning adds at most
        _twists(joint[g], poses, v, V)
        for k in range(3):
            k1, k2 = (k + 1) % 3, (k + 2) % 3
            moving[g, k] = V[3 + k] + V[k1] * (p[g, k2] - V[6 + k2]) - V[k2] * (p[g, k1] - V[6 + k1])
        moving[g, 3] = bound[g] * math.sqrt(V[0] ** 2 + V[1] ** 2 + V[2] ** 2)
    close, room, rank = 0, 4 * rows, np.empty(rows)
    gaps, order = np.empty((room, 3)), np.empty(room, np.int64)
    for i in range(pairs.shape[0]):
        first, second = pairs[i, 0], pairs[i, 1]
        speed, middle = 0.0, 0.0
        for k in range(3):
            speed += (moving[first, k] - moving[second, k]) ** 2
            middle += (p[first, k] - p[second, k]) ** 2
        speed = math.sqrt(speed) + moving[first, 3] + moving[second, 3]
        stop = ((speed + lead) ** 2 - lead * lead) / (2.0 * brake)  # w of it is that speed
        reach = margin + ((speed + ahead + lead) ** 2 - lead * lead) / (2.0 * brake)
        if math.sqrt(middle) - bound[first] - bound[second] > reach:
            continue
        gap = _between(first, second, ends) - around[first] - around[second]
        if gap < reach:  # a box says more than the capsule about it
            gap = max(gap, _outside(first, second, R, p, half) - radius[first] - bound[second])
            gap = max(gap, _outside(second, first, R, p, half) - radius[second] - bound[first])
        if gap < reach:
            at = close
            while at > 0 and gaps[at - 1, 0] > gap - stop:
                at -= 1
            close = min(close + 1, room)
            for k in range(close - 1, at, -1):
                gaps[k, 0], gaps[k, 1], gaps[k, 2], order[k] = (
                    gaps[k - 1, 0],
                    gaps[k - 1, 1],
                    gaps[k - 1, 2],
                    order[k - 1],
                )
            if at < room:
                gaps[at, 0], gaps[at, 1], gaps[at, 2], order[at] = gap - stop, reach, stop, i
    count = 0
    for i in range(close):  # the most urgent first; of what is less so than all that there is room for nothing is kept
        if count == rows and gaps[i, 0] >= rank[rows - 1]:
            break
        reach, stop = gaps[i, 1], gaps[i, 2]
        first, second = pairs[order[i], 0], pairs[order[i], 1]
        count = _pair(first, second, R, p, half, radius, reach, stop, count, rank, dist, which, points, along)
    n, moment_x, moment_y = np.empty(3), np.empty(3), np.empty(3)
    for i in range(rows):
        if i >= count:
            told[i, 0] = math.inf
            for j in range(nv):
                G[i, j] = idle[j]
            continue
        x, y = points[i, 0], points[i, 1]
        at_x, at_y = joint[which[i, 0]], joint[which[i, 1]]
        length = dist[i] + radius[which[i, 0]] + radius[which[i, 1]]
        rate, drift = _derivatives(x, y, length, which[i, 2], along[i], which[i, 3:5], at_x, at_y, poses, v, a, n)
        _cross(x, n, moment_x)
        _cross(y, n, moment_y)
        size = 0.0
        for j in range(nv):
            s = 0.0
            if moves[at_y, j] != moves[at_x, j]:
                for k in range(3):
                    s += moves[at_y, j] * (J[k, j] * n[k] + J[3 + k, j] * moment_y[k])
                    s -= moves[at_x, j] * (J[k, j] * n[k] + J[3 + k, j] * moment_x[k])
            G[i, j] = s
            size = max(size, abs(s))
        told[i, 0], told[i, 1], told[i, 2] = dist[i], rate, drift
        if size < _STILL:  # no joint moves these apart
            told[i, 0] = math.inf
            for j in range(nv):
                G[i, j] = idle[j]
    return count
