"""The study of independent cases: runs, checks of every number of every engine, report."""

from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from itertools import product
from math import isnan, nan
from pathlib import Path
from typing import Any

from drivers.base import paths
from drivers.base.errors import InputError
from drivers.base.tolerances import Tolerance
from drivers.chain.case import Case
from drivers.chain.schemes import verlet_of
from drivers.chain.trace import Trace
from drivers.engines import REFERENCE, VERLET, engine_names, in_order
from drivers.run.run import refuse_all, run_many
from drivers.run.run_folder import EndedRun
from postproc.paper.simulate import exact
from postproc.read.motion import trace_with_state
from validation.chapters import Chapter, Tables, rows_in
from validation.checks import FAIL, NOT_RUN, PASS, RUN, Check, judged, pass_or_fail, without_run
from validation.compare.comparison import absences
from validation.independent.posed_cases import MEASURES, Expectation, Posed, pose, read_independent, unit_of

IN_REPO: dict[str, Callable[[Case], Trace]] = {REFERENCE: lambda case: exact(case).trace, VERLET: verlet_of}


def judge_all(path: Path = paths.INDEPENDENT, runs: Path = paths.RUNS) -> list[Check]:
    """Runs the cases, codes in parallel and finished runs reused, and checks every number of every engine.

    The scene of a check is the id of its case.

    Raises:
        InputError: the file, a scene or a study is wrong, or a guard refuses a scene.
    """
    posed = [one for entry in read_independent(path) for one in pose(entry, path)]
    pairs = [*product(posed, engine_names())]
    absent = {(one, name): why for one in posed for name, why in absences(one.case, engine_names()).items()}
    jobs = [pair for pair in pairs if pair not in absent and pair[1] not in IN_REPO]
    # the last of equal decks is run: those that keep the state come last
    jobs.sort(key=lambda pair: "state" in pair[0].case.scene.run.record)
    cases = [(one.case, engine) for one, engine in jobs]
    refuse_all(cases)
    ended = dict(zip(jobs, run_many(cases, runs), strict=True))
    checks: list[Check] = []
    for pair in pairs:
        checks += [_without(*pair, NOT_RUN, absent[pair])] if pair in absent else _judged(*pair, ended.get(pair))
    return checks


def _judged(one: Posed, engine: str, ended: EndedRun | None) -> Iterator[Check]:
    """Checks of the numbers of a run, or of an in-repo motion."""
    if ended is not None and not ended.done:
        yield _without(one, engine, FAIL, f"{ended.record.status}: {ended.record.reason}")
        return
    try:
        trace = IN_REPO[engine](one.case) if ended is None else _trace_of(one.case, ended)
        values = MEASURES[one.entry.measure].measure(one.case, trace)
    except (ValueError, ArithmeticError, IndexError) as error:  # the run does not show the quantities
        yield _without(one, engine, FAIL, str(error))
        return
    for expectation in one.entry.check:
        yield _check(one, engine, expectation, values.get(expectation.quantity, nan))


def _trace_of(case: Case, run: EndedRun) -> Trace:
    """Trace of a run, with the state if the case asks for it: another case may have the same run and record it."""
    return trace_with_state(run) if "state" in case.scene.run.record else run.trace


def _check(one: Posed, engine: str, expectation: Expectation, found: float) -> Check:
    """Check of a number, with the found and the expected value and its source in ``where``."""
    theory = expectation.expected is None
    expected = one.theory[expectation.quantity] if expectation.expected is None else expectation.expected
    unit = unit_of(expectation.quantity) and f" {unit_of(expectation.quantity)}"
    source = MEASURES[one.entry.measure].source if theory else one.entry.source
    where = f"found {found:.8g}{unit}" if not isnan(found) else "not visible in the run"
    label = f" ({one.label})" if one.label else ""
    check = judged(
        one.entry.id,
        engine,
        f"{expectation.quantity} against {expectation.against}{label}",
        expectation.error(found, expected),
        Tolerance(expectation.limit, expectation.reason),
        f"{where}, expected {expected:.8g}{unit}: {source}",
    )
    return Check(**vars(check) | {"found": found, "expected": expected})


def _without(one: Posed, engine: str, verdict: str, why: str) -> Check:
    return without_run(one.entry.id, engine, f"{one.label}: {why}" if one.label else why, verdict)


def sentences(tables: Tables) -> list[str]:
    """Counts of the verdicts."""
    counts = Counter(tables["independent"]["verdict"])
    return [f"{counts[PASS]} passed, {counts[FAIL]} failed, {counts[NOT_RUN]} not run"]


def checks_in(tables: Tables) -> list[Check]:
    """Checks of the shipped cases.

    Raises:
        InputError: the table holds other cases, or a verdict that disagrees with its numbers.
    """
    checks = rows_in(tables["independent"], Check)
    if list(dict.fromkeys(check.scene for check in checks)) != [entry.id for entry in read_independent()]:
        found = f"other cases than in {paths.shown(paths.INDEPENDENT)}; run make independent"
        raise InputError("independent.csv", "scene", found)
    for check in checks:
        measured = not isnan(check.limit)
        right = pass_or_fail(check.value, check.limit) if measured else NOT_RUN if check.verdict == NOT_RUN else FAIL
        if check.verdict != right:
            found = f"{check.verdict} of {check.scene} on {check.engine}: {check.value:g}, allowed {check.limit:g}"
            raise InputError("independent.csv", "verdict", found, f"{right}; run make independent")
    return checks


def section(tables: Tables) -> dict[str, Any]:
    """``cases`` with their rows and counts of verdicts, ``engines``, ``counts`` and ``checks``."""
    checks, cases = checks_in(tables), []
    for entry in read_independent():
        of_case = [check for check in checks if check.scene == entry.id]
        words = MEASURES[entry.measure].quantities | {RUN: "the run"}
        rows = [
            (words.get(quantity.partition(" against ")[0], quantity), next(iter(by_engine.values())), by_engine)
            for quantity, by_engine in _by_quantity(of_case).items()
        ]
        cases.append({"entry": entry, "rows": rows, "counts": Counter(check.verdict for check in of_case)})
    return {
        "cases": cases,
        "engines": in_order({check.engine for check in checks} & set(engine_names())),
        "counts": Counter(check.verdict for check in checks),
        "checks": checks,
    }


def _by_quantity(checks: Iterable[Check]) -> dict[str, dict[str, Check]]:
    """Checks by quantity and engine, missing runs last."""
    rows: dict[str, dict[str, Check]] = {}
    for check in sorted(checks, key=lambda check: check.quantity == RUN):
        rows.setdefault(check.quantity, {})[check.engine] = check
    return rows


CHAPTER = Chapter(
    name="independent",
    title="independent cases",
    tables={"independent": Check},
    measure=lambda options: {"independent": judge_all(options.file, options.runs)},
    sentences=sentences,
    section=section,
)
