"""Phases in a spec: what they say when nothing is wrong, and where a fault of theirs is told."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.test_spec import edited, faults
from wbc.resources import shipped_folder
from wbc.spec import Within, load

LIFTOFF = (shipped_folder("tasks") / "chalk_liftoff.yaml").read_text()
TOUCHED = "until: {board.fz: {max: -1, for: 0.003}}"
WRITE = "{tasks: [press, draw, posture], until: {draw.done: true}, lost: leave}"
LEAVE = "{contacts: [], tasks: [lift, posture]}"


def test_what_a_phase_says() -> None:
    spec = load("chalk_liftoff")
    approach, write, leave = spec.phases.values()
    assert approach.active("contacts", spec.contacts) == ()
    assert approach.active("tasks", spec.tasks) == ("reach", "posture")
    assert write.active("contacts", spec.contacts) == ("board",)
    assert approach.until is not None
    assert approach.until.conditions == {"board.fz": Within(max=-1.0, **{"for": 0.003})}
    assert (approach.timeout, approach.else_, approach.lost) == (4.0, None, None)
    assert write.until is not None
    assert write.until.conditions == {"draw.done": Within(min=1.0)}
    assert (write.lost, leave.until) == ("leave", None)


def test_a_number_is_an_upper_bound_but_for_the_time() -> None:
    spec = load("chalk_liftoff", ["phases.write.until={time: 2, draw.error: 0.001, draw.speed: {min: 0, max: 0.1}}"])
    until = spec.phases["write"].until
    assert until is not None
    assert until.conditions == {
        "time": Within(min=2.0), "draw.error": Within(max=0.001), "draw.speed": Within(min=0.0, max=0.1),
    }  # fmt: skip


def test_without_names_everything_is_active() -> None:
    spec = load("eraser_weak")
    for phase in spec.phases.values():
        assert phase.active("tasks", spec.tasks) == tuple(spec.tasks)
        assert phase.active("contacts", spec.contacts) == tuple(spec.contacts)


def test_a_phase_with_changed_values_is_checked_with_them() -> None:
    spec = load("chalk_liftoff", ["phases.write.set={tasks.press.kp: 0.2}"])
    changed = spec.with_set(spec.phases["write"].set)
    assert changed.tasks["press"].kp == 0.2  # type: ignore[union-attr]
    assert changed.phases == spec.phases


def test_a_phase_that_only_a_loss_or_a_time_out_leads_to_may_follow_one_without_an_end(tmp_path: Path) -> None:
    text = edited((LEAVE, LEAVE + "\n  again: {contacts: [], tasks: [lift]}"), text=LIFTOFF)
    for way in ("lost: again}", "lost: leave, timeout: 9, else: again}"):
        assert faults(tmp_path, text.replace("lost: leave}", way)) == []
    assert [key for _, _, key, _ in faults(tmp_path, text)] == ["phases.leave.until"]


# what is changed -> key, message
WRONG = {
    "unknown contact": (
        "approach: {contacts: []",
        "approach: {contacts: [bord]",
        "approach.contacts[0]",
        "no contact named 'bord'; did you mean 'board'?",
    ),
    "unknown task": (
        "tasks: [reach, posture]",
        "tasks: [reach, postur]",
        "approach.tasks[1]",
        "no task named 'postur'; did you mean 'posture'?",
    ),
    "twice": ("tasks: [reach, posture]", "tasks: [reach, posture, reach]", "approach.tasks[2]", "reach is given twice"),
    "no list": ("tasks: [reach, posture]", "tasks: reach", "approach.tasks", "expected a list"),
    "on a contact that is not active": (
        "tasks: [reach, posture]",
        "tasks: [reach, draw, posture]",
        "approach.tasks",
        "task 'draw' is on contact 'board', which is not active",
    ),
    "all tasks without the contact": (
        "{contacts: [], tasks: [lift, posture]}",
        "{contacts: []}",
        "leave.contacts",
        "which is not active; only active ones: list the tasks of this phase",
    ),
    "unknown quantity": (
        TOUCHED,
        "until: {board.fzz: -1}",
        "approach.until.board.fzz",
        "no such quantity; did you mean 'board.fz'",
    ),
    "unknown subject": (
        TOUCHED,
        "until: {bord.fz: -1}",
        "approach.until.bord.fz",
        "no such quantity; did you mean 'board.fz'",
    ),
    "no subject": (TOUCHED, "until: {tim: 1}", "approach.until.tim", "no such quantity; did you mean 'time'"),
    "task of another phase": (
        TOUCHED,
        "until: {draw.done: true}",
        "approach.until.draw.done",
        "task 'draw' is not active in this phase",
    ),
    "done of a force": (
        "until: {draw.done: true}",
        "until: {press.done: true}",
        "write.until.press.done",
        "no such quantity",
    ),
    "done is no number": (
        "until: {draw.done: true}",
        "until: {draw.done: 1}",
        "write.until.draw.done",
        "expected true",
    ),
    "done is not false": (
        "until: {draw.done: true}",
        "until: {draw.done: false}",
        "write.until.draw.done",
        "expected true, got False",
    ),
    "a force is not true": (TOUCHED, "until: {board.fz: true}", "approach.until.board.fz", "only what is done is true"),
    "no bounds": (TOUCHED, "until: {board.fz: {for: 1}}", "approach.until.board.fz", "expected min, max or both"),
    "bounds crossed": (
        TOUCHED,
        "until: {board.fz: {min: 1, max: 0}}",
        "approach.until.board.fz.min",
        "expected at most max = 0, got 1",
    ),
    "negative duration": (
        TOUCHED,
        "until: {board.fz: {max: -1, for: -1}}",
        "approach.until.board.fz.for",
        "of at least 0 [s], got -1",
    ),
    "a condition of no kind": (
        TOUCHED,
        "until: {board.fz: [1]}",
        "approach.until.board.fz",
        "expected a number (an upper bound)",
    ),
    "nothing to wait for": (TOUCHED, "until: {}", "approach.until", "expected at least one quantity"),
    "no time at all": ("timeout: 4", "timeout: 0", "approach.timeout", "greater than 0 [s], got 0"),
    "else of nothing": ("timeout: 4", "else: leave", "approach.else", "expected a timeout beside it"),
    "unknown else": (
        "timeout: 4",
        "timeout: 4, else: leav",
        "approach.else",
        "no phase named 'leav'; did you mean 'leave'?",
    ),
    "unknown lost": ("lost: leave", "lost: leav", "write.lost", "no phase named 'leav'; did you mean 'leave'?"),
    "nothing to lose": ("timeout: 4", "timeout: 4, lost: leave", "approach.lost", "nothing presses in this phase"),
    "a word that is taken": ("leave:    {", "stop:    {", "stop", "this word is taken by the end of a run"),
    "misspelt key": ("timeout: 4", "timeuot: 4", "approach.timeuot", "unknown key; did you mean 'timeout'?"),
    "no end": (
        TOUCHED + ", timeout: 4",
        "timeout: 4",
        "approach.until",
        "only the last phase may go on without an end",
    ),
}


@pytest.mark.parametrize("case", WRONG)
def test_one_fault_is_told_with_its_place(tmp_path: Path, case: str) -> None:
    old, new, key, message = WRONG[case]
    text = edited((old, new), text=LIFTOFF)
    if case == "a word that is taken":
        text = text.replace("lost: leave", "lost: stop")
    found = faults(tmp_path, text)
    assert {fault[2] for fault in found} == {f"phases.{key}"}
    assert message in found[0][3]
    lines = text.splitlines()
    assert case == "no end" or new.split(":")[0].split("{")[0].strip()[:5] in lines[found[0][0] - 1]


def test_what_no_phase_uses_is_told(tmp_path: Path) -> None:
    text = edited(("tasks: [lift, posture]", "tasks: [posture]"), text=LIFTOFF)
    assert [(key, "is active in no phase" in message) for _, _, key, message in faults(tmp_path, text)] == [
        ("tasks.lift", True)
    ]
    text = edited((WRITE, "{contacts: [], tasks: [posture], until: {time: 1}}"), text=LIFTOFF)
    assert [key for _, _, key, _ in faults(tmp_path, text)] == ["contacts.board", "tasks.press", "tasks.draw"]


def test_a_faulty_task_does_not_make_the_phases_look_wrong(tmp_path: Path) -> None:
    text = edited(("target: down, kp: 100", "target: down, kp: -100"), text=LIFTOFF)
    assert [key for _, _, key, _ in faults(tmp_path, text)] == ["tasks.reach.kp"]
