"""Specs: what is accepted and how it reads, and every way to be wrong, each with its place and a sentence."""

from __future__ import annotations

import json
import os
import random
import subprocess
import sys
import time
from pathlib import Path

import pytest
from pydantic import ValidationError

from wbc.errors import Fault, SpecError
from wbc.resources import find_file, shipped, shipped_folder, shipped_names
from wbc.spec import Bound, Lissajous, MotionTask, PostureTask, Scale, Spec, json_schema, load, source

ERASER = (shipped_folder("tasks") / "eraser.yaml").read_text()
SHIPPED = shipped_names("tasks", ".yaml")

DOOR = """robot: panda
references: {open: {circle: {radius: 0.1, period: 2}}}
contacts:
  handle:
    frame: hook
    free: {swing: {screw: {axis: z, through: hinge}}}
    artificial: {swing: open, wrench: {fx: 0, fy: 0}}
tasks:
  pull: {type: force, contact: handle, kp: 0.1}
  swing: {type: motion, contact: handle, kp: 1, kd: [2]}
"""

QUINTIC = (
    "robot: a\nreferences: {q: {quintic: {waypoints: [[0, 0, 0], [1, 1, 1], [0, 0, 0, 0, 0, 1]], times: [0, 1, 2]}}}\n"
)


def edited(*edits: tuple[str, str], text: str = ERASER) -> str:
    for old, new in edits:
        assert text.count(old) == 1, f"{old!r} stands {text.count(old)} times in the spec"
        text = text.replace(old, new)
    return text


def faults(tmp_path: Path, text: str | bytes, *overrides: str) -> list[tuple[int, int, str, str]]:
    """Write, load, and return (line, column, key, message) of every fault; [] for a sound spec."""
    file = tmp_path / "wrong.yaml"
    file.write_bytes(text.encode() if isinstance(text, str) else text)
    begun = time.perf_counter()
    try:
        load(file, overrides)
        wrong: tuple[Fault, ...] = ()
    except SpecError as error:
        wrong = error.faults
    assert all(fault.file == str(file) or fault.file.startswith("--set ") for fault in wrong)
    assert all(str(fault).isprintable() for fault in wrong)
    found = [(fault.line, fault.column, fault.key, fault.message) for fault in wrong]
    assert [place[:2] for place in found] == sorted(place[:2] for place in found)
    assert time.perf_counter() - begun < 1
    return found


# One fault each: (edits of the eraser spec or a whole text, line, column, key, a part of the message)
WRONG: dict[str, tuple[object, int, int, str, str]] = {
    "typo in a key": ([("duration:", "durations:")], 7, 1, "durations", "unknown key; did you mean 'duration'?"),
    "typo in a nested key": ([("filter:", "fliter:")], 16, 81, "tasks.press.fliter", "did you mean 'filter'?"),
    "typo in limits": ([("torque_rate", "torqe_rate")], 19, 25, "limits.torqe_rate", "did you mean 'torque_rate'?"),
    "list too short": (
        [("[5, 5, 500]", "[5, 500]")],
        16,
        59,
        "tasks.press.damping",
        "expected 3 numbers (mx, my, fz), got 2",
    ),
    "motion gain too long": (
        [("kd: 20", "kd: [1, 2, 3, 4]")],
        17,
        52,
        "tasks.draw.kd",
        "expected 3 numbers (wz, vx, vy), got 4",
    ),
    "matrix too small": (
        [("kd: 20", "kd: [[1, 0], [0, 1]]")],
        17,
        52,
        "tasks.draw.kd",
        "expected 3 rows (wz, vx, vy), got 2",
    ),
    "both natural": (
        [("fx: 0, fy", "fx: 0, vx: 0, fy")],
        13,
        46,
        "contacts.board.natural.vx",
        "fx and vx are both natural",
    ),
    "both artificial": (
        [("wz: 0, vx", "wz: 0, fx: 0, vx")],
        14,
        46,
        "contacts.board.artificial.vx",
        "fx and vx are both artificial",
    ),
    "an axis of both columns": (
        [("fz: -10", "vz: 0")],
        14,
        63,
        "contacts.board.artificial.vz",
        "vz is both natural and artificial",
    ),
    "wrench along a free motion": (
        [("vx: figure", "fx: 3")],
        14,
        39,
        "contacts.board.artificial.fx",
        "fx is both natural and artificial",
    ),
    "artificial entry missing": (
        [(", fz: -10", "")],
        14,
        5,
        "contacts.board.artificial.fz",
        "fz is missing; natural vz needs",
    ),
    "natural entry missing": (
        [(", vz: 0}", "}")],
        13,
        5,
        "contacts.board.natural.vz",
        "vz is missing; artificial fz needs",
    ),
    "axis misspelt": (
        [("mz: 0, fx", "mq: 0, fx")],
        13,
        32,
        "contacts.board.natural.mq",
        "unknown word 'mq'; did you mean 'mz'?",
    ),
    "target axis misspelt": (
        [("mx: 0, my: 0, wz", "mx: 0, my: 0, wy1: 0, wz")],
        14,
        32,
        "contacts.board.artificial.wy1",
        "unknown axis; did you",
    ),
    "natural value": ([("vz: 0}", "vz: 0.1}")], 13, 53, "contacts.board.natural.vz", "expected 0"),
    "no kind of contact": (DOOR.replace("    free:", "    #"), 4, 3, "contacts.handle", "exactly one of natural, free"),
    "two kinds of contact": (
        [("    artificial", "    holds: all\n    artificial")],
        11,
        3,
        "contacts.board",
        "got natural and holds",
    ),
    "not positive definite": (
        [("kp: 100", "kp: [[1, 2, 0], [2, 1, 0], [0, 0, 1]]")],
        17,
        43,
        "tasks.draw.kp",
        "expected a positive definite matrix, got one whose smallest eigenvalue is -1",
    ),
    "not symmetric": (
        [("kp: 100", "kp: [[1, 2, 0], [0, 1, 0], [0, 0, 1]]")],
        17,
        43,
        "tasks.draw.kp",
        "expected a symmetric matrix",
    ),
    "not square": (
        [("kp: 100", "kp: [[1, 2], [2]]")],
        17,
        43,
        "tasks.draw.kp",
        "square matrix, got rows of 2, 1 numbers",
    ),
    "negative gain": ([("kp: 0.3", "kp: -0.3")], 16, 42, "tasks.press.kp", "expected a number of at least 0, got -0.3"),
    "negative gain in a list": ([("[5, 5, 500]", "[5, -5, 500]")], 16, 72, "tasks.press.damping[1]", "got -5"),
    "NaN": ([("kd: 20", "kd: .nan")], 17, 52, "tasks.draw.kd", "expected a finite number [1/s], got nan"),
    "infinity": ([("duration: 8", "duration: .inf")], 7, 1, "duration", "expected a finite number [s], got inf"),
    "overflow": ([("rate: 1000 ", "rate: 1e999 ")], 6, 1, "rate", "expected a finite number [Hz], got inf"),
    "zero rate": ([("rate: 1000 ", "rate: 0 ")], 6, 1, "rate", "expected a number of at least 1 [Hz], got 0"),
    "text for a number": ([("rate: 1000 ", "rate: '1000' ")], 6, 1, "rate", "expected a number [Hz], got '1000'"),
    "truth for a number": ([("rate: 1000 ", "rate: true ")], 6, 1, "rate", "expected a number [Hz], got True"),
    "YAML 1.1 truth": ([("rate: 1000 ", "rate: on ")], 6, 1, "rate", "expected a number [Hz], got 'on'"),
    "sexagesimal": ([("duration: 8", "duration: 12:30:45")], 7, 1, "duration", "expected a number [s], got '12:30:45'"),
    "octal": ([("rate: 1000 ", "rate: 0o17 ")], 6, 1, "rate", "expected a number [Hz], got '0o17'"),
    "number for a text": ([("tool: eraser", "tool: 5")], 4, 1, "tool", "expected a text, got 5"),
    "list for a mapping": (
        [("limits: {torque: model, torque_rate: 1000, position: model, velocity: model}", "limits: [1]")],
        19,
        1,
        "limits",
        "got a list",
    ),
    "nothing for a mapping": ("robot: a\ntasks:\n", 2, 1, "tasks", "expected a mapping, got nothing"),
    "duplicate key": ([("rate: 1000 ", "robot: ur5\nrate: 1000 ")], 6, 1, "robot", "given twice; first on line 3"),
    "duplicate nested key": ([("ki: 10", "kp: 10")], 16, 51, "tasks.press.kp", "given twice; first on line 16"),
    "anchor": ([("robot: panda", "robot: &r panda")], 3, 8, "robot", "anchors (&r) are not supported"),
    "alias": ([("robot: panda", "robot: *r")], 3, 8, "robot", "aliases (*r) are not supported"),
    "merge key": ([("robot: panda", "robot: panda\n<<: {a: 1}")], 4, 1, "<<", "merge keys are not supported"),
    "tag": ([("rate: 1000 ", "rate: !!str 5 ")], 6, 7, "rate", "tags (tag:yaml.org,2002:str) are not supported"),
    "Python tag": ([("tool: eraser", "tool: !!python/name:os.system")], 4, 7, "tool", "are not supported"),
    "list as a key": ([("rate: 1000 ", "[a, b]: 1000 ")], 6, 1, "", "expected a plain name as a key"),
    "mapping as a key": ([("rate: 1000 ", "{a: b}: 1000 ")], 6, 1, "", "expected a plain name as a key"),
    "number as a key": ([("rate: 1000 ", "5: 1000 ")], 6, 1, "5", "unknown key"),
    "name of a task": ([("  draw:", "  2draw:")], 17, 3, "tasks.2draw", "expected a name of letters, digits and _"),
    "two documents": ([("rate: 1000 ", "---\nrate: 1000 ")], 6, 1, "", "a second document begins here"),
    "control character": ([("tool: eraser", "tool: era\x07ser")], 4, 10, "", r"control character '\x07'"),
    "escaped control character": ([("tool: eraser", r'tool: "era\aser"')], 4, 7, "tool", r"control character '\x07'"),
    "line separator": ([("tool: eraser", "tool: era\u2028ser")], 4, 10, "", "control character"),
    "byte order mark": ("\ufeff" + ERASER, 1, 1, "", "byte order mark"),
    "not UTF-8": (ERASER.encode().replace(b"panda", b"pand\xe4"), 3, 12, "", "byte 0xe4 is not UTF-8"),
    "UTF-16": (ERASER.encode("utf-16-le"), 1, 2, "", "control character"),
    "tab": ([("    frame: eraser", "\tframe: eraser")], 12, 1, "", "not readable as YAML"),
    "unclosed bracket": ([("kp: 100, kd: 20}", "kp: 100, kd: 20")], 18, 10, "", "not readable as YAML"),
    "empty": ("", 1, 1, "", "the file is empty; a spec needs at least the line `robot: NAME`"),
    "only comments": ("# nothing\n\n", 1, 1, "", "the file is empty"),
    "list at the top": ("- robot: panda\n", 1, 1, "", "expected a mapping, got a list"),
    "number at the top": ("5\n", 1, 1, "", "expected a mapping, got 5"),
    "3 MB": (b"robot: panda\n" * 240_000, 1, 1, "", "larger than 256 KiB"),
    "too many values": ("a: [" + "1," * 20_000 + "]", 1, 19999, "", "more than 10000 keys and values"),
    "depth 20 000, flow": ("[" * 20_000 + "]" * 20_000, 1, 33, "", "nested more than 32 levels deep"),
    "depth 20 000, mappings": ("{a: " * 20_000, 1, 129, "", "nested more than 32 levels deep"),
    "depth 20 000, block": ("- " * 20_000, 1, 65, "", "nested more than 32 levels deep"),
    "number for a task": ("robot: a\ntasks: {a: 5}", 2, 9, "tasks.a", "expected a mapping, got 5"),
    "robot missing": ([("robot: panda\n", "")], 2, 1, "robot", "is missing; expected the name of a shipped robot"),
    "type missing": (
        [("{type: posture, ", "{")],
        18,
        3,
        "tasks.posture.type",
        "is missing; expected force, motion, relative, gaze, impedance, admittance, com, momentum, distribution",
    ),
    "unknown type": (
        [("type: force", "type: froce")],
        16,
        13,
        "tasks.press.type",
        "unknown type 'froce'; did you mean 'force'?",
    ),
    "unknown reference": (
        [("vx: figure", "vx: figre")],
        14,
        39,
        "contacts.board.artificial.vx",
        "no reference named 'figre'; did you mean 'figure'?",
    ),
    "unknown contact": (
        [("type: motion, contact: board", "type: motion, contact: bord")],
        17,
        27,
        "tasks.draw.contact",
        "no contact named 'bord'; did you mean 'board'?",
    ),
    "unknown reference of a motion": (
        [("contact: board, kp: 100", "frame: hand, target: figur, kp: 100")],
        17,
        40,
        "tasks.draw.target",
        "did you mean 'figure'?",
    ),
    "contact and frame": ([("kp: 100", "frame: hand, kp: 100")], 17, 43, "tasks.draw.frame", "comes from the contact"),
    "target of a force task": (
        [("ki: 10", "target: 3")],
        16,
        51,
        "tasks.press.target",
        "stands in the contact's `artificial`",
    ),
    "second force task": (
        [("  draw:", "  push: {type: force, contact: board}\n  draw:")],
        17,
        23,
        "tasks.push.contact",
        "already has the force task",
    ),
    "no force targets": (
        DOOR.replace(", wrench: {fx: 0, fy: 0}", ""),
        9,
        23,
        "tasks.pull.contact",
        "has no force target in its `artificial`",
    ),
    "unknown screw": (
        DOOR.replace("{swing: open, ", "{swig: open, "),
        7,
        18,
        "contacts.handle.artificial.swig",
        "did you mean 'swing'?",
    ),
    "screw axis": (
        DOOR.replace("axis: z", "axis: [0, 0]"),
        6,
        28,
        "contacts.handle.free.swing.screw.axis",
        "3 numbers (x, y, z), got 2",
    ),
    "zero screw axis": (
        DOOR.replace("axis: z", "axis: [0, 0, 0]"),
        6,
        28,
        "contacts.handle.free.swing.screw.axis",
        "got the zero vector",
    ),
    "row of A": (
        "robot: a\ncontacts: {c: {frame: f, A: [[1, 0, 0, 0, 0, 0], [1, 2, 3, 4, 5]]}}",
        2,
        50,
        "contacts.c.A[1]",
        "expected 6 numbers",
    ),
    "held twice": (
        "robot: a\ncontacts: {c: {frame: f, holds: [vz, vz]}}",
        2,
        26,
        "contacts.c.holds",
        "vz is given twice",
    ),
    "motion of a held axis": (
        "robot: a\ncontacts: {c: {frame: f, holds: [vz], artificial: {vz: 1}}}",
        2,
        52,
        "contacts.c.artificial.vz",
        "vz is held",
    ),
    "force along a free axis": (
        "robot: a\ncontacts: {c: {frame: f, holds: [vz], artificial: {wrench: {fx: 1}}}}",
        2,
        61,
        "contacts.c.artificial.wrench.fx",
        "vx is free",
    ),
    "two kinds of reference": (
        [("{lissajous:", "{hold: {}, lissajous:")],
        9,
        3,
        "references.figure",
        "got hold and lissajous",
    ),
    "vector": (
        [("size: [0.12, 0.06]", "size: [0.12]")],
        9,
        35,
        "references.figure.lissajous.size",
        "expected 2 numbers (x, y), got 1",
    ),
    "times": (
        QUINTIC.replace("[0, 1, 2]", "[0, 1]"),
        2,
        83,
        "references.q.quintic.times",
        "expected 3 times, one a way point, got 2",
    ),
    "times go back": (
        QUINTIC.replace("[0, 1, 2]", "[0, 1, 1]"),
        2,
        97,
        "references.q.quintic.times[2]",
        "expected a time after 1 s",
    ),
    "way point": (
        QUINTIC.replace("[1, 1, 1]", "[1, 1, 1, 1]"),
        2,
        51,
        "references.q.quintic.waypoints[1]",
        "(x, y, z, rx, ry, rz), got 4",
    ),
    "torque without a limit": (
        [("torque: model", "torque: null")],
        19,
        10,
        "limits.torque",
        "expected model, a number, a list",
    ),
    "scale above 1": (
        [("torque: model", "torque: {scale: 1.5}")],
        19,
        19,
        "limits.torque.scale",
        "of at most 1, got 1.5",
    ),
    "rate of the model": (
        [("torque_rate: 1000", "torque_rate: model")],
        19,
        25,
        "limits.torque_rate",
        "expected a number, a list",
    ),
    "delay": ("robot: a\nplant: {delay: 1.5}", 2, 9, "plant.delay", "expected a whole number [ticks], got 1.5"),
    "bound without bounds": ("robot: a\nexpect: {a.b: {}}", 2, 10, "expect.a.b", "expected min, max or both"),
    "bounds crossed": (
        "robot: a\nexpect: {a.b: {min: 2, max: 1}}",
        2,
        16,
        "expect.a.b.min",
        "expected at most max = 1, got 2",
    ),
    "phase without an end": (
        [("expect:", "phases: {a: {}, b: {}}\nexpect:")],
        20,
        10,
        "phases.a.until",
        "only the last phase",
    ),
    "end of the only phase": (
        [("expect:", "phases: {a: {until: {time: 1}}}\nexpect:")],
        20,
        14,
        "phases.a.until",
        "the last phase runs to the end; remove until, or add a phase after it",
    ),
    "end of the last phase": (
        [("expect:", "phases: {a: {until: {time: 1}}, b: {until: {time: 2}}}\nexpect:")],
        20,
        37,
        "phases.b.until",
        "the last phase runs to the end",
    ),
    "phase sets nothing known": (
        [("expect:", "phases: {a: {set: {tasks.pres.kp: 1}}}\nexpect:")],
        20,
        20,
        "phases.a.set.tasks.pres.kp",
        "tasks.pres: no such key; did you mean 'press'?",
    ),
    "phase sets a wrong value": (
        [("expect:", "phases: {a: {set: {tasks.press.kp: -1}}}\nexpect:")],
        20,
        20,
        "phases.a.set.tasks.press.kp",
        "of at least 0, got -1",
    ),
    "phase sets what it may not": (
        [("expect:", "phases: {a: {set: {rate: 100}}}\nexpect:")],
        20,
        20,
        "phases.a.set.rate",
        "a phase can change contacts, tasks",
    ),
}


@pytest.mark.parametrize("case", WRONG)
def test_one_fault_is_told_with_its_place(tmp_path: Path, case: str) -> None:
    text, line, column, key, message = WRONG[case]
    found = faults(tmp_path, edited(*text) if isinstance(text, list) else text)  # type: ignore[arg-type]
    assert [fault[:3] for fault in found] == [(line, column, key)]
    assert message in found[0][3]


def test_all_faults_are_told_at_once_and_in_order(tmp_path: Path) -> None:
    text = edited(
        ("robot: panda", "robot: 5"),
        ("rate: 1000 ", "rate: &x 1000 "),
        ("vx: figure", "vx: figre"),
        ("[5, 5, 500]", "[5, 500]"),
        ("type: motion, contact: board", "type: motion, contact: bord"),
        ("kp: 50,", "kp: -50,"),
        ("torque_rate", "torqe_rate"),
        ("expect:", "phases: {a: {set: {tasks.posture.kp: 1, tasks.pst.kp: 2, tasks.press.kp: 3}}}\nexpect:"),
    )
    expected = "robot rate contacts.board.artificial.vx tasks.press.damping tasks.draw.contact tasks.posture.kp"
    keys = [fault[2] for fault in faults(tmp_path, text)]
    assert keys == [*expected.split(), "limits.torqe_rate", "phases.a.set.tasks.pst.kp"]


def test_a_faulty_entry_does_not_make_others_look_wrong(tmp_path: Path) -> None:
    text = edited(("frame: eraser", "frame: 5"), ("expect:", "phases: {a: {set: {tasks.draw.kp: 1}}}\nexpect:"))
    assert [fault[2] for fault in faults(tmp_path, text)] == ["contacts.board.frame"]


def test_a_faulty_last_phase_does_not_make_the_one_before_look_last(tmp_path: Path) -> None:
    text = edited(("expect:", "phases: {a: {until: {time: 1}}, b: {set: 5}}\nexpect:"))
    assert [fault[2] for fault in faults(tmp_path, text)] == ["phases.b.set"]


def test_thousands_of_faults_are_cut(tmp_path: Path) -> None:
    found = faults(tmp_path, "robot: a\n" + "".join(f"k{i}: 1\n" for i in range(4900)))
    assert len(found) == source.MAX_FAULTS + 1
    assert any("more faults" in fault[3] for fault in found)


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("earser", "no such file, and no shipped spec of that name; did you mean 'eraser'?"),
        ("no/such/file.yaml", "no such file"),
        ("../tasks/eraser", "no such file"),
        ("a" * 5000, "no such file"),
        ("nul\0", "no such file"),
    ],
)
def test_missing_file(name: str, message: str) -> None:
    with pytest.raises(SpecError) as caught:
        load(name)
    (fault,) = caught.value.faults
    assert (fault.line, fault.column) == (0, 0)
    assert message in fault.message


def test_only_a_regular_file_is_read(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe.yaml")
    for name in (tmp_path, tmp_path / "pipe.yaml", Path(os.devnull)):
        with pytest.raises(SpecError, match="is not a regular file"):
            load(name)


@pytest.mark.parametrize("text", ["secret", "secret: [1", "secret: *secret", "- secret", "a: 1\na: 2\n", "se\x07cret"])
def test_a_file_that_may_be_no_spec_is_not_quoted(tmp_path: Path, text: str) -> None:
    file = tmp_path / "shadow"
    file.write_text(text)
    with pytest.raises(SpecError, match="shadow: not readable as a YAML mapping; name the file") as caught:
        load(file)
    assert "secret" not in str(caught.value)
    file.write_text(ERASER)
    assert load(file).model_dump() == load("eraser").model_dump()


# --- What is accepted ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", SHIPPED)
def test_shipped_specs_load_by_name_and_by_path(name: str) -> None:
    spec = load(name)
    assert spec.file == str(shipped("tasks", name, ".yaml"))
    assert load(spec.file).model_dump() == spec.model_dump()
    assert Path(spec.file).read_text().startswith("# yaml-language-server: $schema=schema.json\n")


def test_the_example_reads_as_written() -> None:
    spec = load("eraser")
    board, press = spec.contacts["board"], spec.tasks["press"]
    assert board.kind == "natural"
    assert board.constrained == ("wx", "wy", "vz")
    assert board.free_axes == ("wz", "vx", "vy")
    assert board.force_axes == ("mx", "my", "fz")
    assert board.wrench_targets == {"mx": 0, "my": 0, "fz": -10}
    assert board.motion_targets == {"wz": 0, "vx": "figure", "vy": "figure"}
    assert press.type == "force"
    assert (press.kp, press.damping, press.filter, press.weight) == (0.3, (5, 5, 500), 50, 1)
    assert isinstance(spec.tasks["draw"], MotionTask)
    assert isinstance(spec.tasks["posture"], PostureTask)
    figure = spec.references["figure"]
    assert figure.kind == "lissajous"
    assert figure.curve == Lissajous.model_validate({"in": "board", "size": [0.12, 0.06], "period": [6, 3]})
    assert spec.expect.settle == 1
    assert spec.expect.bounds["draw.position.rms_error"] == Bound(max=8e-5)
    assert (spec.law, spec.gravity, spec.start, spec.solver) == ("compensated", "controller", None, "daqp")


def test_the_other_ways_to_hold_a_frame() -> None:
    contacts = {
        "door": {"frame": "hook", "free": {"swing": {"screw": {"axis": "z", "through": "hinge"}}}},
        "foot": {"frame": "sole", "holds": "all"},
        "wheel": {"frame": "hub", "holds": ["vz", "vy"], "artificial": {"vx": 0.1, "wrench": {"fz": -5}}},
        "plane": {"frame": "tip", "A": [[0, 0, 0, 0, 0, 1]], "artificial": {"vx": 0.1, "wrench": {"fz": -5}}},
    }
    spec = Spec.model_validate({"robot": "panda", "contacts": contacts})
    door, foot, wheel, plane = spec.contacts.values()
    assert [contact.kind for contact in spec.contacts.values()] == ["free", "holds", "holds", "A"]
    assert (door.constrained, door.free_axes, door.targets) == ((), ("swing",), {})
    assert (len(foot.constrained), foot.free_axes) == (6, ())
    assert wheel.constrained == ("vy", "vz")
    assert wheel.targets == plane.targets == {"vx": 0.1, "fz": -5}
    assert [contact.gain_names("force") for contact in (door, foot, wheel, plane)] == [
        None,
        None,
        ("fy", "fz"),
        ("row 0",),
    ]
    assert [contact.gain_names("motion") for contact in (door, foot, wheel, plane)] == [("swing",), None, None, None]


def test_gain_matrices_and_limits_of_every_form(tmp_path: Path) -> None:
    matrix = "[[2, 1, 0], [1, 2, 0], [0, 0, 1]]"
    limits = ["{scale: 0.5}", "12", "[1, 2, 3]", "{joint1: 5}"]
    for form in limits:
        text = edited(("kp: 100", f"kp: {matrix}"), ("torque: model", f"torque: {form}"))
        assert faults(tmp_path, text) == []
    spec = load("eraser", ["limits.torque={scale: 0.5}", f"tasks.draw.kp={matrix}", "limits.position={margin: 0.1}"])
    assert spec.limits.torque == Scale(scale=0.5)
    assert spec.tasks["draw"].kp == ((2, 1, 0), (1, 2, 0), (0, 0, 1))


@pytest.mark.parametrize(
    ("text", "value"),
    [("1e3", 1e3), ("1e-3", 1e-3), (".5", 0.5), ("5.", 5), ("+2", 2), ("-0.0e+1", 0), ("010", 10), ("1E3", 1e3)],
)
def test_numbers(text: str, value: float) -> None:
    number = source.scalar(text)
    assert number == value
    assert not isinstance(number, bool | str)


@pytest.mark.parametrize(
    "text", ["yes", "no", "on", "off", "y", "12:30:45", "0x1F", "0o17", "1_000", "2001-01-01", "1e", "."]
)
def test_texts(text: str) -> None:
    assert source.scalar(text) == text


def test_truth_and_nothing() -> None:
    assert [source.scalar(text) for text in ("true", "false", "null", "~", "")] == [True, False, None, None, None]


def test_both_yaml_parsers_read_the_same(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    import yaml

    texts = [ERASER, "a: 1\na: 2\né: {b: &x 1, c: *x}\nd: [!!str 5, 'q', \"\\t\"]\n? e\n: f\n", "a: |\n  b\n  c\n"]
    fast = [source.parse(text, "f") for text in texts]
    monkeypatch.setattr(source, "_LOADER", yaml.SafeLoader)
    assert [source.parse(text, "f") for text in texts] == fast
    assert faults(tmp_path, "[" * 20_000) == [(1, 33, "", "nested more than 32 levels deep")]


def test_objects_are_frozen() -> None:
    with pytest.raises(ValidationError, match="frozen"):
        load("eraser").rate = 5  # type: ignore[misc]


# --- Places, overrides, changes --------------------------------------------------------------------------------------


def test_where_is_the_nearest_key_that_exists() -> None:
    spec = load("eraser")
    assert spec.where("tasks", "press", "kp") == (16, 42)
    assert spec.where("tasks", "press", "damping", 2) == (16, 75)
    assert spec.where("tasks", "press", "weight") == spec.where("tasks", "press") == (16, 3)
    assert spec.where("plant", "noise") == (2, 1)
    assert str(spec.fault(("contacts", "board", "frame"), "no such frame")).endswith(
        "eraser.yaml:12:5: contacts.board.frame: no such frame"
    )


def test_without_a_file_there_is_no_place() -> None:
    spec = Spec.model_validate({"robot": "panda"})
    assert spec.where("robot") == (0, 0)
    assert str(spec.fault(("robot",), "unknown")) == "spec: robot: unknown"
    with pytest.raises(SpecError, match=r"^spec: rate: expected a finite number \[Hz\], got nan$"):
        Spec.model_validate({"robot": "panda", "rate": float("nan")})
    with pytest.raises(SpecError, match="expected a mapping"):
        Spec.model_validate([])


def test_overrides_come_before_the_checks() -> None:
    spec = load("eraser", ["tasks.press.kp=0.2", "tasks.press.damping.2=400", "tool=", "tasks.draw.weight=2"])
    assert load("eraser", ["tool=null"]).tool is None
    assert (spec.tasks["press"].kp, spec.tasks["press"].damping, spec.tool) == (0.2, (5, 5, 400), None)
    assert spec.tasks["draw"].weight == 2
    assert load("eraser", {"plant.noise.force": "0.5"}).plant.noise.force == 0.5  # these sections need not be there
    assert load("eraser", {"start": "{joint1: 0.1}"}).start == {"joint1": 0.1}


@pytest.mark.parametrize(
    ("override", "key", "message"),
    [
        ("tasks.press.kp", "", "expected key.path=value"),
        ("=5", "", "expected key.path=value"),
        ("tasks.pres.kp=1", "tasks.pres", "no such key; did you mean 'press'?"),
        ("tasks.press.kpp=1", "tasks.press.kpp", "unknown key; did you mean 'kp'?"),
        ("tasks.press.kp=-1", "tasks.press.kp", "of at least 0, got -1"),
        ("tasks.press.damping=[1, 2]", "tasks.press.damping", "expected 3 numbers (mx, my, fz), got 2"),
        ("tasks.press.damping.3=1", "tasks.press.damping.3", "expected a position from 0 to 2"),
        ("tasks.press.kp.a=1", "tasks.press.kp", "is 0.3, which has no keys"),
        ("rate=.nan", "rate", "expected a finite number [Hz], got nan"),
        ("rate=[", "rate", "not readable as YAML"),
        ("rate=&a 5", "rate", "anchors"),
        ("robot=a: b", "robot", "expected a number, a text, [a list] or {a: mapping}"),
        ("title=" + "[" * 20_000, "title", "nested more than 32 levels deep"),
        ("a." * 100_000 + "b=1", "a", "no such key"),
        ("expect.settle=0", "expect.settle", "bounds cannot be changed"),
        ("expect={}", "expect", "bounds cannot be changed"),
    ],
)
def test_wrong_override(tmp_path: Path, override: str, key: str, message: str) -> None:
    ((line, column, found, text),) = faults(tmp_path, ERASER, override)
    assert (line, column, found) == (0, 0, key)
    assert message in text


def test_override_and_file_are_told_apart(tmp_path: Path) -> None:
    file = tmp_path / "both.yaml"
    file.write_text(edited(("rate: 1000 ", "rate: x ")))
    with pytest.raises(SpecError) as caught:
        load(file, ["tasks.press.kp=x", "duration=0"])
    assert [fault.file for fault in caught.value.faults] == ["--set duration=0", "--set tasks.press.kp=x", str(file)]
    spec = load("eraser", ["tasks.press={type: force, contact: board}"])
    assert spec.fault(("tasks", "press", "kp"), "").file == "--set tasks.press={type: force, contact: board}"


def test_with_set_is_a_checked_copy() -> None:
    spec = load("eraser_weak")
    weak = spec.with_set(spec.phases["weak"].set)
    assert weak.limits.torque == Scale(scale=0.26)
    assert spec.limits.torque == Scale(scale=1)
    assert weak.where("tasks", "draw") == spec.where("tasks", "draw")
    assert weak.with_set({"limits.torque.scale": 1}).model_dump() == spec.model_dump()
    with pytest.raises(SpecError, match=r"eraser_weak\.yaml:16:42: tasks\.press\.kp: expected a number of at least 0"):
        spec.with_set({"tasks.press.kp": -1})
    with pytest.raises(SpecError, match=r"eraser_weak\.yaml:15:1: tasks\.pres: no such key"):
        spec.with_set({"tasks.pres.kp": 1})
    with pytest.raises(SpecError, match=r"tasks\.draw\.kd: expected 3 numbers"):
        spec.with_set({"tasks.draw.kd": [1, 2]})


# --- Mutations -------------------------------------------------------------------------------------------------------


def mutated(seed: int) -> bytes:
    """The eraser spec with one to eight random bytes changed, removed, inserted, or pieces doubled or swapped."""
    rng, data = random.Random(seed), bytearray(ERASER.encode())
    alphabet = b" \n\t:{}[],&*!|>'\"%@`#-?.0e~" + bytes(range(256))
    for _ in range(rng.randint(1, 8)):
        at, to = sorted(rng.randrange(len(data)) for _ in range(2))
        match rng.randrange(5):
            case 0:
                data[at] = rng.choice(alphabet)
            case 1:
                del data[at : at + rng.randint(1, 4)]
            case 2:
                data.insert(at, rng.choice(alphabet))
            case 3:
                data[at:at] = data[at : min(to, at + 40)]
            case _:
                data[at:to] = data[at + (to - at) // 2 : to] + data[at : at + (to - at) // 2]
    return bytes(data)


def test_500_mutated_files_never_give_a_traceback(tmp_path: Path) -> None:
    accepted = 0
    for seed in range(500):
        try:
            accepted += not faults(tmp_path, mutated(seed))  # asserts the time and the form of every fault
        except BaseException as error:
            error.add_note(f"the file is mutated({seed})")
            raise
    assert 0 < accepted < 250


# --- Schema ----------------------------------------------------------------------------------------------------------


def test_the_shipped_schema_is_in_step() -> None:
    shipped_schema = json.loads((shipped_folder("tasks") / "schema.json").read_text())
    assert shipped_schema == json_schema(), "write tasks/schema.json anew: wbc schema > tasks/schema.json"


def test_the_schema_describes_every_key() -> None:
    schema = json_schema()
    for name, part in {"Spec": schema, **schema["$defs"]}.items():
        assert part["description"], name
        for key, value in part["properties"].items():
            assert value.get("description"), f"{name}.{key}"
    assert schema["properties"]["rate"]["description"] == "control rate [Hz]"
    assert schema["$schema"].endswith("2020-12/schema")


@pytest.mark.parametrize("name", SHIPPED)
def test_shipped_specs_fit_the_schema(name: str) -> None:
    schema = json_schema()
    tree = source.parse((shipped_folder("tasks") / f"{name}.yaml").read_bytes(), name).whole().tree
    assert set(schema["required"]) <= set(tree) <= set(schema["properties"])
    validator = pytest.importorskip("jsonschema").Draft202012Validator
    validator.check_schema(schema)
    assert [error.message for error in validator(schema).iter_errors(tree)] == []


def test_the_spec_needs_no_heavy_import() -> None:
    code = "import sys, wbc.spec; wbc.spec.load('eraser'); print([m for m in sys.argv[1:] if m in sys.modules])"
    run = [sys.executable, "-c", code, "mujoco", "pinocchio", "numpy", "qpsolvers"]
    assert subprocess.run(run, capture_output=True, text=True, check=True).stdout == "[]\n"


def test_shipped_files() -> None:
    assert "eraser" in SHIPPED
    assert shipped("tasks", "earser", ".yaml") is None
    assert shipped("tasks", "../tasks/eraser", ".yaml") is None
    assert find_file("tasks", "eraser", ".yaml") == shipped("tasks", "eraser", ".yaml")
    assert shipped_names("no/such/kind", ".xml") == []
