"""What every contestant runs in an interpreter of its own: it is given problems, then ticks, one line of JSON each.

    {"problem": {...}, "as": NAME}        -> {"ready": versions}
    {"as": NAME, "q": [...], "v": [...]}  -> {"tau": [...], "ok": true, "active": [...], "us": 12.3}

`q`, `v` and `tau` stand in the order of the problem's joints; a contestant that has them otherwise says how, and the
exchange stays outside what is timed. Imports nothing but numpy: there is no `wbc` in a peer's interpreter.
"""

from __future__ import annotations

import gc
import json
import os
import sys
import time
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np

Array = np.ndarray[Any, np.dtype[np.float64]]
CLOCKS: dict[str, Callable[[], float]] = {"wall": time.perf_counter, "cpu": time.thread_time}


class Program(NamedTuple):
    """One problem, ready to tick."""

    # q, v -> joint torques [N m], whether it was solved, names of the inequalities that bind, where it tells
    tick: Callable[[Array, Array], tuple[Array, bool, Sequence[str]]]
    joints: Sequence[str]  # in the program's own order
    base: tuple[int, int] = (0, 0)  # how many numbers of q and of v come before the joints


def order(names: Sequence[str], joints: Sequence[str]) -> Array:
    """Where each of `joints` stands among `names`."""
    return np.array([list(names).index(joint) for joint in joints], dtype=int)


def tick(program: Program, joints: Sequence[str], q: Array, v: Array, clock: str = "wall") -> dict[str, Any]:
    """One timed tick of a program that may order its joints otherwise."""
    there, back, (nq, nv) = order(joints, program.joints), order(program.joints, joints), program.base
    q, v = (np.concatenate((x[:n], x[n:][there])) for x, n in ((q, nq), (v, nv)))
    read = CLOCKS[clock]
    begin = read()
    tau, ok, active = program.tick(q, v)
    us = (read() - begin) * 1e6
    return {"tau": np.asarray(tau)[back].tolist(), "ok": bool(ok), "active": list(active), "us": us}


def serve(build: Callable[[dict[str, Any], str], Program], version: str) -> None:
    """Answer lines until there are no more. Libraries may print what they like: that goes to stderr."""
    out = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)
    programs: dict[str, tuple[Program, list[str]]] = {}
    for line in sys.stdin:
        asked = json.loads(line)
        if "problem" in asked:
            problem = asked["problem"]
            programs[asked["as"]] = (build(problem, asked["as"]), problem["joints"])
            gc.collect()
            gc.freeze()
            answer: dict[str, Any] = {"ready": version}
        else:
            program, joints = programs[asked["as"]]
            q, v = (np.array(asked[x], float) for x in "qv")
            answer = tick(program, joints, q, v, asked.get("clock", "wall"))
        print(json.dumps(answer), file=out, flush=True)
