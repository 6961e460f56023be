"""Figures of a log, each from a run that was made up to have it; settling counts from every begin."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest

from wbc.contact.axes import AxesContact
from wbc.friction import Unilateral
from wbc.log import Log
from wbc.metrics import IMPACT, metrics, vocabulary
from wbc.phase import Phase
from wbc.reference import hold
from wbc.task.force import ForceTask
from wbc.task.motion import MotionTask

DT, TICKS = 0.001, 400
BOARD = AxesContact("eraser", ("wx", "vz"))


def phases():
    press = ForceTask("board", BOARD, np.array([0.0, -10.0]))
    draw, lift = (MotionTask("eraser", hold(pin.SE3.Identity())) for _ in range(2))
    return [
        Phase({}, {"lift": lift}, {}, None, None, "air"),
        Phase({"board": BOARD}, {"press": press, "draw": draw}, {}, None, None, "board"),
    ]


def made(active, fz=-10.0, **more):
    """A log that is on the board where `active` (a list of tick ranges) says; `fz`: a number or tick -> number."""
    n = 2
    meta = {"dt": DT, "status_names": ["OK"], "q_max": [], "q_min": []}
    log = Log(TICKS, meta)
    for i in range(TICKS):
        on = any(i in ticks for ticks in active)
        value = fz(i) if callable(fz) else fz
        row = {
            "t": i * DT,
            "tau": np.zeros(n),
            "tau_min": -np.ones(n),
            "tau_max": np.ones(n),
            "status": 0,
            "phase": int(on),
        }
        row |= {"torque_rate_limit": np.ones(n), "q": np.zeros(n)}
        row |= {"board.true": np.r_[0, 0, 0, 0, 0, value], "board.lam": np.array([0.0, value])}
        row |= {"board.points": float(value != 0.0), "board.mu": 0.0}
        row["board.asked"] = np.array([0.0, value if on else np.nan])
        name = "draw" if on else "lift"
        row |= {f"{name}.error": np.array([0, 0, 0, 1e-3, 0, 0]), f"{name}.speed": 0.1, f"{name}.desired_speed": 0.1}
        if on:
            row["board.target"] = np.array([0.0, -10.0])
        log.append((), **row | {key: change(i) for key, change in more.items() if change(i) is not None})
    return log


def test_late_ticks_leave_out_the_settling_after_every_begin():
    log = made([range(0)])
    on = np.zeros(TICKS, bool)
    on[0:100] = on[150:200] = on[300:310] = True
    late = log.late(on, 0.02)
    expected = np.zeros(TICKS, bool)
    expected[20:100] = expected[170:200] = True
    np.testing.assert_array_equal(late, expected)
    np.testing.assert_array_equal(log.late(on, 0.0), on)
    assert not log.late(np.zeros(TICKS, bool), 0.0).any()


def test_figures_are_of_the_ticks_in_which_a_contact_is_active_less_their_settling():
    wrong = lambda i: 0.0 if i < 100 or i >= 300 else -30.0 if i < 150 else -10.5  # noqa: E731
    found = metrics(made([range(100, 300)], wrong), phases(), 0.05)
    assert found["board.fz.rms_error"] == pytest.approx(0.5)
    assert found["board.fz.mean"] == pytest.approx(-10.5)
    assert metrics(made([range(100, 300)], wrong), phases(), 0.049)["board.fz.max_error"] == pytest.approx(20.0)
    twice = metrics(made([range(50, 90), range(100, 300)], wrong), phases(), 0.05)
    assert twice["board.fz.rms_error"] == pytest.approx(0.5)  # the first stretch is shorter than its settling


def test_what_was_never_active_has_no_figures():
    found = metrics(made([range(0)]), phases(), 0.0)
    assert "board.fz.rms_error" not in found
    assert "draw.position.rms_error" not in found
    assert "board.lost" not in found
    assert found["lift.position.rms_error"] == pytest.approx(1e-3)


def test_what_ended_while_settling_was_not_measured():
    found = metrics(made([range(100, 120)]), phases(), 0.05)
    assert np.isnan(found["board.fz.rms_error"])
    assert np.isnan(found["draw.speed.max"])


def test_peak_and_pull_are_along_the_target_and_of_every_tick():
    force = lambda i: {20: -25.0, 350: 3.0}.get(i, -10.0)  # noqa: E731
    found = metrics(made([range(100, 300)], force), phases(), 0.05)
    assert found["board.peak"] == pytest.approx(25.0)
    assert found["board.pull"] == pytest.approx(3.0)
    assert found["board.asked_pull"] == 0.0  # the pull is not in a tick in which the contact is active
    assert metrics(made([range(100, 400)], force), phases(), 0.05)["board.asked_pull"] == pytest.approx(3.0)
    assert metrics(made([range(100, 300)]), phases(), 0.05)["board.pull"] == 0.0


def test_lost_ticks_are_those_of_the_active_contact_after_its_touch():
    force = lambda i: 0.0 if i < 120 or 200 <= i < 207 or i > 300 else -10.0  # noqa: E731
    assert metrics(made([range(100, 300)], force), phases(), 0.05)["board.lost"] == 7


def test_how_much_of_the_friction_is_used_is_a_mean_of_the_ticks_that_press():
    """Half of mu N for a while, all of it for thrice as long, and nothing where nothing presses."""
    up = np.array([0.0, 0.0, -1.0])
    point = AxesContact("eraser", ("vz",))
    point.pushes = Unilateral(up, np.zeros((0, 3)), np.eye(3)[:2], 0.0, 0.4, 8, 0.005, None)
    pushed = lambda i: 0.0 if 290 <= i < 300 else 10.0  # noqa: E731
    told = {
        "board.push": pushed,
        "board.drag": lambda i: np.array([0.0, 2.0 if i < 160 else 0.4 * pushed(i)]),
        "board.slip": lambda i: np.zeros(2),
        "board.mu": lambda i: 0.4 if pushed(i) else 0.0,
        "board.points": lambda i: float(pushed(i) > 0.0),
    }
    placed = [Phase({}, {}, {}, None, None, "air"), Phase({"board": point}, {}, {}, None, None, "board")]
    found = metrics(made([range(100, 350)], **told), placed, 0.0)
    ticks = np.array([0.5 if i < 160 else 1.0 for i in range(100, 350) if pushed(i)])
    assert found["board.friction.share"] == pytest.approx(ticks.mean())
    assert "board.friction.share" in vocabulary(placed)
    late = metrics(made([range(100, 350)], **told), placed, 0.06)
    assert late["board.friction.share"] == pytest.approx(1.0)


def test_an_impact_is_held_against_the_peak_that_follows_it():
    late = round(IMPACT / DT)
    force = lambda i: 0.0 if i < 80 else {85: -20.0, 80 + late + 1: -50.0}.get(i, -10.0)  # noqa: E731
    told = {"board.predicted_peak": lambda i: 18.0 if i == 80 else None}
    found = metrics(made([range(100, 300)], force, **told), phases(), 0.0)
    assert found["board.impact_error"] == pytest.approx(0.1)
    assert found["board.impact"] == pytest.approx(20.0)
    assert "board.impact_error" not in metrics(made([range(100, 300)], force), phases(), 0.0)


def test_overshoot_is_speed_beyond_that_of_the_reference_from_the_first_tick():
    fast = {"draw.speed": lambda i: {101: 0.13, 250: 0.11}.get(i)}
    found = metrics(made([range(100, 300)], **fast), phases(), 0.05)
    assert found["draw.overshoot"] == pytest.approx(0.03)
    assert found["lift.overshoot"] == 0.0


def test_every_figure_is_in_the_vocabulary():
    told = {"board.predicted_peak": lambda i: 18.0 if i == 80 else None}
    assert set(metrics(made([range(100, 300)], **told), phases(), 0.0)) <= set(vocabulary(phases()))
