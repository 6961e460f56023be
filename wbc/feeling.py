"""What a phase may feel: a wrench that its source cannot tell from another one would count twice, and is a fault.

A wrist sensor reads all that acts on its link, a momentum observer all that acts on the arm.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from .contact import Contact
from .geometry import Geometry
from .phase import Phase
from .robot import Robot
from .task import Task
from .task.impedance import Compliance

SENSOR = "wrist_sensor"  # the site of it


def check_felt(geometry: Geometry, contacts: Mapping[str, Contact], tasks: Mapping[str, Task]) -> None:
    """Faults of the wrenches that the contacts and tasks of a phase feel."""
    for name, contact in contacts.items():
        if contact.feedforward == "measured":
            beside = [each for each in contacts if each != name and _one_link(geometry, contact, contacts[each])]
            if beside:
                message = f"the wrench measured there is also that of contact {beside[0]!r}, on the same link"
                geometry.faults.add(
                    ("contacts", name, "feedforward"), f"{message}; expected none or modelled, or one contact on a link"
                )
    compliant = {name: task for name, task in tasks.items() if isinstance(task, Compliance)}
    felt = {name: task for name, task in compliant.items() if task.source in ("measured", "observer")}
    for name, task in felt.items():
        if task.source == "observer":
            others = [f"contact {each!r}" for each in contacts if not _one_link(geometry, task, contacts[each])]
            others += [f"what task {each!r} feels" for each in felt if not _one_link(geometry, task, felt[each])]
            if others:
                message = f"an observer feels all that acts on the arm, so {others[0]} on another link as well"
                geometry.faults.add(("tasks", name, "external"), f"{message}; expected measured, or all on one link")


def unfelt(robot: Robot, phases: Sequence[Phase]) -> dict[str, str]:
    """Contacts and tasks, and their frames, at which a wrist sensor does not read what acts: on links above it."""
    if SENSOR not in robot.frames:
        return {}
    feeling = {name: frame for phase in phases for name, frame in phase.feeling.items()}
    return {name: frame for name, frame in feeling.items() if robot.wrench_map(SENSOR, frame) is None}


def _one_link(geometry: Geometry, a: Contact | Compliance, b: Contact | Compliance) -> bool:
    """Whether no joint lies between the frames of two."""
    return geometry.robot.wrench_map(a.frame, b.frame) is not None
