"""The certificate of a spec: its quadratic program beside the book's closed form, tick by tick and at random states.

The closed form comes from `wbc.analytic` and shares with the controller only its inputs: gains, references, measured
wrench, and the memory of filter and integral. It is evaluated with M, h, J of Pinocchio, and once more with those that
MuJoCo alone computes. Acceleration and multipliers are held against the constrained dynamics under that torque.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

import mujoco
import numpy as np
import pinocchio as pin

from .build import Built, build
from .controller import Controller
from .coordinates import to_mujoco
from .crosscheck import point_jacobian
from .errors import SpecError
from .faults import Faults, Place
from .ladder import Status
from .limit import TorqueLimit
from .memory import Memory
from .observer import Observed
from .oracle import Dynamics, Law, closed_form, force_tasks, motion_tasks, relative
from .pair import movable
from .phase import Phase, hold
from .qp import Array
from .run import run
from .sim import carrier
from .solver import Solver
from .spec import Spec
from .state import State
from .task.force import ForceLoop, ForceTask
from .task.impedance import Compliance, Felt
from .task.motion import MotionTask
from .task.posture import PostureTask
from .task.relative import RelativeTask
from .wrench import Wrench

LAWS: tuple[Law, ...] = ("compensated", "book")
_OF_THE_CHAPTER = (MotionTask, ForceTask, PostureTask, Compliance)
STATES, KEPT = 1000, 700
MAX_COND, MAX_COND_AJ = 1e5, 30.0


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
    left_out: dict[str, str] = field(default_factory=dict)  # law -> why the spec has none

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
            "laws": laws, "left_out": self.left_out,
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

    A law that the spec does not ask for, and that is not defined for it, is left out. Raises SpecError for a spec that
    cannot be built, or has no closed form.
    """
    solver = solver or spec.solver
    certificate = Certificate(spec.file.rsplit("/", 1)[-1].removesuffix(".yaml"), tolerance(solver))
    for i, law in enumerate(LAWS):
        try:
            built = build(spec.model_copy(update={"law": law}), solver=solver)
        except SpecError as error:
            if law == spec.law:
                raise
            del certificate.laws[law]
            certificate.left_out[law] = "; ".join(fault.message for fault in error.faults)
            continue
        _require_closed_form(built)
        told = None if progress is None else partial(_after, progress, 1000 * i)
        Oracle(built, law, certificate, solver).run(
            states, seed, count=law == next(iter(certificate.laws)), progress=told
        )
    return certificate


def _require_closed_form(built: Built) -> None:
    """Raise SpecError where contacts and tasks want more of the start than its axes can give: weights then decide; and
    for floating bases."""
    faults = Faults(built.spec)
    if built.robot.base:
        message = f"{built.spec.robot} has a floating base, of which the chapter has no closed form"
        faults.add(("robot",), f"{message}; expected a robot with a fixed base")
    faults.check()
    for phase in built.phases:
        for name, task in phase.tasks.items():
            if isinstance(task, RelativeTask) or not isinstance(task, _OF_THE_CHAPTER):
                kind = built.spec.tasks[name].type
                message = f"the chapter has no closed form with a task of type {kind}"
                faults.add(("tasks", name, "type"), f"{message}; expected it left out")
    faults.check()
    for phase in built.phases:
        above = np.zeros((0, built.robot.nv))
        for place, rows in _rows(built, phase).items():
            above = np.concatenate((above, rows))
            if np.linalg.matrix_rank(above, tol=1e-7) < len(above):
                have = "asks for motion that contacts and tasks before it decide already"
                message = "what is done then depends on weights, and no closed form tells; expected axes of its own"
                faults.add(place, f"{have}: {message}")
                break
    faults.check()


def _rows(built: Built, phase: Phase) -> dict[Place, Array]:
    """Rows G of the contacts and tasks of a phase at the start, by their place in the spec."""
    state = built.robot.state(built.q, np.zeros(built.robot.nv))
    hold(state, phase)
    rows: dict[Place, Array] = {("contacts", name): held.G for name, held in state.contacts.items()}
    for name, task in phase.tasks.items():
        if isinstance(task, MotionTask | Compliance):
            S = task.selection if isinstance(task, MotionTask) else task.selection(state)
            S = S if task.contact is None else state.contacts[task.contact].free
            frame = state.frame(task.frame) if task.contact is None else state.contacts[task.contact].seen
            rows["tasks", name] = S @ frame.J
    return rows


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

        def tick(seen: Any, out: Any) -> None:
            if out.status in (Status.SAFE_HOLD, Status.STOPPED):
                return  # no law runs any more
            memory, feeling, measured = controller.recalled, controller.phase.feeling, controller.state.measured
            given = {name: Wrench(F, feeling[name]) for name, F in measured.items() if name in feeling}
            if out.active or out.status.name != "OK":
                certificate.lifted += count
                self.free.memory = memory
                out = self.free.step(seen.t, seen.q, seen.v, measured=given)
            self.worst.max_kkt_residual = max(self.worst.max_kkt_residual, *out.certificate)
            self._compare(controller.phase, seen.t - memory.start, seen.q, seen.v, memory, given, out, False)
            certificate.ticks += count

        run(self.built, seed, progress, tick)
        self._random(states, seed, count)

    def _random(self, states: int, seed: int, count: bool) -> None:
        robot, certificate = self.built.robot, self.certificate
        rng = np.random.default_rng(seed)
        low, high = np.maximum(robot.q_min, -np.pi), np.minimum(robot.q_max, np.pi)
        for i in range(states):
            index = i % len(self.free.phases)
            phase = self.free.phases[index]
            q, v = rng.uniform(low, high), rng.uniform(-1.0, 1.0, robot.nv)
            t = float(rng.uniform(0.0, self.built.spec.duration))
            loops, given = {}, {}
            for name in force_tasks(phase):
                size = 6 if self.law == "book" else phase.contacts[name].k
                scale = np.array([1.0, 1.0, 1.0, 10.0, 10.0, 10.0])
                loops[name] = ForceLoop(scale * rng.normal(size=6), rng.normal(size=size))
                given[name] = Wrench(scale * rng.normal(size=6), phase.contacts[name].frame)
            state, felt = self.built.robot.state(q, v, t), {}
            for name, contact in phase.contacts.items():
                state.contacts[name] = contact.hold(state)
            for name, task in phase.compliant.items():
                felt[name] = _any_felt(task, state, rng)
                if name in phase.feeling:
                    given[name] = Wrench(np.r_[rng.normal(size=3), 10.0 * rng.normal(size=3)], task.frame)
            if not self._well_conditioned(phase, q, v):
                certificate.dropped += count
                continue
            memory = Memory(t=t - self.free.dt, phase=index, tau=np.zeros(robot.nv), q=q, v=v, loops=loops, felt=felt)
            self.free.memory = memory
            out = self.free.step(t, q, v, measured=given)
            certificate.states += count
            self.worst.max_kkt_residual = max(self.worst.max_kkt_residual, *out.certificate)
            self._compare(phase, t, q, v, memory, given, out, True)

    def _well_conditioned(self, phase: Phase, q: Array, v: Array) -> bool:
        state = self.built.robot.state(q, v)
        for task in motion_tasks(phase):
            contact = phase.contacts.get(task.contact or "")
            J = (state.frame(task.frame) if contact is None else contact.seen(state)).J
            # a frame halfway up the arm has fewer than six axes at any one pose: what counts is what the task asks for
            J = task.selection @ J if contact is None else J[list(movable(state.robot, task.frame, contact.against))]
            if np.linalg.cond(J @ np.linalg.solve(state.M, J.T)) > MAX_COND:
                return False
        if phase.compliant:
            for name, contact in phase.contacts.items():
                state.contacts[name] = contact.hold(state)
            rows = [h.G for h in state.contacts.values()] + [t.target(state)[0] for t in motion_tasks(phase)]
            G = np.concatenate(rows + [t.target(state)[0] for t in phase.compliant.values()])
            if np.linalg.cond(G @ np.linalg.solve(state.M, G.T)) > MAX_COND:
                return False
        held = [contact.A(state) @ contact.seen(state).J for contact in phase.contacts.values() if contact.k]
        if not held:
            return True
        G = np.concatenate(held)
        if len(G) == 6 and not motion_tasks(phase):  # held in all directions: what counts is the whole task frame
            return bool(np.linalg.cond(G @ np.linalg.solve(state.M, G.T)) <= MAX_COND)
        return bool(np.linalg.cond(G) <= MAX_COND_AJ)

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
        state.starts = {phase.tasks[name]: start for name, start in memory.starts.items() if name in phase.tasks}
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
        still = mujoco.MjData(model)
        still.qpos[:] = data.qpos
        mujoco.mj_forward(model, still)

        def of(name: str) -> Dynamics:
            T, body = np.eye(4), mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, name)
            site = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_SITE, name.removeprefix("site:"))
            if site >= 0 > body:
                body = model.site_bodyid[site]
                T[:3, :3], T[:3, 3] = data.site_xmat[site].reshape(3, 3), data.site_xpos[site]
            else:
                body, X = carrier(self.built.robot, name)
                T[:3, :3], T[:3, 3] = data.xmat[body].reshape(3, 3), data.xpos[body]
                T = T @ X.homogeneous
            J, drift = point_jacobian(model, data, body, T[:3, :3], T[:3, 3].copy())
            return Dynamics(M, data.qfrc_bias.copy() - data.qfrc_passive, J, drift, J @ v, T, still.qfrc_bias)

        return of


def _any_felt(task: Compliance, state: State, rng: np.random.Generator) -> Felt:
    """What a task may remember: a wrench, a twist, and for an admittance a mass near the frame, in motion."""
    frame = state.frame(task.frame)
    F, V = np.r_[rng.normal(size=3), 10.0 * rng.normal(size=3)], frame.V + 1e-3 * rng.normal(size=6)
    T = frame.T * pin.exp6(pin.Motion(0.05 * rng.normal(size=3), 0.2 * rng.normal(size=3)))
    motion = np.column_stack((V + 0.1 * rng.normal(size=6), rng.normal(size=6)))
    observed = Observed(*(rng.normal(size=state.v.size) for _ in range(3))) if task.observer is not None else None
    return Felt(F, V, None, observed, T.homogeneous, motion)


def _pinocchio(state: State, name: str) -> Dynamics:
    frame = state.frame(name)
    return Dynamics(state.M, state.h, frame.J, frame.drift, frame.V, frame.T.homogeneous, state.gravity())


def _unlimited(phase: Phase) -> Phase:
    n = phase.torque.low.size
    free = np.full(n, np.inf)
    contacts = {name: contact.without_cone() for name, contact in phase.contacts.items()}
    torque = TorqueLimit(-free, free, free, phase.torque.joints)
    return replace(phase, contacts=contacts, torque=torque, joint=None, collision=None, exit=None, damped=False)
