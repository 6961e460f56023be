"""Row 10: whatever conflicts, the dynamics, the torque limits and their rate hold in every answer that is accepted.

By mass matrix and bias of Pinocchio, at ticks without an answer, of those that `conflicts` generates.
`WBC_CAMPAIGN=large` makes 200 of them.
"""

from __future__ import annotations

import os

import numpy as np
import pytest
from conflicts import KINDS, generate

from wbc.controller import Status

SEEDS = range(200 if os.environ.get("WBC_CAMPAIGN") == "large" else len(KINDS))
KEPT = (Status.OK, Status.LIMITED)


@pytest.mark.row(10)
def test_row_10_dynamics_and_torque_limits_are_never_relaxed(tell):
    beyond, off, answered, yielded = -np.inf, 0.0, 0, 0
    for seed in SEEDS:
        controller = generate(seed).controller
        tick, robot = controller.tick, controller.robot
        state, program, memory = tick.state, tick.program, controller.memory
        limit, tau = program.phase.torque, memory.tau
        beyond = max(beyond, (tau - limit.high).max(), (limit.low - tau).max())
        step = np.abs(tau - tick.tau_last) - limit.rate * controller.dt
        # where the last torque is outside the limits of now, the way back inside comes first
        beyond = max(beyond, step[np.isfinite(step)].max(initial=-np.inf))
        if memory.status not in KEPT:
            continue  # the last torque is held
        answered += 1
        yielded += bool(program.yielded)
        x, slices = tick.solution.x, program.last.variables.slices
        load = state.M @ x[slices["vdot"]] + state.h
        for name, held in state.contacts.items():
            if name in slices:  # it was not dropped
                load = load + held.G.T @ x[slices[name]]
        load[robot.base :] -= tau
        off = max(off, np.abs(load).max() / (1.0 + np.abs(tau).max()))
    tell("torque limits and rate overstepped by [N m]", beyond, most=1e-9)
    tell("dynamics off by, of 1 + |tau|", off, most=1e-6)
    print(f"{answered} of {len(SEEDS)} answered, {yielded} in which something yielded")
    assert answered > len(SEEDS) // 4
