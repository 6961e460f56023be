"""Every key and scalar of every shipped spec, mutated 8 ways: refused in its place, or a named number changes.

A mutation that is accepted and changes nothing means a key that nobody reads, or a value that is read as another.
`WBC_CAMPAIGN=large` reads them all and runs all that is accepted, on every core. The small one reads a seeded few of
every way at every kind of place (all contacts are one, all tasks of a type), and runs a seeded sample. One mutation:
`WBC_MUTATION=eraser/tasks.press.kp/scaled pytest tests/test_mutations.py`.
"""

from __future__ import annotations

import json
import multiprocessing
import os
import random
import re
import time
import traceback
from collections import Counter
from collections.abc import Iterator, Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np
import pytest

from wbc.errors import SimulationError, SpecError
from wbc.resources import shipped_folder, shipped_names
from wbc.spec import Spec, load, source

# the others need a package that is not always there, and say what these say
SHIPPED = [name for name in shipped_names("tasks", ".yaml") if not load(name).robot.startswith("erd:")]
LARGE = os.environ.get("WBC_CAMPAIGN") == "large"
GAINS = {"kp", "ki", "kd", "damping", "M", "B", "K"}
DEFAULTS = {
    "rate",
    "contacts.handle.free.swing.screw.pitch",
    "tasks.posture.target",
    "limits.torque",
}  # keys shipped at their default
SAMPLE, SAMPLE_WALKER = 25, 10  # accepted mutations of each spec that the small campaign builds and runs
ALIKE = 2  # of mutations of one way at one kind of place, those that the small campaign reads
TICKS = 20
TIMES = (0.0, 0.4, 1.3, 2.9, 5.3)  # [s] at which references are looked at

# what to do about it: what was expected, the nearest name, or advice
REMEDY = re.compile(
    "expected|did you mean|is missing|given twice|choose|lower it|lower kp|only|can change|has no keys|already"
)

Path_ = tuple[str | int, ...]


# --- Mutations of a tree ---------------------------------------------------------------------------------------------


class Pairs(list):
    """A mapping as (key, value) pairs, so that a key can stand there twice."""


class Mutation(NamedTuple):
    spec: str
    path: Path_
    kind: str
    text: str  # the mutated spec

    def __str__(self) -> str:
        return f"{self.spec}/{source.dotted(self.path)}/{self.kind}"


def paired(tree: Any) -> Any:
    if isinstance(tree, dict):
        return Pairs((key, paired(value)) for key, value in tree.items())
    return [paired(each) for each in tree] if isinstance(tree, list) else tree


def emitted(tree: Any, known: Mapping[int, str] = MappingProxyType({}), depth: int = 0) -> str:
    """YAML with a line for each entry of the two upper levels; `known` are the texts of parts, by their id."""
    if (text := known.get(id(tree))) is not None:
        return text
    if isinstance(tree, Pairs):
        entries = [f"{json.dumps(key, ensure_ascii=False)}: {emitted(value, known, depth + 1)}" for key, value in tree]
        return "{" + ",".join(("\n" + "  " * depth if depth < 2 else " ") + entry for entry in entries) + "}"
    if isinstance(tree, list):
        return "[" + ", ".join(emitted(each, known, 9) for each in tree) + "]"
    if isinstance(tree, float) and not np.isfinite(tree):
        return ".nan" if tree != tree else ".inf"
    return json.dumps(tree, ensure_ascii=False)


def parts(tree: Any, depth: int = 0) -> Iterator[tuple[int, str]]:
    """Id and text of each mapping and list of the two upper levels: a mutation leaves most of them as they are."""
    for _, value in tree if isinstance(tree, Pairs) else ():
        if isinstance(value, list):
            yield id(value), emitted(value, depth=depth + 1)
            yield from parts(value, depth + 1) if depth < 1 else ()


def places(tree: Any, path: Path_ = ()) -> Iterator[tuple[Path_, Any, bool]]:
    """(path, value, whether it is the value of a key) of every key and list entry."""
    if isinstance(tree, Pairs):
        for key, value in tree:
            yield (*path, key), value, True
            yield from places(value, (*path, key))
    elif isinstance(tree, list):
        for i, value in enumerate(tree):
            yield (*path, i), value, False
            yield from places(value, (*path, i))


def of_key(pairs: Pairs, at: int) -> Iterator[tuple[str, Pairs]]:
    """A mapping with its entry `at` mutated 8 ways."""
    key, value = pairs[at]
    before, after = pairs[:at], pairs[at + 1 :]
    middle = len(key) // 2
    entries: dict[str, list[tuple[Any, Any]]] = {
        "deleted": [],
        "misspelt": [(key[:middle] + key[middle + 1 :] if len(key) > 2 else key + "q", value)],
        "twice": [(key, value), (key, value)],
        "near": [(key, value), (key + "2", value)],
        "upper": [(key.upper(), value)],
        "empty": [("", value)],
        "nested": [(key, Pairs([(key, value)]))],
    }
    for kind, entry in entries.items():
        yield kind, Pairs([*before, *entry, *after])
    if len(pairs) > 1:  # its value and the next one's change places
        other = (at + 1) % len(pairs)
        swapped = Pairs(pairs)
        swapped[at], swapped[other] = (key, pairs[other][1]), (pairs[other][0], value)
        yield "swapped", swapped


def of_scalar(value: Any) -> Iterator[tuple[str, Any]]:
    """A scalar mutated 8 ways."""
    number = isinstance(value, int | float)
    yield "type", ("x" if number else 5)
    yield "null", None
    yield "nan", float("nan")
    yield "negative", (-value or -1) if number else "-" + value
    yield "zero", 0 if not number or value else 1
    yield "scaled", (value * 1.5 or 1.5) if number else value + "x"
    yield "listed", [value]
    yield "huge", 1e9


def replaced(tree: Any, path: Path_, new: Any) -> Any:
    if not path:
        return new
    if isinstance(tree, Pairs):
        return Pairs((key, replaced(value, path[1:], new) if key == path[0] else value) for key, value in tree)
    return [replaced(value, path[1:], new) if i == path[0] else value for i, value in enumerate(tree)]


def inner(tree: Any, path: Path_) -> Any:
    for part in path:
        tree = dict(tree)[part] if isinstance(tree, Pairs) else tree[part]
    return tree


def mutations(name: str) -> Iterator[Mutation]:
    text = (shipped_folder("tasks") / f"{name}.yaml").read_text()
    tree = paired(source.parse(text, name).whole().tree)
    known = dict(parts(tree))
    for path, value, keyed in places(tree):
        if keyed:
            above = inner(tree, path[:-1])
            at = [key for key, _ in above].index(path[-1])
            for kind, changed in of_key(above, at):
                if changed != above:
                    yield Mutation(name, path, kind, emitted(replaced(tree, path[:-1], changed), known))
        if not isinstance(value, list):
            for kind, new in of_scalar(value):
                yield Mutation(name, path, kind, emitted(replaced(tree, path, new), known))


def place_kind(tree: Any, path: Path_) -> Path_:
    """A path without what its author was free to choose: names, but for the type of a task, and positions."""
    kind: list[str | int] = [0 if isinstance(part, int) else part for part in path]
    if len(path) > 1 and path[0] in ("references", "contacts", "tasks", "phases"):
        kind[1] = dict(inner(tree, path[:2])).get("type", "") if path[0] == "tasks" else ""
    elif path[0] == "expect" and len(path) > 1:
        kind[1] = str(path[1]).partition(".")[2] or path[1]
    return tuple(kind)


def few_alike(name: str, every: list[Mutation]) -> list[Mutation]:
    """A seeded sample: of mutations of one way at one kind of place, `ALIKE`."""
    tree = paired(source.parse((shipped_folder("tasks") / f"{name}.yaml").read_text(), name).whole().tree)
    shuffled = random.Random(name).sample(every, len(every))
    seen = Counter[Any]()
    kept = set[int]()
    for mutation in shuffled:
        seen[kind := (place_kind(tree, mutation.path), mutation.kind)] += 1
        if seen[kind] <= ALIKE:
            kept.add(id(mutation))
    return [mutation for mutation in every if id(mutation) in kept]


# --- Named numbers, from what was built and what was run, never from the spec ----------------------------------------


def fingerprint(spec: Spec, robots: dict[Any, Any]) -> dict[str, Any]:
    from wbc.build import build
    from wbc.run import run

    files = (spec.robot, spec.tool, spec.scene, spec.gravity)
    built = build(spec, robots.get(files))
    robots[files] = built.robot
    found: dict[str, Any] = {"dt": built.controller.dt, "start": built.q, "margins": built.damping_margins}
    found["poles"], found["masses"] = ([repr(each) for each in every] for every in (built.poles, built.masses))
    for i, phase in enumerate(built.phases):
        for name, value in of_phase(built, phase):
            found[f"phase {i}.{name}"] = value

    def enough(seen: Any, out: Any) -> None:
        if seen.t >= (TICKS - 1.5) * built.controller.dt:
            raise SimulationError("enough", seen.t)

    result = run(built, seed=1, hook=enough)
    log = result.log
    found |= {f"log.{name}": log[name] for name in log.names if name != "step_us"}
    found |= {f"meta.{name}": value for name, value in log.meta.items()} | {"ticks": log.ticks}
    found |= {f"summary.{name}": result.summary[name] for name in ("metrics", "checks", "status", "notes")}
    return {name: np.asarray(value).tolist() for name, value in found.items()}


def of_phase(built: Any, phase: Any) -> Iterator[tuple[str, Any]]:
    state = built.robot.state(built.q, np.full(built.robot.nv, 0.1))
    yield "name", phase.name
    if (way := phase.exit) is not None:
        yield "until", repr([(c.name, c.low, c.high, c.duration) for c in way.until])
        yield "ways", repr((way.then, way.timeout, way.otherwise, way.lost))
    yield "torque", (phase.torque.low, phase.torque.high, phase.torque.rate)
    if phase.joint is not None:
        for share in (0.0, 0.5, 0.9, 0.999):
            q = built.q.copy()
            q[-built.robot.nu :] += share * (built.robot.q_max - q[-built.robot.nu :])
            yield f"viable {share}", phase.joint.viable_speed(q)
    for name, contact in phase.contacts.items():
        yield f"{name}.A", contact.A(state)
        yield f"{name}.axes", contact.axes
        if (pushes := contact.pushes) is not None:
            yield f"{name}.cone", contact.hold(state).cone.rows
            yield f"{name}.push", (*pushes.d, pushes.least, pushes.mu, pushes.slip, pushes.modelled)
        yield f"{name}.settling", contact.settling or ()
        yield f"{name}.feedforward", contact.feedforward
        yield f"{name}.frame", (state.frame(contact.frame).T.homogeneous, contact.seen(state).T.homogeneous)
    for name, task in phase.tasks.items():
        yield f"{name}.weight", phase.weights[name]
        for gain in ("Kp", "Ki", "Kd", "K_damp", "M", "B", "K", "split", "source", "printed", "gravity_only"):
            if hasattr(task, gain):
                yield f"{name}.{gain}", getattr(task, gain)
        if hasattr(task, "reference"):
            for t in TIMES:
                sample = task.reference(t)
                yield f"{name}({t})", (*sample.T.homogeneous.ravel(), *sample.motion.ravel())
        if hasattr(task, "smoothing"):
            yield f"{name}.smoothing", task.smoothing(built.controller.dt)
            yield f"{name}.integral_limit", task.integral_limit
            for t in TIMES:
                yield f"{name}({t})", task.target(t)
        if hasattr(task, "shares"):
            yield f"{name}.shares", sorted(task.shares.items())
            yield f"{name}.press", sorted(task.press.items())
        if hasattr(task, "q"):
            yield f"{name}.q", task.q


# --- The campaign ----------------------------------------------------------------------------------------------------


class Outcome(NamedTuple):
    mutation: Mutation
    verdict: str  # refused (by the spec), refused by the build, changed, default; everything else is a failure
    detail: str = ""


class Judge:
    """Holds mutations of one spec against the original; writes them to one file, for the name shows in the figures."""

    def __init__(self, name: str, folder: Path) -> None:
        self.name, self.file, self.robots = name, folder / f"{name}.yaml", dict[Any, Any]()
        self.plain = load(name).model_dump()
        self._original: str | None = None

    def original(self) -> str:
        if self._original is None:
            self.file.write_text((shipped_folder("tasks") / f"{self.name}.yaml").read_text())
            self._original = repr(fingerprint(load(self.file), self.robots))
        return self._original

    def judged(self, mutation: Mutation, build: bool) -> Outcome:
        begun = time.thread_time()
        original = self.original() if build else ""
        self.file.write_text(mutation.text)
        begun, stage = time.thread_time(), "refused"
        try:
            spec = load(self.file)
            if mutation.kind == "deleted" and spec.model_dump() == self.plain:
                return Outcome(mutation, "default")
            if not build:
                return Outcome(mutation, "accepted")
            stage = "refused by the build"
            changed = repr(fingerprint(spec, self.robots)) != original
            # over a single axis a number and a list of it are one gain; over more axes the list is refused
            single = mutation.kind == "listed" and mutation.path[-1] in GAINS
            outcome = Outcome(mutation, "changed" if changed else "default" if single else "UNCHANGED")
        except SpecError as error:
            outcome = Outcome(mutation, stage, str(error))
            if not error.faults or not all(fault.line and fault.column for fault in error.faults):
                outcome = Outcome(mutation, "NO PLACE", str(error))
            elif not all(REMEDY.search(fault.message) for fault in error.faults):
                outcome = Outcome(mutation, "NO REMEDY", str(error))
        except Exception:
            outcome = Outcome(mutation, "ESCAPED", traceback.format_exc())
        if time.thread_time() - begun > 1.0:
            outcome = Outcome(mutation, "SLOW", f"{time.thread_time() - begun:.1f} s, {outcome.verdict}")
        return outcome


_judge: Judge | None = None


def _work(item: tuple[Mutation, str]) -> Outcome:
    global _judge
    mutation, folder = item
    if _judge is None or _judge.name != mutation.spec:
        own = Path(folder) / str(os.getpid())
        own.mkdir(exist_ok=True)
        _judge = Judge(mutation.spec, own)
    return _judge.judged(mutation, build=True)


@pytest.mark.slow
@pytest.mark.timeout(3600 if LARGE else 300)
@pytest.mark.parametrize("name", SHIPPED)
def test_every_mutation_is_refused_or_changes_a_number(name: str, tmp_path: Path) -> None:
    if wanted := os.environ.get("WBC_MUTATION"):
        every = [mutation for mutation in mutations(name) if str(mutation) == wanted]
    else:
        every = list(mutations(name))
        assert len({str(mutation) for mutation in every}) == len(every) > 500
        every = every if LARGE else few_alike(name, every)
    judge = Judge(name, tmp_path)
    outcomes = [judge.judged(mutation, build=False) for mutation in every]
    accepted = [outcome.mutation for outcome in outcomes if outcome.verdict == "accepted"]
    outcomes = [outcome for outcome in outcomes if outcome.verdict != "accepted"]
    if LARGE:
        with multiprocessing.get_context("spawn").Pool() as pool:
            outcomes += pool.imap_unordered(_work, [(mutation, str(tmp_path)) for mutation in accepted], chunksize=4)
    else:
        count = SAMPLE_WALKER if name.startswith(("g1", "go2", "panda_dual")) else SAMPLE  # they take longer
        sample = accepted if wanted else random.Random(name).sample(accepted, count)
        outcomes += [judge.judged(mutation, build=True) for mutation in sample]
    print(name, len(every), dict(Counter(outcome.verdict for outcome in outcomes)))
    failed = [outcome for outcome in outcomes if outcome.verdict.isupper()]
    told = [
        f"WBC_MUTATION={outcome.mutation} pytest tests/test_mutations.py  # {outcome.verdict} {outcome.detail}"
        for outcome in failed
    ]
    assert not failed, "\n".join([f"{len(failed)} of {len(outcomes)}; each repeats with:", *told])
    defaults = {source.dotted(outcome.mutation.path) for outcome in outcomes if outcome.verdict == "default"}
    assert {
        name for name in defaults if name.rsplit(".", 1)[-1] not in GAINS
    } <= DEFAULTS  # what is deleted there is what is assumed there: the same spec
    if not wanted:
        found, kinds = (
            {outcome.verdict for outcome in outcomes},
            {"refused", "refused by the build", "changed", "default"},
        )
        assert found == kinds if LARGE else {"refused", "changed"} <= found <= kinds  # a sample may miss the others


def test_the_campaign_sees_an_unread_key(tmp_path: Path) -> None:
    """What it is worth: the same spec in other words is told as unchanged."""
    judge = Judge("planar", tmp_path)
    text = (shipped_folder("tasks") / "planar.yaml").read_text().replace("kp: 100,", "kp: 1.0e2, weight: 1,")
    assert judge.judged(Mutation("planar", ("tasks",), "reworded", text), build=True).verdict == "UNCHANGED"
    text = text.replace("1.0e2", "100.0000001")
    assert judge.judged(Mutation("planar", ("tasks",), "reworded", text), build=True).verdict == "changed"
