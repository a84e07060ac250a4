"""The study of the paper's statements: computed, judged, reported.

A claim names the function that computes it, ``module.function`` in ``validation/claims``, and its ``arguments``. A
function with the parameter ``run`` is computed on every engine, one with ``table`` from Table 1 as every engine solves
it; other functions use no simulated chain. If a sentence can be read in several ways, the reading that the text favours
is judged, and the reference computes the others as well.
"""

from collections import Counter
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from math import nan
from typing import Any

from drivers.base import paths
from drivers.base.errors import InputError
from drivers.engines import in_order
from validation.claims.claim import KINDS, read_claims
from validation.claims.judged import DIFFERS, REPRODUCED, ComputedReading, Judged, judge_all, verdict_of
from validation.studies import Options, Study, Tables, rows_in

RELATIONS = {"equals": "", "at most": "≤ ", "at least": "≥ "}


@dataclass(frozen=True)
class Row:
    """Row of the table: a claim with the computed values and the verdict."""

    id: str
    where: str
    quote: str
    kind: str
    relation: str
    quoted: float
    number_is: str  # "the paper's" or "ours": source of the quoted number
    unit: str
    within: float
    because: str
    reading: str  # the judged reading; empty if there is one only
    hangs: bool  # True if another reading gives another verdict
    computed: Mapping[str, float]  # by engine
    difference: float  # the reference's value less the quoted one
    verdict: str
    why: str
    how: str  # the computed quantity


@dataclass(frozen=True)
class ReadingRow:
    """Row of the table of readings."""

    id: str  # id of the claim
    reading: str
    favoured: str  # reason why the text favours this reading; empty for the others
    computed: float
    verdict: str


def measure(options: Options) -> dict[str, list[Row] | list[ReadingRow]]:
    """Rows of all claims and of their readings.

    Raises:
        RunError: a run failed.
    """
    return rows_of(judge_all(options.runs))


def rows_of(judged: list[Judged]) -> dict[str, list[Row] | list[ReadingRow]]:
    """Rows of both tables, from judged claims."""
    return {
        "claims": [*map(row_of, judged)],
        "claims-readings": [row for each in judged for row in _reading_rows(each)],
    }


def row_of(judged: Judged) -> Row:
    """Row of a judged claim."""
    claim = judged.claim
    same = ("id", "where", "quote", "kind", "relation", "quoted", "unit", "because")
    return Row(
        **{name: getattr(claim, name) for name in same},
        number_is="ours" if claim.ours else "the paper's",
        within=claim.within or nan,
        reading=claim.favoured.words,
        hangs=judged.hangs,
        computed=judged.computed,
        difference=judged.value - claim.quoted,
        verdict=judged.verdict,
        why=claim.explained,
        how=judged.how,
    )


def _reading_rows(judged: Judged) -> list[ReadingRow]:
    return [
        ReadingRow(
            id=judged.claim.id,
            reading=read.reading.words,
            favoured=read.reading.favoured,
            computed=read.value,
            verdict=read.verdict,
        )
        for read in judged.readings
    ]


def judged_in(tables: Tables) -> list[Judged]:
    """Claims of ``inputs/paper/claims.toml`` with the values of the tables.

    Raises:
        InputError: the tables hold other claims or verdicts.
    """
    rows, claims = rows_in(tables["claims"], Row), read_claims().claim
    values = {(row.id, row.reading): row.computed for row in rows_in(tables["claims-readings"], ReadingRow)}
    known = {(claim.id, reading.words) for claim in claims for reading in claim.readings}
    if [row.id for row in rows] != [claim.id for claim in claims] or set(values) != known:
        raise InputError("claims.csv", "id", f"other claims than in {paths.shown(paths.CLAIMS)}; run make claims")
    judged = [
        Judged(
            claim,
            dict(row.computed),
            row.how,
            tuple(
                ComputedReading(reading, value := values[claim.id, reading.words], verdict_of(claim, value))
                for reading in claim.readings
            ),
        )
        for claim, row in zip(claims, rows, strict=True)
    ]
    for each, row in zip(judged, rows, strict=True):
        if each.verdict != row.verdict:
            raise InputError(
                "claims.csv", f"{row.id}: verdict", row.verdict, f"{each.verdict}, the verdict of make claims"
            )
    return judged


def sentences(tables: Tables) -> list[str]:
    """Statements that differ, and counts of the verdicts."""
    judged = judged_in(tables)
    differ = [
        f"{each.claim.id}: quoted {each.claim.quoted:g}, computed {each.value:.4g} {each.claim.unit}: "
        f"{each.claim.explained}"
        for each in judged
        if each.verdict == DIFFERS
    ]
    counts = [f"{words}: {good} reproduced, {bad} differ" for words, good, bad in _counts(judged)]
    hanging = f"{sum(each.hangs for each in judged)} verdicts depend on the reading of a sentence"
    return [
        *differ,
        *counts,
        hanging,
        f"{len(read_claims().untested)} statements are not tested (reasons in the report)",
    ]


def _counts(judged: list[Judged]) -> list[tuple[str, int, int]]:
    """By kind: its description, the number of reproduced and of differing statements."""
    counts: Counter[tuple[str, str]] = Counter((each.claim.kind, each.verdict) for each in judged)
    return [(words, counts[kind, REPRODUCED], counts[kind, DIFFERS]) for kind, words in KINDS.items()]


def missed(tables: Tables) -> list[str]:
    """Claims with an unexplained difference, an unneeded explanation, or engines that disagree."""
    return [f"{each.claim.id}: {each.fault}" for each in judged_in(tables) if each.fault]


def section(tables: Tables) -> dict[str, Any]:
    """Rows by verdict with their readings, untested statements, engines, and counts."""
    judged = judged_in(tables)
    rows: dict[str, list[dict[str, Any]]] = {verdict: [] for verdict in (DIFFERS, REPRODUCED)}
    for each in judged:
        rows[each.verdict].append(_cells(each))
    return {
        "rows": rows,
        "engines": in_order({engine for each in judged for engine in each.computed}),
        "untested": read_claims().untested,
        "counts": _counts(judged),
        "hanging": sum(each.hangs for each in judged),
    }


def _cells(judged: Judged) -> dict[str, Any]:
    row = row_of(judged)
    # eight digits for a tight tolerance, else four
    digits = 8 if 0 < row.within < 1e-4 * abs(row.quoted) else 4
    cells = asdict(row) | {
        "ours": "our criterion" if row.number_is == "ours" else "",
        "kind": KINDS[row.kind],
        "quoted": f"{RELATIONS[row.relation]}{row.quoted:.8g}",
        "within": f"± {row.within:g}" if row.relation == "equals" else "",
        "computed": f"{judged.value:.{digits}g}",
        "why": row.why or row.because,
    }
    read = [
        {"words": each.reading.words, "favoured": each.reading.favoured, "verdict": each.verdict,
         "computed": f"{each.value:.{digits}g}"}
        for each in judged.readings
    ]  # fmt: skip
    return cells | {"readings": read}


STUDY = Study(
    "claims",
    "statements of the paper",
    {"claims": Row, "claims-readings": ReadingRow},
    measure,
    sentences,
    section,
    missed=missed,
)
