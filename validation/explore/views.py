"""Views of a scene for its live page: pure functions that a worker process computes, with the functions of commands."""

import shlex
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from itertools import chain
from math import nan
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import tomlkit

from drivers.base import paths
from drivers.base.terminal import text_table
from drivers.base.units import quantity
from drivers.chain.case import Case
from drivers.chain.chain import Array
from drivers.chain.trace import Trace
from drivers.engines import REFERENCE, VERLET
from drivers.interactive import run_scene
from drivers.limits import inability, refuse
from drivers.run.compute import compute
from drivers.scene.model import Scene
from drivers.scene.read_scene import apply_settings, find_scene, read_scene
from postproc.draw.drawings import Film
from postproc.draw.overlay import HEADINGS, lay_over, misfit_rows
from postproc.draw.plot import MICRO, cells_of, shown_forces
from postproc.read.alignment import residual_of
from postproc.read.measured import entries_of
from postproc.read.motion import Simulation
from postproc.read.observables import describe, observe, without_unit
from postproc.read.signals import sensor_signals, signals_csv
from validation.accuracy.budget import assess, budget_lines, budget_of, kept_budget, text_of
from validation.accuracy.costs import cost_on
from validation.accuracy.plan import planned_case
from validation.calibration.command import exact_lines, fit, lines
from validation.calibration.fit import EXACT, PARAMETERS, rows_of
from validation.calibration.parameters import TRIGGER
from validation.checks import short
from validation.explore.knobs import Knob, knobs_of

AUTO = "auto"
EXACT_S = 0.01  # longest expected time of an exact motion that follows a knob; longer ones are those of velocity Verlet
SAID_S = 0.3  # expected time of a motion from which on it is said
LIMIT_S = 60.0  # of each motion
FRAMES = 300  # of the moving beads
KINDS = ("peak", "amplitude", "arrival", "speed", "duration", "width", "reflected amplitude", "reflected arrival")
NOW, KEPT, MEASURED, RESIDUAL = "now", "kept", "measured", "residual"  # parts of a gauge, beside names of codes
POINTS = 100  # markers of a code at a gauge

Curves = Mapping[str, Any]  # times in us and forces in N by gauge: a pair, or an array of two rows
Parts = Mapping[str, Curves]  # by part of the gauges


class Question(NamedTuple):
    """A scene with settings, the engine of its motion, and the knobs that ``--knob`` asks for."""

    scene: str
    settings: tuple[str, ...] = ()
    ranges: tuple[str, ...] = ()
    engine: str = AUTO

    def command(self, name: str, *options: tuple[str, str]) -> str:
        """Command line with the scene, its settings and options."""
        pairs = [*(("--set", text) for text in self.settings), *options]
        return shlex.join(["beads", name, self.scene, *chain.from_iterable(pairs)])


@dataclass(frozen=True, eq=False)
class View:
    """Motion of a question.

    Attributes:
        engine: Engine of the motion.
        signals: Signals of the gauges by name, with the static load. Shape (samples,).
        table: Lines with the observables that are shown.
        cells: Beginning of each column in s, number of the contact in each row, and forces. Shape (rows, columns).
        signed: True if these are changes since time 0.
        film: Bodies at some times.
        knobs: Knobs of the scene.
        taken_s: Time of the computation.
    """

    engine: str
    scene: Scene
    time_s: Array
    signals: Mapping[str, Array]
    table: list[str]
    cells: tuple[Array, Array, Array]
    signed: bool
    film: Film
    knobs: list[Knob]
    taken_s: float


def quick_view_of(question: Question) -> View | str:
    """Motion of a question, or the engine and the expected time of one that takes long; raises as ``view_of`` does."""
    case, engine = _case(question)
    takes_s = cost_on(engine).loop_s(case)
    return view_of(question) if takes_s < SAID_S else f"by {engine}: about {takes_s:.2g} s"


def view_of(question: Question) -> View:
    """Motion of a question.

    Raises:
        InputError: The scene or a setting is wrong, or the engine cannot compute it.
        RunError: The computation failed.
    """
    case, engine, trace, taken_s = motion_of(question)
    forces, signed = shown_forces(trace)
    return View(
        engine=engine,
        scene=case.scene,
        time_s=trace.time_s,
        signals=sensor_signals(case.layout, trace),
        table=[*table_of(case, trace, {}), "errors are being measured"],
        cells=cells_of(trace.time_s, forces, signed=signed),
        signed=signed,
        film=Film(case, trace, FRAMES),
        knobs=knobs_of(case, question.ranges),
        taken_s=taken_s,
    )


@lru_cache(maxsize=1)
def _case(question: Question) -> tuple[Case, str]:
    """Case of a question, and its engine."""
    case, engine = planned_case(question.scene, *question.settings), question.engine
    if engine == AUTO:
        exact = inability(case, REFERENCE) is None and cost_on(REFERENCE).loop_s(case) < EXACT_S
        engine = REFERENCE if exact else VERLET
    refuse(case, engine)
    return case, engine


@lru_cache(maxsize=1)
def motion_of(question: Question) -> tuple[Case, str, Trace, float]:
    """Case, engine and trace of a question, as ``beads run`` computes it, and the time that it took in s."""
    case, engine = _case(question)
    ended = compute(case, engine, limit_s=LIMIT_S)
    return case, engine, ended.done, ended.wall_s


def table_of(case: Case, trace: Trace, errors: Mapping[str, float]) -> list[str]:
    """Lines with the observables of a motion and their relative errors."""
    rows = [("observable", "value", "relative error")]
    for name, value in observe(case.layout, trace).items():
        what = without_unit(name)
        if value == value and describe(what).kind in KINDS:
            rows.append((name, f"{value:.6g}", short(errors.get(what, nan))))
    return text_table(rows, right=(1, 2))


@dataclass(frozen=True, eq=False)
class Done:
    """Result of long work: lines, curves by part and gauge, knobs of triggers, settings of a fit by key."""

    lines: list[str]
    curves: Parts = field(default_factory=dict)
    knobs: Sequence[Knob] = ()
    settings: Mapping[str, str] = field(default_factory=dict)


def errors_of(question: Question) -> Done:
    """Observables of a motion with their errors, and notes; raises as ``view_of`` does."""
    case, engine, trace, _ = motion_of(question)
    budget = budget_of(case, engine, trace, LIMIT_S)
    errors = {row["quantity"]: abs(row["whole"]) for row in budget.error_budget}
    return Done([*table_of(case, trace, errors), *filter(None, [budget.error_note, *budget.warnings])])


def laid_over(question: Question) -> Done:
    """Measured traces of the scene over a motion, above its static load, smoothed residuals, and triggers found.

    The lines are chi-square, as of ``beads fit``, and those of ``beads overlay``.

    Raises:
        InputError: A measured file is wrong, or does not fit the motion.
    """
    case, engine, trace, _ = motion_of(question)
    motion, signals = Simulation(case, engine, trace), sensor_signals(case.layout, trace)
    aligned, misfits, remarks = lay_over(*entries_of(case.scene, None, case.scene.name), motion)
    parts: dict[str, dict[str, list[Any]]] = {MEASURED: {}, RESIDUAL: {}}  # of several files one after another
    chi_square, readings, triggers_s = 0.0, 0, dict[str, float]()
    for each in aligned:
        channel, gauge = each.channel, each.channel.gauge
        off = residual_of(channel, motion.curves[gauge], channel.trace.gain, channel.trigger_s)
        chi_square, readings = chi_square + float(off @ off), readings + len(off)
        left_N = each.curve(each.run_s) - np.interp(each.run_s, each.time_s, each.computed_N)
        parts[MEASURED].setdefault(gauge, []).append((each.time_s * MICRO, each.force_N + signals[gauge][0]))
        parts[RESIDUAL].setdefault(gauge, []).append((each.run_s * MICRO, left_N))
        if channel.found:
            triggers_s[f"{channel.trace.key}.{TRIGGER}"] = channel.trigger_s
    words = f"chi-square {chi_square:.5g} of {readings} readings, {chi_square / readings:.3g} each"
    curves = {part: {gauge: np.hstack(pieces) for gauge, pieces in of.items()} for part, of in parts.items()}
    said = [words, *remarks, *text_table([HEADINGS, *misfit_rows(misfits)])]
    return Done(said, curves, [knob for knob in knobs_of(case, (), triggers_s) if knob.key in triggers_s])


def on_code(asked: tuple[Question, str, Path]) -> Done:
    """Run of a question on a code in a folder of runs, with its error budget in the lines of ``beads compare``.

    Raises:
        InputError: The scene or a setting is wrong, or the code cannot compute it.
        RunError: The run failed.
    """
    question, engine, runs = asked
    case = planned_case(question.scene, *question.settings)
    run = assess(run_scene(case, engine, runs=runs), case)
    said = [f"{engine}: {text_of(kept_budget(case, run).checks)}", *budget_lines("engine", {engine: run})]
    every = slice(None, None, max(len(run.trace.time_s) // POINTS, 1))
    time_us, signals = run.trace.time_s[every] * MICRO, sensor_signals(case.layout, run.trace)
    curves = {engine: {gauge: (time_us, force_N[every]) for gauge, force_N in signals.items()}}
    return Done([question.command("run", ("--engine", engine)), *said, paths.shown(run.folder)], curves)


def fitted(asked: tuple[Question, tuple[str, ...], Path]) -> Done:
    """Fit that starts at a question, without profiles, in the lines of ``beads fit``.

    The settings are those of its keys; triggers that the scene does not state stay free.

    Raises:
        InputError: A parameter or the data are wrong.
        RunError: The exact motion cannot be computed.
    """
    question, free, results = asked
    found = fit(question.scene, settings=question.settings, free=free, quick=True, results=results)
    knobs = {knob.key: knob for knob in knobs_of(planned_case(question.scene, *question.settings))}
    settings = dict[str, str]()
    for row in rows_of(found.tables[PARAMETERS]):
        key, number = row.parameter.rpartition(": ")[2], float(f"{row.value:.7g}")
        if key in knobs:
            text = quantity(number, row.unit) if row.unit else str(number)
            settings |= dict.fromkeys((key, *knobs[key].shared), text)
    (law,) = found.fits.values()
    said = *lines(law, found.tables), "", *exact_lines(found.tables[EXACT]), paths.shown(found.folder)
    return Done([question.command("fit", *(("--free", key) for key in free)) + " --quick", *said], settings=settings)


def scene_file(question: Question) -> str:
    """Scene file with the settings in place of its values; paths in it are absolute, so that it runs anywhere.

    Raises:
        InputError: The scene or a setting is wrong.
    """
    read_scene(question.scene, question.settings)  # which may refuse them
    source = find_scene(question.scene)
    document: Any = tomlkit.parse(source.read_text(encoding="utf-8"))
    apply_settings(document, question.settings)
    for table in (document.get("drive", {}), *document.get("measured", ())):
        if "file" in table:
            table["file"] = str((source.parent / table["file"]).resolve())
    return tomlkit.dumps(document)


def forces_csv(question: Question) -> str:
    """Signals of the gauges of a question as CSV."""
    case, _, trace, _ = motion_of(question)
    return signals_csv(case.layout, trace).decode()
