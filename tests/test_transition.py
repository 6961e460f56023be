"""The state machine of the phases, without a robot: readings are played from lists, one value a tick."""

from __future__ import annotations

import math

import pytest

from wbc.transition import LOST_SHARE, LOST_TICKS, STOP, Change, Condition, Exit, Watch, after

DT = 0.001


def reading(key):
    return lambda state: state[key]


def play(exit_, ticks, **values):
    """(tick, change) of the first way out taken; `values`: quantity -> a number, or one of each tick."""
    watch = Watch()
    for i in range(ticks):
        state = {key: value[i] if isinstance(value, list) else value for key, value in values.items()}
        watch, change = exit_.step(watch, i * DT, state)
        if change is not None:
            assert watch == Watch()  # the next phase starts from nothing
            return i, change
    return None


def until(*conditions, **more):
    return Exit(conditions, "next", **more)


def test_a_time_ends_a_phase_at_its_tick_and_not_before():
    for time in (0.001, 0.01, 0.3, 0.7):
        tick, change = play(after(time, "next"), 1000)
        assert tick == round(time / DT)
        assert change.to == "next"
        assert "time" in change.why


@pytest.mark.parametrize(
    ("low", "high", "inside", "outside"),
    [
        (-math.inf, -1.0, [-1.0, -7.0], [-0.999, 3.0]),
        (2.0, math.inf, [2.0, 9.0], [1.999]),
        (0.0, 1.0, [0.5], [-0.1, 1.1]),
    ],
)
def test_bounds_include_their_ends(low, high, inside, outside):
    way = until(Condition("f", reading("f"), low, high))
    for value in inside:
        assert play(way, 3, f=value) is not None
    for value in outside:
        assert play(way, 3, f=value) is None


def test_what_is_not_measured_never_holds():
    assert play(until(Condition("f", reading("f"), -math.inf, math.inf)), 5, f=math.nan) is None


def test_a_condition_must_hold_without_a_gap():
    way = until(Condition("f", reading("f"), high=-1.0, duration=0.003))
    touch = [0, -2, -2, -2, 0, -2, -2, -2, -2, -2]
    assert play(way, 10, f=touch)[0] == 8  # from tick 5 on, 3 ms later
    assert play(way, 8, f=touch) is None
    assert play(way, 10, f=[*touch[:7], math.nan, *touch[8:]]) is None


def test_all_conditions_must_hold_together_each_for_its_own_time():
    way = until(Condition("a", reading("a"), low=1.0, duration=0.002), Condition("b", reading("b"), low=1.0))
    assert play(way, 5, a=[0, 1, 1, 1, 1], b=[1, 1, 1, 0, 1])[0] == 4
    assert play(way, 5, a=1, b=0) is None


def test_the_time_out_says_what_was_waited_for_and_leads_where_it_is_told():
    waited = until(Condition("f", reading("f"), high=-1.0), Condition("g", reading("g"), high=1.0), timeout=0.005)
    tick, change = play(waited, 10, f=0.25, g=0.5)
    assert (tick, change.to) == (5, STOP)
    assert "timeout after 0.005 s" in change.why
    assert "f = 0.25" in change.why
    assert "g" not in change.why.replace("with", "")
    assert play(until(timeout=0.005, otherwise="back"), 10)[1].to == "back"


def test_conditions_come_before_the_time_out_and_a_loss_before_both():
    way = until(Condition("f", reading("f"), low=0.0), timeout=0.0, lost="gone", pressing=(("board", reading("p")),))
    assert play(way, 1, f=0.0, p=1.0)[1].to == "next"
    watch = Watch((), (LOST_TICKS - 1,))
    _, change = way.step(watch, 0.0, {"f": 0.0, "p": 0.0})
    assert change == Change("gone", change.why, "board")


class TestLoss:
    way = Exit(lost="gone", pressing=(("left", reading("left")), ("right", reading("right"))))

    def test_takes_so_many_ticks_in_a_row(self):
        share = [1.0] * 3 + [0.0] * (LOST_TICKS - 1) + [1.0] + [0.0] * LOST_TICKS
        tick, change = play(self.way, len(share), left=share, right=1.0)
        assert tick == len(share) - 1
        assert (change.to, change.lost) == ("gone", "left")
        assert "left" in change.why

    def test_is_of_what_was_touched_before(self):
        assert play(self.way, 50, left=0.0, right=0.0) is None
        assert play(self.way, 50, left=[0.0] * 40 + [0.5] + [0.0] * 9, right=0.0)[0] == 40 + LOST_TICKS

    def test_is_less_than_a_share_of_the_force(self):
        touched = [1.0] * 5
        assert play(self.way, 50, left=touched + [LOST_SHARE] * 45, right=1.0) is None
        assert play(self.way, 50, left=touched + [LOST_SHARE - 1e-6] * 45, right=1.0)[0] == 4 + LOST_TICKS
        assert play(self.way, 50, left=touched + [-0.2] * 45, right=1.0)[0] == 4 + LOST_TICKS  # of noise, or of a load
        assert play(self.way, 50, left=touched + [-1.0] * 45, right=1.0) is None  # a wrong sensor: `wbc.guard` tells

    def test_is_not_told_from_a_missing_measurement(self):
        assert play(self.way, 50, left=[1.0] * 5 + [math.nan] * 45, right=math.nan) is None

    def test_without_a_way_out_the_phase_goes_on(self):
        alone = Exit(pressing=self.way.pressing)
        assert play(alone, 50, left=[1.0] * 5 + [0.0] * 45, right=1.0) is None


def test_the_memory_is_a_value_that_can_be_taken_up_again():
    way = until(Condition("f", reading("f"), high=-1.0, duration=0.004), lost="gone", pressing=(("b", reading("p")),))
    values = [{"f": -2.0, "p": p} for p in (1.0, 0.0, 0.0, 0.05, 1.0, 0.0)]
    watch, seen = Watch(), []
    for i, state in enumerate(values):
        watch, change = way.step(watch, i * DT, state)
        seen.append((watch, change))
    watch = seen[2][0]
    for i in range(3, 6):
        again = way.step(watch, i * DT, values[i])
        assert again == seen[i]
        watch = again[0]


def test_the_phases_that_it_may_lead_to():
    assert Exit().targets == ()
    assert after(1.0, "b").targets == ("b",)
    assert until(Condition("f", reading("f")), timeout=1.0, otherwise="c", lost="next").targets == ("next", "c")
    assert Exit((), "next", lost="d").targets == ("d",)
