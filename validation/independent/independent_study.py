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
from drivers.base.tolerances import Tolerance
from drivers.chain.case import Case
from drivers.chain.schemes import verlet_of
from drivers.chain.trace import Trace
from drivers.engines import REFERENCE, engine_names, in_order, load_engine
from drivers.limits.refusal import inability
from drivers.run.finished import EndedRun
from drivers.run.run import refuse_all, run_many
from postproc.paper.simulate import exact
from postproc.read.motion import trace_with_state
from validation.checks import (
    FAIL,
    NOT_RUN,
    PASS,
    RUN,
    Check,
    judged,
    pass_or_fail,
    share_of_limit,
    table,
    without_run,
    worst_of,
)
from validation.compare.comparison import NOT_INSTALLED, REFUSED
from validation.independent.posed_cases import MEASURES, Expectation, Posed, pose, read_independent, unit_of
from validation.studies import Options, Study, Tables, rows_in

IN_REPO: dict[str, Callable[[Case], Trace]] = {REFERENCE: lambda case: exact(case).trace, "verlet": verlet_of}
AGAINST = " against "  # in a quantity: followed by the origin of the expected value, and by the label of a study's case


@dataclass(frozen=True)
class PublishedCheck(Check):
    """Row of the table: one number of one engine; the scene is the id of the independent case.

    Attributes:
        expected, measured: published or theoretical value, and value of the run, in ``unit``; NaN without a number.
        wall_s: wall time of the run in s.
    """

    expected: float = nan
    measured: float = nan
    unit: str = ""
    wall_s: float = 0.0


def judge_all(path: Path = paths.INDEPENDENT, runs: Path = paths.RUNS) -> list[PublishedCheck]:
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
    checks = []
    for one, engine in product(posed, engine_names()):
        key = (one.entry.id, one.label, engine)
        if key in absent:
            checks.append(_without(one, engine, NOT_RUN, absent[key]))
        else:
            run, started = ended.get(key), perf_counter()
            of_run = _checks(one, engine, run)
            wall_s = run.record.wall_s if run else perf_counter() - started
            checks += [replace(check, wall_s=round(wall_s, 4)) for check in of_run]
    return checks


def _checks(one: Posed, engine: str, ended: EndedRun | None) -> list[PublishedCheck]:
    if ended is not None and not ended.done:
        return [_without(one, engine, FAIL, f"{ended.record.status}: {ended.record.reason}")]
    try:
        if ended is None:
            trace = IN_REPO[engine](one.case)
        else:  # the folder of equal decks has a state also for the case that records none
            trace = trace_with_state(ended) if "state" in one.case.scene.run.record else ended.trace
        values = MEASURES[one.entry.measure].measure(one.case, trace)
    except (ValueError, ArithmeticError, IndexError) as error:  # the run does not show the quantities
        return [_without(one, engine, FAIL, str(error))]
    return [_check(one, engine, expectation, values.get(expectation.quantity, nan)) for expectation in one.entry.check]


def _check(one: Posed, engine: str, number: Expectation, measured: float) -> PublishedCheck:
    expected = one.theory[number.quantity] if number.expected is None else number.expected
    source, unit = _source(one.entry.measure, one.entry.source, number.against), unit_of(number.quantity)
    in_unit = f" {unit}" if unit else ""
    seen = f"found {measured:.8g}{in_unit}" if measured == measured else "not visible in the run"
    where = f"{seen}, expected {expected:.8g}{in_unit}: {source}"
    quantity, limit = f"{number.quantity}{AGAINST}{number.against}", Tolerance(number.limit, number.reason)
    check = judged(one.entry.id, engine, quantity + _labelled(one), number.error(measured, expected), limit, where)
    return PublishedCheck(**vars(check), expected=expected, measured=measured, unit=unit)


def _without(one: Posed, engine: str, verdict: str, why: str) -> PublishedCheck:
    check = without_run(one.entry.id, engine, why, verdict)
    return PublishedCheck(**vars(replace(check, quantity=RUN + _labelled(one))))


def _labelled(one: Posed) -> str:
    return f" ({one.label})" if one.label else ""


def _source(measure: str, source: str, against: str) -> str:
    """Source of an expected value."""
    return MEASURES[measure].source if against == "theory" else source


def _is_run(check: Check) -> bool:
    """True for the check of an engine without numbers."""
    return AGAINST not in check.quantity


def rows_of(checks: Iterable[PublishedCheck]) -> dict[str, dict[str, PublishedCheck]]:
    """Checks of a case by quantity and engine.

    An engine without numbers has its run in each row with the same label; if no engine has numbers, there is one row.
    """
    rows: dict[str, dict[str, PublishedCheck]] = {}
    for check in sorted(checks, key=_is_run):
        label = check.quantity.partition(" (")[2]
        same = [row for quantity, row in rows.items() if quantity.partition(" (")[2] == label]
        for row in (same if _is_run(check) else []) or [rows.setdefault(check.quantity, {})]:
            row[check.engine] = check
    return rows


def measure(options: Options) -> dict[str, list[PublishedCheck]]:
    """Judges all cases.

    Raises:
        InputError: the file, a scene or a study is wrong.
    """
    return {"independent": judge_all(options.file, options.runs)}


def sentences(tables: Tables) -> list[str]:
    """Table of the checks of each case and engine that fail, else the one closest to its limit; counts of verdicts."""
    checks = rows_in(tables["independent"], PublishedCheck)
    groups = defaultdict[tuple[str, str], list[PublishedCheck]](list)
    for check in checks:
        groups[check.scene, check.engine].append(check)
    shown = [
        check
        for group in groups.values()
        for check in [check for check in group if check.verdict != PASS] or [worst_of(group) or group[0]]
    ]
    counts = Counter(check.verdict for check in checks)
    return [*table(shown), f"{counts[PASS]} passed, {counts[FAIL]} failed, {counts[NOT_RUN]} not run"]


def missed(tables: Tables) -> list[str]:
    """Numbers with errors beyond their tolerance, and failed runs."""
    return [
        f"{check.scene}: {check.engine}: {check.quantity}: "
        + ("" if _is_run(check) else f"error {check.value:.3g}, allowed {check.limit:g}: ")
        + check.where
        for check in rows_in(tables["independent"], PublishedCheck)
        if check.verdict == FAIL
    ]


def checks_in(tables: Tables) -> list[PublishedCheck]:
    """Checks of the shipped cases.

    Raises:
        InputError: the table holds other cases, or a verdict that disagrees with its numbers.
    """
    checks = rows_in(tables["independent"], PublishedCheck)
    if list(dict.fromkeys(check.scene for check in checks)) != [entry.id for entry in read_independent()]:
        cases = f"other cases than in {paths.shown(paths.INDEPENDENT)}; run make independent"
        raise InputError("independent.csv", "scene", cases)
    for check in checks:
        # verdict by the numbers; without numbers the given one, unless it is a pass
        verdict = check.verdict if check.verdict == NOT_RUN else FAIL
        if isfinite(check.value) and isfinite(check.limit) and isfinite(check.measured):
            verdict = pass_or_fail(check.value, check.limit)
        if check.verdict != verdict:
            wrong = f"{check.verdict} of {check.scene} on {check.engine}, error {share_of_limit(check):g} of its limit"
            raise InputError("independent.csv", "verdict", wrong, f"{verdict}; run make independent")
    return checks


def section(tables: Tables) -> dict[str, Any]:
    """``cases`` with rows and counts of verdicts, ``engines``, ``checks``."""
    checks, cases = checks_in(tables), []
    for entry in read_independent():
        own, rows = [check for check in checks if check.scene == entry.id], []
        words = MEASURES[entry.measure].quantities | {RUN: "the run"}
        absolute = {f"{each.quantity}{AGAINST}{each.against}" for each in entry.check if each.absolute is not None}
        for quantity, row in rows_of(own).items():
            number, _, origin = quantity.partition(AGAINST)
            name = number.partition(" (")[0]
            source = _source(entry.measure, entry.source, origin.partition(" ")[0])
            unit = unit_of(name) if quantity.partition(" (")[0] in absolute else ""
            rows.append((words.get(name, name), origin, source, unit, min(row.values(), key=_is_run), row))
        cases.append({"entry": entry, "rows": rows, "counts": Counter(check.verdict for check in own)})
    wall_s = defaultdict[tuple[str, str], float](float)
    runs = {(check.scene, check.engine, check.quantity.partition(" (")[2]): check.wall_s for check in checks}
    for (case, engine, _), seconds in runs.items():
        wall_s[case, engine] += seconds
    return {
        "cases": cases,
        "wall_s": wall_s,
        "engines": in_order({check.engine for check in checks} & set(engine_names())),
        "counts": Counter(check.verdict for check in checks),
        "checks": checks,
    }


STUDY = Study(
    "independent", "independent cases", {"independent": PublishedCheck}, measure, sentences, section, missed=missed
)
