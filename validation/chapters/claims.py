"""The study of published numbers: the paper's statements, and cases beyond the paper; computed, judged, reported.

``inputs/paper/claims.toml`` holds the statements, ``inputs/independent.toml`` the cases.
"""

from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from math import isnan

import pandas as pd

from drivers.base import paths
from drivers.base.errors import InputError
from drivers.engines import REFERENCE
from validation.chapters import Options
from validation.checks import FAIL, NOT_RUN, PASS, Check, outcome, share_of_limit
from validation.claims import claim as kinds
from validation.claims.claim import CASE, PHYSICS, Claim, measures, read_claims, read_file
from validation.claims.judged import DIFFERS, REPRODUCED, fault_of, favoured, judge, quantity_of
from validation.report.parts import Chapter, Shown

RELATIONS = {"equals": "", "at most": "≤ ", "at least": "≥ "}
# descriptions by kind and by whether the criterion is ours, in the order of the report
GROUPS = {
    (PHYSICS, False): "can fail on physics, by a number or a direction of the paper",
    (PHYSICS, True): "can fail on physics, by our criterion for the paper's words",
    (kinds.FITTED, False): "decided by the fitted law of dissipation: by its form or parameters, or fitted themselves",
    (kinds.CERTAIN, False): "true by similarity, construction or a bound: these check the simulations",
    (kinds.ARITHMETIC, False): "arithmetic of the paper's own numbers",
}
FORCE, DELAY = "fig4-amplitudes-agree", "fig4-times-agree"  # statements of the first sentence
TEXT = (
    "A statement differs if the computation, done right, gives another number than the paper prints: a finding about"
    " the paper, not a failed run. If a sentence can be read in several ways, one reading is judged, and the others are"
    " listed."
)
FURTHEST = "Found: the value of the engine furthest from the published one, in shares of the allowed error."

Statement = tuple[Claim, list[Check]]


def measure(options: Options) -> Chapter:
    """Judge the paper's statements and the shipped cases; with a file of own cases, these alone."""
    statements, cases = read_claims(), read_claims(options.file)
    for claim in cases:
        if claim.kind != CASE or claim.id in {statement.id for statement in statements}:
            raise InputError(claim.file, f"{claim.kind} {claim.id}", "the id of a statement of the paper", "another id")
    claims = cases if options.file != paths.INDEPENDENT else (*statements, *cases)
    return chapter_of(claims, judge(claims, options.runs))


def chapter_of(claims: Sequence[Claim], checks: Sequence[Check]) -> Chapter:
    """Chapter on judged claims: its checks are those of the cases, and the faults of statements."""
    ids = {claim.id for claim in claims if claim.kind == CASE}
    of_cases = [check for check in checks if check.scene in ids]
    judged = [
        (claim, [check for check in checks if check.scene == claim.id]) for claim in claims if claim.id not in ids
    ]
    faults = [(favoured(*pair)[REFERENCE], fault) for pair in judged if (fault := fault_of(*pair))]
    counts = Counter(check.verdict for check in of_cases)
    counted = f"cases beyond the paper: {counts[PASS]} passed, {counts[FAIL]} failed, {counts[NOT_RUN]} not run"
    return Chapter(
        {"claims": pd.DataFrame(checks)},
        [*(findings(judged) if judged else ()), counted],
        shown=[*(_shown(judged) if judged else ()), _shown_cases(claims, of_cases)],
        checks=[*of_cases, *(replace(check, where=fault, verdict=FAIL) for check, fault in faults)],
    )


def findings(judged: Sequence[Statement]) -> list[str]:
    """Theory against experiment, the number of reproduced statements, causes of differences, and counts by kind."""
    checks = {claim.id: favoured(claim, own)[REFERENCE] for claim, own in judged}
    groups = Counter(
        (claim.kind, claim.kind == PHYSICS and claim.ours, checks[claim.id].verdict) for claim, _ in judged
    )
    (theirs, theirs_off), (ours, ours_off), *_ = counts = [
        (groups[*group, REPRODUCED], groups[*group, DIFFERS]) for group in GROUPS
    ]
    reproduced = (
        f"{theirs + ours} of {theirs + theirs_off + ours + ours_off} statements of the paper that can fail on physics are"
        f" reproduced: {theirs} of {theirs + theirs_off} by a number or direction of the paper, {ours} of"
        f" {ours + ours_off} by our criterion for its words."
    )
    off = [claim.cause for claim, _ in judged if claim.kind == PHYSICS and checks[claim.id].verdict == DIFFERS]
    words = read_file(paths.CLAIMS).causes
    causes = "; ".join(f"{words.get(cause, 'other causes')} ({count})" for cause, count in Counter(off).most_common())
    force, delay = checks[FORCE], checks[DELAY]
    faster = 100 * (delay.expected / delay.found - 1)
    return [
        f"In Fig. 4 elastic theory gives {force.found:.1f} times the measured force and a {faster:.0f} % faster wave.",
        reproduced,
        f"{len(off)} of them differ: {causes}.",
        *(
            f"{text}: {good} reproduced, {bad} differ"
            for text, (good, bad) in zip(GROUPS.values(), counts, strict=True)
        ),
    ]


def _shown(judged: Sequence[Statement]) -> list[Shown]:
    """Statements that differ, those that are reproduced, the paper's own numbers, and statements without a test."""
    rows: dict[str, list[dict[str, str]]] = {DIFFERS: [], REPRODUCED: [], kinds.ARITHMETIC: []}
    for claim, checks in judged:
        verdict = favoured(claim, checks)[REFERENCE].verdict
        rows[claim.kind if claim.kind == kinds.ARITHMETIC else verdict].append(_row(claim, checks))
    headings = (f"Statements that differ: {len(rows[DIFFERS])}", "Reproduced statements", "The paper's own numbers")
    untested = [
        {"statement": f"{one['quote']}\n{one['source']}", "reason": one["reason"]}
        for one in read_file(paths.CLAIMS).untested
    ]
    return [
        Shown("", TEXT, pd.DataFrame(rows[DIFFERS])),
        Shown(f"Reproduced statements: {len(rows[REPRODUCED])}", "", pd.DataFrame(rows[REPRODUCED])),
        Shown(f"The paper's own numbers: {len(rows[kinds.ARITHMETIC])}", "", pd.DataFrame(rows[kinds.ARITHMETIC])),
        Shown(f"Not tested: {len(untested)}", "", pd.DataFrame(untested)),
    ]


def _row(claim: Claim, checks: Sequence[Check]) -> dict[str, str]:
    """A statement with its published and computed number, the verdict, other readings and reasons."""
    # eight digits for a tight tolerance, else four
    digits = 8 if 0 < claim.limit < 1e-4 * abs(claim.expected or 0.0) else 4
    exact = {check.quantity: check for check in checks if check.engine == REFERENCE}
    shown = {key: "–" if isnan(check.found) else f"{check.found:.{digits}g}" for key, check in exact.items()}
    judged, readings = quantity_of(claim, claim.favoured.words), claim.readings if len(claim.readings) > 1 else ()
    names = [(quantity_of(claim, reading.words), reading) for reading in readings]
    others = [
        f"{reading.words}{', judged' * bool(reading.favoured)}: {shown[name]}, {exact[name].verdict}"
        for name, reading in names
    ]
    hangs = len({check.verdict for check in exact.values()}) > 1
    marks = {
        "our criterion": claim.ours,
        "by the fitted law": claim.kind == kinds.FITTED,
        "depends on the reading": hangs,
    }
    within = f" ± {claim.absolute:g}" if claim.relation == "equals" else ""
    return {
        "statement": f"{claim.quote}\n{claim.source}",
        "published": f"{RELATIONS[claim.relation]}{claim.expected:.8g}{within} {claim.unit}".rstrip(),
        "computed": "\n".join([f"{exact[judged].verdict} {shown[judged]}", *others]),
        "reason": "\n".join([claim.explained or claim.reason, *(mark for mark, holds in marks.items() if holds)]),
    }


def _shown_cases(claims: Sequence[Claim], checks: Sequence[Check]) -> Shown:
    """Numbers of cases, each with the value of the engine furthest from it."""
    titles = {claim.id: claim.title or claim.id for claim in claims}
    words = {quantity: text for described in measures().values() for quantity, text in described.items()}
    rows = []
    for (case, quantity), alike in pd.DataFrame({"check": checks}).groupby(
        [[check.scene for check in checks], [check.quantity for check in checks]], sort=False
    )["check"]:
        worst, name = max(alike, key=share_of_limit), quantity.partition(" against ")[0]
        row = {
            "case": f"{titles[case]}\n{case}",
            "number": words.get(name, name),
            "published": "",
            "found": outcome(alike),
        }
        if not isnan(worst.limit):
            row |= {
                "published": f"{worst.expected:.7g}",
                "found": f"{outcome(alike)} {worst.found:.7g}\n{worst.engine}",
            }
            row["reason"] = f"error {worst.value:.1e}, allowed {worst.limit:g}: {worst.reason}"
        rows.append({"reason": f"{worst.engine}: {worst.where}"} | row)
    return Shown(f"Beyond the paper: {len({check.scene for check in checks})} cases", FURTHEST, pd.DataFrame(rows))
