"""Where two runs part: the first tick, and in which input, memory or output."""

from __future__ import annotations

import struct
from collections.abc import Iterator, Mapping
from dataclasses import fields, is_dataclass
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import pinocchio as pin

from .axes import WRENCH_AXES
from .memory import Memory
from .replay import Replay
from .wrench import Wrench

if TYPE_CHECKING:
    from rich.console import Console

MOST = 20  # differences that are told of one tick
_BITS = struct.Struct("d")


class Difference(NamedTuple):
    """`what` has the values `a` and `b`; None where one of the runs does not have it."""

    what: str
    a: Any
    b: Any


class Parting(NamedTuple):
    """The first tick at which two runs differ, its time [s] in the first of them, and in what they differ first.

    `where`: "input" (an argument of the step), "memory" (what the controller remembered before it), "output" (torque,
    status, active limits), or "length" (one run is over). `differences`: of that kind, in this tick.
    """

    tick: int
    t: Any
    where: str
    differences: list[Difference]


def part(a: Replay, b: Replay) -> Parting | None:
    """Where two runs part; None where all ticks of both are the same, bit for bit. Raises LogError.

    The arguments and answers of both are compared as they were kept. The memory is compared at the checkpoints, and
    where it differs earlier than what was kept, tick by tick between them: each controller is stepped there once more.
    """
    both = min(len(a), len(b))
    first = next((tick for tick in range(both) if a.raw(tick) != b.raw(tick)), both)
    found = _memory(a, b, first)
    if found is not None:
        return found
    if first < both:
        for where, one, other in (
            ("input", a.arguments(first), b.arguments(first)),
            ("output", _answer(a, first), _answer(b, first)),
        ):
            if differences := list(differ(one, other)):
                return Parting(first, a.arguments(first).t, where, _readable(differences))
    if len(a) == len(b):
        return None
    longer = a if len(a) > len(b) else b
    return Parting(both, longer.arguments(both).t, "length", [Difference("ticks", len(a), len(b))])


def found(a: Replay, b: Replay) -> dict[str, Any]:
    """`part` and `settings` as JSON can hold them; `ok`: whether no tick of the two runs differs."""
    parting = part(a, b)
    told = None
    if parting is not None:
        told = parting._asdict() | {"differences": [each._asdict() for each in parting.differences]}
        told["t"] = _plain(parting.t)
    return {
        "logs": [a.name, b.name], "ok": parting is None, "ticks": [len(a), len(b)], "parting": told,
        "settings": [each._asdict() for each in settings(a, b)],
    }  # fmt: skip


def tell(result: Mapping[str, Any], console: Console) -> None:
    """What `found` answers, for a terminal."""
    parting, (a, b) = result["parting"], result["logs"]
    if parting is None:
        console.print(f"{a} and {b}: the same in all {result['ticks'][0]} ticks, bit for bit")
    else:
        console.print(f"{a} and {b} part at tick {parting['tick']}, {parting['t']} s, in {parting['where']}:")
        for each in parting["differences"]:
            console.print(f"  {each['what']}: {each['a']!r} and {each['b']!r}")
    for each in result["settings"]:
        console.print(f"they were made with {each['what']}: {each['a']!r} and {each['b']!r}")


def settings(a: Replay, b: Replay) -> list[Difference]:
    """In what the specs of two runs differ, and their models and solvers."""
    found = [Difference(key, a.about.get(key), b.about.get(key)) for key in ("model", "solver", "gravity")]
    found = [each for each in found if each.a != each.b]
    if a.spec is not None and b.spec is not None:
        one, other = (run.spec.model_dump(mode="json", by_alias=True, exclude_unset=True) for run in (a, b))  # type: ignore[union-attr]
        found += list(differ(one, other))
    return found[:MOST]


def differ(a: Any, b: Any, what: str = "") -> Iterator[Difference]:
    """Every number, text or member in which two values differ by a bit, by its place."""
    if isinstance(a, np.ndarray) and isinstance(b, np.ndarray) and a.shape == b.shape and a.dtype == b.dtype:
        if a.tobytes() != b.tobytes():
            for index in np.ndindex(a.shape):
                if a[index].tobytes() != b[index].tobytes():
                    yield Difference(f"{what}[{', '.join(map(str, index))}]" if index else what, a[index], b[index])
    elif isinstance(a, Mapping) and isinstance(b, Mapping):
        for key in dict.fromkeys((*a, *b)):
            place = f"{what}.{key}" if what else str(key)
            if key in a and key in b:
                yield from differ(a[key], b[key], place)
            else:
                yield Difference(place, a.get(key), b.get(key))
    elif isinstance(a, pin.SE3) and isinstance(b, pin.SE3):
        yield from differ(a.homogeneous, b.homogeneous, what)
    elif isinstance(a, Wrench) and isinstance(b, Wrench):
        if a.frame == b.frame and np.shape(a.F) == np.shape(b.F) == (6,):
            for axis, one, other in zip(WRENCH_AXES, a.F, b.F, strict=True):
                yield from differ(float(one), float(other), f"{what}.{axis}")
        else:
            yield from differ(vars(a), vars(b), what)
    elif type(a) is type(b) and (hasattr(a, "_fields") or (is_dataclass(a) and not isinstance(a, type))):
        names = getattr(a, "_fields", None) or [each.name for each in fields(a)]
        one, other = ({name: getattr(each, name) for name in names} for each in (a, b))
        yield from differ(one, other, what)
    elif isinstance(a, list | tuple) and isinstance(b, list | tuple) and len(a) == len(b):
        for i, (one, other) in enumerate(zip(a, b, strict=True)):
            yield from differ(one, other, f"{what}[{i}]")
    elif type(a) is type(b) and isinstance(a, float):
        if _BITS.pack(a) != _BITS.pack(b):
            yield Difference(what, a, b)
    elif type(a) is not type(b) or (repr(a) != repr(b)):
        yield Difference(what, a, b)


def _memory(a: Replay, b: Replay, last: int) -> Parting | None:
    """The first tick, up to `last`, before which the controllers remember something else."""
    ticks = min(len(a), len(b))
    common = [tick for tick in sorted({*a.checkpoints} & {*b.checkpoints}) if tick <= last and tick < ticks]
    unlike = next((i for i, tick in enumerate(common) if a.kept(tick) != b.kept(tick)), len(common))
    if unlike == 0 or not (a.solvable and b.solvable):
        if unlike == len(common):
            return None
        tick = common[unlike]
        return _of_memory(a, tick, a.remembered(tick), b.remembered(tick))
    end = common[unlike] if unlike < len(common) else min(last, ticks - 1)
    begin = common[unlike - 1]
    walks = (_walked(run, begin, end) for run in (a, b))  # one after the other: the controller may be the same
    for tick, (one, other) in enumerate(zip(*walks, strict=True), begin):
        if found := _of_memory(a, tick, one, other):
            return found
    return None


def _walked(run: Replay, begin: int, end: int) -> list[Memory | None]:
    """What the controller remembered before each tick from `begin` to `end`."""
    found = []
    for tick, controller, arguments in run.each(begin):
        found.append(controller.memory)
        if tick == end:
            break
        controller.step(*arguments)
    return found


def _of_memory(a: Replay, tick: int, one: Memory | None, other: Memory | None) -> Parting | None:
    differences = list(differ(one, other, "memory"))
    return Parting(tick, a.arguments(tick).t, "memory", _readable(differences)) if differences else None


def _answer(run: Replay, tick: int) -> dict[str, Any]:
    """What a tick answered, its torques by joint."""
    found, joints = run.recorded(tick), run.about.get("joints") or []
    names = joints if len(joints) == found.tau.size else range(found.tau.size)
    torque = {f"torque {name}": float(value) for name, value in zip(names, found.tau, strict=True)}
    return torque | {"status": found.status.name, "active": ", ".join(found.active)}


def _readable(differences: list[Difference]) -> list[Difference]:
    return [Difference(what, _plain(one), _plain(other)) for what, one, other in differences[:MOST]]


def _plain(value: Any) -> Any:
    """What JSON can hold."""
    if isinstance(value, np.generic):
        return value.item()
    return value if value is None or isinstance(value, bool | int | float | str) else repr(value)
