"""Joint limits of position, velocity and acceleration against the theory of viable states (`viability`)."""

import os

import mujoco
import numpy as np
import pytest
from viability import most, smooth_stopping, stopping, viable

from wbc.controller import Controller
from wbc.limit import JointLimit, make_limits
from wbc.sim import Simulator
from wbc.task.posture import PostureTask

DT = 1e-3
INF = np.inf
OVERSHOOT = 1e-3  # [rad]
LARGE = os.environ.get("WBC_CAMPAIGN") == "large"
STATES = 100_000 if LARGE else 2_000


class Joints:
    """n joints of any range, speed, brake, jerk and acceleration limit."""

    def __init__(self, rng, n):
        self.n, self.half, self.v_max = n, rng.uniform(0.3, 3.0, n), rng.uniform(0.5, 6.0, n)
        brake, self.jerk = 10 ** rng.uniform(0.5, 2.2, n), 10 ** rng.uniform(2.0, 4.3, n)
        self.a_max = np.where(rng.random(n) < 0.3, INF, 10 ** rng.uniform(-0.3, 2.3, n))
        self.a = np.minimum(brake, self.a_max)  # what they can brake with
        names = tuple(map(str, range(n)))
        self.limit = JointLimit(-self.half, self.half, self.v_max, brake, self.jerk, names, self.a_max)

    def viable_states(self, rng):
        """A fifth of them as fast as they may be."""
        q = rng.uniform(-self.half, self.half)
        share = np.where(rng.random(self.n) < 0.2, rng.choice([-1.0, 1.0], self.n), rng.uniform(-1.0, 1.0, self.n))
        top = self.limit.viable_speed(q)
        return q, share * np.where(share > 0, top[: self.n], top[self.n :])

    def sides(self, q, v):
        """(room, speed) towards the upper, then the lower edge."""
        return (self.half - q, v), (self.half + q, -v)


def integrate(q, v, vdot, exact):
    """The next state: of an acceleration held for the tick, or as a simulator has it that takes the speed first."""
    after = v + DT * vdot
    return q + DT * (0.5 * (v + after) if exact else after), after


def test_the_theory_stops_where_it_says(rng):
    """The oracle itself: braking tick by tick takes the way that it states, and a whit more speed is too much."""
    v, a = rng.uniform(0.0, 6.0, 500), rng.uniform(0.5, 100.0, 500)
    way, speed = np.zeros(500), v.copy()
    while speed.any():
        after = np.maximum(speed - a * DT, 0.0)
        way, speed = way + 0.5 * DT * (speed + after), after
    np.testing.assert_allclose(stopping(v, a, DT), way, atol=1e-9)
    room, fast = way + 1e-3, np.full(500, INF)
    vdot = most(room, v, a, fast, DT)
    q, speed = DT * v + 0.5 * DT**2 * vdot, v + DT * vdot
    assert viable(room - q, speed, a, fast, DT, 1e-9).all()
    assert ((vdot > a - 1e-6) | ~viable(room - q - 1e-6, speed + 2e-6, a, fast, DT)).all()


def test_what_is_kept_is_viable():
    """Within the theory's set, also with a brake that takes time to build up; no command is allowed that leaves it."""
    rng = np.random.default_rng(7)
    joints = Joints(rng, STATES)
    q, v = joints.viable_states(rng)
    rows = joints.limit.rows(q, v, DT)
    assert (rows.lo <= rows.hi).all()
    assert (np.maximum(rows.hi, -rows.lo) <= joints.a_max).all()
    for (room, speed), bound in zip(joints.sides(q, v), (rows.hi, -rows.lo), strict=True):
        assert viable(room, speed, joints.a, joints.v_max, DT).all()
        assert (smooth_stopping(speed, joints.a, joints.jerk) <= room + 1e-9).all()
        theory = most(room, speed, joints.a, joints.v_max, DT)
        assert (theory >= -joints.a).all()
        assert (np.minimum(bound, joints.a) <= theory + 1e-9).all()


@pytest.mark.row(9)
@pytest.mark.parametrize("exact", [True, False], ids=["held for the tick", "speed first"])
def test_from_viable_states_to_rest(exact, record_property, tell):
    """Pushed to and fro, then outwards until they rest, with no more jerk than there is: no bound is empty, none is
    overstepped, every state on the way is viable by the theory."""
    rng = np.random.default_rng(8)
    joints = Joints(rng, STATES)
    q, v = joints.viable_states(rng)
    limit, vdot, push = joints.limit, np.zeros(joints.n), np.sign(v)
    over, fast, asked, ticks = -INF, 0.0, 0.0, 0
    while ticks < 1000 or (ticks < 40_000 and np.abs(v).max() > 1e-2):
        if ticks < 1000 and ticks % 200 == 199:
            push = np.where(rng.random(joints.n) < 0.3, rng.uniform(-1.0, 1.0, joints.n), push)
        elif ticks == 1000:
            push = np.where(rng.random(joints.n) < 0.5, -1.0, 1.0)
        rows = limit.rows(q, v, DT)
        assert (rows.lo <= rows.hi).all()
        asked = max(asked, (np.maximum(vdot - rows.hi, rows.lo - vdot) / (joints.jerk * DT)).max())
        vdot = np.clip(np.clip(1e4 * push, rows.lo, rows.hi), vdot - joints.jerk * DT, vdot + joints.jerk * DT)
        q, v = integrate(q, v, vdot, exact)
        over, fast = max(over, (np.abs(q) - joints.half).max()), max(fast, (np.abs(v) / joints.v_max).max())
        if ticks % 10 == 0:
            for room, speed in joints.sides(q, v):
                assert viable(room, speed, joints.a, 1.001 * joints.v_max, DT, OVERSHOOT).all()
        ticks += 1
        if ticks > 1000 and ticks % 500 == 0:  # those that rest need not be looked at any longer
            joints, (q, v, vdot, push) = _awake(joints, q, v, vdot, push)
            limit = joints.limit
            if not joints.n:
                break
    assert not joints.n or np.abs(v).max() <= 1e-2
    record_property("states", STATES)
    tell("overshoot [rad]", over, most=OVERSHOOT)
    assert fast <= 1.001
    assert asked <= 1.0
    if LARGE:
        print(f"{STATES} states: overshoot {over:.2g} rad, speed {fast:.5f}, jerk {asked:.2f}, {ticks} ticks")


def _awake(joints, q, v, *more):
    """Those that still move."""
    keep = np.abs(v) > 1e-2
    some = Joints.__new__(Joints)
    some.n = int(keep.sum())
    for name in ("half", "v_max", "jerk", "a_max", "a"):
        setattr(some, name, getattr(joints, name)[keep])
    brake = np.minimum(some.a, joints.limit.a[: joints.n][keep])
    names = tuple(map(str, range(some.n)))
    some.limit = JointLimit(-some.half, some.half, some.v_max, brake, some.jerk, names, some.a_max)
    return some, [each[keep] for each in (q, v, *more)]


@pytest.mark.row(9)
def test_from_outside_they_come_back(tell):
    """Beyond the range and on the way out or in: never an empty bound, no further out than the theory's brake must go,
    back inside and there to stay."""
    rng = np.random.default_rng(9)
    joints = Joints(rng, STATES // 10)
    side = rng.choice([-1.0, 1.0], joints.n)
    q = side * (joints.half + rng.uniform(0.0, 0.1, joints.n))
    brake = joints.limit.a[: joints.n]
    v = side * rng.uniform(-0.5, 0.2, joints.n) * np.minimum(joints.v_max, np.sqrt(brake * joints.half))
    farthest = np.abs(q) + smooth_stopping(side * v, brake, joints.jerk)
    vdot, peak = np.zeros(joints.n), np.abs(q)
    for _ in range(20_000):
        rows = joints.limit.rows(q, v, DT)
        assert (rows.lo <= rows.hi).all()
        vdot = np.clip(np.clip(1e4 * side, rows.lo, rows.hi), vdot - joints.jerk * DT, vdot + joints.jerk * DT)
        q, v = integrate(q, v, vdot, True)
        peak = np.maximum(peak, np.abs(q))
    tell("from outside: left beyond [rad]", (np.abs(q) - joints.half).max(), most=OVERSHOOT)
    assert (peak - farthest).max() <= OVERSHOOT


@pytest.mark.row(9)
def test_a_robot_beyond_its_range_comes_back_and_says_so(bare_panda):
    """And a task that pulls it out is not followed."""
    for joint in (1, 3, 5):
        q = bare_panda.keyframes["home"].copy()
        q[joint] = bare_panda.q_max[joint] + 0.05
        made = Controller(bare_panda, tasks={"hold": PostureTask(q, 100.0, 20.0)}, limits={"torque_rate": 1000.0})
        plant, first = Simulator(bare_panda, q, DT), ()
        plant.model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_LIMIT)  # no stop of steel does it
        made.reset(q, np.zeros(7))
        for _ in range(1500):
            seen = plant.observe()
            out = made.step(seen.t, seen.q, seen.v)
            first = first or out.active
            assert out.status.name in ("OK", "LIMITED"), out.reason
            plant.apply(out.tau)
        assert seen.q[joint] <= bare_panda.q_max[joint] + OVERSHOOT
        assert f"position[{bare_panda.joints[joint]}]" in first
        assert f"position[{bare_panda.joints[joint]}]" in out.active  # the goal is still out there


@pytest.mark.row(9)
@pytest.mark.parametrize("name", ["panda", "ur5e"])
def test_all_limits_of_a_robot_leave_an_answer_in_every_viable_state(name, request, tell):
    """Torque, its rate, position, velocity and acceleration together, all joints at any viable speed at once, the
    torque that of a motion without acceleration, a task that pulls as hard as it can: nothing yields."""
    robot = request.getfixturevalue({"panda": "bare_panda"}.get(name, name))
    rng, worst = np.random.default_rng(10), 0
    for accelerations in (None, 5.0, 20.0):
        limits = {"torque_rate": 1000.0, "acceleration": accelerations}
        limit = make_limits(robot, limits)[1]
        made = Controller(robot, tasks={"pull": PostureTask(np.zeros(robot.nv), 400.0, 30.0)}, limits=limits)
        for _ in range((50_000 if LARGE else 1000) // 3):
            q = rng.uniform(np.maximum(robot.q_min, -np.pi), np.minimum(robot.q_max, np.pi))
            top = limit.viable_speed(q)
            v = rng.uniform(-top[robot.nv :], top[: robot.nv])
            made.reset(q, v, tau=robot.state(q, v).h.copy())
            made.phase.tasks["pull"].q[:] = q + rng.uniform(-8.0, 8.0, robot.nv)
            out = made.step(0.0, q, v)
            assert out.status.name in ("OK", "LIMITED"), out.reason
            worst += "yield" in out.reason
    tell("viable states of a robot without an answer", worst, most=0)
