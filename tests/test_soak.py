"""A long run: memory stays flat, and the same seed gives the same torques; ten minutes by hand."""

from __future__ import annotations

import os

import pytest
import soak

SECONDS = 600.0 if os.environ.get("WBC_CAMPAIGN") == "large" else 20.0


@pytest.mark.timeout(7200)
@pytest.mark.parametrize("spec", ["eraser", "g1_stand"])
def test_memory_is_flat_and_the_last_tenth_is_bit_equal(spec, record_property):
    found = soak.twice(spec, SECONDS, seed=0)
    repeat = f"repeat: python benchmarks/soak.py {spec} --seconds {SECONDS:g}"
    record_property("memory growth [MB]", max(found["growth_mb"]))
    record_property("p99.9 of the tick on the processor [us]", found["us"]["p99.9"])
    assert max(found["growth_mb"]) <= soak.GROWTH, repeat
    assert found["bit_equal"], repeat
    assert set(found["status"]) <= {"OK", "LIMITED"}, repeat


def test_what_leaks_is_seen(monkeypatch):
    """The verdict on runs that grow, and on runs that part."""
    us = {"p50": 1.0, "p99": 1.0, "p99.9": 1.0}
    run = {"memory": [100.0] * 9 + [102.0], "digest": "a", "us": [us] * 10, "wall_us": us, "status": {"OK": 1}}
    run["floor_us"] = [1.0] * 10

    class Pool:
        def __init__(self, *args, **kwargs):
            pass

        def __enter__(self):
            return self

        def __exit__(self, *args):
            pass

        def map(self, function, *args):
            return self.runs

    monkeypatch.setattr(soak, "ProcessPoolExecutor", Pool)
    flat = run | {"memory": [100.0] * 10}
    for runs, ok in (([flat, flat], True), ([flat, run], False), ([flat, flat | {"digest": "b"}], False)):
        Pool.runs = runs
        assert soak.twice("eraser", 1.0, 0)["ok"] is ok
