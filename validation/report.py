"""The report: one self-contained page with a verdict table first, then every scene."""

import datetime
import math
from collections import Counter
from dataclasses import dataclass
from pathlib import Path

from drivers import deck, paths
from drivers.engines import load_engine
from drivers.record import provenance
from drivers.whole_file import whole_file
from postproc.observables import observe
from postproc.style import inline_svg
from validation.claims.section import read_section
from validation.elements.section import read_section as read_elements
from validation.plots import draw_chain, draw_scene
from validation.scenes import ComparedScene
from validation.stability.section import read_section as read_stability
from validation.trade.section import read_section as read_trade
from validation.verdict import FAIL, NOT_RUN, PASS, Verdict

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
class Row:
    """One line of the verdict table: a scene on an engine.

    Attributes:
        cells: verdict by quantity; None where it does not apply.
        note: why it is not run or failed.
    """

    scene: str
    title: str
    engine: str
    verdict: str
    cells: dict[str, Verdict | None]
    note: str
    cost: str


def write_report(scenes: list[ComparedScene], path: Path) -> Counter[str]:
    """Writes the page and returns how many rows passed, failed and were not run."""
    rows = [row for scene in scenes for row in _rows(scene)]
    counts = Counter(row.verdict for row in rows)
    text = deck.render(
        "report/report.html.j2",
        quantities=QUANTITIES,
        rows=rows,
        counts=counts,
        tolerances=_tolerances(scenes),
        scenes=[_section(scene) for scene in scenes],
        trade=read_trade(path.parent),
        stability=read_stability(path.parent),
        elements=read_elements(path.parent),
        claims=read_section(path.parent / paths.CLAIMS_TABLE),
        provenance=provenance(),
        versions=_versions(scenes),
        date=datetime.datetime.now(datetime.UTC).strftime("%Y-%m-%d %H:%M UTC"),
    )
    path.parent.mkdir(parents=True, exist_ok=True)
    with whole_file(path) as draft:
        draft.write_text(text)
    return counts


def _rows(scene: ComparedScene) -> list[Row]:
    rows = []
    for engine in sorted([*scene.runs, *scene.absent], key=_engine_order):
        own = [verdict for verdict in scene.verdicts if verdict.engine == engine]
        found = {verdict.verdict for verdict in own}
        verdict = FAIL if FAIL in found else NOT_RUN if NOT_RUN in found else PASS
        cells = {name: next((v for v in own if v.quantity == name), None) for name in QUANTITIES}
        title = scene.case.scene.title or scene.case.scene.name
        cost = _cost(scene, engine)
        rows.append(Row(scene.case.scene.name, title, engine, verdict, cells, scene.absent.get(engine, ""), cost))
    return rows


def _engine_order(engine: str) -> tuple[bool, str]:
    return load_engine(engine).IN_REPOSITORY, engine  # the in-repo yardsticks last


def _cost(scene: ComparedScene, engine: str) -> str:
    if engine not in scene.runs:
        return ""
    record = scene.runs[engine].record
    loop = f", {1e3 * record.loop_s:.0f} ms" if record.loop_s is not None else ""
    return f"{record.wall_s:.2f} s{loop}"


def _tolerances(scenes: list[ComparedScene]) -> dict[tuple[str, str, str], list[str]]:
    """The scenes by quantity, limit and reason of every tolerance that was applied."""
    used: dict[tuple[str, str, str], list[str]] = {}
    for verdict in (v for scene in scenes for v in scene.verdicts if v.quantity in QUANTITIES):
        names = used.setdefault((QUANTITIES[verdict.quantity], number(verdict.limit), verdict.reason), [])
        if verdict.scene not in names:
            names.append(verdict.scene)
    return dict(sorted(used.items()))


def _section(scene: ComparedScene) -> dict[str, object]:
    case = scene.case
    observed = {engine: observe(run.layout, run.trace) for engine, run in scene.runs.items()}
    engines = sorted(observed, key=_engine_order)
    names = list(next(iter(observed.values()), {}))
    return {
        "name": case.scene.name,
        "title": case.scene.title or case.scene.name,
        "summary": case.summary,
        "timing": _timing(scene),
        "elements": case.elements,
        "figure": inline_svg(draw_scene(scene), case.scene.name) if scene.runs else "",
        "alt": f"Gauge forces against time for {case.summary}, all engines, with the differences between them below",
        "spacetime": inline_svg(draw_chain(scene), f"{case.scene.name}-spacetime") if scene.runs else "",
        "spacetime_alt": f"Force in every contact of the chain against time for {case.summary}, darker where larger",
        "engines": engines,
        "budget": _budget(scene, engines),
        "warnings": [(engine, words) for engine in engines for words in scene.runs[engine].record.warnings],
        "observables": [(name, [number(observed[e][name], 6) for e in engines]) for name in names],
        "decks": [
            (engine, file, text)
            for engine in engines
            if not load_engine(engine).IN_REPOSITORY
            for file, text in load_engine(engine).render(case).files.items()
        ],
        "folders": [(engine, paths.shown(scene.runs[engine].folder)) for engine in engines],
    }


def _timing(scene: ComparedScene) -> str:
    case = scene.case
    words = f"time step {case.scene.time_step_s * 1e6:g} µs, {case.scene.steps} steps, {case.scene.samples} samples"
    limits = [run.record.step_limit_s for run in scene.runs.values() if run.record.step_limit_s]
    if limits:
        share = case.scene.time_step_s / limits[0]
        words += f"; steps up to {limits[0] * 1e6:.3g} µs are stable, of which this is {share:.2g}"
    return words


def _budget(scene: ComparedScene, engines: list[str]) -> list[tuple[str, str, list[str]]]:
    """Lines of the error budget by quantity and engine: the whole and its parts, which add up to it."""
    lines = []
    for engine in engines:
        for part in scene.runs[engine].record.error_budget:
            cells = [f"{part[key]:.1e}" for key in ("whole", "model", "rounding", "truncation", "sampling")]
            lines.append((part["quantity"], engine, cells))
    order = list(dict.fromkeys(quantity for quantity, _, _ in lines))
    return sorted(lines, key=lambda line: order.index(line[0]))


def _versions(scenes: list[ComparedScene]) -> dict[str, str]:
    return {engine: run.record.engine_version for scene in scenes for engine, run in scene.runs.items()}


def number(value: float, digits: int = 2) -> str:
    """A number for people; a dash for what was not seen."""
    if math.isnan(value):
        return "–"
    return f"{value:.{digits}g}"
