"""The comparison on a fifth of a second of the eraser: every solver, and some that lie."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console
from unruly import Killed, Never

import wbc
from tests.bars import TAU_ERROR
from wbc.build import build
from wbc.compare import compare, record, table
from wbc.errors import ProblemError, SolverError
from wbc.qp import certify
from wbc.solver import TOLERANCE, Daqp, answer, installed

SHORT = ["duration=0.2"]


@pytest.fixture(scope="module")
def recorded():
    return record(build(wbc.load("eraser", SHORT)))


@pytest.fixture(scope="module")
def result(recorded):
    return compare(recorded[::4], installed(), passes=2)


class Changed:
    """DAQP whose answers are changed on every second problem."""

    def __init__(self, change):
        self.inner, self.change, self.asked = Daqp(), change, 0

    def solve(self, problem):
        self.asked += 1
        x, z = self.inner.solve(problem)
        return self.change(x, z) if self.asked % 2 else (x, z)


# --- recording ---


def test_what_is_recorded_reproduces_the_torque_of_the_run(recorded):
    """Against the log of the same run: the torque that was sent, at every recorded tick."""
    from wbc.run import run

    log = run(build(wbc.load("eraser", SHORT))).log
    for item in recorded:
        tick = int(np.argmin(np.abs(log["t"] - item.t)))
        tau = item.torque(answer(Daqp(), item.problem).x)
        np.testing.assert_allclose(tau, log["tau"][tick], atol=1e-9 * (1 + np.abs(tau).max()))


def test_recorded_ticks_are_spread_over_the_run_and_all_limited_ones_are_there(recorded):
    times = np.array([item.t for item in recorded])
    assert (np.diff(times) > 0).all()
    assert (np.diff(times) < 0.0025).all()  # half of 200, over 200 ticks
    assert {item.spec for item in recorded} == {"eraser"}
    limited = [item for item in recorded if item.active]
    assert len(limited) == 5
    assert all(name.startswith("torque_rate[") for item in limited for name in item.active)


def test_recorded_problems_are_values(recorded):
    one, other = recorded[0], recorded[1]
    assert not np.shares_memory(one.problem.stack, other.problem.stack)
    assert not np.shares_memory(one.h, other.h)
    assert np.abs(one.problem.g - other.problem.g).max() > 0


@pytest.mark.parametrize(("every", "most", "evenly", "limited"), [(20, 200, 10, 4), (1, 20, 10, 4), (1, 6, 3, 2)])
def test_how_many_are_kept_is_bounded(every, most, evenly, limited):
    kept = record(build(wbc.load("eraser", SHORT)), every=every, most=most)
    assert len(kept) == evenly + limited  # the first tick is limited too
    assert kept[-1].t > 0.13  # however few there are, they reach to the end


def test_progress_is_told():
    told = []
    record(build(wbc.load("eraser", SHORT)), progress=told.append)
    assert told == [50, 100, 150, 200]


def test_what_moves_the_torque_by_a_thousandth_is_refused(recorded, rng):
    """Also along the weakest direction, and with multipliers of the equalities that hide the mutation best.

    A dual residual r moves the torque by at most |T Z (Z' H Z)^-1 Z'| r, Z the motions that the equalities leave.
    """
    for item in recorded[::5]:
        p = item.problem
        n, n_eq = p.g.size, p.n_eq
        x, z = Daqp().solve(p)
        Z = np.linalg.svd(p.C[:n_eq])[2][n_eq:].T
        reduced = Z.T @ p.H @ Z
        bound = np.linalg.norm(item.T @ Z @ np.linalg.solve(reduced, Z.T), 2)
        assert bound * TOLERANCE.dual < 1e-5  # [N m]: what an accepted answer can be wrong by
        weakest = Z @ np.linalg.eigh(reduced)[1]
        for direction in (*np.eye(n), *weakest.T, *rng.normal(size=(10, n)), *(Z @ rng.normal(size=(n - n_eq, 10))).T):
            moved = np.abs(item.T @ direction).max()
            if moved < 1e-6:
                continue
            step = direction * 1e-3 / moved
            hidden = z.copy()
            hidden[n : n + n_eq] -= np.linalg.lstsq(p.C[:n_eq].T, p.H @ step)[0]
            for multipliers in (z, hidden):
                assert not certify(p, x + step, multipliers).holds(TOLERANCE)


# --- comparing ---


def test_every_installed_solver_has_an_entry(result):
    assert list(result["solvers"]) == installed()
    for row in result["solvers"].values():
        assert row["solved"] + row["wrong"] + row["refused"] == result["problems"]
        assert 0 < row["us"]["p50"] <= row["us"]["p99"] <= row["us"]["max"]


@pytest.mark.parametrize("name", TAU_ERROR)
def test_the_direct_solvers_solve_all_within_their_bars(result, name):
    row = result["solvers"][name]
    assert row["solved"] == result["problems"]
    assert row["retried"] == 0
    assert row["max_tau_error"] <= TAU_ERROR[name] * (1 + result["tau_max"])
    assert row["max_kkt_residual"] <= 1e-6


def test_no_solver_is_wrong_with_the_settings_it_is_given(result):
    for name, row in result["solvers"].items():
        assert row["wrong"] == 0, name
        if row["solved"] == result["problems"]:
            assert row["max_tau_error"] < 1e-6, name


def test_the_result_is_json_and_a_table(result):
    assert json.loads(json.dumps(result, allow_nan=False)) == result
    console = Console(width=140)
    with console.capture() as capture:
        console.print(table(result))
    text = capture.get()
    assert f"{result['problems']} quadratic programs" in text
    assert all(name in text for name in result["solvers"])


@pytest.mark.parametrize(
    ("change", "least", "most"),
    [
        (lambda x, z: (x + 1e-3, z), 1e-4, 1.0),
        (lambda x, z: (np.zeros_like(x), np.zeros_like(z)), 0.1, 100.0),
        (lambda x, z: (x, z + 1e-3), 0.0, 1e-9),  # the right torque, for a wrong reason
        (lambda x, z: (x * np.nan, z), None, None),
        (lambda x, z: (x[:-1], z), None, None),
        (lambda x, z: None, None, None),
    ],
)
def test_a_liar_is_counted_wrong(recorded, change, least, most):
    row = compare(recorded[:10], {"liar": Changed(change), "daqp": "daqp"}, passes=1)["solvers"]["liar"]
    assert (row["solved"], row["wrong"], row["refused"]) == (5, 5, 0)
    if least is None:
        assert row["max_tau_error"] is None
    else:
        assert least <= row["max_tau_error"] <= most
    json.dumps(row, allow_nan=False)


def test_a_solver_that_gives_up_is_counted_refused(recorded):
    def give_up(x, z):
        raise SolverError("too hard")

    row = compare(recorded[:10], {"lazy": Changed(give_up)}, passes=1)["solvers"]["lazy"]
    assert (row["solved"], row["wrong"], row["refused"]) == (5, 0, 5)
    assert row["max_tau_error"] < 1e-9


def test_a_retry_from_cold_is_counted_and_timed(recorded):
    class Forgetful(Changed):
        def restart(self):
            pass

    row = compare(recorded[:10], {"f": Forgetful(lambda x, z: (x + 1, z))}, passes=1)["solvers"]["f"]
    assert row["solved"] == 10
    assert row["retried"] >= 5


def test_without_a_certified_answer_there_is_no_torque_to_compare_with(recorded):
    class Lost:
        def solve(self, problem):
            return np.ones_like(problem.g), np.zeros_like(problem.lo)

    result = compare(recorded[:3], [Lost()])
    assert result["tau_max"] == 0.0
    row = result["solvers"]["Lost"]
    assert (row["wrong"], row["max_tau_error"]) == (3, None)
    assert row["max_kkt_residual"] > 1


def test_the_reference_is_better_than_a_lone_solver(recorded):
    """Against itself a solver has no error; against the polished answer it does."""
    rough = compare(recorded[:20], ["proxqp"], passes=1)["solvers"]["proxqp"]
    assert 0 < rough["max_tau_error"] < 1e-6


def test_objects_of_one_class_get_names_of_their_own(recorded):
    result = compare(recorded[:2], [Daqp(), Daqp(), Daqp(), "daqp"], passes=1)
    assert list(result["solvers"]) == ["Daqp", "Daqp 2", "Daqp 3", "daqp"]


def test_bad_input_is_said(recorded):
    with pytest.raises(ProblemError, match="no problems to compare"):
        compare([], ["daqp"])
    with pytest.raises(SolverError, match="did you mean 'daqp'"):
        compare(recorded[:1], ["dqp"])
    with pytest.raises(SolverError, match="no solvers"):
        compare(recorded[:1], [])
    for timeout in (0.0, -1.0, np.nan, np.inf):
        with pytest.raises(SolverError, match="expected a time above 0"):
            compare(recorded[:1], ["daqp"], timeout=timeout)


def test_strict_levels_are_no_one_problem():
    with pytest.raises(ProblemError, match="expected hierarchy: weighted"):
        record(build(wbc.load("eraser", (*SHORT, "hierarchy=strict"))))


def test_compare_tells_progress(recorded):
    """From its first pass on, in problems."""
    told = []
    compare(recorded[:25], ["daqp"], passes=2, progress=told.append)
    assert told == [5, 10, 12, 17, 22, 25]
    told.clear()
    compare(recorded[:20], {"a": Daqp(), "b": Daqp()}, passes=1, progress=told.append)
    assert told == [5, 10, 15, 20]


def test_a_recorded_answer_is_certified_after_the_run(recorded):
    for item in recorded[:10]:
        x, z = Daqp().solve(item.problem)
        assert max(certify(item.problem, x, z)) < 1e-9


# --- processes ---


def gone(pid, within=5.0):
    end = time.monotonic() + within
    while time.monotonic() < end:
        try:
            os.kill(pid, 0)
        except ProcessLookupError:
            return True
        time.sleep(0.01)
    return False


def test_what_never_answers_is_refused_in_time_and_the_rest_goes_on(recorded, tmp_path):
    file = tmp_path / "pid"
    compare(recorded[:1], ["daqp"], passes=1)  # starts what processes come from
    began = time.monotonic()
    result = compare(recorded[:25], {"never": Never(file=file), "daqp": "daqp"}, passes=2, timeout=0.2)
    assert time.monotonic() - began < 15.0  # one to warm up and five problems wait, 0.2 s each
    never, daqp = result["solvers"].values()
    assert (never["refused"], never["timed_out"], never["solved"], never["crashed"]) == (25, 25, 0, 0)
    assert never["us"]["p50"] >= 0.2e6
    assert (daqp["solved"], daqp["timed_out"], daqp["max_tau_error"] < 1e-9) == (25, 0, True)
    assert result["timeout"] == never["timeout"] == daqp["timeout"] == 0.2
    assert result["ok"]
    assert gone(int(file.read_text()))
    console = Console(width=200)
    with console.capture() as capture:
        console.print(table(result))
    assert "25 (25 too late)" in capture.get()
    assert "at most 0.2 s each" in capture.get()


def test_after_a_problem_that_it_never_answers_a_solver_goes_on(recorded):
    """In a new process, which was asked one problem to warm up: its third is the second of the others."""
    never = compare(recorded[:5], {"n": Never(3)}, passes=2, timeout=0.3)["solvers"]["n"]
    assert (never["solved"], never["refused"]) == (1, 4)  # of the first pass 1 and 3, of the second 0 and 4
    assert never["timed_out"] == 4
    assert never["max_tau_error"] < 1e-9


def test_a_solver_that_ends_its_process_is_refused_and_goes_on(recorded):
    row = compare(recorded[:12], {"k": Killed(recorded[3].problem)}, passes=2)["solvers"]["k"]
    assert (row["solved"], row["refused"], row["crashed"], row["timed_out"]) == (11, 1, 1, 0)


def test_answers_are_the_same_in_a_process_of_its_own(recorded):
    """To the bit; those of ProxQP depend on where arrays stand, by rounding."""
    names = ["daqp", "daqp (plain)", "proxqp"]
    here, there = (compare(recorded[::5], names, passes=1, timeout=each)["solvers"] for each in (None, 10.0))
    for name in names:
        assert (here[name]["timeout"], there[name]["timeout"]) == (None, 10.0)
        for key in ("solved", "retried", "tolerance", *(("certified", "kinds") if name != "proxqp" else ())):
            assert here[name][key] == there[name][key], (name, key)
    for key, value in here["proxqp"]["certified"].items():
        assert abs(value - there["proxqp"]["certified"][key]) < 1e-10, key


def test_an_object_that_cannot_be_pickled_is_asked_in_this_process(recorded):
    mine = Changed(lambda x, z: (x, z))
    row = compare(recorded[:5], {"mine": mine}, passes=1, timeout=5.0)["solvers"]["mine"]
    assert row["timeout"] is None
    assert row["solved"] == 5
    assert mine.asked == 6  # of them one to warm up


SCRIPT = """
import signal, sys
signal.signal(signal.SIGINT, signal.default_int_handler)  # ignored where tests run in the background
from wbc.compare import compare, corpus
from unruly import Loud, Never
compare(corpus.load()[:5], {"daqp": "daqp", "loud": Loud(), "never": Never(file=sys.argv[1])}, timeout=60.0)
"""


@pytest.mark.parametrize("how", [signal.SIGINT, signal.SIGKILL])
def test_who_ends_a_comparison_ends_all_of_it(tmp_path, how):
    """Also when nothing could be tidied up any more. What solvers print goes to stderr."""
    file = tmp_path / "pid"
    tests = Path(__file__).parent
    env = os.environ | {"PYTHONPATH": os.pathsep.join(map(str, (tests, tests.parent)))}
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
    running = subprocess.Popen([sys.executable, "-c", SCRIPT, str(file)], **pipes, env=env, text=True)
    end = time.monotonic() + 100.0
    while not (file.exists() and file.read_text()) and running.poll() is None and time.monotonic() < end:
        time.sleep(0.05)
    pid = int(file.read_text())
    running.send_signal(how)
    out, err = running.communicate(timeout=20.0)
    assert running.returncode != 0
    assert gone(pid)
    assert err.count("Traceback") == (how == signal.SIGINT)  # that of the script itself
    assert (out, "hear me" in err) == ("", True)
