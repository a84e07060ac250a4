"""Table 1: amplitude, speed, duration, width of the waves.

Experiment and paper: printed values; those of the paper are computed with E = 1.46 GPa. Exact: computed by the
reference for the chain with E = 1.46 GPa under gravity. F_m is the peak of the sensor averages above their static
value; each engine solves for the striker speed that gives this amplitude. Widths L/2R are read at 0.2 % and 4 % of the
peak. Codes: largest relative deviation of any code from the three exact numbers. The chain is 20 beads and the
striker, the reading closest to the printed numbers; the paper's statements are judged with 21 beads below the striker.
"""

from pathlib import Path
from typing import Any

import pandas as pd

from drivers.engines import REFERENCE
from postproc.draw.product import Product
from postproc.draw.style import PAGE_IN, pyplot
from postproc.paper.quoted import quoted
from postproc.paper.strikes import COLUMNS, MEASURED, SPREAD, sensor_amplitude, solve_table1, strike_for

SPEED, WIDTH = "$V_s$\n(m/s)", "$L/2R$"
COMPUTED = (SPEED, f"{WIDTH}\n(0.2 %)", f"{WIDTH}\n(4 %)")
GROUPS = (("experiment", 1, 3), ("paper", 4, 6), ("exact", 7, 9))  # heading, first and last column
ROW_IN, HEAD = 0.19, 3.2  # height of a row in inches, height of the headings in rows


def make(runs: Path) -> Product:
    """Solves for the striker speeds by the reference and by each code; spacetime diagrams at every amplitude."""
    table = solve_table1(runs)
    forces = quoted().table1.force_N
    chains = {f"{force:g} N ({REFERENCE})": strike_for(force, sensor_amplitude).trace for force in forces}
    return Product(_draw(table), table, chains)


def _draw(table: pd.DataFrame) -> Any:
    """Draws a row per amplitude, with rules above, below and under the headings."""
    headings = ("$F_m$\n(N)", "duration\n(µs)", SPEED, WIDTH, *COMPUTED, *COMPUTED, "deviation\nof codes")
    figure, axis = pyplot().subplots(figsize=(PAGE_IN, ROW_IN * (HEAD + len(table))), layout="constrained")
    axis.set(xlim=(-0.5, len(headings) - 0.5), ylim=(len(table) - 0.4, -HEAD))
    axis.axis("off")
    for place, heading in enumerate(headings):
        axis.text(place, -0.6, heading, ha="center", va="bottom")
    for words, first, last in GROUPS:
        axis.text((first + last) / 2, -2.45, words, ha="center", va="bottom")
        axis.plot([first - 0.4, last + 0.4], [-2.35, -2.35], color="black", lw=0.5)
    for height, width in ((-HEAD, 1.0), (-0.5, 0.6), (len(table) - 0.4, 1.0)):
        axis.axhline(height, color="black", lw=width, clip_on=False)
    for line, row in enumerate(table.to_dict("records")):
        for place, cell in enumerate(printed(row)):
            axis.text(place, line, cell, ha="center", va="center")
    return figure


def printed(row: dict[Any, Any]) -> list[str]:
    """Texts of a row: the paper's numbers with its digits, the exact numbers with one digit more.

    Raises:
        KeyError: The table lacks a number.
    """
    measured = [f"{row[f'measured_{name}']:g}" for name in MEASURED]
    paper = [f"{row[f'computed_{name}']:{how}}" for name, how in zip(COLUMNS, ("g", ".1f", ".1f"), strict=True)]
    exact = [f"{row[f'{REFERENCE}_{name}']:.{digits}f}" for name, digits in zip(COLUMNS, (1, 2, 2), strict=True)]
    off = f"{row[SPREAD]:.0e}".replace("e-0", "e-") if row[SPREAD] >= 0 else "–"
    return [f"{row['force_N']:g}", *measured, *paper, *exact, off]
