"""What trust costs: the tick with all guards on beside the tick with them off, in turn on the same states.

    python benchmarks/guards.py [SPEC...] [--ticks N] [--json]

Guards look at the input, at the solver's answer and at what is measured, and change nothing while all is well:
they are taken out of the second controller, one call each, for the time of its tick alone.
"""

from __future__ import annotations

import argparse
import gc
import json
import time
from collections.abc import Callable
from typing import Any

import numpy as np
from tick import recorded

import wbc.controller
import wbc.inputs
import wbc.solver
from wbc.build import build
from wbc.guard import Guarded
from wbc.qp import Certificate
from wbc.spec import load

SOUND = Certificate(0.0, 0.0, 0.0)
# where a guard stands, and what stands there instead
GUARDS: tuple[tuple[Any, str, Callable[..., Any]], ...] = (
    (wbc.controller, "array_fault", lambda *_: ""),
    (wbc.controller, "time_fault", lambda *_: ""),
    (wbc.controller, "missed_fault", lambda *_: ""),
    (wbc.controller, "unit", lambda q, parts: (q, "")),
    (wbc.inputs, "array_fault", lambda *_: ""),
    (wbc.solver, "certify", lambda *_: SOUND),
    (wbc.controller, "watch", lambda *_: Guarded({})),
)


def guards(name: str, count: int) -> dict[str, Any]:
    """Median and p99 [us] with guards and without, the ratio of the medians and their difference."""
    built, ticks, _ = recorded(load(name, [f"duration={count / 1000}"]))
    both = built.controller, build(load(name)).controller
    originals = [getattr(owner, attribute) for owner, attribute, _ in GUARDS]
    us = np.full((2, len(ticks)), np.nan)
    for controller in both:
        controller.reset(controller.start, np.zeros(controller.robot.nv))
    gc.collect()
    gc.freeze()
    for i, (t, q, v, measured) in enumerate(ticks):
        for off in (i % 2, 1 - i % 2):  # neither always finds the caches warm
            for (owner, attribute, instead), original in zip(GUARDS, originals, strict=True):
                setattr(owner, attribute, instead if off else original)
            began = time.perf_counter()
            both[off].step(t, q, v, measured=measured)
            us[off, i] = 1e6 * (time.perf_counter() - began)
    for (owner, attribute, _), original in zip(GUARDS, originals, strict=True):
        setattr(owner, attribute, original)
    on, off = ({"p50": float(np.median(x)), "p99": float(np.percentile(x, 99))} for x in us)
    return {
        "spec": name,
        "ticks": len(ticks),
        "on": on,
        "off": off,
        "ratio": on["p50"] / off["p50"],
        "more_us": on["p50"] - off["p50"],
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("specs", nargs="*", default=["eraser", "g1_stand"])
    parser.add_argument("--ticks", type=int, default=3000)
    parser.add_argument("--json", action="store_true")
    args = parser.parse_args()
    found = [guards(name, args.ticks) for name in args.specs]
    if args.json:
        print(json.dumps(found))
        return
    for each in found:
        on, off = each["on"], each["off"]
        print(
            f"{each['spec']:12s} with guards {on['p50']:6.1f} us (p99 {on['p99']:.0f}), without {off['p50']:6.1f} "
            f"(p99 {off['p99']:.0f}): {each['ratio']:.3f} times, {each['more_us']:+.1f} us"
        )


if __name__ == "__main__":
    main()
