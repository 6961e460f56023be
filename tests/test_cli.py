"""The commands as a script sees them: one JSON object on stdout, exit status, files.

And every way to be wrong that only the robot can tell, each refused with its place and what to do.
"""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from wbc import cli
from wbc.build import build
from wbc.errors import SpecError
from wbc.resources import shipped_folder
from wbc.robot import Robot
from wbc.spec import load
from wbc.verify import STATES

ERASER = (shipped_folder("tasks") / "eraser.yaml").read_text()
PLANAR = (shipped_folder("tasks") / "planar.yaml").read_text()
NOISY = (shipped_folder("tasks") / "eraser_noisy.yaml").read_text()

HOLDS = """robot: panda
tool: eraser
contacts:
  grip: {frame: eraser, holds: all, artificial: {wrench: {fz: -1}}}
tasks:
  press: {type: force, contact: grip, kp: 0.1}
"""
REACH = """robot: panda
references: {path: {line: {from: [0.5, 0, 0.5], to: [0.5, 0.1, 0.5], time: 1}}}
tasks:
  reach: {type: motion, frame: flange, target: path, axes: [vx, vy, vz], kp: 100, kd: 20}
"""
DOOR = """robot: panda
scene: board
references: {open: {circle: {radius: 0.1, period: 2}}}
contacts:
  handle: {frame: flange, free: {swing: {screw: {axis: z, through: board}}}, artificial: {swing: open}}
tasks:
  swing: {type: motion, contact: handle, kp: 100, kd: 20}
"""
STILL = DOOR.replace("swing: open", "swing: 0.1").replace(DOOR.splitlines()[2] + "\n", "")


def edited(text: str, *edits: tuple[str, str]) -> str:
    for old, new in edits:
        assert text.count(old) == 1, f"{old!r} stands {text.count(old)} times in the spec"
        text = text.replace(old, new)
    return text


def wbc(*arguments: object):
    """(exit status, stdout, stderr); a traceback of a command fails the test."""
    done = CliRunner().invoke(cli.main, [str(argument) for argument in arguments])
    if done.exception is not None and not isinstance(done.exception, SystemExit):
        raise done.exception
    return done.exit_code, done.stdout, done.stderr


def said(*arguments: object, status: int = 0):
    """What a command prints with --json: exactly one object, and nothing else on stdout."""
    code, out, err = wbc(*arguments, "--json")
    assert code == status, err
    assert out.count("\n") == 1
    return json.loads(out, parse_constant=lambda word: pytest.fail(f"{word} is no JSON"))


def written(folder: Path, text: str, name: str = "wrong.yaml") -> Path:
    file = folder / name
    file.write_text(text)
    return file


# --- Commands --------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory):
    """(folder, what was said) of a short run with noise."""
    folder = tmp_path_factory.mktemp("run") / "a" / "b"
    spec = written(folder.parents[1], edited(NOISY, ("settle: 1.0 ", "settle: 0.0 "), ("error: 0.05 ", "error: 5 ")))
    return folder, said("run", spec, "--headless", "--duration", 0.05, "--seed", 3, "--out", folder)


def test_run_says_what_the_contract_names(finished) -> None:
    _, summary = finished
    assert {"spec", "ok", "ticks", "sim_seconds", "wall_seconds", "metrics", "checks", "status", "step_us"} <= set(
        summary
    )
    assert (summary["spec"], summary["ok"], summary["ticks"]) == ("wrong", True, 50)
    assert summary["sim_seconds"] == pytest.approx(0.05)
    assert summary["checks"][0] | {"value": 0} == {"name": "board.fz.rms_error", "value": 0, "bound": 5, "ok": True}
    assert 0 < summary["checks"][0]["value"] == summary["metrics"]["board.fz.rms_error"]
    assert sum(summary["status"].values()) == 50
    assert summary["step_us"]["p50"] <= summary["step_us"]["p99"] <= summary["step_us"]["max"]


def test_run_writes_what_numpy_alone_can_read(finished) -> None:
    folder, summary = finished
    assert sorted(file.name for file in folder.iterdir()) == ["log.npz", "report.png", "summary.json"]
    assert json.loads((folder / "summary.json").read_text()) == summary
    assert (folder / "report.png").read_bytes().startswith(b"\x89PNG")
    with np.load(folder / "log.npz", allow_pickle=False) as log:
        assert log["tau"].shape == (50, 7)
        assert json.loads(str(log["meta"]))["seed"] == 3


def test_same_seed_same_log_other_seed_other_log(finished, tmp_path: Path) -> None:
    folder, _ = finished
    spec = folder.parents[1] / "wrong.yaml"
    with np.load(folder / "log.npz") as log:
        first = {name: log[name] for name in log.files if name not in ("step_us", "meta")}
    for seed, same in ((3, True), (4, False)):
        said("run", spec, "--headless", "--duration", 0.05, "--seed", seed, "--out", tmp_path / str(seed))
        with np.load(tmp_path / str(seed) / "log.npz") as log:
            assert (
                all(
                    np.array_equal(log[name], value, equal_nan=value.dtype.kind == "f") for name, value in first.items()
                )
                is same
            )


def test_run_that_misses_a_bound(tmp_path: Path) -> None:
    text = edited(ERASER, ("settle: 1.0 ", "settle: 0.0 "), ("fz.rms_error: 0.005 ", "fz.rms_error: 1e-9 "))
    spec = written(tmp_path, text)
    summary = said("run", spec, "--headless", "--duration", 0.01, "--out", tmp_path / "out", status=1)
    assert summary["ok"] is False
    assert "board.fz.rms_error" in [check["name"] for check in summary["checks"] if not check["ok"]]
    code, out, _ = wbc("run", spec, "--headless", "--duration", 0.01, "--out", tmp_path / "out")
    assert code == 1
    assert "FAILED" in out
    assert "missed" in out


def test_run_with_another_solver_and_set(tmp_path: Path) -> None:
    """What is set is what is built, and the other solver's answers are its own."""
    logs = []
    for change in ((), ("--solver", "proxqp"), ("--set", "contacts.board.artificial.fz=-12")):
        said("run", "eraser", "--headless", "--duration", 0.01, "--out", tmp_path / "out", *change, status=1)
        with np.load(tmp_path / "out" / "log.npz") as log:
            logs.append({name: log[name] for name in ("tau", "board.target")})
    np.testing.assert_allclose(logs[0]["tau"], logs[1]["tau"], rtol=1e-4, atol=1e-4)
    assert (logs[0]["tau"] != logs[1]["tau"]).any()
    assert logs[2]["board.target"][0, 2] == -12


def test_check() -> None:
    report = said("check", "eraser")
    assert {"spec", "ok", "faults", "model_error", "feasible", "poles"} <= set(report)
    assert (report["spec"], report["ok"], report["faults"], report["feasible"]) == ("eraser", True, [], True)
    assert report["model_error"] < 1e-8
    assert all(set(pole) == {"contact", "axis", "stiffness", "radius"} for pole in report["poles"])
    assert {pole["axis"] for pole in report["poles"] if pole["stiffness"] is None} == {"mx", "my", "fz"}
    code, out, _ = wbc("check", "planar")
    assert code == 0
    assert "damping uses" in out
    assert "eraser: ok" not in out


def test_check_of_a_start_that_the_motors_cannot_hold() -> None:
    report = said("check", "eraser", "--set", "limits.torque=5", status=1)
    assert report["ok"] is report["feasible"] is False
    assert report["reason"]


def test_verify_and_compare() -> None:
    certificate = said("verify", "planar", "--set", "duration=0.01")
    assert certificate["states"] + certificate["dropped"] == STATES
    keys = {"spec", "ok", "states", "dropped", "lifted", "max_tau_error_mujoco", "laws"}
    assert keys <= set(certificate)
    assert set(certificate["laws"]) == {"compensated", "book"}
    worst = {"max_tau_error", "max_vdot_error", "max_lambda_error", "max_kkt_residual"}
    assert all(worst <= set(law) for law in certificate["laws"].values())
    table = said("compare", "planar", "--solvers", "daqp,proxqp", "--set", "duration=0.02", "--set", "hierarchy=strict")
    assert table["problems"] > 0
    assert set(table["solvers"]) == {"daqp", "proxqp"}
    figures = {"solved", "wrong", "max_tau_error", "max_kkt_residual", "us"}
    assert all(figures <= set(found) for found in table["solvers"].values())


def test_compare_records_to_a_file_and_reads_it(tmp_path: Path) -> None:
    file, short = tmp_path / "met.npz", ("--set", "duration=0.02")
    told = said("compare", "planar", *short, "--record", file)
    assert told["bytes"] == file.stat().st_size
    chosen = ("--solvers", "daqp,daqp (plain),osqp (default)", "--timeout", 20)
    found = said("compare", file, *chosen, "--out", tmp_path / "out")
    assert found["problems"] == told["problems"] > 0
    assert (found["timeout"], found["solvers"]["daqp"]["timed_out"]) == (20.0, 0)
    assert found["ok"]
    assert set(found["solvers"]) == {"daqp", "daqp (plain)", "osqp (default)"}
    assert json.loads((tmp_path / "out" / "compare.json").read_text()) == found
    assert (tmp_path / "out" / "compare.png").stat().st_size > 10_000
    assert "expected a SPEC to change" in said("compare", *short, status=2)["faults"][0]["message"]


def test_schema() -> None:
    code, out, _ = wbc("schema", "--json")
    assert code == 0
    assert "robot" in json.loads(out)["properties"]


def python(code: str, *arguments: object) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-c", code, *map(str, arguments)], capture_output=True, text=True, check=False
    )


def test_help_imports_nothing_heavy() -> None:
    code = """
import sys
from wbc.cli import main
main(["--help"], standalone_mode=False)
print([name for name in ("numpy", "mujoco", "pinocchio", "scipy", "rich", "pydantic", "yaml") if name in sys.modules])
"""
    done = python(code)
    assert done.stdout.endswith("[]\n"), done.stderr
    assert all(command in done.stdout for command in ("run", "check", "verify", "compare", "schema", "doctor"))


def test_a_process_of_its_own(tmp_path: Path) -> None:
    """Exit status and streams as a shell sees them."""
    spec = written(tmp_path, ERASER.replace("frame: eraser", "frame: earser"))
    done = python("from wbc.cli import main; main()", "check", spec, "--json")
    assert done.returncode == 2
    assert json.loads(done.stdout)["faults"][0]["key"] == "contacts.board.frame"
    assert done.stderr.startswith(f"{spec}:12:5: contacts.board.frame: no frame named 'earser'")
    assert "Traceback" not in done.stderr


# --- Where things are ------------------------------------------------------------------------------------------------


def test_a_spec_brings_its_own_robot(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Files are named from the folder of the spec, wherever the command is called; shipped names still hold."""
    (tmp_path / "here").mkdir()
    (tmp_path / "there").mkdir()
    arm = (shipped_folder("scenes") / "robots" / "planar3r.xml").read_text()
    written(tmp_path / "there", arm, "arm.xml")
    written(tmp_path / "there", PLANAR.replace("robot: planar3r", "robot: arm.xml"), "own.yaml")
    monkeypatch.chdir(tmp_path / "here")
    report = said("check", "../there/own.yaml")
    assert (report["spec"], report["ok"]) == ("own", True)
    assert report["poles"] == said("check", "planar")["poles"]
    said("run", "../there/own.yaml", "--headless", "--duration", 0.005, status=1)
    assert (tmp_path / "here" / "runs" / "own" / "summary.json").is_file()


def test_a_folder_that_cannot_be_written_is_told_before_the_run(tmp_path: Path) -> None:
    file = written(tmp_path, "in the way")
    for out in (file, file / "below"):
        found = said("run", "eraser", "--headless", "--out", out, status=2)
        assert found["faults"][0]["message"].startswith(f"--out {out}: cannot be made: ")
        assert found["faults"][0]["message"].endswith("choose another folder")


def test_brackets_are_text(tmp_path: Path) -> None:
    """Titles and names reach the terminal as they are, also where they look like markup."""
    spec = written(
        tmp_path, ERASER.replace("title: Erase", "title: '[/red] [bold]Erase").replace("= 3)", "= 3)'"), "[b].yaml"
    )
    code, out, _ = wbc("run", spec, "--headless", "--duration", 0.005, "--out", tmp_path / "[red]")
    assert code == 1
    assert "[b]: FAILED" in out
    assert "[red]" in out


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("run", "earser"), "no such file, and no shipped spec of that name; did you mean 'eraser'?"),
        (("check", "no/such.yaml"), "no such file"),
        (("check", "."), "is not a regular file"),
        (("run", "eraser", "--duration", "nan"), "duration: expected a number [s], got 'nan'"),
        (("run", "eraser", "--duration", "-1"), "duration: expected a number greater than 0 [s], got -1.0"),
        (("run", "eraser", "--solver", "dapq"), "solver: no solver named 'dapq'; did you mean 'daqp'?"),
        (("check", "eraser", "--solver", ""), "solver: expected a text, got nothing"),
        (("verify", "eraser", "--solver", "dapq"), "did you mean 'daqp'?"),
        (("compare", "eraser", "--solvers", "dapq", "--set", "duration=0.01"), "did you mean 'daqp'?"),
        (("compare", "eraser", "--solvers", ",", "--set", "duration=0.01"), "expected"),
        (("compare", "planar", "--timeout", "0", "--set", "duration=0.01"), "timeout 0: expected a time above 0 [s]"),
        (("compare", "planar", "--timeout", "nan", "--set", "duration=0.01"), "timeout nan: expected a time above"),
        (("run", "eraser", "--set", "expect.board.fz.rms_error=9"), "bounds cannot be changed from the command line"),
        (("run", "eraser", "--set", "expect={}"), "bounds cannot be changed from the command line"),
        (("check", "eraser", "--set", "tasks.pres.kp=1"), "no such key; did you mean 'press'?"),
        (("check", "eraser", "--set", "tasks.press.kp=1e-300"), "expected 0 or a size from 1e-30 to 1e+30, got 1e-300"),
        (("check", "eraser", "--set", "tasks.press.kp=3"), "expected below 1; lower kp"),
        (("check", "eraser", "--set", "robot=pandda"), "no robot named 'pandda'; did you mean 'panda'?"),
    ],
)
def test_wrong_arguments(arguments, message) -> None:
    found = said(*arguments, status=2)
    assert found["ok"] is False
    assert any(message in f"{fault['key']}: {fault['message']}" for fault in found["faults"]), found
    assert all(set(fault) == {"file", "line", "column", "key", "message"} for fault in found["faults"])


@pytest.mark.parametrize(
    "arguments", [("run", "eraser", "--seed", "-1"), ("run",), ("fly",), ("run", "eraser", "--fast")]
)
def test_wrong_usage(arguments) -> None:
    code, out, err = wbc(*arguments)
    assert (code, out) == (2, "")
    assert err.startswith("Usage: ")


def test_taking_the_followers_of_a_reference_away_is_only_noted() -> None:
    still = ("--set", "contacts.board.artificial.vx=0", "--set", "contacts.board.artificial.vy=0")
    assert said("check", "eraser", *still)["notes"][0] == "figure: nothing follows its motion along vx, vy"
    assert said("check", "eraser", *still[:2])["notes"][0] == "figure: nothing follows its motion along vx"


# --- Wrong specs that only the build can see -------------------------------------------------------------------------

# a whole spec or edits of the eraser's; line, column and key; what must be said
WRONG: dict[str, tuple[str | list[tuple[str, str]], str, str]] = {
    "frame": (
        [("frame: eraser", "frame: erasr")],
        "12:5: contacts.board.frame",
        "no frame named 'erasr'; did you mean 'eraser'?",
    ),
    "frame of a reference": (
        [("in: board", "in: bord")],
        "9:24: references.figure.lissajous.in",
        "did you mean 'board'?",
    ),
    "moving frame of a reference": (
        [("in: board", "in: eraser")],
        "9:24: references.figure.lissajous.in",
        "frame 'eraser' moves with joint 'joint7'; expected one fixed to the world",
    ),
    "on": (
        [("    frame: eraser", "    on: bord\n    frame: eraser")],
        "12:5: contacts.board.on",
        "did you mean 'board'?",
    ),
    "on a moving frame": (
        [("    frame: eraser", "    on: flange\n    frame: eraser")],
        "12:5: contacts.board.on",
        "moves with joint",
    ),
    "frame of a motion": (
        REACH.replace("frame: flange", "frame: flnge"),
        "4:25: tasks.reach.frame",
        "did you mean 'flange'?",
    ),
    "screw through": (
        DOOR.replace("through: board", "through: bord"),
        "5:59: contacts.handle.free.swing.screw.through",
        "did you mean 'board'?",
    ),
    "screw through a moving frame": (
        DOOR.replace("through: board", "through: flange"),
        "5:59: contacts.handle.free.swing.screw.through",
        "moves with joint",
    ),
    "screw and reference": (
        DOOR,
        "5:91: contacts.handle.artificial.swing",
        "does not move along wz; expected a number, for a circle gives vx, vy only",
    ),
    "robot": ([("robot: panda", "robot: pandas")], "3:1: robot", "no robot named 'pandas'; did you mean 'panda'?"),
    "robot file": (
        [("robot: panda", "robot: my/arm.xml")],
        "3:1: robot",
        "no file 'my/arm.xml'; expected a path, or one of g1, go2, panda, panda_dual, planar3r, ur5e",
    ),
    "robot with a null byte": ([("robot: panda", r'robot: "a\0b"')], "3:8: robot", "control character"),
    "robot as a folder": ([("robot: panda", "robot: .")], "3:1: robot", "expected one of g1"),
    "tool": ([("tool: eraser", "tool: erasser")], "4:1: tool", "no tool named 'erasser'; did you mean 'eraser'?"),
    "tool left out": ([("tool: eraser\n", "")], "11:5: contacts.board.frame", "(the spec names no tool)"),
    "tool as a robot": (
        [("robot: panda", "robot: eraser")],
        "3:1: robot",
        "no robot named 'eraser'; expected one of g1, go2, panda, panda_dual, planar3r, ur5e",
    ),
    "scene": ([("scene: board", "scene: bord")], "5:1: scene", "no scene named 'bord'; did you mean 'board'?"),
    "scene left out": ([("scene: board\n", "")], "8:24: references.figure.lissajous.in", "(the spec names no scene)"),
    "start": (
        [("duration: 8", "start: hme\nduration: 8")],
        "7:1: start",
        "no keyframe named 'hme'; did you mean 'home'?",
    ),
    "start at the start": ([("duration: 8", "start: start\nduration: 8")], "7:1: start", "no keyframe named 'start'"),
    "start of a joint": (
        [("duration: 8", "start: {jont1: 1}\nduration: 8")],
        "7:9: start.jont1",
        "no joint named 'jont1'; did you mean 'joint1'?",
    ),
    "start out of range": (
        [("duration: 8", "start: {joint4: 1}\nduration: 8")],
        "7:9: start.joint4",
        "1 rad is outside of the joint's range, -3.072",
    ),
    "posture": (
        [("target: start", "target: strat")],
        "18:28: tasks.posture.target",
        "no keyframe named 'strat'; did you mean 'start'?",
    ),
    "posture of a joint": (
        [("target: start", "target: {joint8: 0}")],
        "18:37: tasks.posture.target.joint8",
        "no joint named 'joint8'; did you mean 'joint",
    ),
    "posture gains": (
        [("kp: 50", "kp: [1, 2, 3]")],
        "18:43: tasks.posture.kp",
        "expected a number, 7 numbers (joint1, joint2, joint3",
    ),
    "posture damping": ([("kd: 10}", "kd: [1, 2, 3]}")], "18:51: tasks.posture.kd", "or a matrix 7 x 7, got 3"),
    "limit of a joint": (
        [("torque: model", "torque: {jont2: 5}")],
        "19:19: limits.torque.jont2",
        "did you mean 'joint2'?",
    ),
    "limits over the joints": (
        [("torque_rate: 1000", "torque_rate: [1, 2]")],
        "19:25: limits.torque_rate",
        "expected 7 numbers, one a joint, got 2",
    ),
    "limit that binds nothing": (
        [("torque: model", "torque: 100")],
        "19:10: limits.torque",
        "100 is above the 87 N m of every joint; the model's own limit",
    ),
    "limit above a joint's own": (
        [("velocity: model", "velocity: {joint1: 9}")],
        "19:72: limits.velocity.joint1",
        "9 is above the 2.1",
    ),
    "margin": (
        [("position: model", "position: {margin: 2}")],
        "19:55: limits.position.margin",
        "2 rad on either side leave joint",
    ),
    "metric": (
        [("board.mx.rms_error", "board.mx.rms_eror")],
        "23:3: expect.board.mx.rms_eror",
        "no such quantity; did you mean 'board.mx.rms_error'?",
    ),
    "settle": ([("settle: 1.0 ", "setle: 1.0 ")], "21:3: expect.setle", "did you mean 'settle'?"),
    "solver": (
        [("duration: 8", "solver: qdaqp\nduration: 8")],
        "7:1: solver",
        "no solver named 'qdaqp'; did you mean 'daqp'?",
    ),
    "integral gain": ([("ki: 10", "ki: 5000")], "16:42: tasks.press.kp", "is unstable against"),
    "proportional gain": (
        [("kp: 0.3", "kp: 3")],
        "16:42: tasks.press.kp",
        "against a stiffness of 1e+06 N/m: its largest pole has modulus 1.18",
    ),
    "no damping": (
        [("damping: [5, 5, 500], filter: 50", "filter: 500")],
        "16:42: tasks.press.kp",
        "add damping along the axis",
    ),
    "damping": (
        [("[5, 5, 500]", "3000")],
        "16:59: tasks.press.damping",
        "expected below 2; lower it on the axes of small inertia",
    ),
    "rate": ([("rate: 1000 ", "rate: 50 ")], "16:59: tasks.press.damping", "or raise the rate"),
    "planar table on six axes": (
        PLANAR.replace("planar3r", "panda"),
        "13:5: contacts.board.natural",
        "the table says nothing of wx, wz, vy; expected the axes wx, wy",
    ),
    "six axes on a planar arm": (
        [("robot: panda", "robot: planar3r")],
        "13:5: contacts.board.natural",
        "planar3r cannot move along wx, wz, vy; expected the axes wy, vx, vz",
    ),
    "held where a planar arm cannot go": (
        HOLDS.replace("all, ", "[vy, vz], ").replace("panda", "planar3r"),
        "4:25: contacts.grip.holds",
        "cannot move eraser along vy; expected some of wy, vx, vz",
    ),
    "moved where a planar arm cannot go": (
        REACH.replace("panda", "planar3r"),
        "4:54: tasks.reach.axes",
        "cannot move flange along vy",
    ),
    "drawn elsewhere": (
        [("in: board, ", "")],
        "14:39: contacts.board.artificial.vx",
        "is drawn in 'world', but the contact closes on 'board'; expected `in: board`",
    ),
    "reference along another axis": (
        [("wz: 0, vx: figure", "wz: figure, vx: figure")],
        "14:32: contacts.board.artificial.wz",
        "does not move along wz; expected a number",
    ),
    "reference that nothing follows": (
        [("vx: figure, vy: figure", "vx: 0, vy: 0")],
        "9:3: references.figure",
        "nothing follows it; expected a target",
    ),
    "frame of a hold": (
        [("fz: -10", "fz: q"), ("references:\n", "references:\n  q: {hold: {in: bord}}\n")],
        "9:14: references.q.hold.in",
        "did you mean 'board'?",
    ),
    "contact of the world": (
        [("frame: eraser", "frame: board_body")],
        "12:5: contacts.board.frame",
        "is fixed to the world; expected one of",
    ),
    "contact of a joint": (
        [("frame: eraser", "frame: joint7")],
        "12:5: contacts.board.frame",
        "that of a joint; expected a body or a site",
    ),
    "motion of the world": (
        REACH.replace("frame: flange", "frame: board").replace("robot: panda", "robot: panda\nscene: board"),
        "5:25: tasks.reach.frame",
        "is fixed to the world",
    ),
    "start that cannot be closed": (
        REACH.replace("from: [0.5", "from: [5.5"),
        "4:40: tasks.reach.target",
        "cannot bring flange there from its start pose: ",
    ),
    "place out of reach": (
        [("in: board, size: [0.12, 0.06]", "in: board, size: [8, 6], phase: [1.5, 1.5]")],
        "11:3: contacts.board",
        "choose another place, start or robot",
    ),
    "gain list on what holds all": (
        HOLDS.replace("kp: 0.1", "kp: [1, 2]"),
        "6:39: tasks.press.kp",
        "expected a number, 6 numbers (mx, my, mz, fx, fy, fz)",
    ),
    "gain list over screws": (
        STILL.replace("kp: 100", "kp: [100]"),
        "6:42: tasks.swing.kp",
        "expected a number for the free motion of screws",
    ),
    "rows of A": (
        "robot: panda\ncontacts:\n  c: {frame: flange, A: [[0, 0, 0, 0, 0, 1], [0, 0, 0, 0, 0, 2]]}\n",
        "3:22: contacts.c.A",
        "the 2 rows of A are not independent",
    ),
    "wrench that the rows do not carry": (
        "robot: panda\ncontacts:\n  c: {frame: flange, A: [[0, 0, 0, 0, 0, 1]], artificial: {wrench: {fx: 1}}}\n"
        "tasks: {press: {type: force, contact: c, kp: 0.1}}\n",
        "3:47: contacts.c.artificial",
        "the contact cannot carry fx (+1) of the desired wrench",
    ),
    "wrench that the screws leave free": (
        STILL.replace("swing: 0.1}", "swing: 0.1, wrench: {mz: 1}}").replace(
            "tasks:\n", "tasks:\n  pull: {type: force, contact: handle}\n"
        ),
        "4:78: contacts.handle.artificial",
        "cannot carry mz (+1)",
    ),
    "phase that makes a loop unstable": (
        [("expect:", "phases: {a: {until: {time: 1}}, b: {set: {tasks.press.kp: 3}}}\nexpect:")],
        "20:43: phases.b.set.tasks.press.kp",
        "tasks.press.kp: the force loop on",
    ),
    "phase that frees nothing": (
        [("expect:", "phases: {a: {set: {limits.torque: 99}}}\nexpect:")],
        "20:20: phases.a.set.limits.torque",
        "limits.torque: 99 is above the 87 N m",
    ),
    "law": (
        [
            ("duration: 8", "law: book\nduration: 8"),
            ("references:\n", "references:\n  stay: {hold: {}}\n"),
            (
                "  posture:",
                "  elbow: {type: motion, frame: link4, target: stay, axes: [vx], kp: 50, kd: 10}\n  posture:",
            ),
        ],
        "7:1: law",
        "law: the book's is for one contact and one motion task",
    ),
}


@pytest.fixture(scope="session")
def loaded():
    """Robots by their files: loading is most of the time that a build takes."""
    return {}


def faults(file: Path, loaded) -> list[str]:
    """What the build says, with the robot at hand when it was loaded before."""
    try:
        spec = load(file)
        files = (spec.robot, spec.tool, spec.scene, spec.gravity)
        built = build(spec, loaded.get(files))
        loaded[files] = built.robot
    except SpecError as error:
        return [str(fault) for fault in error.faults]
    return []


@pytest.mark.parametrize("name", WRONG)
def test_wrong_spec(name: str, tmp_path: Path, loaded) -> None:
    wrong, place, message = WRONG[name]
    file = written(tmp_path, wrong if isinstance(wrong, str) else edited(ERASER, *wrong))
    found = faults(file, loaded)
    places = [fault for fault in found if fault.startswith(f"{file}:{place}: ")]
    assert any(message in fault for fault in places), "\n".join(found)


def test_every_fault_of_a_stage_at_once(tmp_path: Path) -> None:
    """As the command tells them: one line a fault, in the order of the file, and the same as JSON."""
    edits = [("in: board", "in: bord"), ("frame: eraser", "frame: erasr"), ("target: start", "target: strat")]
    spec = written(tmp_path, edited(ERASER, *edits, ("torque_rate: 1000", "torque_rate: {jont1: 9}")))
    code, out, err = wbc("check", spec)
    assert (code, out) == (2, "")
    keys = [
        "references.figure.lissajous.in",
        "contacts.board.frame",
        "tasks.posture.target",
        "limits.torque_rate.jont1",
    ]
    assert [line.split(": ")[1] for line in err.splitlines()] == keys
    found = said("check", spec, status=2)
    assert [fault["key"] for fault in found["faults"]] == keys
    assert [
        f"{fault['file']}:{fault['line']}:{fault['column']}: {fault['key']}: {fault['message']}"
        for fault in found["faults"]
    ] == err.splitlines()
    assert (found["model_error"], found["feasible"], found["poles"]) == (None, False, [])
    both = edited(ERASER, ("kp: 0.3", "kp: 3"), ("settle: 1.0 ", "setle: 1.0 "))
    both = both.replace("torque: model", "torque: 100").replace("robot: panda", "robot: panda\nsolver: daqp")
    found = said("check", written(tmp_path, both), status=2)
    assert [fault["key"] for fault in found["faults"]] == ["tasks.press.kp", "limits.torque", "expect.setle"]


# --- Broken model files ----------------------------------------------------------------------------------------------

ARM = """<mujoco><worldbody>
<body name="link"><joint name="turn" axis="0 0 1"/>{body}<site name="tip" pos="1 0 0"/></body></worldbody>
<actuator><motor joint="turn"/></actuator>{more}</mujoco>"""
MASS = '<inertial mass="1" pos="0 0 0" diaginertia="1 1 1"/>'
MODELS = {
    "empty": "",
    "not XML": "robot: panda",
    "cut off": ARM.format(body=MASS, more="")[:80],
    "binary": "\x00\x01\x02",
    "another root": "<html/>",
    "unknown element": ARM.format(body=MASS + "<wing/>", more=""),
    "unknown attribute": ARM.format(body=MASS.replace("mass=", "weight="), more=""),
    "missing mesh": ARM.format(
        body=MASS + '<geom type="mesh" mesh="m"/>', more='<asset><mesh name="m" file="no.stl"/></asset>'
    ),
    "missing include": ARM.format(body=MASS, more='<include file="no.xml"/>'),
    "includes itself": ARM.format(body=MASS, more='<include file="arm.xml"/>'),
    "NaN mass": ARM.format(body=MASS.replace('mass="1"', 'mass="nan"'), more=""),
    "NaN place": ARM.format(body=MASS, more="").replace('name="link"', 'name="link" pos="nan 0 0"'),
    "NaN gear": ARM.format(body=MASS, more="").replace('joint="turn"/></act', 'joint="turn" gear="nan"/></act'),
    "infinite inertia": ARM.format(body=MASS.replace("1 1 1", "inf 1 1"), more=""),
    "negative mass": ARM.format(body=MASS.replace('mass="1"', 'mass="-1"'), more=""),
    "no mass": ARM.format(body="", more=""),
    "impossible inertia": ARM.format(body=MASS.replace("1 1 1", "9 1 1"), more=""),
    "zero axis": ARM.format(body=MASS, more="").replace("0 0 1", "0 0 0"),
    "no joint": "<mujoco><worldbody><body><geom size='1'/></body></worldbody></mujoco>",
    "two of a name": ARM.format(body=MASS + '<site name="tip"/>', more=""),
    "motor of no joint": ARM.format(body=MASS, more="").replace('joint="turn"/></act', 'joint="trun"/></act'),
    "free joint below": ARM.format(body=MASS, more="").replace("<site", "<body><freejoint/></body><site"),
}


ONLY_ROBOTS = ("no joint", "motor of no joint")  # a tool and a scene need neither
BROKEN = [(name, kind) for name in MODELS for kind in ("robot", "tool", "scene")]


@pytest.mark.parametrize(("name", "kind"), [(n, k) for n, k in BROKEN if k == "robot" or n not in ONLY_ROBOTS])
def test_broken_model_file(name: str, kind: str, tmp_path: Path) -> None:
    written(tmp_path, MODELS[name], "arm.xml")
    lines = {"robot": "planar3r", kind: "arm.xml"}
    spec = written(tmp_path, "".join(f"{key}: {value}\n" for key, value in lines.items()))
    (fault,) = said("check", spec, status=2)["faults"]
    assert fault["line"] == list(lines).index(fault["key"]) + 1
    assert fault["message"].isprintable()
    assert len(fault["message"]) < 500


def test_a_model_is_loaded_as_the_spec_says(tmp_path: Path) -> None:
    """The one above is wrong for what was changed in it."""
    written(tmp_path, ARM.format(body=MASS, more=""), "arm.xml")
    report = said("check", written(tmp_path, "robot: arm.xml\n"))
    assert report["model_error"] < 1e-8
    assert Robot.load(str(tmp_path / "arm.xml")).joints == ("turn",)


@pytest.mark.parametrize("buffered", [False, True])
def test_what_a_library_in_c_prints_is_not_among_the_json(buffered):
    """As HiGHS does its name, past Python's `sys.stdout`: at once, or at the end of the process."""
    code = f"""
import ctypes
from wbc import cli, doctor
libc = ctypes.CDLL(None)
def examine():
    libc.puts(b"a library's name")
    {"" if buffered else "libc.fflush(None)"}
    return {{"ok": True}}
doctor.examine = examine
cli.main(["doctor", "--json"])
"""
    done = python(code)
    assert (done.returncode, json.loads(done.stdout)) == (0, {"ok": True})
    assert done.stderr == "a library's name\n"
