"""A task specification: YAML -> frozen objects. It knows names, numbers and units, and no physics.

Every object checks itself, names its own faults in plain words, and refuses keys that it does not know; `agreement`
adds what holds between the entries, and `Spec` remembers where in the file each key stands. Wrenches are robot on
environment; twists and wrenches are angular part first; units stand in the descriptions, and so in the JSON schema.

From the bottom up: `source` reads YAML, `fields` has the base class and the types of values; `reference`, `contact`,
`task` and `limit` are the sections of the file; `agreement` checks them against each other; `document` is the whole.
"""

from ..axes import RECIPROCAL, VELOCITY_AXES, WRENCH_AXES
from .contact import Contact, FreeMotion, Screw
from .document import MAX_ENTRIES, Spec, json_schema, load
from .fields import Model
from .limit import Bound, Expect, Limits, Margin, Noise, Phase, Plant, Scale, Until
from .reference import Arc, Circle, Curve, Hold, Line, Lissajous, Profile, Quintic, Reference
from .task import ForceTask, MotionTask, PostureTask, Task

__all__ = ["MAX_ENTRIES", "RECIPROCAL", "VELOCITY_AXES", "WRENCH_AXES", "Model", "Spec", "json_schema", "load"]
__all__ += ["Arc", "Circle", "Curve", "Hold", "Line", "Lissajous", "Profile", "Quintic", "Reference"]
__all__ += ["Contact", "ForceTask", "FreeMotion", "MotionTask", "PostureTask", "Screw", "Task"]
__all__ += ["Bound", "Expect", "Limits", "Margin", "Noise", "Phase", "Plant", "Scale", "Until"]
