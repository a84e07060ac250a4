"""Table 1: speeds and widths, solved for by every engine.

Solitary waves of five amplitudes: measured, as printed, and computed here.
"""

from pathlib import Path

from drivers.engines import REFERENCE
from postproc.draw.product import Product
from postproc.draw.style import draw_table, pyplot
from postproc.paper.quoted import quoted
from postproc.paper.strikes import COLUMNS, engines_of, sensor_amplitude, solve_table1, strike_for

HEADINGS = (r"$V_s$ (m/s)", r"$L/2R$, 0.2 %", r"$L/2R$, 4 %")
WIDTHS = [0.09, 0.15, 0.11, 0.08, 0.14, 0.12, 0.14, 0.13]  # of the columns


def make(runs: Path) -> Product:
    """Solves for the striker speeds by the reference and by each code; beside it the chain at every amplitude.

    The table is drawn measured, then printed, reference and codes for each of the three numbers.
    """
    table = solve_table1(runs)
    forces = quoted().table1.force_N
    chains = {f"{force:g} N ({REFERENCE})": strike_for(force, sensor_amplitude).trace for force in forces}
    rows, colours = [], []
    for _, row in table.iterrows():
        measured = [f"{row[f'measured_{name}']:g}" for name in ("duration_us", "speed_m_s", "width_diameters")]
        printed = [f"{row[f'computed_{name}']:{how}}" for name, how in zip(COLUMNS, ("g", ".1f", ".1f"), strict=True)]
        rows.append([f"{row['force_N']:g}", *measured, "paper", *printed])
        colours.append(["#eeeeee"] * len(WIDTHS))
        for engine in engines_of(table):
            numbers = [f"{row[f'{engine}_{name}']:.{d}f}" for name, d in zip(COLUMNS, (2, 3, 3), strict=True)]
            rows.append([""] * 4 + [engine, *numbers])
            colours.append(["white"] * len(WIDTHS))
    headings = [r"$F_m$ (N)", "duration (µs)", HEADINGS[0], r"$L/2R$", "computed by", *HEADINGS]
    figure, axis = pyplot().subplots(figsize=(6.4, 0.19 * (len(rows) + 1)))
    draw_table(axis, rows, headings, 8, cellColours=colours, bbox=[0, 0, 1, 1], colWidths=WIDTHS)
    axis.set_title("Table 1. Columns 2 to 4: measured in the paper; the others computed", loc="left")
    return Product(figure, table, chains)
