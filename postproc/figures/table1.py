"""Table 1: speed and width of solitary waves of five amplitudes, measured, as printed, and computed here."""

from pathlib import Path
from typing import Any

import pandas as pd

from postproc.draw.product import Product
from postproc.draw.spacetime import SPACETIME, Panel, spacetime_product
from postproc.draw.style import COLUMN_IN, pyplot
from postproc.paper.quoted import quoted

HEADINGS = (r"$V_s$ (m/s)", r"$L/2R$, 0.2 %", r"$L/2R$, 4 %")


def make(runs: Path) -> Product:
    """Solves for the striker speeds by the reference and by each code."""
    from postproc.paper.solved_table1 import solve_table1

    return Product(*_drawn(solve_table1(runs)), {SPACETIME: _chains()})


def _chains() -> Product:
    """The chain at every amplitude of the table, by the reference."""
    from postproc.paper.simulate import REFERENCE
    from postproc.paper.strikes import sensor_amplitude, strike_for

    panels = [
        Panel(f"{force:g} N ({REFERENCE})", strike_for(force, sensor_amplitude).trace)
        for force in quoted().table1.force_N
    ]
    return spacetime_product(panels, COLUMN_IN)


def _drawn(values: pd.DataFrame) -> tuple[Any, pd.DataFrame]:
    """The table as a figure: measured, then printed, reference and codes for each of the three numbers."""
    from postproc.paper.solved_table1 import COLUMNS, engines_of

    engines = engines_of(values)
    rows, colours = [], []
    for _, row in values.iterrows():
        measured = [f"{row[f'measured_{name}']:g}" for name in ("duration_us", "speed_m_s", "width_diameters")]
        for source in ("computed", *engines):
            digits = ("{:g}", "{:.1f}", "{:.1f}") if source == "computed" else ("{:.2f}", "{:.3f}", "{:.3f}")
            numbers = [d.format(row[f"{source}_{name}"]) for d, name in zip(digits, COLUMNS, strict=True)]
            first = source == "computed"
            head = [f"{row['force_N']:g}", *measured] if first else [""] * 4
            rows.append([*head, "paper" if first else source, *numbers])
            colours.append(["#eeeeee" if first else "white"] * 8)
    headings = [r"$F_m$ (N)", "duration (µs)", *HEADINGS[:1], r"$L/2R$", "computed by", *HEADINGS]
    figure, axis = pyplot().subplots(figsize=(6.4, 0.19 * (len(rows) + 1)))
    axis.axis("off")
    drawn = axis.table(rows, colLabels=headings, cellColours=colours, cellLoc="center", bbox=[0, 0, 1, 1],
                       colWidths=[0.09, 0.15, 0.11, 0.08, 0.14, 0.12, 0.14, 0.13])  # fmt: skip
    drawn.auto_set_font_size(False)
    drawn.set_fontsize(8)
    for cell in drawn.get_celld().values():
        cell.set_linewidth(0.3)
    axis.set_title("Table 1. Columns 2 to 4: measured in the paper; the others computed", loc="left")
    return figure, values
