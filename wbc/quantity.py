"""The measured quantities that end a phase, as readings of a state.

CONTACT.AXIS       wrench of the robot on the environment, at the contact's frame, also of one that is not active; of a
                   foot that is round along the axes of what it stands on
CONTACT.distance   of its frame from where the contact holds it, against its push or along the one axis held [m]
CONTACT.slip       speed of its frame across its push along what friction is to hold there, while it is active [m/s]
TASK.error, .speed distance to the reference along the task's axes [m], speed of its frame [m/s] (as the task sees it)
TASK.singular      smallest singular value of the task's rows in what the contacts leave free (`wbc.singular`)
TASK.tank          the energy left in the tank of a task that has one [J]
TASK.done          1 when the reference, and what led into it, have come to rest for good

All of them are true of the robot's model and of the sensor, as the controller knows them: a slip is that of the joints'
velocities, so noise of theirs is in it.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
import pinocchio as pin

from .contact import Contact
from .pair import seen
from .phase import stored
from .qp import Array
from .singular import smallest, threshold
from .state import State
from .task.force import ForceTask
from .task.impedance import Compliance
from .task.motion import MotionTask
from .transition import Reading


def force(contact: str, axis: int) -> Reading:
    """Component 0 .. 5 of the measured wrench (m, f) [N m, N]."""

    def read(state: State) -> float:
        F = state.measured.get(contact)
        return math.nan if F is None else float(F[axis])

    return read


def force_on(contact: str, frame: str, n: Array, axis: int) -> Reading:
    """The same along the axis n (3,) of the world, 0 .. 2 for a moment, 3 .. 5 for a force."""
    n, part = n.copy(), slice(0, 3) if axis < 3 else slice(3, 6)

    def read(state: State) -> float:
        F = state.measured.get(contact)
        return math.nan if F is None else float(n.dot(state.frame(frame).R.dot(F[part])))

    return read


def from_plane(frame: str, place: pin.SE3, axis: int, side: float = 1.0, to: str | None = None) -> Reading:
    """How far a frame is beyond `place`, on the `side` (1 or -1) of its axis 0 .. 2 [m]; `to`: seen from that frame."""
    normal = side * place.rotation[:, axis]
    origin = float(normal @ place.translation)
    return lambda state: float(normal.dot(seen(state, frame, to).p)) - origin


def from_sphere(frame: str, centre: Array, radius: float, to: str | None = None) -> Reading:
    """How far a frame is outside of a sphere [m]; `to`: seen from that frame."""
    centre = centre.copy()
    return lambda state: float(np.linalg.norm(seen(state, frame, to).p - centre)) - radius


def slip(contact: Contact) -> Reading | None:
    """How fast a contact gives way where its friction is to hold [m/s]; None where none is said to hold anything."""
    pushes = contact.pushes
    if pushes is None or not pushes.mu or not len(pushes.held):
        return None
    return lambda state: float(np.linalg.norm(pushes.turned(contact, state)[1].dot(contact.seen(state).V[3:])))


def error(task: MotionTask) -> Reading:
    """[m]"""
    return lambda state: float(np.linalg.norm(task.error(state)[3:]))


def speed(task: MotionTask) -> Reading:
    """[m/s]"""
    return lambda state: float(np.linalg.norm(task.seen(state).V[3:]))


def done(task: MotionTask) -> Reading:
    """1 or 0."""
    ends = ending(task)

    def read(state: State) -> float:
        start = state.starts.get(task)
        return float(state.since(task) >= (ends if start is None else max(ends, start.settles)))

    return read


def singular(task: MotionTask, start: State, contacts: Mapping[str, Contact]) -> Reading:
    """The smallest singular value of what the task asks for, in what the contacts leave; `start`: a state to begin."""

    def hold(state: State) -> None:
        for name, contact in contacts.items():
            state.contacts[name] = contact.hold(state)

    hold(start)
    rank = threshold(task, start, hold).rank
    return lambda state: smallest(task, state, rank)


def ending(task: MotionTask) -> float:
    """When the reference of a task has come to rest for good, after it began [s]; infinite: never."""
    return float(getattr(task.reference, "ends", math.inf))


def tank(task: ForceTask | Compliance) -> Reading:
    """[J]"""
    return lambda state: stored(state, task)


def pressing(task: ForceTask) -> Reading:
    """The measured force along the desired one, as a share of it [1]; not a number where no force is desired."""

    def read(state: State) -> float:
        F = state.measured.get(task.contact)
        f_d: Array = state.contacts[task.contact].A.T.dot(task.desired(state))[3:]
        square = float(f_d.dot(f_d))
        return math.nan if F is None or square < 1e-12 else float(F[3:].dot(f_d)) / square

    return read
