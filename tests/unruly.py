"""Solvers that do what a process of their own is for; here, so that a process need not import what tests do."""

from __future__ import annotations

import os
import signal
from pathlib import Path

import numpy as np

from wbc.errors import SolverError
from wbc.solver import Daqp


class Never(Daqp):
    """Answers as DAQP does, but none of every so many problems, and not before it is ended."""

    def __init__(self, every=1, file=None):
        super().__init__()
        self.asked, self.every, self.file = 0, every, file

    def solve(self, problem):
        self.asked += 1
        if self.file is not None:
            Path(self.file).write_text(str(os.getpid()))
        while self.asked % self.every == 0:
            pass
        return super().solve(problem)


class Killed(Daqp):
    """Takes its process down on a problem with these bounds."""

    def __init__(self, problem):
        super().__init__()
        self.lo = problem.lo.copy()

    def solve(self, problem):
        if np.array_equal(problem.lo, self.lo):
            os.kill(os.getpid(), signal.SIGSEGV)
        return super().solve(problem)


class Loud:
    def solve(self, problem):
        print("hear me", flush=True)
        raise SolverError("too hard")
