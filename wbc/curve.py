"""References from the entries of a spec: curves and profiles become motions, forces and numbers over time."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pinocchio as pin

from . import spec as specs
from .axes import MOMENTUM_AXES
from .contact import Contact
from .faults import Faults, Place
from .pair import relative_axes
from .qp import Array
from .reference import Hold, Path, Reference, Scalar, arc, constant, quintic, ramp, sine
from .ride import Ride
from .robot import Robot
from .task.centroidal import com, middle
from .wrench import VELOCITY_AXES

SELF = "self"  # of a reference: it goes out from wherever its frame is


@dataclass(frozen=True)
class Curves:
    """What a spec, or one of its phases, says of motion.

    `followed`: reference -> the axes along which something follows it, filled while contacts and tasks are made.
    `made`: what was made already; phases that say the same share it, and so know that it goes on.
    """

    spec: specs.Spec
    robot: Robot
    faults: Faults
    followed: dict[str, set[int]] = field(default_factory=dict)
    made: dict[str, Any] = field(default_factory=dict)

    def ride(self, name: str, here: pin.SE3, path: Place) -> Ride:
        """The motion of ground that is at `here` at the start."""
        self.followed.setdefault(name, set()).update(range(6))
        key = repr((name, self.spec.references[name], here.homogeneous.tobytes()))
        if key not in self.made:
            self.made[key] = Ride(self._path(name, here, path))
        ride: Ride = self.made[key]
        return ride

    def force(self, contact: str, axis: str, value: float | str) -> Scalar:
        """A number, or the motion along x of a reference, in newtons."""
        if not isinstance(value, str):
            return constant(float(value))
        if self.spec.references[value].kind == "hold":
            return constant(0.0)
        return self._component(value, self.spec.references[value], 3, ("contacts", contact, "artificial", axis))

    def profile(self, name: str) -> Scalar:
        """A number over time."""
        return components(self.spec.references[name])[3]

    def com_path(self, name: str, entry: specs.ComTask, contacts: Mapping[str, Contact], q: Array) -> Reference:
        """Where a task wants the centre of mass."""
        state = self.robot.state(q, np.zeros(self.robot.nv))
        here = pin.SE3(np.eye(3), com(state)[0].copy())
        if isinstance(entry.target, specs.Over):
            for absent in [each for each, share in entry.target.shares.items() if share and each not in contacts]:
                path = ("tasks", name, "target", "over", *((absent,) if isinstance(entry.target.over, dict) else ()))
                self.faults.add(path, f"{absent!r} is no contact of this phase; expected a share of 0, or its contact")
            if over := self.over(entry):
                here.translation = np.array([*middle(state, over)[:2], here.translation[2]])
        if entry.reference is None:
            return Hold(here)
        along = components(self.spec.references[entry.reference])
        if turns := [VELOCITY_AXES[i] for i in along if i < 3]:
            message = f"a centre of mass does not turn; expected a reference without {', '.join(turns)}"
            self.faults.add(("tasks", name, "target"), message)
        return self._path(entry.reference, here, ("tasks", name, "target"))

    def over(self, entry: specs.ComTask) -> dict[str, float]:
        """Frame -> share of the contacts over which a task wants the centre of mass; none where it is elsewhere."""
        if not isinstance(entry.target, specs.Over):
            return {}
        contacts = self.spec.contacts
        return {
            contacts[name].frame: share for name, share in entry.target.shares.items() if share and name in contacts
        }

    def momentum(self, name: str, entry: specs.MomentumTask) -> Callable[[float], tuple[Array, Array]] | None:
        """h_d and its derivative along all axes, by time; None where all of it is zero."""
        if not entry.target:
            return None
        scalars = {}
        for axis, target in entry.target.items():
            i, path = MOMENTUM_AXES.index(axis), ("tasks", name, "target", axis)
            if not isinstance(target, str):
                scalars[i] = constant(target)
            elif self.spec.references[target].kind == "hold":
                scalars[i] = constant(0.0)
            else:
                scalars[i] = self._component(target, self.spec.references[target], i, path)

        def desired(t: float) -> tuple[Array, Array]:
            h, hdot = np.zeros(6), np.zeros(6)
            for i, scalar in scalars.items():
                h[i], hdot[i], _ = scalar(t)
            return h, hdot

        return desired

    def _seen_path(self, name: str, entry: specs.RelativeTask, q: Array) -> Reference:
        """Where a task wants one frame, seen from another."""
        state, path = self.robot.state(q, np.zeros(self.robot.nv)), ("tasks", name, "target")
        able = relative_axes(self.robot, entry.frame, entry.to)
        if extra := [axis for axis in entry.axes if entry.axes != "all" and axis not in able]:
            message = f"{self.spec.robot} cannot move {entry.frame} against {entry.to} along {', '.join(extra)}"
            self.faults.add(("tasks", name, "axes"), f"{message}; expected some of {', '.join(able)}")
        here = state.frame(entry.to).T.actInv(state.frame(entry.frame).T)
        if entry.target is None:
            still: Reference = self.made.setdefault(repr((entry.frame, entry.to)), Hold(here, relative=True))
            return still
        reference = self.spec.references[entry.target]
        in_ = reference.curve.in_
        axes = VELOCITY_AXES if entry.axes == "all" else entry.axes
        self.followed.setdefault(entry.target, set()).update(VELOCITY_AXES.index(axis) for axis in axes)
        if reference.kind not in ("hold", "profile") and in_ not in (SELF, entry.to):
            message = f"reference {entry.target!r} is drawn in {in_!r}, but the pose is seen from {entry.to!r}"
            self.faults.add(path, f"{message}; expected `in: {entry.to}` or `in: {SELF}` in the reference")
            return Hold(here)
        key = repr((entry.frame, entry.to, reference, q.tobytes()))
        if key not in self.made:
            self.made[key] = self._path(entry.target, here, path, seen_from=entry.to)
        made: Reference = self.made[key]
        return made

    def _drawn(self, target: float | str | None) -> bool:
        """Whether a target of motion has places, not only a speed."""
        return isinstance(target, str) and self.spec.references[target].kind != "hold"

    def _ends(self, entry: specs.Contact) -> float:
        """When all motion of a contact has come to rest for good [s]."""
        targets = entry.motion_targets.values()
        names = [self.spec.references[target] for target in targets if isinstance(target, str)]
        steady = any(target for target in targets if not isinstance(target, str))
        return max([math.inf if steady else 0.0, *map(duration, names)])

    def _scalar(self, target: float | str, axis: int, path: Place, on: str | None) -> Scalar:
        """Motion along one axis of what a contact closes on; `on` None: wherever the reference is drawn."""
        if not isinstance(target, str):
            return ramp(target) if target else constant(0.0)
        reference = self.spec.references[target]
        self.followed.setdefault(target, set()).add(axis)
        if reference.kind == "hold":
            return constant(0.0)
        if on is not None and reference.kind != "profile" and reference.curve.in_ != on:
            message = f"reference {target!r} is drawn in {reference.curve.in_!r}, but the contact closes on {on!r}"
            self.faults.add(path, f"{message}; expected `in: {on}` in the reference")
        return self._component(target, reference, axis, path)

    def _component(self, name: str, reference: specs.Reference, axis: int, path: Place) -> Scalar:
        known = components(reference)
        if axis not in known:
            gives = ", ".join(VELOCITY_AXES[i] for i in known)
            message = f"reference {name!r} does not move along {VELOCITY_AXES[axis]}"
            self.faults.add(path, f"{message}; expected a number, for a {reference.kind} gives {gives} only")
        return known.get(axis, constant(0.0))

    def _path(self, name: str, here: pin.SE3, path: Place, seen_from: str | None = None) -> Reference:
        reference = self.spec.references[name]
        in_, along, ends = reference.curve.in_, components(reference), duration(reference)
        if reference.kind == "profile":
            message = f"reference {name!r} is a number; expected a motion: hold, line, circle, lissajous or quintic"
            self.faults.add(path, message)
            return Hold(here)
        if reference.kind == "hold" and in_ in ("world", SELF, seen_from):
            return Hold(here, relative=True)
        if in_ == SELF:
            first = Path(pin.SE3.Identity(), along)(0.0).T
            return Path(here * first.inverse(), along, ends=ends, relative=True)
        origin = pin.SE3.Identity() if in_ in ("world", seen_from) else self.robot.fixed_pose(in_)
        turns = any(i < 3 for i in along)
        # a path of positions keeps the orientation that the frame starts with
        offset = None if turns else pin.SE3(origin.rotation.T @ here.rotation, np.zeros(3))
        return Path(origin, along, offset, ends)


def components(reference: specs.Reference) -> dict[int, Scalar]:
    """Scalar motions of a reference by axis (0 .. 5: wx, wy, wz, vx, vy, vz)."""
    curve = reference.curve
    if isinstance(curve, specs.Line):
        ends = enumerate(zip(curve.from_, curve.to, strict=True))
        return {3 + i: quintic((0.0, curve.time), pair) for i, pair in ends if any(pair)}
    if isinstance(curve, specs.Circle):
        (x, y), r, T, ease = curve.center, curve.radius, curve.period, curve.ease
        return {3: sine(r, T, math.pi / 2, x, ease), 4: sine(r, T, 0.0, y, ease)}
    if isinstance(curve, specs.Lissajous):
        sines = zip(curve.size, curve.period, curve.phases, strict=True)
        return {3 + i: sine(size / 2, period, phase, 0.0, curve.ease) for i, (size, period, phase) in enumerate(sines)}
    if isinstance(curve, specs.Quintic):
        points = [(*p, 0.0, 0.0, 0.0)[:6] for p in curve.waypoints]
        order = (3, 4, 5, 0, 1, 2)
        used = [i for i in range(3) if any(p[i] for p in points)]
        used += [3, 4, 5] if any(len(p) == 6 for p in curve.waypoints) else []
        return {order[i]: quintic(curve.times, [p[i] for p in points]) for i in used}
    if isinstance(curve, specs.Arc):
        return arc(curve.radius, quintic(curve.times, curve.angles))
    if isinstance(curve, specs.Profile):
        return dict.fromkeys(range(6), quintic(curve.times, curve.values))  # whichever follows it
    return {}


def duration(reference: specs.Reference) -> float:
    """When it has come to rest for good [s]; infinite for one that never does."""
    curve = reference.curve
    if isinstance(curve, specs.Line):
        return curve.time
    if isinstance(curve, specs.Quintic | specs.Arc | specs.Profile):
        return curve.times[-1]
    return 0.0 if isinstance(curve, specs.Hold) else math.inf
