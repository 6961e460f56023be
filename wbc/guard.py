"""What a force loop believes of its contact: that it is there, and that the sensor tells the truth.

A held frame does not move along the constraint, and then the world answers with what the torque presses with: the
certified multipliers of the last tick tell the force of this one, but for what the model does not know. That error
changes slowly, and is followed (`offset`). So three things are compared at every tick: the measured force, the predicted
one, and the frame's motion against the natural constraint A V = 0 (book 11.40 ff.).

- A reading that jumps off what was foretold is not used (the last one stands); five in a row, and the sensor is not
  believed until it agrees again: the loop is open, at its target and with its integral (book 11.33).
- A contact that has no force left three times in a row is lost, and one that moves as no held frame does. A lost
  contact is no longer pressed on: its axes are taken by a damped hold where they are, and its load is carried on. A
  little later it is felt for, slowly and not far; force on it that is back gives it to the loop again, without a jump.

What cannot be told: an error of the sensor that grows slowly, or stays within the gate, looks like one of the model.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from . import kernels
from .qp import Array
from .robot import State
from .task import ForceTask

if TYPE_CHECKING:
    from .contact import Held

GATE = (4.0, 0.6)  # [N], and of the desired force: a reading farther off than the larger is odd
ODD_TICKS = 5  # in a row, and the sensor is not believed,
CALM_TICKS = 50  # until it was that many times within half the gate
LOOSE = 0.1  # of the desired force: with less a contact carries nothing,
LOOSE_TICKS = 3  # and is lost when it did so that many times in a row,
TURNED = -0.3  # but with less than this the sensor is wrong: what only pushes does not pull
SILENT_TICKS = 5  # without a reading until that is told
HELD_TICKS = 20  # with half the desired force, or without motion, until a contact is known to be held
LEAVES = 0.03  # [m/s] away from what it presses on: it has left, whatever is read
STRAYS = 0.005  # [m/s] either way, where nothing is read that could be believed, for two ticks
STILL = 0.002  # [m/s]
FAR, FORGETS = 2.5e-3, 0.5  # [m] of motion that is forgotten in that time [s]: no held frame goes so far
FORGIVES = 0.5  # [s] in which the error of the model is followed
STIFFNESS, DAMPING = 900.0, 60.0  # [1/s^2], [1/s] of the hold
PULLS = 3.0  # [m/s^2, rad/s^2], at most, of each of its rows
WAITS, FEELS, REACH = 0.2, 0.01, 3e-3  # [s] until a lost contact is felt for, [m/s], [m] no farther
BACK, BACK_TICKS = 0.2, 5  # of the desired force, in a row: it is there again
LEAST = 0.5  # [N] of desired force below which a contact does not press
_NOTHING: Array = np.zeros(0)
_NO_WRENCH = np.zeros(6)


class Grip(NamedTuple):
    """What is known of a pressing contact; a value, its arrays are never written to."""

    held: int = 0  # ticks in a row that show a contact, up to HELD_TICKS
    offset: Array = _NOTHING  # (k,) multipliers measured less those asked for, as they have been
    odd: int = 0
    loose: int = 0
    silent: int = 0  # ticks in a row without a reading, after one; -1: there was none yet
    calm: int = -1  # ticks in a row in which a sensor that is not believed agrees; -1: it is believed
    turned: bool = False  # it read a pull where the contact pushes
    strayed: float = 0.0  # [m] along the desired force, less what is forgotten
    lost: int = -1  # ticks since the contact was lost; -1: it is not
    moved: Array = _NOTHING  # (k,) integral of A V since then
    back: int = 0


NEW = Grip()


class Guarded(NamedTuple):
    """Of a tick: what is known now, what is to be told, and the contact that has just been lost ("": none)."""

    grips: Mapping[str, Grip]
    told: tuple[str, ...] = ()
    lost: str = ""


def watch(
    state: State, force: Mapping[str, tuple[str, ForceTask]], grips: Mapping[str, Grip], lam: Mapping[str, Array]
) -> Guarded:
    """One tick of all contacts at which a force is held; `lam`: last certified multipliers.

    Takes readings that are not believed out of `state.measured`, and puts lost contacts in `state.released`.
    """
    now: dict[str, Grip] = {}
    told: tuple[str, ...] = ()
    lost = ""
    for name, (_, task) in force.items():
        before = grips.get(name, NEW)
        now[name], said = _watched(state, name, task, before, lam.get(name))
        if said:
            told = (*told, f"{name}: {said}")
            if before.lost < 0 <= now[name].lost:
                lost = name
    return Guarded(now, told, lost)


def _watched(state: State, name: str, task: ForceTask, grip: Grip, lam: Array | None) -> tuple[Grip, str]:
    held: Held = state.contacts[name]
    F, desired = state.measured.get(name), task.desired(state)
    k = desired.size
    if lam is None or lam.size != k:  # it has just begun
        return (grip if F is None or grip.silent >= 0 else grip._replace(silent=0)), ""
    offset = grip.offset if grip.offset.size == k else np.zeros(k)
    known = grip.held >= HELD_TICKS
    alpha = state.dt / FORGIVES if known else 1.0 / (grip.held + 1.0)
    grown, out = np.empty(k), np.empty(5)
    reading = _NO_WRENCH if F is None else F
    kernels.press(reading, held.inverse, held.A, lam, offset, desired, held.slip, alpha, grown, out)
    had, asked, size, speed, surprise = out.tolist()
    if grip.lost >= 0:
        return _held_still(state, name, task, grip, held, F, had, size, desired)
    presses = size > LEAST
    strayed = (grip.strayed + speed * state.dt) * (1.0 - state.dt / FORGETS) if presses and known else 0.0
    gate = max(GATE[0], GATE[1] * size)
    if F is None:
        silent = grip.silent + 1 if grip.silent >= 0 else -1
        grip, said = grip._replace(silent=silent, odd=0), "no reading" if silent > SILENT_TICKS else ""
    else:
        # before it is known to be held only what reads the opposite of what it must is odd: landings are rough
        odd = surprise > gate if known else had * asked < 0.0 and surprise > gate + 0.4 * size
        if grip.calm < 0:
            loose = presses and known and TURNED * size < had < LOOSE * size
            if not odd and not loose and had > -size:
                touched = had >= 0.5 * size or known or not presses
                if grip.odd or grip.loose or grip.silent or strayed != grip.strayed or not known:
                    pass
                left = presses and known and (strayed < -FAR or speed < -LEAVES)
                count = min(grip.held + 1, HELD_TICKS) if touched else 0
                grip = Grip(count, grown if touched else _NOTHING, silent=0, strayed=strayed)
                return _lose(state, name, grip, held, "left: it moves away from what it presses on") if left else (grip, "")
            if loose and grip.loose + 1 >= LOOSE_TICKS:
                why = f"lost: less than {LOOSE:.0%} of its force for {LOOSE_TICKS} ticks"
                return _lose(state, name, grip._replace(strayed=strayed), held, why)
            count = grip.odd + 1
            turned = had < TURNED * size if presses else False
            grip = grip._replace(odd=count, loose=grip.loose + 1 if loose else 0, silent=0, strayed=strayed)
            if count < ODD_TICKS or loose:
                _stand(state, name)
                return grip, f"the reading jumped by {surprise:.3g} N off what the torque presses with; the last one stands"
            grip = grip._replace(calm=0, turned=turned, loose=0)
        calm = grip.calm + 1 if (surprise < 0.5 * gate if known else not odd) else 0
        if calm >= CALM_TICKS:
            return grip._replace(calm=-1, odd=0, turned=False, silent=0), ""
        grip = grip._replace(calm=calm, silent=0)
        del state.measured[name]
        said = "the sensor reads a pull where the contact pushes" if grip.turned else (
            f"the sensor is {surprise:.3g} N off what the torque presses with"
        )
        said += ", and is not believed"
    # nothing is read that could be believed: the motion alone tells
    loose = grip.loose + 1 if presses and known and abs(speed) > STRAYS else 0
    if known and presses and (loose >= 2 or abs(strayed) > FAR):
        return _lose(state, name, grip._replace(loose=0), held, "lost: it moves, and no force is known there")
    count = min(grip.held + 1, HELD_TICKS) if abs(speed) < STILL and asked > 0.5 * size else grip.held if known else 0
    return grip._replace(held=count, loose=loose, strayed=strayed), said


def _stand(state: State, name: str) -> None:
    """The last reading that was believed stands for one that is not."""
    last = state.loops[name].filtered if name in state.loops else None
    if last is None:
        del state.measured[name]
    else:
        state.measured[name] = last


def _lose(state: State, name: str, grip: Grip, held: Held, why: str) -> tuple[Grip, str]:
    k = held.rhs.size
    grip = grip._replace(lost=0, moved=np.zeros(k), odd=0, loose=0, strayed=0.0, back=0)
    release(state, name, grip, held, np.zeros(k))
    return grip, f"{why}; held where it is"


def _held_still(
    state: State, name: str, task: ForceTask, grip: Grip, held: Held, F: Array | None, had: float, size: float,
    desired: Array,
) -> tuple[Grip, str]:  # fmt: skip
    """A lost contact, until its force is back."""
    there = F is not None and grip.calm < 0 and had > max(BACK * size, 2.0 * LEAST)
    back = grip.back + 1 if there else 0
    if back >= BACK_TICKS and F is not None:
        lam = held.inverse.dot(F)
        state.loops[name] = task.begin(state, lam - grip.offset if grip.offset.size == lam.size else lam)
        return Grip(silent=0), "pressed on again"
    ticks = grip.lost + 1
    felt = min(max(ticks * state.dt - WAITS, 0.0) * FEELS, REACH)
    n = desired.dot(held.A)[3:] / max(size, LEAST)
    grip = grip._replace(lost=ticks, moved=grip.moved + state.dt * held.slip, back=back)
    release(state, name, grip, held, held.A[:, 3:].dot(n * felt))
    return grip, "lost, and held where it is until it is pressed on again"


def release(state: State, name: str, grip: Grip, held: Held, goal: Array) -> None:
    """Take the axes of a contact by a damped hold, A Vdot + Adot V = -c A V - k (s - goal); carry its load on."""
    pull = np.clip(DAMPING * held.slip + STIFFNESS * (grip.moved - goal), -PULLS, PULLS)
    held.rhs -= pull
    state.released = {**state.released, name: pull}
    state.measured.pop(name, None)
    if grip.offset.size == pull.size:
        state.carry(held.seen, -grip.offset.dot(held.A))


def kept(grips: Mapping[str, Grip], force: Mapping[str, object], contacts: Mapping[str, object]) -> dict[str, Grip]:
    """What is known of the contacts that a phase has in common with the last one."""
    return {name: grip for name, grip in grips.items() if name in force and name in contacts}

