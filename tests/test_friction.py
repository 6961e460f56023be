"""Contacts that only push: cones, cut targets, drag in the model, against closed forms, plant and simulator."""

from __future__ import annotations

import bars
import numpy as np
import pinocchio as pin
import pytest
from oracles import closed_form_step
from runs import result

from wbc import analytic, quantity
from wbc.build import build
from wbc.contact.axes import AxesContact, MatrixContact, WorldAxesContact
from wbc.contact.screw import ScrewContact
from wbc.contact.sphere import SphereContact
from wbc.controller import Controller
from wbc.dynamics import reaction
from wbc.errors import SpecError, WrenchError
from wbc.friction import unilateral
from wbc.ladder import Status
from wbc.oracle import relative
from wbc.reference import Path, hold, sine
from wbc.resources import shipped_folder
from wbc.spec import load
from wbc.task.force import ForceTask
from wbc.task.motion import MotionTask
from wbc.task.posture import PostureTask

DOWN = np.array([0.0, 0.0, -1.0])
NO_LIMITS = dict.fromkeys(("torque", "torque_rate", "position", "velocity"))
TURN = np.linalg.qr(np.random.default_rng(5).normal(size=(3, 3)))[0] * np.array([1, 1, 1.0])


@pytest.fixture(scope="module")
def stick():
    """chalk_stick without its torque rate, at its start."""
    built = build(load("chalk_stick", ["limits.torque_rate=1e9"]))
    return built


def pushing(contact, robot, feedforward="none", **options):
    contact.feedforward = feedforward
    contact.pushes = unilateral(contact, robot.state(robot.keyframes["home"], np.zeros(robot.nv)), DOWN, **options)
    return contact


# --- what a contact that pushes is ---


class TestUnilateral:
    @pytest.mark.parametrize(
        ("held", "sticks", "slides"),
        [(("vz",), 0, 2), (("wx", "wy", "vz"), 0, 2), (("vy", "vz"), 1, 1), (("vx", "vy", "vz"), 2, 0)],
    )
    def test_it_tells_what_sticks_from_what_slides(self, panda, held, sticks, slides):
        pushes = pushing(AxesContact("eraser", held), panda, mu=0.5).pushes
        assert (len(pushes.held), len(pushes.slides)) == (sticks, slides)
        assert pushes.faces == {0: 0, 1: 2, 2: 8}[sticks]
        np.testing.assert_allclose(np.concatenate((pushes.held, pushes.slides)) @ DOWN, 0)

    def test_the_rows_are_the_push_and_the_inner_cone_of_the_wrench(self, panda, draw, rng):
        contacts = [
            AxesContact("eraser", ("vx", "vy", "vz")),
            MatrixContact("eraser", np.diag([0, 0, 1, 1, 2, 3.0])[2:]),
            WorldAxesContact("eraser", ("vx", "vy", "vz"), TURN),
        ]
        for contact in contacts:
            pushing(contact, panda, mu=0.5, faces=6, least=2.0)
            state = draw(panda)
            held, R = contact.hold(state), np.eye(3)
            if isinstance(contact, WorldAxesContact):
                R = TURN.T @ state.frame("eraser").T.rotation
            for _ in range(20):
                lam = 5 * rng.normal(size=contact.k)
                f = R @ (held.A.T @ lam)[3:]  # in the axes in which the contact is given
                np.testing.assert_allclose(held.cone.rows[0] @ lam, -f[2], atol=1e-12)
                faces = analytic.inner_cone(0.5, 6) @ [f[0], f[1], -f[2]]
                np.testing.assert_allclose(held.cone.rows[1:] @ lam, -faces, atol=1e-12)
            np.testing.assert_array_equal(held.cone.least, [2.0, *np.zeros(6)])

    @pytest.mark.parametrize(
        ("contact", "directions"),
        [
            (AxesContact("eraser", ("vx", "vy", "vz")), lambda R: R[:, :2].T),
            (AxesContact("eraser", ("vy", "vz")), lambda R: R[:, 1:2].T),
            (WorldAxesContact("eraser", ("vx", "vz"), TURN), lambda R: TURN[:, :1].T),
        ],
        ids=["both ways", "one way", "the world's way"],
    )
    def test_a_slip_is_the_speed_along_what_it_holds(self, panda, draw, contact, directions):
        """Against the frame's places a moment before and after."""
        read, dt = quantity.slip(pushing(contact, panda, mu=0.5)), 1e-6
        for _ in range(5):
            state = draw(panda)
            there, here = (
                panda.state(pin.integrate(panda.model, state.q, s * dt * state.v), state.v)
                .frame("eraser")
                .T.translation
                for s in (0.5, -0.5)
            )
            R = state.frame("eraser").T.rotation
            assert read(state) == pytest.approx(np.linalg.norm(directions(R) @ (there - here)) / dt, rel=1e-6)

    def test_without_friction_that_holds_nothing_slips(self, panda):
        assert quantity.slip(AxesContact("eraser", ("vx", "vy", "vz"))) is None
        assert quantity.slip(pushing(AxesContact("eraser", ("vx", "vy", "vz")), panda)) is None
        assert quantity.slip(pushing(AxesContact("eraser", ("vz",)), panda, mu=0.5)) is None

    def test_on_a_sphere_z_is_the_normal(self, panda, draw):
        contact = SphereContact("eraser", np.array([0.2, 0.3, 0.3]))
        contact.pushes = unilateral(contact, draw(panda), DOWN, mu=0.3)
        state = draw(panda)
        np.testing.assert_allclose(contact.hold(state).cone.rows, [[-1.0]], atol=1e-12)
        np.testing.assert_allclose(contact.turn(state).T @ contact.turn(state), np.eye(3), atol=1e-12)

    def test_a_direction_that_is_not_held_is_refused(self, panda):
        with pytest.raises(WrenchError, match="holds no force along this direction; expected one that it holds"):
            pushing(AxesContact("eraser", ("wx", "vy")), panda)

    def test_modelled_friction_needs_something_that_slides(self, panda):
        with pytest.raises(WrenchError, match="the contact holds every direction across"):
            pushing(AxesContact("eraser", ("vx", "vy", "vz")), panda, "modelled", mu=0.3)

    def test_friction_that_cannot_be_solved_for_is_refused_with_its_bound(self, panda):
        contact, state = AxesContact("eraser", ("wx", "wy", "vz")), panda.state(panda.keyframes["home"], np.zeros(7))
        J = state.frame("eraser").J
        across = np.eye(3)[:2]
        critical = analytic.critical_friction(contact.A(state), J @ np.linalg.solve(state.M, J.T), DOWN, across)
        assert 0.3 < critical < 10
        pushing(AxesContact("eraser", ("wx", "wy", "vz")), panda, "modelled", mu=0.999 * critical)
        with pytest.raises(WrenchError, match=f"is singular at {critical:.3g} in the start pose; expected less"):
            pushing(AxesContact("eraser", ("wx", "wy", "vz")), panda, "modelled", mu=1.001 * critical)

    def test_without_its_cone_it_is_the_same_contact(self, panda, draw):
        contact, state = pushing(AxesContact("eraser", ("wx", "wy", "vz")), panda, "modelled", mu=0.3), draw(panda)
        lifted = contact.without_cone()
        assert lifted.hold(state).cone is None is not contact.hold(state).cone
        np.testing.assert_array_equal(lifted.hold(state).B, contact.hold(state).B)
        plain = AxesContact("eraser", ("vz",))
        assert plain.without_cone() is plain

    def test_the_cut_keeps_the_push_and_the_direction(self, panda, draw, rng):
        contact = pushing(AxesContact("eraser", ("wz", "vx", "vy", "vz")), panda, mu=0.5, least=1.0)
        cone = contact.hold(draw(panda)).cone
        seen = set()
        for _ in range(200):
            lam = 4 * rng.normal(size=4)
            cut, by = cone.cut(lam)
            seen.add(by)
            assert (cone.rows @ cut >= cone.least - 1e-12).all()
            assert cut[0] == lam[0]  # no force
            assert cut[3] == pytest.approx(min(lam[3], -1.0))
            s = np.linalg.norm(cut[1:3]) / np.linalg.norm(lam[1:3])
            np.testing.assert_allclose(cut[1:3], s * lam[1:3], atol=1e-12)
            if by == "friction":
                assert (cone.rows[1:] @ cut).min() == pytest.approx(0, abs=1e-12)  # on the cone, no shorter
            if not by:
                np.testing.assert_array_equal(cut, lam)
        assert seen == {"", "push", "friction"}


# --- the law with friction: against the closed form and the plant ---


def controller(robot, contact, rng, law="compensated", solver="daqp"):
    lam = 5 * rng.normal(size=contact.k)
    home = robot.state(robot.keyframes["home"], np.zeros(robot.nv)).frame("eraser").T
    path = Path(home, {3: sine(0.1, 2), 4: sine(0.05, 1)})
    if contact.pushes is not None:
        contact.pushes.guide = lambda state: path(state.t)
    tasks = {
        "press": (ForceTask("board", contact, lam, 0.3, 10.0, 50.0, 50.0, law=law), float(10 ** rng.uniform(-2, 2))),
        "draw": MotionTask("eraser", path, 100.0, 20.0, contact.free_axes, "board", law, robot.axes("eraser")),
        "posture": (PostureTask(robot.keyframes["home"]), float(10 ** rng.uniform(-2, 1))),
    }
    return Controller(robot, {"board": contact}, tasks, NO_LIMITS, solver)


CONTACTS = {
    "a point": lambda: AxesContact("eraser", ("vz",)),
    "a face": lambda: AxesContact("eraser", ("wx", "wy", "vz")),
    "a wheel": lambda: AxesContact("eraser", ("vy", "vz")),
    "a point of the world": lambda: WorldAxesContact("eraser", ("vz",), TURN),
}


@pytest.mark.parametrize("solver", ["daqp", "proxqp"])
@pytest.mark.parametrize("law", ["compensated", "book"])
@pytest.mark.parametrize("feedforward", ["modelled", "measured"])
@pytest.mark.parametrize("kind", CONTACTS)
def test_the_program_is_the_closed_form_and_the_plant_answers_it(panda, draw, rng, kind, feedforward, law, solver):
    bar = bars.TAU_ERROR[solver]
    contact = pushing(CONTACTS[kind](), panda, feedforward, mu=0.3, slip=0.1).without_cone()
    ctl = controller(panda, contact, rng, law, solver)
    for i in range(6):
        state = draw(panda, t=0.7)
        if i % 2:  # so slow that the drag follows the desired velocity in part
            state = panda.state(state.q, 0.02 * state.v, 0.7)
        step = closed_form_step(ctl, "eraser", state, rng, law)
        out, F = step.out, step.measured
        assert relative(out.tau, step.tau) <= bar
        assert relative(out.vdot, step.vdot) <= 10 * bar
        held, J = contact.hold(state), state.frame("eraser").J
        assert relative(out.wrenches["board"], step.F) <= 10 * bar
        # Coulomb, spelled out: the push drags along the velocity, in the axes of the frame
        known, f = np.zeros(6), out.wrenches["board"][3:]
        R = np.eye(3) if contact.turn(state) is None else contact.turn(state)
        N, across, v = f @ R @ DOWN, contact.pushes.slides @ R.T, state.frame("eraser").V[3:]
        if feedforward == "measured":
            known = F - held.A.T @ np.linalg.lstsq(held.A.T, F)[0]
            known *= min(1.0, 0.3 * max(F[3:] @ R @ DOWN, 0) / np.linalg.norm(across @ known[3:]))
            np.testing.assert_allclose(across @ f, 0, atol=1e-9 * (1 + np.abs(f).max()))
        elif np.linalg.norm(across @ v) > 0.1:
            drag = 0.3 * N * across @ v / np.linalg.norm(across @ v)
            np.testing.assert_allclose(across @ f, drag, atol=1e-6 * (1 + np.abs(f).max()))
        # equations of motion and constraint, whole
        lhs = state.M @ out.vdot + state.h + J.T @ (out.wrenches["board"] + known)
        assert relative(out.tau, lhs) <= 10 * bar
        rate = held.A @ (J @ out.vdot + state.frame("eraser").drift)
        np.testing.assert_allclose(rate, -contact.Adot_V(state), atol=1e-5)


def test_drag_moves_nothing_and_presses_nothing(panda, draw, rng):
    """With friction in the model the acceleration and the multipliers are those without; the control is its torque."""
    seed = int(rng.integers(1 << 30))
    dragging = pushing(AxesContact("eraser", ("wx", "wy", "vz")), panda, "modelled", mu=0.3).without_cone()
    outs, state = [], draw(panda)
    for contact in (dragging, AxesContact("eraser", ("wx", "wy", "vz"))):
        ctl = controller(panda, contact, np.random.default_rng(seed))
        ctl.reset(state.q, state.v)
        outs.append(ctl.step(0.0, state.q, state.v))
    np.testing.assert_allclose(outs[0].vdot, outs[1].vdot, atol=1e-8)
    np.testing.assert_allclose(outs[0].wrenches["board"][[0, 1, 5]], outs[1].wrenches["board"][[0, 1, 5]], atol=1e-9)
    assert np.abs(outs[0].tau - outs[1].tau).max() > 0.1


# --- limits: what only pushes never pulls, what sticks stays in its cone ---


@pytest.mark.parametrize("solver", ["daqp", "proxqp"])
class TestTargets:
    def step(self, stick, solver, **targets):
        ctl = Controller.from_spec(load("chalk_stick", ["limits.torque_rate=1e9", f"solver={solver}"]), stick.robot)
        ctl.reset(stick.q, np.zeros(7))
        return ctl.step(0.0, stick.q, np.zeros(7), targets={f"board.{axis}": value for axis, value in targets.items()})

    def test_inside_the_cone_nothing_is_said(self, stick, solver):
        out = self.step(stick, solver, fx=4.0, fy=4.0)
        assert (out.status, out.active, out.reason) == (Status.OK, (), "")
        np.testing.assert_allclose(out.wrenches["board"][3:], [4, 4, -10], atol=1e-6)

    def test_outside_it_is_cut_to_the_cone_and_fz_stays(self, stick, solver):
        for angle in np.linspace(0, 2 * np.pi, 17):
            asked = 9.0 * np.array([np.cos(angle), np.sin(angle)])
            out = self.step(stick, solver, fx=float(asked[0]), fy=float(asked[1]))
            f = out.wrenches["board"][3:]
            assert out.status is Status.LIMITED
            assert out.active == ("board.friction",)
            assert out.reason == "at the limit: board.friction"
            assert f[2] == pytest.approx(-10, abs=1e-6)
            assert f[:2] @ [-asked[1], asked[0]] == pytest.approx(0, abs=1e-5)
            assert 6.0 * np.cos(np.pi / 16) - 1e-6 <= np.hypot(*f[:2]) <= 6.0 + 1e-6

    def test_it_never_pulls(self, stick, solver):
        out = self.step(stick, solver, fz=5.0, fx=3.0)
        assert out.status is Status.LIMITED
        assert {"board.push", "board.friction"} & set(out.active)
        np.testing.assert_allclose(out.wrenches["board"][3:], 0, atol=1e-6)

    def test_the_rows_hold_where_the_motors_cannot_follow(self, stick, solver, rng):
        weak = load("chalk_stick", ["limits.torque={scale: 0.25}", "limits.torque_rate=1e9", f"solver={solver}"])
        ctl, bound = Controller.from_spec(weak, stick.robot), 0
        cone = analytic.inner_cone(0.6, 16)
        for _ in range(30):
            q, v = stick.q + 0.2 * rng.normal(size=7), 0.5 * rng.normal(size=7)
            ctl.reset(q, v)
            out = ctl.step(0.0, q, v, targets={"board.fz": float(-40 * rng.random()), "board.fx": float(rng.normal())})
            if out.wrenches:
                f = out.wrenches["board"][3:]
                assert (cone @ [f[0], f[1], -f[2]] <= 1e-5).all()
                bound += any(name in out.active for name in ("board.push", "board.friction"))
        assert bound > 0


def test_a_target_that_leaves_the_cone_in_a_run_neither_slips_nor_winds_up():
    # up to 8 N east of the 6 N that the cone holds; right on the cone of the plant it would slip
    sizes = ("references.east.lissajous.size=[16]", "references.north.lissajous.size=[8]")
    finished = result("chalk_stick", *sizes, "contacts.board.friction.mu=0.58")
    log, figures = finished.log, finished.summary["metrics"]
    late = log["t"] > 1
    f = log["board.true"][late, 3:]
    assert (np.hypot(f[:, 0], f[:, 1]) <= 0.6 * -f[:, 2] + 1e-9).all()
    assert figures["board.creep"] <= bars.SPECS["chalk_stick"]["board.creep"]
    assert figures["board.fz.max_error"] <= bars.SPECS["chalk_stick"]["board.fz.max_error"]
    named = np.array(["board.friction" in active for active in log.active])[late]
    outside = np.hypot(*log["board.target"][late, :2].T) > 5.85
    assert 0.1 < outside.mean() < 0.9
    assert named[outside].all()
    limited = log["status"][late] == log.meta["status_names"].index("LIMITED")
    assert limited[named].all()
    well_inside = np.hypot(*log["board.target"][late, :2].T) < 5.5
    error = log["board.lam"][late] - log["board.target"][late]
    assert np.abs(error[well_inside]).max() <= 0.02  # nothing is left of the time outside


def test_what_is_fed_forward_stays_in_the_cone_of_the_measured_push(panda, draw):
    contact, state = pushing(AxesContact("eraser", ("wx", "wy", "vz")), panda, "measured", mu=0.3), draw(panda)
    held = contact.hold(state)
    inside, outside = np.array([0.1, 0, 0.2, 2.0, -1.0, -10]), np.array([0.1, 0, 0.2, 6.0, -8.0, -10])
    np.testing.assert_allclose(contact.known(state, held, inside), [0, 0, 0.2, 2, -1, 0], atol=1e-12)
    np.testing.assert_allclose(contact.known(state, held, outside), 0.3 * np.array([0, 0, 0.2, 6, -8, 0]), atol=1e-12)
    np.testing.assert_array_equal(contact.known(state, held, -inside), 0)  # it does not even push


# --- specs ---


class TestEraser:
    """`eraser_friction`: what compensation is worth."""

    def test_four_corners_stay_in_contact(self):
        assert result("eraser_friction").summary["metrics"]["board.corners"] == bars.CORNERS

    @pytest.mark.parametrize("mu", [0.24, 0.36])
    def test_modelled_friction_that_is_20_percent_wrong(self, mu):
        finished = result("eraser_friction", "contacts.board.feedforward=modelled", f"plant.contact_friction={mu}")
        figures = finished.summary["metrics"]
        assert {name: figures[name] for name, most in bars.WRONG_MU.items() if not figures[name] <= most} == {}
        assert figures["board.corners"] == bars.CORNERS

    def test_without_compensation_it_misses(self):
        free = ("contacts.board.feedforward=none", "tasks.draw.kp=100", "tasks.draw.kd=20", "duration=4")
        assert result("eraser_friction", *free).summary["metrics"]["draw.position.rms_error"] >= bars.UNCOMPENSATED

    def test_under_the_books_law_corners_lift_as_well(self):
        free = ("contacts.board.feedforward=none", "law=book", "duration=3")
        figures = result("eraser_friction", *free).summary["metrics"]
        assert figures["board.corners"] < bars.CORNERS
        assert figures["board.tilt"] > bars.TIPPED
        assert figures["board.fz.rms_error"] > 1.0  # what tips over is let go


def test_the_drag_follows_what_moves_the_contact_in_its_phase(tmp_path):
    text = (shipped_folder("tasks") / "chalk_slide.yaml").read_text()
    phases = "phases:\n  write: {until: {time: 1}}\n  rest: {tasks: [press, posture]}\nlimits:"
    (tmp_path / "phases.yaml").write_text(text.replace("limits:", phases))
    write, rest = build(load(tmp_path / "phases.yaml")).phases
    assert write.contacts["board"].pushes.guide == write.tasks["draw"].followed
    assert rest.contacts["board"].pushes.guide is None


def test_a_run_beyond_what_the_surface_is_for_is_told_so():
    fast = result("chalk_slide", "references.wave.lissajous.period=[4, 0.8]", "duration=2").summary["notes"]
    assert [note for note in fast if "surface board: its simulated contact may hop" in note]
    assert not result("chalk_slide", "duration=2").summary["notes"]


WRONG = {
    "friction without a push": (
        "chalk_slide", "    pushes: -z\n", "",
        "contacts.board.friction: needs the direction of the push; expected `pushes: -z`",
    ),
    "a push along what is free": (
        "chalk_slide", "pushes: -z", "pushes: -x",
        "contacts.board.pushes: vx is free, so nothing is pushed along -x; expected a side that is held: -z",
    ),
    "no direction": ("chalk_slide", "pushes: -z", "pushes: down", "contacts.board.pushes: unknown word 'down'"),
    "a pull": (
        "chalk_slide", "fz: -10", "fz: 10",
        "contacts.board.artificial.fz: 10 N is less than the least push along -z; expected at most -0",
    ),
    "less than the least push": (
        "chalk_slide", "pushes: -z", "pushes: {along: -z, least: 12}",
        "contacts.board.artificial.fz: -10 N is less than the least push along -z; expected at most -12",
    ),
    "a model without its number": (
        "chalk_slide", "    friction: 0.3\n", "",
        "contacts.board.feedforward: modelled friction needs its coefficient; expected `friction: MU` beside it",
    ),
    "a model of what sticks": (
        "chalk_stick", "    pushes: -z\n", "    pushes: -z\n    feedforward: modelled\n",
        "contacts.board.feedforward: modelled friction is that of sliding, but nothing slides",
    ),
    "a flat cone": ("chalk_stick", "faces: 16", "faces: 2", "board.friction.faces: expected a number of at least 3"),
    "friction beyond what can be solved": (
        "chalk_slide", "friction: 0.3", "friction: 30", "contacts.board.friction: friction of 30 cannot be solved for",
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", WRONG)
def test_what_is_wrong_is_told_in_its_place(name, tmp_path):
    from wbc.resources import shipped_folder

    spec, old, new, message = WRONG[name]
    text = (shipped_folder("tasks") / f"{spec}.yaml").read_text()
    assert text.count(old) == 1
    file = tmp_path / "wrong.yaml"
    file.write_text(text.replace(old, new))
    with pytest.raises(SpecError) as caught:
        build(load(file))
    assert [fault for fault in caught.value.faults if message in str(fault) and fault.line and fault.column], (
        caught.value
    )


def test_screws_push_along_the_axes_of_their_frame(panda, draw):
    contact = ScrewContact("eraser", np.eye(6)[[2, 3, 4]], hold(panda.fixed_pose("board"))(0.0).T)
    contact.pushes = unilateral(contact, draw(panda), DOWN)
    held = contact.hold(draw(panda))
    lam = np.array([1.0, -2.0, 3.0])
    np.testing.assert_allclose(held.cone.rows @ lam, [-(held.A.T @ lam)[5]], atol=1e-12)


def test_the_first_multiplier_of_a_contact_that_drags_is_that_of_the_plant(panda, draw, rng):
    """A torque is answered by B lambda: what the controller takes over from the last torque knows the drag."""
    contact, state = pushing(AxesContact("eraser", ("wx", "wy", "vz")), panda, "modelled", mu=0.3), draw(panda)
    held = state.contacts["board"] = contact.hold(state)
    tau = 10 * rng.normal(size=7)
    J, n = state.frame("eraser").J, 7
    KKT = np.block([[state.M, J.T @ held.B.T], [held.A @ J, np.zeros((3, 3))]])
    lam = np.linalg.solve(KKT, np.r_[tau - state.h, held.rhs])[n:]
    np.testing.assert_allclose(reaction(state, tau)["board"], lam, atol=1e-9)
