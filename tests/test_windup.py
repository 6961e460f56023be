"""A force loop that waits for its contact does not wind up: what then meets it is what it would have met at once.

Three ways to wait with force control on: stuck against an axis limit, before a wall that is out of reach, pressing with
a sensor that reads nothing. Peaks are of the simulator's own contact forces. `WBC_CAMPAIGN=large` waits in earnest, ten
seconds on the way through the air.
"""

from __future__ import annotations

import os

import bars
import numpy as np
import pytest
from air import pressing

from wbc.build import build
from wbc.controller import Status
from wbc.sim import Simulator
from wbc.spec import load
from wbc.task import force as tasks
from wbc.wrench import Wrench

pytestmark = pytest.mark.row(14)

LARGE = os.environ.get("WBC_CAMPAIGN") == "large"
SEEDS = [int(os.environ["WBC_SEED"])] if "WBC_SEED" in os.environ else range(20 if LARGE else 2)
MOST = bars.WIND_UP  # times the impact without a wait
WAIT = 10.0  # [s]


class Rig:
    """A controller above a board in MuJoCo, at a height, with gains of a seed."""

    def __init__(self, folder, seed, height=0.004):
        rng = np.random.default_rng([seed, 14])
        self.values = {
            "force": -rng.uniform(6.0, 15.0), "kp": rng.uniform(0.0, 0.3), "ki": rng.uniform(2.0, 10.0),
            "damping": rng.uniform(350.0, 600.0),
        }  # fmt: skip
        gains = {key: self.values[key] for key in ("kp", "ki", "damping")} | {"filter": 50}
        self.built = build(load(pressing(folder, height, self.values["force"], gains)))
        self.controller = self.built.controller
        self.simulator = Simulator(self.built.robot, self.built.q, self.controller.dt, seed=seed)
        self.controller.reset(self.built.q, np.zeros(self.built.robot.nv))
        self.t, self.felt, self.out = 0.0, None, None
        for _ in range(4):  # until it presses, on nothing yet
            self.step()
        assert self.controller.phase.name == "press"
        self.remember(np.zeros(1))  # where the way from nothing to the target is behind it

    def remember(self, integral):
        memory = self.controller.memory
        self.controller.memory = memory._replace(loops={"board": memory.loops["board"]._replace(integral=integral)})

    @property
    def integral(self):
        """[N] of the command."""
        loop = self.controller.memory.loops["board"]
        return float(np.abs(self.controller.phase.tasks["press"].Ki @ loop.integral).max(initial=0.0))

    def step(self, deaf=False):
        """One tick of the loop; the force that truly acts [N]."""
        seen = self.simulator.observe()
        given = None if self.felt is None else {"board": self.nothing if deaf else self.felt}
        self.out = self.controller.step(self.t, seen.q, seen.v, measured=given)
        self.t += self.controller.dt
        self.simulator.apply(self.out.tau)
        self.felt = self.simulator.measured(self.controller.state, self.out.vdot)
        return -float(self.simulator.true_wrench("chalk")[5])

    nothing = Wrench(np.zeros(6), "chalk")

    def stand_still(self, seconds):
        """Nothing moves, however it presses, and the sensor reads nothing: it is stuck."""
        seen = self.simulator.observe()
        v = np.zeros_like(seen.v)
        for _ in range(round(seconds / self.controller.dt)):
            self.out = self.controller.step(self.t, seen.q, v, measured={"board": self.nothing})
            self.t += self.controller.dt
        assert self.out.status in (Status.OK, Status.LIMITED), self.out.reason

    def impact(self, ticks):
        """The largest force of the next ticks [N]."""
        return max(self.step() for _ in range(ticks))


def stuck(folder, seed, seconds):
    """The impact on a board 4 mm below, after so long against an axis limit."""
    rig = Rig(folder, seed)
    rig.stand_still(seconds)
    return rig.impact(700), rig


def again(seed, test, told):
    return f"WBC_SEED={seed} pytest tests/test_windup.py -k {test}  # {told}"


def test_ten_seconds_against_a_limit_and_then_contact(tmp_path, tell):
    ratios, wrong = [], []
    for seed in SEEDS:
        at_once, (waited, rig) = stuck(tmp_path, seed, 0.0)[0], stuck(tmp_path, seed, WAIT)
        assert at_once > 5.0, "it must have touched"
        assert -rig.values["force"] == pytest.approx(-rig.simulator.true_wrench("chalk")[5], rel=0.2)
        ratios.append(waited / at_once)
        if not ratios[-1] <= MOST:
            wrong.append(again(seed, "limit", f"{ratios[-1]:.2f} of {at_once:.1f} N"))
    tell("impact over that without a wait", max(ratios), most=MOST, why="\n".join(wrong))


def test_pressing_with_a_sensor_that_reads_nothing(tmp_path, tell):
    """For half a second it reads nothing, however it presses: no more than the proportional part comes of it."""
    rig = Rig(tmp_path, 0)
    rig.impact(700)
    before, most = rig.integral, -rig.values["force"] * (1.0 + rig.values["kp"])
    peak = max(rig.step(deaf=True) for _ in range(500))
    tell("peak over the command", peak / (most + before), most=1.1)  # a step of the command, and what rings after it
    assert rig.integral <= before - 0.01 * rig.values["ki"] * rig.values["force"]  # 0.01 s: until its filter says so
    assert rig.impact(300) <= MOST * peak


@pytest.mark.skipif(not LARGE, reason="half a minute: WBC_CAMPAIGN=large")
def test_ten_seconds_through_the_air(tmp_path, tell):
    at_once = Rig(tmp_path, 0).impact(700)
    rig = Rig(tmp_path, 0, height=0.2)
    waited = rig.impact(12000)
    tell("impact over that without a wait", waited / at_once, most=MOST)


def test_without_the_cure_it_strikes(tmp_path, monkeypatch):
    """The control: with an integral that grows whatever is felt, the same test fails."""
    advance = tasks.ForceTask.advance
    monkeypatch.setattr(
        tasks.ForceTask,
        "advance",
        lambda self, state, lam: advance(self, _always(state, self.contact), lam),
    )
    at_once, (waited, _) = stuck(tmp_path, 0, 0.0)[0], stuck(tmp_path, 0, 2.0)
    assert waited > 3.0 * at_once


def _always(state, contact):
    state.loops[contact] = state.loops[contact]._replace(pressed=True)
    return state


def test_what_a_loop_begins_with_is_unwound_while_it_waits(tmp_path):
    """It begins with what the last torque presses with, here nothing, and comes to its target without a contact."""
    rig = Rig(tmp_path, 1)
    for start in (1.0, -1.0):  # its target is below zero: the first is the way from nothing, the second beyond it
        rig.remember(np.array([start]))
        before = rig.integral
        rig.stand_still(1.0)
        assert rig.integral == (0.0 if start > 0.0 else pytest.approx(before, rel=1e-12))
