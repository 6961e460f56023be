"""A run that tests share is the one that they would have made: in memory, and left by another process."""

import numpy as np
import runs


def test_another_process_finds_the_run_that_one_has_made(tmp_path, monkeypatch):
    monkeypatch.setenv(runs.FOLDER, str(tmp_path))
    wanted = ("wheel", "duration=0.05")
    runs.ran.cache_clear()
    made = runs.ran(*wanted)
    (file,) = tmp_path.iterdir()
    monkeypatch.setattr(runs, "_run", None)  # nothing more is run
    runs.ran.cache_clear()
    found = runs.ran(*wanted)
    assert found is not made
    assert found.finished.summary == made.finished.summary
    assert found.finished.log.active == made.finished.log.active
    for name in made.finished.log.names:
        np.testing.assert_array_equal(found.finished.log[name], made.finished.log[name])
    np.testing.assert_array_equal(found.joint("axle"), made.joint("axle"))
    assert np.ptp(made.joint("axle")) > 0.0
    assert file.stat().st_size > 0
    runs.ran.cache_clear()


def test_what_is_changed_is_another_run(tmp_path, monkeypatch):
    monkeypatch.setenv(runs.FOLDER, str(tmp_path))
    runs.ran.cache_clear()
    short, long = (runs.result("wheel", f"duration={seconds}") for seconds in (0.02, 0.03))
    assert (short.log.size, long.log.size) == (20, 30)
    runs.ran.cache_clear()
