"""``beads fit``: fit parameters of scenes to measured data, compare laws, and check the fitted scene with codes.

The folder ``fit-SCENE`` can be sent: scenes and data, fitted scenes, tables, a figure, and in ``fit.json`` the request,
with the laws and the bounds of the parameters, by which it fits again elsewhere. Predictions and designs read it.
"""

import json
import re
import shutil
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from filecmp import cmp
from math import isfinite, nan
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import pandas as pd
import tomlkit
from pydantic import Field

from drivers.base import paths
from drivers.base.errors import InputError
from drivers.base.messages import validate
from drivers.base.terminal import counted, text_table
from drivers.base.units import quantity
from drivers.chain.case import build_case
from drivers.engines import codes
from drivers.limits import inability
from drivers.scene.model import Part
from drivers.scene.read_scene import apply_settings, find_scene, read_scene
from drivers.scene.settings import look_up, setting_texts
from postproc.draw.plot import COLUMN_IN, pyplot, write_figure
from postproc.read.measured import MEASURED, entries_of
from validation.calibration.fit import (
    DATA,
    DECISIVE,
    EXACT,
    LAWS,
    LEANING,
    LOOKS,
    PARAMETERS,
    RISES,
    Fit,
    Tables,
    digits,
    excess_of,
    rounded,
    rows_of,
    solve,
    suited,
    taken_as_exact,
    value_text,
    with_error,
)
from validation.calibration.parameters import GAIN, OF_LAWS, TRIGGER, Free, Texts, keys_of, law_of
from validation.calibration.problem import DataSet, Problem, checked, paper_data, pose, scene_data
from validation.compare.comparison import EngineSelection, compare_scenes
from validation.report.parts import Chapter, store_part

REQUEST = "fit.json"
ROW_IN, HEAD_IN = 0.55, 0.5
SAME = 1e-3  # relative, of chi-square: a repeated computation
MAX_EXACT = 8  # printed numbers that are taken as exact
LEAST_CHANGE = 0.1  # standard errors by 1 % of such a number: smaller ones are in the table alone


class FitRequest(Part):
    """Parameters to fit, and the data.

    Attributes:
        scenes: Names or files of scenes with measured data.
        free, own: Options ``--free`` and ``--own``: keys with or without bounds.
        laws: Laws to compare, as of ``--law``; none for that of the scene.
        quoted: Names of data sets of the paper.
        measured: CSV file that replaces the files of the scene.
        settings: Settings applied to the scenes.
        quick: True to omit profiles and runs of codes.
    """

    scenes: Texts = ()
    free: Texts = ()
    own: Texts = ()
    laws: Texts = ()
    quoted: Texts = ()
    measured: Annotated[Path | None, Field(strict=False)] = None
    settings: Texts = ()
    quick: bool = False


@dataclass(frozen=True)
class Fitted:
    """Fits with their folder.

    Attributes:
        fits: Fit of each law; the law is an empty text if it is that of the scene.
        tables: ``parameters``, ``data``, ``laws`` and ``exact`` of all laws.
    """

    folder: Path
    request: FitRequest
    fits: Mapping[str, Fit] = field(repr=False)
    tables: Tables = field(repr=False)

    def scenes(self, law: str) -> list[Path]:
        """Fitted scenes of a law."""
        ending = "-" + re.sub("[ =,]+", "-", law) if len(self.fits) > 1 else ""
        return [self.folder / f"fit-{source.stem}{ending}.toml" for source in self.sources]

    @property
    def sources(self) -> list[Path]:
        """Files of the scenes that are fitted."""
        sets = next(iter(self.fits.values())).problem.sets
        return [*map(find_scene, dict.fromkeys(data.source for data in sets))]


def request_of(scenes: Sequence[str | Path], *, free: Texts = (), uncertain: Texts = (), **more: Any) -> FitRequest:
    """Request of the words of a command, or of the folder of a fit with further words.

    Raises:
        InputError: An error is missing, or the folder is not that of a fit.
    """
    folders = [scene for scene in scenes if Path(scene).is_dir()]
    if folders and len(scenes) > 1:
        raise InputError("fit", "", f"{folders[0]}, a folder, among {len(scenes)} scenes", "the folder of a fit alone")
    for text in uncertain:
        if not all(map(str.strip, text.partition("="))):
            raise InputError("fit", "--uncertain", text, "KEY=ERROR, such as striker.speed=1%")
    texts = (*free, *(text.replace("=", "=±", 1) for text in uncertain))
    given = validate(FitRequest, {"scenes": [*map(str, scenes)], "free": texts, **more}, "fit")
    if not folders:
        return given
    former = read_request(Path(folders[0]))
    update = {key: getattr(former, key) + getattr(given, key) for key in ("laws", "settings")}
    for key in ("free", "own"):
        update[key] = (*(by_key(getattr(former, key)) | by_key(getattr(given, key), f"--{key}")).values(),)
    return former.model_copy(update=update | {"quick": given.quick, "measured": given.measured})


def by_key(options: Sequence[str], option: str = "--free", command: str = "fit") -> dict[str, str]:
    """Options ``KEY`` or ``KEY=...`` by their keys.

    Raises:
        InputError: A key stands twice.
    """
    asked = {text.partition("=")[0].strip(): text for text in options}
    if len(asked) < len(options):
        raise InputError(command, option, ", ".join(options), "each key once")
    return asked


def problems_of(request: FitRequest) -> dict[str, Problem]:
    """Problem of each law, on identical data.

    Raises:
        InputError: There are no free parameters or no measured data, or they have errors.
    """
    if request.quoted and (request.scenes or request.measured):
        raise InputError("fit", "--quoted", "not allowed with scenes or --measured, whose data would not be fitted")
    if not (request.scenes or request.quoted):
        raise InputError("fit", "", "no scene: name scenes with [[measured]] data, or use --quoted")
    if not (request.free or request.own or any(map(keys_of, request.laws))):
        raise InputError("fit", "--free", "no free parameter: name a key of the scene, --free contact.restitution")
    names = request.quoted or [Path(scene).stem for scene in request.scenes]
    if len({*names}) < len(names):
        raise InputError("fit", "data sets", ", ".join(names), "each once, with different names")
    sets = paper_data(request.quoted, request.settings)
    sets = sets or [scene_data(scene, request.settings, request.measured) for scene in request.scenes]
    return {law: problem_of(request, law, sets) for law in request.laws or ("",)}


def problem_of(request: FitRequest, law: str, sets: Sequence[DataSet]) -> Problem:
    """Problem of a law: its own first key is free, its constants and keys of other laws are not.

    Settings of the command come after those of the law, so that ``contact.alpha=1.5`` stays.

    Raises:
        InputError: As of ``problems_of``.
    """
    own, asked = keys_of(law), by_key(request.free)
    fixed = {f"contact.{constant.partition('=')[0].strip()}" for constant in law.split(",")[1:]}
    fixed |= {*OF_LAWS} - {*own} if law else set()
    free = [asked.get(key, key) for key in dict.fromkeys((*asked, *own[:1])) if key not in fixed]
    texts = law_of(law, asked)
    begun = [replace(data, tables=checked(data.source, (*texts, *data.settings)).tables) for data in sets]
    return pose(begun, free, request.own)


def folder_of(request: FitRequest, results: Path) -> Path:
    """Folder of a fit.

    Raises:
        InputError: There is another folder of this name.
    """
    first = Path((*request.scenes, *request.quoted)[0]).stem
    folder = results.resolve() / f"fit-{first}".replace(" ", "-")  # the current folder may be that of the fit
    if folder.exists() and not (folder / f"{PARAMETERS}.csv").is_file():
        raise InputError(paths.shown(folder), "", "a folder that is not of a fit", "another --results, or move it away")
    return folder


def read_request(folder: Path) -> FitRequest:
    """Request of a fit from its folder, with the scenes of the folder.

    Raises:
        InputError: The folder is not that of a fit, or the file has errors.
    """
    file = folder / REQUEST
    for name in (REQUEST, f"{PARAMETERS}.csv", f"{LAWS}.csv"):
        if not (folder / name).is_file():
            raise InputError(paths.shown(folder), "", f"no {name} in it", "a folder that beads fit has written")
    try:
        request = validate(FitRequest, json.loads(file.read_bytes()), file)
    except ValueError as error:
        raise InputError(paths.shown(file), "", f"not valid JSON: {error}") from error
    return request.model_copy(update={"scenes": tuple(str(folder / scene) for scene in request.scenes)})


def read_fits(folder: Path) -> Fitted:
    """Fits of a folder, posed again from its scenes and data at the parameters found.

    Raises:
        InputError: The folder is not that of a fit, or its files are not those of one fit.
    """
    request, fits = read_request(folder), dict[str, Fit]()
    allowed = f"those of one fit; beads fit {paths.shown(folder)} fits again"
    try:
        tables = {name: pd.read_csv(folder / f"{name}.csv").fillna({"law": ""}) for name in (PARAMETERS, LAWS)}
        values = tables[PARAMETERS].set_index(["law", "parameter"])["value"].astype(float)
        stated = tables[LAWS].set_index("law")["chi_square"].astype(float)
    except (ValueError, LookupError) as error:
        raise InputError(paths.shown(folder), "", f"damaged tables: {error}", allowed) from error
    for law, problem in problems_of(request).items():
        found = [free.coordinate(values.get((law, free.label), nan)) for free in problem.free]
        fits[law] = Fit(problem, np.array(found))
        if not abs(fits[law].chi_square - stated.get(law, nan)) <= SAME * (1 + stated.get(law, nan)):
            raise InputError(paths.shown(folder), law, "changed files: another chi-square", allowed)
    return Fitted(folder, request, fits, tables)


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
    """The request for the scenes of its folder, with the bounds that shared parameters had."""
    request, free = fitted.request, [each for fit in fitted.fits.values() for each in fit.problem.free]
    bounded = {each.key: option_of(each) for each in free if each.of_motion and not each.own}  # others differ by scene
    asked = by_key(request.free)
    asked |= {key: key for law in request.laws for key in keys_of(law)[:1] if key not in asked}
    update: dict[str, Any] = {"measured": None, "free": tuple(bounded.get(text, text) for text in asked.values())}
    if not request.quoted:  # the scenes have their data
        update["scenes"] = tuple(source.name for source in fitted.sources)
        update["settings"] = tuple(text for text in request.settings if not text.startswith(MEASURED))
    return request.model_copy(update=update)


def option_of(free: Free) -> str:
    """Text of a parameter with its bounds, or with its prior knowledge."""
    ends = (free.start, free.prior) if free.prior else (free.low, free.high)
    return f"{free.key}=" + ("±" if free.prior else "..").join(f"{end!r} {free.unit}".strip() for end in ends)


def draw_parameters(parameters: pd.DataFrame) -> Any:
    """A panel for each parameter: value, 68 % (thick) and 95 % interval (thin) of each law, or range if it is open."""
    groups, laws = parameters.groupby("parameter", sort=False), [*parameters["law"].unique()]
    height = HEAD_IN + len(groups) * (ROW_IN + 0.12 * len(laws))
    figure, axes = pyplot().subplots(len(groups), 1, figsize=(COLUMN_IN, height), squeeze=False, layout="constrained")
    for axis, (name, own) in zip(axes[:, 0], groups, strict=True):
        scale, unit = suited(own["value"].iloc[0], own["unit"].iloc[0])
        for place, row in enumerate(rows_of(own)):
            colour, marker = LOOKS[laws.index(row.law) % len(LOOKS)]
            for low, high, width in ((row.low_95pct, row.high_95pct, 0.9), (row.low_68pct, row.high_68pct, 2.6)):
                ends = np.fmax(low, row.least) * scale, np.fmin(high, row.most) * scale  # the range instead of NaN
                axis.hlines(place, *ends, colour, lw=width)
            axis.plot(row.value * scale, place, marker, color=colour, ms=5, label=row.law or None)
        axis.set_title(f"{name}{f' ({unit})' * bool(unit)}".removeprefix("materials."), loc="left", fontsize=8)
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
    request = fitted.request
    for law, fit in fitted.fits.items():
        rows = {row.parameter: row for row in rows_of(fitted.tables[PARAMETERS]) if row.law == law}
        for source, written in zip(fitted.sources, fitted.scenes(law), strict=True):
            if not request.quoted:
                _write_scene(fitted.folder / source.name, source, request, "", fit, {})
            _write_scene(written, source, request, law, fit, rows)


def _write_scene(path: Path, source: Path, request: FitRequest, law: str, fit: Fit, rows: Mapping[str, Any]) -> None:
    """Writes a scene file with settings, data, and values of rows by label, and with the comments of its source."""
    document: Any = tomlkit.parse(source.read_text(encoding="utf-8"))
    apply_settings(document, (*law_of(law, by_key(request.free)), *request.settings))
    for free in fit.problem.free:
        row = rows.get(free.label)
        if row and free.belongs_to(source.stem) and free.of_motion:
            apply_settings(document, setting_texts({free.key: float(f"{row.value:.6g}")}))
            if not isinstance(look_up(document, free.key.rpartition(".")[0]), tomlkit.items.InlineTable):
                # in which a comment would hide the rest of the line
                look_up(document, free.key).comment(f"fitted: {value_text(row, fit.enlargement)}")
    if drive := look_up(document, "drive.file"):
        document["drive"]["file"] = _copied(source.parent / drive, path.parent)
    if not request.quoted:
        document[MEASURED] = _entries(source, request, path.parent, rows)
    path.write_text(tomlkit.dumps(document), encoding="utf-8")


def _copied(file: Path, folder: Path) -> str:
    """Copy a measured file; its new path, relative to the folder."""
    target = folder / DATA / file.name
    target.parent.mkdir(exist_ok=True)
    while target.exists() and not cmp(file, target, shallow=False):  # a file of the same name from another folder
        target = target.with_stem(f"{target.stem}-other")
    shutil.copyfile(file, target)
    return str(target.relative_to(folder))


def _entries(source: Path, request: FitRequest, folder: Path, rows: Mapping[str, Any]) -> Any:
    """``[[measured]]`` tables of a scene, with copied files, and with gains and triggers of fitted rows by label."""
    tables, (entries, home, _) = tomlkit.aot(), entries_of(read_scene(source, request.settings), request.measured, "")
    for key, entry in entries.items():
        values = entry.model_dump(exclude_none=True, exclude_unset=True)
        gain, trigger = (rows.get(f"{source.stem}: {key}.{part}") for part in (GAIN, TRIGGER))
        trigger_s = trigger.value if trigger else entry.trigger
        if entry.file:
            values["file"] = _copied(home / entry.file, folder)
        if trigger_s is not None:
            values[TRIGGER] = quantity(float(f"{trigger_s:.9g}"), "s")
        if gain and entry.file:
            error, number = abs(gain.error / gain.value), f"{gain.value:.6g}"
            values["gain_uncertainty"] = float(f"{error:.2g}") if error < 1 else entry.gain_uncertainty
            values[GAIN] = f"{number} {gain.unit}" if gain.unit else float(number)
        tables.append(tomlkit.item(values))
    return tables


def fit(
    *scenes: str | Path,
    settings: Mapping[str, Any] | Sequence[str] = (),
    results: str | Path = paths.RESULTS,
    **options: Any,
) -> Fitted:
    """Fit as ``beads fit`` does, without a check by codes.

    Args:
        scenes: Names or files of scenes with measured data, or the folder of a fit.
        settings: Values that replace those of the scenes by key, as for ``drivers.run_scene``; or ``KEY=VALUE`` texts.
        results: Folder of the fit's folder; by default ``results/`` of the checkout.
        options: ``free``, ``own``, ``laws``, ``uncertain``, ``quoted``: sequences of texts, as after the options of the
            command; ``measured``: a Path; ``quick``: True to omit profiles.

    Raises:
        InputError: The request has errors.
        RunError: The exact motion cannot be computed.

    Examples:
        >>> found = fit("example-measured", free=["contact.restitution"], quick=True, results=folder)
        >>> found.tables["parameters"].loc[0, "parameter"]
        'contact.restitution'
    """
    request = request_of(scenes, settings=setting_texts(settings), **options)
    problems, fits, of_laws = problems_of(request), dict[str, Fit](), dict[str, Tables]()
    problem, folder = next(iter(problems.values())), folder_of(request, Path(results))
    with counted(f"fit of {len(problem.free)} parameter{'s' * (len(problem.free) > 1)} to {problem.rows} readings"):
        for law, each in problems.items():  # each fit also starts from the earlier ones: a larger model is never worse
            fits[law], tables = solve(each, quick=request.quick, seeds=[found.values for found in fits.values()])
            of_laws[law] = tables | {EXACT: taken_as_exact(fits[law])}
    named = [{name: table.assign(law=law) for name, table in tables.items()} for law, tables in of_laws.items()]
    whole = {name: pd.concat([each[name] for each in named]).set_index("law").reset_index() for name in named[0]}
    fitted = Fitted(folder, request, fits, whole)
    write_folder(fitted)
    return fitted


def confirm(fitted: Fitted, runs: Path) -> int:
    """Print the results of a fit, and compare its scenes on the codes; 1 if the comparison fails."""
    best = min(fitted.fits, key=lambda law: fitted.fits[law].aic)
    try:
        return 0 if fitted.request.quick else _compare(fitted.scenes(best), runs)
    finally:  # last, so that it stays on screen, also after a failed run
        for law, found in fitted.fits.items():
            own = {name: table[table["law"] == law] for name, table in fitted.tables.items()}
            print(*([f"--- {law} ---"] * bool(law)), *lines(found, own), "", *exact_lines(own[EXACT]), "", sep="\n")
        print(*comparison(fitted), paths.shown(fitted.folder), sep="\n", flush=True)


def _compare(fitted: Sequence[Path], runs: Path) -> int:
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
        numbers = row.low_68pct, row.high_68pct, row.low_95pct, row.high_95pct
        ends, unit = digits(numbers, row.value, row.error, row.unit)
        intervals = [f"{low} .. {high} {unit}".rstrip() * isfinite(row.error) for low, high in (ends[:2], ends[2:])]
        start = with_error(row.start, row.prior, row.unit) if row.prior else rounded(row.start, row.unit)
        rows.append([row.parameter, value_text(row, fit.enlargement), *intervals, start])
    yield from text_table([["parameter", "value", *(f"{rise} interval" for rise in RISES), "start"], *rows])
    if fit.enlargement != 1:
        times = f"enlarged {fit.enlargement:.3g} times"
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
    freedom = f"{goodness.freedom} degree{'s' * (goodness.freedom != 1)} of freedom"
    yield f"chi-square {goodness.chi_square:.4g} with {freedom}{chance}"
    if not fit.explained:
        yield "the model does not explain the data"
    yield from goodness.remarks.split(". ") if goodness.remarks else ()


def exact_lines(exact: pd.DataFrame) -> list[str]:
    """Table of the numbers that are taken as exact, those of the largest effect on a parameter first."""
    exact = exact.assign(size=(exact["change_by_1pct"] / exact["error"]).abs())
    sizes = exact.groupby("key")["size"].max().sort_values(ascending=False)
    rows = [["taken as exact: 1 % would add", *exact["parameter"].unique()]]
    for key in sizes.index[sizes > LEAST_CHANGE][:MAX_EXACT]:
        scaled = [(row, *suited(row.change_by_1pct, row.unit)) for row in rows_of(exact[exact["key"] == key])]
        rows.append([key, *(f"{row.change_by_1pct * scale:+.2g} {unit}".rstrip() for row, scale, unit in scaled)])
    return text_table(rows) if len(rows) > 1 else []


def comparison(fitted: Fitted) -> Iterator[str]:
    """Lines on several laws: goodness of each, the best one, or those that remain with what would decide."""
    if len(fitted.fits) < 2:
        return
    laws = fitted.tables[LAWS].sort_values("aic", kind="stable")
    laws["above"] = laws["aic"] - laws["aic"].min()
    columns = ["law", "chi_square", "freedom", "probability", "aic", "bic", "above"]
    yield from laws[columns].to_string(index=False, float_format="{:.5g}".format).splitlines()
    excess = pd.Series(excess_of(fitted.fits)).sort_values(kind="stable")
    best, second = excess.index[:2]
    if not any(found.explained for found in fitted.fits.values()):
        yield f"no law explains the data; {best} comes nearest"
    elif excess[second] >= DECISIVE:
        yield f"{best} is the best law: the AIC of {second} is {excess[second]:.3g} higher"
    else:
        near = ", ".join(excess.index[excess < DECISIVE])
        leaning = f", leaning to {best}" * bool(excess[second] >= LEANING)
        yield f"undecided{leaning}: the AIC of {second} is {excess[second]:.2g} higher, and {DECISIVE:g} would decide"
        yield f"to distinguish {near}: beads design {paths.shown(fitted.folder)} --vary striker.speed=LOW..HIGH"
    yield ""
