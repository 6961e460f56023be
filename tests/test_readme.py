"""The README's promises: its commands exist, its spec is the shipped one, its snippets and tables are true."""

from __future__ import annotations

import re
from pathlib import Path

import yaml
from click.testing import CliRunner

from wbc import analytic
from wbc.cli import main
from wbc.resources import shipped_folder, shipped_names

ROOT = Path(__file__).resolve().parent.parent
README = (ROOT / "README.md").read_text()


def blocks(language):
    return re.findall(rf"```{language}\n(.*?)```", README, flags=re.S)


def test_the_two_commands_are_what_the_check_runs():
    setup, tests = blocks("bash")
    script = (ROOT / ".ci" / "run").read_text()
    for word in ("wbc run eraser --headless", "pip install"):
        assert word in setup
    assert ".venv/bin/wbc run eraser --headless" in setup
    assert "run eraser --headless" in script
    assert '".[test]"' in tests
    assert '".[test]"' in script
    assert "pytest -n 2" in tests
    assert 'pytest" -n 2' in script


def test_the_main_command_runs(tmp_path):
    command = re.search(r"wbc (run eraser --headless)", README).group(1).split()
    result = CliRunner().invoke(main, [*command, "--duration", "1.2", "--out", str(tmp_path)])
    assert result.exit_code == 0, result.output


def test_the_spec_is_the_shipped_one():
    (text,) = blocks("yaml")
    shown, shipped = yaml.safe_load(text), yaml.safe_load((shipped_folder("tasks") / "eraser.yaml").read_text())
    shipped.pop("title")
    for key in ("board.mx.rms_error", "board.my.rms_error"):
        shipped["expect"].pop(key)
    assert shown == shipped


def test_the_python_snippets_run(capsys):
    for snippet in blocks("python"):
        exec(compile(snippet, "README.md", "exec"), {})
    said = capsys.readouterr().out
    assert "Status." in said
    assert "5.0" in said


def test_every_command_and_spec_is_named():
    for command in main.commands:
        assert f"`wbc {command}" in README
    for name in shipped_names("tasks", ".yaml"):
        assert f"`{name}`" in README


def test_explained_ticks_are_as_shown():
    shown = re.findall(r"`(wbc explain [^`]*--at [\d.]+[^`]*)`[^`]*```\n(.*?)```", README, flags=re.S)
    assert len(shown) == 2
    for command, lines in shown:
        result = CliRunner().invoke(main, command.split()[1:])
        assert result.exit_code == 0, result.output
        for figure in re.findall(r"[-+]?\d+\.\d+|\d+ constraints", lines):
            assert figure in result.output, (command, figure)


def test_commands_with_set_are_true():
    for key in re.findall(r"--set (\S+=\S+?)`", re.sub(r"`wbc explain [^`]*`", "", README)):
        if "key.path" in key:
            continue
        result = CliRunner().invoke(main, ["check", "eraser", "--set", key])
        assert result.exit_code == 0, (key, result.output)


def test_linked_files_exist():
    for target in re.findall(r"\]\(([^)#:]+)\)", README):
        assert (ROOT / target).exists(), target


def test_the_example_loop_reaches_the_new_target():
    example: dict = {"__name__": "example"}
    exec(compile((ROOT / "examples" / "loop.py").read_text(), "loop.py", "exec"), example)
    assert abs(example["main"](2.0) + 12.0) < 0.05


def test_the_table_of_the_chapter_is_whole_and_true():
    table = README.split("## The chapter, equation by equation")[1].split("\n## ")[0]
    rows = [[cell.strip() for cell in line.split("|")[1:-1]] for line in table.splitlines() if line.startswith("| ")][
        1:
    ]
    functions, tests, specs = (set(re.findall(r"`([^`]+)`", " ".join(row[i] for row in rows))) for i in (1, 2, 3))
    assert functions == {name for name in analytic.__all__ if name not in ("Array", "Law")}
    for test in tests:
        file, _, group = test.partition("::")
        assert f"class {group}" in (ROOT / "tests" / file).read_text() if group else (ROOT / "tests" / file).exists()
    assert specs <= set(shipped_names("tasks", ".yaml"))
