"""A log's ticks beside what they answer when they are solved again: as they were, or with something changed."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from .arguments import Arguments
from .controller import Controller
from .errors import LogError
from .memory import Output
from .qp import Array
from .replay import Recorded, Replay

if TYPE_CHECKING:
    from rich.console import Console

Progress = Callable[[int], None]


def again(
    replay: Replay,
    tick: int | None = None,
    solver: str | None = None,
    overrides: Sequence[str] = (),
    progress: Progress | None = None,
) -> dict[str, Any]:
    """Solve a tick again, or all of them, with what is recorded or with another solver and changes as of `--set`.

    With changes each tick begins with the memory of the recorded run: it is that tick's answer, not another run. `ok`
    is whether all that should be the same is, bit for bit; changed answers are held against nothing. Raises WbcError.
    """
    changed = replay.other(solver, overrides) if solver is not None or overrides else None
    told = _one(replay, tick, changed) if tick is not None else _all(replay, changed, progress)
    return {"log": replay.name} | told | {"changed": changed is not None, "notes": replay.notes}


def _one(replay: Replay, tick: int, changed: Controller | None) -> dict[str, Any]:
    controller, arguments = replay.at(tick)
    recorded, out = replay.recorded(tick), _answer(controller, arguments, changed)
    joints = list(controller.robot.joints)
    return {
        "ok": changed is not None or recorded.same(out),
        "tick": tick,
        "t": arguments.t,
        "equal": recorded.same(out),
        "max_tau_difference": _apart(recorded.tau, out.tau),
        "recorded": _told(recorded, joints),
        "replayed": _told(out, joints) | {"reason": out.reason, "kkt": float(max(out.certificate))},
    }


def _all(replay: Replay, changed: Controller | None, progress: Progress | None) -> dict[str, Any]:
    equal, worst, first = 0, -1.0, None
    at, before, after, active = None, Counter[str](), Counter[str](), Counter[str]()
    if not len(replay):
        raise LogError(replay.name, "it has no ticks")
    for tick, controller, arguments in replay.each():
        recorded, out = replay.recorded(tick), _answer(controller, arguments, changed)
        same, apart = recorded.same(out), _apart(recorded.tau, out.tau)
        equal += same
        before[recorded.status.name] += 1
        after[out.status.name] += 1
        active.update(out.active)
        where = _place(replay, tick, recorded, out, arguments) if apart > worst or (not same and first is None) else {}
        if apart > worst:
            worst, at = apart, where
        if not same and first is None:
            first = where
        if progress is not None and tick % 50 == 49:
            progress(tick + 1)
    return {
        "ok": changed is not None or equal == len(replay), "ticks": len(replay), "equal": equal, "first": first,
        "max_tau_difference": worst, "worst": at, "recorded": {"status": dict(before)},
        "replayed": {"status": dict(after), "active": dict(active)},
    }  # fmt: skip


def _answer(controller: Controller, arguments: Arguments, changed: Controller | None) -> Output:
    """Of the recorded controller, which goes on to the next tick, or of the changed one from the same memory."""
    if changed is None:
        return controller.step(*arguments)
    changed.memory = controller.memory
    controller.step(*arguments)
    return changed.step(*arguments)


def _told(answer: Recorded | Output, joints: Sequence[str]) -> dict[str, Any]:
    tau = dict(zip(joints, answer.tau.tolist(), strict=True))
    return {"tau": tau, "status": answer.status.name, "active": list(answer.active)}


def _apart(one: Array, other: Array) -> float:
    """The largest difference of two torques [N m]; of another number of them, infinite."""
    return float(np.abs(one - other).max(initial=0.0)) if one.shape == other.shape else float("inf")


def _place(replay: Replay, tick: int, recorded: Recorded, out: Output, arguments: Arguments) -> dict[str, Any]:
    """A tick, and the joint whose torque is farthest off in it."""
    place: dict[str, Any] = {"tick": tick, "t": arguments.t}
    if recorded.tau.shape != out.tau.shape or not recorded.tau.size:
        return place
    i = int(np.argmax(np.abs(recorded.tau - out.tau)))
    place |= {"joint": replay.controller.robot.joints[i], "recorded": float(recorded.tau[i])}
    return place | {
        "replayed": float(out.tau[i]),
        "status": [recorded.status.name, out.status.name],
        "active": [list(recorded.active), list(out.active)],
    }


def tell(result: dict[str, Any], console: Console) -> None:
    """What `again` answers, for a terminal."""
    for note in result["notes"]:
        console.print(f"note: {note}")
    if "tick" in result:
        _tell_one(result, console)
        return
    ticks, equal, worst = result["ticks"], result["equal"], result["worst"]
    if not result["changed"]:
        verdict = "all torques bit-equal" if result["ok"] else f"{ticks - equal} are not the same"
        console.print(f"{result['log']}: {ticks} ticks solved again, {verdict}")
        if result["first"] is not None:
            console.print(f"the first: {_sentence(result['first'])}")
        return
    console.print(f"{result['log']}: {ticks} ticks solved again with the changes, {equal} bit-equal to the log")
    console.print(f"largest difference {result['max_tau_difference']:.3g} N m: {_sentence(worst)}")
    for which in ("recorded", "replayed"):
        status = ", ".join(f"{name} {count}" for name, count in result[which]["status"].items())
        console.print(f"{which}: {status}")
    for name, count in sorted(result["replayed"]["active"].items(), key=lambda item: -item[1])[:10]:
        console.print(f"active: {name} in {count} ticks")


def _sentence(place: dict[str, Any]) -> str:
    """Where a torque is off, and how."""
    at = f"tick {place['tick']} at {place['t']} s"
    if "joint" not in place:
        return at
    status = place["status"]
    return f"{at}, {place['joint']}: recorded {place['recorded']!r}, solved again {place['replayed']!r} N m" + (
        f"; status {status[0]}, now {status[1]}" if status[0] != status[1] else ""
    )


def _tell_one(result: dict[str, Any], console: Console) -> None:
    from rich.table import Table

    recorded, replayed = result["recorded"], result["replayed"]
    table = Table("joint", "recorded [N m]", "solved again", "difference", title=f"tick {result['tick']}")
    for joint, tau in recorded["tau"].items():
        now = replayed["tau"][joint]
        table.add_row(joint, f"{tau:.9g}", f"{now:.9g}", f"{now - tau:.3g}" if now != tau else "")
    console.print(table)
    for which, answer in (("recorded", recorded), ("solved again", replayed)):
        limits = ", ".join(answer["active"]) or "no limit"
        console.print(f"{which}: {answer['status']}; active: {limits}")
    if replayed["reason"]:
        console.print(f"why: {replayed['reason']}")
    console.print(f"t = {result['t']} s: {'bit-equal' if result['equal'] else 'not the same bits'}")
