"""Desired motion: twist and acceleration are the derivatives of the pose; scalars end where they say."""

import numpy as np
import pinocchio as pin
import pytest

from wbc.reference import Path, Sample, ScrewPath, constant, hold, quintic, ramp, sine

H = 1e-6
TILTED = pin.SE3(pin.exp3(np.array([0.3, -0.5, 0.9])), np.array([0.4, -0.1, 0.3]))
OFFSET = pin.SE3(pin.exp3(np.array([-1.0, 0.4, 0.2])), np.array([0.05, 0.1, -0.2]))
TIMES = np.linspace(0.05, 3.0, 23)


def angular_first(x):
    return np.r_[x[3:], x[:3]]


def check(reference, times=TIMES, tolerance=1e-8):
    """V is the body twist of T, Vdot the derivative of V."""
    for t in times:
        here, before, after = reference(t), reference(t - H), reference(t + H)
        step = pin.log6(here.T.actInv(after.T)).vector - pin.log6(here.T.actInv(before.T)).vector
        np.testing.assert_allclose(here.V, angular_first(step) / (2 * H), atol=tolerance)
        np.testing.assert_allclose(here.Vdot, (after.V - before.V) / (2 * H), atol=tolerance)


def scalars(rng, n):
    """Sines of random size and phase, some of them easing in."""
    return [
        sine(rng.uniform(0.1, 0.8), rng.uniform(1, 4), rng.uniform(-3, 3), rng.uniform(-0.5, 0.5), i % 2)
        for i in range(n)
    ]


@pytest.mark.parametrize(
    "axes", [*[(i,) for i in range(6)], (3, 4), (0, 1), (0, 2), (1, 2), (0, 1, 2), (2, 3, 5), (0, 1, 2, 3, 4, 5)]
)
def test_paths_differentiate_to_their_twist(axes, rng):
    along = dict(zip(axes, scalars(rng, len(axes)), strict=True))
    check(Path(TILTED, along))
    check(Path(TILTED, along, OFFSET))


def test_path_is_the_product_of_exponentials(rng):
    along = dict(enumerate(scalars(rng, 6)))
    for t in TIMES:
        s = [along[i](t)[0] for i in range(6)]
        T = TILTED * pin.SE3(np.eye(3), np.array(s[3:]))
        for i in (2, 1, 0):  # about z, then y, then x
            T = T * pin.SE3(pin.exp3(s[i] * np.eye(3)[i]), np.zeros(3))
        np.testing.assert_allclose(Path(TILTED, along)(t).T.homogeneous, T.homogeneous, atol=1e-14)
        np.testing.assert_allclose(Path(TILTED, along, OFFSET)(t).T.homogeneous, (T * OFFSET).homogeneous, atol=1e-14)


@pytest.mark.parametrize("count", [1, 2, 3, 6])
def test_screw_paths_differentiate_to_their_twist(count, rng):
    screws = rng.normal(size=(count, 6))
    screws[0, :3] = 0.0  # a pure translation
    check(ScrewPath(TILTED, screws, scalars(rng, count), OFFSET), tolerance=1e-7)


def test_one_screw_is_the_exponential(rng):
    S = rng.normal(size=6)
    sample = ScrewPath(TILTED, [S], [ramp(0.3, 0.1)], OFFSET)(2.0)
    T = TILTED * pin.exp6(pin.Motion(0.7 * S[3:], 0.7 * S[:3])) * OFFSET
    np.testing.assert_allclose(sample.T.homogeneous, T.homogeneous, atol=1e-14)


def test_without_screws_a_screw_path_stays():
    sample = ScrewPath(TILTED, [], [], OFFSET)(1.0)
    np.testing.assert_array_equal(sample.T.homogeneous, (TILTED * OFFSET).homogeneous)
    np.testing.assert_array_equal(sample.motion, np.zeros((6, 2)))


def test_hold_stays_and_keeps_a_pose_of_its_own():
    T = TILTED.copy()
    reference = hold(T)
    T.translation = np.zeros(3)
    np.testing.assert_array_equal(reference(5.0).T.translation, TILTED.translation)
    np.testing.assert_array_equal(reference(5.0).motion, np.zeros((6, 2)))


def test_path_of_nothing_is_its_origin():
    sample = Path(TILTED, {})(3.0)
    assert isinstance(sample, Sample)
    np.testing.assert_allclose(sample.T.homogeneous, TILTED.homogeneous)
    np.testing.assert_array_equal(sample.motion, np.zeros((6, 2)))


# --- scalars ---

SCALARS = {
    "constant": constant(0.7),
    "ramp": ramp(-0.4, 1.0),
    "sine": sine(0.3, 2.0, 0.4, 0.1),
    "eased sine": sine(0.3, 2.0, 0.4, 0.1, ease=1.5),
    "quintic": quintic((0.5, 1.3, 2.9), (0.1, -0.4, 0.8)),
}


@pytest.mark.parametrize("name", SCALARS)
def test_scalars_give_their_own_derivatives(name):
    scalar = SCALARS[name]
    for t in np.linspace(-0.3, 3.3, 61) + 1e-4:
        _, rate, bend = scalar(t)
        assert rate == pytest.approx((scalar(t + H)[0] - scalar(t - H)[0]) / (2 * H), abs=1e-8)
        assert bend == pytest.approx((scalar(t + H)[1] - scalar(t - H)[1]) / (2 * H), abs=1e-8)


def test_ramp_and_constant():
    assert ramp(2.0, 1.0)(3.0) == (7.0, 2.0, 0.0)
    assert constant(4.0)(9.0) == (4.0, 0.0, 0.0)


def test_quintic_rests_at_every_waypoint():
    times, values = (0.5, 1.3, 2.9), (0.1, -0.4, 0.8)
    scalar = quintic(times, values)
    for t, value in zip(times, values, strict=True):
        np.testing.assert_allclose(scalar(t), (value, 0.0, 0.0), atol=1e-14)
        for side in (-1e-5, 1e-5):  # acceleration too is continuous
            np.testing.assert_allclose(scalar(t + side), (value, 0.0, 0.0), atol=1e-3)
    assert scalar(-9.0) == (0.1, 0.0, 0.0)
    assert scalar(99.0) == (0.8, 0.0, 0.0)
    # halfway in time is halfway in space, at 15/8 of the mean speed (book 9.2.2)
    np.testing.assert_allclose(scalar(0.9), (-0.15, 15 / 8 * -0.5 / 0.8, 0.0), atol=1e-12)


def test_ease_starts_at_rest_and_is_smooth_to_the_second_derivative():
    scalar, plain = sine(0.3, 2.0, 0.4, 0.1, ease=1.5), sine(0.3, 2.0, 0.4, 0.1)
    start = 0.1 + 0.3 * np.sin(0.4)
    for t in (-1.0, 0.0):
        assert scalar(t) == pytest.approx((start, 0.0, 0.0), abs=1e-14)
    for edge in (0.0, 1.5):
        np.testing.assert_allclose(scalar(edge - 1e-7), scalar(edge + 1e-7), atol=1e-5)
    # afterwards it is the plain sine, later by half the time of easing
    for t in (1.5, 2.2, 7.0):
        np.testing.assert_allclose(scalar(t), plain(t - 0.75), atol=1e-13)
