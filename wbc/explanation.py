"""Why a tick is as it is: what conflicts where nothing satisfies all constraints, and what made the torque.

`explain` asks of a controller only that it has done a step. A conflict is an irreducible set of the hard constraints by
name, without what nobody can change: the dynamics. Of an answer it tells

    tau = motion + force + dynamics (+ null space)      [N m], as section 11.6.2 of the book writes its law

with F - h_C = M_C Vdot + A' lambda: motion is J' P (F - h_C), force J' (I - P) (F - h_C), dynamics J' h_C, and a
redundant arm adds its null space, (I - J' Jbar') (M vdot + h). Where no single frame tells the task (no contact or
several, a floating base) the same is told of the joints: h for J' h_C, and P of all contact rows G,
P = I - G' (G M^-1 G')^-1 G M^-1. Of a torque that is held without an answer dynamics is gravity, force J' lambda of the
last certified wrenches, and motion the rest: damping, and what is being let go.
"""

from __future__ import annotations

import copy
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from .analytic import dynamically_consistent_inverse, force_projector, task_bias, task_inertia
from .controller import Controller, Tick
from .dynamics import inertia, mobility
from .hardness import Culprit, Hard
from .pull import Pull, Regulariser, decided, pulls
from .qp import Array

SINGULAR = 1e6  # condition of J M^-1 J' beyond which the frame does not tell the task


class Active(NamedTuple):
    """A limit at work. As the costs are powers over time, of weights 1 the multiplier of a joint's bound is the torque
    [N m] with which it holds back, and that of a torque or force is an acceleration."""

    name: str
    multiplier: float
    unit: str


@dataclass(frozen=True)
class Explanation:
    """One tick, explained.

    `conflict`: a set of constraints that cannot hold together and can without any one of them; empty where all hold.
    `others`: names of further conflicts, which remain when one of the first is dropped. `tau` (nu,) as sent and its
    `split` by part. Of an answer, where there is one: `tasks`, `limits` at work, what is left to the `regulariser`.
    """

    t: float
    status: str
    reason: str
    joints: tuple[str, ...]
    conflict: tuple[Culprit, ...] = ()
    others: tuple[tuple[str, ...], ...] = ()
    tau: Array | None = None
    split: Mapping[str, Array] | None = None
    tasks: tuple[Pull, ...] = ()
    limits: tuple[Active, ...] = ()
    regulariser: Regulariser | None = None

    @property
    def feasible(self) -> bool:
        """Whether all constraints hold together."""
        return not self.conflict

    def as_json(self) -> dict[str, Any]:
        """One object of numbers and lists, SI units."""
        by_joint = None if self.split is None else {part: tau.tolist() for part, tau in self.split.items()}
        return {
            "t": self.t, "status": self.status, "reason": self.reason, "feasible": self.feasible,
            "joints": list(self.joints), "conflict": [each._asdict() for each in self.conflict],
            "others": [list(each) for each in self.others], "tau": None if self.tau is None else self.tau.tolist(),
            "split": by_joint, "tasks": [each.as_json() for each in self.tasks],
            "limits": [each._asdict() for each in self.limits],
            "regulariser": None if self.regulariser is None else self.regulariser.as_json(),
        }  # fmt: skip


def explain(controller: Controller) -> Explanation:
    """The controller's last tick, in up to tens of milliseconds. It changes nothing that a later tick reads.

    Where contacts were dropped the conflict is that of the tick with all of them, and the torque that without. A tick
    that was refused, or held until reset, solved nothing: it has no conflict of its own. Raises SolverError where it
    cannot be shown whether constraints conflict.
    """
    tick, out, joints = controller.tick, controller.output, controller.robot.joints
    if out is None:
        return Explanation(0.0, "NONE", "no tick was made", joints)
    told = {"status": out.status.value, "reason": out.reason, "joints": joints, "tau": out.tau}
    conflict, others = (), ()  # type: tuple[Culprit, ...], tuple[tuple[str, ...], ...]
    if tick is not None:
        asked = tick.refused or tick
        if not asked.solution.accepted or tick.program.yielded:
            conflict, others = Hard(asked, controller.dt).conflict()
    if tick is None or not tick.solution.accepted:
        t = controller.state.t if tick is None else tick.state.t
        return Explanation(t, conflict=conflict, others=others, split=_of_hold(controller), **told)  # type: ignore[arg-type]
    if tick.refused is not None:  # as it was solved, without the contacts that were dropped
        state = copy.copy(tick.state)
        state.contacts = {name: each for name, each in state.contacts.items() if name in tick.program.phase.contacts}
        tick = tick._replace(state=state)
    memory = controller.memory
    assert memory is not None
    given = memory.gravity if controller.robot.gravity == "robot" else np.zeros(len(joints))
    return Explanation(
        tick.state.t, conflict=conflict, others=others, split=_split(tick, memory.tau, given), tasks=pulls(tick),
        limits=_active(tick, controller.dt), regulariser=decided(tick), **told,  # type: ignore[arg-type]
    )  # fmt: skip


def _active(tick: Tick, dt: float) -> tuple[Active, ...]:
    """Limits with a multiplier, the largest first."""
    program, z = tick.program, tick.solution.z
    found = []
    for i in program.last.active(z):
        name = program.name(program.last.labels[i], bool(z[i] > 0.0), tick.state, tick.tau_last, dt)
        kind = name.partition("[")[0]
        force = kind in ("torque", "torque_rate") or "[" not in name
        found.append(
            Active(name, abs(float(z[i])), "rad/s^2" if force and "[" in name else "m/s^2" if force else "N m")
        )
    found.sort(key=lambda each: -each.multiplier)
    return tuple({each.name: each for each in reversed(found)}.values())[::-1]  # of several rows the largest


def _split(tick: Tick, tau: Array, given: Array) -> dict[str, Array]:
    """By part, (nu,) each; `tau` is what the motors do, of which the driver adds `given` itself."""
    state, x, slices = tick.state, tick.solution.x, tick.program.last.variables.slices
    base, held = state.robot.base, state.contacts
    vdot, pushed = x[slices["vdot"]], np.zeros(state.v.size)
    for name, each in held.items():
        pushed = pushed + each.push.T.dot(x[slices[name]])
    parts = _of_frame(tick, vdot, pushed) or _of_joints(tick, vdot, pushed)
    parts = {name: part[base:] for name, part in parts.items()}
    parts["dynamics"] = parts["dynamics"] - given
    # what the certificate's tolerance let through was cut from the torque, and is a motion's
    parts["motion"] = parts["motion"] + (tau - given - sum(parts.values()))
    return parts


def _of_frame(tick: Tick, vdot: Array, pushed: Array) -> dict[str, Array] | None:
    """The book's terms, where one contact of a fixed base tells the task frame; else None."""
    state = tick.state
    if state.robot.base or len(state.contacts) != 1:
        return None
    (held,) = state.contacts.values()
    frame = held.seen
    axes = np.flatnonzero(np.abs(frame.J).max(axis=1) > 1e-9)
    J, drift, A, M = frame.J[axes], frame.drift[axes], held.A[:, axes], state.M.copy()
    if len(axes) > M.shape[0] or not np.linalg.cond(J @ np.linalg.solve(M, J.T)) < SINGULAR:
        return None
    M_C, h_C = task_inertia(M, J), task_bias(M, J, state.bias, drift)
    moved = M_C @ (J @ vdot + drift)
    held_back = force_projector(A, M_C) @ moved if len(A) else np.zeros(len(axes))
    total = M @ vdot + state.bias
    parts = {"motion": J.T @ (moved - held_back), "force": pushed + J.T @ held_back, "dynamics": J.T @ h_C}
    if len(axes) < M.shape[0]:
        parts["null space"] = total - J.T @ (dynamically_consistent_inverse(M, J).T @ total)
    return parts


def _of_joints(tick: Tick, vdot: Array, pushed: Array) -> dict[str, Array]:
    """The same of the joints."""
    state = tick.state
    total = state.M.dot(vdot)
    G = np.concatenate([np.zeros((0, vdot.size)), *(each.G for each in state.contacts.values())])
    held_back = G.T.dot(inertia(mobility(state, G)).dot(G.dot(vdot))) if len(G) else np.zeros(vdot.size)
    return {"motion": total - held_back, "force": pushed + held_back, "dynamics": state.bias.copy()}


def _of_hold(controller: Controller) -> dict[str, Array] | None:
    """The same of a torque that no answer stands behind; None before the controller has started."""
    memory, state, base = controller.memory, controller.state, controller.robot.base
    if memory is None:
        return None
    gravity, pushed = state.gravity(), np.zeros(state.v.size)
    for name, lam in memory.lam.items():
        if name in state.contacts:
            pushed = pushed + state.contacts[name].push.T.dot(lam)
    given = memory.gravity if controller.robot.gravity == "robot" else np.zeros(memory.tau.size)
    force, motion = pushed[base:], memory.tau - gravity[base:] - pushed[base:]
    return {"motion": motion, "force": force, "dynamics": gravity[base:] - given}
