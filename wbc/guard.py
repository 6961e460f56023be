"""What a force loop believes of its contact: that it is there, and that the sensor tells the truth.

A held frame does not move along the constraint, so the world answers with what the torque presses with: the certified
multipliers of one tick foretell the force read in the next, but for what the model does not know. That error changes
slowly, and is followed (`Grip.offset`). Three things are compared at every tick: the measured force, the foretold one,
and the frame's motion against the natural constraint A V = 0 (book 11.40 ff.).

- A reading that jumps off what was foretold is not used, the last one stands; five in a row, and the sensor is not
  believed until it agrees again: the loop is open, at its target and with its integral (book 11.33).
- A contact without its force three times in a row is lost, and so is one that moves as no held frame does. It is no
  longer pressed on: a damped hold takes its axes where they are, with the load that the model does not know. A little
  later it is felt for with a share of its force, to which the hold gives way by about a millimetre; a force that is
  back gives it to the loop again, which begins with what presses then.

What nobody can tell: an error of the sensor that grows slowly, or stays within the gate, looks like one of the model.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from . import kernels
from .qp import Array
from .state import State
from .task.force import ForceTask, Released

if TYPE_CHECKING:
    from .contact import Held

GATE = (4.0, 0.6)  # [N], and of the desired force: a reading farther off than the larger is odd
ODD_TICKS = 5  # odd so many times in a row, and the sensor is not believed,
CALM_TICKS = 50  # until it was so many times within half the gate
LOOSE, TURNED = 0.1, -0.3  # of the desired force: with less a contact carries nothing; but it does not pull either
LOOSE_TICKS = 3  # with nothing to carry in a row, and it is lost
SILENT_TICKS = 5  # without a reading, until that is told
HELD_TICKS = 20  # with half the desired force, or without motion where nothing is read, until a contact is known
LEAVES = 0.03  # [m/s] away from what it presses on: it has left, whatever is read
STRAYS, STILL = 0.005, 0.002  # [m/s] either way, twice in a row, where no reading is believed; no motion
FAR, TIPS, FORGETS = 2.5e-3, 5e-3, 0.5  # [m], [rad] of motion that is forgotten in that time [s]: none held goes so far
FORGIVES = 0.5  # [s] in which the model's error is followed
STIFFNESS, DAMPING, MOST = 900.0, 60.0, 3.0  # [1/s^2], [1/s] of the hold; [m/s^2, rad/s^2] of each of its rows
WAITS, RISES, FEELS = 0.1, 0.2, 0.3  # [s] until a lost contact is felt for, [s] until that is at its share
BACK, BACK_TICKS = 0.2, 5  # of the desired force, in a row: it is there again
LEAST = 0.5  # [N] of desired force: with less a contact does not press
_NOTHING: Array = np.zeros(0)
_NO_WRENCH, _UPRIGHT = np.zeros(6), np.zeros(3)


class Grip(NamedTuple):
    """What is known of a pressing contact: a value, its arrays are never written to."""

    held: int = 0  # ticks that show a contact, up to HELD_TICKS
    offset: Array = _NOTHING  # (k,) multipliers measured less those asked for, as they have been
    strayed: float = 0.0  # [m] along the desired force, less what is forgotten
    tipped: Array = _UPRIGHT  # (3,) [rad] about axes that are held, less what is forgotten
    silent: int = -1  # ticks in a row without a reading, after one; -1: there was none yet
    odd: int = 0  # ticks in a row
    loose: int = 0  # ticks in a row
    calm: int = -1  # ticks in a row in which a sensor that is not believed agrees; -1: it is believed
    turned: bool = False  # it then read the opposite
    lost: int = -1  # ticks since the contact was lost; -1: it is not
    moved: Array = _NOTHING  # (k,) integral of A V since then
    back: int = 0  # ticks in a row with a force on what was lost


class Pressed(NamedTuple):
    """A tick, along the desired force: forces measured, foretold and desired [N], the frame's speed [m/s]; how far [N]
    the whole measured force is off what was foretold, and the frame has tipped over [rad]."""

    had: float
    asked: float
    wanted: float
    speed: float
    surprise: float
    tilt: float


class Guarded(NamedTuple):
    """What is known after a tick, what is to be told, and the contact that has just been
    lost without its reading telling so ("": none)."""

    grips: Mapping[str, Grip]
    told: tuple[str, ...] = ()
    lost: str = ""


NEW = Grip()
UNGUARDED = Guarded({})


def watch(
    state: State, force: Mapping[str, tuple[str, ForceTask]], grips: Mapping[str, Grip], lam: Mapping[str, Array]
) -> Guarded:
    """One tick of all contacts at which a force is held; `lam`: last certified multipliers.

    Takes readings that are not believed out of `state.measured`, and puts lost contacts into `state.released`.
    """
    if not force:
        return UNGUARDED
    now: dict[str, Grip] = {}
    told: tuple[str, ...] = ()
    lost = ""
    for name, (_, task) in force.items():
        before = grips.get(name, NEW)
        now[name], said = _tick(state, name, task, before, lam.get(name))
        if said:
            told = (*told, f"{name}: {said}")
            # where the force is gone the phase's own way out sees it, two ticks later
            if before.lost < 0 <= now[name].lost and before.loose + 1 < LOOSE_TICKS:
                lost = name
    return Guarded(now, told, lost)


def gripped(grips: Mapping[str, Grip], force: Mapping[str, object], contacts: Mapping[str, object]) -> dict[str, Grip]:
    """What is known of the contacts that a phase has in common with the last one."""
    return {name: grip for name, grip in grips.items() if name in force and name in contacts}


def _tick(state: State, name: str, task: ForceTask, grip: Grip, lam: Array | None) -> tuple[Grip, str]:
    held: Held = state.contacts[name]
    F, desired = state.measured.get(name), state.followed[name]
    k = desired.size
    if lam is None or lam.size != k:  # nothing has been foretold yet
        return grip, ""
    known = grip.held >= HELD_TICKS
    offset = grip.offset if grip.offset.size == k else np.zeros(k)
    dt = state.dt
    alpha, fade = dt / FORGIVES if known else 1.0 / (grip.held + 1.0), 1.0 - dt / FORGETS
    read, grown, tipped = _NO_WRENCH if F is None else F, np.empty(k), np.empty(3)
    at = Pressed._make(
        kernels.press(
            read, held.inverse, held.A, lam, offset, desired, held.slip, alpha, grip.tipped, dt, fade, grown, tipped
        )
    )
    if grip.lost >= 0:
        return _hold_still(state, name, task, grip, at, F, desired)
    presses = known and at.wanted > LEAST
    strayed = fade * (grip.strayed + at.speed * dt) if presses else 0.0
    if not presses:
        tipped = _UPRIGHT
    elif at.tilt > TIPS:
        return _leave(state, name, grip, held, "it tips over")
    if F is None:
        silent = grip.silent + 1 if grip.silent >= 0 else -1
        said = "no reading" if silent > SILENT_TICKS and task.listens else ""
        grip = Grip(grip.held, grip.offset, strayed, tipped, silent, 0, grip.loose, grip.calm, grip.turned)
        return _by_motion(state, name, grip, held, at, said)
    if grip.calm >= 0:
        return _not_believed(state, name, grip._replace(strayed=strayed, silent=0, tipped=tipped), held, at)
    loose = presses and TURNED * at.wanted < at.had < LOOSE * at.wanted
    if loose or (task.listens and _odd(known, at)):  # what nobody goes by need not be right
        return _doubted(state, name, grip._replace(tipped=tipped), held, at, strayed, loose)
    if presses and (strayed < -FAR or at.speed < -LEAVES):
        return _leave(state, name, grip, held, "it moves away from what it presses on")
    if known:
        return Grip(grip.held, grown, strayed, tipped, 0), ""
    return (Grip(grip.held + 1, grown, silent=0) if at.had >= 0.5 * at.wanted else Grip(silent=0)), ""


def _odd(known: bool, at: Pressed) -> bool:
    """Whether a reading is no continuation of what was. Before a contact is known only the opposite of what must be
    read is, landings are rough; and so much less than what a frame that stands presses with."""
    gate = _gate(at.wanted)
    if known:
        return at.surprise > gate
    opposite = at.had * at.asked < 0.0 and at.surprise > gate + 0.4 * at.wanted
    short = at.had >= LOOSE * at.wanted and at.asked - at.had > at.wanted + gate and abs(at.speed) < STRAYS
    return opposite or short


def _gate(wanted: float) -> float:
    return max(GATE[0], GATE[1] * wanted)


def _doubted(
    state: State, name: str, grip: Grip, held: Held, at: Pressed, strayed: float, loose: bool
) -> tuple[Grip, str]:
    """A tick whose reading is doubtful, of a sensor that has been right so far."""
    odd, count = grip.odd + 1, grip.loose + 1 if loose else 0
    if count >= LOOSE_TICKS:
        return _lose(state, name, grip, held, f"lost: less than {LOOSE:.0%} of its force for {LOOSE_TICKS} ticks")
    turned = abs(at.had + at.asked) < -TURNED * max(at.wanted, at.asked)
    calm = 0 if odd >= ODD_TICKS else -1
    grip = Grip(grip.held, grip.offset, strayed, grip.tipped, 0, odd, count, calm, turned)
    if odd >= ODD_TICKS:
        return _not_believed(state, name, grip, held, at)
    last = state.loops[name].filtered
    if last is None:
        del state.measured[name]
    else:
        state.measured[name] = last
    return grip, f"the reading is {at.surprise:.3g} N off what the torque presses with; the last one stands"


def _not_believed(state: State, name: str, grip: Grip, held: Held, at: Pressed) -> tuple[Grip, str]:
    """A tick whose sensor is wrong, until it agrees for long enough."""
    calm = grip.calm + 1 if at.surprise < 0.5 * _gate(at.wanted) else 0
    if calm >= CALM_TICKS:
        return Grip(grip.held, grip.offset, grip.strayed, grip.tipped, 0), ""
    del state.measured[name]
    if grip.held < HELD_TICKS:  # nothing of what a sensor made that was never right
        state.loops[name] = state.loops[name]._replace(integral=_NOTHING)
    what = "reads the opposite of" if grip.turned else f"is {at.surprise:.3g} N off"
    said = f"its sensor {what} what the torque presses with, and is not believed"
    return _by_motion(state, name, grip._replace(calm=calm), held, at, said)


def _by_motion(state: State, name: str, grip: Grip, held: Held, at: Pressed, said: str) -> tuple[Grip, str]:
    """A tick without a reading that could be believed: the motion alone tells whether the contact is there."""
    if grip.held < HELD_TICKS:
        still = abs(at.speed) < STILL and at.asked > 0.5 * at.wanted
        return grip._replace(held=grip.held + 1 if still else 0), said
    if at.wanted <= LEAST:
        return grip, said
    loose = grip.loose + 1 if abs(at.speed) > STRAYS else 0
    if loose >= 2 or abs(grip.strayed) > FAR:
        return _lose(state, name, grip, held, "lost: it moves as no held frame does, and no force is known")
    return grip._replace(loose=loose), said


def _leave(state: State, name: str, grip: Grip, held: Held, why: str) -> tuple[Grip, str]:
    """Lost by its motion, whatever is read: that is no contact's, nor what was learnt of it."""
    if grip.calm < 0:
        grip = grip._replace(calm=0, offset=_NOTHING)
    return _lose(state, name, grip, held, f"left: {why}")


def _lose(state: State, name: str, grip: Grip, held: Held, why: str) -> tuple[Grip, str]:
    grip = grip._replace(lost=0, moved=np.zeros(held.rhs.size), odd=0, loose=0, strayed=0.0, back=0)
    _release(state, name, grip, held)
    return grip, why


def _hold_still(
    state: State, name: str, task: ForceTask, grip: Grip, at: Pressed, F: Array | None, desired: Array
) -> tuple[Grip, str]:
    """A lost contact, until its force is back."""
    held: Held = state.contacts[name]
    there = F is not None and grip.calm < 0 and at.had > max(BACK * at.wanted, LEAST)
    back = grip.back + 1 if there else 0
    if F is not None and back >= BACK_TICKS:
        lam = held.inverse.dot(F)
        state.loops[name] = task.begin(state, lam - grip.offset if grip.offset.size == lam.size else lam)
        return Grip(silent=0), "pressed on again"
    calm = grip.calm
    if calm >= 0:  # a sensor that reads nothing where nothing is pressed on is right again
        calm = calm + 1 if F is not None and abs(at.had) < max(LOOSE * at.wanted, LEAST) else 0
    calm = -1 if calm >= CALM_TICKS else calm
    grip = grip._replace(lost=grip.lost + 1, moved=grip.moved + state.dt * held.slip, back=back, calm=calm)
    _release(state, name, grip, held)
    return grip, "lost, and held where it is until it is pressed on again"


def _release(state: State, name: str, grip: Grip, held: Held) -> None:
    """Hold the axes of a contact: A Vdot + Adot V = -c A V - k s, s what they moved; carry what the model left out."""
    pull = np.clip(DAMPING * held.slip + STIFFNESS * grip.moved, -MOST, MOST)
    held.rhs -= pull
    feels = FEELS * min(max(grip.lost * state.dt - WAITS, 0.0) / RISES, 1.0)
    state.released = {**state.released, name: Released(pull, feels)}
    state.measured.pop(name, None)
    if grip.offset.size == pull.size:
        state.carry(held.seen, -grip.offset.dot(held.A))
