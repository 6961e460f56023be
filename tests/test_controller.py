"""The tick from outside: bad data, the ladder, memory, gravity by the driver, targets, limits, yielding."""

from __future__ import annotations

import copy

import numpy as np
import pytest

import wbc
from wbc.errors import NameNotFound, SolverError, StateError
from wbc.ladder import GOOD_TICKS, HOLD_TICKS, Status
from wbc.phase import hold
from wbc.solver import Daqp
from wbc.task.force import ForceLoop

SPEC = wbc.load("eraser")
ROBOT = wbc.Robot.load("panda", tool="eraser", scene="board")
DRIVEN = wbc.Robot.load("panda", tool="eraser", scene="board", gravity="robot")


class Failing:
    """DAQP that can be told to fail, or to lie."""

    def __init__(self):
        self.inner, self.fail, self.lie = Daqp(), False, 0.0

    def solve(self, problem):
        if self.fail:
            raise RuntimeError("planned")
        x, z = self.inner.solve(problem)
        return x + self.lie, z


def controller(robot=ROBOT, **changes):
    made = wbc.Controller.from_spec(SPEC, robot=robot, **changes)
    made.reset(made.start, np.zeros(7))
    return made


def press(fz=-10.0):
    return {"board": wbc.Wrench.on_environment(f=[0.0, 0.0, fz], m=[0.0, 0.0, 0.0], frame="eraser")}


def run(made, ticks, start=0, **kwargs):
    return [made.step(0.001 * (start + i), made.start, np.zeros(7), measured=press(), **kwargs) for i in range(ticks)]


def carried(q, lam):
    """(7,) the torque that carries the weight and what presses the board, (mx, my, fz) = lam."""
    state = ROBOT.state(q, np.zeros(7))
    return state.gravity() + state.frame("eraser").J[[0, 1, 5]].T @ lam


def test_good_ticks_are_ok_once_the_rate_limit_lets_go():
    out = run(controller(), 20)[-1]
    assert out.status is Status.OK
    assert out.reason == ""
    assert out.active == ()
    assert max(out.certificate) < 1e-6
    np.testing.assert_allclose(out.wrenches["board"], [0, 0, 0, 0, 0, -10.0], atol=0.2)


def test_the_first_torque_continues_what_reset_was_told():
    made = controller()
    tau = ROBOT.state(made.start, np.zeros(7)).gravity() + 3.0
    made.reset(made.start, np.zeros(7), tau=tau)
    out = made.step(0.0, made.start, np.zeros(7), measured=press())
    assert np.abs(out.tau - tau).max() <= 1.0 + 1e-9
    assert out.status is Status.LIMITED
    assert any(name.startswith("torque_rate[") for name in out.active)


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("which", ["q", "v"])
def test_every_index_of_the_state_is_refused_when_not_finite(bad, which):
    made = controller()
    run(made, 12)
    for i in range(7):
        memory = made.memory
        state = {"q": made.start.copy(), "v": np.zeros(7)}
        state[which][i] = bad
        out = made.step(0.02, state["q"], state["v"])
        assert out.status is Status.DEGRADED
        assert out.reason.startswith(f"{which}: expected finite numbers")
        load = carried(made.start, memory.lam["board"])
        np.testing.assert_allclose(out.tau, load + 0.8 * (memory.tau - load), atol=1e-12)
        made.memory = memory


@pytest.mark.parametrize(
    ("q", "said"),
    [
        (np.zeros(6), r"q: expected a float64 array of shape \(7,\), got float64 \(6,\)"),
        (np.zeros((7, 1)), r"q: expected .* got float64 \(7, 1\)"),
        (np.zeros(7, dtype=np.float32), "got float32"),
        ([0.0] * 7, "got list"),
        (None, "got NoneType"),
        ("q", "got str"),
    ],
)
def test_a_wrong_state_is_named_and_leaves_no_trace(q, said):
    made, twin = controller(), controller()
    run(made, 12), run(twin, 12)
    out = made.step(0.012, q, np.zeros(7))
    assert out.status is Status.DEGRADED
    with pytest.raises(AssertionError, match=said):
        raise AssertionError(out.reason)
    after, other = run(made, 1, start=12)[0], run(twin, 1, start=12)[0]
    np.testing.assert_array_equal(after.tau, other.tau)


@pytest.mark.parametrize("t", [np.nan, np.inf, None, "0"])
def test_a_wrong_time_is_refused(t):
    made = controller()
    run(made, 12)
    assert made.step(t, made.start, np.zeros(7)).reason.startswith("t: expected a finite time")


def test_the_integral_never_takes_more_than_two_periods():
    made = controller()
    run(made, 12)
    memory = made.memory
    steps = []
    for jump in (0.001, 0.002, 5.0, 0.0, -1.0):
        made.memory = memory
        made.step(memory.t + jump, made.start, np.zeros(7), measured=press(-9.0))
        steps.append(made.memory.loops["board"].integral[2] - memory.loops["board"].integral[2])
    assert abs(steps[2]) <= abs(steps[1]) + 1e-12
    assert steps[3] == steps[4] == 0.0


def test_wrenches_and_targets_that_are_not_finite_are_refused_and_the_old_ones_stand():
    made = controller()
    run(made, 12)
    bad = wbc.Wrench.on_environment(f=[0, 0, np.nan], m=[0, 0, 0], frame="eraser")
    out = made.step(0.012, made.start, np.zeros(7), measured={"board": bad}, targets={"board.fz": np.nan})
    assert out.status is Status.LIMITED
    assert "measured.board" in out.reason
    assert "targets.board.fz: expected a finite number" in out.reason
    assert np.isfinite(out.tau).all()
    assert made.memory.loops["board"].filtered[5] == pytest.approx(-10.0)


def test_targets_are_kept_until_changed_and_wrong_ones_are_refused_by_name():
    made = controller()
    run(made, 12)
    out = made.step(0.012, made.start, np.zeros(7), measured=press(), targets={"board.fz": -12.0})
    run(made, 40, start=13)
    integral = made.memory.loops["board"].integral[2]
    out = run(made, 1, start=53)[0]
    assert integral < 0.0
    assert out.wrenches["board"][5] == pytest.approx(-12.0 + 0.3 * (-12.0 + 10.0) + 10.0 * integral, abs=1e-3)
    assert made.memory.targets["board.fz"] == -12.0
    out = made.step(0.06, made.start, np.zeros(7), measured=press(), targets={"board.fx": 1.0, "bord.fz": -1.0})
    assert out.status is Status.LIMITED
    assert "column space" in out.reason
    assert "did you mean 'board.fz'" in out.reason
    assert made.memory.targets == {"board.fz": -12.0}


def test_an_unknown_contact_in_measured_is_named():
    made = controller()
    out = made.step(0.0, made.start, np.zeros(7), measured={"bord": press()["board"]})
    assert "no contact named 'bord'; did you mean 'board'?" in out.reason


def test_a_failing_solver_holds_then_holds_safely_until_reset():
    solver = Failing()
    made = controller(solver=solver)
    good = run(made, 15)[-1]
    solver.fail = True
    outs = run(made, 40, start=15)
    assert [out.status for out in outs[: HOLD_TICKS + 1]] == [Status.DEGRADED] * HOLD_TICKS + [Status.SAFE_HOLD]
    assert "RuntimeError: planned" in outs[0].reason
    load = carried(made.start, good.wrenches["board"][[0, 1, 5]])
    for k, out in enumerate(outs[:HOLD_TICKS], 1):
        np.testing.assert_allclose(out.tau, load + (1 - k / HOLD_TICKS) * (good.tau - load), atol=1e-12)
    # the safe hold carries the weight and the last wrench, and moves there inside the rate
    steps = np.abs(np.diff([out.tau for out in outs], axis=0)).max()
    assert steps <= 1.0 + 1e-9
    state = ROBOT.state(made.start, np.zeros(7))
    expected = state.gravity() + state.frame("eraser").J.T @ good.wrenches["board"]
    np.testing.assert_allclose(outs[-1].tau, expected, atol=1e-2)
    solver.fail = False
    assert run(made, 1, start=60)[0].status is Status.SAFE_HOLD
    made.reset(made.start, np.zeros(7), tau=outs[-1].tau)
    assert run(made, 1, start=61)[0].status in (Status.OK, Status.LIMITED)


def test_a_good_tick_applies_at_once_and_the_status_recovers_after_ten():
    solver = Failing()
    made = controller(solver=solver)
    run(made, 15)
    solver.fail = True
    run(made, 2, start=15)
    solver.fail = False
    outs = run(made, GOOD_TICKS + 1, start=17)
    assert max(outs[0].certificate) < 1e-6
    assert [out.status for out in outs[: GOOD_TICKS - 1]] == [Status.DEGRADED] * (GOOD_TICKS - 1)
    assert outs[GOOD_TICKS - 1].status is Status.OK


def test_a_lying_solver_is_refused():
    solver = Failing()
    made = controller(solver=solver)
    run(made, 15)
    solver.lie = 1e-3
    out = run(made, 1, start=15)[0]
    assert out.status is Status.DEGRADED
    assert "no certified answer" in out.reason


def test_missed_ticks_degrade_and_stop():
    made = controller()
    run(made, 15)
    assert run(made, 1, start=15, missed=1)[0].status is Status.OK
    out = run(made, 1, start=16, missed=3)[0]
    assert out.status is Status.DEGRADED
    assert "3 ticks missed" in out.reason
    assert run(made, 1, start=17, missed=20)[0].status is Status.STOPPED
    assert run(made, 1, start=18)[0].status is Status.STOPPED


def test_gravity_by_the_driver_is_left_out_of_the_torque_but_not_of_the_limits():
    ours, theirs = controller(ROBOT), controller(DRIVEN)
    gravity = ROBOT.state(ours.start, np.zeros(7)).gravity()
    for a, b in zip(run(ours, 30), run(theirs, 30), strict=True):
        np.testing.assert_allclose(a.tau, b.tau + gravity, atol=1e-9)
    # what reset and tau_applied are told is in the driver's convention as well
    sent = np.full(7, 0.5)
    theirs.reset(theirs.start, np.zeros(7), tau=sent)
    out = theirs.step(1.0, theirs.start, np.zeros(7), measured=press())
    assert np.abs(out.tau - sent).max() <= 1.0 + 1e-9
    out = theirs.step(1.001, theirs.start, np.zeros(7), measured=press(), tau_applied=sent)
    assert np.abs(out.tau - sent).max() <= 1.0 + 1e-9


def test_a_wrong_tau_applied_is_refused_and_the_own_memory_stands():
    made = controller()
    run(made, 12)
    out = run(made, 1, start=12, tau_applied=np.full(7, np.nan))[0]
    assert "tau_applied: expected finite numbers" in out.reason
    assert np.isfinite(out.tau).all()


def test_memory_is_a_value_that_replays_a_tick_bit_for_bit():
    made = controller()
    run(made, 15)
    memory = copy.deepcopy(made.memory)
    rng = np.random.default_rng(1)
    q, v = made.start + 1e-3 * rng.normal(size=7), 1e-2 * rng.normal(size=7)
    first = made.step(0.015, q, v, measured=press(-9.5))
    run(made, 5, start=16)
    made.memory = memory
    again = made.step(0.015, q, v, measured=press(-9.5))
    np.testing.assert_array_equal(first.tau, again.tau)
    other = controller()
    other.memory = memory
    np.testing.assert_array_equal(first.tau, other.step(0.015, q, v, measured=press(-9.5)).tau)


def test_arguments_are_neither_kept_nor_written():
    made = controller()
    q, v = made.start.copy(), np.full(7, 1e-3)
    out = made.step(0.0, q, v, measured=press())
    kept = out.tau.copy(), out.vdot.copy(), {k: w.copy() for k, w in out.wrenches.items()}
    q[:], v[:] = np.nan, np.nan
    made.step(0.001, made.start, np.zeros(7), measured=press())
    np.testing.assert_array_equal(out.tau, kept[0])
    np.testing.assert_array_equal(out.vdot, kept[1])
    np.testing.assert_array_equal(out.wrenches["board"], kept[2]["board"])
    assert np.isfinite(made.memory.q).all()


def test_torque_limits_hold_when_nothing_fits_and_what_binds_is_named():
    made = wbc.Controller(
        ROBOT,
        tasks={"posture": wbc.PostureTask(ROBOT.keyframes["home"] + 0.5, kp=1000.0, kd=60.0)},
        limits={"torque": np.full(7, 25.0)},
    )
    q = ROBOT.keyframes["home"].copy()
    made.reset(q, np.zeros(7))
    out = made.step(0.0, q, np.zeros(7))
    assert out.status is Status.LIMITED
    assert any(name.startswith("torque[") for name in out.active)
    assert np.abs(out.tau).max() <= np.minimum(25.0, ROBOT.tau_max).max() + 1e-9


def test_a_raising_task_of_ones_own_does_not_take_the_loop_down():
    class Broken:
        calls = 0

        def rows(self, state):
            Broken.calls += 1
            if Broken.calls > 5:
                raise ZeroDivisionError("mine")
            b = np.zeros(7)
            return wbc.Rows("", {"vdot": None}, b, b)

    made = wbc.Controller(ROBOT, tasks={"mine": Broken()})
    q = ROBOT.keyframes["home"]
    made.reset(q, np.zeros(7))
    outs = [made.step(0.001 * i, q, np.zeros(7)) for i in range(8)]
    assert outs[-1].status is Status.DEGRADED
    assert "ZeroDivisionError: mine" in outs[-1].reason


def test_construction_says_what_is_wrong():
    with pytest.raises(NameNotFound, match=r"task 'draw'.* 'bord'; did you mean 'board'"):
        wbc.Controller(
            ROBOT,
            contacts={"board": wbc.AxesContact("eraser", ("vz",))},
            tasks={"draw": wbc.MotionTask("eraser", wbc.reference.hold(ROBOT.fixed_pose("board")), contact="bord")},
        )
    with pytest.raises(NameNotFound, match="no frame named 'erasr'; did you mean 'eraser'"):
        wbc.Controller(ROBOT, tasks={"m": wbc.MotionTask("erasr", wbc.reference.hold(ROBOT.fixed_pose("board")))})
    with pytest.raises(SolverError, match="no solver named 'dapq'; did you mean 'daqp'"):
        wbc.Controller(ROBOT, solver="dapq")
    with pytest.raises(StateError, match=r"q: expected a float64 array of shape \(7,\)"):
        controller().reset(np.zeros(3), np.zeros(7))


def test_self_motion_is_damped_without_a_posture_and_a_meaningless_posture_is_dropped():
    made = wbc.Controller(ROBOT, tasks={"m": wbc.MotionTask("eraser", wbc.reference.hold(ROBOT.fixed_pose("board")))})
    assert "self_motion" in made.phase.tasks
    ur = wbc.Controller.from_spec(wbc.load("eraser", ["robot=ur5e"]))
    assert "posture" not in ur.phase.tasks
    assert any("posture: dropped" in note for note in ur.notes)


@pytest.mark.parametrize("law", ["compensated", "book"])
def test_motion_and_posture_of_equal_weight_are_one_cost_and_the_same_problem(law):
    made = wbc.Controller.from_spec(SPEC.model_copy(update={"law": law}), robot=ROBOT)
    (program,) = made._programs
    rng = np.random.default_rng(7)
    for _ in range(10):
        state = ROBOT.state(made.start + 0.2 * rng.normal(size=7), rng.normal(size=7), t=rng.uniform(0, 5))
        seen, kept = [], program.merged
        assert kept is not None
        for merged in (kept, None):
            program.merged = merged
            hold(state, program.phase)
            state.loops = {"board": ForceLoop()}
            assert program.assemble(state, state.h, 0.001)
            seen.append(program.strict.problem.copy())
            program.merged = kept
        for name in ("H", "g", "C", "lo", "hi"):
            one, other = getattr(seen[0], name), getattr(seen[1], name)
            finite = np.isfinite(one)
            np.testing.assert_array_equal(finite, np.isfinite(other))
            np.testing.assert_allclose(one[finite], other[finite], atol=1e-9 * (1 + np.abs(one[finite]).max()))
