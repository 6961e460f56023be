"""How the tick grows with joints and contacts, part by part, beside the floor of Pinocchio alone: a picture and JSON.

    python benchmarks/growth.py [--ticks N] [--clock wall|cpu] [--out FOLDER] [--json]

Robots are synthetic, so that nothing but the size differs: an arm of 7 to 60 joints that holds the pose of its tip, and
a trunk on limbs with up to 60 degrees of freedom that stands on 2, 4 or 8 of them (centre of mass, orientation of the
trunk, posture, limits of torque, position and velocity). On eight limbs of six joints it stands on none to eight feet.
Panda, Go2 and G1 are marked beside them, with what they do in `eraser`, `go2_stand` and `g1_stand`. Ticks are timed as
by `tick.py`: each in turn with the floor, stages in a pass of their own. Writes growth.png and growth.json.
"""

from __future__ import annotations

import argparse
import gc
import json
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
from tick import CLOCKS, STAGES, stages, told

import wbc
from wbc.friction import unilateral
from wbc.reference import Hold

REACH = 0.4  # [m] along and down of a limb
AXES = {"z": (0.0, 0.0, 1.0), "y": (0.0, 1.0, 0.0), "x": (1.0, 0.0, 0.0)}
ORDER = "zyyxyz"  # axes of a limb's joints, from the trunk on: three make a leg, six a whole one
DOWN = np.array([0.0, 0.0, -1.0])
LEVEL = ("wx", "wy", "wz")
DOFS = {0: (7, 15, 25, 35, 45, 60), 2: (18, 30, 42, 60), 4: (18, 30, 42, 60), 8: (30, 42, 54, 60)}
LIMBS, JOINTS = 8, 6  # of the robot that stands on none to eight feet
ROUNDS, WARM = 8, 5  # ticks that begin a round leave the caches of another behind
SHIPPED = {"Panda": "eraser", "Go2": "go2_stand", "G1": "g1_stand"}


def limb(model: pin.Model, name: str, parent: int, place: pin.SE3, joints: int, down: float = REACH) -> None:
    """A chain that goes out by `REACH`, then `down`; its foot is a frame of its name."""
    path = np.cumsum([[0.0, 0.0, 0.0], *([[REACH, 0.0, 0.0]] * 2), *([[0.0, 0.0, -down]] * 2)], axis=0) / 2.0
    at = np.linspace(0.0, 4.0, joints + 1)
    points = np.stack([np.interp(at, np.arange(5.0), path[:, i]) for i in range(3)], axis=1)
    most = {key: np.array([value]) for key, value in (("tau", 500.0), ("v", 20.0), ("low", -3.0), ("high", 3.0))}
    for i in range(joints):
        step = place if i == 0 else pin.SE3(np.eye(3), points[i] - points[i - 1])
        axis = np.array(AXES[ORDER[i % len(ORDER)]])
        parent = model.addJoint(
            parent, pin.JointModelRevoluteUnaligned(axis), step, f"{name}_{i}",
            most["tau"], most["v"], most["low"], most["high"],
        )  # fmt: skip
        middle = 0.5 * (points[i + 1] - points[i])
        model.appendBodyToJoint(parent, pin.Inertia.FromSphere(5.0 / joints, 0.05), pin.SE3(np.eye(3), middle))
    tip = pin.SE3(np.eye(3), points[-1] - points[-2])
    model.addFrame(pin.Frame(name, parent, 0, tip, pin.FrameType.OP_FRAME))


def walker(limbs: int, dof: int) -> wbc.Robot:
    """A trunk with `dof` velocities, six of them its own, the others dealt to limbs around it."""
    model = pin.Model()
    trunk = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "root_joint")
    model.appendBodyToJoint(trunk, pin.Inertia.FromBox(20.0, 0.4, 0.4, 0.2), pin.SE3.Identity())
    model.addFrame(pin.Frame("trunk", trunk, 0, pin.SE3.Identity(), pin.FrameType.OP_FRAME))
    for i in range(limbs):
        R = pin.utils.rotate("z", 2.0 * np.pi * (i + 0.5) / limbs)
        joints = (dof - 6) // limbs + (i < (dof - 6) % limbs)
        limb(model, f"foot{i}", trunk, pin.SE3(R, R @ [0.2, 0.0, 0.0]), joints)
    return _ready(model)


def arm(joints: int) -> wbc.Robot:
    model = pin.Model()
    limb(model, "tip", 0, pin.SE3.Identity(), joints, -REACH)
    return _ready(model)


def _ready(model: pin.Model) -> wbc.Robot:
    armature = np.full(model.nv, 0.01)
    armature[: 6 if model.nq != model.nv else 0] = 0.0
    model.armature = armature
    return wbc.Robot.from_pinocchio(model)


def standing(limbs: int, dof: int, feet: int) -> wbc.Controller:
    """A walker that stands on some of its limbs."""
    robot = walker(limbs, dof)
    q = robot.keyframes["home"]
    state = robot.state(q, np.zeros(robot.nv))
    contacts = {}
    for i in range(feet):  # as far around as they go
        name = f"foot{i * limbs // feet}"
        contacts[name] = wbc.RoundFoot(name, np.eye(3))
        contacts[name].pushes = unilateral(contacts[name], state, DOWN, mu=0.6)
    com = pin.centerOfMass(robot.model, robot.model.createData(), q)
    tasks = {
        "balance": wbc.ComTask(Hold(pin.SE3(np.eye(3), com))),
        "trunk": wbc.MotionTask("trunk", Hold(state.frame("trunk").T), axes=LEVEL),
        "posture": wbc.WholeBodyPosture(q, 20.0, 9.0, robot.nu),
    }
    return wbc.Controller(robot, contacts, tasks, {}, q=q)


def holding(joints: int) -> wbc.Controller:
    """An arm that holds the pose of its tip."""
    robot = arm(joints)
    q = robot.keyframes["home"] + 0.3
    tip = robot.state(q, np.zeros(robot.nv)).frame("tip").T
    tasks = {"tip": wbc.MotionTask("tip", Hold(tip)), "posture": wbc.PostureTask(q)}
    return wbc.Controller(robot, {}, tasks, {}, q=q)


def shipped(spec: str) -> wbc.Controller:
    return wbc.Controller.from_spec(wbc.load(spec))


def cases() -> dict[str, tuple[dict[str, Any], Callable[[], wbc.Controller]]]:
    """Name -> what it counts for, and the controller."""
    found: dict[str, tuple[dict[str, Any], Callable[[], wbc.Controller]]] = {}
    for feet, dofs in DOFS.items():
        for dof in dofs:
            made = (lambda d=dof: holding(d)) if not feet else (lambda f=feet, d=dof: standing(f, d, f))
            found[f"{dof} dof, {feet} contacts"] = ({"dof": dof, "contacts": feet, "sweep": "dof"}, made)
    dof = 6 + LIMBS * JOINTS
    for feet in range(LIMBS + 1):
        found[f"{LIMBS} limbs, {feet} contacts"] = (
            {"dof": dof, "contacts": feet, "sweep": "contacts"}, lambda f=feet: standing(LIMBS, dof, f),
        )  # fmt: skip
    for name, spec in SHIPPED.items():
        found[name] = ({"sweep": "shipped"}, lambda s=spec: shipped(s))
    return found


def near(controller: wbc.Controller, count: int) -> list[tuple[Any, ...]]:
    """Ticks (t, q, v, measured) at states near the start."""
    rng, robot = np.random.default_rng(0), controller.robot
    ticks = []
    for i in range(count):
        q = pin.integrate(robot.model, controller.start, 1e-5 * rng.standard_normal(robot.nv))
        ticks.append((1e-3 * i, q, 1e-4 * rng.standard_normal(robot.nv), {}))
    return ticks


def survey(count: int, clock: str) -> dict[str, Any]:
    """Median and p99 [us] of all cases; in rounds, so that all see the machine at every pace that it has."""
    asked, made = cases(), {}
    for name, (_, make) in asked.items():
        made[name] = make()
        progress(f"built {len(made)} of {len(asked)} controllers")
    gc.collect()
    gc.freeze()
    found: dict[str, list[dict[str, Any]]] = {name: [] for name in asked}
    for i in range(ROUNDS):
        for name, controller in made.items():
            us = stages(controller, near(controller, WARM + count // ROUNDS), CLOCKS[clock])
            found[name].append({stage: values[WARM:] for stage, values in us.items()})
        progress(f"round {i + 1} of {ROUNDS}")
    result = {}
    for name, (about, _) in asked.items():
        controller, rounds = made[name], found[name]
        us = told({stage: np.concatenate([each[stage] for each in rounds]) for stage in rounds[0]})
        size = {"dof": controller.robot.nv, "contacts": len(controller.phase.contacts)}
        result[name] = size | about | {"status": controller.memory.status.value, "us": us}
    return result


def progress(told: str) -> None:
    """One line that changes, or many in a file."""
    print(f"\r{told:40s}" if sys.stderr.isatty() else told, end="" if sys.stderr.isatty() else "\n", file=sys.stderr)


def table(found: dict[str, Any]) -> None:
    print(f"{'':22s} {'median':>8s} {'p99':>8s} [us] {'x floor':>8s}")
    for name, x in found.items():
        whole, floor = x["us"]["whole tick"], x["us"]["floor: Pinocchio"]["p50"]
        print(f"{name:22s} {whole['p50']:8.0f} {whole['p99']:8.0f}      {whole['p50'] / floor:8.1f}  {x['status']}")


def draw(found: dict[str, Any], clock: str, path: Path) -> None:
    """Totals above, parts below; joints to the left, contacts to the right."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    top = 1.3 * max(x["us"]["whole tick"]["p50"] for x in found.values())  # a p99 beyond is the machine's
    figure, ((grow, touch), (parts_grow, parts_touch)) = plt.subplots(2, 2, figsize=(11, 8), sharey="row")
    by = lambda sweep: [x for x in found.values() if x["sweep"] == sweep]  # noqa: E731
    for colour, feet in zip(("tab:gray", "tab:green", "tab:blue", "tab:red"), DOFS, strict=True):
        line = [x for x in by("dof") if x["contacts"] == feet]
        label = "arm, no contact" if not feet else f"floating base, {feet} contacts"
        _curve(grow, [x["dof"] for x in line], line, label, colour)
    line = by("contacts")
    _curve(touch, [x["contacts"] for x in line], line, f"floating base, {line[0]['dof']} dof", "tab:purple")
    for axes, lines, key in ((grow, by("dof"), "dof"), (touch, line, "contacts")):
        at = sorted({x[key] for x in lines})
        floor = [np.median([x["us"]["floor: Pinocchio"]["p50"] for x in lines if x[key] == one]) for one in at]
        axes.plot(at, floor, color="black", linestyle=":", label="floor: computeAllTerms")
    for name, x in found.items():
        if x["sweep"] == "shipped":
            at = (x["dof"], x["us"]["whole tick"]["p50"])
            grow.plot(*at, "k*", markersize=9)
            grow.annotate(name, at, xytext=(7, 4), textcoords="offset points", fontsize=9, weight="bold")
    middle = [x for x in by("dof") if x["contacts"] == 4]
    _parts(parts_grow, [x["dof"] for x in middle], middle)
    _parts(parts_touch, [x["contacts"] for x in line], line)
    grow.set_title(f"whole tick ({clock} time): median, up to p99 shaded")
    touch.set_title("the same, by contacts")
    parts_grow.set_title("its parts (median), 4 contacts")
    parts_touch.set_title(f"its parts (median), {line[0]['dof']} dof")
    parts_grow.set_xlabel("degrees of freedom")
    parts_touch.set_xlabel("points of contact")
    for axes in (grow, parts_grow):
        axes.set_ylabel("[us]")
    for axes in (grow, touch, parts_grow, parts_touch):
        axes.grid(alpha=0.3)
        axes.set_ylim(0.0, top)
    grow.legend(fontsize=8, loc="upper left")
    touch.legend(fontsize=8, loc="upper left")
    handles, labels = parts_grow.get_legend_handles_labels()
    parts_grow.legend(handles[::-1], labels[::-1], fontsize=8, loc="upper left")
    figure.tight_layout()
    figure.savefig(path, dpi=110)


def _curve(axes: Any, x: list[int], line: list[dict[str, Any]], label: str, colour: str) -> None:
    p50, p99 = ([each["us"]["whole tick"][key] for each in line] for key in ("p50", "p99"))
    axes.plot(x, p50, "o-", color=colour, label=label, markersize=4)
    axes.fill_between(x, p50, p99, color=colour, alpha=0.12, linewidth=0)


def _parts(axes: Any, x: list[int], line: list[dict[str, Any]]) -> None:
    known = {stage: np.array([each["us"][stage]["p50"] for each in line]) for stage in STAGES}
    whole = np.array([each["us"]["whole tick"]["p50"] for each in line])
    known["the rest"] = np.maximum(whole - sum(known.values()), 0.0)
    axes.stackplot(x, list(known.values()), labels=list(known), colors=[f"C{i}" for i in range(len(known))], alpha=0.75)
    axes.plot(x, [each["us"]["floor: Pinocchio"]["p50"] for each in line], "k:")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--ticks", type=int, default=400)
    parser.add_argument("--clock", choices=CLOCKS, default="wall")
    parser.add_argument("--out", type=Path, default=Path("runs") / "growth")
    parser.add_argument("--json", action="store_true")
    args = parser.parse_args()
    found = survey(args.ticks, args.clock)
    args.out.mkdir(parents=True, exist_ok=True)
    (args.out / "growth.json").write_text(json.dumps(found, indent=1))
    draw(found, args.clock, args.out / "growth.png")
    if args.json:
        print(json.dumps(found))
    else:
        table(found)
    print(f"wrote {args.out / 'growth.png'}, {args.out / 'growth.json'}", file=sys.stderr)


if __name__ == "__main__":
    main()
