"""Time of one tick on the eraser, split by stage, beside the floor of Pinocchio alone, in one run.

    python benchmarks/tick.py [--ticks N] [--set KEY=VALUE] [--solver NAME] [--json]

The stages are those of `Controller.step`: state, rows, assembly, solve, certificate, decode. Every tick is a real one,
of a run in MuJoCo, so that caches are as cold as in use; the floor is `pinocchio.computeAllTerms` on the same states.
"""

from __future__ import annotations

import argparse
import gc
import json
import time
from collections.abc import Callable
from typing import Any

import numpy as np
import pinocchio as pin

import wbc.controller
import wbc.solver
from wbc.build import build
from wbc.controller import Controller
from wbc.phase import Program
from wbc.run import run
from wbc.spec import load

# stage -> where its function stands; a stage inside another is taken off it
STAGES = {
    "state": (wbc.controller, "State"),
    "contacts and wrenches": (Controller, "_read"),
    "rows": (Program, "costs"),
    "assembly": (Program, "assemble"),
    "certificate": (wbc.solver, "certify"),
    "solve": (wbc.controller, "answer"),
    "decode": (Controller, "_accept"),
}
INSIDE = {"assembly": "rows", "solve": "certificate"}


class Clock:
    """Sums the time spent in wrapped functions, by stage, tick by tick."""

    def __init__(self) -> None:
        self.now: dict[str, float] = {}
        self.ticks: list[dict[str, float]] = []

    def wrap(self, stage: str, function: Callable[..., Any]) -> Callable[..., Any]:
        def timed(*args: Any, **kwargs: Any) -> Any:
            begin = time.perf_counter()
            try:
                return function(*args, **kwargs)
            finally:
                self.now[stage] = self.now.get(stage, 0.0) + time.perf_counter() - begin

        return timed


def split(name: str, overrides: list[str], ticks: int) -> dict[str, dict[str, float]]:
    """Median and p99 [us] of every stage over one run with the stages timed, and of the whole over one without."""
    clock, spec = Clock(), load(name, [*overrides, f"duration={ticks / 1000}"])
    whole = run(build(spec)).log["step_us"]
    built, floor = build(spec), list[float]()
    data = built.robot.model.createData()
    originals = {stage: getattr(owner, attribute) for stage, (owner, attribute) in STAGES.items()}

    def tick(seen: Any, out: Any) -> None:
        clock.ticks.append(clock.now)
        clock.now = {}
        begin = time.perf_counter()
        pin.computeAllTerms(built.robot.model, data, seen.q, seen.v)
        floor.append(time.perf_counter() - begin)

    try:
        for stage, (owner, attribute) in STAGES.items():
            setattr(owner, attribute, clock.wrap(stage, originals[stage]))
        run(built, hook=tick)
    finally:
        for stage, (owner, attribute) in STAGES.items():
            setattr(owner, attribute, originals[stage])
    stages = {stage: np.array([t.get(stage, 0.0) for t in clock.ticks]) * 1e6 for stage in STAGES}
    for outer, inner in INSIDE.items():
        stages[outer] = stages[outer] - stages[inner]
    stages |= {"whole tick": whole, "floor: Pinocchio alone": np.array(floor) * 1e6}
    return {stage: {"p50": float(np.median(us)), "p99": float(np.percentile(us, 99))} for stage, us in stages.items()}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--spec", default="eraser")
    parser.add_argument("--ticks", type=int, default=4000)
    parser.add_argument("--set", action="append", default=[])
    parser.add_argument("--solver")
    parser.add_argument("--json", action="store_true")
    args = parser.parse_args()
    gc.collect()
    result = split(args.spec, args.set + ([f"solver={args.solver}"] if args.solver else []), args.ticks)
    if args.json:
        print(json.dumps(result))
        return
    print(f"{'stage':28s} {'median':>8s} {'p99':>8s}  [us]")
    for stage, us in result.items():
        print(f"{stage:28s} {us['p50']:8.1f} {us['p99']:8.1f}")
    ratio = result["whole tick"]["p50"] / result["floor: Pinocchio alone"]["p50"]
    print(f"the tick costs {ratio:.1f} times the floor")


if __name__ == "__main__":
    main()
