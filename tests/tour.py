"""Seeded variations of the shipped specs: pose, gains, tilt, stiffness, armature, sensor noise, mass error.

Every variation has the bars of its spec, widened by what theory predicts of the error that was put in: the motion that
a wrong mass pulls off, |J M^-1 dg| / kp on the free axes, and three sigma of the force loop's own noise gain.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from pathlib import Path

import bars
import numpy as np
import pinocchio as pin

from wbc.build import build
from wbc.resources import shipped
from wbc.run import run
from wbc.spec import load
from wbc.stability import loop_matrix
from wbc.task import ForceTask, MotionTask

SPECS = ("eraser", "polish_sphere", "planar")
SCENES = {"eraser": "board", "polish_sphere": "dome", "planar": "board"}
SECONDS = 4.0


@dataclass(frozen=True)
class Variation:
    """One seed's spec: what `--set` would say, and its scene."""

    seed: int
    spec: str
    changes: tuple[str, ...]
    scene: str
    robot: str
    facts: dict[str, float] = field(default_factory=dict)


def variation(seed: int) -> Variation:
    """The same for ever for a seed."""
    rng = np.random.default_rng([seed, 20])
    spec = SPECS[seed % len(SPECS)]
    planar = spec == "planar"
    shift = rng.uniform(-0.04, 0.04, 3) * (1.0, 0.0 if planar else 1.0, 0.5)
    tilt = np.radians(rng.uniform(-12.0, 12.0, 2)) * (0.0 if planar else 1.0, 1.0)
    stiff = float(np.exp(rng.uniform(np.log(0.006), np.log(0.02))))  # [s] MuJoCo's time constant of the contact
    kp = float(rng.uniform(80.0, 144.0))
    noise, mass = float(rng.uniform(0.0, 0.2)), float(rng.uniform(-0.03, 0.03))
    changes = [
        f"duration={SECONDS}",
        f"tasks.press.kp={rng.uniform(0.2, 0.4):.4f}",
        f"tasks.press.ki={rng.uniform(8.0, 15.0):.4f}",
        f"tasks.press.filter={rng.uniform(40.0, 70.0):.3f}",
        f"tasks.{'polish' if spec == 'polish_sphere' else 'draw'}.kp={kp:.3f}",
        f"tasks.{'polish' if spec == 'polish_sphere' else 'draw'}.kd={2 * np.sqrt(kp):.3f}",
        f"plant.noise.force={noise:.4f}",
        f"plant.noise.moment={0.02 * noise:.5f}",
        f"plant.mass_error={mass:.4f}",
    ]
    text = shipped("scenes", SCENES[spec], ".xml").read_text()
    facts = {"kp": kp, "noise": noise, "mass": mass, "tilt": float(np.degrees(np.abs(tilt).max())), "solref": stiff}
    robot = shipped("scenes/robots", "planar3r" if planar else "panda", ".xml").read_text()
    # rotors that the controller knows: of a wrong one the bars say nothing
    armature = float(rng.uniform(0.0, 0.15))
    robot, known = re.subn(r'armature="[^"]*"', f'armature="{armature:.4f}"', robot)
    robot = robot if known else robot.replace("<joint ", f'<joint armature="{armature:.4f}" ')
    return Variation(seed, spec, tuple(changes), _moved(text, shift, tilt, stiff), robot, facts)


def _moved(text: str, shift: np.ndarray, tilt: np.ndarray, stiff: float) -> str:
    """A scene with its body shifted [m], tilted about x and y [rad], and of another stiffness."""

    def place(found: re.Match[str]) -> str:
        at = np.array([float(x) for x in found[2].split()]) + shift
        return f'{found[1]}pos="{at[0]:.5f} {at[1]:.5f} {at[2]:.5f}" euler="{tilt[0]:.5f} {tilt[1]:.5f} 0"'

    text, once = re.subn(r'(<body name="(?:board|dome)_body" )pos="([^"]*)"', place, text)
    text, twice = re.subn(r'solref="0.01 1"', f'solref="{stiff:.5f} 1"', text)
    assert (once, twice) == (1, 1)
    return text


@dataclass(frozen=True)
class Verdict:
    """What came of a variation: metric -> (value, bound with its allowances)."""

    variation: Variation
    figures: dict[str, tuple[float, float]]
    finished: bool

    @property
    def missed(self) -> dict[str, tuple[float, float]]:
        return {name: pair for name, pair in self.figures.items() if not pair[0] <= pair[1]}

    @property
    def diverged(self) -> bool:
        """Ended early, or ten times beyond a bound."""
        return not self.finished or any(not value <= 10 * bound for value, bound in self.missed.values())

    def __str__(self) -> str:
        facts = ", ".join(f"{name} {value:.3g}" for name, value in self.variation.facts.items())
        figures = ", ".join(f"{name} {value:.2g} of {bound:.2g}" for name, (value, bound) in self.missed.items())
        return f"WBC_SEED={self.variation.seed} pytest tests/test_tour.py  # {self.variation.spec}: {figures} ({facts})"


def judge(case: Variation, folder: Path) -> Verdict:
    """Run a variation."""
    files = []
    for key, text in (("scene", case.scene), ("robot", case.robot)):
        file = folder / f"{key}{case.seed}.xml"
        file.write_text(text)
        files.append(f"{key}={file}")
    built = build(load(case.spec, [*files, *case.changes]))
    result = run(built, seed=case.seed)
    figures = {}
    for metric, bar in bars.SPECS[case.spec].items():
        name = metric.split(".")[0]
        extra = pulled(built, result.log, name) if "position" in metric else pressed(built, result.log, metric, case)
        figures[metric] = (result.summary["metrics"].get(metric, np.inf), bar + extra)
    for metric, bar in bars.ALWAYS.items():
        figures[metric] = (result.summary["metrics"].get(metric, np.inf), bar)
    return Verdict(case, figures, "broken" not in result.summary)


def astray(built, log, tick: int) -> np.ndarray:
    """(nv,) [N m] the torque dg that the wrong masses take at a tick, of which the controller knows nothing."""
    model, a = built.robot.model, log["vdot"][tick]
    tau = pin.rnea(model, model.createData(), log["q"][tick], log["v"][tick], a) - model.armature * a
    return built.spec.plant.mass_error * tau


def pulled(built, log, name: str) -> float:
    """[m] |J M^-1 dg| / kp along the free axes, the others held: how far a wrong mass pulls the motion off, rms."""
    robot, phase = built.robot, built.controller.phase
    task = phase.tasks[name]
    assert isinstance(task, MotionTask)
    off = []
    for tick in range(log.size // 4, log.size, 50):
        state = robot.state(log["q"][tick], log["v"][tick])
        contact, J = phase.contacts[task.contact], state.frame(task.frame).J
        G, free = contact.A(state) @ J, contact.free(state)
        held = np.linalg.solve(state.M, G.T)
        vdot = np.linalg.solve(state.M, astray(built, log, tick))
        vdot -= held @ np.linalg.solve(G @ held, G @ vdot)  # the contact holds all the same
        off.append(np.linalg.norm((free @ J @ vdot)[free[:, 3:].any(axis=1)]))
    return float(np.sqrt(np.mean(np.square(off))) / task.Kp.max())


def pressed(built, log, metric: str, case: Variation) -> float:
    """[N, N m] three times what the sensor's noise leaves in the force, and what a wrong mass leaves.

    A wrong mass pushes with d = Lam A M_C^-1 F of dg along the constraint; the loop sees it change as the arm moves.
    """
    contact, axis, _ = metric.split(".")
    phase, robot, dt = built.controller.phase, built.robot, built.controller.dt
    task = next(t for t in phase.tasks.values() if isinstance(t, ForceTask) and t.contact == contact)
    i = task.axes.index(axis)
    A = loop_matrix(1.0, task.Kp[i, i], task.Ki[i, i], 0.0, task.smoothing(dt), dt, None)
    sigma = case.facts["noise"] * (0.02 if axis.startswith("m") else 1.0)
    b = A[:, 0]  # noise enters where the last force does
    P = np.linalg.solve(np.eye(A.size) - np.kron(A, A), np.outer(b, b).ravel()).reshape(A.shape)  # P = A P A' + b b'
    x, left, d = np.zeros(len(A)), [], 0.0
    for tick in range(log.size):
        if tick % 10 == 0:
            state = robot.state(log["q"][tick], log["v"][tick])
            G = phase.contacts[contact].A(state) @ state.frame(phase.contacts[contact].frame).J
            X = np.linalg.solve(state.M, G.T)
            d = np.linalg.solve(G @ X, X.T @ astray(built, log, tick))[i]
        x = A @ x
        x[0] += d
        left.append(x[0])
    weight = abs(built.spec.plant.mass_error) * robot.inertia_below("wrist_sensor").mass * 9.81
    reads = 0.0 if axis.startswith("m") else weight  # the sensor's compensation takes the tool for what it is not
    return 3.0 * sigma * float(np.sqrt(P[0, 0])) + float(np.sqrt(np.mean(np.square(left[1000:])))) + reads
