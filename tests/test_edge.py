"""Edges: the contact by finite differences, its cone against forces anywhere along it, how it lies, rolls and lifts."""

from __future__ import annotations

from typing import ClassVar

import numpy as np
import pinocchio as pin
import pytest
from oracles import first_tick
from scipy.optimize import linprog

from wbc import analytic
from wbc.analytic.surface import ALONG, ENDS
from wbc.build import build
from wbc.contact import Settling
from wbc.contact.edge import Edge, EdgeContact
from wbc.errors import SpecError, WrenchError
from wbc.footing import Footing
from wbc.ladder import Status
from wbc.resources import shipped_folder
from wbc.run import run
from wbc.spec import load
from wbc.testing import check_contact

TILTED = pin.exp3(np.array([0.2, -0.3, 0.5]))[:, 2]
UP = np.array([0.0, 0.0, 1.0])
CASES = [(UP, 1, 0.0), (UP, 0, 0.05), (TILTED, 1, 0.05), (TILTED, 0, 0.0)]
SPEC = (shipped_folder("tasks") / "g1_line_foot.yaml").read_text()
LEFT = "{frame: left_toe,  holds: [wx, wz, vx, vy, vz], pushes: -z, friction: 0.6, edge: 0.06, radius: 0.005}"


@pytest.fixture(scope="module")
def built():
    return build(load("g1_line_foot"))


class _At:
    """A frame at a pose."""

    def __init__(self, T):
        self.T, self.R, self.p = T, T.rotation, T.translation


def axes_of(normal, edge, along):
    """Columns x, y, z of an edge in the world: z the normal, the edge projected onto x or y."""
    e = edge - normal * (normal @ edge)
    e /= np.linalg.norm(e)
    return np.column_stack((e, np.cross(normal, e), normal) if along == 0 else (np.cross(e, normal), e, normal))


class TestContact:
    @pytest.mark.parametrize(("normal", "along", "radius"), CASES)
    def test_by_finite_differences(self, g1, normal, along, radius):
        check_contact(EdgeContact("left_toe", normal, along, radius), g1)

    @pytest.mark.parametrize(("normal", "along", "radius"), CASES)
    def test_it_holds_the_line_and_lets_it_turn_about_itself(self, g1, draw, normal, along, radius):
        contact = EdgeContact("right_toe", normal, along, radius)
        state = draw(g1)
        frame = state.frame("right_toe")
        E = axes_of(normal, frame.R[:, along], along)
        w, v = (frame.R @ part for part in frame.V.reshape(2, 3))
        held = np.r_[E[:, 1 - along] @ w, normal @ w, E.T @ (v + np.cross(w, -radius * normal))]
        np.testing.assert_allclose(contact.A(state) @ frame.V, held, atol=1e-13)
        spin = 0.7 * E[:, along]  # a cylinder that rolls
        V = np.r_[frame.R.T @ spin, frame.R.T @ np.cross(spin, radius * normal)]
        np.testing.assert_allclose(contact.A(state) @ V, 0.0, atol=1e-14)
        assert contact.free(state) @ V == pytest.approx(0.7)

    @pytest.mark.parametrize(("normal", "along", "radius"), CASES)
    def test_its_multipliers_are_the_wrench_at_the_line(self, g1, draw, normal, along, radius):
        contact, lam = EdgeContact("left_toe", normal, along, radius), np.array([0.3, -0.2, 1.0, -2.0, -30.0])
        state = draw(g1)
        R = state.frame("left_toe").R
        E, F = axes_of(normal, R[:, along], along), contact.A(state).T @ lam
        moment = E[:, [1 - along, 2]] @ lam[:2]
        np.testing.assert_allclose(R @ F[3:], E @ lam[2:], atol=1e-12)
        np.testing.assert_allclose(R @ F[:3], moment + np.cross(-radius * normal, E @ lam[2:]), atol=1e-12)
        np.testing.assert_allclose(contact.turn(state), R.T @ E, atol=1e-13)
        about = R.T @ E[:, along]  # a moment along the edge tells the multipliers nothing
        np.testing.assert_allclose(contact.hold(state).inverse @ (F + np.r_[9.0 * about, 0, 0, 0]), lam, atol=1e-12)
        assert contact.axes == (("my", "mx")[along], "mz", "fx", "fy", "fz")


class TestCone:
    """Against point forces in their pyramids, at places all along the edge."""

    MU, HALF = 0.45, 0.03
    PLACES = np.linspace(-HALF, HALF, 9)

    def generators(self, along):
        """(6, n) wrenches of the edges of all pyramids."""
        wrenches = []
        for s in self.PLACES:
            for x in (-self.MU, self.MU):
                for y in (-self.MU, self.MU):
                    f = np.array([x, y, 1.0])
                    wrenches.append(np.r_[np.cross(s * np.eye(3)[along], f), f])
        return np.array(wrenches).T

    def carried(self, F, along):
        G = self.generators(along)
        found = linprog(np.zeros(G.shape[1]), A_eq=G, b_eq=F, bounds=[(0, None)] * G.shape[1], method="highs")
        return found.status == 0

    @pytest.mark.parametrize("along", [0, 1])
    def test_forces_along_the_edge_make_wrenches_inside(self, along, rng):
        U, G = analytic.edge_cone(self.MU, self.HALF, along), self.generators(along)
        for _ in range(300):
            F = G @ (rng.uniform(0.0, 9.0, G.shape[1]) * (rng.random(G.shape[1]) < 0.2))
            assert (U @ F).min() >= -1e-12
            assert abs(F[along]) <= 1e-12

    @pytest.mark.parametrize("along", [0, 1])
    def test_it_is_exact(self, along, rng):
        """Just inside its border a wrench has forces, just outside it has none; every face is met."""
        U, push, met = analytic.edge_cone(self.MU, self.HALF, along), np.eye(6)[5], set()
        for _ in range(300):
            away = rng.normal(size=6) * (self.HALF, self.HALF, self.HALF * self.MU, self.MU, self.MU, 0.0)
            away *= rng.permuted([0.1, 0.1, 1.0, 1.0, 1.0, 1.0])
            away[along] = 0.0
            share = -(U @ push) / np.minimum(U @ away, -1e-300)
            border = share.min()
            met.add(int(share.argmin()))
            assert self.carried(push + 0.999 * border * away, along)
            assert not self.carried(push + 1.001 * border * away, along)
        assert met == {*range(7)[ALONG], *range(7)[ENDS]}

    @pytest.mark.parametrize("along", [0, 1])
    def test_it_is_that_of_a_rectangle_without_width(self, along, rng):
        """Less the moment along the edge, of which a rectangle says that it is nothing."""
        thin = (self.HALF, 0.0) if along == 0 else (0.0, self.HALF)
        U, whole = analytic.edge_cone(self.MU, self.HALF, along), analytic.surface_cone(self.MU, *thin)
        inside = 0
        for F in rng.normal(size=(2000, 6)) * (self.HALF, self.HALF, self.HALF * self.MU, self.MU, self.MU, 0.0):
            F[5], F[along] = 1.0, 0.0
            assert ((U @ F).min() >= 0.0) == ((whole @ F).min() >= 0.0)
            inside += (U @ F).min() >= 0.0
        assert 20 < inside < 1980

    @pytest.mark.parametrize("along", [0, 1])
    def test_the_contact_asks_it_of_its_multipliers(self, g1, draw, rng, along):
        contact = EdgeContact("left_toe", UP, along, 0.01)
        contact.pushes = Edge(2 * self.HALF, along, self.MU * np.sqrt(2.0))
        state = draw(g1)
        held, U = contact.hold(state), analytic.edge_cone(self.MU, self.HALF, along)
        E = axes_of(UP, state.frame("left_toe").R[:, along], along)
        R = state.frame("left_toe").R
        for lam in rng.normal(size=(20, 5)):
            F = held.A.T @ lam  # what acts on the environment, carried to the line
            m, f = E.T @ (R @ F[:3] + np.cross(0.01 * UP, R @ F[3:])), E.T @ R @ F[3:]
            np.testing.assert_allclose(held.cone.rows @ lam, U @ -np.r_[m, f], atol=1e-12)
        labels = contact.pushes.rows("foot", held.cone).labels
        assert labels == ("foot.push", *["foot.friction"] * 2, *["foot.ends"] * 4)

    def test_a_target_is_cut_to_it_and_the_push_kept(self):
        edge = Edge(0.06, 1, 0.6, least=5.0)
        cone = edge.border
        inside = np.array([0.1, 0.0, 1.0, -2.0, -30.0])
        assert cone.cut(inside) == (pytest.approx(inside), "")
        for lam, by in (([0, 0, 0, 90.0, -30.0], "friction"), ([9.0, 0, 0, 0, -30.0], "ends")):
            cut, what = cone.cut(np.array(lam, float))
            assert what == by
            assert cut[4] == pytest.approx(-30.0)
            assert (cone.rows @ cut).min() == pytest.approx(0.0, abs=1e-12)
        assert cone.cut(np.array([0, 0, 0, 0, 3.0]))[0][4] == pytest.approx(-5.0)

    def test_an_edge_has_a_length(self):
        with pytest.raises(WrenchError, match="expected more than 0 m"):
            Edge(0.0, 1, 0.6)


class TestFooting:
    @pytest.mark.parametrize("along", [0, 1])
    def test_its_height_is_that_of_its_lower_end(self, along):
        footing = Footing(TILTED, 0.3, 0.01, (0.06, 0.0) if along == 0 else (0.0, 0.06))
        for _ in range(10):
            T = pin.SE3.Random()
            ends = [TILTED @ (T * (s * np.eye(3)[along])) - 0.3 - 0.01 for s in (-0.03, 0.03)]
            assert footing.height(_At(T)) == pytest.approx(min(ends), abs=1e-12)

    @pytest.mark.parametrize("along", [0, 1])
    def test_the_way_down_lays_it_on_the_plane_and_leaves_its_turn_alone(self, along):
        footing = Footing(UP, 0.0, size=(0.06, 0.0) if along == 0 else (0.0, 0.06))
        T = pin.SE3(pin.exp3(np.array([0.3, -0.2, 1.0])), np.array([0.0, 0.0, 0.1]))
        for _ in range(1000):
            V = footing.down(_At(T))
            assert V[along] == 0.0
            T = T * pin.exp6(pin.Motion(V[3:], V[:3]) * 1e-3)
        assert T.rotation[2, along] == pytest.approx(0.0, abs=3e-3)
        assert T.translation[2] < 0.05

    def test_in_the_air_it_carries_nothing_and_comes_down(self):
        built = build(load("g1_line_foot", ["limits.torque_rate=1e6"]))
        robot, q = built.robot, built.q.copy()
        for joint, angle in {"left_hip_pitch_joint": -0.1, "left_knee_joint": 0.2}.items():
            q[7 + robot.joints.index(joint)] += angle
        out, state = first_tick(built.controller, q, np.zeros(robot.nv))
        assert "left_foot.lifted" in out.active
        assert out.status is Status.LIMITED
        np.testing.assert_allclose(out.wrenches["left_foot"], 0.0, atol=1e-6)
        frame = state.frame("left_toe")
        assert (frame.R @ (frame.J @ out.vdot + frame.drift)[3:])[2] < -0.5


class TestSpec:
    def test_a_foot_is_one_line(self, built):
        foot = built.phases[0].contacts["left_foot"]
        assert isinstance(foot, EdgeContact)
        assert isinstance(foot.pushes, Edge)
        assert (foot.along, foot.radius, foot.pushes.length) == (1, 0.005, 0.06)
        assert foot.settling == Settling(20.0)
        assert foot.footing.size == (0.0, 0.06)

    def test_it_starts_on_staggered_edges_with_its_heels_up(self, built):
        state = built.robot.state(built.q, np.zeros(35))
        left, right = (state.frame(name) for name in ("left_toe", "right_toe"))
        assert left.p[0] - right.p[0] == pytest.approx(0.15, abs=5e-4)
        for frame in (left, right):
            assert frame.p[2] == pytest.approx(0.005, abs=1e-9)
            assert frame.R[2, 1] == pytest.approx(0.0, abs=1e-9)  # the edge is level
            assert np.arcsin(-frame.R[2, 0]) == pytest.approx(0.3, abs=1e-3)  # the sole is not

    def test_a_start_that_leans_is_closed_onto_its_edges(self):
        built = build(load("g1_line_foot", ["start.left_hip_roll_joint=0.1", "start.right_hip_yaw_joint=-0.2"]))
        state = built.robot.state(built.q, np.zeros(35))
        for name in ("left_toe", "right_toe"):
            frame = state.frame(name)
            assert (frame.p[2], frame.R[2, 1]) == (pytest.approx(0.005, abs=1e-9), pytest.approx(0.0, abs=1e-9))

    FAULTS: ClassVar = {
        "without pushing": ("pushes: -z, friction: 0.6, ", "", "expected `pushes: -z` beside it"),
        "holds all": ("[wx, wz, vx, vy, vz]", "all", r"expected `holds: \[wx, wz, vx, vy, vz\]`, or wy along x"),
        "a point": ("[wx, wz, vx, vy, vz]", "[vx, vy, vz]", "an edge along y turns about it"),
        "upwards": ("-z", "+z", r"pushes along -z of its plane; expected `pushes: -z`, got \+z"),
        "slippery": (" friction: 0.6,", "", "an edge needs its friction; expected `friction: MU`"),
        "faces": ("friction: 0.6", "friction: {mu: 0.6, faces: 6}", "the ends of an edge have 4 faces each"),
        "a sole as well": ("edge: 0.06", "edge: 0.06, sole: [0.1, 0.1]", "expected either `sole` or"),
        "no length": ("edge: 0.06", "edge: 0", "expected a number greater than 0"),
    }

    @pytest.mark.parametrize("what", FAULTS)
    def test_faults_have_a_place_and_a_remedy(self, tmp_path, what):
        old, new, message = self.FAULTS[what]
        (tmp_path / "spec.yaml").write_text(SPEC.replace(LEFT, LEFT.replace(old, new)))
        assert old in LEFT
        with pytest.raises(SpecError, match=message) as caught:
            build(load(tmp_path / "spec.yaml"))
        assert all(fault.line and fault.column for fault in caught.value.faults)


def test_pushed_on_its_edges_it_comes_back(tmp_path):
    """What stands unmoved might stand by luck: 2 N s from behind and 3 from the side are led back."""
    shove = "plant: {pushes: {shove: {frame: torso_link, wrench: {fx: 20, fy: 30}, from: 0.2, to: 0.3}}}\nexpect:"
    (tmp_path / "spec.yaml").write_text(SPEC.replace("expect:", shove))
    finished = run(build(load(tmp_path / "spec.yaml", ["duration=2.2", "limits.torque_rate=20000"])))
    away = np.linalg.norm(finished.log["balance.away"], axis=1)
    assert away[300:].max() > 2e-3
    assert away[-1] < 1e-3
    figures = finished.summary["metrics"]
    assert max(figures["left_foot.slip"], figures["right_foot.slip"]) < 2e-4
    assert figures["ticks.degraded"] == 0
