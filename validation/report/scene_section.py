"""The verdict table, scenes and independent cases down, engines across; what the page says of one scene."""

import math
import shlex
from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from drivers.base import paths
from drivers.base.command_line import engines_again
from drivers.base.errors import InputError
from drivers.chain.case import Case
from drivers.chain.contact_law import hertz_force
from drivers.chain.trace import Trace
from drivers.engines import REFERENCE, in_order, load_engine
from drivers.run.finished import EndedRun
from drivers.scene.model import Scene
from postproc.draw.overlay import HEADINGS, draw_overlay, misfit_rows
from postproc.draw.product import draw_spacetime
from postproc.draw.style import svg_of
from postproc.read.misfit import lay_over
from postproc.read.observables import observe
from validation.accuracy.budget import PARTS
from validation.compare.comparison import ComparedScene
from validation.compare.departure import departure_rows
from validation.compare.verdict import FAIL, NOT_RUN, PASS, Verdict, share_of
from validation.report.charts import Chart, chart_of, failed_label
from validation.report.page_figures import Image, image_of

QUANTITIES = {
    "force against verlet": "model: force against the same scheme",
    "motion against verlet": "model: kinetic energy and momentum, likewise",
    "force against reference": "truncation: force against the exact reference",
    "peak of a gauge": "peak of a gauge",
    "speed between gauges": "speed between gauges",
    "energy drift": "energy drift",
    "impulse balance": "impulse balance",
}


@dataclass(frozen=True)
class Cell:
    """What one engine makes of one scene."""

    engine: str
    verdict: str
    worst: Verdict | None  # nearest to its tolerance, or passes it by most; None where nothing was measured
    note: str  # why it is not run or has no numbers
    verdicts: list[Verdict]
    cost: str = ""
    diagnosis: str = ""  # what a run that is off matches
    wall_s: float = 0.0  # of its runs

    @property
    def misses(self) -> list[Verdict]:
        """What failed."""
        return [verdict for verdict in self.verdicts if verdict.verdict == FAIL]


@dataclass(frozen=True)
class Row:
    """A scene or an independent case on all engines; ``again`` is the command that shows more of it."""

    name: str
    title: str
    again: str
    cells: dict[str, Cell]


def scene_row(scene: ComparedScene, runs: Path | None = None) -> Row:
    """The row of a compared scene, whose run folders are in ``runs`` where that is not the usual place."""
    cells = {}
    for engine in in_order([*scene.runs, *scene.absent]):
        own = [verdict for verdict in scene.verdicts if verdict.engine == engine]
        cost = ""
        if engine in scene.runs:
            record = scene.runs[engine].record
            loop = f", loop {1e3 * record.loop_s:.0f} ms" if record.loop_s is not None else ""
            cost = f"run {record.wall_s:.2f} s{loop}"
        note, diagnosis = scene.absent.get(engine, ""), scene.diagnoses.get(engine, "")
        cells[engine] = _cell(engine, own, note, scene.wall_s.get(engine, 0.0), cost, diagnosis)
    told = scene.case.scene
    options = [*(["--runs", str(runs)] if runs else []), *engines_again()]
    again = " ".join(["python -m validation compare", source_of(told), *map(shlex.quote, options)])
    return Row(told.name, told.title or told.name, again, cells)


def case_rows(independent: Mapping[str, Any]) -> list[Row]:
    """The rows of independent cases, of the section on them."""
    rows = []
    for entry in (case["entry"] for case in independent.get("cases", [])):
        of_case = [verdict for verdict in independent["verdicts"] if verdict.scene == entry.id]
        cells = {}
        for engine in in_order({verdict.engine for verdict in of_case}):
            own = [verdict for verdict in of_case if verdict.engine == engine]
            note = next((verdict.where for verdict in own if math.isnan(verdict.limit)), "")
            cells[engine] = _cell(engine, own, note, independent["wall_s"][entry.id, engine])
        rows.append(Row(entry.id, entry.title, "python -m validation independent", cells))
    return rows


def counted(rows: Iterable[Row]) -> Counter[str]:
    """How many cells passed, failed and were not run."""
    return Counter(cell.verdict for row in rows for cell in row.cells.values())


def worst_of(verdicts: list[Verdict]) -> Verdict | None:
    """The figure with the largest share of its tolerance; one that is no number is the worst of all."""
    measured = [verdict for verdict in verdicts if not math.isnan(verdict.limit)]
    return max(measured, key=lambda verdict: (verdict.verdict == FAIL, share_of(verdict)), default=None)


def tolerances(scenes: list[ComparedScene]) -> list[tuple[str, str, list[str], str]]:
    """Quantity, limits, scenes and reason of every tolerance that was applied, those of one reason together."""
    used: dict[tuple[str, str], list[Verdict]] = {}
    for verdict in (v for scene in scenes for v in scene.verdicts if not math.isnan(v.limit)):
        used.setdefault((QUANTITIES.get(verdict.quantity, verdict.quantity), verdict.reason), []).append(verdict)
    rows = []
    for (quantity, reason), found in sorted(used.items()):
        limits = dict.fromkeys(number(choose(each.limit for each in found)) for choose in (min, max))
        rows.append((quantity, " to ".join(limits), list(dict.fromkeys(each.scene for each in found)), reason))
    return rows


def source_of(scene: Scene) -> str:
    """A scene as a command line takes it: its name where it is shipped, else its file."""
    shipped = paths.SCENES / f"{scene.name}.toml"
    same = shipped.is_file() and scene.file and (paths.ROOT / scene.file).resolve() == shipped.resolve()
    return scene.name if same or scene.file == scene.name else shlex.quote(scene.file)


def number(value: float, digits: int = 2) -> str:
    """A number for people; a dash for what was not seen."""
    return "–" if math.isnan(value) else f"{value:.{digits}g}"


def short(value: float) -> str:
    """Two digits and a power of ten, without the zeros that nobody reads; a dash for what is no number."""
    if not math.isfinite(value):
        return "–" if math.isnan(value) else "∞"
    digits, _, power = f"{value:.1e}".partition("e")
    return f"{digits}e{int(power)}" if int(power) else digits


def _cell(engine: str, own: list[Verdict], note: str, wall_s: float, cost: str = "", diagnosis: str = "") -> Cell:
    found = {verdict.verdict for verdict in own}
    verdict = FAIL if FAIL in found else NOT_RUN if NOT_RUN in found else PASS
    return Cell(engine, verdict, worst_of(own), note, own, cost, diagnosis, wall_s)


@dataclass(frozen=True)
class MeasuredOverlay:
    """A scene's measured traces over computed ones: the picture, and a row for each quantity.

    Attributes:
        image: None where only values are quoted.
        problem: why the traces cannot be laid over the computed ones, in words; empty where they can.
    """

    engine: str
    image: Image | None
    headings: tuple[str, ...]
    rows: list[tuple[str, ...]]
    problem: str = ""


def overlay_of(case: Case, engine: str, trace: Trace) -> MeasuredOverlay:
    """The overlay of a scene that has measured traces or quoted values, on an engine's run."""
    scene = case.scene
    entries = {f"measured.{place}": entry for place, entry in enumerate(scene.measured)}
    try:
        curves, found = lay_over(entries, scene.folder, scene.file, case.layout, trace)
    except InputError as error:  # what is wrong with the file alone is said before anything runs
        return MeasuredOverlay(engine, None, HEADINGS, [], str(error))
    drawn = draw_overlay(case.layout, trace, engine, curves, found) if curves else None
    return MeasuredOverlay(engine, image_of(svg_of(drawn.figure)) if drawn else None, HEADINGS, misfit_rows(found))


FORCE_RANGE = 2.0  # times the largest force of the runs that finished: what is larger would flatten their curves


@dataclass(frozen=True)
class SceneSection:
    """One scene; every list is in the order in which it is shown.

    Attributes:
        row: of the verdict table.
        runs: those that finished.
        overlay: measured traces over the exact motion, or over that of the first engine; None without any.
        chart: None where there is no trace, or neither a gauge nor a second engine; ``chain``: where none finished.
        judged: of every verdict on a finished run: quantity in words, then by engine the verdict or None.
        budget: quantity, engine, the whole error and its parts, which add up to it.
        observables: name and its value by each run.
        decks: engine, file, text: of codes that finished, and of every engine that failed.
    """

    row: Row
    case: Case
    runs: Mapping[str, EndedRun]
    timing: str
    judged: list[tuple[str, list[Any]]]
    chart: Chart | None
    overlay: MeasuredOverlay | None
    chain: Image | None
    departures: list[tuple[str, str]]
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
    own = {(v.quantity, v.engine): v for v in scene.verdicts if v.engine in engines}
    seen = dict.fromkeys(quantity for quantity, _ in own)
    judged = [name for name in dict.fromkeys([*QUANTITIES, *seen]) if name in seen]
    budget = [
        (part["quantity"], engine, [f"{part[key]:.1e}" for key in PARTS])
        for engine in engines
        for part in scene.runs[engine].record.error_budget or ()
    ]
    step_s = case.scene.time_step_s
    timing = f"time step {step_s * 1e6:g} µs, {case.scene.steps} steps, {case.scene.samples} samples"
    if limits := [run.record.step_limit_s for run in scene.runs.values() if run.record.step_limit_s]:
        timing += f"; steps up to {limits[0] * 1e6:.3g} µs are stable, of which this is {step_s / limits[0]:.2g}"
    order = list(dict.fromkeys(quantity for quantity, _, _ in budget))
    return SceneSection(
        row=row,
        case=case,
        runs={engine: scene.runs[engine] for engine in engines},
        timing=timing,
        judged=[(QUANTITIES.get(name, name), [own.get((name, e)) for e in engines]) for name in judged],
        chart=chart if chart and chart.panels else None,
        overlay=overlay_of(case, shown, traces[shown]) if traces and case.scene.measured else None,
        chain=image_of(svg_of(draw_spacetime({shown: traces[shown]}).figure)) if traces else None,
        departures=_departures(scene),
        budget=sorted(budget, key=lambda line: order.index(line[0])),
        observables=[(name, [number(observed[engine][name], 6) for engine in engines]) for name in names],
        decks=[
            (engine, file, text)
            for engine, cell in row.cells.items()
            if (cell.verdict == FAIL if engine in scene.absent else not load_engine(engine).in_repository)
            for file, text in load_engine(engine).render(case).files.items()
        ],
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


def _departures(scene: ComparedScene) -> list[tuple[str, str]]:
    """Engines that part from the exact motion alike, and how."""
    labels = {name: failed_label(name) if name in scene.refused else name for name in in_order(scene.departures)}
    alike: dict[str, list[str]] = {}
    for label, each in departure_rows({label: scene.departures[name] for name, label in labels.items()}):
        alike.setdefault(each.words, []).append(label)
    return [(", ".join(same), words) for words, same in alike.items()]
