"""The study of published numbers: the paper's statements, and cases beyond the paper; computed, judged, reported.

A claim of the paper names the function that computes it, ``module.function`` in this folder, and its ``arguments``. A
function with the parameter ``run`` is computed on every engine, one with ``table`` from Table 1 as every engine solves
it; other functions use no simulated chain. If a sentence can be read in several ways, one reading is judged, and the
reference computes the others as well. A case beyond the paper names a scene and a measure of ``measures/``.
"""

from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from math import isnan
from typing import Any

from drivers.base import paths
from drivers.base.errors import InputError
from drivers.engines import REFERENCE
from validation.chapters import Chapter, Options, Tables, rows_in
from validation.checks import FAIL, NOT_RUN, PASS, RUN, Check, outcome, pass_or_fail, share_of_limit, table
from validation.claims.cases import MEASURES, Independent, read_independent, unit_of
from validation.claims.claim import ARITHMETIC, CERTAIN, FITTED, PHYSICS, Claim, read_claims
from validation.claims.judged import (
    DIFFERS,
    REPRODUCED,
    check_of,
    fault_of,
    favoured,
    hangs,
    how_computed,
    judge_cases,
    judge_claims,
    quantity_of,
)

REMEDY = "run make claims"
RELATIONS = {"equals": "", "at most": "≤ ", "at least": "≥ "}
JudgedClaim = tuple[Claim, list[Check]]
GROUPS: dict[
    tuple[str, bool], str
] = {  # descriptions of kinds, by kind and by whether the criterion is ours; in the order of the report
    (PHYSICS, False): "can fail on physics, by a number or a direction of the paper",
    (PHYSICS, True): "can fail on physics, by our criterion for the paper's words",
    (FITTED, False): "decided by the fitted law of dissipation: by its form, or by a fit to the same numbers",
    (CERTAIN, False): "true by similarity, construction or a bound: these check the simulations",
    (ARITHMETIC, False): "arithmetic of the paper's own numbers",
}


def measure(options: Options) -> dict[str, Any]:
    """Judges the paper's claims and the shipped cases; with a file of own cases, these alone."""
    own_cases, taken = options.file != paths.INDEPENDENT, {claim.id for claim in read_claims().claim}
    for entry in read_independent(options.file):
        if entry.id in taken:
            raise InputError(
                paths.shown(options.file), f"case {entry.id}", "the id of a statement of the paper", "another id"
            )
    claims = [] if own_cases else judge_claims(options.runs)
    return {"claims": [*claims, *judge_cases(options.file, options.runs)]}


def checks_in(tables: Tables) -> tuple[list[JudgedClaim], list[Check]]:
    """Claims of the paper with their checks, none if the table holds own cases alone; and checks of cases.

    Raises:
        InputError: the table holds other claims, readings or verdicts.
    """
    claims = {claim.id: claim for claim in read_claims().claim}
    of_claim: dict[str, list[Check]] = {name: [] for name in claims}
    cases: list[Check] = []
    for check in rows_in(tables["claims"], Check):
        claim = claims.get(check.scene)
        if claim:
            right = check_of(claim, claim.favoured, check.engine, check.found).verdict
        elif isnan(check.limit):
            right = NOT_RUN if check.verdict == NOT_RUN else FAIL
        else:
            right = pass_or_fail(check.value, check.limit)
        if check.verdict != right:
            wrong = f"{check.verdict} of {check.scene} on {check.engine}: {check.value:g}, allowed {check.limit:g}"
            raise InputError("parts/claims.json", "verdict", wrong, f"{right}; run make claims")
        (of_claim[claim.id] if claim else cases).append(check)
    if not any(of_claim.values()):
        return [], cases
    for name, claim in claims.items():
        known = {quantity_of(claim, reading) for reading in claim.readings or [claim.favoured]}
        if {check.quantity for check in of_claim[name] if check.engine == REFERENCE} != known:
            raise InputError(
                "parts/claims.json", "scene", f"other claims than in {paths.shown(paths.CLAIMS)}; {REMEDY}"
            )
    return [(claim, of_claim[name]) for name, claim in claims.items()], cases


def sentences(tables: Tables) -> list[str]:
    """Statements that differ, and counts of the verdicts."""
    judged, cases = checks_in(tables)
    counts = Counter(check.verdict for check in cases)
    lines = [f"cases beyond the paper: {counts[PASS]} passed, {counts[FAIL]} failed, {counts[NOT_RUN]} not run"]
    if judged:
        checks = [favoured(*pair)[REFERENCE] for pair in judged]
        lines += table([check for check in checks if check.verdict == DIFFERS])
        lines += [f"{group}: {good} reproduced, {bad} differ" for group, good, bad in _counts(judged)]
        lines += [headline(judged), misfit(judged)]
    return lines


def headline(judged: Sequence[JudgedClaim]) -> str:
    """Number of reproduced statements among those that can fail on physics."""
    (_, theirs, off), (_, ours, ours_off), *_ = _counts(judged)  # the groups that can fail on physics
    return (
        f"{theirs + ours} of {theirs + off + ours + ours_off} statements of the paper that can fail on physics are"
        f" reproduced: {theirs} of {theirs + off} by a number or direction of the paper, {ours} of {ours + ours_off} by"
        " our criterion for its words."
    )


def misfit(judged: Sequence[JudgedClaim]) -> str:
    """Causes of the differences among statements that can fail on physics, each with its number of statements."""
    off = [pair[0] for pair in judged if pair[0].kind == PHYSICS and verdict_of(pair) == DIFFERS]
    counts, causes = Counter(claim.cause for claim in off), read_claims().causes
    parts = [f"{causes.get(cause, 'other causes')} ({count})" for cause, count in counts.most_common()]
    return f"{len(off)} statements differ: {'; '.join(parts)}." if off else ""


def verdict_of(judged: JudgedClaim) -> str:
    """Verdict of a claim: of the reference, in the favoured reading."""
    return favoured(*judged)[REFERENCE].verdict


def _counts(judged: Iterable[JudgedClaim]) -> list[tuple[str, int, int]]:
    """By group: its description, the number of reproduced and of differing statements."""
    counts: Counter[tuple[str, bool, str]] = Counter(
        (pair[0].kind, pair[0].kind == PHYSICS and pair[0].ours, verdict_of(pair)) for pair in judged
    )
    return [(description, counts[*group, REPRODUCED], counts[*group, DIFFERS]) for group, description in GROUPS.items()]


def judge(tables: Tables) -> Iterator[Check]:
    """Failures: claims with an unexplained difference, an unneeded explanation, or engines that disagree."""
    for claim, checks in checks_in(tables)[0]:
        if fault := fault_of(claim, checks):
            yield replace(favoured(claim, checks)[REFERENCE], where=fault, verdict=FAIL)


def section(tables: Tables) -> dict[str, Any]:
    """Statements by verdict, those of arithmetic apart; cases with their statements; headline, counts, untested.

    Raises:
        InputError: the table lacks the paper's claims or a shipped case.
    """
    (judged, checks), entries = checks_in(tables), read_independent()
    if not judged or list(dict.fromkeys(check.scene for check in checks)) != [entry.id for entry in entries]:
        raise InputError("parts/claims.json", "scene", f"other claims or cases than the shipped ones; {REMEDY}")
    physics = [pair for pair in judged if pair[0].kind != ARITHMETIC]
    return {
        "headline": headline(judged),
        "misfit": misfit(judged),
        "counts": _counts(judged),
        "hanging": sum(hangs(own) for _, own in judged),
        "without_code": sum(len(favoured(*pair)) == 1 for pair in judged if pair[0].kind == PHYSICS),
        DIFFERS: [_statement(*physic) for physic in physics if verdict_of(physic) == DIFFERS],
        REPRODUCED: [_statement(*physic) for physic in physics if verdict_of(physic) == REPRODUCED],
        ARITHMETIC: [_statement(*pair) for pair in judged if pair[0].kind == ARITHMETIC],
        "untested": read_claims().untested,
        "cases": [
            (entry, *_of_case(entry, [check for check in checks if check.scene == entry.id])) for entry in entries
        ],
        "checks": checks,
    }


def _statement(claim: Claim, checks: list[Check]) -> dict[str, Any]:
    """Row of the section on a claim.

    ``where`` is the place in the paper, ``words`` the sentence, ``how`` describes the computed value, ``why`` is the
    reason of the verdict, ``marks`` are remarks on the judgement, and ``readings`` are the ways to read the sentence,
    each with its value and verdict.
    """
    # eight digits for a tight tolerance, else four
    digits = 8 if 0 < claim.limit < 1e-4 * abs(claim.quoted) else 4
    exact = {check.quantity: check for check in checks if check.engine == REFERENCE}
    judged = quantity_of(claim, claim.favoured)
    within = f" ± {claim.within:g}" if claim.relation == "equals" else ""
    shown = {key: "–" if isnan(check.found) else f"{check.found:.{digits}g}" for key, check in exact.items()}
    marks = {
        "our criterion": claim.ours,
        "by the fitted law": claim.kind == FITTED,
        "depends on the reading": hangs(checks),
    }
    readings = {quantity_of(claim, reading): reading for reading in claim.readings}
    return {
        "id": claim.id,
        "where": claim.where,
        "words": claim.quote,
        "how": how_computed(claim),
        "published": f"{RELATIONS[claim.relation]}{claim.quoted:.8g}{within} {claim.unit}".rstrip(),
        "found": shown[judged],
        "verdict": exact[judged].verdict,
        "why": claim.explained or claim.because,
        "marks": [mark for mark, holds in marks.items() if holds],
        "readings": [
            (f"{reading.words}{', judged' * bool(reading.favoured)}", shown[quantity], exact[quantity].verdict)
            for quantity, reading in readings.items()
        ],
    }


def _of_case(entry: Independent, checks: Sequence[Check]) -> tuple[str, list[dict[str, Any]]]:
    """Verdict on a case, and a row for each number, with the value of the engine furthest from it, and failed run.

    The rows have the keys of ``_statement``; ``where`` is the source of the published number.
    """
    by_quantity: dict[str, list[Check]] = {}
    for check in checks:
        by_quantity.setdefault(f"{check.engine}: run" if check.quantity == RUN else check.quantity, []).append(check)
    rows = []
    for quantity, alike in by_quantity.items():
        worst, name = max(alike, key=share_of_limit), quantity.partition(" against ")[0]
        row: dict[str, Any] = dict.fromkeys(("where", "published", "found", "marks", "readings"), "") | {
            "id": entry.id,
            "words": MEASURES[entry.measure].quantities.get(name, name),
            "how": f"by {worst.engine}",
            "verdict": outcome(alike),
            "why": worst.where,
        }
        if not isnan(worst.limit):
            row |= {
                "where": worst.where.partition(": ")[2],
                "published": f"{worst.expected:.7g} {unit_of(name)}".rstrip(),
                "found": f"{worst.found:.7g}",
                "why": f"error {worst.value:.1e}, allowed {worst.limit:g}: {worst.reason}",
            }
        rows.append(row)
    return outcome(checks), rows


CHAPTER = Chapter(
    name="claims",
    title="published numbers",
    tables={"claims": Check},
    measure=measure,
    sentences=sentences,
    section=section,
    judge=judge,
)
