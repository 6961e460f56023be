"""The six axes of a frame, angular part first. This module imports nothing, so that the spec stays light."""

VELOCITY_AXES = ("wx", "wy", "wz", "vx", "vy", "vz")  # of a twist [rad/s, m/s]
MOMENTUM_AXES = ("kx", "ky", "kz", "lx", "ly", "lz")  # about the centre of mass, in the world [N m s, N s]
WRENCH_AXES = ("mx", "my", "mz", "fx", "fy", "fz")  # of a wrench, robot on environment [N m, N]
RECIPROCAL = dict(zip(VELOCITY_AXES + WRENCH_AXES, WRENCH_AXES + VELOCITY_AXES, strict=True))
