"""`polish_sphere`: a curved contact, where Adot V is not zero, and the bias that the book's law leaves there."""

import bars
import numpy as np
import pinocchio as pin
import pytest

from wbc import analytic
from wbc.build import build
from wbc.errors import SpecError
from wbc.reference import SpherePath, sine
from wbc.run import run
from wbc.spec import load

OPEN = ("tasks.press.kp=0", "tasks.press.ki=0")


def biases(*changes):
    """Of a run beyond its first second [N]: means of the true force less the commanded one, and of Lam Adot V.

    The command is the target less the damping along the normal, which sees half a tick of the path's curvature.
    """
    built = build(load("polish_sphere", ["duration=3", *changes]))
    log = run(built).log
    contact, predicted, slip = built.controller.phase.contacts["dome"], [], []
    damping = built.controller.phase.tasks["press"].K_damp
    late = log["t"] > 1.0
    for q, v in zip(log["q"][late], log["v"][late], strict=True):
        state = built.robot.state(q, v)
        G = contact.A(state) @ state.frame("ball").J
        slip.append(damping @ G @ v)
        predicted.append(analytic.task_inertia(state.M, G) @ contact.Adot_V(state))
    error = (log["dome.lam"] - log["dome.target"])[late]
    return (error + slip).mean(), np.mean(predicted), error.mean()


def test_the_books_law_leaves_the_predicted_bias():
    found, predicted, _ = biases("law=book", *OPEN)
    assert found >= bars.SPHERE_BIAS * 5.0
    assert found == pytest.approx(predicted, rel=bars.SPHERE_PREDICTED)


def test_compensated_there_is_none():
    _, predicted, found = biases()
    assert predicted >= bars.SPHERE_BIAS * 5.0, "the same motion as under the book's law"
    assert abs(found) <= bars.SPHERE_COMPENSATED * 5.0


def test_path_stays_on_the_sphere_and_its_derivatives_are_right():
    origin = pin.SE3(pin.exp3(np.array([0.3, -0.2, 0.5])), np.array([0.1, 0.2, 0.3]))
    path = SpherePath(origin, 0.11, sine(0.05, 1.7), sine(0.04, 1.1, 0.4))
    for t in (0.0, 0.3, 1.9):
        ahead, here, behind = path(t + 1e-4), path(t), path(t - 1e-4)
        assert np.linalg.norm(here.T.translation - origin.translation) == pytest.approx(0.11)
        p = [sample.T.translation for sample in (behind, here, ahead)]
        R = here.T.rotation
        np.testing.assert_allclose(R @ here.V[3:], (p[2] - p[0]) / 2e-4, atol=1e-6)
        np.testing.assert_allclose(R @ here.Vdot[3:], (p[2] - 2 * p[1] + p[0]) / 1e-8, atol=1e-4)
        np.testing.assert_array_equal(here.motion[:3], 0.0)


@pytest.mark.parametrize(
    ("change", "place", "said"),
    [
        ("contacts.dome.surface.sphere.radius=-1", "contacts.dome.surface.sphere.radius", "greater than 0"),
        ("contacts.dome.surface={cube: {}}", "contacts.dome.surface.cube", "unknown key"),
        ("contacts.dome.surface={}", "contacts.dome.surface", "exactly one of sphere"),
        ("contacts.dome.artificial.fz=-5", "contacts.dome.artificial.fz", "unknown target"),
        ("contacts.dome.artificial.motion=3", "contacts.dome.artificial.motion", "name of a reference"),
        ("tasks.press.damping=[1, 2]", "tasks.press.damping", "expected 1 numbers (normal)"),
    ],
)
def test_wrong_surfaces_are_told(change, place, said):
    with pytest.raises(SpecError) as error:
        build(load("polish_sphere", [change]))
    assert any(place == fault.key and said in fault.message for fault in error.value.faults), str(error.value)
