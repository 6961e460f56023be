"""One picture of a run: what it held, what it followed, what it cost, and whether every check passed.

Drawn with matplotlib's object interface on the Agg canvas: no pyplot, no window, no global state. A panel takes its data
from the log by name; what a run does not have (contacts, motion) leaves its place to the others.
"""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.gridspec import GridSpec, GridSpecFromSubplotSpec, SubplotSpec

from .log import Log
from .qp import Array

SIZE, DPI = (16.0, 12.0), 100  # [in], [1/in]
INK, MUTED, GRID, PAPER = "#1f2933", "#7b8794", "#e4e7eb", "#ffffff"
GOOD, BAD = "#2f855a", "#c53030"
COLOURS = ("#2b6cb0", "#dd6b20", "#2c9c8f", "#805ad5", "#d53f8c", "#b7950b", "#4a5568", "#e53e3e")
STATUS = {"OK": "#68b587", "LIMITED": "#f0b429", "DEGRADED": "#e8710a", "SAFE_HOLD": "#c53030", "STOPPED": "#4a1d1d"}
BLOCKS, JOINTS, ROWS, CHECKS, NAME = 8, len(COLOURS), 8, 12, 30  # the most of each that one picture shows
POINTS = 4000  # of one line; longer ones keep the extremes of their stretches


def report(log: Log, summary: dict[str, Any], path: Path | str) -> None:
    """Write the picture of a run to `path` (PNG, 1600 x 1200)."""
    FigureCanvasAgg(figure(log, summary)).print_png(str(path))


def figure(log: Log, summary: dict[str, Any]) -> Figure:
    """The picture as a matplotlib `Figure`; each axes carries the name of its panel as label."""
    fig = Figure(figsize=SIZE, dpi=DPI, facecolor=PAPER)
    _header(fig, log, summary)
    blocks = _blocks(log)
    motions = [name for name in log.meta.get("motions", ()) if f"{name}.error" in log]
    heights = [3.7 if blocks or motions else 0.01, 2.6, 2.7]
    grid = GridSpec(3, 12, fig, left=0.05, right=0.985, top=0.865, bottom=0.045, hspace=0.27, wspace=0.9, height_ratios=heights)
    split = 7 if blocks and motions else 12 if blocks else 0
    if blocks:
        _wrenches(fig, grid[0, :split], log, blocks)
    if motions:
        _path(fig.add_subplot(grid[0, split:], label="path"), log, motions)
        _tracking(fig.add_subplot(grid[1, 7:], label="tracking"), log, motions)
    _torques(fig.add_subplot(grid[1, : 7 if motions else 12], label="torques"), log)
    _status(fig, grid[2, :5], log, summary)
    _times(fig.add_subplot(grid[2, 5:8], label="times"), log, summary)
    _checks(fig.add_subplot(grid[2, 8:], label="checks"), summary)
    return fig


def _header(fig: Figure, log: Log, summary: dict[str, Any]) -> None:
    """Title, verdict with what failed, and one line on the run."""
    meta, us = log.meta, summary.get("step_us", {})
    title = str(meta.get("title") or summary.get("spec", ""))
    failed = [check["name"] for check in summary.get("checks", ()) if not check["ok"]]
    verdict = "PASS" if summary.get("ok") else "FAIL"
    colour = GOOD if summary.get("ok") else BAD
    box = {"boxstyle": "round,pad=0.35", "facecolor": colour, "edgecolor": "none"}
    fig.text(0.05, 0.955, verdict, size=20, weight="bold", color="white", va="center", bbox=box)
    fig.text(0.115, 0.955, _short(title, 95), size=22 if len(title) < 65 else 16, weight="bold", color=INK, va="center", parse_math=False)
    facts = [str(meta.get("robot", "")), f"{len(meta.get('joints', ()))} joints", f"{summary.get('sim_seconds', 0.0):.4g} s in {log.size} ticks"]
    facts += [f"tick p50 {us['p50']:.0f} µs, p99 {us['p99']:.0f} µs"] if us else []
    facts += [f"seed {meta['seed']}"] if "seed" in meta else []
    fig.text(0.115, 0.923, "   ·   ".join(filter(None, facts)), size=11, color=MUTED, va="center", parse_math=False)
    wrong = ["simulation broke: " + str(summary["broken"])] if summary.get("broken") else []
    wrong += ["failed: " + _listed(failed, 4)] if failed else []
    fig.text(0.115, 0.899, _short("   ·   ".join(wrong), 170), size=11, weight="bold", color=BAD, va="center", parse_math=False)


def _blocks(log: Log) -> list[tuple[str, str, list[int]]]:
    """(contact, unit, columns of its multipliers): forces and moments of a contact stand in plots of their own."""
    blocks = []
    for contact, axes in log.meta.get("contacts", {}).items():
        if f"{contact}.lam" in log:
            units = [{"f": "N", "m": "N m"}.get(axis[0], "") if len(axis) == 2 else "" for axis in axes]
            blocks += [(contact, unit, [i for i, u in enumerate(units) if u == unit]) for unit in dict.fromkeys(units)]
    return blocks


def _wrenches(fig: Figure, place: SubplotSpec, log: Log, blocks: list[tuple[str, str, list[int]]]) -> None:
    """True multipliers of each contact over their targets, and the error below in a unit that suits it."""
    columns = min(2, len(blocks))
    shown = blocks[:BLOCKS]
    grid = GridSpecFromSubplotSpec(-(-len(shown) // columns), columns, place, hspace=0.42, wspace=0.2)
    for i, (contact, unit, index) in enumerate(shown):
        target = log[f"{contact}.target"] if f"{contact}.target" in log else None
        inner = GridSpecFromSubplotSpec(1 if target is None else 2, 1, grid[i], hspace=0.08)
        value = _axes(fig.add_subplot(inner[0], label=f"{contact} [{unit}]"), f"{contact} held [{unit}]", log)
        true, names = log[f"{contact}.lam"][:, index], [log.meta["contacts"][contact][j] for j in index]
        _lines(value, log, true, names, linewidth=1.8)
        _window(value, log, [true] if target is None else [true, target[:, index]])
        if target is not None:
            _lines(value, log, target[:, index[:1]], ["target"], INK, linewidth=1.0, linestyle=(0, (4, 3)))
            _lines(value, log, target[:, index[1:]], [""] * (len(index) - 1), INK, linewidth=1.0, linestyle=(0, (4, 3)))
            value.tick_params(labelbottom=False)
            _wrench_error(fig.add_subplot(inner[1], label=f"{contact} error [{unit}]"), log, true - target[:, index], names, unit)
        _legend(value, loc="lower right", bbox_to_anchor=(1.01, 0.98), ncols=7)
    if len(blocks) > BLOCKS:
        hidden = dict.fromkeys(contact for contact, _, _ in blocks[BLOCKS:])
        value.set_xlabel(f"not drawn: {_listed(list(hidden), 6)}", color=MUTED)


def _wrench_error(ax: Axes, log: Log, error: Array, names: list[str], unit: str) -> None:
    factor, prefix = _prefix(error[_settled(log)])
    rms = [_rms(column) * factor for column in error[_settled(log)].T]
    _axes(ax, "", log).set_ylabel(f"error [{prefix}{unit}]", size=9, color=INK)
    _lines(ax, log, error * factor, [f"{name} rms {value:.2g}" for name, value in zip(names, rms, strict=True)], linewidth=1.0)
    ax.axhline(0.0, color=MUTED, linewidth=0.6)
    _window(ax, log, [error * factor], settled=True)
    _legend(ax, loc="upper right", ncols=3, borderaxespad=0.2)


def _path(ax: Axes, log: Log, motions: list[str]) -> None:
    """Desired and actual path on the two world axes along which the references move most."""
    _axes(ax, "path in the plane [mm]")
    spread = sum(np.nan_to_num(np.nanvar(_known(log[f"{name}.desired"]), axis=0)) for name in motions)
    a, b = sorted(np.argsort(-np.asarray(spread), kind="stable")[:2])
    for i, name in enumerate(motions):
        desired, actual = 1e3 * log[f"{name}.desired"], 1e3 * log[f"{name}.position"]
        label = f"{name} " if len(motions) > 1 else ""
        ax.plot(desired[:, a], desired[:, b], color="#cbd2d9", linewidth=7, solid_capstyle="round", label=f"{label}desired")
        ax.plot(actual[:, a], actual[:, b], color=COLOURS[i % JOINTS], linewidth=1.6, label=f"{label}actual")
        start = _known(actual)[0]
        ax.plot(start[a], start[b], "o", color=INK, markersize=6, label="" if i else "start")
        ax.update_datalim([start[[a, b]] - 0.5, start[[a, b]] + 0.5])  # a point keeps a frame around it
    ax.set_xlabel("xyz"[a], size=9, color=INK)
    ax.set_ylabel("xyz"[b], size=9, color=INK)
    ax.set_aspect("equal", adjustable="datalim")
    _legend(ax, loc="lower right", bbox_to_anchor=(1.01, 0.99), ncols=5)


def _tracking(ax: Axes, log: Log, motions: list[str]) -> None:
    """Distance and angle to the reference, on one logarithmic scale: the start and the end are decades apart."""
    _axes(ax, "tracking error [mm, mrad]", log)
    for i, name in enumerate(motions):
        label = f"{name} " if len(motions) > 1 else ""
        for part, unit, style in ((slice(3, 6), "mm", "-"), (slice(0, 3), "mrad", ":")):
            error = 1e3 * np.linalg.norm(log[f"{name}.error"][:, part], axis=1)
            text = f"{label}{'position' if unit == 'mm' else 'rotation'}, rms {_rms(error[_settled(log)]):.2g} {unit}"
            colour = COLOURS[(2 * i + (unit == "mrad")) % JOINTS]
            _lines(ax, log, np.maximum(error, 1e-9)[:, None], [text], colour, linewidth=1.2, linestyle=style)
    ax.set_yscale("log")
    low, high = ax.get_ylim()
    ax.set_ylim(max(low, 1e-7 * high), high)
    _legend(ax, loc="upper right", ncols=1)


def _torques(ax: Axes, log: Log) -> None:
    """Torque as share of the joint's largest limit; limits that change with the phase are drawn as they change."""
    _axes(ax, "torque, share of the limit", log)
    if "tau" not in log:
        return
    tau, low, high = log["tau"], log["tau_min"], log["tau_max"]
    joints = [str(name) for name in log.meta.get("joints", ())]
    joints = joints if len(joints) == tau.shape[1] else [f"joint {i + 1}" for i in range(tau.shape[1])]
    up, down = (np.max(np.where(np.isfinite(x), np.abs(x), 0.0), axis=0) for x in (high, low))
    share, ceiling, floor = (_share(x, down, up) for x in (tau, low, high))
    peak = np.max(np.nan_to_num(np.abs(share)), axis=0)
    first = sorted(np.argsort(-peak, kind="stable")[:JOINTS])
    rest = [i for i in range(peak.size) if i not in first]
    limits = np.unique(np.hstack((ceiling, floor)), axis=1)
    _lines(ax, log, limits, [""] * limits.shape[1], BAD, linewidth=1.1)
    _lines(ax, log, share[:, rest], [f"{len(rest)} others" if n == 0 else "" for n in range(len(rest))], "#cbd2d9", linewidth=0.8)
    _lines(ax, log, share[:, first], [f"{_short(joints[i], 20)}  {peak[i]:.0%}" for i in first], linewidth=1.3)
    ax.set_ylim(-1.15, 1.15)
    _legend(ax, loc="upper left", bbox_to_anchor=(1.0, 1.02), title="joint, peak")


def _status(fig: Figure, place: SubplotSpec, log: Log, summary: dict[str, Any]) -> None:
    """How good each tick was, and below which limits were active when."""
    count = Counter(name for active in log.active for name in active)
    names = [name for name, _ in count.most_common(ROWS)]
    grid = GridSpecFromSubplotSpec(2, 1, place, hspace=0.06, height_ratios=[1, 4])
    strip = _axes(fig.add_subplot(grid[0], label="status"), "status", log)
    raster = _axes(fig.add_subplot(grid[1], label="active"), "", log)
    if "t" in log:
        for i, name in enumerate(log.meta.get("status_names", STATUS)):
            colour, ticks = STATUS.get(name, MUTED), log["status"] == i
            _runs(strip, log, ticks, 0.0, 1.0, colour, f"{name} {summary.get('status', {}).get(name, ticks.sum())}" if ticks.any() else "")
        for row, name in enumerate(names):
            _runs(raster, log, np.array([name in active for active in log.active]), row - 0.35, 0.7, STATUS["LIMITED"])
    strip.set(ylim=(0, 1), yticks=[])
    strip.tick_params(labelbottom=False)
    _legend(strip, loc="lower right", bbox_to_anchor=(1.01, 0.98), ncols=5)
    raster.set_ylim(max(len(names), 4) - 0.5, -0.5)
    raster.set_yticks(range(len(names)), [f"{_short(name, NAME)}  {count[name]}" for name in names], size=8)
    more = len(count) - len(names)
    note = "no limit was active" if not names else f"and {more} more" if more else ""
    raster.text(0.5, 0.06, note, transform=raster.transAxes, ha="center", size=9, color=MUTED)


def _times(ax: Axes, log: Log, summary: dict[str, Any]) -> None:
    """Time of a tick on a logarithmic scale, beside the control period."""
    _axes(ax, "time of a tick [µs]").set_yticks([])
    if "step_us" not in log:
        return
    us, period = np.maximum(_known(log["step_us"][:, None])[:, 0], 1e-3), 1e6 * float(log.meta.get("dt", np.nan))
    edges = np.geomspace(0.8 * us.min(), 1.25 * us.max(), 60)
    ax.hist(us, edges, color=COLOURS[0], alpha=0.55)
    marks = [(value, f"{name} {value:.0f}", INK, style) for name, value, style in zip(("p50", "p99"), np.percentile(us, [50, 99]), ("-", "--"))]
    marks += [(period, f"period {period:.0f}, {np.mean(us > period):.2%} over", BAD, "-")] if period > 0 else []
    for value, text, colour, style in marks:
        ax.axvline(value, color=colour, linewidth=1.4, linestyle=style, label=text)
    ax.set_xscale("log")
    ax.set_ylim(0, 1.45 * ax.get_ylim()[1])
    _legend(ax, loc="upper right", ncols=1)


def _checks(ax: Axes, summary: dict[str, Any]) -> None:
    """Every bound: what was measured, what was asked. What failed comes first."""
    _axes(ax, "checks [SI units]")
    ax.set(xlim=(0, 1), ylim=(CHECKS + 1.2, -0.4))
    ax.axis("off")
    checks = sorted(summary.get("checks", ()), key=lambda check: bool(check["ok"]))
    for x, text in ((0.64, "value"), (0.9, "bound")):
        ax.text(x, 0, text, size=9, color=MUTED, ha="right")
    for row, check in enumerate(checks[:CHECKS], 1):
        colour = INK if check["ok"] else BAD
        weight = "normal" if check["ok"] else "bold"
        cells = ((0.0, _short(check["name"], NAME), "left"), (0.64, _number(check["value"]), "right"), (0.9, _bound(check["bound"]), "right"))
        for x, text, align in cells:
            ax.text(x, row, text, size=9, color=colour, weight=weight, ha=align, va="center", parse_math=False)
        ax.text(1.0, row, "ok" if check["ok"] else "FAIL", size=9, weight="bold", color=GOOD if check["ok"] else BAD, ha="right", va="center")
    more = len(checks) - CHECKS
    ax.text(0, CHECKS + 1, f"and {more} more" if more > 0 else "" if checks else "no checks", size=9, color=MUTED, va="center")


# --- parts ---


def _axes(ax: Axes, title: str, log: Log | None = None) -> Axes:
    """The house style; with a log, a time axis with its settling time shaded."""
    ax.set_title(title, loc="left", size=11, weight="bold", color=INK, pad=6, parse_math=False)
    ax.set_facecolor(PAPER)
    ax.grid(color=GRID, linewidth=0.7)
    ax.set_axisbelow(True)
    ax.tick_params(colors=INK, labelsize=8, length=0)
    for side, spine in ax.spines.items():
        spine.set(visible=side in ("left", "bottom"), color=MUTED)
    if log is not None and "t" in log:
        start, end = float(log["t"][0]), float(log["t"][-1]) + float(log.meta.get("dt", 0.0))
        ax.set_xlim(start, end if end > start else start + 1e-3)
        settle = min(float(log.meta.get("settle", 0.0)), end)
        if settle > start:
            ax.axvspan(start, settle, color="#f1f3f5", linewidth=0, zorder=0)
    return ax


def _legend(ax: Axes, **where: Any) -> None:
    if any(ax.get_legend_handles_labels()[1]):
        look: dict[str, Any] = {"fontsize": 8, "title_fontsize": 8, "labelcolor": INK, "frameon": True, "edgecolor": "none", "framealpha": 0.85}
        legend = ax.legend(**look, handlelength=1.2, columnspacing=1.0, handletextpad=0.4, **where)
        for text in legend.get_texts():
            text.set_parse_math(False)


def _lines(ax: Axes, log: Log, y: Array, labels: list[str], colour: str | None = None, **style: Any) -> None:
    """One line a column of y (N, m) over time; a single tick is a dot."""
    for i, label in enumerate(labels):
        t, column = _thin(log["t"], y[:, i])
        marker = "o" if t.size == 1 else ""
        ax.plot(t, column, color=colour or COLOURS[i % JOINTS], marker=marker, markersize=4, label=label, **style)


def _runs(ax: Axes, log: Log, on: Array, low: float, height: float, colour: str, label: str = "") -> None:
    """Stretches of ticks as bars that are at least a line wide, so that one tick of many is seen."""
    edges = np.flatnonzero(np.diff(np.concatenate(([False], on, [False])).astype(int)))
    t = np.append(log["t"], log["t"][-1] + float(log.meta.get("dt", 1e-3)))
    spans = [(t[a], t[b] - t[a]) for a, b in zip(edges[::2], edges[1::2], strict=True)]
    if spans:
        ax.broken_barh(spans, (low, height), facecolor=colour, edgecolor=colour, linewidth=0.8, label=label)


def _thin(t: Array, y: Array) -> tuple[Array, Array]:
    """At most about POINTS of a line: the least and the greatest of every stretch."""
    if t.size <= POINTS:
        return t, y
    size = -(-2 * t.size // POINTS)
    starts = np.arange(0, t.size, size)
    low, high = np.fmin.reduceat(y, starts), np.fmax.reduceat(y, starts)
    return np.repeat(t[starts], 2), np.column_stack((low, high)).ravel()


def _window(ax: Axes, log: Log, ys: list[Array], settled: bool = False) -> None:
    """Frame what is settled; of the rest, unless told otherwise, all but its wildest percents."""
    parts = [_known(y[_settled(log)].reshape(-1, 1)) for y in ys]
    parts += [] if settled else [np.percentile(_known(y.reshape(-1, 1)), [1, 99]) for y in ys]
    values = np.concatenate([part.ravel() for part in parts])
    half = 0.02 * np.abs(values).max()
    low, high = values.min(), values.max()
    pad = max(0.12 * (high - low), half, 1e-9)
    ax.set_ylim(low - pad, high + (2.5 if settled else 1.0) * pad)


def _settled(log: Log) -> Any:
    late = log["t"] >= float(log.meta.get("settle", 0.0)) - 1e-9
    return late if late.any() else ~late


def _known(y: Array) -> Array:
    """The finite rows of y (N, m), a row of zeros if there are none."""
    rows = y[np.isfinite(y).all(axis=1)]
    return rows if rows.size else np.zeros((1, y.shape[1]))


def _rms(y: Array) -> float:
    return float(np.sqrt(np.mean(_known(y[:, None]) ** 2)))


def _prefix(y: Array) -> tuple[float, str]:
    """Factor and prefix of the unit in which the largest of y is a handy number."""
    peak = float(np.abs(_known(y)).max())
    return (1.0, "") if peak >= 0.1 or peak == 0.0 else (1e3, "m") if peak >= 1e-4 else (1e6, "µ")


def _share(x: Array, down: Array, up: Array) -> Array:
    """x [N m] as a share of the upper limit, below zero of the lower one; NaN where there is none."""
    scale = np.where(x >= 0.0, up, down)
    return np.divide(x, scale, out=np.full(x.shape, np.nan), where=np.isfinite(x) & (scale > 0.0))


def _short(text: str, length: int) -> str:
    return text if len(text) <= length else text[: length - 1] + "…"


def _listed(names: list[str], most: int) -> str:
    return ", ".join(names[:most]) + (f" and {len(names) - most} more" if len(names) > most else "")


def _number(value: Any) -> str:
    return "-" if value is None or not np.isfinite(value) else f"{value:.3g}"


def _bound(bound: Any) -> str:
    if isinstance(bound, dict):
        return " … ".join(_number(bound[key]) if key in bound else "" for key in ("min", "max"))
    return _number(bound)
