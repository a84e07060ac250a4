"""``results/independent.csv``: written whole, read back line by line."""

import math
from collections.abc import Hashable
from dataclasses import asdict, fields
from pathlib import Path
from typing import Any

import pandas as pd

from drivers.base import paths
from drivers.base.errors import InputError
from drivers.base.files import whole_file
from validation.compare.verdict import FAIL, NOT_RUN, PASS, Verdict
from validation.independent.judged_cases import Line, verdict_of
from validation.independent.posed_cases import read_independent

NUMBERS = ("expected", "found", "error", "within")


def write_lines(lines: list[Line], path: Path) -> None:
    """Writes the table, whole or not at all."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with whole_file(path) as draft:
        pd.DataFrame([asdict(line) for line in lines], columns=[f.name for f in fields(Line)]).to_csv(
            draft, index=False
        )


def read_lines(path: Path, cases: Path = paths.INDEPENDENT) -> list[Line]:
    """The lines of the table, bit for bit; none where there is no table.

    Raises:
        InputError: it is damaged, or of other cases than those of ``cases``.
    """
    if not path.exists():
        return []
    where, allowed = paths.shown(path), "what make independent writes"
    try:
        table = pd.read_csv(path, dtype=str, keep_default_na=False)
        rows = table[[field.name for field in fields(Line)]].to_dict("records")
        lines = [_line(row) for row in rows]
    except (ValueError, KeyError) as error:  # pandas' own errors are ValueErrors
        raise InputError(where, "", "a damaged table", allowed) from error
    if list(dict.fromkeys(line.id for line in lines)) != [entry.id for entry in read_independent(cases)]:
        raise InputError(where, "id", f"not the cases of {paths.shown(cases)}", allowed)
    for line in lines:
        if line.verdict != _verdict_by_numbers(line):
            found = f"{line.verdict} of {line.id} on {line.engine}, off by {line.error:g} of {line.within:g}"
            raise InputError(where, "verdict", found, allowed)
    return lines


def _verdict_by_numbers(line: Line) -> str:
    """The verdict that a line's numbers make; of what was not measured the one it has, unless that is a pass."""
    if math.isfinite(line.error) and math.isfinite(line.within) and math.isfinite(line.found):
        return PASS if line.error <= line.within else FAIL
    return line.verdict if line.verdict == NOT_RUN else FAIL


def _line(row: dict[Hashable, Any]) -> Line:
    values: dict[str, Any] = {str(key): float(text or "nan") if key in NUMBERS else text for key, text in row.items()}
    return Line(**values)


def read_verdicts(results: Path) -> list[Verdict]:
    """The verdicts of the table in a results folder; none without the table.

    Raises:
        InputError: the table is damaged.
    """
    return [verdict_of(line) for line in read_lines(results / paths.INDEPENDENT_TABLE)]
