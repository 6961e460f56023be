"""Frames, pose errors and where things are: poses (R, p), twists angular part first."""

from __future__ import annotations

import math

import numpy as np

from .compiled import COUNTS, NOTHING, TRUTH, Array, Counts, F, M, T, V, compiled, m, t, v


@compiled(NOTHING, COUNTS, m, m, COUNTS, t, m, m, v, T, M, T)
def frames(
    wanted: Counts, poses: Array, drifts: Array, joint: Counts, place: Array, moves: Array, J_0: Array, v: Array,
    R: Array, p: Array, table: Array,
) -> None:  # fmt: skip
    """The frames `wanted`, of all that sit at `place` = [R | p] (3, 4) of a joint each.

    R, p: their poses; table = [J | drift | J v] (6, n + 2) of their body twists, angular part first. Pinocchio's are
    `poses` (joints, 12) of joints, rotations by columns, their accelerations `drifts` (joints, 6) in their own axes and
    the columns `J_0` (6, n) in the world's axes and origin, linear part first; `moves` (n,) is 1 for those that count.
    """
    n = v.size
    for f in wanted:
        pose, a, at, S, T = poses[joint[f]], drifts[joint[f]], place[f], R[f], table[f]
        for i in range(3):
            p[f, i] = pose[9 + i]
            for j in range(3):
                p[f, i] += pose[3 * j + i] * at[j, 3]
                S[i, j] = 0.0
                for k in range(3):
                    S[i, j] += pose[3 * k + i] * at[k, j]
        x, y, z = p[f, 0], p[f, 1], p[f, 2]
        for i in range(6):
            T[i, n + 1] = 0.0
        for j in range(n):
            if moves[f, j] == 0.0:
                for i in range(6):
                    T[i, j] = 0.0
                continue
            w0, w1, w2 = J_0[3, j], J_0[4, j], J_0[5, j]
            v0 = J_0[0, j] + w1 * z - w2 * y
            v1 = J_0[1, j] + w2 * x - w0 * z
            v2 = J_0[2, j] + w0 * y - w1 * x
            for i in range(3):
                T[i, j] = S[0, i] * w0 + S[1, i] * w1 + S[2, i] * w2
                T[3 + i, j] = S[0, i] * v0 + S[1, i] * v1 + S[2, i] * v2
            for i in range(6):
                T[i, n + 1] += T[i, j] * v[j]
        x, y, z = at[0, 3], at[1, 3], at[2, 3]
        b0 = a[0] + a[4] * z - a[5] * y
        b1 = a[1] + a[5] * x - a[3] * z
        b2 = a[2] + a[3] * y - a[4] * x
        for i in range(3):
            T[i, n] = at[0, i] * a[3] + at[1, i] * a[4] + at[2, i] * a[5]
            T[3 + i, n] = at[0, i] * b0 + at[1, i] * b1 + at[2, i] * b2


@compiled(NOTHING, m, v, m, m, v, m, M, V, M)
def relative(
    R_a: Array, p_a: Array, table_a: Array, R_b: Array, p_b: Array, table_b: Array, R: Array, p: Array, table: Array
) -> None:
    """A frame a seen from b: R = R_b' R_a, p = R_b' (p_a - p_b), and table = table_a - Ad table_b, Ad = Ad_{T^-1}.

    Its drifts, of the column before the last, have ad_V (Ad V_b) beside, V the twist in the last column.
    """
    for i in range(3):
        p[i] = 0.0
        for k in range(3):
            p[i] += R_b[k, i] * (p_a[k] - p_b[k])
        for j in range(3):
            R[i, j] = R_b[0, i] * R_a[0, j] + R_b[1, i] * R_a[1, j] + R_b[2, i] * R_a[2, j]
    x, y, z, last = p[0], p[1], p[2], table.shape[1] - 1
    for j in range(last + 1):
        w0, w1, w2 = table_b[0, j], table_b[1, j], table_b[2, j]
        v0 = table_b[3, j] + w1 * z - w2 * y
        v1 = table_b[4, j] + w2 * x - w0 * z
        v2 = table_b[5, j] + w0 * y - w1 * x
        for i in range(3):
            table[i, j] = table_a[i, j] - (R[0, i] * w0 + R[1, i] * w1 + R[2, i] * w2)
            table[3 + i, j] = table_a[3 + i, j] - (R[0, i] * v0 + R[1, i] * v1 + R[2, i] * v2)
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        wj, wk, vj, vk = table[j, last], table[k, last], table[3 + j, last], table[3 + k, last]
        # Ad V_b is what table has less than table_a
        cj, ck = table_a[j, last] - wj, table_a[k, last] - wk
        dj, dk = table_a[3 + j, last] - vj, table_a[3 + k, last] - vk
        table[i, last - 1] += wj * ck - wk * cj
        table[3 + i, last - 1] += wj * dk - wk * dj + vj * ck - vk * cj


@compiled(NOTHING, m, *9 * [F], V, M)
def shift(
    place: Array,
    x: float,
    vx: float,
    ax: float,
    y: float,
    vy: float,
    ay: float,
    z: float,
    vz: float,
    az: float,
    p: Array,
    motion: Array,
) -> None:
    """p = R (x, y, z) + p_0 of place = [R | p_0]; motion (6, 2) = the linear velocity and acceleration."""
    for i in range(3):
        p[i] = place[i, 0] * x + place[i, 1] * y + place[i, 2] * z + place[i, 3]
        motion[i, 0] = motion[i, 1] = 0.0
    motion[3, 0], motion[4, 0], motion[5, 0] = vx, vy, vz
    motion[3, 1], motion[4, 1], motion[5, 1] = ax, ay, az


@compiled(NOTHING, m, v, V)
def log(R: Array, p: Array, X: Array) -> None:
    """X (6,) with exp [X] = (R, p), angular part first (book 3.92), by way of the quaternion: exact for any angle."""
    big, trace = 0, R[0, 0] + R[1, 1] + R[2, 2]
    for i in range(1, 3):
        if R[i, i] > R[big, big]:
            big = i
    q = np.empty(3)
    if trace > R[big, big]:
        root = math.sqrt(1.0 + trace)
        c = 0.5 * root
        for i in range(3):
            q[i] = (R[(i + 2) % 3, (i + 1) % 3] - R[(i + 1) % 3, (i + 2) % 3]) * 0.5 / root
    else:
        i, j, k = big, (big + 1) % 3, (big + 2) % 3
        root = math.sqrt(1.0 + R[i, i] - R[j, j] - R[k, k])
        q[i] = 0.5 * root
        q[j] = (R[j, i] + R[i, j]) * 0.5 / root
        q[k] = (R[k, i] + R[i, k]) * 0.5 / root
        c = (R[k, j] - R[j, k]) * 0.5 / root
    sine = math.sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2])
    if c < 0.0:  # the shorter way round
        c, q[0], q[1], q[2] = -c, -q[0], -q[1], -q[2]
    angle = 2.0 * math.atan2(sine, c)
    scale = angle / sine if sine > 1e-8 else 2.0 / c
    square = angle * angle
    if angle < 0.1:
        beta = 1.0 / 12.0 + square * (1.0 / 720.0 + square * (1.0 / 30240.0 + square / 1209600.0))
    else:
        beta = (1.0 - 0.5 * angle * c / sine) / square
    for i in range(3):
        X[i] = scale * q[i]
    a = X[1] * p[2] - X[2] * p[1], X[2] * p[0] - X[0] * p[2], X[0] * p[1] - X[1] * p[0]
    X[3] = p[0] - 0.5 * a[0] + beta * (X[1] * a[2] - X[2] * a[1])
    X[4] = p[1] - 0.5 * a[1] + beta * (X[2] * a[0] - X[0] * a[2])
    X[5] = p[2] - 0.5 * a[2] + beta * (X[0] * a[1] - X[1] * a[0])


@compiled(NOTHING, m, v, v, m, v, m, TRUTH, V, V, V)
def pose_errors(
    R: Array,
    p: Array,
    V: Array,
    R_d: Array,
    p_d: Array,
    motion: Array,
    split: bool,
    X_e: Array,
    V_e: Array,
    ahead: Array,
) -> None:
    """X_e, V_e and d/dt(Ad V_d) of a frame at (R, p) that moves with V; `motion` = [V_d | Vdot_d]."""
    E, e, V_d = np.empty((3, 3)), np.empty(3), np.empty(6)
    for i in range(3):
        e[i] = 0.0
        for k in range(3):
            e[i] += R[k, i] * (p_d[k] - p[k])
        for j in range(3):
            E[i, j] = R[0, i] * R_d[0, j] + R[1, i] * R_d[1, j] + R[2, i] * R_d[2, j]
    log(E, e, X_e)
    for i in range(3):
        V_d[i] = V_d[3 + i] = ahead[i] = ahead[3 + i] = 0.0
        for k in range(3):
            V_d[i] += E[i, k] * motion[k, 0]
            V_d[3 + i] += E[i, k] * motion[3 + k, 0]
            ahead[i] += E[i, k] * motion[k, 1]
            ahead[3 + i] += E[i, k] * motion[3 + k, 1]
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        if split:  # the straight way, and the acceleration of the origin less what the frame turns
            X_e[3 + i] = e[i]
            ahead[3 + i] += V_d[j] * V_d[3 + k] - V_d[k] * V_d[3 + j] - (V[j] * V[3 + k] - V[k] * V[3 + j])
        else:
            ahead[3 + i] += e[j] * ahead[k] - e[k] * ahead[j]
    if not split:
        for i in range(3):
            j, k = (i + 1) % 3, (i + 2) % 3
            V_d[3 + i] += e[j] * V_d[k] - e[k] * V_d[j]
        for i in range(3):
            j, k = (i + 1) % 3, (i + 2) % 3
            turned = V[j] * V_d[3 + k] - V[k] * V_d[3 + j]
            ahead[3 + i] -= turned + V[3 + j] * V_d[k] - V[3 + k] * V_d[j]
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        ahead[i] -= V[j] * V_d[k] - V[k] * V_d[j]
    for i in range(6):
        V_e[i] = V_d[i] - V[i]


@compiled(NOTHING, m, v, v, m, v, m, m, V)
def computed_torque(R: Array, p: Array, V: Array, R_d: Array, p_d: Array, motion: Array, K: Array, y: Array) -> None:
    """y = d/dt(Ad V_d) + [Kp, Kd] (X_e, V_e) of a frame at (R, p)."""
    X_e, V_e = np.empty(6), np.empty(6)
    pose_errors(R, p, V, R_d, p_d, motion, False, X_e, V_e, y)
    for i in range(6):
        for j in range(6):
            y[i] += K[i, j] * X_e[j] + K[i, 6 + j] * V_e[j]


@compiled(NOTHING, m, v, m, v, m, v, v, m, V)
def point_target(
    R: Array, p: Array, motion: Array, c: Array, J: Array, v: Array, drift: Array, K: Array, b: Array
) -> None:
    """b = pddot + [Kp, Kd] (p - c, pdot - J v) - drift of a point that follows p, which moves as `motion` in axes R."""
    w0, w1, w2 = motion[0, 0], motion[1, 0], motion[2, 0]
    u0, u1, u2 = motion[3, 0], motion[4, 0], motion[5, 0]
    a = (motion[3, 1] + w1 * u2 - w2 * u1, motion[4, 1] + w2 * u0 - w0 * u2, motion[5, 1] + w0 * u1 - w1 * u0)
    e = np.empty(6)
    for i in range(3):
        e[i] = p[i] - c[i]
        e[3 + i] = R[i, 0] * u0 + R[i, 1] * u1 + R[i, 2] * u2
        for j in range(v.size):
            e[3 + i] -= J[i, j] * v[j]
        b[i] = R[i, 0] * a[0] + R[i, 1] * a[1] + R[i, 2] * a[2] - drift[i]
    for i in range(3):
        for j in range(6):
            b[i] += K[i, j] * e[j]


@compiled(NOTHING, m, v, v, F, V)
def carried_along(R: Array, h: Array, g: Array, mass: float, drift: Array) -> None:
    """drift = R f / mass + g, with the force f of a base's first three equations h = (f, ...) in its axes."""
    for i in range(3):
        drift[i] = (R[i, 0] * h[0] + R[i, 1] * h[1] + R[i, 2] * h[2]) / mass + g[i]
