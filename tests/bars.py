"""Every number that a shipped spec or a test is held to. A spec's `expect:` may be tighter, never looser."""

from __future__ import annotations

# spec -> metric -> bound, from true quantities after the first second
SPECS: dict[str, dict[str, float]] = {
    "eraser": {
        "board.fz.rms_error": 0.005,  # [N] of 10 N
        "board.mx.rms_error": 1e-3,  # [N m]
        "board.my.rms_error": 1e-3,
        "draw.position.rms_error": 8e-5,  # [m]
    },
    "eraser_noisy": {"board.fz.rms_error": 0.05},  # sensor noise of 0.2 N
    "eraser_weak": {"board.fz.max_error": 2.0, "draw.speed.max": 0.5, "board.lost": 0},
    "force_feedforward": {  # 0.01 % of (1, -0.5, 0.5) N m and (6, -4, -10) N
        "anchor.mx.max_error": 1e-4,
        "anchor.my.max_error": 5e-5,
        "anchor.mz.max_error": 5e-5,
        "anchor.fx.max_error": 6e-4,
        "anchor.fy.max_error": 4e-4,
        "anchor.fz.max_error": 1e-3,
    },
    "force_pi": {  # the load of 0.15 kg is gone: 1e-3 N of 1.5 N
        **{f"anchor.{axis}.rms_error": 1e-4 for axis in ("mx", "my", "mz")},
        **{f"anchor.{axis}.rms_error": 1e-3 for axis in ("fx", "fy", "fz")},
    },
    "door": {
        "open.swing.rms_error": 8.72e-4,  # 0.05 deg [rad]
        **{f"handle.{axis}.rms_error": 0.1 for axis in ("fx", "fy", "fz")},
        **{f"handle.{axis}.rms_error": 0.02 for axis in ("mx", "my", "mz")},
    },
    "force_damped": {"wall.vz.speed.max": 0.0404, "wall.fz.rms_error": 0.005},  # F_d / K_damp = 0.04 m/s, and 1 %
    "wheel": {
        "board.fz.rms_error": 0.005,
        "board.fy.rms_error": 0.005,
        "roll.position.rms_error": 8e-5,
        "board.vy.slip": 1e-4,  # sideways, over the whole curve [m]
    },
    "planar": {"board.fz.rms_error": 0.005, "board.my.rms_error": 1e-3, "draw.position.rms_error": 8e-5},
}

# every run, whatever its spec says
ALWAYS = {"torque.max_excess": 1e-6, "torque_rate.max_excess": 1e-3, "ticks.degraded": 0}

# torque against the closed form, relative to 1 + max |tau|
TAU_ERROR = {"daqp": 1e-9, "proxqp": 1e-6}
TAU_ERROR_MUJOCO = 1e-8
KEPT_STATES = 700  # of 1 000 random ones

# eraser_weak: share of ticks in which a torque limit binds, and the way back
WEAK_SATURATED = 0.10
WEAK_OVERSHOOT, WEAK_RECOVERY = 0.10, 0.5  # of the step, [s]

# pure force control: bias by an unknown load against its prediction, decay against the discrete pole, and how far the
# naive Ki / (1 + Kp) is off; shares of the computed limit that are stable and that diverge
FEEDFORWARD_BIAS, FORCE_POLE, NAIVE_POLE_OFF = 0.01, 0.01, 0.03
FORCE_EDGE = (0.97, 1.05)
TERMINAL_SPEED = 0.01

# of this kind of machine; measured by benchmarks/tick.py, never asserted in a timed test
TICK_MEDIAN_US = 150.0
HELP_SECONDS = 0.5
