"""Whole-body contact control: one quadratic program a tick, exact where the book has a closed form.

The names below are imported on first use, so that `import wbc` costs nothing.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

__version__ = "0.2.0"

_HOME = {
    "Controller": "controller", "Output": "memory", "Phase": "phase", "Status": "ladder",
    "Robot": "robot", "State": "state", "Frame": "frame", "Wrench": "wrench", "ForceSensor": "wrench",
    "Contact": "contact", "AxesContact": "contact.axes", "MatrixContact": "contact.axes",
    "WorldAxesContact": "contact.axes", "ScrewContact": "contact.screw", "SphereContact": "contact.sphere",
    "ForceTask": "task.force", "MotionTask": "task.motion", "PostureTask": "task.posture",
    "Rows": "qp", "Sample": "reference",
    "ComTask": "task.centroidal", "DistributionTask": "task.centroidal", "MomentumTask": "task.centroidal",
    "WholeBodyPosture": "task.centroidal", "GazeTask": "task.relative", "RelativeTask": "task.relative",
    "TorqueTask": "task.effort", "RoundFoot": "contact.foot", "weighed": "dynamics",
    "Explanation": "explanation", "explain": "explanation",
    "Replay": "replay", "Tape": "tape", "WbcError": "errors", "SpecError": "errors", "load": "spec",
}  # fmt: skip
_MODULES = ("analytic", "errors", "reference", "solver", "testing")

__all__ = [*_HOME, *_MODULES]

if TYPE_CHECKING:
    from . import analytic, errors, reference, solver, testing
    from .contact import Contact
    from .contact.axes import AxesContact, MatrixContact, WorldAxesContact
    from .contact.foot import RoundFoot
    from .contact.screw import ScrewContact
    from .contact.sphere import SphereContact
    from .controller import Controller
    from .dynamics import weighed
    from .errors import SpecError, WbcError
    from .explanation import Explanation, explain
    from .frame import Frame
    from .ladder import Status
    from .memory import Output
    from .phase import Phase
    from .qp import Rows
    from .reference import Sample
    from .replay import Replay
    from .robot import Robot
    from .spec import load
    from .state import State
    from .tape import Tape
    from .task.centroidal import ComTask, DistributionTask, MomentumTask, WholeBodyPosture
    from .task.effort import TorqueTask
    from .task.force import ForceTask
    from .task.motion import MotionTask
    from .task.posture import PostureTask
    from .task.relative import GazeTask, RelativeTask
    from .wrench import ForceSensor, Wrench


def __getattr__(name: str) -> Any:
    if name in _HOME:
        return getattr(importlib.import_module(f".{_HOME[name]}", __name__), name)
    if name in _MODULES:
        return importlib.import_module(f".{name}", __name__)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted(__all__)
