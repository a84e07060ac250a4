"""``beads fit``: fits parameters of scenes to measured data and checks the fitted scene with codes."""

import os
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from math import isfinite
from pathlib import Path
from typing import Any

from drivers.base import paths
from drivers.base.errors import InputError
from drivers.base.files import whole_file
from drivers.base.progress import counted
from drivers.base.text_table import text_table
from drivers.base.units import quantity
from drivers.chain.case import build_case
from drivers.engines import codes
from drivers.limits.refusal import inability
from drivers.scene.read_scene import apply_setting, find_scene, read_scene, set_value
from drivers.scene.settings import look_up
from validation.calibration.certainty import RISES, Prediction
from validation.calibration.data_sets import DataSet, paper_data, scene_data
from validation.calibration.free import GAIN, TRIGGER, Free
from validation.calibration.outcome import Outcome, interval_text, solve, value_text
from validation.calibration.problem import Problem, pose
from validation.calibration.rows import DatumRow, Parameter, datum_rows, parameter_rows
from validation.chapters import write_table
from validation.compare.compare_command import compare_scenes
from validation.compare.selection import EngineSelection

MEASURED = "measured"


@dataclass(frozen=True)
class FitRequest:
    """Arguments of the command.

    Attributes:
        scenes: Names or files of scenes with measured data.
        free, own: Options ``--free`` and ``--own``: keys with or without bounds.
        quoted: Names of data sets of the paper.
        measured: CSV file that replaces the files of the scene.
        settings: Settings applied to the scenes.
        quick: True to omit profiles, left-out data and runs of codes.
    """

    scenes: Sequence[str]
    free: Sequence[str]
    own: Sequence[str] = ()
    quoted: Sequence[str] = ()
    measured: Path | None = None
    settings: Sequence[str] = ()
    quick: bool = False


def problem_of(request: FitRequest) -> Problem:
    """Calibration problem of a request.

    Raises:
        InputError: there are no free parameters or no measured data, or they have errors.
    """
    if not request.free and not request.own:
        raise InputError("fit", "--free", "no free parameter: name a key of the scene, --free contact.restitution")
    if request.quoted:
        if request.measured:
            raise InputError("fit", "--measured", "cannot be combined with --quoted")
        sets = paper_data(request.quoted, request.settings)
    else:
        sets = [scene_data(scene, request.settings, request.measured) for scene in request.scenes]
    if not sets:
        raise InputError("fit", "", "no scene: name scenes with [[measured]] data, or use --quoted")
    for name, count in Counter(data.name for data in sets).items():
        if count > 1:
            raise InputError(
                "fit", "", f"data set {name} {count} times", "each data set once; scenes need different names"
            )
    return pose(sets, request.free, request.own)


def run_fit(request: FitRequest, runs: Path, results: Path) -> int:
    """Fits, prints and writes the results, and compares the fitted scenes on the codes; 1 if the comparison fails.

    Raises:
        InputError: the request has errors.
    """
    problem = problem_of(request)
    number = len(problem.free)
    with counted(f"fit of {number} parameter{'s' * (number != 1)} to {len(problem.data)} data", unit="fit") as count:
        outcome = solve(problem, quick=request.quick, count=count)
    name = f"fit-{Path((*request.scenes, *request.quoted)[0]).stem}"
    law, data = " ".join(request.settings), ", ".join(each.name for each in problem.sets)
    write_table(results / f"{name}.csv", Parameter, parameter_rows(law, data, outcome))
    write_table(results / f"{name}-data.csv", DatumRow, datum_rows(law, data, outcome))
    sources = request.scenes or [data.source for data in outcome.fit.problem.sets]
    fitted = [write_fitted(source, request.settings, outcome, results) for source in dict.fromkeys(sources)]
    try:
        return 0 if request.quick or not fitted else _confirm(fitted, runs)
    finally:  # last, so that it stays on screen, also after a failed run
        print(*lines(outcome), "", sep="\n")
        written = [*(results / f"{name}{end}" for end in (".csv", "-data.csv")), *fitted]
        print(*map(paths.shown, written), sep="\n", flush=True)


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
    found = outcome.fit
    heading = ["parameter", "value", *(f"{each} interval" for each in RISES), "start"]
    rows = []
    for index, free in enumerate(found.problem.free):
        value, error = free.value(float(found.place[index])), float(outcome.certainty.errors[index])
        profile = outcome.profiles.get(free.label)
        ends = [interval_text(free, profile.interval(rise), value, error) if profile else "" for rise in RISES.values()]
        start = quantity(float(f"{free.start:.4g}"), free.unit) if free.unit else f"{free.start:.4g}"
        rows.append([free.label, value_text(free, value, error * outcome.enlargement), *ends, start])
    yield from _table(heading, rows)
    if outcome.enlargement != 1:
        times = f"{outcome.enlargement:.2g} times, by the scatter of the data"
        yield f"the errors above (not the intervals) are enlarged {times}, which the model does not explain"
    yield ""
    heading = ["datum", "measured", "fitted", "deviation", "predicted", "deviation", ""]
    cells = [[each.datum.label, *_datum_cells(each)] for each in outcome.predictions]
    yield from _table(heading, cells)
    yield from LEGEND if any(row[4] for row in cells) else LEGEND[:1]
    yield ""
    yield from outcome.sentences()


def _table(heading: Sequence[str], rows: Sequence[Sequence[str]]) -> list[str]:
    """Lines of a table; columns without an entry are left out."""
    shown = [place for place in range(len(heading)) if any(row[place] for row in rows)]
    return text_table([row[place] for place in shown] for row in (heading, *rows))


def _datum_cells(line: Prediction) -> list[str]:
    """Cells of a datum: measured, fitted, deviation, predicted, deviation, remark."""
    number = line.datum.number
    if number is None:
        return ["", "", f"{line.off:.2f}", "", "", ""]
    measured, fitted = f"{number.value:.4g} ± {number.error:.2g}", f"{line.fitted:.5g}"
    without = f"{line.without:.4g} ± {line.without_error:.2g}" if isfinite(line.without) else ""
    off = f"{line.without_off:.2f}" if isfinite(line.without_off) else ""
    return [measured, fitted, f"{line.off:.2f}", without, off, "" if number.fitted else "(not fitted)"]


def write_fitted(source: str, settings: Sequence[str], outcome: Outcome, results: Path) -> Path:
    """Writes ``fit-SCENE.toml``, the scene file with fitted values and the original comments."""
    import tomlkit

    path = find_scene(source)
    document: Any = tomlkit.parse(path.read_text(encoding="utf-8"))
    for setting in settings:
        apply_setting(document, setting)
    for index, free in enumerate(outcome.fit.problem.free):
        if free.own in ("", path.stem) and not free.key.startswith(MEASURED):
            set_value(document, free.key, _rounded(free, outcome, index), str(path))
            value, error = free.value(float(outcome.fit.place[index])), float(outcome.certainty.errors[index])
            parent = look_up(document, free.key.rpartition(".")[0])
            if not isinstance(parent, tomlkit.items.InlineTable):  # a comment would hide the rest of the line
                text = value_text(free, value, error * outcome.enlargement)
                look_up(document, free.key).comment(f"fitted: {text}")
    for data in outcome.fit.problem.sets:
        if data.name == path.stem and data.records:
            document[MEASURED] = _entries(data, outcome, results)
    results.mkdir(parents=True, exist_ok=True)
    fitted = results / f"fit-{path.stem}.toml"
    with whole_file(fitted) as draft:
        draft.write_text(tomlkit.dumps(document), encoding="utf-8")
    return fitted


def _rounded(free: Free, outcome: Outcome, index: int) -> str | float:
    """Value to six digits, with its unit."""
    value = float(f"{free.value(float(outcome.fit.place[index])):.6g}")
    return quantity(value, free.unit) if free.unit else value


def _entries(data: DataSet, outcome: Outcome, results: Path) -> Any:
    """``[[measured]]`` tables of a data set with fitted gains and triggers and paths relative to ``results``."""
    import tomlkit

    found, files = tomlkit.aot(), {record.key: record.measured.file for record in data.records}
    labels = [free.label for free in outcome.fit.problem.free]
    for key, entry in data.entries.items():
        values = entry.model_dump(exclude_none=True, exclude_unset=True)
        if key in files:
            values["file"] = os.path.relpath(files[key], results)
            if entry.trigger is not None:
                values[TRIGGER] = quantity(entry.trigger, "s")
        for end in (TRIGGER, GAIN) if key in files else ():
            label = f"{data.name}: {key}.{end}"
            if label in labels:
                index = labels.index(label)
                fitted = _rounded(outcome.fit.problem.free[index], outcome, index)
                values[end] = fitted if end == TRIGGER else _scaled(entry.gain, float(fitted), outcome, index)
        found.append(tomlkit.item({name: values[name] for name in values}))
    return found


def _scaled(gain: str | float | None, fitted: float, outcome: Outcome, index: int) -> str | float:
    """A fitted gain in the unit used by the scene."""
    if not isinstance(gain, str):
        return fitted
    number, unit = gain.split(None, 1)
    return f"{float(number) * fitted / outcome.fit.problem.free[index].start:.6g} {unit}"
