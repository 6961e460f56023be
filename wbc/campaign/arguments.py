"""What a caller can get wrong in the arguments of a tick: each a way to spoil them, drawn from a seed."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from ..qp import Array
from ..wrench import Wrench

if TYPE_CHECKING:
    from ..controller import Controller

Given = dict[str, Any]  # the arguments of a tick, by name
Spoilt = Callable[[np.random.Generator, "Controller", Given], Any]


def _read_only(x: Array) -> Array:
    y = x.copy()
    y.flags.writeable = False
    return y


# an array that is none, or not the one that is wanted
WRONG: tuple[Callable[[Array], Any], ...] = (
    lambda x: x.tolist(),
    lambda x: x[:-1].copy(),
    lambda x: np.append(x, 0.0),
    lambda x: x[:, None].copy(),
    lambda x: x.astype(np.float32),
    lambda x: np.zeros(x.shape, int),
    lambda x: x.astype(complex),
    lambda x: x.astype(object),
    lambda x: x.astype(x.dtype.newbyteorder()),
    lambda x: np.repeat(x, 2)[::2],
    _read_only,
    lambda x: "nothing",
    lambda x: np.zeros(0),
)


def _wrong(rng: np.random.Generator, x: Array) -> Any:
    return WRONG[int(rng.integers(len(WRONG)))](x)


def _not_finite(rng: np.random.Generator, x: Array) -> Array:
    y = x.copy()
    y[rng.integers(y.size)] = (math.nan, math.inf, -math.inf)[int(rng.integers(3))]
    return y


def _turned(rng: np.random.Generator, controller: Controller, given: Given) -> Any:
    """Every quaternion off by too much; where there are none, an entry that is no number."""
    q, parts = given["q"].copy(), controller.robot.unit_parts
    for part in parts:
        q[part] *= (1.01, 0.9985, 0.5, 1e-9, 0.0)[int(rng.integers(5))]
    return q if parts else _not_finite(rng, q)


def _frame(controller: Controller) -> tuple[str, str]:
    """A name that a wrench may be measured for, and its frame."""
    names = [(name, frame) for phase in controller.phases for name, frame in phase.feeling.items()]
    return names[0] if names else ("world", "universe")


def _measured(rng: np.random.Generator, controller: Controller, given: Given) -> Any:
    name, frame = _frame(controller)
    F = rng.normal(size=6)
    return (
        [F],
        {name: F},
        {name: Wrench(_not_finite(rng, F), frame)},
        {name: Wrench(_wrong(rng, F), frame)},
        {name: Wrench(F, frame + "_")},
        {name + "_": Wrench(F, frame)},
        {7: Wrench(F, frame)},
    )[int(rng.integers(7))]


def _targets(rng: np.random.Generator, controller: Controller, given: Given) -> Any:
    names = [f"{name}.{axis}" for p in controller.phases for name, c in p.contacts.items() for axis in c.axes]
    name = names[int(rng.integers(len(names)))] if names else "board.fz"
    return (
        3.0,
        {name: math.nan},
        {name: -math.inf},
        {name: "-5"},
        {name: None},
        {name + "z": 1.0},
        {7: 1.0},
        {name: np.zeros(2)},
    )[int(rng.integers(8))]


def _late(rng: np.random.Generator, controller: Controller, given: Given) -> Any:
    return (None, -1, math.nan, 1.5, "3")[int(rng.integers(5))]


def _time(rng: np.random.Generator, controller: Controller, given: Given) -> Any:
    return (math.nan, math.inf, -math.inf, None, "0", np.zeros(1))[int(rng.integers(6))]


class Argument(NamedTuple):
    """One that is spoilt: which it is, how, and whether the tick then has no state to go by."""

    field: str
    spoil: Spoilt
    state: bool
    told: str


ARGUMENTS = {
    "argument.q": Argument("q", lambda r, c, g: _wrong(r, g["q"]), True, "q of a wrong shape, type or layout"),
    "argument.v": Argument("v", lambda r, c, g: _wrong(r, g["v"]), True, "v of a wrong shape, type or layout"),
    "argument.q.finite": Argument("q", lambda r, c, g: _not_finite(r, g["q"]), True, "an entry of q is no number"),
    "argument.v.finite": Argument("v", lambda r, c, g: _not_finite(r, g["v"]), True, "an entry of v is no number"),
    "argument.quaternion": Argument("q", _turned, True, "quaternions of another norm than 1"),
    "argument.t": Argument("t", _time, True, "a time that is none"),
    "argument.measured": Argument("measured", _measured, False, "wrenches that are none, or of nothing known"),
    "argument.targets": Argument("targets", _targets, False, "targets that are no numbers, or of nothing known"),
    "argument.applied": Argument(
        "tau_applied", lambda r, c, g: _wrong(r, c.memory.tau if c.memory else g["v"]), False, "a torque that is none"
    ),
    "argument.applied.finite": Argument(
        "tau_applied",
        lambda r, c, g: _not_finite(r, c.memory.tau if c.memory else g["v"]),
        False,
        "an entry of the torque is no number",
    ),
    "argument.missed": Argument("missed", _late, False, "a number of missed ticks that is none"),
    "argument.memory": Argument("", lambda r, c, g: None, False, "ticks in between, and the memory put back"),
}
