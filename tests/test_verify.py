"""The certificate: it holds for the shipped specs, and fails for a controller with any one thing wrong."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

import wbc.task.motion
from tests.bars import KEPT_STATES, TAU_ERROR, TAU_ERROR_MUJOCO
from wbc.cli.verify import tell
from wbc.contact import Contact, Held
from wbc.errors import SpecError
from wbc.resources import shipped_names
from wbc.spec import Spec, load
from wbc.state import State
from wbc.task.force import ForceTask
from wbc.task.posture import PostureTask
from wbc.verify import LAWS, STATES, Certificate, Worst, tolerance, verify

KEYS = ["spec", "ok", "states", "dropped", "lifted", "max_tau_error_mujoco", "laws"]
OF_A_LAW = ["max_tau_error", "max_vdot_error", "max_lambda_error", "max_kkt_residual"]


def short(name: str | Path = "eraser", seconds: float = 0.02, *changes: str) -> Spec:
    return load(name, [f"duration={seconds}", *changes])


@pytest.fixture(scope="module")
def certificate() -> Certificate:
    return verify(short(seconds=0.2), states=150)


def test_eraser_holds(certificate):
    assert certificate.ok
    assert set(certificate.laws) == set(LAWS) == {"compensated", "book"}
    for worst in certificate.laws.values():
        # not one of them is left at its start of exactly zero
        assert 0 < worst.max_tau_error <= TAU_ERROR["daqp"]
        assert 0 < worst.max_vdot_error <= TAU_ERROR["daqp"]
        assert 0 < worst.max_lambda_error <= TAU_ERROR["daqp"]
        assert 0 < worst.max_kkt_residual <= 1e-6
    assert 0 < certificate.max_tau_error_mujoco <= TAU_ERROR_MUJOCO
    assert certificate.ticks == 200
    assert certificate.states + certificate.dropped == 150
    assert certificate.states >= KEPT_STATES / STATES * 150
    assert certificate.lifted < 20  # only the start runs into the rate limit


def test_json_has_the_keys_of_the_contract(certificate):
    told = json.loads(json.dumps(certificate.as_json()))
    assert set(KEYS) <= set(told)
    assert told["spec"] == "eraser"
    assert told["ok"] is True
    assert all(list(law) == OF_A_LAW for law in told["laws"].values())


def test_it_says_how_many_states_it_kept_and_dropped(certificate, capsys):
    tell(certificate)
    said = " ".join(capsys.readouterr().out.split())
    assert f"{certificate.states} random states ({certificate.dropped} ill-conditioned ones dropped)" in said
    assert certificate.dropped > 0
    assert "holds" in said


def test_same_seed_same_certificate():
    first, again, other = (verify(short(), states=5, seed=seed) for seed in (1, 1, 2))
    assert first == again
    assert first != other


@pytest.mark.parametrize(
    ("name", "solver", "changes"),
    [
        ("planar", "daqp", ()),
        ("eraser", "proxqp", ()),
        ("eraser", "daqp", ("tasks.draw.kp=[90, 100, 110]", "tasks.draw.kd=[18, 20, 22]")),
    ],
    ids=["planar arm", "proxqp", "gains by axis"],
)
def test_other_arm_solver_and_gains(name, solver, changes):
    found = verify(short(name, 0.02, *changes), solver, states=20)
    assert found.ok, found
    assert found.tolerance == TAU_ERROR[solver]


# floating bases have none, see test_floating; these two are tested above
ARMS = [
    n
    for n in shipped_names("tasks", ".yaml")
    if not n.startswith(("g1", "go2", "panda_dual", "talos")) and n not in ("eraser", "planar")
]


@pytest.mark.parametrize("solver", ["daqp", "proxqp"])
@pytest.mark.parametrize("name", ARMS)
def test_every_spec_has_its_closed_form(name, solver):
    found = verify(short(name, 0.008), solver, states=12)
    assert found.ok, found
    assert found.states >= 9
    assert found.ticks == 8
    assert not found.left_out
    assert min(law.max_tau_error for law in found.laws.values()) > 0


def written(tmp_path: Path, *changes: tuple[str, str]) -> Path:
    """The spec below, changed."""
    text, file = ELBOW, tmp_path / "changed.yaml"
    for old, new in changes:
        assert text.count(old) == 1
        text = text.replace(old, new)
    file.write_text(text)
    return file


def test_a_law_that_is_not_defined_for_a_spec_is_left_out_and_said(tmp_path, capsys):
    motion = "  draw:    {type: motion, contact: board, kp: 100, kd: 20}\n  posture:"
    file = written(tmp_path, ("vx]", "vz]"), ("  posture:", motion))
    found = verify(short(file), states=20)
    assert found.ok, found
    assert set(found.laws) == {"compensated"}
    assert "one contact and one motion task on it; there are 1 contacts and 2" in found.left_out["book"]
    assert found.as_json()["left_out"] == found.left_out
    tell(found)
    assert "law book left out: the book's is for one contact" in " ".join(capsys.readouterr().out.split())
    with pytest.raises(SpecError, match="law: the book's is for one contact"):
        verify(short(file, 0.02, "law=book"), states=20)


def test_what_has_no_closed_form_is_told_with_its_place(tmp_path):
    twice = "  twice:   {type: motion, frame: link4, target: stay, axes: [vx, vy], kp: 50, kd: 10}\n  posture:"
    file = written(tmp_path, ("  posture:", twice))
    with pytest.raises(SpecError) as caught:
        verify(short(file), states=20)
    (fault,) = caught.value.faults
    assert (fault.key, "twice:" in file.read_text().splitlines()[fault.line - 1]) == ("tasks.twice", True)
    assert "no closed form tells; expected axes of its own" in fault.message


def test_several_postures_are_one_at_the_mean_of_their_weights(tmp_path):
    more = "  rest: {type: posture, target: home, kp: 5, kd: 3, weight: 3}\n  posture:"
    found = verify(short(written(tmp_path, ("  posture:", more))), states=20)
    assert found.ok, found


def test_a_posture_alone_has_a_closed_form(tmp_path):
    file = tmp_path / "alone.yaml"
    file.write_text("robot: panda\ntasks:\n  posture: {type: posture, target: start, kp: 50, kd: 10}\n")
    assert verify(short(file), states=5).ok


ELBOW = """
robot: panda
tool: eraser
scene: board
references: {stay: {hold: {}}}
contacts:
  board:
    frame: eraser
    natural:    {wx: 0, wy: 0, mz: 0, fx: 0, fy: 0, vz: 0}
    artificial: {mx: 0, my: 0, wz: 0, vx: 0, vy: 0, fz: -10}
tasks:
  press:   {type: force, contact: board, kp: 0.3, ki: 10, damping: [5, 5, 500], filter: 50}
  elbow:   {type: motion, frame: link4, target: stay, axes: [vx], kp: 50, kd: 10}
  posture: {type: posture, target: start, kp: 50, kd: 10}
"""


def test_motion_of_a_body_halfway_up_the_arm_and_none_on_the_contact(tmp_path):
    file = tmp_path / "elbow.yaml"
    file.write_text(ELBOW)
    found = verify(short(file), states=20)
    assert found.ok, found
    assert found.states >= 14


def test_tolerance_is_the_solvers():
    assert [tolerance(solver) for solver in ("daqp", "proxqp", "osqp", object())] == [1e-9, 1e-6, 1e-6, 1e-6]


# --- it must fail ---


@pytest.mark.parametrize(
    "change",
    [
        {"laws": {"compensated": Worst(), "book": Worst(max_tau_error=1.1e-9)}},
        {"laws": {"compensated": Worst(max_tau_error=1.1e-9), "book": Worst()}},
        {"laws": {"compensated": Worst(max_tau_error=float("inf")), "book": Worst()}},
        {"max_tau_error_mujoco": 1.1e-8},
        {"states": 699, "dropped": 301},
        {"states": 0, "dropped": 1000},
    ],
)
def test_each_bar_counts(change):
    sound = {"spec": "x", "tolerance": 1e-9, "states": 700, "dropped": 300}
    assert Certificate(**sound).ok
    assert not Certificate(**(sound | change)).ok


def spoiled(change: Callable[[Held, State], None]) -> Callable:
    """`Contact._hold` with some of its answer changed."""
    right = Contact._hold

    def wrong(self: Contact, state: State, *args):
        held = right(self, state, *args)
        change(held, state)
        return held

    return wrong


def without_drift(held: Held, state: State) -> None:
    held.table[:, state.v.size] = 0.0
    held.bias[:] = 0.0


def against_the_motion(held: Held, state: State) -> None:
    held.slip[:] = -held.slip


def rows_with(metric: Callable[[State], np.ndarray]) -> Callable:
    right = PostureTask.rows
    return lambda self, state: right(self, state)._replace(metric=metric(state))


def forgetful(self: ForceTask, state: State, right=ForceTask.rows):
    loop = state.loops[self.contact]
    state.loops[self.contact] = loop._replace(integral=0.0 * loop.integral)
    return right(self, state)


SABOTAGE = {
    "identity metric": (wbc.task.motion, "inertia", lambda mobility: np.eye(len(mobility)), ["book"]),
    "no Jdot v": (Contact, "_hold", spoiled(without_drift), LAWS),
    "damping that drives": (Contact, "_hold", spoiled(against_the_motion), LAWS),
    "posture in everyone's way": (PostureTask, "rows", rows_with(lambda state: state.M), LAWS),
    "no integral": (ForceTask, "rows", forgetful, LAWS),
}


@pytest.mark.parametrize("what", SABOTAGE)
def test_sabotage_is_caught(what, monkeypatch):
    where, name, wrong, laws = SABOTAGE[what]
    monkeypatch.setattr(where, name, wrong)
    # weights that differ, so that every task's own rows are in use
    found = verify(short("eraser", 0.02, "tasks.posture.weight=2"), states=20)
    assert not found.ok
    assert found.states >= 14  # it is not for want of states
    assert all(found.laws[law].max_tau_error > 1e-4 for law in laws), found.laws


def test_an_error_that_both_sides_share_is_caught_by_mujoco(monkeypatch):
    right = State.frame

    def without_drift(self, name):
        frame = right(self, name)
        frame.drift[:] = 0.0
        return frame

    monkeypatch.setattr(State, "frame", without_drift)
    found = verify(short(), states=20)
    assert max(law.max_tau_error for law in found.laws.values()) <= TAU_ERROR["daqp"]
    assert found.max_tau_error_mujoco > 1e-4
    assert not found.ok


class Silent:
    """A solver that never answers."""

    def solve(self, problem):
        raise RuntimeError("planned")


def test_a_controller_without_answers_fails_with_infinite_errors():
    found = verify(short(), Silent(), states=3)
    assert not found.ok
    for worst in found.laws.values():
        assert worst.max_lambda_error == worst.max_kkt_residual == np.inf
