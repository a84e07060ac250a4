"""The study of published numbers: the paper's statements, and cases beyond the paper; computed, judged, reported.

``inputs/paper/claims.toml`` holds the statements, ``inputs/independent.toml`` the cases.
"""

from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from math import isnan
from typing import Any

import pandas as pd

from drivers.base import paths
from drivers.base.errors import InputError
from drivers.engines import REFERENCE
from validation.chapters import Options
from validation.checks import DIFFERS, FAIL, NOT_RUN, PASS, REPRODUCED, Check, outcome, share_of_limit
from validation.claims.claim import ARITHMETIC, CASE, CERTAIN, FITTED, PHYSICS, Claim, measures, read_claims, read_file
from validation.claims.judged import fault_of, favoured, judge, quantity_of
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
    """Chapter on judged claims; its checks are those of the cases, and the faults of statements."""
    statements = {claim.id: claim for claim in claims if claim.kind != CASE}
    of_cases = [check for check in checks if check.scene not in statements]
    judged = [(claim, [check for check in checks if check.scene == name]) for name, claim in statements.items()]
    faults = [(favoured(*pair)[REFERENCE], fault) for pair in judged if (fault := fault_of(*pair))]
    counts = Counter(check.verdict for check in of_cases)
    counted = f"cases beyond the paper: {counts[PASS]} passed, {counts[FAIL]} failed, {counts[NOT_RUN]} not run"
    rows = pd.DataFrame([_row(*pair) for pair in judged])
    return Chapter(
        {"claims": pd.DataFrame(checks)},
        [*(findings(rows) if judged else ()), counted],
        shown=[*(_shown(rows) if judged else ()), _shown_cases(claims, of_cases)],
        checks=[*of_cases, *(replace(check, where=fault, verdict=FAIL) for check, fault in faults)],
    )


def _row(claim: Claim, checks: Sequence[Check]) -> dict[str, Any]:
    """A statement with its published and computed number, the verdict, other readings, reasons, and what is counted."""
    # eight digits for a tight tolerance, else four
    digits = 8 if 0 < claim.limit < 1e-4 * abs(claim.expected or 0.0) else 4
    exact = {check.quantity: check for check in checks if check.engine == REFERENCE}
    judged = exact[quantity_of(claim, claim.favoured.words)]
    readings = [(reading, exact[quantity_of(claim, reading.words)]) for reading in claim.readings if reading.words]
    marks = {
        "our criterion": claim.our_criterion,
        "by the fitted law": claim.kind == FITTED,
        "depends on the reading": len({check.verdict for check in exact.values()}) > 1,
    }

    def number(check: Check) -> str:
        return "–" if isnan(check.found) else f"{check.found:.{digits}g}"

    listed = [
        f"{reading.words}{', judged' * bool(reading.favoured)}: {number(check)}, {check.verdict}"
        for reading, check in readings
    ]
    within = f" ± {claim.absolute:g}" if claim.relation == "equals" else ""
    return {
        "statement": f"{claim.quote}\n{claim.source}",
        "published": f"{RELATIONS[claim.relation]}{claim.expected:.8g}{within} {claim.unit}".rstrip(),
        "computed": "\n".join([f"{judged.verdict} {number(judged)}", *listed]),
        "reason": "\n".join([claim.explained or claim.reason, *(mark for mark, holds in marks.items() if holds)]),
        **claim.model_dump(include={"id", "kind", "our_criterion", "cause", "expected"}),
        "verdict": judged.verdict,
        "found": judged.found,
    }


def findings(rows: pd.DataFrame) -> list[str]:
    """Theory against experiment, the number of reproduced statements, causes of differences, and counts by kind."""
    good, physics, by_id = rows["verdict"] == REPRODUCED, rows["kind"] == PHYSICS, rows.set_index("id")
    theirs, ours = (physics & (rows["our_criterion"] == our) for our in (False, True))

    def share(group: pd.Series) -> str:
        return f"{(group & good).sum()} of {group.sum()}"

    words, off = read_file(paths.CLAIMS).causes, rows.loc[physics & ~good, "cause"].value_counts()
    causes = "; ".join(f"{words.get(cause, 'other causes')} ({count})" for cause, count in off.items())
    faster = 100 * (by_id.loc[DELAY, "expected"] / by_id.loc[DELAY, "found"] - 1)
    return [
        f"In Fig. 4 elastic theory gives {by_id.loc[FORCE, 'found']:.1f} times the measured force, and a wave that is"
        f" {faster:.0f} % faster.",
        f"{share(physics)} statements of the paper that can fail on physics are reproduced: {share(theirs)} by a number"
        f" or direction of the paper, {share(ours)} by our criterion for its words.",
        f"{off.sum()} of them differ: {causes}.",
        *(f"{text}: {share(rows['kind'] == kind)} reproduced" for kind, text in GROUPS.items()),
    ]


def _shown(rows: pd.DataFrame) -> list[Shown]:
    """Statements that differ, those that are reproduced, the paper's own numbers, and statements without a test."""
    own = rows["kind"] == ARITHMETIC
    differ, reproduced = (rows.loc[~own & (rows["verdict"] == verdict), SHOWN] for verdict in (DIFFERS, REPRODUCED))
    untested = pd.DataFrame(read_file(paths.CLAIMS).untested)
    untested["quote"] += "\n" + untested.pop("source")
    return [
        Shown("", DIFFERENCE, differ),
        Shown(f"Reproduced statements: {len(reproduced)}", "", reproduced),
        Shown(f"The paper's own numbers: {own.sum()}", "", rows.loc[own, SHOWN]),
        Shown(f"Not tested: {len(untested)}", "", untested.rename(columns={"quote": "statement"})),
    ]


def _shown_cases(claims: Sequence[Claim], checks: Sequence[Check]) -> Shown:
    """Numbers of cases, each with the value of the engine furthest from it."""
    titles = {claim.id: claim.title or claim.id for claim in claims}
    words = {quantity: text for described in measures().values() for quantity, text in described.items()}
    alike: dict[tuple[str, str], list[Check]] = {}
    for check in checks:
        alike.setdefault((check.scene, check.quantity), []).append(check)
    rows = []
    for (case, quantity), by_engine in alike.items():
        worst = max(by_engine, key=share_of_limit)
        row = {"case": f"{titles[case]}\n{case}", "number": words.get(quantity.partition(" against ")[0], quantity)}
        row |= {"published": "", "found": outcome(by_engine), "reason": f"{worst.engine}: {worst.where}"}
        if not isnan(worst.limit):
            row["published"] = f"{worst.expected:.7g}"
            row["found"] += f" {worst.found:.7g}\n{worst.engine}"
            row["reason"] = f"error {worst.value:.1e}, allowed {worst.limit:g}: {worst.reason}"
        rows.append(row)
    count = len({check.scene for check in checks})
    return Shown(f"Beyond the paper: {count} cases with published or theoretical numbers", FURTHEST, pd.DataFrame(rows))
