"""Cases beyond the paper: run, judged, told."""

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
from drivers.chain.trace import Trace
from drivers.engines import REFERENCE, engine_names, in_order, load_engine
from drivers.limits.refusal import inability
from drivers.run.finished import EndedRun, open_run
from drivers.run.run import refuse_all, run_many
from postproc.paper.simulate import exact
from postproc.read.motion import read_motion
from validation.accuracy.schemes import verlet_of
from validation.compare.comparison import NOT_INSTALLED, REFUSED
from validation.compare.verdict import FAIL, NOT_RUN, PASS, RUN, Verdict, pass_or_fail
from validation.independent.posed_cases import MEASURES, Check, Posed, pose, read_independent, unit_of
from validation.studies import Options, Study, Tables, rows_in

HERE: dict[str, Callable[[Case], Trace]] = {REFERENCE: lambda case: exact(case).trace, "verlet": verlet_of}


@dataclass(frozen=True)
class Line:
    """A line of the table: one number of one engine.

    Attributes:
        id, title: of the independent case; ``label`` is its case's of a study.
        quantity: ``run`` where there are no numbers; then ``why`` says why.
        against: ``quoted`` or ``theory``; ``source`` says whose.
        error: relative, unless ``error_is`` says absolute; ``within``: what is allowed of it, and ``reason`` why.
        wall_s: of the run.
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
    """Runs what is not done, the codes side by side, and judges every number by every engine.

    Raises:
        InputError: the file, a scene or a study is wrong, or a scene cannot end well.
    """
    posed = [one for entry in read_independent(path) for one in pose(entry, path)]
    absent, jobs = {}, {}
    for one, engine in product(posed, engine_names()):
        key = (one.entry.id, one.label, engine)
        if load_engine(engine).find() is None:
            absent[key] = NOT_INSTALLED
        elif (cannot := inability(one.case, engine)) is not None:
            absent[key] = f"{REFUSED}: {cannot}"
        elif engine not in HERE:
            jobs[key] = (one.case, engine)
    # of equal decks the last is run: one that keeps its state serves the others too
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
        trace = HERE[engine](one.case) if ended is None else trace_of(one.case, ended.folder)
        found = MEASURES[one.entry.measure].measure(one.case, trace)
    except (ValueError, ArithmeticError, IndexError) as error:  # what the run does not show
        return [_without(one, engine, FAIL, str(error))]
    return [_line(one, engine, check, found.get(check.quantity, nan)) for check in one.entry.check]


def trace_of(case: Case, folder: Path) -> Trace:
    """The trace of a finished run, with the state where the scene asks for it.

    Raises:
        InputError: a file is missing or damaged.
    """
    run = open_run(folder)
    if "state" not in case.scene.run.record:
        return run.trace
    motion = read_motion(run)
    return replace(run.trace, height_m=motion.place_m[:, :, 2], velocity_m_s=motion.velocity_m_s[:, :, 2])


def _line(one: Posed, engine: str, check: Check, found: float) -> Line:
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
        why="" if found == found else "the run does not show it",
        reason=check.reason,
        source=MEASURES[one.entry.measure].SOURCE if check.expected is None else one.entry.source,
    )


def _without(one: Posed, engine: str, verdict: str, why: str) -> Line:
    entry, reason = one.entry, "a run has to be done and to show what is asked"
    names = (entry.id, entry.title, one.label, engine, RUN, "", "")
    return Line(*names, nan, nan, nan, "", nan, verdict, why, reason, entry.source)


def verdict_of(line: Line) -> Verdict:
    """The line as a verdict: the scene is the case's id, what is found and expected stands in ``where``."""
    if line.quantity == RUN:
        quantity, where = RUN, line.why
    else:
        unit = f" {line.unit}" if line.unit else ""
        quantity = f"{line.quantity} against {line.against}"
        where = f"found {line.found:.8g}{unit}, expected {line.expected:.8g}{unit}: {line.source}"
    if line.label:
        quantity += f" ({line.label})"
    return Verdict(line.id, line.engine, quantity, line.error, line.within, line.reason, where, line.verdict)


def rows_of(lines: Iterable[Line]) -> list[dict[str, Line]]:
    """A row for each number of each case: its lines by engine.

    An engine without numbers has the line that says why in each row of its case; if none has any, it is the only row.
    """
    rows: dict[tuple[str, ...], dict[str, Line]] = {}
    for line in sorted(lines, key=lambda each: each.quantity == RUN):
        key = (line.id, line.label, line.quantity, line.against)
        own = [row for other, row in rows.items() if other[:2] == key[:2]] if line.quantity == RUN else []
        for row in own or [rows.setdefault(key, {})]:
            row[line.engine] = line
    return list(rows.values())


def measure(options: Options) -> dict[str, list[Line]]:
    """Lines of all cases.

    Raises:
        InputError: the file, a scene or a study is wrong.
    """
    return {"independent": judge_all(options.file, options.runs)}


def sentences(tables: Tables) -> list[str]:
    """The lines for a terminal, and how many there are of each verdict."""
    lines = rows_in(tables["independent"], Line)
    counts = Counter(line.verdict for line in lines)
    return [*for_terminal(lines), f"{counts[PASS]} passed, {counts[FAIL]} failed, {counts[NOT_RUN]} not run"]


def missed(tables: Tables) -> list[str]:
    """Numbers that are off by more than is allowed, and runs that failed."""
    said = []
    for line in rows_in(tables["independent"], Line):
        if line.verdict == FAIL:
            each = verdict_of(line)
            off = "" if line.quantity == RUN else f"off by {line.error:.3g}, allowed {line.within:g}: "
            said.append(f"{line.id}: {line.engine}: {each.quantity}: {off}{each.where}")
    return said


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
        errors = {engine: f"{line.error:.1e}" + ("" if line.verdict == PASS else "!") for engine, line in row.items()}
        cells = " ".join(f"{errors.get(engine, '-'):>9}" for engine in engines)
        text.append(f"{head:<24} {name:<34} {one.expected:12.6g} {one.within:8.1e} {cells}")
    return text + [f"{x.id} {x.label} {x.engine} {x.verdict}: {x.why}" for x in lines if x.quantity == RUN]


def lines_in(tables: Tables) -> list[Line]:
    """The lines of the shipped cases.

    Raises:
        InputError: the table is of other cases, or has a verdict that its numbers do not make.
    """
    lines, allowed = rows_in(tables["independent"], Line), "what make independent writes"
    if list(dict.fromkeys(line.id for line in lines)) != [entry.id for entry in read_independent()]:
        raise InputError("independent.csv", "id", f"not the cases of {paths.shown(paths.INDEPENDENT)}", allowed)
    for line in lines:
        # the verdict that the numbers make; of what was not measured the one it has, unless that is a pass
        verdict = line.verdict if line.verdict == NOT_RUN else FAIL
        if isfinite(line.error) and isfinite(line.within) and isfinite(line.found):
            verdict = PASS if line.error <= line.within else FAIL
        if line.verdict != verdict:
            found = f"{line.verdict} of {line.id} on {line.engine}, off by {line.error:g} of {line.within:g}"
            raise InputError("independent.csv", "verdict", found, allowed)
    return lines


def section(tables: Tables) -> dict[str, Any]:
    """``cases`` with their rows and counts of verdicts, ``engines``, ``verdicts``."""
    lines, cases = lines_in(tables), []
    for entry in read_independent():
        own = [line for line in lines if line.id == entry.id]
        rows = rows_of(own)
        first = [min(row.values(), key=lambda line: line.quantity == RUN) for row in rows]  # with a number, if any has
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
        "verdicts": [verdict_of(line) for line in lines],
    }


STUDY = Study(
    "independent", "cases beyond the paper", {"independent": Line}, measure, sentences, section, missed=missed
)
