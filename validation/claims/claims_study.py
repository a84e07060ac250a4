"""``python -m validation claims``: judges the paper's statements, tells and writes what came out; their section."""

import sys
from collections import Counter
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from math import isnan, nan
from pathlib import Path
from typing import Any

from drivers.base import paths
from drivers.base.errors import InputError
from drivers.engines import in_order, missing_codes
from postproc.read.residual import REFERENCE
from validation.claims.judged_claims import DIFFERS, EXPERIMENT_ONLY, REPRODUCED, Judged, judge_all, read_claims
from validation.study_tables import read_rows, refused_if_damaged, write_table

RELATIONS = {"equals": "", "at most": "≤ ", "at least": "≥ "}


@dataclass(frozen=True)
class Row:
    """A claim with what came out, as the table has it.

    Attributes:
        number_is: whose reading of the paper's words the quoted number is.
        computed: by engine.
        difference: the reference's value less the quoted one.
        how: what was computed.
    """

    id: str
    where: str
    quote: str
    relation: str
    quoted: float
    number_is: str
    unit: str
    kind: str
    within: float
    because: str
    computed: Mapping[str, float]
    difference: float
    verdict: str
    why: str
    how: str


def claims(out: Path, runs: Path) -> int:
    """Judges every claim and writes the table; the exit code is 1 where one cannot stand.

    Raises:
        RunError: a run failed.
    """
    judged = judge_all(runs)
    write_claims(judged, out)
    for each in judged:
        claim = each.claim
        if each.verdict == DIFFERS:
            print(f"{claim.id}: quoted {claim.quoted:g}, computed {each.value:.4g} {claim.unit}: {claim.explained}")
    print(f"{paths.shown(out)}: {counted(judged)}")
    if missing_codes():
        print(f"without what is not installed: {', '.join(missing_codes())}", file=sys.stderr)
    faults = [each for each in judged if each.fault]
    for each in faults:
        print(f"{each.claim.id}: {each.fault}", file=sys.stderr)
    return 1 if faults else 0


def counted(judged: list[Judged]) -> str:
    """How many claims have which verdict, in words."""
    counts = Counter(each.verdict for each in judged)
    plain = sum(each.claim.arithmetic for each in judged if each.verdict == REPRODUCED)
    reproduced = f"{counts[REPRODUCED]} reproduced ({plain} of them by plain arithmetic)"
    return f"{reproduced}, {counts[DIFFERS]} differ, {counts[EXPERIMENT_ONLY]} of the experiment only"


def write_claims(judged: list[Judged], path: Path) -> None:
    """Writes the table, whole or not at all."""
    write_table(path, Row, [_row(each) for each in judged])


def _row(judged: Judged) -> Row:
    claim = judged.claim
    same = {name: getattr(claim, name) for name in ("id", "where", "quote", "relation", "quoted", "unit", "because")}
    return Row(
        **same,
        number_is="ours" if claim.ours else "the paper's",
        kind="arithmetic" if claim.arithmetic else "computed",
        within=nan if claim.within is None else claim.within,
        computed=judged.computed,
        difference=judged.off,
        verdict=judged.verdict,
        why=claim.explained or claim.note,
        how=judged.how,
    )


def read_section(results: Path) -> dict[str, Any]:
    """The rows of ``claims.csv`` by verdict, the differing ones first, and the engines in it; empty without the file.

    Raises:
        InputError: the table is damaged, or of other claims than those of ``inputs/paper/claims.toml``.
    """
    path = results / paths.CLAIMS_TABLE
    if not path.exists():
        return {}
    table = read_rows(path, Row, "claims")
    if [row.id for row in table] != [claim.id for claim in read_claims()]:
        found = f"not the claims of {paths.shown(paths.CLAIMS)}"
        raise InputError(paths.shown(path), "id", found, "the table that make claims writes")
    rows: dict[str, list[dict[str, Any]]] = {verdict: [] for verdict in (DIFFERS, REPRODUCED, EXPERIMENT_ONLY)}
    with refused_if_damaged(path, "claims"):
        for row in table:
            rows[row.verdict].append(_cells(row))
    return {"rows": rows, "engines": in_order({engine for row in table for engine in row.computed})}


def _cells(row: Row) -> dict[str, Any]:
    computed = row.computed.get(REFERENCE, nan)
    # more digits than four only where the tolerance looks at them
    digits = 8 if 0 < row.within < 1e-4 * abs(row.quoted) else 4
    return asdict(row) | {
        "ours": "our criterion" if row.number_is == "ours" else "",
        "kind": "plain arithmetic" if row.kind == "arithmetic" else "",
        "quoted": f"{RELATIONS[row.relation]}{row.quoted:.8g}",
        "within": f"± {row.within:g}" if not isnan(row.within) and row.relation == "equals" else "",
        "computed": "–" if isnan(computed) else f"{computed:.{digits}g}",
        "why": row.why or row.because,
    }
