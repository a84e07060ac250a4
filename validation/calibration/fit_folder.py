"""The folder ``fit-SCENE``, which can be sent: fitted scene, data, tables, figures and the command that fits again."""

import shlex
import shutil
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from drivers.base import paths
from drivers.base.errors import InputError
from drivers.base.units import quantity
from drivers.chain.case import build_case
from drivers.engines import REFERENCE
from drivers.scene.read_scene import apply_setting, find_scene, read_scene, set_value
from drivers.scene.settings import look_up
from postproc.draw.overlay import draw_overlay
from postproc.draw.product import write_figure, write_product
from postproc.paper.simulate import exact
from postproc.read.measured import MEASURED, entries_of
from postproc.read.misfit import lay_over
from validation.calibration.calibration_file import calibration_file
from validation.calibration.data_sets import DataSet
from validation.calibration.draw import draw_parameters
from validation.calibration.free import GAIN, TRIGGER
from validation.calibration.outcome import DatumRow, FitRow, Outcome, Parameter, value_text
from validation.chapters import write_table
from validation.report.page_figures import write_part

PARAMETERS, DATA, LAWS, PREDICTIONS = "parameters", "data", "laws", "predictions"
README = "README.md"


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
        return (*(calibration_file().law_named(law).set if law else ()), *self.settings)


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
    request: FitRequest, outcomes: Mapping[str, Outcome], predictions: Sequence[DatumRow], results: Path
) -> tuple[Path, dict[str, list[Path]], list[str]]:
    """Writes the folder when all its files are made; files of an earlier fit are replaced, others stay.

    Returns:
        The folder, the fitted scenes by law, and remarks on the traces.
    """
    folder = folder_of(request, results)
    results = folder.parent
    results.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=results, prefix=".fit-") as temporary:
        draft = Path(temporary) / folder.name
        draft.mkdir()
        parameters = [row for solved in outcomes.values() for row in solved.parameters]
        write_table(draft / f"{PARAMETERS}.csv", Parameter, parameters)
        write_table(draft / f"{DATA}.csv", DatumRow, [row for solved in outcomes.values() for row in solved.data])
        write_table(draft / f"{LAWS}.csv", FitRow, [solved.row for solved in outcomes.values()])
        write_table(draft / f"{PREDICTIONS}.csv", DatumRow, predictions)
        figure = write_figure(draw_parameters(parameters), PARAMETERS, draft)
        write_part(folder.name, results, {}, figure)
        fitted, remarks = dict[str, list[Path]](), list[str]()
        for law, outcome in outcomes.items():
            fitted[law], said = _scenes(request, law, outcome, draft)
            remarks += said
        (draft / README).write_text(_readme(request, folder.name, fitted), encoding="utf-8")
        for former in (*folder.glob("fit-*.toml"), *folder.glob("traces-*")):
            former.unlink()
        for path in (path for path in sorted(draft.rglob("*")) if path.is_file()):
            target = folder / path.relative_to(draft)
            target.parent.mkdir(parents=True, exist_ok=True)
            path.replace(target)
    scenes = {law: [folder / path.name for path in of_law] for law, of_law in fitted.items()}
    texts = dict.fromkeys(remark.replace(paths.shown(draft), paths.shown(folder)) for remark in remarks)
    return folder, scenes, list(texts)


def _scenes(request: FitRequest, law: str, outcome: Outcome, folder: Path) -> tuple[list[Path], list[str]]:
    """Writes the scenes, their data and figures; returns the fitted scenes, and remarks on the traces."""
    written, remarks, sets = list[Path](), list[str](), outcome.fit.problem.sets
    ending = f"-{law.replace(' ', '-')}" if len(request.laws) > 1 else ""
    for source in dict.fromkeys(request.scenes or [data.source for data in sets]):
        path = find_scene(source)
        data = next((candidate for candidate in sets if candidate.name == path.stem), None)
        copies = _copied(data, folder) if data else {}
        if data and data.entries:
            _write_scene(folder / path.name, path, request.settings, [], _entries(data, copies, None))
        fitted = folder / f"fit-{path.stem}{ending}.toml"
        _write_scene(
            fitted,
            path,
            request.settings_of(law),
            _values(outcome, path.stem),
            _entries(data, copies, outcome) if data else None,
        )
        written.append(fitted)
        if data and data.records:
            remarks += _draw_traces(fitted, f"traces-{path.stem}{ending}")
    return written, remarks


def _copied(data: DataSet, folder: Path) -> dict[Path, str]:
    """Copies the measured files of a data set; their new paths, relative to the folder, by file."""
    copies = dict[Path, str]()
    for file in dict.fromkeys(record.measured.file for record in data.records):
        target = folder / DATA / file.name
        while target.exists():  # a file of the same name from another folder
            target = target.with_stem(f"{target.stem}-other")
        target.parent.mkdir(exist_ok=True)
        shutil.copyfile(file, target)
        copies[file] = str(target.relative_to(folder))
    return copies


def _draw_traces(fitted: Path, name: str) -> list[str]:
    """Draws measured traces over those of the fitted scene, with residuals; returns remarks on them."""
    scene = read_scene(fitted)
    case = build_case(scene)
    trace = exact(case).trace
    try:
        curves, misfits, remarks = lay_over(*entries_of(scene, None, fitted.name), case.layout, trace)
    except InputError as error:  # the fit needs no quiet readings, the figure does
        return [f"no figure of the traces: {error}"]
    write_product(draw_overlay(case.layout, trace, REFERENCE, curves, misfits), name, fitted.parent)
    return remarks


def _values(outcome: Outcome, scene: str) -> list[tuple[str, str | float, str]]:
    """Key, value to six digits with its unit, and value with error, of each fitted key of a scene."""
    pairs = zip(outcome.fit.problem.free, outcome.parameters, strict=True)
    fitted = [(free.key, row) for free, row in pairs if free.own in ("", scene) and free.of_motion]
    values = [(key, row, float(f"{row.value:.6g}")) for key, row in fitted]
    return [
        (key, quantity(value, row.unit) if row.unit else value, f"fitted: {value_text(row, outcome.enlargement)}")
        for key, row, value in values
    ]


def _write_scene(
    path: Path, source: Path, settings: Sequence[str], values: Sequence[tuple[str, Any, str]], entries: Any | None
) -> None:
    """Writes a scene file with settings, fitted values and data, and with the comments of its source."""
    import tomlkit

    document: Any = tomlkit.parse(source.read_text(encoding="utf-8"))
    for setting in settings:
        apply_setting(document, setting)
    for key, value, remark in values:
        set_value(document, key, value, str(source))
        if not isinstance(look_up(document, key.rpartition(".")[0]), tomlkit.items.InlineTable):
            look_up(document, key).comment(remark)  # in an inline table it would hide the rest of the line
    if entries is not None:
        document[MEASURED] = entries
    path.write_text(tomlkit.dumps(document), encoding="utf-8")


def _entries(data: DataSet, copies: Mapping[Path, str], outcome: Outcome | None) -> Any | None:
    """``[[measured]]`` tables of a data set, with copied files, and with fitted gains and triggers."""
    import tomlkit

    if not data.entries:
        return None
    records = {record.key: record for record in data.records}
    label = f"{data.name}: "
    rows = {row.parameter.removeprefix(label): row for row in (outcome.parameters if outcome else ())}
    fitted = {name: row.value for name, row in rows.items()}
    tables = tomlkit.aot()
    for key, entry in data.entries.items():
        values = entry.model_dump(exclude_none=True, exclude_unset=True)
        record = records.get(key)
        if record:
            values["file"] = copies[record.measured.file]
            trigger_s = fitted.get(f"{record.trigger_key}.{TRIGGER}", record.trigger_s)
            if trigger_s is not None:
                values[TRIGGER] = quantity(float(f"{trigger_s:.9g}"), "s")
            if f"{key}.{GAIN}" in fitted:
                error = abs(rows[f"{key}.{GAIN}"].error / fitted[f"{key}.{GAIN}"])
                values["gain_uncertainty"] = float(f"{error:.2g}") if error < 1 else entry.gain_uncertainty
                values[GAIN] = f"{fitted[f'{key}.{GAIN}']:.6g} N/{record.measured.unit}"
                if record.measured.unit == "N":
                    values[GAIN] = float(f"{fitted[f'{key}.{GAIN}']:.6g}")
        tables.append(tomlkit.item(values))
    return tables


def _readme(request: FitRequest, name: str, fitted: Mapping[str, Sequence[Path]]) -> str:
    """Contents of the folder, and the command that fits again."""
    command = ["beads", "fit", *(Path(scene).stem + ".toml" for scene in request.scenes)]
    if request.quoted:
        command = ["beads", "fit", *request.scenes, "--quoted", ",".join(request.quoted)]
    for option, given in (
        ("--law", request.laws),
        ("--free", request.free),
        ("--own", request.own),
        ("--predict", request.predict),
        ("--set", request.settings if request.quoted else ()),
    ):
        command += [word for value in given for word in (option, value)]
    again = shlex.join([*command, *(["--quick"] * request.quick), "--results", "again"])
    scenes = [path.name for of_law in fitted.values() for path in of_law]
    return "\n".join([
        f"# {name}: parameters fitted to measured data", "",
        "- `parameters.csv`, `.svg`: values with errors and intervals; `data.csv`: each datum; `laws.csv`: goodness;",
        "  `predictions.csv`: observables of the fitted motion with errors. Units are SI.",
        f"- Fitted scenes: {', '.join(scenes)}; `traces-*`: measured and computed forces with residuals.", "",
        "Fit again, in this folder:", "", f"    {again}", "",
        "Compare codes on the fitted scene, and draw the traces:", "",
        f"    beads compare {scenes[0]}", *([f"    beads overlay {scenes[0]}"] * (not request.quoted)), "",
    ])  # fmt: skip
