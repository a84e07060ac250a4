"""The page's section on the paper's figures and Table 1."""

import re
from collections.abc import Collection
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from markupsafe import Markup, escape

from postproc.draw.product import SPACETIME
from postproc.figures import captions
from postproc.figures.table1 import GROUPS, printed
from validation.checks import REPRODUCED
from validation.report.parts import Shown, read_part

TABLE, SCORED = "table1", "fig3"
LARGE_N = 2.0  # smallest force counted among the large amplitudes of the scores
SUBSCRIPT = re.compile(r"\b([^\W_])_(\w)\b")  # symbols in captions, such as F_m
COMPUTED = ("V_s, m/s", "L/2R, 0.2 %", "L/2R, 4 %")
TABLE_HEADINGS = ("F_m, N", "duration, µs", "V_s, m/s", "L/2R", *COMPUTED * 3, "deviation of codes")


def shown_of(name: str, table: pd.DataFrame) -> list[Shown]:
    """Tables of the page for a figure: Table 1 itself, and the scores of the moduli of the figure of speeds."""
    if name == TABLE:
        return [Shown("", "", _table_1(table))]
    return [Shown("Deviation of measured from computed speeds", "", _scores(table))] if name == SCORED else []


def _table_1(table: pd.DataFrame) -> pd.DataFrame:
    """Texts of Table 1 under two levels of headings; numbers that equal the paper's are marked."""
    groups = [""] * len(TABLE_HEADINGS)
    for words, first, last in GROUPS:
        groups[first : last + 1] = [words] * (last + 1 - first)
    rows = [
        [f"{REPRODUCED} {text}" if equal else text for text, equal in printed(row)] for row in table.to_dict("records")
    ]
    return pd.DataFrame(rows, columns=pd.MultiIndex.from_arrays([groups, TABLE_HEADINGS]))


def _scores(table: pd.DataFrame) -> pd.DataFrame:
    """Deviation of measured from computed speeds: a row for each modulus.

    Deviations are in per cent of the computed speed by amplitude, root mean squares in standard errors.
    """
    table, rows = table[table["source"] == "score"], []
    for modulus, points in table.groupby("modulus_MPa"):
        large = points["force_N"] >= LARGE_N
        rms = [np.sqrt((points["deviation_standard_errors"][which] ** 2).mean()) for which in (large, ~large)]
        deviations = [f"{value:+.1f}" for value in points["deviation_pct"]]
        rows.append([f"{modulus:g}", *deviations, *(f"{value:.1f}" for value in rms)])
    at = [f"{force:g} N" for force in table["force_N"].unique()]
    columns = [("", "E, MPa")]
    columns += [("measured minus computed speed, %, at", words) for words in at]
    columns += [("rms, standard errors", words) for words in (f"from {LARGE_N:g} N", "below")]
    return pd.DataFrame(rows, columns=pd.MultiIndex.from_tuples(columns))


def read_figures(results: Path, to_come: Collection[str] = ()) -> dict[str, Any]:
    """The paper's figures and its table in the order of the paper, without those to come.

    Returns:
        made: caption, image if it is no table, space-time picture and stored part of each.
        missing: names of the others.

    Raises:
        InputError: a stored figure is damaged.
    """
    stored = {name: read_part(name, results) for name in captions() if name not in to_come}
    made = [
        {
            "caption": captions()[name],
            "image": part.figures.get(name) if name != TABLE else None,
            "spacetime": part.figures.get(f"{name}-{SPACETIME}"),
            "part": part,
        }
        for name, part in stored.items()
        if part
    ]
    return {"made": made, "missing": [name for name in captions() if not stored.get(name)]}


def set_symbols(text: str) -> Markup:
    """Text with subscripts in its symbols."""
    return Markup(SUBSCRIPT.sub(r"\1<sub>\2</sub>", str(escape(text))))
