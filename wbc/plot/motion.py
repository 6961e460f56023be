"""Panels of paths, and how well they are followed."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes

from ..chart import COLOURS, INK, JOINTS, PALE, after_settling, known_rows, legend, lines, panel, rms
from ..log import Log


def _of(log: Log, motions: list[str], part: slice) -> list[str]:
    """The motions that have an error along some axes of this part of a pose at all; all of them where none has."""
    return [name for name in motions if np.nan_to_num(log[f"{name}.error"][:, part]).any()] or motions


def path(ax: Axes, log: Log, motions: list[str]) -> None:
    """Desired and actual path along the two world axes on which the references, or else the frames, move most; several
    from their starts."""
    motions = _of(log, motions, slice(3, 6))
    known = {name: known_rows(log[f"{name}.desired"]) for name in motions}
    spread = np.sum([path.var(axis=0) for path in known.values()], axis=0)
    if not spread.max() > 1e-12:  # references that stand still: where the push moves it
        spread = np.sum([known_rows(log[f"{name}.position"]).var(axis=0) for name in motions], axis=0)
    x, y = np.sort(np.argsort(-spread, kind="stable")[:2])
    alone = len(motions) == 1
    panel(ax, f"path along {'xyz'[x]}, {'xyz'[y]}{'' if alone else ', from the start'} [mm]")
    for i, name in enumerate(motions):
        origin = np.zeros(3) if alone else known[name][0]
        desired, actual = (1e3 * (log[f"{name}.{which}"] - origin)[:, [x, y]] for which in ("desired", "position"))
        start = known_rows(actual)[0]
        ax.plot(*desired.T, color=PALE, linewidth=7, solid_capstyle="round", label="" if i else "desired")
        ax.plot(*actual.T, color=COLOURS[i % JOINTS], linewidth=1.6, label="actual" if alone else name)
        ax.plot(*start, "o", color=INK, markersize=6)
        ax.update_datalim([start - 0.5, start + 0.5])  # a point keeps a frame around it
    ax.set_aspect("equal", adjustable="datalim")
    legend(ax, loc="lower right", bbox_to_anchor=(1.01, 0.99), ncols=5)


def tracking(ax: Axes, log: Log, motions: list[str]) -> None:
    """Distance and angle to the reference, logarithmic: start and end may be decades apart."""
    soft = [name for name in motions if f"{name}.displacement" in log]
    panel(ax, f"tracking error{', way given' if soft else ''} [mm, mrad]", log)
    parts = (("position", "mm", slice(3, 6)), ("rotation", "mrad", slice(0, 3)))
    drawn = [(name, part) for name in motions for part in parts if name in _of(log, motions, part[2])]
    for i, (name, (what, unit, part)) in enumerate(drawn):
        error = 1e3 * np.linalg.norm(log[f"{name}.error"][:, part], axis=1)
        told = f"rms {rms(error[after_settling(log, f'{name}.error')]):.2g} {unit}"
        text = f"{name} gives way: {told}" if name in soft else f"{name}.{what}: {told}"
        lines(ax, log, np.maximum(error, 1e-9)[:, None], [text], COLOURS[i % JOINTS])
    ax.set_yscale("log")
    ax.minorticks_off()
    ax.yaxis.set_major_formatter("{x:g}")
    low, high = ax.get_ylim()
    ax.set_ylim(max(low, 1e-6 * high), 10.0 ** (0.3 * len(drawn) + 0.3) * high)
    legend(ax, loc="upper right")
