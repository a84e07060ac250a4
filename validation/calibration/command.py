"""``beads fit``: fit parameters of scenes to measured data, compare laws, and check the fitted scene with codes.

The folder ``fit-SCENE`` can be sent: fitted scene, data, tables, figure and the command that fits again.
"""

import json
import re
import shlex
import shutil
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from filecmp import cmp
from functools import partial
from math import isfinite
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import tomlkit

from drivers.base import paths
from drivers.base.errors import InputError
from drivers.base.terminal import counted, text_table
from drivers.base.units import quantity
from drivers.chain.case import build_case
from drivers.chain.chain import Array
from drivers.engines import codes
from drivers.limits import inability
from drivers.scene.model import places_of
from drivers.scene.read_scene import apply_setting, find_scene, read_scene, set_value
from drivers.scene.settings import look_up
from postproc.draw.product import write_figure
from postproc.draw.style import COLUMN_IN, pyplot
from postproc.read.measured import MEASURED
from postproc.read.observables import describe, without_unit
from validation.calibration.data import GAIN, TRIGGER, DataSet, calibration_file, paper_data, scene_data, unknown
from validation.calibration.fit import (
    DATA,
    LAWS,
    LOOKS,
    PARAMETERS,
    RISES,
    Fit,
    Tables,
    digits,
    rounded,
    rows_of,
    solve,
    suited,
    value_text,
    with_error,
)
from validation.calibration.problem import Problem, pose, simulated, stepped
from validation.compare.comparison import EngineSelection, compare_scenes
from validation.report.parts import Chapter, store_part

PREDICTIONS, AGAIN = "predictions", "again.sh"
ROW_IN, HEAD_IN = 0.55, 0.5
DECISIVE = 6.0  # excess of Akaike's criterion: a ratio of likelihoods of 20


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

    def settings_of(self, law: str) -> tuple[str, ...]:
        """Settings of a law and of the command; those of the command come last, so that ``contact.alpha=1.5`` stays."""
        return (*(calibration_file().law[law].set if law else ()), *self.settings)


def problems_of(request: FitRequest) -> dict[str, Problem]:
    """Problem of each law, on identical data.

    Raises:
        InputError: There are no free parameters or no measured data, or they have errors.
    """
    asked = [(text.partition("=")[0].strip(), text) for text in request.free]
    if request.quoted and request.measured:
        raise InputError("fit", "--measured", "cannot be combined with --quoted")
    if not (request.scenes or request.quoted):
        raise InputError("fit", "", "no scene: name scenes with [[measured]] data, or use --quoted")
    known, problems = calibration_file().law, dict[str, Problem]()
    _refuse_repetition("--law", request.laws)
    for law in {*request.laws} - {*known}:
        raise unknown("fit", "--law", law, known)
    of_laws = {law: known[law].free for law in request.laws}
    for law in request.laws or [""]:
        settings, own = request.settings_of(law), of_laws.get(law, ())
        others = {key for keys in of_laws.values() for key in keys} - {*own}  # parameters of other laws
        free = [text for key, text in asked if key not in others]
        free += [key for key in own if key not in dict(asked)]
        if not (free or request.own):
            raise InputError("fit", "--free", "no free parameter: name a key of the scene, --free contact.restitution")
        if request.quoted:
            sets = paper_data(request.quoted, settings)
        else:
            freed = any(key.endswith(f".{TRIGGER}") for key, _ in asked)
            sets = [scene_data(scene, settings, request.measured, free_trigger=freed) for scene in request.scenes]
        _refuse_repetition("data sets", [data.name for data in sets])
        problems[law] = pose(sets, free, request.own)
    return problems


def _refuse_repetition(key: str, given: Sequence[str]) -> None:
    if len({*given}) < len(given):
        raise InputError("fit", key, ", ".join(given), "each once, with different names")


def run_fit(request: FitRequest, runs: Path, results: Path) -> int:
    """Fits, prints and writes the results, and compares the fitted scenes on the codes; 1 if the comparison fails.

    Raises:
        InputError: The request has errors.
    """
    problems, fits, tables = problems_of(request), dict[str, Fit](), dict[str, Tables]()
    problem, folder = next(iter(problems.values())), folder_of(request, results)
    known = {name for data in problem.sets for name in observables_of(problem, data, request.predict, problem.start)}
    for name in request.predict:
        if without_unit(name) not in map(without_unit, known):
            raise unknown(problem.sets[0].where, "--predict", name, sorted(known))
    with counted(f"fit of {len(problem.free)} parameter{'s' * (len(problem.free) > 1)} to {problem.rows} readings"):
        for law, each in problems.items():  # each fit also starts from the earlier ones: a larger model is never worse
            seeds, names = [found.values for found in fits.values()], ", ".join(data.name for data in each.sets)
            fits[law], tables[law] = solve(each, law, names, quick=request.quick, seeds=seeds)
    predictions = pd.concat([predict(fits[law], law, request.predict) for law in fits], ignore_index=True)
    fitted = write_folder(request, fits, tables, predictions, folder)
    best = min(tables, key=lambda law: float(tables[law][LAWS]["aic"].iloc[0]))
    try:
        return 0 if request.quick or not fitted[best] else _confirm(fitted[best], runs)
    finally:  # last, so that it stays on screen, also after a failed run
        for law in fits:
            print(*([f"--- {law} ---"] * bool(law)), *lines(fits[law], tables[law]), "", sep="\n")
        predicted = predicted_lines(predictions, request.predict)
        print(*comparison(fits, tables), *predicted, paths.shown(folder), sep="\n", flush=True)


def _confirm(fitted: Sequence[Path], runs: Path) -> int:
    """Compares fitted scenes on all engines, or on the in-repo engines if no code has their contact law."""
    cases = [build_case(read_scene(path)) for path in fitted]
    modelled = any(inability(case, code) is None for case in cases for code in codes())
    if not modelled:
        print("no code has this contact law: only in-repo engines check the fitted scene")
    return compare_scenes(
        [str(path) for path in fitted], (), runs, EngineSelection(allow_missing=not modelled), unsafe=False, brief=True
    )


def lines(fit: Fit, tables: Tables) -> Iterator[str]:
    """Lines of text with parameters, data and remarks."""
    rows = []
    for row in rows_of(tables[PARAMETERS]):
        ends, unit = digits(
            (row.low_68pct, row.high_68pct, row.low_95pct, row.high_95pct), row.value, row.error, row.unit
        )
        intervals = [
            f"{low} .. {high} {unit}".rstrip() if isfinite(row.error) else "" for low, high in (ends[:2], ends[2:])
        ]
        start = with_error(row.start, row.prior, row.unit) if row.prior else rounded(row.start, row.unit)
        rows.append([row.parameter, value_text(row, fit.enlargement), *intervals, start])
    yield from text_table([["parameter", "value", *(f"{rise} interval" for rise in RISES), "start"], *rows])
    if fit.enlargement != 1:
        times = f"enlarged {fit.enlargement:.2g} times"
        yield f"errors (not intervals) are {times}, since the data scatter more than noise explains"
    yield ""
    rows = [["datum", "measured", "fitted", "deviation in standard errors"]]
    for row in rows_of(tables[DATA]):
        number = [f"{row.measured:.4g} ± {row.error:.2g}", f"{row.fitted:.5g}"] if isfinite(row.measured) else ["", ""]
        rows.append([": ".join(filter(None, (row.data_set, row.datum))), *number, f"{row.off:.2f}"])
    yield from text_table(rows)
    yield ""
    (goodness,) = rows_of(tables[LAWS])
    chance = f", probability {goodness.probability:.2g}" if goodness.freedom > 0 else ""
    yield f"chi-square {goodness.chi_square:.4g} with {goodness.freedom} degrees of freedom{chance}"
    if not fit.explained:
        yield f"{goodness.law or 'the model'} does not explain the data"
    yield from goodness.remarks.split(". ") if goodness.remarks else ()


def comparison(fits: Mapping[str, Fit], tables: Mapping[str, Tables]) -> Iterator[str]:
    """Lines on several laws: goodness of each, and the best if one is.

    Where no law explains the data, differences of AIC are divided by the best law's chi-square per degree of freedom.
    """
    if len(fits) < 2:
        return
    laws = pd.concat([tables[law][LAWS] for law in fits]).sort_values("aic", kind="stable")
    laws["above"] = laws["aic"] - laws["aic"].min()
    columns = ["law", "chi_square", "freedom", "probability", "aic", "bic", "above"]
    yield from laws[columns].to_string(index=False, float_format="{:.5g}".format).splitlines()
    excess = laws["above"] / fits[laws["law"].iloc[0]].enlargement ** 2
    near = [*laws.loc[excess < DECISIVE, "law"]]
    if len(near) > 1:
        yield f"undecided: the data do not distinguish {', '.join(near)} (AIC within {DECISIVE:g})"
    else:
        yield f"{near[0]} is the best law: the AIC of {laws['law'].iloc[1]} is {excess.iloc[1]:.3g} higher"
    yield ""


def predicted_lines(predictions: pd.DataFrame, asked: Sequence[str]) -> Iterator[str]:
    """Table of the requested predictions; nothing without one."""
    names = {without_unit(name) for name in asked}
    rows = [row for row in rows_of(predictions) if without_unit(row.datum) in names]
    cells = [(row.datum, row.data_set, row.law, with_error(row.fitted, row.fitted_error, row.unit)) for row in rows]
    yield from (*text_table([("predicted", "scene", "law", "value"), *sorted(cells)]), "") if cells else ()


def predict(fit: Fit, law: str, names: Sequence[str]) -> pd.DataFrame:
    """Observables of waves, and those asked for by ``names``, of each data set in the fitted motion."""
    parts = []
    for data in fit.problem.sets:
        at = partial(observables_of, fit.problem, data, names)
        here = pd.Series(at(fit.place), dtype=float)
        columns = [(pd.Series(at(other), dtype=float) - here) / step for other, step in stepped(fit.place)]
        slopes = pd.concat(columns, axis=1).reindex(here.index).fillna(0.0).to_numpy()
        errors = np.sqrt(np.einsum("ij,jk,ik->i", slopes, fit.covariance, slopes))
        part = {"law": law, "data_set": data.name, "datum": here.index, "fitted": here.to_numpy()}
        part |= {"fitted_error": errors, "unit": [describe(name).unit for name in here.index]}
        parts.append(pd.DataFrame(part))
    return pd.concat(parts, ignore_index=True)


def observables_of(problem: Problem, data: DataSet, names: Sequence[str], place: Array) -> dict[str, float]:
    """Observables of waves, and those asked for, at given coordinates; a gauge is added at a bead without a sensor.

    Args:
        problem: The problem.
        data: One of its data sets, which is run as its scene.
        names: Observables, with or without their units.
        place: Coordinates. Shape (parameters,).
    """
    tables = json.loads(data.tables)
    tables["run"]["duration"] = data.duration or tables["run"]["duration"]
    sensors = tables["chain"].setdefault("sensors", [])
    asked = {int(match[1]) for name in names if (match := re.match(r"bead_(\d+)_", name))}
    new = asked.difference(*(places_of(sensor["from_wall"]) for sensor in sensors))
    sensors.extend({"from_wall": bead} for bead in sorted(new, reverse=True))  # one without a mass changes nothing
    shown = replace(data, tables=json.dumps(tables))
    simulation = simulated(shown, problem.motion_values(data, place))
    values = simulation.values if simulation else {}
    known = {without_unit(name): name for name in values}
    listed = [*map(without_unit, names), *(name for name in known if describe(name).of_wave)]
    return {known[name]: values[known[name]] for name in dict.fromkeys(listed) if name in known}


def folder_of(request: FitRequest, results: Path) -> Path:
    """Folder of a fit.

    Raises:
        InputError: There is another folder of this name.
    """
    first = Path((*request.scenes, *request.quoted)[0]).stem
    folder = results.resolve() / f"fit-{first}".replace(" ", "-")  # the current folder may be that of the fit
    if folder.exists() and not (folder / f"{PARAMETERS}.csv").is_file():
        raise InputError(paths.shown(folder), "", "not a folder of a fit", "another --results, or move it away")
    return folder


def write_folder(
    request: FitRequest, fits: Mapping[str, Fit], tables: Mapping[str, Tables], predictions: pd.DataFrame, folder: Path
) -> dict[str, list[Path]]:
    """Writes the folder when all its files are made; files of an earlier fit are replaced, others stay.

    Returns:
        The fitted scenes by law.
    """
    folder.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=folder.parent, prefix=".fit-") as temporary:
        draft, whole = Path(temporary), {PREDICTIONS: predictions}
        whole |= {name: pd.concat([each[name] for each in tables.values()]) for name in (PARAMETERS, DATA, LAWS)}
        for name, table in whole.items():
            table.to_csv(draft / f"{name}.csv", index=False)
        write_figure(draw_parameters(whole[PARAMETERS]), PARAMETERS, draft)
        svg = (draft / f"{PARAMETERS}.svg").read_text(encoding="utf-8")
        fitted = {law: _write_scenes(request, law, fits[law], whole[PARAMETERS], draft) for law in fits}
        (draft / AGAIN).write_text(f"{_command(request)}\n", encoding="utf-8")
        for former in folder.glob("fit-*.toml"):
            former.unlink()
        shutil.copytree(draft, folder, dirs_exist_ok=True)
    store_part(folder.name, Chapter({}), {PARAMETERS: ("Fitted parameters", svg)}, folder.parent)
    return {law: [folder / path.name for path in of_law] for law, of_law in fitted.items()}


def draw_parameters(parameters: pd.DataFrame) -> Any:
    """A panel for each parameter: value, 68 % (thick) and 95 % interval (thin) of each law, or range if it is open."""
    names, laws = [*parameters["parameter"].unique()], [*parameters["law"].unique()]
    height = HEAD_IN + len(names) * (ROW_IN + 0.12 * len(laws))
    figure, axes = pyplot().subplots(len(names), 1, figsize=(COLUMN_IN, height), squeeze=False, layout="constrained")
    for axis, name in zip(axes[:, 0], names, strict=True):
        own = parameters[parameters["parameter"] == name]
        scale, unit = suited(own["value"].iloc[0], own["unit"].iloc[0])
        for place, row in enumerate(rows_of(own)):
            colour, marker = LOOKS[laws.index(row.law) % len(LOOKS)]
            for low, high, width in ((row.low_95pct, row.high_95pct, 0.9), (row.low_68pct, row.high_68pct, 2.6)):
                ends = np.fmax(low, row.least) * scale, np.fmin(high, row.most) * scale  # the range instead of NaN
                axis.hlines(place, *ends, colour, lw=width)
            axis.plot(row.value * scale, place, marker, color=colour, ms=5, label=row.law or None)
        title = name.removeprefix("materials.")
        axis.set_title(f"{title}{f' ({unit})' * bool(unit)}", loc="left", fontsize=8)
        axis.set(yticks=[], ylim=(len(own) - 0.4, -0.6))
        axis.locator_params(axis="x", nbins=5)
        axis.ticklabel_format(axis="x", useOffset=False)
    handles, labels = axes[0, 0].get_legend_handles_labels()
    if len(labels) > 1:
        figure.legend(handles, labels, loc="outside upper left", ncols=len(labels), fontsize=7)
    figure.supxlabel("value, 68 % (thick) and 95 % interval", fontsize=8)
    return figure


def _command(request: FitRequest) -> str:
    """Command that fits again, in the folder of the fit."""
    data = [Path(scene).stem + ".toml" for scene in request.scenes]
    options = {"--law": request.laws, "--free": request.free, "--own": request.own, "--predict": request.predict}
    if request.quoted:
        data, options["--set"] = [*request.scenes, "--quoted", ",".join(request.quoted)], request.settings
    words = [word for option, values in options.items() for value in values for word in (option, value)]
    return shlex.join(["beads", "fit", *data, *words, *(["--quick"] * request.quick), "--results", "again"])


def _write_scenes(request: FitRequest, law: str, fit: Fit, parameters: pd.DataFrame, folder: Path) -> list[Path]:
    """Writes the scenes with copies of their data; returns the fitted scenes."""
    written, ending = list[Path](), f"-{law.replace(' ', '-')}" if len(request.laws) > 1 else ""
    rows = {row.parameter: row for row in rows_of(parameters[parameters["law"] == law])}
    for source in dict.fromkeys(request.scenes or [data.source for data in fit.problem.sets]):
        path = find_scene(source)
        data = next((each for each in fit.problem.sets if each.name == path.stem and each.entries), None)
        if data:
            _write_scene(folder / path.name, path, request.settings, data, fit, {})
        written.append(folder / f"fit-{path.stem}{ending}.toml")
        _write_scene(written[-1], path, request.settings_of(law), data, fit, rows)
    return written


def _write_scene(
    path: Path, source: Path, settings: Sequence[str], data: DataSet | None, fit: Fit, rows: Mapping[str, Any]
) -> None:
    """Writes a scene file with settings, data, and values of rows by label, and with the comments of its source."""
    document: Any = tomlkit.parse(source.read_text(encoding="utf-8"))
    for setting in settings:
        apply_setting(document, setting)
    for free in fit.problem.free:
        row = rows.get(free.label)
        if row and free.own in ("", source.stem) and free.of_motion:
            value = float(f"{row.value:.6g}")
            set_value(document, free.key, quantity(value, row.unit) if row.unit else value, str(source))
            if not isinstance(look_up(document, free.key.rpartition(".")[0]), tomlkit.items.InlineTable):
                # in an inline table it would hide the rest of the line
                look_up(document, free.key).comment(f"fitted: {value_text(row, fit.enlargement)}")
    if data:
        document[MEASURED] = _entries(data, path.parent, rows)
    path.write_text(tomlkit.dumps(document), encoding="utf-8")


def _copied(file: Path, folder: Path) -> str:
    """Copies a measured file; its new path, relative to the folder."""
    target = folder / DATA / file.name
    target.parent.mkdir(exist_ok=True)
    while target.exists() and not cmp(file, target, shallow=False):  # a file of the same name from another folder
        target = target.with_stem(f"{target.stem}-other")
    shutil.copyfile(file, target)
    return str(target.relative_to(folder))


def _entries(data: DataSet, folder: Path, rows: Mapping[str, Any]) -> Any:
    """``[[measured]]`` tables of a data set, with copied files, and with gains and triggers of fitted rows by label."""
    tables, channels = tomlkit.aot(), {channel.key: channel for channel in data.channels}
    for key, entry in data.entries.items():
        values = entry.model_dump(exclude_none=True, exclude_unset=True)
        if channel := channels.get(key):
            values["file"] = _copied(channel.trace.file, folder)
            trigger = rows.get(f"{data.name}: {channel.file_key}.{TRIGGER}")
            gain = rows.get(f"{data.name}: {key}.{GAIN}")
            trigger_s = trigger.value if trigger else channel.trigger_s
            if trigger_s is not None:
                values[TRIGGER] = quantity(float(f"{trigger_s:.9g}"), "s")
            if gain:
                error = abs(gain.error / gain.value)
                values["gain_uncertainty"] = float(f"{error:.2g}") if error < 1 else entry.gain_uncertainty
                number = f"{gain.value:.6g}"
                values[GAIN] = float(number) if channel.trace.unit == "N" else f"{number} N/{channel.trace.unit}"
        tables.append(tomlkit.item(values))
    return tables
