"""What a robot presses on, taken away on purpose: a fault of the scene that only the simulator knows of."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import mujoco
import numpy as np

if TYPE_CHECKING:
    from .sim import Simulator


class Wall:
    """The geoms and welds of the scene that hold the bodies of `frames`, as they touch when the fault begins.

    `remove` puts them out of reach; `shift` moves the geoms by so many metres [m] away from the robot, along
    the normal with which they were touched (they have no velocity in MuJoCo: contact knows positions alone). `restore`
    undoes both.
    """

    def __init__(self, simulator: Simulator, frames: Sequence[str]) -> None:
        self.model = model = simulator.model
        own = {int(model.body_rootid[simulator.body(frame)]) for frame in frames}
        roots, data = model.body_rootid, simulator.data
        normal, found = np.zeros(3), set[int]()
        force = np.zeros(6)
        bodies = {int(model.body_weldid[simulator.body(frame)]) for frame in frames}
        for i in range(data.ncon):
            contact = data.contact[i]
            for geom, other, sign in ((*contact.geom, -1.0), (*contact.geom[::-1], 1.0)):
                touches = int(model.body_weldid[model.geom_bodyid[other]]) in bodies
                if touches and int(roots[model.geom_bodyid[geom]]) not in own:
                    mujoco.mj_contactForce(model, data, i, force)
                    normal += sign * force[0] * contact.frame[:3]
                    found.add(int(geom))
        self.geoms = sorted(found)
        size = float(np.linalg.norm(normal))
        self.normal = normal / size if size > 0.0 else normal
        self.welds = [i for i in range(model.neq) if self._welded(i, bodies)]
        self._places = model.geom_pos[self.geoms].copy()
        self._same = model.geom_sameframe[self.geoms].copy()
        self._data, self._active = data, data.eq_active[self.welds].copy()

    def __bool__(self) -> bool:
        return bool(self.geoms or self.welds)

    def _welded(self, i: int, bodies: set[int]) -> bool:
        model = self.model
        if model.eq_objtype[i] != mujoco.mjtObj.mjOBJ_SITE:
            return False
        ends = {int(model.body_weldid[model.site_bodyid[site]]) for site in (model.eq_obj1id[i], model.eq_obj2id[i])}
        return len(ends) == 2 and bool(ends & bodies)

    def remove(self) -> None:
        self.shift(10.0)  # explicit pairs of a scene know no masks
        self._data.eq_active[self.welds] = 0

    def shift(self, distance: float) -> None:
        model, data = self.model, self._data
        model.geom_sameframe[self.geoms] = 0  # else MuJoCo takes the place of the body for that of the geom
        for geom, place in zip(self.geoms, self._places, strict=True):
            R = data.xmat[model.geom_bodyid[geom]].reshape(3, 3)
            model.geom_pos[geom] = place + distance * R.T.dot(self.normal)

    def restore(self) -> None:
        self.model.geom_pos[self.geoms], self.model.geom_sameframe[self.geoms] = self._places, self._same
        self._data.eq_active[self.welds] = self._active
