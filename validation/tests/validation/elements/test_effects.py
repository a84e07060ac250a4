"""Rows of the study of elements."""

from validation.chapters import frame_of
from validation.elements.elements_chapter import effect_rows
from validation.elements.switches import Effect


def effect(name: str, engine: str, change: float) -> Effect:
    return Effect("fig4", name, engine, "wall peak", 16.0, 16.0 * (1 + change), change, 5e-4, 6, 100.0, 1.0)


def test_codes_that_agree_share_a_row() -> None:
    rows = [effect("tube", engine, -0.08) for engine in ("one", "other")]
    rows += [effect("rotation", "one", -0.05), effect("rotation", "other", -0.04), effect("gravity", "one", 1e-15)]
    assert [*effect_rows(frame_of(Effect, rows), ["wall peak"])] == [
        ["tube", "-8 ± 0.05"],
        ["rotation (one)", "-5 ± 0.05"],
        ["rotation (other)", "-4 ± 0.05"],
        ["gravity", "0"],
    ]
