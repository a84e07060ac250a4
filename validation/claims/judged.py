"""Judged numbers: statements of the paper and cases beyond it, each on all engines that it takes."""

from collections.abc import Callable, Iterable, Sequence
from functools import cache, partial
from itertools import product
from math import isnan, nan
from pathlib import Path

from drivers.base import paths
from drivers.base.errors import InputError, RunError
from drivers.chain.case import Case
from drivers.chain.schemes import verlet_of
from drivers.chain.trace import Trace
from drivers.engines import REFERENCE, VERLET, engine_names, installed_codes
from drivers.run.run import run_many
from drivers.run.run_folder import EndedRun
from postproc.read.motion import Simulation, exact, trace_with_state
from validation.checks import DIFFERS, FAIL, NOT_RUN, REPRODUCED, Check, pass_or_fail, without_run
from validation.claims.claim import ARITHMETIC, CASE, Claim, Reading, cases_of, function_of, measures
from validation.claims.equations import paper_numbers
from validation.compare.comparison import absences

IN_REPO: dict[str, Callable[[Case], Trace]] = {REFERENCE: lambda case: exact(case).trace, VERLET: verlet_of}


def posed(claim: Claim) -> dict[str, Reading | Case]:
    """Ways to compute a claim, by their words: readings of a statement, or cases.

    Raises:
        InputError: a case is wrong, or an expected value is missing and no theory gives it.
    """
    if claim.kind != CASE:
        return {reading.words: reading for reading in claim.readings}
    cases, place = cases_of(claim.scene, claim.study, claim.set), f"case {claim.id}"
    try:
        theories = [_theory(function_of(claim, "_theory"), case) for case in cases.values()]
    except (ValueError, ArithmeticError) as error:
        raise InputError(claim.file, place, str(error), f'a case for the measure "{claim.measure}"') from error
    if claim.expected is None and any(claim.quantity not in theory for theory in theories):
        found = "missing key expected; no theory gives the value"
        raise InputError(claim.file, f"{place}: check {claim.quantity}", found)
    return {**cases}


@cache
def _theory(theory: Callable[[Case], dict[str, float]], case: Case) -> dict[str, float]:
    return theory(case)


def quantity_of(claim: Claim, words: str) -> str:
    """Quantity of the checks of a claim in a reading, or on a case of a study."""
    of_case = f"{claim.quantity} against {claim.against}"
    name = of_case if claim.kind == CASE else claim.measure or claim.kind
    return f"{name} ({words})" if words else name


def check_of(claim: Claim, words: str, engine: str, value: float, expected: float) -> Check:
    """Verdict on a value; the scene is the id of the claim, and a difference has its explanation in ``where``."""
    error, unit = claim.error(value, expected), f" {claim.unit}".rstrip()
    verdict = pass_or_fail(error, claim.limit)
    if claim.kind == CASE:
        found = "not visible in the run" if isnan(value) else f"found {value:.8g}{unit}"
        source = measures()[claim.measure]["source"] if claim.expected is None else claim.source
        where = f"{found}, expected {expected:.8g}{unit}: {source}"
    else:
        verdict = DIFFERS if verdict == FAIL else REPRODUCED
        where = f"{claim.source}: computed {value:.6g}, quoted {expected:g}{unit}"
        where += f": {claim.explained}" if verdict == DIFFERS and claim.explained else ""
    quantity = quantity_of(claim, words)
    return Check(claim.id, engine, quantity, error, claim.limit, claim.reason, where, verdict, value, expected)


def favoured(claim: Claim, checks: Sequence[Check]) -> dict[str, Check]:
    """Checks of the favoured reading of a statement, by engine; by ``reference`` only if no chain is simulated."""
    judged = quantity_of(claim, claim.favoured.words)
    return {check.engine: check for check in checks if check.quantity == judged}


def fault_of(claim: Claim, checks: Sequence[Check]) -> str:
    """Fault of a statement: a difference without an explanation, the reverse, or engines that disagree; else empty."""
    judged = favoured(claim, checks)
    check = judged[REFERENCE]
    if check.verdict == DIFFERS and not claim.explained:
        return f"differs without an explanation: {check.found:.6g}, quoted {claim.expected:g}"
    if check.verdict == REPRODUCED and claim.explained:
        return "is reproduced, but a difference is explained"
    other = [one.engine for one in judged.values() if one.verdict != check.verdict]
    other += [f"{one.engine} ({one.where})" for one in checks if one.verdict == FAIL]
    return f"{', '.join(other)} disagree with the reference" if other else ""


def judge(claims: Sequence[Claim], runs: Path = paths.RUNS) -> list[Check]:
    """Compute and judge claims, codes in parallel and finished runs reused.

    The reference computes the statements first; then the codes run all cases that it needed for them, and those of the
    cases beyond the paper. A code that needs another one, such as a strike of corrected speed, runs it when it does.

    Raises:
        InputError: a case is wrong, or a guard refuses it; nothing has been run.
    """
    asked: list[Case] = []  # for the value that is computed
    ended: dict[tuple[str, str], EndedRun] = {}

    def run_all(jobs: Iterable[tuple[Case, str]]) -> None:
        taken = {_key(*job): job for job in jobs if job[1] not in IN_REPO and not absences(job[0], [job[1]])}
        # the last of equal decks is run: those that keep the state come last
        keys = sorted(taken, key=lambda key: "state" in taken[key][0].scene.run.record)
        ended.update(zip(keys, run_many([taken[key] for key in keys], runs), strict=True))

    def run(case: Case, engine: str) -> Simulation:
        asked.append(case)
        if engine in IN_REPO:
            return Simulation(case, engine, IN_REPO[engine](case))
        if absent := absences(case, [engine]):
            raise RunError(absent[engine], NOT_RUN)
        if _key(case, engine) not in ended:
            run_all([(case, engine)])
        done = ended[_key(case, engine)]
        if not done.done:
            raise RunError(f"{done.record.status}: {done.record.reason}")
        # without the state if another case has the same run and records it
        return Simulation(case, engine, trace_with_state(done) if "state" in case.scene.run.record else done.trace)

    @cache
    def quantities(measure: Callable[[Case, Trace], dict[str, float]], case: Case, engine: str) -> dict[str, float]:
        return measure(case, run(case, engine).trace)

    def check(claim: Claim, words: str, way: Reading | Case, engine: str) -> Check:
        function, expected = function_of(claim), claim.expected or 0.0
        if isinstance(way, Case):
            value = quantities(function, way, engine).get(claim.quantity, nan)
            if claim.expected is None:
                expected = _theory(function_of(claim, "_theory"), way)[claim.quantity]
        elif claim.kind == ARITHMETIC:
            value = paper_numbers()[claim.id]
        else:
            given = () if claim.measure.startswith("equations.") else (partial(run, engine=engine),)
            value = float(function(*given, **(claim.arguments | way.arguments)))
        return check_of(claim, words, engine, value, expected)

    ways = [(claim, words, way) for claim in claims for words, way in posed(claim).items()]
    checks, jobs = dict[Check, None](), list[tuple[Case, str]]()
    on_engines: list[tuple[Claim, str, Reading | Case, str]] = []
    for claim, words, way in ways:
        asked[:] = [way] if isinstance(way, Case) else []
        engines = engine_names() if claim.kind == CASE else installed_codes()
        if claim.kind != CASE:
            checks[check(claim, words, way, REFERENCE)] = None
        if asked and (claim.kind == CASE or way is claim.favoured):
            on_engines += [(claim, words, way, engine) for engine in engines]
            jobs += product(asked, engines)
    run_all(jobs)
    for claim, words, way, engine in on_engines:
        try:
            checks[check(claim, words, way, engine)] = None
        except (RunError, ValueError, ArithmeticError, IndexError) as error:
            verdict = NOT_RUN if isinstance(error, RunError) and error.status == NOT_RUN else FAIL
            checks[without_run(claim.id, engine, f"{words}: {error}".removeprefix(": "), verdict)] = None
    places = {claim.id: place for place, claim in enumerate(claims)}
    return sorted(checks, key=lambda check: places[check.scene])


def _key(case: Case, code: str) -> tuple[str, str]:
    return case.scene.model_dump_json(), code
