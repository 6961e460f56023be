"""What a motion costs the motors."""

from __future__ import annotations

from ..dynamics import inertia
from ..qp import Array, Rows
from ..state import State


class TorqueTask:
    """Least torque: the cost of tau = M vdot + bias + push' lambda itself, over the joints that have a motor.

    In the metric of the joints' own inverse inertia it is, as the cost of a motion, a power over time: with a weight w
    beside a posture of weight 1 a share w / (1 + w) of what the posture needs is let go, of gravity too. So it stands
    with a small weight, or strict on a level below what must not give way; there it decides what is left: which of the
    contacts' wrenches and which of the motions that nothing asks for take the least torque.
    """

    def rows(self, state: State) -> Rows:
        base = state.robot.base
        A: dict[str, Array | None] = {"vdot": state.M[base:]}
        for name, held in state.contacts.items():
            A[name] = held.push.T[base:]
        b = -state.bias[base:]
        return Rows("", A, b, b, inertia(state.M[base:, base:]))
