"""Rows of the verdict tables, and the page's section on a scene."""

import math
import shlex
from collections import Counter
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from drivers.base import paths
from drivers.base.errors import InputError
from drivers.base.terminal import in_words
from drivers.chain.case import Case
from drivers.chain.chain import hertz_force
from drivers.chain.trace import Trace
from drivers.engines import REFERENCE, engines_again, in_order, load_engine
from drivers.limits import step_limit
from drivers.run.run_folder import EndedRun
from drivers.scene.model import Scene
from postproc.draw.overlay import HEADINGS, draw_overlay, lay_over, misfit_rows, number
from postproc.draw.plot import draw_spacetime, svg_of
from postproc.draw.stack import MAX_GAUGES, draw_gauge_forces
from postproc.read.measured import entries_of
from postproc.read.motion import Simulation
from postproc.read.observables import observe
from postproc.read.signals import gauges_of
from validation.accuracy.budget import PARTS, budget_rows
from validation.checks import FAIL, Check, outcome, short, worst_of
from validation.compare.comparison import ComparedScene
from validation.report.parts import Shown, image_of, prediction_part, read_part


def cell_of(checks: Sequence[Check], diagnosis: str = "") -> dict[str, Any]:
    """Checks of one engine on one scene or case, as page and JSON have them.

    ``note`` is the reason for a missing run or missing numbers, else empty; ``worst`` the quantity closest to its
    limit, or furthest beyond, None if nothing was measured; ``diagnosis`` the cause of a wrong run.
    """
    worst = worst_of(checks)
    return {
        "verdict": outcome(checks),
        "note": next((check.where for check in checks if math.isnan(check.limit)), ""),
        "worst": worst.quantity if worst else None,
        "diagnosis": diagnosis or None,
        "checks": checks,
    }


def scene_row(scene: ComparedScene, runs: Path | None = None) -> dict[str, Any]:
    """A compared scene on all engines: name, title, the command that prints more, and a ``cell_of`` each engine.

    ``runs`` is the folder of its run folders if not the default.
    """
    source = scene.case.scene
    options = [*(["--runs", str(runs)] if runs else []), *engines_again()]
    engines = in_order([*scene.runs, *scene.absent])
    return {
        "name": source.name,
        "title": source.title or source.name,
        "command": " ".join(["beads compare", source_of(source), *map(shlex.quote, options)]),
        "engines": {name: cell_of(scene.of_engine(name), scene.diagnoses.get(name, "")) for name in engines},
    }


def case_rows(checks: Sequence[Check]) -> list[dict[str, Any]]:
    """Rows of the cases beyond the paper, whose checks are those with an engine; as of ``scene_row``."""
    cases: dict[str, dict[str, list[Check]]] = {}
    for check in checks:
        if check.engine:
            cases.setdefault(check.scene, {}).setdefault(check.engine, []).append(check)
    return [
        {"name": name, "title": name, "command": "beads claims"}
        | {"engines": {engine: cell_of(by_engine[engine]) for engine in in_order(by_engine)}}
        for name, by_engine in cases.items()
    ]


def counted(rows: Iterable[Mapping[str, Any]]) -> Counter[str]:
    """Numbers of cells that passed, failed and were not run."""
    return Counter(cell["verdict"] for row in rows for cell in row["engines"].values())


def tolerances(scenes: Iterable[ComparedScene]) -> pd.DataFrame:
    """Quantity, limits, scenes and reason of every applied tolerance; limits with the same reason share a row."""
    applied = [check for scene in scenes for check in scene.checks if not math.isnan(check.limit)]
    checks = pd.DataFrame(applied, columns=["quantity", "reason", "limit", "scene"])
    named = {"limit": ("limit", _limits_of), "scenes": ("scene", lambda names: ", ".join(names.unique()))}
    return checks.groupby(["quantity", "reason"]).agg(**named).reset_index()[["quantity", "limit", "scenes", "reason"]]


def _limits_of(limits: Collection[float]) -> str:
    """A limit, or the smallest and the largest."""
    return " to ".join(dict.fromkeys(number(limit, 2) for limit in (min(limits), max(limits))))


def source_of(scene: Scene) -> str:
    """Argument that names a scene on a command line: its name if shipped, else its file."""
    shipped = paths.SCENES / f"{scene.name}.toml"
    same = shipped.is_file() and scene.file and (paths.ROOT / scene.file).resolve() == shipped.resolve()
    return scene.name if same or scene.file == scene.name else shlex.quote(scene.file)


FITTED_PARAMETERS = "parameters"  # stored figure of a fit


def overlay_of(case: Case, engine: str, trace: Trace, results: Path) -> dict[str, Any]:
    """Overlay of a scene's measured traces or quoted values on the run of an engine.

    ``image`` is None if only values are quoted, ``rows`` has a row for each quantity, ``remarks`` are sentences on
    lengths and gains, and ``problem`` says why the traces do not fit the run; else it is empty. ``far`` is the misfit
    that is largest in standard errors, or None. ``parameters`` is the figure of fitted parameters, and ``fitted`` the
    scene of the fit, if ``beads fit`` wrote this scene or one for it in ``results``.
    """
    scene, is_fit = case.scene, case.scene.name.startswith("fit-")
    fit = scene.folder if is_fit else results / f"fit-{scene.name}"
    part = read_part(fit.name, fit.parent, "beads fit")
    parameters = part and part.figures[FITTED_PARAMETERS][1]
    fitted = paths.shown(fit / f"fit-{scene.name}.toml") if parameters and not is_fit else ""
    overlay: dict[str, Any] = {"engine": engine, "image": None, "rows": [], "remarks": [], "problem": "", "far": None}
    overlay |= {"parameters": parameters, "fitted": fitted}
    try:
        motion = Simulation(case, engine, trace)
        aligned, misfits, overlay["remarks"] = lay_over(*entries_of(scene, None, scene.file), motion)
    except InputError as error:  # the file was read before; it does not fit the run
        return overlay | {"problem": str(error)}
    if aligned:
        overlay["image"] = image_of(svg_of(draw_overlay(motion, aligned, misfits).figure))
    known = misfits.dropna(subset="difference_in_errors").sort_values("difference_in_errors", key=abs)
    return overlay | {"rows": misfit_rows(misfits), "far": known.to_dict("records")[-1] if len(known) else None}


FORCE_RANGE = 2.0  # largest drawn force of a failed run, divided by the largest force of the finished runs


@cache  # the page is written after each step
def section_of(scene: ComparedScene, results: Path, runs: Path | None = None) -> dict[str, Any]:
    """Values of the page's section on a compared scene; lists are in the order of the page.

    Args:
        scene: the compared scene.
        results: folder of the page.
        runs: folder of its run folders if not the default.

    Returns:
        row, case: row of the table of verdicts, and the case.
        runs: finished runs by engine.
        timing: time step, samples and stability in a sentence.
        forces: forces on the gauges and differences; None without a trace, or without both a gauge and a second engine.
        left_out: number of gauges without a panel.
        prediction: stored result of ``beads predict`` for the scene as it is now; None without one.
        overlay: measured traces over the exact motion, or over the first engine without it; None without traces.
        chain: forces of all contacts in space and time; None if no run finished.
        shown: tables of misfits, checks by quantity, observables, error budget and elements.
        decks: engine, file and text, of finished codes and of all failed engines.
    """
    case, row = scene.case, scene_row(scene, runs)
    finished = {engine: scene.runs[engine] for engine in in_order(scene.runs)}
    traces = {engine: run.trace for engine, run in finished.items()}
    refused = {engine: part_in_range(case, scene.refused[engine], traces) for engine in in_order(scene.refused)}
    forces = draw_gauge_forces(case.layout, traces, refused) if traces or refused else None
    shown = REFERENCE if REFERENCE in finished else next(iter(finished), "")
    trace = traces.get(shown)
    overlay = overlay_of(case, shown, trace, results) if trace and case.scene.measured else None
    return {
        "row": row,
        "case": case,
        "runs": finished,
        "timing": _timing(scene),
        "forces": image_of(svg_of(forces)) if forces else None,
        "left_out": max(0, len(gauges_of(case.layout)) - MAX_GAUGES),
        "prediction": read_part(prediction_part(case.scene), results, "beads predict"),
        "overlay": overlay,
        "chain": image_of(svg_of(draw_spacetime({shown: trace}).figure)) if trace else None,
        "shown": _tables(scene, finished, overlay["rows"] if overlay else ()),
        "decks": [
            (name, file, text)
            for name, cell in row["engines"].items()
            for engine in [load_engine(name)]
            if (cell["verdict"] == FAIL if name in scene.absent else not engine.in_repository)
            for file, text in engine.by_hand(engine.render(case)).files.items()
        ],
    }


BUDGET = (
    "Signed errors divided by the true value; for the force trace, at the contact and time of its largest error,"
    " divided by the largest change. Energy is divided by the largest kinetic energy, momentum by the largest momentum."
    " Model: engine minus the same scheme in absolute heights. Rounding: scheme in heights minus scheme in overlaps."
    " Truncation: scheme minus exact motion. Sampling: change by the interval between samples. The whole error is their"
    " sum."
)


def _tables(scene: ComparedScene, finished: Mapping[str, EndedRun], misfits: Sequence[Any]) -> list[Shown]:
    """Tables of the finished runs of a scene by engine: misfits, checks, observables, error budget, elements."""
    checks = {(check.quantity, check.engine): check for check in scene.checks if check.engine in finished}
    judged = []
    for quantity in dict.fromkeys(quantity for quantity, _ in checks):
        row = [checks.get((quantity, engine)) for engine in finished]
        judged.append([quantity, *map(_judgement, row), _limits_of([check.limit for check in row if check])])
    observed = [observe(run.layout, run.trace) for run in finished.values()]
    values = [[name, *(number(values.get(name, math.nan), 6) for values in observed)] for name in (observed or [{}])[0]]
    budget = [(name, engine, *(short(row[part]) for part in PARTS)) for name, engine, row in budget_rows(finished)]
    notes = [f"{engine}: {run.record.error_note}." for engine, run in finished.items() if run.record.error_note]
    elements = [(element.name, "in" if element.modelled else "out", element.reason) for element in scene.case.elements]
    tables = (
        ("", "", misfits, HEADINGS),
        ("", "", judged, ("quantity", *finished, "allowed")),
        ("Observables: peaks, speeds, widths, balances", "", values, ("observable", *finished)),
        (f"Error budget: {', '.join(PARTS[1:])}", " ".join((BUDGET, *notes)), budget, ("quantity", "engine", *PARTS)),
        ("Modelled elements, with reasons", "", elements, ("element", "in or out", "reason")),
    )
    return [
        Shown(heading, text, pd.DataFrame(rows, columns=columns)) for heading, text, rows, columns in tables if rows
    ]


def _judgement(check: Check | None) -> str:
    """Verdict and value of a check, and the place of a failure."""
    if check is None:
        return ""
    return f"{check.verdict} {short(check.value)}" + (f"\n{check.where}" if check.verdict == FAIL else "")


def _timing(scene: ComparedScene) -> str:
    """Time step, numbers of steps and samples, share of the stable step, and computing time, as a sentence."""
    own, records = scene.case.scene, [run.record for run in scene.runs.values()]
    text = f"time step {own.time_step_s * 1e6:g} µs, {own.steps} steps, {own.samples} samples"
    if (limit_s := step_limit(scene.case)[0]) < math.inf:
        text += f"; stable up to {limit_s * 1e6:.3g} µs, this run uses {100 * own.time_step_s / limit_s:.2g} % of that"
    loops = [f"{record.engine} {in_words(record.loop_s)}" for record in records if record.loop_s is not None]
    return text + (f"; computing time: {', '.join(loops)}" if loops else "")


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
    in_range = np.all(np.abs(failed.force_N) <= limit_N, axis=1)[:, np.newaxis]  # false for NaN
    missing = len(case.sample_times_s) - len(in_range)
    force_N = np.pad(np.where(in_range, failed.force_N, np.nan), ((0, missing), (0, 0)), constant_values=np.nan)
    return replace(failed, time_s=case.sample_times_s, force_N=force_N)
