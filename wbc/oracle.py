"""The closed form of a phase at a state, from `wbc.analytic`: what `verify` holds the quadratic program against.

It shares with the controller only its inputs: gains, references, measured wrench, and the memory of filter and
integral; M, h, J may come from Pinocchio or from MuJoCo alone.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, Literal, NamedTuple

import numpy as np
import pinocchio as pin

from . import analytic
from .contact import Contact
from .memory import Memory
from .pair import movable
from .phase import Phase
from .qp import Array
from .reference import Sample
from .robot import Robot
from .state import State
from .task.force import ForceLoop, ForceTask
from .task.impedance import NEW, AdmittanceTask, Compliance, Felt
from .task.motion import MotionTask
from .task.posture import PostureTask
from .wrench import Wrench

Law = Literal["compensated", "book"]


class Dynamics(NamedTuple):
    """What the closed form needs of the robot at a state: M, h, g, and of the task frame J, drift, V and T (4, 4)."""

    M: Array
    h: Array
    J: Array
    drift: Array
    V: Array
    T: Array
    g: Array = np.zeros(0)  # asked for by impedance that compensates the weight alone


def closed_form(
    robot: Robot,
    phase: Phase,
    law: Law,
    state: State,
    dynamics: Callable[[str], Dynamics],
    memory: Memory,
    given: dict[str, Wrench],
) -> tuple[Array, Array, dict[str, Array]]:
    """Torque of the book's law, and the acceleration and multipliers with which a rigid contact answers it."""
    motions = motion_tasks(phase)
    compliant = phase.compliant
    frames = [task.frame for task in motions] + [task.frame for task in compliant.values()]
    frames += [contact.frame for contact in phase.contacts.values()]
    frames += [robot.frames[-1]]  # a posture alone has none
    known = np.zeros(robot.nv)
    for name in set(phase.fed) & set(given):
        contact = phase.contacts[name]
        known += _of(dynamics, contact).J.T @ _known(contact, state, given[name].F)
    felt = {name: _felt(task, name, state, memory, given) for name, task in compliant.items()}
    counted = [phase.contacts[name].frame for name in set(phase.fed) & set(given)]
    for name, task in compliant.items():
        F = felt[name].F
        if F is None or not task.carries or any(_one_link(robot, task.frame, frame) for frame in counted):
            continue
        counted.append(task.frame)
        on = [contact for contact in phase.contacts.values() if _one_link(robot, task.frame, contact.frame)]
        frame = on[0].frame if on else task.frame
        rows = [np.zeros((0, 6)), *(contact.A(state) @ _adjoint(dynamics, frame, contact.frame) for contact in on)]
        F = _adjoint(dynamics, frame, task.frame).T @ F
        known += dynamics(frame).J.T @ analytic.wrench_residual(np.concatenate(rows), F)
    dynamics = _loaded(dynamics, known, phase.gravity_only)
    base = dynamics(frames[0])
    vdot_posture = _posture(phase, state)
    commands = {name: _command(phase, name, law, state, dynamics, memory, given) for name in phase.contacts}
    held = {name: (contact.A(state), _of(dynamics, contact)) for name, contact in phase.contacts.items()}
    adot = {name: contact.Adot_V(state) for name, contact in phase.contacts.items()}
    rendered = [_compliance(phase, task, felt[name], state, dynamics, held) for name, task in compliant.items()]
    if len(motions) == 1 and len(held) == 1 and motions[0].contact in held and not rendered:
        tau = _hybrid(robot, phase, law, state, motions[0], held, adot, commands, dynamics, vdot_posture)
    else:
        tau = _stacked(phase, law, state, motions, held, adot, commands, dynamics, base, vdot_posture, rendered)
    reactions = {name: A.T for name, (A, _) in held.items()}
    for name, contact in phase.contacts.items():
        if contact.pushes is not None and contact.pushes.modelled:
            A, d = held[name]
            reactions[name] = _sliding_map(contact, state, A, d)
            pressed = _pressed(law if name in force_tasks(phase) else "compensated", A, d, commands[name], adot[name])
            tau = tau + analytic.sliding_torque(d.J, A, reactions[name], pressed)
    # what a rigid contact makes of that torque
    G = np.concatenate([np.zeros((0, robot.nv)), *(A @ d.J for A, d in held.values())])
    rhs = np.concatenate([np.zeros(0), *(-(held[n][0] @ held[n][1].drift + adot[n]) for n in held)])
    k = rhs.size
    push = np.concatenate([np.zeros((0, robot.nv)), *(reactions[name].T @ d.J for name, (_, d) in held.items())])
    answer = np.linalg.solve(np.block([[base.M, push.T], [G, np.zeros((k, k))]]), np.r_[tau - base.h, rhs])
    lam, start = {}, robot.nv
    for name, (A, _) in held.items():
        lam[name] = answer[start : start + A.shape[0]]
        start += A.shape[0]
    return tau, answer[: robot.nv], lam


def _of(dynamics: Callable[[str], Dynamics], contact: Contact) -> Dynamics:
    """The dynamics of a contact's frame; against another body those of the relative motion (chapter 3)."""
    d = dynamics(contact.frame)
    if contact.against is None:
        return d
    other = dynamics(contact.against)
    T = analytic.inverse(other.T) @ d.T
    Ad = analytic.adjoint(analytic.inverse(T))
    V = d.V - Ad @ other.V
    drift = d.drift - Ad @ other.drift + analytic.ad(V) @ Ad @ other.V
    return d._replace(J=d.J - Ad @ other.J, drift=drift, V=V, T=T)


def _posture(phase: Phase, state: State) -> Array:
    """(nv,) what postures ask for: in one metric several are one, at the mean that their weights make."""
    tasks = {name: task for name, task in phase.tasks.items() if isinstance(task, PostureTask)}
    total, weights = np.zeros(state.v.size), sum(phase.weights[name] for name in tasks)
    for name, task in tasks.items():
        total += phase.weights[name] / weights * (task.Kp @ (task.q - state.q) - task.Kd @ state.v)
    return total


def _one_link(robot: Robot, a: str, b: str) -> bool:
    """Whether no joint lies between two frames."""
    frames = robot.model.frames
    return bool(frames[robot.frame_id(a)].parentJoint == frames[robot.frame_id(b)].parentJoint)


def _adjoint(dynamics: Callable[[str], Dynamics], a: str, b: str) -> Array:
    """(6, 6) with V_b = Ad V_a for two frames of one link."""
    return analytic.adjoint(analytic.inverse(dynamics(b).T) @ dynamics(a).T)


def _loaded(dynamics: Callable[[str], Dynamics], known: Array, gravity_only: bool) -> Callable[[str], Dynamics]:
    """The same with h counting the torque of known wrenches, and of the arm's own all or its weight alone."""

    def of(name: str) -> Dynamics:
        d = dynamics(name)
        return d._replace(h=(d.g if gravity_only else d.h) + known)

    return of


def _known(contact: Contact, state: State, F: Array) -> Array:
    """(6,) the measured wrench along the free axes, its drag within the cone of the measured push."""
    free = analytic.wrench_residual(contact.A(state), F)
    if contact.pushes is None or not contact.pushes.mu:
        return free
    d, slides = _across(contact, state)
    return analytic.capped_friction(free, slides, contact.pushes.mu * float(d @ F[3:]))


def _across(contact: Contact, state: State) -> tuple[Array, Array]:
    """The direction of the push (3,) and those of sliding (s, 3), in the axes of the frame."""
    assert contact.pushes is not None
    turn = contact.turn(state)
    R = np.eye(3) if turn is None else turn
    return R @ contact.pushes.d, contact.pushes.slides @ R.T


def _sliding_map(contact: Contact, state: State, A: Array, dynamics: Dynamics) -> Array:
    """(6, k) B of a contact that slides, along its velocity or, at rest, along the desired one."""
    pushes = contact.pushes
    assert pushes is not None
    d, slides = _across(contact, state)
    v_d = np.zeros(3)
    if pushes.guide is not None:
        desired = pushes.guide(state)
        v_d = dynamics.T[:3, :3].T @ desired.T.rotation @ desired.V[3:]
    u = analytic.sliding_direction(slides @ dynamics.V[3:], slides @ v_d, pushes.slip)
    return analytic.sliding_map(A, d, u @ slides, pushes.mu)


def _pressed(law: Law, A: Array, d: Dynamics, F: Array, Adot_V: Array) -> Array:
    """(k,) the multipliers with which the law presses."""
    if law == "compensated":
        return analytic.multiplier_error(A, F)
    G = A @ d.J
    return analytic.dynamically_consistent_inverse(d.M, G).T @ d.J.T @ F + analytic.task_inertia(d.M, G) @ Adot_V


def _felt(task: Compliance, name: str, state: State, memory: Memory, given: dict[str, Wrench]) -> Felt:
    """What a task feels at this tick, from what it remembers of the last."""
    last = memory.felt.get(name, NEW)
    wrench = given.get(task.contact or name)
    return task.feel(state, None if wrench is None else wrench.at(state, task.frame), memory.tau, last)


def _compliance(
    phase: Phase, task: Compliance, felt: Felt, state: State, dynamics: Any, held: Any
) -> tuple[Array, Array, Array]:
    """Rows, target and drift of an impedance or admittance: the book's accelerations along the axes of the task."""
    d = dynamics(task.frame)
    S = task.selection(state) if task.contact is None else phase.contacts[task.contact].free(state)
    G = S @ d.J
    X_e, V_e, ahead = (S @ part for part in _errors(task, d.T, d.V, task.followed(state)))
    f_ext = np.zeros(len(S)) if felt.F is None else -np.linalg.pinv(S).T @ felt.F
    K, share = (task.wanted(state), 1.0) if felt.tank is None else (felt.tank.K, felt.tank.valve)
    if felt.tank is not None:
        ahead = ahead + felt.tank.brake * V_e
    if isinstance(task, AdmittanceTask) and not task.printed:
        assert felt.T is not None
        assert felt.motion is not None
        parts = _errors(task, d.T, d.V, Sample(pin.SE3(felt.T), felt.motion))
        X_e, V_e, ahead = (S @ part for part in parts)
        return G, ahead + task.Kp @ X_e + task.Kd @ V_e, S @ d.drift
    if not task.massless and task.source != "acceleration":
        return G, ahead + analytic.admittance_acceleration(task.M, task.B, K, share * f_ext, -V_e, -X_e), S @ d.drift
    rows = np.concatenate([np.zeros((0, d.h.size)), *(A @ each.J for A, each in held.values())])
    free = np.linalg.inv(d.M)
    if len(rows):
        free -= free @ rows.T @ np.linalg.solve(rows @ free @ rows.T, rows @ free)
    W = G @ free @ G.T
    if task.massless:
        Lam = np.linalg.inv(W)
        y = analytic.impedance_acceleration(Lam, task.B, K, -V_e, -X_e, np.zeros(len(S)), Lam)
        return G, ahead + y, np.zeros(len(S)) if phase.gravity_only else S @ d.drift
    past = np.zeros(len(S)) if felt.Vdot is None else S @ felt.Vdot - ahead
    # book 11.66 along the axes: Lam y = (Lam - M) xdd - B xd - K x
    return G, ahead + past + W @ (task.B @ V_e + K @ X_e - task.M @ past), S @ d.drift


def _errors(task: Compliance | MotionTask, T: Array, V: Array, desired: Sample) -> tuple[Array, Array, Array]:
    """(6,), (6,), (6,): X_e, V_e and d/dt(Ad V_d), by the book's log or in the world's axes."""
    T_d, V_d = desired.T.homogeneous, desired.V
    if not task.split:
        ahead = analytic.computed_torque(T, V, T_d, V_d, desired.Vdot, 0.0, 0.0)
        return analytic.pose_error(T, T_d), analytic.twist_error(T, V, T_d, V_d), ahead
    turned, turned_d = np.eye(4), np.eye(4)
    turned[:3, :3], turned_d[:3, :3] = R, R_d = T[:3, :3], T_d[:3, :3]
    pddot = R_d @ (desired.Vdot[3:] + np.cross(V_d[:3], V_d[3:]))  # of the origin, in the world
    X_e = np.r_[analytic.pose_error(turned, turned_d)[:3], R.T @ (T_d[:3, 3] - T[:3, 3])]
    V_e = np.r_[R.T @ R_d @ V_d[:3], R.T @ R_d @ V_d[3:]] - V
    wdot = R.T @ R_d @ desired.Vdot[:3] - np.cross(V[:3], R.T @ R_d @ V_d[:3])
    return X_e, V_e, np.r_[wdot, R.T @ pddot - np.cross(V[:3], V[3:])]


def _hybrid(
    robot: Robot,
    phase: Phase,
    law: Law,
    state: State,
    task: MotionTask,
    held: Any,
    adot: Any,
    commands: Any,
    dynamics: Any,
    vdot_posture: Array,
) -> Array:
    (name,) = held
    A, d = held[name]
    axes = list(movable(robot, task.frame, phase.contacts[name].against))
    y = _motion(task, state, d)
    # an arm of fewer axes cannot move along all that the contact leaves free: the rows that it can
    _, s, rows = np.linalg.svd(phase.contacts[name].free(state)[:, axes], full_matrices=False)
    S = rows[s > 1e-9]
    return analytic.hybrid_torque(
        d.M, d.h, d.J[axes], d.drift[axes], A[:, axes], y[axes], commands[name][axes], Adot_V=adot[name],
        law=law, vdot_posture=vdot_posture if robot.nv > len(axes) else None, S=S,
    )  # fmt: skip


def _stacked(
    phase: Phase,
    law: Law,
    state: State,
    motions: Any,
    held: Any,
    adot: Any,
    commands: Any,
    dynamics: Any,
    base: Dynamics,
    vdot_posture: Array,
    more: Any,
) -> Array:
    """Contacts and motion that do not span one task space: fact 9, all rows stacked."""
    G, target, drift = [], [], []
    for name, (A, d) in held.items():
        G.append(A @ d.J)
        target.append(-adot[name])
        drift.append(A @ d.drift)
    for task in motions:
        d = dynamics(task.frame) if task.contact is None else held[task.contact][1]
        S = phase.contacts[task.contact].free(state) if task.contact is not None else task.selection
        G.append(S @ d.J)
        target.append(S @ _motion(task, state, d))
        drift.append(S @ d.drift)
    for rows, wanted, velocity in more:
        G.append(rows)
        target.append(wanted)
        drift.append(velocity)
    n = base.h.size
    rows = np.concatenate([np.zeros((0, n)), *G])
    vdot = analytic.hybrid_acceleration(
        base.M, rows, np.concatenate([np.zeros(0), *target]), np.concatenate([np.zeros(0), *drift]), vdot_posture
    )
    tau = base.M @ vdot + base.h
    for name, (A, d) in held.items():
        push = d.J.T @ commands[name]
        if law == "book" and name in force_tasks(phase):
            # the joint form of A' (Lam A M_C^-1 F + Lam Adot V), which needs no M_C of the whole frame
            held_rows = A @ d.J
            lam = (
                analytic.dynamically_consistent_inverse(d.M, held_rows).T @ push
                + analytic.task_inertia(d.M, held_rows) @ adot[name]
            )
            push = held_rows.T @ lam
        tau = tau + push
    return tau


def _motion(task: MotionTask, state: State, d: Dynamics) -> Array:
    desired = task.followed(state)
    if task.split:
        X_e, V_e, ahead = _errors(task, d.T, d.V, desired)
        return ahead + task.Kp @ X_e + task.Kd @ V_e
    T_d, V_d = desired.T.homogeneous, desired.V
    feedforward = analytic.computed_torque(d.T, d.V, T_d, V_d, desired.Vdot, 0.0, 0.0)
    # gains on some axes are only semidefinite as (6, 6), which `computed_torque` refuses
    return feedforward + task.Kp @ analytic.pose_error(d.T, T_d) + task.Kd @ analytic.twist_error(d.T, d.V, T_d, V_d)


def _command(
    phase: Phase, name: str, law: Law, state: State, dynamics: Any, memory: Memory, given: dict[str, Wrench]
) -> Array:
    """(6,) the wrench that the force loop asks for, before any projection."""
    task = force_tasks(phase).get(name)
    contact = phase.contacts[name]
    A, d = contact.A(state), _of(dynamics, contact)
    if task is None:
        return np.zeros(6)
    target = task.target(state.since(task))
    F_d = analytic.project_wrench(A, target) if task.wrench else A.T @ target
    damping = A.T @ (task.K_damp @ (A @ d.V))
    loop = memory.loops.get(name, ForceLoop())
    if name not in given:
        return F_d - damping
    F = given[name].F
    filtered = F if loop.filtered is None else loop.filtered + task.smoothing(state.dt) * (F - loop.filtered)
    integral = loop.integral if loop.integral.size else np.zeros(6 if law == "book" else contact.k)
    yielded = _yielded(task, loop, state.dt)
    if law == "book":
        return analytic.force_command(F_d, F_d + A.T @ yielded - filtered, integral, task.Kp, task.Ki) - damping
    error = analytic.multiplier_error(A, F_d - filtered) + yielded
    return F_d + A.T @ (task.Kp @ error + task.Ki @ integral) - damping


def _yielded(task: ForceTask, loop: ForceLoop, dt: float) -> Array:
    """(k,) what limits took from earlier commands, as the loop's filter remembers it."""
    past = np.zeros(task.K_damp.shape[0]) if loop.yielded is None else loop.yielded
    last = np.zeros_like(past) if loop.last is None else loop.last
    return past + task.smoothing(dt) * (last - past)


def relative(value: Array, truth: Array) -> float:
    """max |value - truth| / (1 + max |truth|); infinite when a number is missing."""
    if value.shape != truth.shape or not (np.isfinite(value).all() and np.isfinite(truth).all()):
        return math.inf
    return float(np.abs(value - truth).max(initial=0.0) / (1.0 + np.abs(truth).max(initial=0.0)))


def force_tasks(phase: Phase) -> dict[str, ForceTask]:
    return {task.contact: task for task in phase.tasks.values() if isinstance(task, ForceTask)}


def motion_tasks(phase: Phase) -> list[MotionTask]:
    return [task for task in phase.tasks.values() if isinstance(task, MotionTask)]
