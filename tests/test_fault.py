"""Fault plans: their lines in a spec and on the command line, what they do, and that a run that breaks down says when
(row 18)."""

from __future__ import annotations

import json
import re

import numpy as np
import pytest
from click.testing import CliRunner

from wbc.build import build
from wbc.cli import main
from wbc.errors import SpecError
from wbc.log import Log
from wbc.record import STATUS_NAMES
from wbc.run import run
from wbc.spec import load
from wbc.spec.fault import KINDS, planned


@pytest.fixture(scope="module")
def built():
    """The eraser, and a way to run it with some faults."""
    spec = load("eraser", ["duration=0.4"])

    def one(*faults, seed=0):
        return run(build(spec.with_set({"plant.faults": list(faults)}) if faults else spec), seed)

    return one


@pytest.fixture(scope="module")
def sound(built):
    return built().log


def statuses(result):
    return [STATUS_NAMES[int(i)] for i in result.log["status"]]


@pytest.mark.parametrize(
    ("text", "kind", "value", "window"),
    [
        ("sensor.dropout at 1.2 for 0.1", "sensor.dropout", None, (1200, 1300)),
        ("sensor.dropout at 1.2 s for 0.1 s", "sensor.dropout", None, (1200, 1300)),
        ("  solver.fail   at tick 500 for ever ", "solver.fail", None, (500, np.inf)),
        ("solver.fail at tick 0", "solver.fail", None, (0, 1)),
        ("solver.x 1e-2 at 0.5 for 3 ticks", "solver.x", 1e-2, (500, 503)),
        ("solver.x at 0.5", "solver.x", 1e-3, (500, 501)),
        ("state.time -0.5 at 1", "state.time", -0.5, (1000, 1001)),
        ("sensor.drift 2 at 1 for 1", "sensor.drift", 2.0, (1000, 2000)),
    ],
)
def test_a_line_is_read(text, kind, value, window):
    fault = planned(text)
    assert fault.kind == kind
    assert np.isnan(fault.value) if value is None else fault.value == value
    assert fault.window(1e-3) == window


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("sensor.dropout", "expected WHAT.HOW [VALUE] at TIME [for DURATION], such as"),
        ("", "expected a text that is not empty"),
        ("sensr.dropout at 1", "did you mean 'sensor.dropout'?"),
        ("sensor.dropout 3 at 1", "sensor.dropout takes no value (no wrench is measured), got '3'"),
        ("sensor.bias much at 1", "expected a number: force on every axis [N], got 'much'"),
        ("sensor.bias nan at 1", "expected a number: force on every axis [N], got 'nan'"),
        ("sensor.bias at -1", "expected a number of at least 0: a time [s], got '-1'"),
        ("sensor.bias at 1 for -2", "expected a number of at least 0: a duration [s], got '-2'"),
    ],
)
def test_a_wrong_line_is_told_in_its_place(text, said, tmp_path):
    file = tmp_path / "mine.yaml"
    file.write_text(f"robot: panda\nplant:\n  faults:\n    - {json.dumps(text)}\n")
    with pytest.raises(SpecError) as caught:
        load(file)
    (fault,) = caught.value.faults
    assert (fault.line, fault.key) == (4, "plant.faults[0]")
    assert said in fault.message
    if text:
        result = CliRunner().invoke(main, ["run", "eraser", "--headless", "--fault", text])
        assert result.exit_code == 2
        assert f"--fault: {said}" in result.output or said in result.output


EXPECTED = {  # kind -> (worst status while it lasts, ten ticks)
    "sensor.dropout": "LIMITED",  # told by name after five ticks without a reading
    "sensor.nan": "LIMITED",
    "solver.fail": "SAFE_HOLD",
    "solver.x": "SAFE_HOLD",
    "solver.signs": "OK",  # nothing is active: its multipliers are those of equalities, or zero
    "solver.stale": "SAFE_HOLD",
    "solver.leans": "SAFE_HOLD",
    "solver.nan": "SAFE_HOLD",
    "solver.shape": "SAFE_HOLD",
    "state.nan": "SAFE_HOLD",
    "state.shape": "SAFE_HOLD",
    "state.quaternion": "OK",  # there is none in an arm's q
    "simulator.missed": "DEGRADED",
}


@pytest.mark.parametrize("kind", [kind for kind in KINDS if kind not in ("simulator.nan", "simulator.reset")])
def test_every_kind_acts_when_planned_and_not_before(built, sound, kind):
    result = built(f"{kind} at 0.2 for 10 ticks")
    log, at = result.log, 200
    np.testing.assert_array_equal(log["tau"][:at], sound["tau"][:at])
    worst = max(log["status"][at : at + 12].astype(int))
    assert STATUS_NAMES[worst] == EXPECTED.get(kind, STATUS_NAMES[worst])
    changed = not np.array_equal(log["tau"][at : at + 20], sound["tau"][at : at + 20], equal_nan=True)
    assert changed != (kind in ("state.quaternion", "solver.signs"))
    assert np.isfinite(log["tau"]).all()
    assert log.meta["faults"] == [f"{kind} at 0.2 for 10 ticks"]


def test_a_plan_is_repeated_by_its_seed(built):
    plan = ("sensor.spikes 20 at 0.1 for 0.2", "state.nan at 0.25 for 2 ticks")
    first, again, other = built(*plan, seed=3), built(*plan, seed=3), built(*plan, seed=4)
    np.testing.assert_array_equal(first.log["tau"], again.log["tau"])
    assert not np.array_equal(first.log["tau"], other.log["tau"])


def test_a_mended_controller_has_its_solvers_back():
    made = build(load("eraser", ["duration=0.05", 'plant.faults=["solver.fail at 0.02"]']))
    solvers = made.controller.solvers
    result = run(made)
    assert made.controller.solvers == solvers
    assert statuses(result)[20] == "DEGRADED"


@pytest.mark.row(18)
@pytest.mark.parametrize(("fault", "why"), [("simulator.nan", "mjWARN_BADQPOS"), ("simulator.reset", "it was reset")])
def test_row_18_a_simulator_that_breaks_down_ends_the_run_and_says_when(fault, why, tmp_path, tell):
    args = ["run", "eraser", "--headless", "--json", "--duration", "0.6", "--out", str(tmp_path)]
    result = CliRunner().invoke(main, [*args, "--fault", f"{fault} at 0.3"])
    assert result.exit_code == 1
    summary = json.loads(result.stdout)
    said = float(re.search(r"the simulation broke down at t = (\d+\.\d+)", summary["broken"])[1])
    tell("said when, off by [s]", abs(said - 0.3), most=2e-3)
    assert why in summary["broken"]
    assert not summary["ok"]
    log = Log.load(tmp_path / "log.npz")
    assert log.size == summary["ticks"] == 300
    assert np.isfinite(log["tau"]).all()
    assert log["t"][-1] == pytest.approx(0.299)
    assert (tmp_path / "report.png").exists()


@pytest.mark.row(18)
def test_row_18_of_the_first_tick_too(tmp_path):
    args = ["run", "eraser", "--headless", "--json", "--duration", "0.2", "--out", str(tmp_path)]
    result = CliRunner().invoke(main, [*args, "--fault", "simulator.nan at 0"])
    assert result.exit_code == 1, result.output
    assert "broke down at t = 0.00" in json.loads(result.stdout)["broken"]


def test_faults_of_the_command_line_are_added_to_those_of_the_spec(tmp_path):
    args = ["run", "eraser", "--headless", "--json", "--duration", "0.1", "--out", str(tmp_path)]
    args += ["--set", 'plant.faults=["solver.fail at tick 20"]', "--fault", "solver.fail at tick 60"]
    CliRunner().invoke(main, args)
    status = Log.load(tmp_path / "log.npz")["status"]
    assert [STATUS_NAMES[int(status[i])] for i in (19, 20, 40, 60)] == ["OK", "DEGRADED", "OK", "DEGRADED"]
