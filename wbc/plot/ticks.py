"""Panels of each tick: its torques, how good it was, which limits were active, how long it took."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.gridspec import GridSpecFromSubplotSpec, SubplotSpec

from ..chart import (
    BAD,
    COLOURS,
    INK,
    JOINTS,
    MUTED,
    PALE,
    SHADE,
    TEXT,
    and_more,
    known_rows,
    legend,
    lines,
    panel,
    runs,
    short,
)
from ..log import Log
from ..qp import Array

LIMITS = 8  # the most that one picture shows
STATUS = {"OK": "#68b587", "LIMITED": "#f0b429", "DEGRADED": "#e8710a", "SAFE_HOLD": "#c53030", "STOPPED": "#4a1d1d"}


def torques(ax: Axes, log: Log) -> None:
    """Torque over the joint's largest limit; a limit that changes with the phase is drawn as it changes."""
    panel(ax, "torque, share of the limit", log)
    if "tau" not in log:
        return
    names = log.meta["joints"]
    tau, low, high = (log[name][:, -len(names) :] for name in ("tau", "tau_min", "tau_max"))
    most = [np.where(np.isfinite(limit), np.abs(limit), 0.0).max(axis=0) for limit in (low, high)]
    share, edges = _share(tau, *most), np.hstack((_share(low, *most), _share(high, *most))).T
    peak = np.nan_to_num(np.abs(_share(tau, np.abs(low), np.abs(high)))).max(axis=0)
    order = np.argsort(-peak, kind="stable")
    first, rest = np.sort(order[:JOINTS]), order[JOINTS:]
    told = [f"{short(names[i].removesuffix('_joint'), 16)}  {min(peak[i], 9.99):.0%}" for i in first]
    lines(ax, log, share[:, rest], f"{rest.size} others", PALE, linewidth=0.8)
    lines(ax, log, share[:, first], told, linewidth=1.4)
    lines(ax, log, np.array(list({edge.tobytes(): edge for edge in edges}.values())).T, "limit", BAD, linewidth=1.2)
    ax.set_ylim(-1.15, 1.15)
    legend(ax, loc="upper left", bbox_to_anchor=(1.0, 1.03), title="joint, peak")


def status(fig: Figure, place: SubplotSpec, log: Log) -> None:
    """How good each tick was; below, which limits were active when, the most frequent first."""
    changes = log.meta.get("changes", ())
    grid = GridSpecFromSubplotSpec(3, 1, place, hspace=0.08, height_ratios=[1, 0.8 if len(changes) > 1 else 0.01, 4])
    strip = panel(fig.add_subplot(grid[0], label="status"), "status", log)
    if len(changes) > 1 and log.size:
        _phases(panel(fig.add_subplot(grid[1], label="phases"), "", log), log, changes)
    raster = panel(fig.add_subplot(grid[2], label="active"), "", log)
    for i, name in enumerate(log.meta["status_names"] if "status" in log else ()):
        on = np.flatnonzero(log["status"] == i)
        runs(strip, log, on, 0.0, 1.0, STATUS.get(name, MUTED), f"{name} {on.size}")
    ticks: dict[str, list[int]] = {}
    for i, active in enumerate(log.active):
        for name in active:
            ticks.setdefault(name, []).append(i)
    names = sorted(ticks, key=lambda name: -len(ticks[name]))[:LIMITS]
    for row, name in enumerate(names):
        runs(raster, log, np.array(ticks[name]), row + 0.55, 0.35, STATUS["LIMITED"])
        raster.text(log["t"][0], row + 0.3, f"{short(name, 60)}   {len(ticks[name])}", size=8, color=INK, **TEXT)
    note = and_more(ticks, LIMITS) if ticks else "no limit was active"
    raster.text(0.98, 0.04, note, transform=raster.transAxes, ha="right", size=8, color=MUTED)
    strip.set(ylim=(0, 1), yticks=[])
    strip.tick_params(labelbottom=False)
    raster.set(ylim=(max(5, len(names)) + 0.1, -0.1), yticks=[])
    legend(strip, loc="lower right", bbox_to_anchor=(1.01, 0.97), ncols=5)


def _phases(ax: Axes, log: Log, changes: Sequence[dict[str, Any]]) -> None:
    """The phases by name, side by side, each name as long as there is room for it."""
    ends = [*(change["start"] for change in changes[1:]), log["t"][-1] + log.meta["dt"]]
    for i, (change, end) in enumerate(zip(changes, ends, strict=True)):
        start, whole = change["start"], ends[-1] - log["t"][0]
        ax.axvspan(start, end, color=(PALE, SHADE)[i % 2], linewidth=0)
        name = short(change["name"], int(60 * (end - start) / max(whole, 1e-9)))
        ax.text(0.5 * (start + end), 0.5, name, size=8, color=INK, ha="center", **TEXT)
    ax.set(ylim=(0, 1), yticks=[])
    ax.grid(visible=False)
    ax.tick_params(labelbottom=False)


def times(ax: Axes, log: Log) -> None:
    """How long a tick took, beside the control period."""
    panel(ax, "time of a tick [µs]").set_yticks([])
    if "step_us" not in log:
        return
    us, period = np.maximum(known_rows(log["step_us"]), 1e-3).ravel(), 1e6 * float(log.meta["dt"])
    p50, p99, last = np.percentile(us, [50, 99, 100])
    low, high = 0.8 * min(us.min(), period), 1.25 * max(last, period)
    ax.stairs(*np.histogram(us, np.geomspace(low, high, 70)), fill=True, color=COLOURS[0], alpha=0.55)
    for x, text, colour, style in (
        (p50, f"p50 {p50:.0f}", INK, "-"),
        (p99, f"p99 {p99:.0f}, max {last:.0f}", INK, (0, (4, 3))),
        (period, f"period {period:.0f}: {np.mean(us > period):.2%} over", BAD, "-"),
    ):
        ax.axvline(x, color=colour, linestyle=style, linewidth=1.4, label=text)
    steps = (1, 2, 5) if high < 100.0 * low else (1,)  # labels of more would overlap
    ticks = [step * 10.0**k for k in range(-3, 9) for step in steps]
    ax.set(xscale="log", xlim=(low, high), ylim=(0, 1.45 * ax.get_ylim()[1]))
    ax.set_xticks([x for x in ticks if low <= x <= high], [f"{x:g}" for x in ticks if low <= x <= high])
    ax.minorticks_off()
    legend(ax, loc="upper right")


def _share(x: Array, down: Array, up: Array) -> Array:
    """x (N, n) over the upper limit where it is positive, else over the lower one; NaN where there is no limit."""
    scale = np.where(x >= 0.0, up, down)
    known = np.isfinite(x) & np.isfinite(scale) & (scale > 0.0)
    return np.where(known, x, np.nan) / np.where(known, scale, 1.0)
