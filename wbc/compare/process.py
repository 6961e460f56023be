"""A solver in a process of its own, which is ended when it overruns: a call into C++ cannot be interrupted.

One process, the nursery, imports what solvers need, and forks one for each of them, so that a new one costs
milliseconds. It is started by the first solver, has a session of its own (Ctrl-C is for the parent, which ends it), and
ends with its parent and everything that it forked.
"""

from __future__ import annotations

import atexit
import gc
import os
import pickle
import signal
import socket
import struct
import subprocess
import sys
import threading
import time
import warnings
from contextlib import suppress
from multiprocessing import Pipe
from multiprocessing.connection import Connection
from typing import Any

from ..errors import SolverError
from ..qp import Problem
from ..solver import Solver, make, refused
from .ask import Asked, Timed

STARTS = 120.0  # [s] that starting may take: the machine, not the solver, is what is slow then
PATIENCE = 5  # problems in a row without an answer, after which a solver is asked no more
_NUMBER = struct.Struct("q")


class Isolated:
    """A solver, by its name or as a pickled object, that has `limit` [s] for each problem.

    What answers too late, or ends its process, is refused for that; a new process goes on with the next problem, after
    `first`, which warms it up. After `PATIENCE` such problems in a row the rest is refused unasked. Raises SolverError
    for a solver that `make` refuses, and for an object that the process cannot rebuild.
    """

    def __init__(self, solver: str | bytes, limit: float, first: Problem) -> None:
        self._solver, self._limit, self._first = solver, limit, first
        self._lost: list[Asked] = []  # the last problems, as long as they ended the process
        self._warms = True
        self._start()

    def ask(self, problems: list[Problem]) -> list[Asked]:
        """Of all problems in turn."""
        found: list[Asked] = []
        while len(found) < len(problems):
            if len(self._lost) == PATIENCE:
                unasked = refused(f"not asked: no answer to {PATIENCE} problems in a row")
                found.append(self._lost[-1]._replace(solution=unasked, attempts=0))
                continue
            if self._pid is None:
                self._start()
            for asked in self._answers(problems[len(found) :]):
                found.append(asked)
                self._lost = [*self._lost, asked] if asked.timed_out or asked.crashed else []
        return found

    def close(self) -> None:
        """End the process."""
        if self._pid is not None:
            self._end()

    def _start(self) -> None:
        self._pid: int | None = None
        self._channel, theirs = Pipe()
        try:
            self._nursery = _nursery()
            self._pid = self._nursery.fork(theirs.fileno())
        finally:
            theirs.close()
        try:
            self._channel.send((sys.path, self._solver))
            told = self._channel.recv() if self._channel.poll(STARTS) else f"not made within {STARTS:g} s"
        except (EOFError, OSError):
            told = "its process ended"
        if told:
            self._end()
            raise SolverError(told)
        if self._warms and self._pid is not None:
            (asked,) = self._answers([self._first])
            self._warms = not (asked.timed_out or asked.crashed)
            if self._pid is None:
                self._start()

    def _answers(self, problems: list[Problem]) -> list[Asked]:
        """Up to the first problem that ended the process."""
        found: list[Asked] = []
        began = time.perf_counter()
        try:
            self._channel.send(problems)
            for _ in problems:
                began = time.perf_counter()
                if not self._channel.poll(self._limit):
                    self._end()
                    reason = refused(f"no answer within {self._limit:g} s")
                    return [*found, Asked(reason, False, 1, 1e6 * self._limit, timed_out=True)]
                found.append(self._channel.recv())
        except (EOFError, OSError):
            us, how = 1e6 * (time.perf_counter() - began), self._end(itself=True)
            found.append(Asked(refused(f"the solver's process ended: {how}"), False, 1, us, crashed=True))
        return found

    def _end(self, itself: bool = False) -> str:
        """How it ended: by `itself`, or now."""
        assert self._pid is not None
        pid, self._pid = self._pid, None
        self._channel.close()
        return self._nursery.end(pid, itself)


class _Nursery:
    """The parent's end of the process that forks."""

    def __init__(self) -> None:
        self._control, theirs = socket.socketpair()
        self._control.settimeout(STARTS)
        code = "import sys; sys.path[:] = sys.argv[2:]; from wbc.compare.process import nurse; nurse(int(sys.argv[1]))"
        with theirs:
            number = theirs.fileno()
            self._process = subprocess.Popen(
                [sys.executable, "-c", code, str(number), *sys.path],
                stdin=subprocess.DEVNULL, stdout=2, pass_fds=[number], start_new_session=True,
            )  # fmt: skip
        self._lock = threading.Lock()

    @property
    def alive(self) -> bool:
        return self._control.fileno() >= 0 and self._process.poll() is None

    def fork(self, channel: int) -> int:
        """The id of a new process that serves at the other end of the channel."""
        return self._told(0, [channel])

    def end(self, pid: int, itself: bool = False) -> str:
        """End a process, or one that ends by itself: how it ended."""
        if not self.alive:
            return "with all others"
        status = self._told(-pid if itself else pid)
        code = os.waitstatus_to_exitcode(status)
        return signal.Signals(-code).name if code < 0 else f"exit status {code}"

    def _told(self, number: int, channel: list[int] | None = None) -> int:
        with self._lock:
            try:
                socket.send_fds(self._control, [_NUMBER.pack(number)], channel or [])
                told: int = _NUMBER.unpack(self._control.recv(_NUMBER.size))[0]
            except BaseException as error:  # Ctrl-C as well: what is half said cannot be gone on with
                self.close()
                if isinstance(error, OSError | struct.error):
                    raise SolverError(f"the process that starts solvers does not answer: {error}") from None
                raise
        return told

    def close(self) -> None:
        """End it and all that it forked."""
        self._control.close()
        self._process.terminate()  # heard as long as it imports
        try:
            self._process.wait(5.0)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()


_nurseries: list[_Nursery] = []  # at most one that is alive


def _nursery() -> _Nursery:
    if not (_nurseries and _nurseries[0].alive):
        _nurseries[:] = [_Nursery()]
        atexit.register(_nurseries[0].close)
    return _nurseries[0]


# --- in the other processes ---


def nurse(number: int) -> None:
    """Fork a process for every channel that comes, and end those that are named, until the parent is gone."""
    import qpsolvers  # noqa: F401  with every backend

    signal.signal(signal.SIGTERM, signal.SIG_IGN)  # from now on it ends by the parent's end, and takes all with it
    control, forked = socket.socket(fileno=number), set[int]()
    with suppress(OSError):  # nobody waits for the answer any more
        while _nursed(control, forked):
            pass
    for pid in forked:
        _reap(pid)


def _nursed(control: socket.socket, forked: set[int]) -> bool:
    """One request; False at the end."""
    message, channels, _, _ = socket.recv_fds(control, _NUMBER.size, 1)
    if channels:
        told = _fork(control, channels[0])
        forked.add(told)
    elif message:
        (pid,) = _NUMBER.unpack(message)
        forked.remove(abs(pid))
        told = _reap(abs(pid), 0.0 if pid > 0 else 1.0)
    else:
        return False
    control.send(_NUMBER.pack(told))
    return True


def _fork(control: socket.socket, channel: int) -> int:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of threads, which a library of linear algebra has, and starts again
        pid = os.fork()
    if pid:
        os.close(channel)
        return pid
    try:
        control.close()
        signal.signal(signal.SIGTERM, signal.SIG_DFL)
        _serve(Connection(channel))
    finally:
        os._exit(0)


def _reap(pid: int, patience: float = 0.0) -> int:
    """The status with which it ends, within `patience` [s] by itself."""
    last = time.monotonic() + patience
    while time.monotonic() < last:
        done, status = os.waitpid(pid, os.WNOHANG)
        if done:
            return status
        time.sleep(0.002)
    os.kill(pid, signal.SIGKILL)
    return os.waitpid(pid, 0)[1]


def _serve(channel: Connection) -> None:
    """Make the solver and answer lists of problems, one by one, until the channel is closed."""
    try:
        sys.path[:], solver = channel.recv()
        timed = Timed(make(_unpickled(solver) if isinstance(solver, bytes) else solver))
    except Exception as error:
        channel.send(str(error) or type(error).__name__)
        return
    channel.send("")
    gc.collect()
    gc.freeze()  # the collector need not look at what exists while a clock runs
    try:
        while True:
            for problem in channel.recv():
                channel.send(timed.one(problem))
    except (EOFError, OSError):  # nobody listens any more
        return


def _unpickled(solver: bytes) -> Solver:
    made: Any = pickle.loads(solver)
    return made
