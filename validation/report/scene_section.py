"""Rows of the verdict tables, and the page's section on a scene."""

import math
import shlex
from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from drivers.base import paths
from drivers.base.decks import Deck
from drivers.base.errors import InputError
from drivers.base.progress import in_words
from drivers.chain.case import Case
from drivers.chain.contact_law import hertz_force
from drivers.chain.trace import Trace
from drivers.engines import REFERENCE, in_order, load_engine
from drivers.engines._entries import engines_again
from drivers.limits.refusal import FORCE
from drivers.run.run_folder import EndedRun
from drivers.scene.model import Scene
from postproc.draw.gauge_forces import MAX_GAUGES, draw_gauge_forces, failed_label
from postproc.draw.overlay import HEADINGS, draw_overlay, misfit_rows
from postproc.draw.product import draw_spacetime
from postproc.draw.style import svg_of
from postproc.read.misfit import lay_over
from postproc.read.observables import observe
from postproc.read.sensors import gauges_of
from validation.accuracy.budget import ERROR, PARTS
from validation.checks import FAIL, Check, outcome, short, worst_of
from validation.compare.comparison import ComparedScene
from validation.report.page_figures import Image, image_of

EXACT_FORCE = f"{ERROR}: {FORCE}"  # quantity of a check


@dataclass(frozen=True)
class Cell:
    """Checks of one engine on one scene or independent case."""

    engine: str
    checks: list[Check]
    note: str = ""  # reason for a missing run or missing numbers
    loop_s: float | None = None  # computing time of the code's own loop
    run_s: float | None = None  # wall time of the judged run
    diagnosis: str = ""  # measured law of a wrong run

    @property
    def verdict(self) -> str:
        """Outcome of the checks."""
        return outcome(self.checks)

    @property
    def worst(self) -> Check | None:
        """Check closest to its limit, or furthest beyond; None if nothing was measured."""
        return worst_of(self.checks)

    @property
    def error(self) -> float | None:
        """Largest force error against the exact motion; None if it was not judged."""
        return next((check.value for check in self.checks if check.quantity == EXACT_FORCE), None)

    @property
    def cost(self) -> str:
        """Times of the run and of its loop; empty without a run."""
        loop = f", loop {in_words(self.loop_s)}" if self.loop_s is not None else ""
        return f"run {in_words(self.run_s)}{loop}" if self.run_s is not None else ""

    @property
    def misses(self) -> list[Check]:
        """Failed checks."""
        return [check for check in self.checks if check.verdict == FAIL]


@dataclass(frozen=True)
class ReportRow:
    """A scene or an independent case on all engines; the command ``again`` prints more details."""

    name: str
    title: str
    again: str
    cells: dict[str, Cell]


def scene_row(scene: ComparedScene, runs: Path | None = None) -> ReportRow:
    """Row of a compared scene; ``runs`` is the folder of its run folders if not the default."""
    cells = {}
    for engine in in_order([*scene.runs, *scene.absent]):
        record = scene.runs[engine].record if engine in scene.runs else None
        cells[engine] = Cell(
            engine,
            scene.of_engine(engine),
            note=scene.absent.get(engine, ""),
            loop_s=record.loop_s if record else None,
            run_s=record.wall_s if record else None,
            diagnosis=scene.diagnoses.get(engine, ""),
        )
    own = scene.case.scene
    options = [*(["--runs", str(runs)] if runs else []), *engines_again()]
    again = " ".join(["beads compare", source_of(own), *map(shlex.quote, options)])
    return ReportRow(own.name, own.title or own.name, again, cells)


def case_rows(independent: Mapping[str, Any]) -> list[ReportRow]:
    """Rows of the independent cases, from the section on them."""
    rows = []
    for entry in (case["entry"] for case in independent.get("cases", [])):
        checks = [check for check in independent["checks"] if check.scene == entry.id]
        cells = {}
        for engine in in_order({check.engine for check in checks}):
            of_engine = [check for check in checks if check.engine == engine]
            note = next((check.where for check in of_engine if math.isnan(check.limit)), "")
            cells[engine] = Cell(engine, of_engine, note)
        rows.append(ReportRow(entry.id, entry.title, "beads independent", cells))
    return rows


def counted(rows: Iterable[ReportRow]) -> Counter[str]:
    """Numbers of cells that passed, failed and were not run."""
    return Counter(cell.verdict for row in rows for cell in row.cells.values())


def tolerances(scenes: list[ComparedScene]) -> list[tuple[str, str, list[str], str]]:
    """Quantity, limits, scenes and reason of every applied tolerance; limits with the same reason share a row."""
    used: dict[tuple[str, str], list[Check]] = {}
    for check in (check for scene in scenes for check in scene.checks if not math.isnan(check.limit)):
        used.setdefault((check.quantity, check.reason), []).append(check)
    rows = []
    for (quantity, reason), found in sorted(used.items()):
        limits = dict.fromkeys(number(choose(each.limit for each in found)) for choose in (min, max))
        rows.append((quantity, " to ".join(limits), list(dict.fromkeys(each.scene for each in found)), reason))
    return rows


def source_of(scene: Scene) -> str:
    """Argument that names a scene on a command line: its name if shipped, else its file."""
    shipped = paths.SCENES / f"{scene.name}.toml"
    same = shipped.is_file() and scene.file and (paths.ROOT / scene.file).resolve() == shipped.resolve()
    return scene.name if same or scene.file == scene.name else shlex.quote(scene.file)


def number(value: float, digits: int = 2) -> str:
    """Rounded number as text; a dash for NaN."""
    return "–" if math.isnan(value) else f"{value:.{digits}g}"


@dataclass(frozen=True)
class MeasuredOverlay:
    """Measured traces of a scene over computed traces: a picture, and a row for each quantity.

    Attributes:
        image: None if only values are quoted.
        problem: message if the measured traces do not fit the run; else empty.
    """

    engine: str
    image: Image | None
    headings: tuple[str, ...]
    rows: list[tuple[str, ...]]
    problem: str = ""


def overlay_of(case: Case, engine: str, trace: Trace) -> MeasuredOverlay:
    """Overlay of a scene's measured traces or quoted values on the run of an engine."""
    scene = case.scene
    entries = {f"measured.{place}": entry for place, entry in enumerate(scene.measured)}
    try:
        curves, found = lay_over(entries, scene.folder, scene.file, case.layout, trace)
    except InputError as error:  # the file was read before; it does not fit the run
        return MeasuredOverlay(engine, None, HEADINGS, [], str(error))
    drawn = draw_overlay(case.layout, trace, engine, curves, found) if curves else None
    return MeasuredOverlay(engine, image_of(svg_of(drawn.figure)) if drawn else None, HEADINGS, misfit_rows(found))


FORCE_RANGE = 2.0  # largest drawn force of a failed run, over the largest force of the finished runs


@dataclass(frozen=True)
class SceneSection:
    """Section on one scene; lists are in the order of the page.

    Attributes:
        row: of the verdict table.
        runs: finished runs by engine.
        timing: time step, samples and stability in a sentence.
        judged: quantity, and the check of each finished run or None.
        forces: forces on the gauges and differences; None without a trace, or without both a gauge and a second engine.
        left_out: number of gauges without a panel.
        overlay: measured traces over the exact motion, or over the first engine without it; None without traces.
        chain: forces of all contacts in space and time; None if no run finished.
        departures: engines, and when their runs first depart from their schemes.
        budget: quantity, engine, and the whole error followed by its parts.
        observables: name, and the value of each run.
        decks: engine, file and text, of finished codes and of all failed engines.
    """

    row: ReportRow
    case: Case
    runs: Mapping[str, EndedRun]
    timing: str
    judged: list[tuple[str, list[Any]]]
    forces: Image | None
    left_out: int
    overlay: MeasuredOverlay | None
    chain: Image | None
    departures: list[tuple[str, str]]
    budget: list[tuple[str, str, list[str]]]
    observables: list[tuple[str, list[str]]]
    decks: list[tuple[str, str, str]]


def section_of(scene: ComparedScene, row: ReportRow) -> SceneSection:
    """Section on a compared scene with its row of the verdict table."""
    case = scene.case
    engines = in_order(scene.runs)
    observed = {engine: observe(scene.runs[engine].layout, scene.runs[engine].trace) for engine in engines}
    names = list(next(iter(observed.values()), {}))
    traces = {engine: scene.runs[engine].trace for engine in engines}
    shown = _shown(scene)
    checks = {(check.quantity, check.engine): check for check in scene.checks if check.engine in engines}
    budget = [
        (part["quantity"], engine, [short(part[key]) for key in PARTS])
        for engine in engines
        for part in scene.runs[engine].record.error_budget or ()
    ]
    step_s = case.scene.time_step_s
    timing = f"time step {step_s * 1e6:g} µs, {case.scene.steps} steps, {case.scene.samples} samples"
    if limits := [run.record.step_limit_s for run in scene.runs.values() if run.record.step_limit_s]:
        timing += f"; stable up to {limits[0] * 1e6:.3g} µs, this run uses {100 * step_s / limits[0]:.2g} % of that"
    order = list(dict.fromkeys(quantity for quantity, _, _ in budget))
    return SceneSection(
        row=row,
        case=case,
        runs={engine: scene.runs[engine] for engine in engines},
        timing=timing,
        judged=[(name, [checks.get((name, e)) for e in engines]) for name in dict.fromkeys(name for name, _ in checks)],
        forces=forces_picture(scene),
        left_out=max(0, len(gauges_of(case.layout)) - MAX_GAUGES),
        overlay=overlay_of(case, shown, traces[shown]) if traces and case.scene.measured else None,
        chain=_chain_picture(scene),
        departures=_departures(scene),
        budget=sorted(budget, key=lambda line: order.index(line[0])),
        observables=[(name, [number(observed[engine][name], 6) for engine in engines]) for name in names],
        decks=[
            (engine, file, text)
            for engine, cell in row.cells.items()
            if (cell.verdict == FAIL if engine in scene.absent else not load_engine(engine).in_repository)
            for file, text in _written_deck(case, engine).files.items()
        ],
    )


def _shown(scene: ComparedScene) -> str:
    """Engine whose run is shown alone: the exact motion, else the first engine; empty if no run finished."""
    return REFERENCE if REFERENCE in scene.runs else next(iter(in_order(scene.runs)), "")


@cache  # the page is written after each chapter
def forces_picture(scene: ComparedScene, gauges: int = MAX_GAUGES) -> Image | None:
    """Forces on the gauges and differences; None without a trace, or without both a gauge and a second engine."""
    traces = {engine: scene.runs[engine].trace for engine in in_order(scene.runs)}
    refused = {engine: part_in_range(scene.case, scene.refused[engine], traces) for engine in in_order(scene.refused)}
    if not (traces or refused):
        return None
    figure = draw_gauge_forces(scene.case.layout, traces, refused, gauges)
    return image_of(svg_of(figure)) if figure else None


@cache
def _chain_picture(scene: ComparedScene) -> Image | None:
    """Forces of all contacts in space and time; None if no run finished."""
    shown = _shown(scene)
    return image_of(svg_of(draw_spacetime({shown: scene.runs[shown].trace}).figure)) if shown else None


def _written_deck(case: Case, name: str) -> Deck:
    engine = load_engine(name)
    return engine.deck_by_hand(engine.render(case))


def part_in_range(case: Case, failed: Trace, finished: Mapping[str, Trace]) -> Trace:
    """Forces of a failed run at all sample times of its scene, NaN for missing samples and forces out of range.

    Args:
        case: of the run.
        failed: trace with the first samples or all, maybe with NaN.
        finished: traces by engine; without any, the range is that of forces at an overlap of a radius.
    """
    chain = case.chain
    largest_N = max((float(np.abs(trace.force_N).max()) for trace in finished.values()), default=0.0)
    limit_N = FORCE_RANGE * (largest_N or float(hertz_force(chain.stiffness, chain.smaller_radius_m).max()))
    in_range = np.all(np.abs(failed.force_N) <= limit_N, axis=1)  # false for NaN
    force_N = np.full((len(case.sample_times_s), failed.force_N.shape[1]), np.nan)
    force_N[: len(in_range)][in_range] = failed.force_N[in_range]
    return replace(failed, time_s=case.sample_times_s, force_N=force_N)


def _departures(scene: ComparedScene) -> list[tuple[str, str]]:
    """Engines that depart from their schemes in the same way, with a sentence."""
    groups: dict[str, list[str]] = {}
    for engine, departure in scene.departures.items():
        groups.setdefault(departure, []).append(failed_label(engine) if engine in scene.refused else engine)
    return [(", ".join(same), departure) for departure, same in groups.items()]
