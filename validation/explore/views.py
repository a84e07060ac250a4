"""Views of a scene for its live page: pure functions that a worker process computes, with the functions of commands."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from itertools import chain
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import tomlkit

from drivers.base import paths
from drivers.base.errors import InputError, RunError
from drivers.base.units import quantity
from drivers.chain.case import Case
from drivers.chain.chain import Array
from drivers.chain.trace import Trace
from drivers.engines import REFERENCE, VERLET
from drivers.interactive import run_scene
from drivers.limits import inability, refuse
from drivers.run.compute import compute
from drivers.scene.model import Scene
from drivers.scene.read_scene import apply_settings, find_scene
from postproc.draw.drawings import Film
from postproc.draw.overlay import lay_over
from postproc.draw.plot import AVERAGE, GREY, MICRO, PAGE_IN, cells_of, marker_of, pyplot, shown_forces, svg_of
from postproc.read.alignment import residual_of
from postproc.read.measured import entries_of
from postproc.read.motion import Simulation
from postproc.read.observables import describe, observe, without_unit
from postproc.read.signals import sensor_signals, signals_csv
from validation.accuracy.budget import assess, budget_of, kept_budget
from validation.accuracy.costs import cost_on
from validation.accuracy.plan import planned_case
from validation.calibration.command import fit
from validation.calibration.fit import LAWS, PARAMETERS, rows_of, value_text
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
DRAWN: dict[str, dict[str, Any]] = {  # in figures that are kept
    MEASURED: {"ls": "none", "marker": ".", "ms": 3, "mew": 0, "color": GREY},
    NOW: AVERAGE,
}
DASHES = ("dashed", "dotted", "dashdot")  # of kept curves, one after another, then fainter
POINTS = 100  # markers of a code at a gauge

Curves = Mapping[str, Any]  # times in us and forces in N by gauge: a pair, or an array of two rows
Parts = Mapping[str, Curves]  # by part of the gauges


class Question(NamedTuple):
    """A scene with settings, and the engine of its motion."""

    scene: str
    settings: tuple[str, ...] = ()
    engine: str = AUTO

    @property
    def words(self) -> tuple[str, ...]:
        """Scene and settings as arguments of a command."""
        return (self.scene, *chain.from_iterable(("--set", text) for text in self.settings))


@dataclass(frozen=True, eq=False)
class View:
    """Motion of a question.

    Attributes:
        engine: Engine of the motion.
        signals: Signals of the gauges by name, with the static load. Shape (samples,).
        values: Observables that are shown, by name.
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
    values: Mapping[str, float]
    cells: tuple[Array, Array, Array]
    signed: bool
    film: Film
    knobs: list[Knob]
    taken_s: float


def quick_view_of(asked: tuple[Question, tuple[str, ...]]) -> View | str:
    """Motion of a question, or the engine and the expected time of one that takes long; raises as ``view_of`` does."""
    case, engine = _case(asked[0])
    takes_s = cost_on(engine).loop_s(case)
    return view_of(asked) if takes_s < SAID_S else f"by {engine}: about {takes_s:.2g} s"


def view_of(asked: tuple[Question, tuple[str, ...]]) -> View:
    """Motion of a question, with the knobs that ``--knob`` asks for.

    Raises:
        InputError: The scene or a setting is wrong, or the engine cannot compute it.
        RunError: The computation failed.
    """
    question, ranges = asked
    case, engine, trace, taken_s = motion_of(question)
    values = {name: value for name, value in observe(case.layout, trace).items() if value == value}
    forces, signed = shown_forces(trace)
    return View(
        engine=engine,
        scene=case.scene,
        time_s=trace.time_s,
        signals=sensor_signals(case.layout, trace),
        values={name: value for name, value in values.items() if describe(without_unit(name)).kind in KINDS},
        cells=cells_of(trace.time_s, forces, signed=signed),
        signed=signed,
        film=Film(case, trace, FRAMES),
        knobs=knobs_of(case, ranges),
        taken_s=taken_s,
    )


@lru_cache(maxsize=8)
def _case(question: Question) -> tuple[Case, str]:
    """Case of a question, and its engine."""
    case, engine = planned_case(question.scene, *question.settings), question.engine
    if engine == AUTO:
        exact = inability(case, REFERENCE) is None and cost_on(REFERENCE).loop_s(case) < EXACT_S
        engine = REFERENCE if exact else VERLET
    refuse(case, engine)
    return case, engine


@lru_cache(maxsize=8)
def motion_of(question: Question) -> tuple[Case, str, Trace, float]:
    """Case, engine and trace of a question, as ``beads run`` computes it, and the time that it took in s."""
    case, engine = _case(question)
    ended = compute(case, engine, limit_s=LIMIT_S)
    return case, engine, ended.done, ended.wall_s


def errors_of(question: Question) -> tuple[dict[str, tuple[float, float]], list[str]]:
    """Relative errors of a motion, and those of the codes' scheme at the time step of the scene, by quantity; notes."""
    case, engine, trace, _ = motion_of(question)
    budgets = [budget_of(case, engine, trace, LIMIT_S)]
    if engine != VERLET:
        try:
            refuse(case, VERLET)
            budgets.append(budget_of(case, VERLET, motion_of(question._replace(engine=VERLET))[2], LIMIT_S))
        except (InputError, RunError) as error:
            budgets[0].warnings.append(f"velocity Verlet: {error}")
    own, of_scheme = ({row["quantity"]: abs(row["whole"]) for row in each.error_budget} for each in (budgets * 2)[:2])
    notes = dict.fromkeys(text for budget in budgets for text in (budget.error_note, *budget.warnings) if text)
    return {name: (error, of_scheme.get(name, np.nan)) for name, error in own.items()}, [*notes]


@dataclass(frozen=True, eq=False)
class Done:
    """Result of long work: lines, curves by part and gauge, knobs of triggers, settings of a fit by key."""

    lines: list[str]
    curves: Parts = field(default_factory=dict)
    knobs: Sequence[Knob] = ()
    settings: Mapping[str, str] = field(default_factory=dict)


def laid_over(question: Question) -> Done:
    """Measured traces of the scene over a motion, above its static load, smoothed residuals, and triggers found.

    The lines are chi-square, as of ``beads fit``, and remarks on lengths and gains.

    Raises:
        InputError: A measured file is wrong, or does not fit the motion.
    """
    case, engine, trace, _ = motion_of(question)
    motion, signals = Simulation(case, engine, trace), sensor_signals(case.layout, trace)
    aligned, _, remarks = lay_over(*entries_of(case.scene, None, case.scene.name), motion)
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
    return Done([words, *remarks], curves, [knob for knob in knobs_of(case, (), triggers_s) if knob.key in triggers_s])


def on_code(asked: tuple[Question, str, Path]) -> Done:
    """Run of a question on a code in a folder of runs, with what its budget says.

    Raises:
        InputError: The scene or a setting is wrong, or the code cannot compute it.
        RunError: The run failed.
    """
    question, engine, runs = asked
    case = planned_case(question.scene, *question.settings)
    run = assess(run_scene(case, engine, runs=runs), case)
    said = [f"{check.quantity}: {short(check.value)} (limit {short(check.limit)}): {check.verdict}"
            for check in kept_budget(case, run).checks]  # fmt: skip
    every = slice(None, None, max(len(run.trace.time_s) // POINTS, 1))
    time_us, signals = run.trace.time_s[every] * MICRO, sensor_signals(case.layout, run.trace)
    curves = {engine: {gauge: (time_us, force_N[every]) for gauge, force_N in signals.items()}}
    return Done([f"{engine}:", *said, paths.shown(run.folder)], curves)


def fitted(asked: tuple[Question, tuple[str, ...], Path]) -> Done:
    """Parameters of a fit that starts at a question, without profiles, and how well it fits.

    The settings are those of its keys; triggers that the scene does not state stay free.

    Raises:
        InputError: A parameter or the data are wrong.
        RunError: The exact motion cannot be computed.
    """
    question, free, results = asked
    found = fit(question.scene, settings=question.settings, free=free, quick=True, results=results)
    knobs = {knob.key: knob for knob in knobs_of(planned_case(question.scene, *question.settings))}
    (law,), settings = rows_of(found.tables[LAWS]), dict[str, str]()
    fits = f"chi-square {law.chi_square:.5g} with {law.freedom:g} degrees of freedom"
    lines = [f"{paths.shown(found.folder)}: {fits}, probability {short(law.probability)}"]
    for each in rows_of(found.tables[PARAMETERS]):
        key, number = each.parameter.rpartition(": ")[2], f"{each.value:.7g}"
        lines.append(f"{key} = {value_text(each)}")
        if key in knobs:
            text = quantity(float(number), each.unit) if each.unit else number
            settings |= dict.fromkeys((key, *knobs[key].shared), text)
    return Done(lines, settings=settings)


def scene_file(question: Question) -> str:
    """Scene file with the settings in place of its values; paths in it are absolute, so that it runs anywhere."""
    source = find_scene(question.scene)
    document: Any = tomlkit.parse(source.read_text(encoding="utf-8"))
    apply_settings(document, question.settings)
    for table in (document.get("drive", {}), *document.get("measured", ())):
        if "file" in table:
            table["file"] = str((source.parent / table["file"]).resolve())
    return tomlkit.dumps(document)


def figure_of(curves: Mapping[str, Mapping[str, tuple[Array, Array]]]) -> str:
    """SVG of curves by gauge and part, as of ``Plots.curves``."""
    size = (PAGE_IN, 0.6 + 1.6 * len(curves))
    figure, axes = pyplot().subplots(len(curves), 1, figsize=size, squeeze=False, sharex=True, layout="constrained")
    for axis, (gauge, parts) in zip(axes[:, 0], curves.items(), strict=True):
        for part, (time_us, force_N) in parts.items():
            if part.startswith(KEPT):
                dash, share = kept_look(part)
                look: dict[str, Any] = {"ls": dash, "alpha": share, "lw": 0.8, "color": GREY}
            else:
                look = DRAWN.get(part) or marker_of(part) | {"ls": "none"}
            axis.plot(time_us, force_N, label=part, **look)
        axis.set_title(gauge.replace("_", " "), loc="left")
        axis.set_ylabel("force (N)")
    axes[-1, 0].set_xlabel("time since impact (µs)")
    handles = {line.get_label(): line for axis in axes[:, 0] for line in axis.lines}
    figure.legend(handles.values(), handles.keys(), loc="outside upper left", ncols=5)
    return svg_of(figure)


def kept_look(part: str) -> tuple[str, float]:
    """Dashes and opacity of kept curves, which tell six of them apart."""
    round_, place = divmod(int(part.removeprefix(KEPT)) - 1, len(DASHES))
    return DASHES[place], 0.9 if round_ % 2 == 0 else 0.45


def forces_csv(question: Question) -> bytes:
    """Signals of the gauges of a question as CSV."""
    case, _, trace, _ = motion_of(question)
    return signals_csv(case.layout, trace)
