"""The arguments of a tick, judged without the controller."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from ..arguments import Arguments
from ..controller import Controller
from ..qp import Array
from ..robot import Robot
from ..wrench import Wrench

UNIT = 1e-3  # how far the norm of a quaternion may be off


class Call:
    """The arguments of a tick, judged: `wrong` says what of the state is not valid, "" if all is; `q`, `v`, `t` are
    those that hold then."""

    def __init__(self, given: Arguments, robot: Robot) -> None:
        t: Any
        q: Any
        v: Any
        t, q, v, measured, targets, applied, missed = given
        self.t, self.q, self.v, self.measured, self.targets = t, q, v, measured, targets
        whole = isinstance(missed, (int, np.integer)) and missed >= 0
        self.missed, self._missed = (int(missed), True) if whole else (0, False)
        self.applied: Array | None
        self.applied, self._applied = (applied, True) if _sound(applied, robot.nu) else (None, applied is None)
        self.wrong = next((name for name, x, n in (("q", q, robot.nq), ("v", v, robot.nv)) if not _sound(x, n)), "")
        if not self.wrong:
            self.q = q.copy()
            for part in robot.unit_parts:
                norm = float(np.linalg.norm(q[part]))
                if not abs(norm - 1.0) <= UNIT:
                    self.wrong = f"q, with a norm of {norm:g}"
                    break
                self.q[part] /= norm
        if not self.wrong and not (isinstance(t, (int, float)) and math.isfinite(t)):
            self.wrong = "t"

    def refused(self, controller: Controller) -> list[str]:
        """The fields, other than of the state, that are not valid."""
        found = [] if self._missed else ["missed"]
        found += [] if self._applied else ["tau_applied"]
        for name, given in (("measured", self.measured), ("targets", self.targets)):
            if given is not None and not isinstance(given, Mapping):
                found.append(name)
        frames = controller.robot.frames
        for name, wrench in self.measured.items() if isinstance(self.measured, Mapping) else ():
            felt = any(name in phase.feeling for phase in controller.phases)
            good = isinstance(wrench, Wrench) and _sound(wrench.F, 6) and wrench.frame in frames
            if not (felt and good):
                found.append(f"measured.{name}" if felt else "measured")
        good_ones = self.valid_targets(controller)
        given = self.targets if isinstance(self.targets, Mapping) else {}
        return found + [f"targets.{name}" for name in given if name not in good_ones]

    def valid_targets(self, controller: Controller) -> dict[str, float]:
        known = {f"{name}.{axis}" for p in controller.phases for name, c in p.contacts.items() for axis in c.axes}
        given = self.targets if isinstance(self.targets, Mapping) else {}
        return {
            name: float(value)
            for name, value in given.items()
            if name in known and isinstance(value, (int, float)) and math.isfinite(value)
        }


def _sound(x: Any, n: int) -> bool:
    """Whether it is a finite float64 array of n numbers, in one piece and writeable."""
    if not isinstance(x, np.ndarray) or x.dtype != np.float64 or not x.dtype.isnative or x.shape != (n,):
        return False
    # whose square is no number is as good as none
    return x.flags.c_contiguous and x.flags.aligned and x.flags.writeable and bool((np.abs(x) < 1e150).all())
