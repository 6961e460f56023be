"""The closed-form laws of force, hybrid and impedance control, one small function an equation.

Lynch & Park, *Modern Robotics*, ch. 11. A rigid contact holds k of the r <= 6 axes of a task frame (0 <= k <= r):

    A V = 0                                        (1)      A Vdot + Adot V = 0                               (2)
    F = M_C Vdot + h_C                             (3)      F = M_C Vdot + h_C + A' lambda                    (4)
    lambda = Lam (A M_C^-1 (F - h_C) + Adot V)     (5)      Lam = (A M_C^-1 A')^-1

Everywhere: twist V = (w, v) [rad/s, m/s] and wrench F = (m, f) [N m, N] of the task frame in its own axes (body frame),
angular part first; wrenches are applied by the robot to the environment; poses T (4, 4) are of the task frame in the
world. M (n, n) is symmetric positive definite, J (r, n) and A (k, r) have full row rank: more rows than columns raise
LinAlgError, and near a singularity results grow as the inverse does, so look at cond(J M^-1 J') first. `X'` is the
transpose, `X^+` the pseudo-inverse. Only the external force of impedance control, f_ext, acts on the robot.
"""

from __future__ import annotations

from .dynamics import (
    constrained_acceleration,
    constraint_inertia,
    dynamically_consistent_inverse,
    force_bias,
    force_projector,
    inverse_dynamics,
    motion_projector,
    multipliers,
    task_bias,
    task_inertia,
)
from .force import (
    damping_limit,
    force_command,
    force_error,
    force_error_matrix,
    force_torque,
    gain_matrix,
    multiplier_error,
    project_wrench,
    require_wrench,
    terminal_velocity,
    unmodelled_bias,
    wrench_residual,
)
from .friction import (
    capped_friction,
    critical_friction,
    cut_to_cone,
    inner_cone,
    sliding_acceleration,
    sliding_direction,
    sliding_map,
    sliding_multipliers,
    sliding_torque,
)
from .hybrid import Law, computed_torque, hybrid_acceleration, hybrid_torque
from .indirect import (
    admittance_acceleration,
    admittance_torque,
    force_stiffness,
    impedance_acceleration,
    impedance_torque,
    impedance_torque_gravity,
    impedance_torque_massless,
    motion_compliance,
    printed_scale,
    rendered_as_printed,
)
from .sampled import acceleration_feedback_limit, least_stable_damping, least_stable_mass, rendered_mass
from .se3 import Array, ad, adjoint, exp3, exp6, inverse, log3, log6, pose_error, pose_error_split, skew, twist_error
from .second_order import (
    admittance,
    damping_ratio,
    impact_peak,
    impedance,
    measurement,
    natural_frequency,
    step_response,
)
from .surface import corner_forces_map, edge_cone, surface_cone

__all__ = [
    "Array",
    "Law",
    "acceleration_feedback_limit",
    "ad",
    "adjoint",
    "admittance",
    "admittance_acceleration",
    "admittance_torque",
    "capped_friction",
    "computed_torque",
    "constrained_acceleration",
    "constraint_inertia",
    "corner_forces_map",
    "critical_friction",
    "cut_to_cone",
    "damping_limit",
    "damping_ratio",
    "dynamically_consistent_inverse",
    "edge_cone",
    "exp3",
    "exp6",
    "force_bias",
    "force_command",
    "force_error",
    "force_error_matrix",
    "force_projector",
    "force_stiffness",
    "force_torque",
    "gain_matrix",
    "hybrid_acceleration",
    "hybrid_torque",
    "impact_peak",
    "impedance",
    "impedance_acceleration",
    "impedance_torque",
    "impedance_torque_gravity",
    "impedance_torque_massless",
    "inner_cone",
    "inverse",
    "inverse_dynamics",
    "least_stable_damping",
    "least_stable_mass",
    "log3",
    "log6",
    "measurement",
    "motion_compliance",
    "motion_projector",
    "multiplier_error",
    "multipliers",
    "natural_frequency",
    "pose_error",
    "pose_error_split",
    "printed_scale",
    "project_wrench",
    "rendered_as_printed",
    "rendered_mass",
    "require_wrench",
    "skew",
    "sliding_acceleration",
    "sliding_direction",
    "sliding_map",
    "sliding_multipliers",
    "sliding_torque",
    "step_response",
    "surface_cone",
    "task_bias",
    "task_inertia",
    "terminal_velocity",
    "twist_error",
    "unmodelled_bias",
    "wrench_residual",
]
