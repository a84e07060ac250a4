"""Effect and cost of each modelled element, and a check that elements which straight chains omit change nothing.

Every scene runs with and without each element of ``inputs/elements.toml`` on the codes. A straight chain runs again
with lateral freedom, tube and friction, which must change nothing.
"""

from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from itertools import product
from math import inf
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.ticker import LogLocator, NullFormatter, StrMethodFormatter
from pydantic import Field

from drivers.base import paths
from drivers.base.messages import validate
from drivers.base.terminal import following
from drivers.base.tolerances import tolerance
from drivers.chain.case import Case
from drivers.chain.trace import residual
from drivers.engines import VERLET, installed_codes
from drivers.limits import inability
from drivers.run.compute import compute
from drivers.scene.model import Part
from drivers.scene.read_scene import read_toml
from postproc.draw.plot import GREY, PAGE_IN, marker_of, pyplot
from postproc.read.motion import Simulation, case_of, run_codes
from validation.chapters import Options
from validation.checks import Check, judged, summary
from validation.report.parts import Chapter, Shown

REPEATS = 3  # further runs for costs, except in the short study
ROUNDING = 1e-6  # of a mean: a smaller spread counts as none
MAX_ELEMENTS = 3  # in a sentence
SCATTER = "scatter"  # in a setting: replaced by the scene's value
COLUMNS = (
    "scene", "element", "engine", "observable", "without", "with", "change", "spread", "seeds", "cost_ns", "cost_ratio",
)  # fmt: skip
MIN_CHANGE = 1e-6  # smaller changes are drawn here
OMITTED = "elements that straight chains omit"
Found = Mapping[tuple[Case, str], Simulation]  # all runs of the study, by case and engine


class Side(Part):
    """Settings of a scene with or without an element; ``tube``: the scene in a tube, with the settings ``set``."""

    tube: bool = False
    set: tuple[str, ...] = Field(default=(), strict=False)


class Element(Part):
    """A switched element; ``random``: repeated for every seed; ``only``: names of the scenes that have it.

    ``of`` names the element of which this is a variant: variants show how uncertain its effect is.
    """

    name: str
    of: str = ""
    without: Side
    with_: Side = Field(alias="with")
    random: bool = False
    only: tuple[str, ...] = Field(default=(), strict=False)


class SwitchedScene(Part):
    """A scene with its sensors and the scatter of its masses; in a tube the scene is ``NAME-tube``."""

    name: str
    scatter: str
    gauges: str


class Elements(Part):
    """The file ``inputs/elements.toml``."""

    seeds: int
    quick_seeds: int
    scene: tuple[SwitchedScene, ...] = Field(strict=False)
    element: tuple[Element, ...] = Field(strict=False)


IN_TUBE = {"tube": True, "set": ("chain.lateral_offset=0 um",)}
STRAIGHT = Element.model_validate({"name": OMITTED, "without": {}, "with": IN_TUBE})


@dataclass(frozen=True)
class Switched:
    """Cases of all seeds of a scene without an element, then with it."""

    scene: str
    element: str
    cases: Sequence[Case]


def read_elements() -> Elements:
    """Reads ``inputs/elements.toml``."""
    return validate(Elements, read_toml(paths.ELEMENTS), paths.shown(paths.ELEMENTS))


def pairs_of(
    engine: str, scenes: Iterable[SwitchedScene], elements: Iterable[Element], seeds: int
) -> Iterator[Switched]:
    """Cases without and with each element, for all scenes and seeds, that an engine can run on both sides."""
    for subject, switch in product(scenes, elements):
        if not switch.only or subject.name in switch.only:
            sides = product((switch.without, switch.with_), range(1, (seeds if switch.random else 1) + 1))
            cases = [case_on(subject, side, seed) for side, seed in sides]
            if not any(inability(case, engine) for case in cases):
                yield Switched(subject.name, switch.name, cases)


@cache
def case_on(subject: SwitchedScene, side: Side, seed: int) -> Case:
    """Case of a scene with the settings of one side."""
    settings = [setting.replace(f"={SCATTER}", f"={subject.scatter}") for setting in side.set]
    source = f"{subject.name}-tube" if side.tube else subject.name
    return case_of(source, f"chain.sensors={subject.gauges}", f"seed={seed}", *settings)


def observables_of(case: Case) -> dict[str, str]:
    """Compared observables by label: speed, peak and width at the gauges, peak and arrival at the wall."""
    upper, lower = (sensor.from_wall for sensor in case.layout.sensors)
    return {
        "speed": f"speed_{upper}_to_{lower}_m_s",
        "sensor peak": f"bead_{upper}_peak_N",
        "wall peak": "wall_peak_N",
        "width": f"bead_{lower}_width_4pct_diameters",
        "arrival": "wall_arrival_s",
    }


def measure_effects(taken: Mapping[str, Sequence[Switched]], repeats: int, ran: Found) -> pd.DataFrame:
    """Effects of all elements by each code on the pairs that it can model, a row for each observable.

    ``without`` and ``with`` are means over the ``seeds``; ``change`` and ``spread`` are mean and standard deviation of
    their relative changes, with a NaN spread for a single run. ``cost_ns`` is the loop time with the element per body
    and step, on the first scene, ``cost_ratio`` that time divided by the loop time without.
    """
    rows = []
    for engine, pairs in taken.items():
        costs = _costs([pair for pair in pairs if pair.scene == pairs[0].scene], engine, repeats, ran)
        for pair in pairs:
            runs, (cost_without, cost) = [ran[case, engine] for case in pair.cases], costs[pair.element]
            for word, name in observables_of(pair.cases[0]).items():
                without, with_ = np.split(np.array([run.values[name] for run in runs]), 2)
                changes = pd.Series(with_ / without - 1)
                effect = without.mean(), with_.mean(), changes.mean(), changes.std(), len(changes)
                rows.append((pair.scene, pair.element, engine, word, *effect, cost, cost / cost_without))
    return pd.DataFrame(rows, columns=COLUMNS)


def _costs(pairs: Sequence[Switched], engine: str, repeats: int, ran: Found) -> dict[str, tuple[float, float]]:
    """Loop time in ns per body and step without and with each element: the least of all seeds and repetitions.

    The runs of the study are parallel; the repetitions, of the first seed, run one after the other.
    """
    loops_s = {case: ran[case, engine].loop_s for pair in pairs for case in pair.cases}
    repeated = {case for pair in pairs for case in (pair.cases[0], pair.cases[len(pair.cases) // 2])}
    what = f"costs on {engine}, one run after the other"
    for case in following([*repeated] * repeats, what, len(repeated) * repeats):
        ended = compute(case, engine)
        loops_s[case] = min(loops_s[case], ended.loop_s if ended.done and ended.loop_s else inf)
    costs = {}
    for pair in pairs:
        cases_ns = [loops_s[case] / case.work * 1e9 for case in pair.cases]
        costs[pair.element] = tuple(np.reshape(cases_ns, (2, -1)).min(axis=1).tolist())
    return costs


def omitted_effects(taken: Mapping[str, Sequence[Switched]], ran: Found) -> Iterator[Check]:
    """Do straight chains omit only what has no effect? Differences divided by the largest change of force."""
    for engine, pair in ((engine, pair) for engine, pairs in taken.items() for pair in pairs):
        one, other = (ran[case, engine].trace for case in pair.cases)
        change, place = float(residual(other, one).max()), "straight chain against one with lateral freedom in its tube"
        yield judged(pair.scene, engine, OMITTED, change, tolerance("elements", "nothing"), place)


def measure(options: Options) -> Chapter:
    """Run and measure everything; the short study has fewer seeds and only the first scene."""
    asked = read_elements()
    seeds = asked.quick_seeds if options.quick else asked.seeds
    scenes = asked.scene[:1] if options.quick else asked.scene
    engines = installed_codes() or [VERLET]
    taken = {engine: [*pairs_of(engine, scenes, asked.element, seeds)] for engine in engines}
    omitted = {engine: [*pairs_of(engine, scenes, [STRAIGHT], 1)] for engine in engines}
    jobs = {}
    for engine in engines:
        cases = (case for pair in (*taken[engine], *omitted[engine]) for case in pair.cases)
        jobs[engine] = [*dict.fromkeys(cases)]
    ran = {(run.case, engine): run for engine, own in run_codes(jobs, options.runs).items() for run in own}
    effects = measure_effects(taken, 0 if options.quick else REPEATS, ran)
    checks = [*omitted_effects(omitted, ran)]
    sizes = largest_effects(effects).groupby("element")["size"].max().nlargest(MAX_ELEMENTS)
    findings = [
        f"Largest changes: {', '.join(f'{name} {100 * size:.0f} %' for name, size in sizes.items())}.",
        f"Elements that straight chains omit change nothing: {summary(checks)}.",
    ]
    return Chapter(
        {"elements": effects, "elements-checks": pd.DataFrame(checks)},
        findings,
        {"elements": ("Largest change by each element, and its cost", draw_effects(effects))},
        [show_effects(str(scene), of_scene) for scene, of_scene in effects.groupby("scene", sort=False)],
        checks,
        short=options.quick,
    )


def largest_effects(effects: pd.DataFrame) -> pd.DataFrame:
    """Largest change of an observable over the scenes, and the ratio of costs, by element and engine.

    Elements from the largest to the smallest effect, each followed by its variants.
    """
    worst = effects.assign(size=effects["change"].abs()).groupby(["element", "engine"], sort=False)
    table = worst.agg(size=("size", "max"), cost=("cost_ratio", "median")).reset_index()
    parents = {item.name: item.of or item.name for item in read_elements().element}
    parent, sizes = table["element"].map(parents), table.groupby("element")["size"].max()
    keys = {"rank": -parent.map(sizes), "parent": parent, "own": parent != table["element"]}
    return table.assign(**keys).sort_values([*keys], kind="stable").drop(columns=["rank", "parent", "own"])


def draw_effects(effects: pd.DataFrame) -> Any:
    """Draws a row for each element: its largest change by code; to the right its cost."""
    table = largest_effects(effects)
    names, variants = list(table["element"].unique()), {item.name for item in read_elements().element if item.of}
    figure, (left, right) = pyplot().subplots(
        1, 2, figsize=(PAGE_IN, 0.8 + 0.19 * len(names)), sharey=True, width_ratios=(3, 2), layout="constrained"
    )
    for engine, rows in table.groupby("engine", sort=False):
        places, mark = rows["element"].map(names.index), marker_of(str(engine))
        left.plot(rows["size"].clip(lower=MIN_CHANGE), places, ls="", **mark)
        right.plot(rows["cost"], places, ls="", label=engine, **mark)
    right.axvline(1.0, color=GREY, lw=0.8)
    left.set(xscale="log", xlabel=f"largest relative change, all scenes ({MIN_CHANGE:.0e} or less: none)")
    right.set(xscale="log", xlabel="time with / without the element")
    right.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    right.xaxis.set_major_formatter(StrMethodFormatter("{x:g}"))
    right.xaxis.set_minor_formatter(NullFormatter())
    labels = [f"variant: {name}" if name in variants else name for name in names]
    left.set_yticks(range(len(names)), labels)
    left.invert_yaxis()
    figure.legend(*right.get_legend_handles_labels(), loc="outside upper right", ncols=5, fontsize=7)
    return figure


def show_effects(scene: str, effects: pd.DataFrame) -> Shown:
    """Changes on a scene in per cent: a row for each element, of codes that agree together."""
    observables, rows = list(effects["observable"].unique()), []
    for element, of_element in effects.groupby("element", sort=False):
        engines: dict[tuple[str, ...], list[str]] = defaultdict(list)
        for engine, of_engine in of_element.groupby("engine", sort=False):
            by_name = of_engine.set_index("observable").reindex(observables)
            engines[tuple(map(_change, by_name["change"], by_name["spread"]))].append(str(engine))
        for cells, names in engines.items():
            rows.append([f"{element} ({', '.join(names)})" if len(engines) > 1 else str(element), *cells])
    return Shown(
        f"{scene}: change of each observable in per cent",
        "With the standard deviation over seeds for random elements; codes that differ have rows of their own.",
        pd.DataFrame(rows, columns=["element", *observables]),
    )


def _change(change: float, spread: float) -> str:
    if pd.isna(change):
        return "–"
    if abs(change) < ROUNDING:
        return "0"
    return f"{100 * change:+.2g}" + (f" ± {100 * spread:.1g}" if spread > ROUNDING * abs(change) else "")
