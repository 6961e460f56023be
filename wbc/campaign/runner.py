"""All seeds of a campaign, each on one of its specs, on as many processes as asked for."""

from __future__ import annotations

import hashlib
import shlex
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from typing import TYPE_CHECKING, Any, NamedTuple

from ..build import Built, build
from ..spec import Spec, load
from .episode import Episode, Failure, Outcome, rounding
from .scenario import scenario

if TYPE_CHECKING:
    Progress = Callable[[int], None]

TWICE = 9  # every so many seeds are run twice, and have to be the same
NEXT_GOOD = 0.999  # share of good ticks after bad ones that have to be accepted
CHUNK = 10  # seeds that a process is given at a time


class Case(NamedTuple):
    """A spec with changes as of `--set`."""

    spec: str
    changes: tuple[str, ...] = ()

    def repeat(self, seed: int) -> str:
        """The command that runs one seed of it."""
        sets = [part for change in self.changes for part in ("--set", change)]
        return shlex.join(["wbc", "campaign", self.spec, *sets, "--seed", str(seed)])

    def load(self) -> Spec:
        return load(self.spec, self.changes)


# arms and walkers, one and several phases, weak motors, a driver that adds gravity, levels that are strict
CASES = (
    Case("eraser"),
    Case("go2_stand"),
    Case("eraser_weak", ("phases.full.until.time=0.05", "phases.weak.until.time=0.08")),
    Case("g1_stand"),
    Case("impedance", ("gravity=robot",)),
    Case("go2_step", ("phases.stand.until.time=0.04", "phases.unload_FL.until.time=0.06")),
    Case("eraser", ("hierarchy=strict", "gravity=robot")),
    Case("door"),
)

_built: dict[Case, Built] = {}


def cases(
    specs: Sequence[str] = (), changes: Sequence[str] = (), solver: str | None = None, hierarchy: str | None = None
) -> tuple[Case, ...]:
    """The specs, or without any the usual cases, with changes as of `--set`."""
    own = tuple(f"{key}={value}" for key, value in (("solver", solver), ("hierarchy", hierarchy)) if value is not None)
    return tuple(
        case._replace(changes=(*case.changes, *changes, *own)) for case in (map(Case, specs) if specs else CASES)
    )


def built_of(case: Case) -> Built:
    if case not in _built:
        _built[case] = build(case.load())
    return _built[case]


def run_one(case: Case, seed: int) -> Outcome:
    """One seed; a controller is built once for each case and process."""
    built = built_of(case)
    made, repeat = scenario(built, seed), case.repeat(seed)
    outcome = Episode(built, made, repeat).run()
    if seed % TWICE or outcome.failure is not None or rounding(built.controller):
        return outcome
    again = Episode(built, made, repeat).run()
    checked = outcome.checked | {"repeated": 1}
    failure = None if again.digest == outcome.digest else Failure("repeated", outcome.ticks, "a second run is another")
    return outcome._replace(failure=failure, checked=checked)


def _work(task: tuple[Case, list[int]]) -> list[tuple[int, Outcome]]:
    case, seeds = task
    return [(seed, run_one(case, seed)) for seed in seeds]


def campaign(
    cases: Sequence[Case] = CASES, seeds: Sequence[int] = range(100), jobs: int = 1, progress: Progress | None = None
) -> dict[str, Any]:
    """Run every seed on one of the cases, in turn. The same answer for any number of `jobs`; `progress` is told the
    number of seeds done. Raises SpecError."""
    for case in dict.fromkeys(cases):
        case.load()  # better said before than by a process
    tasks = list(_tasks(cases, seeds))
    found: dict[int, Outcome] = {}
    for done in _done(tasks, jobs):
        found |= dict(done)
        if progress is not None:
            progress(len(found))
    return _summed(cases, seeds, found)


def case_of(cases: Sequence[Case], seed: int) -> Case:
    return cases[seed % len(cases)]


def _tasks(cases: Sequence[Case], seeds: Sequence[int]) -> Iterator[tuple[Case, list[int]]]:
    """Seeds of one case together: it is built but once."""
    for case in dict.fromkeys(cases):
        own = [seed for seed in seeds if case_of(cases, seed) == case]
        yield from ((case, own[i : i + CHUNK]) for i in range(0, len(own), CHUNK))


def _done(tasks: Sequence[tuple[Case, list[int]]], jobs: int) -> Iterator[list[tuple[int, Outcome]]]:
    if jobs == 1:
        for case, seeds in tasks:
            for seed in seeds:
                yield _work((case, [seed]))
        return
    with ProcessPoolExecutor(jobs, mp_context=get_context("spawn")) as pool:
        yield from pool.map(_work, tasks)


def _summed(cases: Sequence[Case], seeds: Sequence[int], found: dict[int, Outcome]) -> dict[str, Any]:
    checked, faults, digest = Counter[str](), dict[str, Counter[str]](), hashlib.sha256()
    failures, accepted, tried, ticks = list[dict[str, Any]](), 0, 0, 0
    for seed in seeds:
        outcome, case = found[seed], case_of(cases, seed)
        checked.update(outcome.checked)
        digest.update(outcome.digest.encode())
        ticks += outcome.ticks
        accepted, tried = accepted + outcome.next_good[0], tried + outcome.next_good[1]
        for kind, statuses in outcome.faults.items():
            faults.setdefault(kind, Counter()).update(statuses)
        if outcome.failure is not None:
            told = outcome.failure._asdict() | {"spec": case.spec, "set": list(case.changes), "seed": seed}
            failures.append(told | {"repeat": case.repeat(seed)})
    holds = accepted >= NEXT_GOOD * tried
    if not holds:
        shared = f"{accepted} of {tried} good ticks after bad ones were accepted"
        failures.append({"invariant": "recovery", "tick": None, "told": shared, "spec": None, "seed": None})
    return {
        "seeds": len(seeds), "ok": not failures, "ticks": ticks,
        "specs": [[case.spec, *case.changes] for case in cases],
        "failures": failures,
        "next_good": {"accepted": accepted, "of": tried},
        "faults": {kind: sum(faults[kind].values()) for kind in sorted(faults)},
        "statuses": {kind: dict(faults[kind]) for kind in sorted(faults)},
        "invariants": dict(sorted(checked.items())), "digest": digest.hexdigest(),
    }  # fmt: skip
