"""The plant: what MuJoCo warns of ends a run in words, and leaves nothing behind."""

from __future__ import annotations

import re

import mujoco
import pytest

from wbc.build import Built, build
from wbc.errors import SimulationError
from wbc.model import quietly
from wbc.run import run
from wbc.sim import Simulator
from wbc.spec import load

WARNING = r"broke down at t = 0\.001 s \(mjWARN_INERTIA: Inertia matrix is too close to singular.*\)$"


@pytest.fixture(scope="module")
def heavy() -> Built:
    """A load so heavy that MuJoCo gives up on the inertia matrix."""
    return build(load("eraser", {"plant.payload": "1e30", "duration": "0.05"}))


def test_a_run_that_breaks_down_names_the_warning_and_writes_no_file(heavy, tmp_path, monkeypatch, capfd):
    monkeypatch.chdir(tmp_path)
    result = run(heavy)
    assert re.search(WARNING, result.summary["broken"])
    assert not result.ok
    assert list(tmp_path.iterdir()) == []
    assert capfd.readouterr() == ("", "")


def test_the_error_carries_warning_and_time(heavy, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    simulator = Simulator(heavy.robot, heavy.q, heavy.controller.dt, heavy.spec.plant)
    with quietly():
        simulator.observe()
        with pytest.raises(SimulationError, match=WARNING) as caught:
            simulator.apply(heavy.robot.tau_max)
    assert caught.value.time == pytest.approx(1e-3)
    assert list(tmp_path.iterdir()) == []


def test_whoever_listened_to_warnings_before_a_run_does_so_afterwards(heavy: Built):
    said: list[str] = []
    before = mujoco.get_mju_user_warning()
    mujoco.set_mju_user_warning(said.append)
    try:
        run(heavy)
        assert mujoco.get_mju_user_warning() == said.append
    finally:
        mujoco.set_mju_user_warning(before)
    assert said == []
