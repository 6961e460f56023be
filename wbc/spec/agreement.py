"""What must hold between the entries of a spec: the names that they refer to, gains and axes, what phases change.

`left_out` are entries and sections with faults of their own; they are not in the spec, and nothing is said of them.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator
from collections.abc import Set as AbstractSet
from itertools import chain, islice
from typing import TYPE_CHECKING, Any

from ..axes import MOMENTUM_AXES, WRENCH_AXES
from ..errors import did_you_mean
from .body import ComTask, DistributionTask, GazeTask, MomentumTask, Over, RelativeTask, TorqueTask
from .compliance import AdmittanceTask, ImpedanceTask
from .fields import shown
from .phase import STOP
from .source import MAX_FAULTS, KeyPath, Message, NoSuchKey, dotted, put
from .task import ForceTask, MotionTask, PostureTask

if TYPE_CHECKING:
    from .document import Spec
    from .phase import Phase

LeftOut = AbstractSet[KeyPath]
SECTIONS: tuple[KeyPath, ...] = (
    ("limits",),
    ("plant",),
    ("plant", "noise"),
    ("plant", "noise", "bias"),
)  # `--set` makes them when absent
_GAINS: dict[type, tuple[str, ...]] = {
    ForceTask: ("kp", "ki", "damping"),
    MotionTask: ("kp", "kd"),
    ImpedanceTask: ("M", "B", "K"),
    AdmittanceTask: ("M", "B", "K", "kp", "kd"),
}
_IN_PHASES = ("contacts", "tasks", "limits", "references")


def disagreements(spec: Spec, left_out: LeftOut, check: Callable[[Any, LeftOut], list[Message]]) -> list[Message]:
    """At most MAX_FAULTS + 1 faults; `check` gives those of a changed tree."""
    found = list(
        islice(
            chain(_of_contacts(spec, left_out), _of_tasks(spec, left_out), _of_plant(spec, left_out)), MAX_FAULTS + 1
        )
    )
    phases = _of_phases(spec, left_out, lambda tree: [each for each in check(tree, left_out) if each not in found])
    return found + list(islice(phases, MAX_FAULTS + 1 - len(found)))


def _unknown(name: str, spec: Spec, section: str, left_out: LeftOut) -> str | None:
    known = [*getattr(spec, section), *(str(path[-1]) for path in left_out if path[0] == section)]
    if name in known or (section,) in left_out:
        return None
    hint = did_you_mean(name, filter(None, known)) or f"; expected it under `{section}`, where there is none"
    return f"no {section[:-1]} named {shown(name)}{hint}"


def _of_contacts(spec: Spec, left_out: LeftOut) -> Iterator[Message]:
    for name, contact in spec.contacts.items():
        if contact.rides is not None and (message := _unknown(contact.rides, spec, "references", left_out)):
            yield ("contacts", name, "rides"), message
        for axis, target in contact.targets.items():
            if isinstance(target, str) and (message := _unknown(target, spec, "references", left_out)):
                under = ("wrench",) if axis in WRENCH_AXES and contact.natural is None else ()
                yield ("contacts", name, "artificial", *under, axis), message


def _of_tasks(spec: Spec, left_out: LeftOut) -> Iterator[Message]:
    forced: dict[str, str] = {}  # contact -> its force task
    for name, task in spec.tasks.items():
        if isinstance(task, PostureTask | GazeTask | TorqueTask):
            continue
        if isinstance(task, RelativeTask | MomentumTask):
            yield from ((("tasks", name, *key), message) for key, message in _of_body_motion(task, spec, left_out))
            continue
        if isinstance(task, ComTask | DistributionTask):
            yield from ((("tasks", name, *key), message) for key, message in _of_body(task, spec, left_out))
            continue
        for key, message in _of_task(task, spec, left_out):
            yield ("tasks", name, key), message
        if isinstance(task, ForceTask) and (first := forced.setdefault(task.contact, name)) != name:
            message = f"contact {task.contact!r} already has the force task {first!r}"
            yield ("tasks", name, "contact"), message


def _of_body(task: ComTask | DistributionTask, spec: Spec, left_out: LeftOut) -> Iterator[tuple[KeyPath, str]]:
    """The reference of a centre of mass, and the contacts that tasks of the whole body name."""
    shares: Collection[str] = ()
    key: KeyPath = ("shares",)
    if isinstance(task, DistributionTask):
        shares = task.shares or ()
        for name in task.press or ():
            if message := _unknown(name, spec, "contacts", left_out):
                yield ("press", name), message
    elif isinstance(task.target, Over):
        shares, key = task.target.over, ("target", "over")
    elif task.reference is not None and (message := _unknown(task.reference, spec, "references", left_out)):
        yield ("target",), message
    for i, name in enumerate(shares):
        if message := _unknown(name, spec, "contacts", left_out):
            yield (*key, name if isinstance(shares, dict) else i), message


def _of_body_motion(task: RelativeTask | MomentumTask, spec: Spec, left_out: LeftOut) -> Iterator[tuple[KeyPath, str]]:
    """The references of a relative pose and of a momentum, and gains along their axes."""
    targets: dict[KeyPath, Any] = (
        {("target",): task.target}
        if isinstance(task, RelativeTask)
        else {("target", axis): target for axis, target in task.target.items()}
    )
    for path, target in targets.items():
        if isinstance(target, str) and (message := _unknown(target, spec, "references", left_out)):
            yield path, message
    axes: Collection[str] = () if task.axes == "all" else task.axes
    if isinstance(task, MomentumTask) and task.axes == "all":
        axes = MOMENTUM_AXES
    for key in ("kp", "kd"):
        gain = getattr(task, key, 0.0)
        if axes and isinstance(gain, tuple) and len(gain) != len(axes):
            expected = "numbers" if isinstance(gain[0], float) else "rows"
            yield (key,), f"expected {len(axes)} {expected} ({', '.join(axes)}), got {len(gain)}"


def _of_plant(spec: Spec, left_out: LeftOut) -> Iterator[Message]:
    """A push is a name in the log, beside those of contacts and tasks; bodies move on references."""
    for body, path in spec.plant.paths.items():
        if message := _unknown(path, spec, "references", left_out):
            yield ("plant", "paths", body), message
    for name in spec.plant.pushes:
        for kind, known in (("contact", spec.contacts), ("task", spec.tasks)):
            if name in known:
                yield ("plant", "pushes", name), f"there is a {kind} of that name; expected another one"


def _of_task(
    task: ForceTask | MotionTask | ImpedanceTask | AdmittanceTask, spec: Spec, left_out: LeftOut
) -> Iterator[tuple[str, str]]:
    if (
        not isinstance(task, ForceTask)
        and task.target
        and (message := _unknown(task.target, spec, "references", left_out))
    ):
        yield "target", message
    if task.contact and (message := _unknown(task.contact, spec, "contacts", left_out)):
        yield "contact", message
    if isinstance(task, ImpedanceTask | AdmittanceTask) and task.K_scale is not None:
        if message := _unknown(task.K_scale, spec, "references", left_out):
            yield "K_scale", message
        elif (reference := spec.references.get(task.K_scale)) is not None:
            if reference.profile is None:
                yield "K_scale", f"{task.K_scale!r} is a {reference.kind}; expected a profile, a number over time"
            elif min(reference.profile.values) < 0.0:
                yield (
                    "K_scale",
                    f"{task.K_scale!r} falls below 0, where a spring pushes away; expected values of at least 0",
                )
    axes: tuple[str, ...] | None = None  # None: the spec alone does not tell
    if contact := spec.contacts.get(task.contact or ""):
        axes = contact.gain_names(task.type)
        if not (contact.wrench_targets if task.type == "force" else contact.motion_targets):
            kind = "force" if task.type == "force" else "motion"
            yield "contact", f"contact {task.contact!r} has no {kind} target in its `artificial`; expected one"
        if contact.with_ is not None and isinstance(task, ImpedanceTask | AdmittanceTask):
            message = f"contact {task.contact!r} is with another body, and what is felt there is told of the world"
            yield "contact", f"{message}; expected a motion task, or a contact with the world"
    elif not isinstance(task, ForceTask) and task.contact is None and task.axes != "all":
        axes = task.axes
    for key in _GAINS[type(task)]:
        gain = getattr(task, key)
        if axes and isinstance(gain, tuple) and len(gain) != len(axes):
            expected = "numbers" if isinstance(gain[0], float) else "rows"
            yield key, f"expected {len(axes)} {expected} ({', '.join(axes)}), got {len(gain)}"


def _of_phases(spec: Spec, left_out: LeftOut, check: Callable[[Any], list[Message]]) -> Iterator[Message]:
    if not spec.phases:
        return
    if not any(key[0] in ("phases", "contacts", "tasks") for key in left_out):
        yield from _of_names(spec)
    tree = spec.model_dump(by_alias=True, exclude_unset=True, exclude={"phases", "expect"})
    for name, phase in spec.phases.items():
        path: KeyPath = ("phases", name)
        yield from ((path + key, message) for key, message in _of_phase(phase, spec, left_out))
        changed: Any = tree
        places: dict[KeyPath, str] = {}
        for key, value in phase.set.items():
            parts: KeyPath = tuple(key.split("."))
            if parts[:1] in left_out or parts[:2] in left_out:
                continue
            try:
                if parts[0] not in _IN_PHASES:
                    raise NoSuchKey(parts, f"a phase can change {', '.join(_IN_PHASES)} only")
                changed, place = put(changed, parts, value, SECTIONS)
                places[place] = key
            except NoSuchKey as missing:
                yield (*path, "set", key), f"{dotted(missing.path)}: {missing.message}"
        for at, message in check(with_sound(spec, changed, places)) if places else ():
            key = next((key for place, key in places.items() if at[: len(place)] == place), "")
            tail = message if tuple(key.split(".")) == at else f"{dotted(at)}: {message}"
            yield (*path, "set", *([key] if key else [])), tail


def with_sound(spec: Spec, tree: dict[str, Any], places: Collection[KeyPath]) -> dict[str, Any]:
    """A changed tree in which the entries that no place leads into stand as they are in the spec: checked already."""
    touched = {place[:length] for place in places for length in (1, 2)}
    sound: dict[str, Any] = {}
    for key, value in tree.items():
        was = getattr(spec, key)
        if (key,) not in touched:
            sound[key] = was
        elif isinstance(was, dict) and (key,) not in places:  # entries by name
            sound[key] = {name: entry if (key, name) in touched else was[name] for name, entry in value.items()}
        else:
            sound[key] = value
    return sound


def _of_names(spec: Spec) -> Iterator[Message]:
    """Phases lead to phases, each of them is led to, and each contact and task is active in one of them."""
    names = list(spec.phases)
    if STOP in names:
        yield ("phases", STOP), "this word is taken by the end of a run; expected another name"
    named = {way for phase in spec.phases.values() for way in (phase.else_, phase.lost)}
    for name, follower in zip(names, [*names[1:], None], strict=True):
        phase = spec.phases[name]
        if phase.until is None and follower is not None and follower not in named:
            yield ("phases", name, "until"), "is missing; only the last phase may go on without an end"
        if phase.until is not None and follower is None:
            message = "the last phase runs to the end; remove until, or add a phase after it"
            yield ("phases", name, "until"), f"expected none: {message}"
        for key, way in (("else", phase.else_), ("lost", phase.lost)):
            if way is not None and way not in (*names, STOP):
                yield ("phases", name, key), f"no phase named {shown(way)}{did_you_mean(way, (*names, STOP))}"
    for section in ("contacts", "tasks"):
        used = {name for phase in spec.phases.values() for name in phase.active(section, getattr(spec, section))}
        for name in getattr(spec, section):
            if name not in used:
                yield (section, name), f"is active in no phase; expected one to name it in its {section}"


def _of_phase(phase: Phase, spec: Spec, left_out: LeftOut) -> Iterator[tuple[KeyPath, str]]:
    for section in ("contacts", "tasks"):
        for i, entry in enumerate(getattr(phase, section) or ()):
            if message := _unknown(entry, spec, section, left_out):
                yield (section, i), message
    contacts, tasks = (phase.active(section, getattr(spec, section)) for section in ("contacts", "tasks"))
    key = "tasks" if phase.tasks is not None else "contacts"
    for task in tasks:
        contact = getattr(spec.tasks[task], "contact", None)
        if contact in spec.contacts and contact not in contacts:
            where = "list the tasks of this phase without it" if phase.tasks is None else "leave it out"
            yield (key,), f"task {task!r} is on contact {contact!r}, which is not active; only active ones: {where}"
    if phase.lost is not None and not any(isinstance(spec.tasks[task], ForceTask) for task in tasks):
        yield ("lost",), "nothing presses in this phase; expected a force task, whose contact can be lost"
    for quantity in phase.until.conditions if phase.until is not None else ():
        if quantity != "time" and (message := _unmeasured(quantity, contacts, tasks, spec, left_out)):
            yield ("until", quantity), message


def _unmeasured(
    quantity: str, contacts: Collection[str], tasks: Collection[str], spec: Spec, left_out: LeftOut
) -> str | None:
    """What is wrong with the name of a measured quantity, of any contact, or of what is active in the phase."""
    subject, _, what = quantity.rpartition(".")
    motions = [name for name, task in spec.tasks.items() if isinstance(task, MotionTask | RelativeTask)]
    known = [f"{name}.{each}" for name in spec.contacts for each in (*WRENCH_AXES, "distance")]
    known += [f"{name}.slip" for name in contacts]
    of_motion = ("done", "error", "singular", "speed")
    known += [f"{name}.{each}" for name in motions if name in tasks for each in of_motion]
    bounded = [name for name, task in spec.tasks.items() if getattr(task, "tank", None) is not None]
    known += [f"{name}.tank" for name in bounded if name in tasks]
    if quantity in known or any((section, subject) in left_out for section in ("contacts", "tasks")):
        return None
    elsewhere = (subject in motions and what in of_motion) or (subject in bounded and what == "tank")
    if elsewhere and subject not in tasks:
        return f"task {subject!r} is not active in this phase; expected one of its own"
    if subject in spec.contacts and subject not in contacts and what == "slip":
        return f"contact {subject!r} is not active in this phase; expected one of its own"
    return f"no such quantity{did_you_mean(quantity, [*known, 'time'])}"
