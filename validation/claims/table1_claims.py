"""Claims on the numerical half of Table 1, one a printed number."""

from pathlib import Path

from postproc.paper.quoted import quoted
from postproc.paper.solved_table1 import COLUMNS, engines_of, solve_table1

NAMES = dict(zip(("speed", "width-0.2", "width-4"), COLUMNS, strict=True))
HOW = {
    "speed": "Speed from bead 9 to bead 5 of the strike that gives this amplitude, m/s.",
    "width-0.2": "Width at bead 5 at 0.2 % of the peak of the strike that gives this amplitude, in diameters.",
    "width-4": "Width at bead 5 at 4 % of the peak of the strike that gives this amplitude, in diameters.",
}


def claim_id(force_N: float, name: str) -> str:
    """The id of the claim on one number."""
    return f"table1-{force_N:g}N-{name}"


def all_ids() -> dict[str, str]:
    """How each number is computed, by claim."""
    return {claim_id(force, name): HOW[name] for force in quoted().table1.force_N for name in NAMES}


def compute(runs: Path) -> dict[str, dict[str, float]]:
    """All numbers by claim and engine."""
    found = solve_table1(runs)
    return {
        claim_id(row["force_N"], name): {engine: row[f"{engine}_{column}"] for engine in engines_of(found)}
        for _, row in found.iterrows()
        for name, column in NAMES.items()
    }
