"""Rows of the study of elements."""

import pandas as pd

from validation.chapters.elements import show_effects


def effect(name: str, engine: str, change: float) -> dict[str, object]:
    return {"element": name, "engine": engine, "observable": "wall peak", "change": change, "spread": 5e-4}


def test_codes_that_agree_share_a_row() -> None:
    rows = [effect("tube", engine, -0.08) for engine in ("one", "other")]
    rows += [effect("rotation", "one", -0.05), effect("rotation", "other", -0.04), effect("gravity", "one", 1e-15)]
    assert show_effects("fig4", pd.DataFrame(rows)).table.to_numpy().tolist() == [
        ["tube", "-8 ± 0.05"],
        ["rotation (one)", "-5 ± 0.05"],
        ["rotation (other)", "-4 ± 0.05"],
        ["gravity", "0"],
    ]
