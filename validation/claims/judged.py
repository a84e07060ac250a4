"""Judged numbers: the paper's claims, and cases beyond the paper, each on all engines that it takes."""

import inspect
from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import cache, partial
from itertools import product
from math import isnan, nan
from pathlib import Path
from typing import Any

import pandas as pd

from drivers.base import paths
from drivers.base.tolerances import Tolerance
from drivers.chain.case import Case
from drivers.chain.schemes import verlet_of
from drivers.chain.trace import Trace
from drivers.engines import REFERENCE, VERLET, engine_names
from drivers.run.execute import execute
from drivers.run.run import run_many
from drivers.run.run_folder import EndedRun
from postproc.paper.simulate import Simulation, exact, run_codes_on
from postproc.paper.strikes import Amplitude, exact_table1, sensor_amplitude, solve_table1
from postproc.read.motion import trace_with_state
from validation.checks import FAIL, NOT_RUN, Check, judged, without_run
from validation.claims.cases import MEASURES, Expectation, Posed, pose, read_independent, unit_of
from validation.claims.claim import ARITHMETIC, Claim, Reading, function_of, given_to, read_claims
from validation.claims.paper_numbers import paper_numbers
from validation.compare.comparison import absences

REPRODUCED, DIFFERS = "reproduced", "differs"
IN_REPO: dict[str, Callable[[Case], Trace]] = {REFERENCE: lambda case: exact(case).trace, VERLET: verlet_of}


def check_of(claim: Claim, reading: Reading, engine: str, value: float) -> Check:
    """Verdict on a value; the scene is the id of the claim, and a difference has its explanation in ``where``."""
    error = claim.error(value)
    verdict = REPRODUCED if error <= claim.limit else DIFFERS
    where = f"{claim.where}: computed {value:.6g}, quoted {claim.quoted:g} {claim.unit}".rstrip()
    where += f": {claim.explained}" if verdict == DIFFERS and claim.explained else ""
    quantity, limit = quantity_of(claim, reading), claim.limit
    return Check(claim.id, engine, quantity, error, limit, claim.because, where, verdict, value, claim.quoted)


def quantity_of(claim: Claim, reading: Reading) -> str:
    """Function of a claim, with the reading of the sentence if there are several."""
    computed = claim.compute or claim.kind
    return f"{computed} ({reading.words})" if reading.words else computed


def favoured(claim: Claim, checks: Iterable[Check]) -> dict[str, Check]:
    """Checks of the favoured reading by engine; by ``reference`` only if no chain is simulated."""
    return {check.engine: check for check in checks if check.quantity == quantity_of(claim, claim.favoured)}


def hangs(checks: Iterable[Check]) -> bool:
    """True if another reading of the sentence gives another verdict."""
    return len({check.verdict for check in checks if check.engine == REFERENCE}) > 1


def fault_of(claim: Claim, checks: Sequence[Check]) -> str:
    """Fault of a claim: a difference without an explanation, the reverse, or engines that disagree; else empty."""
    by_engine = favoured(claim, checks)
    check = by_engine[REFERENCE]
    if check.verdict == DIFFERS and not claim.explained:
        return f"differs without an explanation: {check.found:.6g}, quoted {claim.quoted:g}"
    if check.verdict == REPRODUCED and claim.explained:
        return "is reproduced, but a difference is explained"
    other = [engine for engine, of_engine in by_engine.items() if of_engine.verdict != check.verdict]
    return f"{', '.join(other)} disagree with the reference" if other else ""


def judge_claims(runs: Path = paths.RUNS) -> list[Check]:
    """Computes and judges every claim of the paper; claims on simulated chains on every engine.

    Table 1 is solved while the reference computes the simulated claims. The codes then run the same cases, while the
    reference computes the other readings.

    Raises:
        RunError: a run failed.
    """
    claims = read_claims().claim
    asked: dict[str, Case] = {}

    @cache
    def solved(setting: str, amplitude: Amplitude) -> pd.DataFrame:
        return solve_table1(runs, setting) if amplitude is sensor_amplitude else exact_table1(setting, amplitude)

    def noted(case: Case) -> Simulation:
        asked[_key(case)] = case
        return exact(case)

    def values_with(**given: Any) -> dict[str, Any]:
        """Values of claims whose functions take just these of ``run`` and ``table``."""
        computed = [claim for claim in claims if claim.kind != ARITHMETIC and given_to(claim) == set(given)]
        return {claim.id: _call(claim, claim.favoured, **given) for claim in computed}

    def on_codes() -> dict[str, dict[str, Any]]:
        """Values by code of the claims on simulated chains."""
        values = {}
        for code, simulations in run_codes_on([*asked.values()], runs).items():
            done = dict(zip(asked, simulations, strict=True))
            values[code] = values_with(run=lambda case, done=done: done[_key(case)])
        return values

    def others() -> tuple[dict[str, Any], list[Check]]:
        """Values of claims that take neither, and the other readings of all claims by the reference."""
        return values_with() | paper_numbers(), [check for claim in claims for check in _other_readings(claim)]

    first: dict[str, Any] = {"table": partial(values_with, table=solved), "run": partial(values_with, run=noted)}
    second: dict[str, Any] = {"codes": on_codes, "others": others}
    done: dict[str, Any] = {}
    for work in (first, second):
        done |= {name: result for (name, _), result in execute(lambda named: named[1](), work.items())}
    by_engine, (rest, readings) = {REFERENCE: done["run"]} | done["codes"], done["others"]
    values = done["table"] | {name: {REFERENCE: value} for name, value in rest.items()}
    for name in by_engine[REFERENCE]:
        values[name] = {engine: float(computed[name]) for engine, computed in by_engine.items()}
    checks = []
    for claim in claims:
        checks += [check_of(claim, claim.favoured, engine, value) for engine, value in values[claim.id].items()]
        checks += [check for check in readings if check.scene == claim.id]
    return checks


def _key(case: Case) -> str:
    """The scene of a case, as text."""
    return case.scene.model_dump_json()


def _call(claim: Claim, reading: Reading, **given: Any) -> Any:
    """Result of the claim's function for one reading, with ``run`` or ``table`` if it takes them."""
    function = function_of(claim)
    assert function is not None
    taken = {name: argument for name, argument in given.items() if name in given_to(claim)}
    return function(**taken, **(claim.arguments | reading.arguments))


def _other_readings(claim: Claim) -> Iterator[Check]:
    """Readings that are not judged, by the reference."""
    for reading in claim.readings:
        if not reading.favoured:
            value = _call(claim, reading, run=exact, table=exact_table1)
            value = value[REFERENCE] if isinstance(value, dict) else float(value)
            yield check_of(claim, reading, REFERENCE, value)


def how_computed(claim: Claim) -> str:
    """Description of the computed quantity: the claim's, or the first sentence of its function."""
    text = claim.how or inspect.getdoc(function_of(claim) or "") or ""
    return "" if claim.kind == ARITHMETIC else " ".join(text.partition("\n\n")[0].replace("``", "").split())


def judge_cases(path: Path = paths.INDEPENDENT, runs: Path = paths.RUNS) -> list[Check]:
    """Runs the cases, codes in parallel and finished runs reused, and checks every number of every engine.

    The scene of a check is the id of its case.

    Raises:
        InputError: the file, a scene or a study is wrong, or a guard refuses a scene.
    """
    posed = [test for entry in read_independent(path) for test in pose(entry, path)]
    pairs = [*product(posed, engine_names())]
    absent = {(test, name): why for test in posed for name, why in absences(test.case, engine_names()).items()}
    jobs = [pair for pair in pairs if pair not in absent and pair[1] not in IN_REPO]
    # the last of equal decks is run: those that keep the state come last
    jobs.sort(key=lambda pair: "state" in pair[0].case.scene.run.record)
    cases = [(test.case, engine) for test, engine in jobs]
    ended = dict(zip(jobs, run_many(cases, runs), strict=True))
    checks: list[Check] = []
    for pair in pairs:
        checks += [_without(*pair, NOT_RUN, absent[pair])] if pair in absent else _judged(*pair, ended.get(pair))
    return checks


def _judged(posed: Posed, engine: str, ended: EndedRun | None) -> Iterator[Check]:
    """Checks of the numbers of a run, or of an in-repo motion."""
    if ended is not None and not ended.done:
        yield _without(posed, engine, FAIL, f"{ended.record.status}: {ended.record.reason}")
        return
    try:
        if ended is None:
            trace = IN_REPO[engine](posed.case)
        else:  # without the state if another case has the same run and records it
            trace = trace_with_state(ended) if "state" in posed.case.scene.run.record else ended.trace
        values = MEASURES[posed.entry.measure].measure(posed.case, trace)
    except (ValueError, ArithmeticError, IndexError) as error:  # the run does not show the quantities
        yield _without(posed, engine, FAIL, str(error))
        return
    for expectation in posed.entry.check:
        yield _check(posed, engine, expectation, values.get(expectation.quantity, nan))


def _check(posed: Posed, engine: str, expectation: Expectation, value: float) -> Check:
    """Check of a number, with the found and the expected value and its source in ``where``."""
    theory = expectation.expected is None
    expected = posed.theory[expectation.quantity] if expectation.expected is None else expectation.expected
    unit = unit_of(expectation.quantity) and f" {unit_of(expectation.quantity)}"
    source = MEASURES[posed.entry.measure].source if theory else posed.entry.source
    where = f"found {value:.8g}{unit}" if not isnan(value) else "not visible in the run"
    label = f" ({posed.label})" if posed.label else ""
    check = judged(
        posed.entry.id,
        engine,
        f"{expectation.quantity} against {expectation.against}{label}",
        expectation.error(value, expected),
        Tolerance(expectation.limit, expectation.reason),
        f"{where}, expected {expected:.8g}{unit}: {source}",
    )
    return Check(**vars(check) | {"found": value, "expected": expected})


def _without(posed: Posed, engine: str, verdict: str, why: str) -> Check:
    return without_run(posed.entry.id, engine, f"{posed.label}: {why}" if posed.label else why, verdict)
