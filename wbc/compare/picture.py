"""The comparison as one picture: performance profile, accuracy against time, growth with size."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from matplotlib.axes import Axes

EXACT = 1e-15  # [N m] where an error of zero is drawn


def picture(result: Mapping[str, Any], path: Path) -> None:
    """Write what `compare` answered to a PNG of 1600 x 700."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    from ..chart import DPI, INK, MUTED

    fig = Figure(figsize=(16.0, 7.0), dpi=DPI, facecolor="white")
    fig.suptitle(
        f"{result['problems']} quadratic programs, {result['infeasible']} of them infeasible",
        x=0.045, ha="left", size=16, weight="bold", color=INK,
    )  # fmt: skip
    axes = fig.subplots(1, 3)
    fig.subplots_adjust(left=0.045, right=0.985, top=0.86, bottom=0.24, wspace=0.18)
    styles = _styles(list(result["solvers"]))
    _profiles(axes[0], result, styles)
    _accuracy(axes[1], result, styles)
    _growth(axes[2], result, styles)
    for ax in axes:
        ax.tick_params(labelsize=9, colors=MUTED)
    handles, labels = axes[0].get_legend_handles_labels()
    fig.legend(handles, labels, loc="lower center", ncols=7, fontsize=9, labelcolor=INK, edgecolor="none")
    FigureCanvasAgg(fig).print_figure(path, dpi=DPI, format="png")


def _styles(names: list[str]) -> dict[str, dict[str, Any]]:
    """One colour a solver; tuned full, as it comes dashed, plain dotted."""
    from ..chart import COLOURS

    solvers = list(dict.fromkeys(name.split(" (")[0] for name in names))
    return {
        name: {
            "color": COLOURS[solvers.index(name.split(" (")[0]) % len(COLOURS)],
            "linestyle": "--" if name.endswith("(default)") else ":" if name.endswith("(plain)") else "-",
        }
        for name in names
    }


def _profiles(ax: Axes, result: Mapping[str, Any], styles: Mapping[str, Any]) -> None:
    for name, row in result["solvers"].items():
        ax.step(result["ratios"], row["profile"], where="post", label=name, linewidth=1.8, **styles[name])
    ax.set(xscale="log", xlabel="time over that of the fastest solver", ylim=(-0.02, 1.02), xlim=(1, None))
    ax.set_title("share of the feasible programs solved within that", loc="left", size=10)
    ax.grid(alpha=0.3)


def _accuracy(ax: Axes, result: Mapping[str, Any], styles: Mapping[str, Any]) -> None:
    """Median time against the worst torque error: of the certified answers, and of all where that is more."""
    named = []
    for name, row in result["solvers"].items():
        colour, us, certified = styles[name]["color"], row["us"]["p50"], row["certified"]["tau_error"]
        full = "none" if styles[name]["linestyle"] != "-" else colour
        if certified is not None:
            ax.plot(us, max(certified, EXACT), "o", color=colour, markerfacecolor=full, markersize=8)
            named.append((us, max(certified, EXACT), name, colour))
        every = row["max_tau_error"]
        if every is not None and (certified is None or every > 1.5 * certified):
            ax.plot(us, every, "x", color=colour, markersize=8)
            ax.plot([us, us], [max(certified or every, EXACT), every], linewidth=0.8, color=colour, linestyle=":")
    ax.axhline(1e-6, color="#7b8794", linewidth=0.8)
    ax.set(xscale="log", yscale="log", xlabel="median time [us]")
    ax.set_title("worst torque error [N m]: certified (o), all that was answered (x)", loc="left", size=10)
    ax.grid(alpha=0.3)
    ax.margins(0.12)
    _name(ax, named)


def _name(ax: Axes, named: Sequence[tuple[float, float, str, str]]) -> None:
    """Names (x, y, name, colour) beside their points, none over another: from below, each as low as it can stand."""
    line, wide, gap = 11.0, 5.0, 6.0  # [points] of a line, a letter, and from the point
    ax.autoscale_view()
    low, high = ax.get_xlim()
    middle, scale = (low * high) ** 0.5, 72.0 / ax.figure.dpi
    taken: list[tuple[float, float, float]] = []
    for x, y, name, colour in sorted(named, key=lambda each: each[1]):
        left, (at, up) = x > middle, ax.transData.transform((x, y)) * scale
        begin = at - gap - wide * len(name) if left else at + gap
        end, above = begin + wide * len(name), up - 3.0
        while any(b < end and begin < e and abs(above - u) < line for b, e, u in taken):
            above += 1.0
        taken.append((begin, end, above))
        offset = (-gap if left else gap, above - up)
        ax.annotate(
            name, (x, y), offset, textcoords="offset points", size=8, color=colour, ha="right" if left else "left"
        )


def _growth(ax: Axes, result: Mapping[str, Any], styles: Mapping[str, Any]) -> None:
    for name, row in result["solvers"].items():
        ax.plot(list(map(int, row["growth"])), list(row["growth"].values()), marker=".", **styles[name])
    ax.set(xscale="log", yscale="log", xlabel="unknowns")
    ax.set_title("median time of feasible programs [us] by size", loc="left", size=10)
    ax.xaxis.set_major_formatter("{x:g}")
    ax.xaxis.set_minor_formatter("{x:g}")
    ax.grid(alpha=0.3)
