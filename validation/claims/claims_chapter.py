"""The study of the paper's statements: computed, judged, reported.

A claim names the function that computes it, ``module.function`` in ``validation/claims``, and its ``arguments``. A
function with the parameter ``run`` is computed on every engine, one with ``table`` from Table 1 as every engine solves
it; other functions use no simulated chain. If a sentence can be read in several ways, the reading that the text favours
is judged, and the reference computes the others as well.
"""

from collections import Counter
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

from drivers.base import paths
from drivers.base.errors import InputError
from drivers.engines import REFERENCE, in_order
from validation.chapters import Chapter, Tables, rows_in
from validation.checks import FAIL, Check, table
from validation.claims.claim import KINDS, Claim, read_claims
from validation.claims.judged import (
    DIFFERS,
    REPRODUCED,
    check_of,
    fault_of,
    favoured,
    hangs,
    how_computed,
    judge_all,
    quantity_of,
)

RELATIONS = {"equals": "", "at most": "≤ ", "at least": "≥ "}


def checks_in(tables: Tables) -> list[tuple[Claim, list[Check]]]:
    """Claims of ``inputs/paper/claims.toml`` with their checks.

    Raises:
        InputError: the table holds other claims, readings or verdicts.
    """
    rows, claims = rows_in(tables["claims"], Check), read_claims().claim
    judged = [(claim, [row for row in rows if row.scene == claim.id]) for claim in claims]
    others = InputError("claims.csv", "scene", f"other claims than in {paths.shown(paths.CLAIMS)}; run make claims")
    if {row.scene for row in rows} != {claim.id for claim in claims}:
        raise others
    for claim, checks in judged:
        known = {quantity_of(claim, reading) for reading in claim.readings or [claim.favoured]}
        if {check.quantity for check in checks if check.engine == REFERENCE} != known:
            raise others
        for check in checks:
            verdict = check_of(claim, claim.favoured, check.engine, check.found).verdict
            if check.verdict != verdict:
                allowed = f"{verdict}, the verdict of make claims"
                raise InputError("claims.csv", f"{claim.id}: verdict", check.verdict, allowed)
    return judged


def sentences(tables: Tables) -> list[str]:
    """Statements that differ, and counts of the verdicts."""
    judged = checks_in(tables)
    checks = [favoured(claim, checks)[REFERENCE] for claim, checks in judged]
    return [
        *table([check for check in checks if check.verdict == DIFFERS]),
        *(f"{words}: {good} reproduced, {bad} differ" for words, good, bad in _counts(judged)),
        f"{sum(hangs(checks) for _, checks in judged)} verdicts depend on the reading of a sentence",
        f"{len(read_claims().untested)} statements are not tested (reasons in the report)",
    ]


def _counts(judged: list[tuple[Claim, list[Check]]]) -> list[tuple[str, int, int]]:
    """By kind: its description, the number of reproduced and of differing statements."""
    counts: Counter[tuple[str, str]] = Counter(
        (claim.kind, favoured(claim, checks)[REFERENCE].verdict) for claim, checks in judged
    )
    return [(words, counts[kind, REPRODUCED], counts[kind, DIFFERS]) for kind, words in KINDS.items()]


def judge(tables: Tables) -> Iterator[Check]:
    """Failures: claims with an unexplained difference, an unneeded explanation, or engines that disagree."""
    for claim, checks in checks_in(tables):
        if fault := fault_of(claim, checks):
            yield replace(favoured(claim, checks)[REFERENCE], where=fault, verdict=FAIL)


def section(tables: Tables) -> dict[str, Any]:
    """Claims by verdict with their readings, untested statements, engines, and counts."""
    judged = checks_in(tables)
    rows: dict[str, list[dict[str, Any]]] = {verdict: [] for verdict in (DIFFERS, REPRODUCED)}
    for claim, checks in judged:
        rows[favoured(claim, checks)[REFERENCE].verdict].append(_cells(claim, checks))
    return {
        "rows": rows,
        "engines": in_order({check.engine for _, checks in judged for check in checks}),
        "untested": read_claims().untested,
        "counts": _counts(judged),
        "hanging": sum(hangs(checks) for _, checks in judged),
    }


def _cells(claim: Claim, checks: list[Check]) -> dict[str, Any]:
    # eight digits for a tight tolerance, else four
    digits = 8 if 0 < claim.limit < 1e-4 * abs(claim.quoted) else 4
    exact = {check.quantity: check for check in checks if check.engine == REFERENCE}
    readings = [(reading, exact[quantity_of(claim, reading)]) for reading in claim.readings]
    return {
        "claim": claim,
        "ours": "our criterion" if claim.ours else "",
        "kind": KINDS[claim.kind],
        "quoted": f"{RELATIONS[claim.relation]}{claim.quoted:.8g}",
        "within": f"± {claim.within:g}" if claim.relation == "equals" else "",
        "computed": f"{exact[quantity_of(claim, claim.favoured)].found:.{digits}g}",
        "why": claim.explained or claim.because,
        "how": how_computed(claim),
        "hangs": hangs(checks),
        "readings": [(reading, f"{check.found:.{digits}g}", check.verdict) for reading, check in readings],
    }


CHAPTER = Chapter(
    name="claims",
    title="statements of the paper",
    tables={"claims": Check},
    measure=lambda options: {"claims": judge_all(options.runs)},
    sentences=sentences,
    section=section,
    judge=judge,
)
