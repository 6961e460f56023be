"""The hard constraints of a tick by the names that people know them by, and which of them conflict."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from .conflict import System
from .dynamics import inertia, mobility
from .qp import Array

if TYPE_CHECKING:
    from .controller import Tick

MORE = 2  # further conflicts that are named


class Culprit(NamedTuple):
    """A constraint of a conflict: `side` ("least", "most" or "exactly") and its `bound` in `unit`. `frees`: whether the
    whole tick has an answer without it; then `needs` is by how much it must give way, alone, in its unit (else inf).

    Of joint limits the bound is that of the acceleration which keeps them; `told` says at which position and speed.
    """

    name: str
    side: str
    bound: float
    unit: str
    needs: float
    frees: bool
    told: str = ""


class _Row(NamedTuple):
    name: str
    unit: str
    C: Array  # (n,)
    lo: float
    hi: float
    bias: float = 0.0  # what its bounds are told with
    per: float = 1.0  # its unit over that of the row
    told: str = ""


class Hard:
    """All hard constraints of a tick; `dt` [s]. `system` has their rows, the dynamics of a floating base beside."""

    def __init__(self, tick: Tick, dt: float) -> None:
        self._tick, self._dt, self._workspace = tick, dt, tick.program.strict
        self._n = self._workspace.problem.g.size
        self.rows = [*self._contacts(), *self._pushes(), *self._torques(), *self._joints(), *self._distances()]
        base = self._workspace.stored.get("base")
        E, e = (np.zeros((0, self._n)), np.zeros(0)) if base is None else (self._block("base"), base.lo)
        C = np.array([row.C for row in self.rows]).reshape(-1, self._n)
        lo, hi = (np.array([row[i] for row in self.rows]) for i in (3, 4))
        self.system = System(C, lo, hi, [row.name for row in self.rows], E, e)

    @property
    def yielding(self) -> set[str]:
        """Names of what gives way where nothing satisfies all: joint limits and distances."""
        kinds = ("position[", "velocity[", "acceleration[", "collision[")
        return {name for name in self.system.names if name.startswith(kinds)}

    def conflict(self) -> tuple[tuple[Culprit, ...], tuple[tuple[str, ...], ...]]:
        """A conflict, and the names of others; first of what never yields, for there is no answer then."""
        system, yielding, others = self.system, self.yielding, list[tuple[str, ...]]()
        among = [name for name in system.names if name not in yielding]
        members = system.members(among) or system.members()
        if members and not any(each.frees for each in members):
            left = [name for name in system.names if name != members[0].name]
            while len(others) < MORE and (more := system.conflict(left)):
                others.append(more)
                left.remove(more[0])
        return tuple(self._culprit(*each) for each in members), tuple(others)

    def _culprit(self, name: str, number: int, upper: bool, needs: float, frees: bool) -> Culprit:
        row = self.rows[number]
        side = "exactly" if row.lo == row.hi else "most" if upper else "least"
        bound = (row.hi if upper else row.lo) + row.bias
        return Culprit(name, side, row.per * float(bound), row.unit, row.per * needs, frees, row.told)

    def _block(self, name: str) -> Array:
        return self._workspace.coefficients(name)

    def _contacts(self) -> list[_Row]:
        """What the contacts hold: axis by axis, or whole where they hold more than it takes."""
        state, workspace, phase = self._tick.state, self._workspace, self._tick.program.phase
        whole = workspace.stored.get("contacts")
        if whole is None or "contacts" in phase.contacts:
            found = []
            for name, contact in phase.contacts.items():
                stored, C = workspace.stored[name], self._block(name)
                for i, (label, axis) in enumerate(zip(contact.labels(name), contact.axes, strict=True)):
                    unit = "rad/s^2" if axis.startswith("m") else "m/s^2"
                    found.append(_Row(label, unit, C[i], stored.lo[i], stored.hi[i]))
            return found
        if state.count != state.terms.count:  # a later state stands in the storage of what each of them holds
            C = self._block("contacts")
            return [_Row("contacts", "m/s^2", C[i], b, b) for i, b in enumerate(whole.lo)]
        held = list(state.contacts.values())
        G, rhs = np.concatenate([each.G for each in held]), np.concatenate([each.rhs for each in held])
        K = mobility(state, G)
        rhs = K.dot(inertia(K).dot(rhs))  # as the independent rows have it: contradictions are gone
        C = np.zeros((len(G), self._n))
        C[:, workspace.variables.slices["vdot"]] = G
        names = [name for name, each in state.contacts.items() for _ in each.rhs]
        return [_Row(name, "m/s^2", C[i], rhs[i], rhs[i]) for i, name in enumerate(names)]

    def _pushes(self) -> list[_Row]:
        found = []
        for name in self._tick.program.pushing:
            rows, C = self._workspace.stored[f"{name}.push"], self._block(f"{name}.push")
            for i, label in enumerate(rows.labels):
                unit = "N m" if label.endswith((".pressure", ".yaw", ".ends")) else "N"
                found.append(_Row(label, unit, C[i], rows.lo[i], rows.hi[i]))
        return found

    def _torques(self) -> list[_Row]:
        """The torque itself and, apart from it, its rate."""
        program, limit, C = self._tick.program, self._tick.program.phase.torque, self._block("torque")
        rows, found = self._workspace.stored["torque"], list[_Row]()
        with np.errstate(invalid="ignore"):  # of limits that bind nothing
            sides = np.array([program.window[0] - rows.lo, program.window[1] - rows.hi, np.zeros(rows.lo.size)])
        bias = sides[np.argmax(np.isfinite(sides), axis=0), np.arange(rows.lo.size)]
        for i, joint in enumerate(limit.joints):
            found.append(
                _Row(f"torque[{joint}]", "N m", C[i], limit.low[i] - bias[i], limit.high[i] - bias[i], bias[i])
            )
            if np.isfinite(limit.rate[i]):
                past, step = self._tick.tau_last[i] - bias[i], limit.rate[i] * self._dt
                more = (-past, 1.0 / self._dt)
                found.append(_Row(f"torque_rate[{joint}]", "N m/s", C[i], past - step, past + step, *more))
        return found

    def _joints(self) -> list[_Row]:
        """Each side by the limit that binds there, and the acceleration's own where there is one."""
        program, state = self._tick.program, self._tick.state
        limit, rows, base = program.phase.joint, self._workspace.stored.get("joint"), self._tick.state.robot.base
        found: list[_Row] = []
        if limit is None or rows is None:
            return found
        first, coordinate = self._workspace.variables.slices["vdot"].start + base, 7 if base else 0
        for i, joint in enumerate(limit.joints):
            C = np.zeros(self._n)
            C[first + i] = 1.0
            told = f"at {state.q[coordinate + i]:.4g} rad, {state.v[base + i]:.3g} rad/s"
            for upper, bound in ((True, rows.hi[base + i]), (False, rows.lo[base + i])):
                name = limit.name(i, upper, state.q, bound)
                lo, hi = (-np.inf, bound) if upper else (bound, np.inf)
                if np.isfinite(bound):
                    found.append(_Row(name, "rad/s^2", C, lo, hi, told=told))
            if np.isfinite(most := limit.a_max[i]):
                found.append(_Row(f"acceleration[{joint}]", "rad/s^2", C, -most, most, told=told))
        return found

    def _distances(self) -> list[_Row]:
        rows, collision = self._workspace.stored.get("collision"), self._tick.program.phase.collision
        if rows is None or collision is None:
            return []
        C, state = self._block("collision"), self._tick.state
        bound = np.flatnonzero(np.isfinite(rows.lo))
        return [_Row(collision.name(int(i), state), "m/s^2", C[i], rows.lo[i], np.inf) for i in bound]
