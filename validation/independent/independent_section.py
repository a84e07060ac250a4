"""The independent cases as the report shows them: rows by case, engines as columns."""

from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from drivers.base import paths
from drivers.engines import engine_names, in_order
from validation.independent.independent_table import read_lines
from validation.independent.judged_cases import RUN, Line
from validation.independent.measures import MEASURES
from validation.independent.posed_cases import read_independent


@dataclass(frozen=True)
class Cell:
    """What one engine shows of one number.

    Attributes:
        text: the number, or why there is none.
        error: in the terms of the tolerance; empty where there is no number.
    """

    text: str
    error: str
    verdict: str


@dataclass(frozen=True)
class Row:
    """One number of one case.

    Attributes:
        quantity: in words; ``name`` is its name in the table.
        cells: by engine.
    """

    label: str
    name: str
    quantity: str
    unit: str
    against: str
    expected: str
    within: str
    reason: str
    source: str
    cells: dict[str, Cell]


def read_section(results: Path) -> dict[str, Any]:
    """``cases``, each with its ``rows`` and ``counts`` of verdicts, and ``engines``; empty without the table.

    Raises:
        InputError: the table is damaged.
    """
    lines = read_lines(results / paths.INDEPENDENT_TABLE)
    if not lines:
        return {}
    engines = in_order({line.engine for line in lines} & set(engine_names()))
    cases = []
    for entry in read_independent():
        own = [line for line in lines if line.id == entry.id]
        words = MEASURES[entry.measure].quantities
        cases.append(
            {
                "id": entry.id,
                "title": entry.title,
                "source": entry.source,
                "file": f"{entry.scene or entry.study}.toml",
                "settings": list(entry.set),
                "rows": _rows(own, words, engines),
                "counts": Counter(line.verdict for line in own),
            }
        )
    return {"cases": cases, "engines": engines, "counts": Counter(line.verdict for line in lines)}


def _rows(lines: list[Line], words: Any, engines: list[str]) -> list[Row]:
    """A row for each number; an engine without numbers says why in each row of its case."""
    rows = []
    numbers = [line for line in lines if line.quantity != RUN]
    keys = dict.fromkeys((line.label, line.quantity, line.against) for line in numbers)
    without = {(line.label, line.engine): line for line in lines if line.quantity == RUN}
    for label, quantity, against in keys:
        own = {
            line.engine: line
            for line in numbers
            if (line.label, line.quantity, line.against) == (label, quantity, against)
        }
        one = next(iter(own.values()))
        cells = {}
        for engine in engines:
            line = own.get(engine) or without.get((label, engine))
            if line is not None:
                cells[engine] = _cell(line)
        within = f"{one.within:g}" if one.error_is == "relative" else f"{one.within:g} {one.unit}".strip()
        rows.append(
            Row(label, quantity, words.get(quantity, quantity), one.unit, against, f"{one.expected:.7g}", within,
                one.reason, one.source, cells)
        )  # fmt: skip
    for (label, _), line in without.items():  # nothing ran: the row says why
        if label not in {row.label for row in rows}:
            cells = {e: _cell(each) for (of, e), each in without.items() if of == label}
            rows.append(Row(label, RUN, "the run", "", "", "", "", line.reason, line.source, cells))
    return rows


def _cell(line: Line) -> Cell:
    if line.quantity == RUN or line.why:
        return Cell(line.why, "", line.verdict)
    return Cell(f"{line.found:.7g}", f"{line.error:.1e}", line.verdict)
