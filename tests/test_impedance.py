"""Impedance and admittance as tasks: the book's torques, straight lines, stable masses, memory, and what is refused."""

from __future__ import annotations

import bars
import numpy as np
import pinocchio as pin
import pytest
import yaml

from wbc import analytic
from wbc.build import build
from wbc.contact.axes import AxesContact
from wbc.controller import Controller
from wbc.errors import GainError, SpecError
from wbc.free_motion import free_matrix, radius, stable_range
from wbc.ladder import Status
from wbc.observer import MomentumObserver
from wbc.reference import Sample, hold
from wbc.resources import shipped_folder
from wbc.robot import Robot
from wbc.run import run
from wbc.sim import Simulator
from wbc.spec import Spec, load
from wbc.task.impedance import AdmittanceTask, ImpedanceTask
from wbc.task.motion import MotionTask, pose_errors
from wbc.task.posture import PostureTask
from wbc.verify import verify
from wbc.wrench import Wrench

DT = 1e-3
NO_LIMITS = dict.fromkeys(("torque", "torque_rate", "position", "velocity"))
M, B, K = np.diag([0.2, 0.3, 0.25, 2.0, 3.0, 2.5]), 40.0, 200.0


@pytest.fixture(scope="module")
def handled():
    """A panda with the handle."""
    return Robot.load("panda", tool="handle")


def near(T, rng, size=0.1):
    return T * pin.exp6(pin.Motion(size * rng.normal(size=6)))


# --- the law, against the book ---


def one_tick(robot, state, task, F=None):
    """The answer of a controller with this task alone, at a state where all six axes belong to it."""
    made = Controller(robot, tasks={"feel": task}, limits=NO_LIMITS)
    made.reset(state.q, state.v)
    given = None if F is None else {"feel": Wrench(F, task.frame)}
    out = made.step(0.0, state.q, state.v, measured=given)
    assert out.status is Status.OK, out.reason
    return out


class TestAgainstTheBook:
    """A ur5e has six joints: what all six axes ask for is all that its torque can be."""

    frame = "flange"

    def parts(self, robot, draw, rng):
        state = draw(robot)
        while np.linalg.cond((J := state.frame(self.frame).J) @ np.linalg.solve(state.M, J.T)) > 1e4:
            state = draw(robot)
        frame = state.frame(self.frame)
        T_d = near(frame.T, rng)
        x_e = -analytic.pose_error(frame.T.homogeneous, T_d.homogeneous)
        M_C = np.linalg.inv(frame.J @ np.linalg.solve(state.M, frame.J.T))
        h_C = M_C @ (frame.J @ np.linalg.solve(state.M, state.h) - frame.drift)
        F = rng.normal(size=6) * [1, 1, 1, 5, 5, 5]
        return state, frame, T_d, x_e, M_C, h_C, F

    def test_impedance_with_the_acceleration_that_the_push_makes_of_it(self, ur5e, draw, rng):
        for _ in range(20):
            state, frame, T_d, x_e, M_C, h_C, F = self.parts(ur5e, draw, rng)
            out = one_tick(ur5e, state, ImpedanceTask(self.frame, hold(T_d), M, B, K), F)
            xdd = frame.J @ np.linalg.solve(state.M, out.tau - state.h - frame.J.T @ F) + frame.drift
            np.testing.assert_allclose(M @ xdd + B * frame.V + K * x_e, -F, atol=1e-7)  # f_ext = -F
            tau = analytic.impedance_torque(frame.J, M_C, h_C, xdd, frame.V, x_e, M, B, K)
            np.testing.assert_allclose(out.tau, tau, atol=1e-7)

    def test_without_a_mass(self, ur5e, draw, rng):
        for _ in range(20):
            state, frame, T_d, x_e, _, h_C, _ = self.parts(ur5e, draw, rng)
            out = one_tick(ur5e, state, ImpedanceTask(self.frame, hold(T_d), 0, B, K, source="none"))
            tau = analytic.impedance_torque_massless(frame.J, h_C, frame.V, x_e, B, K)
            np.testing.assert_allclose(out.tau, tau, atol=1e-7)

    def test_with_its_weight_alone_compensated(self, ur5e, draw, rng):
        state, frame, T_d, x_e, _, _, _ = self.parts(ur5e, draw, rng)
        task = ImpedanceTask(self.frame, hold(T_d), 0, B, K, source="none", compensate="gravity")
        tau = analytic.impedance_torque_gravity(frame.J, state.gravity(), x_e, np.zeros(6), frame.V, B, K)
        np.testing.assert_allclose(one_tick(ur5e, state, task).tau, tau, atol=1e-7)

    def test_with_nothing_asked_the_arm_floats(self, ur5e, draw, rng):
        state, _, T_d, *_ = self.parts(ur5e, draw, rng)
        task = ImpedanceTask(self.frame, hold(T_d), 0, 0, 0, source="none", compensate="gravity")
        np.testing.assert_allclose(one_tick(ur5e, state, task).tau, state.gravity(), atol=1e-8)

    @pytest.mark.parametrize("law", ["compensated", "printed"])
    def test_admittance(self, ur5e, draw, rng, law):
        for _ in range(20):
            state, frame, T_d, x_e, _, _, F = self.parts(ur5e, draw, rng)
            out = one_tick(ur5e, state, AdmittanceTask(self.frame, hold(T_d), M, B, K, law=law), F)
            xdd = analytic.admittance_acceleration(M, B, K, -F, frame.V, x_e)
            f_ext = -F if law == "compensated" else None
            tau = analytic.admittance_torque(state.M, state.h, frame.J, frame.drift, xdd, f_ext)
            np.testing.assert_allclose(out.tau, tau, atol=1e-7)

    def test_from_the_acceleration_of_the_last_tick(self, ur5e, draw, rng):
        state, frame, T_d, x_e, M_C, h_C, _ = self.parts(ur5e, draw, rng)
        task = ImpedanceTask(self.frame, hold(T_d), M, B, K, source="acceleration")
        made = Controller(ur5e, tasks={"feel": task}, limits=NO_LIMITS)
        past = state.q - DT * state.v, state.v - DT * rng.normal(size=6)
        made.reset(*past)
        made.step(0.0, *past)
        before = ur5e.state(*past).frame(self.frame).V
        out = made.step(DT, state.q, state.v)
        tau = analytic.impedance_torque(frame.J, M_C, h_C, (frame.V - before) / DT, frame.V, x_e, M, B, K)
        np.testing.assert_allclose(out.tau, tau, rtol=1e-8, atol=1e-6)


@pytest.mark.parametrize(
    ("place", "feedforward", "more"),
    [
        ("contact: board", "none", ""),
        ("contact: board", "none", ", error: split"),
        ("contact: board", "none", ", external: acceleration"),
        ("contact: board", "none", ", external: observer, filter: 50"),
        ("contact: board", "none", ", filter: 30"),
        ("frame: eraser, axes: [wz, vx, vy]", "none", ""),
        ("frame: wrist_sensor, axes: [wz, vx, vy]", "measured", ""),
    ],
)
def test_beside_a_force_and_under_contact_the_closed_form_holds(place, feedforward, more):
    text = f"{{type: impedance, {place}, M: [0.1, 2, 2], B: [2, 40, 40], K: 30{more}}}"
    spec = load("eraser", ["duration=0.02"])
    tree = spec.model_dump(by_alias=True, exclude_unset=True)
    tree["tasks"]["draw"] = yaml.safe_load(text)
    tree["expect"] = {}
    tree["contacts"]["board"]["feedforward"] = feedforward
    certificate = verify(Spec.model_validate(tree), states=40)
    assert certificate.states > 25
    assert max(law.max_tau_error for law in certificate.laws.values()) < bars.TAU_ERROR["daqp"]


def test_tasks_at_one_frame_count_a_push_once(handled):
    """Two tasks share the axes of one push: the arm answers as to a single task."""
    q, v = handled.keyframes["home"], np.zeros(7)
    T = handled.state(q, v).frame("tip").T
    all_axes = ("wx", "wy", "wz", "vx", "vy", "vz")
    one = {"feel": ImpedanceTask("tip", hold(T), 2, 40, 200)}
    two = {
        "x": ImpedanceTask("tip", hold(T), 2, 40, 200, axes=all_axes[:4]),
        "y": ImpedanceTask("tip", hold(T), 2, 40, 200, axes=all_axes[4:]),
    }
    push = Wrench(np.array([0.1, 0.2, 0.0, 3.0, -2.0, 5.0]), "tip")
    posture = {"posture": PostureTask(q)}
    answers = []
    for tasks in (one, two):
        made = Controller(handled, tasks=tasks | posture)
        made.reset(q, v)
        answers.append(made.step(0.0, q, v, measured=dict.fromkeys(tasks, push)).tau)
    np.testing.assert_allclose(*answers, atol=1e-9)


@pytest.mark.parametrize("feedforward", ["none", "measured"])
@pytest.mark.parametrize(
    "tasks",
    [
        {"feel": ("eraser", ("vx", "vy", "wz"), True)},
        {"feel": ("eraser", ("vx", "vy", "wz"), False)},
        {"feel": ("wrist_sensor", ("vx", "vy"), False)},
        {"x": ("eraser", ("vx",), False), "y": ("wrist_sensor", ("vy",), False)},
        {"x": ("eraser", ("vx", "vy", "wz"), True), "y": ("eraser", ("wz",), False)},
    ],
    ids=["on the contact", "at its frame", "at another frame", "at both", "on it and at its frame"],
)
def test_one_wrench_on_one_link_counts_once(panda, draw, rng, tasks, feedforward):
    """Whoever is told of it: an arm under that wrench then moves as the tasks ask, and presses as predicted."""
    state = draw(panda)
    F, q = np.r_[rng.normal(size=3), 8.0 * rng.normal(size=3)], panda.keyframes["home"]
    board = AxesContact("eraser", ("wx", "wy", "vz"))
    board.feedforward = feedforward
    made = {}
    for name, (frame, axes, on) in tasks.items():
        target = hold(panda.state(q, np.zeros(7)).frame(frame).T)
        axes = board.free_axes if on else axes
        made[name] = ImpedanceTask(frame, target, 2, 40, 200, axes=axes, contact="board" if on else None)
    controller = Controller(panda, {"board": board}, made | {"posture": PostureTask(q)}, NO_LIMITS)
    controller.reset(state.q, state.v)
    given = dict.fromkeys(controller.phase.feeling, Wrench(F, "eraser"))
    out = controller.step(0.0, state.q, state.v, measured=given)
    J, held = state.frame("eraser").J, board.hold(state)
    free = np.r_[0.0, 0.0, F[2], F[3], F[4], 0.0]  # what the board does not cause, for it leaves wz, vx, vy free
    kkt = np.block([[state.M, held.G.T], [held.G, np.zeros((3, 3))]])
    vdot, lam = np.split(np.linalg.solve(kkt, np.r_[out.tau - state.h - J.T @ free, held.rhs]), [7])
    np.testing.assert_allclose(vdot, out.vdot, atol=1e-8)
    np.testing.assert_allclose(held.A.T @ lam, out.wrenches["board"], atol=1e-7)
    if len(tasks) == 1:  # and it has the mass that was asked for
        (task,) = made.values()
        frame, S = state.frame(task.frame), board.free(state) if task.contact else task.selection(state)
        X_e, V_e, _ = task.errors(frame.T, frame.V, task.followed(state))
        f_ext = -S @ Wrench(F, "eraser").at(state, task.frame)
        asked = (40.0 * S @ V_e + 200.0 * S @ X_e + f_ext) / 2.0
        np.testing.assert_allclose(S @ (frame.J @ vdot + frame.drift), asked, rtol=1e-7)


def test_an_observer_and_the_sensor_count_a_push_once(handled):
    q, v = handled.keyframes["home"], np.zeros(7)
    T = handled.state(q, v).frame("tip").T
    observer = MomentumObserver(handled, 30.0)
    feel = ImpedanceTask("tip", hold(T), 2, 40, 200, axes=("vx",))
    watch = ImpedanceTask("handle_body", hold(T), 2, 40, 200, axes=("vy",), source="observer", observer=observer)
    push, posture = Wrench(np.array([0.1, 0.2, 0.0, 3.0, -2.0, 5.0]), "tip"), PostureTask(q)
    made = Controller(handled, tasks={"feel": feel, "watch": watch, "posture": posture})
    made.reset(q, v)
    made.step(0.0, q, v, measured={"feel": push})
    made.step(0.001, q, v + 0.01, measured={"feel": push})  # now there is a residual
    assert np.abs(made.memory.felt["watch"].F).max() > 1.0
    state = made.state
    np.testing.assert_allclose(state.bias, state.h + state.frame("tip").J.T @ push.F)


ELBOW = "tasks:\n  elbow: {type: impedance, frame: link4, axes: [vy], M: 3, B: 60, K: 300, external: "
SEEN, READ = ELBOW + "observer, filter: 30}\n", ELBOW + "measured}\n"


@pytest.mark.parametrize(
    ("spec", "changes", "place", "message"),
    [
        (
            "impedance", {"tasks:\n": SEEN}, "tasks.elbow.external",
            "an observer feels all that acts on the arm, so what task 'feel' feels on another link as well; expected",
        ),
        (
            "chalk", {"tasks:\n": SEEN}, "tasks.elbow.external",
            "so contact 'board' on another link as well; expected measured, or all on one link",
        ),
        (
            "chalk",
            {
                "    frame: chalk\n": "    frame: chalk\n    feedforward: measured\n",
                "tasks:\n": "  side: {frame: wrist_sensor, holds: [wz]}\ntasks:\n",
            },
            "contacts.board.feedforward", "also that of contact 'side', on the same link; expected none or modelled",
        ),
    ],
    ids=["two tasks", "a contact elsewhere", "two contacts"],
)  # fmt: skip
def test_wrenches_that_nothing_tells_apart_are_refused(tmp_path, spec, changes, place, message):
    text = (shipped_folder("tasks") / f"{spec}.yaml").read_text()
    for old, new in changes.items():
        assert text.count(old) == 1
        text = text.replace(old, new)
    (fault,) = refused(tmp_path, text)
    assert fault[2] == place
    assert message in fault[3]


def test_the_wrist_sensor_reads_nothing_of_the_elbow(tmp_path):
    file = tmp_path / "elbow.yaml"
    text = (shipped_folder("tasks") / "impedance.yaml").read_text()
    for old, new in (("tasks:\n", READ), ("duration: 8", "duration: 1"), ("frame: tip\n", "frame: link5\n")):
        assert text.count(old) == 1
        text = text.replace(old, new)
    file.write_text(text)
    finished = run(build(load(file)))
    said = "elbow: nothing is measured there, for the wrist sensor does not read what acts on link4"
    assert said in finished.summary["notes"]
    assert not finished.log["elbow.felt"].any()
    assert not [
        note for note in run(build(load("impedance", ["duration=0.01"]))).summary["notes"] if "measured" in note
    ]


# --- pose errors ---


@pytest.mark.parametrize("split", [False, True])
def test_errors_are_each_others_derivatives(rng, split):
    """V_e + V = Ad V_d, and `ahead` is its derivative, along any two motions."""
    for _ in range(10):
        T, T_d = near(pin.SE3.Identity(), rng, 0.5), near(pin.SE3.Identity(), rng, 0.5)
        V, motion = rng.normal(size=6), rng.normal(size=(6, 2))

        def at(s, T=T, T_d=T_d, V=V, motion=motion):
            V_d = motion[:, 0] + s * motion[:, 1]
            mean = motion[:, 0] + 0.5 * s * motion[:, 1]
            now = T * pin.exp6(pin.Motion(s * V[3:], s * V[:3]))
            wanted = T_d * pin.exp6(pin.Motion(s * mean[3:], s * mean[:3]))
            return pose_errors(now, V, Sample(wanted, np.column_stack((V_d, motion[:, 1]))), split)

        h = 1e-6
        (_, before, _), (_, after, _), (X_e, _, ahead) = at(-h), at(h), at(0.0)
        # split: the rows of the linear part are those of a turning frame, of which v has the other half
        turned = np.r_[np.zeros(3), np.cross(V[:3], V[3:] - seen(T, T_d, motion))] if split else 0.0
        np.testing.assert_allclose((after - before) / (2 * h), ahead + turned, atol=2e-8)
        assert np.isfinite(X_e).all()


def seen(T, T_d, motion):
    """The desired linear velocity, in the axes of T."""
    return T.rotation.T @ T_d.rotation @ motion[3:, 0]


@pytest.mark.parametrize(("split", "bend"), [(True, (0.0, 5e-4)), (False, (0.01, 0.1))])
def test_split_errors_lead_along_a_straight_line_and_the_log_does_not(split, bend):
    """0.3 m and 1 rad, by computed torque on a free body."""
    T, V = pin.SE3.Identity(), np.zeros(6)
    goal = Sample(pin.SE3(pin.exp3(np.array([0.0, 0.0, 1.0])), np.array([0.3, 0.0, 0.0])), np.zeros((6, 2)))
    away = 0.0
    for _ in range(3000):
        X_e, V_e, ahead = pose_errors(T, V, goal, split)
        V = V + DT * (ahead + 100 * X_e + 20 * V_e)
        T = T * pin.exp6(pin.Motion(DT * V[3:], DT * V[:3]))
        away = max(away, float(np.linalg.norm(T.translation[1:])))
    assert np.linalg.norm(T.translation - goal.T.translation) < 1e-5
    assert bend[0] <= away <= bend[1]


def test_a_motion_task_takes_the_same_choice(handled, rng):
    state = handled.state(handled.keyframes["home"], 0.3 * rng.normal(size=7))
    frame = state.frame("tip")
    goal = hold(near(frame.T, rng))
    for error in ("log", "split"):
        X_e, V_e, ahead = pose_errors(frame.T, frame.V, goal(0.0), error == "split")
        y = MotionTask("tip", goal, 100.0, 20.0, error=error).acceleration(state)
        np.testing.assert_allclose(y, ahead + 100 * X_e + 20 * V_e, atol=1e-9)


# --- stable masses ---


class TestFreeMotion:
    def test_the_bounds_of_one_dimension(self):
        W, one = np.array([[0.25]]), np.ones((1, 1))

        def worst(mass, accelerated):
            return radius(W, mass * one, 40 * one, 300 * one, DT, accelerated)

        least, most = stable_range(lambda scale: worst(scale, False))
        assert least == pytest.approx(analytic.least_stable_mass(40, 300, DT), rel=1e-4)
        assert most == np.inf
        least, most = stable_range(lambda scale: worst(scale, True))
        assert most == pytest.approx(analytic.acceleration_feedback_limit(4.0, 40, 300, DT), rel=1e-4)
        assert 0 < least < 1

    def test_a_delay_shifts_what_the_arm_does(self):
        W, one = np.array([[0.5]]), np.ones((1, 1))
        late = free_matrix(W, 2 * one, 40 * one, 300 * one, DT, False, delay=3)
        x, v, asked = 0.01, 0.2, []
        state = np.r_[x, v, np.zeros(4)]
        for _ in range(50):
            asked.append(-(40 * v + 300 * x) / 2)
            v += DT * (asked[-4] if len(asked) > 3 else 0.0)
            x += DT * v
            state = late @ state
            np.testing.assert_allclose(state[:2], (x, v), rtol=1e-9)

    def test_none_is_said_where_none_is_stable(self):
        assert np.isnan(stable_range(lambda scale: 2.0)).all()

    @pytest.mark.parametrize("law", ["compensated", "printed"])
    def test_the_smallest_mass_that_an_admittance_renders_is_the_computed_one(self, handled, law):
        computed = analytic.least_stable_mass(120.0, 400.0, DT)
        measured = smallest(lambda mass: settles(handled, AdmittanceTask, mass, law=law), computed)
        assert abs(measured / computed - 1) <= bars.LEAST_MASS_ERROR

    def test_and_an_impedance(self, handled):
        computed = analytic.least_stable_mass(120.0, 400.0, DT)
        measured = smallest(lambda mass: settles(handled, ImpedanceTask, mass), computed)
        assert abs(measured / computed - 1) <= bars.LEAST_MASS_ERROR


def settles(robot, kind, mass, **more):
    """Whether free motion dies out in MuJoCo, from a velocity of the joints."""
    q = robot.keyframes["home"]
    state = robot.state(q, np.zeros(7))
    T = state.frame("tip").T
    tasks = {
        "feel": kind("tip", hold(T), mass, 120.0, 400.0, axes=("vx", "vy", "vz"), **more),
        "upright": MotionTask("tip", hold(T), 400.0, 40.0, axes=("wx", "wy", "wz")),
        "posture": PostureTask(q),
    }
    made, plant = Controller(robot, tasks=tasks), Simulator(robot, q, DT)
    plant.data.qvel[:] = 1e-4
    made.reset(q, np.zeros(7))
    speeds = []
    for _ in range(120):
        seen = plant.observe()
        out = made.step(seen.t, seen.q, seen.v, measured={"feel": Wrench(np.zeros(6), "tip")})
        plant.apply(out.tau)
        speeds.append(np.linalg.norm(made.state.frame("tip").V[3:]))
    return max(speeds[-10:]) < 3 * speeds[0]


def smallest(stable, near):
    """The mass at which stability begins, by bisection within a third of the expected one."""
    low, high = near / 1.5, near * 1.5
    assert stable(high)
    assert not stable(low)
    for _ in range(5):
        middle = np.sqrt(low * high)
        low, high = (low, middle) if stable(middle) else (middle, high)
    return np.sqrt(low * high)


# --- memory and data ---


class TestMemory:
    @staticmethod
    def made(robot, kind=AdmittanceTask, **more):
        q = robot.keyframes["home"]
        T = robot.state(q, np.zeros(7)).frame("tip").T
        made = Controller(robot, tasks={"feel": kind("tip", hold(T), 2, 40, 200, **more), "posture": PostureTask(q)})
        made.reset(q, np.zeros(7))
        return made, q

    def test_a_tick_depends_on_its_arguments_and_memory_alone(self, handled):
        made, q = self.made(handled)
        for i in range(5):
            made.step(i * DT, q, np.zeros(7), measured={"feel": Wrench(np.full(6, 2.0), "tip")})
        memory = made.memory
        one = made.step(5 * DT, q, np.zeros(7), measured={"feel": Wrench(np.ones(6), "tip")})
        made.step(6 * DT, q, np.zeros(7))
        made.memory = memory
        two = made.step(5 * DT, q, np.zeros(7), measured={"feel": Wrench(np.ones(6), "tip")})
        np.testing.assert_array_equal(one.tau, two.tau)

    def test_the_mass_moves_on_its_own(self, handled):
        """Under a steady push the reference does what m x'' + b x' + k x = f says, wherever the arm is."""
        made, q = self.made(handled, error="split")
        F, t = np.r_[np.zeros(5), -3.0], np.arange(400) * DT
        T0, z = None, []
        for each in t:
            made.step(each, q, np.zeros(7), measured={"feel": Wrench(F, "tip")})
            T = pin.SE3(made.memory.felt["feel"].T)
            T0 = T0 or T
            z.append((T0.actInv(T)).translation[2])
        # its velocity is that of the middle of the tick
        np.testing.assert_allclose(z, analytic.step_response(2, 40, 200, 3.0, t + DT / 2)[0], atol=2.5e-5)

    def test_what_is_measured_wrongly_is_refused_and_the_last_wrench_stands(self, handled):
        made, q = self.made(handled, ImpedanceTask)
        good = made.step(0.0, q, np.zeros(7), measured={"feel": Wrench(np.full(6, 2.0), "tip")})
        bad = made.step(DT, q, np.zeros(7), measured={"feel": Wrench(np.full(6, np.nan), "tip")})
        assert bad.status is Status.LIMITED
        assert "measured.feel: expected a finite Wrench" in bad.reason
        np.testing.assert_allclose(bad.tau, good.tau, atol=1e-9)

    def test_a_low_pass_on_the_wrench(self, handled):
        made, q = self.made(handled, ImpedanceTask, filter=20.0)
        made.step(0.0, q, np.zeros(7), measured={"feel": Wrench(np.zeros(6), "tip")})
        made.step(DT, q, np.zeros(7), measured={"feel": Wrench(np.ones(6), "tip")})
        np.testing.assert_allclose(made.memory.felt["feel"].F, 1 - np.exp(-2 * np.pi * 20 * DT))


# --- what is refused ---


@pytest.mark.parametrize(
    ("name", "value", "message"),
    [
        ("M", [1.0, 2.0], "M: got shape"),
        ("K", [[1.0, 2.0, 0.0], [2.0, 1.0, 0.0], [0.0, 0.0, 1.0]], "K: not positive definite"),
        ("B", [1.0, -1.0, 1.0], "B: not positive definite"),
        ("source", "guessed", "external: expected one of measured, observer"),
    ],
)
def test_gains_that_cannot_be_are_refused(name, value, message):
    given = {"M": 1.0, "B": 1.0, "K": 1.0, "axes": ("vx", "vy", "vz"), name: value}
    with pytest.raises(GainError, match=message):
        ImpedanceTask("tip", hold(pin.SE3.Identity()), **given)


def test_an_admittance_without_a_mass_is_refused():
    with pytest.raises(GainError, match="an admittance moves a mass"):
        AdmittanceTask("tip", hold(pin.SE3.Identity()), 0, 1, 1)


REFUSED = {
    "unstable from an acceleration": (
        "impedance", ["tasks.feel.external=acceleration", "tasks.feel.M=9"],
        "tasks.feel.M", "choose M on vx from .* to 3",
    ),
    "too light for the rate": ("admittance", ["tasks.feel.M=0.01"], "tasks.feel.M", "unstable at this rate"),
    "followed too stiffly": ("admittance", ["tasks.feel.kd=5000"], "tasks.feel.kd", "follow so stiffly"),
    "negative stiffness": ("impedance", ["tasks.feel.K=-1"], "tasks.feel.K", "of at least 0"),
    "a mass along some axes": ("impedance", ["tasks.feel.M=[1, 0, 1]"], "tasks.feel.M", "all of them above 0"),
    "a mass, and no wrench": ("impedance", ["tasks.feel.external=none"], "tasks.feel.external", "a mass needs"),
    "a wrench for no mass": (
        "impedance_massless", ["tasks.feel.external=measured"], "tasks.feel.external", "no external wrench is needed",
    ),
    "a mass and gravity alone": (
        "impedance", ["tasks.feel.compensate=gravity"], "tasks.feel.compensate", "a mass needs the arm's dynamics",
    ),
    "an observer without bandwidth": ("impedance", ["tasks.feel.external=observer"], "tasks.feel.filter", "is missing"),
    "a filter on nothing": (
        "impedance", ["tasks.feel.external=acceleration", "tasks.feel.filter=5"],
        "tasks.feel.filter", "nothing is filtered",
    ),
    "admittance of nothing": ("admittance", ["tasks.feel.M=0"], "tasks.feel.M", "an admittance moves a mass"),
    "a matrix that is not symmetric": (
        "impedance", ["tasks.feel.K=[[1, 2, 0], [0, 1, 0], [0, 0, 1]]"], "tasks.feel.K", "expected a symmetric matrix",
    ),
    "too few numbers": ("impedance", ["tasks.feel.B=[1, 2]"], "tasks.feel.B", "expected 3 numbers"),
    "no such frame": ("impedance", ["tasks.feel.frame=tib"], "tasks.feel.frame", "did you mean 'tip'"),
    "no such contact": ("impedance", ["tasks.feel.target=nowhere"], "tasks.feel.target", "no reference named"),
    "neither log nor split": ("impedance", ["tasks.feel.error=both"], "tasks.feel.error", "expected one of log, split"),
    "a push at no frame": (
        "impedance", ["plant.pushes.hand.frame=tib"], "plant.pushes.hand.frame", "no frame named 'tib'; did you mean",
    ),
    "a push at the world": (
        "high_low_impedance", ["plant.pushes.hand.frame=board"], "plant.pushes.hand.frame", "fixed to the world",
    ),
    "a push that ends before it begins": (
        "mass_spring_damper", ["plant.pushes.step.to=0.2"],
        "plant.pushes.step.to", "expected a time after from = 0.5 s",
    ),
    "a sine without a frequency": (
        "impedance", ["plant.pushes.hand.wrench.fx.sine.frequency=0"],
        "plant.pushes.hand.wrench.fx.sine.frequency", "a number greater than 0",
    ),
    "a direction without one": (
        "high_low_impedance", ["plant.moves.board_body.along=[0, 0, 0]"],
        "plant.moves.board_body.along", "expected a direction",
    ),
}  # fmt: skip


@pytest.mark.parametrize("case", REFUSED)
def test_wrong_specs_are_refused_in_their_place(case):
    name, overrides, key, message = REFUSED[case]
    with pytest.raises(SpecError, match=message) as caught:
        build(load(name, overrides))
    assert [fault.key for fault in caught.value.faults] == [key]


def refused(tmp_path, text):
    file = tmp_path / "spec.yaml"
    file.write_text(text)
    with pytest.raises(SpecError) as caught:
        build(load(file))
    return [(fault.line, fault.column, fault.key, fault.message) for fault in caught.value.faults]


@pytest.mark.parametrize(
    ("line", "place", "message"),
    [
        ("tasks: {a: {type: impedance, M: 1, B: 1, K: 1}}", (3, 9, "tasks.a.frame"), "a `contact` or a `frame`"),
        ("plant: {moves: {board_body: {along: [0, 0, 1], sine: {amplitude: 1, frequency: 1}}}}",
         (3, 17, "plant.moves.board_body"), "no mocap body named 'board_body'"),
        ("tasks: {a: {type: posture, kp: 1, kd: 1}}\nplant: {pushes: {a: {frame: tip, wrench: {fx: 1}}}}",
         (4, 18, "plant.pushes.a"), "there is a task of that name; expected another one"),
        ("plant: {pushes: {a: {frame: tip, wrench: {}}}}", (3, 34, "plant.pushes.a.wrench"), "at least 1 entries"),
        ("plant: {pushes: {a: {frame: tip, wrench: {vx: 1}}}}", (3, 43, "plant.pushes.a.wrench.vx"), "'mx'"),
        ("tare: 1", (3, 1, "tare"), "expected true or false"),
    ],
)  # fmt: skip
def test_faults_have_their_line_and_column(tmp_path, line, place, message):
    (fault,) = refused(tmp_path, f"robot: panda\ntool: handle\n{line}\n")
    assert fault[:3] == place
    assert message in fault[3]
