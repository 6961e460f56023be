"""Spec files that attack: exit 2 and located messages, no traceback, at most a second.

`WBC_CAMPAIGN=large` reads 100 times as many mutated files. One of them, by its number:
`WBC_INPUT=17 pytest tests/test_inputs_specs.py -k mutated`. CI bounds the work (bytes, parser
events), not the clock.
"""

from __future__ import annotations

import os
import random
import re
import time
from collections import Counter
from pathlib import Path
from typing import Any

import pytest
import yaml
from click.testing import CliRunner

from wbc.cli import main
from wbc.errors import SpecError
from wbc.resources import shipped_folder, shipped_names
from wbc.spec import load, source

LARGE = os.environ.get("WBC_CAMPAIGN") == "large"
FILES = 50_000 if LARGE else 500
SECOND = 1.0  # [s] of this thread's own time
ERASER = (shipped_folder("tasks") / "eraser.yaml").read_text()
SHIPPED = [(shipped_folder("tasks") / f"{name}.yaml").read_text() for name in shipped_names("tasks", ".yaml")]

LONG = "a" * 200_000
LAUGHS = "a: &a [x, x, x, x, x, x, x, x, x, x]\n" + "".join(
    f"{b}: &{b} [{', '.join([f'*{a}'] * 10)}]\n" for a, b in zip("abcdefgh", "bcdefghi", strict=True)
)


def changed(old: str, new: str) -> str:
    assert ERASER.count(old) == 1
    return ERASER.replace(old, new)


ATTACKS: dict[str, str | bytes] = {
    "billion_laughs": LAUGHS + ERASER,
    "laughs_in_merge_keys": "a: &a {x: 1}\nb: {<<: [*a, *a, *a, *a]}\n",
    "an_alias_of_itself": "robot: &r [*r]\n",
    "depth_20_000": "[" * 20_000,
    "depth_20_000_closed": "robot: " + "[" * 20_000 + "]" * 20_000,
    "depth_20_000_mappings": "{a: " * 20_000,
    "depth_20_000_block": "- " * 20_000,
    "depth_20_000_keys": "? " * 20_000,
    "depth_of_lines": "".join("\n" + " " * i + "a:" for i in range(600)),
    "3_MB": b"# " + b"x" * 3_000_000,
    "3_MB_of_entries": b"robot: panda\n" * 240_000,
    "3_MB_of_brackets": b"[" * 3_000_000,
    "256_KiB_of_colons": b": " * 128 * 1024,
    "256_KiB_of_quotes": b"'" * 256 * 1024,
    "256_KiB_of_lines": b"\n" * (256 * 1024 - 1) + b"-",
    "256_KiB_of_anchors": b"&a " * 80_000,
    "256_KiB_of_tags": b"!a " * 80_000,
    "256_KiB_of_stars": b"*a " * 80_000,
    "256_KiB_of_documents": b"---\n" * 60_000,
    "256_KiB_of_text": "robot: |\n" + " a\n" * 80_000,
    "256_KiB_of_folds": "robot: >\n" + " a\n\n" * 60_000,
    "256_KiB_of_escapes": 'robot: "' + "\\x41" * 60_000 + '"',
    "10_000_entries_of_a_list": changed("kp: 100", f"kp: [{', '.join(['1'] * 4_000)}]"),
    "a_matrix_of_60": changed("kp: 100", f"kp: [{', '.join(['[' + ', '.join(['1'] * 60) + ']'] * 60)}]"),
    "duplicate_keys": changed("rate: 1000 ", "robot: ur5\nrate: 1000 "),
    "4_000_duplicate_keys": "robot: panda\n" * 4_000,
    "4_000_unknown_keys": "".join(f"key_that_is_not_known_{i}: 1\n" for i in range(4_000)),
    "key_is_a_list": changed("rate: 1000 ", "[a, b]: 1000 "),
    "key_is_a_mapping": changed("rate: 1000 ", "{a: b}: 1000 "),
    "key_is_a_mapping_in_block": changed("rate: 1000 ", "? {a: b}\n: 1000 "),
    "key_is_an_alias": changed("rate: 1000 ", "*a : 1000 "),
    "key_is_null": changed("rate: 1000 ", "~: 1000 "),
    "key_is_empty": changed("rate: 1000 ", "'': 1000 "),
    "key_is_a_number": changed("rate: 1000 ", "1e3: 1000 "),
    "key_is_not_a_number": changed("rate: 1000 ", ".nan: 1000 "),
    "key_of_200_KB": f"robot: panda\n? {LONG}\n: 1\n",
    "word_of_200_KB": changed("law: compensated", f"law: {LONG}") if "law: compensated" in ERASER else f"law: {LONG}\n",
    "robot_of_200_KB": changed("robot: panda", f"robot: {LONG}"),
    "frame_of_200_KB": changed("frame: eraser", f"frame: {LONG}"),
    "number_of_200_KB": changed("rate: 1000 ", f"rate: {'1' * 200_000} "),
    "exponent_of_200_KB": changed("rate: 1000 ", f"rate: 1e{'1' * 200_000} "),
    "control_character": changed("tool: eraser", "tool: era\x07ser"),
    "control_character_escaped": changed("tool: eraser", r'tool: "era\aser"'),
    "escape_of_a_terminal": changed("tool: eraser", 'tool: "\\e[31m"'),
    "zero_byte": changed("tool: eraser", "tool: era\0ser"),
    "zero_byte_escaped": changed("robot: panda", r'robot: "pan\0da"'),
    "delete": changed("tool: eraser", "tool: era\x7fser"),
    "line_separator": changed("tool: eraser", "tool: era\u2028ser"),
    "right_to_left": changed("tool: eraser", "tool: \u202eresare"),
    "surrogate": changed("tool: eraser", r'tool: "\ud800"'),
    "no_break_space": changed("robot: panda", "robot:\u00a0panda"),
    "zero_width_space": changed("robot: panda", "robot: pan\u200bda"),
    "cyrillic_a": changed("robot: panda", "robot: p\u0430nda"),
    "cyrillic_key": changed("robot: panda", "r\u043ebot: panda"),
    "full_width_digits": changed("rate: 1000 ", "rate: \uff11\uff10 "),
    "arabic_digits": changed("rate: 1000 ", "rate: \u0661\u0660 "),
    "minus_sign": changed("fz: -10", "fz: \u221210"),
    "utf_16": ERASER.encode("utf-16"),
    "utf_16_without_a_mark": ERASER.encode("utf-16-be"),
    "utf_32": ERASER.encode("utf-32"),
    "latin_1": changed("tool: eraser", "tool: \xe4raser").encode("latin-1"),
    "byte_order_mark": ERASER.encode("utf-8-sig"),
    "overlong_utf_8": ERASER.encode().replace(b"panda", b"pand\xc0\xaf"),
    "binary": bytes(range(256)) * 8,
    "empty": "",
    "blank": " \n\n  \n",
    "only_comments": "# nothing\n",
    "only_a_document_mark": "---\n",
    "two_documents": ERASER + "---\n" + ERASER,
    "directive": "%YAML 1.1\n---\n" + ERASER.replace("robot: panda", "robot: 5"),
    "unknown_directive": "%TAG ! tag:evil,2000:\n---\nrobot: !x panda\n",
    "null": "null\n",
    "list": "- robot: panda\n",
    "tab": changed("    frame: eraser", "\tframe: eraser"),
    "merge_key": changed("robot: panda", "robot: panda\n<<: {tool: x}"),
    "merge_key_of_an_alias": changed("robot: panda", "robot: panda\nlimits2: &l {torque: 1}\nplant: {<<: *l}"),
    "python_object": changed("robot: panda", "robot: !!python/object/apply:os.system ['true']"),
    "python_name": changed("robot: panda", "robot: !!python/name:os.system"),
    "python_module": changed("robot: panda", "robot: !!python/module:antigravity"),
    "binary_tag": changed("robot: panda", "robot: !!binary cGFuZGE="),
    "own_tag": changed("robot: panda", "robot: !include ../secret.yaml"),
    "set": changed("robot: panda", "robot: !!set {panda}"),
    "timestamp": changed("rate: 1000 ", "rate: 2001-12-14 "),
    "NaN": changed("rate: 1000 ", "rate: .nan "),
    "nan": changed("rate: 1000 ", "rate: nan "),
    "inf": changed("rate: 1000 ", "rate: -.inf "),
    "1e400": changed("rate: 1000 ", "rate: 1e400 "),
    "minus_1e400": changed("fz: -10", "fz: -1e400"),
    "1e-400": changed("kd: 20", "kd: 1e-40"),
    "1e308": changed("kd: 20", "kd: 1e308"),
    "octal": changed("rate: 1000 ", "rate: 0o1750 "),
    "hexadecimal": changed("rate: 1000 ", "rate: 0x3e8 "),
    "sexagesimal": changed("rate: 1000 ", "rate: 16:40 "),
    "underscore": changed("rate: 1000 ", "rate: 1_000 "),
    "truth": changed("rate: 1000 ", "rate: true "),
    "a_number_as_text": changed("rate: 1000 ", 'rate: "1000" '),
    "missing_frame": changed("frame: eraser", "frame: no_such_frame"),
    "empty_frame": changed("frame: eraser", "frame: ''"),
    "missing_keyframe": changed("robot: panda", "robot: panda\nstart: no_such_pose"),
    "missing_joint": changed("robot: panda", "robot: panda\nstart: {joint_99: 0}"),
    "missing_robot": changed("robot: panda", "robot: pnada"),
    "robot_is_a_path": changed("robot: panda", "robot: ../../../../etc/passwd"),
    "robot_is_a_device": changed("robot: panda", "robot: /dev/zero"),
    "robot_is_erd": changed("robot: panda", "robot: erd:../../x"),
    "phase_sets_a_section_to_a_number": changed("expect:", "phases: {a: {set: {tasks: 0.2}}}\nexpect:"),
    "phase_sets_a_section_to_others": changed("expect:", "phases: {a: {set: {tasks: {x: {type: posture}}}}}\nexpect:"),
    "unknown_key": changed("rate: 1000 ", "rat: 1000 "),
    "unknown_solver": changed("rate: 1000 ", "rate: 1000\nsolver: os.system\n"),
}
PLACED = re.compile(r"^[^:]+\.yaml:\d+:\d+: ")


def refusals(file: Path) -> list[str]:
    """Stderr of `wbc check`: exit 2, one printable line a fault, each with what to do; nothing else."""
    begun = time.thread_time()
    result = CliRunner().invoke(main, ["check", str(file), "--json"])
    spent = time.thread_time() - begun
    print(f"{spent:.3f} s")
    assert result.exit_code == 2, result.output
    assert isinstance(result.exception, SystemExit)
    lines = result.stderr.splitlines()
    assert lines
    assert all(line.isprintable() and len(line) < 2_000 for line in lines)
    assert not LARGE or spent < SECOND
    return lines


@pytest.fixture
def work(monkeypatch: pytest.MonkeyPatch) -> Counter[str]:
    """Counts what reading costs: texts given to the parser, their characters, and the events that were taken."""
    counts = Counter[str]()
    original = yaml.parse

    def counted(text: Any, *given: Any, **named: Any) -> Any:
        counts["texts"] += 1
        counts["characters"] += len(text)
        for event in original(text, *given, **named):
            counts["events"] += 1
            yield event

    monkeypatch.setattr(source.yaml, "parse", counted)
    return counts


@pytest.mark.row(16)
@pytest.mark.parametrize("case", ATTACKS)
def test_an_attack_is_refused_in_its_place(case: str, tmp_path: Path, work: Counter[str]) -> None:
    file, text = tmp_path / "attack.yaml", ATTACKS[case]
    file.write_bytes(text if isinstance(text, bytes) else text.encode("utf-8", "surrogatepass"))
    lines = refusals(file)
    assert all(PLACED.match(line) for line in lines)
    assert len(lines) <= source.MAX_FAULTS + 1
    assert work["texts"] <= 1
    assert work["characters"] <= source.MAX_BYTES
    assert work["events"] <= 2 * source.MAX_VALUES + 10


@pytest.mark.row(16)
@pytest.mark.parametrize(
    "kind", ["missing", "folder", "pipe", "without permission", "link to nothing", "loop of links"]
)
def test_what_is_no_file_is_told(kind: str, tmp_path: Path) -> None:
    file = tmp_path / "task.yaml"
    if kind == "folder":
        file.mkdir()
    if kind == "pipe":
        os.mkfifo(file)
    if kind == "without permission":
        file.write_text(ERASER)
        file.chmod(0)
        if os.access(file, os.R_OK):
            pytest.skip("the superuser may read it")
    if kind.startswith("l"):
        file.symlink_to("nothing.yaml" if kind == "link to nothing" else "task.yaml")
    (line,) = refusals(file)
    assert line.startswith(f"{file}: ")


@pytest.mark.row(16)
@pytest.mark.parametrize(("text", "value"), [("1e3", 1000.0), ("1e-3", 0.001), ("1E3", 1000.0), ("+1.e+3", 1000.0)])
def test_powers_of_ten_are_numbers(text: str, value: float, tmp_path: Path) -> None:
    (tmp_path / "task.yaml").write_text(changed("duration: 8", f"duration: {text}"))
    assert load(tmp_path / "task.yaml").duration == value


# --- Mutated files ----------------------------------------------------------------------------------------------------

TOKENS = list(":-?[]{},&*!|>'\"%@`#~\t\r\0\x07\x1b\x85\ufeff\u2028\ud7ff\U0001f600\xe9\u0430\\")
TOKENS += ["---", "...", "<<", "&a", "*a", "!!str", "!!python/object:os.system", "null", "true", ".nan", ".inf"]
TOKENS += ["1e400", "-1e400", "1e-400", "1e3", "0x1", "-1", "0", "1e30", "1e31"]
TOKENS += ["\n", "\n\n", " ", "  ", ": ", "- ", "{a: 1}", "[1, 2]", "\n---\n", "a: b\n", "? a\n: b\n", "\t"]


def mutated(number: int) -> bytes:
    """One to five changes of a shipped spec: of bytes, of tokens, of lines, of their order and their depth."""
    rng = random.Random(number)
    data = rng.choice(SHIPPED).encode()
    for _ in range(rng.randint(1, 5)):
        at, end = sorted((rng.randrange(len(data) + 1), rng.randrange(len(data) + 1)))
        end = min(end, at + rng.choice((1, 2, 8, 200)))
        lines = data.split(b"\n")
        row = rng.randrange(len(lines))
        way = rng.randrange(10)
        if way == 0:
            data = data[:at] + bytes([rng.randrange(256)]) + data[at + 1 :]
        elif way == 1:
            data = data[:at] + data[end:]
        elif way == 2:
            data = data[:end] + data[at:end] * rng.choice((1, 2, 50)) + data[end:]
        elif way == 3:
            data = data[:at]
        elif way == 4:
            data = data[:at] + rng.choice(TOKENS).encode("utf-8", "surrogatepass") + data[at:]
        elif way == 5:
            data = data[:at] + rng.randbytes(rng.choice((1, 4, 64))) + data[end:]
        elif way == 6:
            data = b"\n".join([*lines[:row], *rng.choice((lines[row : row + 1] * 2, [])), *lines[row + 1 :]])
        elif way == 7:
            lines[row] = b" " * rng.randrange(6) + rng.choice((lines[row], lines[row].strip()))
            data = b"\n".join(lines)
        elif way == 8:
            words = list(re.finditer(rb"[\w.+-]+", data)) or [re.match(b"", data)]
            word, other = rng.choice(words), rng.choice(words)
            assert word
            assert other
            data = data[: word.start()] + rng.choice((other[0], word[0][::-1], b"")) + data[word.end() :]
        else:
            words = list(re.finditer(rb"-?\d[\d.e]*", data)) or [re.match(b"", data)]
            word = rng.choice(words)
            assert word
            data = data[: word.start()] + rng.choice((b"-1", b"0", b"1e31", b".nan", b"1e9", b"x")) + data[word.end() :]
    return data


@pytest.mark.row(16)
def test_mutated_files_are_read_or_refused_in_their_place(tmp_path: Path, record_property: Any) -> None:
    wanted = os.environ.get("WBC_INPUT")
    file, counts, failed, slowest = tmp_path / "mutated.yaml", Counter[str](), [], (0.0, 0)
    for number in [int(wanted)] if wanted else range(FILES):
        file.write_bytes(mutated(number))
        begun = time.thread_time()
        try:
            load(file)
            counts["accepted"] += 1
        except SpecError as error:
            counts["refused"] += 1
            if not error.faults or not all(fault.line and str(fault).isprintable() for fault in error.faults):
                failed.append((number, f"not placed, or not printable: {error}"))
        except Exception as error:
            failed.append((number, f"{type(error).__name__}: {error}"))
        spent = time.thread_time() - begun
        slowest = max(slowest, (spent, number))
        if LARGE and spent > SECOND:
            failed.append((number, f"{spent:.1f} s"))
    record_property("mutated files", f"{counts['refused']} refused, {counts['accepted']} read")
    record_property("slowest [s]", slowest[0])
    print(dict(counts), f"slowest {slowest[0]:.3f} s: {slowest[1]}")
    told = [f"WBC_INPUT={number} pytest tests/test_inputs_specs.py -k mutated  # {why}" for number, why in failed]
    assert not failed, "\n".join(told)
    if not wanted:
        assert counts["refused"] > FILES / 2  # most are no longer specs
        assert counts["accepted"] > 0  # and some changed a comment, or a number
