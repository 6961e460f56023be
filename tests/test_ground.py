"""Ground that leans and ground that moves: contacts in its axes and seen from it, feet that stand on it."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest

from wbc.build import build
from wbc.contact.axes import WorldAxesContact
from wbc.contact.edge import EdgeContact
from wbc.contact.foot import RoundFoot
from wbc.errors import SpecError
from wbc.reference import Path, sine
from wbc.resources import shipped_folder
from wbc.ride import Ride
from wbc.run import run
from wbc.spec import load

TASKS = shipped_folder("tasks")
TILTED = pin.exp3(np.array([0.2, -0.3, 0.5]))
ORIGIN = pin.SE3(TILTED, np.array([0.1, -0.2, 0.05]))
PATH = Path(
    ORIGIN, {0: sine(0.3, 1.1), 2: sine(0.4, 1.7, 0.5), 3: sine(0.1, 1.3), 4: sine(0.2, 0.9), 5: sine(0.1, 2.0)}
)
FEET = {
    "round": lambda: RoundFoot("left_sole", TILTED, 0.03),
    "edge": lambda: EdgeContact("left_sole", TILTED[:, 2], 1, 0.02),
    "flat": lambda: WorldAxesContact("left_sole", ("wx", "wy", "wz", "vx", "vy", "vz"), TILTED),
}


@pytest.fixture
def made(tmp_path):
    """made(name, (old, new), ...) -> a shipped spec with changes, loaded."""

    def one(name, *changes, **overrides):
        text = (TASKS / f"{name}.yaml").read_text()
        for old, new in changes:
            assert old in text
            text = text.replace(old, new)
        (tmp_path / f"{name}.yaml").write_text(text)
        return load(tmp_path / f"{name}.yaml", [f"{key}={value}" for key, value in overrides.items()])

    return one


def stands(finished, com=5e-4, slip=2e-4):
    figures = finished.summary["metrics"]
    contacts = list(finished.log.meta["contacts"])
    assert figures["balance.position.rms_error"] <= com
    for name in contacts:
        assert figures[f"{name}.slip"] <= slip
        assert figures[f"{name}.cone.max_asked"] <= 1e-6
        assert finished.log[f"{name}.excess"][1000:].max() <= 1e-6  # true, after a second
        assert figures[f"{name}.motion.error"] <= 5e-3
    assert figures["ticks.degraded"] == 0


class TestRide:
    """The contact on moving ground, against finite differences along any motion of robot and ground."""

    @pytest.mark.parametrize("kind", FEET)
    def test_its_rows_are_the_derivative_of_how_it_slips(self, g1, rng, kind):
        contact, h = FEET[kind](), 1e-6
        contact.ride = Ride(PATH)
        for _ in range(5):
            q = pin.integrate(g1.model, g1.keyframes["home"], rng.uniform(-1.0, 1.0, g1.nv))
            v, t = rng.uniform(-1.0, 1.0, g1.nv), rng.uniform(0.1, 2.0)
            slips = []
            for step in (h, -h):
                state = g1.state(pin.integrate(g1.model, q, step * v), v, t=t + step)
                slips.append(contact.hold(state).slip.copy())
            state = g1.state(q, v, t=t)
            held = contact.hold(state)
            np.testing.assert_allclose(-held.rhs, (slips[0] - slips[1]) / (2 * h), atol=2e-6)
            np.testing.assert_allclose(held.G, held.A @ state.frame("left_sole").J, atol=1e-13)

    @pytest.mark.parametrize("kind", FEET)
    def test_what_the_ground_carries_does_not_slip(self, g1, kind):
        """A frame that moves with the ground, in place and twist, is at rest for the contact."""
        contact, t, base = FEET[kind](), 0.7, 6
        contact.ride = ride = Ride(PATH)
        home = g1.state(g1.keyframes["home"], np.zeros(g1.nv))
        at_rest = FEET[kind]().A(home).copy()
        q = g1.keyframes["home"].copy()
        T = ride.displacement(t) * pin.XYZQUATToSE3(q[:7])
        q[:7] = pin.SE3ToXYZQUAT(T)
        v = np.zeros(g1.nv)
        w, linear = ride.motion(t, T)[:, 0].reshape(2, 3)
        v[:base] = np.concatenate((linear, w))  # Pinocchio's order
        state = g1.state(q, v, t=t)
        held = contact.hold(state)
        np.testing.assert_allclose(held.slip, 0.0, atol=1e-12)
        np.testing.assert_allclose(held.A, at_rest, atol=1e-12)
        assert np.abs(FEET[kind]().hold(state).slip).max() > 0.05

    def test_its_motion_is_that_of_its_displacement(self):
        ride, h, t = Ride(PATH), 1e-6, 0.9
        place = pin.SE3(pin.exp3(np.array([1.0, -0.4, 0.2])), np.array([0.5, 0.2, -0.3]))
        np.testing.assert_allclose(ride.displacement(0.0).homogeneous, np.eye(4), atol=1e-15)
        now, *around = (ride.displacement(t + step) * place for step in (0.0, h, -h))
        twist = [pin.log6(now.actInv(each)).vector[[3, 4, 5, 0, 1, 2]] for each in around]
        motion = ride.motion(t, now)
        np.testing.assert_allclose(motion[:, 0], (twist[0] - twist[1]) / (2 * h), atol=1e-8)
        later, before = (ride.motion(t + s, ride.displacement(t + s) * place)[:, 0] for s in (h, -h))
        np.testing.assert_allclose(motion[:, 1], (later - before) / (2 * h), atol=1e-7)

    def test_the_simulated_platform_is_where_and_as_fast_as_the_path_says(self):
        finished, seen = build(load("go2_ride", ["duration=0.7"])), []
        ride = finished.rides["platform_body"]

        def look(observed, out):
            seen.append((observed.t, *simulators[-1].true_motion("platform")))

        simulators = []
        from wbc import run as running

        plain = running.Simulator

        class Kept(plain):
            def __init__(self, *args):
                super().__init__(*args)
                simulators.append(self)

        running.Simulator = Kept
        try:
            run(finished, hook=look)
        finally:
            running.Simulator = plain
        for t, T, V in seen[50::100]:
            np.testing.assert_allclose(T.homogeneous, ride.displacement(t).homogeneous, atol=2e-4)
            np.testing.assert_allclose(V, ride.motion(t, T)[:, 0], atol=2e-3)
        assert max(np.abs(V).max() for _, _, V in seen) > 0.03

    def test_a_deck_that_turns_as_well_carries_it(self, made):
        """Rolls by 3 deg, yaws by 6, heaves by 2 cm, while the trunk stays level and where it is."""
        old = "ride:  {lissajous: {in: self, size: [0.1, 0.06], period: [4, 2]}}"
        points = "[[0, 0, 0, 0, 0, 0], [0.02, 0, 0.02, 0.05, 0, 0.1], [0, 0, 0, 0, 0, 0]]"
        deck = f"ride: {{quintic: {{in: self, waypoints: {points}, times: [0, 0.8, 1.6]}}}}"
        spec = made("go2_ride", (old, deck), ("target: ride, kp", "target: start, kp"), duration=1.6)
        finished = run(build(spec))
        stands(finished)
        assert np.ptp(finished.log["FL.place"][:, 2]) > 0.005  # its feet went along

    def test_without_it_the_feet_slip(self, made):
        """The same platform under a robot that believes the ground to be still: what the key is for."""
        spec = made("go2_ride", (", rides: ride", ""), duration=1.5)
        assert run(build(spec)).summary["metrics"]["balance.position.rms_error"] > 1e-3


class TestSlopes:
    def test_a_sole_starts_flat_on_its_slope(self):
        built = build(load("g1_slopes"))
        state = built.robot.state(built.q, np.zeros(35))
        for side in ("left", "right"):
            plane = built.robot.fixed_pose(f"{side}_slope")
            frame, n = state.frame(f"{side}_sole"), plane.rotation[:, 2]
            assert n @ (frame.p - plane.translation) == pytest.approx(0.0, abs=1e-9)
            np.testing.assert_allclose(frame.R[:, 2], n, atol=1e-9)
            assert n[2] < 0.98

    def test_a_point_has_its_cone_in_the_axes_of_its_plane(self, made, rng):
        spec = made("go2_stand", ("scene: floor", "scene: slopes"), *self.own())
        built = build(spec)
        state = built.robot.state(built.q, np.zeros(18))
        contact = built.phases[0].contacts["FL"]
        held, R = contact.hold(state), built.robot.fixed_pose("left_slope").rotation
        for _ in range(100):
            f = rng.normal(size=3) * (0.6, 0.6, 1.0)
            pushes, across = -f[2], np.linalg.norm(f[:2])
            F = np.r_[np.zeros(3), state.frame("FL_foot").R.T @ R @ f]
            inside = (held.cone.rows @ (held.inverse @ F)).min() >= 0.0
            if inside:
                assert across <= 0.6 * pushes
            elif pushes > 0:
                assert across > 0.6 * np.cos(np.pi / 8) * pushes

    @staticmethod
    def own():
        return tuple(
            (f"{leg}_foot, holds: [vx, vy, vz]", f"{leg}_foot, holds: [vx, vy, vz], ground: {side}_slope")
            for leg, side in (("FL", "left"), ("RL", "left"), ("FR", "right"), ("RR", "right"))
        )

    def test_round_feet_stand_on_them(self, made):
        stands(run(build(made("go2_stand", ("scene: floor", "scene: slopes"), *self.own(), duration=1.5))))

    def test_edges_stand_on_gentler_ones(self, made, tmp_path):
        """What staggered edges support is 3 cm wide: the start pose leads on steeper slopes too near to its border."""
        text = (shipped_folder("scenes") / "slopes.xml").read_text()
        for steep, gentle in (("0.14 0.19 0", "0.05 0.07 0"), ("-0.14 -0.16 0", "-0.05 -0.06 0")):
            assert steep in text
            text = text.replace(f'"{steep}"', f'"{gentle}"')
        (tmp_path / "gentle.xml").write_text(text)
        changes = [(f"{side}_toe,", f"{side}_toe, ground: {side}_slope,") for side in ("left", "right")]
        spec = made("g1_line_foot", ("scene: floor", "scene: gentle.xml"), *changes, duration=2)
        stands(run(build(spec)))


class TestFaults:
    @pytest.mark.parametrize(
        ("old", "new", "message"),
        [
            ("rides: ride}", "rides: rid}", "no reference named 'rid'; did you mean 'ride'"),
            ("platform_body: ride", "platform_body: rode", "no reference named 'rode'; did you mean 'ride'"),
            ("{platform_body: ride}", "{platform_bdy: ride}", "no body named 'platform_bdy' that moves freely; did"),
            ("{platform_body: ride}", "{base: ride}", "no body named 'base' that moves freely"),
            ("scene: platform", "scene: floor", "no frame named 'platform'"),
            ("lissajous: {in: self, size: [0.1, 0.06], period: [4, 2]}", "profile: {values: [0, 1], times: [0, 1]}",
             "is a number; expected a motion"),
        ],
    )  # fmt: skip
    def test_have_a_place_and_a_remedy(self, made, old, new, message):
        with pytest.raises(SpecError, match=message) as caught:
            build(made("go2_ride", (old, new)))
        assert all(fault.line and fault.column for fault in caught.value.faults)

    def test_ground_that_moves_has_nothing_drawn_on_it(self, tmp_path):
        text = (TASKS / "eraser.yaml").read_text().replace("    natural:", "    rides: figure\n    natural:")
        (tmp_path / "spec.yaml").write_text(text)
        with pytest.raises(SpecError, match="expected no target of motion beside it"):
            load(tmp_path / "spec.yaml")
