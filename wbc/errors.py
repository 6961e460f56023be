"""One family of errors; each carries its data, so that a caller can act on it without parsing the sentence."""

from __future__ import annotations

import difflib
from collections.abc import Iterable
from dataclasses import dataclass


class WbcError(Exception):
    """Base class of every error that this package raises on purpose."""


@dataclass(frozen=True)
class Fault:
    """One thing wrong in one place of an input file.

    `line` and `column` count from 1; 0 where the fault has no place in the file (a missing file, the command line).
    """

    file: str
    line: int
    column: int
    key: str
    message: str

    def __str__(self) -> str:
        where = f"{self.file}:{self.line}:{self.column}" if self.line else self.file
        return f"{where}: {self.key}: {self.message}" if self.key else f"{where}: {self.message}"


class SpecError(WbcError):
    """The specification is wrong; `faults` lists everything that was found, in the order of the file."""

    def __init__(self, faults: Iterable[Fault]) -> None:
        self.faults = tuple(sorted(faults, key=lambda f: (f.line, f.column, f.key)))
        super().__init__("\n".join(map(str, self.faults)))


class ModelError(WbcError):
    """A robot, tool or scene file cannot be used."""


class ModelMismatch(ModelError):
    """Simulator and controller disagree about the model; `differences` maps a quantity to its worst error."""

    def __init__(self, differences: dict[str, float], tolerance: float) -> None:
        self.differences, self.tolerance = differences, tolerance
        listing = ", ".join(f"{name} by {error:.1e}" for name, error in differences.items())
        super().__init__(
            f"MuJoCo and Pinocchio disagree beyond {tolerance:.0e}: {listing}; "
            "the model uses something that the conversion does not carry over"
        )


class NameNotFound(WbcError):
    """A frame, joint, contact, ... that does not exist; `nearest` is the best guess at what was meant."""

    def __init__(self, kind: str, name: str, known: Iterable[str]) -> None:
        self.kind, self.name, self.known = kind, name, tuple(known)
        self.nearest = nearest(name, self.known)
        super().__init__(f"no {kind} named {name!r}{did_you_mean(name, self.known)}")


class WrenchError(WbcError):
    """A desired wrench that the contact cannot carry: outside the column space of A' (book 11.6.1)."""


class LawError(WbcError):
    """A control law asked for where it does not apply."""


class GainError(WbcError):
    """A gain of the wrong size, or one that is not positive definite."""


class ProblemError(WbcError):
    """Rows that do not fit the variables of the quadratic program: shape or name."""


class StateError(WbcError):
    """A state that a controller cannot start from: shape, type, or a number that is not finite."""


class SimulationError(WbcError):
    """The simulator diverged; `time` [s] says when."""

    def __init__(self, message: str, time: float) -> None:
        self.time = time
        super().__init__(message)


class InvariantError(WbcError):
    """A tick that violates what must always hold: which invariant, at which tick, how, and what repeats it."""

    def __init__(self, invariant: str, tick: int, told: str, repeat: str = "") -> None:
        self.invariant, self.tick, self.told, self.repeat = invariant, tick, told, repeat
        tail = f"; repeat: {repeat}" if repeat else ""
        super().__init__(f"{invariant}: {told}, at tick {tick}{tail}")


class LogError(WbcError):
    """A log that cannot be read, or a tick that it does not have; `file` says which log, `message` what."""

    def __init__(self, file: str, message: str) -> None:
        self.file, self.message = file, message
        super().__init__(f"{file}: {message}")


class SolverError(WbcError):
    """A solver that is unknown or not installed."""


def nearest(name: str, known: Iterable[str]) -> str | None:
    """The most similar of `known`, or None."""
    folded = {each.lower(): each for each in known}
    match = difflib.get_close_matches(name.lower(), list(folded), n=1, cutoff=0.5)
    return folded[match[0]] if match else None


def did_you_mean(name: str, known: Iterable[str], most: int = 12) -> str:
    """The tail of a message: the nearest name, else what there is to choose from."""
    known = list(known)
    if guess := nearest(name, known):
        return f"; did you mean {guess!r}?"
    if not known:
        return ""
    listing = ", ".join(sorted(known)[:most]) + (", ..." if len(known) > most else "")
    return f"; expected one of {listing}"
