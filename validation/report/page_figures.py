"""The paper's figures and Table 1 as the page shows them, from what ``make figures`` left in the results folder."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pandas as pd

from drivers.base import paths
from drivers.base.errors import InputError
from postproc.draw.spacetime import SPACETIME
from postproc.paper.solved_table1 import COLUMNS, engines_of
from validation.report.inline_figures import read_svg

TABLE = "table1.csv"
WORDS = {
    "fig1": "the set-up to scale",
    "fig2": "a sensor bead: free body, forces, the coefficient β",
    "fig3": "speed against amplitude, with scores of the moduli",
    "fig4": "one solitary wave and its reflection",
    "fig5": "a heavy striker's train, its envelope and the incident pulse",
    "fig6": "small beads under a steel and a PTFE ball",
}
MEASURED = ("duration_us", "speed_m_s", "width_diameters")
HEADINGS = {"speed_m_s": "speed, m/s", "width_0.2pct_diameters": "L/2R at 0.2 %", "width_4pct_diameters": "L/2R at 4 %"}


@dataclass(frozen=True)
class Figure:
    """A figure that was made.

    Attributes:
        label: for those who do not see it.
        beside: the same chains in space and time; empty where that was not made.
    """

    name: str
    title: str
    label: str
    svg: str
    beside: str


def read_figures(results: Path) -> tuple[list[Figure], list[str]]:
    """The figures that were made, and the names of those that were not.

    Raises:
        InputError: one is damaged.
    """
    made, missing = [], []
    for name, words in WORDS.items():
        svg = read_svg(results / f"{name}.svg", name)
        if not svg:
            missing.append(name)
            continue
        title = f"Fig. {name.removeprefix('fig')}: {words}"
        made.append(Figure(name, title, f"{title}, drawn from the runs", svg, read_beside(results, name)))
    return made, missing


def read_beside(results: Path, name: str) -> str:
    """The chains of a figure in space and time; empty where that was not made."""
    return read_svg(results / f"{name}-{SPACETIME}.svg", f"{name}-{SPACETIME}")


def read_table1(results: Path) -> dict[str, Any]:
    """Rows by amplitude: measured, printed, and by each engine; empty without the table.

    Raises:
        InputError: it is damaged.
    """
    path = results / TABLE
    if not path.exists():
        return {}
    try:
        table = pd.read_csv(path)
        engines = engines_of(table)
        rows = [
            {
                "force": f"{row['force_N']:g}",
                "measured": [f"{row[f'measured_{name}']:g}" for name in MEASURED],
                "computed": [
                    ("the paper", [f"{row[f'computed_{name}']:g}" for name in COLUMNS]),
                    *((e, [_digits(row[f"{e}_{name}"], name) for name in COLUMNS]) for e in engines),
                ],
            }
            for row in table.to_dict("records")
        ]
    except (ValueError, KeyError, TypeError) as error:  # pandas' own errors are ValueErrors
        raise InputError(paths.shown(path), "", "a damaged table", "what make table1 writes") from error
    return {"rows": rows, "headings": list(HEADINGS.values()), "beside": read_beside(results, "table1")}


def _digits(value: float, name: str) -> str:
    return f"{value:.2f}" if name == "speed_m_s" else f"{value:.3f}"
