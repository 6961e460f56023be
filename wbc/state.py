"""The robot at a tick: all that tasks, contacts and limits read of it, computed once."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
import pinocchio as pin
from eigenpy import LLT

from .frame import Frame, Frames
from .kernels.compiled import Counts
from .qp import Array

if TYPE_CHECKING:
    from .robot import Robot

_NOBODY = np.zeros(0, np.int64)
_NO_STARTS: Mapping[Any, Any] = {}  # never written to
_NO_ROWS: tuple[Array, Array, Array] = (np.zeros((0, 0)), np.zeros((0, 0)), np.zeros((0, 0)))


class Terms:
    """Pinocchio's storage for a robot, and views of what a tick reads of it, made once: each costs as much as its use.

    `named`: frame -> its storage; `held`: contact -> its storage; `pairs`: (frame, what it is seen from) -> how.
    """

    def __init__(self, robot: Robot) -> None:
        self.robot, self.data = robot, robot.model.createData()
        n = robot.model.nv
        # of one joint its one column comes as a vector
        self.M, self.h, self.J = self.data.M.reshape(n, n), self.data.nle, self.data.J.reshape(6, n)
        self.count = 0  # states computed so far
        self.frames = Frames(robot.mounts, self.data, self.J)
        self.named: dict[str, tuple[Frame, Counts]] = {}
        self.batches: dict[tuple[str, ...], tuple[list[Frame], Counts]] = {}
        self.held: dict[Any, Any] = {}
        self.pairs: dict[tuple[str, Any], Any] = {}

    @cached_property
    def mass(self) -> float:
        """Of the whole robot [kg]."""
        return float(self.data.mass[0])

    @cached_property
    def masses(self) -> Array:
        """(3, 3) the same along each axis."""
        return self.mass * np.eye(3)

    @cached_property
    def load(self) -> float:
        """Of what the contacts carry: all that moves with a floating base, be it a robot or a box [kg]."""
        return float(self.data.mass[1 if self.robot.base else 0])

    @cached_property
    def com(self) -> tuple[Array, Array, Array, Array]:
        """The centre of mass (3,), its Jacobian (3, nv), the first joint's axes (3, 3), and gravity (3,)."""
        model, data = self.robot.model, self.data
        return data.com[0], data.Jcom.reshape(3, model.nv), data.oMi[1].rotation, model.gravity.linear

    def add(self, name: str) -> tuple[Frame, Counts]:
        """Storage of a frame. Raises NameNotFound."""
        index = self.robot.frame_id(name)
        self.named[name] = found = (self.frames.frame(index), np.array([index]))
        return found

    def batch(self, names: tuple[str, ...]) -> tuple[list[Frame], Counts]:
        """The same of several. Raises NameNotFound."""
        found = [self.named.get(name) or self.add(name) for name in names]
        self.batches[names] = batch = ([frame for frame, _ in found], np.concatenate([_NOBODY, *(i for _, i in found)]))
        return batch


class State:
    """Everything about the robot that a tick may read, computed once: M vdot + bias = tau - J' F.

    Attributes: t [s], dt [s], q (nq,), v (nv,), M (nv, nv), h (nv,) with Coriolis, centrifugal, gravity and joint
    damping; `bias` (nv,) [N m], h and the torque of wrenches that are known. `frame(name)` is a `Frame`. `contacts`,
    `measured`, `targets`, `loops` and `felt` are filled by the controller: what the contacts demand, the wrenches
    measured (6,), the targets set from outside, the force loops' memory, and what tasks feel of a push; `primary` is
    (G, W, K), all rows of contacts and motion tasks, their inertia and mobility: the posture stays out of them;
    `starts`: task -> `Start`, how its reference was taken up, for those that began after the run did; `grounds`:
    contact -> how far above its plane a foot has found the floor [m]; `followed`: contact -> what is followed of the
    target of its force, (k,); `gave`: what of a task gives way at this tick -> why; `released`: contact that is lost
    -> `Released`. Valid until the next state is computed from the same `terms`.
    """

    __slots__ = (
        "M",
        "_L",
        "bias",
        "contacts",
        "count",
        "dt",
        "felt",
        "followed",
        "gave",
        "grounds",
        "h",
        "loops",
        "measured",
        "primary",
        "q",
        "released",
        "robot",
        "starts",
        "t",
        "targets",
        "terms",
        "v",
    )

    def __init__(self, terms: Terms, q: Array, v: Array, t: float = 0.0, dt: float = 1e-3) -> None:
        robot = terms.robot
        self.robot, self.terms, self.t, self.dt, self.q, self.v = robot, terms, t, dt, q, v
        pin.computeAllTerms(robot.model, terms.data, q, v)
        self.count = terms.count = terms.count + 1
        self.M: Array = terms.M
        self.h: Array = terms.h if robot.damping is None else terms.h + robot.damping * v
        self.bias = self.h
        self.contacts: dict[str, Any] = {}
        self.measured: dict[str, Array] = {}
        self.targets: dict[str, float] = {}
        self.loops: dict[str, Any] = {}
        self.felt: dict[Any, Any] = {}
        self.primary: tuple[Array, Array, Array] = _NO_ROWS
        self.starts: Mapping[Any, Any] = _NO_STARTS
        self.grounds: Mapping[Any, float] = _NO_STARTS
        self.followed: dict[str, Array] = {}
        self.gave: dict[str, str] = {}
        self.released: Mapping[str, Any] = _NO_STARTS
        self._L: Any = None

    def frame(self, name: str) -> Frame:
        """The frame of that name. Raises NameNotFound."""
        terms = self.terms
        found, index = terms.named.get(name) or terms.add(name)
        if found.of != self.count:
            found.of, found._T = self.count, None
            terms.frames.fill(index, self.v)
        return found

    def prepare(self, names: tuple[str, ...]) -> None:
        """Compute frames that will be asked for in one call. Raises NameNotFound."""
        terms = self.terms
        found, indices = terms.batches.get(names) or terms.batch(names)
        for frame in found:
            frame.of, frame._T = self.count, None
        terms.frames.fill(indices, self.v)

    def carry(self, frame: str | Frame, F: Array) -> None:
        """Count a known wrench F (6,) of the robot on its environment, in the axes of `frame`: bias + J' F."""
        self.bias = self.bias + (self.frame(frame) if isinstance(frame, str) else frame).J.T.dot(F)

    def since(self, task: Any) -> float:
        """Time that a task has been active [s], on which its targets are functions."""
        start = self.starts.get(task)
        return self.t if start is None else self.t - float(start.t)

    def solve_M(self, B: Array) -> Array:
        """M^-1 B by Cholesky, factored once a tick."""
        if self._L is None:
            self._L = LLT(self.M)
        return self._L.solve(B).reshape(B.shape)  # eigenpy answers one column as a vector

    def gravity(self) -> Array:
        """(nv,) g(q) [N m]."""
        return pin.computeGeneralizedGravity(self.robot.model, self.terms.data, self.q)
