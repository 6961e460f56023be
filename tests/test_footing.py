"""Feet that leave the floor: how high they are, that they carry nothing then and come back down."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
from oracles import first_tick
from test_floating import contacts_of

from wbc.build import build
from wbc.footing import LIFTED, Footing
from wbc.handover import Start
from wbc.ladder import Status
from wbc.resources import shipped_folder
from wbc.run import run
from wbc.spec import load
from wbc.task.centroidal import FADE, DistributionTask, com, mass

PAIR, PAIR_STEP = ("FL", "RR"), 0.3  # [N m] a tick
BENT = {
    "FL": {"FL_calf_joint": -0.1},
    "left_foot": {"left_hip_pitch_joint": -0.2, "left_knee_joint": 0.4, "left_ankle_pitch_joint": -0.2},
}


class _At:
    """A frame at a pose."""

    def __init__(self, T):
        self.T, self.R, self.p = T, T.rotation, T.translation


@pytest.fixture(scope="module")
def stands():
    return {name: build(load(name)) for name in ("go2_stand", "g1_stand")}


class TestHeight:
    def test_of_a_sole_is_that_of_its_lowest_corner(self, rng):
        n = np.array([0.1, -0.2, 0.97])
        n /= np.linalg.norm(n)
        footing = Footing(n, 0.3, size=(0.17, 0.05))
        corners = np.array([(x, y, 0.0) for x in (-0.085, 0.085) for y in (-0.025, 0.025)])
        for _ in range(20):
            T = pin.SE3.Random()
            heights = [n @ (T * corner) - 0.3 for corner in corners]
            assert footing.height(_At(T)) == pytest.approx(min(heights), abs=1e-12)

    def test_of_a_round_foot_is_less_its_radius(self):
        footing = Footing(np.array([0.0, 0.0, 1.0]), 0.1, 0.022)
        T = pin.SE3(pin.exp3(np.array([1.0, 2.0, 3.0])), np.array([5.0, 6.0, 0.4]))
        assert footing.height(_At(T)) == pytest.approx(0.4 - 0.1 - 0.022)

    def test_the_way_down_turns_a_sole_flat(self):
        """Followed for a second it brings any tilted sole flat, whichever way it heads."""
        n = np.array([0.0, 0.0, 1.0])
        footing = Footing(n, 0.0, size=(0.2, 0.1))
        T = pin.SE3(pin.exp3(np.array([0.3, -0.2, 1.0])), np.array([0.0, 0.0, 0.1]))
        for _ in range(1000):
            V = footing.down(_At(T))
            T = T * pin.exp6(pin.Motion(V[3:], V[:3]) * 1e-3)
        assert T.rotation[2, 2] == pytest.approx(1.0, abs=1e-4)
        assert T.translation[2] < 0.05


class TestInTheAir:
    @pytest.mark.parametrize(("name", "foot", "solver"), [
        ("go2_stand", "FL", "daqp"), ("go2_stand", "FL", "proxqp"), ("g1_stand", "left_foot", "daqp"),
        ("g1_stand", "left_foot", "proxqp"),
    ])  # fmt: skip
    def test_it_carries_nothing_and_comes_down_while_the_others_go_on(self, name, foot, solver):
        built = build(load(name, [f"solver={solver}", "limits.torque_rate=1e6"]))
        robot, q = built.robot, built.q.copy()
        for joint, angle in BENT[foot].items():
            q[7 + robot.joints.index(joint)] += angle
        out, state = first_tick(built.controller, q, np.zeros(robot.nv))
        held = state.contacts[foot]
        assert held.lifted
        assert f"{foot}.lifted" in out.active
        assert out.status is Status.LIMITED
        np.testing.assert_allclose(out.wrenches[foot], 0.0, atol=1e-6)
        frame = state.frame(held.frame)
        down = (frame.T.rotation @ (frame.J @ out.vdot + frame.drift)[3:])[2]
        assert down < -0.5
        up = -sum(
            (state.frame(built.phases[0].contacts[n].frame).T.rotation @ F[3:])[2] for n, F in out.wrenches.items()
        )
        _, J, drift = com(state)
        assert up == pytest.approx(mass(state) * (9.81 + (J @ out.vdot + drift)[2]), rel=1e-6)

    def test_within_the_softness_of_the_floor_it_stands(self, stands):
        built = stands["go2_stand"]
        q = built.q.copy()
        for away, lifted in ((0.9 * LIFTED, False), (1.1 * LIFTED, True)):
            q[2] = built.q[2] + away
            _, state = first_tick(built.controller, q, np.zeros(18))
            assert {held.lifted for held in state.contacts.values()} == {lifted}

    def test_with_all_feet_in_the_air_it_falls_with_g(self):
        built = build(load("go2_stand", ["limits.torque_rate=1e6"]))
        q = built.q.copy()
        q[2] += 0.1
        out, state = first_tick(built.controller, q, np.zeros(18))
        assert out.status is Status.LIMITED
        _, J, drift = com(state)
        np.testing.assert_allclose(J @ out.vdot + drift, [0.0, 0.0, -9.81], atol=1e-6)


class TestChangingHands:
    """From one phase of `go2_step` to the next."""

    def test_loads_and_the_centre_of_mass_lead_from_what_is_to_what_is_asked_for(self):
        built = build(load("go2_step"))
        robot, controller, q = built.robot, built.controller, built.q
        controller.reset(q, np.zeros(robot.nv))
        before = controller.step(0.0, q, np.zeros(robot.nv))
        after = controller.step(0.2, q, np.zeros(robot.nv))
        assert controller.phase.name == "unload_FL"
        for name, F in before.wrenches.items():
            np.testing.assert_allclose(after.wrenches[name], F, atol=2.0)  # of 38; the old task pulled by 0.7 mm
        np.testing.assert_allclose(after.tau, before.tau, atol=0.3)
        balance = controller.phase.tasks["balance"]
        wanted, velocity, _ = balance.desired(controller.state)
        np.testing.assert_allclose(wanted, com(controller.state)[0], atol=1e-9)
        np.testing.assert_allclose(velocity, 0.0, atol=1e-9)
        for t in np.arange(0.201, 1.3005, 1e-3).tolist():  # a clock that jumped would be led in
            controller.step(t, q, np.zeros(robot.nv))
        place = sum(
            share * controller.state.frame(f"{foot}_foot").T.translation[:2]
            for foot, share in (("FR", 0.4), ("RL", 0.4), ("RR", 0.2))
        )
        np.testing.assert_allclose(balance.desired(controller.state)[0][:2], place, atol=1e-9)

    def test_shares_are_taken_up_within_their_time(self, go2):
        state = go2.state(go2.keyframes["home"], np.zeros(18))
        for name, contact in contacts_of(go2).items():
            state.contacts[name] = contact.hold(state)
        task, weight = DistributionTask({"FL_foot": 1.0}), mass(state) * 9.81
        names = list(state.contacts)
        even = DistributionTask().rows(state).lo
        loads = dict(zip(names, np.split(even, len(names)), strict=True))
        wanted = task.rows(state).lo
        assert np.abs(wanted - even).max() > 0.05 * weight
        for t, share in ((0.0, 0.0), (0.5 * FADE, 0.5), (FADE, 1.0), (2.0 * FADE, 1.0)):
            state.t, state.starts = t, {task: Start(0.0, loads=loads)}
            np.testing.assert_allclose(task.rows(state).lo, (1 - share) * even + share * wanted, atol=1e-9 * weight)

    def test_two_feet_at_once_leave_and_come_back_without_a_bump(self, tmp_path):
        """A diagonal pair, unloaded first: in one tick two contacts go, in another they come."""
        text = (shipped_folder("tasks") / "go2_step.yaml").read_text().partition("phases:")[0]
        text = "".join(line for line in text.splitlines(keepends=True) if "_swing" not in line and "_ahead" not in line)
        shares = {f"tasks.{key}.{foot}": 0 for key in ("balance.target.over", "share.shares") for foot in PAIR}
        shares |= {f"tasks.share.shares.{foot}": 0.5 for foot in ("FR", "RL")}
        nothing = ", ".join(f"{key}: {value}" for key, value in shares.items())
        (tmp_path / "pair.yaml").write_text(
            text.replace("duration: 10", "duration: 1.6").replace("torque_rate: 1500", "torque_rate: 5000")
            + "phases:\n  stand: {until: {time: 0.1}}\n"
            + f"  unload: {{set: {{{nothing}}}, until: {{time: 0.9}}}}\n"
            + f"  two: {{contacts: [FR, RL], set: {{{nothing}}}, until: {{time: 0.05}}}}\n  all: {{}}\n"
        )
        finished = run(build(load(tmp_path / "pair.yaml")))
        log, phase = finished.log, finished.log["phase"].astype(int)
        assert [change["name"] for change in finished.summary["phases"]] == ["stand", "unload", "two", "all"]
        assert set(finished.summary["status"]) <= {"OK", "LIMITED"}
        changes = np.flatnonzero(np.diff(phase)) + 1  # the first tick of each phase
        steps = np.abs(np.diff(log["tau"], axis=0)).max(axis=1)
        assert steps[changes[0] :].max() < PAIR_STEP
        carried = [np.abs(log[f"{foot}.true"][changes[1] : changes[2], 5]).max() for foot in PAIR]
        assert max(carried) < 1.0  # [N] they are let go with nothing on them,
        for foot in PAIR:  # and carry the same again afterwards
            before, after = (np.linalg.norm(log[f"{foot}.true"][i, 3:]) for i in (changes[0] - 1, -1))
            assert after == pytest.approx(before, rel=0.05)
