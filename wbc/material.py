"""Contact parameters from what a surface is for: friction, and the force and speed at which it is touched.

A scene declares a surface by `<numeric name="surface:GEOM" data="mu N v"/>`: friction coefficient [1], normal force [N]
and sliding speed [m/s], the last 0 where things stick. Every geom that can touch it becomes an explicit pair, with
parameters by this rule.

In MuJoCo's convex model with elliptic cones a contact of one point that slides at v under the force f_n is lost when

    mu b_t v + v^2/rho  >  f_n (1 + mu^2) R,      R = (1 - d)/d w,      b_t = 2/(d s)

d: impedance (solimp), s: time constant of friction (solreffriction), w: inverse inertia at the contact (invweight0),
rho: radius of a curved surface. The left side over the right is the `hop_ratio`; below 0.5 contacts hold. A large s
lowers it as well, but beside a stiff normal friction then opposes the acceleration, not the velocity: so R is made
large (d = 0.05, a soft normal) and s as small as the ratio allows. What sticks creeps at v = f_t R/(b_t impratio).
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import NamedTuple

import mujoco
import numpy as np

from .errors import ModelError

VALID = 0.5  # a run whose ratio exceeds it may show the simulator's hopping, not the controller's
DESIGNED = 0.4  # the ratio that parameters aim at
PREFIX = "surface:"
_SOFT, _STIFF = 0.05, 0.95  # impedance of what slides and of what sticks
_FRICTION_TIME = (0.02, 1.0)  # [s] bounds of s


class Surface(NamedTuple):
    """What a surface is for."""

    mu: float
    force: float  # [N]
    speed: float  # [m/s], 0: it sticks


class Parameters(NamedTuple):
    """Of a contact pair in MuJoCo."""

    solref: tuple[float, float]
    solreffriction: tuple[float, float]
    solimp: tuple[float, float, float, float, float]
    impratio: float


def regularisation(d: float, invweight: float) -> float:
    """R = (1 - d)/d w [1/kg] along the normal."""
    return (1.0 - d) / d * invweight


def friction_damping(d: float, s: float) -> float:
    """b_t = 2/(d s) [1/s]."""
    return 2.0 / (d * s)


def hop_ratio(
    mu: float, force: float, speed: float, d: float, s: float, invweight: float, rho: float = math.inf
) -> float:
    """(mu b_t v + v^2/rho) / (f_n (1 + mu^2) R) of one point: above 1 it is lost, below 0.5 it holds."""
    load = mu * friction_damping(d, s) * speed + speed**2 / rho
    carried = force * (1.0 + mu**2) * regularisation(d, invweight)
    return load / carried if carried > 0.0 else math.inf


def creep(force: float, d: float, s: float, invweight: float, impratio: float) -> float:
    """f_t R / (b_t impratio) [m/s]: the speed at which a point that sticks gives way to f_t [N]."""
    return force * regularisation(d, invweight) / (friction_damping(d, s) * impratio)


def parameters(surface: Surface, invweight: float, points: int = 1) -> Parameters:
    """The pair's parameters for `surface`, its force shared by `points` contacts; invweight [1/kg]."""
    mu, force, speed = surface
    if not speed:
        return Parameters((0.01, 1.0), (0.01, 1.0), (_STIFF, _STIFF, 0.001, 0.5, 2.0), 100.0)
    # b_t = 2/(d s), so that the ratio falls with s
    s = hop_ratio(mu, force / points, speed, _SOFT, 1.0, invweight) / DESIGNED
    s = min(max(s, _FRICTION_TIME[0]), _FRICTION_TIME[1])
    return Parameters((0.01, 1.0), (s, 1.0), (_SOFT, _SOFT, 0.001, 0.5, 2.0), 10.0)


def declared(numerics: Iterator[tuple[str, np.ndarray]]) -> dict[str, Surface]:
    """Surfaces by the name of their geom. Raises ModelError."""
    found = {}
    for name, data in numerics:
        if not name.startswith(PREFIX):
            continue
        values = [float(value) for value in data]
        if len(values) != 3 or not values[0] > 0.0 or not values[1] > 0.0 or not values[2] >= 0.0:
            expected = "friction [1] and force [N] above 0 and a speed [m/s] of 0 or more"
            raise ModelError(f"numeric {name!r}: expected {expected}, got {values}")
        found[name[len(PREFIX) :]] = Surface(*values)
    return found


def worst(
    surface: str,
    model: mujoco.MjModel,
    push: np.ndarray,
    speed: np.ndarray,
    points: np.ndarray,
    body: int | None = None,
) -> str:
    """Where a run left the range in which its contacts hold, or "": push [N], speed [m/s] and points of every tick, of
    what moves as one with a `body`; None: of whatever touches the surface."""
    pairs, rigid = pairs_of(model, surface), model.body_weldid
    if body is not None:
        pairs = [pair for pair in pairs if rigid[model.geom_bodyid[model.pair_geom2[pair]]] == rigid[body]]
    touched = points > 0
    if not pairs or not touched.any():
        return ""
    force, speed = push[touched] / points[touched], speed[touched]
    at = int(np.argmax(speed / np.maximum(force, 1e-9)))
    pair = pairs[0]
    d, s, mu = model.pair_solimp[pair, 0], model.pair_solreffriction[pair, 0], model.pair_friction[pair, 0]
    ratio = hop_ratio(mu, max(force[at], 1e-9), speed[at], d, s, invweight(model, pair))
    if ratio <= VALID:
        return ""
    met = f"{push[touched][at]:.3g} N at {speed[at]:.3g} m/s, a ratio of {ratio:.2g}, expected at most {VALID:g}"
    return f"surface {surface}: its simulated contact may hop or drag askew: it met {met}; declare it for these"


def add_pairs(world: mujoco.MjSpec) -> None:
    """Explicit pairs of every declared surface with what can touch it. Raises ModelError."""
    for name, surface in declared((numeric.name, numeric.data) for numeric in world.numerics).items():
        ground = world.geom(name)
        if ground is None:
            raise ModelError(f"numeric {PREFIX + name!r}: no geom {name!r} in the scene; expected the name of one")
        for geom in list(world.geoms):
            if geom is ground or not (geom.contype & ground.conaffinity or ground.contype & geom.conaffinity):
                continue
            if not geom.name:
                raise ModelError(f"a geom without a name touches the surface {name!r}; expected one with a name")
            pair = world.add_pair(geomname1=name, geomname2=geom.name, condim=3)
            pair.friction = [surface.mu, surface.mu, 1e-5, 1e-5, 1e-5]


def settle(model: mujoco.MjModel, mu: float | None = None) -> None:
    """Set the parameters of all declared pairs; `mu` instead of the declared friction. Raises ModelError."""
    impratio = []  # one for the whole model: what slides has the say, but never less than the scene's, for what stands
    for name, declared_surface in of_model(model).items():
        surface = declared_surface if mu is None else declared_surface._replace(mu=mu)
        pairs = pairs_of(model, name)
        bodies = model.geom_bodyid[model.pair_geom2[pairs]].tolist()
        for pair, body in zip(pairs, bodies, strict=True):
            found = parameters(surface, invweight(model, pair), bodies.count(body))
            impratio.append(found.impratio)
            model.pair_solref[pair], model.pair_solreffriction[pair] = found.solref, found.solreffriction
            model.pair_solimp[pair] = found.solimp
            model.pair_friction[pair, :2] = surface.mu
    if impratio:
        model.opt.impratio = max(model.opt.impratio, min(impratio))


def of_model(model: mujoco.MjModel) -> dict[str, Surface]:
    """The declared surfaces of a compiled model."""
    numerics = (model.numeric(i) for i in range(model.nnumeric))
    return declared((numeric.name, numeric.data) for numeric in numerics)


def pairs_of(model: mujoco.MjModel, surface: str) -> list[int]:
    """Numbers of the pairs of a surface."""
    return np.flatnonzero(model.pair_geom1 == model.geom(surface).id).tolist()


def invweight(model: mujoco.MjModel, pair: int) -> float:
    """w [1/kg] of both bodies of a pair."""
    bodies = model.geom_bodyid[[model.pair_geom1[pair], model.pair_geom2[pair]]]
    return float(model.body_invweight0[bodies, 0].sum())
