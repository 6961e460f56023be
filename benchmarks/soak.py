"""A long run: whether memory stays flat and ticks stay fast, and whether the same seed gives the same torques.

    python benchmarks/soak.py [SPEC...] [--seconds S] [--seed N] [--json]

Controller and simulator in a closed loop for S simulated seconds (600), twice side by side in processes of their own.
Nothing is logged but times, so that what grows is the controller's or the simulator's. The first tenth of the run is
left out of what must not grow. Exit status 1 when memory grows by more than 1 MB after it, or the torques of the last
tenth are not bit-equal. Times are told, not judged: on the processor alone, and by the clock on the wall, in which is
also what else the machine does. Whether ticks grow is told in units of `pinocchio.computeAllTerms` on the same states,
for the pace of a shared machine changes within a run.
"""

from __future__ import annotations

import argparse
import gc
import hashlib
import json
import sys
import time
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin

from wbc.build import build
from wbc.record import STATUS_NAMES
from wbc.run import felt_names, wrist
from wbc.sim import Simulator
from wbc.spec import load

PARTS = 10
EVERY = 50  # ticks from one look at the floor to the next
GROWTH = 1.0  # [MB]


def resident() -> float:
    """Memory of this process [MB]; NaN where the system does not say."""
    try:
        return int(Path("/proc/self/statm").read_text().split()[1]) * 4096 / 1e6
    except OSError:
        return float("nan")


def told(us: Any) -> dict[str, float]:
    """Percentiles of some ticks."""
    return dict(zip(("p50", "p99", "p99.9", "max"), np.percentile(us, [50, 99, 99.9, 100]).tolist(), strict=True))


def soak(name: str, seconds: float, seed: int) -> dict[str, Any]:
    """One run: memory [MB] and tick percentiles [us] of every tenth, a digest of the last tenth's torques."""
    built = build(load(name))
    controller, dt = built.controller, built.controller.dt
    simulator = Simulator(built.robot, built.q, dt, built.spec.plant, seed, built.rides)
    controller.reset(built.q, np.zeros(built.robot.nv))
    feeling, ticks = felt_names(built), round(seconds / dt / PARTS)
    us, wall = np.ones((2, PARTS, ticks))  # written to, so that its pages are there before the first tick
    model, floor = built.robot.model, np.ones((PARTS, -(-ticks // EVERY)))
    data = model.createData()
    digest, before, memory, status = hashlib.sha256(), None, [], dict.fromkeys(STATUS_NAMES, 0)
    gc.freeze()
    for part in range(PARTS):
        for tick in range(ticks):
            seen = simulator.observe()
            wrench = wrist(simulator, controller, before, seen)
            given = dict.fromkeys(feeling, wrench) if wrench is not None else None
            began, worked = time.perf_counter(), time.thread_time()
            out = controller.step(*seen, measured=given)
            us[part, tick] = 1e6 * (time.thread_time() - worked)
            wall[part, tick] = 1e6 * (time.perf_counter() - began)
            if tick % EVERY == 0:
                worked = time.thread_time()
                pin.computeAllTerms(model, data, seen.q, seen.v)
                floor[part, tick // EVERY] = 1e6 * (time.thread_time() - worked)
            simulator.apply(out.tau)
            before = (seen, out, controller.state)
            status[out.status.name] += 1
            if part == PARTS - 1:
                digest.update(out.tau.tobytes())
        gc.collect()
        memory.append(resident())
    return {
        "ticks": PARTS * ticks,
        "status": {name: count for name, count in status.items() if count},
        "memory": memory,
        "us": [told(x) for x in us],
        "floor_us": np.median(floor, axis=1).tolist(),
        "wall_us": told(wall[1:]),
        "digest": digest.hexdigest(),
    }


def twice(name: str, seconds: float, seed: int) -> dict[str, Any]:
    """Two runs of one seed side by side, and the verdict on them."""
    with ProcessPoolExecutor(2, mp_context=get_context("spawn")) as pool:
        runs = list(pool.map(soak, [name] * 2, [seconds] * 2, [seed] * 2))
    growth = [max(run["memory"][1:]) - run["memory"][0] for run in runs]
    ratio = np.array([[part["p50"] for part in run["us"]] for run in runs]) / [run["floor_us"] for run in runs]
    equal = runs[0]["digest"] == runs[1]["digest"]
    return {
        "spec": name,
        "seconds": seconds,
        "seed": seed,
        "ok": equal and not max(growth) > GROWTH,
        "growth_mb": growth,
        "bit_equal": equal,
        "ratio": ratio.tolist(),  # of a tick to the floor, medians, by tenths
        "tick_growth": (ratio[:, -1] / ratio[:, 1]).tolist(),
        "status": runs[0]["status"],
        "us": {key: max(part[key] for run in runs for part in run["us"][1:]) for key in ("p50", "p99", "p99.9")},
        "wall_us": {key: max(run["wall_us"][key] for run in runs) for key in ("p50", "p99", "p99.9")},
        "runs": runs,
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("specs", nargs="*", default=["eraser", "g1_stand"])
    parser.add_argument("--seconds", type=float, default=600.0)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--json", action="store_true")
    args = parser.parse_args()
    results = []
    for name in args.specs:
        results.append(found := twice(name, args.seconds, args.seed))
        us, wall, ratio = found["us"], found["wall_us"], np.mean(found["ratio"], axis=0)
        print(
            f"{name}: {args.seconds:g} s, memory {max(found['growth_mb']):+.2f} MB after the first tenth, last tenth "
            f"{'bit-equal' if found['bit_equal'] else 'NOT EQUAL'} on a second run; a tick p50 {us['p50']:.0f} us, p99 "
            f"{us['p99']:.0f}, p99.9 {us['p99.9']:.0f} (wall {wall['p50']:.0f}, {wall['p99']:.0f}, "
            f"{wall['p99.9']:.0f}), {' '.join(f'{each:.1f}' for each in ratio)} times the floor by tenths",
            file=sys.stderr if args.json else sys.stdout,
            flush=True,
        )
    if args.json:
        print(json.dumps(results))
    sys.exit(0 if all(found["ok"] for found in results) else 1)


if __name__ == "__main__":
    main()
