"""The page's section on the paper's figures and Table 1."""

from collections.abc import Collection
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from postproc.draw.product import SPACETIME
from postproc.figures import captions
from postproc.figures.table1 import GROUPS, printed
from validation.checks import REPRODUCED
from validation.report.parts import Shown, read_part

TABLE, SCORED = "table1", "fig3"
LARGE_N = 2.0  # smallest force counted among the large amplitudes of the scores
COMPUTED = ("V_s, m/s", "L/2R, 0.2 %", "L/2R, 4 %")


def shown_of(name: str, table: pd.DataFrame) -> list[Shown]:
    """Tables of the page for a figure: Table 1 itself, and the scores of the moduli of the figure of speeds."""
    if name == TABLE:
        return [Shown("", "", _table_1(table))]
    return [Shown("Deviation of measured from computed speeds", "", _scores(table))] if name == SCORED else []


def _table_1(table: pd.DataFrame) -> pd.DataFrame:
    """Texts of Table 1, a column for each amplitude; numbers that equal the paper's are marked."""
    (measured, _, _), *computed = GROUPS
    labels = [f"{measured}: {words}" for words in ("duration, µs", "V_s, m/s", "L/2R")]
    labels += [f"{group}: {words}" for group, _, _ in computed for words in COMPUTED]
    texts: dict[str, list[str]] = {"F_m": [*labels, "deviation of codes"]}
    for row in table.to_dict("records"):
        (force, _), *cells = printed(row)
        texts[f"{force} N"] = [f"{REPRODUCED} {text}" if equal else text for text, equal in cells]
    return pd.DataFrame(texts)


def _scores(table: pd.DataFrame) -> pd.DataFrame:
    """Deviation of measured from computed speeds: a column for each modulus.

    Deviations are in per cent of the computed speed by amplitude, root mean squares in standard errors.
    """
    table = table[table["source"] == "score"]
    at = [f"measured minus computed speed at {force:g} N, %" for force in table["force_N"].unique()]
    texts = {"E": [*at, f"rms from {LARGE_N:g} N, standard errors", "rms below, standard errors"]}
    for modulus, points in table.groupby("modulus_MPa"):
        large = points["force_N"] >= LARGE_N
        rms = [np.sqrt((points["deviation_standard_errors"][which] ** 2).mean()) for which in (large, ~large)]
        deviations = [f"{value:+.1f}" for value in points["deviation_pct"]]
        texts[f"{modulus:g} MPa"] = [*deviations, *(f"{value:.1f}" for value in rms)]
    return pd.DataFrame(texts)


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
