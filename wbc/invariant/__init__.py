"""What must hold at every tick, whatever goes wrong around the controller, held against it from outside.

Nothing here asks the controller whether it did well: residuals, the torque of an answer, the torque of a hold and the
ladder are worked out again from the tick's arguments, with numbers of their own where the controller has constants.
"""

from __future__ import annotations

from .watched import Watched

# name -> what must hold
INVARIANTS = {
    "raises": "no exception leaves `step`",
    "status": "a named status; with a reason and a name for all that is not OK",
    "finite": "torque of the right shape, all of it finite",
    "limit": "torque within its limits, the part that the robot's driver adds included",
    "rate": "change of the torque within its rate limit",
    "transition": "a status that may follow the last one",
    "ladder": "5 bad ticks, then SAFE_HOLD; OK after 10 good ones; STOPPED after 20 missed or stale; up by reset alone",
    "certificate": "no torque is accepted but that of an answer whose residuals are within 1e-6",
    "dynamics": "the torque is that of the certified answer: M vdot + h + J'F = S'tau",
    "hold": "a held torque is g + J'F of the last wrenches, with what is left to decay, or damping",
    "refused": "what is not valid is refused, naming it, and changes nothing that is remembered",
    "targets": "a target stands until a valid one takes its place",
    "integral": "integrators take two periods at most",
    "clock": "the controller's time is the caller's and does not run backwards",
    "memory": "what is remembered, and what the caller owns, is not written to",
}

__all__ = ["INVARIANTS", "Watched"]
