"""What is followed never jumps: motions lead into a reference that does, forces go to theirs at a bounded rate.

References and targets come from outside: from a function of one's own, from `targets`, or from a clock that goes on by
more than a tick. A pose that is not where its own twist said a tick ago that it would be has jumped, and so has a twist
that its acceleration does not explain; what was followed until then leads into it (`Lead`), with no step in pose, twist
or acceleration. A reference that does not jump is followed as it is, to the bit.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pinocchio as pin

from .handover import Start
from .kernels import approach, jumped
from .lead import Lead
from .phase import Phase
from .program import Program
from .qp import Array
from .state import State

LEAST = np.array([2e-3, 1e-2, 2e-2, 1e-1])  # [m], [rad], [m/s], [rad/s] between two ticks that make a jump
NEVER = np.full(4, np.inf)
_NOWHERE = np.zeros((3, 8))
TICKS = 2.0  # by which a clock may go on at once

Followed = Mapping[str, Array]  # by task: (3, 8) poses and motions as of `kernels.jumped`, (k,) multipliers


def lead_in(
    program: Program, state: State, followed: Followed, starts: Mapping[str, Start], past: float, dt: float
) -> tuple[dict[str, Array], Mapping[str, Start]]:
    """What the tasks follow at this tick, and the starts of tasks, with those of jumps.

    `past` [s] since the last tick, `dt` the tick. Fills in `state.starts`, `state.followed` and `state.gave`.
    """
    now: dict[str, Array] = {}
    h = min(past, TICKS * dt)
    for name, task in program.phase.following.items():
        sample, told, last = task.followed(state), np.empty((3, 8)), followed.get(name)
        least = NEVER if last is None else LEAST
        last = _NOWHERE if last is None else last
        if jumped(last, sample.R, sample.p, sample.motion, h, least, told):
            begun = starts.get(name, Start())
            target = begun._replace(lead=None).sample(task.reference, state.t)
            starts = {**starts, name: begun._replace(lead=Lead.of(state.t, *_expected(last, h), target, task.jump))}
            state.starts = program.named(starts)
            sample = task.followed(state)
            jumped(last, sample.R, sample.p, sample.motion, h, NEVER, told)
        now[name] = told
        lead = starts[name].lead if name in starts else None
        if lead is not None and state.t < lead.ends:
            left = lead.ends - state.t
            state.gave[f"{name}.jump"] = f"the reference of {name} has jumped: it is led in within {left:.2g} s"
    for contact, (name, force) in program.force.items():
        wanted, before = force.desired(state), followed.get(name)
        if before is not None and before is not wanted and before.shape == wanted.shape:
            reached = np.empty(wanted.size)
            if approach(before, wanted, force.rate, state.dt, reached):
                state.gave[f"{name}.jump"] = f"the target of {name} has jumped: it is followed at its rate"
            wanted = reached
        state.followed[contact] = now[name] = wanted
    return now, starts


def _expected(last: Array, h: float) -> tuple[pin.SE3, Array]:
    """The pose and the motion (6, 2), h [s] later."""
    motion = np.concatenate((last[:, 4:6], last[:, 6:8]))
    step = motion[:, 0] * h + motion[:, 1] * (0.5 * h * h)
    motion[:, 0] += h * motion[:, 1]
    return pin.SE3(last[:, :3].copy(), last[:, 3].copy()) * pin.exp6(pin.Motion(step[3:], step[:3])), motion


def kept(followed: Followed, before: Phase, after: Program, starts: Mapping[str, Start], t: float) -> dict[str, Array]:
    """What goes on from one phase to the next: of motions that do not begin now, of forces on contacts that were held.

    `t` [s]: now, on the clock of `State.t`.
    """
    forces = {name: contact for contact, (name, _) in after.force.items()}

    def goes_on(name: str) -> bool:
        if name in forces:
            return forces[name] in before.contacts
        return name in after.phase.following and (name not in starts or starts[name].t != t)

    return {name: told for name, told in followed.items() if goes_on(name)}
