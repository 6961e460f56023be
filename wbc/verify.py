"""The certificate of a spec: its quadratic program beside the book's closed form, tick by tick and at random states.

The closed form comes from `wbc.analytic` and shares with the controller only its inputs: gains, references, measured
wrench, and the memory of filter and integral. It is evaluated with M, h, J of Pinocchio, and once more with those that
MuJoCo alone computes. Acceleration and multipliers are held against the constrained dynamics under that torque.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from typing import Any, Literal, NamedTuple

import mujoco
import numpy as np
import pinocchio as pin

from . import analytic
from .build import Built, build
from .controller import Controller, Memory, Phase
from .limit import TorqueLimit
from .model import body_name, point_jacobian
from .qp import Array
from .robot import Robot, State
from .run import run
from .sim import to_mujoco
from .solver import Solver
from .spec import Spec
from .task import ForceLoop, ForceTask, MotionTask, PostureTask
from .wrench import Wrench

Law = Literal["compensated", "book"]
LAWS: tuple[Law, ...] = ("compensated", "book")
STATES, KEPT = 1000, 700
MAX_COND, MAX_COND_AJ = 1e5, 30.0


class Dynamics(NamedTuple):
    """What the closed form needs of the robot at a state: M, h, and of the task frame J, drift, V and T (4, 4)."""

    M: Array
    h: Array
    J: Array
    drift: Array
    V: Array
    T: Array


@dataclass
class Worst:
    """Largest errors of one law, relative to 1 + the largest entry."""

    max_tau_error: float = 0.0
    max_vdot_error: float = 0.0
    max_lambda_error: float = 0.0
    max_kkt_residual: float = 0.0


@dataclass
class Certificate:
    """The result of `verify`."""

    spec: str
    tolerance: float
    states: int = 0
    dropped: int = 0
    lifted: int = 0
    ticks: int = 0
    max_tau_error_mujoco: float = 0.0
    laws: dict[str, Worst] = field(default_factory=lambda: {law: Worst() for law in LAWS})

    @property
    def ok(self) -> bool:
        """Every torque within the tolerance, MuJoCo's within ten times of it, and enough states kept."""
        worst = max(law.max_tau_error for law in self.laws.values())
        enough = self.states >= KEPT * (self.states + self.dropped) / STATES
        return worst <= self.tolerance and self.max_tau_error_mujoco <= 10 * self.tolerance and enough

    def as_json(self) -> dict[str, Any]:
        """The contract's object."""
        laws = {law: vars(worst) for law, worst in self.laws.items()}
        return {
            "spec": self.spec, "ok": self.ok, "states": self.states, "dropped": self.dropped, "lifted": self.lifted,
            "ticks": self.ticks, "tolerance": self.tolerance, "max_tau_error_mujoco": self.max_tau_error_mujoco,
            "laws": laws,
        }  # fmt: skip


def tolerance(solver: str | Solver) -> float:
    """Relative torque error that a solver is held to: exact active sets, or an iteration's accuracy."""
    return 1e-9 if solver in ("daqp", "quadprog") else 1e-6


def verify(
    spec: Spec,
    solver: str | Solver | None = None,
    states: int = STATES,
    seed: int = 0,
    progress: Callable[[int], None] | None = None,
) -> Certificate:
    """Both laws of a spec against the closed form, at every tick of its run and at `states` random states.

    Raises SpecError for a spec that cannot be built.
    """
    solver = solver or spec.solver
    certificate = Certificate(spec.file.rsplit("/", 1)[-1].removesuffix(".yaml"), tolerance(solver))
    for i, law in enumerate(LAWS):
        built = build(spec.model_copy(update={"law": law}), solver=solver)
        told = None if progress is None else partial(_after, progress, 1000 * i)
        Oracle(built, law, certificate, solver).run(states, seed, count=law == LAWS[0], progress=told)
    return certificate


def _after(progress: Callable[[int], None], before: int, ticks: int) -> None:
    progress(before + ticks)


class Oracle:
    """One law of one built spec, beside the same controller with every limit lifted."""

    def __init__(self, built: Built, law: Law, certificate: Certificate, solver: str | Solver) -> None:
        self.built, self.law, self.certificate, self.worst = built, law, certificate, certificate.laws[law]
        phases = [_unlimited(phase) for phase in built.phases]
        self.free = Controller(built.robot, solver=solver, rate=built.spec.rate, phases=phases, q=built.q)
        mj = built.robot.mujoco
        self._mj = (mj, mujoco.MjData(mj)) if mj is not None else None

    def run(self, states: int, seed: int, count: bool, progress: Callable[[int], None] | None) -> None:
        controller, certificate = self.built.controller, self.certificate
        before: list[Memory | None] = [None]

        def tick(seen: Any, out: Any) -> None:
            memory, before[0] = before[0], controller.memory
            if memory is None:
                memory = Memory(tau=np.zeros(self.built.robot.nv))
            given = {
                name: Wrench(F, controller.phase.contacts[name].frame) for name, F in controller.state.measured.items()
            }
            t = seen.t
            if out.active or out.status.name != "OK":
                certificate.lifted += count
                out = self._lifted(memory, controller, seen, given)
            self.worst.max_kkt_residual = max(self.worst.max_kkt_residual, *out.certificate)
            self._compare(controller.phase, t - controller.memory.start, seen.q, seen.v, memory, given, out, False)  # type: ignore[union-attr]
            certificate.ticks += count

        run(self.built, seed, progress, tick)
        self._random(states, seed, count)

    def _lifted(self, memory: Memory, controller: Controller, seen: Any, given: dict[str, Wrench]) -> Any:
        self.free.memory = memory._replace(start=controller.memory.start, t=memory.t)  # type: ignore[union-attr]
        return self.free.step(seen.t, seen.q, seen.v, measured=given)

    def _random(self, states: int, seed: int, count: bool) -> None:
        robot, certificate = self.built.robot, self.certificate
        rng = np.random.default_rng(seed)
        phase = self.free.phases[0]
        low, high = np.maximum(robot.q_min, -np.pi), np.minimum(robot.q_max, np.pi)
        for _ in range(states):
            q, v = rng.uniform(low, high), rng.uniform(-1.0, 1.0, robot.nv)
            t = float(rng.uniform(0.0, self.built.spec.duration))
            loops, given = {}, {}
            for name in _force_tasks(phase):
                size = 6 if self.law == "book" else phase.contacts[name].k
                scale = np.array([1.0, 1.0, 1.0, 10.0, 10.0, 10.0])
                loops[name] = ForceLoop(scale * rng.normal(size=6), rng.normal(size=size))
                given[name] = Wrench(scale * rng.normal(size=6), phase.contacts[name].frame)
            if not self._well_conditioned(phase, q, v):
                certificate.dropped += count
                continue
            memory = Memory(t=t - self.free.dt, tau=np.zeros(robot.nv), q=q, v=v, loops=loops)
            self.free.memory = memory
            out = self.free.step(t, q, v, measured=given)
            certificate.states += count
            self.worst.max_kkt_residual = max(self.worst.max_kkt_residual, *out.certificate)
            self._compare(phase, t, q, v, memory, given, out, True)

    def _well_conditioned(self, phase: Phase, q: Array, v: Array) -> bool:
        state = self.built.robot.state(q, v)
        for task in _motion_tasks(phase):
            J = state.frame(task.frame).J
            # a frame halfway up the arm has fewer than six axes at any one pose: what counts is what the task asks for
            J = J[list(self.built.robot.axes(task.frame))] if task.contact is not None else task.selection @ J
            if np.linalg.cond(J @ np.linalg.solve(state.M, J.T)) > MAX_COND:
                return False
        held = [contact.A(state) @ state.frame(contact.frame).J for contact in phase.contacts.values() if contact.k]
        return not held or bool(np.linalg.cond(np.concatenate(held)) <= MAX_COND_AJ)

    # --- the closed form ---

    def _compare(
        self,
        phase: Phase,
        t: float,
        q: Array,
        v: Array,
        memory: Memory,
        given: dict[str, Wrench],
        out: Any,
        random: bool,
    ) -> None:
        state = self.built.robot.state(
            q, v, t, self.free.dt if memory.t is None or random else self.built.controller.state.dt
        )
        sources = [("pinocchio", lambda name: _pinocchio(state, name))]
        if self._mj is not None:
            sources.append(("mujoco", self._mujoco(q, v)))
        got = out.tau if self.built.robot.gravity == "controller" else out.tau + state.gravity()
        for source, dynamics in sources:
            tau, vdot, lam = closed_form(self.built.robot, phase, self.law, state, dynamics, memory, given)
            error = relative(got, tau)
            if source == "mujoco":
                self.certificate.max_tau_error_mujoco = max(self.certificate.max_tau_error_mujoco, error)
                continue
            worst = self.worst
            worst.max_tau_error = max(worst.max_tau_error, error)
            worst.max_vdot_error = max(worst.max_vdot_error, relative(out.vdot, vdot))
            for name, value in lam.items():
                wrench = out.wrenches.get(name, np.full(6, np.nan))  # a tick without an answer predicts none
                predicted = np.linalg.pinv(phase.contacts[name].A(state)).T @ wrench
                worst.max_lambda_error = max(worst.max_lambda_error, relative(predicted, value))

    def _mujoco(self, q: Array, v: Array) -> Callable[[str], Dynamics]:
        assert self._mj is not None
        model, data = self._mj
        data.qpos[:], data.qvel[:] = to_mujoco(model, q), v
        mujoco.mj_forward(model, data)
        M = np.zeros((model.nv, model.nv))
        mujoco.mj_fullM(model, data, M)

        def of(name: str) -> Dynamics:
            T, body = np.eye(4), mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, name)
            site = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_SITE, name.removeprefix("site:"))
            if site >= 0 > body:
                body = model.site_bodyid[site]
                T[:3, :3], T[:3, 3] = data.site_xmat[site].reshape(3, 3), data.site_xpos[site]
            else:
                body, X = _carrier(self.built.robot, name)
                T[:3, :3], T[:3, 3] = data.xmat[body].reshape(3, 3), data.xpos[body]
                T = T @ X.homogeneous
            J, drift = point_jacobian(model, data, body, T[:3, :3], T[:3, 3].copy())
            return Dynamics(M, data.qfrc_bias.copy() - data.qfrc_passive, J, drift, J @ v, T)

        return of


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
    motions = _motion_tasks(phase)
    frames = [task.frame for task in motions] or [contact.frame for contact in phase.contacts.values()]
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
    # what a rigid contact makes of that torque
    G = np.concatenate([np.zeros((0, robot.nv)), *(A @ d.J for A, d in held.values())])
    rhs = np.concatenate([np.zeros(0), *(-(held[n][0] @ held[n][1].drift + adot[n]) for n in held)])
    k = rhs.size
    answer = np.linalg.solve(np.block([[base.M, G.T], [G, np.zeros((k, k))]]), np.r_[tau - base.h, rhs])
    lam, start = {}, robot.nv
    for name, (A, _) in held.items():
        lam[name] = answer[start : start + A.shape[0]]
        start += A.shape[0]
    return tau, answer[: robot.nv], lam


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
        if law == "book" and name in _force_tasks(phase):
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
    desired = task.reference(state.t)
    T_d, V_d = desired.T.homogeneous, desired.V
    feedforward = analytic.computed_torque(d.T, d.V, T_d, V_d, desired.Vdot, 0.0, 0.0)
    # gains on some axes are only semidefinite as (6, 6), which `computed_torque` refuses
    return feedforward + task.Kp @ analytic.pose_error(d.T, T_d) + task.Kd @ analytic.twist_error(d.T, d.V, T_d, V_d)


def _command(
    phase: Phase, name: str, law: Law, state: State, dynamics: Any, memory: Memory, given: dict[str, Wrench]
) -> Array:
    """(6,) the wrench that the force loop asks for, before any projection."""
    task = _force_tasks(phase).get(name)
    contact = phase.contacts[name]
    A, d = contact.A(state), dynamics(contact.frame)
    if task is None:
        return np.zeros(6)
    F_d = analytic.project_wrench(A, task.target(state.t)) if task.wrench else A.T @ task.target(state.t)
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


def _pinocchio(state: State, name: str) -> Dynamics:
    frame = state.frame(name)
    return Dynamics(state.M, state.h, frame.J, frame.drift, frame.V, frame.T.homogeneous)


def _carrier(robot: Robot, name: str) -> tuple[int, pin.SE3]:
    """MuJoCo's body that carries a frame that is no site (a body's or joint's), and the frame's place on it."""
    frame = robot.model.frames[robot.frame_id(name)]
    for body in range(1, robot.mujoco.nbody):
        carrier = robot.model.frames[robot.frame_id(body_name(robot.mujoco, body))]
        if carrier.parentJoint == frame.parentJoint:
            return body, carrier.placement.actInv(frame.placement)
    return 0, frame.placement


def relative(value: Array, truth: Array) -> float:
    """max |value - truth| / (1 + max |truth|); infinite when a number is missing."""
    if value.shape != truth.shape or not (np.isfinite(value).all() and np.isfinite(truth).all()):
        return math.inf
    return float(np.abs(value - truth).max(initial=0.0) / (1.0 + np.abs(truth).max(initial=0.0)))


def _force_tasks(phase: Phase) -> dict[str, ForceTask]:
    return {task.contact: task for task in phase.tasks.values() if isinstance(task, ForceTask)}


def _motion_tasks(phase: Phase) -> list[MotionTask]:
    return [task for task in phase.tasks.values() if isinstance(task, MotionTask)]


def _unlimited(phase: Phase) -> Phase:
    n = phase.torque.low.size
    free = np.full(n, np.inf)
    return Phase(
        phase.contacts,
        phase.tasks,
        phase.weights,
        TorqueLimit(-free, free, free, phase.torque.joints),
        None,
        phase.name,
        phase.until,
    )
