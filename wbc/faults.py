"""What is wrong with a spec, collected with its place until going on would only repeat it."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace

from .errors import Fault, GainError, SpecError, WbcError
from .spec import Spec

Place = tuple[str | int, ...]


@dataclass(frozen=True)
class Faults:
    """Grows, and is raised by `check`. `phase` is the one being built, `changed` the keys that it changes."""

    spec: Spec
    found: list[Fault] = field(default_factory=list)
    phase: str = ""
    changed: tuple[str, ...] = ()

    def within(self, phase: str, changed: tuple[str, ...]) -> Faults:
        """The same collection, told from inside a phase."""
        return replace(self, phase=phase, changed=changed)

    @contextmanager
    def at(self, *path: str | int) -> Iterator[None]:
        """Whatever is wrong inside is a fault of that place in the spec."""
        try:
            yield
        except SpecError:
            raise
        except GainError as error:  # its message begins with the key
            key, _, message = str(error).partition(": ")
            self.add((*path, key), message)
        except WbcError as error:
            self.add(path, str(error))

    def add(self, path: Place, message: str) -> None:
        """Something wrong in one place; what a phase has changed is told where the phase says so."""
        at = tuple(map(str, path))
        for key in self.changed:
            if all(ours == theirs for ours, theirs in zip(key.split("."), at, strict=False)):
                path, message = ("phases", self.phase, "set", key), f"{'.'.join(at)}: {message}"
                break
        self.found.append(self.spec.fault(path, message))

    def check(self) -> None:
        """Raise SpecError if anything was found."""
        if self.found:
            raise SpecError(dict.fromkeys(self.found))
