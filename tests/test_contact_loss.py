"""Rows 5 and 8 of the faults: contacts that are lost, sensors that are wrong. Bars are those rows' numbers.

`WBC_CAMPAIGN=large` takes 20 seeds of each kind.
"""

from __future__ import annotations

import os

import numpy as np
import pytest

import wbc.controller
from wbc.build import build
from wbc.guard import Guarded
from wbc.run import run
from wbc.spec import load

SEEDS = range(20 if os.environ.get("WBC_CAMPAIGN") == "large" else 1)
FRAMES = {"eraser": "eraser", "chalk": "chalk"}


def faulty(name, kind, seed):
    """True motion along the normal and force of the tool from the fault on, and what was told."""
    rng = np.random.default_rng(seed)
    at, value = round(float(rng.uniform(0.3, 0.5)), 3), ""
    if kind == "contact.away":
        value = f" {rng.uniform(0.1, 0.5):.3f}"
    if kind == "sensor.bias":
        value = f" {rng.choice([-1, 1]) * rng.uniform(8, 20):.3f}"
    if kind == "sensor.drift":
        value = f" {rng.choice([-1, 1]) * rng.uniform(10, 40):.3f}"
    spec = load(name, [f"duration={at + 0.4:g}"]).with_set({"plant.faults": [f"{kind}{value} at {at} for ever"]})
    rows, told = [], []

    def show(simulator):
        T, V = simulator.true_motion(FRAMES[name])
        rows.append(
            (T.translation[2], (T.rotation @ V[3:])[2], np.linalg.norm(simulator.true_wrench(FRAMES[name])[3:]))
        )

    run(build(spec), hook=lambda seen, out: told.append((out.status.name, out.reason)), show=show)
    first = round(at * 1000)
    z, speed, force = np.array(rows).T
    repeat = f'wbc run {name} --headless --duration {at + 0.4:g} --fault "{kind}{value} at {at} for ever"'
    return (z - z[first - 1])[first:], speed[first:], force[first:], told[first:], repeat


@pytest.mark.row(8)
@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("kind", ["contact.lost", "contact.away"])
@pytest.mark.parametrize("name", FRAMES)
def test_row_8_a_lost_contact_is_noticed_and_held(name, kind, seed, record_property):
    travel, speed, _, told, repeat = faulty(name, kind, seed)
    noticed = next((i for i, (_, why) in enumerate(told) if "lost" in why), 999)
    for key, value in (
        ("noticed [ticks]", noticed),
        ("speed [m/s]", np.abs(speed).max()),
        ("travel [m]", np.abs(travel).max()),
    ):
        record_property(key, float(value))
    assert noticed <= 5, repeat
    assert np.abs(speed).max() <= 0.15, repeat
    assert np.abs(travel).max() <= 0.01, repeat


@pytest.mark.row(5)
@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("how", ["dropout", "bias", "drift", "spikes", "saturation", "sign", "frame"])
@pytest.mark.parametrize("name", FRAMES)
def test_row_5_a_wrong_sensor_does_not_drive_the_tool_off(name, how, seed, record_property):
    travel, speed, force, told, repeat = faulty(name, f"sensor.{how}", seed)
    record_property("speed [m/s]", float(np.abs(speed).max()))
    record_property("travel [m]", float(np.abs(travel).max()))
    assert np.abs(speed).max() <= 0.05, repeat
    assert np.abs(travel).max() <= 0.005, repeat
    if how == "sign":
        found = next((i for i, (_, why) in enumerate(told) if "reads the opposite" in why), 999)
        assert found <= 100, repeat
        assert np.abs(force - 10.0).max() <= 5.0, repeat
    if how not in ("drift", "bias"):
        assert any(status == "LIMITED" and "board: " in why for status, why in told), repeat


@pytest.mark.parametrize("kind", ["contact.lost", "sensor.sign"])
def test_without_the_guard_the_bars_are_missed(kind, monkeypatch):
    monkeypatch.setattr(wbc.controller, "watch", lambda state, force, grips, lam: Guarded(grips))
    travel, _, force, told, _ = faulty("eraser", kind, 0)
    assert not any("board: " in why for _, why in told)
    assert np.abs(travel).max() > 0.01 or np.abs(force - 10.0).max() > 5.0
