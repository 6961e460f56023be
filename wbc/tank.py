"""Energy tanks: what bounds the energy that a task brings in by what it was given and what it has dissipated.

A spring of constant stiffness, a damper, a force against a wall at rest bring none in; a force that something gives way
to, a spring that is made stiffer while it is bent, an answer that comes late do. A tank pays for that, and is filled by
what dissipates, up to `most` (Ferraguti, Secchi and Fantuzzi 2013; Schindlbeck and Haddadin 2015). Over a tick in which
a task moved by dx along its axes while it pressed with f,

    E+ = min(E - f'dx - (U+ - U), most),     U = x'K x / 2 of its spring, where it has one

is exact, for dx is what was measured, not v dt of a prediction. Where a wrench moves a mass, the same wrench has
brought in what the frame went under it. What keeps E above zero:

- stiffness is paid before it acts, x'(K+ - K) x / 2 for K+ at the pose of the tick: what cannot be paid waits, and what
  becomes softer gives back;
- a force is not larger than can be paid if all that it presses on gives way, p'v + p'W p / 2 for the momentum p that is
  under way, a spring not stiffer than its lag can be paid, v'K v d^2 for a delay d (both `AHEAD` times);
- below `RESERVE` of the first filling the valve closes in proportion, on forces and on the push that is answered, what
  still costs is let go, and the motion is braked.

A torque that acts late, or a wrench that is measured late, costs what this sum does not see. So there is a sum for each
delay up to `ticks`, which pairs the way of a tick with the force of so many ticks ago, and the least of them counts: no
constant delay up to that one costs more.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from .errors import GainError
from .qp import Array

RESERVE = 0.1  # of the first filling: below, the valve closes
LET_GO = 0.01  # [s] in which a spring that costs gives back what it holds
BRAKE = 0.01  # [s] in which a motion is braked, or four times the delay, or the lag of what follows
PEAK = 1.0  # [s] in which the largest push is forgotten
AHEAD = 3.0  # times what is under way counts as spent
_NOTHING: Array = np.zeros(0)


class Tank(NamedTuple):
    """The memory of a tank, a value. Of a force only the first four are used."""

    sums: Array  # (a, b) [J] for each delay of the torque, and of the wrench
    valve: float = 1.0  # what it lets pass [1]
    limited: bool = False  # whether the task yields something
    forces: Array = _NOTHING  # (a, s) along the axes, newest first [N, N m]
    moves: Array = _NOTHING  # (b, s) of the frame in the last ticks, newest first [m, rad]
    x: Array = _NOTHING  # (s,) pose error [m, rad]
    K: Array = _NOTHING  # (s, s) stiffness as it acts [N/m, N m/rad]
    brake: float = 0.0  # how fast it takes the motion against the reference away [1/s]
    peak: Array = _NOTHING  # (s,) the largest push of late [N, N m]

    @property
    def energy(self) -> float:
        """What is surely left [J]."""
        return float(self.sums.min())


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

    # --- a force, along axes on which something may give way ---

    def press(self, tank: Tank | None, driven: Array, rate: Array, W: Array, dt: float) -> Tank:
        """The tank of a tick before the force `driven` (s,) that would act, damping aside, at the `rate` (s,) of the
        axes, whose mobility is W (s, s). That rate is the mean one of the last tick but for half of what it changed,
        and noise of it cannot have been in the forces of then."""
        rows = self.ticks + 1
        if tank is None:
            tank = Tank(np.full((rows, 1), self.energy), forces=np.zeros((rows, rate.size)))
        power = tank.forces.dot(rate)
        sums = np.minimum(tank.sums - dt * power[:, None], self.most)
        energy, span = float(sums.min()), rows * dt
        first = span * max(float(power.max()), float(driven.dot(rate)), 0.0)
        second = 0.5 * span * span * float(driven.dot(W.dot(driven)))
        valve = min(self._open(energy), _affordable(first, second, energy / AHEAD))
        return tank._replace(sums=sums, valve=valve, limited=valve < 1.0)

    # --- a spring and damper, and the push that moves it ---

    def comply(
        self, tank: Tank | None, x: Array, V: Array, wanted: Array, B: Array, M: Array, push: Array | None,
        move: Array, dt: float, late: bool, lag: float = 0.0,
    ) -> Tank:  # fmt: skip
        """The tank of a tick, of a mass M (s, s) at the errors x, V (s,) of pose and twist, with the damping B and a
        spring that is `wanted` to have the stiffness (s, s).

        `push` (s,) is what is felt to push, `move` (s,) what the frame has gone in the last tick; `late`: whether the
        mass is the arm, which the motors move after a delay; `lag` [s] with which the frame follows it.
        """
        if tank is None or tank.x.size != x.size:
            tank = self._filled(x, wanted, late, push is not None)
        K, went, moves = tank.K, tank.x - x, tank.moves
        spent = tank.forces.dot(went)[:, None] + 0.5 * float(x.dot(K.dot(x)) - tank.x.dot(K.dot(tank.x)))
        if push is not None:
            moves = _newest(move, moves)
            spent = spent - moves.dot(push)  # the push was felt while the frame went one of these ways
        peak = tank.peak if push is None else np.maximum(np.abs(push), (1.0 - dt / PEAK) * tank.peak)
        ahead = AHEAD * _under_way(tank.forces, x, V, K, M, dt) + _given_away(moves, peak, lag, dt)
        if push is not None:
            ahead += _beyond(move, V, M, dt)
        most = self.most + ahead  # what is under way is as good as spent
        sums = np.minimum(tank.sums - spent, most)
        given, K, limited = self._stiffened(float(sums.min()) - ahead, K, wanted, x, V, M, len(tank.forces) * dt, dt)
        if given:
            sums = np.minimum(sums + given, most)
        valve, brake = self._open(float(sums.min()) - ahead), 0.0
        force = K.dot(x) + B.dot(V)
        if valve < 1.0:
            limited, brake = True, (1.0 - valve) / max(BRAKE, 4.0 * len(tank.forces) * dt)
            force = force + brake * M.dot(V)
        if push is not None:
            force = force + valve * push
        return Tank(sums, valve, limited, _newest(force, tank.forces), moves, x, K, brake, peak)

    def _filled(self, x: Array, K: Array, late: bool, pushed: bool) -> Tank:
        rows = self.ticks + 1
        shape = (rows if late else 1, rows if pushed else 1)
        forces, moves = (np.zeros((n, x.size)) for n in shape)
        return Tank(np.full(shape, self.energy), forces=forces, moves=moves, x=x, K=K, peak=np.zeros(x.size))

    def _stiffened(
        self, energy: float, K: Array, wanted: Array, x: Array, V: Array, M: Array, span: float, dt: float
    ) -> tuple[float, Array, bool]:
        """What a step towards the stiffness that is wanted gives to the tank [J], the stiffness after it, and whether
        it falls short; `span` [s] is how late it may act."""
        shut = 1.0 - self._open(energy)
        if shut:
            share = shut * min(1.0, dt / LET_GO)
            return 0.5 * share * float(x.dot(K.dot(x))), (1.0 - share) * K, True
        if K is wanted or (wanted == K).all():
            return 0.0, wanted, False
        cost = 0.5 * float(x.dot((wanted - K).dot(x)))
        if cost <= 0.0:
            return -cost, wanted, False
        way = span * (V + 0.5 * span * np.linalg.solve(M, wanted.dot(x)))
        share = (energy - self._reserve) / (cost + AHEAD * float(way.dot(wanted.dot(way))))
        if share >= 1.0:
            return -cost, wanted, False
        share = max(share, 0.0)
        return -share * cost, K + share * (wanted - K), True


def _under_way(forces: Array, x: Array, V: Array, K: Array, M: Array, dt: float) -> float:
    """What forces (n, s) under way will have cost when the last of them has acted, where nothing else does [J]."""
    if len(forces) == 1:
        return 0.0
    p = dt * forces.sum(axis=0)  # [N s]
    rate = 0.5 * np.linalg.solve(M, p) - V
    then = x - len(forces) * dt * rate
    return max(0.0, float(p.dot(rate) + 0.5 * (then.dot(K.dot(then)) - x.dot(K.dot(x)))))


def _beyond(move: Array, V: Array, M: Array, dt: float) -> float:
    """What a frame has of motion beyond that of the mass that it follows [J]: it is still to be given away."""
    return 0.5 * max(0.0, float(move.dot(M.dot(move))) / (dt * dt) - float(V.dot(M.dot(V)))) if dt > 0.0 else 0.0


def _given_away(moves: Array, peak: Array, lag: float, dt: float) -> float:
    """What a frame may give away until it has come to rest, `lag` [s] after it is told to, where who pushed it with up
    to `peak` (s,) turns round [J]."""
    return (len(moves) + lag / dt) * float(peak.dot(np.abs(moves[0]))) if dt > 0.0 else 0.0


def _affordable(first: float, second: float, energy: float) -> float:
    """The largest s <= 1 with first s + second s^2 <= energy, coefficients of at least 0."""
    if energy <= 0.0:
        return 1.0 if first <= 0.0 and second <= 0.0 else 0.0
    if first + second <= energy:
        return 1.0
    return 2.0 * energy / (first + math.sqrt(first * first + 4.0 * second * energy))


def _newest(row: Array, rows: Array) -> Array:
    """Rows with another one before them, and without the last."""
    moved = np.empty_like(rows)
    moved[0], moved[1:] = row, rows[:-1]
    return moved


def pressed(tank: Tank, force: Array) -> Tank:
    """The tank after a tick that asked for a force (s,), as the limits allowed it."""
    return tank._replace(forces=_newest(force, tank.forces))
