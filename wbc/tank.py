"""Energy tanks: what bounds the energy that a task brings in by what it was given and what it has dissipated.

A spring of constant stiffness, a damper, a force against a wall at rest bring none in; a force that something gives way
to, a spring that is made stiffer while it is bent, an answer that comes late do. A tank pays for that, and is filled by
what dissipates, up to `most` (Ferraguti, Secchi and Fantuzzi 2013; Franchi and Schindlbeck with Haddadin 2015). Over a
tick in which a task moved by dx along its axes while it pressed with f,

    E+ = min(E - f'dx - (U+ - U), most),     U = x'K x / 2 of its spring, where it has one

is exact, for dx is what was measured, not v dt of a prediction. Three things keep E above zero:

- stiffness is paid before it acts, x'(K+ - K) x / 2 for K+ at the pose of the tick: what cannot be paid waits, and what
  becomes softer gives back;
- below `RESERVE` of the first filling the valve closes in proportion, on a force and on the push that is answered;
- there a spring that still costs is let go, and gives back what it holds.

A torque that acts late, or a wrench that is measured late, costs what this sum does not see. So the dearest of the last
`ticks` forces is charged, or the least of what was got for the wrench, which pays for any delay up to that many ticks.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from .errors import GainError
from .kernels import costliest
from .qp import Array

RESERVE = 0.1  # of the first filling: below, the valve closes
LET_GO = 0.01  # [s] in which a spring that costs gives back what it holds
AHEAD = 2.0  # the valve leaves this many times what the forces under way cost at the speed of the tick
_NOTHING: Array = np.zeros(0)


class Tank(NamedTuple):
    """The memory of a tank, a value. Of a force only the first four are used."""

    energy: float  # [J]
    valve: float = 1.0  # what it lets pass [1]
    limited: bool = False  # whether the task yields something
    forces: Array = _NOTHING  # (n, s) along the axes, newest first [N, N m]
    moves: Array = _NOTHING  # (n, s) of the frame in the last ticks, newest first [m, rad]
    x: Array = _NOTHING  # (s,) pose error [m, rad]
    K: Array = _NOTHING  # (s, s) stiffness as it acts [N/m, N m/rad]


class Bounded:
    """What a tank begins with and holds at most [J], and up to how many `ticks` late torques and wrenches are."""

    def __init__(self, energy: float, most: float | None = None, ticks: int = 0) -> None:
        self.energy, self.most, self.ticks = float(energy), float(energy if most is None else most), int(ticks)
        if not (0.0 < self.energy <= self.most < np.inf) or self.ticks < 0:
            told = f"got {energy:g} J of {self.most:g} J, {ticks} ticks"
            raise GainError(f"tank: expected an energy above 0, no more than it holds, and ticks of at least 0; {told}")
        self._reserve = RESERVE * self.energy

    def _open(self, energy: float) -> float:
        return min(max(energy / self._reserve, 0.0), 1.0)

    def _settled(self, energy: float) -> float:
        return energy if energy < self.most else self.most

    # --- a force, along axes on which something may give way ---

    def press(self, tank: Tank | None, driven: Array, rate: Array, dt: float) -> Tank:
        """The tank of a tick before the force `driven` (s,) that would act, damping aside, at the `rate` (s,) of the
        axes. That rate is the mean one of the last tick but for half of what it changed, and noise of it cannot have
        been in the forces of then."""
        if tank is None:
            return Tank(self.energy, forces=np.zeros((self.ticks + 1, rate.size)))
        energy = self._settled(tank.energy - dt * costliest(tank.forces, rate))
        dear = max(costliest(tank.forces, rate), float(driven.dot(rate)))
        cost = AHEAD * (self.ticks + 1) * dt * dear
        valve = self._open(energy)
        if cost > energy:
            valve = min(valve, max(energy / cost, 0.0))
        return tank._replace(energy=energy, valve=valve, limited=valve < 1.0)

    # --- a spring and damper, and the push that moves it ---

    def comply(
        self, tank: Tank | None, x: Array, wanted: Array, damping: Array, push: Array | None, move: Array, dt: float,
        late: bool,
    ) -> Tank:  # fmt: skip
        """The tank of a tick, of a mass at the pose error x (s,) whose spring is `wanted` to have the stiffness (s, s).

        `damping` (s,) is the force beside the spring, `push` (s,) what is felt to push, `move` (s,) what the frame has
        gone in the last tick; `late`: whether the mass is the arm, which the motors move after a delay.
        """
        size = x.size
        if tank is None or tank.x.size != size:
            late_forces = np.zeros((self.ticks + 1 if late else 1, size))
            tank = Tank(self.energy, forces=late_forces, moves=np.zeros((self.ticks + 1, size)), x=x, K=wanted)
        K, went, valve = tank.K, tank.x - x, 1.0
        spent = costliest(tank.forces, went) + 0.5 * float(x.dot(K.dot(x)) - tank.x.dot(K.dot(tank.x)))
        moves = tank.moves
        if push is not None:
            moves = _newest(move, moves)
            spent += costliest(-moves, push)  # the push was felt while the frame went one of these ways
        energy = self._settled(tank.energy - spent)
        energy, K, limited = self._stiffened(energy, K, wanted, x, spent, dt)
        force = K.dot(x) + damping
        if push is not None:
            valve = self._open(energy)
            limited = limited or valve < 1.0
            force = force + valve * push
        return Tank(energy, valve, limited, _newest(force, tank.forces), moves, x, K)

    def _stiffened(
        self, energy: float, K: Array, wanted: Array, x: Array, spent: float, dt: float
    ) -> tuple[float, Array, bool]:
        """The energy and the stiffness after a step towards the one that is wanted, and whether it falls short."""
        if energy < self._reserve and spent > 0.0:  # it costs as it is
            held = 0.5 * float(x.dot(K.dot(x)))
            share = min(1.0, dt / LET_GO) * (1.0 - self._open(energy))
            return energy + share * held, (1.0 - share) * K, True
        if K is wanted or (wanted == K).all():
            return energy, wanted, False
        cost = 0.5 * float(x.dot((wanted - K).dot(x)))
        if cost <= 0.0:
            return self._settled(energy - cost), wanted, False
        share = (energy - self._reserve) / cost
        if share >= 1.0:
            return energy - cost, wanted, False
        share = max(share, 0.0)
        return energy - share * cost, K + share * (wanted - K), True


def _newest(row: Array, rows: Array) -> Array:
    """Rows with another one before them, and without the last."""
    moved = np.empty_like(rows)
    moved[0], moved[1:] = row, rows[:-1]
    return moved


def pressed(tank: Tank, force: Array) -> Tank:
    """The tank after a tick that asked for a force (s,), as the limits allowed it."""
    return tank._replace(forces=_newest(force, tank.forces))
