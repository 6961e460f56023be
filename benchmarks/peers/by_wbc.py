"""The problems stated with this package, in forms that `as` names.

tsid, placo   the very problem of the peer: identity metrics, a plain posture, and its hard-coded regulariser of 1e-8 on
              all its unknowns. Placo's are wrenches, tsid's the forces at the corners of a sole.
wbc           the same tasks and contacts as this package has them: inertia as metric, projected posture, distribution
floor         `pinocchio.computeAllTerms` alone
"""

from __future__ import annotations

import itertools
from typing import Any

import numpy as np
import pinocchio as pin

import wbc
from wbc.analytic.surface import YAW, corner_forces_map
from wbc.friction import unilateral
from wbc.reference import Hold
from wbc.surface import Sole

from .loop import Array, Program, serve
from .problems import load

REGULARISER = 1e-8
DOWN = np.array([0.0, 0.0, -1.0])
DIAGONAL = pin.utils.rotate("z", np.pi / 4)
AXES = {"se3": ("wx", "wy", "wz", "vx", "vy", "vz"), "orientation": ("wx", "wy", "wz")}


class Motion:
    """A frame's acceleration in the identity metric; with split errors it is that of its origin, kp e - kd v."""

    def __init__(self, task: wbc.MotionTask) -> None:
        self.task = task

    def rows(self, state: wbc.State) -> wbc.Rows:
        G, b = self.task.target(state)
        return wbc.Rows("", {"vdot": G}, b, b)


class CentreOfMass(wbc.ComTask):
    """The centre of mass in metres, not in newtons."""

    def rows(self, state: wbc.State) -> wbc.Rows:
        G, b = self.target(state)
        return wbc.Rows("", {"vdot": G}, b, b)


class Posture(wbc.PostureTask):
    """The joints' vdot = kp (q_d - q) - kd v, beside the tasks instead of behind them."""

    def __init__(self, q: Array, kp: float, kd: float) -> None:
        self.q, self.kp, self.kd = np.array(q), kp, kd

    def rows(self, state: wbc.State) -> wbc.Rows:
        n, base = self.q.size, state.robot.base
        b = self.kp * (self.q - state.q[-n:]) - self.kd * state.v[-n:]
        return wbc.Rows("", {"vdot": np.eye(n + base)[base:]}, b, b)


class Still(wbc.PostureTask):
    """What regularises the accelerations."""

    def __init__(self) -> None:
        pass

    def rows(self, state: wbc.State) -> wbc.Rows:
        zero = np.zeros(state.robot.nv)
        return wbc.Rows("", {"vdot": None}, zero, zero)


class Forces(wbc.DistributionTask):
    """Forces and moments drawn to zero; `metric` is over all multipliers, in the order of the contacts."""

    def __init__(self, metric: Array) -> None:
        super().__init__()
        self.metric = metric

    def rows(self, state: wbc.State, among: Any = None) -> wbc.Rows:
        k = len(self.metric)
        one, sizes = np.eye(k), [contact.A.shape[0] for contact in state.contacts.values()]
        ends = np.cumsum(sizes)
        A = {name: one[:, b - n : b] for name, n, b in zip(state.contacts, sizes, ends, strict=True)}
        return wbc.Rows("", A, np.zeros(k), np.zeros(k), self.metric)


class Fixed(wbc.Contact):
    """A frame whose origin does not accelerate and whose axes do not turn."""

    def __init__(self, frame: str) -> None:
        self.frame, self.k = frame, 6

    def A(self, state: wbc.State) -> Array:
        return np.eye(6)

    def Adot_V(self, state: wbc.State) -> Array:
        w, v = state.frame(self.frame).V.reshape(2, 3)
        return np.concatenate((np.zeros(3), np.cross(w, v)))


class Corner(wbc.Contact):
    """A corner of a sole, at r from the origin of its frame, whose forces are TSID's unknowns.

    Its rows are those of `Fixed` at the corner, v + w x r, so that the four of a sole ask for the same six.
    """

    def __init__(self, frame: str, r: Array) -> None:
        self.frame, self.k = frame, 3
        self._A = DIAGONAL.T @ np.hstack((-pin.skew(r), np.eye(3)))

    def A(self, state: wbc.State) -> Array:
        return self._A

    def Adot_V(self, state: wbc.State) -> Array:
        w, v = state.frame(self.frame).V.reshape(2, 3)
        return self._A[:, 3:] @ np.cross(w, v)

    def turn(self, state: wbc.State) -> Array:
        return DIAGONAL


class NoYaw(Sole):
    """A sole that may turn about its normal, as PlaCo has it: friction and centre of pressure alone."""

    def __init__(self, *given: Any) -> None:
        super().__init__(*given)
        kept = slice(0, YAW.start)
        self._wrenches, self._least, self._most = self._wrenches[kept], self._least[kept], self._most[kept]
        self._labels = self._labels[kept]


def contact(name: str, given: dict[str, Any], state: wbc.State, form: str) -> dict[str, wbc.Contact]:
    """A foot with the pyramid that the problem has, which is wider than the cone of its mu."""
    mu = np.sqrt(2.0) * given["mu"]  # four faces along the axes touch the cone of this mu with their edges
    if given["type"] == "sole" and form != "tsid":
        foot = wbc.AxesContact(given["frame"], AXES["se3"]) if form == "wbc" else Fixed(given["frame"])
        foot.pushes = (NoYaw if form == "placo" else Sole)(DOWN, tuple(given["size"]), mu)
        return {name: foot}
    # edges lie on the first two axes: of axes along the diagonals the faces lie along the world's, or the sole's
    feet: dict[str, wbc.Contact] = {name: wbc.RoundFoot(given["frame"], DIAGONAL, 0.0)}
    if given["type"] == "sole":
        x, y = 0.5 * np.array(given["size"])
        corners = itertools.product((x, -x), (y, -y))
        feet = {f"{name}{i}": Corner(given["frame"], np.array([*at, 0.0])) for i, at in enumerate(corners)}
    for foot in feet.values():
        foot.pushes = unilateral(foot, state, DOWN, mu=mu, faces=4)
    return feet


def force_metric(problem: dict[str, Any], form: str) -> Array:
    """(k, k) of w/2 |f|^2 + w/2 |m|^2 over all multipliers, with the peer's regulariser."""
    metric = np.zeros((0, 0))
    for given in problem["contacts"].values():
        W, T = np.diag([problem["moments"]] * 3 + [problem["forces"]] * 3), np.eye(6)
        if given["type"] == "point":
            T = np.eye(6)[:, 3:]
        elif form == "tsid":
            length, width = given["size"]
            turned = np.kron(np.eye(4), DIAGONAL)
            T = corner_forces_map(0.5 * length, 0.5 * width) @ turned
        old, k = len(metric), T.shape[1]
        metric = np.pad(metric, (0, k))
        metric[old:, old:] = T.T @ W @ T + REGULARISER * np.eye(k)
    return metric


def tasks(problem: dict[str, Any], robot: wbc.Robot, form: str) -> dict[str, Any]:
    """Name -> (task, weight)."""
    own, found = form == "wbc", {}
    for name, given in problem["tasks"].items():
        gains = (given["kp"], given["kd"])
        task: Any
        if given["type"] == "com":
            at = Hold(pin.SE3(np.eye(3), np.array(given["p"])))
            task = (wbc.ComTask if own else CentreOfMass)(at, *gains)
        elif given["type"] == "posture":
            q = np.array(given["q"])
            whole = robot.base and wbc.WholeBodyPosture(robot.posed(q), *gains, robot.nu)
            task = (whole or wbc.PostureTask(q, *gains)) if own else Posture(q, *gains)
        else:
            at = Hold(pin.SE3(np.array(given["R"]), np.array(given["p"])))
            motion = wbc.MotionTask(given["frame"], at, *gains, axes=AXES[given["type"]], error="split")
            task = motion if own else Motion(motion)
        found[name] = (task, 1.0 if own else given["weight"])
    if own:
        return found
    if problem["unique"]:
        return found
    found["still"] = (Still(), REGULARISER)
    return found | ({"forces": (Forces(force_metric(problem, form)), 1.0)} if problem["contacts"] else {})


def controller(problem: dict[str, Any], form: str, solver: str = "daqp") -> wbc.Controller:
    """The problem in one of the forms; positions and velocities of the joints are left free, as peers bound them
    otherwise."""
    robot = load(problem["robot"])
    q = robot.keyframes["home"]
    state = robot.state(q, np.zeros(robot.nv))
    contacts: dict[str, wbc.Contact] = {}
    for name, given in problem["contacts"].items():
        contacts |= contact(name, given, state, form)
    limits = {"torque": None if problem["unique"] else "model", "position": None, "velocity": None}
    return wbc.Controller(robot, contacts, tasks(problem, robot, form), limits, solver, q=q)


def build(problem: dict[str, Any], form: str) -> Program:
    base = (7, 6) if problem["base"] else (0, 0)
    if form == "floor":
        model = load(problem["robot"]).model
        data, nothing = model.createData(), np.zeros(len(problem["joints"]))

        def floor(q: Array, v: Array) -> tuple[Array, bool, tuple[str, ...]]:
            pin.computeAllTerms(model, data, q, v)
            return nothing, True, ()

        return Program(floor, problem["joints"], base)
    made = controller(problem, form)
    made.reset(made.start, np.zeros(made.robot.nv), np.zeros(made.robot.nu))

    def step(q: Array, v: Array) -> tuple[Array, bool, tuple[str, ...]]:
        out = made.step(0.0, q, v)
        return out.tau, bool(np.isfinite(out.certificate.dual)), out.active

    return Program(step, made.robot.joints, base)


if __name__ == "__main__":
    serve(build, f"wbc {wbc.__version__}")
