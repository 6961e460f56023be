"""Controller.step from a loop of one's own: here MuJoCo stands for the robot, stepped by hand.

python examples/loop.py
"""

from __future__ import annotations

import numpy as np

import wbc
from wbc.sim import Simulator


def main(seconds: float = 2.0) -> float:
    """Press with 10 N, then ask for 12 N from outside; answers the true force at the end [N]."""
    spec = wbc.load("eraser")
    controller = wbc.Controller.from_spec(spec)
    robot = Simulator(controller.robot, controller.start, controller.dt)
    controller.reset(controller.start, np.zeros(7))
    wrench = None
    for tick in range(round(seconds / controller.dt)):
        seen = robot.observe()
        out = controller.step(
            seen.t,
            seen.q,
            seen.v,
            measured={"board": wrench} if wrench is not None else None,
            targets={"board.fz": -12.0} if tick == 1000 else None,
        )
        if out.status is not wbc.Status.OK and tick > 20:
            print(f"{seen.t:.3f} s: {out.status.name}: {out.reason}")
        robot.apply(out.tau)
        wrench = robot.measured(controller.state, out.vdot)
    return float(robot.true_wrench("eraser")[5])


if __name__ == "__main__":
    print(f"the eraser presses with {-main():.3f} N")
