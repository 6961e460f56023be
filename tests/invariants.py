"""What must hold at every tick whatever goes wrong: finite torque, its limits and rate, a status that may follow."""

from __future__ import annotations

import numpy as np

from wbc.ladder import FOLLOWS, Status


class Watched:
    """A controller whose every tick is held against them; `repeat` is the command that repeats a failure."""

    def __init__(self, controller, repeat):
        self.controller, self.repeat, self.status = controller, repeat, None

    def step(self, *args, **kwargs):
        before = self.controller.memory
        try:
            out = self.controller.step(*args, **kwargs)
        except Exception as error:
            raise AssertionError(f"step raised {type(error).__name__}: {error}\nrepeat: {self.repeat}") from error
        after, limit = self.controller.memory, self.controller.phase.torque
        assert isinstance(out.status, Status), self.repeat
        assert np.isfinite(out.tau).all(), self.repeat
        assert out.status is Status.OK or out.reason, self.repeat
        if self.status is not None:
            assert out.status in FOLLOWS[self.status], f"{self.status} to {out.status}; repeat: {self.repeat}"
        if after is not None:
            assert (after.tau <= limit.high).all(), self.repeat
            assert (after.tau >= limit.low).all(), self.repeat
        if before is not None and kwargs.get("tau_applied") is None:
            step = np.abs(after.tau - before.tau)
            assert (step <= limit.rate * self.controller.dt + 1e-9).all(), f"{step.max()} N m; repeat: {self.repeat}"
        self.status = out.status
        return out

    def reset(self, *args, **kwargs):
        self.status = None
        self.controller.reset(*args, **kwargs)
