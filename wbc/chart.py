"""The house style of every picture, and the parts that panels are made of."""

from __future__ import annotations

from collections.abc import Sized
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from numpy.typing import NDArray

from .log import Log
from .qp import Array

DPI = 100  # [1/in]
INK, MUTED, GRID, SHADE, PALE, GOOD, BAD = "#1f2933", "#7b8794", "#e4e7eb", "#eef0f3", "#cbd2d9", "#2f855a", "#c53030"
COLOURS = ("#2b6cb0", "#dd6b20", "#2c9c8f", "#805ad5", "#d53f8c", "#b7950b", "#4a5568", "#7c4a1e")
LEGEND: dict[str, Any] = {
    "fontsize": 8, "title_fontsize": 8, "labelcolor": INK, "edgecolor": "none", "framealpha": 0.85,
    "handlelength": 1.2, "columnspacing": 1.0, "handletextpad": 0.4,
}  # fmt: skip
TEXT: dict[str, Any] = {"va": "center", "parse_math": False}
JOINTS = len(COLOURS)  # the most lines of one panel
POINTS = 4000  # of one line; a longer one keeps the extremes of its stretches


def panel(ax: Axes, title: str, log: Log | None = None, told_of: str | None = None) -> Axes:
    """The house style; with a log, a time axis on which changes of phase are marked, and the settling time after each
    begin of the quantity `told_of`, or of the run, is shaded."""
    ax.set_title(title, loc="left", y=1.0, size=11, weight="bold", color=INK, parse_math=False)
    ax.grid(color=GRID, linewidth=0.7)
    ax.tick_params(colors=INK, labelsize=8, length=0)
    ax.set(facecolor="white", axisbelow=True)
    ax.xaxis.set_major_formatter("{x:g}")
    ax.yaxis.set_major_formatter("{x:g}")
    for side, spine in ax.spines.items():
        spine.set(visible=side in ("left", "bottom"), color=MUTED)
    if log is not None and "t" in log:
        start, end = log["t"][0], log["t"][-1] + log.meta["dt"]
        ax.set_xlim(start - 0.01 * (end - start), end + 0.01 * (end - start))
        for begin in begins(log, told_of):
            ax.axvspan(begin, min(begin + log.meta.get("settle", 0.0), end), color=SHADE, linewidth=0, zorder=0)
        for change in log.meta.get("changes", ())[1:]:
            ax.axvline(change["start"], color=MUTED, linewidth=0.8, linestyle=(0, (1, 2)), zorder=0.5)
        ax.locator_params(axis="x", nbins=8)
        ax.xaxis.set_major_formatter("{x:g} s")
    return ax


def legend(ax: Axes, **where: Any) -> None:
    if any(ax.get_legend_handles_labels()[1]):
        for text in ax.legend(**LEGEND, **where).get_texts():
            text.set_parse_math(False)


def lines(ax: Axes, log: Log, y: Array, labels: list[str] | str, colour: str = "", **style: Any) -> None:
    """One line a column of y (N, m) over time, all under one label if it is a text; a single tick is a dot."""
    look: dict[str, Any] = {"marker": "o" if log.size == 1 else "", "markersize": 4, "alpha": 0.9, **style}
    for i, column in enumerate(y.T):
        label = labels[i] if isinstance(labels, list) else "" if i else labels
        ax.plot(*thin(log["t"], column), color=colour or COLOURS[i % JOINTS], label=label, **look)


def runs(ax: Axes, log: Log, on: NDArray[np.int_], low: float, height: float, colour: str, label: str = "") -> None:
    """The ticks `on` as bars, no thinner than a line, so that one tick of many is seen."""
    t = np.append(log["t"], log["t"][-1] + log.meta["dt"])
    stretches = [run for run in np.split(on, np.flatnonzero(np.diff(on) > 1) + 1) if run.size]
    if stretches:
        spans = [(t[run[0]], t[run[-1] + 1] - t[run[0]]) for run in stretches]
        ax.broken_barh(spans, (low, height), facecolor=colour, edgecolor=colour, linewidth=1.2, label=label)


def window(ax: Axes, *parts: Array, head: float = 1.0) -> None:
    """Frame these values, with `head` times the margin above them, for a legend."""
    values = np.concatenate([part.ravel() for part in parts])
    low, high = values.min(), values.max()
    pad = max(0.1 * (high - low), 1e-6)
    ax.set_ylim(low - pad, high + head * pad)


def thin(t: Array, y: Array) -> tuple[Array, Array]:
    """About POINTS points at most: the least and the greatest of every stretch."""
    if t.size <= POINTS:
        return t, y
    starts = np.arange(0, t.size, -(-2 * t.size // POINTS))
    return np.repeat(t[starts], 2), np.column_stack((np.fmin.reduceat(y, starts), np.fmax.reduceat(y, starts))).ravel()


def ticks_of(log: Log, name: str | None) -> NDArray[np.bool_]:
    """(N,) ticks in which a quantity is known; all of them without a name, or when there are none."""
    everything = np.ones(log.size, bool)
    known = everything if name is None else np.isfinite(log[name].reshape(log.size, -1)).all(axis=1)
    return np.asarray(known if known.any() else everything)


def begins(log: Log, name: str | None) -> Array:
    """Times at which a quantity begins to be known [s]."""
    on = ticks_of(log, name)
    return log["t"][on & ~np.concatenate((np.zeros(min(1, on.size), bool), on[:-1]))]


def after_settling(log: Log, name: str | None = None) -> NDArray[np.bool_]:
    """(N,) ticks after the settling time of a quantity, or of the run; all of its ticks when there are none."""
    on = ticks_of(log, name)
    late = log.late(on, log.meta.get("settle", 0.0))
    return late if late.any() else on


def short(text: str, length: int) -> str:
    return text if len(text) <= length else text[: length - 1] + "…"


def known_rows(y: Array) -> Array:
    """The finite rows of y (N, m); one of zeros when there are none."""
    rows = y.reshape(y.shape[0], -1)
    known = rows[np.isfinite(rows).all(axis=1)]
    return known if known.size else np.zeros((1, rows.shape[1]))


def rms(y: Array) -> float:
    """Of what is finite."""
    known = y[np.isfinite(y)]
    return float(np.sqrt(np.mean(known**2))) if known.size else np.nan


def and_more(names: Sized, most: int) -> str:
    return f"and {len(names) - most} more" if len(names) > most else ""
