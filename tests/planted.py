"""Bugs that a controller could have, planted one at a time: a line of the package is replaced by a wrong one.

What a campaign is worth is how many of them it catches. Each says where it is, what stands there, what stands there
instead, and which invariants may name it.
"""

from __future__ import annotations

import importlib
import inspect
import sys
import textwrap
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, NamedTuple

import wbc.campaign  # noqa: F401  whose modules hold names of their own


class Bug(NamedTuple):
    """`place`: module and function; `old` -> `new`, in turn; `changes`: of the cases, where it takes others."""

    name: str
    place: str
    swaps: tuple[tuple[str, str], ...]
    by: str  # invariants, any of which may name it
    changes: tuple[str, ...] = ()


def bug(name: str, place: str, old: str, new: str, by: str, *more: str, changes: tuple[str, ...] = ()) -> Bug:
    """More pairs of old and new may follow."""
    return Bug(name, place, ((old, new), *zip(more[::2], more[1::2], strict=True)), by, changes)


STEP, ACCEPT, RATED = "controller:Controller._step", "controller:Controller._accept", "controller:_rated"
CHECKED = "controller:Controller._checked"

BUGS = (
    # what comes in
    bug("q is taken as it comes", CHECKED, 'array_fault("q", q, self.robot.nq) or ', "",
        "refused raises swallowed hold"),
    bug("v is taken as it comes", CHECKED, ' or array_fault("v", v, self.robot.nv)', "",
        "refused raises swallowed hold"),
    bug("any time is taken", STEP, "fault = fault or time_fault(t)", "pass", "refused swallowed clock"),
    bug(
        "wrenches are taken as they come", "inputs:_at",
        'if fault := array_fault("F", wrench.F, 6):', "if fault := '':", "refused swallowed",
        "if math.isfinite(F.dot(F)) else (None, str(F))", "",
    ),
    bug(
        "a target that is no number is stored", "inputs:Inputs._retarget",
        "elif not isinstance(value, (int, float)) or not math.isfinite(value):", "elif False:",
        "refused targets swallowed",
    ),
    bug("any torque is believed to be applied", STEP,
        'if fault := array_fault("tau_applied", tau_applied, self.robot.nu):', "if fault := '':",
        "refused swallowed rate"),
    bug("a quaternion is left as it is", "valid:unit", "q[part] /= norm", "pass", "dynamics hold"),
    bug("a quaternion may have any norm", "valid:unit", "if not abs(norm - 1.0) <= UNIT:", "if not norm > 0.0:",
        "refused"),
    # limits
    bug("no limit of the torque rate", "limit:TorqueLimit.window", "self.rate, dt", "self.rate, 1e3 * dt", "rate"),
    bug("no limit of the torque", "limit:TorqueLimit.window", "(self.low, self.high, self.rate",
        "(self.low - 1e3, self.high + 1e3, self.rate", "limit"),
    # the answer
    bug("a refused x is read", STEP, "if not solution.accepted:\n            reason",
        "if not solution.x.size:\n            reason", "certificate finite"),
    bug("the solver is taken at its word", "solver:_certified",
        "if primal <= tolerance.primal and dual <= tolerance.dual and gap <= tolerance.gap:",
        "if x.shape == problem.g.shape:", "certificate finite raises swallowed"),
    bug("the certificate has no gap", "kernels.program:residuals", "return math.sqrt(primal), math.sqrt(dual), gap",
        "return math.sqrt(primal), math.sqrt(dual), 0.0", "certificate"),
    bug("the certificate has no dual residual", "kernels.program:residuals",
        "return math.sqrt(primal), math.sqrt(dual), gap", "return math.sqrt(primal), 0.0, gap", "certificate"),
    bug("the warm start is kept", "controller:Controller.memory", 'getattr(solver, "restart", lambda: None)()', "pass",
        "untouched repeated", changes=("solver=proxqp",)),
    bug("the torque is not that of x", ACCEPT, "solution.x, state.bias", "0.999 * solution.x, state.bias", "dynamics"),
    bug("the load of a contact is forgotten", ACCEPT, "state.bias[self.robot.base :]",
        "0.99 * state.bias[self.robot.base :]", "dynamics"),
    # the ladder
    bug("it degrades for ever", "holding:Holding.degraded", "or bad > HOLD_TICKS", "or bad > 10**9", "ladder"),
    bug("one good tick is enough", RATED, "if good < GOOD_TICKS:", "if good < 1:", "ladder"),
    bug("it never recovers", ACCEPT, "else memory.good + 1", "else memory.good", "ladder"),
    bug("it leaves the safe hold on its own", STEP, "if memory.status in HELD:", "if memory.status is Status.STOPPED:",
        "transition ladder"),
    bug("missed ticks do not stop it", STEP, "if missed >= MISSED_STOPPED:", "if False:", "ladder"),
    bug("missed ticks do not degrade it", ACCEPT, "good = 0 if missed >= MISSED_DEGRADED else", "good =", "ladder"),
    bug("a time that stands is not noticed", STEP, "if stale >= MISSED_STOPPED:", "if False:", "ladder"),
    # the hold
    bug("the wrenches of the hold have the other sign", "holding:Holding._load",
        "tau = tau + state.contacts[name].push.T @ lam", "tau = tau - state.contacts[name].push.T @ lam", "hold"),
    bug("gravity decays as well", "holding:Holding.degraded", "decayed(memory.tau, load, bad)",
        "decayed(memory.tau, 0.0 * load, bad)", "hold"),
    bug("it is damped by a velocity of the past", "holding:Holding.safe", "elif v is not None:",
        "elif (v := memory.v if v is None else v) is not None:", "hold"),
    # what is remembered
    bug("the whole of a jump in time is integrated", STEP, "past if past < most else most", "past", "integral"),
    bug("the clock runs backwards", STEP, "t, stale = memory.t, memory.stale + 1", "stale = memory.stale + 1",
        "clock ladder"),
    bug("the caller's own q is remembered", ACCEPT, "state.q.copy(), state.v.copy()", "state.q, state.v", "memory"),
    bug("the torque that is remembered is given out", ACCEPT, "else tau.copy()", "else tau", "memory"),
    bug("targets are forgotten", ACCEPT, "state.targets, status", "{}, status", "targets"),
    # what is told
    bug("OK while a limit is active", RATED, "if active or refused or program.yielded:",
        "if refused or program.yielded:",
        "status"),
    bug("what is refused is not told", RATED, "told = Status.LIMITED, list(refused)", "told = Status.LIMITED, []",
        "refused"),
)  # fmt: skip


@contextmanager
def planted(one: Bug) -> Iterator[None]:
    """The package with the bug, everywhere that names the function."""
    module, path = one.place.split(":")
    home = importlib.import_module(f"wbc.{module}")
    *outer, name = path.split(".")
    owner = getattr(home, outer[0]) if outer else home
    whole = vars(owner)[name]
    plain = whole.fset if isinstance(whole, property) else getattr(whole, "py_func", whole)
    source = textwrap.dedent(inspect.getsource(plain))
    source = source[source.index("def ") :]  # as it stands, without what compiles it
    for old, new in one.swaps:
        old, new = (textwrap.dedent(each) for each in (old, new))
        found = [at for at in (old, old.replace("\n            ", "\n        ")) if at in source]
        assert found, f"{one.place} has no {old!r} any more: plant this bug another way"
        source = source.replace(found[0], new.replace("\n            ", "\n        ") if found[0] != old else new)
    code = compile(f"from __future__ import annotations\n{source}", inspect.getfile(plain), "exec")
    made: dict[str, Any] = {}
    exec(code, vars(home), made)
    wrong = made[name]
    if isinstance(whole, property):
        wrong = property(whole.fget, wrong)
    holders = (
        [owner] if outer else [m for key, m in sys.modules.items() if key.split(".")[0] == "wbc" and m is not None]
    )
    places = [holder for holder in holders if vars(holder).get(name) is whole]
    try:
        for holder in places:
            setattr(holder, name, wrong)
        yield
    finally:
        for holder in places:
            setattr(holder, name, whole)
