"""What theory predicts of errors put into a plant: a wrong mass, noise on the wrist sensor.

The plant's links weigh 1 + e of what the controller thinks, rotors do not. With M' its inertia, tau the torque of the
controller's own dynamics and F what it counts as known beside the truth, the motion and the multipliers it asked for
are missed by

    M' dvdot + G' dlam = dg = -e (tau - rotors) + J' dF,     G dvdot = 0

so that free axes are pulled off by J dvdot / kp, and forces pushed off by dlam, against which their loop works. The
sensor's driver takes the tool off for what it is not, at the acceleration that was asked for: dF_s. Of noise three
standard deviations count, through the linear loop that it runs in.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin

from wbc.log import Log
from wbc.material import invweight
from wbc.response import task_parts
from wbc.task.force import ForceTask
from wbc.task.impedance import AdmittanceTask, Compliance
from wbc.task.motion import MotionTask
from wbc.wrench import ForceSensor

EVERY = 10  # ticks from one evaluation of the slow errors to the next
SENSOR = "wrist_sensor"


class Astray(NamedTuple):
    """A tick: the state, contacts as held, and by what the plant misses what the controller thinks of it."""

    state: Any
    held: dict[str, Any]
    vdot: np.ndarray  # (nv,) true less asked [rad/s^2]
    lam: dict[str, np.ndarray]  # (k,) true less asked, by contact
    sensor: dict[str, np.ndarray]  # (6,) measured less true, at the frame of a contact or task
    solve: Any  # torque (nv,) -> vdot, lam of all contacts: what is pulled off and pushed by it


def astray(built: Any, log: Log, tick: int) -> Astray:
    """What a wrong mass does at a tick of a run."""
    robot, phase, e = built.robot, built.controller.phase, built.spec.plant.mass_error
    q, v, vdot = (log[key][tick] for key in ("q", "v", "vdot"))
    state = robot.state(q, v, t=float(log["t"][tick]))
    held = {name: contact.hold(state) for name, contact in phase.contacts.items()}
    rotors = robot.model.armature
    links = pin.rnea(robot.model, robot.model.createData(), q, v, vdot) - rotors * vdot
    M = state.M + e * (state.M - np.diag(rotors))
    G = np.vstack([np.zeros((0, v.size))] + [h.G for h in held.values()])
    push = np.vstack([np.zeros((0, v.size))] + [h.push for h in held.values()])
    reach = np.linalg.solve(M, push.T)

    def solve(torque: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        free = np.linalg.solve(M, torque)
        lam = np.linalg.solve(G @ reach, G @ free)
        return free - reach @ lam, lam

    sensor, nothing = ForceSensor(robot, SENSOR), np.zeros(6)
    frames, known = phase.feeling, np.zeros(v.size)
    for _ in range(2):  # what is fed forward moves the tool, of which the sensor feels a little
        off, lam = solve(known - e * links)
        real = -sensor.compensated(nothing, state, vdot + off).F * (1.0 + e)
        thought = -sensor.compensated(nothing, state, vdot + (off if phase.compliant else 0.0)).F
        error = {name: robot.wrench_map(SENSOR, frame) @ (real - thought) for name, frame in frames.items()}
        known = sum((fed(phase, state, held, name).T @ F for name, F in error.items()), np.zeros(v.size))
    parts = np.split(lam, np.cumsum([len(h.rhs) for h in held.values()])[:-1]) if held else []
    return Astray(state, held, off, dict(zip(held, parts, strict=True)), error, solve)


def fed(phase: Any, state: Any, held: dict[str, Any], name: str) -> np.ndarray:
    """(6, nv) K: a measured wrench F counts as known with the torque K' F."""
    if name in held:
        h = held[name]
        free = np.eye(6) - h.A.T @ h.inverse if name in phase.fed else np.zeros((6, 6))
        return free.T @ state.frame(h.frame).J
    task = phase.tasks[name]
    return task.carries * state.frame(task.frame).J


def noise(built: Any, frame: str) -> np.ndarray:
    """(6, 6) covariance of a measured wrench at a frame."""
    sigma, X = built.spec.plant.noise, built.robot.wrench_map(SENSOR, frame)
    return (X * ([sigma.moment**2] * 3 + [sigma.force**2] * 3)) @ X.T


def sampled(built: Any, log: Log) -> list[Astray]:
    """The slow errors of a run, every so many ticks."""
    return [astray(built, log, tick) for tick in range(0, log.size, EVERY)]


def pulled(built: Any, run: list[Astray], name: str, settle: float) -> float:
    """[m] |J dvdot| / kp along the free axes, rms, and three sigma of what noise that is fed forward moves them.

    White noise a on the acceleration moves x'' + kd x' + kp x = a by var x = var a dt/(2 kd kp).
    """
    phase, dt = built.controller.phase, built.controller.dt
    task = phase.tasks[name]
    assert isinstance(task, MotionTask)
    kp, kd, off, shaken = task.Kp.max(), task.Kd.max(), [], []
    for at in run[round(settle / dt / EVERY) :]:
        h, J = at.held[task.contact], at.state.frame(task.frame).J
        rows = h.free[h.free[:, 3:].any(axis=1)] @ J
        off.append(np.sum((rows @ at.vdot) ** 2))
        if task.contact in phase.fed and built.spec.plant.noise.force:
            K = fed(phase, at.state, at.held, task.contact)
            per = rows @ np.column_stack([at.solve(row)[0] for row in K])
            shaken.append(np.trace(per @ noise(built, task.frame) @ per.T))
    still = np.mean(shaken) * dt / (2 * kd * kp) if shaken else 0.0
    return float(np.sqrt(np.mean(off)) / kp + 3.0 * np.sqrt(still))


class Loop(NamedTuple):
    """A force loop at a contact as MuJoCo has it, linear: z = (x, v, f, s, I), k of each, from tick to tick.

    x and v: how far, and how fast, the contact gives way; f = (W + R)^-1 (W u + b v + k x), W the mobility of the
    contact and R its regularisation; u: what the loop and a disturbance of the multipliers press with.
    """

    A: np.ndarray  # (5 k, 5 k)
    reads: np.ndarray  # (5 k, k) of an error of what is measured
    presses: np.ndarray  # (5 k, k) of a disturbance


def force_loop(built: Any, task: ForceTask, at: Astray) -> Loop:
    """The loop of a task at a state."""
    dt, h = built.controller.dt, at.held[task.contact]
    alpha, k = task.smoothing(dt), len(h.rhs)
    W = h.G @ at.state.solve_M(h.push.T)
    R, stiffness, damping = gives_way(built.robot.mujoco, k)

    def step(z: np.ndarray, read: np.ndarray, press: np.ndarray) -> np.ndarray:
        x, v, f, s, integral = np.split(z, 5)
        s = (1.0 - alpha) * s + alpha * (f + read)
        u = press - task.Kp @ s + task.Ki @ integral - task.K_damp @ v
        f = np.linalg.solve(W + R, W @ u + damping * v + stiffness * x)
        v = v + dt * (W @ (u - f))
        return np.concatenate((x + dt * v, v, f, s, integral - dt * s))

    none, each = np.zeros((k, 5 * k)), np.eye(k)
    still, nothing = np.zeros((5 * k, k)), np.zeros((k, k))
    return Loop(step(np.eye(5 * k), none, none), step(still, each, nothing), step(still, nothing, each))


def gives_way(model: Any, k: int) -> tuple[np.ndarray, float, float]:
    """R (k, k) [1/kg], k [1/s^2] and b [1/s] of the one thing in a scene that is touched (MuJoCo, Computation).

    R = (1 - d)/d w of a point, w the inverse inertia of the body at it; points at P [mx, my, fz] share a force.
    """
    if model.neq:  # what is welded does not give way
        return np.zeros((k, k)), 0.0, 0.0
    tips = [geom for geom in range(model.ngeom) if model.geom_contype[geom] == 1 and model.geom_conaffinity[geom] == 2]
    ground = next(geom for geom in range(model.ngeom) if model.geom_contype[geom] == 2)
    if model.npair:
        (time, ratio), (d, most), w = model.pair_solref[0], model.pair_solimp[0][:2], invweight(model, 0)
    else:
        (time, ratio), (d, most) = model.geom_solref[ground], model.geom_solimp[ground][:2]
        w = model.body_invweight0[model.geom_bodyid[tips[0]], 0]
    place = model.geom_pos[tips] - model.geom_pos[tips].mean(axis=0)
    P = np.column_stack((-place[:, 1], -place[:, 0], np.ones(len(tips))))[:, {1: [2], 2: [1, 2], 3: [0, 1, 2]}[k]]
    return (1.0 - d) / d * w * np.linalg.inv(P.T @ P), d / (most * time * ratio) ** 2, 2.0 / (most * time)


def pressed(built: Any, run: list[Astray], contact: str, settle: float) -> dict[str, tuple[float, float, float]]:
    """Axis -> what a wrong mass leaves in its force, rms and at most, and the sigma of what noise does [N, N m]."""
    phase, dt = built.controller.phase, built.controller.dt
    task = next(t for t in phase.tasks.values() if isinstance(t, ForceTask) and t.contact == contact)
    middle = run[len(run) // 2]
    loop, h, k = force_loop(built, task, middle), middle.held[contact], len(task.axes)
    z, left = np.zeros(5 * k), []
    for at in run:
        enter = loop.reads @ (at.held[contact].inverse @ at.sensor[contact]) + loop.presses @ at.lam[contact]
        for _ in range(EVERY):
            z = loop.A @ z + enter
            left.append(z[2 * k : 3 * k])
    late = np.array(left[round(settle / dt) :])
    fed_forward = fed(phase, middle.state, middle.held, contact)
    direct = np.column_stack([middle.solve(row)[1] for row in fed_forward])  # of one contact a phase
    enter = loop.reads @ h.inverse + loop.presses @ direct  # noise (6,) -> loop
    P, power = enter @ noise(built, h.frame) @ enter.T, loop.A  # P = A P A' + Q, by doubling
    for _ in range(16):
        P, power = P + power @ P @ power.T, power @ power
    sigma = np.sqrt(P.diagonal()[2 * k : 3 * k])
    most, rms = np.abs(late).max(axis=0), np.sqrt(np.mean(late**2, axis=0))
    return {axis: (float(rms[i]), float(most[i]), float(sigma[i])) for i, axis in enumerate(task.axes)}


def rendered(
    built: Any, log: Log, run: list[Astray], name: str, settle: float
) -> tuple[dict[str, np.ndarray], dict[str, float]]:
    """What mass, damping and stiffness a push feels beside those asked for, and three sigma of it relative to them.

    The arm answers M xdd + B xd + K x = f + c, and least squares put c down to M, B and K. Wrong masses make
    c = -S dF + M S J dvdot; an arm that follows a moved mass by kp and kd adds what comes of S J dvdot later on. What
    noise n makes of c is linear in n; where it moves the arm at the same time, the fit is off on average as well.
    """
    task: Compliance = built.controller.phase.tasks[name]
    S, s, dt = task.selection(run[0].state), len(task.axes), built.controller.dt
    x, xd = log[f"{name}.displacement"], log[f"{name}.rate"]
    xdd = np.diff(log[f"{name}.twist"], axis=0) / dt - log[f"{name}.ahead"][:-1]
    ticks = np.arange(round(settle / dt), log.size - 2)
    R = np.hstack((xdd[ticks], xd[ticks], x[ticks]))
    all_ticks, some = np.arange(log.size), EVERY * np.arange(len(run))
    off, reads = (
        np.column_stack([np.interp(all_ticks, some, each) for each in np.array(values).T])
        for values in ([S @ at.state.frame(task.frame).J @ at.vdot for at in run], [-S @ at.sensor[name] for at in run])
    )
    fit = np.linalg.pinv(R)  # (3 s, ticks)
    felt = -(fit @ (reads + _answered(task, off, dt))[ticks])
    a, c = _of_noise(built, task, name, run[len(run) // 2])
    Sigma = noise(built, task.frame)
    felt -= np.linalg.inv(R.T @ R) @ (ticks.size * np.einsum("kai,ij,kcj->ac", a, Sigma, c))
    variance = np.empty((3 * s, s))
    for row, weights in enumerate(fit):  # the fit is off by sum_j h_j n_j
        for out in range(s):
            h = np.array([np.convolve(weights, c[::-1, out, j]) for j in range(6)])
            variance[row, out] = np.einsum("ik,ij,jk->", h, Sigma, h)
    figures = ("mass_error", "damping_error", "stiffness_error")
    parts = {figure: felt[i * s : (i + 1) * s].T for i, figure in enumerate(figures)}
    spread = {}
    for i, (figure, asked) in enumerate(zip(figures, task_parts(task), strict=True)):
        unit = 1.0 / np.sqrt(asked.diagonal())  # M, B and K are diagonal in the tour
        spread[figure] = 3.0 * float(np.linalg.norm(unit[:, None] * np.sqrt(variance[i * s : (i + 1) * s].T) * unit))
    return parts, spread


def _answered(task: Compliance, off: np.ndarray, dt: float) -> np.ndarray:
    """(N, s) M dxdd + B dxd + K dx of an arm whose acceleration is pulled off (N, s) from the mass that is rendered."""
    if not isinstance(task, AdmittanceTask):
        return off @ task.M.T  # nothing remembers: what is rendered is the arm itself
    c, x, v = np.empty_like(off), np.zeros(off.shape[1]), np.zeros(off.shape[1])
    for i, pull in enumerate(off):
        xdd = pull - task.Kp @ x - task.Kd @ v
        c[i] = task.M @ xdd + task.B @ v + task.K @ x
        v = v + dt * xdd
        x = x + dt * v
    return c


def _of_noise(built: Any, task: Compliance, name: str, at: Astray) -> tuple[np.ndarray, np.ndarray]:
    """(L, 3 s, 6) xdd, xd, x and (L, s, 6) c after a unit of noise in one tick."""
    S, s, dt = task.selection(at.state), len(task.axes), built.controller.dt
    fed_forward = fed(built.controller.phase, at.state, at.held, name)
    pull = S @ at.state.frame(task.frame).J @ np.column_stack([at.solve(row)[0] for row in fed_forward])
    ticks = 1 if not isinstance(task, AdmittanceTask) else 1000
    a, c = np.empty((ticks, 3 * s, 6)), np.empty((ticks, s, 6))
    off, push = np.zeros((ticks, s, 6)), np.zeros((ticks, s, 6))
    off[0], push[0] = pull, -S
    for j in range(6):
        c[:, :, j] = push[:, :, j] + _answered(task, off[:, :, j], dt)
    # the mass is moved by the push, the arm beside it by the pull
    inverse, x, v, e, ed = np.linalg.inv(task.M), *(np.zeros((s, 6)) for _ in range(4))
    follow = isinstance(task, AdmittanceTask)
    for i in range(ticks):
        xdd = inverse @ (push[i] - task.B @ v - task.K @ x)
        edd = off[i] - ((task.Kp @ e + task.Kd @ ed) if follow else 0.0)
        a[i] = np.concatenate((xdd + edd, v + ed, x + e))
        v, ed = v + dt * xdd, ed + dt * edd
        x, e = x + dt * v, e + dt * ed
    return a, c
