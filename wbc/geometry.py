"""Contacts from the entries of a spec, tables and screws, at the pose that a robot starts in; and motion on them."""

from __future__ import annotations

import copy
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from . import quantity
from . import spec as specs
from .axes import MOMENTUM_AXES
from .closing import Goal, Lying
from .contact import Contact, Settling
from .contact.axes import AxesContact, MatrixContact, WorldAxesContact
from .contact.edge import Edge, EdgeContact
from .contact.foot import RoundFoot
from .contact.screw import ScrewContact
from .contact.sphere import SphereContact
from .curve import Curves, components
from .errors import ModelError
from .faults import Place
from .footing import Footing
from .friction import unilateral
from .names import MOVING
from .pair import movable, seen
from .qp import Array
from .reference import Path, Reference, Scalar, ScrewPath, SpherePath, constant, hold
from .surface import Sole
from .transition import Reading
from .wrench import VELOCITY_AXES

FLOOR = "floor"  # the frame on whose plane a robot with a floating base stands, unless a contact says otherwise
SETTLING = 20.0  # [1/s] of its contacts


@dataclass(frozen=True)
class Geometry(Curves):
    """What a spec, or one of its phases, says of places, and of motion there."""

    def at(self, q: Array) -> tuple[dict[str, Contact], dict[str, Reference]]:
        """Contacts, and the motion references by task, at the start `q` (nq,)."""
        spec = self.spec
        contacts: dict[str, Contact] = {}
        paths: dict[str, Reference] = {}
        for name, entry in spec.contacts.items():
            with self.faults.at("contacts", name, entry.kind):
                motion = entry.model_copy(update={"artificial": entry.motion_targets})
                targets = [self.spec.references.get(str(target)) for target in entry.motion_targets.values()]
                key = repr((name, motion, targets, q.tobytes()))
                if key not in self.made:
                    self.made[key] = self._contact(name, entry, q)
                contact, paths[name] = self.made[key]
                contacts[name] = copy.copy(contact)  # a phase's own: its drag follows what moves it in that phase
                contacts[name].feedforward, contacts[name].against = entry.feedforward, entry.with_
                rate = entry.settling if entry.settling is not None else SETTLING if self.robot.base else 0.0
                contacts[name].settling = Settling(rate) if rate else None
                contacts[name].footing = self._footing(name, entry)
                if entry.rides is not None:
                    place = self._on(name, entry, q)[0]
                    contacts[name].ride = self.ride(entry.rides, place, ("contacts", name, "rides"))
            if name in contacts and entry.push is not None:
                self._push(name, entry, entry.push, contacts[name], q)
        references: dict[str, Reference] = {}
        for name, task in spec.tasks.items():
            if isinstance(task, specs.RelativeTask):
                references[name] = self._seen_path(name, task, q)
            if isinstance(task, specs.MomentumTask):
                for axis, target in task.target.items():
                    if isinstance(target, str):
                        self.followed.setdefault(target, set()).add(MOMENTUM_AXES.index(axis))
            if isinstance(task, specs.ComTask) and task.reference is not None:
                self.followed.setdefault(task.reference, set()).update((3, 4, 5))
            if not isinstance(task, MOVING):
                continue
            if task.contact is not None:
                if task.contact in paths:
                    references[name] = paths[task.contact]
                continue
            assert task.frame is not None
            if task.target is None:
                references[name] = hold(self.robot.state(q, np.zeros(self.robot.nv)).frame(task.frame).T)
            else:
                key = repr((task.frame, spec.references[task.target], q.tobytes()))
                if key not in self.made:
                    here = self.robot.state(q, np.zeros(self.robot.nv)).frame(task.frame).T
                    self.made[key] = self._path(task.target, here, ("tasks", name, "target"))
                references[name] = self.made[key]
                axes = VELOCITY_AXES if task.axes == "all" else task.axes
                self.followed.setdefault(task.target, set()).update(VELOCITY_AXES.index(axis) for axis in axes)
            self._check_axes(task.frame, () if task.axes == "all" else task.axes, ("tasks", name, "axes"))
        return contacts, references

    def goals(
        self, q: Array, contacts: Mapping[str, Contact], references: Mapping[str, Reference]
    ) -> list[Goal | Lying]:
        """What the start pose must be closed onto; what is to stay where it starts asks for nothing."""
        robot, spec = self.robot, self.spec
        goals: list[Goal | Lying] = []
        paths: dict[str, Reference] = {}
        for name, task in spec.tasks.items():
            if not isinstance(task, MOVING):
                continue
            if task.contact is not None:
                paths[task.contact] = references[name]
            elif task.frame is not None and task.target and not getattr(references[name], "relative", False):
                rows = np.eye(6)[[i for i, a in enumerate(VELOCITY_AXES) if task.axes == "all" or a in task.axes]]
                goals.append(Goal(task.frame, references[name](0.0).T, rows, ("tasks", name, "target")))
        for name, contact in contacts.items():
            T, on = self._on(name, spec.contacts[name], q)
            if on is not None:
                rows = np.eye(6) if name in paths else contact.A(robot.state(q, np.zeros(robot.nv)))
                if self._ground(name, spec.contacts[name]):
                    goals.append(self._standing(name, T, q))
                    continue
                T = paths[name](0.0).T if name in paths else T
                goals.append(Goal(contact.frame, T, rows, ("contacts", name), to=contact.against))
        return goals

    def _check_axes(self, frame: str, axes: Sequence[str], path: Place, able: Sequence[str] = ()) -> None:
        able = able or [VELOCITY_AXES[i] for i in self.robot.axes(frame)]
        if extra := [axis for axis in axes if axis not in able]:
            message = (
                f"{self.spec.robot} cannot move {frame} along {', '.join(extra)}; expected some of {', '.join(able)}"
            )
            self.faults.add(path, message)

    def _on(self, name: str, contact: specs.Contact, q: Array) -> tuple[pin.SE3, str | None]:
        """Where what holds the frame has it at the start, and the frame there that the start must be closed onto."""
        if ground := self._ground(name, contact):
            return self.robot.fixed_pose(ground), ground
        if (on := self._closed_on(name, contact)) is not None:
            return self._place(on, contact.with_), on
        return seen(self.robot.state(q, np.zeros(self.robot.nv)), contact.frame, contact.with_).T, None

    def _closed_on(self, name: str, contact: specs.Contact) -> str | None:
        """The frame that a contact closes against: `on`, else the one of its own name, if that is where it is held."""
        if contact.on is not None or name not in self.robot.frames:
            return contact.on
        return name if contact.with_ is None or self.robot.wrench_map(contact.with_, name) is not None else None

    def _place(self, frame: str, to: str | None) -> pin.SE3:
        """Pose of a frame that is fixed to the link of `to`, seen from there, or to the world."""
        if to is None:
            return self.robot.fixed_pose(frame)
        ends = [self.robot.model.frames[self.robot.frame_id(each)] for each in (to, frame)]
        if ends[0].parentJoint != ends[1].parentJoint:
            raise ModelError(f"frame {frame!r} moves against {to!r}; expected one on its link")
        return ends[0].placement.actInv(ends[1].placement)

    def _ground(self, name: str, contact: specs.Contact) -> str | None:
        """The frame on whose plane the contact stands wherever it is."""
        if contact.ground is not None or contact.with_ is not None:
            return contact.ground
        held = contact.on is not None or name in self.robot.frames or contact.push is None or contact.kind != "holds"
        return FLOOR if self.robot.base and not held and FLOOR in self.robot.frames else None

    def _footing(self, name: str, entry: specs.Contact) -> Footing | None:
        """What a foot of a robot with a floating base stands on; None of what is held in another way."""
        ground = self._ground(name, entry)
        point = set(entry.constrained) == {"vx", "vy", "vz"}
        if ground is None or not self.robot.base or not (point or entry.sole or entry.edge):
            return None
        plane = self.robot.fixed_pose(ground)
        n, size = plane.rotation[:, 2], entry.sole
        if entry.edge is not None:
            size = (entry.edge, 0.0) if entry.along == 0 else (0.0, entry.edge)
        return Footing(n, float(n @ plane.translation), entry.radius or 0.0, size)

    def _standing(self, name: str, plane: pin.SE3, q: Array) -> Goal | Lying:
        """That a contact's frame comes to stand on a plane: at its height, a sole with its z along the plane's."""
        contact = self.spec.contacts[name]
        if contact.edge is not None:
            n = plane.rotation[:, 2]
            level = float(n @ plane.translation) + (contact.radius or 0.0)
            return Lying(contact.frame, n, level, contact.along, ("contacts", name))
        here = self.robot.state(q, np.zeros(self.robot.nv)).frame(contact.frame).T
        n, z = plane.rotation[:, 2], here.rotation[:, 2]
        height = float(n @ (here.translation - plane.translation)) - (contact.radius or 0.0)
        axis = np.cross(z, n)
        sine = float(np.linalg.norm(axis))
        turn = pin.exp3(axis / max(sine, 1e-12) * math.atan2(sine, float(z @ n)))  # the shortest way
        T = pin.SE3(turn @ here.rotation, here.translation - height * n)
        rows = np.eye(6)[[0, 1, 5] if contact.holds == "all" else [5]]
        return Goal(contact.frame, T, rows, ("contacts", name), plane.rotation)

    def plane(self, name: str) -> pin.SE3 | None:
        """What a round foot stands on, along whose axes its forces are told; None of anything else."""
        ground = self._ground(name, self.spec.contacts[name])
        return None if ground is None or self.spec.contacts[name].sole else self.robot.fixed_pose(ground)

    def distance(self, name: str, q: Array) -> Reading | None:
        """How far the frame of a contact is from where it is held; None where it is not held along one direction."""
        entry = self.spec.contacts[name]
        (place, _), to = self._on(name, entry, q), entry.with_
        if entry.surface is not None and entry.surface.sphere is not None:
            return quantity.from_sphere(entry.frame, place.translation, entry.surface.sphere.radius, to)
        if entry.push is not None:
            outward = -1.0 if entry.push.along.startswith("+") else 1.0
            return quantity.from_plane(entry.frame, place, "xyz".index(entry.push.along[-1]), outward, to)
        linear = [VELOCITY_AXES.index(axis) - 3 for axis in entry.constrained if axis[0] == "v"]
        return quantity.from_plane(entry.frame, place, linear[0], to=to) if len(linear) == 1 else None

    def _contact(self, name: str, entry: specs.Contact, q: Array) -> tuple[Contact, Reference]:
        origin, on = self._on(name, entry, q)
        able = tuple(VELOCITY_AXES[i] for i in movable(self.robot, entry.frame, entry.with_))
        if entry.kind == "free":
            return self._screws(name, entry, origin)
        if entry.kind == "A":
            return MatrixContact(entry.frame, np.array(entry.A or np.zeros((0, 6)))), hold(origin)
        if entry.surface is not None and entry.surface.sphere is not None:
            return self._sphere(name, entry, entry.surface.sphere.radius, origin, on)
        if entry.kind == "natural":
            self._check_table(name, entry, able)
        elif entry.holds != "all":
            self._check_axes(entry.frame, entry.constrained, ("contacts", name, "holds"), able)
        held = able if entry.holds == "all" else entry.constrained
        free = tuple(axis for axis in able if axis not in held)
        contact: Contact = AxesContact(entry.frame, held, free)
        ground = self._ground(name, entry) is not None
        if entry.edge is not None:
            contact = EdgeContact(entry.frame, origin.rotation[:, 2], entry.along, entry.radius or 0.0)
        elif entry.radius is not None or (ground and set(held) == {"vx", "vy", "vz"}):
            contact = RoundFoot(entry.frame, origin.rotation, entry.radius or 0.0)
        elif entry.in_ == "on" or (ground and entry.sole is None):
            contact = WorldAxesContact(entry.frame, held, origin.rotation, free)
        along: dict[int, Scalar] = {}
        for axis in free:
            component, path = VELOCITY_AXES.index(axis), ("contacts", name, "artificial", axis)
            target = entry.motion_targets.get(axis, 0.0)
            along[component] = self._scalar(target, component, path, on or entry.with_ or "world")
            if isinstance(target, str) and self.spec.references[target].kind == "arc":
                # it moves across its heading as well, by turning: what a wheel cannot do, and need not
                along = components(self.spec.references[target]) | along
                self.followed[target].add(VELOCITY_AXES.index("vy"))
        drawn = frozenset(VELOCITY_AXES.index(axis) for axis in free if self._drawn(entry.motion_targets.get(axis)))
        return contact, Path(origin, along, ends=self._ends(entry), placed=drawn)

    def _push(self, name: str, entry: specs.Contact, push: specs.Unilateral, contact: Contact, q: Array) -> None:
        """Where the world only pushes; what friction does there stands in the keys that are at fault."""
        d = (-1.0 if push.along.startswith("-") else 1.0) * np.eye(3)["xyz".index(push.along[-1])]
        state, friction = self.robot.state(q, np.zeros(self.robot.nv)), entry.coulomb
        key = "friction" if entry.feedforward == "modelled" else "pushes"
        origin, on = self._on(name, entry, q)
        flat = on is not None and entry.surface is None and not isinstance(contact, RoundFoot | EdgeContact)
        place = origin.rotation if flat else None
        if entry.sole is not None:
            with self.faults.at("contacts", name, "sole"):
                assert friction is not None
                contact.pushes = Sole(d, entry.sole, friction.mu, push.least, place)
            return
        if entry.edge is not None:
            assert friction is not None
            contact.pushes = Edge(entry.edge, entry.along, friction.mu, push.least)
            return
        with self.faults.at("contacts", name, key):
            if friction is None:
                contact.pushes = unilateral(contact, state, d, push.least, place=place)
            else:
                mu, faces, slip = friction.mu, friction.faces, friction.slip
                contact.pushes = unilateral(contact, state, d, push.least, mu, faces, slip, place)

    def _sphere(
        self, name: str, entry: specs.Contact, radius: float, origin: pin.SE3, on: str | None
    ) -> tuple[Contact, Reference]:
        """The frame keeps its orientation, that of `on`, while what is drawn in the plane is lifted onto the sphere."""
        path = ("contacts", name, "artificial", "motion")
        if on is None:
            message = (
                f"no frame of the scene is named {name!r} or given by `on`; expected one, the centre of the sphere"
            )
            self.faults.add(("contacts", name), message)
        drawn = entry.motion_targets.get("motion")
        along = {axis: self._scalar(drawn, axis, path, on) for axis in (3, 4)} if drawn is not None else {}
        x, y = (along.get(axis, constant(0.0)) for axis in (3, 4))
        curve = SpherePath(origin, radius, x, y, self._ends(entry))
        return SphereContact(entry.frame, origin.translation), curve

    def _check_table(self, name: str, entry: specs.Contact, able: Sequence[str]) -> None:
        named = {*entry.constrained, *entry.free_axes}
        missing = ", ".join(axis for axis in able if axis not in named)
        extra = ", ".join(axis for axis in VELOCITY_AXES if axis in named and axis not in able)
        said = [f"the table says nothing of {missing}"] if missing else []
        said += [f"{self.spec.robot} cannot move along {extra}"] if extra else []
        if said:
            self.faults.add(("contacts", name, "natural"), f"{'; '.join(said)}; expected the axes {', '.join(able)}")

    def _screws(self, name: str, entry: specs.Contact, origin: pin.SE3) -> tuple[Contact, Reference]:
        screws, scalars = [], []
        for label, motion in (entry.free or {}).items():
            screw = motion.screw
            place = origin if screw.through == "self" else self._place(screw.through, entry.with_)
            named = isinstance(screw.axis, str)
            component = "xyz".index(screw.axis) if isinstance(screw.axis, str) else 2
            axis = np.eye(3)[component] if named else np.array(screw.axis) / np.linalg.norm(np.array(screw.axis))
            w = place.rotation @ axis
            p = place.translation - origin.translation
            R = origin.rotation.T  # everything in the axes of the place where the frame is held
            screws.append(np.concatenate((R @ w, R @ (np.cross(p, w) + screw.pitch * w))))
            target, path = entry.motion_targets.get(label, 0.0), ("contacts", name, "artificial", label)
            scalars.append(self._scalar(target, component, path, None))
        contact = ScrewContact(entry.frame, np.array(screws).reshape(-1, 6), origin, tuple(entry.free or ()))
        drawn = any(map(self._drawn, entry.motion_targets.values()))
        return contact, ScrewPath(origin, screws, scalars, pin.SE3.Identity(), self._ends(entry), not drawn)
