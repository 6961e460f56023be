"""Ticks that have no answer, of known cause: generated from ticks that have one by tightening two constraints at once.

With either of the two as it was there is an answer (scipy's HiGHS says so, on the rows of the tick), so both stand in
every conflict that there is: these are the known culprits. A culprit is a name, or the beginning of one that ends in
`.` or `[` (any axis of that contact), or `*` and its end (`*.friction`: of any foot).
"""

from __future__ import annotations

import copy
from functools import lru_cache
from typing import NamedTuple

import numpy as np
import pinocchio as pin
from scipy.optimize import linprog

from wbc.build import build
from wbc.contact import MatrixContact
from wbc.controller import Controller
from wbc.friction import unilateral
from wbc.limit import FloatingJointLimit, JointLimit, TorqueLimit
from wbc.phase import Phase
from wbc.spec import load
from wbc.surface import Sole
from wbc.task import PostureTask

TRIES = 60
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


def answered(C, lo, hi, C_eq=None, b_eq=None):
    """Whether some x has lo <= C x <= hi, and C_eq x = b_eq."""
    if (lo > hi).any():
        return False
    up, down = np.isfinite(hi), np.isfinite(lo)
    A, b = np.concatenate((C[up], -C[down])), np.concatenate((hi[up], -lo[down]))
    scale = np.maximum(np.linalg.norm(A, axis=1), 1e-12)
    equal = {} if C_eq is None or not len(C_eq) else {"A_eq": C_eq, "b_eq": b_eq}
    found = linprog(np.zeros(C.shape[1]), A_ub=A / scale[:, None], b_ub=b / scale, bounds=(None, None), **equal)
    return found.status == 0


def feasible(controller):
    """Whether the hard rows of the last tick hold together."""
    p = controller.tick.program.strict.problem
    n, n_eq = p.g.size, p.n_eq
    C = np.concatenate((np.eye(n), p.C[n_eq:]))
    lo, hi = (np.concatenate((side[:n], side[n + n_eq :])) for side in (p.lo, p.hi))
    return answered(C, lo, hi, p.C[:n_eq], p.lo[n : n + n_eq])


def matches(culprit, names):
    """Whether a conflict names a known culprit."""
    if culprit.startswith("*"):
        return any(name.endswith(culprit[1:]) for name in names)
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

    def make(self, q, v, limits, contacts=None):
        """`limits`: low, high, rate (nu,) of the torque, tau (nu,) before, and joint: a JointLimit or None."""
        robot = self.robot
        contacts = self.contacts if contacts is None else contacts
        low, high, rate, tau, joint = limits
        torque = TorqueLimit(low, high, rate, robot.joints)
        tasks = {} if robot.base else {"hold": PostureTask(self.q, 10.0, 5.0)}
        phase = Phase(contacts, tasks, dict.fromkeys(tasks, 1.0), torque, joint)
        made = Controller(robot, phases=[phase], q=self.q)
        made.reset(q, v, tau=tau)
        made.step(0.0, q, v)
        return made

    def torques(self, q, v):
        """Wide limits of the torque about that of rest."""
        robot = self.robot
        most = self.strong * np.minimum(robot.tau_max, -robot.tau_min)
        return -most, most, np.full(robot.nu, FREE), np.clip(robot.state(q, v).h[robot.base :], -most, most)

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


def _braked(scene, rng, what):
    """A joint that must brake for its position or speed, against its torque or the rate of it."""
    robot, (q, v, j) = scene.robot, _at_speed(scene, rng)
    limit = "velocity" if what == "velocity" else "position"
    edge = scene.edge(
        q, v, j, 10 ** rng.uniform(1.5, 3.5), 0.5 * abs(v[robot.base + j]) if limit == "velocity" else FREE
    )
    wide, name = scene.torques(q, v), robot.joints[j]
    width = rng.uniform(0.01, 0.2) * robot.tau_max[j]

    def make(first, second):
        limits = (*wide, edge if first else None)
        if second and what == "rate":
            rate = np.full(robot.nu, FREE)
            rate[j] = 1000.0 * width
            limits = (*limits[:2], rate, *limits[3:])
        elif second:
            limits = _narrow(limits, j, wide[3][j], width)
        return scene.make(q, v, limits)

    return make, (f"{limit}[{name}]", f"torque{'_rate' * (what == 'rate')}[{name}]")


def _pressed(scene, rng, what):
    """A contact that must press, against the torque of one joint."""
    robot = scene.robot
    q, v = scene.state(rng)
    name = str(rng.choice(list(scene.contacts)))
    contact = copy.copy(scene.contacts[name])
    state = robot.state(q, v)
    lever = np.abs(contact.hold(state).push).max(axis=0)[robot.base :]
    j = int(rng.choice(np.flatnonzero(lever > 0.3 * lever.max())))
    contact.pushes = copy.copy(contact.pushes)
    contact.pushes._kept, contact.pushes._least = None, contact.pushes._least.copy()
    contact.pushes._least[0] = 10 ** rng.uniform(0.0, 1.5) * 100.0
    wide = scene.torques(q, v)
    width = rng.uniform(0.01, 0.1) * robot.tau_max[j]

    def make(first, second):
        limits = (*wide, None)
        contacts = scene.contacts | ({name: contact} if first else {})
        return scene.make(q, v, _narrow(limits, j, wide[3][j], width) if second else limits, contacts)

    return make, (f"{name}.push", f"torque[{robot.joints[j]}]")


def _slippery(scene, rng, what):
    """A joint of a robot that stands must brake, against the friction of its feet."""
    robot, (q, v, j) = scene.robot, _at_speed(scene, rng)
    edge, slick = scene.edge(q, v, j, 10 ** rng.uniform(1.0, 3.0)), scene.of_friction(rng.uniform(0.02, 0.1), q)
    rough, unlimited = scene.of_friction(2.0, q), np.full(robot.nu, FREE)

    def make(first, second):
        limits = (-unlimited, unlimited, unlimited, robot.state(q, v).h[robot.base :].copy(), edge if first else None)
        return scene.make(q, v, limits, slick if second else rough)

    return make, (f"position[{robot.joints[j]}]", "*.friction")


def _clamped(scene, rng, what):
    """A joint must brake, against a wall that holds the tool on all axes and another joint that must not move."""
    robot = scene.robot
    wall = {"wall": MatrixContact("eraser", np.eye(6))}
    q, v, j = _at_speed(Scene(robot, wall, scene.q, 1.0), rng)
    unlimited = np.full(robot.nu, FREE)
    most = unlimited.copy()
    most[(j + 1 + int(rng.integers(robot.nu - 1))) % robot.nu] = rng.uniform(0.01, 1.0)
    edge = scene.edge(q, v, j, 10 ** rng.uniform(1.0, 2.0), a_max=most)

    def make(first, second):
        limits = (-unlimited, unlimited, unlimited, robot.state(q, v).h.copy(), edge if first else None)
        return scene.make(q, v, limits, wall if second else {})

    return make, (f"position[{robot.joints[j]}]", "wall.")


def _contrary(scene, rng, what):
    """Two walls hold one axis of the tool, one at rest and the other on its way."""
    robot, axis = scene.robot, int(rng.integers(6))
    q, v = Scene(robot, {}, scene.q, 1.0).state(rng)
    A = np.eye(6)[axis : axis + 1] * rng.uniform(0.5, 2.0)
    wall, lift = MatrixContact("eraser", A), Moving("eraser", A, [rng.uniform(0.1, 5.0)])

    def make(first, second):
        contacts = {"wall": wall} if first else {}
        return scene.make(q, v, (*scene.torques(q, v), None), contacts | ({"lift": lift} if second else {}))

    return make, ("wall.", "lift.")


KINDS = {
    "torque": ("chalk_stick", _braked), "rate": ("chalk_stick", _braked), "velocity": ("chalk_stick", _braked),
    "push": ("chalk_stick", _pressed), "clamped": ("eraser", _clamped), "contrary": ("eraser", _contrary),
    "go2 torque": ("go2_stand", _braked), "go2 rate": ("go2_stand", _braked), "go2 push": ("go2_stand", _pressed),
    "go2 friction": ("go2_stand", _slippery),
}  # fmt: skip


@lru_cache
def scene(spec):
    built = build(load(spec))
    contacts = built.phases[0].contacts
    return Scene(built.robot, contacts, built.q, 3.0)


def generate(seed):
    """The tick of a seed. Raises where a kind of cause makes none in many tries."""
    kind = list(KINDS)[seed % len(KINDS)]
    spec, draw = KINDS[kind]
    rng = np.random.default_rng([7, seed])
    for _ in range(TRIES):
        make, culprits = draw(scene(spec), rng, kind.split()[-1])
        made = make(True, True)
        if made.tick is not None and not feasible(made) and feasible(make(True, False)) and feasible(make(False, True)):
            return Generated(made, culprits, kind)
    raise AssertionError(f"no tick of kind {kind} with seed {seed}")
