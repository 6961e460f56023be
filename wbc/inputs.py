"""Wrenches and targets that a tick is given: what can be used is taken, what cannot is said and the old value kept."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from .contact import Contact
from .errors import WbcError, did_you_mean
from .qp import Array
from .state import State
from .task.impedance import NEW
from .valid import array_fault
from .wrench import Wrench

if TYPE_CHECKING:
    from .memory import Memory


class Inputs:
    """What the caller may name: `contacts` whose axes have targets, and in `feeling` name -> frame of the wrenches."""

    def __init__(self, contacts: Mapping[str, Contact], feeling: Mapping[str, str]) -> None:
        self._contacts, self._feeling = contacts, feeling

    def read(self, state: State, memory: Memory, measured: Any, targets: Any) -> list[str]:
        """Put wrenches and targets of this tick into the state. Answers with what is refused, and why."""
        refused: list[str] = []
        for what, given in (("measured", measured), ("targets", targets)):
            if given is not None and not isinstance(given, Mapping):
                refused.append(f"{what}: expected a mapping by name, got {type(given).__name__}")
        if isinstance(measured, Mapping):
            self._measure(state, memory, measured, refused)
        state.targets = memory.targets  # type: ignore[assignment]
        if targets and isinstance(targets, Mapping):
            state.targets = dict(memory.targets)
            self._retarget(state, targets, refused)
        return refused

    def _measure(self, state: State, memory: Memory, measured: Mapping[str, Any], refused: list[str]) -> None:
        loops = memory.loops
        for name, wrench in measured.items():
            frame = self._feeling.get(name)
            if frame is None:
                known = did_you_mean(str(name), self._feeling)  # tasks that feel a wrench themselves among them
                refused.append(f"measured: no contact named {name!r}{known}")
                continue
            F, fault = _at(wrench, state, frame)
            if fault:
                refused.append(f"measured.{name}: expected a finite Wrench, got {fault}; the last one stands")
                F = loops[name].filtered if name in loops else memory.felt.get(name, NEW).F
            if F is not None:
                state.measured[name] = F

    def _retarget(self, state: State, targets: Mapping[str, Any], refused: list[str]) -> None:
        known = [f"{name}.{axis}" for name, contact in self._contacts.items() for axis in contact.axes]
        for name, value in targets.items():
            if name not in known:
                contact = self._contacts.get(str(name).split(".")[0])
                hint = did_you_mean(str(name), known)
                if contact is not None:
                    hint = f": that component lies outside the column space of A'; it holds {', '.join(contact.axes)}"
                refused.append(f"targets.{name}: no such target{hint}")
            elif not isinstance(value, (int, float)) or not math.isfinite(value):
                refused.append(f"targets.{name}: expected a finite number, got {value!r}; the old target is kept")
            else:
                state.targets[name] = float(value)


def _at(wrench: Any, state: State, frame: str) -> tuple[Array | None, str]:
    """(6,) a measured wrench at a frame, or why it is refused."""
    if not isinstance(wrench, Wrench):
        return None, type(wrench).__name__
    if fault := array_fault("F", wrench.F, 6):
        return None, f"one whose {fault}"
    try:
        F = wrench.at(state, frame)
    except (WbcError, TypeError) as error:
        return None, str(error)
    return (F, "") if math.isfinite(F.dot(F)) else (None, str(F))
