"""``python -m validation independent``: runs the independent cases, tells and writes what they show; their section."""

import sys
from collections import Counter
from math import isfinite
from pathlib import Path
from typing import Any

from drivers.base import paths
from drivers.base.errors import InputError
from drivers.engines import engine_names, in_order, missing_codes
from validation.compare.verdict import FAIL, NOT_RUN, PASS
from validation.independent.judged_cases import RUN, Line, judge_all, rows_of, verdict_of
from validation.independent.measures import MEASURES
from validation.independent.posed_cases import read_independent
from validation.study_tables import read_rows, write_table

TARGET = "independent"


def independent(file: Path, results: Path, runs: Path) -> int:
    """Judges every case, writes ``independent.csv``; the exit code is 1 where one fails.

    Raises:
        InputError: the file, a scene or a study is wrong.
    """
    lines = judge_all(file, runs)
    out = results / paths.INDEPENDENT_TABLE
    write_table(out, Line, lines)
    print("\n".join(for_terminal(lines)))
    counts = Counter(line.verdict for line in lines)
    print(f"{paths.shown(out)}: {counts[PASS]} passed, {counts[FAIL]} failed, {counts[NOT_RUN]} not run")
    if missing_codes():
        print(f"without what is not installed: {', '.join(missing_codes())}", file=sys.stderr)
    for line in lines:
        if line.verdict == FAIL:
            each = verdict_of(line)
            off = "" if line.quantity == RUN else f"off by {line.error:.3g}, allowed {line.within:g}: "
            print(f"{line.id}: {line.engine}: {each.quantity}: {off}{each.where}", file=sys.stderr)
    return 1 if counts[FAIL] else 0


def for_terminal(lines: list[Line]) -> list[str]:
    """The lines for a terminal: a row for each number, with the error of each engine."""
    engines = list(dict.fromkeys(line.engine for line in lines))
    text = [f"{'case':<24} {'quantity':<34} {'expected':>12} {'allowed':>8} " + " ".join(f"{e:>9}" for e in engines)]
    last = ("", "")
    for row in rows_of(line for line in lines if line.quantity != RUN):
        one = next(iter(row.values()))
        if one.label and (one.id, one.label) != last:
            text.append(f"{one.id}: {one.label}")
        last = (one.id, one.label)
        name, head = f"{one.quantity}, {one.against}", "" if one.label else one.id
        cells = " ".join(f"{_error(row.get(engine)):>9}" for engine in engines)
        text.append(f"{head:<24} {name:<34} {one.expected:12.6g} {one.within:8.1e} {cells}")
    return text + [f"{x.id} {x.label} {x.engine} {x.verdict}: {x.why}" for x in lines if x.quantity == RUN]


def _error(line: Line | None) -> str:
    return "-" if line is None else f"{line.error:.1e}" + ("" if line.verdict == PASS else "!")


def read_lines(path: Path, cases: Path = paths.INDEPENDENT) -> list[Line]:
    """The lines of the table; none where there is no table.

    Raises:
        InputError: it is damaged, or of other cases than those of ``cases``.
    """
    if not path.exists():
        return []
    lines = read_rows(path, Line, TARGET)
    where, allowed = paths.shown(path), f"what make {TARGET} writes"
    if list(dict.fromkeys(line.id for line in lines)) != [entry.id for entry in read_independent(cases)]:
        raise InputError(where, "id", f"not the cases of {paths.shown(cases)}", allowed)
    for line in lines:
        if line.verdict != _verdict_by_numbers(line):
            found = f"{line.verdict} of {line.id} on {line.engine}, off by {line.error:g} of {line.within:g}"
            raise InputError(where, "verdict", found, allowed)
    return lines


def _verdict_by_numbers(line: Line) -> str:
    """The verdict that a line's numbers make; of what was not measured the one it has, unless that is a pass."""
    if isfinite(line.error) and isfinite(line.within) and isfinite(line.found):
        return PASS if line.error <= line.within else FAIL
    return line.verdict if line.verdict == NOT_RUN else FAIL


def read_section(results: Path) -> dict[str, Any]:
    """``cases`` with their rows and counts of verdicts, ``engines``, ``verdicts``; empty without the table.

    Raises:
        InputError: the table is damaged.
    """
    lines = read_lines(results / paths.INDEPENDENT_TABLE)
    if not lines:
        return {}
    cases = []
    for entry in read_independent():
        own = [line for line in lines if line.id == entry.id]
        words = MEASURES[entry.measure].QUANTITIES | {RUN: "the run"}
        cases.append({
            "entry": entry,
            "rows": [(words.get(line.quantity, line.quantity), line, row) for line, row in _with_first_number(own)],
            "counts": Counter(line.verdict for line in own),
        })  # fmt: skip
    return {
        "cases": cases,
        "engines": in_order({line.engine for line in lines} & set(engine_names())),
        "counts": Counter(line.verdict for line in lines),
        "verdicts": [verdict_of(line) for line in lines],
    }


def _with_first_number(lines: list[Line]) -> list[tuple[Line, dict[str, Line]]]:
    """Each row with its first line that has a number, if one has."""
    return [(min(row.values(), key=lambda line: line.quantity == RUN), row) for row in rows_of(lines)]
