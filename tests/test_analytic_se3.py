"""SE(3) and its errors against the matrix exponential, derivatives and Pinocchio."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pinocchio as pin
import pytest
import scipy.linalg
from plants import hat, pose

from wbc import analytic
from wbc.analytic import Array

ANGULAR_FIRST = np.array([3, 4, 5, 0, 1, 2])  # Pinocchio stacks the linear part first


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(11)


class TestSE3:
    def test_skew_is_the_cross_product(self, rng: np.random.Generator) -> None:
        a, b = rng.normal(size=(2, 3))
        assert analytic.skew(a) @ b == pytest.approx(np.cross(a, b), abs=1e-15)

    @pytest.mark.parametrize("angle", [0, 1e-12, 1e-6, 1e-3, 0.29999, 0.30001, 1, 3, np.pi - 1e-9, np.pi, 5, 20])
    def test_exponentials_are_matrix_exponentials(self, rng: np.random.Generator, angle: float) -> None:
        w, v = rng.normal(size=(2, 3))
        V = np.concatenate([w / np.linalg.norm(w) * angle, v])
        assert analytic.exp6(V) == pytest.approx(scipy.linalg.expm(hat(V)), abs=2e-14)
        assert analytic.exp3(V[:3]) == pytest.approx(analytic.exp6(V)[:3, :3], abs=0)

    @pytest.mark.parametrize("angle", [0, 1e-200, 1e-12, 1e-6, 0.3, 1, 3, np.pi - 1e-4, np.pi - 1e-8, np.pi - 1e-12])
    def test_logarithms_undo_the_exponentials(self, rng: np.random.Generator, angle: float) -> None:
        for _ in range(50):
            w, v = rng.normal(size=(2, 3))
            V = np.concatenate([w / np.linalg.norm(w) * angle, v])
            assert analytic.log6(analytic.exp6(V)) == pytest.approx(V, abs=1e-14)
            assert analytic.log3(analytic.exp3(V[:3])) == pytest.approx(V[:3], abs=1e-14)

    @pytest.mark.parametrize("axis", [(1, 0, 0), (0, 1, 0), (0, 0, 1), (0.6, 0.8, 0), (0, -0.6, 0.8)])
    def test_logarithm_of_half_a_turn(self, axis: tuple[float, float, float]) -> None:
        a = np.array(axis, dtype=float)
        R = 2 * np.outer(a, a) - np.eye(3)
        w = analytic.log3(R)
        assert np.linalg.norm(w) == pytest.approx(np.pi, abs=1e-15)
        assert np.linalg.norm(np.cross(w, a)) == pytest.approx(0, abs=1e-15)

    def test_inverse_and_adjoint_carry_twists(self, rng: np.random.Generator) -> None:
        T, V = pose(rng), rng.normal(size=6)
        assert analytic.inverse(T) @ T == pytest.approx(np.eye(4), abs=1e-15)
        assert hat(analytic.adjoint(T) @ V) == pytest.approx(T @ hat(V) @ np.linalg.inv(T), abs=1e-14)

    def test_ad_is_the_commutator_and_the_rate_of_the_adjoint(self, rng: np.random.Generator) -> None:
        V, W = rng.normal(size=(2, 6))
        assert hat(analytic.ad(V) @ W) == pytest.approx(hat(V) @ hat(W) - hat(W) @ hat(V), abs=1e-14)
        step = [analytic.adjoint(analytic.exp6(s * V)) for s in (1e-5, -1e-5)]
        assert (step[0] - step[1]) / 2e-5 == pytest.approx(analytic.ad(V), abs=1e-8)

    def test_pinocchio_agrees(self, rng: np.random.Generator) -> None:
        T, V = pose(rng), rng.normal(size=6)
        X, motion = pin.SE3(T), pin.Motion(V[ANGULAR_FIRST])
        swap = np.ix_(ANGULAR_FIRST, ANGULAR_FIRST)
        assert analytic.adjoint(T) == pytest.approx(X.action[swap], abs=1e-14)
        assert analytic.ad(V) == pytest.approx(motion.action[swap], abs=1e-14)
        assert analytic.exp6(V) == pytest.approx(pin.exp6(motion).homogeneous, abs=1e-14)
        assert analytic.log6(T) == pytest.approx(pin.log6(X).vector[ANGULAR_FIRST], abs=1e-13)


class TestErrors:
    def test_errors_vanish_on_the_target(self, rng: np.random.Generator) -> None:
        T, V = pose(rng), rng.normal(size=6)
        assert analytic.pose_error(T, T) == pytest.approx(np.zeros(6), abs=1e-15)
        assert analytic.twist_error(T, V, T, V) == pytest.approx(np.zeros(6), abs=1e-15)

    def test_pose_error_is_the_twist_that_arrives_in_one_second(self, rng: np.random.Generator) -> None:
        T, T_d = pose(rng), pose(rng)
        assert T @ scipy.linalg.expm(hat(analytic.pose_error(T, T_d))) == pytest.approx(T_d, abs=1e-13)

    def test_twist_error_is_the_rate_of_a_small_pose_error(self, rng: np.random.Generator) -> None:
        T, (V, V_d) = pose(rng), rng.normal(size=(2, 6))
        ahead, behind = (
            analytic.pose_error(T @ analytic.exp6(s * V), T @ analytic.exp6(s * V_d)) for s in (1e-5, -1e-5)
        )
        assert (ahead - behind) / 2e-5 == pytest.approx(analytic.twist_error(T, V, T, V_d), abs=1e-8)

    def test_split_error_goes_straight_where_the_screw_bends(self) -> None:
        # a chord of 0.3 m under 1 rad: the screw's arc stands off it by (0.3/2) tan(1/4) = 38 mm
        T, T_d = np.eye(4), analytic.exp6(np.array([0, 0, 1.0, 0, 0, 0]))
        T_d[:3, 3] = [0.3, 0, 0]
        bent = follow(T, T_d, analytic.pose_error)
        straight = follow(T, T_d, analytic.pose_error_split)
        assert np.abs(bent[:, 1:]).max() == pytest.approx(0.15 * np.tan(0.25), rel=0.02)
        assert np.abs(straight[:, 1:]).max() < 1e-15
        for path in (bent, straight):
            assert path[-1] == pytest.approx([0.3, 0, 0], abs=1e-3)

    def test_split_error_is_the_rotation_and_the_way_left(self, rng: np.random.Generator) -> None:
        for _ in range(20):
            T, T_d = pose(rng), pose(rng)
            X = analytic.pose_error_split(T, T_d)
            assert T[:3, :3] @ scipy.linalg.expm(hat(np.append(X[:3], np.zeros(3)))[:3, :3]) == pytest.approx(
                T_d[:3, :3], abs=1e-13
            )
            assert T[:3, 3] + T[:3, :3] @ X[3:] == pytest.approx(T_d[:3, 3], abs=1e-14)

    def test_split_error_is_the_screw_to_first_order(self, rng: np.random.Generator) -> None:
        T, V = pose(rng), rng.normal(size=6)
        T_d = T @ analytic.exp6(1e-5 * V)
        assert analytic.pose_error_split(T, T_d) == pytest.approx(analytic.pose_error(T, T_d), abs=1e-9)


def follow(T: Array, T_d: Array, error: Callable[[Array, Array], Array]) -> Array:
    """Origins (N, 3) on the way from T to T_d with a body twist in proportion to the error, by Euler's rule."""
    R, path = T[:3, :3], [T[:3, 3]]
    for _ in range(600):
        X = 0.01 * error(np.block([[R, path[-1][:, None]], [np.zeros((1, 3)), np.ones((1, 1))]]), T_d)
        path.append(path[-1] + R @ X[3:])
        R = R @ analytic.exp3(X[:3])
    return np.array(path)
