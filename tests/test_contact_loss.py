"""Rows 5 and 8 of the faults: contacts that are lost, sensors that are wrong. Bars are those rows' numbers.

On boards without friction and with it, pushed on and held, on a sphere, and under a humanoid's hand.
`WBC_CAMPAIGN=large` takes 20 seeds of each kind.
"""

from __future__ import annotations

import os
from typing import NamedTuple

import numpy as np
import pytest

import wbc.controller
from wbc.build import build
from wbc.guard import Guarded
from wbc.run import run
from wbc.spec import load

LARGE = os.environ.get("WBC_CAMPAIGN") == "large"
SEEDS = range(20 if LARGE else 1)
NOTICED, LOST_SPEED, LOST_TRAVEL = 5, 0.15, 0.01  # [ticks], [m/s], [m]
SPEED, TRAVEL, WITHIN, SOON = 0.05, 0.005, 5.0, 100  # [m/s], [m], [N], [ticks]


class Press(NamedTuple):
    """A spec that presses: the frame, what it presses on, with how much [N], and more settings."""

    frame: str
    on: str
    force: float
    more: tuple[str, ...] = ()
    begins: float = 0.0  # [s] until it does


SPECS = {
    "eraser": Press("eraser", "board", 10.0),
    "chalk": Press("chalk", "board", 10.0),
    "eraser_friction": Press("eraser", "board", 10.0),  # pushes, slides
    "chalk_stick": Press("chalk", "board", 10.0),  # pushes, sticks
    "polish_sphere": Press("ball", "dome", 5.0),
}
HAND = "references.ahead.quintic.times=[0, 0.6, 1.2]"  # there sooner
EVERY = SPECS | {"g1_wipe": Press("mitt", "board", 15.0, (HAND,), 0.9)}


class Seen(NamedTuple):
    """A run, from its fault on: the tool's way along the normal [m], its speed [m/s] and force [N] there; what was
    told; and the command that repeats it."""

    travel: np.ndarray
    speed: np.ndarray
    force: np.ndarray
    told: list[tuple[str, str]]
    repeat: str

    def first(self, *words):
        """The tick at which one of these was first told, infinite where it was not."""
        return next((i for i, (_, why) in enumerate(self.told) if any(word in why for word in words)), np.inf)


def normal(name, built):
    """p -> (height [m] above what is pressed on, its normal (3,))."""
    T = built.robot.state(built.q, np.zeros(built.robot.nv)).frame(EVERY[name].on).T.copy()

    def at(p):
        way = p - T.translation
        n = way / np.linalg.norm(way) if name == "polish_sphere" else T.rotation[:, 2]
        return n @ way, n

    return at


def faulty(name, *faults, at, after=0.3, changes=None):
    """A run with faults from `at` [s] on, and for as long after it."""
    press = EVERY[name]
    more = [f"duration={at + after:g}", *press.more]
    built = build(load(name, more).with_set({"plant.faults": list(faults), **(changes or {})}))
    above = normal(name, built)
    rows, told = [], []

    def show(simulator):
        T, V = simulator.true_motion(press.frame)
        height, n = above(T.translation)
        force = -n @ T.rotation @ simulator.true_wrench(press.frame)[3:]
        rows.append((height, n @ T.rotation @ V[3:], force))

    run(built, hook=lambda seen, out: told.append((out.status.name, out.reason)), show=show)
    first = max(round(at * 1000), 1)
    z, speed, force = np.array(rows).T
    given = " ".join([*(f'--set "{one}"' for one in more[1:]), *(f'--fault "{fault}"' for fault in faults)])
    repeat = f"wbc run {name} --headless --duration {at + after:g} {given}"
    return Seen((z - z[first - 1])[first:], speed[first:], force[first:], told[first:], repeat)


def drawn(name, kind, seed):
    """When [s], and the line of the plan: with a value of the seed."""
    rng = np.random.default_rng(seed)
    at, value = round(EVERY[name].begins + float(rng.uniform(0.15, 0.4)), 3), ""
    if kind == "contact.away":
        value = f" {rng.uniform(0.1, 0.5):.3f}"
    if kind == "sensor.bias":
        value = f" {rng.choice([-1, 1]) * rng.uniform(8, 20):.3f}"
    if kind == "sensor.drift":
        value = f" {rng.choice([-1, 1]) * rng.uniform(10, 40):.3f}"
    if kind == "sensor.saturation":
        value = f" {rng.uniform(0.2, 0.6) * EVERY[name].force:.3f}"
    return at, f"{kind}{value} at {at} for ever"


def judge_lost(seen, tell):
    """Row 8."""
    tell("noticed [ticks]", seen.first("lost", "left"), most=NOTICED, why=seen.repeat)
    tell("speed [m/s]", np.abs(seen.speed).max(), most=LOST_SPEED, why=seen.repeat)
    tell("travel [m]", np.abs(seen.travel).max(), most=LOST_TRAVEL, why=seen.repeat)


def judge_sensor(seen, tell):
    """Row 5."""
    tell("speed [m/s]", np.abs(seen.speed).max(), most=SPEED, why=seen.repeat)
    tell("travel [m]", np.abs(seen.travel).max(), most=TRAVEL, why=seen.repeat)


def judge_sign(seen, force, tell):
    """Row 5, of a sensor that reads the opposite."""
    tell("wrong sign found [ticks]", seen.first("reads the opposite"), most=SOON, why=seen.repeat)
    tell("wrong sign: off by [N]", (seen.force - force).max(), most=WITHIN, why=seen.repeat)


@pytest.mark.row(8)
@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("kind", ["contact.lost", "contact.away"])
@pytest.mark.parametrize("name", SPECS)
def test_row_8_a_lost_contact_is_noticed_and_held(name, kind, seed, tell):
    at, fault = drawn(name, kind, seed)
    judge_lost(faulty(name, fault, at=at), tell)


@pytest.mark.row(8)
@pytest.mark.parametrize("speed", [0.1, 0.5])
@pytest.mark.parametrize("name", SPECS if LARGE else ["eraser", "polish_sphere"])
def test_row_8_without_any_sensor_its_motion_tells(name, speed, tell):
    seen = faulty(name, "sensor.dropout at 0 for ever", f"contact.away {speed} at 0.2 for ever", at=0.2)
    judge_lost(seen, tell)


@pytest.mark.row(8)
@pytest.mark.parametrize("name", SPECS)
def test_row_8_a_contact_that_comes_back_is_pressed_on_again(name, tell):
    """It is felt for meanwhile; the loop that begins again comes to its force."""
    seen = faulty(name, "contact.lost at 0.2 for 0.25", at=0.2, after=0.25 + 0.55)
    judge_lost(seen, tell)
    tell("pressed on again [ticks]", seen.first(": pressed on again") - 250, most=30, why=seen.repeat)
    assert seen.first(": pressed on again") >= 250, seen.repeat
    assert abs(seen.force[-100:].mean() - EVERY[name].force) < 0.1 * EVERY[name].force, seen.repeat
    assert sum(": pressed on again" in why for _, why in seen.told) == 1, seen.repeat


@pytest.mark.row(5)
@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("how", ["dropout", "bias", "drift", "spikes", "saturation", "sign", "frame"])
@pytest.mark.parametrize("name", SPECS)
def test_row_5_a_wrong_sensor_does_not_drive_the_tool_off(name, how, seed, tell):
    at, fault = drawn(name, f"sensor.{how}", seed)
    seen = faulty(name, fault, at=at)
    judge_sensor(seen, tell)
    if how == "sign":
        judge_sign(seen, EVERY[name].force, tell)
    within = how in ("drift", "bias") or (how == "saturation" and name == "polish_sphere")  # of the gate
    if not within:
        on = EVERY[name].on
        assert any(status == "LIMITED" and f"{on}: " in why for status, why in seen.told), seen.repeat


@pytest.mark.row(5)
@pytest.mark.parametrize("how", ["sign", "frame", "saturation", "dropout"])
@pytest.mark.parametrize("name", SPECS)
def test_row_5_a_sensor_that_is_wrong_from_the_first_tick(name, how, tell):
    """Nothing has been known of the contact yet; what it reads then is held against what the torque presses with."""
    value = f" {0.25 * EVERY[name].force}" if how == "saturation" else ""
    seen = faulty(name, f"sensor.{how}{value} at 0 for ever", at=0.0, after=0.4)
    judge_sensor(seen, tell)
    if how == "sign":
        judge_sign(seen, EVERY[name].force, tell)
    tell("wrong from the first tick: times the force", seen.force.max() / EVERY[name].force, most=2.5, why=seen.repeat)


LIFTING = [("eraser", -10), ("eraser_friction", 10), ("chalk", 10)]  # a drift [N/s] that lifts it, with no gate to tell


@pytest.mark.row(5)
@pytest.mark.parametrize(
    ("name", "rate"),
    LIFTING + ([(name, rate) for name in SPECS for rate in (-20, -5, -3, 3, 5, 20)] if LARGE else []),
)
def test_row_5_a_sensor_that_drifts_until_the_contact_is_left(name, rate, tell):
    """No gate tells of a slow drift. The tool that it lifts, or tips over, is held by its motion; the sensor that still
    reads a force is not believed again, so that nothing is pressed on in the air. Where it presses harder, or the gate
    does tell, it stays."""
    seen = faulty(name, f"sensor.drift {rate} at 0.2 for ever", at=0.2, after=min(20.0 / abs(rate), 5.0))
    judge_sensor(seen, tell)
    assert seen.first("left: ") < np.inf or (name, rate) not in LIFTING, seen.repeat
    assert seen.force[-1] > 0.0 or seen.told[-1][0] != "OK", seen.repeat
    assert seen.first(": pressed on again") == np.inf, seen.repeat


@pytest.mark.row(8)
@pytest.mark.parametrize("way", ["hold", "approach"])
def test_row_8_a_humanoids_hand_loses_its_board(way, tell):
    """By the guard alone, and with the phase's own way out: back to where it came from."""
    at, fault = drawn("g1_wipe", "contact.lost", 0)
    changes = {"phases.wipe": {"tasks": WIPE}} if way == "hold" else None
    judge_lost(faulty("g1_wipe", fault, at=at, after=0.2, changes=changes), tell)


WIPE = ["balance", "pelvis", "press", "draw", "waving", "posture"]


@pytest.mark.row(5)
def test_row_5_a_humanoids_sensor_reads_the_opposite(tell):
    """What pulls is no lost contact: its phase goes on."""
    at, fault = drawn("g1_wipe", "sensor.sign", 0)
    seen = faulty("g1_wipe", fault, at=at, after=0.2)
    judge_sensor(seen, tell)
    judge_sign(seen, EVERY["g1_wipe"].force, tell)


@pytest.mark.parametrize("kind", ["contact.lost", "sensor.sign"])
def test_without_the_guard_the_bars_are_missed(kind, monkeypatch):
    monkeypatch.setattr(wbc.controller, "watch", lambda state, force, grips, lam: Guarded(grips))
    at, fault = drawn("eraser", kind, 0)
    seen = faulty("eraser", fault, at=at, after=0.4)
    assert not any("board: " in why for _, why in seen.told)
    assert np.abs(seen.travel).max() > LOST_TRAVEL or np.abs(seen.force - 10.0).max() > WITHIN
