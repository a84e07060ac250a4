"""Rows of the study of elements: their order, and codes that agree."""

from validation.chapters import frame_of
from validation.elements.effect_figures import largest_effects
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


def test_variants_follow_their_element_and_elements_their_size() -> None:
    changes = {"gravity": -0.03, "tube of 5.2 mm": -0.23, "tube": -0.08, "restitution 0.9": -0.5}
    effects = frame_of(Effect, [effect(name, "one", change) for name, change in changes.items()])
    assert list(largest_effects(effects)["element"]) == ["restitution 0.9", "tube", "tube of 5.2 mm", "gravity"]
