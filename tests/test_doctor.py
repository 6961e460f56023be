"""What `wbc doctor` says of this installation, and of broken ones: a shadowed Pinocchio, a solver that lies."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner

from wbc import doctor, machine
from wbc.cli import main
from wbc.solver import installed


def own_process(*entries: Path) -> tuple[int, dict[str, Any], str]:
    """`wbc doctor --json` in a process with these folders on PYTHONPATH, without the trial frame."""
    root = Path(doctor.__file__).parent.parent
    code = (
        "from wbc import doctor, cli\nfull = doctor.examine\n"
        "doctor.examine = lambda: full(seconds=0.01, rendering=False)\ncli.main(['doctor', '--json'])"
    )
    path = os.pathsep.join(map(str, [*entries, root]))
    done = subprocess.run(
        [sys.executable, "-c", code], env=os.environ | {"PYTHONPATH": path}, capture_output=True, text=True, check=False
    )
    return done.returncode, json.loads(done.stdout), done.stderr


def by_name(report: dict[str, Any]) -> dict[str, dict[str, str]]:
    return {each["name"]: each for each in report["findings"]}


def test_nothing_is_broken_here() -> None:
    result = CliRunner().invoke(main, ["doctor", "--json"])
    report = json.loads(result.stdout)
    found = by_name(report)
    assert result.exit_code == 0, [each for each in report["findings"] if each["status"] == "problem"]
    assert report["ok"]
    assert report["packages"]["numpy"] == found["numpy"]["found"] == np.__version__
    assert {f"solver {name}" for name in installed()} <= set(found)
    assert {"python", "pinocchio", "kernels", "timer", "cores", "real-time priority", "BLAS", "off screen"} <= set(
        found
    )
    for each in report["findings"]:
        assert each["status"] in ("ok", "note", "problem")
        assert each["do"] or each["status"] == "ok"  # what is not well comes with what to do


def test_it_is_told_in_a_table(monkeypatch: pytest.MonkeyPatch) -> None:
    findings = [{"name": "thing", "status": "problem", "found": "[red]broken[/red]", "do": "mend it"}]
    monkeypatch.setattr(doctor, "examine", lambda: {"ok": False, "findings": findings})
    result = CliRunner().invoke(main, ["doctor"])
    assert result.exit_code == 1
    assert all(word in result.stdout for word in ("problem", "thing", "[red]broken[/red]", "mend it", "PROBLEMS"))


def test_what_is_needed_is_what_pyproject_says() -> None:
    file = Path(doctor.__file__).parent.parent / "pyproject.toml"
    if not file.exists():
        pytest.skip("an installed package has no pyproject.toml")
    dependencies = tomllib.loads(file.read_text())["project"]["dependencies"]
    assert dict(each.split(">=") for each in dependencies) == doctor.NEEDED


@pytest.mark.parametrize(
    ("module", "message"),
    [
        ("__version__ = '3.2.0'", "expected 4.0 or newer; take {0} out of PYTHONPATH"),
        ("__version__ = '4.9.0'", "it shadows that of `pin` in"),
        ("raise ImportError('libboost_python310.so.1.74.0: cannot open shared object file')", "libboost_python310"),
    ],
)
def test_a_pinocchio_from_elsewhere_is_a_problem(module: str, message: str, tmp_path: Path) -> None:
    """As of ROS: a folder on PYTHONPATH comes before the packages of the environment."""
    (tmp_path / "pinocchio").mkdir()
    (tmp_path / "pinocchio" / "__init__.py").write_text(module)
    code, report, errors = own_process(tmp_path)
    finding = by_name(report)["pinocchio"]
    assert (code, report["ok"], finding["status"]) == (1, False, "problem")
    assert message.format(tmp_path) in f"{finding['found']} {finding['do']}"
    assert "Traceback" not in errors


def test_a_second_pinocchio_behind_is_noted(tmp_path: Path) -> None:
    for folder in ("first", "second"):
        (tmp_path / folder / "pinocchio").mkdir(parents=True)
        (tmp_path / folder / "pinocchio" / "__init__.py").write_text("")
    (tmp_path / "link").symlink_to("first")
    found = doctor.copies([str(tmp_path / folder) for folder in ("nothing", "first", "second", "link")])
    assert [path.parts[-3] for path in found] == ["first", "second"]


def test_two_pinocchio_libraries_in_one_process(tmp_path: Path) -> None:
    line = "7f00-7f01 r-xp 00000000 08:01 42                         {}/libpinocchio_default.so.4.1.0\n"
    (tmp_path / "maps").write_text(
        "".join(line.format(folder) for folder in ("/opt/ros/lib", "/venv/lib", "/venv/lib"))
    )
    assert [path.split("/lib")[0] for path in doctor.loaded("libpinocchio_default", tmp_path / "maps")] == [
        "/opt/ros",
        "/venv",
    ]
    assert doctor.loaded("libpinocchio_default", tmp_path / "no such file") == []


def test_a_solver_that_answers_wrongly_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    class Wrong:
        def solve(self, problem: Any) -> Any:
            return np.zeros(2), np.zeros(3)

    assert doctor.solves("daqp") == ""
    assert "no certified answer: primal 1.0e+00" in doctor.solves(Wrong())
    monkeypatch.setattr("wbc.solver.installed", lambda: ["daqp", "mine"])
    monkeypatch.setattr(doctor, "solves", lambda name: "it lies" if name == "mine" else "")
    status = {each.name: each.status for each in doctor._solvers()}
    assert status == {"solver daqp": "ok", "solver proxqp": "problem", "solver mine": "note"}


def test_a_package_that_is_old_or_missing_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(doctor, "version", lambda name: {"numpy": "1.26.4", "numba": ""}.get(name, "99.0"))
    wrong = {each.name: each.do for each in doctor._packages() if each.status != "ok"}
    assert wrong == {
        "numpy": "expected 2.0 or newer: pip install 'numpy>=2.0'",
        "numba": "expected 0.61 or newer: pip install 'numba>=0.61'",
    }


def test_versions_are_compared_by_their_numbers() -> None:
    assert doctor.older("0.9", "0.61")
    assert not doctor.older("0.100.1", "0.61")
    assert not doctor.older("4.0.0rc1", "4.0")


def test_the_timer_is_told_late(monkeypatch: pytest.MonkeyPatch) -> None:
    late = machine.lateness(0.05)
    assert len(late) == 50
    assert late == sorted(late)
    assert late[0] >= 0.0
    for most, status in ((1e-4, "ok"), (2e-3, "note")):
        monkeypatch.setattr(machine, "lateness", lambda seconds, most=most: [1e-5] * 90 + [most] * 10)
        (finding,) = machine.timer(1.0)
        assert (finding.status, f"{most * 1e6:.0f} us at most" in finding.found) == (status, True)


def test_a_renderer_that_fails_is_noted(monkeypatch: pytest.MonkeyPatch) -> None:
    assert "invalid value for environment variable MUJOCO_GL" in machine.frame("nothing")
    monkeypatch.setenv("MUJOCO_GL", "osmesa")
    monkeypatch.setattr(machine, "frame", lambda backend: "" if backend == "egl" else "no library")
    asked, other, _ = machine.rendering()
    assert (asked.status, asked.found) == ("note", "MUJOCO_GL=osmesa draws no frame: no library")
    assert other.found == "egl draws a frame"
    monkeypatch.setattr(machine, "frame", lambda backend: "no library")
    assert [each.status for each in machine.rendering()][:2] == ["note", "note"]  # it is needed by no command


def test_an_examination_that_raises_is_a_finding() -> None:
    def _eyes() -> list[doctor.Finding]:
        raise OSError("the disk\nis gone")

    (finding,) = doctor._guarded(_eyes)
    assert (finding.name, finding.status, finding.found) == ("eyes", "problem", "OSError: the disk is gone")
    assert finding.do
