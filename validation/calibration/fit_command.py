"""``beads fit``: fits parameters of scenes to measured data and checks the fitted scene with codes."""

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from math import isfinite
from pathlib import Path

from drivers.base import paths
from drivers.base.errors import InputError
from drivers.base.progress import counted
from drivers.base.text_table import text_table
from drivers.base.units import quantity
from drivers.chain.case import build_case
from drivers.engines import codes
from drivers.limits.refusal import inability
from drivers.scene.read_scene import read_scene
from validation.calibration.calibration_file import calibration_file
from validation.calibration.certainty import RISES, Prediction
from validation.calibration.data_sets import paper_data, scene_data
from validation.calibration.fit_folder import write_folder
from validation.calibration.models import Model, differences, predict, settings_of, solve_all, verdict
from validation.calibration.outcome import Outcome, interval_text, value_text
from validation.calibration.problem import pose
from validation.calibration.rows import ModelRow, PredictionRow, model_rows
from validation.compare.compare_command import compare_scenes
from validation.compare.selection import EngineSelection


@dataclass(frozen=True)
class FitRequest:
    """Arguments of the command.

    Attributes:
        scenes: Names or files of scenes with measured data.
        free, own: Options ``--free`` and ``--own``: keys with or without bounds.
        laws: Names of laws of ``inputs/calibration.toml``, with their own free parameters; none for that of the scene.
        predict: Observables to predict.
        quoted: Names of data sets of the paper.
        measured: CSV file that replaces the files of the scene.
        settings: Settings applied to the scenes.
        quick: True to omit profiles, left-out data and runs of codes.
    """

    scenes: Sequence[str]
    free: Sequence[str] = ()
    own: Sequence[str] = ()
    laws: Sequence[str] = ()
    predict: Sequence[str] = ()
    quoted: Sequence[str] = ()
    measured: Path | None = None
    settings: Sequence[str] = ()
    quick: bool = False


def models_of(request: FitRequest) -> list[Model]:
    """Laws to be fitted, each with its problem, on identical data.

    Raises:
        InputError: There are no free parameters or no measured data, or they have errors.
    """
    if not (request.free or request.own or request.laws):
        raise InputError("fit", "--free", "no free parameter: name a key of the scene, --free contact.restitution")
    if request.quoted and request.measured:
        raise InputError("fit", "--measured", "cannot be combined with --quoted")
    if not (request.scenes or request.quoted):
        raise InputError("fit", "", "no scene: name scenes with [[measured]] data, or use --quoted")
    models = []
    for name in request.laws or [""]:
        law = calibration_file().law_named(name) if name else None
        settings = settings_of(law, request.settings) if law else tuple(request.settings)
        if request.quoted:
            sets = paper_data(request.quoted, settings)
        else:
            sets = [scene_data(scene, settings, request.measured) for scene in request.scenes]
        for repeated, times in Counter(data.name for data in sets).items():
            if times > 1:
                found = f"data set {repeated} {times} times"
                raise InputError("fit", "", found, "each data set once; scenes need different names")
        free = (*request.free, *(law.free if law else ()))
        if not free and not request.own:
            raise InputError("fit", "--free", f"the law {name} has no free parameter: name one, --free KEY")
        models.append(Model(name, pose(sets, free, request.own)))
    if len({model.law for model in models}) < len(models):
        raise InputError("fit", "--law", ", ".join(request.laws), "each law once")
    return models


def run_fit(request: FitRequest, runs: Path, results: Path) -> int:
    """Fits, prints and writes the results, and compares the fitted scenes on the codes; 1 if the comparison fails.

    Raises:
        InputError: The request has errors.
    """
    models = models_of(request)
    number, problem = len(models[0].problem.free), models[0].problem
    what = f"fit of {number} parameter{'s' * (number != 1)} to {counted_data(problem.rows, len(problem.data))}"
    with counted(what, unit="fit") as count:
        outcomes = solve_all(models, quick=request.quick, count=count)
    data = ", ".join(each.name for each in problem.sets)
    rows = model_rows(outcomes, data)
    predictions = [row for law, each in outcomes.items() for row in predict(law, each, request.predict)]
    folder, fitted = write_folder(request, outcomes, rows, predictions, results)
    best = min(rows, key=lambda row: row.aic).law
    try:
        return 0 if request.quick or not fitted else _confirm(fitted[best], runs)
    finally:  # last, so that it stays on screen, also after a failed run
        for law, outcome in outcomes.items():
            print(*([f"--- {law} ---"] * bool(law)), *lines(outcome), "", sep="\n")
        print(*comparison(rows, outcomes, predictions, request.predict), sep="\n")
        print(paths.shown(folder), flush=True)


def counted_data(rows: int, data: int) -> str:
    """Number of data, and of readings if there are traces."""
    return f"{data} numbers" if rows == data else f"{rows} readings"


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
    "deviation: fitted minus measured, in standard errors of the measurement; of a trace the rms over its readings",
    "predicted: by a fit to all other data; deviation: of this prediction, in standard errors of both",
)


def lines(outcome: Outcome) -> Iterator[str]:
    """Lines of text with parameters, data and remarks; columns without an entry are left out."""
    heading = ["parameter", "value", *(f"{each} interval" for each in RISES), "start"]
    rows = []
    for index, free in enumerate(outcome.fit.problem.free):
        value, error = outcome.value(index), outcome.error(index)
        known = isfinite(error)
        ends = [interval_text(free, outcome.interval(index, rise), value, error) if known else "" for rise in RISES.values()]
        start = quantity(float(f"{free.start:.4g}"), free.unit) if free.unit else f"{free.start:.4g}"
        if free.prior:
            start = value_text(free, free.start, free.prior)
        rows.append([free.label, value_text(free, value, error * outcome.enlargement), *ends, start])
    yield from _table(heading, rows)
    if outcome.enlargement != 1:
        times = f"{outcome.enlargement:.2g} times, by the scatter of the data"
        yield f"the errors above (not the intervals) are enlarged {times}, which the model does not explain"
    yield ""
    heading = ["datum", "measured", "fitted", "deviation", "predicted", "deviation"]
    cells = [[each.datum.label, *_datum_cells(each)] for each in outcome.predictions]
    yield from _table(heading, cells)
    yield from LEGEND if any(row[4] for row in cells) else LEGEND[:1]
    yield ""
    yield from outcome.sentences()


def comparison(
    rows: Sequence[ModelRow], outcomes: dict[str, Outcome], predictions: Sequence[PredictionRow], asked: Sequence[str]
) -> Iterator[str]:
    """Lines on several laws and on requested predictions."""
    if len(rows) > 1:
        heading = ["law", "chi-square", "freedom", "probability", "AIC", "BIC", "AIC above the best"]
        numbers = [(row.chi_square, row.freedom, row.probability, row.aic, row.bic, row.aic_excess) for row in rows]
        yield from text_table([heading, *([row.law, *(f"{x:.5g}" for x in each)] for row, each in zip(rows, numbers, strict=True))])
        yield from verdict(rows, {law: each.explained for law, each in outcomes.items()})
        yield from differences(predictions, [row.law for row in sorted(rows, key=lambda row: row.aic)])
        yield ""
    if asked:
        errors = [f"{row.value:.5g} ± {row.error:.2g} {row.unit}".rstrip() for row in predictions]
        cells = [[row.observable, row.scene, row.law, text] for row, text in zip(predictions, errors, strict=True)]
        yield from _table(["predicted", "scene", "law", "value"], sorted(cells))
        yield ""


def _table(heading: Sequence[str], rows: Sequence[Sequence[str]]) -> list[str]:
    """Lines of a table; columns without an entry are left out."""
    shown = [place for place in range(len(heading)) if any(row[place] for row in rows)]
    return text_table([row[place] for place in shown] for row in (heading, *rows))


def _datum_cells(line: Prediction) -> list[str]:
    """Cells of a datum: measured, fitted, deviation, predicted, deviation."""
    number = line.datum.number
    if number is None:
        return ["", "", f"{line.off:.2f}", "", ""]
    measured, fitted = f"{number.value:.4g} ± {number.error:.2g}", f"{line.fitted:.5g}"
    without = f"{line.without:.4g} ± {line.without_error:.2g}" if isfinite(line.without) else ""
    off = f"{line.without_off:.2f}" if isfinite(line.without_off) else ""
    return [measured, fitted, f"{line.off:.2f}", without, off]
