"""The study of published numbers: the paper's statements, and cases beyond the paper; computed, judged, reported.

``inputs/paper/claims.toml`` holds the statements, ``inputs/independent.toml`` the cases.
"""

from collections import Counter, defaultdict
from collections.abc import Sequence
from dataclasses import replace
from math import isnan
from typing import Any

import pandas as pd

from drivers.base import paths
from drivers.base.errors import InputError
from drivers.engines import REFERENCE
from validation.chapters import Options
from validation.checks import DIFFERS, FAIL, NOT_RUN, PASS, REPRODUCED, RUN, Check, outcome, share_of_limit
from validation.claims.judged import (
    ARITHMETIC,
    CASE,
    CERTAIN,
    FITTED,
    PHYSICS,
    Claim,
    fault_of,
    favoured,
    function_of,
    judge,
    measures,
    quantity_of,
    read_claims,
    read_file,
)
from validation.report.parts import Chapter, Shown

RELATIONS = {"equals": "", "at most": "≤ ", "at least": "≥ "}
GROUPS = {  # kinds of statements that are counted apart
    FITTED: "decided by the fitted law of dissipation, by its form or its parameters",
    CERTAIN: "true by similarity, construction or a bound: these check the simulations",
    ARITHMETIC: "arithmetic of the paper's own numbers",
}
FORCE, DELAY = "fig4-amplitudes-agree", "fig4-times-agree"  # statements of the first sentence
SHOWN = ["statement", "published", "computed", "reason"]
DIFFERENCE = (
    "A statement differs if the computation, done right, gives another number than the paper prints: a finding about"
    " the paper, not a failed run. If a sentence can be read in several ways, one is judged, and all are listed."
)
FURTHEST = "Found: the value of the engine furthest from the published one, in shares of the allowed error."


def measure(options: Options) -> Chapter:
    """Judge the paper's statements and the shipped cases; with a file of own cases, these alone."""
    statements, cases = read_claims(), read_claims(options.file)
    taken = {claim.id for claim in statements}
    for claim in cases:
        if claim.kind != CASE or claim.id in taken:
            raise InputError(claim.file, f"case {claim.id}", "the id of a statement of the paper", "another id")
    claims = cases if options.file != paths.INDEPENDENT else (*statements, *cases)
    return chapter_of(claims, judge(claims, options.runs))


def chapter_of(claims: Sequence[Claim], checks: Sequence[Check]) -> Chapter:
    """Chapter on judged claims; its checks are those of the cases, and the faults of statements, of no engine."""
    own: dict[str, list[Check]] = defaultdict(list)
    for check in checks:
        own[check.scene].append(check)
    statements = {claim.id: claim for claim in claims if claim.kind != CASE}
    judged = [check for check in checks if check.scene not in statements]
    counts = Counter(check.verdict for check in judged)
    counted = f"cases beyond the paper: {counts[PASS]} passed, {counts[FAIL]} failed, {counts[NOT_RUN]} not run"
    for name, claim in statements.items():
        if fault := fault_of(claim, own[name]):
            judged.append(replace(favoured(claim, own[name])[REFERENCE], engine="", where=fault, verdict=FAIL))
    rows = pd.DataFrame([_row(claim, own[claim.id]) for claim in claims])
    found = [*(findings(rows) if statements else ()), counted]
    return Chapter({"claims": pd.DataFrame(checks)}, found, shown=_shown(rows), checks=judged)


def _row(claim: Claim, checks: Sequence[Check]) -> dict[str, Any]:
    """A claim with its published and computed number, the verdict, other readings, reasons, and what is counted."""
    if claim.kind == CASE:
        missing = [check for check in checks if check.quantity == RUN]
        measured = [check for check in checks if check.quantity.startswith(quantity_of(claim, ""))]
        judged = max(measured or missing, key=share_of_limit)
        verdict, words = outcome(measured or missing), measures()[claim.measure][claim.quantity]
        listed = [judged.engine]
        reason = [f"error {judged.value:.1e}: {claim.reason}", *(f"{one.engine}: {one.where}" for one in missing)]
    else:
        exact = {check.quantity: check for check in checks if check.engine == REFERENCE}
        judged = exact[quantity_of(claim, claim.favoured.words)]
        verdict, words = judged.verdict, claim.quote
        readings = [(reading, exact[quantity_of(claim, reading.words)]) for reading in claim.readings if reading.words]
        how = claim.how or (function_of(claim).__doc__ or "").partition("\n")[0] if claim.kind != ARITHMETIC else ""
        listed = [how.replace("``", "")] * bool(how) + [
            f"{reading.words}{', judged' * bool(reading.favoured)}: {_number(claim, check)}, {check.verdict}"
            for reading, check in readings
        ]
        marks = {
            "our criterion": claim.our_criterion,
            "by the fitted law": claim.kind == FITTED,
            "depends on the reading": len({check.verdict for check in exact.values()}) > 1,
        }
        reason = [claim.explained or claim.reason, *(mark for mark, holds in marks.items() if holds)]
    within = f" ± {claim.absolute:g}" if claim.relation == "equals" and claim.absolute else ""
    share = f", within {claim.within:g} of it" if claim.within else ""
    return {
        "statement": "\n".join(filter(None, (words, claim.title, claim.source))),
        "published": f"{RELATIONS[claim.relation]}{judged.expected:.8g}{within} {claim.unit}".rstrip() + share,
        "computed": "\n".join([f"{verdict} {_number(claim, judged)}", *listed]),
        "reason": "\n".join(reason),
        **claim.model_dump(include={"id", "kind", "our_criterion", "cause"}),
        "verdict": verdict,
        "expected": judged.expected,
        "found": judged.found,
    }


def _number(claim: Claim, check: Check) -> str:
    """Computed number: eight digits for a tight tolerance, else four."""
    tight = 0 < claim.limit < 1e-4 * (1.0 if claim.within else abs(check.expected))
    return "–" if isnan(check.found) else f"{check.found:.{8 if tight else 4}g}"


def findings(rows: pd.DataFrame) -> list[str]:
    """Theory against experiment, the number of reproduced statements, causes of differences, and counts by kind."""
    good, physics = rows["verdict"] == REPRODUCED, rows["kind"] == PHYSICS
    numbers = {row["id"]: row for row in rows.to_dict("records")}
    force, delay = numbers[FORCE], numbers[DELAY]
    theirs, ours = (physics & (rows["our_criterion"] == our) for our in (False, True))

    def share(group: pd.Series) -> str:
        return f"{(group & good).sum()} of {group.sum()}"

    words, off = (
        read_file(paths.CLAIMS).named_causes | {"": "other causes"},
        Counter(rows.loc[physics & ~good, "cause"]),
    )
    causes = "; ".join(f"{words[cause]} ({off[cause]})" for cause in words if off[cause])
    return [
        f"In Fig. 4 elastic theory gives {force['found']:.1f} times the measured force, and a wave that is"
        f" {100 * (delay['expected'] / delay['found'] - 1):.0f} % faster.",
        f"{share(physics)} statements of the paper that can fail on physics are reproduced: {share(theirs)} by a number"
        f" or direction of the paper, {share(ours)} by our criterion for its words.",
        f"{off.total()} differ: {causes}.",
        *(f"{text}: {share(rows['kind'] == kind)} reproduced" for kind, text in GROUPS.items()),
    ]


def _shown(rows: pd.DataFrame) -> list[Shown]:
    """Statements that differ, those that are reproduced, the paper's own numbers, those without a test, and cases."""
    cases, own = rows["kind"] == CASE, rows["kind"] == ARITHMETIC
    of_cases = f"Beyond the paper: {rows.loc[cases, 'id'].nunique()} cases with published or theoretical numbers"
    shown = [Shown(of_cases, FURTHEST, rows.loc[cases, SHOWN])]
    if cases.all():
        return shown
    differ, reproduced = (~cases & ~own & (rows["verdict"] == verdict) for verdict in (DIFFERS, REPRODUCED))
    untested = pd.DataFrame(read_file(paths.CLAIMS).untested)
    untested["quote"] += "\n" + untested.pop("source")
    return [
        Shown("", DIFFERENCE, rows.loc[differ, SHOWN]),
        Shown(f"Reproduced statements: {reproduced.sum()}", "", rows.loc[reproduced, SHOWN]),
        Shown(f"The paper's own numbers: {own.sum()}", "", rows.loc[own, SHOWN]),
        Shown(f"Not tested: {len(untested)}", "", untested.rename(columns={"quote": "statement"})),
        *shown,
    ]
