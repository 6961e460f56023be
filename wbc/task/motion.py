"""Motion of a frame in SE(3) by computed torque, and its errors."""

from __future__ import annotations

from typing import Any

import numpy as np
import pinocchio as pin

from .. import kernels
from ..analytic import gain_matrix
from ..contact import Held
from ..dynamics import inertia, mobility
from ..errors import GainError
from ..frame import Frame
from ..qp import Array, Rows
from ..reference import Reference, Sample
from ..singular import LEAST
from ..state import State
from ..wrench import VELOCITY_AXES
from .following import SPEEDS, Following

_ORDER = np.array([3, 4, 5, 0, 1, 2])


def computed_torque(frame: Frame, desired: Sample, K: Array) -> Array:
    """(6,) y = d/dt(Ad V_d) + Kp X_e + Kd V_e in the axes of the frame (book 11.37), [rad/s^2, m/s^2].

    `K` (6, 12) is [Kp, Kd].
    """
    y = np.empty(6)
    kernels.computed_torque(frame.R, frame.p, frame.V, desired.R, desired.p, desired.motion, K, y)
    return y


def pose_errors(T: pin.SE3, V: Array, desired: Sample, split: bool = False) -> tuple[Array, Array, Array]:
    """(6,), (6,), (6,): X_e, V_e = Ad V_d - V and d/dt(Ad V_d), in the axes of a frame at T that moves with V.

    X_e = log(T^-1 T_d) and Ad = Ad_{T^-1 T_d} (book 11.37) turn and move along one screw. `split` has the rotation's
    logarithm beside the straight way between the origins, R'(p_d - p), and with it Ad = blkdiag(R'R_d, R'R_d).
    """
    X_e, V_e, ahead = np.empty(6), np.empty(6), np.empty(6)
    kernels.pose_errors(T.rotation, T.translation, V, desired.R, desired.p, desired.motion, split, X_e, V_e, ahead)
    return X_e, V_e, ahead


class MotionTask(Following):
    """SE(3) motion of a frame by computed torque, on selected axes.

    Parameters: `frame`; `reference` (t -> Sample); `kp` [1/s^2], `kd` [1/s]: numbers, vectors over the axes or
    matrices; `axes`: names from wx ... vz, or with `contact` the free motion of that contact. `law="book"` tracks the
    raw y on all axes that the robot has, in the metric M_C, as the book prints it; otherwise y is only asked of the
    free axes, where the constraint says A y = -Adot V. `error`: "log", or "split" for straight lines (`pose_errors`).
    `singular`, `jump`: as of `Following`.
    """

    def __init__(
        self,
        frame: str,
        reference: Reference,
        kp: Any = 100.0,
        kd: Any = 20.0,
        axes: tuple[str, ...] = VELOCITY_AXES,
        contact: str | None = None,
        law: str = "compensated",
        robot_axes: tuple[int, ...] = (0, 1, 2, 3, 4, 5),
        error: str = "log",
        singular: float = LEAST,
        jump: tuple[float, float] | None = SPEEDS,
    ) -> None:
        super().__init__(reference, singular, jump)
        self.frame, self.axes, self.contact = frame, axes, contact
        self.split = error == "split"
        self.raw = law == "book" and contact is not None  # tracks the raw y of the book on all axes
        self._S = None if contact is not None else np.eye(6)[[VELOCITY_AXES.index(a) for a in axes]]
        self.robot_axes = list(robot_axes)
        self.Kp, self.Kd = self._lift(kp, "kp"), self._lift(kd, "kd")
        self._K = np.hstack((self.Kp, self.Kd))

    @property
    def selection(self) -> Array:
        """(s, 6) rows that pick the task's axes, for a task without a contact."""
        return np.eye(6) if self._S is None else self._S

    def _lift(self, K: Any, name: str) -> Array:
        """Gains over the selected axes as a (6, 6) matrix; a number also holds the other axes, as in the book."""
        if np.ndim(K) == 0:
            return gain_matrix(K, 6, name)
        small = gain_matrix(K, len(self.axes), name)
        if self._S is None and not set(self.axes) <= set(VELOCITY_AXES):
            raise GainError(
                f"{name}: a vector or matrix needs axes with names, expected a number for the free motion of screws"
            )
        S = np.eye(6)[[VELOCITY_AXES.index(a) for a in self.axes]]
        return S.T @ small @ S

    def seen(self, state: State) -> Frame:
        """The frame as its reference is told: in the world, on a contact as what holds it sees it."""
        held: Held | None = state.contacts.get(self.contact) if self.contact is not None else None
        return held.seen if held is not None and held.frame == self.frame else state.frame(self.frame)

    def along(self, state: State) -> Array:
        """(s,) X_e, with [X_e] = log(T^-1 T_d), along the rows that pick the task's axes [rad, m]."""
        X_e = pin.log6(self.seen(state).T.actInv(self.followed(state).T)).vector[_ORDER]
        return np.asarray(self._select(state) @ X_e, float)

    def lift(self, state: State) -> Array:
        """(6, s) from what is along those rows to the axes of the frame."""
        return self.selection.T if self.contact is None else np.asarray(state.contacts[self.contact].lift)

    def error(self, state: State) -> Array:
        """(6,) X_e on the task's axes alone [rad, m]."""
        return np.asarray(self.lift(state) @ self.along(state), float)

    def _select(self, state: State) -> Array:
        rows: Array = self.selection if self.contact is None else state.contacts[self.contact].free
        return rows

    def acceleration(self, state: State) -> Array:
        """(6,) y in the axes of the frame [rad/s^2, m/s^2]."""
        frame, desired = self.seen(state), self.followed(state)
        if not self.split:
            return computed_torque(frame, desired, self._K)
        X_e, V_e, ahead = pose_errors(frame.T, frame.V, desired, split=True)
        return np.asarray(ahead + self.Kp @ X_e + self.Kd @ V_e)

    def target(self, state: State) -> tuple[Array, Array]:
        """The task's own rows G vdot = b: (s, nv) and (s,)."""
        frame = self.seen(state)
        y = self.acceleration(state)
        if self.raw:
            return frame.J[self.robot_axes], (y - frame.drift)[self.robot_axes]
        S = self.selection if self.contact is None else state.contacts[self.contact].free
        selected, bias, b = np.empty((len(S), frame.table.shape[1])), np.empty(len(S)), np.empty(len(S))
        kernels.select(S, frame.table, selected, bias)
        kernels.wanted(S, y, bias, b)
        return selected[:, :-2], b

    def stack(self, state: State) -> tuple[Array, Array]:
        """G vdot = b with the contacts' rows first: they hold anyway, and with them the metric of the rows is the
        inertia that the constrained robot shows. Under the book's law the raw rows alone."""
        if not self.raw and len(state.contacts) == 1 and self.contact is not None:
            held: Held = state.contacts[self.contact]
            b = np.empty(held.bias.size)
            kernels.wanted(held.free, self.acceleration(state), held.bias, b)
            return held.stack, b
        G, b = self.target(state)
        if not self.raw:
            G = np.concatenate([held.G for held in state.contacts.values()] + [G])
            b = np.concatenate([held.rhs for held in state.contacts.values()] + [b])
        return G, b

    def rows(self, state: State) -> Rows:
        G, b = self.stack(state)
        K = mobility(state, G)
        W = inertia(K)
        state.primary = (G, W, K)
        return Rows("", {"vdot": G}, b, b, W)
