"""What the page says of one scene."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from drivers.chain.case import Case
from drivers.chain.contact_law import hertz_force
from drivers.chain.trace import Trace
from drivers.engines import in_order, load_engine
from drivers.run.finished import EndedRun
from postproc.draw.spacetime import draw_spacetime
from postproc.draw.style import svg_of
from postproc.read.observables import observe
from postproc.read.residual import REFERENCE
from validation.accuracy.budget import PARTS
from validation.compare.compared_scenes import ComparedScene
from validation.compare.departure import Departure, departure_rows
from validation.compare.verdict import FAIL
from validation.report.charts import Chart, chart_of, failed_label
from validation.report.page_figures import Image, image_of
from validation.report.verdict_table import QUANTITIES, Row, number

FORCE_RANGE = 2.0  # times the largest force of the runs that finished: what is larger would flatten their curves


@dataclass(frozen=True)
class SceneSection:
    """One scene; every list is in the order in which it is shown.

    Attributes:
        row: of the verdict table.
        runs: those that finished.
        chart: None where there is no trace, or neither a gauge nor a second engine; ``chain``: where none finished.
        judged: quantity in words, then by engine the verdict or None.
        budget: quantity, engine and its parts.
        observables: name and its value by each run.
        decks: engine, file, text; also of engines that failed.
    """

    row: Row
    case: Case
    runs: Mapping[str, EndedRun]
    timing: str
    judged: list[tuple[str, list[Any]]]
    chart: Chart | None
    chain: Image | None
    departures: list[tuple[str, Departure]]
    budget: list[tuple[str, str, list[str]]]
    observables: list[tuple[str, list[str]]]
    decks: list[tuple[str, str, str]]


def section_of(scene: ComparedScene, row: Row) -> SceneSection:
    """The section of a compared scene, whose row of the verdict table is ``row``."""
    case = scene.case
    engines = in_order(scene.runs)
    observed = {engine: observe(scene.runs[engine].layout, scene.runs[engine].trace) for engine in engines}
    names = list(next(iter(observed.values()), {}))
    traces = {engine: scene.runs[engine].trace for engine in engines}
    refused = {engine: part_in_range(case, scene.refused[engine], traces) for engine in in_order(scene.refused)}
    chart = chart_of(case.layout, traces, refused) if traces or refused else None
    shown = REFERENCE if REFERENCE in traces else next(iter(traces), "")
    return SceneSection(
        row=row,
        case=case,
        runs={engine: scene.runs[engine] for engine in engines},
        timing=_timing(scene),
        judged=_judged(scene, engines),
        chart=chart if chart and chart.panels else None,
        chain=image_of(svg_of(draw_spacetime({shown: traces[shown]}))) if traces else None,
        departures=_departures(scene),
        budget=_budget(scene, engines),
        observables=[(name, [number(observed[engine][name], 6) for engine in engines]) for name in names],
        decks=_decks(scene, row),
    )


def part_in_range(case: Case, failed: Trace, finished: Mapping[str, Trace]) -> Trace:
    """Forces of a run that failed, at all sample times of its scene; NaN where it has no sample that can be shown.

    Args:
        case: that was run.
        failed: maybe only the first samples, maybe no numbers.
        finished: by engine; where there is none, forces at overlaps of a radius are the largest.
    """
    chain = case.chain
    largest_N = max((float(np.abs(trace.force_N).max()) for trace in finished.values()), default=0.0)
    limit_N = FORCE_RANGE * (largest_N or float(hertz_force(chain.stiffness, chain.smaller_radius_m).max()))
    in_range = np.all(np.abs(failed.force_N) <= limit_N, axis=1)  # not so of NaN
    force_N = np.full((len(case.sample_times_s), failed.force_N.shape[1]), np.nan)
    force_N[: len(in_range)][in_range] = failed.force_N[in_range]
    return replace(failed, time_s=case.sample_times_s, force_N=force_N)


def _timing(scene: ComparedScene) -> str:
    case = scene.case
    words = f"time step {case.scene.time_step_s * 1e6:g} µs, {case.scene.steps} steps, {case.scene.samples} samples"
    limits = [run.record.step_limit_s for run in scene.runs.values() if run.record.step_limit_s]
    if limits:
        share = case.scene.time_step_s / limits[0]
        words += f"; steps up to {limits[0] * 1e6:.3g} µs are stable, of which this is {share:.2g}"
    return words


def _decks(scene: ComparedScene, row: Row) -> list[tuple[str, str, str]]:
    """Engine, file and text of the decks of codes that finished, and of every engine that failed."""
    return [
        (engine, file, text)
        for engine, cell in row.cells.items()
        if (cell.verdict == FAIL if engine in scene.absent else not load_engine(engine).in_repository)
        for file, text in load_engine(engine).render(scene.case).files.items()
    ]


def _departures(scene: ComparedScene) -> list[tuple[str, Departure]]:
    """Of engines that part from the exact motion alike, one line."""
    labels = {name: failed_label(name) if name in scene.refused else name for name in in_order(scene.departures)}
    rows = departure_rows({label: scene.departures[name] for name, label in labels.items()})
    alike: dict[str, list[tuple[str, Departure]]] = {}
    for label, each in rows:
        alike.setdefault(each.words, []).append((label, each))
    return [(", ".join(label for label, _ in same), same[0][1]) for same in alike.values()]


def _judged(scene: ComparedScene, engines: list[str]) -> list[tuple[str, list[Any]]]:
    """Every verdict on a finished run, a line for each quantity."""
    own = {(v.quantity, v.engine): v for v in scene.verdicts if v.engine in engines}
    names = dict.fromkeys([*(name for name in QUANTITIES), *(quantity for quantity, _ in own)])
    seen = {quantity for quantity, _ in own}
    return [(QUANTITIES.get(name, name), [own.get((name, e)) for e in engines]) for name in names if name in seen]


def _budget(scene: ComparedScene, engines: list[str]) -> list[tuple[str, str, list[str]]]:
    """Lines of the error budget by quantity and engine: the whole and its parts, which add up to it."""
    lines = [
        (part["quantity"], engine, [f"{part[key]:.1e}" for key in PARTS])
        for engine in engines
        for part in scene.runs[engine].record.error_budget or ()
    ]
    order = list(dict.fromkeys(quantity for quantity, _, _ in lines))
    return sorted(lines, key=lambda line: order.index(line[0]))
