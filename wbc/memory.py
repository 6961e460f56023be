"""The values of a tick: what it answers, and all that it carries to the next."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from .grounds import Ground
from .guard import Grip
from .handover import Start
from .ladder import GOOD_TICKS, Status
from .qp import Array, Certificate
from .task.force import ForceLoop
from .task.impedance import Felt
from .transition import Watch

NOTHING: Mapping[str, Any] = {}  # never written to
NEW_WATCH = Watch()


class Output(NamedTuple):
    """What a tick answers. `tau` (nu,) [N m], in the order of `robot.joints`, is for the driver; `vdot` (nv,) and the
    wrenches are predicted, wrenches robot on environment."""

    tau: Array
    vdot: Array
    wrenches: dict[str, Array]
    active: tuple[str, ...]
    status: Status
    reason: str
    certificate: Certificate


class Memory(NamedTuple):
    """All that a tick carries to the next: a value, to be kept and restored. Its arrays are never written to."""

    t: float | None = None  # time of the last tick [s]
    start: float = 0.0  # time of the first tick [s]
    phase: int = 0
    phase_start: float = 0.0
    tau: Array = np.zeros(0)  # last torque of the motors, gravity included [N m]
    gravity: Array = np.zeros(0)  # g(q) of the last tick [N m]
    q: Array = np.zeros(0)
    v: Array = np.zeros(0)
    lam: Mapping[str, Array] = NOTHING  # last certified multipliers
    loops: Mapping[str, ForceLoop] = NOTHING
    targets: Mapping[str, float] = NOTHING
    status: Status = Status.OK
    bad: int = 0
    good: int = GOOD_TICKS
    starts: Mapping[str, Start] = NOTHING  # of the tasks that began after the first tick
    watch: Watch = NEW_WATCH  # of the phase's ways out
    why: str = ""  # the last change of phase, or the stop
    felt: Mapping[str, Felt] = NOTHING  # what tasks know of a push
    grounds: Mapping[str, Ground] = NOTHING  # where feet that measure their force have found the floor
    stale: int = 0  # ticks in a row whose time did not go on
    followed: Mapping[str, Array] = NOTHING  # of motions and forces, so that none jumps (`jump`)
    grips: Mapping[str, Grip] = NOTHING  # what is believed of the contacts that press
