"""The hybrid motion-force law against the plant, solved whole in joint space."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.linalg
from plants import Plant, full_rank, motion_axes, pose, sizes, spd, tangent

from wbc import analytic
from wbc.analytic import Array
from wbc.errors import NameNotFound


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(11)


class TestComputedTorque:
    def test_feedforward_is_the_derivative_of_the_desired_twist_seen_from_the_frame(
        self, rng: np.random.Generator
    ) -> None:
        T, T_d, (V, V_d, Vdot_d) = pose(rng), pose(rng), rng.normal(size=(3, 6))

        def seen(s: float) -> Array:
            actual, desired = T @ analytic.exp6(s * V), T_d @ analytic.exp6(s * V_d + s * s / 2 * Vdot_d)
            return analytic.twist_error(actual, np.zeros(6), desired, V_d + s * Vdot_d)

        y = analytic.computed_torque(T, V, T_d, V_d, Vdot_d, Kp=0, Kd=0)
        assert y == pytest.approx((seen(1e-5) - seen(-1e-5)) / 2e-5, abs=1e-8)

    def test_closed_loop_on_the_group_converges_to_a_moving_target(self, rng: np.random.Generator) -> None:
        dt, Vdot_d = 1e-3, np.array([0.2, -0.1, 0.3, 0.1, 0.2, -0.2])
        T, T_d, V, V_d = pose(rng), pose(rng), rng.normal(size=6), rng.normal(size=6)
        errors = []
        for _ in range(3000):
            errors.append(np.linalg.norm(analytic.pose_error(T, T_d)))
            y = analytic.computed_torque(T, V, T_d, V_d, Vdot_d, Kp=100, Kd=20)
            T, T_d = T @ analytic.exp6(dt * V + dt**2 / 2 * y), T_d @ analytic.exp6(dt * V_d + dt**2 / 2 * Vdot_d)
            V, V_d = V + dt * y, V_d + dt * Vdot_d
        assert errors[0] > 1
        assert errors[1000] < 0.01 * errors[0]
        assert errors[-1] < 1e-5


class TestHybrid:
    @sizes
    def test_book_law_on_the_plant(self, rng: np.random.Generator, r: int, n: int, k: int) -> None:
        plant, y, F = Plant.random(rng, r, n, k), rng.normal(size=r), 10 * rng.normal(size=r)
        vdot, lam = plant.react(analytic.hybrid_torque(*plant.arm, y, F))
        bias = analytic.force_bias(plant.A, plant.M_C, plant.Adot_V)
        pressed = analytic.force_projector(plant.A, plant.M_C) @ F
        assert plant.A.T @ lam == pytest.approx(pressed + plant.A.T @ bias, abs=1e-10)
        missed = tangent(plant.A).T @ plant.M_C @ (plant.twist_rate(vdot) - y)
        assert missed == pytest.approx(np.zeros(r - k), abs=1e-10)

    @sizes
    def test_compensated_law_on_the_plant(self, rng: np.random.Generator, r: int, n: int, k: int) -> None:
        plant, y, lam_d = Plant.random(rng, r, n, k), rng.normal(size=r), 10 * rng.normal(size=k)
        friction = rng.normal(size=r)
        F = plant.A.T @ lam_d + friction - plant.A.T @ np.linalg.pinv(plant.A.T) @ friction
        S = motion_axes(rng, plant.A)
        for rows in (S, None):
            tau = analytic.hybrid_torque(*plant.arm, y, F, Adot_V=plant.Adot_V, law="compensated", S=rows)
            vdot, lam = plant.react(tau)
            assert lam == pytest.approx(lam_d, abs=1e-10)
            Vdot = plant.twist_rate(vdot)
            if rows is None:  # the nearest in M_C: what is left of y is M_C-orthogonal to every free motion
                assert plant.A @ Vdot == pytest.approx(-plant.Adot_V, abs=1e-10)
                assert tangent(plant.A).T @ plant.M_C @ (Vdot - y) == pytest.approx(np.zeros(r - k), abs=1e-10)
            else:
                assert S @ Vdot == pytest.approx(S @ y, abs=1e-10)

    @sizes
    def test_laws_coincide_on_a_flat_contact(self, rng: np.random.Generator, r: int, n: int, k: int) -> None:
        plant, y = Plant.random(rng, r, n, k), rng.normal(size=r)
        y = y - np.linalg.pinv(plant.A) @ plant.A @ y
        F, posture = plant.A.T @ rng.normal(size=k), rng.normal(size=n)
        book = analytic.hybrid_torque(*plant.arm, y, F, vdot_posture=posture)
        compensated = analytic.hybrid_torque(*plant.arm, y, F, law="compensated", vdot_posture=posture)
        assert compensated == pytest.approx(book, abs=1e-11)

    @sizes
    def test_joint_space_law_is_the_same_torque(self, rng: np.random.Generator, r: int, n: int, k: int) -> None:
        plant, y, F = Plant.random(rng, r, n, k), rng.normal(size=r), rng.normal(size=r)
        S = motion_axes(rng, plant.A)
        G = np.vstack([plant.A, S])
        posture, target = rng.normal(size=n), np.concatenate([-plant.Adot_V, S @ y])
        vdot = analytic.hybrid_acceleration(plant.M, G @ plant.J, target, G @ plant.drift, posture)
        lam = analytic.multiplier_error(plant.A, F)
        expected = analytic.inverse_dynamics(plant.M, plant.h, vdot, plant.J, plant.A, lam)
        tau = analytic.hybrid_torque(
            *plant.arm, y, F, Adot_V=plant.Adot_V, law="compensated", vdot_posture=posture, S=S
        )
        assert tau == pytest.approx(expected, abs=1e-10)
        assert plant.react(tau)[0] == pytest.approx(vdot, abs=1e-10)

    def test_posture_moves_the_null_space_alone(self, rng: np.random.Generator) -> None:
        plant, y, posture = Plant.random(rng, 6, 9, 3), rng.normal(size=6), rng.normal(size=9)
        rest, moved = (
            plant.react(analytic.hybrid_torque(*plant.arm, y, np.zeros(6), vdot_posture=p)) for p in (None, posture)
        )
        null = scipy.linalg.null_space(plant.J)
        assert plant.J @ (moved[0] - rest[0]) == pytest.approx(np.zeros(6), abs=1e-11)
        assert moved[1] == pytest.approx(rest[1], abs=1e-11)
        assert null.T @ plant.M @ (moved[0] - posture) == pytest.approx(np.zeros(3), abs=1e-11)
        assert null.T @ plant.M @ rest[0] == pytest.approx(np.zeros(3), abs=1e-11)

    def test_contact_and_motion_that_do_not_span_the_task(self, rng: np.random.Generator) -> None:
        # of all accelerations that reach the target, the one M-nearest to the posture; a repeated row changes nothing
        M, G, posture = spd(rng, 9), full_rank(rng, 4, 9), rng.normal(size=9)
        Gdot_v, target = rng.normal(size=(2, 4))
        vdot = analytic.hybrid_acceleration(M, G, target, Gdot_v, posture)
        kkt = np.block([[M, G.T], [G, np.zeros((4, 4))]])
        assert vdot == pytest.approx(
            np.linalg.solve(kkt, np.concatenate([M @ posture, target - Gdot_v]))[:9], abs=1e-12
        )
        twice = [np.concatenate([x, x[:2]]) for x in (G, target, Gdot_v)]
        assert analytic.hybrid_acceleration(M, *twice, posture) == pytest.approx(vdot, abs=1e-12)
        assert analytic.hybrid_acceleration(M, np.zeros((0, 9)), np.zeros(0), np.zeros(0), posture) == pytest.approx(
            posture, abs=0
        )

    def test_book_law_leaks_an_error_on_a_held_axis_by_the_metric(self, rng: np.random.Generator) -> None:
        # y errs by e = kp * 1 mrad about the held x axis; the nearest possible motion depends on what "near" means
        plant, e = Plant.random(rng, 6, 7, 1), 100 * 1e-3
        flat = Plant(plant.M, plant.h, plant.J, plant.drift, np.eye(6)[:1], np.zeros(1))
        y = np.append(e, np.zeros(5))
        Vdot = flat.twist_rate(flat.react(analytic.hybrid_torque(*flat.arm, y, np.zeros(6)))[0])

        def nearest(W: Array) -> Array:
            root = np.linalg.cholesky(W).T
            return np.append(0, np.linalg.lstsq(root[:, 1:], root @ y, rcond=None)[0])

        assert nearest(np.eye(6)) == pytest.approx(np.zeros(6), abs=1e-15)
        assert nearest(flat.M_C) == pytest.approx(Vdot, abs=1e-13)
        compliance = np.linalg.inv(flat.M_C)
        assert Vdot[1:] == pytest.approx(-compliance[1:, 0] / compliance[0, 0] * e, abs=1e-13)
        assert np.abs(Vdot[1:]).max() > 0.05 * e

    def test_unknown_law(self, rng: np.random.Generator) -> None:
        plant = Plant.random(rng, 3, 3, 1)
        with pytest.raises(NameNotFound, match="no law named 'boook'; did you mean 'book'"):
            analytic.hybrid_torque(*plant.arm, np.zeros(3), np.zeros(3), law="boook")  # type: ignore[arg-type]
