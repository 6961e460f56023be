"""The picture of frequency responses: admittance and impedance of tasks over the theory."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from .chart import COLOURS, DPI, INK, JOINTS, legend, panel, short


def bode_plot(responses: Mapping[str, Any], title: str, path: Path) -> None:
    """Write the admittances Y(jw) = X/F of tasks, and their impedances Z = 1/Y, over the theory, to a PNG."""
    fig = Figure(figsize=(12.0, 8.0), dpi=DPI, facecolor="white")
    fig.suptitle(short(title, 98), x=0.07, ha="left", size=16, weight="bold", color=INK, parse_math=False)
    axes = fig.subplots(2, 2, sharex=True)
    fig.subplots_adjust(left=0.07, right=0.98, top=0.89, bottom=0.08, wspace=0.16, hspace=0.16)
    for column, (name, sign, unit) in enumerate((("Y = X/F", 1, "m/N"), ("Z = F/X", -1, "N/m"))):
        size, angle = axes[0, column], axes[1, column]
        panel(size, f"|{name}| [dB of {unit}]")
        panel(angle, f"phase of {name} [deg]")
        for i, (task, found) in enumerate(responses.items()):
            f, colour = found.w / (2 * np.pi), COLOURS[i % JOINTS]
            for Y, style in ((found.theory, {"linestyle": "-"}), (found.Y, {"linestyle": "", "marker": "o"})):
                label = task if "marker" in style else f"{task}, theory with its delay"
                size.plot(f, sign * 20 * np.log10(np.abs(Y)), color=colour, label=label, **style)
                angle.plot(f, sign * np.degrees(np.unwrap(np.angle(Y))), color=colour, **style)
        legend(size, loc="lower left" if sign > 0 else "upper left")
        angle.set_xscale("log")
        angle.set_xlabel("frequency [Hz]", size=9, color=INK)
        angle.xaxis.set_major_formatter("{x:g}")
        angle.xaxis.set_minor_formatter("{x:g}")
    FigureCanvasAgg(fig).print_figure(path, dpi=DPI, format="png")
