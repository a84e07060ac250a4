"""The study of independent cases: runs, verdicts, report."""

from collections import Counter, defaultdict
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from itertools import product
from math import isfinite, nan
from pathlib import Path
from time import perf_counter
from typing import Any

from drivers.base import paths
from drivers.base.errors import InputError
from drivers.chain.case import Case
from drivers.chain.schemes import verlet_of
from drivers.chain.trace import Trace
from drivers.engines import REFERENCE, engine_names, in_order, load_engine
from drivers.limits.refusal import inability
from drivers.run.finished import EndedRun
from drivers.run.run import refuse_all, run_many
from postproc.paper.simulate import exact
from postproc.read.motion import trace_with_state
from validation.checks import FAIL, NOT_RUN, PASS, RUN, Check, pass_or_fail
from validation.compare.comparison import NOT_INSTALLED, REFUSED
from validation.independent.posed_cases import MEASURES, Posed, pose, read_independent, unit_of
from validation.independent.posed_cases import Check as Expectation
from validation.studies import Options, Study, Tables, rows_in

IN_REPO: dict[str, Callable[[Case], Trace]] = {REFERENCE: lambda case: exact(case).trace, "verlet": verlet_of}


@dataclass(frozen=True)
class Line:
    """Row of the table: one number of one engine.

    Attributes:
        id, title: id and title of the independent case.
        label: settings of the case if the independent case is a study; else empty.
        quantity: ``run`` if the engine has no numbers, with the reason in ``why``.
        against: ``quoted`` or ``theory``, with its ``source``.
        error: error, ``relative`` or ``absolute`` as in ``error_is``.
        within, reason: tolerance of the error and its reason.
        wall_s: wall time of the run in s.
    """

    id: str
    title: str
    label: str
    engine: str
    quantity: str
    unit: str
    against: str
    expected: float
    found: float
    error: float
    error_is: str
    within: float
    verdict: str
    why: str
    reason: str
    source: str
    wall_s: float = 0.0


def judge_all(path: Path = paths.INDEPENDENT, runs: Path = paths.RUNS) -> list[Line]:
    """Runs the cases, codes in parallel and finished runs reused, and judges every number of every engine.

    Raises:
        InputError: the file, a scene or a study is wrong, or a guard refuses a scene.
    """
    posed = [one for entry in read_independent(path) for one in pose(entry, path)]
    absent, jobs = {}, {}
    for one, engine in product(posed, engine_names()):
        key = (one.entry.id, one.label, engine)
        if load_engine(engine).find() is None:
            absent[key] = NOT_INSTALLED
        elif (cannot := inability(one.case, engine)) is not None:
            absent[key] = f"{REFUSED}: {cannot}"
        elif engine not in IN_REPO:
            jobs[key] = (one.case, engine)
    # the last of equal decks is run: those that keep the state come last
    order = sorted(jobs, key=lambda key: "state" in jobs[key][0].scene.run.record)
    refuse_all([jobs[key] for key in order])
    ended = dict(zip(order, run_many([jobs[key] for key in order], runs), strict=True))
    lines = []
    for one, engine in product(posed, engine_names()):
        key = (one.entry.id, one.label, engine)
        if key in absent:
            lines.append(_without(one, engine, NOT_RUN, absent[key]))
        else:
            run, started = ended.get(key), perf_counter()
            judged = _judged(one, engine, run)
            wall_s = run.record.wall_s if run else perf_counter() - started
            lines += [replace(line, wall_s=round(wall_s, 4)) for line in judged]
    return lines


def _judged(one: Posed, engine: str, ended: EndedRun | None) -> list[Line]:
    if ended is not None and not ended.done:
        return [_without(one, engine, FAIL, f"{ended.record.status}: {ended.record.reason}")]
    try:
        trace = IN_REPO[engine](one.case) if ended is None else trace_with_state(ended)
        found = MEASURES[one.entry.measure].measure(one.case, trace)
    except (ValueError, ArithmeticError, IndexError) as error:  # the run does not show the quantities
        return [_without(one, engine, FAIL, str(error))]
    return [_line(one, engine, check, found.get(check.quantity, nan)) for check in one.entry.check]


def _line(one: Posed, engine: str, check: Expectation, found: float) -> Line:
    expected = one.theory[check.quantity] if check.expected is None else check.expected
    error = check.error(found, expected)
    return Line(
        id=one.entry.id,
        title=one.entry.title,
        label=one.label,
        engine=engine,
        quantity=check.quantity,
        unit=unit_of(check.quantity),
        against=check.against,
        expected=expected,
        found=found,
        error=error,
        error_is="relative" if check.within is not None else "absolute",
        within=check.limit,
        verdict=pass_or_fail(error, check.limit),
        why="" if found == found else "not visible in the run",
        reason=check.reason,
        source=MEASURES[one.entry.measure].SOURCE if check.expected is None else one.entry.source,
    )


def _without(one: Posed, engine: str, verdict: str, why: str) -> Line:
    entry, reason = one.entry, "a run has to finish and to show the quantities"
    names = (entry.id, entry.title, one.label, engine, RUN, "", "")
    return Line(*names, nan, nan, nan, "", nan, verdict, why, reason, entry.source)


def verdict_of(line: Line) -> Check:
    """The row as a verdict: the scene is the id of the case, ``where`` holds the found and the expected value."""
    if line.quantity == RUN:
        quantity, where = RUN, line.why
    else:
        unit = f" {line.unit}" if line.unit else ""
        quantity = f"{line.quantity} against {line.against}"
        where = f"found {line.found:.8g}{unit}, expected {line.expected:.8g}{unit}: {line.source}"
    if line.label:
        quantity += f" ({line.label})"
    return Check(line.id, line.engine, quantity, line.error, line.within, line.reason, where, line.verdict)


def rows_of(lines: Iterable[Line]) -> list[dict[str, Line]]:
    """One row per number and case: lines by engine.

    An engine without numbers has its ``run`` line in each row of the case; if no engine has numbers, there is one row.
    """
    rows: dict[tuple[str, ...], dict[str, Line]] = {}
    for line in sorted(lines, key=lambda each: each.quantity == RUN):
        key = (line.id, line.label, line.quantity, line.against)
        own = [row for other, row in rows.items() if other[:2] == key[:2]] if line.quantity == RUN else []
        for row in own or [rows.setdefault(key, {})]:
            row[line.engine] = line
    return list(rows.values())


def measure(options: Options) -> dict[str, list[Line]]:
    """Judges all cases.

    Raises:
        InputError: the file, a scene or a study is wrong.
    """
    return {"independent": judge_all(options.file, options.runs)}


def sentences(tables: Tables) -> list[str]:
    """Lines for a terminal, and counts of the verdicts."""
    lines = rows_in(tables["independent"], Line)
    counts = Counter(line.verdict for line in lines)
    return [*budget_lines(lines), f"{counts[PASS]} passed, {counts[FAIL]} failed, {counts[NOT_RUN]} not run"]


def missed(tables: Tables) -> list[str]:
    """Numbers with errors beyond their tolerance, and failed runs."""
    said = []
    for line in rows_in(tables["independent"], Line):
        if line.verdict == FAIL:
            each = verdict_of(line)
            off = "" if line.quantity == RUN else f"error {line.error:.3g}, allowed {line.within:g}: "
            said.append(f"{line.id}: {line.engine}: {each.quantity}: {off}{each.where}")
    return said


def budget_lines(lines: list[Line]) -> list[str]:
    """Lines for a terminal: a row for each number, with the error of each engine."""
    engines = list(dict.fromkeys(line.engine for line in lines))
    text = [f"{'case':<24} {'quantity':<34} {'expected':>12} {'allowed':>8} " + " ".join(f"{e:>9}" for e in engines)]
    last = ("", "")
    for row in rows_of(line for line in lines if line.quantity != RUN):
        one = next(iter(row.values()))
        if one.label and (one.id, one.label) != last:
            text.append(f"{one.id}: {one.label}")
        last = (one.id, one.label)
        name, head = f"{one.quantity}, {one.against}", "" if one.label else one.id
        errors = {engine: f"{line.error:.1e}" + ("" if line.verdict == PASS else "!") for engine, line in row.items()}
        cells = " ".join(f"{errors.get(engine, '-'):>9}" for engine in engines)
        text.append(f"{head:<24} {name:<34} {one.expected:12.6g} {one.within:8.1e} {cells}")
    return text + [f"{x.id} {x.label} {x.engine} {x.verdict}: {x.why}" for x in lines if x.quantity == RUN]


def lines_in(tables: Tables) -> list[Line]:
    """Rows of the shipped cases.

    Raises:
        InputError: the table holds other cases, or a verdict that disagrees with its numbers.
    """
    lines = rows_in(tables["independent"], Line)
    if list(dict.fromkeys(line.id for line in lines)) != [entry.id for entry in read_independent()]:
        found = f"other cases than in {paths.shown(paths.INDEPENDENT)}; run make independent"
        raise InputError("independent.csv", "id", found)
    for line in lines:
        # verdict by the numbers; without numbers the given one, unless it is a pass
        verdict = line.verdict if line.verdict == NOT_RUN else FAIL
        if isfinite(line.error) and isfinite(line.within) and isfinite(line.found):
            verdict = PASS if line.error <= line.within else FAIL
        if line.verdict != verdict:
            found = f"{line.verdict} of {line.id} on {line.engine} with error {line.error:g}, tolerance {line.within:g}"
            raise InputError("independent.csv", "verdict", found, f"{verdict}; run make independent")
    return lines


def section(tables: Tables) -> dict[str, Any]:
    """``cases`` with rows and counts of verdicts, ``engines``, ``verdicts``."""
    lines, cases = lines_in(tables), []
    for entry in read_independent():
        own = [line for line in lines if line.id == entry.id]
        rows = rows_of(own)
        first = [min(row.values(), key=lambda line: line.quantity == RUN) for row in rows]  # prefer numbers
        words = MEASURES[entry.measure].QUANTITIES | {RUN: "the run"}
        cases.append({
            "entry": entry,
            "rows": [(words.get(one.quantity, one.quantity), one, row) for one, row in zip(first, rows, strict=True)],
            "counts": Counter(line.verdict for line in own),
        })  # fmt: skip
    wall_s = defaultdict[tuple[str, str], float](float)
    for (case, engine, _), seconds in {(line.id, line.engine, line.label): line.wall_s for line in lines}.items():
        wall_s[case, engine] += seconds
    return {
        "cases": cases,
        "wall_s": wall_s,
        "engines": in_order({line.engine for line in lines} & set(engine_names())),
        "counts": Counter(line.verdict for line in lines),
        "checks": [verdict_of(line) for line in lines],
    }


STUDY = Study("independent", "independent cases", {"independent": Line}, measure, sentences, section, missed=missed)
