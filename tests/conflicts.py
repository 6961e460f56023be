"""Ticks that have no answer, of known cause: generated from ticks that have one by tightening two constraints at once.

With either of the two as it was there is an answer (`violation` says so, on the rows that go to a solver), so both
stand in every conflict that there is: these are the known culprits. A culprit is a name, or the beginning of one that
ends in `.` or `[` (any axis of that contact), or `*` and its ends (`*.friction|.yaw`: of any foot).
"""

from __future__ import annotations

import copy
import warnings
from collections.abc import Callable
from functools import lru_cache
from typing import NamedTuple

import numpy as np
import pinocchio as pin
from qpsolvers import Problem, solve_problem

from wbc.build import build
from wbc.collision import SelfCollision
from wbc.contact.axes import MatrixContact
from wbc.controller import Controller
from wbc.friction import unilateral
from wbc.limit import FloatingJointLimit, JointLimit, TorqueLimit
from wbc.phase import Phase
from wbc.spec import load
from wbc.surface import Sole
from wbc.task.posture import PostureTask

TRIES, STEPS = 200, 6
TOLERANCE = 1e-5  # of rows of norm 1 that hold together
CLEAR = 1e-3  # of a tick that has no answer
SOLVERS = (("piqp", {"eps_abs": 1e-9, "eps_rel": 0.0}), ("piqp", {"eps_abs": 1e-8, "eps_rel": 0.0}), ("clarabel", {}))
FAR = (("clarabel", dict.fromkeys(("tol_gap_abs", "tol_gap_rel", "tol_feas"), 1e-10)), ("highs", {}))
FREE = np.inf


class Generated(NamedTuple):
    """A controller after its tick, the known culprits, and how it was made."""

    controller: Controller
    culprits: tuple[str, ...]
    kind: str


class Moving(MatrixContact):
    """A wall that holds some axes while it accelerates along them."""

    def __init__(self, frame, A, ahead):
        super().__init__(frame, A)
        self._ahead = np.array(ahead, float)
        self._zero = -self._ahead

    def hold(self, state):
        return self._hold(state, self._A, self._free, self._inverse, self._basis, self._zero)


def violation(C, lo, hi, E=None, e=None, solvers=SOLVERS, within=np.inf):
    """The least t by which all rows, scaled to a norm of 1, must give way for some x with E x = e: measured of the x of
    the first solver that has one no larger than `within`, not a number where none has."""
    up, down = np.isfinite(hi), np.isfinite(lo)
    A, b = np.concatenate((C[up], -C[down])), np.concatenate((hi[up], -lo[down]))
    norm = np.maximum(np.linalg.norm(A, axis=1), 1e-12)
    A, b = A / norm[:, None], b / norm
    m, n = A.shape
    E, e = (np.zeros((0, n)), np.zeros(0)) if E is None else (E, e)
    far = 1.0 / np.maximum(np.abs(A * norm[:, None]).max(axis=0, initial=0.0), 1e-6)  # a light wrist flies off fast
    G = np.zeros((m + 1, n + 1))
    G[:m, :n], G[:, n] = A * far, -1.0
    program = Problem(np.zeros((n + 1, n + 1)), np.eye(n + 1)[n], G, np.append(b, 0.0))
    if len(E):
        program.A, program.b = np.c_[E * far, np.zeros(len(E))], e
    for solver, accuracy in solvers:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of sparse copies, and of what is not so exact
            found = solve_problem(program, solver, **accuracy)
        if found.found:
            x = far * found.x[:n]
            if np.abs(x).max(initial=0.0) > within:
                continue
            return max((A @ x - b).max(initial=0.0), np.abs(E @ x - e).max(initial=0.0))
    return np.nan


def answered(*rows, within=np.inf):
    """Whether some x, no larger than `within`, satisfies the rows, to `TOLERANCE`. Interior points lose answers that
    are far away (|x| of 1e6 and more); a point of whatever origin is a proof, for it is measured."""
    tried = (SOLVERS, *((one,) for one in FAR))
    return any(violation(*rows, solvers=solvers, within=within) <= TOLERANCE for solvers in tried)


def missed(controller):
    """By how much the hard rows of the last tick must give way."""
    tick = controller.tick.refused or controller.tick  # with all contacts
    p = tick.program.strict.problem
    return violation(np.concatenate((np.eye(p.g.size), p.C)), p.lo, p.hi)


def matches(culprit, names):
    """Whether a conflict names a known culprit."""
    if culprit.startswith("*"):
        return any(name.endswith(tuple(culprit[1:].split("|"))) for name in names)
    if culprit.endswith((".", "[")):
        return any(name.startswith(culprit) for name in names)
    return culprit in names


class Scene:
    """A robot with the contacts that it stands or presses with; `make` does one tick of it under given limits."""

    def __init__(self, robot, contacts, q, strong):
        self.robot, self.contacts, self.q, self.strong = robot, contacts, q, strong  # in the model's torques

    def state(self, rng):
        """A random state that keeps the velocities which its contacts forbid at zero."""
        robot = self.robot
        q = pin.integrate(robot.model, self.q, np.r_[np.zeros(robot.base), rng.uniform(-0.2, 0.2, robot.nu)])
        v = rng.uniform(-0.5, 0.5, robot.nv)
        state = robot.state(q, v)
        rows = [contact.hold(state).G.copy() for contact in self.contacts.values()]
        if rows:
            G = np.concatenate(rows)
            v = v - np.linalg.pinv(G, rcond=1e-8) @ (G @ v)
        return q, v

    def make(self, q, v, limits, contacts=None, collision=None):
        """`limits`: low, high, rate (nu,) of the torque, tau (nu,) before, and joint: a JointLimit or None."""
        robot = self.robot
        contacts = self.contacts if contacts is None else contacts
        low, high, rate, tau, joint = limits
        torque = TorqueLimit(low, high, rate, robot.joints)
        tasks = {} if robot.base else {"hold": PostureTask(self.q, 10.0, 5.0)}
        phase = Phase(contacts, tasks, dict.fromkeys(tasks, 1.0), torque, joint, collision=collision)
        made = Controller(robot, phases=[phase], q=self.q)
        made.reset(q, v, tau=tau)
        made.step(0.0, q, v)
        return made

    def torques(self, q, v, j=None):
        """Limits of the torque about that of rest; wide for joint j, or where all are strong."""
        robot = self.robot
        most = np.minimum(robot.tau_max, -robot.tau_min)
        room = np.full(robot.nu, self.strong)
        room[slice(0) if j is None else j] = max(self.strong, 3.0)
        rest = np.clip(robot.state(q, v).h[robot.base :], -most, most)
        return rest - room * most, rest + room * most, np.full(robot.nu, FREE), rest

    def of_friction(self, mu, q):
        """Its contacts on a ground of that friction."""
        robot, found = self.robot, {}
        for name, contact in self.contacts.items():
            found[name] = copy.copy(contact)
            if isinstance(contact.pushes, Sole):
                found[name].pushes = Sole(contact.pushes.d, contact.pushes.size, mu)
            else:
                found[name].pushes = unilateral(contact, robot.state(q, np.zeros(robot.nv)), contact.pushes.d, mu=mu)
        return found

    def edge(self, q, v, j, brake, speed=FREE, a_max=None):
        """Limits of one joint alone, that it meets in the next moment: of its position, or of its speed."""
        robot, n = self.robot, self.robot.nu
        q_max, q_min, v_max = np.full(n, FREE), np.full(n, -FREE), np.full(n, FREE)
        at, v_j = q[(7 if robot.base else 0) + j], v[robot.base + j]
        if np.isfinite(speed):
            v_max[j] = speed
        elif v_j > 0.0:
            q_max[j] = at + 0.002 * v_j
        else:
            q_min[j] = at + 0.002 * v_j
        kind = FloatingJointLimit if robot.base else JointLimit
        return kind(q_min, q_max, v_max, np.full(n, brake), np.full(n, 1e5), robot.joints, a_max)


def _narrow(limits, j, tau, width):
    """The torque of one joint held within `width` of a value."""
    low, high, rate, past, joint = limits
    low, high, past = low.copy(), high.copy(), past.copy()
    low[j], high[j] = tau - width, tau + width
    past[j] = np.clip(past[j], low[j], high[j])
    return low, high, rate, past, joint


def _at_speed(scene, rng):
    """A state, and a joint of some speed in it."""
    robot = scene.robot
    q, v = scene.state(rng)
    j = int(rng.choice(np.flatnonzero(np.abs(v[robot.base :]) > 0.2 * np.abs(v[robot.base :]).max())))
    return q, v * max(1.0, rng.uniform(0.3, 2.0) / abs(v[robot.base + j])), j


class Draw(NamedTuple):
    """`make(first, second, demand)` makes a tick with either of two constraints or both; `demand` says how much the
    first asks for, 10^`least` to 10^`most`."""

    make: Callable[[bool, bool, float], Controller]
    culprits: tuple[str, str]
    least: float
    most: float


def _braked(scene, rng, what):
    """A joint that must brake for its position or speed, against its torque or the rate of it."""
    robot, (q, v, j) = scene.robot, _at_speed(scene, rng)
    limit = "velocity" if what == "velocity" else "position"
    speed = 0.5 * abs(v[robot.base + j]) if limit == "velocity" else FREE
    wide, name = scene.torques(q, v, j), robot.joints[j]
    width = rng.uniform(0.01, 0.2) * robot.tau_max[j]

    def make(first, second, demand):
        limits = (*wide, scene.edge(q, v, j, demand, speed) if first else None)
        if second and what == "rate":
            rate = np.full(robot.nu, FREE)
            rate[j] = 1000.0 * width
            limits = (*limits[:2], rate, *limits[3:])
        elif second:
            limits = _narrow(limits, j, wide[3][j], width)
        return scene.make(q, v, limits)

    return Draw(make, (f"{limit}[{name}]", f"torque{'_rate' * (what == 'rate')}[{name}]"), 0.5, 3.5)


def _pressed(scene, rng, what):
    """A contact that must press, against the torque of one joint."""
    robot = scene.robot
    q, v = scene.state(rng)
    name = str(rng.choice(list(scene.contacts)))
    lever = np.abs(scene.contacts[name].hold(robot.state(q, v)).push).max(axis=0)[robot.base :]
    j = int(rng.choice(np.flatnonzero(lever > 0.3 * lever.max())))
    wide = scene.torques(q, v, j)
    width = rng.uniform(0.01, 0.1) * robot.tau_max[j]

    def make(first, second, demand):
        contact = copy.copy(scene.contacts[name])
        contact.pushes = copy.copy(contact.pushes)
        contact.pushes._kept, contact.pushes._least = None, contact.pushes._least.copy()
        contact.pushes._least[0] = demand
        limits = (*wide, None)
        contacts = scene.contacts | ({name: contact} if first else {})
        return scene.make(q, v, _narrow(limits, j, wide[3][j], width) if second else limits, contacts)

    return Draw(make, (f"{name}.push", f"torque[{robot.joints[j]}]"), 1.0, 4.0)


def _slippery(scene, rng, what):
    """A joint of a robot that stands must brake, against the friction of its feet."""
    robot, (q, v, j) = scene.robot, _at_speed(scene, rng)
    slick, rough = scene.of_friction(rng.uniform(0.02, 0.1), q), scene.of_friction(2.0, q)
    low, high, rate, tau = scene.torques(q, v, j)
    if scene.strong > 1.0:
        low, high = np.full((2, robot.nu), FREE) * [[-1.0], [1.0]]

    def make(first, second, demand):
        limits = (low, high, rate, tau, scene.edge(q, v, j, demand) if first else None)
        return scene.make(q, v, limits, slick if second else rough)

    return Draw(make, (f"position[{robot.joints[j]}]", "*.friction|.yaw"), 0.5, 3.5)


def _clamped(scene, rng, what):
    """A joint must brake, against a wall that holds the tool on all axes and another joint that must not move."""
    robot = scene.robot
    wall = {"wall": MatrixContact("eraser", np.eye(6))}
    q, v, j = _at_speed(Scene(robot, wall, scene.q, 1.0), rng)
    unlimited = np.full(robot.nu, FREE)
    most = unlimited.copy()
    most[(j + 1 + int(rng.integers(robot.nu - 1))) % robot.nu] = rng.uniform(0.01, 1.0)

    def make(first, second, demand):
        edge = scene.edge(q, v, j, demand, a_max=most)
        limits = (-unlimited, unlimited, unlimited, robot.state(q, v).h.copy(), edge if first else None)
        return scene.make(q, v, limits, wall if second else {})

    return Draw(make, (f"position[{robot.joints[j]}]", "wall."), 0.5, 2.5)


def _contrary(scene, rng, what):
    """Two walls hold one axis of the tool, one at rest and the other on its way."""
    robot, axis = scene.robot, int(rng.integers(6))
    q, v = Scene(robot, {}, scene.q, 1.0).state(rng)
    A = np.eye(6)[axis : axis + 1] * rng.uniform(0.5, 2.0)
    wall = MatrixContact("eraser", A)

    def make(first, second, demand):
        lift = Moving("eraser", A, [demand])
        contacts = {"lift": lift} if first else {}
        return scene.make(q, v, (*scene.torques(q, v), None), contacts | ({"wall": wall} if second else {}))

    return Draw(make, ("lift.", "wall."), -1.0, 1.0)


def _nearing(scene, rng, what):
    """Two bodies must not meet, against the torque of a joint: the others that move them have hardly any to add."""
    robot = scene.robot
    q, v = scene.state(rng)
    pairs = robot.pairs()
    far = pairs.distances(robot.state(q, v))
    near = np.flatnonzero((far > 0.01) & (far < 0.3) & (pairs.home > far))
    if not near.size:
        return None
    distance = 0.98 * far[rng.choice(near)]
    rows, told, _ = SelfCollision(robot, distance).told(robot.state(q, 100.0 * v))
    row = int(rng.integers(len(told)))
    v = v * -np.sign(told[row, 1]) * rng.uniform(0.1, 0.5) / max(0.01 * abs(told[row, 1]), 1e-3)
    moves = np.abs(rows.A["vdot"][row, robot.base :])
    j = int(rng.choice(np.flatnonzero(moves > 0.3 * moves.max())))
    width = rng.uniform(0.001, 0.05) * robot.tau_max
    wide = scene.torques(q, v, j)
    base = (*wide, None)
    for i in np.flatnonzero(moves > 1e-9):
        base = _narrow(base, i, wide[3][i], width[i]) if i != j else base

    def make(first, second, demand):
        limits = _narrow(base, j, wide[3][j], width[j]) if second else base
        return scene.make(q, v, limits, collision=SelfCollision(robot, distance, demand) if first else None)

    return Draw(make, ("collision[", f"torque[{robot.joints[j]}]"), 0.0, 2.0)


KINDS = {
    "torque": ("chalk_stick", _braked), "rate": ("chalk_stick", _braked), "velocity": ("chalk_stick", _braked),
    "push": ("chalk_stick", _pressed), "clamped": ("eraser", _clamped), "contrary": ("eraser", _contrary),
    "go2 torque": ("go2_stand", _braked), "go2 rate": ("go2_stand", _braked), "go2 push": ("go2_stand", _pressed),
    "go2 friction": ("go2_stand", _slippery), "g1 torque": ("g1_stand", _braked), "g1 rate": ("g1_stand", _braked),
    "g1 push": ("g1_stand", _pressed), "g1 friction": ("g1_stand", _slippery), "g1 collision": ("g1_stand", _nearing),
    "collision": ("chalk_stick", _nearing),
}  # fmt: skip


@lru_cache
def scene(spec):
    built = build(load(spec))
    contacts = built.phases[0].contacts
    return Scene(built.robot, contacts, built.q, 0.1 if spec.startswith("g1") else 3.0)


def generate(seed):
    """The tick of a seed: a demand that is met without the second constraint and is not with it is searched for.

    Raises where a kind of cause makes none in many tries.
    """
    kind = list(KINDS)[seed % len(KINDS)]
    spec, draw = KINDS[kind]
    rng = np.random.default_rng([7, seed])
    for _ in range(TRIES):
        drawn = draw(scene(spec), rng, kind.split()[-1])
        if drawn is None or not missed(drawn.make(False, True, 1.0)) <= TOLERANCE:
            continue
        least, most = drawn.least, drawn.most
        for _ in range(STEPS):
            power = rng.uniform(least, most)
            made = drawn.make(True, True, 10.0**power)
            if not missed(made) > CLEAR:
                least = power
            elif missed(drawn.make(True, False, 10.0**power)) <= TOLERANCE:
                return Generated(made, drawn.culprits, kind)
            else:
                most = power
    raise AssertionError(f"no tick of kind {kind} with seed {seed}")
