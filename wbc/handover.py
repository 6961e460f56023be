"""What one phase leaves to the next, so that nothing jumps: references that go on or are taken up, force loops.

A motion task whose reference goes on is left alone. One that begins takes its reference up where the robot is: along
axes on which the reference says only how to move, for good; along the others the pose and the twist of the frame lead
into it. A force loop that begins asks first for what the last torque already presses with; its integral then leads to
the target.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from .dynamics import reaction
from .lead import SLOPE, Lead, fall, run
from .program import Program
from .qp import Array
from .reference import ALL_AXES, Reference, Sample, advanced, seen_from
from .state import State
from .task import Task
from .task.centroidal import ComTask, DistributionTask, com, middle
from .task.force import ForceLoop, ForceTask

FADE = 0.5  # [s] in which what was between the robot and its reference fades out, or longer:
FADE_SPEED, FADE_TURN = 0.1, 0.5  # [m/s], [rad/s] no faster than this
SHARING = "distribution"  # of the contacts, where no task says it
NOTHING = 1e-9  # [m, rad, m/s, rad/s] of difference
_ORDER = [3, 4, 5, 0, 1, 2]


class Start(NamedTuple):
    """When and how a task began under way.

    What it follows is `shift` T_d(s) `offset` exp([S_1] a(s)) exp([S_2] b(s)), s = t - t_0 with t_0 = `t`. The two
    `screws` (2, 6) undo the difference in pose, then that in twist, at s = 0: a falls from 1 to 0; b, 0 with a slope of
    1, comes back to 0. Both are quintics that come to rest at s = `fade`.
    """

    t: float = 0.0  # [s] on the clock of `State.t`
    shift: pin.SE3 | None = None
    offset: pin.SE3 | None = None
    screws: Array | None = None
    fade: float = 0.0  # [s]
    loads: Mapping[str, Array] = {}  # multipliers that the contacts had, of what shares them from now on
    lead: Lead | None = None  # into a reference that has jumped since

    @property
    def settles(self) -> float:
        """When nothing is left of how the task began, and of jumps since [s after it began]."""
        return self.fade if self.lead is None else max(self.fade, self.lead.ends - self.t)

    def sample(self, reference: Reference, t: float) -> Sample:
        """What is followed at time t [s]."""
        sample = self._begun(reference, t)
        return sample if self.lead is None else self.lead.onto(sample, t)

    def _begun(self, reference: Reference, t: float) -> Sample:
        """The same, but for a jump of the reference since."""
        s = t - self.t
        sample = reference(s)
        if self.shift is not None:
            sample = Sample(self.shift * sample.T, sample.motion)
        if self.offset is not None:
            sample = Sample(sample.T * self.offset, seen_from(self.offset, sample.motion))
        if self.screws is None or s >= self.fade:
            return sample
        T, u = self.fade, max(s / self.fade, 0.0)
        a, b = fall(u, T), run(u, T)
        return advanced(self.screws[1], *b, advanced(self.screws[0], *a, sample))


def take_up(reference: Reference, t: float, T: pin.SE3, V: Array, start: Start | None = None) -> Start:
    """The start at time t [s] of a reference that a frame at pose T with body twist V (6,) takes up.

    `start`: where the reference is shifted to; by default where it says that it has no place of its own.
    """
    start = (_placed(reference, T) if start is None else start)._replace(t=t)
    desired = start.sample(reference, t)
    X = desired.T.actInv(T)
    pose, twist = _vector(X), V - seen_from(X, desired.motion)[:, 0]
    if max(np.abs(pose).max(), np.abs(twist).max()) <= NOTHING:
        return start
    far = max(float(np.linalg.norm(pose[3:])) / FADE_SPEED, float(np.linalg.norm(pose[:3])) / FADE_TURN)
    return start._replace(screws=np.array([pose, twist]), fade=max(FADE, SLOPE * far))


def _com_taken_up(task: ComTask, state: State) -> Start:
    """The start of a path of the centre of mass, over the contacts as they stand now."""
    c, J, _ = com(state)
    T, V = pin.SE3(np.eye(3), c.copy()), np.concatenate((np.zeros(3), J.dot(state.v)))
    if not task.over:
        return take_up(task.reference, state.t, T, V)
    away = middle(state, task.over) - task.reference(0.0).T.translation
    away[2] = 0.0
    return take_up(task.reference, state.t, T, V, Start(shift=_unless_nothing(pin.SE3(np.eye(3), away))))


def _placed(reference: Reference, T: pin.SE3) -> Start:
    """What has no place of its own takes that of the frame, for good."""
    here = reference(0.0).T
    if getattr(reference, "relative", False):
        return Start(shift=_unless_nothing(T * here.inverse()))
    placed = getattr(reference, "placed", ALL_AXES)
    if placed == ALL_AXES:
        return Start()
    R = reference.origin.rotation  # type: ignore[attr-defined]
    away = R.T @ (T.translation - here.translation)
    away[[axis - 3 for axis in placed if axis > 2]] = 0.0
    turn = np.eye(3) if placed & {0, 1, 2} else here.rotation.T @ T.rotation
    shift, offset = pin.SE3(np.eye(3), R @ away), pin.SE3(turn, np.zeros(3))
    return Start(shift=_unless_nothing(shift), offset=_unless_nothing(offset))


def _unless_nothing(X: pin.SE3) -> pin.SE3 | None:
    return X if np.abs(_vector(X)).max() > NOTHING else None


def _vector(X: pin.SE3) -> Array:
    """(6,) log X, angular part first."""
    return np.asarray(pin.log6(X).vector[_ORDER], float)


def hand_over(
    before: Program,
    after: Program,
    state: State,
    starts: Mapping[str, Start],
    loops: Mapping[str, ForceLoop],
    tau: Array,
    lam: Mapping[str, Array] | None = None,
) -> tuple[dict[str, Start], dict[str, ForceLoop]]:
    """Starts by task and force loops by contact of the phase that begins.

    `state` has the contacts of the new phase, and the wrenches measured; `tau` (nv,) is the last torque [N m],
    `lam` the last multipliers by contact.
    """
    begun: dict[str, Start] = {}
    for name, task in after.phase.tasks.items():
        if _goes_on(before.phase.tasks.get(name), task, before.phase.contacts):
            if name in starts:
                begun[name] = starts[name]
        elif isinstance(task, ComTask):
            begun[name] = _com_taken_up(task, state)
        elif (reference := getattr(task, "reference", None)) is not None:
            seen = getattr(task, "seen", None)
            frame = state.frame(task.frame) if seen is None else seen(state)  # type: ignore[attr-defined]
            begun[name] = take_up(reference, state.t, frame.T, frame.V)
        else:
            begun[name] = Start(state.t, loads=lam or {})
    if state.robot.base:
        begun[SHARING] = Start(state.t, loads=lam or {})
    state.starts = after.named(begun)
    kept = {name: loop for name, loop in loops.items() if name in before.phase.contacts and name in after.force}
    lam = reaction(state, tau) if set(after.force) - set(kept) else {}
    made = {}
    for contact, (_, task) in after.force.items():
        if contact not in kept:
            made[contact] = task.begin(state, lam[contact])
        else:
            made[contact] = _resumed(kept[contact], before.force.get(contact, ("", task))[1], task)
    return begun, made


def _goes_on(old: Task | None, task: Task, contacts: Mapping[str, object]) -> bool:
    """Whether a task of the last phase is the same motion, or presses on the same contact, in this one."""
    if old is None or type(old) is not type(task):
        return False
    if isinstance(task, ForceTask):
        return task.contact in contacts and getattr(old, "contact", None) == task.contact
    if isinstance(task, DistributionTask):
        return False  # the contacts may be others
    if (reference := getattr(task, "reference", None)) is None:
        return True
    place = all(getattr(old, key, None) == getattr(task, key, None) for key in ("frame", "over"))
    return place and getattr(old, "reference", None) is reference


def _resumed(loop: ForceLoop, old: ForceTask, task: ForceTask) -> ForceLoop:
    """A loop that goes on with other gains: its integral's part of the command stays."""
    if task is old or np.array_equal(task.Ki, old.Ki) or loop.integral.size != len(task.Ki):
        return loop
    return loop._replace(integral=task.integral_for(old.Ki @ loop.integral))
