"""A spec looked over without running it: does it build, can the start pose be held, how stable are its force loops."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin

from .build import build
from .controller import Controller
from .free_motion import MassRange
from .ladder import Status
from .limit import TorqueLimit
from .memory import Output
from .phase import Phase
from .spec import Spec
from .stability import Pole

FALLS = 0.01  # of gravity's acceleration: from here on the start of a floating base is a fall


@dataclass(frozen=True)
class Report:
    """What `check` found; faults of the input never get here, they raise SpecError."""

    spec: str
    model_error: float
    feasible: bool
    reason: str
    poles: list[Pole]
    damping_margins: dict[str, float]
    damping_limits: dict[str, dict[str, float]]  # task -> axis -> largest stable damping [N s/m, N m s/rad]
    notes: list[str] = field(default_factory=list)
    masses: list[MassRange] = field(default_factory=list)

    @property
    def ok(self) -> bool:
        return self.feasible

    def as_json(self) -> dict[str, Any]:
        """The contract's object."""
        return {
            "spec": self.spec,
            "ok": self.ok,
            "faults": [],
            "model_error": self.model_error,
            "feasible": self.feasible,
            "reason": self.reason,
            "poles": [pole._asdict() for pole in self.poles],
            "damping_margins": self.damping_margins,
            "damping_limits": self.damping_limits,
            "notes": self.notes,
            "masses": [each._asdict() for each in self.masses],
        }


def check(spec: Spec) -> Report:
    """Build the spec and solve its first tick. Raises SpecError with every fault located."""
    built = build(spec)
    # the start is judged with the torque that it needs, not with what the rate lets through in one tick
    steady = [_without_rate(phase) for phase in built.phases[:1]]
    controller = Controller(built.robot, solver=spec.solver, rate=spec.rate, phases=steady, q=built.q)
    controller.reset(built.q, np.zeros(built.robot.nv))
    out = controller.step(0.0, built.q, np.zeros(built.robot.nv))
    # references begin at rest: a torque that reaches its limit here cannot even hold the robot where it is
    held = not any(name.startswith("torque[") for name in out.active) and "yield" not in out.reason
    falls, near = _falling(controller, out), _too_near(controller)
    feasible = out.status in (Status.OK, Status.LIMITED) and held and not falls and not near
    reasons = [out.reason, falls, *(f"too near at the start: {pair}" for pair in near)]
    return Report(
        Path(spec.file).stem,
        built.robot.model_error,
        feasible,
        "; ".join(filter(None, reasons)),
        built.poles,
        built.damping_margins,
        built.damping_limits,
        built.notes,
        built.masses,
    )


def _falling(controller: Controller, out: Output) -> str:
    """What is said of a floating base, a walker or a body to be carried, that its contacts do not hold at the start."""
    robot, state = controller.robot, controller.state
    g = robot.model.gravity.linear
    if not robot.base or not g.any() or out.status not in (Status.OK, Status.LIMITED):
        return ""
    share = float(state.terms.com[2].dot(out.vdot[:3]).dot(g) / g.dot(g))
    if share < FALLS:
        return ""
    base = next(f.name for f in robot.model.frames if f.parentJoint == 1 and f.type == pin.FrameType.BODY)
    holding = [name for name, held in state.contacts.items() if np.abs(held.push[:, : robot.base]).max(initial=0.0) > 0]
    if not holding:
        return f"nothing carries {base!r}, so it falls; expected a contact that holds it from the start"
    falls = f"{base!r} falls with {share:.0%} of gravity, for {', '.join(holding)} cannot carry it"
    return f"{falls}; expected more contacts, more friction, or a harder `press`"


def _too_near(controller: Controller) -> list[str]:
    """Pairs of bodies that start nearer than they may."""
    collision = controller.phase.collision
    return [] if collision is None else collision.too_near(controller.state)


def _without_rate(phase: Phase) -> Phase:
    limit = phase.torque
    torque = TorqueLimit(limit.low, limit.high, np.full(limit.low.size, np.inf), limit.joints)
    return replace(phase, torque=torque, exit=None)
