"""``python -m validation independent``: runs the independent cases, prints and writes what they show."""

import sys
from collections import Counter
from pathlib import Path

from drivers.base import paths
from drivers.engines import missing_codes
from validation.compare.verdict import FAIL, NOT_RUN, PASS
from validation.independent.independent_table import write_lines
from validation.independent.judged_cases import RUN, Line, judge_all, verdict_of


def independent(file: Path, results: Path, runs: Path) -> int:
    """Judges every case, writes ``independent.csv``; the exit code is 1 where one fails.

    Raises:
        InputError: the file, a scene or a study is wrong.
    """
    lines = judge_all(file, runs)
    out = results / paths.INDEPENDENT_TABLE
    write_lines(lines, out)
    for text in table(lines):
        print(text)
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


def table(lines: list[Line]) -> list[str]:
    """The lines for a terminal: a row for each number, with the error of each engine."""
    engines = list(dict.fromkeys(line.engine for line in lines))
    width = {"id": 24, "quantity": 34}
    text = [
        f"{'case':<{width['id']}} {'quantity':<{width['quantity']}} {'expected':>12} {'allowed':>8} "
        + " ".join(f"{engine:>9}" for engine in engines)
    ]
    keys = dict.fromkeys((x.id, x.label, x.quantity, x.against) for x in lines if x.quantity != RUN)
    last = ("", "")
    for key in keys:
        own = {x.engine: x for x in lines if (x.id, x.label, x.quantity, x.against) == key}
        one = next(iter(own.values()))
        if key[:2] != last and one.label:
            text.append(f"{one.id}: {one.label}")
        last = key[:2]
        name = f"{one.quantity}, {one.against}"
        cells = " ".join(f"{_shown(own.get(engine)):>9}" for engine in engines)
        head = "" if one.label else one.id
        text.append(f"{head:<{width['id']}} {name:<{width['quantity']}} {one.expected:12.6g} {one.within:8.1e} {cells}")
    text += [f"{x.id} {x.label} {x.engine} {x.verdict}: {x.why}" for x in lines if x.quantity == RUN]
    return text


def _shown(line: Line | None) -> str:
    if line is None:
        return "-"
    return f"{line.error:.1e}" + ("" if line.verdict == PASS else "!")
