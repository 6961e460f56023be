"""The closed form of a phase at a state, from `wbc.analytic`: what `verify` holds the quadratic program against.

It shares with the controller only its inputs: gains, references, measured wrench, and the memory of filter and
integral; M, h, J may come from Pinocchio or from MuJoCo alone.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, Literal, NamedTuple

import numpy as np

from . import analytic
from .contact import Contact
from .controller import Memory, Phase
from .qp import Array
from .robot import Robot, State
from .task import ForceLoop, ForceTask, MotionTask, PostureTask
from .wrench import Wrench

Law = Literal["compensated", "book"]


class Dynamics(NamedTuple):
    """What the closed form needs of the robot at a state: M, h, and of the task frame J, drift, V and T (4, 4)."""

    M: Array
    h: Array
    J: Array
    drift: Array
    V: Array
    T: Array


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
    frames = [task.frame for task in motions] or [contact.frame for contact in phase.contacts.values()]
    known = np.zeros(robot.nv)
    for name in set(phase.fed) & set(given):
        contact = phase.contacts[name]
        known += dynamics(contact.frame).J.T @ _known(contact, state, given[name].F)
    dynamics = _loaded(dynamics, known)
    base = dynamics(frames[0])
    posture = next((task for task in phase.tasks.values() if isinstance(task, PostureTask)), None)
    vdot_posture = np.zeros(robot.nv) if posture is None else posture.Kp @ (posture.q - state.q) - posture.Kd @ state.v
    commands = {name: _command(phase, name, law, state, dynamics, memory, given) for name in phase.contacts}
    held = {name: (contact.A(state), dynamics(contact.frame)) for name, contact in phase.contacts.items()}
    adot = {name: contact.Adot_V(state) for name, contact in phase.contacts.items()}
    if len(motions) == 1 and len(held) == 1 and motions[0].contact in held:
        tau = _hybrid(robot, phase, law, state, motions[0], held, adot, commands, dynamics, vdot_posture)
    else:
        tau = _stacked(phase, law, state, motions, held, adot, commands, dynamics, base, vdot_posture)
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


def _loaded(dynamics: Callable[[str], Dynamics], known: Array) -> Callable[[str], Dynamics]:
    """The same with h counting the torque of known wrenches."""

    def of(name: str) -> Dynamics:
        d = dynamics(name)
        return d._replace(h=d.h + known)

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
    axes = list(robot.axes(task.frame))
    y = _motion(task, state, dynamics(task.frame))
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
) -> Array:
    """Contacts and motion that do not span one task space: fact 9, all rows stacked."""
    G, target, drift = [], [], []
    for name, (A, d) in held.items():
        G.append(A @ d.J)
        target.append(-adot[name])
        drift.append(A @ d.drift)
    for task in motions:
        d = dynamics(task.frame)
        S = phase.contacts[task.contact].free(state) if task.contact is not None else task.selection
        G.append(S @ d.J)
        target.append(S @ _motion(task, state, d))
        drift.append(S @ d.drift)
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
    desired = task.desired(state)
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
    A, d = contact.A(state), dynamics(contact.frame)
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
