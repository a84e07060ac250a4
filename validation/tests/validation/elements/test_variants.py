"""Uncertainty of an effect: variants of an element, in addition to the spread over seeds."""

from validation.chapters import frame_of
from validation.elements.elements_chapter import CHAPTER, sentences
from validation.elements.switches import Effect, read_elements


def test_variants_are_of_an_existing_element() -> None:
    elements = {each.name: each for each in read_elements().element}
    variants = [each for each in elements.values() if each.of]
    assert len(variants) >= 3
    for each in variants:
        assert elements[each.of].random
        assert each.with_.tube
        assert each.without.tube == elements[each.of].without.tube


def test_effects_are_given_with_their_spread_and_their_variants() -> None:
    changes = {"tube": -0.08, "tube of 5.2 mm": -0.23, "tube of 4.9 mm": -0.03, "gravity": -0.01}
    rows = [
        Effect("fig4", name, engine, "wall peak", 16.0, 16.0 * (1 + change), change, 5e-4, 6, 100.0, 1.0)
        for name, change in changes.items()
        for engine in ("one", "other")
    ]
    tables = {name: frame_of(kind, rows if name == "elements" else []) for name, kind in CHAPTER.tables.items()}
    said = next(line for line in sentences(tables) if line.startswith("fig4, tube:"))
    assert "by -8 %, with a spread over seeds of 0.05 %" in said
    assert said.endswith("-23 (tube of 5.2 mm), -3 (tube of 4.9 mm).")
