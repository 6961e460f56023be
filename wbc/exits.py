"""The ways out of a phase, from its entry in a spec; what only the geometry can tell is checked here."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from . import quantity as quantities
from . import spec as specs
from .contact import Contact
from .faults import Place
from .geometry import Geometry
from .qp import Array
from .task import Task
from .task.force import ForceTask
from .task.impedance import Compliance
from .task.motion import MotionTask
from .transition import STOP, Condition, Exit, Reading
from .wrench import WRENCH_AXES


def exit_of(
    base: Geometry,
    name: str,
    entry: specs.Phase,
    follower: str,
    contacts: Mapping[str, Contact],
    tasks: Mapping[str, Task],
    q: Array,
) -> Exit | None:
    """The ways out of a phase with its contacts and tasks; None where there are none."""
    conditions = entry.until.conditions if entry.until is not None else {}
    if not conditions and entry.timeout is None and entry.lost is None:
        return None
    until = []
    for quantity, bound in conditions.items():
        path = ("phases", name, "until", quantity)
        read = None if quantity == "time" else _reading(base, path, quantity, contacts, tasks, q)
        low = -math.inf if bound.min is None else bound.min
        until.append(Condition(quantity, read, low, math.inf if bound.max is None else bound.max, bound.for_))
    pressing = [(task.contact, quantities.pressing(task)) for task in tasks.values() if isinstance(task, ForceTask)]
    timeout = math.inf if entry.timeout is None else entry.timeout
    return Exit(tuple(until), follower, timeout, entry.else_ or STOP, entry.lost or "", tuple(pressing))


def _reading(
    base: Geometry, path: Place, quantity: str, contacts: Mapping[str, Contact], tasks: Mapping[str, Task], q: Array
) -> Reading | None:
    """How a measured quantity is read; None where it cannot be."""
    subject, _, what = quantity.rpartition(".")
    if what in WRENCH_AXES:
        axis, plane = WRENCH_AXES.index(what), base.plane(subject)
        if plane is None:
            return quantities.force(subject, axis)
        return quantities.force_on(subject, base.spec.contacts[subject].frame, plane.rotation[:, axis % 3], axis)
    if what == "distance":
        read = base.distance(subject, q)
        if read is None:
            held = ", ".join(base.spec.contacts[subject].constrained) or "no axis"
            message = f"contact {subject!r} holds {held}; expected one that `pushes`, or holds one of vx, vy, vz alone"
            base.faults.add(path, message)
        return read
    if what == "slip" and subject in contacts:
        if (read := quantities.slip(contacts[subject])) is None:
            base.faults.add(path, _no_slip(subject, contacts[subject]))
        return read
    task = tasks.get(subject)
    if what == "tank" and isinstance(task, ForceTask | Compliance):
        return quantities.tank(task)
    if not isinstance(task, MotionTask):
        return None  # at fault already
    if what == "done" and quantities.ending(task) == math.inf:
        base.faults.add(
            path, f"the reference of {subject!r} never ends; expected one that does, or another end: `time`"
        )
    if what == "singular":
        return quantities.singular(task, base.robot.state(q, np.zeros(base.robot.nv)), contacts)
    return {"done": quantities.done, "error": quantities.error, "speed": quantities.speed}[what](task)


def _no_slip(name: str, contact: Contact) -> str:
    """Why a contact cannot slip."""
    if contact.pushes is None or not contact.pushes.mu:
        lacks = "`pushes` and `friction`" if contact.pushes is None else "`friction`"
        return f"contact {name!r} has no friction that could give way; expected {lacks} in it"
    return f"contact {name!r} slides across its push by design; expected one that holds the frame there, or TASK.speed"
