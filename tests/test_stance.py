"""Robots that stand: redundant contacts, unsettled starts, fallbacks within limits, figures that can fail."""

from __future__ import annotations

import os
from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from bars import REDUNDANT_REFUSED
from oracles import first_tick
from test_floating import DOWN, FREE, contacts_of, tasks_of

from wbc.build import build
from wbc.check import check
from wbc.contact import Settling
from wbc.contact.axes import AxesContact
from wbc.contact.foot import RoundFoot
from wbc.controller import Controller
from wbc.errors import LawError, NameNotFound, SpecError, StateError
from wbc.friction import unilateral
from wbc.ladder import Status
from wbc.phase import place
from wbc.reference import Path, sine
from wbc.resources import shipped_folder
from wbc.robot import Robot
from wbc.run import run
from wbc.sim import Simulator
from wbc.spec import load
from wbc.task.centroidal import ComTask, DistributionTask, com, mass
from wbc.task.force import ForceTask
from wbc.task.motion import MotionTask
from wbc.transition import after
from wbc.whole_body import WholeBodyProgram
from wbc.wrench import Wrench

LARGE = os.environ.get("WBC_CAMPAIGN") == "large"
WRITTEN = (("scenes", "robots/g1.xml"), ("tasks", "g1_stand.yaml"))
CORNERS = tuple(f"{side}_{corner}" for side in ("left", "right") for corner in ("a", "b", "c", "d"))


@pytest.fixture(scope="module")
def cornered():
    """G1 with a frame in every corner of its soles."""

    from wbc import model as models

    composed = models.compose("g1", None, "floor")
    for name in CORNERS:
        side, corner = name.split("_")
        x, y = (0.12 if corner in "ab" else -0.05), (0.025 if corner in "ac" else -0.025)
        composed.spec.body(f"{side}_ankle_roll_link").add_site(name=name, pos=[x, y, -0.035])
    mj = models.compile_model(composed.spec)
    plain = Robot.load("g1", scene="floor")
    return replace(plain, model=models.pinocchio_model(mj), mujoco=mj, plant=mj)


def points(robot):
    state = robot.state(robot.keyframes["home"], np.zeros(robot.nv))
    made = {}
    for name in CORNERS:
        made[name] = RoundFoot(name, np.eye(3))
        made[name].pushes = unilateral(made[name], state, DOWN, mu=0.6)
        made[name].settling = Settling()
    return made


class TestRedundantContacts:
    def controller(self, robot, solver="daqp", tasks=None):
        q = robot.keyframes["home"]
        limits = {"torque": "model", "torque_rate": 2000.0, "position": "model", "velocity": "model"}
        return Controller(robot, points(robot), tasks or tasks_of(robot, q), limits, q=q, solver=solver)

    def test_the_rank_is_told(self, cornered):
        assert "contacts hold 24 axes, of which 12 are independent" in self.controller(cornered).notes

    def test_rank_of_soles_is_full_and_needs_no_note(self, g1):
        controller = Controller(g1, contacts_of(g1), tasks_of(g1, g1.keyframes["home"]))
        assert not controller.notes

    @pytest.mark.parametrize("solver", ["daqp", "proxqp"])
    def test_eight_points_stand_and_sway_and_no_tick_is_refused(self, cornered, solver):
        """3 000 ticks at the full size, a bar of its own: CI runs 150 of them."""
        q, ticks = cornered.keyframes["home"], 3000 if LARGE else 150
        tasks = tasks_of(cornered, q)
        start = cornered.state(q, np.zeros(cornered.nv))
        middle = pin.SE3(np.eye(3), com(start)[0].copy())
        course = {3: sine(0.01, 1.5, ease=0.5), 4: sine(0.03, 2.0, ease=0.5), 5: sine(0.01, 1.0, ease=0.5)}  # [m], [s]
        tasks["balance"] = ComTask(Path(middle, course), 40.0, 12.0)
        controller = self.controller(cornered, solver, tasks)
        assert controller.phase.contacts.keys() == set(CORNERS)
        simulator = Simulator(cornered, q, 1e-3)
        controller.reset(q, np.zeros(cornered.nv))
        refused, lowest = 0, np.inf
        for _ in range(ticks):
            seen = simulator.observe()
            out = controller.step(seen.t, seen.q, seen.v)
            refused += out.status not in (Status.OK, Status.LIMITED)
            simulator.apply(out.tau)
            pushes = [-(controller.state.frame(n).T.rotation @ F[3:])[2] for n, F in out.wrenches.items()]
            lowest = min([lowest, *pushes])
        assert refused <= REDUNDANT_REFUSED
        assert lowest >= -1e-6  # [N] none pulls
        away = controller.phase.tasks["balance"].desired(controller.state)[0] - simulator.true_com()
        assert np.linalg.norm(away) < 5e-3

    def test_check_tells_the_rank(self, tmp_path):
        """Of a spec whose robot has a site in every corner of its soles."""
        xml, text = (shipped_folder(name).joinpath(file).read_text() for name, file in WRITTEN)
        for name in CORNERS:
            side, corner = name.split("_")
            x, y = (0.12 if corner in "ab" else -0.05), (0.025 if corner in "ac" else -0.025)
            sole = f'<site name="{side}_sole"'
            xml = xml.replace(sole, f'<site name="{name}" pos="{x} {y} -0.035"/>\n{sole}')
        (tmp_path / "cornered.xml").write_text(xml)
        head, _, tail = text.partition("contacts:\n")
        tail = (
            tail.partition("tasks:\n")[2]
            .partition("expect:")[0]
            .replace("left_foot, right_foot", ", ".join(f"at_{n}" for n in CORNERS))
        )
        feet = "".join(
            f"  at_{name}: {{frame: {name}, holds: [vx, vy, vz], pushes: -z, friction: 0.6}}\n" for name in CORNERS
        )
        spec = f"{head}contacts:\n{feet}tasks:\n{tail}".replace("robot: g1", "robot: cornered.xml")
        (tmp_path / "corners.yaml").write_text(spec)
        report = check(load(tmp_path / "corners.yaml"))
        assert report.feasible, report.reason
        assert "contacts hold 24 axes, of which 12 are independent" in report.notes

    def test_their_wrenches_add_up_to_those_of_soles(self, cornered, g1):
        """Eight points or two soles, the motion and what each foot carries are the same while no cone binds."""
        q = g1.keyframes["home"]
        soles = Controller(g1, contacts_of(g1, bound=False), tasks_of(g1, q), FREE, q=q)
        bare = points(cornered)
        for contact in bare.values():
            contact.pushes = contact.settling = None
        corners = Controller(cornered, bare, tasks_of(cornered, q), FREE, q=q)
        (a, _), (b, _) = (first_tick(each, q, np.zeros(35)) for each in (soles, corners))
        np.testing.assert_allclose(a.vdot, b.vdot, atol=1e-8 * (1.0 + np.abs(a.vdot).max()))
        both = [sum(F[3:] @ np.eye(3)[2] for F in out.wrenches.values()) for out in (a, b)]
        assert both[0] == pytest.approx(both[1], rel=1e-6)

    def test_random_velocities_do_not_make_them_contradict(self, cornered, rng):
        """Points of a foot that turns accelerate towards one another: as plain rows that has no answer."""
        controller, q = self.controller(cornered), cornered.keyframes["home"]
        for _ in range(10):
            v = rng.uniform(-0.05, 0.05, cornered.nv)
            out, _ = first_tick(controller, q, v)
            assert out.status in (Status.OK, Status.LIMITED), out.reason


class TestUnsettled:
    def test_a_start_that_moves_asks_nothing_that_the_floor_cannot_give(self, go2, rng):
        """Feet that start with 0.5 m/s: their contacts brake with at most 1 m/s^2, all push, nothing is refused."""
        q = go2.keyframes["home"]
        controller = Controller(go2, contacts_of(go2), tasks_of(go2, q), q=q)
        weight = mass(controller.state) * 9.81
        for up in (0.5, -0.5):
            v = np.zeros(18)
            v[2] = up  # all feet leave the floor, or meet it
            out, state = first_tick(controller, q, v)
            assert out.status in (Status.OK, Status.LIMITED), out.reason
            for held in state.contacts.values():
                at = held.G @ out.vdot + held.A @ state.frame(held.frame).drift
                np.testing.assert_allclose(at[2], -np.sign(up) * 1.0, atol=1e-6)
            pushed = [-(state.frame(n).T.rotation @ F[3:])[2] for n, F in out.wrenches.items()]
            assert min(pushed) > 0.0
            assert max(pushed) < 0.6 * weight

    def test_a_robot_that_is_dropped_comes_to_stand(self, go2):
        q = go2.keyframes["home"].copy()
        controller = Controller(go2, contacts_of(go2), tasks_of(go2, q), {"torque_rate": 2000.0}, q=q)
        high = q.copy()
        high[2] += 0.005
        simulator = Simulator(go2, high, 1e-3)
        controller.reset(high, np.zeros(18))
        for _ in range(900):
            seen = simulator.observe()
            out = controller.step(seen.t, seen.q, seen.v)
            assert out.status in (Status.OK, Status.LIMITED), out.reason
            simulator.apply(out.tau)
        assert np.abs(seen.v).max() < 0.02
        for name in controller.phase.contacts:
            true, asked = simulator.true_wrench(name), out.wrenches[name]
            np.testing.assert_allclose(true, asked, atol=1e-2 * mass(controller.state) * 9.81)


class TestTheLadder:
    def controller(self, robot, rate=2000.0):
        q = robot.keyframes["home"]
        return Controller(robot, contacts_of(robot), tasks_of(robot, q), {"torque_rate": rate}, q=q)

    def test_a_reset_starts_with_what_holds_the_weight(self, g1):
        """Without a torque of the driver's it is the one that the first tick would need at rest."""
        controller, q = self.controller(g1, None), g1.keyframes["home"]
        controller.reset(q, np.zeros(35))
        rest = controller.memory.tau
        tasks = {name: task for name, task in tasks_of(g1, q).items() if name == "trunk"}
        still = Controller(g1, contacts_of(g1), tasks, {"torque_rate": None}, q=q)
        out, _ = first_tick(still, q, np.zeros(35))
        np.testing.assert_allclose(rest, out.tau, atol=1e-6)

    def test_torques_have_one_entry_a_motor(self, go2):
        controller, q, v = self.controller(go2), go2.keyframes["home"], np.zeros(18)
        with pytest.raises(StateError, match=r"tau: expected a float64 array of shape \(12,\)"):
            controller.reset(q, v, tau=np.zeros(18))
        controller.reset(q, v, tau=np.full(12, 0.5))
        out = controller.step(0.0, q, v, tau_applied=np.full(12, 0.5))
        assert out.tau.shape == (12,)
        assert out.vdot.shape == (18,)
        assert np.abs(out.tau - 0.5).max() <= 2.0 + 1e-9  # N m a tick
        out = controller.step(1e-3, q, v, tau_applied=np.zeros(18))
        assert "tau_applied: expected a float64 array of shape (12,)" in out.reason

    def test_without_an_answer_it_holds_within_limits_and_rate(self, g1):
        controller, q, v = self.controller(g1), g1.keyframes["home"], np.zeros(35)
        controller.reset(q, v)
        last = controller.step(0.0, q, v).tau
        seen = []
        for tick in range(1, 30):
            bad = q.copy()
            bad[3] = np.nan
            out = controller.step(1e-3 * tick, bad, v)
            seen.append(out.status)
            assert out.tau.shape == (29,)
            assert (np.abs(out.tau) <= g1.tau_max).all()
            assert np.abs(out.tau - last).max() <= 2.0 + 1e-9
            last = out.tau
        assert seen[0] is Status.DEGRADED
        assert seen[-1] is Status.SAFE_HOLD
        # the safe hold carries the weight with the last wrenches: it is the torque of rest, but for the damping
        controller.reset(q, v)
        assert np.abs(last - controller.memory.tau).max() < 0.2 * np.abs(controller.memory.tau).max() + 1.0

    def test_joint_limits_are_those_of_the_joints(self, go2):
        """A knee pressed to its limit is kept by its own row, with its own name."""
        controller, q = self.controller(go2), go2.keyframes["home"].copy()
        q[9] = go2.q_max[2] - 1e-5
        v = np.zeros(18)
        v[8] = 0.5
        controller.reset(q, v)
        out = controller.step(0.0, q, v)
        assert out.vdot[8] < 0.0 or "yield" in out.reason
        assert any(name == "position[FL_calf_joint]" for name in out.active) or "yield" in out.reason

    def test_the_book_has_no_law_for_it(self, go2):
        state = go2.state(go2.keyframes["home"], np.zeros(18))
        motion = MotionTask("base", lambda t: None, contact="FL_foot", law="book")
        with pytest.raises(LawError, match="fixed base"):
            WholeBodyProgram(place(go2, contacts_of(go2), {"move": motion}, {}), state)

    def test_a_posture_that_nothing_is_left_for_is_dropped(self, go2):
        from wbc.task.centroidal import WholeBodyPosture

        q = go2.keyframes["home"]
        tasks = tasks_of(go2, q) | {"posture": WholeBodyPosture(q, nu=12)}
        controller = Controller(go2, contacts_of(go2), tasks, q=q)
        assert "posture" not in controller.phase.tasks
        assert controller.notes == ["posture: dropped, contacts and motion leave no null space of the 12 joints"]

    def test_shares_name_contacts(self, go2):
        tasks = {"share": DistributionTask({"FL_fot": 1.0})}
        with pytest.raises(NameNotFound, match="did you mean 'FL_foot'"):
            Controller(go2, contacts_of(go2), tasks, q=go2.keyframes["home"])


class TestPhases:
    def test_a_hand_that_begins_to_press_asks_first_for_what_is_there(self, g1):
        """A force loop under way on a floating base: its first command is what the last torque presses with."""
        q = g1.keyframes["home"]
        feet, hand = contacts_of(g1), AxesContact("left_palm", ("vz",))
        press = ForceTask("hand", hand, np.array([-15.0]), kp=0.3, ki=10.0)
        tasks = tasks_of(g1, q)
        first, second = (
            replace(place(g1, contacts, more, {"torque_rate": None}), name=name)
            for name, contacts, more in (
                ("stand", feet, tasks),
                ("wipe", feet | {"hand": hand}, tasks | {"press": press}),
            )
        )
        first = replace(first, exit=after(0.002, "wipe"))
        controller = Controller(g1, phases=[first, second], q=q)
        v = np.zeros(35)
        controller.reset(q, v)
        felt = Wrench(np.array([0.0, 0.0, 0.0, 0.0, 0.0, -3.0]), "left_palm")
        told = [controller.step(1e-3 * i, q, v, measured={"hand": felt}) for i in range(4)]
        assert all(out.status in (Status.OK, Status.LIMITED) for out in told), [out.reason for out in told]
        assert controller.phase.name == "wipe"
        jump = np.abs(told[2].tau - told[1].tau).max()
        assert jump < 1.0  # N m, while the hand goes from free to pressed
        later = [controller.step(controller.memory.t + 1e-3, q, v, measured={"hand": felt}) for _ in range(300)]
        assert later[149].wrenches["hand"][5] < -15.0  # it integrates towards what is missing
        assert "not believed" in later[299].reason  # until nobody believes that so little is felt of so much


# --- figures, of runs from specs ---

G1 = (shipped_folder("tasks") / "g1_stand.yaml").read_text()


@pytest.fixture
def ran(tmp_path):
    """ran(text, (old, new), ...) -> the result of the run."""

    def one(text, *changes):
        for old, new in changes:
            assert old in text
            text = text.replace(old, new)
        (tmp_path / "spec.yaml").write_text(text)
        return run(build(load(tmp_path / "spec.yaml")))

    return one


class TestFigures:
    def test_loaded_70_to_30_on_command_each_foot_carries_what_is_predicted(self, ran):
        finished = ran(
            G1,
            (
                "over: [left_foot, right_foot]}, kp: 40, kd: 12",
                "over: {left_foot: 0.7, right_foot: 0.3}}, kp: 60, kd: 16",
            ),
            ("  posture:", "  share: {type: distribution, shares: {left_foot: 0.7, right_foot: 0.3}}\n  posture:"),
            ("duration: 10", "duration: 3"),
        )
        figures, log = finished.summary["metrics"], finished.log
        for foot in ("left_foot", "right_foot"):
            assert figures[f"{foot}.rest.error"] <= 1e-4
        assert figures["weight.rest.error"] <= 1e-6
        left, right = (log[f"{foot}.true"][-1, 5] for foot in ("left_foot", "right_foot"))
        assert left / (left + right) == pytest.approx(0.7, abs=1e-4)

    def test_slip_is_seen(self, ran):
        text = (shipped_folder("tasks") / "go2_stand.yaml").read_text()
        slippery = (
            "expect:",
            "plant: {contact_friction: 0.02, pushes: {shove: {frame: base, wrench: {fy: 20}}}}\nexpect:",
        )
        finished = ran(text, slippery, ("duration: 10", "duration: 0.4"), ("settle: 1.0", "settle: 0.02"))
        figures = finished.summary["metrics"]
        assert figures["FL.slip"] > 1e-3
        assert not finished.ok

    def test_a_true_wrench_beyond_the_cone_is_seen(self, ran):
        """What the controller believes, a low friction, is not what the floor gives when somebody pushes."""
        text = (shipped_folder("tasks") / "go2_stand.yaml").read_text().replace("friction: 0.6", "friction: 0.05")
        push = ("expect:", "plant: {pushes: {shove: {frame: base, wrench: {fy: 30}}}}\nexpect:")
        finished = ran(text, push, ("duration: 10", "duration: 0.3"))
        assert finished.summary["metrics"]["FL.cone.max_excess"] > 0.1
        assert finished.summary["metrics"]["FL.cone.max_asked"] < 1e-6

    def test_a_wrong_mass_shows_in_the_centre_and_the_weight(self, ran):
        finished = ran(G1, ("expect:", "plant: {mass_error: 0.05}\nexpect:"), ("duration: 10", "duration: 2"))
        figures = finished.summary["metrics"]
        assert figures["balance.position.rms_error"] > 1e-3
        assert figures["left_foot.cone.max_asked"] < 1e-6

    def test_a_start_that_cannot_be_held_is_told(self, tmp_path):
        (tmp_path / "spec.yaml").write_text(G1.replace("limits: {torque: model", "limits: {torque: 1"))
        report = check(load(tmp_path / "spec.yaml"))
        assert not report.feasible
        assert report.reason

    def test_verify_says_that_there_is_no_closed_form(self):
        from wbc.verify import verify

        with pytest.raises(SpecError, match="expected a robot with a fixed base"):
            verify(load("go2_stand"))
