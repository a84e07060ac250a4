"""The study of elements: effects and costs, omitted elements, and the gap between elastic theory and experiment."""

from collections import defaultdict
from collections.abc import Iterator, Sequence
from functools import partial
from itertools import chain, product
from typing import Any

import numpy as np
import pandas as pd

from drivers.base.tolerances import tolerance
from drivers.chain.case import Case
from drivers.engines import VERLET, installed_codes
from drivers.limits import inability
from postproc.paper.simulate import case_of, run_codes
from validation.accuracy.costs import cost_on
from validation.chapters import Chapter, Options, Picture, Tables, rows_in
from validation.checks import Check, judged, short, summary
from validation.elements import gauge_steps, switches
from validation.elements.effect_figures import Quote, draw_effects, draw_oscilloscope, largest_effects, quotes
from validation.elements.gauge_steps import ELASTIC
from validation.elements.switches import read_elements, runs_of

REPEATS = 3  # further runs for costs, except in the short study
ROUNDING = 1e-6  # of a mean: a smaller spread counts as none
MAX_ELEMENTS = 3  # in a sentence


def measure(options: Options) -> dict[str, Any]:
    """Runs and measures everything; the short study has fewer seeds and only the first scene."""
    asked = read_elements()
    seeds = asked.quick_seeds if options.quick else asked.seeds
    scenes = asked.scene[:1] if options.quick else asked.scene
    codes = installed_codes()
    engines = codes or [VERLET]
    tube = case_of(f"{scenes[0].name}-tube")
    in_tubes = [name for name in codes if inability(tube, name) is None]
    fastest = min(in_tubes or [VERLET], key=lambda name: cost_on(name).run_s(tube))
    pairs = [*switches.pairs_of(asked.model_copy(update={"scene": scenes}), seeds)]
    steps = {scene.name: [*gauge_steps.add_steps(scene, seeds)] for scene in scenes}
    varied = [variant for scene in scenes[:2] for variant in gauge_steps.vary(scene, seeds)]
    jobs: dict[str, list[Case]] = defaultdict(list)
    for engine in engines:
        jobs[engine] += [case for pair in switches.taken_by(engine, pairs) for case in pair.cases]
    for engine, scene in product(in_tubes or [VERLET], scenes):
        jobs[engine] += switches.straight(scene)
        jobs[engine] += [case for cases in switches.in_tube(scene, seeds).values() for case in cases]
    jobs[fastest] += [case for variant in (*chain.from_iterable(steps.values()), *varied) for case in variant.cases]
    done = run_codes({engine: [*dict.fromkeys(cases)] for engine, cases in jobs.items()}, options.runs)
    ran = {(run.case, engine): run for engine, own in done.items() for run in own}
    shown = {name: {variant.step: runs_of(variant, fastest, ran) for variant in own} for name, own in steps.items()}
    return {
        "elements": [*switches.measure_effects(pairs, engines, 0 if options.quick else REPEATS, ran)],
        "elements-checks": switches.omitted_effects(scenes, in_tubes or [VERLET], ran),
        "elements-between": switches.compare_codes(scenes, seeds, in_tubes, ran),
        "oscilloscope": gauge_steps.rows_of(chain(*steps.values(), varied), fastest, ran),
        **{f"oscilloscope-{name}": draw_oscilloscope(name, own) for name, own in shown.items()},
    }


def judge(tables: Tables) -> Iterator[Check]:
    """Do the codes agree in the tube without friction, until the wave reaches the wall?"""
    between = tables["elements-between"]
    for row in between[between["friction"] == switches.WITHOUT_FRICTION].to_dict("records"):
        codes, limit = str(row["codes"]).replace(" ", " and "), tolerance("elements", "codes")
        yield judged(row["scene"], codes, "forces in the tube", row["before_wall"], limit, "before the wall")


def sentences(tables: Tables) -> list[str]:
    """Largest effects, the gap to the experiment, the codes in the tube, omitted elements: a sentence each."""
    checks = rows_in(tables["elements-checks"], Check)
    return [
        *_on_effects(tables["elements"]),
        *_on_gap(tables["oscilloscope"]),
        _on_codes(tables["elements-between"]),
        f"Elements that straight chains omit change nothing: {summary(checks)}.",
    ]


def _on_effects(effects: pd.DataFrame) -> Iterator[str]:
    sizes = largest_effects(effects).groupby("element")["size"].max().nlargest(MAX_ELEMENTS)
    if not sizes.empty:
        yield f"Largest changes: {', '.join(f'{name} {_percent(size)}' for name, size in sizes.items())}."


def _on_gap(numbers: pd.DataFrame) -> Iterator[str]:
    """Share of the gap between the elastic line and the experiment that each step explains, of the first quote."""
    for quote in quotes()[:1]:
        steps = _means(quote, numbers[numbers["value"] == ""]).set_index("step")["mean"]
        if ELASTIC in steps.index:
            shares = (steps - steps[ELASTIC]) / (quote.value - steps[ELASTIC])
            explained = ", ".join(f"{step} {_percent(shares[step])}" for step in steps.index[1:])
            yield (
                f"{quote.scene}, {quote.words}: {steps[ELASTIC]:.3g} {quote.unit} on the elastic line,"
                f" {quote.about}{quote.value:g} {quote.unit} in the experiment; the steps"
                f" explain of this gap: {explained}."
            )


def _means(quote: Quote, numbers: pd.DataFrame) -> pd.DataFrame:
    """Rows of a quoted observable, with the means in the unit of the quote."""
    rows = numbers[(numbers["scene"] == quote.scene) & (numbers["observable"] == quote.observable)]
    return rows.assign(mean=quote.scale * rows["mean"])


def _on_codes(between: pd.DataFrame) -> str:
    worst = between.groupby("friction", sort=False)["before_wall"].max()
    said = ", ".join(f"{short(value)} {friction}" for friction, value in worst.items())
    if not said:
        return "Codes in the tube: not compared, as fewer than two installed codes model tubes."
    return f"Codes in the tube differ, until the wave reaches the wall, by at most {said}."


def _percent(share: float) -> str:
    return f"{100 * share:.0f} %" if np.isfinite(share) else "not visible"


def figures(tables: Tables) -> dict[str, Picture]:
    """Effects with costs, and for each scene the gauges, drawn while measuring."""
    effects = tables["elements"]
    title = "Largest change by each element, and its cost"
    caption = "gauge signals, step by step from the elastic line to the experiment"
    return {"elements": (title, partial(draw_effects, effects))} | {
        f"oscilloscope-{scene}": (f"{scene}: {caption}", None) for scene in effects["scene"].unique()
    }


def section(tables: Tables) -> dict[str, Any]:
    """Rows of tables: effects by scene, steps to the experiment, codes in the tube; True for the short study."""
    effects = tables["elements"]
    observables = list(effects["observable"].unique())
    quoted_here = [quote for quote in quotes() if quote.scene in set(effects["scene"])]
    return {
        "short": not {scene.name for scene in read_elements().scene} <= set(effects["scene"]),
        "observables": observables,
        "effects": {scene: [*effect_rows(rows, observables)] for scene, rows in effects.groupby("scene", sort=False)},
        "quotes": [f"{quote.scene}: {quote.words}, {quote.unit}" for quote in quoted_here],
        "steps": [*_step_rows(quoted_here, tables["oscilloscope"])],
        "between": [*_between_rows(tables["elements-between"])],
    }


def effect_rows(effects: pd.DataFrame, observables: list[str]) -> Iterator[list[str]]:
    """A row for each element: changes in per cent, of codes that agree together."""
    for element, of_element in effects.groupby("element", sort=False):
        engines: dict[tuple[str, ...], list[str]] = defaultdict(list)
        for engine, rows in of_element.groupby("engine", sort=False):
            by_name = rows.set_index("observable").reindex(observables)
            cells = tuple(map(_change, by_name["change"], by_name["spread"]))
            engines[cells].append(str(engine))
        for cells, names in engines.items():
            yield [f"{element} ({', '.join(names)})" if len(engines) > 1 else str(element), *cells]


def _change(change: float, spread: float) -> str:
    if pd.isna(change):
        return "–"
    if abs(change) < ROUNDING:
        return "0"
    return f"{100 * change:+.2g}" + (f" ± {100 * spread:.1g}" if spread > ROUNDING * abs(change) else "")


def _step_rows(shown: Sequence[Quote], numbers: pd.DataFrame) -> Iterator[list[str]]:
    """Quoted observables of the experiment, by step and by value of a parameter."""
    rows: dict[str, list[str]] = {"experiment": [f"{quote.about}{quote.value:g}" for quote in shown]}
    for place, quote in enumerate(shown):
        for row in rows_in(_means(quote, numbers), gauge_steps.StepRow):
            cells = rows.setdefault(f"{row.step} {row.value}".rstrip(), ["–"] * len(shown))
            if np.isfinite(row.mean):
                cells[place] = f"{row.mean:.3g}"
    for name, cells in rows.items():
        yield [name, *cells]


def _between_rows(between: pd.DataFrame) -> Iterator[list[str]]:
    """A row for each scene, friction and pair of codes: differences, and the wall peaks of both."""
    for row in rows_in(between, switches.Between):
        parted = "never" if np.isnan(row.parted_s) else f"{row.parted_s * 1e6:.0f}"
        peaks = (_pm(row.first_peak_N, row.first_spread_N), _pm(row.second_peak_N, row.second_spread_N))
        yield [f"{row.scene} {row.friction}, {row.codes.replace(' ', ' and ')}", short(row.before_wall), parted, *peaks]


def _pm(mean: float, spread: float) -> str:
    return f"{mean:.4g} ± {spread:.1g}" if spread > ROUNDING * abs(mean) else f"{mean:.4g}"


CHAPTER = Chapter(
    name="elements",
    title="effects of elements",
    tables={
        "elements": switches.Effect,
        "elements-checks": Check,
        "elements-between": switches.Between,
        "oscilloscope": gauge_steps.StepRow,
    },
    measure=measure,
    sentences=sentences,
    figures=figures,
    section=section,
    judge=judge,
)
