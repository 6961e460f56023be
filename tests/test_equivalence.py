"""The quadratic program of a tick against the closed-form law: every contact, axis selection, gain and posture weight.

Three oracles that share no algebra: the book's equations (`verify.closed_form`), the same with M, h, J of MuJoCo, and
Gauss's principle as dense KKT systems, written here. Then the controls that must fail, by the amount that theory gives.
"""

from __future__ import annotations

import itertools
import os
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import cache

import mujoco
import numpy as np
import pinocchio as pin
import pytest

from tests.bars import TAU_ERROR, TAU_ERROR_MUJOCO
from wbc import analytic
from wbc.contact import Contact
from wbc.contact.axes import AxesContact, MatrixContact, WorldAxesContact
from wbc.contact.screw import ScrewContact
from wbc.contact.sphere import SphereContact
from wbc.controller import Controller
from wbc.ladder import Status
from wbc.memory import Memory, Output
from wbc.phase import Phase
from wbc.qp import Array, Rows
from wbc.reference import Path, Sample, hold, sine
from wbc.robot import Robot
from wbc.state import State
from wbc.task.force import ForceLoop, ForceTask
from wbc.task.motion import MotionTask
from wbc.task.posture import PostureTask
from wbc.verify import MAX_COND, MAX_COND_AJ, Dynamics, closed_form, relative
from wbc.wrench import VELOCITY_AXES, Wrench

POSTURE_WEIGHTS = (1e-4, 1e-2, 1.0, 1e2)
LARGE = 25 if os.environ.get("WBC_CAMPAIGN") == "large" else 1
NO_LIMITS = dict.fromkeys(("torque", "torque_rate", "position", "velocity"))
PLANAR_AXES = ("wy", "vx", "vz")
FOREARM = {"panda": "link4", "ur5e": "forearm_link"}
ANGULAR_FIRST = np.array([3, 4, 5, 0, 1, 2])
SCALE = np.array([1.0, 1.0, 1.0, 10.0, 10.0, 10.0])  # of random wrenches [N m, N]

laws = pytest.mark.parametrize("law", ["compensated", "book"])
arms = pytest.mark.parametrize("name", ["panda", "ur5e"])
ks = pytest.mark.parametrize("k", range(7))


@cache
def arm(name: str) -> Robot:
    return Robot.load(name, tool="eraser", scene="board")


# --- random laws ---


class BentContact(Contact):
    """Rows that change from place to place: A = A_0 + A_1 p_x + A_2 p_z, p [m] the frame's position in the world."""

    def __init__(self, frame: str, rows: Array) -> None:
        self.frame, self._rows, self.k = frame, rows, rows.shape[1]

    def A(self, state: State) -> Array:
        p = state.frame(self.frame).T.translation
        return self._rows[0] + self._rows[1] * p[0] + self._rows[2] * p[2]

    def Adot_V(self, state: State) -> Array:
        frame = state.frame(self.frame)
        pdot = frame.T.rotation @ frame.V[3:]
        return (self._rows[1] * pdot[0] + self._rows[2] * pdot[2]) @ frame.V


def full_rank(rng: np.random.Generator, m: int, n: int) -> Array:
    """(m, n) with singular values between 0.5 and 2."""
    U, V = (np.linalg.qr(rng.normal(size=(i, i)))[0] if i else np.zeros((0, 0)) for i in (m, n))
    return (U * rng.uniform(0.5, 2.0, m)) @ V[:m]


def matrix_contact(rng: np.random.Generator, robot: Robot, k: int) -> MatrixContact:
    """Any dense A over the axes that the robot has."""
    axes = list(robot.axes("eraser"))
    A = np.zeros((k, 6))
    A[:, axes] = full_rank(rng, k, len(axes))
    return MatrixContact("eraser", A)


def bent_contact(rng: np.random.Generator, k: int) -> BentContact:
    return BentContact("eraser", np.stack([full_rank(rng, k, 6), *0.3 * rng.normal(size=(2, k, 6))]))


def sphere(robot: Robot, frame: str = "eraser") -> SphereContact:
    return SphereContact(frame, np.array([0.2, 0.0 if robot.name == "planar3r" else 0.3, 0.3]))


def gain(rng: np.random.Generator, n: int, size: float, numbers: bool = False) -> float | Array:
    """A number, a vector, or a matrix that is positive definite but not symmetric."""
    kind = 0 if numbers else rng.integers(3)
    if kind == 0:
        return float(size * rng.uniform(0.2, 1.0))
    if kind == 1:
        return size * rng.uniform(0.2, 1.0, n)
    X = rng.normal(size=(n, n))
    return size * (0.2 * np.eye(n) + 0.1 * X @ X.T + 0.1 * (X - X.T))


def force_task(rng: np.random.Generator, name: str, contact: Contact, law: str) -> ForceTask:
    n = 6 if law == "book" else contact.k
    lam = 5.0 * rng.normal(size=contact.k)
    target = lam if rng.random() < 0.5 else lambda t: lam * (1.0 + 0.3 * np.sin(t))
    kp, ki, damping = gain(rng, n, 1.0), gain(rng, n, 10.0), gain(rng, contact.k, 50.0)
    return ForceTask(name, contact, target, kp, ki, damping, filter=rng.choice([None, 50.0]), law=law)


def motion_task(
    rng: np.random.Generator, robot: Robot, frame: str, axes: tuple[str, ...], law: str, contact: str | None = None
) -> MotionTask:
    """Along sines on all axes; the free motion of a matrix has no names, so that its gains are numbers."""
    home = robot.state(robot.keyframes["home"], np.zeros(robot.nv)).frame(frame).T
    along = {i: sine(rng.uniform(0.02, 0.1), rng.uniform(1, 3), rng.uniform(0, 6)) for i in robot.axes(frame)}
    unnamed = not axes or not set(axes) <= set(VELOCITY_AXES)
    kp, kd = gain(rng, len(axes), 100.0, unnamed), gain(rng, len(axes), 20.0, unnamed)
    path = Path(home, along)
    return MotionTask(frame, path, kp, kd, axes, contact, law, robot.axes(frame), singular=0.0)


def posture_task(rng: np.random.Generator, robot: Robot) -> PostureTask:
    return PostureTask(robot.keyframes["home"], gain(rng, robot.nv, 50.0), gain(rng, robot.nv, 10.0))


def stacked(
    rng: np.random.Generator,
    robot: Robot,
    contacts: Mapping[str, Contact],
    motions: list[tuple[str, tuple[str, ...], str | None]],
    law: str = "compensated",
    posture: float = 1.0,
    solver: str = "daqp",
) -> Controller:
    """Force on every contact, motion of some frames along some axes, and a posture of that weight."""
    tasks = {}
    for name, contact in contacts.items():
        tasks[f"press_{name}"] = (force_task(rng, name, contact, law), float(10.0 ** rng.uniform(-2, 2)))
    for i, (frame, axes, name) in enumerate(motions):
        tasks[f"move_{i}"] = motion_task(rng, robot, frame, axes, law, name)
    tasks["posture"] = (posture_task(rng, robot), posture)
    return Controller(robot, contacts, tasks, NO_LIMITS, solver)


def hybrid(
    rng: np.random.Generator, robot: Robot, contact: Contact, law: str, posture: float = 1.0, solver: str = "daqp"
) -> Controller:
    """Motion and force on one contact."""
    motions = [(contact.frame, contact.free_axes, "board")]
    return stacked(rng, robot, {"board": contact}, motions, law, posture, solver)


# --- the oracles ---


def from_pinocchio(state: State) -> Callable[[str], Dynamics]:
    def of(name: str) -> Dynamics:
        frame = state.frame(name)
        return Dynamics(state.M, state.h, frame.J, frame.drift, frame.V, frame.T.homogeneous)

    return of


def from_mujoco(robot: Robot, q: Array, v: Array) -> Callable[[str], Dynamics]:
    """MuJoCo's own; its Jacobians are in the axes of the world, so that the drift is R' Jdot_w v - (0, w x v)."""
    model, n = robot.mujoco, robot.nv
    data = mujoco.MjData(model)
    data.qpos, data.qvel = q, v
    mujoco.mj_forward(model, data)
    M = np.zeros((n, n))
    mujoco.mj_fullM(model, data, M)

    def of(name: str) -> Dynamics:
        site = model.site(name)
        world, rate, T = np.zeros((2, 3, n)), np.zeros((2, 3, n)), np.eye(4)
        T[:3, :3], T[:3, 3] = data.site(name).xmat.reshape(3, 3), data.site(name).xpos
        mujoco.mj_jacSite(model, data, world[1], world[0], site.id)
        mujoco.mj_jacDot(model, data, rate[1], rate[0], T[:3, 3], site.bodyid[0])
        J = np.vstack(T[:3, :3].T @ world)
        V, drift = J @ v, np.ravel((rate @ v) @ T[:3, :3])
        drift[3:] -= np.cross(V[:3], V[3:])
        return Dynamics(M, data.qfrc_bias - data.qfrc_passive, J, drift, V, T)

    return of


def nearest(M: Array, G: Array, r: Array, a: Array) -> tuple[Array, Array]:
    """x nearest to a in the metric M with G x = r, and lambda of M x + G' lambda = M a: one KKT system.

    Its rows are an orthonormal basis of those of G, which need not be independent.
    """
    U, s, Vt = np.linalg.svd(G, full_matrices=False)
    U, s, Vt = U[:, s > 1e-9], s[s > 1e-9], Vt[s > 1e-9]
    KKT = np.block([[M, Vt.T], [Vt, np.zeros((s.size, s.size))]])
    solution = np.linalg.solve(KKT, np.concatenate([M @ a, U.T @ r / s]))
    return solution[: len(M)], U @ (solution[len(M) :] / s)


def held_rows(phase: Phase, state: State) -> tuple[Array, Array]:
    """G = A J of all contacts, and the -(A Jdot v + Adot V) that they ask of G vdot."""
    G, rhs = [np.zeros((0, state.v.size))], [np.zeros(0)]
    for contact in phase.contacts.values():
        A, frame = contact.A(state), state.frame(contact.frame)
        G.append(A @ frame.J)
        rhs.append(-contact.Adot_V(state) - A @ frame.drift)
    return np.concatenate(G), np.concatenate(rhs)


def desired_acceleration(task: MotionTask, state: State) -> Array:
    """y, in Pinocchio's algebra of motions."""
    frame, desired = state.frame(task.frame), task.reference(state.t)
    X = frame.T.actInv(desired.T)
    V, V_d, Vdot_d = (pin.Motion(x[3:], x[:3]) for x in (frame.V, desired.V, desired.Vdot))
    feedforward, X_e, V_e = X.act(Vdot_d) - V.cross(X.act(V_d)), pin.log6(X), X.act(V_d) - V
    y, X_e, V_e = (x.vector[ANGULAR_FIRST] for x in (feedforward, X_e, V_e))
    return y + task.Kp @ X_e + task.Kd @ V_e


def gauss(phase: Phase, law: str, state: State, memory: Memory, given: Mapping[str, Array]) -> Array:
    """tau (nv,) from Gauss's principle.

    Compensated: the acceleration nearest to the posture's that meets contacts and motion. Book: first the nearest to
    the posture's with the raw y, then the nearest to that which meets the contact.
    """
    tasks = phase.tasks.values()
    free = np.zeros(state.v.size)
    for task in tasks:
        if isinstance(task, PostureTask):
            free = task.Kp @ (task.q - state.q) - task.Kd @ state.v
    G, rhs = held_rows(phase, state)
    for task in tasks:
        if isinstance(task, MotionTask):
            frame = state.frame(task.frame)
            target = desired_acceleration(task, state) - frame.drift
            if law == "book" and task.contact is not None:
                free = nearest(state.M, frame.J, target, free)[0]
                continue
            S = phase.contacts[task.contact].free(state) if task.contact is not None else task.selection
            G, rhs = np.concatenate([G, S @ frame.J]), np.concatenate([rhs, S @ target])
    tau = state.M @ nearest(state.M, G, rhs, free)[0] + state.h
    for task in tasks:
        if isinstance(task, ForceTask):
            contact, loop = phase.contacts[task.contact], memory.loops[task.contact]
            lam = command(task, contact, law, state, loop, given[task.contact])
            tau = tau + state.frame(contact.frame).J.T @ (contact.A(state).T @ lam)
    return tau


def command(task: ForceTask, contact: Contact, law: str, state: State, loop: ForceLoop, F: Array) -> Array:
    """lambda (k,) of a force loop. Book: what a rigid contact answers to the feedback's wrench, and to Adot V."""
    A, frame, lam_d = contact.A(state), state.frame(contact.frame), task.target(state.t)
    alpha = 1.0 if task.filter is None else 1.0 - np.exp(-2 * np.pi * task.filter * 1e-3)
    F = loop.filtered + alpha * (F - loop.filtered)
    lam = lam_d - task.K_damp @ (A @ frame.V)
    if law == "compensated":
        return lam + task.Kp @ (lam_d - np.linalg.lstsq(A.T, F)[0]) + task.Ki @ loop.integral
    feedback = task.Kp @ (A.T @ lam_d - F) + task.Ki @ loop.integral
    push = np.linalg.solve(state.M, frame.J.T @ feedback)
    return lam + nearest(state.M, A @ frame.J, -contact.Adot_V(state), push)[1]


# --- the campaign ---


@dataclass
class Worst:
    """Largest errors relative to 1 + the largest entry: torque by each oracle, vdot and wrenches by the plant."""

    book: float = 0.0
    gauss: float = 0.0
    mujoco: float = 0.0
    vdot: float = 0.0
    wrench: float = 0.0
    kept: int = 0
    dropped: int = 0

    def note(self, key: str, value: Array, truth: Array) -> None:
        setattr(self, key, max(getattr(self, key), relative(value, truth)))

    def hold(self, bar: float = TAU_ERROR["daqp"]) -> None:
        assert self.kept > 0, self
        assert max(self.book, self.gauss) <= bar, self
        assert self.mujoco <= TAU_ERROR_MUJOCO, self
        assert max(self.vdot, self.wrench) <= 10 * bar, self  # an acceleration is M^-1 of a torque


def campaign(
    rng: np.random.Generator, controller: Controller, law: str, states: int, also_mujoco: bool = False
) -> Worst:
    """The controller beside its oracles at that many well-conditioned states."""
    worst, phase = Worst(), controller.phases[0]
    for state in random_states(rng, controller, states * LARGE, worst):
        memory, measured, given = random_memory(rng, phase, law, state)
        controller.memory = memory
        out = controller.step(state.t, state.q, state.v, measured=measured)
        assert out.status is Status.OK, out.reason
        wrenches = {name: Wrench(F, phase.contacts[name].frame) for name, F in given.items()}
        scene = (controller.robot, phase, law, state)
        tau, vdot, lam = closed_form(*scene, from_pinocchio(state), memory, wrenches)
        worst.note("book", out.tau, tau)
        worst.note("vdot", out.vdot, vdot)
        for name, contact in phase.contacts.items():
            worst.note("wrench", out.wrenches[name], contact.A(state).T @ lam[name])
        worst.note("gauss", out.tau, gauss(phase, law, state, memory, given))
        if also_mujoco:
            dynamics = from_mujoco(controller.robot, state.q, state.v)
            worst.note("mujoco", out.tau, closed_form(*scene, dynamics, memory, wrenches)[0])
    return worst


def random_states(rng: np.random.Generator, controller: Controller, states: int, worst: Worst) -> Iterator[State]:
    """That many states that the requirement counts; those it does not are only counted."""
    while worst.kept < states:
        state = random_state(rng, controller.robot)
        if well_conditioned(controller.phases[0], state):
            worst.kept += 1
            yield state
        else:
            worst.dropped += 1
            assert worst.dropped < 200 * states, "hardly a state is well conditioned"


def random_state(rng: np.random.Generator, robot: Robot) -> State:
    low, high = np.maximum(robot.q_min, -np.pi), np.minimum(robot.q_max, np.pi)
    return robot.state(rng.uniform(low, high), rng.uniform(-1.0, 1.0, robot.nv), rng.uniform(0.0, 4.0))


def well_conditioned(phase: Phase, state: State) -> bool:
    """cond(J M^-1 J') <= 1e5 and cond(A J) <= 30, J of the task; with several tasks the former of all rows together."""
    tasks = [task for task in phase.tasks.values() if isinstance(task, MotionTask)]
    held, chosen = held_rows(phase, state)[0], []
    for task in tasks:
        S = task.selection if task.contact is None else phase.contacts[task.contact].free(state)
        chosen.append(S @ state.frame(task.frame).J)
    one = len(tasks) == len(phase.contacts) == 1 and tasks[0].contact is not None
    rows = state.frame("eraser").J[list(state.robot.axes("eraser"))] if one else np.concatenate([held, *chosen])
    if np.linalg.cond(rows @ np.linalg.solve(state.M, rows.T)) > MAX_COND:
        return False
    return not len(held) or bool(np.linalg.cond(held) <= MAX_COND_AJ)


def random_memory(
    rng: np.random.Generator, phase: Phase, law: str, state: State
) -> tuple[Memory, dict[str, Wrench], dict[str, Array]]:
    """Filters and integrals; wrenches as measured, some at the wrist; the same wrenches at the contacts."""
    loops, measured, given = {}, {}, {}
    for name, contact in phase.contacts.items():
        size = 6 if law == "book" else contact.k
        loops[name] = ForceLoop(filtered=SCALE * rng.normal(size=6), integral=0.1 * rng.normal(size=size))
        F = given[name] = SCALE * rng.normal(size=6)
        measured[name] = Wrench(F, contact.frame)
        if contact.frame == "eraser" and rng.random() < 0.3:
            at_wrist = state.frame("wrist_sensor").T.actInv(state.frame("eraser").T).act(pin.Force(F[3:], F[:3]))
            measured[name] = Wrench(at_wrist.vector[ANGULAR_FIRST], "wrist_sensor")
    memory = Memory(t=state.t - 1e-3, tau=np.zeros(state.v.size), q=state.q, v=state.v, loops=loops)
    return memory, measured, given


# --- one contact: the hybrid law ---


def selections(axes: tuple[str, ...]) -> list[tuple[str, ...]]:
    return [chosen for k in range(len(axes) + 1) for chosen in itertools.combinations(axes, k)]


@laws
@arms
def test_every_selection_of_held_axes(rng, name, law):
    assert len(selections(VELOCITY_AXES)) == 64
    for held in selections(VELOCITY_AXES):
        posture = rng.choice(POSTURE_WEIGHTS)
        campaign(rng, hybrid(rng, arm(name), AxesContact("eraser", held), law, posture), law, 2).hold()


@laws
def test_every_selection_of_held_axes_of_a_planar_arm(rng, law):
    for held in selections(PLANAR_AXES):
        contact = AxesContact("eraser", held, tuple(axis for axis in PLANAR_AXES if axis not in held))
        campaign(rng, hybrid(rng, arm("planar3r"), contact, law), law, 4, also_mujoco=True).hold()


@laws
@ks
@arms
def test_any_constant_rows_at_every_posture_weight(rng, name, k, law):
    for posture in POSTURE_WEIGHTS if name == "panda" else (1.0,):
        contact = matrix_contact(rng, arm(name), k)
        campaign(rng, hybrid(rng, arm(name), contact, law, posture), law, 3, also_mujoco=True).hold()


@laws
@ks
@arms
def test_rows_that_depend_on_the_state(rng, name, k, law):
    campaign(rng, hybrid(rng, arm(name), bent_contact(rng, k), law), law, 4, also_mujoco=True).hold()


@laws
@pytest.mark.parametrize("k", range(4))
def test_any_constant_rows_of_a_planar_arm(rng, k, law):
    robot = arm("planar3r")
    campaign(rng, hybrid(rng, robot, matrix_contact(rng, robot, k), law), law, 4, also_mujoco=True).hold()


@laws
@pytest.mark.parametrize("name", ["panda", "ur5e", "planar3r"])
def test_a_sphere(rng, name, law):
    campaign(rng, hybrid(rng, arm(name), sphere(arm(name)), law), law, 8, also_mujoco=True).hold()


@laws
@arms
@pytest.mark.parametrize("held", [("vz",), ("wx", "wy", "vz"), ("wz", "vx", "vy"), ("wx", "wy", "wz", "vy", "vz")])
def test_axes_of_the_world(rng, name, held, law):
    contact = WorldAxesContact("eraser", held, pin.exp3(rng.normal(size=3)))
    campaign(rng, hybrid(rng, arm(name), contact, law), law, 4, also_mujoco=True).hold()


@laws
@arms
@pytest.mark.parametrize("f", range(7))
def test_free_screws(rng, name, f, law):
    origin = arm(name).state(arm(name).keyframes["home"], np.zeros(arm(name).nv)).frame("eraser").T
    contact = ScrewContact("eraser", full_rank(rng, f, 6), origin)
    campaign(rng, hybrid(rng, arm(name), contact, law), law, 3, also_mujoco=True).hold()


@laws
@ks
@arms
def test_proxqp(rng, name, k, law):
    for posture in POSTURE_WEIGHTS if name == "panda" else (1.0,):
        contact = matrix_contact(rng, arm(name), k)
        campaign(rng, hybrid(rng, arm(name), contact, law, posture, "proxqp"), law, 1).hold(TAU_ERROR["proxqp"])


# --- several rows that do not span one task space: vdot = Gbar (target - Gdot v) + N vdot_posture ---


@pytest.mark.parametrize("name", ["panda", "ur5e", "planar3r"])
def test_motion_along_every_selection_of_axes(rng, name):
    every = PLANAR_AXES if name == "planar3r" else VELOCITY_AXES
    for axes in selections(every)[1:]:
        controller = stacked(rng, arm(name), {}, [("eraser", axes, None)], posture=rng.choice(POSTURE_WEIGHTS))
        campaign(rng, controller, "compensated", 2).hold()


@laws
@arms
@pytest.mark.parametrize(
    ("contacts", "motions"),
    [
        (("table",), []),
        (("sphere",), []),
        (("table", "elbow"), []),
        (("table", "elbow"), [("eraser", ("vx", "vy"))]),
        (("table",), [("eraser", ("wz", "vx"))]),
        (("elbow",), [("eraser", ("vx", "vy", "vz"))]),
        (("table",), [("wrist_sensor", ("vx", "vy"))]),
        ((), [("eraser", ("vx", "vy")), ("forearm", ("vx", "vz"))]),
    ],
)
def test_contacts_and_motions_of_several_frames(rng, name, contacts, motions, law):
    robot, forearm = arm(name), FOREARM[name]
    known = {"table": AxesContact("eraser", ("wx", "vz")), "sphere": sphere(robot), "elbow": sphere(robot, forearm)}
    moved = [(forearm if frame == "forearm" else frame, axes, None) for frame, axes in motions]
    controller = stacked(rng, robot, {contact: known[contact] for contact in contacts}, moved, law)
    campaign(rng, controller, law, 5).hold()


def test_two_contacts_with_the_free_motion_of_one(rng):
    robot = arm("panda")
    table = AxesContact("eraser", ("wx", "wy", "vz"))
    motions = [("eraser", table.free_axes, "table")]
    controller = stacked(rng, robot, {"table": table, "elbow": sphere(robot, "link4")}, motions)
    assert controller.notes == ["posture: dropped, contacts and motion leave no null space of the 7 joints"]
    campaign(rng, controller, "compensated", 3).hold()


# --- projectors ---


@ks
@arms
def test_ranks_of_the_projectors_that_the_program_applies(rng, name, k):
    """P M_C is what the torque makes of a desired acceleration, I - P what it makes of a measured wrench."""
    robot, nudge = arm(name), np.zeros(6)
    contact = matrix_contact(rng, robot, k)
    (state,) = random_states(rng, hybrid(rng, robot, contact, "book"), 1, Worst())
    T = state.frame("eraser").T
    tasks = {
        "press": ForceTask("board", contact, np.zeros(k), kp=1.0, law="book"),
        "draw": MotionTask(
            "eraser", lambda t: Sample(T, np.stack([np.zeros(6), nudge], axis=1)), contact="board", law="book"
        ),
    }
    controller = Controller(robot, {"board": contact}, tasks, NO_LIMITS)

    def wrench(F: Array) -> Array:
        controller.reset(state.q, state.v)
        out = controller.step(0.0, state.q, state.v, measured={"board": Wrench(F, "eraser")})
        return np.linalg.lstsq(state.frame("eraser").J.T, out.tau - state.h)[0]

    at_rest, P_MC = wrench(np.zeros(6)), []
    rest = np.stack([at_rest - wrench(F) for F in np.eye(6)], axis=1)
    for i in range(6):
        nudge[:] = np.eye(6)[i]
        P_MC.append(wrench(np.zeros(6)) - at_rest)
    M_C = analytic.task_inertia(state.M, state.frame("eraser").J)
    P = np.linalg.solve(M_C, np.array(P_MC)).T
    assert np.trace(P) == pytest.approx(6 - k, abs=1e-8)
    assert np.trace(rest) == pytest.approx(k, abs=1e-8)
    assert np.linalg.matrix_rank(P, 1e-6) == 6 - k
    assert np.linalg.matrix_rank(rest, 1e-6) == k
    assert P + rest == pytest.approx(np.eye(6), abs=1e-8)


# --- what the contact really feels on a curved surface ---


@laws
@arms
def test_actual_force_on_a_sphere(rng, name, law):
    """The book's law presses Lam Adot V too much, the default what it was told, all along a path on a rigid sphere."""
    robot, lam_d, dt, bias = arm(name), np.array([-10.0]), 1e-3, []
    contact = sphere(robot)
    tasks = {
        "press": ForceTask("board", contact, lam_d, law=law),
        "draw": motion_task(rng, robot, "eraser", contact.free_axes, law, "board"),
        "posture": posture_task(rng, robot),
    }
    controller = Controller(robot, {"board": contact}, tasks, NO_LIMITS)
    (state,) = random_states(rng, controller, 1, Worst())
    q, v = state.q, 2.0 * state.v
    centre = np.array([0.2, 0.3, 0.3])
    for tick in range(40):
        state = robot.state(q, v)
        G, rhs = held_rows(controller.phases[0], state)
        v = nearest(state.M, G, np.zeros(1), v)[0]  # along the surface
        state = robot.state(q, v)
        G, rhs = held_rows(controller.phases[0], state)
        out = controller.step(tick * dt, q, v)
        vdot, lam = nearest(state.M, G, rhs, np.linalg.solve(state.M, out.tau - state.h))
        frame = state.frame("eraser")
        M_C, Adot_V = analytic.task_inertia(state.M, frame.J), contact.Adot_V(state)
        bias.append(analytic.force_bias(contact.A(state), M_C, Adot_V)[0])
        assert lam == pytest.approx(lam_d + (bias[-1] if law == "book" else 0.0), abs=1e-9)
        assert out.wrenches["board"] == pytest.approx(contact.A(state).T @ lam, abs=1e-9)
        # the plant stays on the sphere: (p - c) . p'' = -|p'|^2
        R, V, a = frame.T.rotation, frame.V, frame.J @ vdot + frame.drift
        out_of_centre, pdot, pddot = frame.T.translation - centre, R @ V[3:], R @ (a[3:] + np.cross(V[:3], V[3:]))
        assert out_of_centre @ pddot == pytest.approx(-pdot @ pdot, abs=1e-9 * (1.0 + np.abs(pddot).max()))
        q, v = q + dt * (v + 0.5 * dt * vdot), v + dt * vdot
    assert np.abs(bias).max() > 1.0  # [N] of 10


# --- the controls that must fail, by the amount that theory gives ---


class IdentityMetric(MotionTask):
    """The motion cost |J vdot + Jdot v - y|^2 without M_C."""

    def rows(self, state: State) -> Rows:
        return super().rows(state)._replace(metric=None)


class PlainPosture(PostureTask):
    """The posture cost in M, not kept out of the tasks."""

    def rows(self, state: State) -> Rows:
        return super().rows(state)._replace(metric=state.M)


class SixAxesPosture(PostureTask):
    """The posture kept out of all six axes of the eraser by I - Jbar J, whatever the motion task uses of them."""

    def acceleration(self, state: State) -> Array:
        J = state.frame("eraser").J
        return super().acceleration(state) - analytic.dynamically_consistent_inverse(state.M, J) @ (
            J @ super().acceleration(state)
        )


def tick(robot: Robot, state: State, contacts: Mapping[str, Contact], **tasks: object) -> Output:
    controller = Controller(robot, contacts, tasks, NO_LIMITS)
    controller.reset(state.q, state.v)
    out = controller.step(0.0, state.q, state.v)
    assert out.status is Status.OK, out.reason
    return out


def home_of(robot: Robot) -> State:
    return robot.state(robot.keyframes["home"], np.zeros(robot.nv))


TABLE = ("wx", "wy", "vz")
HELD, FREE = [0, 1, 5], [2, 3, 4]


def leak(state: State) -> Array:
    """(3, 3) M_C^-1 A' Lam on the free axes: what an acceleration that the table withholds does to them."""
    A = np.eye(6)[HELD]
    M_C = analytic.task_inertia(state.M, state.frame("eraser").J)
    return np.linalg.solve(M_C, A.T @ analytic.constraint_inertia(A, M_C))[FREE]


def displaced(state: State, error: Array) -> Callable[[float], Sample]:
    """A reference at X_e = error (6,) from the eraser."""
    T = state.frame("eraser").T
    return hold(T * pin.exp6(pin.Motion(error[3:], error[:3])))


@pytest.mark.parametrize("held", range(3))
def test_identity_metric_with_the_raw_y_misses_the_leak(held):
    """The book moves the free axes by -M_C^-1 A' Lam A y, the identity metric by nothing: another law."""
    robot, kp, error = arm("panda"), 100.0, np.zeros(6)
    state, contact = home_of(robot), AxesContact("eraser", TABLE)
    error[HELD[held]] = 1e-3  # [rad, m]
    out = {}
    for kind in (MotionTask, IdentityMetric):
        draw = kind("eraser", displaced(state, error), kp, 20.0, contact.free_axes, "board", "book")
        out[kind] = tick(robot, state, {"board": contact}, draw=draw)
    J, drift = state.frame("eraser").J, state.frame("eraser").drift
    moved = {kind: (J @ o.vdot + drift)[FREE] for kind, o in out.items()}
    theory = -kp * leak(state) @ error[HELD]
    assert moved[MotionTask] == pytest.approx(theory, abs=1e-10)
    assert moved[IdentityMetric] == pytest.approx(np.zeros(3), abs=1e-10)
    assert np.abs(theory).max() > 1e-3
    wrench = analytic.task_inertia(state.M, J)[:, FREE] @ theory
    assert out[MotionTask].tau - out[IdentityMetric].tau == pytest.approx(J.T @ wrench, abs=1e-9)


def test_one_milliradian_off_the_table_moves_the_eraser_by_two_tenths_of_a_millimetre():
    """Where the leak and the free axes' own error balance: X_e on the free axes = M_C^-1 A' Lam times the held one."""
    robot, error = arm("panda"), np.zeros(6)
    state, contact = home_of(robot), AxesContact("eraser", TABLE)
    error[:2] = 1e-3
    error[FREE] = leak(state) @ error[HELD]
    assert 1e3 * error[3:5] == pytest.approx([-0.170, 0.139], abs=0.001)  # [mm]
    draw = MotionTask("eraser", displaced(state, error), 100.0, 20.0, contact.free_axes, "board", "book")
    out = tick(robot, state, {"board": contact}, draw=draw)
    assert state.frame("eraser").J @ out.vdot == pytest.approx(np.zeros(6), abs=1e-9)


def test_identity_metric_agrees_where_y_satisfies_the_constraint(rng):
    robot, contact = arm("panda"), AxesContact("eraser", TABLE)
    for state in random_states(rng, hybrid(rng, robot, contact, "compensated"), 4, Worst()):
        reference, tau = displaced(home_of(robot), np.zeros(6)), []
        for kind in (MotionTask, IdentityMetric):
            draw = kind("eraser", reference, axes=contact.free_axes, contact="board")
            tau.append(tick(robot, state, {"board": contact}, draw=draw).tau)
        assert relative(*tau) < TAU_ERROR["daqp"]


def test_unprojected_posture_errs_by_its_weight(rng):
    """Of weight e it moves the free axes by e/(1 + e) of its way: slope one in log-log."""
    robot, contact = arm("panda"), AxesContact("eraser", TABLE)
    weights = np.array([1e-4, 1e-3, 1e-2, 1e-1])
    for state in random_states(rng, hybrid(rng, robot, contact, "compensated"), 3, Worst()):
        draw = motion_task(rng, robot, "eraser", contact.free_axes, "compensated", "board")
        right = tick(robot, state, {"board": contact}, draw=draw, posture=PostureTask(robot.keyframes["home"]))
        plain = PlainPosture(robot.keyframes["home"])
        outs = [tick(robot, state, {"board": contact}, draw=draw, posture=(plain, e)) for e in weights]
        errors = np.array([out.tau - right.tau for out in outs])
        # what of the posture lies among the rows of J, but not of A J
        J, way = state.frame("eraser").J, plain.acceleration(state) - right.vdot
        row_space = projector(state.M, J) - projector(state.M, J[HELD])
        theory = np.outer(weights / (1.0 + weights), state.M @ row_space @ way)
        assert errors == pytest.approx(theory, abs=1e-8 * np.abs(right.tau).max())
        slope = np.polyfit(np.log(weights), np.log(np.abs(errors).max(axis=1)), 1)[0]
        assert slope == pytest.approx(1.0, abs=0.02)
        assert np.abs(errors[-1]).max() > 1.0  # [N m]


def projector(M: Array, G: Array) -> Array:
    """Gbar G: M-orthogonal, onto the row space of G seen through M."""
    return analytic.dynamically_consistent_inverse(M, G) @ G


@pytest.mark.parametrize("axes", [("vx", "vy"), ("wz", "vx", "vy")])
def test_six_axes_projection_errs_where_the_motion_uses_fewer(rng, axes):
    """I - Jbar J takes from the posture also what no task uses: (Jbar J - Gbar G) vdot_posture."""
    robot, contact = arm("panda"), AxesContact("eraser", TABLE)
    for state in random_states(rng, hybrid(rng, robot, contact, "compensated"), 3, Worst()):
        move = motion_task(rng, robot, "eraser", axes, "compensated")
        postures = [kind(robot.keyframes["home"]) for kind in (PostureTask, SixAxesPosture)]
        right, wrong = (tick(robot, state, {"board": contact}, move=move, posture=p) for p in postures)
        J = state.frame("eraser").J
        G = J[HELD + [VELOCITY_AXES.index(axis) for axis in axes]]
        theory = (projector(state.M, G) - projector(state.M, J)) @ postures[0].acceleration(state)
        assert wrong.vdot - right.vdot == pytest.approx(theory, abs=1e-9 * (1.0 + np.abs(right.vdot).max()))
        assert wrong.tau - right.tau == pytest.approx(state.M @ theory, abs=1e-9 * (1.0 + np.abs(right.tau).max()))
        assert (np.abs(theory).max() > 1.0) == (len(axes) == 2)  # three and the table's three are all six


@pytest.mark.parametrize("axis", [3, 4])
def test_the_books_projection_reads_friction_as_a_normal_force_and_parks_there(axis):
    """Kinetic friction of 3 N along the board. The plant is rigid: its lambda answers the torque and the friction."""
    robot, lam_d, friction = arm("panda"), np.array([0.0, 0.0, -10.0]), np.zeros(6)
    state, contact = home_of(robot), AxesContact("eraser", TABLE)
    friction[axis] = 3.0
    A, frame = np.eye(6)[HELD], state.frame("eraser")
    M_C = analytic.task_inertia(state.M, frame.J)
    x = np.linalg.solve(np.linalg.inv(M_C)[np.ix_(HELD, HELD)], np.linalg.inv(M_C)[HELD] @ friction)
    assert x == pytest.approx({3: [-0.011, -0.500, 0.507], 4: [0.414, 0.003, 0.013]}[axis], abs=0.001)  # [N m, N]

    first, parked = {}, {}
    for law in ("compensated", "book"):
        press = ForceTask("board", contact, lam_d, kp=0.3, ki=20.0, law=law)
        draw = MotionTask("eraser", hold(frame.T), axes=contact.free_axes, contact="board", law=law)
        controller = Controller(robot, {"board": contact}, {"press": press, "draw": draw}, NO_LIMITS)
        F = A.T @ lam_d + friction
        for i in range(700):
            out = controller.step(i * 1e-3, state.q, state.v, measured={"board": Wrench(F, "eraser")})
            pushed = np.linalg.solve(state.M, out.tau - state.h - frame.J.T @ friction)
            lam = nearest(state.M, A @ frame.J, -A @ frame.drift, pushed)[1]
            if not i:
                first[law] = A @ out.wrenches["board"] - lam_d
            F = A.T @ lam + friction
        parked[law] = lam - lam_d
    assert first["compensated"] == pytest.approx(np.zeros(3), abs=1e-9)
    assert first["book"] == pytest.approx(-0.3 * x, abs=1e-9)
    assert parked["compensated"] == pytest.approx(np.zeros(3), abs=1e-4)
    assert parked["book"] == pytest.approx(-x, abs=1e-4)
