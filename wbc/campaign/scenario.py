"""What a seed means: the errors of the plant, the targets, and all that goes wrong, of one episode of a spec."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from ..feeling import SENSOR
from ..outside import has_site
from ..spec.fault import KINDS
from ..spec.limit import Noise, Plant
from ..spec.push import Push
from .arguments import ARGUMENTS

if TYPE_CHECKING:
    from ..build import Built

TICKS = 180  # of an episode
CALM = 20  # ticks at its end in which nothing new begins
EVER = 0.04  # share of faults that stay for ever
ENDING = ("simulator.nan", "simulator.reset")  # after these there is nothing left to control
_APPLIED = ("", "sent", "off")  # what the caller says of the torque that was applied


class Target(NamedTuple):
    """A target that the caller sets at a tick."""

    tick: int
    name: str
    value: float


class Scenario(NamedTuple):
    """An episode: the same for ever for a seed and a spec.

    `clock` [s]: what the caller's clock shows at the start; `faults`: lines of a fault plan; `calls`: ticks at which
    the caller gives what no tick takes, and of which kind; `patience`: ticks in a safe hold until somebody resets;
    `applied`: what `tau_applied` says: nothing, what was sent, or that and an error; `norm`: of the caller's
    quaternions, negative for the other sign.
    """

    seed: int
    ticks: int
    plant: Plant
    clock: float
    targets: tuple[Target, ...]
    faults: tuple[str, ...]
    calls: tuple[tuple[int, str], ...]
    patience: int
    applied: str
    norm: float


def scenario(built: Built, seed: int) -> Scenario:
    """The episode of a seed."""
    rng = np.random.default_rng([seed, 0xCA])
    ticks, mass = TICKS, _mass(built)
    noise = Noise(force=_of(rng, 0.5), moment=_of(rng, 0.01), position=_of(rng, 1e-5), velocity=_of(rng, 1e-3))
    plant = Plant(
        mass_error=float(rng.uniform(-0.05, 0.05)),
        joint_friction=_of(rng, 0.3),
        delay=int(rng.integers(0, 3)),
        noise=noise,
        pushes=_pushes(rng, built, ticks * built.controller.dt, mass),
    )
    faults, calls = _faults(rng, built, ticks), _calls(rng, ticks)
    return Scenario(
        seed, ticks, plant, float(rng.choice((0.0, 0.0, -3.0, 1e3, 1e5))), _targets(rng, built, ticks), faults, calls,
        int(rng.integers(1, 25)), _APPLIED[int(rng.choice(3, p=(0.6, 0.2, 0.2)))],
        float(rng.choice((1.0, 1.0, -1.0, 1.0 + 9e-4, 1.0 - 9e-4, 1.0 + 1e-9))),
    )  # fmt: skip


def _of(rng: np.random.Generator, most: float) -> float:
    """Nothing, half of the time."""
    return float(rng.uniform(0.0, most)) if rng.random() < 0.5 else 0.0


def _mass(built: Built) -> float:
    return float(sum(inertia.mass for inertia in built.robot.model.inertias))


def _pushes(rng: np.random.Generator, built: Built, duration: float, mass: float) -> dict[str, Any]:
    """At most one, at a frame that the spec names, of at most a tenth of the weight or 15 N."""
    model = built.robot.mujoco
    bodies = {model.body(i).name for i in range(model.nbody)}
    frames = dict.fromkeys(name for phase in built.phases for name in phase.frames)
    known = [name for name in frames if name in bodies or has_site(model, name)]
    if not known or rng.random() < 0.5:
        return {}
    most, start = min(15.0, mass), float(rng.uniform(0.0, 0.7 * duration))
    values = rng.uniform(-most, most, 3)
    wrench = dict(zip(("fx", "fy", "fz"), map(float, values), strict=True))
    times = {"from": start, "to": start + float(rng.uniform(0.005, 0.1))}
    return {"hand": Push(frame=str(rng.choice(known)), wrench=wrench, **times)}  # type: ignore[arg-type]


def _targets(rng: np.random.Generator, built: Built, ticks: int) -> tuple[Target, ...]:
    """Targets of force axes: a few newtons, pushing where the contact only pushes."""
    axes = [(n, a) for p in built.phases for n, c in p.contacts.items() for a in c.axes if a[:1] in ("m", "f")]
    found = []
    for _ in range(int(rng.integers(0, 4)) if axes else 0):
        name, axis = axes[int(rng.integers(len(axes)))]
        size = 0.5 if axis.startswith("m") else 20.0
        found.append(Target(int(rng.integers(1, ticks)), f"{name}.{axis}", float(rng.uniform(-size, size))))
    return tuple(sorted(found))


def _faults(rng: np.random.Generator, built: Built, ticks: int) -> tuple[str, ...]:
    """Lines of a plan: a few faults of any kind, most of them short; of sensors where there is one."""
    senses = SENSOR in built.robot.frames and any(phase.feeling for phase in built.phases)
    kinds = [kind for kind in KINDS if kind not in ENDING and (senses or not kind.startswith("sensor."))]
    lines = []
    for _ in range(int(rng.integers(1, 8))):
        kind = kinds[int(rng.integers(len(kinds)))]
        start, spans = int(rng.integers(1, ticks - CALM)), (1, int(rng.integers(2, 7)), int(rng.integers(7, 40)))
        span = spans[int(rng.choice(3, p=(0.5, 0.35, 0.15)))]
        lasts = "ever" if rng.random() < EVER else f"{min(span, ticks - CALM - start)} ticks"
        value = _value(rng, kind)
        lines.append(f"{kind}{value} at tick {start} for {lasts}")
    if rng.random() < 0.05:
        lines.append(f"{ENDING[int(rng.integers(2))]} at tick {ticks - int(rng.integers(1, CALM))}")
    return tuple(lines)


def _value(rng: np.random.Generator, kind: str) -> str:
    """Some other value than its own, where it takes one."""
    own = KINDS[kind].value
    if own is None or rng.random() < 0.3:
        return ""
    special: dict[str, Sequence[float]] = {
        "simulator.missed": (1.0, 2.0, 3.0, 5.0, 19.0, 20.0, 30.0),
        "state.quaternion": (1.0 + 1e-6, 1.0 - 9e-4, 1.0 + 9e-4, 1.002, 0.99, 0.5, 1e-9, 0.0, -1.0),
        "state.time": (-1.0, -0.01, -0.001, 1e-9, 0.001, 0.0015, 0.05, 5.0),
        "solver.leans": (1e-6, 1e-3, 0.1, 10.0),
        "solver.x": (1e-7, 1e-4, 1e-2, 1.0, 1e3, -1.0),
    }
    choice = special.get(kind) or (0.1 * own, 3.0 * own, -own, -10.0 * own)
    if kind == "sensor.saturation":
        choice = (0.0, 0.5, 50.0)
    return f" {choice[int(rng.integers(len(choice)))]!r}"


def _calls(rng: np.random.Generator, ticks: int) -> tuple[tuple[int, str], ...]:
    """What the caller gets wrong, at ticks of their own."""
    kinds = list(ARGUMENTS)
    at = rng.choice(np.arange(1, ticks), int(rng.integers(2, 9)), replace=False)
    return tuple((int(tick), kinds[int(rng.integers(len(kinds)))]) for tick in np.sort(at))
