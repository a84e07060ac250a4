"""Claims on the numerical half of Table 1: a row of the solved table, each number by every engine."""

import pandas as pd

from postproc.paper.solved_table1 import engines_of


def speed(table: pd.DataFrame, force_N: float) -> dict[str, float]:
    """Speed from bead 9 to bead 5 of the strike that gives this amplitude, m/s."""
    return _by_engine(table, force_N, "speed_m_s")


def width_at_0_2_per_cent(table: pd.DataFrame, force_N: float) -> dict[str, float]:
    """Width at bead 5 at 0.2 % of the peak of the strike that gives this amplitude, in diameters."""
    return _by_engine(table, force_N, "width_0.2pct_diameters")


def width_at_4_per_cent(table: pd.DataFrame, force_N: float) -> dict[str, float]:
    """Width at bead 5 at 4 % of the peak of the strike that gives this amplitude, in diameters."""
    return _by_engine(table, force_N, "width_4pct_diameters")


def _by_engine(table: pd.DataFrame, force_N: float, column: str) -> dict[str, float]:
    row = next(row for row in table.to_dict("records") if row["force_N"] == force_N)
    return {engine: row[f"{engine}_{column}"] for engine in engines_of(table)}
