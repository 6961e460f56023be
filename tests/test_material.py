"""The rule for contact parameters: formulas, what a scene declares, and MuJoCo on both sides of it."""

from __future__ import annotations

import math

import mujoco
import numpy as np
import pytest

from wbc import material
from wbc.errors import ModelError
from wbc.material import Surface
from wbc.robot import Robot

WORLD = """<mujoco><option timestep="0.001" integrator="implicitfast" cone="elliptic"/>
<custom><numeric name="surface:ground" data="{surface}"/></custom>
<worldbody>
  <geom name="ground" type="plane" size="5 5 0.1"/>
  <body name="puck" pos="0 0 0.01">
    <joint name="x" type="slide" axis="1 0 0"/><joint name="y" type="slide" axis="0 1 0"/>
    <joint name="z" type="slide" axis="0 0 1"/>
    <geom name="puck" type="sphere" size="0.01" mass="3"/>
  </body>
</worldbody></mujoco>"""


def world(surface: str) -> mujoco.MjModel:
    spec = mujoco.MjSpec.from_string(WORLD.format(surface=surface))
    material.add_pairs(spec)
    model = spec.compile()
    material.settle(model)
    return model


def slide(model: mujoco.MjModel, speed: float, force: float, seconds: float = 0.5) -> np.ndarray:
    """(ticks, 3) contact force along the normal and across of a puck that is pressed and led in a circle at a speed."""
    data, found, total = mujoco.MjData(model), [], np.zeros(6)
    radius = 0.05
    for i in range(round(seconds / 1e-3)):
        angle = speed * i * 1e-3 / radius
        velocity = speed * np.array([-np.sin(angle), np.cos(angle)])
        data.qvel[:2] = velocity
        data.qfrc_applied[:] = [0, 0, 3 * 9.81 - force]
        mujoco.mj_step(model, data)
        total[:] = 0
        for c in range(data.ncon):
            mujoco.mj_contactForce(model, data, c, total)
        axes = data.contact[0].frame.reshape(3, 3) if data.ncon else np.eye(3)
        across = (axes.T @ [0, total[1], total[2]])[:2]
        found.append([total[0], across @ velocity / speed, across @ [-velocity[1], velocity[0]] / speed])
    return np.array(found)


class TestRule:
    def test_ratio_by_hand(self) -> None:
        # b_t = 2/(0.05 0.4) = 100 1/s, R = 19 * 0.2 = 3.8 1/kg: 0.3 100 0.1 / (2.5 1.09 3.8)
        assert material.hop_ratio(0.3, 2.5, 0.1, 0.05, 0.4, 0.2) == pytest.approx(3.0 / 10.355)
        assert material.hop_ratio(0.0, 2.5, 0.1, 0.05, 0.4, 0.2, rho=0.004) == pytest.approx(2.5 / 9.5)
        assert math.isinf(material.hop_ratio(0.3, 0.0, 0.1, 0.05, 0.4, 0.2))

    @pytest.mark.parametrize("points", [1, 4])
    def test_sliding_parameters_aim_at_their_ratio(self, points: int) -> None:
        found = material.parameters(Surface(0.3, 10, 0.1), 0.14, points)
        ratio = material.hop_ratio(0.3, 10 / points, 0.1, found.solimp[0], found.solreffriction[0], 0.14)
        assert ratio == pytest.approx(material.DESIGNED)
        assert ratio < material.VALID

    def test_sticking_is_stiff(self) -> None:
        found = material.parameters(Surface(0.6, 10, 0), 0.14)
        assert (found.solimp[0], found.impratio) == (0.95, 100)


class TestDeclared:
    @pytest.mark.parametrize("data", ["0.3 10", "0 10 0.1", "0.3 -1 0.1", "0.3 10 -0.1"])
    def test_what_is_no_surface_is_refused(self, data: str) -> None:
        with pytest.raises(ModelError, match=r"'surface:ground': expected friction \[1\] and force \[N\] above 0"):
            world(data)

    def test_a_surface_needs_its_geom(self) -> None:
        spec = mujoco.MjSpec.from_string(
            WORLD.format(surface="0.3 10 0.1").replace('name="ground" type', 'name="g" type')
        )
        with pytest.raises(ModelError, match="no geom 'ground' in the scene; expected the name of one"):
            material.add_pairs(spec)

    def test_every_corner_of_the_eraser_is_a_pair_once(self) -> None:
        model = Robot.load("panda", "eraser", "blackboard").mujoco
        assert model.npair == 4
        assert material.of_model(model) == {"board": Surface(0.3, 10, 0.15)}
        assert model.opt.impratio == 10
        np.testing.assert_array_equal(model.pair_friction[:, :2], 0.3)
        assert Robot.load("panda", "eraser", "board").mujoco.npair == 0

    def test_a_force_is_shared_by_the_points_of_one_body_alone(self) -> None:
        """Soles may touch the board too, but do not help the hand to carry its 15 N."""
        model = Robot.load("g1", "mitt", "whiteboard").mujoco
        assert model.npair == 9
        surface = material.of_model(model)["board"]
        for pair in range(model.npair):
            points = 1 if model.geom(model.pair_geom2[pair]).name == "mitt_tip" else 4
            found = material.parameters(surface, material.invweight(model, pair), points)
            assert model.pair_solreffriction[pair, 0] == found.solreffriction[0]

    def test_what_slides_leaves_feet_what_the_scene_gives_them(self) -> None:
        """Sliding asks for an impratio of 10 where the scene says less, and feet keep the floor's 100."""
        assert Robot.load("panda", "eraser", "board").mujoco.opt.impratio == 1
        assert Robot.load("g1", "mitt", "whiteboard").mujoco.opt.impratio == 100


class TestSimulated:
    """MuJoCo's own contacts, without any arm."""

    def test_at_its_force_and_speed_it_holds_and_drags_along_the_velocity(self) -> None:
        force = slide(world("0.3 10 0.2"), 0.2, 10.0)[100:]
        assert force[:, 0].min() > 9.5
        angle = np.degrees(np.arctan2(np.abs(force[:, 2]), np.abs(force[:, 1])))
        assert angle.max() < 5
        ratio = np.hypot(force[:, 1], force[:, 2]) / force[:, 0]
        np.testing.assert_allclose(ratio, 0.3, rtol=0.02)

    def test_where_the_ratio_exceeds_one_it_hops(self) -> None:
        model = world("0.3 10 0.2")
        lost = slide(model, 0.2 * 1.1 / material.DESIGNED, 10.0)
        assert (lost[:, 0] == 0).mean() > 0.1
        held = slide(model, 0.2 * 0.9 / material.DESIGNED, 10.0)
        assert (held[100:, 0] > 0).all()

    def test_what_sticks_creeps_as_predicted(self) -> None:
        model = world("0.6 10 0")
        data = mujoco.MjData(model)
        data.qfrc_applied[:] = [5.0, 0, 3 * 9.81 - 10.0]
        for _ in range(1000):
            mujoco.mj_step(model, data)
        creep = material.creep(5.0, 0.95, 0.01, material.invweight(model, 0), 100.0)
        assert data.qvel[0] == pytest.approx(creep, rel=0.02)

    def test_a_run_that_leaves_its_range_is_told_so(self) -> None:
        model = world("0.3 10 0.2")
        push, points = np.full(3, 10.0), np.array([1, 1, 0])
        assert material.worst("ground", model, push, np.array([0.2, 0.24, 9.0]), points) == ""
        told = material.worst("ground", model, push, np.array([0.2, 0.3, 9.0]), points)
        assert "it met 10 N at 0.3 m/s, a ratio of 0.6, expected at most 0.5" in told
        puck = model.body("puck").id
        assert material.worst("ground", model, push, np.array([0.2, 0.3, 9.0]), points, puck) == told
        assert material.worst("ground", model, push, np.array([0.2, 0.3, 9.0]), points, 0) == ""  # it is not that body
