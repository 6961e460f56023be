"""One picture of a run: what it held, what it followed, what it cost, and whether every check passed.

Drawn with matplotlib's object interface on the Agg canvas: no pyplot, no window, no global state. Panels take their
data from the log by name; what a run does not have (a contact, a motion) leaves its place to the others.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.gridspec import GridSpec

from ..chart import BAD, DPI, GOOD, INK, MUTED, TEXT, and_more, short
from ..log import Log
from .checks import checks
from .motion import path, tracking
from .ticks import status, times, torques
from .wrench import BLOCKS, blocks_of, pushes, wrenches

SIZE = (16.0, 12.0)  # [in]


def report(log: Log, summary: dict[str, Any], path: Path) -> None:
    """Write the picture of a run to `path`, a PNG of 1600 x 1200."""
    with np.errstate(all="ignore"):  # a run that broke may hold any number
        picture = figure(log, summary)
        FigureCanvasAgg(picture).print_figure(path, dpi=DPI, format="png", bbox_inches=picture.bbox_inches)


def figure(log: Log, summary: dict[str, Any]) -> Figure:
    """The picture as a `Figure`; the label of each of its axes is the name of the panel."""
    fig = Figure(figsize=SIZE, dpi=DPI, facecolor="white")
    _header(fig, log, summary)
    blocks, motions = blocks_of(log), [name for name in log.meta.get("motions", ()) if f"{name}.error" in log]
    pushed = {} if blocks else {n: axes for n, axes in log.meta.get("pushed", {}).items() if f"{n}.external" in log}
    top = 3.7 + max(0.0, 0.45 * (len(blocks[:BLOCKS]) - 4)) if blocks or motions else 0.01
    place = {"left": 0.05, "right": 0.985, "top": 0.865, "bottom": 0.045, "hspace": 0.27, "wspace": 1.6}
    grid = GridSpec(3, 24, fig, **place, height_ratios=[top, 2.6, 2.7])
    split = 14 if (blocks or pushed) and motions else 24 if blocks else 0
    if blocks:
        wrenches(fig, grid[0, :split], log, blocks)
    elif pushed:
        pushes(fig, grid[0, :split], log, pushed)
    if motions:
        path(fig.add_subplot(grid[0, split:], label="path"), log, motions)
        tracking(fig.add_subplot(grid[1, 14:], label="tracking"), log, motions)
    torques(fig.add_subplot(grid[1, : 11 if motions else 21], label="torques"), log)
    status(fig, grid[2, :9], log)
    times(fig.add_subplot(grid[2, 9:15], label="times"), log)
    checks(fig.add_subplot(grid[2, 15:], label="checks"), summary)
    return fig


def _header(fig: Figure, log: Log, summary: dict[str, Any]) -> None:
    """Verdict and title; a line on the run; what went wrong."""
    ok, title = bool(summary.get("ok")), short(str(log.meta.get("title") or summary.get("spec", "")), 98)
    badge = {"boxstyle": "round,pad=0.35", "facecolor": GOOD if ok else BAD, "edgecolor": "none"}
    facts, faults = "   ·   ".join(_facts(log, summary)), short("   ·   ".join(_faults(log, summary)), 150)
    fig.text(0.056, 0.955, "PASS" if ok else "FAIL", size=20, weight="bold", color="white", bbox=badge, **TEXT)
    fig.text(0.124, 0.957, title, size=22 if len(title) < 65 else 16, weight="bold", color=INK, **TEXT)
    fig.text(0.124, 0.926, facts, size=11, color=MUTED, **TEXT)
    fig.text(0.124, 0.903, faults, size=11, weight="bold", color=BAD, **TEXT)


def _facts(log: Log, summary: dict[str, Any]) -> list[str]:
    meta, us = log.meta, summary["step_us"]
    facts = [
        f"{meta.get('robot', 'robot')}, {len(meta['joints'])} joints",
        f"{log.size} ticks of {1e3 * meta['dt']:.3g} ms",
    ]
    facts += [f"a tick takes {us['p50']:.0f} µs (p50), {us['p99']:.0f} µs (p99)"] if log.size else []
    return facts + ([f"shaded: {meta['settle']:.3g} s of settling"] if meta.get("settle") else [])


def _faults(log: Log, summary: dict[str, Any]) -> list[str]:
    failed = [check["name"] for check in summary.get("checks", ()) if not check["ok"]]
    faults = [f"simulation broke: {summary['broken']}"] if summary.get("broken") else []
    faults += ["failed: " + ", ".join(filter(None, [*failed[:4], and_more(failed, 4)]))] if failed else []
    early = log.size and log["t"][-1] < log.meta.get("settle", 0.0)
    return faults + (["ended while settling: figures that leave settling out have measured nothing"] if early else [])
