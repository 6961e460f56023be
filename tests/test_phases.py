"""Phases on the running loop: what ends them, what comes then, and that nothing jumps where they change."""

from __future__ import annotations

import copy
from functools import lru_cache

import numpy as np
import pytest

import wbc
from wbc.build import build
from wbc.errors import NameNotFound, SpecError
from wbc.ladder import Status
from wbc.limit import make_limits
from wbc.phase import Phase
from wbc.reference import hold
from wbc.run import run
from wbc.spec import load
from wbc.transition import after
from wbc.verify import verify

TOUCH = """
robot: panda
tool: chalk
scene: board
duration: 1.8
references:
  down:   {line: {in: board, from: [0.02, 0, 0.004], to: [0.02, 0, -0.004], time: 0.75}}
  stroke: {line: {in: board, from: [0.02, 0, 0], to: [0.02, 0.03, 0], time: 0.6}}
  up:     {line: {in: self, from: [0, 0, 0], to: [0, 0, 0.02], time: 0.4}}
contacts:
  board:
    frame: chalk
    natural:    {fx: 0, fy: 0, mx: 0, my: 0, mz: 0, vz: 0}
    artificial: {vx: 0, vy: stroke, wx: 0, wy: 0, wz: 0, fz: -10}
tasks:
  reach:   {type: motion, frame: chalk, target: down, kp: 100, kd: 20}
  press:   {type: force, contact: board, kp: 0.3, ki: 10, damping: 500, filter: 50}
  draw:    {type: motion, contact: board, kp: 100, kd: 20}
  lift:    {type: motion, frame: chalk, target: up, kp: 100, kd: 20}
  posture: {type: posture, target: start, kp: 50, kd: 10}
phases:
  approach: {contacts: [], tasks: [reach, posture], until: {board.fz: {max: -1, for: 0.003}}, timeout: 0.6}
  write:    {tasks: [press, draw, posture], until: {draw.done: true}, lost: leave}
  leave:    {contacts: [], tasks: [lift, posture]}
limits: {torque: model, torque_rate: 1000, position: model, velocity: model}
expect: {settle: 0.3}
"""


@pytest.fixture(scope="module")
def file(tmp_path_factory):
    path = tmp_path_factory.mktemp("phases") / "touch.yaml"
    path.write_text(TOUCH)
    return path


@pytest.fixture(scope="module")
def touch(file):
    """touch(*overrides) -> the run of the spec above, with the torque and inputs of every tick."""

    @lru_cache
    def one(*overrides, fall=None):
        built, ticks = build(load(file, overrides)), []

        def keep(seen, out):
            state = built.controller.state
            ticks.append((seen, out, dict(state.measured), built.controller.memory))

        def drop(simulator):
            if fall is not None and simulator.data.time > fall:
                simulator.model.body("board_body").pos[2] = -1.0

        return run(built, hook=keep, show=drop), ticks

    return one


def told(result):
    return [phase["name"] for phase in result.summary["phases"]]


def starts(result):
    return [phase["start"] for phase in result.summary["phases"]]


def change(result, index=1):
    """The tick at which a phase begins."""
    return int(np.searchsorted(result.log["t"], starts(result)[index] - 1e-6))


class TestWaysOut:
    def test_a_force_then_the_end_of_a_path_end_phases(self, touch):
        result, _ = touch()
        assert result.ok
        assert told(result) == ["approach", "write", "leave"]
        fz, phase = result.log["board.measured"][:, 5], result.log["phase"]
        begin, end = change(result), change(result, 2)
        assert (phase[:begin] == 0).all()
        assert (phase[begin:end] == 1).all()
        assert (phase[end:] == 2).all()
        assert (fz[begin - 3 : begin + 1] <= -1.0).all()  # 3 ms without a gap, and no earlier
        assert not fz[begin - 4] <= -1.0
        assert end - begin == 600  # the path's own time
        whys = [entry["why"] for entry in result.summary["phases"]]
        assert whys[0] == ""
        assert whys[1].startswith("approach: board.fz = -")
        assert whys[2] == "write: draw.done"
        assert result.log.meta["phases"] == ["approach", "write", "leave"]

    def test_a_distance_a_speed_and_an_error(self, touch, file):
        text = file.read_text()
        for quantity, bound, read in (
            ("board.distance", "{max: 0.002}", lambda log: log["reach.position"][:, 2] - 0.3 <= 0.002),
            ("reach.speed", "{min: 0.01}", lambda log: log["reach.speed"] >= 0.01),
            ("reach.error", "{min: 1.0e-7}", lambda log: np.linalg.norm(log["reach.error"][:, 3:], axis=1) >= 1e-7),
        ):
            other = file.with_name("other.yaml")
            other.write_text(text.replace("board.fz: {max: -1, for: 0.003}", f"{quantity}: {bound}"))
            result = run(build(load(other, ["duration=0.45"])))
            begin = change(result)
            known = read(result.log)
            assert not known[:begin].any()
            assert begin > 5
            # the tick itself, of the new phase, is the first at which it is so
            first = np.flatnonzero(known[: begin + 1])
            assert first.size == 0 or first[0] == begin

    def test_the_time_out_stops_the_run_in_a_safe_hold(self, touch):
        result, ticks = touch("references.down.line.to=[0.02, 0, 0.002]", "duration=1")
        assert not result.ok
        assert told(result) == ["approach", "stop"]
        assert starts(result)[1] == pytest.approx(0.6, abs=1e-9)
        outs = [out for _, out, _, _ in ticks]
        assert {out.status for out in outs[600:]} == {Status.STOPPED}
        assert all("approach: timeout after 0.6 s with board.fz = " in out.reason for out in outs[600:])
        speed = np.linalg.norm([seen.v for seen, _, _, _ in ticks[-50:]], axis=1)
        assert speed.max() < 1e-3

    def test_or_leads_to_another_phase(self, touch):
        result, _ = touch("references.down.line.to=[0.02, 0, 0.002]", "phases.approach.else=leave", "duration=1.2")
        assert told(result) == ["approach", "leave"]
        assert result.ok

    def test_a_lost_contact_leads_away(self, touch):
        result, _ = touch("duration=1.0", fall=0.7)
        assert told(result) == ["approach", "write", "leave"]
        assert "board lost" in result.summary["phases"][2]["why"]
        lost = change(result, 2)
        # five ticks after the sensor, which is one tick late
        assert 0.7 + 0.004 <= result.log["t"][lost] <= 0.7 + 0.015
        assert result.summary["metrics"]["lift.overshoot"] < 0.2

    def test_or_stops_without_pressing_on(self, touch):
        result, ticks = touch("duration=1.4", "phases.write.lost=stop", fall=0.7)
        assert told(result) == ["approach", "write", "stop"]
        assert not result.ok
        assert ticks[-1][1].status is Status.STOPPED
        assert "write: board lost" in ticks[-1][1].reason
        # the force that the board held does not drive the arm on
        assert np.abs(ticks[-1][0].v).max() < 1e-2

    def test_or_is_left_unnoticed_where_nothing_is_said(self, file):
        other = file.with_name("unsaid.yaml")
        other.write_text(file.read_text().replace(", lost: leave", ""))
        built = build(load(other, ["duration=0.8"]))

        def drop(simulator):
            if simulator.data.time > 0.7:
                simulator.model.body("board_body").pos[2] = -1.0

        result = run(built, show=drop)
        assert told(result) == ["approach", "write"]
        assert result.summary["metrics"]["board.lost"] > 50


SLIP = """
robot: panda
tool: chalk
scene: grip_board
duration: 1.6
references:
  askew: {profile: {values: [0, 5.5], times: [0, 1.2]}}
contacts:
  board:
    frame: chalk
    natural:    {mx: 0, my: 0, mz: 0, vx: 0, vy: 0, vz: 0}
    artificial: {wx: 0, wy: 0, wz: 0, fx: askew, fy: 0, fz: -10}
    pushes: -z
    friction: 0.6
tasks:
  press:   {type: force, contact: board, kp: 0.3, ki: 10, damping: 500, filter: 200}
  upright: {type: motion, contact: board, kp: 100, kd: 20}
  posture: {type: posture, target: start, kp: 50, kd: 10}
phases:
  hold:   {until: {board.slip: {min: 0.001, for: 0.003}}, timeout: 1.5, else: held}
  harder: {set: {contacts.board.artificial.fz: -20}}
  held:   {}
limits: {torque: model, torque_rate: 1000, position: model, velocity: model}
"""


class TestSlip:
    """The plant knows 0.4 where the controller counts on 0.6; 4 N of friction are all that 10 N give."""

    def slipping(self, tmp_path, *overrides):
        """The run, and the true speed across the push at every tick."""
        path, speed = tmp_path / "slip.yaml", []
        path.write_text(SLIP)

        def watch(simulator):
            T, V = simulator.true_motion("chalk")
            speed.append(np.linalg.norm((T.rotation @ V[3:])[:2]))

        return run(build(load(path, overrides)), show=watch), np.array(speed)

    @pytest.mark.parametrize("noise", [0.0, 2e-4])
    def test_it_ends_the_phase_when_the_point_truly_slips(self, tmp_path, noise):
        result, speed = self.slipping(tmp_path, "plant.contact_friction=0.4", f"plant.noise.velocity={noise}")
        assert told(result) == ["hold", "harder"]
        assert "board.slip = " in result.summary["phases"][1]["why"]
        begin = change(result)
        first = 100 + int(np.argmax(speed[100:] >= 0.001))  # where it is set down it slides for 2 ms
        late = begin - first - 3  # ticks, beyond the 3 ms that were asked for
        assert late == 0 if not noise else -2 <= late <= 5
        force = np.abs(result.log["board.true"][first, 3:])
        assert force[0] / force[2] == pytest.approx(0.4, rel=0.01)
        # pressed harder it holds again
        assert result.log["board.true"][-1, 5] == pytest.approx(-20.0, abs=0.2)
        assert speed[-100:].max() < 1e-5

    def test_where_nothing_slips_nothing_is_told(self, tmp_path):
        result, speed = self.slipping(tmp_path)
        assert told(result) == ["hold", "held"]
        assert "timeout" in result.summary["phases"][1]["why"]
        assert speed.max() < 1e-5
        assert result.log["board.true"][1400, 3] > 5.0  # it was asked to


class TestNothingJumps:
    def test_the_torque_keeps_its_rate_at_every_change(self, touch):
        result, _ = touch()
        steps = np.abs(np.diff(result.log["tau"], axis=0)).max(axis=1)
        assert steps.max() <= 1.0 + 1e-9
        assert result.summary["metrics"]["torque_rate.max_excess"] == 0.0
        for begin in (change(result), change(result, 2)):
            assert steps[begin - 1 : begin + 6].max() > 0.1  # there is something to limit

    def test_the_first_force_is_what_the_last_torque_pressed_with(self):
        """At rest, with 4 N held by the torque alone: the torque does not move at all, then the force goes to 10 N."""
        made, q = rest_then_press()
        state = made.robot.state(q, np.zeros(7))
        push = np.array([0.0, 0.0, 0.0, 0.0, 0.0, -4.0])
        tau = state.gravity() + state.frame("eraser").J.T @ push
        given = {"board": wbc.Wrench(push, "eraser")}
        for i in range(20):
            out = made.step(0.001 * i, q, np.zeros(7), measured=given, tau_applied=tau)
        assert made.memory.phase == 0
        out = made.step(0.020, q, np.zeros(7), measured=given, tau_applied=tau)
        assert made.memory.phase == 1
        np.testing.assert_allclose(out.wrenches["board"], push, atol=1e-8)
        np.testing.assert_allclose(out.tau, tau, atol=1e-8)
        assert out.active == ()
        forces = []
        for i in range(21, 1500):
            out = made.step(0.001 * i, q, np.zeros(7), measured=given)
            given = {"board": wbc.Wrench(out.wrenches["board"], "eraser")}  # a rigid wall, one tick late
            forces.append(out.wrenches["board"][5])
        assert forces[-1] == pytest.approx(-10.0, abs=1e-3)
        assert np.diff(forces).max() < 1e-3  # no overshoot on the way

    def test_what_the_driver_sent_counts_in_the_limits_of_the_phase_that_answers(self):
        """Also at the tick at which motors get their torque back: 30 % of it sent, 26 % allowed until then."""
        made = build(load("eraser_weak", ["phases.full.until.time=0.005", "phases.weak.until.time=0.005"])).controller
        full, weak, recovered = (phase.torque for phase in made.phases)
        sent = made.robot.state(made.start, np.zeros(7)).gravity()
        sent[1] = 0.3 * full.low[1]
        made.reset(made.start, np.zeros(7))
        for i in range(15):
            out = made.step(0.001 * i, made.start, np.zeros(7), tau_applied=sent)
            limits = (full, weak, recovered)[made.memory.phase]
            assert np.abs(out.tau - limits.inside(sent)).max() <= 1.0 + 1e-9
        assert made.memory.phase == 2
        assert weak.inside(sent)[1] - sent[1] > 2.0

    def test_references_start_where_the_robot_is(self, touch):
        result, _ = touch()
        log = result.log
        for name, index, at in (("draw", 1, "position"), ("lift", 2, "position")):
            begin = change(result, index)
            np.testing.assert_allclose(log[f"{name}.desired"][begin], log[f"{name}.{at}"][begin], atol=1e-9)
            speed = abs(log[f"{name}.desired_speed"][begin] - log[f"{name}.speed"][begin])
            assert speed < 1e-9
        # `in: self`: 20 mm out of the board from where the stroke ended
        travelled = log["lift.desired"][-1] - log["lift.position"][change(result, 2)]
        np.testing.assert_allclose(travelled, [0.0, 0.0, 0.02], atol=1e-4)
        # a speed of zero in the table keeps x; what is drawn is drawn where it stands
        np.testing.assert_allclose(log["draw.desired"][change(result, 2) - 1][:2], [0.52, 0.03], atol=1e-4)

    def test_to_hold_is_to_stay_where_the_phase_found_the_robot(self, touch):
        result, _ = touch("references.up={hold: {}}")
        stayed = result.log["lift.position"][change(result, 2) :]
        assert np.linalg.norm(stayed - stayed[0], axis=1).max() < 1e-3
        np.testing.assert_allclose(stayed[-1], [0.52, 0.03, 0.3], atol=1e-3)  # not where the run began

    def test_a_rate_that_is_too_slow_for_the_contact_makes_the_tasks_yield(self, touch):
        result, ticks = touch("limits.torque_rate=60", "duration=0.8")
        begin = change(result)
        steps = np.abs(np.diff(result.log["tau"], axis=0)).max()
        assert steps <= 0.06 + 1e-9
        limited = [out for _, out, _, _ in ticks[begin : begin + 20]]
        assert any(name.startswith("torque_rate[") for out in limited for name in out.active)
        assert {out.status for out in limited} <= {Status.OK, Status.LIMITED}

    def test_several_contacts_change_in_one_tick(self):
        made, q = several()
        state = made.robot.state(q, np.zeros(7))
        F = np.array([0.0, 0.0, 0.0, 0.0, 0.0, -5.0])
        before, outs = made.robot.state(q, np.zeros(7)).gravity(), []
        for i in range(40):
            given = {name: wbc.Wrench(F, contact.frame) for name, contact in made.phase.contacts.items()}
            outs.append(made.step(0.001 * i, q, np.zeros(7), measured=given))
            assert np.abs(outs[-1].tau - before).max() <= 1.0 + 1e-9
            before = outs[-1].tau
        assert [set(out.wrenches) for out in outs] == [{"a", "b"}] * 20 + [{"c", "d"}] * 20
        assert set(made.memory.loops) == {"c", "d"}
        assert all(max(out.certificate) < 1e-6 for out in outs)
        G = {name: made.phases[1].contacts[name].hold(state).G for name in ("c", "d")}
        for name, rows in G.items():  # the new constraints hold from the first tick on
            np.testing.assert_allclose(rows @ outs[20].vdot, 0.0, atol=1e-6, err_msg=name)

    def test_a_point_becomes_a_face_and_the_force_goes_from_one_target_to_the_other(self, tmp_path):
        path = tmp_path / "tilt.yaml"
        path.write_text(POINT_TO_FACE)
        result = run(build(load(path)))
        assert told(result) == ["point", "face"]
        begin = change(result)
        fz = result.log["face.true"][:, 5]
        assert fz[begin - 1] == pytest.approx(-6.0, abs=0.02)
        assert np.abs(np.diff(fz[begin - 5 : begin + 500])).max() < 0.05  # a jump would be of 4 N
        assert fz[begin + 500 :].max() < -9.7
        assert result.summary["metrics"]["face.lost"] == 0.0


class TestMemory:
    def test_a_change_is_repeated_bit_for_bit_from_a_memory_before_it(self, touch, file):
        result, ticks = touch()
        for index in (1, 2):
            begin = change(result, index)
            made = build(load(file)).controller
            made.memory = copy.deepcopy(ticks[begin - 3][3])
            for seen, out, measured, memory in ticks[begin - 2 : begin + 20]:
                given = {name: wbc.Wrench(F, "chalk") for name, F in measured.items()}
                again = made.step(seen.t, seen.q, seen.v, measured=given)
                np.testing.assert_array_equal(again.tau, out.tau)
                assert made.memory.phase == memory.phase
                assert made.memory.why == memory.why

    def test_going_back_before_a_change_undoes_it(self, touch, file):
        result, ticks = touch()
        begin = change(result)
        made = build(load(file)).controller
        for start in (begin + 5, begin - 3):
            made.memory = ticks[start][3]
            seen, out, measured, _ = ticks[start + 1]
            given = {name: wbc.Wrench(F, "chalk") for name, F in measured.items()}
            np.testing.assert_array_equal(made.step(seen.t, seen.q, seen.v, measured=given).tau, out.tau)

    def test_reset_begins_with_the_first_phase(self, touch, file):
        made = build(load(file)).controller
        _, ticks = touch()
        made.memory = ticks[-1][3]
        assert made.phase.name == "leave"
        made.reset(made.start, np.zeros(7))
        made.step(5.0, made.start, np.zeros(7))
        assert made.phase.name == "approach"
        assert made.memory.starts == {}


def test_the_closed_form_holds_in_every_phase_and_at_every_change(file):
    found = verify(load(file, ["duration=1.1"]), states=30)
    assert found.ok, found
    assert found.states >= 24


def test_measured_wrenches_and_targets_of_contacts_that_come_later_are_taken(file):
    made = build(load(file)).controller
    made.reset(made.start, np.zeros(7))
    given = {"board": wbc.Wrench.on_environment(f=[0, 0, -0.5], m=[0, 0, 0], frame="chalk")}
    for i in range(12):
        out = made.step(0.001 * i, made.start, np.zeros(7), measured=given, targets={"board.fz": -7.0})
    assert out.status is Status.OK
    assert out.reason == ""
    assert made.memory.targets == {"board.fz": -7.0}
    out = made.step(0.012, made.start, np.zeros(7), measured={"bord": given["board"]})
    assert "no contact named 'bord'; did you mean 'board'?" in out.reason


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("    friction: 0.6\n", "", "contact 'board' has no friction that could give way; expected `friction` in it"),
        ("    pushes: -z\n    friction: 0.6\n", "", "expected `pushes` and `friction` in it"),
        (
            "{mx: 0, my: 0, mz: 0, vx: 0, vy: 0, vz: 0}\n    artificial: {wx: 0, wy: 0, wz: 0, fx: askew, fy: 0,",
            "{mx: 0, my: 0, mz: 0, fx: 0, fy: 0, vz: 0}\n    artificial: {wx: 0, wy: 0, wz: 0, vx: askew, vy: 0,",
            "contact 'board' slides across its push by design; expected one that holds the frame there, or TASK.speed",
        ),
        ("  hold:   {until", "  hold:   {contacts: [], tasks: [posture], until", "'board' is not active in this phase"),
    ],
    ids=["no friction", "no push", "it slides", "not active"],
)
def test_a_slip_that_cannot_be_is_told_with_its_place(tmp_path, old, new, said):
    assert SLIP.count(old) == 1
    text = SLIP.replace(old, new)
    (tmp_path / "wrong.yaml").write_text(text)
    with pytest.raises(SpecError) as caught:
        build(load(tmp_path / "wrong.yaml"))
    (fault,) = caught.value.faults
    assert fault.key == "phases.hold.until.board.slip"
    assert "board.slip" in text.splitlines()[fault.line - 1]
    assert said in fault.message


def test_a_way_to_a_phase_that_does_not_exist_is_refused():
    robot = wbc.Robot.load("panda", tool="eraser", scene="board")
    torque, joint = make_limits(robot, {})
    phases = [Phase({}, {}, {}, torque, joint, "here", after(1.0, "ther")), Phase({}, {}, {}, torque, joint, "there")]
    with pytest.raises(NameNotFound, match="no phase named 'ther'; did you mean 'there'"):
        wbc.Controller(robot, phases=phases)


@pytest.mark.parametrize(
    ("old", "new", "key", "said"),
    [
        ("vy: stroke", "vy: 0.01", "phases.write.until.draw.done", "the reference of 'draw' never ends; expected"),
        (
            "{line: {in: board, from: [0.02, 0, 0], to: [0.02, 0.03, 0], time: 0.6}}",
            "{lissajous: {in: board, size: [0.02, 0.01], period: [2, 1]}}",
            "phases.write.until.draw.done",
            "never ends",
        ),
        (
            "{fx: 0, fy: 0, mx: 0, my: 0, mz: 0, vz: 0}\n    artificial: {vx: 0, ",
            "{vx: 0, fy: 0, mx: 0, my: 0, mz: 0, vz: 0}\n    artificial: {fx: 0, ",
            "phases.approach.until.board.distance",
            "contact 'board' holds vx, vz; expected one that `pushes`, or holds one of vx, vy, vz alone",
        ),
    ],
    ids=["a speed never ends", "a periodic path never ends", "no one direction"],
)
def test_what_only_the_geometry_tells_is_told_with_its_place(file, old, new, key, said):
    text = file.read_text().replace("board.fz: {max: -1, for: 0.003}", "board.distance: 0")
    assert text.count(old) == 1
    other = file.with_name("wrong.yaml")
    other.write_text(text.replace(old, new))
    with pytest.raises(SpecError) as caught:
        build(load(other))
    (fault,) = [fault for fault in caught.value.faults if fault.key == key]
    assert fault.line > 20
    assert said in fault.message


# --- made without a file ---

POINT_TO_FACE = """
robot: panda
tool: eraser
scene: board
duration: 1.3
references:
  figure: {lissajous: {in: board, size: [0.12, 0.06], period: [6, 3]}}
contacts:
  point:
    frame: eraser
    on: board
    natural:    {fx: 0, fy: 0, mx: 0, my: 0, mz: 0, vz: 0}
    artificial: {vx: figure, vy: figure, wx: 0, wy: 0, wz: 0, fz: -6}
  face:
    frame: eraser
    on: board
    natural:    {wx: 0, wy: 0, mz: 0, fx: 0, fy: 0, vz: 0}
    artificial: {mx: 0, my: 0, wz: 0, vx: 0, vy: 0, fz: -10}
tasks:
  lean:    {type: force, contact: point, kp: 0.3, ki: 10, damping: 500, filter: 50}
  slide:   {type: motion, contact: point, kp: 100, kd: 20}
  press:   {type: force, contact: face, kp: 0.3, ki: 10, damping: [5, 5, 500], filter: 50}
  draw:    {type: motion, contact: face, kp: 100, kd: 20}
  posture: {type: posture, target: start, kp: 50, kd: 10}
phases:
  point: {contacts: [point], tasks: [lean, slide, posture], until: {time: 0.7}}
  face:  {contacts: [face], tasks: [press, draw, posture]}
limits: {torque: model, torque_rate: 1000, position: model, velocity: model}
"""


def rest_then_press():
    """At rest in the air, then pressing on a board, after 20 ms."""
    robot = wbc.Robot.load("panda", tool="eraser", scene="board")
    q = build(load("eraser"), robot=robot).q
    held = wbc.AxesContact("eraser", ("vz",))
    stay = hold(robot.state(q, np.zeros(7)).frame("eraser").T)
    press = wbc.ForceTask("board", held, np.array([-10.0]), kp=0.3, ki=10.0, damping=500.0, filter=50.0)
    torque, joint = make_limits(robot, {"torque_rate": 1000.0})
    rest = {"stay": wbc.MotionTask("eraser", stay), "posture": wbc.PostureTask(q)}
    more = rest | {"press": press, "stay": wbc.MotionTask("eraser", stay, contact="board", axes=held.free_axes)}
    phases = [
        Phase({}, rest, dict.fromkeys(rest, 1.0), torque, joint, "rest", after(0.02, "press")),
        Phase({"board": held}, more, dict.fromkeys(more, 1.0), torque, joint, "press"),
    ]
    made = wbc.Controller(robot, phases=phases, q=q)
    made.reset(q, np.zeros(7))
    return made, q


def several():
    """Two contacts end and two begin, after 20 ms."""
    robot = wbc.Robot.load("panda", tool="eraser", scene="board")
    q = robot.keyframes["home"].copy()
    torque, joint = make_limits(robot, {"torque_rate": 1000.0})
    places = {
        "a": wbc.AxesContact("eraser", ("vz",)), "b": wbc.AxesContact("link4", ("vx",)),
        "c": wbc.AxesContact("eraser", ("wx", "vz")), "d": wbc.AxesContact("link5", ("vz",)),
    }  # fmt: skip

    def one(names, name, exit_):
        tasks = {
            f"press_{key}": wbc.ForceTask(key, places[key], np.full(places[key].k, -3.0), kp=0.2, ki=5.0)
            for key in names
        }
        tasks["posture"] = wbc.PostureTask(q)
        return Phase({key: places[key] for key in names}, tasks, dict.fromkeys(tasks, 1.0), torque, joint, name, exit_)

    made = wbc.Controller(robot, phases=[one("ab", "first", after(0.02, "then")), one("cd", "then", None)], q=q)
    made.reset(q, np.zeros(7))
    return made, q


def test_phases_share_the_limits_that_they_do_not_change():
    full, weak, recovered = build(load("eraser_weak")).phases
    assert full.joint is recovered.joint
    assert full.torque is recovered.torque
    assert weak.joint is not full.joint
    np.testing.assert_allclose(weak.torque.high, 0.26 * full.torque.high)
