"""One picture of a run: what it held, what it followed, what it cost, and whether every check passed.

Drawn with matplotlib's object interface on the Agg canvas: no pyplot, no window, no global state. Panels take their
data from the log by name; what a run does not have (a contact, a motion) leaves its place to the others.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence, Sized
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.gridspec import GridSpec, GridSpecFromSubplotSpec, SubplotSpec

from .chart import (
    BAD,
    COLOURS,
    DPI,
    GOOD,
    INK,
    JOINTS,
    MUTED,
    PALE,
    SHADE,
    after_settling,
    legend,
    lines,
    panel,
    runs,
    short,
    window,
)
from .log import Log
from .qp import Array

SIZE = (16.0, 12.0)  # [in]
STATUS = {"OK": "#68b587", "LIMITED": "#f0b429", "DEGRADED": "#e8710a", "SAFE_HOLD": "#c53030", "STOPPED": "#4a1d1d"}
TEXT: dict[str, Any] = {"va": "center", "parse_math": False}
BLOCKS, LIMITS, CHECKS = 8, 8, 12  # the most of each that one picture shows
ROUNDING = 1e-6  # of a target: errors below it are not blown up


def report(log: Log, summary: dict[str, Any], path: Path) -> None:
    """Write the picture of a run to `path`, a PNG of 1600 x 1200."""
    with np.errstate(all="ignore"):  # a run that broke may hold any number
        picture = figure(log, summary)
        FigureCanvasAgg(picture).print_figure(path, dpi=DPI, format="png", bbox_inches=picture.bbox_inches)


def figure(log: Log, summary: dict[str, Any]) -> Figure:
    """The picture as a `Figure`; the label of each of its axes is the name of the panel."""
    fig = Figure(figsize=SIZE, dpi=DPI, facecolor="white")
    _header(fig, log, summary)
    blocks, motions = _blocks(log), [name for name in log.meta.get("motions", ()) if f"{name}.error" in log]
    pushed = {} if blocks else {n: axes for n, axes in log.meta.get("pushed", {}).items() if f"{n}.external" in log}
    top = 3.7 + max(0.0, 0.45 * (len(blocks[:BLOCKS]) - 4)) if blocks or motions else 0.01
    place = {"left": 0.05, "right": 0.985, "top": 0.865, "bottom": 0.045, "hspace": 0.27, "wspace": 1.6}
    grid = GridSpec(3, 24, fig, **place, height_ratios=[top, 2.6, 2.7])
    split = 14 if (blocks or pushed) and motions else 24 if blocks else 0
    if blocks:
        _wrenches(fig, grid[0, :split], log, blocks)
    elif pushed:
        _pushes(fig, grid[0, :split], log, pushed)
    if motions:
        _path(fig.add_subplot(grid[0, split:], label="path"), log, motions)
        _tracking(fig.add_subplot(grid[1, 14:], label="tracking"), log, motions)
    _torques(fig.add_subplot(grid[1, : 11 if motions else 21], label="torques"), log)
    _status(fig, grid[2, :9], log)
    _times(fig.add_subplot(grid[2, 9:15], label="times"), log)
    _checks(fig.add_subplot(grid[2, 15:], label="checks"), summary)
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
    faults += ["failed: " + ", ".join(filter(None, [*failed[:4], _more(failed, 4)]))] if failed else []
    early = log.size and log["t"][-1] < log.meta.get("settle", 0.0)
    return faults + (["ended while settling: figures that leave settling out have measured nothing"] if early else [])


# --- panels ---

Block = tuple[str, str, list[int]]


def _blocks(log: Log) -> list[Block]:
    """(contact, unit, columns of its multipliers): moments and forces of a contact stand in plots of their own."""
    blocks = []
    for contact, axes in log.meta.get("contacts", {}).items():
        if f"{contact}.lam" in log:
            units = [
                {"m": "N m", "f": "N"}.get(axis[0], "") if len(axis) == 2 else "N" * (axis == "normal") for axis in axes
            ]
            blocks += [(contact, unit, [i for i, u in enumerate(units) if u == unit]) for unit in dict.fromkeys(units)]
    return blocks


def _wrenches(fig: Figure, place: SubplotSpec, log: Log, blocks: list[Block]) -> None:
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
        settled, whole = _known(true[after_settling(log, told_of)]), np.percentile(_known(true), [1, 99], axis=0)
        window(ax, np.array([-0.05, 0.05]), settled, whole)
        legend(ax, loc="lower right", bbox_to_anchor=(1.01, 0.97), ncols=7)
    hidden = ", ".join(dict.fromkeys(contact for contact, _, _ in blocks[BLOCKS:]))
    fig.axes[-1].set_xlabel(f"not drawn: {hidden}" if hidden else "", size=8, color=MUTED)


def _error(ax: Axes, log: Log, contact: str, index: list[int], unit: str) -> None:
    """Error of the held wrench, in a unit and a window that suit what is settled."""
    names, told_of = [log.meta["contacts"][contact][j] for j in index], f"{contact}.target"
    error, settled = (log[f"{contact}.lam"] - log[told_of])[:, index], after_settling(log, told_of)
    peak = np.abs(_known(error[settled])).max()
    factor, prefix = (1.0, "") if peak >= 0.1 or peak == 0.0 else (1e3, "m") if peak >= 1e-4 else (1e6, "µ")
    rms = [_rms(column) for column in factor * error[settled].T]
    panel(ax, "", log, told_of).set_ylabel(f"error\n[{prefix}{unit}]", size=8, color=INK)
    lines(ax, log, factor * error, [f"{name} rms {value:.2g}" for name, value in zip(names, rms, strict=True)])
    least = factor * ROUNDING * np.abs(_known(log[told_of])).max()  # less than this is the simulator's own
    window(ax, np.array([-least, least]), _known(factor * error[settled]), head=3.0)
    legend(ax, loc="upper right", ncols=3, borderaxespad=0.1)


def _pushes(fig: Figure, place: SubplotSpec, log: Log, tasks: Mapping[str, Sequence[str]]) -> None:
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
            window(ax, np.zeros((1, 1)), _known(log[f"{name}.tank"][:, None]))


def _of(log: Log, motions: list[str], part: slice) -> list[str]:
    """The motions that have an error along some axes of this part of a pose at all; all of them where none has."""
    return [name for name in motions if np.nan_to_num(log[f"{name}.error"][:, part]).any()] or motions


def _path(ax: Axes, log: Log, motions: list[str]) -> None:
    """Desired and actual path along the two world axes on which the references, or else the frames, move most; several
    from their starts."""
    motions = _of(log, motions, slice(3, 6))
    known = {name: _known(log[f"{name}.desired"]) for name in motions}
    spread = np.sum([path.var(axis=0) for path in known.values()], axis=0)
    if not spread.max() > 1e-12:  # references that stand still: where the push moves it
        spread = np.sum([_known(log[f"{name}.position"]).var(axis=0) for name in motions], axis=0)
    x, y = np.sort(np.argsort(-spread, kind="stable")[:2])
    alone = len(motions) == 1
    panel(ax, f"path along {'xyz'[x]}, {'xyz'[y]}{'' if alone else ', from the start'} [mm]")
    for i, name in enumerate(motions):
        origin = np.zeros(3) if alone else known[name][0]
        desired, actual = (1e3 * (log[f"{name}.{which}"] - origin)[:, [x, y]] for which in ("desired", "position"))
        start = _known(actual)[0]
        ax.plot(*desired.T, color=PALE, linewidth=7, solid_capstyle="round", label="" if i else "desired")
        ax.plot(*actual.T, color=COLOURS[i % JOINTS], linewidth=1.6, label="actual" if alone else name)
        ax.plot(*start, "o", color=INK, markersize=6)
        ax.update_datalim([start - 0.5, start + 0.5])  # a point keeps a frame around it
    ax.set_aspect("equal", adjustable="datalim")
    legend(ax, loc="lower right", bbox_to_anchor=(1.01, 0.99), ncols=5)


def _tracking(ax: Axes, log: Log, motions: list[str]) -> None:
    """Distance and angle to the reference, logarithmic: start and end may be decades apart."""
    soft = [name for name in motions if f"{name}.displacement" in log]
    panel(ax, f"tracking error{', way given' if soft else ''} [mm, mrad]", log)
    parts = (("position", "mm", slice(3, 6)), ("rotation", "mrad", slice(0, 3)))
    drawn = [(name, part) for name in motions for part in parts if name in _of(log, motions, part[2])]
    for i, (name, (what, unit, part)) in enumerate(drawn):
        error = 1e3 * np.linalg.norm(log[f"{name}.error"][:, part], axis=1)
        told = f"rms {_rms(error[after_settling(log, f'{name}.error')]):.2g} {unit}"
        text = f"{name} gives way: {told}" if name in soft else f"{name}.{what}: {told}"
        lines(ax, log, np.maximum(error, 1e-9)[:, None], [text], COLOURS[i % JOINTS])
    ax.set_yscale("log")
    ax.minorticks_off()
    ax.yaxis.set_major_formatter("{x:g}")
    low, high = ax.get_ylim()
    ax.set_ylim(max(low, 1e-6 * high), 10.0 ** (0.3 * len(drawn) + 0.3) * high)
    legend(ax, loc="upper right")


def _torques(ax: Axes, log: Log) -> None:
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


def _status(fig: Figure, place: SubplotSpec, log: Log) -> None:
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
    note = _more(ticks, LIMITS) if ticks else "no limit was active"
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


def _times(ax: Axes, log: Log) -> None:
    """How long a tick took, beside the control period."""
    panel(ax, "time of a tick [µs]").set_yticks([])
    if "step_us" not in log:
        return
    us, period = np.maximum(_known(log["step_us"]), 1e-3).ravel(), 1e6 * float(log.meta["dt"])
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


def _checks(ax: Axes, summary: dict[str, Any]) -> None:
    """Every bound: what was measured, what was asked. What failed stands first."""
    panel(ax, "checks [SI units]").axis("off")
    checks = sorted(summary.get("checks", ()), key=lambda check: bool(check["ok"]))
    last = max(8, len(checks[:CHECKS])) + 1
    ax.set(xlim=(0, 1), ylim=(last + 0.4, -0.3))
    _row(ax, 0, ("", "value", "bound", ""), MUTED)
    for y, check in enumerate(checks[:CHECKS], 1):
        cells = (
            short(check["name"], 30),
            "-" if check["value"] is None else f"{check['value']:.3g}",
            _bound(check["bound"]),
            "" if check["ok"] else "FAIL",
        )
        _row(ax, y, cells, INK if check["ok"] else BAD)
        if check["ok"]:
            _row(ax, y, ("", "", "", "ok"), GOOD)
    notes = filter(None, [_more(checks, CHECKS), *summary.get("notes", ())])
    ax.text(0, last, short("   ·   ".join(notes), 80), size=8, color=MUTED, **TEXT)


def _row(ax: Axes, y: int, cells: Sequence[str], colour: str) -> None:
    weight = "bold" if colour in (GOOD, BAD) else "normal"
    for x, side, text in zip((0.0, 0.64, 0.89, 1.0), ("left", "right", "right", "right"), cells, strict=True):
        ax.text(x, y, text, size=9.5, color=colour, weight=weight, ha=side, **TEXT)


# --- numbers and words ---


def _known(y: Array) -> Array:
    """The finite rows of y (N, m); one of zeros when there are none."""
    rows = y.reshape(y.shape[0], -1)
    known = rows[np.isfinite(rows).all(axis=1)]
    return known if known.size else np.zeros((1, rows.shape[1]))


def _rms(y: Array) -> float:
    known = y[np.isfinite(y)]
    return float(np.sqrt(np.mean(known**2))) if known.size else np.nan


def _share(x: Array, down: Array, up: Array) -> Array:
    """x (N, n) over the upper limit where it is positive, else over the lower one; NaN where there is no limit."""
    scale = np.where(x >= 0.0, up, down)
    known = np.isfinite(x) & np.isfinite(scale) & (scale > 0.0)
    return np.where(known, x, np.nan) / np.where(known, scale, 1.0)


def _more(names: Sized, most: int) -> str:
    return f"and {len(names) - most} more" if len(names) > most else ""


def _bound(bound: Any) -> str:
    ends = bound if isinstance(bound, dict) else {"max": bound}
    if len(ends) == 2:
        return f"{ends['min']:.3g} … {ends['max']:.3g}"
    return "".join(f"{'≤' if end == 'max' else '≥'} {value:.3g}" for end, value in ends.items())
