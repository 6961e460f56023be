"""Pushed robots survive, as the README defines it, in eight directions."""

from __future__ import annotations

import math
import os

import bars
import pytest

from wbc.build import build
from wbc.run import run
from wbc.spec import load

LARGE = os.environ.get("WBC_CAMPAIGN") == "large"
TIME = 0.1  # [s] of a push
EIGHTHS = range(8) if LARGE else (0, 5)  # of a turn: forwards; and half backwards, half to the right


def pushed(name, ahead, aside, *more):
    """A run after a push [N s]."""
    wrench = f"{{fx: {ahead / TIME:.6g}, fy: {aside / TIME:.6g}}}"
    return run(build(load(name, [f"plant.pushes.shove.wrench={wrench}", "duration=3", *more])))


@pytest.mark.parametrize("eighth", EIGHTHS)
@pytest.mark.parametrize("name", bars.PUSHES)
def test_it_survives(name, eighth):
    ahead, aside = bars.PUSHES[name]
    angle = eighth * math.pi / 4
    finished = pushed(name, ahead * math.cos(angle), aside * math.sin(angle))
    figures = finished.summary["metrics"]
    assert finished.ok, [check for check in finished.summary["checks"] if not check["ok"]]
    for metric, bound in (bars.SPECS[name] | bars.ALWAYS).items():
        assert figures[metric] <= bound, metric


def test_what_falls_does_not_survive():
    finished = pushed("go2_push", 0.0, 60.0)
    missed = {check["name"] for check in finished.summary["checks"] if not check["ok"]}
    assert {"base.tilt.max", "recovery"} <= missed
