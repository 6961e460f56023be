"""What a phase leaves to the next: references taken up without a jump, force loops that begin at the last torque."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest

from tests.test_reference import OFFSET, TILTED, check, scalars
from wbc.contact.axes import AxesContact
from wbc.contact.screw import ScrewContact
from wbc.dynamics import reaction
from wbc.handover import FADE, FADE_SPEED, FADE_TURN, Start, hand_over, take_up
from wbc.limit import make_limits
from wbc.phase import Phase, hold
from wbc.program import Program
from wbc.reference import Path, constant, ramp
from wbc.reference import hold as stay
from wbc.task.force import ForceLoop, ForceTask
from wbc.task.motion import MotionTask
from wbc.task.posture import PostureTask

LAWS = ["compensated", "book"]


def pose(rng, size=0.05):
    return pin.exp6(pin.Motion(size * rng.normal(size=3), 3 * size * rng.normal(size=3)))


class TestStart:
    def test_what_is_followed_differentiates_to_its_twist(self, rng):
        reference = Path(TILTED, dict(enumerate(scalars(rng, 6))), OFFSET)
        for shift, offset in ((None, None), (pose(rng), pose(rng))):
            start = Start(0.5, shift, offset, rng.normal(size=(2, 6)), 2.0)
            check(lambda t, start=start: start.sample(reference, t), np.linspace(0.6, 2.4, 19), 1e-7)

    def test_it_begins_where_the_frame_is_and_as_it_moves(self, rng):
        reference = Path(TILTED, dict(enumerate(scalars(rng, 6))))
        for _ in range(10):
            T, V = reference(0.0).T * pose(rng), rng.normal(size=6)
            start = take_up(reference, 3.0, T, V)
            sample = start.sample(reference, 3.0)
            np.testing.assert_allclose(sample.T.homogeneous, T.homogeneous, atol=1e-12)
            np.testing.assert_allclose(sample.V, V, atol=1e-12)

    def test_it_ends_in_the_reference_itself_without_a_jump(self, rng):
        reference = Path(TILTED, dict(enumerate(scalars(rng, 6))))
        start = take_up(reference, 0.0, reference(0.0).T * pose(rng), rng.normal(size=6))
        before, after = (start.sample(reference, start.fade + s) for s in (-1e-6, 0.0))
        assert after.T == reference(start.fade).T
        np.testing.assert_allclose(before.T.homogeneous, after.T.homogeneous, atol=1e-5)
        np.testing.assert_allclose(before.motion, after.motion, atol=1e-3)

    def test_nothing_to_fade_costs_nothing(self):
        reference = stay(TILTED)
        start = take_up(reference, 3.0, TILTED, np.zeros(6))
        assert start == Start(3.0)
        assert start.sample(reference, 3.0) is reference(0.0)

    @pytest.mark.parametrize(("away", "turn"), [(0.02, 0.0), (0.5, 0.0), (0.0, 0.1), (0.0, 2.0), (0.3, 1.0)])
    def test_what_is_far_away_is_led_in_no_faster_than_it_should(self, away, turn):
        reference = stay(TILTED)
        gap = pin.exp6(pin.Motion(np.array([away, 0, 0]), np.array([turn, 0, 0])))
        start = take_up(reference, 0.0, TILTED * gap, np.zeros(6))
        twists = np.array([start.sample(reference, t).V for t in np.linspace(0, start.fade, 2001)])
        speed, rate = (np.linalg.norm(part, axis=1).max() for part in (twists[:, 3:], twists[:, :3]))
        assert start.fade >= FADE
        assert speed <= FADE_SPEED * 1.0001
        assert rate <= FADE_TURN * 1.0001
        if start.fade > FADE:  # no slower than that either
            assert max(speed / FADE_SPEED, rate / FADE_TURN) == pytest.approx(1.0, rel=1e-4)

    def test_a_relative_reference_goes_out_from_the_frame_along_its_axes_for_good(self, rng):
        reference = Path(TILTED, {3: ramp(0.1), 5: ramp(0.2)}, relative=True)
        T = pose(rng, 1.0)
        start = take_up(reference, 1.0, T, np.zeros(6))
        for t in (0.0, 2.0, 9.0):
            led = T * pin.SE3(np.eye(3), np.array([0.1 * t, 0.0, 0.2 * t]))
            sample = start.sample(reference, 1.0 + t)
            if t > start.fade:  # what was to fade is the speed alone
                np.testing.assert_allclose(sample.T.homogeneous, led.homogeneous, atol=1e-12)
        assert start.fade == FADE

    def test_axes_without_a_place_of_their_own_keep_the_one_they_find(self, rng):
        """A contact's table: x follows what is drawn, y only moves on, rotations stay."""
        along = {axis: constant(0.0) for axis in range(3)} | {3: constant(0.03), 4: ramp(0.1)}
        reference = Path(TILTED, along, placed=frozenset({3}))
        T = reference(0.0).T * pin.SE3(pin.exp3(0.3 * rng.normal(size=3)), np.array([0.02, -0.05, 0.001]))
        start = take_up(reference, 1.0, T, np.zeros(6))
        for t in (0.0, 5.0):
            sample = start.sample(reference, 1.0 + t)
            seen = TILTED.actInv(sample.T)
            np.testing.assert_allclose(sample.T.rotation, T.rotation, atol=1e-12)
            np.testing.assert_allclose(seen.translation[1:], [-0.05 + 0.1 * t, 0.001], atol=1e-12)
            np.testing.assert_allclose(seen.translation[0], 0.05 if t == 0.0 else 0.03, atol=1e-12)
        check(lambda t: start.sample(reference, t), np.linspace(1.05, 2.0, 9), 1e-7)


# --- forces ---

PLACES = {
    "one axis": {"a": AxesContact("eraser", ("vz",))},
    "a face": {"a": AxesContact("eraser", ("wx", "wy", "vz"))},
    "two frames": {"a": AxesContact("eraser", ("vz",)), "b": AxesContact("link4", ("vx",))},
    "a hinge": {"a": ScrewContact("eraser", np.array([[0, 0, 1, 0, 0.2, 0]]), pin.SE3.Identity())},
    "nothing": {},
}


@pytest.mark.parametrize("contacts", PLACES.values(), ids=PLACES)
def test_reaction_is_what_rigid_contacts_answer_to_a_torque(contacts, panda, draw, rng):
    state = draw(panda)
    state.contacts = {name: contact.hold(state) for name, contact in contacts.items()}
    state.carry("eraser", rng.normal(size=6))  # a known wrench
    tau = 20.0 * rng.normal(size=7)
    lam = reaction(state, tau)
    G = np.concatenate([np.zeros((0, 7)), *(held.G for held in state.contacts.values())])
    rhs = np.concatenate([np.zeros(0), *(held.rhs for held in state.contacts.values())])
    k = len(G)
    whole = np.linalg.solve(np.block([[state.M, G.T], [G, np.zeros((k, k))]]), np.r_[tau - state.bias, rhs])
    np.testing.assert_allclose(np.concatenate([np.zeros(0), *lam.values()]), whole[7:], rtol=1e-8, atol=1e-9)


def begun(panda, law, v=None, measured=True, **gains):
    """State, task and the multipliers asked first, of a face that begins to press."""
    contact = AxesContact("eraser", ("wx", "wy", "vz"))
    state = panda.state(panda.keyframes["home"], np.zeros(7) if v is None else v)
    state.contacts = {"board": contact.hold(state)}
    if measured:
        state.measured["board"] = np.array([0.1, -0.2, 0.05, 1.0, 2.0, -6.0])
    target = np.array([0.0, 0.0, -10.0])
    task = ForceTask(
        "board", contact, target, **{"kp": 0.3, "ki": 10.0, "damping": 5.0, "filter": 50.0} | gains, law=law
    )
    lam = np.array([0.02, 0.03, -4.0])
    state.loops = {"board": task.begin(state, lam)}
    return state, task, lam


@pytest.mark.parametrize("law", LAWS)
def test_the_first_command_of_a_force_loop_is_what_it_was_given(panda, law):
    state, task, lam = begun(panda, law)
    np.testing.assert_array_equal(state.loops["board"].filtered, state.measured["board"])
    np.testing.assert_allclose(task.rows(state).lo, lam, atol=1e-10)


def test_damping_acts_on_top_of_the_first_command(panda, rng):
    state, task, lam = begun(panda, "compensated", v=0.1 * rng.normal(size=7))
    np.testing.assert_allclose(task.rows(state).lo, lam - 5.0 * state.contacts["board"].slip, atol=1e-10)


@pytest.mark.parametrize("law", LAWS)
def test_without_an_integral_a_loop_begins_at_its_target(panda, law):
    state, task, _ = begun(panda, law, ki=0.0, kp=0.0)
    np.testing.assert_allclose(task.rows(state).lo, [0, 0, -10.0], atol=1e-12)


def test_without_a_sensor_a_loop_begins_at_its_target(panda):
    state, task, _ = begun(panda, "compensated", measured=False)
    np.testing.assert_allclose(task.rows(state).lo, [0, 0, -10.0], atol=1e-12)


# --- a whole phase ---


def program(panda, tasks, contacts=None):
    torque, joint = make_limits(panda, {})
    start = panda.state(panda.keyframes["home"], np.zeros(7))
    return Program(Phase(contacts or {}, tasks, dict.fromkeys(tasks, 1.0), torque, joint), start)


def handed(panda, before, after, loops=None, starts=None):
    state = panda.state(panda.keyframes["home"], np.zeros(7), t=2.0)
    hold(state, after.phase)
    state.measured = dict.fromkeys(after.phase.contacts, np.array([0, 0, 0, 0, 0, -6.0]))
    return hand_over(before, after, state, starts or {}, loops or {}, state.gravity())


def test_a_motion_that_goes_on_is_left_alone_and_another_begins(panda):
    path, other = stay(panda.fixed_pose("board")), stay(panda.fixed_pose("board"))
    first = program(panda, {"move": MotionTask("eraser", path), "rest": PostureTask(np.zeros(7))})
    stiffer = program(panda, {"move": MotionTask("eraser", path, kp=400.0), "rest": PostureTask(np.zeros(7))})
    assert handed(panda, first, stiffer)[0] == {}
    kept = Start(0.7)
    assert handed(panda, first, stiffer, starts={"move": kept})[0] == {"move": kept}
    for changed in (MotionTask("eraser", other), MotionTask("link7", path)):
        starts, _ = handed(panda, first, program(panda, {"move": changed}), starts={"move": kept})
        assert starts["move"].t == 2.0


def test_a_loop_that_goes_on_keeps_its_integral_and_one_that_begins_does_not_find_an_old_one(panda):
    def pressing(contact, **gains):
        held = AxesContact("eraser", ("vz",))
        press = ForceTask(contact, held, np.array([-10.0]), **{"kp": 0.3, "ki": 10.0} | gains)
        return program(panda, {"press": press}, {contact: held})

    loop = ForceLoop(np.zeros(6), np.array([-0.4]))
    first = pressing("board")
    assert handed(panda, first, pressing("board"), {"board": loop})[1]["board"] is loop
    resumed = handed(panda, first, pressing("board", ki=5.0), {"board": loop})[1]["board"]
    assert 5.0 * resumed.integral[0] == pytest.approx(10.0 * -0.4)
    free = program(panda, {"rest": PostureTask(np.zeros(7))})
    for before in (free, pressing("other")):
        new = handed(panda, before, first, {"board": loop})[1]
        assert set(new) == {"board"}
        np.testing.assert_array_equal(new["board"].filtered, [0, 0, 0, 0, 0, -6.0])
    assert handed(panda, first, free, {"board": loop})[1] == {}
