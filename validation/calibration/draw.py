"""Figures of fits: parameters with intervals, measured against fitted numbers."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from postproc.draw.style import COLUMN_IN, GREY, pyplot
from validation.calibration.outcome import DatumRow, Parameter, suited

COLOURS = ("#0072b2", "#d55e00", "#555555", "#cc79a7", "#999933", "#56b4e9")
MARKERS = ("o", "s", "v", "D", "P", "^")
ROW_IN, HEAD_IN = 0.55, 0.5
KINDS = (("amplitude", "force (N)", 1.0), ("contact_force", "force (N)", 1.0), ("speed", "speed (m/s)", 1.0),
         ("full_width", "full width (µs)", 1e6), ("decay", "decay at the wall (1/µs)", -1e-6))  # fmt: skip
SHIFT = 0.24  # between laws in a row


def look_of(laws: Sequence[str]) -> dict[str, dict[str, Any]]:
    """Colour and marker by law."""
    return {law: {"color": COLOURS[i % 6], "marker": MARKERS[i % 6]} for i, law in enumerate(dict.fromkeys(laws))}


def draw_parameters(rows: Sequence[Parameter]) -> Any:
    """A panel for each parameter: value, 68 % (thick) and 95 % interval (thin) of each law."""
    shown = [row for row in rows if np.isfinite(row.error)]
    names, look = list(dict.fromkeys(row.parameter for row in shown)) or [""], look_of([row.law for row in rows])
    height = HEAD_IN + len(names) * (ROW_IN + 0.12 * len(look))
    figure, axes = pyplot().subplots(len(names), 1, figsize=(COLUMN_IN, height), squeeze=False, layout="constrained")
    for axis, name in zip(axes[:, 0], names, strict=True):
        own = [row for row in shown if row.parameter == name]
        scale, unit = suited(own[0].value, own[0].unit) if own else (1.0, "")
        for place, row in enumerate(own):
            colour = look[row.law]["color"]
            for low, high, width in ((row.low_95pct, row.high_95pct, 0.9), (row.low_68pct, row.high_68pct, 2.6)):
                ends = max(low, row.least) * scale, min(high, row.most) * scale  # an open interval ends with the range
                axis.plot(ends, [place, place], color=colour, lw=width, solid_capstyle="butt")
            axis.plot(row.value * scale, place, ls="none", ms=5, **look[row.law], label=row.law or None)
        axis.set_title(
            f"{name.removeprefix('materials.') or 'no parameter is determined'}{f' ({unit})' * bool(unit)}",
            loc="left",
            fontsize=8,
        )
        axis.set(yticks=[], ylim=(len(own) - 0.4, -0.6))
        axis.locator_params(axis="x", nbins=5)
        axis.ticklabel_format(axis="x", useOffset=False)
    handles, labels = axes[0, 0].get_legend_handles_labels()
    if len(labels) > 1:
        figure.legend(handles, labels, loc="outside upper left", ncols=len(labels), fontsize=7)
    figure.supxlabel("value, 68 % (thick) and 95 % interval", fontsize=8)
    return figure


def name_of(data_set: str, datum: str) -> str:
    """Name of a datum: kind and, of a row, its force."""
    kind = next((words.partition(" (")[0] for kind, words, _ in KINDS if kind in datum), datum)
    words = {"table1": "Table 1,", "fig4": "Fig. 4", "fig5": "Fig. 5"}
    named = " ".join(words.get(part, part) for part in data_set.removesuffix(" width").split(" "))
    return f"{named}: {kind}"


def draw_data(rows: Sequence[DatumRow]) -> Any:
    """A panel for each kind of number: measured with errors, and fitted by each law with errors; default reading."""
    shown = [row for row in rows if row.data == rows[0].data and np.isfinite(row.measured)]
    look = look_of([row.law for row in shown])
    kinds = [(kind, words, scale) for kind, words, scale in KINDS if any(kind in row.datum for row in shown)]
    counts = [len({row.data_set for row in shown if kind in row.datum}) for kind, _, _ in kinds]
    figure, axes = pyplot().subplots(
        len(kinds), 1, figsize=(6.8, 1.2 + 0.42 * sum(counts) + 0.45 * len(kinds)), layout="constrained",
        height_ratios=[count + 0.6 for count in counts], squeeze=False,
    )  # fmt: skip
    for axis, (kind, words, scale) in zip(axes[:, 0], kinds, strict=True):
        own = [row for row in shown if kind in row.datum]
        sets = list(dict.fromkeys(row.data_set for row in own))
        for row in own:
            place = sets.index(row.data_set)
            if row.law == own[0].law:
                axis.errorbar(
                    row.measured * scale, place, xerr=abs(row.error * scale), fmt="ks", ms=4, lw=1.1, capsize=2
                )
            offset = SHIFT * (1 + [*look].index(row.law))
            style = {"ls": "none", "ms": 3.5, "elinewidth": 0.8} | look[row.law]
            error = row.fitted_error * abs(scale) if np.isfinite(row.fitted_error) else 0.0
            label = row.law if place == 0 else None
            axis.errorbar(row.fitted * scale, place + offset, xerr=error, label=label, **style)
        names = [name_of(name, kind).partition(":")[0] for name in sets]
        axis.set(yticks=range(len(sets)), yticklabels=names, ylim=(len(sets) - 0.15, -0.4), xlabel=words)
        axis.set_xscale("log" if kind in ("amplitude", "contact_force") else "linear")
        axis.grid(axis="x", color=GREY, lw=0.3)
    handles, labels = axes[0, 0].get_legend_handles_labels()
    (measured,) = axes[0, 0].plot([], [], "ks", ms=4)
    figure.legend(
        [measured, *handles], ["measured", *labels], loc="outside upper center", ncols=len(labels) + 1, fontsize=7
    )
    return figure
