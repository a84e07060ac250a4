"""The study of elements: what each adds and costs, whether the rule that leaves them out holds, and the experiment."""

from typing import Any

import pandas as pd

from drivers.engines import installed_codes
from postproc.paper.simulate import case_of
from validation.accuracy.costs import cost_on
from validation.elements.between import Between, compare_codes
from validation.elements.element_figures import draw_oscilloscope, figures
from validation.elements.elements_sentences import missed, quotes, sentences
from validation.elements.oscilloscope import Number, add_steps, vary
from validation.elements.rule_checks import Asked, Nothing, accuracies_kept, nothing_changes
from validation.elements.switch_effects import Effect, measure_effects
from validation.elements.switches import pairs_of, read_elements
from validation.studies import Options, Study, Tables

REPEATS = 3  # runs from which a cost is the least
VERLET = "verlet"  # where no code is installed


def measure(options: Options) -> dict[str, Any]:
    """All of it; the short study takes few seeds, and only the first scene where all are switched.

    Raises:
        RunError: a run failed.
    """
    asked, runs = read_elements(), options.runs
    seeds = asked.quick_seeds if options.quick else asked.seeds
    scenes = asked.scene[:1] if options.quick else asked.scene
    codes = installed_codes()
    engines = codes or [VERLET]
    tube = case_of(f"{scenes[0].name}-tube")
    fastest = min(engines, key=lambda name: cost_on(name).run_s(tube))
    pairs = pairs_of(asked.model_copy(update={"scene": scenes}), seeds)
    steps = {scene.name: list(add_steps(scene, seeds, fastest, runs)) for scene in scenes}
    varied = [each for scene in scenes[:2] for each in vary(scene, seeds, fastest, runs)]
    return {
        "elements": measure_effects(pairs, engines, 1 if options.quick else REPEATS, runs),
        "elements-nothing": nothing_changes(scenes, engines, runs),
        "elements-accuracies": accuracies_kept(scenes[0].name, engines, runs),
        "elements-between": compare_codes(scenes, seeds, codes, runs),
        "oscilloscope": [number for own in steps.values() for each in own for number in each.numbers],
        "oscilloscope-ranges": [number for each in varied for number in each.numbers],
        **{f"oscilloscope-{name}": draw_oscilloscope(own, quotes()) for name, own in steps.items()},
    }


def section(tables: Tables) -> dict[str, Any]:
    """Effects by scene, and whether it is the short study."""
    effects = tables["elements"]
    names = list(effects["observable"].unique())
    return {
        "short": not {scene.name for scene in read_elements().scene} <= set(effects["scene"]),
        "observables": names,
        "effects": {scene: _rows(own, names) for scene, own in effects.groupby("scene", sort=False)},
    }


def _rows(effects: pd.DataFrame, names: list[str]) -> list[dict[str, Any]]:
    rows = []
    for (element, engine), own in effects.groupby(["element", "engine"], sort=False):
        by_name = own.set_index("observable").reindex(names)
        cells = [_cell(change, spread) for change, spread in zip(by_name["change"], by_name["spread"], strict=True)]
        cost, ratio = f"{own['cost_ns'].iloc[0]:.3g}", f"{own['cost_ratio'].iloc[0]:.2f}"
        rows.append({"element": element, "engine": engine, "cells": cells, "cost": cost, "ratio": ratio})
    return rows


def _cell(change: float, spread: float) -> str:
    if pd.isna(change):
        return "–"
    return f"{100 * change:+.3g}" + (f" ± {100 * spread:.1g}" if pd.notna(spread) else "")


STUDY = Study(
    name="elements",
    tables={
        "elements": Effect,
        "elements-nothing": Nothing,
        "elements-accuracies": Asked,
        "elements-between": Between,
        "oscilloscope": Number,
        "oscilloscope-ranges": Number,
    },
    measure=measure,
    sentences=sentences,
    figures=figures,
    section=section,
    missed=missed,
)
