"""Table 1: amplitude, speed, duration, width of the waves.

The printed computed numbers fit 20 beads and the striker: 12 of 15 equal the exact ones, rounded (bold); with 21 beads
below the striker 6 do. F_m is printed to one digit: for amplitudes that round to it 13 and 8 do.

F_m: peak of a sensor's average above its static value, mean of both; each engine solves for the striker speed of it.
Experiment and paper's calculation as printed; E = 1.46 GPa, under gravity. Widths L/2R: twice the front half, from
0.2 % or 4 % of the peak. Deviation of codes: the largest, from the exact numbers of 20 beads.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from drivers.engines import REFERENCE, installed_codes
from postproc.draw.plot import PAGE_IN, Product, pyplot
from postproc.paper import quoted
from postproc.paper.strikes import COLUMNS, sensor_amplitude, settled, strike_for, striker_speed, table1_numbers
from postproc.read.motion import Simulation, run_codes

SPEED, WIDTH = "$V_s$\n(m/s)", "$L/2R$"
COMPUTED = (SPEED, f"{WIDTH}\n(0.2 %)", f"{WIDTH}\n(4 %)")
DIGITS = (0, 1, 1)  # decimals of the paper's computed numbers
MEASURED = ("duration_us", "speed_m_s", "width_diameters")
LONGER = 21  # beads below the striker in the other reading of the paper's chain
EXACT_LONGER = f"exact_{LONGER}"
SPREAD = "codes_largest_deviation_share"
# heading, first and last column
GROUPS = (("experiment", 1, 3), ("paper, computed", 4, 6), ("exact, 20 beads", 7, 9), ("exact, 21 beads", 10, 12))
ROW_IN, HEAD = 0.19, 3.2  # height of a row in inches, height of the headings in rows


def make(runs: Path) -> Product:
    """Solves for the striker speeds by the reference and by each code, with 21 beads by the reference alone.

    The table has a row per amplitude: the paper's columns, striker speed and three numbers by each engine, and the
    largest relative deviation of any code from the three numbers of the reference, NaN without a code.
    """
    table, forces = pd.DataFrame(quoted().table1), quoted().table1["force_N"]
    exact = [strike_for(force, sensor_amplitude) for force in forces]

    def solve(code: str) -> Sequence[Simulation]:
        return settled(lambda cases: run_codes({code: cases}, runs)[code], [motion.case for motion in exact], forces)

    for engine, motions in [(REFERENCE, exact), *((code, solve(code)) for code in installed_codes())]:
        table[f"{engine}_striker_m_s"] = [*map(striker_speed, motions)]
        table[_names(engine)] = [*map(table1_numbers, motions)]
    off = [table[_names(code)].to_numpy() / table[_names(REFERENCE)].to_numpy() - 1 for code in installed_codes()]
    table[SPREAD] = np.abs(off).max(axis=(0, 2)) if off else np.nan
    longer = [strike_for(force, sensor_amplitude, f"chain.count={LONGER}") for force in forces]
    table[_names(EXACT_LONGER)] = [*map(table1_numbers, longer)]
    return Product(_draw(table), table)


def _names(engine: str) -> list[str]:
    return [f"{engine}_{name}" for name in COLUMNS]


def _draw(table: pd.DataFrame) -> Any:
    """Draws a row per amplitude, with rules above, below and under the headings."""
    headings = ("$F_m$\n(N)", "duration\n(µs)", SPEED, WIDTH, *COMPUTED * 3, "deviation\nof codes")
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
        for place, (cell, bold) in enumerate(printed(row)):
            axis.text(place, line, cell, ha="center", va="center", weight="bold" if bold else "normal")
    return figure


def printed(row: dict[Any, Any]) -> list[tuple[str, bool]]:
    """Texts of a row: the paper's numbers with its digits, the exact numbers with one digit more.

    Each with True for an exact number that equals the paper's when rounded to its digits.

    Raises:
        KeyError: The table lacks a number.
    """
    measured = [f"{row[f'measured_{name}']:g}" for name in MEASURED]
    off = f"{row[SPREAD]:.0e}".replace("e-0", "e-") if row[SPREAD] >= 0 else "–"
    exact = [
        pair
        for of in (REFERENCE, EXACT_LONGER)
        for pair in zip(_texts(row, of, more=1), equals_printed(row, of), strict=True)
    ]
    plain = [(cell, False) for cell in (f"{row['force_N']:g}", *measured, *_texts(row, "computed"))]
    return [*plain, *exact, (off, False)]


def _texts(row: dict[Any, Any], prefix: str, more: int = 0) -> list[str]:
    """Numbers of the paper (``computed``) or of a calculation with the paper's digits, or with more."""
    return [f"{row[f'{prefix}_{name}']:.{digits + more}f}" for name, digits in zip(COLUMNS, DIGITS, strict=True)]


def equals_printed(row: dict[Any, Any], prefix: str) -> list[bool]:
    """For each exact number of a row, True if it equals the paper's when rounded to its digits."""
    return [exact == paper for exact, paper in zip(_texts(row, prefix), _texts(row, "computed"), strict=True)]
