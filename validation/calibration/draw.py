"""Figures of fits: parameters with intervals."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from postproc.draw.style import COLUMN_IN, pyplot
from validation.calibration.rows import Parameter

COLOURS = ("#0072b2", "#d55e00", "#555555", "#cc79a7", "#999933", "#56b4e9")
MARKERS = ("o", "s", "v", "D", "P", "^")
ROW_IN, HEAD_IN = 0.55, 0.5


def look_of(laws: Sequence[str]) -> dict[str, dict[str, Any]]:
    """Colour and marker by law."""
    return {law: {"color": COLOURS[i % 6], "marker": MARKERS[i % 6]} for i, law in enumerate(dict.fromkeys(laws))}


def draw_parameters(rows: Sequence[Parameter]) -> Any:
    """A panel for each parameter: value, 68 % (thick) and 95 % interval (thin) of each law."""
    shown = [row for row in rows if np.isfinite(row.error)]
    names, look = list(dict.fromkeys(row.parameter for row in shown)) or ["none determined"], look_of([r.law for r in rows])
    height = HEAD_IN + len(names) * (ROW_IN + 0.12 * len(look))
    figure, axes = pyplot().subplots(len(names), 1, figsize=(COLUMN_IN, height), squeeze=False, layout="constrained")
    for axis, name in zip(axes[:, 0], names, strict=True):
        own = [row for row in shown if row.parameter == name]
        for place, row in enumerate(own):
            colour = look[row.law]["color"]
            for low, high, width in ((row.low_95pct, row.high_95pct, 0.9), (row.low_68pct, row.high_68pct, 2.6)):
                ends = max(low, row.least), min(high, row.most)  # an open interval ends with the range
                axis.plot(ends, [place, place], color=colour, lw=width, solid_capstyle="butt")
            axis.plot(row.value, place, ls="none", ms=5, **look[row.law], label=row.law or None)
        unit = f" ({own[0].unit})" if own and own[0].unit else ""
        axis.set_title(f"{name.removeprefix('materials.')}{unit}", loc="left", fontsize=8)
        axis.set(yticks=[], ylim=(len(own) - 0.4, -0.6))
        axis.ticklabel_format(axis="x", useOffset=False)
    handles, labels = axes[0, 0].get_legend_handles_labels()
    if len(labels) > 1:
        figure.legend(handles, labels, loc="outside upper left", ncols=len(labels), fontsize=7)
    figure.supxlabel("value, 68 % (thick) and 95 % interval", fontsize=8)
    return figure
