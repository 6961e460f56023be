"""The tank of a task is never below zero, and never promises more than is truly there.

The truth is kept by whoever moves the masses: the force that really acted, times the way really gone. A thousand seeds
of masses in one dimension with answers 1 to 20 ms late; `WBC_CAMPAIGN=large` runs as many through the controller and
MuJoCo; `WBC_SEED` picks one.
"""

from __future__ import annotations

import os
from array import array
from functools import partial

import bars
import numpy as np
import pytest
import runs
from air import pressing

from wbc.build import build
from wbc.dynamics import mobility
from wbc.errors import GainError, SpecError
from wbc.replay import Replay
from wbc.run import run
from wbc.spec import load
from wbc.tank import Bounded, pressed
from wbc.tape import CODEC

pytestmark = pytest.mark.row(15)

LARGE = os.environ.get("WBC_CAMPAIGN") == "large"
SEEDS = [int(os.environ["WBC_SEED"])] if "WBC_SEED" in os.environ else range(1000)
DT, TICKS, LATE = 1e-3, 400 if LARGE else 250, 20


class Story:
    """What a run of one seed keeps: energy in the tank, and what is truly left of it [J]."""

    def __init__(self):
        self.energy, self.left, self.limited = [], [], 0

    def tick(self, tank, left):
        self.energy.append(tank.energy)
        self.left.append(left)
        self.limited += tank.limited

    @property
    def low(self):
        return min(self.energy)

    @property
    def promised(self):
        """How much more was promised than was there."""
        return float(np.max(np.subtract(self.energy, self.left)))


def stiffness(rng, K, x, v, adverse):
    """A course of the stiffness: at random, or such that it pumps: stiff on the way back, soft on the way out."""
    if adverse:
        return K * (6.0 if x * v < 0.0 else 0.2)
    return K * rng.uniform(0.0, 6.0)


def spring(seed, bounded=None, law=Bounded.comply):
    """A mass on a spring that changes and a damper, whose force acts late; someone pushes, now and then a wall."""
    rng = np.random.default_rng([seed, 1])
    delay, m, K = int(rng.integers(1, LATE + 1)), rng.uniform(1.0, 5.0), rng.uniform(50.0, 400.0)
    B, adverse, wall = rng.uniform(0.05, 0.5) * m / (LATE * DT), seed % 2, rng.uniform(0.02, 0.1)
    bounded = bounded or Bounded(rng.uniform(0.1, 2.0), ticks=LATE)
    x, v = rng.uniform(-0.1, wall), 0.0
    push, wanted, late, tank, story = 0.0, K, [0.0] * delay, None, Story()
    begin = bounded.energy + 0.5 * K * x * x
    for tick in range(TICKS):
        if tick and (adverse or rng.random() < 0.02):
            wanted = stiffness(rng, K, x, v, adverse)
        if rng.random() < 0.01:
            push = rng.uniform(-20.0, 20.0)
        given = [np.array(each) for each in ([-x], [-v], [[wanted]], [[B]], [[m]])]
        tank = law(bounded, tank, *given, None, np.array([DT * v]), DT, True)
        story.tick(tank, begin - 0.5 * float(tank.K[0, 0]) * x * x)
        late.append(float(tank.K[0, 0]) * -x - (B + m * tank.brake) * v)
        f = late.pop(0)
        v += DT / m * (f + push - max(2e4 * (x - wall) + 100.0 * v, 0.0) * (x > wall))
        x += DT * v
        begin -= f * DT * v
    return story


def press(seed, bounded=None, law=Bounded.press):
    """A force on a mass that meets a wall which gives way, goes and comes back, by an answer that is late."""
    rng = np.random.default_rng([seed, 2])
    delay, m, target = int(rng.integers(1, LATE + 1)), rng.uniform(2.0, 6.0), rng.uniform(5.0, 30.0)
    D, kp, k = rng.uniform(0.0, 0.4) * m / (LATE * DT), rng.uniform(0.0, 0.3), 10.0 ** rng.uniform(3.0, 4.5)
    bounded = bounded or Bounded(rng.uniform(0.05, 1.0), ticks=LATE)
    x, v, wall, away = 0.0, 0.0, rng.uniform(0.0, 0.01), 0.0
    late, felt, tank, story, left = [0.0] * delay, [0.0] * delay, None, Story(), bounded.energy
    for _ in range(TICKS):
        if rng.random() < 0.01:
            wall, away = x + rng.uniform(-1e-3, 0.05), rng.choice([0.0, 0.0, 0.3])
        wall += DT * away
        driven = np.array([target + kp * (target - felt[0])])
        tank = law(bounded, tank, driven, np.array([v]), np.array([[1.0 / m]]), DT)
        story.tick(tank, left)
        lam = tank.valve * driven - D * v
        tank = pressed(tank, lam)
        late.append(float(lam[0]))
        f, contact = late.pop(0), max(k * (x - wall) + 50.0 * v, 0.0) if x > wall else 0.0
        v += DT / m * (f - contact)
        x += DT * v
        left -= f * DT * v
        felt = [*felt[1:], contact]
    return story


def follow(seed, bounded=None, law=Bounded.comply, ticks=TICKS):
    """A mass that an admittance moves by a wrench that is late; an arm follows it late, and a hand holds the arm."""
    rng = np.random.default_rng([seed, 3])
    delay, M, K = int(rng.integers(1, LATE + 1)), rng.uniform(1.0, 5.0), rng.uniform(0.0, 300.0)
    B, hand, adverse = rng.uniform(0.05, 1.0) * np.sqrt(200.0 * M), 10.0 ** rng.uniform(1.0, 3.0), seed % 2
    bounded = bounded or Bounded(rng.uniform(0.1, 2.0), ticks=LATE)
    kd = min(100.0, 0.4 / (delay * DT))
    got = [0.0] * (delay - 1)  # by the push, what is not yet measured
    x = v = at = speed = goal = pace = 0.0  # the mass, the arm, and where the hand wants it
    wanted, felt, asked, tank, story, left = K, [0.0] * delay, [0.0] * delay, None, Story(), bounded.energy
    for tick in range(ticks):
        if tick and (adverse or rng.random() < 0.02):
            wanted = stiffness(rng, K, x, v, adverse)
        if rng.random() < 0.02:
            pace = rng.uniform(-0.5, 0.5)
        goal += DT * pace
        push, move = np.array([felt[0]]), np.array([DT * speed])
        given = [np.array(each) for each in ([-x], [-v], [[wanted]], [[B]], [[M]])]
        tank = law(bounded, tank, *given, push, move, DT, False, 4.0 / kd)
        stored = 0.5 * M * v * v + 0.5 * float(tank.K[0, 0]) * x * x
        story.tick(tank, left - stored)
        v += DT / M * (tank.valve * felt[0] - float(tank.K[0, 0]) * x - B * v) - DT * tank.brake * v
        x += DT * v
        asked.append(kd * (0.25 * kd * (x - at) + v - speed))
        speed += DT * asked.pop(0)
        f = np.clip(hand * (goal - at), -40.0, 40.0)
        at += DT * speed
        got.append(f * DT * speed)
        left += got.pop(0)
        felt = [*felt[1:], f]
    return story


MODELS = {"spring": spring, "press": press, "follow": follow}


@pytest.mark.parametrize("model", MODELS)
def test_never_below_zero_nor_more_than_there_is(model, record_property, tell):
    """On 1000 seeds, a third of them a model, with 1 to 20 ms of delay; the sum against the true one at every tick."""
    lowest, promised, limited, wrong = np.inf, -np.inf, 0, []
    share = SEEDS if LARGE or len(SEEDS) == 1 else SEEDS[list(MODELS).index(model) :: len(MODELS)]
    for seed in share:
        story = MODELS[model](seed)
        lowest, promised = min(lowest, story.low), max(promised, story.promised)
        limited += story.limited > 0
        if not (story.low >= bars.TANK and story.promised <= 1e-9):
            wrong.append(f"WBC_SEED={seed} pytest tests/test_tank.py -k {model}  # {story.low:g}, {story.promised:g} J")
    record_property(f"{model}: seeds that it bounds", f"{limited} of {len(share)}")
    tell(f"{model}: energy [J]", lowest, least=bars.TANK, why="\n".join(wrong[:20]))
    tell(f"{model}: promised beyond the truth [J]", promised, most=1e-9, why="\n".join(wrong[:20]))


def unpaid(bounded, tank, x, V, wanted, *given):
    """Stiffness that acts at once, whatever it costs."""
    tank = Bounded.comply(bounded, tank, x, V, wanted, *given)
    return tank._replace(K=wanted, brake=0.0, valve=1.0)


def open_valve(bounded, tank, *given):
    return Bounded.press(bounded, tank, *given)._replace(valve=1.0)


@pytest.mark.parametrize(
    ("model", "law"), [(spring, unpaid), (press, open_valve), (partial(follow, ticks=400), unpaid)]
)
def test_without_its_valve_a_tank_is_overdrawn(model, law):
    """The control: the thousand runs ask for more than there is, and the sum says so."""
    stories = [model(seed, law=law) for seed in range(20)]
    assert min(story.left[-1] for story in stories) < -0.05


@pytest.mark.parametrize("model", MODELS)
def test_a_tank_that_knows_of_no_delay_promises_too_much(model):
    """The control: the sums of the other delays are what makes it true."""
    assert max(MODELS[model](seed, Bounded(1.0, ticks=0)).promised for seed in range(40)) > 1e-3


def test_what_is_constant_costs_nothing():
    """A spring that stays as it is, and a damper: the tank is full at the end, and has let all of it pass."""
    bounded, tank, x, v, K, M = Bounded(1.0), None, 0.1, 0.0, np.array([[300.0]]), np.eye(1)
    for _ in range(3000):
        tank = bounded.comply(tank, np.array([-x]), np.array([-v]), K, 20.0 * M, M, None, np.zeros(1), DT, True)
        assert tank.K is K
        assert not tank.limited
        v += DT * (-300.0 * x - 20.0 * v)
        x += DT * v
    assert tank.energy == pytest.approx(1.0, abs=1e-6)


def test_stiffness_is_paid_to_the_last_bit():
    """At rest, bent by 0.1 m: 300 N/m more cost 1.5 J, of which 0.9 J can be paid; softer gives all of it back."""
    bounded, x, still, M = Bounded(1.0, 2.0), np.array([0.1]), np.zeros(1), np.eye(1)

    def step(tank, K):
        return bounded.comply(tank, x, still, np.array([[K]]), M, M, None, still, 0.0, True)

    tank = step(None, 100.0)
    stiffer = step(tank, 400.0)
    assert stiffer.limited
    assert stiffer.energy == pytest.approx(0.1)
    assert stiffer.K[0, 0] == pytest.approx(280.0)
    softer = step(stiffer, 100.0)
    assert (softer.energy, softer.limited) == (pytest.approx(1.0), False)


@pytest.mark.parametrize("given", [(0.0,), (-1.0,), (1.0, 0.5), (1.0, 2.0, -1), (float("nan"),), (1.0, float("inf"))])
def test_a_tank_that_is_none_is_refused(given):
    with pytest.raises(GainError, match="tank: expected an energy above 0"):
        Bounded(*given)


# --- in the controller ---

PUMP = """
title: A spring that changes twice as fast as it swings
robot: panda
tool: handle
rate: 1000
duration: {duration}
references:
  start: {{hold: {{}}}}
  pump: {{profile: {{values: {values}, times: {times}}}}}
tasks:
  feel:    {{type: {kind}, frame: tip, axes: [vx, vy, vz], error: split, K_scale: pump{tank}}}
  upright: {{type: motion, frame: tip, axes: [wx, wy, wz], target: start, kp: 400, kd: 40}}
  posture: {{type: posture, target: start, kp: 50, kd: 10}}
limits: {{torque: model, torque_rate: 1000, position: model, velocity: model}}
plant: {{delay: {delay}, pushes: {{hand: {{frame: tip, wrench: {{fx: {fx}, fz: {fz}}}, to: 0.3}}}}}}
"""
KINDS = {
    "impedance": "impedance, M: 3, B: 10, K: 100",
    "massless": "impedance, M: 0, B: 10, K: 100",
    "admittance": "admittance, M: 3, B: 10, K: 100, kp: 400, kd: 40",
    "hardly damped": "impedance, M: 3, B: 2, K: 200",
}


def pumped(folder, seed, kind, tank=True, duration=1.2, masses=None):
    """A run of the controller whose spring is pumped, with 1 to 20 ticks of delay; `masses` is given the pose and the
    twist of the mass that an admittance moves, by ticks."""
    rng = np.random.default_rng([seed, 5])
    delay = int(rng.integers(1, LATE + 1)) if tank else 0
    times = [round(0.122 * i, 3) for i in range(12)]
    values = {
        "values": [(4.0 if i % 2 else 1.0) for i in range(12)], "times": times, "kind": KINDS[kind], "delay": delay,
        "tank": f", tank: {{energy: {rng.uniform(0.05, 0.5):.3f}, delay: 0.02}}" if tank else "",
        "fx": round(rng.uniform(-8, 8), 3), "fz": round(rng.uniform(-8, 8), 3), "duration": duration,
    }  # fmt: skip
    path = folder / "pump.yaml"
    path.write_text(PUMP.format(**values))
    built = build(load(path))

    def keep(seen, out):
        felt = built.controller.memory.felt["feel"]
        if masses is not None and felt.T is not None:
            masses.append((felt.T.copy(), felt.motion[:, 0].copy()))

    return run(built, hook=keep, seed=seed), built


def balance(result, built, masses=()):
    """(N,) [J] what truly is left: what was there and was pushed in, less what moves and what is bent."""
    log, task = result.log, built.phases[0].tasks["feel"]
    x, v, f = (log[f"feel.{name}"] for name in ("displacement", "rate", "external"))
    given = np.concatenate(([0.0], np.cumsum((f[:-1] * np.diff(x, axis=0)).sum(axis=1))))
    if masses:  # it bends the spring; the arm, which is pushed, comes after it
        T, V = map(np.array, zip(*masses, strict=True))
        x, v = np.einsum("tji,tj->ti", T[:, :3, :3], T[:, :3, 3] - T[0, :3, 3]), V[:, 3:]
    K = log["feel.stiffness"] if "feel.stiffness" in log else np.array([task.K_scale(t)[0] * task.K for t in log["t"]])
    M = task.M if task.M.any() else np.linalg.inv(log["feel.mobility"])
    stored = 0.5 * np.einsum("ti,...ij,tj->t", x, K, x) if K.ndim == 2 else 0.5 * np.einsum("ti,tij,tj->t", x, K, x)
    moving = 0.5 * (np.einsum("ti,tij,tj->t", v, M, v) if M.ndim == 3 else np.einsum("ti,ij,tj->t", v, M, v))
    return (task.tank.energy if task.tank is not None else 0.0) + given - stored - moving


@pytest.mark.timeout(3600 if LARGE else 300)
@pytest.mark.parametrize("kind", list(KINDS)[:3])
def test_the_controllers_tank_is_never_below_zero(tmp_path, kind, tell):
    """Through the controller and MuJoCo, against the true pushes and the true way of the hand."""
    seeds = SEEDS if LARGE or len(SEEDS) == 1 else range(1)
    lowest, left, wrong = np.inf, np.inf, []
    for seed in seeds:
        masses = []
        result, built = pumped(tmp_path, seed, kind, masses=masses)
        low, true = float(result.log["feel.tank"].min()), float(balance(result, built, masses).min())
        lowest, left = min(lowest, low), min(left, true)
        if not (low >= bars.TANK and true >= -1e-3 and result.summary["status"].keys() <= {"OK", "LIMITED"}):
            wrong.append(
                f"WBC_SEED={seed} pytest tests/test_tank.py -k 'controllers and {kind}'  # {low:g}, {true:g} J"
            )
    tell(f"{kind} in MuJoCo: energy [J]", lowest, least=bars.TANK, why="\n".join(wrong))
    tell(f"{kind} in MuJoCo: truly left [J]", left, least=-1e-3, why="\n".join(wrong))
    assert not wrong, "\n".join(wrong)


def test_without_a_tank_the_spring_brings_energy_in(tmp_path):
    """The control: what moves and is bent at the end was never given."""
    assert balance(*pumped(tmp_path, 0, "hardly damped", tank=False)).min() < -0.2


def test_a_full_tank_changes_no_bit():
    for name, task in (("eraser", "press"), ("impedance", "feel"), ("admittance", "feel"), ("force_pi", "press")):
        plain = runs.result(name, "duration=0.15").log
        bounded = runs.result(name, "duration=0.15", f"tasks.{task}.tank=50").log
        np.testing.assert_array_equal(bounded["tau"], plain["tau"])
        assert f"{task}.tank" in bounded
        assert f"{task}.tank" not in plain


def test_memory_and_replay(tmp_path):
    """The tank is part of the memory: kept, restored, and solved again bit for bit."""
    result, built = pumped(tmp_path, 3, "impedance", duration=0.25)
    memory = built.controller.memory
    numbers = array("d")
    structure = CODEC.pack(memory, numbers)
    restored = CODEC.unpack(structure, np.array(numbers))
    np.testing.assert_array_equal(restored.felt["feel"].tank.sums, memory.felt["feel"].tank.sums)
    result.log.save(tmp_path / "log.npz")
    replay = Replay(tmp_path / "log.npz")
    assert len(replay) == 250
    assert all(replay.recorded(tick).same(ctl.step(*given)) for tick, ctl, given in replay.each())


def test_a_force_into_the_air_takes_no_more_than_the_tank_has(tmp_path, tell):
    """Nothing holds it back but the tank: m v^2 / 2 is all that ever comes of it."""
    fastest = {}
    for tank in (False, True):
        gains = {"tank": "{energy: 0.02, delay: 0.003}"} if tank else {}
        built = build(load(pressing(tmp_path, 0.2, -10, gains, duration=0.4, delay=2)))
        energies = []

        def watch(seen, out, built=built, energies=energies):
            held = built.controller.state.contacts.get("board")
            if held is not None:
                energies.append(
                    0.5 * float(held.slip @ np.linalg.solve(mobility(built.controller.state, held.G), held.slip))
                )

        result = run(built, hook=watch)
        fastest[tank] = max(energies)
    assert np.nanmin(result.log["press.tank"]) >= 0.0
    assert result.summary["metrics"]["press.tank.min"] >= 0.0
    assert any("press.tank" in active for active in result.log.active)
    assert fastest[False] > 0.2
    tell("energy of a motion over that of the tank", fastest[True] / 0.02, most=1.02)


FAULTS = {
    "no energy": ("tank: 1", "tank: 0", "tasks.feel.tank: expected a number greater than 0 [J], got 0"),
    "less than it begins with": (
        "tank: 1",
        "tank: {energy: 1, most: 0.5}",
        "tasks.feel.tank.most: expected at least en",
    ),
    "no such profile": (
        "K_scale: pump",
        "K_scale: pomp",
        "tasks.feel.K_scale: no reference named 'pomp'; did you mean",
    ),
    "no profile": ("K_scale: pump", "K_scale: start", "tasks.feel.K_scale: 'start' is a hold; expected a profile"),
    "below zero": ("[1, 4]", "[1, -4]", "tasks.feel.K_scale: 'pump' falls below 0"),
    "a list": ("tank: 1", "tank: [1]", "tasks.feel.tank: expected a number (the energy) or a mapping with energy"),
}


@pytest.mark.parametrize("case", FAULTS)
def test_faults_are_told_with_their_place(tmp_path, case):
    old, new, message = FAULTS[case]
    text = PUMP.format(
        duration=1, values=[1, 4], times=[0, 1], kind=KINDS["impedance"], tank=", tank: 1", delay=0, fx=1, fz=0
    )
    assert old in text
    path = tmp_path / "spec.yaml"
    path.write_text(text.replace(old, new, 1))
    with pytest.raises(SpecError) as caught:
        build(load(path))
    assert message in str(caught.value)
