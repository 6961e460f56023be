"""Time of one tick, split by stage, beside the floor of Pinocchio alone, in one run.

    python benchmarks/tick.py [--spec NAME] [--ticks N] [--set KEY=VALUE] [--solver NAME] [--clock wall|cpu] [--json]

The ticks of a simulated run are recorded and given to `Controller.step` again, nothing else between them but the floor:
`pinocchio.computeAllTerms` on the same state, timed in turn, so that both see the same machine. `in the loop` is the
same tick with MuJoCo's step and the log between, which leaves the caches cold. Stages are timed in a pass of their own.
Of a busy machine `--clock cpu` tells the time on the processor alone, without that of waiting for it.
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
import wbc.program
import wbc.solver
from wbc.build import build
from wbc.controller import Controller
from wbc.inputs import Inputs
from wbc.program import Program
from wbc.run import run
from wbc.spec import load
from wbc.whole_body import WholeBodyProgram
from wbc.wrench import Wrench

# stage -> where its functions stand; a stage inside another is taken off it
STAGES: dict[str, tuple[tuple[Any, str], ...]] = {
    "state": ((wbc.controller, "State"),),
    "contacts, wrenches": ((wbc.controller, "hold"), (Inputs, "read")),
    "rows": ((Program, "costs"), (WholeBodyProgram, "costs")),
    "assembly": ((Program, "assemble"),),
    "solve": ((wbc.program, "answer"),),
    "certificate": ((wbc.solver, "certify"),),
    "decode": ((Controller, "_accept"),),
}
INSIDE = {"assembly": "rows", "solve": "certificate"}
CLOCKS: dict[str, Callable[[], float]] = {"wall": time.perf_counter, "cpu": time.thread_time}


class Clock:
    """Sums the time spent in wrapped functions, by stage, tick by tick."""

    def __init__(self, read: Callable[[], float]) -> None:
        self.read = read
        self.now: dict[str, float] = {}
        self.ticks: list[dict[str, float]] = []

    def wrap(self, stage: str, function: Callable[..., Any]) -> Callable[..., Any]:
        def timed(*args: Any, **kwargs: Any) -> Any:
            begin = self.read()
            try:
                return function(*args, **kwargs)
            finally:
                self.now[stage] = self.now.get(stage, 0.0) + self.read() - begin

        return timed

    def end_tick(self) -> None:
        self.ticks.append(self.now)
        self.now = {}


def replay(
    controller: Controller, ticks: list[tuple[Any, ...]], read: Callable[[], float], after: Callable[[], None]
) -> tuple[Any, Any]:
    """Microseconds of every tick and of the floor."""
    model = controller.robot.model
    data, took, floor = model.createData(), [], []
    controller.reset(controller.start, np.zeros(model.nv))
    for t, q, v, measured in ticks:
        begin = read()
        controller.step(t, q, v, measured=measured)
        between = read()
        pin.computeAllTerms(model, data, q, v)
        floor.append(read() - between)
        took.append(between - begin)
        after()
    return np.array(took) * 1e6, np.array(floor) * 1e6


def stages(
    controller: Controller, ticks: list[tuple[Any, ...]], read: Callable[[], float] = time.perf_counter
) -> dict[str, Any]:
    """Microseconds of every tick (t, q, v, measured), of its stages and of the floor, by name."""
    whole, floor = replay(controller, ticks, read, lambda: None)
    clock = Clock(read)
    places = [(stage, owner, attribute) for stage, found in STAGES.items() for owner, attribute in found]
    originals = [getattr(owner, attribute) for _, owner, attribute in places]
    try:
        for (stage, owner, attribute), original in zip(places, originals, strict=True):
            setattr(owner, attribute, clock.wrap(stage, original))
        replay(controller, ticks, read, clock.end_tick)
    finally:
        for (_, owner, attribute), original in zip(places, originals, strict=True):
            setattr(owner, attribute, original)
    us = {stage: np.array([t.get(stage, 0.0) for t in clock.ticks]) * 1e6 for stage in STAGES}
    for outer, inner in INSIDE.items():
        us[outer] = us[outer] - us[inner]
    return us | {"whole tick": whole, "floor: Pinocchio": floor}


def told(us: dict[str, Any]) -> dict[str, dict[str, float]]:
    """Median and p99 [us] of each."""
    return {name: {"p50": float(np.median(x)), "p99": float(np.percentile(x, 99))} for name, x in us.items()}


def recorded(spec: Any) -> tuple[Any, list[tuple[Any, ...]], Any]:
    """A spec, built, the ticks (t, q, v, measured) of its run, and what they took there [us]."""
    built, ticks = build(spec), []
    controller = built.controller

    def record(seen: Any, out: Any) -> None:
        given = {
            name: Wrench(F, controller.phase.contacts[name].frame) for name, F in controller.state.measured.items()
        }
        ticks.append((seen.t, seen.q, seen.v, given))

    return built, ticks, run(built, hook=record).log["step_us"]


def split(name: str, overrides: list[str], count: int, clock: str = "wall") -> dict[str, dict[str, float]]:
    """Median and p99 [us] of the tick, of its stages and of the floor."""
    built, ticks, loop = recorded(load(name, [*overrides, f"duration={count / 1000}"]))
    gc.collect()
    gc.freeze()
    us = stages(built.controller, ticks, CLOCKS[clock])
    floor = us.pop("floor: Pinocchio")
    return told(us | {"in the loop": loop, "floor: Pinocchio": floor})


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--spec", default="eraser")
    parser.add_argument("--ticks", type=int, default=4000)
    parser.add_argument("--set", action="append", default=[])
    parser.add_argument("--solver")
    parser.add_argument("--clock", choices=CLOCKS, default="wall")
    parser.add_argument("--json", action="store_true")
    args = parser.parse_args()
    overrides = args.set + ([f"solver={args.solver}"] if args.solver else [])
    result = split(args.spec, overrides, args.ticks, args.clock)
    if args.json:
        print(json.dumps(result))
        return
    print(f"{'stage':22s} {'median':>8s} {'p99':>8s}  [us]")
    for stage, us in result.items():
        print(f"{stage:22s} {us['p50']:8.1f} {us['p99']:8.1f}")
    ratio = result["whole tick"]["p50"] / result["floor: Pinocchio"]["p50"]
    print(f"a tick costs {ratio:.0f} times the floor")


if __name__ == "__main__":
    main()
