"""The arguments of one `Controller.step`, and methods that are called as it is."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping
from functools import wraps
from typing import Any, Concatenate, NamedTuple, ParamSpec, TypeVar

from .qp import Array
from .wrench import Wrench

P = ParamSpec("P")
Owner = TypeVar("Owner")
Answer = TypeVar("Answer")


class Arguments(NamedTuple):
    """Of one `Controller.step`, in its order."""

    t: float
    q: Array
    v: Array
    measured: Mapping[str, Wrench] | None = None
    targets: Mapping[str, float] | None = None
    tau_applied: Array | None = None
    missed: int = 0


def called_as(
    step: Callable[Concatenate[Any, P], Any],
) -> Callable[[Callable[[Owner, Arguments], Answer]], Callable[Concatenate[Owner, P], Answer]]:
    """A method of `Arguments` that is called as `step` is: for what takes a controller's place in a loop."""

    def made(method: Callable[[Owner, Arguments], Answer]) -> Callable[Concatenate[Owner, P], Answer]:
        gathered: Callable[..., Arguments] = Arguments

        @wraps(method)
        def called(self: Owner, /, *given: P.args, **named: P.kwargs) -> Answer:
            return method(self, gathered(*given, **named))

        told = inspect.signature(step).replace(return_annotation=inspect.signature(method).return_annotation)
        called.__signature__ = told  # type: ignore[attr-defined]
        return called

    return made
