"""One frame of the robot seen from another: what a relative pose is told by, and contacts of body against body."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from .axes import VELOCITY_AXES
from .frame import Frame
from .kernels import relative
from .robot import Robot
from .state import State


class RelativeFrame(Frame):
    """One frame seen from another: T = T_to^-1 T_frame, and the twist of the first against the second, in its own axes.

    V = V_frame - Ad V_to with Ad = Ad_{T^-1}, and drift = drift_frame - Ad drift_to + ad_V (Ad V_to). A wrench F of the
    first on the second loads the joints with J' F, for it acts on both.
    """

    __slots__ = ("_ends",)

    def __init__(self, frame: Frame, to: Frame) -> None:
        super().__init__(np.empty((3, 3)), np.empty(3), np.empty(frame.table.shape))
        self._ends = frame, to
        self.update()

    def update(self) -> None:
        """From both frames as they are now."""
        frame, to = self._ends
        self._T = None
        relative(frame.R, frame.p, frame.table, to.R, to.p, to.table, self.R, self.p, self.table)


def seen(state: State, frame: str, to: str | None) -> Frame:
    """A frame as it is seen from another one, or from the world; computed once a tick. Raises NameNotFound."""
    if to is None:
        return state.frame(frame)
    pairs = state.terms.pairs
    found: RelativeFrame | None = pairs.get((frame, to))
    ends = state.frame(frame), state.frame(to)
    if found is None:
        found = pairs[frame, to] = RelativeFrame(*ends)
    elif found.of != state.count:
        found.update()
    found.of = state.count
    return found


def movable(robot: Robot, frame: str, to: str | None) -> tuple[int, ...]:
    """Indices 0 .. 5 of the axes along which the robot can ever move a frame against another one, or the world."""
    if to is None:
        return robot.axes(frame)
    return tuple(VELOCITY_AXES.index(axis) for axis in relative_axes(robot, frame, to))


def relative_axes(robot: Robot, frame: str, to: str, states: int = 8) -> tuple[str, ...]:
    """Axes of `frame` along which the robot can ever move it against `to`: none of two frames of one link."""
    rng, reach = np.random.default_rng(0), np.zeros(6)
    for _ in range(states):
        q = pin.integrate(robot.model, robot.keyframes["home"], rng.uniform(-1.5, 1.5, robot.nv))
        state = robot.state(q, np.zeros(robot.nv))
        reach = np.maximum(reach, np.abs(seen(state, frame, to).J).max(axis=1))
    return tuple(axis for axis, most in zip(VELOCITY_AXES, reach, strict=True) if most > 1e-9)
