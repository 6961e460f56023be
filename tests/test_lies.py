"""Row 7: a solver that lies. What the certificate lets through of the shipped specs' programs, in N m.

By theory: let (x, z) be an answer and Z a basis of what its equalities and active rows leave free. A lie that keeps
these moves x by Z y with |Z' H Z y| <= e, e the tolerance of `dual`, whatever multipliers come with it; so a torque by
at most e |(T Z) (Z' H Z)^-1|: the weakest direction. A lie may also lean on one inequality that does not bind, with a
multiplier w and a slack s: w s <= e by the gap, which moves the torque by |T K C'| w where K = Z (Z' H Z)^-1 Z'; on one
that binds with z, d (z + d / k) <= e lets it off its bound by d, k = C K C'.
`WBC_CAMPAIGN=large` takes all shipped specs and longer runs; one: `pytest tests/test_lies.py -k eraser`.
"""

from __future__ import annotations

import os
from typing import NamedTuple

import numpy as np
import pytest
import scipy.linalg

from wbc.build import build
from wbc.resources import shipped_names
from wbc.run import run
from wbc.solver import TOLERANCE, answer
from wbc.spec import load

LARGE = os.environ.get("WBC_CAMPAIGN") == "large"
SMALL = ["eraser", "eraser_weak", "chalk_stick", "impedance", "go2_stand", "g1_stand", "panda_dual_box"]
SHIPPED = [name for name in shipped_names("tasks", ".yaml") if not load(name).robot.startswith("erd:")]
SPECS = SHIPPED if LARGE else SMALL
MOVES = 1e-3  # [N m] that no accepted lie may move a torque by
MUTATIONS = 4000 if LARGE else 300


class Seen(NamedTuple):
    """A program of a run, its answer, and the rows T of the torque: tau = T x + bias."""

    problem: object
    x: np.ndarray
    z: np.ndarray
    T: np.ndarray


def programs(name):
    built = build(load(name, ["duration=2" if LARGE else "duration=0.06", "hierarchy=weighted"]))
    controller, seen, ticks = built.controller, [], []
    every = 100 if LARGE else 15

    def keep(observed, out):
        ticks.append(out)
        if len(ticks) % every in (1, 5) and max(out.certificate) < 1e-6:
            workspace = controller.workspace
            solution = answer(controller.solvers[0], workspace.problem)
            if solution.accepted:
                T = workspace.coefficients("torque").copy()
                seen.append(Seen(workspace.problem.copy(), solution.x.copy(), solution.z.copy(), T))

    run(built, hook=keep)
    return seen


class Given:
    """A solver that answers what it was given."""

    def __init__(self, x, z):
        self.answer = x, z

    def solve(self, problem):
        return self.answer


def free(seen, binding=None):
    """(Z, K): what equalities and active rows leave free, and the answer of x to a residual of `dual`."""
    problem, n = seen.problem, seen.x.size
    rows = np.vstack((np.eye(n), problem.C))
    equal = np.zeros(len(rows), bool)
    equal[n : n + problem.n_eq] = True
    binding = equal | (np.abs(seen.z) > 1e-9) if binding is None else binding
    Z = scipy.linalg.null_space(rows[binding]) if binding.any() else np.eye(n)
    return rows, binding, Z, Z @ np.linalg.solve(Z.T @ problem.H @ Z, Z.T)


@pytest.mark.row(7)
@pytest.mark.parametrize("name", SPECS)
def test_row_7_what_moves_a_torque_is_refused(name, tell):
    rng = np.random.default_rng(7)
    repeat = f"pytest tests/test_lies.py -k {name}"
    weakest = leaning = letting = worst = 0.0
    seen = programs(name)
    assert seen
    for before, each in zip([seen[-1], *seen], seen, strict=False):
        problem, x, z, T = each
        rows, binding, Z, K = free(each)
        gain = T @ K
        sizes = np.linalg.norm(gain, axis=1)
        weakest = max(weakest, TOLERANCE.dual * sizes.max())
        # lies: along the weakest direction and random ones, multipliers made to fit as well as they can
        direction = K @ gain[sizes.argmax()]
        for k in range(MUTATIONS):
            d = direction if k % 10 == 0 else Z @ rng.normal(size=Z.shape[1]) if k % 3 else rng.normal(size=x.size)
            moved = np.abs(T @ d).max()
            if moved < 1e-12:
                continue
            d = d * (1.001 * MOVES / moved) * 10 ** rng.uniform(0.0, 3.0)
            fit = z.copy()
            if k % 2:  # equalities' and active rows' multipliers that hide as much of it as can be hidden
                fit[binding] -= np.linalg.lstsq(rows[binding].T, problem.H @ d, rcond=None)[0]
            assert not answer(Given(x + d, fit), problem).accepted, repeat
        # leaning on an inequality that does not bind, harder and harder while it is let through
        values = rows @ x
        for side, bound in ((1.0, problem.hi), (-1.0, problem.lo)):
            slack = side * (bound - values)
            for i in np.flatnonzero(np.isfinite(slack) & ~binding):
                c = K @ rows[i]
                stiff = float(rows[i] @ c)
                s = max(slack[i], 0.0)
                # w (s + stiff w) = e: it moves away from the bound it leans on
                w = (np.sqrt(s * s + 4.0 * stiff * TOLERANCE.gap) - s) / (2.0 * stiff) if stiff > 1e-12 else 0.0
                moved = w * np.abs(T @ c).max()
                leaning = max(leaning, moved)
                if moved > worst:
                    lie, lied = x - side * w * 0.99 * c, z.copy()
                    lied[i] += side * 0.99 * w
                    if answer(Given(lie, lied), problem).accepted:
                        worst = moved
        # stale answers, turned signs, the certificate as x
        if before.x.size == x.size:
            stale = answer(Given(before.x, before.z), problem)
            assert not stale.accepted or np.abs(T @ (before.x - x)).max() <= MOVES, repeat
        turned = answer(Given(x, -z), problem)
        assert not turned.accepted or np.abs(z).max() < 1e-5, repeat
        assert not answer(Given(z, x), problem).accepted, repeat
        told = np.full_like(x, max(answer(Given(x, z), problem).certificate))
        moved = np.abs(T @ (told - x)).max()
        assert not answer(Given(told, z), problem).accepted or moved <= MOVES, repeat
        # leaning on a row that binds: d (z + d / stiff) <= e with d its distance from the bound
        first = x.size + problem.n_eq
        for i in np.flatnonzero(binding):
            if x.size <= i < first:
                continue
            others = binding.copy()
            others[i] = False
            _, _, _, loose = free(each, others)
            c, force = loose @ rows[i], abs(z[i])
            stiff = float(rows[i] @ c)
            if stiff < 1e-12:
                continue
            d = 0.5 * stiff * (np.sqrt(force * force + 4.0 * TOLERANCE.gap / stiff) - force)
            moved = d / stiff * np.abs(T @ c).max()
            letting = max(letting, moved)
            for share in (0.5, 0.99):
                lied, side = z.copy(), np.sign(z[i])
                lied[i] += side * share * d / stiff
                lie = x - side * share * d / stiff * c
                if answer(Given(lie, lied), problem).accepted:
                    worst = max(worst, share * moved)
    told = (f"{name}: {len(seen)} programs; weakest direction {weakest:.1e} N m, leaning on a limit {leaning:.1e}, "
          f"on one that binds {letting:.1e} "
          f"(worst let through {worst:.1e})")  # fmt: skip
    print(told)
    for what, bound in (("weakest direction", weakest), ("leaning", max(leaning, letting)), ("let through", worst)):
        tell(f"{what} [N m]", bound, most=MOVES, why=f"{told}; repeat: {repeat}")
