"""Contacts of body against body: two palms on a box, two hands, links of one arm; what they are held to."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
from bars import TAU_ERROR
from oracles import accelerated, closed_form_step, constrained, first_tick, unconstrained
from test_floating import FREE

from wbc.build import build
from wbc.check import check
from wbc.contact.axes import AxesContact, MatrixContact, WorldAxesContact
from wbc.contact.foot import RoundFoot
from wbc.contact.screw import ScrewContact
from wbc.contact.sphere import SphereContact
from wbc.controller import Controller
from wbc.errors import ModelError, SpecError
from wbc.friction import unilateral
from wbc.ladder import Status
from wbc.oracle import relative
from wbc.pair import seen
from wbc.reference import Hold, Path, sine
from wbc.resources import shipped_folder
from wbc.robot import Robot
from wbc.run import run
from wbc.spec import load as load_spec
from wbc.surface import Sole
from wbc.task.centroidal import ComTask, DistributionTask, MomentumTask, WholeBodyPosture, com, load, mass, momentum
from wbc.task.force import ForceTask
from wbc.task.motion import MotionTask
from wbc.task.posture import PostureTask
from wbc.testing import check_contact, check_task
from wbc.verify import verify
from wbc.wrench import VELOCITY_AXES

DOWN = np.array([0.0, 0.0, -1.0])
TILTED = pin.SE3(pin.exp3(np.array([0.2, -0.3, 0.5])), np.array([0.1, -0.2, 0.3]))
PALMS = {"left": "left_palm", "right": "right_palm"}
BOX = (shipped_folder("tasks") / "panda_dual_box.yaml").read_text()


@pytest.fixture(scope="module")
def dual():
    return Robot.load("panda_dual", scene="floor")


@pytest.fixture(scope="module")
def box():
    """The shipped spec, built."""
    return build(load_spec("panda_dual_box"))


@pytest.fixture
def written(tmp_path):
    """written(text, (old, new), ...) -> the spec."""

    def one(text, *changes):
        for old, new in changes:
            assert text.count(old) == 1, old
            text = text.replace(old, new)
        (tmp_path / "spec.yaml").write_text(text)
        return load_spec(tmp_path / "spec.yaml")

    return one


def against(contact, frame):
    contact.against = frame
    return contact


def palms(bound=False):
    made = {name: against(AxesContact(frame, VELOCITY_AXES), "box") for name, frame in PALMS.items()}
    for contact in made.values() if bound else ():
        contact.pushes = Sole(DOWN, (0.08, 0.08), 0.6)
    return made


def carrying(robot, q):
    state = robot.state(q, np.zeros(robot.nv))
    goal = state.frame("box").T * pin.SE3(pin.exp3(np.array([0.1, 0.0, -0.2])), np.array([0.01, -0.02, 0.015]))
    return {
        "carry": MotionTask("box", Hold(goal), 100.0, 20.0),
        "posture": WholeBodyPosture(q, 20.0, 9.0, robot.nu),
    }


def at_random(robot, rng, speed=1.0, size=0.3):
    q = pin.integrate(robot.model, robot.keyframes["home"], rng.uniform(-size, size, robot.nv))
    return q, rng.uniform(-speed, speed, robot.nv)


# --- the robot ---


class TestRobot:
    def test_both_arms_are_the_panda(self, dual, bare_panda):
        one, two = bare_panda.mujoco, dual.mujoco
        for side in ("left", "right"):
            for i in range(8):
                here, there = one.body(f"link{i}"), two.body(f"{side}_link{i}")
                for number in ("mass", "inertia", "ipos", "iquat", *(("pos", "quat") if i else ())):
                    np.testing.assert_array_equal(getattr(here, number), getattr(there, number), err_msg=number)
            for i in range(1, 8):
                here, there = one.joint(f"joint{i}"), two.joint(f"{side}_joint{i}")
                for number in ("axis", "pos", "range"):
                    np.testing.assert_array_equal(getattr(here, number), getattr(there, number))
                for k, all_of in ((one, here.dofadr), (two, there.dofadr)):
                    assert k.dof_armature[all_of] == 0.1
        for limit in ("tau_min", "tau_max", "q_min", "q_max", "v_max"):
            np.testing.assert_array_equal(getattr(dual, limit), np.tile(getattr(bare_panda, limit), 2))

    def test_the_box_is_the_base_and_what_is_carried(self, dual):
        state = dual.state(dual.keyframes["home"], np.zeros(20))
        assert (dual.base, dual.nu, dual.floats) == (6, 14, False)
        assert load(state) == pytest.approx(2.0)
        assert mass(state) > 30.0

    def test_a_walker_floats_whole(self, g1):
        assert g1.floats
        state = g1.state(g1.keyframes["home"], np.zeros(35))
        assert load(state) == pytest.approx(mass(state), rel=1e-12)

    def test_home_has_the_palms_on_the_faces(self, dual):
        state = dual.state(dual.keyframes["home"], np.zeros(20))
        for side in ("left", "right"):
            T = seen(state, f"{side}_palm", f"{side}_face").T
            np.testing.assert_allclose(T.homogeneous, np.eye(4), atol=1e-5)

    def test_pads_touch_the_box_and_nothing_else(self, dual):
        mj = dual.mujoco
        pads = [g for g in range(mj.ngeom) if mj.geom_contype[g] == 1]
        assert len(pads) == 8
        assert not any(mj.geom_contype[a] & mj.geom_conaffinity[b] for a in pads for b in pads)
        crate = int(mj.body("box").geomadr[0])
        assert all(mj.geom_contype[pad] & mj.geom_conaffinity[crate] for pad in pads)

    def test_a_free_body_that_is_not_the_first_is_told(self, tmp_path):
        text = (shipped_folder("scenes/robots") / "panda.xml").read_text().split("<keyframe>")[0]
        loose = '<body name="ball" pos="1 0 0"><freejoint name="ball"/><geom type="sphere" size="0.1" mass="1"/></body>'
        (tmp_path / "arm.xml").write_text(text.replace("</worldbody>", f"{loose}</worldbody>") + "</mujoco>")
        with pytest.raises(ModelError, match=r"joint 'ball' leaves a body free .* expected one free body, which comes"):
            Robot.load(str(tmp_path / "arm.xml"))

    @pytest.mark.parametrize("what", ["com", "momentum"])
    def test_what_stands_on_the_world_is_no_part_of_the_base(self, dual, what):
        """The centre of mass of all that moves, by finite differences: the box's own equations do not tell it."""
        task = ComTask(Hold(TILTED), 40.0, 12.0) if what == "com" else MomentumTask(5.0)
        check_task(task, dual, states=4)
        state = dual.state(dual.keyframes["home"], np.ones(20))
        value, J, _ = com(state) if what == "com" else momentum(state)
        np.testing.assert_allclose((J @ state.v)[-3:] * (mass(state) if what == "com" else 1.0), momentum(state)[0][3:])
        assert np.isfinite(value).all()


# --- what a contact says ---

MADE = {
    "palm": lambda: against(AxesContact("left_palm", VELOCITY_AXES), "box"),
    "some axes": lambda: against(AxesContact("right_palm", ("wy", "vx", "vz")), "left_face"),
    "axes of the other": lambda: against(WorldAxesContact("left_palm", ("vy", "vz"), TILTED.rotation), "box"),
    "matrix": lambda: against(MatrixContact("left_palm", np.eye(6)[[1, 5]] + 0.3), "right_palm"),
    "hinge": lambda: against(ScrewContact("left_palm", np.eye(6)[[2]], TILTED), "box"),
    "sphere": lambda: against(SphereContact("right_palm", np.array([0.5, 0.4, 0.3])), "box"),
    "ball": lambda: against(RoundFoot("left_palm", TILTED.rotation, 0.05), "box"),
}


@pytest.mark.parametrize("kind", MADE)
def test_contacts_by_finite_differences(dual, kind):
    check_contact(MADE[kind](), dual, states=6)


def test_two_hands_and_two_links(g1, bare_panda):
    check_contact(against(AxesContact("left_palm", ("vx", "vy", "vz")), "right_palm"), g1, states=3)
    check_contact(against(AxesContact("flange", ("wx", "vz")), "link2"), bare_panda, states=3)


def test_a_wrong_drift_is_seen(dual):
    """What the finite differences are worth: without ad_V (Ad V_to) they fail."""

    class Wrong(AxesContact):
        def hold(self, state):
            held = super().hold(state)
            held.rhs += 1e-3 * state.frame("box").V[0]
            return held

    with pytest.raises(AssertionError, match="rhs of hold"):
        check_contact(against(Wrong("left_palm", VELOCITY_AXES), "box"), dual, states=3)


def test_motion_along_what_a_contact_leaves_free_is_that_against_the_body(dual):
    """A palm that slides on the box: its reference is told in the axes of the box, whatever the box does."""
    slides = against(AxesContact("left_palm", ("wx", "wy", "wz", "vz")), "box")
    path = Path(TILTED, {3: sine(0.1, 2), 4: sine(0.05, 1)})
    task = MotionTask("left_palm", path, 100.0, 20.0, slides.free_axes, "left")
    check_task(task, dual, {"left": slides}, states=4)
    state = dual.state(dual.keyframes["home"], np.zeros(20), t=0.3)
    state.contacts["left"] = slides.hold(state)
    here = seen(state, "left_palm", "box").T
    np.testing.assert_allclose(task.along(state), pin.log6(here.actInv(path(0.3).T)).linear[:2], atol=1e-12)


def test_the_wrench_acts_on_both_bodies(dual, rng):
    """Virtual power: what a wrench does to the joints is what it does to the motion of one body against the other."""
    q, v = at_random(dual, rng)
    state = dual.state(q, v)
    held = palms()["left"].hold(state)
    F = rng.normal(size=6)
    a, b = state.frame("left_palm"), state.frame("box")
    X = a.T.inverse() * b.T
    on_box = np.r_[X.rotation.T @ (F[:3] - np.cross(X.translation, F[3:])), X.rotation.T @ F[3:]]
    np.testing.assert_allclose(held.push.T @ (held.inverse @ F), a.J.T @ F - b.J.T @ on_box, atol=1e-12)


# --- the oracle of a tick ---


def closed_loop(robot):
    """(contacts, tasks) of a box between palms, or of a humanoid that has its hands together."""
    q = robot.keyframes["home"]
    if robot.name == "panda_dual":
        return palms(), carrying(robot, q)
    contacts = {name: AxesContact(f"{name}_sole", VELOCITY_AXES) for name in ("left", "right")}
    contacts["clasp"] = against(AxesContact("left_palm", ("vx", "vy", "vz")), "right_palm")
    pelvis = robot.state(q, np.zeros(robot.nv)).frame("pelvis").T
    tasks = {
        "pelvis": MotionTask("pelvis", Hold(pelvis), 100.0, 20.0),
        "posture": WholeBodyPosture(q, 20.0, 9.0, robot.nu),
    }
    return contacts, tasks


@pytest.fixture(params=["dual", "g1"])
def loop(request):
    """A robot and its controller without limits."""
    robot = request.getfixturevalue(request.param)
    controller = Controller(robot, *closed_loop(robot), FREE, q=robot.keyframes["home"])
    return robot, controller


class TestOracle:
    def test_mujoco_accelerates_as_predicted(self, loop, rng):
        """Contacts off, every predicted wrench applied from outside to both of its bodies, at random velocities."""
        robot, controller = loop
        mj, data = unconstrained(robot)
        for _ in range(10):
            q, v = at_random(robot, rng)
            out, _ = first_tick(controller, q, v)
            assert out.status is Status.OK, out.reason
            vdot = accelerated(mj, data, controller, out, q, v)
            np.testing.assert_allclose(vdot, out.vdot, atol=1e-9 * (1.0 + np.abs(vdot).max()))

    def test_vdot_and_lambda_are_pinocchios_constrained_dynamics(self, dual, rng):
        """Of the torque that is sent, Pinocchio's own solver of rigid loops finds the same, with the palms at rest on
        the box while all of it moves."""
        q = dual.keyframes["home"]
        controller = Controller(dual, palms(), carrying(dual, q), FREE, q=q)
        dynamics = constrained(dual, pin.ContactType.CONTACT_6D, PALMS, on="box", iterations=20)
        for _ in range(10):
            state = dual.state(q, np.zeros(20))
            G = np.concatenate([contact.hold(state).G for contact in palms().values()])
            v = np.linalg.svd(G)[2][12:].T @ rng.uniform(-1.0, 1.0, 8)  # the palms stay where they are on the box
            out, _ = first_tick(controller, q, v)
            vdot, wrenches = dynamics(q, v, np.r_[np.zeros(6), out.tau])
            np.testing.assert_allclose(out.vdot, vdot, atol=1e-9 * (1.0 + np.abs(vdot).max()))
            for name, F in wrenches.items():
                np.testing.assert_allclose(out.wrenches[name], F, atol=1e-9 * (1.0 + np.abs(F).max()))

    def test_equations_of_motion_and_constraint_at_any_velocity(self, loop, rng):
        """M vdot + h + J' F = S' tau of both bodies, and the second derivative of the pose of one against the other."""
        robot, controller = loop
        for _ in range(5):
            q, v = at_random(robot, rng)
            out, state = first_tick(controller, q, v)
            left = state.M @ out.vdot + state.h
            for name, F in out.wrenches.items():
                held = state.contacts[name]
                left = left + held.seen.J.T @ F
                bar = 1e-9 * (1.0 + np.abs(held.G).sum(axis=1).max() * np.abs(out.vdot).max())
                np.testing.assert_allclose(held.G @ out.vdot, held.rhs, atol=bar)
            np.testing.assert_allclose(left, np.r_[np.zeros(6), out.tau], atol=1e-9 * (1.0 + np.abs(left).max()))


class TestFixedBase:
    """Links of one arm held against one another: the program is the book's closed form in their relative motion."""

    @pytest.mark.parametrize("law", ["compensated", "book"])
    @pytest.mark.parametrize("feedforward", ["none", "measured", "modelled"])
    def test_the_program_is_the_closed_form(self, bare_panda, draw, rng, law, feedforward):
        robot, contact = bare_panda, against(AxesContact("flange", ("vz",)), "link1")
        contact.feedforward = feedforward
        if feedforward == "modelled":
            home = robot.state(robot.keyframes["home"], np.zeros(7))
            contact.pushes = unilateral(contact, home, DOWN, mu=0.2, slip=0.1).lifted()
        path = Path(TILTED, {3: sine(0.1, 2), 4: sine(0.05, 1)})
        tasks = {
            "press": ForceTask("board", contact, np.array([-5.0]), 0.3, 10.0, 50.0, 50.0, law=law),
            "draw": MotionTask("flange", path, 100.0, 20.0, contact.free_axes, "board", law, singular=0.0),
            "posture": PostureTask(robot.keyframes["home"]),
        }
        ctl = Controller(robot, {"board": contact}, tasks, FREE)
        for _ in range(6):
            state = draw(robot, t=0.7)
            step = closed_form_step(ctl, "flange", state, rng, law)
            assert relative(step.out.tau, step.tau) <= 1e-9
            assert relative(step.out.vdot, step.vdot) <= 1e-8
            assert relative(step.out.wrenches["board"], step.F) <= 1e-8

    @pytest.mark.parametrize("solver", ["daqp", "proxqp"])
    def test_verify_holds_for_a_spec(self, tmp_path, solver):
        """Both laws, and once more with M, h and the relative J and drift from MuJoCo alone."""
        (tmp_path / "links.yaml").write_text(LINKS)
        found = verify(load_spec(tmp_path / "links.yaml"), solver, states=20)
        assert found.ok, found
        assert found.states >= 14
        assert set(found.laws) == {"compensated", "book"}
        assert 0.0 < found.max_tau_error_mujoco <= 10 * TAU_ERROR[solver]


LINKS = """
title: Links of one arm held against one another
robot: panda
rate: 1000
duration: 0.01
contacts:
  strut: {frame: flange, with: link1, holds: [wx, wy, vz], artificial: {vx: 0.01, wrench: {mx: 0, my: 0, fz: -5}}}
tasks:
  press:   {type: force,  contact: strut, kp: 0.3, ki: 10, damping: [5, 5, 500], filter: 50}
  draw:    {type: motion, contact: strut, kp: 100, kd: 20}
  posture: {type: posture, target: start, kp: 50, kd: 10}
limits: {torque: model, torque_rate: 1000, position: model, velocity: model}
"""


# --- the internal force ---


class TestPress:
    def ready(self, dual, press, rng=None):
        q, v = (dual.keyframes["home"], np.zeros(20)) if rng is None else at_random(dual, rng, size=0.1)
        state = dual.state(q, v)
        state.contacts = {name: contact.hold(state) for name, contact in palms(bound=True).items()}
        return state, DistributionTask(press=press)

    def test_it_is_added_to_what_the_motion_needs(self, dual, rng):
        """Of the multipliers that carry the motion, the nearest to the press: found another way."""
        state, task = self.ready(dual, {"left": 30.0, "right": 30.0}, rng)
        rows, held = task.rows(state), list(state.contacts.values())
        vdot = rng.normal(size=20)
        P = np.concatenate([each.push[:, :6] for each in held]).T
        w = -(state.M[:6] @ vdot + state.bias[:6])
        scale = np.repeat((0.05, 1.0), 3)
        scale = np.concatenate([scale, scale])
        wanted = np.zeros(12)
        wanted[[5, 11]] = -30.0
        wanted = wanted + np.linalg.lstsq(P * scale, w - P @ wanted, rcond=1e-12)[0] * scale
        np.testing.assert_allclose(rows.lo - rows.A["vdot"] @ vdot, wanted, atol=1e-9 * (1.0 + np.abs(wanted).max()))

    def test_the_internal_force_is_that_which_moves_nothing(self, dual, rng):
        state, task = self.ready(dual, {"left": 30.0, "right": 30.0})
        carried = {name: rng.normal(size=6) for name in PALMS}
        asked, _ = task.internal(state, carried)
        assert asked == pytest.approx(30.0, rel=1e-3)
        # what carries any motion at all, spread as the task spreads it, has none of it; a squeeze is counted whole
        P = np.concatenate([each.push[:, :6] for each in state.contacts.values()]).T
        scale = np.tile(np.repeat((0.05, 1.0), 3), 2)
        spread = np.linalg.lstsq(P * scale, rng.normal(size=6), rcond=1e-12)[0] * scale
        squeeze = np.zeros(12)
        squeeze[[5, 11]] = -7.0
        for lam, force in ((spread, 0.0), (squeeze, 7.0), (spread + squeeze, 7.0)):
            _, got = task.internal(state, {"left": lam[:6], "right": lam[6:]})
            assert got == pytest.approx(force, rel=1e-3, abs=1e-9)

    def test_pressed_from_one_side_both_share_it(self, dual):
        state, task = self.ready(dual, {"left": 30.0})
        lam = {"left": np.array([0, 0, 0, 0, 0, -15.0]), "right": np.array([0, 0, 0, 0, 0, -15.0])}
        assert task.internal(state, lam) == pytest.approx((15.0, 15.0), rel=1e-3)

    def test_what_cannot_be_squeezed_has_no_internal_force(self, dual):
        state, task = self.ready(dual, {"left": 30.0})
        del state.contacts["right"]
        assert np.isnan(task.internal(state, {"left": np.ones(6)})).all()

    def test_shares_of_a_box_are_what_lifts_it(self, dual):
        """A share of the weight presses upwards on a box, downwards under a foot."""
        state = dual.state(dual.keyframes["home"], np.zeros(20))
        state.contacts = {name: contact.hold(state) for name, contact in palms(bound=True).items()}
        rows = DistributionTask({"left": 0.7, "right": 0.3}).rows(state)
        both = zip(PALMS.values(), rows.lo.reshape(2, 6), strict=True)
        up = [state.frame(frame).T.rotation[2] @ lam[3:] for frame, lam in both]
        assert sum(up) == pytest.approx(2.0 * 9.81, rel=1e-9)
        assert up[0] > up[1] > 0.0


# --- the spec ---


class TestSpec:
    def test_a_palm_is_one_line(self, box):
        contact = box.phases[0].contacts["left"]
        assert (contact.frame, contact.against) == ("left_palm", "box")
        assert isinstance(contact.pushes, Sole)
        assert contact.settling.rate == 20.0
        assert box.phases[0].tasks["squeeze"].press == {"left": 35.0, "right": 35.0}

    def test_the_start_is_closed_onto_the_body(self, written):
        """Palms that begin 2 cm off come onto the faces, wherever the box is."""
        bent = "robot: panda_dual\nstart: {left_joint2: -0.08, right_joint4: -2.3}\n"
        built = build(written(BOX, ("robot: panda_dual\n", bent)))
        state = built.robot.state(built.q, np.zeros(20))
        for side in ("left", "right"):
            T = seen(state, f"{side}_palm", f"{side}_face").T
            np.testing.assert_allclose(T.homogeneous, np.eye(4), atol=1e-8)

    def test_without_a_place_it_is_held_where_it_is(self, written):
        hold = ("with: box, on: left_face,  holds: all, pushes: -z, friction: 0.6, sole: [0.08, 0.08]",
                "with: box, free: {swing: {screw: {axis: x}}}, artificial: {swing: 0}")  # fmt: skip
        unbound = ("  left.cone.max_excess: 1.0e-6     # [N, N m]\n", "")
        built = build(written(BOX, hold, ("{left: 35, right: 35}", "{right: 35}"), unbound))
        state = built.robot.state(built.q, np.zeros(20))
        contact = built.phases[0].contacts["left"]
        here = seen(state, "left_palm", "box").T
        assert isinstance(contact, ScrewContact)
        np.testing.assert_allclose(contact._origin.homogeneous, here.homogeneous, atol=1e-12)
        np.testing.assert_allclose(contact.A(state) @ np.eye(6)[0], 0.0, atol=1e-12)

    def test_the_distance_of_a_palm_is_that_from_the_face(self, written):
        ways = "phases:\n  hold: {until: {left.distance: {min: 0.001}}}\n  stay: {}\nexpect:"
        built = build(written(BOX, ("expect:", ways)))
        (condition,) = built.phases[0].exit.until
        q = built.q.copy()
        for away in (0.0, 0.002):
            q[0] = built.q[0] + away  # the box, off the left palm
            assert condition.read(built.robot.state(q, np.zeros(20))) == pytest.approx(away, abs=1e-9)

    def test_the_schema_says_with(self):
        import json

        schema = json.loads((shipped_folder("tasks") / "schema.json").read_text())
        assert "with" in schema["$defs"]["Contact"]["properties"]


LEFT = "with: box, on: left_face, "
FAULTS = {
    "no such frame": (LEFT, "with: bxo, ", "no frame named 'bxo'; did you mean 'box'"),
    "itself": (LEFT, "with: left_palm, ", "'left_palm' is the frame itself; expected one of another body"),
    "the same link": (LEFT, "with: left_link7, ", "on one link; expected a frame that moves against it"),
    "the world": (LEFT, "with: left_link0, ", "'left_link0' is fixed to the world; expected a frame that moves, or"),
    "another body's place": (LEFT, "with: box, on: right_palm, ", "'right_palm' is not on the link of 'box'; expected"),
    "the ground": (LEFT, "with: box, ground: floor, ", "a body holds it, not the ground; expected either"),
    "a moving place": (LEFT, "on: left_face, ", "frame 'left_face' moves with joint 'box_joint'; expected one fixed"),
    "an impedance": (
        "  posture:", "  soft: {type: impedance, contact: left, M: 0, B: 10, K: 100}\n  posture:",
        "contact 'left' is with another body, .* expected a motion task, or a contact with the world",
    ),
    "press of none": ("left: 35", "leftt: 35", "no contact named 'leftt'; did you mean 'left'"),
    "press of what holds": (
        "holds: all, pushes: -z, friction: 0.6, sole: [0.08, 0.08]}   # [m]", "holds: all}",
        "contact 'left' does not push; expected `pushes: -z` in it",
    ),
    "press of what is forced": (
        "  posture:", "  press: {type: force, contact: left}\n  posture:",
        "contact 'left' has a force task, which says how it presses; expected one of the two",
    ),
}  # fmt: skip


@pytest.mark.parametrize("what", FAULTS)
def test_faults_have_a_place_and_a_remedy(written, what):
    old, new, message = FAULTS[what]
    more = ()
    if what == "press of what is forced":
        more = (("sole: [0.08, 0.08]}   # [m]", "sole: [0.08, 0.08], artificial: {wrench: {fz: -35}}}"),)
    with pytest.raises(SpecError, match=message) as caught:
        build(written(BOX, (old, new), *more))
    assert all(fault.line and fault.column for fault in caught.value.faults)


class TestCarried:
    def test_a_box_that_nothing_holds_falls_and_is_told(self, written):
        nobody = "phases:\n  reach: {contacts: [], tasks: [posture], until: {time: 1}}\n  carry: {}\nexpect:"
        report = check(written(BOX, ("expect:", nobody)))
        assert not report.feasible
        assert "nothing carries 'box', so it falls; expected a contact" in report.reason

    def test_a_box_that_one_palm_pushes_falls_and_is_told(self, written):
        alone = "phases:\n  push: {contacts: [left], tasks: [carry, posture], until: {time: 1}}\n  carry: {}\nexpect:"
        report = check(written(BOX, ("expect:", alone)))
        assert not report.feasible
        assert "% of gravity, for left cannot carry it; expected more contacts" in report.reason

    def test_what_is_carried_is_feasible(self):
        assert check(load_spec("panda_dual_box")).feasible


# --- in the simulator ---


class TestRun:
    def test_the_internal_force_follows_what_is_asked(self, written):
        softer = ("{left: 35, right: 35}", "{left: 30, right: 30}")
        finished = run(build(written(BOX, softer, ("duration: 10", "duration: 0.6"))))
        log, figures = finished.log, finished.summary["metrics"]
        assert figures["squeeze.internal.max_error"] <= 0.02
        push = [-log[f"{name}.true"][-1, 5] for name in PALMS]
        assert np.mean(push) == pytest.approx(30.0, abs=0.02)
        assert figures["left.slip"] <= 5e-4

    def test_a_heavier_box_shows(self, written):
        """What only the plant knows: the box sinks, and the palms carry more than was predicted."""
        load = ("expect:", "plant: {payload: 0.2, payload_at: box}\nexpect:")
        finished = run(build(written(BOX, load, ("duration: 10", "duration: 0.6"))))
        assert finished.summary["metrics"]["carry.position.max_error"] > 1e-3
        assert finished.summary["metrics"]["left.motion.error"] > 0.01

    def test_hands_together_are_a_closed_loop(self, tmp_path):
        """A humanoid whose palms are joined, as by a handshake, pulls them apart with 10 N while it stands: the loop
        carries what was asked for, and nobody moves."""
        folder = shipped_folder("scenes")
        joint = '<equality><connect site1="left_palm" site2="right_palm" solref="0.005 1"/></equality>'
        text = (folder / "floor.xml").read_text().replace("</worldbody>", f"</worldbody>{joint}")
        (tmp_path / "clasped.xml").write_text(text)
        hands = "{frame: left_palm, with: right_palm, on: right_palm, holds: [vx, vy, vz], artificial: {wrench: {fx: 10, fz: 5}}}"  # noqa: E501
        text = (shipped_folder("tasks") / "g1_stand.yaml").read_text().split("expect:")[0]
        text = text.replace("scene: floor", "scene: clasped.xml").replace("duration: 10", "duration: 0.5")
        text = text.replace("tasks:\n", f"  hands: {hands}\ntasks:\n  pull: {{type: force, contact: hands}}\n")
        (tmp_path / "clasp.yaml").write_text(text + "expect: {settle: 0.4, hands.fx.max_error: 0.01}\n")
        built = build(load_spec(tmp_path / "clasp.yaml"))
        state = built.robot.state(built.q, np.zeros(35))
        np.testing.assert_allclose(seen(state, "left_palm", "right_palm").p, 0.0, atol=1e-9)
        finished = run(built)
        assert finished.ok, finished.summary["checks"]
        assert finished.summary["metrics"]["hands.motion.error"] < 1e-4
        np.testing.assert_allclose(finished.log["hands.true"][-1], [0, 0, 0, 10, 0, 5], atol=0.01)
