"""The claims table as the report shows it."""

from collections.abc import Hashable
from pathlib import Path
from typing import Any

import pandas as pd

from drivers.base import paths
from drivers.base.errors import InputError
from drivers.engines import engine_names
from validation.claims.judged_claims import DIFFERS, EXPERIMENT_ONLY, REPRODUCED, read_claims

RELATIONS = {"equals": "", "at most": "≤ ", "at least": "≥ "}


def read_section(results: Path) -> dict[str, Any]:
    """The rows of ``claims.csv`` by verdict, the differing ones first, and the engines in it; empty without the file.

    Raises:
        InputError: the table is damaged, or of other claims than those of ``inputs/paper/claims.toml``.
    """
    path = results / paths.CLAIMS_TABLE
    if not path.exists():
        return {}
    claims = read_claims()
    where, allowed = paths.shown(path), "the table that make claims writes"
    rows: dict[str, list[dict[str, str]]] = {verdict: [] for verdict in (DIFFERS, REPRODUCED, EXPERIMENT_ONLY)}
    try:
        table = pd.read_csv(path, keep_default_na=False)
        if list(table["id"]) != [claim.id for claim in claims]:
            raise InputError(where, "id", f"not the claims of {paths.shown(paths.CLAIMS)}", allowed)
        for row in table.to_dict("records"):
            rows[row["verdict"]].append(_cells(row))
    except (ValueError, KeyError) as error:  # pandas' own errors are ValueErrors
        raise InputError(where, "", "a damaged table", allowed) from error
    return {"rows": rows, "engines": [name for name in engine_names() if name in table.columns]}


def _cells(row: dict[Hashable, Any]) -> dict[str, str]:
    within, quoted, computed = row["within"], float(row["quoted"]), row["reference"]
    # more digits than four only where the tolerance looks at them
    digits = 8 if within != "" and 0 < float(within) < 1e-4 * abs(quoted) else 4
    return {
        "id": row["id"],
        "where": row["where"],
        "quote": row["quote"],
        "unit": row["unit"],
        "ours": "our criterion" if row["number_is"] == "ours" else "",
        "kind": "plain arithmetic" if row["kind"] == "arithmetic" else "",
        "quoted": f"{RELATIONS[row['relation']]}{quoted:.8g}",
        "within": f"± {float(within):g}" if within != "" and row["relation"] == "equals" else "",
        "computed": f"{float(computed):.{digits}g}" if computed != "" else "–",
        "why": row["why"] or row["because"],
        "how": row["how"],
    }
