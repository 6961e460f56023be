"""What is stable at the start: force loops, damping, masses that can be rendered; what is not is a fault."""

from __future__ import annotations

import math
from collections.abc import Mapping
from copy import copy

import numpy as np

from . import spec as specs
from .analytic import damping_limit
from .contact import Contact
from .dynamics import mobility
from .free_motion import STABLE, MassRange, following_radius, mass_range
from .geometry import Geometry
from .qp import Array
from .stability import Pole, damping_margin, force_poles
from .task import Task
from .task.force import ForceTask
from .task.impedance import AdmittanceTask, Compliance


def masses_at(
    geometry: Geometry, contacts: Mapping[str, Contact], tasks: Mapping[str, Task], q: Array
) -> list[MassRange]:
    """What impedance and admittance can render at the start; what is unstable there is a fault."""
    spec, robot, masses = geometry.spec, geometry.robot, list[MassRange]()
    state = robot.state(q, np.zeros(robot.nv))
    for name, contact in contacts.items():
        state.contacts[name] = contact.hold(state)
    for name, task in tasks.items():
        if not isinstance(task, Compliance):
            continue
        found = mass_range(name, _stiffest(spec, name, task), state, 1.0 / spec.rate, spec.plant.delay)
        masses.append(found)
        if not found.stable:
            geometry.faults.add(("tasks", name, "M"), _unrendered(found))
        if isinstance(task, AdmittanceTask) and not task.printed:
            pole = following_radius(task, 1.0 / spec.rate, spec.plant.delay)
            if not pole <= STABLE:
                told = f"the arm cannot follow so stiffly at this rate: the largest pole has modulus {pole:.4f}"
                geometry.faults.add(("tasks", name, "kd"), f"{told}, expected below 1; lower kp or kd")
    return masses


def _stiffest(spec: specs.Spec, name: str, task: Compliance) -> Compliance:
    """A task with the largest stiffness that it is to have."""
    scale = getattr(spec.tasks[name], "K_scale", None)
    if scale is None:
        return task
    profile = spec.references[scale].profile
    assert profile is not None
    task = copy(task)
    task.K = max(profile.values) * task.K
    return task


def _unrendered(found: MassRange) -> str:
    """An unstable mass, and those that would be stable."""
    pole = f"unstable at this rate: the largest pole of free motion has modulus {found.radius:.4f}, expected below 1"
    told = [
        f"{axis} from {low:.3g}{'' if math.isinf(high) else f' to {high:.3g}'}"
        for axis, low, high in zip(found.axes, found.least, found.most, strict=True)
        if low < high
    ]
    return f"{pole}; choose M on {', '.join(told)}" if told else f"{pole}; lower it with K and B, or raise the rate"


def force_loops(
    geometry: Geometry, contacts: Mapping[str, Contact], tasks: Mapping[str, Task], q: Array
) -> tuple[list[Pole], dict[str, float], dict[str, dict[str, float]]]:
    """Poles of every force loop; by task, the damping margin and the most that each axis bears on its own."""
    spec, robot, faults = geometry.spec, geometry.robot, geometry.faults
    state, dt = robot.state(q, np.zeros(robot.nv)), 1.0 / spec.rate
    poles: list[Pole] = []
    margins: dict[str, float] = {}
    most: dict[str, dict[str, float]] = {}
    for name, task in tasks.items():
        if not isinstance(task, ForceTask):
            continue
        contact = contacts[task.contact]
        W = mobility(state, contact.hold(state).G)
        k, delay, alpha = contact.k, 1 + spec.plant.delay, task.smoothing(dt)
        Kp, Ki, D = task.Kp[:k, :k], task.Ki[:k, :k], task.K_damp
        masses = 1.0 / np.maximum(W.diagonal(), 1e-12)
        margins[name] = damping_margin(W, D, dt)
        most[name] = {axis: damping_limit(W[i : i + 1, i : i + 1], dt) for i, axis in enumerate(contact.axes)}
        if not margins[name] < 2.0:
            bound = f"dt max eig(A M_C^-1 A' K_damp) = {margins[name]:.3g}, expected below 2"
            advice = "lower it on the axes of small inertia, or raise the rate"
            faults.add(("tasks", name, "damping"), f"damping is unstable at this rate: {bound}; {advice}")
            continue
        if not (Kp.any() or Ki.any()):
            continue  # an open loop has no poles of its own
        found = force_poles(task.contact, contact.axes, masses, Kp, Ki, D, alpha, dt, delay)
        poles += found
        worst = max(found, key=lambda pole: pole.radius, default=None)
        if worst is not None and not worst.radius < 1.0:
            faults.add(("tasks", name, "kp"), _unstable(worst))
    return poles, margins, most


def against(pole: Pole) -> str:
    """What a force loop meets at this pole, in words."""
    unit = "N m/rad" if pole.axis.startswith("m") else "N/m"
    return "a rigid wall" if pole.stiffness is None else f"a stiffness of {pole.stiffness:.3g} {unit}"


def _unstable(worst: Pole) -> str:
    loop = f"the force loop on {worst.axis} is unstable against {against(worst)}"
    pole = f"its largest pole has modulus {worst.radius:.4f}, expected below 1"
    return f"{loop}: {pole}; lower kp or ki, add damping along the axis, or lower the filter's cut-off"
