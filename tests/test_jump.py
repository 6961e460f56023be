"""Targets and clocks that jump: what is followed does not, the torque stays calm, and it arrives (rows 13 and 4)."""

import math
from array import array
from itertools import pairwise

import numpy as np
import pinocchio as pin
import pytest
from bars import JUMP
from flight import fly
from invariants import Watched

from wbc.build import build
from wbc.controller import Controller, Status
from wbc.jump import LEAST
from wbc.kernels import approach, jumped
from wbc.lead import SETTLE, SLOPE, Lead
from wbc.reference import Path, Sample, hold, sine
from wbc.sim import Simulator
from wbc.spec import load
from wbc.spec.placed import Jump
from wbc.spec.task import ForceTask as ForceEntry
from wbc.tape import CODEC
from wbc.task.centroidal import com
from wbc.task.following import SPEEDS
from wbc.task.force import RATE, ForceTask
from wbc.task.motion import MotionTask
from wbc.task.posture import PostureTask

pytestmark = pytest.mark.row(13)

FAST = (1.0, 4.0)  # [m/s], [rad/s] for tests that are to end soon


def still(T):
    return hold(pin.SE3(T))


def differences(samples, dt):
    """Largest steps from one sample to the next, of pose, twist and acceleration beyond what these explain."""
    worst = np.zeros(3)
    for a, b in pairwise(samples):
        mean = 0.5 * (a.V + b.V) * dt
        step = pin.log6(a.T.actInv(b.T)).vector[[3, 4, 5, 0, 1, 2]] - mean
        worst = np.maximum(worst, [np.abs(step).max(), np.abs(b.V - a.V).max(), np.abs(b.Vdot - a.Vdot).max()])
    return worst


class TestLead:
    def test_it_begins_where_it_was_and_ends_on_the_reference(self, rng):
        for _ in range(40):
            T, motion = pin.SE3.Random(), rng.normal(size=(6, 2)) * 0.1
            target = Sample(pin.SE3.Random(), 0.1 * rng.normal(size=(6, 2)))
            lead = Lead.of(2.0, T, motion, target, SPEEDS)
            first = lead.onto(target, 2.0)
            np.testing.assert_allclose(first.T.homogeneous, T.homogeneous, atol=1e-9)
            np.testing.assert_allclose(first.motion, motion, atol=1e-9)
            assert lead.onto(target, lead.ends) is target
            late = lead.onto(target, lead.ends - 1e-6)
            np.testing.assert_allclose(late.motion, target.motion, atol=1e-4)

    def test_its_motion_is_the_derivative_of_its_pose(self, rng):
        target, h = Path(pin.SE3.Random(), {3: sine(0.1, 2.0), 2: sine(0.4, 3.0)}), 1e-5
        lead = Lead.of(0.0, pin.SE3.Random(), 0.2 * rng.normal(size=(6, 2)), target(0.0), FAST)
        for t in (0.05, 0.3, 0.7, 1.5):
            a, b, c = (lead.onto(target(t + s), t + s) for s in (-h, 0.0, h))
            twist = pin.log6(a.T.actInv(c.T)).vector[[3, 4, 5, 0, 1, 2]] / (2 * h)
            np.testing.assert_allclose(b.V, twist, atol=1e-6)
            np.testing.assert_allclose(b.Vdot, (c.V - a.V) / (2 * h), atol=1e-5)

    @pytest.mark.parametrize(("far", "turn"), [(0.5, 0.0), (0.0, math.pi), (0.3, 2.0), (0.01, 0.02)])
    def test_its_speed_and_acceleration_are_bounded(self, far, turn):
        T = pin.SE3(pin.exp3(np.array([0.0, 0.0, turn])), np.array([far, 0.0, 0.0]))
        target = Sample(pin.SE3.Identity(), np.zeros((6, 2)))
        lead = Lead.of(0.0, T, np.zeros((6, 2)), target, SPEEDS)
        samples = [lead.onto(target, t) for t in np.linspace(0.0, lead.ends, 400)]
        v, w = (max(np.linalg.norm(s.V[i : i + 3]) for s in samples) for i in (3, 0))
        a, b = (max(np.linalg.norm(s.Vdot[i : i + 3]) for s in samples) for i in (3, 0))
        assert v <= SPEEDS[0] * (1 + 1e-9)
        assert w <= SPEEDS[1] * (1 + 1e-9)
        assert a <= 5.78 / SLOPE / SETTLE * SPEEDS[0] + 1e-9  # 0.62 m/s^2
        assert b <= 5.78 / SLOPE / SETTLE * SPEEDS[1] + 1e-9  # 3.1 rad/s^2
        assert max(np.linalg.norm(np.cross(s.p, T.translation)) for s in samples) < 1e-12  # a straight line


def test_a_jump_is_told_from_a_motion(rng):
    """By the kernel, beside differences of poses by Pinocchio."""
    for _ in range(300):
        T, motion, h = pin.SE3.Random(), rng.normal(size=(6, 2)), 1e-3
        scale = 10.0 ** rng.uniform(-2, 2, 4) * LEAST
        pushes = [rng.normal(size=3) for _ in range(4)]
        far, angle, speed, turning = (s * p / np.linalg.norm(p) for s, p in zip(scale, pushes, strict=True))
        angle = angle * min(1.0, 3.0 / np.linalg.norm(angle))
        scale[1] = np.linalg.norm(angle)
        V = motion[:, 0]
        moved = T * pin.exp6(pin.Motion(V[3:] * h, V[:3] * h))
        moved = pin.SE3(moved.rotation @ pin.exp3(angle), moved.translation + far)
        after = motion + np.column_stack((np.concatenate((turning, speed)) + h * motion[:, 1], np.zeros(6)))
        last, told = np.empty((3, 8)), np.empty((3, 8))
        jumped(np.zeros((3, 8)), T.rotation, T.translation, motion, h, np.full(4, np.inf), last)
        if np.abs(scale / LEAST - 1.0).min() < 0.05:
            continue
        got = jumped(last, moved.rotation, moved.translation, after, h, LEAST, told)
        assert got == bool((scale > LEAST).any())
        np.testing.assert_array_equal(told[:, 3], moved.translation)


def test_a_number_goes_to_its_target_at_its_rate():
    last, out = np.array([0.0, 1.0, 2.0]), np.empty(3)
    assert approach(last, np.array([5.0, 1.5, -9.0]), np.array([1000.0, 1000.0, 100.0]), 1e-3, out)
    np.testing.assert_allclose(out, [1.0, 1.5, 1.9])
    assert not approach(last, np.array([1.0, 0.0, 2.05]), np.array([1000.0, 1000.0, 100.0]), 1e-3, out)
    np.testing.assert_array_equal(out, [1.0, 0.0, 2.05])


# --- an arm in the air: distances [m] and turns [rad] of the target at 0.1 s -----------------------------------------

JUMPS = {
    "0.5 m": ((0.0, 0.5, 0.0), 0.0),
    "180 degrees": ((0.0, 0.0, 0.0), math.pi),
    "both": ((0.05, 0.3, -0.1), math.pi),
}
START = np.array([0.0, -0.4, 0.0, -2.1, 0.0, 1.7, -1.4])


def jump(robot, far, turn, speeds, seconds, flicker=0.0):
    """The flight, with the pose that the flange is to have."""
    T = robot.state(START, np.zeros(7)).frame("flange").T.copy()
    rng = np.random.default_rng(3)

    def reference(t):
        if t < 0.1:
            return still(T)(t)
        angle = turn + flicker * rng.uniform(-1.0, 1.0)
        return still(pin.SE3(T.rotation @ pin.exp3(np.array([0.0, 0.0, angle])), T.translation + np.array(far)))(t)

    task = MotionTask("flange", reference, jump=speeds, error="split")
    tasks = {"draw": task, "posture": PostureTask(START)}
    controller = Controller(robot, tasks=tasks, limits={"torque_rate": 1000.0}, q=START)
    flown = fly(controller, START, seconds, "pytest tests/test_jump.py -k arm")
    goal = pin.SE3(T.rotation @ pin.exp3(np.array([0.0, 0.0, turn])), T.translation + np.array(far))
    return flown, goal


def judged(robot, flown, goal):
    """What is left at the end [m], [rad], beyond the goal on the way [m], and what moves at the end [m/s]."""
    start = robot.state(flown.q[0], flown.v[0]).frame("flange").p.copy()
    way = goal.translation - start
    places = [robot.state(*each).frame("flange").p.copy() for each in zip(flown.q[::20], flown.v[::20], strict=True)]
    last = robot.state(flown.q[-1], flown.v[-1]).frame("flange")
    size = np.linalg.norm(way)
    beyond = max(0.0, max((p - start) @ way / size for p in places) - size) if size else 0.0
    left = goal.actInv(last.T)
    return {
        "left": float(np.linalg.norm(left.translation)), "turned": float(np.linalg.norm(pin.log3(left.rotation))),
        "beyond": float(beyond), "moving": float(np.abs(last.V).max()),
    }  # fmt: skip


@pytest.mark.parametrize("name", JUMPS)
def test_an_arm_follows_a_jump_calmly(name, bare_panda, tell):
    far, turn = JUMPS[name]
    flown, goal = jump(bare_panda, far, turn, FAST, 2.6)
    told = judged(bare_panda, flown, goal)
    tell("rate [N m/s]", flown.rate, most=JUMP["rate"])
    tell("left [m]", told["left"], most=1e-4)
    tell("left [rad]", told["turned"], most=1e-3)
    tell("beyond [m]", told["beyond"], most=JUMP["beyond"])
    tell("moving [m/s, rad/s]", told["moving"], most=1e-3)  # no limit cycle
    assert "draw.jump" in flown.active[150]
    assert "has jumped" in flown.reasons[150]
    assert flown.status[50] == "OK"
    assert flown.status[-1] == "OK"


@pytest.mark.parametrize("name", ["0.5 m", "180 degrees"])
def test_as_it_comes_the_torque_steps(name, bare_panda):
    """Else the bounds above would show nothing."""
    far, turn = JUMPS[name]
    flown, _ = jump(bare_panda, far, turn, None, 0.3)
    assert flown.rate > 999.0
    assert any(name.startswith("torque_rate") for active in flown.active for name in active)


def test_half_a_turn_is_taken_one_way(bare_panda, tell):
    """With a target that flickers about 180 degrees, now this side and now that: no stall, no chatter."""
    flown, goal = jump(bare_panda, (0.0, 0.0, 0.0), math.pi, FAST, 2.6, flicker=1e-6)
    told, speed = judged(bare_panda, flown, goal), flown.v[:, 6]
    assert told["turned"] < 1e-3
    tell("rate [N m/s]", flown.rate, most=JUMP["rate"])
    assert (speed > -1e-3).all() or (speed < 1e-3).all()  # never back


def test_the_default_speeds_keep_their_word(bare_panda, tell):
    """The first second of 0.5 m, at 0.1 m/s."""
    flown, _ = jump(bare_panda, (0.0, 0.5, 0.0), 0.0, SPEEDS, 1.2)
    speed = max(
        float(np.linalg.norm(bare_panda.state(q, v).frame("flange").V[3:]))
        for q, v in zip(flown.q[::10], flown.v[::10], strict=True)
    )
    tell("speed by default [m/s]", speed, most=SPEEDS[0])
    tell("rate by default [N m/s]", flown.rate, most=100.0)


def test_targets_that_jump_again_and_again_are_followed(bare_panda, tell):
    """A staircase of 2 cm at 20 Hz: each step is a jump, and what is followed has no step in its acceleration."""
    T = bare_panda.state(START, np.zeros(7)).frame("flange").T.copy()

    def stairs(t):
        steps = min(math.floor(20.0 * t + 1e-9), 10)
        return still(pin.SE3(T.rotation, T.translation + np.array([0.0, 0.02 * steps, 0.0])))(t)

    task, samples = MotionTask("flange", stairs, error="split"), []
    tasks = {"draw": task, "posture": PostureTask(START)}
    controller = Controller(bare_panda, tasks=tasks, limits={"torque_rate": 1000.0}, q=START)

    def look(tick):
        told = controller.memory.followed["draw"]
        motion = np.concatenate((told[:, 4:6], told[:, 6:8]))
        samples.append(Sample(pin.SE3(told[:, :3].copy(), told[:, 3].copy()), motion))

    flown = fly(controller, START, 5.2, "pytest tests/test_jump.py -k again", after=look)
    worst = differences(samples, 1e-3)
    assert worst[0] < 1e-6
    assert worst[1] < 5e-3
    assert worst[2] < 0.1  # as the jerk has it: no step
    end = bare_panda.state(flown.q[-1], flown.v[-1]).frame("flange").p
    np.testing.assert_allclose(end, T.translation + np.array([0.0, 0.2, 0.0]), atol=1e-4)
    tell("rate on stairs [N m/s]", flown.rate, most=100.0)


# --- a force of 10 N that is to be 110 N, pressed on the board -------------------------------------------------------


def pressed(seconds, rate=RATE, target=-110.0, at=0.3, clock=lambda tick: 1e-3 * tick, missed=None):
    """(ticks,) true normal force, torques (ticks, 7), answers of the eraser in the simulator."""
    spec = load("eraser", [f"tasks.press.rate={rate}"])
    built = build(spec)
    controller, dt = built.controller, built.controller.dt
    simulator = Simulator(built.robot, built.q, dt, spec.plant, 0, built.rides)
    watched = Watched(controller, "pytest tests/test_jump.py -k force")
    watched.reset(built.q, np.zeros(7))
    forces, outs, before = [], [], None
    for tick in range(round(seconds / dt)):
        seen = simulator.observe()
        measured = None if before is None else simulator.measured(*before)
        given = None if measured is None else {"board": measured}
        targets = {"board.fz": target} if tick == round(at / dt) else None
        more = {} if missed is None else {"missed": missed(tick)}
        out = watched.step(clock(tick), seen.q, seen.v, measured=given, targets=targets, **more)
        simulator.apply(out.tau)
        before = (controller.state, out.vdot)
        forces.append(simulator.true_touch("eraser").F[5])
        outs.append(out)
    return np.array(forces), np.array([out.tau for out in outs]), outs, controller


def test_a_force_that_jumps_by_100_N(tell):
    forces, tau, outs, _ = pressed(1.4)
    rate = float(np.abs(np.diff(tau[290:], axis=0)).max() / 1e-3)
    beyond = float(-forces.min() - 110.0)
    tell("of a force: rate [N m/s]", rate, most=JUMP["force rate"])
    assert not any(name.startswith("torque_rate") for out in outs[290:] for name in out.active)
    assert "press.jump" in outs[320].active
    tell("of a force: beyond [N]", beyond, most=JUMP["force"])
    assert forces[-1] == pytest.approx(-110.0, abs=1.0)
    assert outs[-1].status is Status.OK


def test_a_target_that_is_one_array_written_to_is_led_in_as_well():
    built = build(load("eraser"))
    contact, given = built.phases[0].contacts["board"], np.array([0.0, 0.0, -10.0])
    controller = Controller(
        built.robot, {"board": contact}, {"press": ForceTask("board", contact, lambda t: given)}, q=built.q
    )
    controller.reset(built.q, np.zeros(7))
    for tick in range(3):
        given[2] = -10.0 if tick < 2 else -110.0
        out = controller.step(1e-3 * tick, built.q, np.zeros(7))
    assert "press.jump" in out.active
    assert out.wrenches["board"][5] == pytest.approx(-10.5, abs=1e-6)


def test_as_it_comes_the_torque_steps_for_a_force_too():
    _, tau, outs, _ = pressed(0.36, rate=1e9)
    rate = float(np.abs(np.diff(tau[290:], axis=0)).max() / 1e-3)
    assert rate > 999.0
    assert any(name.startswith("torque_rate") for out in outs[290:] for name in out.active)


# --- a clock that goes on by more than a tick ------------------------------------------------------------------------


@pytest.mark.parametrize("gap", [0.004, 0.1, 1.7])
def test_a_clock_that_jumps_moves_nothing_by_a_step(gap, tell):
    """The reference is where the clock says, led in; `missed` tells of the gap."""
    late = round(gap / 1e-3)
    forces, tau, outs, controller = pressed(
        1.2, target=-10.0, clock=lambda tick: 1e-3 * (tick + (late if tick >= 600 else 0)),
        missed=lambda tick: min(late - 1, 10) if tick == 600 else 0,
    )  # fmt: skip
    rate = float(np.abs(np.diff(tau[560:], axis=0)).max() / 1e-3)
    assert outs[600].status is Status.DEGRADED
    assert controller.state.t == pytest.approx(1.199 + gap)
    tell("of a clock: rate [N m/s]", rate, most=JUMP["clock"])
    tell("of a clock: force off by [N]", np.abs(forces[650:] + 10.0).max(), most=0.5)
    assert ("draw.jump" in outs[601].active) == (gap > 0.01)


# --- memory: saved, restored, replayed -------------------------------------------------------------------------------


def test_what_is_led_in_goes_on_from_a_memory_and_from_a_tape(bare_panda):
    T = bare_panda.state(START, np.zeros(7)).frame("flange").T.copy()

    def reference(t):
        return still(pin.SE3(T.rotation, T.translation + np.array([0.0, 0.4 * (t > 0.05), 0.0])))(t)

    def made():
        tasks = {"draw": MotionTask("flange", reference), "posture": PostureTask(START)}
        return Controller(bare_panda, tasks=tasks, limits={"torque_rate": 1000.0}, q=START)

    one, other, memories, outs = made(), made(), [], []
    one.reset(START, np.zeros(7))
    for tick in range(200):
        memories.append(one.memory)
        outs.append(one.step(1e-3 * tick, START, np.zeros(7)))
    for begin in (40, 52, 120):
        numbers = array("d")
        packed = CODEC.pack(memories[begin], numbers)
        other.memory = CODEC.unpack(packed, np.array(numbers))
        for tick in range(begin, 200):
            out = other.step(1e-3 * tick, START, np.zeros(7))
            assert out.tau.tobytes() == outs[tick].tau.tobytes(), (begin, tick)
    assert memories[120].starts["draw"].lead is not None


def test_what_does_not_jump_is_followed_to_the_bit():
    """Three hundred ticks of the eraser with and without what looks after jumps."""
    spec, taus = load("eraser"), []
    for guarded in (True, False):
        built = build(spec)
        if not guarded:
            built.phases[0].tasks["draw"].jump = None
            built.phases[0].__dict__.pop("following", None)
            built.phases[0].tasks["press"].rate = np.full(3, np.inf)
        controller = built.controller
        controller.reset(built.q, np.zeros(7))
        q, v = built.q.copy(), np.zeros(7)
        rows = []
        for tick in range(300):
            out = controller.step(1e-3 * tick, q, v)
            rows.append(out.tau.tobytes())
            v = v + 1e-3 * out.vdot
            q = q + 1e-3 * v
        assert ("draw" in controller.memory.followed) == guarded
        taus.append(rows)
    assert taus[0] == taus[1]


# --- robots that stand -----------------------------------------------------------------------------------------------


def stood(name, change, seconds):
    """Largest change of a torque [N m/s], answers and simulator of a shipped spec, whose tasks `change` has seen."""
    spec = load(name)
    built = build(spec)
    change(built)
    controller, dt = built.controller, built.controller.dt
    simulator = Simulator(built.robot, built.q, dt, spec.plant, 0, built.rides)
    watched = Watched(controller, f"pytest tests/test_jump.py -k {name}")
    watched.reset(built.q, np.zeros(built.robot.nv))
    outs = []
    for _ in range(round(seconds / dt)):
        seen = simulator.observe()
        outs.append(watched.step(seen.t, seen.q, seen.v))
        simulator.apply(outs[-1].tau)
    tau = np.array([out.tau for out in outs])
    return float(np.abs(np.diff(tau, axis=0)).max() / dt), outs, controller


@pytest.mark.parametrize("guarded", [True, False])
def test_a_centre_of_mass_of_go2_that_is_to_be_half_a_metre_away(guarded, tell):
    """For 0.4 s, then back: led in at 0.1 m/s it stays over the feet, and the robot stands where it stood."""

    def change(built):
        task = built.phases[0].tasks["balance"]
        path, there = task.reference, pin.SE3(np.eye(3), np.array([0.5, 0.0, 0.0]))
        far = lambda t: Sample(there * path(t).T, path(t).motion)  # noqa: E731
        task.reference = lambda t: far(t) if 0.2 <= t < 0.6 else path(t)
        if not guarded:
            task.jump = None
            built.phases[0].__dict__.pop("following", None)

    rate, outs, controller = stood("go2_stand", change, 1.3 if guarded else 0.3)
    if not guarded:
        assert rate > 2.0 * JUMP["rate"]
        return
    left = float(
        np.linalg.norm(controller.phase.tasks["balance"].desired(controller.state)[0] - com(controller.state)[0])
    )
    tell("a walker's centre of mass: rate [N m/s]", rate, most=JUMP["rate"])
    assert {out.status for out in outs} <= {Status.OK, Status.LIMITED}
    tell("a walker's centre of mass: left [m]", left, most=1e-3)


@pytest.mark.parametrize("guarded", [True, False])
def test_a_hand_of_g1_that_is_to_be_turned_by_180_degrees(guarded, tell):
    """For 0.4 s, then back: led in at 0.5 rad/s, the robot stands and its hand is where it was to be."""

    def change(built):
        task, half = built.phases[0].tasks["reach"], pin.SE3(pin.exp3(np.array([0.0, 0.0, math.pi])), np.zeros(3))
        path = task.reference
        task.reference = lambda t: Sample(path(t).T * half, path(t).motion) if 0.2 <= t < 0.6 else path(t)
        if not guarded:
            task.jump = None
            built.phases[0].__dict__.pop("following", None)

    _, outs, controller = stood("g1_wipe", change, 1.2 if guarded else 0.25)
    rate = float(np.abs(np.diff([out.tau for out in outs[150:]], axis=0)).max() / 1e-3)  # the start is behind it
    if not guarded:
        assert rate > 2.0 * JUMP["rate"]
        return
    assert "reach.jump" in outs[220].active
    assert {out.status for out in outs} <= {Status.OK, Status.LIMITED}
    tell("a humanoid's hand: rate [N m/s]", rate, most=JUMP["rate"])
    tell("a humanoid's hand: left [m, rad]", np.linalg.norm(controller.phase.tasks["reach"].error(controller.state)),
         most=1e-3)  # fmt: skip


def test_the_spec_has_the_defaults_of_the_tasks():
    assert (Jump().speed, Jump().turn) == SPEEDS
    assert ForceEntry.model_fields["rate"].default == RATE
    spec = load("eraser", ["tasks.press.rate=50"]).with_set({"tasks.draw.jump": {"speed": 0.2}})
    tasks = build(spec).phases[0].tasks
    assert tasks["draw"].jump == (0.2, 0.5)
    np.testing.assert_allclose(tasks["press"].rate, [5.0, 5.0, 50.0])
