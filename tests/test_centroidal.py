"""Tasks of a whole body and the contacts that it stands on, against finite differences and closed forms."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
from test_floating import DOWN, FEET, contacts_of, tasks_of

from wbc.analytic import surface_cone
from wbc.contact import Contact, Settling
from wbc.contact.axes import AxesContact
from wbc.contact.foot import RoundFeet, RoundFoot
from wbc.controller import Controller
from wbc.errors import GainError, WrenchError
from wbc.footing import Footing
from wbc.phase import hold, place
from wbc.reference import Hold, Path, sine
from wbc.surface import Sole
from wbc.task.centroidal import ComTask, DistributionTask, WholeBodyPosture, com, mass
from wbc.task.motion import MotionTask
from wbc.testing import check_contact, check_task
from wbc.wrench import VELOCITY_AXES

TILTED = pin.exp3(np.array([0.2, -0.3, 0.5]))


def held(robot, contacts, q=None, v=None):
    state = robot.state(robot.keyframes["home"] if q is None else q, np.zeros(robot.nv) if v is None else v)
    hold(state, place(robot, contacts, {}, {}))
    return state


# --- contacts ---


@pytest.mark.parametrize("radius", [0.0, 0.022, 0.2])
def test_round_feet_by_finite_differences(go2, radius):
    for R in (np.eye(3), TILTED):
        check_contact(RoundFoot("FL_foot", R, radius), go2)


def test_a_round_foot_rolls_without_slipping(go2, draw):
    """What it holds is the material point at -r n; what it lets go is a rolling ball's twist."""
    foot = RoundFoot("RR_foot", TILTED, 0.05)
    state = draw(go2)
    frame = state.frame("RR_foot")
    w, v = (frame.T.rotation @ part for part in frame.V.reshape(2, 3))
    np.testing.assert_allclose(foot.A(state) @ frame.V, TILTED.T @ (v + np.cross(w, -0.05 * TILTED[:, 2])), atol=1e-13)
    spin = np.array([0.3, -0.8, 0.4])  # a ball that turns moves by w x r n
    V = np.r_[frame.T.rotation.T @ spin, frame.T.rotation.T @ np.cross(spin, 0.05 * TILTED[:, 2])]
    np.testing.assert_allclose(foot.A(state) @ V, 0.0, atol=1e-15)


def test_feet_are_evaluated_together_as_they_would_be_one_by_one(go2, draw):
    """The kernel against the formulas of a contact whose rows turn: standing, settling at its bound, over a floor that
    was found elsewhere, in the air, and on no plane at all."""
    state, feet = draw(go2), {}
    for name, settling in zip(("FL", "FR", "RL", "RR"), (None, (20.0, 1.0), (3.0, 0.1), (20.0, 1.0)), strict=True):
        foot = feet[name] = RoundFoot(f"{name}_foot", TILTED if name == "FR" else np.eye(3), 0.02)
        foot.settling = settling and Settling(*settling)
    heights = {"FL": 0.0, "FR": 1e-4, "RL": 0.03}
    for name, height in heights.items():
        n, p = feet[name]._R[:, 2], state.frame(f"{name}_foot").p
        feet[name].footing = Footing(n, n @ p - 0.02 - height, 0.02)
    state.grounds = {feet["FL"]: -0.1, feet["FR"]: 1e-4}
    together = RoundFeet(feet).hold(state)
    lifted = {name: held.lifted for name, held in together.items()}
    assert lifted == {"FL": True, "FR": False, "RL": True, "RR": False}
    for name, foot in feet.items():
        alone, held = Contact.hold(foot, state), together[name]
        for key in ("A", "free", "inverse", "B", "push", "G", "table", "slip"):
            np.testing.assert_allclose(getattr(held, key), getattr(alone, key), atol=1e-12, err_msg=f"{name} {key}")
        np.testing.assert_allclose(held.rhs, alone.rhs, atol=1e-12)
        np.testing.assert_allclose(held.Adot_V, alone.Adot_V, atol=1e-12)
        np.testing.assert_array_equal(held.seen.J, state.frame(foot.frame).J)


def test_its_multipliers_are_the_force_at_the_point_of_contact(go2, draw):
    foot, lam = RoundFoot("FR_foot", TILTED, 0.05), np.array([1.0, -2.0, -30.0])
    state = draw(go2)
    R, F = state.frame("FR_foot").T.rotation, foot.A(state).T @ lam
    np.testing.assert_allclose(R @ F[3:], TILTED @ lam, atol=1e-13)
    np.testing.assert_allclose(R @ F[:3], np.cross(-0.05 * TILTED[:, 2], TILTED @ lam), atol=1e-13)
    np.testing.assert_allclose(foot.pseudo_inverse(foot.A(state)) @ F, lam, atol=1e-13)


class TestSole:
    def sole(self, robot, d=DOWN, least=0.0):
        contact = AxesContact("left_sole", VELOCITY_AXES)
        contact.pushes = Sole(d, (0.17, 0.06), 0.6, least)
        return held(robot, {"foot": contact}).contacts["foot"].cone, contact.pushes

    @pytest.mark.parametrize("d", [DOWN, -DOWN])
    def test_its_cone_is_that_of_the_rectangle_turned_to_the_push(self, g1, rng, d):
        cone, _ = self.sole(g1, d)
        U = surface_cone(0.6 / np.sqrt(2.0), 0.085, 0.03)
        for F in rng.normal(size=(20, 6)):
            np.testing.assert_allclose(cone.rows @ F, U @ (F * d[2]), atol=1e-14)
        assert (cone.rows @ np.r_[0, 0, 0, d] >= 0.0).all()

    def test_its_corners_stay_in_the_round_cone(self, g1, rng):
        """Forces of the corners exist, each with |f_t| <= mu N."""
        cone, _ = self.sole(g1)
        for _ in range(20):
            f = rng.uniform(-1.0, 1.0, 2)
            f *= 0.6 / np.linalg.norm(f) * 1.001
            assert (cone.rows @ [0, 0, 0, *f, -1.0]).min() < 0.0

    def test_labels_name_what_binds(self, g1):
        cone, sole = self.sole(g1)
        labels = sole.rows("foot", cone).labels
        count = {
            name: sum(label == f"foot.{name}" for label in labels) for name in ("push", "friction", "pressure", "yaw")
        }
        assert count == {"push": 1, "friction": 4, "pressure": 4, "yaw": 8}
        assert len(labels) == len(cone.rows)

    def test_a_target_is_cut_to_the_cone_and_the_push_kept(self, g1):
        cone, _ = self.sole(g1, least=5.0)
        inside = np.array([0.1, 0.2, 0.0, 1.0, -2.0, -30.0])
        assert cone.cut(inside) == (pytest.approx(inside), "")
        for lam, by in (
            ([0, 0, 0, 100.0, 0, -30.0], "friction"),
            ([9.0, 0, 0, 0, 0, -30.0], "pressure"),
            ([0, 0, 50.0, 0, 0, -30.0], "yaw"),
        ):
            cut, what = cone.cut(np.array(lam, float))
            assert what == by
            assert cut[5] == pytest.approx(-30.0)
            assert (cone.rows @ cut).min() == pytest.approx(0.0, abs=1e-12)
        cut, what = cone.cut(np.array([0, 0, 0, 0, 0, 3.0]))
        assert (what, cut[5]) == ("push", pytest.approx(-5.0))

    def test_it_lies_in_the_plane_of_its_frame(self):
        with pytest.raises(WrenchError, match="expected it to push along z"):
            Sole(np.array([1.0, 0.0, 0.0]), (0.1, 0.1), 0.6)

    def test_lifted_it_has_no_cone(self, g1):
        contact = contacts_of(g1)["left_sole"].without_cone()
        assert held(g1, {"foot": contact}).contacts["foot"].cone is None


def test_settling_damps_motion_against_a_contact_within_its_bound(go2, draw):
    contact = RoundFoot("FL_foot", np.eye(3))
    for _ in range(5):
        state = draw(go2)
        plain = contact.hold(state).rhs.copy()
        contact.settling = Settling(rate=3.0, most=0.5)
        held = contact.hold(state)
        np.testing.assert_allclose(held.rhs, plain - np.clip(3.0 * held.slip, -0.5, 0.5), atol=1e-14)
        contact.settling = None


# --- tasks ---


class TestCom:
    @pytest.mark.parametrize("name", ["go2", "g1", "panda"])
    def test_by_finite_differences(self, request, name):
        robot = request.getfixturevalue(name)
        check_task(ComTask(Hold(pin.SE3(np.eye(3), np.array([0.1, 0.2, 0.6])))), robot)

    def test_it_is_mujocos(self, g1, draw):
        import mujoco

        state = draw(g1)
        data = mujoco.MjData(g1.mujoco)
        data.qpos[:], data.qvel[:] = g1.to_mujoco(state.q, state.v)
        mujoco.mj_forward(g1.mujoco, data)
        mujoco.mj_subtreeVel(g1.mujoco, data)
        c, J, _ = com(state)
        np.testing.assert_allclose(c, data.subtree_com[1], atol=1e-12)
        np.testing.assert_allclose(J @ state.v, data.subtree_linvel[1], atol=1e-12)

    def test_it_follows_its_path(self, go2, draw):
        """The law, of a path that is drawn in turned axes, by differences over time."""
        origin = pin.SE3(TILTED, np.array([0.1, -0.2, 0.4]))
        path = Path(origin, {3: sine(0.1, 2.0), 4: sine(0.05, 1.0)})
        task, h = ComTask(path, [10.0, 20.0, 30.0], 5.0), 1e-5
        state = draw(go2, t=0.7)
        p, v, a = task.desired(state)
        before, after = (path(0.7 + s).T.translation for s in (-h, h))
        np.testing.assert_allclose(p, path(0.7).T.translation, atol=1e-15)
        np.testing.assert_allclose(v, (after - before) / (2 * h), atol=1e-8)
        np.testing.assert_allclose(a, (after - 2 * p + before) / h**2, atol=1e-4)
        (c, J, drift), (G, b) = com(state), task.target(state)
        wanted = a + np.array([10.0, 20.0, 30.0]) * (p - c) + 5.0 * (v - J @ state.v) - drift
        np.testing.assert_allclose(b, wanted, atol=1e-12)
        np.testing.assert_array_equal(G, J)


@pytest.mark.parametrize(("name", "trunk"), [("go2", "base"), ("g1", "pelvis")])
def test_the_orientation_of_the_base_by_finite_differences(request, name, trunk):
    robot = request.getfixturevalue(name)
    task = MotionTask(trunk, Hold(pin.SE3(TILTED, np.zeros(3))), axes=("wx", "wy", "wz"))
    check_task(task, robot, contacts_of(robot, bound=False))


class TestPosture:
    def test_by_finite_differences(self, g1):
        check_task(WholeBodyPosture(g1.keyframes["home"], 20.0, 9.0, g1.nu), g1, contacts_of(g1, bound=False))

    def test_it_does_not_push_the_base(self, g1, draw):
        state = draw(g1)
        far = WholeBodyPosture(pin.integrate(g1.model, state.q, np.r_[np.ones(6), np.zeros(29)]), 20.0, 9.0, 29)
        np.testing.assert_allclose(far.acceleration(state)[:6], -9.0 * state.v[:6], atol=1e-12)
        np.testing.assert_allclose(far.acceleration(state)[6:], -9.0 * state.v[6:], atol=1e-12)

    def test_its_cost_is_blind_to_what_stands_above(self, g1, rng):
        q = pin.integrate(g1.model, g1.keyframes["home"], rng.uniform(-0.3, 0.3, g1.nv))
        controller = Controller(g1, contacts_of(g1), tasks_of(g1, q), q=q)
        controller.reset(q, np.zeros(g1.nv))
        controller.step(0.0, q, np.zeros(g1.nv))
        state = controller.state
        rows, (G, _, _) = controller.phase.tasks["posture"].rows(state), state.primary
        lifted = np.linalg.solve(state.M, G.T)  # what forces along the rows above do
        assert np.abs(rows.metric @ lifted).max() <= 1e-9 * np.abs(rows.metric).max() * np.abs(lifted).max()


class TestDistribution:
    def solved(self, state, task, vdot):
        """Multipliers that the rows want for a motion, stacked."""
        rows = task.rows(state)
        return rows.lo - rows.A["vdot"] @ vdot, rows

    def test_at_rest_round_feet_share_the_weight_upright(self, go2):
        state = held(go2, contacts_of(go2))
        lam, _ = self.solved(state, DistributionTask(), np.zeros(18))
        lam = lam.reshape(4, 3)
        np.testing.assert_allclose(lam[:, :2], 0.0, atol=1e-9)
        assert lam[:, 2].sum() == pytest.approx(-mass(state) * 9.81, rel=1e-12)
        c = com(state)[0]
        feet = np.array([state.frame(name).T.translation for name in FEET])
        np.testing.assert_allclose((lam[:, 2:] * feet).sum(axis=0)[:2] / lam[:, 2].sum(), c[:2], atol=1e-9)

    def test_it_costs_nothing_whatever_the_motion(self, g1, draw, rng):
        """For any vdot there are multipliers that carry it and that the rows want: they compete with no motion."""
        state = draw(g1)
        hold(state, place(g1, contacts_of(g1), {}, {}))
        for shares in ({}, {"left_sole": 0.7, "right_sole": 0.3}):
            vdot = rng.normal(size=35)
            lam, _ = self.solved(state, DistributionTask(shares), vdot)
            P = np.concatenate([each.push[:, :6] for each in state.contacts.values()]).T
            np.testing.assert_allclose(P @ lam, -(state.M[:6] @ vdot + state.bias[:6]), atol=1e-8)

    def test_it_is_the_nearest_to_what_the_shares_say(self, g1):
        state = held(g1, contacts_of(g1))
        shares = {"left_sole": 0.7, "right_sole": 0.3}
        lam, rows = self.solved(state, DistributionTask(shares), np.zeros(35))
        P = np.concatenate([each.push[:, :6] for each in state.contacts.values()]).T
        weight = mass(state) * 9.81
        wanted = np.r_[np.zeros(5), -0.7 * weight, np.zeros(5), -0.3 * weight]
        W = np.tile([400.0, 400.0, 400.0, 1.0, 1.0, 1.0], 2)
        np.testing.assert_allclose(np.diag(rows.metric) * mass(state), W, rtol=1e-12)
        kkt = np.block([[np.diag(W), P.T], [P, np.zeros((6, 6))]])
        best = np.linalg.solve(kkt, np.r_[W * wanted, -state.bias[:6]])[:12]
        np.testing.assert_allclose(lam, best, atol=1e-8)

    def test_what_others_carry_is_left_to_them(self, g1, rng):
        """Contacts that do not share, a hand that presses, count with their own multipliers."""
        contacts = contacts_of(g1) | {"hand": AxesContact("left_palm", ("vz",))}
        state = held(g1, contacts)
        rows = DistributionTask().rows(state, ["left_sole", "right_sole"])
        hand, vdot = np.array([-15.0]), rng.normal(size=35)
        lam = rows.lo - rows.A["vdot"] @ vdot - rows.A["hand"] @ hand
        P = np.concatenate([state.contacts[name].push[:, :6] for name in ("left_sole", "right_sole")]).T
        carried = P @ lam + state.contacts["hand"].push[:, :6].T @ hand
        np.testing.assert_allclose(carried, -(state.M[:6] @ vdot + state.bias[:6]), atol=1e-8)

    def test_shares_are_not_negative(self):
        with pytest.raises(GainError, match="expected 0 or more"):
            DistributionTask({"left": -0.1})
