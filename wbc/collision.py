"""Self-collision: shapes of the robot keep a distance, as hard rows on vdot.

Shapes are the geoms of the compiled model: spheres, capsules and boxes as they are, a cylinder as the capsule about it,
anything else as its box (a mesh only where its body has nothing simpler). Each distance d of a pair is bounded like the
range of a joint (`limit`): with the room d - d_min and the speed -ddot at which it closes, the pair brakes with at most
a [m/s^2], built up at a jerk j, so that it comes to rest where d = d_min; from nearer than that it is led apart.

Pairs are those that can meet: not on one link or on neighbours, not too near in `home` already (what the robot's maker
calls a pose is no collision; such pairs are told), and seen near one another in one of many random poses.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import mujoco
import numpy as np
import pinocchio as pin

from .errors import GainError, ModelError
from .kernels.distance import meet, nearest
from .kernels.limit import apart
from .limit import SETTLE
from .model import body_name
from .qp import Array, Rows
from .robot import Robot
from .state import State, Terms

KIND = mujoco.mjtGeom
DECELERATION = 2.0  # a [m/s^2]
BUILD_UP = 0.01  # a/j [s]
ROWS = 16  # most rows at a tick, those of the least distances after the way to brake
FASTER = 1.5  # [m/s] a pair is looked at that would have to brake if it closed so much faster than it does
MEETING = 0.1  # [m] two shapes that are never seen nearer are no pair,
POSES = 1000  # in as many random poses


class Shapes(NamedTuple):
    """The shapes of a robot, n of them: `joint` (n,), `place` (n, 3, 4) [R | p] on it, `half` (n, 3) lengths of the
    core [m], `radius` (n,) [m] around it, `bound` (n,) [m] of a sphere about all of it, names of their bodies, `geoms`:
    their numbers in the compiled model."""

    joint: Any
    place: Array
    half: Array
    radius: Array
    bound: Array
    bodies: tuple[str, ...]
    geoms: tuple[int, ...]


@dataclass(frozen=True)
class Pairs:
    """Shapes of a robot and the pairs (m, 2) of them that can meet; `home` (m,): their distances in that pose [m]."""

    shapes: Shapes
    pairs: Any
    home: Array

    def distances(self, state: State) -> Array:
        """(m,) distance of each pair, less than zero where they meet [m]."""
        return signed(self.shapes, self.pairs, state)

    def name(self, pair: Any) -> str:
        """`body, body`."""
        return f"{self.shapes.bodies[pair[0]]}, {self.shapes.bodies[pair[1]]}"


class _Store:
    """What a tick fills, and views of what it reads: `J` (6, nv), poses (joints, 12) and motions (joints, 6)."""

    def __init__(self, terms: Terms, rows: int) -> None:
        data, n = terms.data, terms.robot.model.nv
        self.poses, self.v, self.a = poses(data), _row_by_row(data.v, 6), _row_by_row(data.a, 6)
        self.dist, self.which = np.empty(rows), np.zeros((rows, 5), np.int64)
        self.points, self.along, self.told = np.zeros((rows, 2, 3)), np.zeros((rows, 2, 3)), np.zeros((rows, 3))
        self.G, self.lo, self.count = np.empty((rows, n)), np.empty(rows), 0


class SelfCollision:
    """Keeps the pairs of a robot at least `distance` [m] apart, braking with `deceleration` [m/s^2]; `rows`: as many of
    the smallest distances are bounded at a tick. Raises ModelError for a robot without shapes that can meet."""

    def __init__(
        self, robot: Robot, distance: float = 0.02, deceleration: float = DECELERATION, rows: int = ROWS
    ) -> None:
        for name, value in (("distance", distance), ("deceleration", deceleration), ("rows", rows)):
            if not value > 0.0:
                raise GainError(f"limits.self_collision.{name}: expected a positive number, got {value}")
        found = robot.pairs()
        apart = found.home >= distance
        self.near_home = sorted({found.name(pair) for pair in found.pairs[~apart]})  # left out
        self.pairs = Pairs(found.shapes, found.pairs[apart], found.home[apart])
        if not len(self.pairs.pairs):
            raise ModelError("limits.self_collision: no two shapes of the robot can meet; expected a robot with some")
        self.distance, self.rows = distance, rows
        a, j = deceleration, deceleration / BUILD_UP
        self._law = np.array([distance, a, max(2.0 * a * a / j, a * SETTLE), -0.1 * a, j, SETTLE, FASTER])
        model = robot.model
        self._moves, self._idle = np.zeros((model.njoints, model.nv)), np.zeros(model.nv)
        self._idle[-1] = 1.0
        for joint in range(model.njoints):
            for index in list(model.supports[joint])[1:]:
                first = model.joints[index].idx_v
                self._moves[joint, first : first + model.joints[index].nv] = 1.0

    @property
    def note(self) -> str:
        """How many pairs are kept apart, and which are not."""
        told = f"self_collision: {len(self.pairs.pairs)} pairs of shapes stay {self.distance:g} m apart"
        return f"{told}; nearer in `home`, and left out: {'; '.join(self.near_home)}" if self.near_home else told

    def sample(self, n: int) -> Rows:
        """Rows of the structure."""
        labels = tuple(f"collision[{i}]" for i in range(self.rows))
        G, free = np.tile(self._idle, (self.rows, 1)), np.full(self.rows, np.inf)
        return Rows("collision", {"vdot": G}, -free, free, labels=labels)

    def fill(self, state: State, dt: float, rows: Rows) -> None:
        """Put the bounds of a tick in rows where they stand."""
        store, shapes = self._store(state), self.pairs.shapes
        A: Any = rows.A
        store.count = nearest(
            store.poses, store.v, store.a, state.terms.J, self._moves, self._idle, shapes.joint, shapes.place,
            shapes.half, shapes.radius, shapes.bound, self.pairs.pairs, self._law,
            store.dist, store.which, store.points, store.along, store.told, A["vdot"],
        )  # fmt: skip
        apart(store.told, self._law, dt, rows.lo)

    def told(self, state: State, dt: float = 1e-3) -> tuple[Rows, Array, list[str]]:
        """Rows, (d, ddot, drift) of each and the names of the pairs, as they are at a state."""
        rows = self.sample(state.robot.nv)
        self.fill(state, dt, rows)
        store = self._store(state)
        return rows, store.told[: store.count].copy(), [self.name(i, state) for i in range(store.count)]

    def name(self, row: int, state: State) -> str:
        """`collision[body, body]` of a row of the last tick."""
        return f"collision[{self.pairs.name(self._store(state).which[row])}]"

    def too_near(self, state: State) -> list[str]:
        """`body, body` of all that are nearer than they may be, with the distance."""
        d = self.pairs.distances(state)
        names = {self.pairs.name(self.pairs.pairs[i]): d[i] for i in np.argsort(-d) if d[i] < self.distance - 1e-9}
        return [f"{name} ({1e3 * at:.1f} mm)" for name, at in names.items()]

    def _store(self, state: State) -> _Store:
        store: _Store | None = state.terms.held.get(self)
        if store is None:
            store = state.terms.held[self] = _Store(state.terms, self.rows)
        return store


def poses(data: Any) -> Array:
    """(joints, 12) placements of all joints where Pinocchio keeps them: R by columns, then p."""
    return _row_by_row(data.oMi, 12)


def _row_by_row(motions: Any, size: int) -> Array:
    """(n, size) numbers of a vector of Pinocchio's, which keeps one after the other, where they stand."""
    first = motions[0].rotation if size == 12 else motions[0].linear
    return np.lib.stride_tricks.as_strided(first.T.reshape(-1), (len(motions), size), (8 * size, 8))


def signed(shapes: Shapes, pairs: Any, state: State) -> Array:
    """(m,) distances of pairs of shapes, of those that meet less than zero [m]: coal's, exact but not smooth."""
    import coal

    geometry = [_coal(coal, half, radius) for half, radius in zip(shapes.half, shapes.radius, strict=True)]
    places, data = [], state.terms.data
    for joint, place in zip(shapes.joint, shapes.place, strict=True):
        T = data.oMi[int(joint)] * pin.SE3(place[:, :3].copy(), place[:, 3].copy())
        places.append(coal.Transform3s(T.rotation, T.translation))
    request, out = coal.DistanceRequest(), np.empty(len(pairs))
    request.enable_signed_distance = True
    for i, (a, b) in enumerate(pairs):
        out[i] = coal.distance(geometry[a], places[a], geometry[b], places[b], request, coal.DistanceResult())
    return out


def _coal(coal: Any, half: Array, radius: float) -> Any:
    """A shape as coal has it."""
    if not half.any():
        return coal.Sphere(radius)
    return coal.Capsule(radius, 2.0 * half[2]) if radius else coal.Box(2.0 * half)


def find_pairs(robot: Robot) -> Pairs:
    """The pairs of a robot, whatever distance they are to keep."""
    shapes = make_shapes(robot)
    joint, parents = shapes.joint, list(robot.model.parents)
    shaped = set(joint.tolist())
    for i in range(1, len(parents)):  # the last link towards the base that has a shape
        while parents[i] and parents[i] not in shaped:
            parents[i] = parents[parents[i]]
    pairs = [
        (a, b)
        for a in range(len(joint))
        for b in range(a + 1, len(joint))
        if joint[a] != joint[b] and parents[joint[a]] != joint[b] and parents[joint[b]] != joint[a]
    ]
    every = np.array(pairs, np.int64).reshape(-1, 2)
    rng = np.random.default_rng(0)
    low, high = np.maximum(robot.q_min, -np.pi), np.minimum(robot.q_max, np.pi)
    nothing, terms, seen = np.zeros(robot.nv), Terms(robot), np.zeros(len(every), np.int64)
    where = poses(terms.data)
    for _ in range(POSES):
        State(terms, robot.posed(rng.uniform(low, high)), nothing)
        meet(where, shapes.joint, shapes.place, shapes.half, shapes.radius, every, MEETING, seen)
    every = every[seen > 0]
    return Pairs(shapes, every, signed(shapes, every, State(terms, robot.keyframes["home"], nothing)))


def make_shapes(robot: Robot) -> Shapes:
    """The shapes of the robot with its tool, without its scene. Raises ModelError where there is no compiled model."""
    mj = robot.mujoco
    if mj is None:
        raise ModelError("limits.self_collision: expected a robot that was loaded from a file with shapes")
    tree = mj.body_rootid
    own = np.isin(tree, tree[mj.body_weldid > 0])
    simple = {int(mj.geom_bodyid[g]) for g in range(mj.ngeom) if KIND(int(mj.geom_type[g])) != KIND.mjGEOM_MESH}
    joint, place, half, radius, bodies, geoms = [], [], [], [], [], []
    for g in range(mj.ngeom):
        body, kind = int(mj.geom_bodyid[g]), KIND(int(mj.geom_type[g]))
        if not own[body] or kind in (KIND.mjGEOM_PLANE, KIND.mjGEOM_HFIELD):
            continue
        if kind == KIND.mjGEOM_MESH and body in simple:
            continue
        frame = robot.model.frames[robot.frame_id(body_name(mj, body))]
        turn, p, size = np.empty(9), mj.geom_pos[g].copy(), mj.geom_size[g]
        mujoco.mju_quat2Mat(turn, mj.geom_quat[g])
        R, core, around = turn.reshape(3, 3), np.zeros(3), 0.0
        if kind == KIND.mjGEOM_SPHERE:
            around = size[0]
        elif kind in (KIND.mjGEOM_CAPSULE, KIND.mjGEOM_CYLINDER):
            around, core[2] = size[0], size[1]
        elif kind == KIND.mjGEOM_BOX:
            core = size.copy()
        else:  # the box about it
            p, core = p + R @ mj.geom_aabb[g, :3], mj.geom_aabb[g, 3:].copy()
        at = frame.placement
        joint.append(int(frame.parentJoint))
        place.append(np.column_stack((at.rotation @ R, at.rotation @ p + at.translation)))
        half.append(core)
        radius.append(float(around))
        bodies.append(body_name(mj, body))
        geoms.append(g)
    if not joint:
        raise ModelError("limits.self_collision: the robot has no shapes; expected geoms on its bodies")
    cores, radii = np.array(half), np.array(radius)
    bound = np.linalg.norm(cores, axis=1) + radii
    return Shapes(np.array(joint, np.int64), np.array(place), cores, radii, bound, tuple(bodies), tuple(geoms))
