"""Singularities are crossed with bounded acceleration, damped and by name; away from them nothing changes (row 12)."""

import os
from collections import Counter
from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
import runs
from bars import SINGULAR
from flight import fly

from wbc import kernels
from wbc.build import build
from wbc.controller import Controller
from wbc.limit import TorqueLimit
from wbc.reference import Path, ScrewPath, quintic
from wbc.singular import LEAST, smallest
from wbc.spec import load
from wbc.spec.task import MotionTask as MotionEntry
from wbc.task.motion import MotionTask
from wbc.task.posture import PostureTask

pytestmark = pytest.mark.row(12)

PLANE = ("wy", "vx", "vz")
LIMITS = {"torque_rate": 1000.0}
LARGE = os.environ.get("WBC_CAMPAIGN") == "large"


def within(C, T):
    """(U, s) of the rows T in what the rows C leave free, by numpy."""
    N = np.eye(T.shape[1]) - np.linalg.pinv(C, rcond=1e-9) @ C if len(C) else np.eye(T.shape[1])
    U, s, _ = np.linalg.svd(T @ N, full_matrices=True)
    return U, np.concatenate((s, np.zeros(len(T) - s.size)))


def test_the_kernel_finds_singular_values_within_contacts(rng):
    found = 0
    for i in range(600):
        n = int(rng.integers(3, 12))
        r = int(rng.integers(1, min(6, n) + 1))
        k = int(rng.integers(0, n - r + 1))
        G = rng.normal(size=(k + r, n))
        if k > 1 and i % 3 == 0:
            G[k - 1] = 2.0 * G[0]  # redundant contacts
        u = rng.normal(size=r)
        u /= np.linalg.norm(u)
        G[k:] -= (1.0 - 10.0 ** -rng.uniform(0.0, 6.0)) * np.outer(u, u @ G[k:])
        values, U = np.empty(r), np.empty((r, r))
        _, s = within(G[:k], G[k:])
        if kernels.far(G, k, 0.3):
            assert s.min() > 0.3
            continue
        kernels.singular(G, k, values, U)
        found += 1
        np.testing.assert_allclose(np.sort(values), np.sort(s), atol=1e-7)
        np.testing.assert_allclose(U @ U.T, np.eye(r), atol=1e-12)
        N = np.eye(n) - np.linalg.pinv(G[:k], rcond=1e-9) @ G[:k] if k else np.eye(n)
        np.testing.assert_allclose(np.linalg.norm(U.T @ G[k:] @ N, axis=1), values, atol=1e-7)
    assert found > 300


def test_several_tasks_are_told_as_each_alone(rng):
    """Of tasks one below the other, whatever the others are: also the same as another one, and nearly lost."""
    told = Counter()
    for _ in range(400):
        n, k = 12, int(rng.integers(0, 5))
        sizes = rng.integers(1, 5, int(rng.integers(1, 4)))
        G = rng.normal(size=(k + sizes.sum(), n))
        G[-1] *= 10.0 ** -rng.uniform(0.0, 3.0)
        if len(sizes) > 1 and rng.random() < 0.3:
            G[k + sizes[0]] = G[k]
        least = rng.choice([0.0, 0.03, 0.3], sizes.size)
        ends = k + np.cumsum(sizes)
        alone = all(
            least[i] == 0.0 or kernels.far(np.concatenate((G[:k], G[end - m : end])), k, least[i])
            for i, (m, end) in enumerate(zip(sizes, ends, strict=True))
        )
        told[alone] += 1
        assert kernels.all_far(G, k, sizes, least) == alone
    assert min(told.values()) > 50


def stretched(robot, frame, rng, spread):
    """A random state, at most `spread` [rad] a joint from an arm that is stretched out."""
    q = np.array([0.4, 0.0, 0.0]) if robot.nv == 3 else np.array([0.0, 0.6, 0.0, -0.45, 0.0, 0.8, 0.3])
    return q + rng.uniform(-spread, spread, q.size), rng.uniform(-0.5, 0.5, q.size)


def moved(robot, q, posture, singular=LEAST, axes=None, frame="flange"):
    """A controller that holds the flange 3 cm away, and its task."""
    T = robot.state(q, np.zeros(robot.nv)).frame(frame).T * pin.SE3(pin.exp3(np.full(3, 0.02)), np.full(3, 0.03))
    axes = PLANE if robot.name == "planar3r" else MotionTask.__init__.__defaults__[2]
    task = MotionTask(frame, Path(T, {}), axes=axes, singular=singular)
    tasks = {"draw": task} | ({"posture": PostureTask(robot.keyframes["home"])} if posture else {})
    return Controller(robot, tasks=tasks, limits={"torque": None, "position": None, "velocity": None}, q=q), task


@pytest.mark.parametrize("name", ["planar3r", "panda"])
class TestLaw:
    def test_the_answer_is_that_of_the_law_by_numpy(self, name, request, rng):
        robot = request.getfixturevalue("planar3r" if name == "planar3r" else "bare_panda")
        damped, largest = 0, 0.0
        for _ in range(120):
            q, v = stretched(robot, "flange", rng, 0.15)
            controller, task = moved(robot, q, posture=name == "panda")
            controller.reset(q, v)
            out = controller.step(0.0, q, v)
            G, b = task.target(controller.state)
            U, s = within(np.zeros((0, q.size)), G)
            back = PostureTask(q, 25.0, 10.0) if name == "planar3r" else controller.phase.tasks["posture"]
            free = back.acceleration(controller.state)
            low = s < LEAST
            share = np.where(low, (s / LEAST) ** 2, 1.0)
            wanted = b - U @ ((1.0 - share) * (U.T @ (b - G @ free)))
            np.testing.assert_allclose(G @ out.vdot, wanted, atol=1e-7 * (1.0 + np.abs(b).max()))
            assert ("draw.singular" in out.active) == low.any()
            if low.any():
                damped += 1
                assert f"smallest singular value is {s.min():.2g}" in out.reason
                # along what is lost, beyond what postures ask for: at most |b - G vdot_0| / s_0
                lost = np.abs(U.T @ G @ (out.vdot - free))[low] / s[low]
                bound = np.linalg.norm(b - G @ free) / LEAST
                largest = max(largest, float(lost.max() / bound))
        assert damped > 15
        assert 0.05 < largest <= 1.0 + 1e-6

    def test_away_from_singularities_torques_are_the_same_bit_for_bit(self, name, request, rng):
        robot, same = request.getfixturevalue("planar3r" if name == "planar3r" else "bare_panda"), 0
        for _ in range(60):
            q, v = stretched(robot, "flange", rng, 0.8)
            (one, task), (other, _) = (moved(robot, q, name == "panda", singular) for singular in (LEAST, 0.0))
            if smallest(task, one.robot.state(q, v), 3 if name == "planar3r" else 6) <= LEAST:
                continue
            for controller in (one, other):
                controller.reset(q, v)
            a, b = one.step(0.0, q, v), other.step(0.0, q, v)
            assert a.tau.tobytes() == b.tau.tobytes()
            assert a.active == b.active
            same += 1
        assert same > 20


# name -> robot, start, direction of the line in the world, axes, with posture; out to its end and back
REACH = 0.92  # [m] of the planar arm
CASES = {
    "planar": ("planar3r", np.array([0.6, -1.2, 0.6]), (1.0, 0.0, 0.0), PLANE, False),
    "planar redundant": ("planar3r", np.array([0.6, -1.2, 0.6]), (1.0, 0.0, 0.0), ("vx", "vz"), True),
    "panda elbow": ("bare_panda", np.array([0.0, 1.0, 0.0, -0.9, 0.0, 1.6, 0.8]), (0.86, 0.0, -0.5), None, True),
    "ur5e elbow": ("ur5e", np.array([0.0, -1.2, 0.5, -1.0, -1.57, 0.0]), (1.0, 0.0, -0.2), None, False),
}
NEARER = {"panda elbow": (3, -0.62), "ur5e elbow": (2, 0.25)}  # joint and its angle, to begin a slow crossing at
OUT = {"planar": 0.02, "planar redundant": 0.02, "panda elbow": 0.2, "ur5e elbow": 0.2}  # [m]


def crossing(robot, name, speed, singular=LEAST):
    """The flight on a straight line out of reach, or over where axes align, and back: and its task."""
    _, q, direction, axes, posture = CASES[name]
    x = np.array(direction) / np.linalg.norm(direction)
    frame = "flange" if "flange" in robot.frames else robot.frames[-1]
    far = OUT[name]
    if robot.name == "planar3r":
        if speed < 0.1:  # nearer, so that it does not take all day
            bend = np.arccos(1.0 - 0.01 / 0.8)
            q = np.array([bend, -2.0 * bend, bend])
        far += REACH - robot.state(q, np.zeros(robot.nv)).frame(frame).p[0]
    elif speed < 0.1:
        joint, angle = NEARER[name]
        q, far = np.where(np.arange(q.size) == joint, angle, q), 0.03
    T = robot.state(q, np.zeros(robot.nv)).frame(frame).T.copy()
    y = np.cross([0.0, 0.0, 1.0], x)
    y /= np.linalg.norm(y)
    line = pin.SE3(np.column_stack((x, y, np.cross(x, y))), T.translation)
    time = 1.875 * far / speed
    path = Path(line, {3: quintic([0.0, time, 2.0 * time], [0.0, far, 0.0])}, offset=line.inverse() * T)
    given = {} if axes is None else {"axes": axes}
    task = MotionTask(frame, path, error="split", singular=singular, **given)
    tasks = {"draw": task} | ({"posture": PostureTask(q)} if posture else {})
    controller = Controller(robot, tasks=tasks, limits=LIMITS, q=q)
    repeat = f"pytest tests/test_singular.py -k 'crossed and {name} and {speed}'"
    return fly(controller, q, 2.0 * time + 0.8, repeat), task


def told(robot, flown, task):
    """Smallest singular value, and distances to the reference at every tick [m]."""
    low, errors = np.inf, []
    for tick in range(len(flown.q) - 1, -1, -7):
        state = robot.state(flown.q[tick], flown.v[tick], 1e-3 * tick)
        errors.append(np.linalg.norm(task.error(state)[3:]))
        low = min(low, np.linalg.svd(task.target(state)[0], compute_uv=False).min())
    return low, np.array(errors[::-1])


@pytest.mark.parametrize("speed", [0.02, 0.5])
@pytest.mark.parametrize("name", CASES if LARGE else ["planar", "panda elbow"])
def test_it_is_crossed_with_bounded_acceleration(name, speed, request, tell):
    robot = request.getfixturevalue(CASES[name][0])
    flown, task = crossing(robot, name, speed)
    low, errors = told(robot, flown, task)
    most, rate = SINGULAR[speed]
    assert any("draw.singular" in active for active in flown.active)
    assert set(flown.status) <= {"OK", "LIMITED"}
    tell("smallest singular value", low, most=LEAST)  # it is one
    tell(f"at {speed} m/s: acceleration [rad/s^2]", flown.acceleration, most=most)
    tell(f"at {speed} m/s: rate [N m/s]", flown.rate, most=rate * (1.0 + 1e-9))
    tell("end [m]", errors[-1], most=1e-3)


@pytest.mark.parametrize("speed", [0.02, 0.5])
def test_undamped_it_is_not(speed, planar3r):
    """Else the bounds above would show nothing."""
    flown, _ = crossing(planar3r, "planar", speed, singular=0.0)
    assert flown.acceleration > 2.0 * SINGULAR[speed][0]
    assert not any("draw.singular" in active for active in flown.active)


@pytest.mark.parametrize("time", [4.0, 0.8] if LARGE else [0.8])
def test_axes_of_a_wrist_align(time, ur5e, tell):
    """From one side of the alignment to the other along one screw, that the wrist must flip for, and back."""
    ends = (np.array([0.0, -1.2, 1.6, -2.0, s * 0.15, 0.0]) + 0.04 * (s > 0) for s in (-1.0, 1.0))
    q, other = ends
    frame = ur5e.frames[-1]
    a, b = (ur5e.state(each, np.zeros(6)).frame(frame).T.copy() for each in (q, other))
    step = pin.log6(a.actInv(b))
    screw = np.concatenate((step.angular, step.linear))
    path = ScrewPath(a, [screw], [quintic([0.0, time / 2, time], [0.0, 1.0, 0.0])], pin.SE3.Identity())
    found = {}
    for singular in (LEAST, 0.0):
        task = MotionTask(frame, path, singular=singular)
        controller = Controller(ur5e, tasks={"draw": task}, limits=LIMITS, q=q)
        flown = fly(controller, q, time + 0.8, "pytest tests/test_singular.py -k wrist")
        found[singular] = flown
    assert any("draw.singular" in active for active in found[LEAST].active)
    most, rate = SINGULAR[0.02 if time > 1.0 else 0.5]
    tell("of a wrist: acceleration [rad/s^2]", found[LEAST].acceleration, most=most)
    tell("of a wrist: rate [N m/s]", found[LEAST].rate, most=rate * (1.0 + 1e-9))


@pytest.mark.parametrize(("name", "rank"), [("planar", 1), ("eraser", 3)])
def test_within_a_contact_that_holds(name, rank, rng, tell):
    """The law by numpy in what a contact leaves free, at states about those in which the arm is stretched out."""
    built = build(load(name))
    robot, none = built.robot, np.full(built.robot.nu, np.inf)
    phase = replace(built.phases[0], torque=TorqueLimit(-none, none, none, robot.joints), joint=None)
    controller = Controller(robot, phases=[phase], q=built.q)
    task, damped, largest = phase.tasks["draw"], 0, 0.0
    for i in range(150):
        q, v = stretched(robot, "eraser", rng, 0.08 if i % 3 else 0.005)
        controller.reset(q, v)
        out, state = controller.step(0.0, q, 0.2 * v), controller.state
        held = state.contacts["board"]
        G, b = task.target(state)
        U, s = within(held.G, G)
        U, s = U[:, :rank], s[:rank]
        low = s < LEAST
        assert ("draw.singular" in out.active) == low.any()
        if not low.any() or s.min() < 1e-4:
            continue
        damped += 1
        posture = PostureTask(built.q, 25.0, 10.0) if name == "planar" else phase.tasks["posture"]
        free = posture.acceleration(state)
        pull = np.linalg.solve(held.G @ np.linalg.solve(state.M, held.G.T), held.rhs - held.G @ free)
        free = free + np.linalg.solve(state.M, held.G.T @ pull)
        share = np.where(low, (s / LEAST) ** 2, 1.0)
        got, wanted = U.T @ G @ (out.vdot - free), share * (U.T @ (b - G @ free))
        np.testing.assert_allclose(got, wanted, atol=1e-6 * (1.0 + np.abs(b).max()))
        np.testing.assert_allclose(held.G @ out.vdot, held.rhs, atol=1e-7)
        largest = max(largest, float(np.abs(got[low] / s[low]).max() * LEAST / np.linalg.norm(b - G @ free)))
    assert damped > 5
    tell("within a contact: share of the bound", largest, most=1.0 + 1e-6)


BEGUN = 100  # ticks until the force that is pressed with has come up


def slid(speed, singular=LEAST, share=2.0):
    """The planar arm slides along its wall until it is stretched out, 1 cm on by its reference, and back; or some share
    of one way."""
    built = build(load("planar"))
    robot, phase = built.robot, built.phases[0]
    task, end = phase.tasks["draw"], np.sqrt(0.8**2 - 0.1**2)  # [m] from the shoulder, 0.1 m below it
    task.singular = singular
    x = end - (0.006 if speed < 0.1 else 0.25)
    bend, up = np.arccos(np.hypot(x, 0.1) / 0.8), np.arctan2(0.1, x)
    q = np.array([up + bend, -2.0 * bend, bend - up - np.pi / 2.0])
    T = robot.state(q, np.zeros(3)).frame("eraser").T.copy()
    far = end - x + 0.01
    time = 1.875 * far / speed
    task.reference = Path(T, {3: quintic([0.0, time, 2.0 * time], [0.0, far, 0.0])}, offset=pin.SE3.Identity())
    controller = Controller(robot, phases=[phase], q=q)
    repeat = f"pytest tests/test_singular.py -k 'wall and {speed}'"
    flown = fly(controller, q, share * time + 0.5, repeat, held=True)
    return flown._replace(**{name: getattr(flown, name)[BEGUN:] for name in ("q", "v", "tau", "active", "status")}), T


@pytest.mark.parametrize("speed", [0.02, 0.5])
def test_a_wall_holds_the_arm_that_crosses(speed, tell):
    """In a closed loop with a rigid wall that is pressed on: it stays on it, and comes back to where it began."""
    flown, T = slid(speed)
    robot = build(load("planar")).robot
    places = np.array([robot.state(*each).frame("eraser").p for each in zip(flown.q[::7], flown.v[::7], strict=True)])
    last = robot.state(flown.q[-1], flown.v[-1]).frame("eraser").p
    most, rate = SINGULAR[speed]
    assert any("draw.singular" in active for active in flown.active)
    assert set(flown.status) <= {"OK", "LIMITED"}
    tell(f"on a wall at {speed} m/s: acceleration [rad/s^2]", flown.acceleration, most=most)
    tell(f"on a wall at {speed} m/s: rate [N m/s]", flown.rate, most=rate)
    tell("off the wall [m]", np.abs(places[:, 2] - T.translation[2]).max(), most=1e-3)
    tell("end [m]", np.linalg.norm(last - T.translation), most=1e-3)


def test_undamped_it_does_not_cross_a_wall_calmly():
    flown, _ = slid(0.02, singular=0.0, share=0.5)
    assert flown.acceleration > 2.0 * SINGULAR[0.02][0]
    assert flown.rate > 2.0 * SINGULAR[0.02][1]


def test_it_is_told():
    """A figure of a run is the singular value by numpy, and a phase may wait for it."""
    ran = runs.result("eraser", "duration=0.3")
    built = build(load("eraser"))
    task, log = built.phases[0].tasks["draw"], ran.log
    q, v = log["q"][-1].copy(), log["v"][-1].copy()  # those of a shared run may be read-only
    state = built.robot.state(q, v)
    built.controller.reset(q, v)
    for name, contact in built.phases[0].contacts.items():
        state.contacts[name] = contact.hold(state)
    G = state.contacts["board"].stack
    _, s = within(G[:3], G[3:])
    assert log["draw.singular"][-1] == pytest.approx(s.min(), rel=1e-4)
    assert ran.summary["metrics"]["draw.singular.min"] <= s.min() * (1 + 1e-9)
    assert smallest(task, state, 3) == pytest.approx(s.min(), rel=1e-9)
    assert MotionEntry.model_fields["singular"].default == LEAST


def test_a_phase_waits_for_it():
    spec = load("chalk_liftoff")
    quantity = {"phases.approach.until": {"reach.singular": {"min": 0.01}}}
    controller = build(spec.with_set(quantity)).controller
    assert controller.phases[0].exit.until[0].read is not None
