"""What the tests share: the shipped robots, loaded once, and one seeded generator."""

import os
import shutil
import tempfile
from functools import partial

import numpy as np
import pytest
import rows
import runs

from wbc.robot import Robot

LONG = (
    "test_tour.py", "test_specs.py", "test_landing.py", "test_mutations.py", "test_pushes.py", "test_friction.py",
    "test_force.py", "test_verify.py", "test_response.py", "test_soak.py",
)  # fmt: skip


def pytest_configure(config):
    """A folder for the runs that processes share; those that the first one starts inherit its name."""
    if runs.FOLDER not in os.environ:
        config.shared_runs = os.environ[runs.FOLDER] = tempfile.mkdtemp(prefix="runs")
    config.pluginmanager.register(rows.Rows(), "rows")


def pytest_unconfigure(config):
    if folder := getattr(config, "shared_runs", None):
        del os.environ[runs.FOLDER]
        shutil.rmtree(folder, ignore_errors=True)


def pytest_collection_modifyitems(items):
    """The longest tests first, so that no worker is left with one of them at the end."""
    items.sort(key=lambda item: LONG.index(item.path.name) if item.path.name in LONG else len(LONG))


LOADED = {
    "panda on the board": ("panda", "eraser", "board"),
    "panda": ("panda", None, None),
    "ur5e": ("ur5e", None, None),
    "planar3r": ("planar3r", None, None),
}


@pytest.fixture
def tell(record_property):
    """tell(name, value, most= or least=, why=""): a number for the table of the rows, held to its bound."""
    return partial(rows.told, record_property)


@pytest.fixture(scope="session")
def robots():
    """Name -> Robot, as in `LOADED`; nobody changes them."""
    return {name: Robot.load(*files) for name, files in LOADED.items()}


@pytest.fixture(scope="session")
def panda(robots):
    """With the eraser, at the board."""
    return robots["panda on the board"]


@pytest.fixture(scope="session")
def bare_panda(robots):
    return robots["panda"]


@pytest.fixture(scope="session")
def ur5e(robots):
    return robots["ur5e"]


@pytest.fixture(scope="session")
def planar3r(robots):
    return robots["planar3r"]


@pytest.fixture(scope="session")
def go2():
    """On the floor."""
    return Robot.load("go2", scene="floor")


@pytest.fixture(scope="session")
def g1():
    return Robot.load("g1", scene="floor")


@pytest.fixture(params=LOADED)
def robot(request, robots):
    """Each of the shipped robots in turn."""
    return robots[request.param]


@pytest.fixture
def rng():
    return np.random.default_rng(20250)


@pytest.fixture
def draw(rng):
    """draw(robot) -> a random state: q within a radian of home, v up to 1 rad/s."""
    import pinocchio as pin

    def one(robot, t=0.0):
        q = pin.integrate(robot.model, robot.keyframes["home"], rng.uniform(-1.0, 1.0, robot.nv))
        return robot.state(q, rng.uniform(-1.0, 1.0, robot.nv), t=t)

    return one
