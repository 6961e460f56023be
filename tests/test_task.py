"""Tasks against the oracle of the chapter, the force loop against a recursion by hand, and `wbc.testing`."""

import math

import numpy as np
import pinocchio as pin
import pytest

from wbc import analytic
from wbc.contact.axes import AxesContact, MatrixContact, WorldAxesContact
from wbc.contact.screw import ScrewContact
from wbc.contact.sphere import SphereContact
from wbc.dynamics import inertia, mobility
from wbc.errors import GainError
from wbc.qp import Rows
from wbc.reference import Path, hold, sine
from wbc.task.force import ForceLoop, ForceTask
from wbc.task.motion import MotionTask, computed_torque
from wbc.task.posture import PostureTask
from wbc.testing import check_task

TILTED = pin.SE3(pin.exp3(np.array([0.3, -0.5, 0.9])), np.array([0.4, -0.1, 0.3]))
BOARD = ("wx", "wy", "vz")


def moving(rng):
    """A reference that moves and turns about every axis."""
    return Path(TILTED, {i: sine(*rng.uniform(0.2, 1.0, 2), rng.uniform(-3, 3)) for i in range(6)})


def held(state, **contacts):
    """The state with contacts evaluated, as the controller does it."""
    state.contacts = {name: contact.hold(state) for name, contact in contacts.items()}
    state.loops = {name: ForceLoop() for name in contacts}
    return state


def positive(rng, n):
    X = rng.normal(size=(n, n))
    return X @ X.T + np.eye(n)


# --- motion ---


def test_computed_torque_is_the_chapters(panda, draw, rng):
    Kp, Kd = positive(rng, 6), positive(rng, 6)
    for t in np.linspace(0, 3, 10):
        frame, desired = draw(panda).frame("eraser"), moving(rng)(t)
        ours = computed_torque(frame, desired, np.hstack((Kp, Kd)))
        book = analytic.computed_torque(
            frame.T.homogeneous, frame.V, desired.T.homogeneous, desired.V, desired.Vdot, Kp, Kd
        )
        np.testing.assert_allclose(ours, book, atol=1e-12 * (1 + np.abs(book).max()))


def test_rows_of_a_motion_task_are_its_axes_of_the_law(panda, draw, rng):
    reference, state = moving(rng), draw(panda, t=0.4)
    frame, desired = state.frame("eraser"), reference(0.4)
    for axes, kp in (
        (("wx", "wy", "wz", "vx", "vy", "vz"), 80.0),
        (("vx", "vz"), np.array([50.0, 70.0])),
        (("wz", "vx", "vy"), positive(rng, 3)),
    ):
        rows = MotionTask("eraser", reference, kp, 15.0, axes).rows(state)
        S = np.eye(6)[[("wx", "wy", "wz", "vx", "vy", "vz").index(a) for a in axes]]
        Kp = np.eye(6) * kp if np.ndim(kp) == 0 else S.T @ (np.diag(kp) if np.ndim(kp) == 1 else kp) @ S
        # zero gain on the other axes is not positive definite: the oracle's parts are added up
        X_e = analytic.pose_error(frame.T.homogeneous, desired.T.homogeneous)
        no_kp = analytic.computed_torque(
            frame.T.homogeneous, frame.V, desired.T.homogeneous, desired.V, desired.Vdot, np.zeros((6, 6)), 15.0
        )
        np.testing.assert_allclose(rows.A["vdot"], S @ frame.J, atol=1e-14)
        np.testing.assert_allclose(rows.lo, S @ (no_kp + Kp @ X_e - frame.drift), atol=1e-11)
        np.testing.assert_allclose(rows.metric, analytic.task_inertia(state.M, S @ frame.J), rtol=1e-8)
        assert rows.lo is rows.hi


def test_book_law_tracks_the_raw_target_on_all_axes(panda, draw, rng):
    reference, state = moving(rng), held(draw(panda, t=0.4), board=AxesContact("eraser", BOARD))
    frame, desired = state.frame("eraser"), reference(0.4)
    y = analytic.computed_torque(
        frame.T.homogeneous, frame.V, desired.T.homogeneous, desired.V, desired.Vdot, 80.0, 15.0
    )
    rows = MotionTask("eraser", reference, 80.0, 15.0, ("wz", "vx", "vy"), "board", law="book").rows(state)
    np.testing.assert_allclose(rows.A["vdot"], frame.J, atol=1e-14)
    np.testing.assert_allclose(rows.lo, y - frame.drift, atol=1e-11)
    np.testing.assert_allclose(rows.metric, analytic.task_inertia(state.M, frame.J), rtol=1e-8)


def test_compensated_law_leaves_the_constrained_axes_to_the_contact(panda, draw, rng):
    contact = WorldAxesContact("eraser", BOARD, TILTED.rotation)
    reference, state = moving(rng), held(draw(panda, t=0.4), board=contact)
    frame, desired, board = state.frame("eraser"), reference(0.4), state.contacts["board"]
    y = analytic.computed_torque(
        frame.T.homogeneous, frame.V, desired.T.homogeneous, desired.V, desired.Vdot, 80.0, 15.0
    )
    task = MotionTask("eraser", reference, 80.0, 15.0, contact.free_axes, "board")
    rows = task.rows(state)
    np.testing.assert_allclose(rows.A["vdot"], np.r_[board.A, board.free] @ frame.J, atol=1e-13)
    target = np.r_[-contact.Adot_V(state) - board.A @ frame.drift, board.free @ (y - frame.drift)]
    np.testing.assert_allclose(rows.lo, target, atol=1e-11)
    # with a second contact, rows are stacked one by one and say the same
    state = held(draw(panda, t=0.4), board=contact, other=MatrixContact("flange", np.zeros((0, 6))))
    frame, board = state.frame("eraser"), state.contacts["board"]
    again, (G, b) = task.rows(state), task.target(state)
    np.testing.assert_allclose(again.A["vdot"], np.r_[board.G, G], atol=1e-13)
    np.testing.assert_allclose(again.lo, np.r_[board.rhs, b], atol=1e-13)


@pytest.mark.parametrize(
    ("gains", "message"),
    [
        ({"kp": -1.0}, "kp: not positive definite: smallest eigenvalue -1, expected above 0"),
        ({"kp": [1.0, 2.0]}, r"kp: got shape \(2,\), expected a number, \(3,\) or \(3, 3\)"),
        ({"kd": [[1, 0, 0], [0, 1, 3], [0, 0, 1]]}, r"kd: not positive definite: smallest eigenvalue -0\.5"),
        ({"kd": np.nan}, "kd: not finite"),
    ],
)
def test_motion_gains_are_refused(gains, message):
    with pytest.raises(GainError, match=message):
        MotionTask("eraser", hold(TILTED), axes=("wz", "vx", "vy"), **gains)


def test_screws_take_one_number_for_a_gain():
    with pytest.raises(GainError, match="kp: a vector or matrix needs axes with names, expected a number"):
        MotionTask("eraser", hold(TILTED), kp=[5.0], axes=("swing",), contact="handle")


# --- force ---

CONTACT = AxesContact("eraser", BOARD)
DT = 2e-3


def ticks(panda, draw, task, readings, lam=None):
    """Rows and memory of tick after tick, as the controller drives them; `lam(command)` is the force that comes."""
    loop, out = ForceLoop(), []
    for reading in readings:
        state = held(draw(panda), board=CONTACT)
        state.dt, state.loops = DT, {"board": loop}
        state.measured = {} if reading is None else {"board": reading}
        rows = task.rows(state)
        loop = task.advance(state, rows.lo if lam is None else lam(rows.lo))
        out.append((rows, loop, state))
    return out


def test_force_loop_by_hand(panda, draw, rng):
    """lambda = lambda_d + Kp e + Ki int e - K_damp A V with e = lambda_d - A s, s the filtered wrench."""
    target, Kp, Ki, K_damp = rng.normal(size=3), positive(rng, 3), positive(rng, 3), positive(rng, 3)
    task = ForceTask("board", CONTACT, target, Kp, Ki, K_damp, filter=30.0)
    readings = rng.normal(size=(6, 6))
    alpha = 1 - math.exp(-2 * math.pi * 30 * DT)
    s, integral, pressed = readings[0], np.zeros(3), 0
    for reading, (rows, loop, state) in zip(readings, ticks(panda, draw, task, readings), strict=True):
        s = s + alpha * (reading - s)
        A = CONTACT.A(state)
        e = target - A @ s  # the rows of A are orthonormal: (A')^+ = A
        command = target + Kp @ e + Ki @ integral - K_damp @ A @ state.frame("eraser").V
        np.testing.assert_allclose(rows.lo, command, atol=1e-12)
        f_d, grown = (A.T @ target)[3:], integral + DT * e
        if s[3:] @ f_d < 0.1 * f_d @ f_d:  # nothing is pressed: towards zero, and no further
            grown = np.where(e * integral > 0.0, integral, np.where(grown * integral > 0.0, grown, 0.0))
        integral, pressed = grown, pressed + (s[3:] @ f_d >= 0.1 * f_d @ f_d)
        np.testing.assert_allclose(loop.integral, integral, atol=1e-14)
        np.testing.assert_allclose(loop.filtered, s, atol=1e-14)
        np.testing.assert_allclose(
            rows.metric, state.contacts["board"].G @ np.linalg.solve(state.M, state.contacts["board"].G.T), atol=1e-10
        )
        assert rows.A == {"board": None}
    assert 0 < pressed < 6


def test_force_error_is_in_multiplier_coordinates_of_any_contact(panda, draw, rng):
    contact, F = MatrixContact("eraser", rng.normal(size=(2, 6))), rng.normal(size=6)
    state = held(draw(panda), board=contact)
    state.measured = {"board": F}
    lam_d = np.array([1.0, -2.0])
    rows = ForceTask("board", contact, lam_d, kp=0.5).rows(state)
    np.testing.assert_allclose(rows.lo, lam_d + 0.5 * (lam_d - np.linalg.pinv(contact.A(state).T) @ F), atol=1e-12)


def test_book_force_law_projects_the_whole_error_and_keeps_its_bias(panda, draw, rng):
    contact, F = SphereContact("eraser", TILTED.translation), rng.normal(size=6)
    state = held(draw(panda), board=contact)
    state.measured, state.loops = {"board": F}, {"board": ForceLoop(integral=rng.normal(size=6))}
    integral = state.loops["board"].integral
    rows = ForceTask("board", contact, np.array([-10.0]), kp=0.3, ki=7.0, law="book").rows(state)
    frame, A, Adot_V = state.frame("eraser"), contact.A(state), contact.Adot_V(state)
    M_C = analytic.task_inertia(state.M, frame.J)
    F_d = A.T @ [-10.0]
    command = analytic.force_command(F_d, F_d - F, integral, 0.3, 7.0)
    pressed = analytic.project_wrench(A, analytic.force_projector(A, M_C) @ command)
    expected = analytic.multiplier_error(A, pressed) + analytic.force_bias(A, M_C, Adot_V)
    np.testing.assert_allclose(rows.lo, expected, rtol=1e-9)


def test_without_a_reading_the_loop_is_open(panda, draw):
    target = np.array([0.0, 0.0, -10.0])
    task = ForceTask("board", CONTACT, target, kp=0.3, ki=10.0)
    (rows, loop, _), (after, _, _) = ticks(panda, draw, task, [None, None])
    np.testing.assert_array_equal(rows.lo, target)
    np.testing.assert_array_equal(after.lo, target)
    np.testing.assert_array_equal(loop.integral, np.zeros(3))


def test_targets_from_outside_and_over_time(panda, draw):
    state = held(draw(panda, t=2.0), board=CONTACT)
    task = ForceTask("board", CONTACT, lambda t: np.array([0.0, 0.0, -5.0 * t]))
    np.testing.assert_array_equal(task.desired(state), [0, 0, -10])
    state.targets = {"board.fz": -12.0, "other.fz": 3.0}
    np.testing.assert_array_equal(task.desired(state), [0, 0, -12])
    fixed = np.array([0.0, 0.0, -10.0])
    task = ForceTask("board", CONTACT, fixed)
    task.desired(state)
    state.targets = {}
    np.testing.assert_array_equal(task.desired(state), [0, 0, -10])


def test_what_limits_take_is_no_error(panda, draw, rng):
    """By hand: e = lambda_d + y - A s with y the filtered (lambda - command) of the last tick, in pace with s."""
    target, K = rng.normal(size=3), positive(rng, 3)
    task = ForceTask("board", CONTACT, target, K, 10 * K, filter=30.0)
    readings, taken = rng.normal(size=(6, 6)), rng.normal(size=3)
    readings += 9.0 * CONTACT.A(None).T @ target  # it presses all the time
    alpha = 1 - math.exp(-2 * math.pi * 30 * DT)
    s, integral, y = readings[0], np.zeros(3), np.zeros(3)
    found = ticks(panda, draw, task, readings, lambda command: command + taken)
    for tick, (rows, loop, state) in enumerate(found):
        s = s + alpha * (readings[tick] - s)
        y = y + alpha * (taken - y) if tick else y
        e = target + y - CONTACT.A(state) @ s
        np.testing.assert_allclose(rows.lo, target + K @ e + 10 * K @ integral, atol=1e-12)
        integral = integral + DT * e
        np.testing.assert_allclose(loop.integral, integral, atol=1e-14)


def test_a_force_held_back_by_a_limit_does_not_wind_up(panda, draw):
    """The limit lets 4 N of 10 N through, and the sensor says so: the integral stays zero, nothing strikes after."""
    task = ForceTask("board", CONTACT, np.array([0.0, 0.0, -10.0]), kp=0.3, ki=10.0, filter=50.0)
    loop, reading = ForceLoop(), CONTACT.A(None).T @ [0, 0, -4.0]
    for cap in [-4.0] * 500 + [-99.0] * 500:
        state = held(draw(panda), board=CONTACT)
        state.dt, state.loops, state.measured = DT, {"board": loop}, {"board": reading}
        lam = np.maximum(task.rows(state).lo + task.K_damp @ state.contacts["board"].slip, cap)
        loop, reading = task.advance(state, lam), CONTACT.A(None).T @ lam
        if cap == -4.0:
            stuck = loop.integral[2]
    # a loop that counts the missing 6 N as an error would have stored 6 N s by then, 60 N to strike with
    assert abs(stuck) < 0.05
    assert lam[2] == pytest.approx(-10.0, abs=1e-6)


def test_the_integral_is_bounded_by_what_it_may_push(panda, draw):
    task = ForceTask("board", CONTACT, np.array([0.0, 0.0, -10.0]), ki=[5.0, 5.0, 20.0], integral_limit=0.3)
    *_, (rows, loop, _) = ticks(panda, draw, task, [CONTACT.A(None).T @ [0, 0, -4.0]] * 20)
    np.testing.assert_allclose(loop.integral, [0, 0, -0.3 / 20], atol=1e-14)
    assert rows.lo[2] == pytest.approx(-10.3)


@pytest.mark.parametrize(
    ("gains", "message"),
    [
        ({"kp": [0.1, 0.2]}, r"kp: got shape \(2,\), expected a number, \(3,\) or \(3, 3\)"),
        ({"ki": -3.0}, "ki: not positive definite: smallest eigenvalue -3"),
        ({"damping": [5, 5, -1]}, "damping: not positive definite: smallest eigenvalue -1"),
        (
            {"kp": [0.1, 0.2, 0.3], "law": "book"},
            "kp: under law: book the gains act on the whole wrench; expected a number or 6 of them, got 3",
        ),
    ],
)
def test_force_gains_are_refused(gains, message):
    with pytest.raises(GainError, match=message):
        ForceTask("board", CONTACT, np.zeros(3), **gains)


# --- posture ---


def test_posture_acceleration(ur5e, draw, rng):
    Kp, Kd = positive(rng, 6), positive(rng, 6)
    q, state = rng.normal(size=6), draw(ur5e)
    task = PostureTask(q, Kp, Kd)
    np.testing.assert_allclose(task.acceleration(state), Kp @ (q - state.q) - Kd @ state.v, atol=1e-12)
    with pytest.raises(GainError, match=r"kd: got shape \(5,\), expected a number, \(6,\) or \(6, 6\)"):
        PostureTask(q, 1.0, np.ones(5))


def test_posture_metric_is_the_projected_inertia(panda, draw, rng):
    """N' M N with N = I - Gbar G, Gbar = M^-1 G' (G M^-1 G')^-1; it annihilates what contacts and motion use."""
    contact = AxesContact("eraser", BOARD)
    motion = MotionTask("eraser", moving(rng), axes=("vx", "vy"))
    for _ in range(5):
        state = held(draw(panda), board=contact)
        motion.rows(state)
        G = state.primary[0]
        assert G.shape == (5, 7)
        rows = PostureTask(np.zeros(7)).rows(state)
        M = state.M
        Gbar = np.linalg.solve(M, G.T) @ np.linalg.inv(G @ np.linalg.solve(M, G.T))
        N = np.eye(7) - Gbar @ G
        np.testing.assert_allclose(rows.metric, N.T @ M @ N, atol=1e-9)
        # accelerations that obey the rows above are orthogonal to what the posture weighs
        np.testing.assert_allclose(rows.metric @ np.linalg.solve(M, G.T), 0.0, atol=1e-9)
        np.testing.assert_allclose(np.linalg.matrix_rank(rows.metric, tol=1e-8), 2)
        assert rows.A == {"vdot": None}


def test_inertia_of_dependent_rows_weighs_what_can_move(panda, draw, rng):
    state = draw(panda)
    G = rng.normal(size=(3, 7))
    twice = np.r_[G, G[:1]]
    W = inertia(mobility(state, twice))
    force = twice @ rng.normal(size=7)
    N = np.eye(7) - np.linalg.solve(state.M, G.T) @ inertia(mobility(state, G)) @ G
    np.testing.assert_allclose(state.M - twice.T @ W @ twice, N.T @ state.M @ N, atol=1e-9)
    assert np.isfinite(force @ W @ force)


# --- the checks of wbc.testing ---


def test_shipped_tasks_pass(panda, ur5e, planar3r, rng):
    check_task(MotionTask("eraser", moving(rng)), panda)
    check_task(MotionTask("eraser", moving(rng), axes=("vx", "wz")), panda)
    check_task(MotionTask("eraser", moving(rng), axes=("wz", "vx", "vy"), contact="board"), panda, {"board": CONTACT})
    check_task(MotionTask("eraser", moving(rng), contact="board", law="book"), panda, {"board": CONTACT})
    check_task(ForceTask("board", CONTACT, np.zeros(3), 0.3, 10.0, 5.0), panda, {"board": CONTACT})
    check_task(PostureTask(np.zeros(6)), ur5e)
    check_task(PostureTask(np.zeros(7)), panda, {"board": CONTACT})
    check_task(MotionTask("flange", moving(rng), axes=("wy", "vx", "vz"), robot_axes=(1, 3, 5)), planar3r)
    for contact in (WorldAxesContact("eraser", BOARD, TILTED.rotation), ScrewContact("eraser", np.eye(6)[:2], TILTED)):
        task = MotionTask("eraser", moving(rng), axes=contact.free_axes, contact="board")
        check_task(task, panda, {"board": contact}, drift=False)


class Height:
    """The height of the flange: a task of one's own, with one thing wrong."""

    def __init__(self, wrong=""):
        self.wrong = wrong

    def rows(self, state):
        frame = state.frame("flange")
        R, V = frame.T.rotation, frame.V
        G = R[2:] @ frame.J[3:]
        drift = R[2] @ (frame.drift[3:] + np.cross(V[:3], V[3:]))  # world acceleration of the point
        y = 50.0 * (0.4 - frame.T.translation[2]) - 10.0 * R[2] @ V[3:]
        wrong = self.wrong
        drift = {"drift": R[2] @ frame.drift[3:], "sign": -drift}.get(wrong, drift)
        b = np.array([np.nan if wrong == "nan" else y - drift])
        metric = {"negative": -np.eye(1), "wide": np.eye(2)}.get(wrong)
        names = {"name": "vdott"}.get(wrong, "vdot")
        A = {"shape": G[:, 1:], "none": None}.get(wrong, G)
        return Rows("height", {} if wrong == "empty" else {names: A}, b, b, metric)


class Skewed(Height):
    def rows(self, state):
        rows = super().rows(state)
        b = np.r_[rows.lo, rows.lo]
        return Rows("", {"vdot": np.r_[rows.A["vdot"], rows.A["vdot"]]}, b, b, np.array([[2.0, 0.5], [0.0, 2.0]]))


WRONG = {
    "drift": r"the part of the target that is even in v, -Gdot v at state 0 of seed 5: expected \[.*\], got .* off",
    "sign": "the part of the target that is even in v",
    "nan": "lo at state 0 of seed 5: expected finite numbers, got .*nan",
    "negative": "metric at state 0 of seed 5: expected eigenvalues >= 0, got -1",
    "wide": r"metric at state 0 of seed 5: expected shape \(1, 1\), got \(2, 2\)",
    "name": "rows at state 0 of seed 5: expected unknowns among vdot, got 'vdott'",
    "shape": r"A\['vdot'\] at state 0 of seed 5: expected shape \(1, 6\), got \(1, 5\)",
    "none": "the number of rows with the identity on vdot at state 0 of seed 5: expected 6, got 1",
    "empty": "rows at state 0 of seed 5: expected coefficients of an unknown, got none",
}


@pytest.mark.parametrize("wrong", WRONG)
def test_check_task_names_what_is_wrong(ur5e, wrong):
    check_task(Height(), ur5e)
    with pytest.raises(AssertionError, match=WRONG[wrong]):
        check_task(Height(wrong), ur5e, seed=5)


def test_check_task_wants_a_symmetric_metric(ur5e):
    with pytest.raises(AssertionError, match="metric, its transpose at state 0 of seed 0: expected"):
        check_task(Skewed(), ur5e)


def test_a_wrench_as_target_follows_the_contact_as_it_turns(panda):
    """F_d in the frame's axes stays F_d, whatever the rows of a state-dependent A are at the moment."""
    hinge = ScrewContact("eraser", np.eye(6)[2], panda.fixed_pose("board"))
    home = panda.keyframes["home"]
    rng = np.random.default_rng(5)
    for _ in range(5):
        state = panda.state(home + 0.2 * rng.normal(size=7), np.zeros(7))
        state.contacts["door"] = hinge.hold(state)
        A = state.contacts["door"].A
        F_d = A.T @ rng.normal(size=5)
        task = ForceTask("door", hinge, F_d, wrench=True)
        np.testing.assert_allclose(A.T @ task.desired(state), F_d, atol=1e-12)
