"""Table 1: speed and width of solitary waves of five amplitudes, measured, as printed, and computed here.

The amplitude is that of the sensors' averages above their static value, of a chain without lighter sensor beads,
E = 1.46 GPa, gravity on, the striker counted among the 21 beads: the reading that reproduces the printed numbers.
"""

from pathlib import Path
from typing import Any

import pandas as pd

from postproc.product import Product
from postproc.quoted import quoted
from postproc.style import pyplot

COLUMNS = ("speed_m_s", "width_0.2pct_diameters", "width_4pct_diameters")
HEADINGS = (r"$V_s$ (m/s)", r"$L/2R$, 0.2 %", r"$L/2R$, 4 %")


def make(runs: Path) -> Product:
    """Solves for the striker speeds by the reference and by each code."""
    return Product(*_drawn(table(runs)))


def table(runs: Path) -> pd.DataFrame:
    """A row per amplitude: the paper's columns, then the striker speed and the three numbers by each engine."""
    from validation.simulate import REFERENCE
    from validation.strikes import sensor_amplitude, speed_between_sensors, strike_for, strikes_by_codes

    paper = quoted().table1.frame
    forces = paper["force_N"].astype(float).tolist()
    exact_ones = [strike_for(force, sensor_amplitude) for force in forces]
    solved = {REFERENCE: exact_ones} | strikes_by_codes(exact_ones, forces, sensor_amplitude, runs)
    for engine, simulations in solved.items():
        lower = f"bead_{simulations[0].case.layout.sensors[-1].from_wall}"
        strikers = [simulation.case.scene.striker for simulation in simulations]
        paper[f"{engine}_striker_m_s"] = [striker.speed for striker in strikers if striker]
        paper[f"{engine}_speed_m_s"] = [speed_between_sensors(simulation) for simulation in simulations]
        for name in COLUMNS[1:]:
            paper[f"{engine}_{name}"] = [simulation.values[f"{lower}_{name}"] for simulation in simulations]
    return paper


def engines_of(values: pd.DataFrame) -> list[str]:
    """The engines whose columns a table has."""
    ending = "_striker_m_s"
    return [str(name).removesuffix(ending) for name in values.columns if str(name).endswith(ending)]


def _drawn(values: pd.DataFrame) -> tuple[Any, pd.DataFrame]:
    """The table as a figure: measured, then printed, reference and codes for each of the three numbers."""
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
