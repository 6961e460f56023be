"""The arithmetic of a tick, compiled: one call for what would take numpy ten, each of which costs more than its work.

Plain loops over small dense arrays; the theory is told where they are called. Signatures are explicit.
"""

from .algebra import gauss, inverse, minimum, mobility, within
from .contact import carried, demand, demands, edge, height, rolling, select, settle, share, wanted
from .force import advance, feedback, press, sense, spring
from .jump import approach, jumped
from .limit import braking_bounds, torque_window
from .motion import carried_along, computed_torque, frames, log, point_target, pose_errors, relative, shift
from .null_space import least_squares, root
from .program import active, add_rows, add_square, equations, residuals, square, torque, total
from .singular import all_far, far, singular
from .touch import angle, slip, touch

__all__ = [
    "active",
    "add_rows",
    "add_square",
    "advance",
    "all_far",
    "angle",
    "approach",
    "braking_bounds",
    "carried",
    "carried_along",
    "computed_torque",
    "demand",
    "demands",
    "edge",
    "equations",
    "far",
    "feedback",
    "frames",
    "gauss",
    "height",
    "inverse",
    "jumped",
    "least_squares",
    "log",
    "minimum",
    "mobility",
    "point_target",
    "pose_errors",
    "press",
    "relative",
    "residuals",
    "rolling",
    "root",
    "select",
    "sense",
    "settle",
    "share",
    "shift",
    "singular",
    "slip",
    "spring",
    "square",
    "torque",
    "torque_window",
    "total",
    "touch",
    "wanted",
    "within",
]
