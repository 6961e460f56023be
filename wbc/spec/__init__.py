"""A task specification: YAML -> frozen objects. It knows names, numbers and units, and no physics.

Every object checks itself, names its own faults in plain words, and refuses keys that it does not know; `agreement`
adds what holds between the entries, and `Spec` remembers where in the file each key stands. Wrenches are robot on
environment; twists and wrenches are angular part first; units stand in the descriptions, and so in the JSON schema.

From the bottom up: `source` reads YAML, `fields` has the base class and the types of values; `reference`, `contact`
(with `screw` and `friction`), `task` (with `placed`, `compliance` and `body`), `phase` and `limit` are the sections of
the file; `agreement` checks them against each other; `document` is the whole.
"""

from ..axes import RECIPROCAL, VELOCITY_AXES, WRENCH_AXES
from .body import ComTask, DistributionTask, GazeTask, MomentumTask, Over, RelativeTask, TorqueTask
from .compliance import AdmittanceTask, ImpedanceTask
from .contact import NORMAL, Contact
from .document import MAX_ENTRIES, Spec, json_schema, load
from .fields import Model
from .friction import Friction, Unilateral
from .limit import Bound, Expect, Limits, Margin, Noise, Plant, Scale
from .phase import Phase, Until, Within
from .placed import Following, Tank
from .push import Bias, Move, Push, Sine, Wave
from .reference import Arc, Circle, Curve, Hold, Line, Lissajous, Profile, Quintic, Reference
from .screw import FreeMotion, Screw
from .task import ForceTask, MotionTask, PostureTask, Task

__all__ = [
    "MAX_ENTRIES",
    "NORMAL",
    "RECIPROCAL",
    "VELOCITY_AXES",
    "WRENCH_AXES",
    "Model",
    "Spec",
    "json_schema",
    "load",
]
__all__ += ["Arc", "Circle", "Curve", "Hold", "Line", "Lissajous", "Profile", "Quintic", "Reference"]
__all__ += [
    "Contact",
    "ForceTask",
    "FreeMotion",
    "Friction",
    "MotionTask",
    "PostureTask",
    "Screw",
    "Task",
    "Unilateral",
]
__all__ += [
    "ComTask",
    "DistributionTask",
    "Following",
    "GazeTask",
    "MomentumTask",
    "Over",
    "RelativeTask",
    "Tank",
    "TorqueTask",
]
__all__ += ["AdmittanceTask", "Bias", "ImpedanceTask", "Move", "Push", "Sine", "Wave"]
__all__ += ["Bound", "Expect", "Limits", "Margin", "Noise", "Phase", "Plant", "Scale", "Until", "Within"]
