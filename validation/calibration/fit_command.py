"""``beads fit``: fits parameters of scenes to measured data, compares laws, and checks the fitted scene with codes."""

import json
import re
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from math import hypot, isfinite, nan
from pathlib import Path

from drivers.base import paths
from drivers.base.errors import InputError
from drivers.base.terminal import counted, text_table
from drivers.chain.case import build_case
from drivers.chain.chain import Array
from drivers.engines import codes
from drivers.limits import inability
from drivers.scene.model import places_of
from drivers.scene.read_scene import read_scene
from postproc.read.observables import describe, without_unit
from validation.calibration.calibration_file import calibration_file
from validation.calibration.data_sets import DataSet, paper_data, scene_data
from validation.calibration.fit import RISES
from validation.calibration.fit_folder import FitRequest, folder_of, write_folder
from validation.calibration.free import TRIGGER, did_you_mean
from validation.calibration.outcome import DatumRow, Outcome, interval_text, rounded, solve, value_text, with_error
from validation.calibration.problem import Problem, motion_values, pose, simulated
from validation.compare.comparison import EngineSelection, compare_scenes

DECISIVE = 6.0  # excess of Akaike's criterion: a ratio of likelihoods of 20
MIN_SHARE = 0.01  # relative difference of two predictions that is worth an experiment
MOST_LISTED = 4


def problems_of(request: FitRequest) -> dict[str, Problem]:
    """Problem of each law, on identical data.

    Raises:
        InputError: There are no free parameters or no measured data, or they have errors.
    """
    if not (request.free or request.own or request.laws):
        raise InputError("fit", "--free", "no free parameter: name a key of the scene, --free contact.restitution")
    if request.quoted and request.measured:
        raise InputError("fit", "--measured", "cannot be combined with --quoted")
    if not (request.scenes or request.quoted):
        raise InputError("fit", "", "no scene: name scenes with [[measured]] data, or use --quoted")
    if len(set(request.laws)) < len(request.laws):
        raise InputError("fit", "--law", ", ".join(request.laws), "each law once")
    problems = dict[str, Problem]()
    for law in request.laws or [""]:
        settings = request.settings_of(law)
        if request.quoted:
            sets = paper_data(request.quoted, settings)
        else:
            freed = any(text.partition("=")[0].strip().endswith(f".{TRIGGER}") for text in request.free)
            sets = [scene_data(scene, settings, request.measured, free_trigger=freed) for scene in request.scenes]
        for name, times in Counter(data.name for data in sets).items():
            if times > 1:
                raise InputError(
                    "fit", "", f"data set {name} {times} times", "each data set once; scenes need different names"
                )
        free = _free_of(request, law)
        if not (free or request.own):
            raise InputError("fit", "--free", f"the law {law} has no free parameter: name one, --free KEY")
        problems[law] = pose(sets, free, request.own)
    return problems


def _free_of(request: FitRequest, law: str) -> list[str]:
    """Free parameters of a law; bounds of the request replace those of a parameter that a law has."""
    asked = {text.partition("=")[0].strip(): text for text in request.free}
    if len(asked) < len(request.free):
        raise InputError("fit", "--free", ", ".join(request.free), "each parameter once")
    of_laws = {name: calibration_file().law_named(name).free for name in request.laws}
    of_law = of_laws.get(law, ())
    others = {key for keys in of_laws.values() for key in keys} - {*of_law}
    kept = [text for key, text in asked.items() if key not in others]
    return [*kept, *(key for key in of_law if key not in asked)]


def run_fit(request: FitRequest, runs: Path, results: Path) -> int:
    """Fits, prints and writes the results, and compares the fitted scenes on the codes; 1 if the comparison fails.

    Raises:
        InputError: The request has errors.
    """
    problems, outcomes = problems_of(request), dict[str, Outcome]()
    problem = next(iter(problems.values()))
    data, number = ", ".join(each.name for each in problem.sets), len(problem.free)
    size = f"{problem.rows} readings" if any(each.records for each in problem.sets) else f"{len(problem.data)} numbers"
    folder_of(request, results)
    refuse_unknown(problem, request.predict)
    with counted(f"fit of {number} parameter{'s' * (number != 1)} to {size}", unit="fit") as count:
        for law, each in problems.items():  # each fit also starts from the earlier ones: a larger model is never worse
            seeds = [outcome.fit.values for outcome in outcomes.values()]
            outcomes[law] = solve(each, law, data, quick=request.quick, seeds=seeds, count=count)
    predictions = [row for each in outcomes.values() for row in predict(each, request.predict)]
    folder, fitted, remarks = write_folder(request, outcomes, predictions, results)
    best = min(outcomes.values(), key=lambda each: each.row.aic).row.law
    try:
        return 0 if request.quick or not fitted[best] else _confirm(fitted[best], runs)
    finally:  # last, so that it stays on screen, also after a failed run
        for law, outcome in outcomes.items():
            print(*([f"--- {law} ---"] * bool(law)), *lines(outcome), "", sep="\n")
        print(*comparison(outcomes, predictions), *predicted_lines(predictions, request.predict), sep="\n")
        print(*remarks, paths.shown(folder), sep="\n", flush=True)


def _confirm(fitted: Sequence[Path], runs: Path) -> int:
    """Compares fitted scenes on all engines, or on the in-repo engines if no code has their contact law."""
    cases = [build_case(read_scene(path)) for path in fitted]
    modelled = any(inability(case, code) is None for case in cases for code in codes())
    if not modelled:
        print("no code has this contact law: only in-repo engines check the fitted scene")
    return compare_scenes(
        [str(path) for path in fitted], (), runs, EngineSelection(allow_missing=not modelled), unsafe=False, brief=True
    )


LEGEND = (
    "deviation: fitted minus measured, in standard errors of the measurement; of a trace the rms of its readings, of a "
    "parameter with prior knowledge fitted minus stated value",
    "predicted: by a fit to all other data; deviation: of this prediction, in standard errors of both",
)


def lines(outcome: Outcome) -> Iterator[str]:
    """Lines of text with parameters, data and remarks; columns without an entry are left out."""
    rows = []
    for row in outcome.parameters:
        ends = ((row.low_68pct, row.high_68pct), (row.low_95pct, row.high_95pct))
        start = with_error(row.start, row.prior, row.unit) if row.prior else rounded(row.start, row.unit)
        value = value_text(row, outcome.enlargement)
        rows.append([row.parameter, value, *(interval_text(row, end) for end in ends), start])
    yield from _table(["parameter", "value", *(f"{rise} interval" for rise in RISES), "start"], rows)
    if outcome.enlargement != 1:
        times = f"enlarged {outcome.enlargement:.2g} times"
        yield f"errors (not intervals) are {times}, since the data scatter more than noise explains"
    yield ""
    cells = [[row.label, *_datum_cells(row)] for row in outcome.data]
    yield from _table(["datum", "measured", "fitted", "deviation", "predicted", "deviation"], cells)
    yield from LEGEND if any(row[4] for row in cells) else LEGEND[:1]
    yield ""
    goodness = outcome.row
    chance = f", probability {goodness.probability:.2g}" if goodness.freedom > 0 else ""
    few = "fewer data than parameters"
    freedom = f"{goodness.freedom} degrees of freedom{chance}" if goodness.freedom >= 0 else few
    yield f"chi-square {goodness.chi_square:.4g} with {freedom}"
    if not outcome.explained:
        yield "the model does not explain the data"
    yield from goodness.remarks.split(". ") if goodness.remarks else ()


def _datum_cells(row: DatumRow) -> list[str]:
    """Cells of a datum: measured, fitted, deviation, predicted, deviation."""
    off = f"{row.off:.2f}"
    if not isfinite(row.measured):
        return ["", "", off, "", ""]
    without = f"{row.by_the_others:.4g} ± {row.by_the_others_error:.2g}" if isfinite(row.by_the_others) else ""
    without_off = f"{row.by_the_others_off:.2f}" if isfinite(row.by_the_others_off) else ""
    return [f"{row.measured:.4g} ± {row.error:.2g}", f"{row.fitted:.5g}", off, without, without_off]


def comparison(outcomes: Mapping[str, Outcome], predictions: Sequence[DatumRow]) -> Iterator[str]:
    """Lines on several laws: goodness of each, the best if one is, and what they predict differently."""
    if len(outcomes) < 2:
        return
    rows = sorted((outcome.row for outcome in outcomes.values()), key=lambda row: row.aic)
    best = rows[0]
    numbers = [(r.chi_square, r.freedom, r.probability, r.aic, r.bic, r.aic - best.aic) for r in rows]
    heading = ["law", "chi-square", "freedom", "probability", "AIC", "BIC", "AIC above the best"]
    yield from text_table(
        [heading, *([r.law, *(f"{x:.5g}" for x in values)] for r, values in zip(rows, numbers, strict=True))]
    )
    yield from verdict(outcomes)
    yield from differences(predictions, [row.law for row in rows])
    yield ""


def verdict(outcomes: Mapping[str, Outcome]) -> Iterator[str]:
    """Sentences on the laws that explain the data, and on the best of them.

    Where no law does, differences of AIC are divided by the best law's chi-square per degree of freedom.
    """
    rows = sorted((outcome.row for outcome in outcomes.values()), key=lambda row: row.aic)
    best, unit = rows[0], outcomes[rows[0].law].enlargement ** 2
    for row in rows:
        if not outcomes[row.law].explained:
            yield f"{row.law} does not explain the data"
        for end in (remark for remark in row.remarks.split(". ") if "end of its range" in remark):
            yield f"{row.law}: {end}"
    near = [row.law for row in rows if (row.aic - best.aic) / unit < DECISIVE]
    if len(near) > 1:
        yield f"undecided: the data do not distinguish {', '.join(near)} (AIC within {DECISIVE:g})"
    else:
        yield f"{best.law} is the best law: the AIC of {rows[1].law} is {(rows[1].aic - best.aic) / unit:.3g} higher"


def predicted_lines(rows: Sequence[DatumRow], asked: Sequence[str]) -> Iterator[str]:
    """Table of the requested predictions; nothing without one."""
    names = {without_unit(name) for name in asked}
    cells = [
        [row.datum, row.data_set, row.law, with_error(row.fitted, row.fitted_error, row.unit)]
        for row in rows
        if without_unit(row.datum) in names
    ]
    if cells:
        yield from _table(["predicted", "scene", "law", "value"], sorted(cells))
        yield ""


def _table(heading: Sequence[str], rows: Sequence[Sequence[str]]) -> list[str]:
    """Lines of a table; columns without an entry are left out."""
    shown = [place for place in range(len(heading)) if any(row[place] for row in rows)]
    return text_table([row[place] for place in shown] for row in (heading, *rows))


def predict(outcome: Outcome, names: Sequence[str]) -> list[DatumRow]:
    """Observables of each data set in the fitted motion; a gauge is added at a bead without a sensor.

    Args:
        outcome: The fit.
        names: Observables, with or without their units, in addition to all observables of waves.
    """
    rows, problem = list[DatumRow](), outcome.fit.problem
    for data in problem.sets:
        shown = _as_run(data, names)
        simulation = simulated(shown, motion_values(problem, data, outcome.fit.place), whole=True)
        known = {without_unit(name): name for name in simulation.values} if simulation else {}
        every = [name for name in known if describe(name).of_wave]
        asked = map(without_unit, (*names, *every))
        for name in dict.fromkeys(known[word] for word in asked if word in known):
            value, error = outcome.fit.number(partial(_observable, problem, data, shown, name))
            row = outcome.row
            rows.append(DatumRow(row.law, row.data, data.name, name, describe(name).unit, nan, nan, value, error, nan))
    return rows


def refuse_unknown(problem: Problem, names: Sequence[str]) -> None:
    """Refuses names that are no observable of any scene.

    Raises:
        InputError: A name is unknown.
    """
    known = set[str]()
    for data in problem.sets if names else ():
        simulation = simulated(_as_run(data, names), motion_values(problem, data, problem.start), whole=True)
        known |= {without_unit(name) for name in simulation.values} if simulation else set()
    for name in names:
        if without_unit(name) not in known:
            hint = did_you_mean(without_unit(name), known) or f"allowed: {', '.join(sorted(known))}"
            raise InputError(problem.sets[0].where, f"--predict {name}", f"unknown observable; {hint}")


def _as_run(data: DataSet, names: Sequence[str]) -> DataSet:
    """Data set as the scene runs, with a sensor at each named bead; one without a mass changes nothing."""
    tables = json.loads(data.tables)
    tables["run"]["duration"] = data.duration or tables["run"]["duration"]
    sensors = tables["chain"].setdefault("sensors", [])
    asked = {int(match[1]) for name in names if (match := re.match(r"bead_(\d+)_", name))}
    new = asked.difference(*(places_of(sensor["from_wall"]) for sensor in sensors))
    sensors.extend({"from_wall": bead} for bead in sorted(new, reverse=True))
    return replace(data, tables=json.dumps(tables))


def _observable(problem: Problem, data: DataSet, shown: DataSet, name: str, place: Array) -> float:
    """An observable at given coordinates."""
    simulation = simulated(shown, motion_values(problem, data, place), whole=True)
    return simulation.values[name] if simulation else nan


def differences(rows: Sequence[DatumRow], laws: Sequence[str]) -> Iterator[str]:
    """Sentences on the observables that the first law and another predict most differently, in their errors."""
    first, *others = laws
    for other in others:
        two = {row.label: row for row in rows if row.law == other}
        pairs = [(row, two[row.label]) for row in rows if row.law == first and row.label in two]
        apart = [
            (abs(b.fitted - a.fitted) / max(hypot(a.fitted_error, b.fitted_error), 1e-300), a, b)
            for a, b in pairs
            if isfinite(a.fitted + b.fitted) and abs(b.fitted - a.fitted) > MIN_SHARE * abs(a.fitted)
        ]
        for errors, a, b in sorted(apart, key=lambda item: -item[0])[:MOST_LISTED]:
            pair = f"{a.fitted:.4g} against {b.fitted:.4g} {a.unit}".rstrip()
            yield f"{first} and {other} differ in {a.label}: {pair}, {errors:.1f} standard errors"
