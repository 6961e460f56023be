"""Every kind of contact against finite differences, and the checks of `wbc.testing` against contacts that are wrong."""

import re

import numpy as np
import pinocchio as pin
import pytest

from wbc.contact import Contact, complement
from wbc.contact.axes import AxesContact, MatrixContact, WorldAxesContact
from wbc.contact.screw import ScrewContact
from wbc.contact.sphere import SphereContact
from wbc.errors import WrenchError
from wbc.testing import check_contact
from wbc.wrench import VELOCITY_AXES

TILTED = pin.SE3(pin.exp3(np.array([0.3, -0.5, 0.9])), np.array([0.4, -0.1, 0.3]))


@pytest.mark.parametrize("k", range(7))
def test_matrix_contacts(panda, rng, k):
    contact = MatrixContact("eraser", rng.normal(size=(k, 6)))
    check_contact(contact, panda)
    np.testing.assert_allclose(contact.free(None) @ contact.A(None).T, 0.0, atol=1e-12)


@pytest.mark.parametrize("k", range(7))
def test_axes_contacts(panda, rng, k):
    held = tuple(VELOCITY_AXES[i] for i in sorted(rng.permutation(6)[:k]))
    contact = AxesContact("eraser", held)
    check_contact(contact, panda)
    assert contact.free_axes == tuple(a for a in VELOCITY_AXES if a not in held)
    assert contact.axes == tuple("mf"[a[0] == "v"] + a[1] for a in held)


@pytest.mark.parametrize("k", range(7))
def test_world_axes_contacts(panda, rng, k):
    held = tuple(VELOCITY_AXES[i] for i in sorted(rng.permutation(6)[:k]))
    check_contact(WorldAxesContact("eraser", held, TILTED.rotation), panda)


@pytest.mark.parametrize("k", range(7))
def test_screw_contacts(panda, rng, k):
    contact = ScrewContact("eraser", rng.normal(size=(6 - k, 6)), TILTED)
    assert contact.k == k
    check_contact(contact, panda)


def test_sphere_contacts(panda, ur5e):
    check_contact(SphereContact("eraser", TILTED.translation), panda)
    check_contact(SphereContact("flange", TILTED.translation), ur5e)


def test_planar_contacts(planar3r):
    # the axes of the plane: wy, vx, vz
    for held in ((), ("vz",), ("wy", "vz"), ("wy", "vx", "vz")):
        free = tuple(a for a in ("wy", "vx", "vz") if a not in held)
        check_contact(AxesContact("flange", held, free), planar3r)
    check_contact(WorldAxesContact("flange", ("vz",), np.eye(3), ("wy", "vx")), planar3r)
    check_contact(SphereContact("flange", np.array([0.2, 0.0, 0.1])), planar3r)


# --- what a contact means ---


def test_world_axes_keep_the_normal_while_the_frame_turns(panda, draw):
    contact = WorldAxesContact("eraser", ("vz",), TILTED.rotation)
    for _ in range(5):
        state = draw(panda)
        frame = state.frame("eraser")
        speed = TILTED.rotation[:, 2] @ (frame.T.rotation @ frame.V[3:])
        assert contact.A(state) @ frame.V == pytest.approx([speed], abs=1e-14)


def test_the_free_screws_are_free_and_named(panda, draw):
    hinge = np.array([[0.0, 0.0, 1.0, 0.2, -0.1, 0.0]])
    contact = ScrewContact("eraser", hinge, TILTED, ("swing",))
    assert contact.free_axes == ("swing",)
    state = draw(panda)
    X = TILTED.actInv(state.frame("eraser").T).inverse().toActionMatrix()
    V = X[np.ix_([3, 4, 5, 0, 1, 2], [3, 4, 5, 0, 1, 2])] @ hinge[0]  # the hinge's twist in the axes of the frame
    np.testing.assert_allclose(contact.A(state) @ V, 0.0, atol=1e-12)
    np.testing.assert_allclose(contact.free(state) @ V, 1.0, atol=1e-12)
    assert ScrewContact("eraser", hinge, TILTED).free_axes == ("free1",)


def test_a_sphere_is_a_distance(panda, draw):
    contact = SphereContact("eraser", TILTED.translation)
    state = draw(panda)
    step = 1e-6
    q = [pin.integrate(panda.model, state.q, h * state.v) for h in (-step, step)]
    near, far = (np.linalg.norm(panda.state(x, state.v).frame("eraser").T.translation - TILTED.translation) for x in q)
    assert contact.A(state) @ state.frame("eraser").V == pytest.approx([(far - near) / (2 * step)], abs=1e-8)
    assert contact.axes == ("normal",)


def test_the_table_holds_contact_rows_then_free_rows(panda, draw, rng):
    state = draw(panda)
    for contact in (
        MatrixContact("eraser", rng.normal(size=(3, 6))),
        WorldAxesContact("eraser", ("wx", "vz"), TILTED.rotation),
        SphereContact("eraser", TILTED.translation),
        ScrewContact("eraser", rng.normal(size=(2, 6)), TILTED),
    ):
        held, frame, k = contact.hold(state), state.frame("eraser"), contact.k
        assert held.table.shape == (6, 9)
        basis = np.r_[held.A, held.free]
        np.testing.assert_allclose(held.table, basis @ np.c_[frame.J, frame.drift, frame.V], atol=1e-13)
        np.testing.assert_array_equal(held.table[:k, :7], held.G)
        rows = contact.rows("board", held)
        assert rows.lo is rows.hi is held.rhs
        assert contact.labels("board") == tuple(f"board.{axis}" for axis in contact.axes)
        # an acceleration that satisfies the rows keeps A V constant
        vdot = np.linalg.pinv(held.G) @ held.rhs
        Adot_V = np.zeros(k) if held.Adot_V is None else held.Adot_V
        np.testing.assert_allclose(held.A @ (frame.J @ vdot + frame.drift) + Adot_V, 0.0, atol=1e-10)


# --- wrenches ---


def test_multipliers_of_a_wrench_that_the_contact_carries(panda, draw, rng):
    state, lam = draw(panda), rng.normal(size=3)
    for contact in (
        MatrixContact("eraser", rng.normal(size=(3, 6))),
        WorldAxesContact("eraser", ("wx", "wy", "vz"), TILTED.rotation),
        ScrewContact("eraser", rng.normal(size=(3, 6)), TILTED),
    ):
        np.testing.assert_allclose(contact.multipliers(contact.A(state).T @ lam, state), lam, atol=1e-12)


@pytest.mark.parametrize(
    ("wrench", "message"),
    [
        ([0, 0, 0, 3.0, 0, -10], r"cannot carry fx \(\+3\) of the desired wrench"),
        ([0, 0, 0.5, 0, -2.0, -10], r"cannot carry mz \(\+0.5\), fy \(-2\) of the desired wrench"),
    ],
)
def test_a_wrench_outside_the_column_space_is_refused_by_component(panda, draw, wrench, message):
    contact = AxesContact("eraser", ("wx", "wy", "vz"))
    with pytest.raises(WrenchError, match=message):
        contact.multipliers(np.array(wrench), draw(panda))


def test_dependent_rows_are_refused():
    row = np.array([0.0, 0, 0, 0, 0, 1])
    with pytest.raises(WrenchError, match=re.escape("the 2 rows of A are not independent (rank 1)")):
        MatrixContact("eraser", np.array([row, 2 * row]))
    with pytest.raises(WrenchError, match="the free screws are not independent"):
        ScrewContact("eraser", np.array([row, row]), TILTED)


def test_complement(rng):
    for k in range(7):
        A = rng.normal(size=(k, 6))
        N = complement(A)
        assert N.shape == (6 - k, 6)
        np.testing.assert_allclose(N @ N.T, np.eye(6 - k), atol=1e-12)
        np.testing.assert_allclose(N @ A.T, 0.0, atol=1e-12)


# --- the checks find what is wrong ---


class Sphere(SphereContact):
    """A sphere with one thing wrong."""

    def __init__(self, wrong):
        super().__init__("eraser", TILTED.translation)
        self.wrong = wrong

    def A(self, state):
        A = super().A(state)
        return {"shape": A[0], "nan": A * np.nan, "rank": 0 * A}.get(self.wrong, A)

    def Adot_V(self, state):
        right = super().Adot_V(state)
        return {"Adot_V": right * 1.001, "Adot_V shape": right[0]}.get(self.wrong, right)

    def free(self, state):
        right = complement(SphereContact.A(self, state))
        return {"free": np.r_[right[:4], SphereContact.A(self, state)], "free count": right[:4]}.get(self.wrong, right)

    def pseudo_inverse(self, A):
        return 2 * A if self.wrong == "inverse" else super().pseudo_inverse(A)

    @property
    def axes(self):
        return ("normal", "more") if self.wrong == "names" else ("normal",)


WRONG = {
    "shape": r"A at state 0 of seed 3: expected shape \(1, 6\), got \(6,\)",
    "nan": "A at state 0 of seed 3: expected finite numbers, got .*nan",
    "rank": "the rank of A at state 0 of seed 3: expected 1, got 0",
    "Adot_V": r"Adot_V at state 0 of seed 3: expected \[.*\], got \[.*\] \(.* off, .* allowed\)",
    "Adot_V shape": r"Adot_V at state 0 of seed 3: expected shape \(1,\), got \(\)",
    "free": "the rank of A and free on the axes of the robot at state 0 of seed 3: expected 6, got 5",
    "free count": r"free at state 0 of seed 3: expected shape \(5, 6\), got \(4, 6\)",
    "inverse": "inverse of hold times A', the identity at state 0 of seed 3: expected",
    "names": r"len\(axes\) in its names: expected 1, got 2",
}


@pytest.mark.parametrize("wrong", WRONG)
def test_check_contact_names_what_is_wrong(panda, wrong):
    check_contact(Sphere(""), panda)
    with pytest.raises(AssertionError, match=WRONG[wrong]):
        check_contact(Sphere(wrong), panda, seed=3)


def test_a_contact_of_ones_own_needs_only_two_methods(panda):
    class Wall(Contact):
        frame, k = "eraser", 1

        def A(self, state):
            return np.r_[np.zeros(3), state.frame("eraser").T.rotation[0]][None]  # the wall's normal is world x

        def Adot_V(self, state):
            frame = state.frame("eraser")
            return np.array([frame.T.rotation[0] @ np.cross(frame.V[:3], frame.V[3:])])

    check_contact(Wall(), panda)
