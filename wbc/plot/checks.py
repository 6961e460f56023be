"""The panel of every bound."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from matplotlib.axes import Axes

from ..chart import BAD, GOOD, INK, MUTED, TEXT, and_more, panel, short

CHECKS = 12  # the most that one picture shows


def checks(ax: Axes, summary: dict[str, Any]) -> None:
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
    notes = filter(None, [and_more(checks, CHECKS), *summary.get("notes", ())])
    ax.text(0, last, short("   ·   ".join(notes), 80), size=8, color=MUTED, **TEXT)


def _row(ax: Axes, y: int, cells: Sequence[str], colour: str) -> None:
    weight = "bold" if colour in (GOOD, BAD) else "normal"
    for x, side, text in zip((0.0, 0.64, 0.89, 1.0), ("left", "right", "right", "right"), cells, strict=True):
        ax.text(x, y, text, size=9.5, color=colour, weight=weight, ha=side, **TEXT)


def _bound(bound: Any) -> str:
    ends = bound if isinstance(bound, dict) else {"max": bound}
    if len(ends) == 2:
        return f"{ends['min']:.3g} … {ends['max']:.3g}"
    return "".join(f"{'≤' if end == 'max' else '≥'} {value:.3g}" for end, value in ends.items())
