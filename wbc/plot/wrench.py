"""Panels of what contacts hold, and of what pushes on compliant tasks."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.gridspec import GridSpecFromSubplotSpec, SubplotSpec

from ..chart import INK, MUTED, after_settling, known_rows, legend, lines, panel, rms, window
from ..log import Log

BLOCKS = 8  # the most that one picture shows
ROUNDING = 1e-6  # of a target: errors below it are not blown up

Block = tuple[str, str, list[int]]


def blocks_of(log: Log) -> list[Block]:
    """(contact, unit, columns of its multipliers): moments and forces of a contact stand in plots of their own."""
    blocks = []
    for contact, axes in log.meta.get("contacts", {}).items():
        if f"{contact}.lam" in log:
            units = [
                {"m": "N m", "f": "N"}.get(axis[0], "") if len(axis) == 2 else "N" * (axis == "normal") for axis in axes
            ]
            blocks += [(contact, unit, [i for i, u in enumerate(units) if u == unit]) for unit in dict.fromkeys(units)]
    return blocks


def wrenches(fig: Figure, place: SubplotSpec, log: Log, blocks: list[Block]) -> None:
    """What each contact truly holds, its target dashed, and the error below."""
    columns = min(2, len(blocks))
    rows = -(-len(blocks[:BLOCKS]) // columns)
    grid = GridSpecFromSubplotSpec(rows, columns, place, hspace=0.15 * rows, wspace=0.2)
    for i, (contact, unit, index) in enumerate(blocks[:BLOCKS]):
        names, true = [log.meta["contacts"][contact][j] for j in index], log[f"{contact}.lam"][:, index]
        told = f"{contact}.target" in log
        cell = GridSpecFromSubplotSpec(2 if told else 1, 1, grid[i // columns, i % columns], hspace=0.08)
        told_of = f"{contact}.target" if told else None
        ax = panel(fig.add_subplot(cell[0], label=f"{contact} [{unit}]"), f"{contact} holds [{unit}]", log, told_of)
        lines(ax, log, true, names, linewidth=1.8)
        if told:
            target = log[f"{contact}.target"][:, index]
            lines(ax, log, target, "target", INK, linewidth=1.0, linestyle=(0, (4, 3)))
            ax.tick_params(labelbottom=False)
            _error(fig.add_subplot(cell[1], label=f"{contact} error [{unit}]"), log, contact, index, unit)
        settled, whole = (
            known_rows(true[after_settling(log, told_of)]),
            np.percentile(known_rows(true), [1, 99], axis=0),
        )
        window(ax, np.array([-0.05, 0.05]), settled, whole)
        legend(ax, loc="lower right", bbox_to_anchor=(1.01, 0.97), ncols=7)
    hidden = ", ".join(dict.fromkeys(contact for contact, _, _ in blocks[BLOCKS:]))
    fig.axes[-1].set_xlabel(f"not drawn: {hidden}" if hidden else "", size=8, color=MUTED)


def _error(ax: Axes, log: Log, contact: str, index: list[int], unit: str) -> None:
    """Error of the held wrench, in a unit and a window that suit what is settled."""
    names, told_of = [log.meta["contacts"][contact][j] for j in index], f"{contact}.target"
    error, settled = (log[f"{contact}.lam"] - log[told_of])[:, index], after_settling(log, told_of)
    peak = np.abs(known_rows(error[settled])).max()
    factor, prefix = (1.0, "") if peak >= 0.1 or peak == 0.0 else (1e3, "m") if peak >= 1e-4 else (1e6, "µ")
    each = [rms(column) for column in factor * error[settled].T]
    panel(ax, "", log, told_of).set_ylabel(f"error\n[{prefix}{unit}]", size=8, color=INK)
    lines(ax, log, factor * error, [f"{name} rms {value:.2g}" for name, value in zip(names, each, strict=True)])
    least = factor * ROUNDING * np.abs(known_rows(log[told_of])).max()  # less than this is the simulator's own
    window(ax, np.array([-least, least]), known_rows(factor * error[settled]), head=3.0)
    legend(ax, loc="upper right", ncols=3, borderaxespad=0.1)


def pushes(fig: Figure, place: SubplotSpec, log: Log, tasks: Mapping[str, Sequence[str]]) -> None:
    """What truly pushes on each compliant task, and below how far it gives way, and what is left in its tank."""
    grid = GridSpecFromSubplotSpec(1, len(tasks), place, wspace=0.2)
    for i, (name, axes) in enumerate(tasks.items()):
        linear = [j for j, axis in enumerate(axes) if axis[0] == "v"]  # moments have a unit of their own
        index = linear or list(range(len(axes)))
        units = ("N", "mm") if linear else ("N m", "mrad")
        tank = f"{name}.tank" in log
        cell = GridSpecFromSubplotSpec(3 if tank else 2, 1, grid[0, i], hspace=0.08)
        names = [axes[j][1:] if len(axes[j]) == 2 else axes[j] for j in index]
        rows = (("external", 1.0), ("displacement", 1e3))
        for row, ((quantity, factor), unit, said) in enumerate(
            zip(rows, units, ("pushed by", "gives way"), strict=True)
        ):
            ax = fig.add_subplot(cell[row], label=f"{name} {said} [{unit}]")
            panel(ax, "" if row else f"{name}: {said} [{unit}]", log, f"{name}.{quantity}")
            lines(ax, log, factor * log[f"{name}.{quantity}"][:, index], names)
            if row:
                ax.set_ylabel(f"{said}\n[{unit}]", size=8, color=INK)
            else:
                legend(ax, loc="lower right", bbox_to_anchor=(1.01, 0.97), ncols=7)
            ax.tick_params(labelbottom=bool(row) and not tank)
        if tank:
            ax = panel(fig.add_subplot(cell[2], label=f"{name} tank [J]"), "", log, f"{name}.external")
            ax.set_ylabel("tank\n[J]", size=8, color=INK)
            lines(ax, log, log[f"{name}.tank"][:, None], "energy", linewidth=1.8)
            window(ax, np.zeros((1, 1)), known_rows(log[f"{name}.tank"][:, None]))
