"""Limits: torque and its rate, and joints that always brake in time, alone and as a driven robot."""

import os

import numpy as np
import pytest

from wbc.controller import Controller
from wbc.errors import GainError
from wbc.limit import JointLimit, TorqueLimit, braking, make_limits
from wbc.sim import Simulator
from wbc.task.posture import PostureTask

OVERSHOOT = 1e-3  # [rad]
OVERSPEED = 1.01  # of the velocity limit
DT = 1e-3
INF = np.inf
LARGE = os.environ.get("WBC_CAMPAIGN") == "large"


# --- torque ---


def test_torque_bounds_are_the_tighter_of_limit_and_rate():
    limit = TorqueLimit(np.array([-5.0, -9.0]), np.array([5.0, 9.0]), np.array([1000.0, INF]), ("a", "b"))
    low, high = limit.bounds(np.array([4.5, 8.9]), DT)
    np.testing.assert_allclose(low, [3.5, -9])
    np.testing.assert_allclose(high, [5, 9])
    assert limit.name(0, True, np.array([4.5, 0]), DT) == "torque[a]"
    assert limit.name(0, False, np.array([4.5, 0]), DT) == "torque_rate[a]"
    assert limit.name(0, True, np.array([0.0, 0]), DT) == "torque_rate[a]"
    assert limit.name(1, True, np.array([0.0, 0]), DT) == "torque[b]"
    assert limit.labels == ("torque[a]", "torque[b]")


def test_torque_bounds_are_never_empty_from_inside(rng):
    limit = TorqueLimit(
        -rng.uniform(1, 9, 50), rng.uniform(1, 9, 50), rng.uniform(1, 5000, 50), tuple(map(str, range(50)))
    )
    for _ in range(50):
        low, high = limit.bounds(limit.inside(rng.uniform(-20, 20, 50)), rng.uniform(1e-4, 0.1))
        assert (low <= high).all()
        assert (low >= limit.low).all()
        assert (high <= limit.high).all()


def test_limits_are_never_wider_than_the_models(bare_panda):
    torque, _ = make_limits(bare_panda, {"torque": 50.0})
    np.testing.assert_allclose(torque.high, [50] * 4 + [12] * 3)
    np.testing.assert_allclose(torque.low, -torque.high)
    with pytest.raises(GainError, match=r"limits.torque: expected positive numbers, got \[-1"):
        make_limits(bare_panda, {"torque": -1.0})


# --- one joint: a double integrator whose acceleration changes by no more than the jerk allows ---


def joints(rng, n):
    """n joints of random range, speed, deceleration and jerk, as one JointLimit."""
    half, v_max = rng.uniform(0.3, 3.0, n), rng.uniform(0.5, 6.0, n)
    a, j = 10 ** rng.uniform(0.5, 2.2, n), 10 ** rng.uniform(2.0, 4.3, n)
    return JointLimit(-half, half, v_max, a, j, tuple(map(str, range(n)))), half, v_max, j


def drive(limit, q, v, jerk, push, ticks):
    """Push as hard as bounds and jerk allow: q, v, vdot (ticks, n), and the largest share of the jerk asked for."""
    vdot, history, asked = np.zeros_like(v), [], 0.0
    for _ in range(ticks):
        rows = limit.rows(q, v, DT)
        assert (rows.lo <= rows.hi).all()
        asked = max(asked, (np.maximum(vdot - rows.hi, rows.lo - vdot) / (jerk * DT)).max())
        vdot = np.clip(np.clip(push, rows.lo, rows.hi), vdot - jerk * DT, vdot + jerk * DT)
        v = v + DT * vdot
        q = q + DT * v
        history.append((q, v, vdot))
    return *map(np.array, zip(*history, strict=True)), asked


@pytest.mark.row(9)
@pytest.mark.parametrize("start", ["inside", "at the bound"])
def test_a_joint_stops_in_time_from_every_viable_state(rng, start):
    """And asks for less jerk than the model has: the bound is never empty for a motor of that rate."""
    n = 400
    limit, half, v_max, jerk = joints(rng, n)
    q = rng.uniform(-half, half)
    top = limit.viable_speed(q)
    share = rng.uniform(-1, 1, n) if start == "inside" else rng.choice([-1.0, 1.0], n)
    v = np.where(share > 0, share * top[:n], share * top[n:])
    q_at, v_at, _, asked = drive(limit, q, v, jerk, 1e4 * np.sign(share), 3000)
    assert (np.abs(q_at) - half).max() <= OVERSHOOT / 10
    assert (np.abs(v_at) / v_max).max() <= 1.001
    assert asked <= 0.8
    # it gets there: what was pushed for three seconds is at its limit, or on the way at full speed
    late = np.minimum(half - np.abs(q_at[-1]), np.abs(1 - np.abs(v_at[-1]) / v_max))
    assert np.median(late) < 1e-3
    assert late.max() < 0.2


@pytest.mark.row(9)
def test_random_viable_states_stay_viable():
    """1e5 of them at the full size: any range, speed, brake, jerk and acceleration limit, pushed to and fro as hard as
    the bounds allow. No bound is empty, none is overstepped, and no more jerk is asked for than there is."""
    rng, n = np.random.default_rng(4), 100_000 if LARGE else 2_000
    half, v_max = rng.uniform(0.3, 3.0, n), rng.uniform(0.5, 6.0, n)
    a, jerk = 10 ** rng.uniform(0.5, 2.2, n), 10 ** rng.uniform(2.0, 4.3, n)
    a_max = np.where(rng.random(n) < 0.3, INF, 10 ** rng.uniform(-0.3, 2.3, n))
    limit = JointLimit(-half, half, v_max, a, jerk, tuple(map(str, range(n))), a_max)
    q = rng.uniform(-half, half)
    top = limit.viable_speed(q)
    v = np.where(rng.random(n) < 0.2, rng.choice([-1.0, 1.0], n), rng.uniform(-1.0, 1.0, n))
    v, vdot = v * np.where(v > 0, top[:n], top[n:]), np.zeros(n)
    push, over, fast, hard, asked = np.sign(v), -INF, 0.0, 0.0, 0.0
    for tick in range(1500):
        if tick % 150 == 149:
            push = np.where(rng.random(n) < 0.3, rng.uniform(-1.0, 1.0, n), push)
        rows = limit.rows(q, v, DT)
        assert (rows.lo <= rows.hi).all()
        asked = max(asked, (np.maximum(vdot - rows.hi, rows.lo - vdot) / (jerk * DT)).max())
        vdot = np.clip(np.clip(1e4 * push, rows.lo, rows.hi), vdot - jerk * DT, vdot + jerk * DT)
        v = v + DT * vdot
        q = q + DT * v
        over = max(over, (np.abs(q) - half).max())
        fast, hard = max(fast, (np.abs(v) / v_max).max()), max(hard, (np.abs(vdot) / a_max).max())
    assert over <= OVERSHOOT
    assert fast <= 1.001
    assert hard <= 1.0 + 1e-12
    assert asked <= 1.0
    if LARGE:
        print(f"{n} states: overshoot {over:.2g} rad, speed {fast:.4f}, acceleration {hard:.4f}, jerk {asked:.2f}")


def test_acceleration_limits_leave_room_at_any_state(rng):
    """Beyond the range and too fast as well: the bounds of all three never cross, and the limit itself is kept."""
    n = 1000
    half, v_max, a_max = rng.uniform(0.3, 3.0, n), rng.uniform(0.5, 6.0, n), 10 ** rng.uniform(-2.0, 2.0, n)
    a, jerk = 10 ** rng.uniform(0.5, 2.2, n), 10 ** rng.uniform(2.0, 4.3, n)
    limit = JointLimit(-half, half, v_max, a, jerk, tuple(map(str, range(n))), a_max)
    for _ in range(100):
        rows = limit.rows(rng.uniform(-1.2, 1.2, n) * half, rng.uniform(-1.5, 1.5, n) * v_max, DT)
        assert (rows.lo <= rows.hi).all()
        assert (np.abs([rows.lo, rows.hi]) <= a_max).all()


def test_an_acceleration_limit_alone():
    free = np.full(2, INF)
    limit = JointLimit(-free, free, free, np.full(2, 20.0), np.full(2, 2e3), ("a", "b"), np.array([3.0, INF]))
    rows = limit.rows(np.zeros(2), np.ones(2), DT)
    np.testing.assert_array_equal(rows.hi, [3.0, INF])
    np.testing.assert_array_equal(rows.lo, [-3.0, -INF])
    assert limit.name(0, True, np.zeros(2), 3.0) == "acceleration[a]"
    assert limit.name(1, True, np.zeros(2), 3.0) == "velocity[b]"


def test_a_robot_keeps_its_acceleration(bare_panda):
    """Far goals, wild gains: no joint speeds up or brakes harder, the edge is not overstepped, and it says so."""
    q, edge = bare_panda.keyframes["home"], bare_panda.q_max
    goal = PostureTask(q + 8.0, 400.0, 10.0)
    made = Controller(bare_panda, tasks={"go": goal}, limits={"torque_rate": 1000.0, "acceleration": [2.0] * 6 + [9.0]})
    plant, most, active = Simulator(bare_panda, q, DT), 0.0, set()
    made.reset(q, np.zeros(7))
    for _ in range(1500):
        seen = plant.observe()
        out = made.step(seen.t, seen.q, seen.v)
        assert "yield" not in out.reason
        most, active = max(most, np.abs(out.vdot[:6]).max()), active | set(out.active)
        plant.apply(out.tau)
        assert (seen.q <= edge + OVERSHOOT).all()
    assert most <= 2.0 + 1e-6
    assert "acceleration[joint1]" in active
    _, joint = make_limits(bare_panda, {"position": None, "velocity": None, "acceleration": 4.0})
    assert (joint.a_max == 4.0).all()
    assert make_limits(bare_panda, {"position": None, "velocity": None})[1] is None


def test_a_walker_keeps_its_acceleration(go2):
    limit = make_limits(go2, {"acceleration": 5.0})[1]
    rows = limit.rows(go2.keyframes["home"], np.zeros(18), DT)
    assert (rows.hi[6:] <= 5.0).all()
    assert (rows.hi[:6] == INF).all()


def test_a_joint_pressed_into_its_limit_rests_there(rng):
    n = 200
    limit, half, _, jerk = joints(rng, n)
    q_at, v_at, vdot, _ = drive(limit, np.zeros(n), np.zeros(n), jerk, np.full(n, 1e4), 9000)
    arrived = half - q_at[-1] < 1e-4
    assert arrived.mean() > 0.9
    assert np.abs(v_at[-1][arrived]).max() < 1e-2
    # once it brakes it does not push again: one change of sign, from speeding up to braking, no chatter
    loud = np.where(np.abs(vdot) > 1e-3 * limit.a[:n], np.sign(vdot), 0)
    for i in range(n):
        signs = loud[:, i][loud[:, i] != 0]
        assert np.count_nonzero(np.diff(signs)) <= 1, i


def test_the_stopping_distance_is_not_wasteful(rng):
    """From full speed no more than four times what a perfect brake of that deceleration and jerk needs."""
    limit, _, v_max, j = joints(rng, 200)
    a = np.minimum(limit.a[:200], np.sqrt(v_max * j))
    perfect = np.where(a * a < v_max * j, v_max**2 / (2 * a) + v_max * a / (2 * j), np.sqrt(v_max**3 / j))
    for i in range(0, 200, 10):
        one = JointLimit(np.array([-INF]), np.zeros(1), v_max[[i]], limit.a[[i]], j[[i]], ("a",))
        near, far = 0.0, 100.0
        while far - near > 1e-3:
            room = 0.5 * (near + far)
            near, far = (near, room) if one.viable_speed(np.array([-room]))[0] >= 0.999 * v_max[i] else (room, far)
        assert 0.9 * perfect[i] <= far <= 4 * perfect[i] + 0.02 * v_max[i]


@pytest.mark.row(9)
def test_beyond_its_range_a_joint_comes_back(rng):
    n = 100
    limit, half, v_max, jerk = joints(rng, n)
    q_at, v_at, _, _ = drive(limit, half + 0.05, np.zeros(n), jerk, np.full(n, 1e4), 6000)
    assert (q_at[-1] - half).max() < 1e-3
    assert (np.abs(v_at) <= v_max).all()
    q_at, v_at, _, _ = drive(limit, -0.9 * half, 1.1 * v_max, jerk, np.full(n, 1e4), 200)
    assert (v_at[-1] <= 1.01 * v_max).all()


@pytest.mark.row(9)
def test_bounds_are_never_empty_at_any_state(rng):
    limit, half, v_max, _ = joints(rng, 1000)
    for _ in range(100):
        rows = limit.rows(rng.uniform(-1.2, 1.2, 1000) * half, rng.uniform(-1.5, 1.5, 1000) * v_max, DT)
        assert (rows.lo <= rows.hi).all()
        assert np.isfinite(rows.lo).all()
        assert np.isfinite(rows.hi).all()


def test_infinite_limits_bind_nothing():
    a, j = np.full(3, 5.0), np.full(3, 500.0)
    limit = JointLimit(
        np.array([-INF, -1, -INF]), np.array([INF, 1, INF]), np.array([2.0, INF, INF]), a, j, ("a", "b", "c")
    )
    for q in (np.zeros(3), np.full(3, 0.999)):
        rows = limit.rows(q, np.full(3, 0.1), DT)
        assert rows.hi[2] == -rows.lo[2] == INF
        assert np.isfinite(rows.hi[:2]).all()
    np.testing.assert_array_equal(limit.viable_speed(np.zeros(3))[[2, 5]], [INF, INF])
    assert limit.viable_speed(np.zeros(3))[0] == 2.0
    assert 0 < limit.viable_speed(np.zeros(3))[1] < INF


def test_names_say_which_of_the_two_binds():
    limit = JointLimit(
        np.array([-1.0]), np.array([1.0]), np.array([2.0]), np.array([20.0]), np.array([2000.0]), ("elbow",)
    )
    assert limit.name(0, True, np.zeros(1)) == "velocity[elbow]"
    assert limit.name(0, True, np.array([0.99])) == "position[elbow]"
    assert limit.name(0, False, np.array([0.99])) == "velocity[elbow]"
    assert limit.name(0, False, np.array([-0.99])) == "position[elbow]"
    assert limit.labels == ("joint[elbow]",)


# --- what a robot can brake with ---


def test_braking_is_within_torque_and_rate_in_every_pose(robot, rng):
    rate = np.full(robot.nv, 1000.0)
    a, j = braking(robot, robot.tau_min, robot.tau_max, rate)
    for _ in range(50):
        state = robot.state(rng.uniform(np.maximum(robot.q_min, -3), np.minimum(robot.q_max, 3)), np.zeros(robot.nv))
        spare = np.minimum(robot.tau_max - state.h, state.h - robot.tau_min)
        signs = rng.choice([-1.0, 1.0], (20, robot.nv))
        torque, rates = np.abs((signs * a) @ state.M), np.abs((signs * j) @ state.M)
        assert np.median(torque / np.maximum(spare, 0.1 * robot.tau_max)) < 1.0
        assert np.median(rates) < 1000.0
    assert (j > 0).all()
    assert (a > 0).all()


def test_braking_without_a_rate_limit_is_finite(bare_panda):
    a, j = braking(bare_panda, bare_panda.tau_min, bare_panda.tau_max, np.full(7, INF))
    np.testing.assert_array_equal(j, np.full(7, 1e6))
    assert np.isfinite(a).all()


# --- a whole robot, driven as hard as it can be ---


def run(robot, q, v, target, gains, ticks):
    """A posture far beyond the limits: overshoot [rad], speed over its limit, ticks in which joint limits yield, ..."""
    made = Controller(robot, tasks={"posture": PostureTask(target, *gains)}, limits={"torque_rate": 1000.0})
    plant = Simulator(robot, q, DT)
    plant.data.qvel[:] = v
    made.reset(q, v)
    over, speed, yields, statuses, vdot, active = -INF, 0.0, 0, set(), [], set()
    for _ in range(ticks):
        seen = plant.observe()
        over = max(over, np.maximum(seen.q - robot.q_max, robot.q_min - seen.q).max())
        speed = max(speed, (np.abs(seen.v) / robot.v_max).max())
        out = made.step(seen.t, seen.q, seen.v)
        yields += "yield" in out.reason
        statuses.add(out.status.name)
        active.update(out.active)
        vdot.append(out.vdot)
        plant.apply(out.tau)
    return over, speed, yields, statuses, np.array(vdot), active, seen


GAINS = [(100.0, 20.0), (400.0, 10.0), (2000.0, 5.0)]  # from damped to wild


@pytest.mark.parametrize("side", [-1.0, 1.0])
@pytest.mark.parametrize("gains", GAINS)
def test_every_joint_driven_into_its_limit_stops_there(bare_panda, side, gains):
    q = bare_panda.keyframes["home"]
    over, speed, yields, statuses, vdot, active, seen = run(bare_panda, q, np.zeros(7), q + 8 * side, gains, 3000)
    assert over <= OVERSHOOT
    assert speed <= OVERSPEED
    assert yields == 0
    assert statuses <= {"OK", "LIMITED"}
    edge = bare_panda.q_max if side > 0 else bare_panda.q_min
    there = np.abs(seen.q - edge) < 1e-3  # the torque limits keep one or two from getting there
    assert there.sum() >= 5
    assert active >= {f"position[{joint}]" for joint, yes in zip(bare_panda.joints, there, strict=True) if yes}
    # pressed into the limits it rests: no chatter in the last half second
    assert np.abs(vdot[-500:, there]).max() < 0.1


@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_one_joint_driven_alone(bare_panda, side):
    edge = bare_panda.q_max if side > 0 else bare_panda.q_min
    for i in range(7):
        start = bare_panda.keyframes["home"].copy()
        start[i] = edge[i] - 0.8 * side
        target = start.copy()
        target[i] += 8 * side
        over, speed, yields, _, vdot, _, seen = run(bare_panda, start, np.zeros(7), target, (400.0, 30.0), 1000)
        assert over <= OVERSHOOT, i
        assert speed <= OVERSPEED, i
        assert yields == 0, i
        assert seen.q[i] == pytest.approx(edge[i], abs=5e-3), i
        # it speeds up, brakes, and rests: no chatter
        loud = np.sign(vdot[np.abs(vdot[:, i]) > 0.05, i])
        assert np.count_nonzero(np.diff(loud)) <= 2, i


def test_viable_states_stay_viable(bare_panda, rng):
    """Random viable states with the torque that holds the pose, pushed outwards."""
    limit = make_limits(bare_panda, {"torque_rate": 1000.0})[1]
    worst, yielded, ticks = -INF, 0, 300
    for i in range(30):
        q = rng.uniform(bare_panda.q_min, bare_panda.q_max)
        top = limit.viable_speed(q)
        v = rng.uniform(-top[7:], top[:7])
        over, speed, yields, statuses, *_ = run(
            bare_panda, q, v, q + 8 * rng.choice([-1.0, 1.0], 7), GAINS[i % 3], ticks
        )
        worst, yielded = max(worst, over), yielded + yields
        assert over <= OVERSHOOT, i
        assert speed <= OVERSPEED, i
        assert statuses <= {"OK", "LIMITED"}, i
    assert yielded <= 0.005 * 30 * ticks


def test_yielding_ends_however_hard_a_task_pushes(bare_panda):
    """From full speed in every joint the limits yield for some ticks, and then never again: tasks yield before them."""
    q = np.array([1.36, 1.74, 0.55, -2.82, 1.79, 2.5, -0.06])
    v = bare_panda.v_max * [-1, -1, -1, 1, 1, 0.2, -0.6]
    over, speed, yields, statuses, *_ = run(bare_panda, q, v, q + 8 * np.sign(v), (2000.0, 5.0), 400)
    assert 0 < yields <= 30
    assert over <= OVERSHOOT
    assert speed <= 1.05
    assert statuses <= {"OK", "LIMITED"}
