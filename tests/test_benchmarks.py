"""The benchmarks run, and measure what they say."""

from __future__ import annotations

import guards
import numpy as np


def test_what_is_taken_out_for_the_price_of_guards_stands_there_again():
    before = [getattr(owner, attribute) for owner, attribute, _ in guards.GUARDS]
    found = guards.guards("eraser", 60)
    assert found["ticks"] == 60
    assert np.isfinite([found["ratio"], found["more_us"]]).all()
    assert before == [getattr(owner, attribute) for owner, attribute, _ in guards.GUARDS]
