"""What the comparison with other libraries is given, without them: the robot as URDF, and the problem as it is stated.

The oracle puts the problem together from Pinocchio's terms alone, with forces at the corners of soles where a peer has
those as unknowns, and has quadprog solve it.
"""

from __future__ import annotations

import bars
import growth
import numpy as np
import parity
import pinocchio as pin
import pytest
import quadprog
from peers import by_wbc
from peers.loop import Program, order, tick
from peers.problems import problems, states
from peers.urdf import write_urdf

from wbc.ladder import Status

WORLD = pin.LOCAL_WORLD_ALIGNED
ROBOTS = {"arm": "panda", "arm, unique": "ur5e", "quadruped": "go2", "humanoid": "g1", "humanoid, unique": "g1"}


@pytest.fixture(scope="module")
def asked():
    return problems()


def read(problem):
    """The model that a reader of URDF has, and where the problem's joints stand in it: in q, in v."""
    base = problem["base"]
    model = pin.buildModelFromXML(problem["urdf"], *((pin.JointModelFreeFlyer(),) if base else ()))
    own = order(problem["joints"], [name for name in model.names if name in problem["joints"]])
    armature = np.array(model.armature)
    armature[base:] = np.array(problem["armature"])[own]
    model.armature = armature
    first = 7 if base else 0
    return model, np.r_[np.arange(first), first + own], np.r_[np.arange(base), base + own]


@pytest.mark.parametrize("name", ["arm", "quadruped", "humanoid"])
def test_the_urdf_is_the_robot(asked, name):
    problem, robot = asked[name], by_wbc.load(ROBOTS[name])
    model, in_q, in_v = read(problem)
    ours, theirs = robot.model.createData(), model.createData()
    rng = np.random.default_rng(0)
    for _ in range(5):
        q = pin.integrate(robot.model, robot.keyframes["home"], rng.standard_normal(robot.nv))
        v = rng.standard_normal(robot.nv)
        pin.computeAllTerms(robot.model, ours, q, v)
        pin.computeAllTerms(model, theirs, q[in_q], v[in_v])
        np.testing.assert_allclose(theirs.M, ours.M[np.ix_(in_v, in_v)], atol=1e-12)
        np.testing.assert_allclose(theirs.nle, ours.nle[in_v], atol=1e-11)
        pin.updateFramePlacements(robot.model, ours)
        pin.updateFramePlacements(model, theirs)
        for task in [*problem["tasks"].values(), *problem["contacts"].values()]:
            if "frame" in task:
                poses = [d.oMf[m.getFrameId(task["frame"])] for m, d in ((robot.model, ours), (model, theirs))]
                np.testing.assert_allclose(poses[1].homogeneous, poses[0].homogeneous, atol=1e-13)


def test_a_slide_is_prismatic_and_a_ball_is_refused():
    model = pin.Model()
    slide = model.addJoint(0, pin.JointModelPY(), pin.SE3.Random(), "slide")
    model.appendBodyToJoint(slide, pin.Inertia.Random(), pin.SE3.Identity())
    again = pin.buildModelFromXML(write_urdf(model))
    assert again.joints[1].shortname() == "JointModelPY"
    q, v = np.array([0.3]), np.array([0.7])
    terms = [pin.rnea(m, m.createData(), q, v, v) for m in (model, again)]
    np.testing.assert_allclose(terms[1], terms[0], rtol=1e-12)
    model.addJoint(slide, pin.JointModelSpherical(), pin.SE3.Identity(), "ball")
    with pytest.raises(ValueError, match="'ball': expected one axis, got JointModelSpherical"):
        write_urdf(model)


class Terms:
    """What the equations need of a state, in the order of joints that the reader of the URDF has."""

    def __init__(self, problem, q, v):
        self.model, in_q, in_v = read(problem)
        self.problem, self.base, self.q, self.v = problem, problem["base"], q[in_q], v[in_v]
        self.joints = in_v[self.base :] - self.base
        model, still = self.model, np.zeros(self.model.nv)
        self.data = data = model.createData()
        self.h = pin.nonLinearEffects(model, data, self.q, self.v).copy()
        M = pin.crba(model, data, self.q)
        self.M = np.triu(M) + np.triu(M, 1).T
        pin.forwardKinematics(model, data, self.q, self.v, still)
        pin.computeJointJacobians(model, data, self.q)
        pin.updateFramePlacements(model, data)
        self.com = pin.centerOfMass(model, data, self.q, self.v, still).copy()
        self.Jcom = pin.jacobianCenterOfMass(model, data, self.q).copy()

    def frame(self, name):
        """J (6, nv), drift (6,), T and V (6,): of the classical acceleration along the world's axes, linear first."""
        at = self.model.getFrameId(name)
        J = pin.getFrameJacobian(self.model, self.data, at, WORLD)
        drift = pin.getFrameClassicalAcceleration(self.model, self.data, at, WORLD).vector
        return J, drift, self.data.oMf[at], pin.getFrameVelocity(self.model, self.data, at, WORLD).vector

    def task(self, given):
        """Rows A vdot = b."""
        kp, kd, nu = given["kp"], given["kd"], len(self.joints)
        if given["type"] == "com":
            error = np.array(given["p"]) - self.com
            return self.Jcom, kp * error - kd * self.data.vcom[0] - self.data.acom[0]
        if given["type"] == "posture":
            goal = np.array(given["q"])[self.joints]
            return np.eye(self.model.nv)[self.base :], kp * (goal - self.q[-nu:]) - kd * self.v[-nu:]
        J, drift, T, V = self.frame(given["frame"])
        error = np.r_[np.array(given["p"]) - T.translation, pin.log3(np.array(given["R"]) @ T.rotation.T)]
        rows = slice(3, 6) if given["type"] == "orientation" else slice(0, 6)
        return J[rows], (kp * error - kd * V - drift)[rows]

    def contact(self, given, form):
        """J and drift of what is held; maps of the unknown forces to its wrench, and their cones (rows >= 0)."""
        J, drift, T, _ = self.frame(given["frame"])
        mu = given["mu"]
        pyramid = np.array([[1, 0, mu], [-1, 0, mu], [0, 1, mu], [0, -1, mu]], float)
        if given["type"] == "point":
            return J[:3], drift[:3], [(np.eye(3), pyramid)]
        R, (x, y) = np.kron(np.eye(2), T.rotation), 0.5 * np.array(given["size"])
        J, drift = R.T @ J, R.T @ drift
        if form == "tsid":
            corners = [np.array([a, b, 0.0]) for a in (x, -x) for b in (y, -y)]
            return J, drift, [(np.vstack((np.eye(3), pin.skew(at))), pyramid) for at in corners]
        pressed = [[0, 0, y, s, 0, 0] for s in (1, -1)] + [[0, 0, x, 0, s, 0] for s in (1, -1)]
        return J, drift, [(np.eye(6), np.vstack((np.pad(pyramid, ((0, 0), (0, 3))), pressed)))]


def solve(problem, form, q, v):
    """Joint torques [N m] of the problem in a peer's form, in the reader's order."""
    of = Terms(problem, q, v)
    n, base = of.model.nv, of.base
    held = [of.contact(given, form) for given in problem["contacts"].values()]
    size = n + sum(B.shape[1] for _, _, forces in held for B, _ in forces)
    tau, H, g = np.pad(of.M, ((0, 0), (0, size - n))), np.eye(size) * by_wbc.REGULARISER, np.zeros(size)

    def wide(A, first=0):
        return np.pad(A, ((0, 0), (first, size - first - A.shape[1])))

    def add(A, b, weight):
        H[:] += weight * A.T @ A
        g[:] -= weight * A.T @ b

    equal, least, at = [], [], n
    for J, drift, forces in held:
        equal.append((wide(J), -drift))
        wrench = np.zeros((len(J), size))
        for B, cone in forces:
            wrench += wide(B, at)
            least.append((wide(cone, at), np.zeros(len(cone))))
            at += B.shape[1]
        tau -= J.T @ wrench
        for row, weight in zip(wrench, 3 * [problem["forces"]] + 3 * [problem["moments"]], strict=False):
            add(row[None], np.zeros(1), weight)
    for given in problem["tasks"].values():
        A, b = of.task(given)
        add(wide(A), b, given["weight"])
    equal.append((tau[:base], -of.h[:base]))
    most = np.array(problem["effort"])[of.joints]
    least += [(tau[base:], -most - of.h[base:]), (-tau[base:], of.h[base:] - most)]
    C, c = (np.concatenate([rows[i] for rows in equal + least]) for i in (0, 1))
    x = quadprog.solve_qp(H, -g, C.T, c, sum(len(b) for _, b in equal))[0]
    return (tau @ x + of.h)[base:]


def closed_form(problem, q, v):
    """The same where constraints and tasks determine vdot, and the base's six equations the one wrench."""
    of = Terms(problem, q, v)
    held = [of.contact(given, "placo")[:2] for given in problem["contacts"].values()]
    rows = [(J, -drift) for J, drift in held] + [of.task(given) for given in problem["tasks"].values()]
    G, b = (np.concatenate([row[i] for row in rows]) for i in (0, 1))
    vdot = np.linalg.solve(G, b)
    tau = of.M @ vdot + of.h
    for J, _ in held:
        tau = tau - J.T @ np.linalg.solve(J[:, :6].T, tau[:6])
    return tau[of.base :]


def stated(program, problem, q, v):
    """What the package answers, its torques in the reader's order."""
    answer = tick(program, problem["joints"], q, v)
    own = read(problem)[2][problem["base"] :] - problem["base"]
    return np.array(answer["tau"])[own], answer


@pytest.mark.parametrize(
    ("name", "form"), [("arm", "placo"), ("quadruped", "placo"), ("humanoid", "placo"), ("humanoid", "tsid")]
)
def test_the_problem_is_the_peers(asked, name, form):
    """With inequalities at work and without."""
    problem, seen = asked[name], set()
    program = by_wbc.build(problem, form)
    for q, v in list(states(by_wbc.load(ROBOTS[name]), 8))[2:]:
        tau, answer = stated(program, problem, q, v)
        expected = solve(problem, form, q, v)
        assert answer["ok"]
        seen.add(bool(answer["active"]))
        assert np.abs(tau - expected).max() <= 0.1 * bars.PARITY * (1.0 + np.abs(expected).max())
    assert seen == ({False, True} if problem["contacts"] else {False})


@pytest.mark.parametrize("name", ["arm, unique", "humanoid, unique"])
@pytest.mark.parametrize("form", ["placo", "tsid"])
def test_what_is_unique_needs_no_regulariser(asked, name, form):
    problem = asked[name]
    program = by_wbc.build(problem, form)
    for q, v in states(by_wbc.load(ROBOTS[name]), 4):
        tau, _ = stated(program, problem, q, v)
        np.testing.assert_allclose(tau, closed_form(problem, q, v), rtol=1e-8, atol=1e-8)


def test_joints_may_stand_in_another_order():
    program = Program(lambda q, v: (10.0 * q[7:] + v[6:], True, ()), ["c", "a", "b"], (7, 6))
    q, v = np.r_[np.zeros(7), 1.0, 2.0, 3.0], np.r_[np.zeros(6), 0.1, 0.2, 0.3]
    assert tick(program, ["a", "b", "c"], q, v)["tau"] == pytest.approx([10.1, 20.2, 30.3])


def test_a_wrong_torque_is_told():
    ticks = {"us": np.array([1.0, 3.0, 2.0]), "ok": np.array([True, True, False]), "active": [[], ["torque"], []]}
    right = ticks | {"tau": np.array([[1.0, 0.0], [0.0, 9.0], [5.0, 5.0]])}
    wrong = ticks | {"tau": np.array([[1.0, 0.0], [0.5, 9.0], [0.0, 0.0]])}
    assert parity.BAR <= bars.PARITY
    rows = parity.judge({"floor: Pinocchio": ticks, "wbc, as tsid": wrong, "tsid": right}, ["tsid"])
    assert rows["wbc, as tsid"]["tau_error"] == pytest.approx(0.05)
    assert (rows["wbc, as tsid"]["compared"], rows["wbc, as tsid"]["bound"]) == (2, 1)
    assert rows["tsid"] | {"p99_us": 0} == {"p50_us": 2.0, "p99_us": 0, "floors": 1.0, "refused": 1}


def test_the_robots_of_the_growth_plot_span_what_it_shows():
    counted = [about for about, _ in growth.cases().values() if "dof" in about]
    assert {about["contacts"] for about in counted if about["sweep"] == "contacts"} == set(range(9))
    assert (min(about["dof"] for about in counted), max(about["dof"] for about in counted)) == (7, 60)
    for made, dof in ((growth.holding(7), 7), (growth.standing(4, 30, 4), 30), (growth.standing(8, 54, 1), 54)):
        out = made.step(0.0, made.start, np.zeros(dof))
        assert made.robot.nv == dof
        assert out.status in (Status.OK, Status.LIMITED), out.reason
