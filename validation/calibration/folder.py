"""Requests of fits, and the folder ``fit-SCENE`` that a fit writes and that predictions and designs read.

It can be sent: scenes and data, fitted scenes, tables, a figure, and in ``fit.json`` the request, with the laws and the
bounds of the parameters, by which it fits again elsewhere.
"""

import json
import re
import shutil
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from filecmp import cmp
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import tomlkit
from pydantic import Field

from drivers.base import paths
from drivers.base.errors import InputError
from drivers.base.files import read_file
from drivers.base.messages import validate
from drivers.base.units import quantity
from drivers.scene.model import Part
from drivers.scene.read_scene import apply_setting, find_scene, set_value
from drivers.scene.settings import look_up
from postproc.draw.product import write_figure
from postproc.draw.style import COLUMN_IN, pyplot
from postproc.read.measured import MEASURED
from validation.calibration.data import GAIN, TRIGGER, DataSet, paper_data, scene_data, with_settings
from validation.calibration.fit import DATA, LAWS, LOOKS, PARAMETERS, Fit, Tables, rows_of, suited, value_text
from validation.calibration.parameters import Free, Law, Texts, law_of
from validation.calibration.problem import Problem, pose
from validation.report.parts import Chapter, store_part

REQUEST = "fit.json"
ROW_IN, HEAD_IN = 0.55, 0.5
SAME = 1e-3  # relative, of chi-square: a repeated computation


class FitRequest(Part):
    """What to fit, to which data.

    Attributes:
        scenes: Names or files of scenes with measured data.
        free, own: Options ``--free`` and ``--own``: keys with or without bounds.
        law: Laws to compare by name, with their own free parameters; none for that of the scene.
        predict: Observables to predict.
        quoted: Names of data sets of the paper.
        measured: CSV file that replaces the files of the scene.
        settings: Settings applied to the scenes.
        quick: True to omit profiles, left-out data and runs of codes.
    """

    scenes: Texts = ()
    free: Texts = ()
    own: Texts = ()
    law: dict[str, Law] = Field(default_factory=dict)
    predict: Texts = ()
    quoted: Texts = ()
    measured: Path | None = None
    settings: Texts = ()
    quick: bool = False

    def settings_of(self, law: str) -> tuple[str, ...]:
        """Settings of a law and of the command; those of the command come last, so that ``contact.alpha=1.5`` stays."""
        return (*(self.law[law].set if law else ()), *self.settings)


@dataclass(frozen=True)
class Fitted:
    """Fits with their folder.

    Attributes:
        fits: Fit of each law; the law is an empty text if it is that of the scene.
        tables: ``parameters``, ``data``, ``laws``, ``exact`` and ``predictions`` of all laws.
    """

    folder: Path
    request: FitRequest
    fits: Mapping[str, Fit]
    tables: Tables

    def scenes(self, law: str) -> list[Path]:
        """Fitted scenes of a law."""
        ending = "-" + re.sub("[ =,]+", "-", law) if len(self.fits) > 1 else ""
        return [self.folder / f"fit-{source.stem}{ending}.toml" for source in self.sources]

    @property
    def sources(self) -> list[Path]:
        """Files of the scenes that are fitted."""
        sets = next(iter(self.fits.values())).problem.sets
        return [*map(find_scene, dict.fromkeys(self.request.scenes or [data.source for data in sets]))]


def request_of(
    scenes: Sequence[str | Path],
    free: Sequence[str] = (),
    laws: Sequence[str] = (),
    uncertain: Sequence[str] = (),
    **more: Any,
) -> FitRequest:
    """Request of the words of a command, or of the folder of a fit with further words.

    Raises:
        InputError: A law is unknown or named twice, or the folder is not that of a fit.
    """
    for text in uncertain:
        if not all(map(str.strip, text.partition("="))):
            raise InputError("fit", "--uncertain", text, "KEY=ERROR, such as striker.speed=1%")
    free = (*free, *("=±".join(text.split("=", 1)) for text in uncertain))
    asked = {text.partition("=")[0].strip(): text for text in free}
    refuse_repetition("--law", laws)
    given = FitRequest(free=free, law={law: law_of(law, asked) for law in laws}, **more)
    if len(scenes) != 1 or not Path(scenes[0]).is_dir():
        return given.model_copy(update={"scenes": (*map(str, scenes),)})
    former = read_request(Path(scenes[0]))
    both = {key: getattr(former, key) + getattr(given, key) for key in ("free", "own", "predict", "settings")}
    both |= {"law": {**former.law, **given.law}, "quick": given.quick, "measured": given.measured}
    return former.model_copy(update=both)


def problems_of(request: FitRequest) -> dict[str, Problem]:
    """Problem of each law, on identical data.

    Raises:
        InputError: There are no free parameters or no measured data, or they have errors.
    """
    if request.quoted and request.measured:
        raise InputError("fit", "--measured", "cannot be combined with --quoted")
    if not (request.scenes or request.quoted):
        raise InputError("fit", "", "no scene: name scenes with [[measured]] data, or use --quoted")
    problems = dict[str, Problem]()
    for law in request.law or [""]:
        problems[law] = problem_of(request, law, next((each.sets for each in problems.values()), ()))
    return problems


def problem_of(request: FitRequest, law: str, known: Sequence[DataSet] = ()) -> Problem:
    """Problem of a law of a request; the data are read if they are not known.

    Raises:
        InputError: As of ``problems_of``.
    """
    asked = {text.partition("=")[0].strip(): text for text in request.free}
    keys = {name: [text.partition("=")[0] for text in each.free] for name, each in request.law.items()}
    others = {key for of_law in keys.values() for key in of_law} - {*keys.get(law, ())}  # parameters of other laws
    own = {text.partition("=")[0]: text for text in (request.law[law].free if law else ())}
    free = [text for key, text in (asked | own | asked).items() if key not in others]
    if not (free or request.own):
        raise InputError("fit", "--free", "no free parameter: name a key of the scene, --free contact.restitution")
    settings, freed = request.settings_of(law), any(key.endswith(f".{TRIGGER}") for key in asked)
    if request.quoted:
        sets = paper_data(request.quoted, settings)
    elif known:
        sets = [with_settings(data, settings) for data in known]
    else:
        sets = [scene_data(scene, settings, request.measured, free_trigger=freed) for scene in request.scenes]
    refuse_repetition("data sets", [data.name for data in sets])
    return pose(sets, free, request.own)


def refuse_repetition(key: str, given: Sequence[str]) -> None:
    """Refuse a name that stands twice."""
    if len({*given}) < len(given):
        raise InputError("fit", key, ", ".join(given), "each once, with different names")


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


def folder_named(name: str, results: Path) -> Path:
    """Folder of a fit by its path, or by its name in the folder of results."""
    return Path(name) if Path(name).exists() else results / name


def read_request(folder: Path) -> FitRequest:
    """Request of a fit from its folder, with the scenes of the folder.

    Raises:
        InputError: The folder is not that of a fit, or the file has errors.
    """
    file = folder / REQUEST
    try:
        request = validate(FitRequest, json.loads(read_file(file, "a JSON file")), file)
    except OSError as error:
        raise InputError(
            paths.shown(folder), "", f"no {REQUEST} in it", "a folder that beads fit has written"
        ) from error
    except json.JSONDecodeError as error:
        raise InputError(paths.shown(file), "", f"not valid JSON: {error}") from error
    return request.model_copy(update={"scenes": tuple(str(folder / scene) for scene in request.scenes)})


def read_fits(folder: Path) -> Fitted:
    """Fits of a folder, posed again from its scenes and data at the parameters found.

    Raises:
        InputError: The folder is not that of a fit, or its files are not those of one fit.
    """
    request = read_request(folder)
    tables = {path.stem: pd.read_csv(path) for path in (folder / f"{name}.csv" for name in (PARAMETERS, LAWS))}
    found, fits = {name: table.fillna({"law": ""}) for name, table in tables.items()}, dict[str, Fit]()
    for law, problem in problems_of(request).items():
        values = found[PARAMETERS].query("law == @law").set_index("parameter")["value"]
        values.index = values.index.str.replace(rf"{MEASURED}\.(?!\d)", f"{MEASURED}.0.", regex=True)  # of --measured
        stated = found[LAWS].query("law == @law")["chi_square"]
        same = set(values.index) == {free.label for free in problem.free} and len(stated) == 1
        if same:
            fits[law] = Fit(problem, np.array([free.coordinate(values[free.label]) for free in problem.free]))
        if not same or abs(fits[law].chi_square - stated.iloc[0]) > SAME * (1 + stated.iloc[0]):
            was = f"chi-square {fits[law].chi_square:.5g} for {stated.iloc[0]:.5g}" if same else "other parameters"
            allowed = f"the files of one fit; beads fit {paths.shown(folder)} fits again"
            raise InputError(paths.shown(folder), law, f"changed files: {was}", allowed)
    return Fitted(folder, request, fits, found)


def write_folder(fitted: Fitted) -> None:
    """Write the folder when all its files are made; files of an earlier fit are replaced, others stay."""
    folder, tables = fitted.folder, fitted.tables
    folder.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=folder.parent, prefix=".fit-") as temporary:
        draft = Path(temporary)
        for name, table in tables.items():
            table.to_csv(draft / f"{name}.csv", index=False)
        write_figure(draw_parameters(tables[PARAMETERS]), PARAMETERS, draft)
        svg = (draft / f"{PARAMETERS}.svg").read_text(encoding="utf-8")
        _write_scenes(replace(fitted, folder=draft))
        stored = _complete(fitted).model_dump_json(indent=2, exclude_defaults=True)
        (draft / REQUEST).write_text(f"{stored}\n", encoding="utf-8")
        for former in folder.glob("fit-*.toml"):
            former.unlink()
        shutil.copytree(draft, folder, dirs_exist_ok=True)
    store_part(folder.name, Chapter({}), {PARAMETERS: ("Fitted parameters", svg)}, folder.parent)


def _complete(fitted: Fitted) -> FitRequest:
    """The request for the scenes of its folder, with the bounds that parameters had."""
    request, free = (
        fitted.request,
        [each for fit in fitted.fits.values() for each in fit.problem.free if each.of_motion],
    )
    bounded = {each.key: option_of(each) for each in free}

    def complete(texts: Sequence[str]) -> tuple[str, ...]:
        return tuple(bounded.get(text, text) for text in texts)

    update: dict[str, Any] = {"free": complete(request.free), "own": complete(request.own), "measured": None}
    update["law"] = {name: law.model_copy(update={"free": complete(law.free)}) for name, law in request.law.items()}
    if not request.quoted:  # the scenes have their data
        update["scenes"] = tuple(Path(scene).stem + ".toml" for scene in request.scenes)
        update["settings"] = tuple(text for text in request.settings if not text.startswith(MEASURED))
    return request.model_copy(update=update)


def option_of(free: Free) -> str:
    """Text of a parameter with its bounds, or with its prior knowledge."""
    ends = (free.start, free.prior) if free.prior else (free.low, free.high)
    return f"{free.key}=" + ("±" if free.prior else "..").join(f"{end!r} {free.unit}".strip() for end in ends)


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


def _write_scenes(fitted: Fitted) -> None:
    """Write the scenes with copies of their data, and the fitted ones of each law."""
    request, parameters = fitted.request, fitted.tables[PARAMETERS]
    for law, fit in fitted.fits.items():
        rows = {row.parameter: row for row in rows_of(parameters[parameters["law"] == law])}
        for source, written in zip(fitted.sources, fitted.scenes(law), strict=True):
            data = next((each for each in fit.problem.sets if each.name == source.stem and each.entries), None)
            if data:
                _write_scene(fitted.folder / source.name, source, request.settings, data, fit, {})
            _write_scene(written, source, request.settings_of(law), data, fit, rows)


def _write_scene(
    path: Path, source: Path, settings: Sequence[str], data: DataSet | None, fit: Fit, rows: Mapping[str, Any]
) -> None:
    """Writes a scene file with settings, data, and values of rows by label, and with the comments of its source."""
    document: Any = tomlkit.parse(source.read_text(encoding="utf-8"))
    for setting in settings:
        apply_setting(document, setting)
    for free in fit.problem.free:
        row = rows.get(free.label)
        if row and free.belongs_to(source.stem) and free.of_motion:
            value = float(f"{row.value:.6g}")
            set_value(document, free.key, quantity(value, row.unit) if row.unit else value, str(source))
            if not isinstance(look_up(document, free.key.rpartition(".")[0]), tomlkit.items.InlineTable):
                # in an inline table it would hide the rest of the line
                look_up(document, free.key).comment(f"fitted: {value_text(row, fit.enlargement)}")
    if drive := look_up(document, "drive.file"):
        document["drive"]["file"] = _copied(source.parent / drive, path.parent)
    if data:
        document[MEASURED] = _entries(data, path.parent, rows)
    path.write_text(tomlkit.dumps(document), encoding="utf-8")


def _copied(file: Path, folder: Path) -> str:
    """Copy a measured file, once for equal content; its new path, relative to the folder."""
    target = folder / DATA / file.name
    target.parent.mkdir(exist_ok=True)
    equal = next((each for each in target.parent.iterdir() if cmp(file, each, shallow=False)), None)
    while not equal and target.exists():  # a file of the same name from another folder
        target = target.with_stem(f"{target.stem}-other")
    if not equal:
        shutil.copyfile(file, target)
    return str((equal or target).relative_to(folder))


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
