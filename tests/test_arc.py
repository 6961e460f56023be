"""References of one number and along an arc: their derivatives, and what is wrong with them, in its place."""

from __future__ import annotations

import numpy as np
import pytest

from wbc import load
from wbc.build import build
from wbc.errors import SpecError
from wbc.reference import arc, quintic


@pytest.mark.parametrize("radius", [0.2, -0.5])
def test_an_arc_heads_along_itself(radius):
    along, dt = arc(radius, quintic((0.0, 2.0, 4.0), (-0.6, 0.8, 0.1))), 1e-5
    for t in (0.3, 1.1, 2.7, 3.6):
        values = {axis: scalar(t) for axis, scalar in along.items()}
        for axis, (_, rate, bend) in values.items():
            before, after = along[axis](t - dt), along[axis](t + dt)
            assert rate == pytest.approx((after[0] - before[0]) / (2 * dt), abs=1e-8)
            assert bend == pytest.approx((after[1] - before[1]) / (2 * dt), abs=1e-8)
        heading, v = values[2][0], np.array([values[3][1], values[4][1]])
        assert v @ [-np.sin(heading), np.cos(heading)] == pytest.approx(0, abs=1e-12)  # nothing sideways
        assert np.hypot(values[3][0], values[4][0] - radius) == pytest.approx(abs(radius))


@pytest.mark.parametrize(
    ("spec", "change", "message"),
    [
        ("wheel", "references.bend.arc.radius=0", r"references\.bend\.arc\.radius: expected a radius other than 0"),
        ("wheel", "references.bend.arc.times=[0, 5]", r"arc\.times: expected 3 times, one a heading, got 2"),
        ("wheel", "references.bend.arc.times=[0, 5, 4]", r"arc\.times\[2\]: expected a time after 5 s, got 4"),
        ("door", "references.open.profile.times=[0, 4]", r"profile\.times: expected 3 times, one a value, got 2"),
        ("door", "references.open.profile.times=[0, 4, 4]", r"profile\.times\[2\]: expected a time after 4 s, got 4"),
        (
            "force_damped",
            "references.middle={profile: {values: [0, 1], times: [0, 1]}}",
            r"tasks\.stay\.target: reference 'middle' is a number; expected a motion",
        ),
    ],
)
def test_what_is_wrong_is_told_in_its_place(spec, change, message):
    with pytest.raises(SpecError, match=message):
        build(load(spec, [change]))
