"""Commands of the report and its chapters, of the paper's figures, and of fits."""

import shlex
import sys
import traceback
from pathlib import Path
from runpy import run_path
from typing import Any

from drivers.base import paths
from drivers.base.errors import InputError, RunError, one_line
from drivers.base.terminal import counted, text_table
from drivers.engines import REFERENCE, engines_again, missing_codes
from drivers.limits import refuse
from drivers.run.inventory import scene_now
from postproc.draw.overlay import HEADINGS, draw_overlay, misfit_rows
from postproc.draw.product import Product, write_product
from postproc.figures import caption_of, captions
from postproc.read.measured import entries_of
from postproc.read.misfit import lay_over
from postproc.read.motion import exact
from validation.accuracy.plan import planned_case
from validation.calibration.command import run_fit
from validation.calibration.folder import folder_named, request_of
from validation.calibration.predict import chapter_of, part_of
from validation.calibration.predict import lines as prediction_lines
from validation.calibration.predict import predict as predict_scene
from validation.chapters import CHAPTERS, Options, run_chapter, write_paper_figure
from validation.commands.options import print_paths
from validation.commands.run_commands import open_shown
from validation.compare.comparison import EngineSelection
from validation.report import write_report


def report(scenes: tuple[str, ...], studies: bool, runs: Path, out: Path | None = None, **engines: Any) -> int:
    """Write the report page and its checks as JSON.

    Examples:
      beads report
      beads report fig4 --out fig4.html --allow-missing
    """
    arguments = sys.argv[1:] if "--engines" in sys.argv else [*sys.argv[1:], *engines_again()]
    given = None if runs == paths.RUNS else runs
    again = shlex.join(["beads", *arguments])
    return write_report.report(scenes, out, given, EngineSelection(**engines), again, studies=studies)


def figures(names: tuple[str, ...], runs: Path, results: Path) -> int:
    """Make figures and the table of the paper, or of your own.

    Examples:
      beads figures
      beads figures fig4 table1
      beads figures my_figure.py
    """
    known, code = captions(), 0
    for name in names:
        if name not in known and not name.endswith(".py"):
            raise InputError("figures", "", f'"{name}"', f"{', '.join(known)}, or a Python file of your own")
    for name in dict.fromkeys(names or known):
        try:
            caption = known.get(name) or caption_of(Path(name))
            with counted(f"{name}: {caption.title}"):
                written = (write_paper_figure if name in known else _write_own)(name, runs, results)
        except (RunError, InputError) as error:
            print(f"{name}: {error}" if name in known else error, file=sys.stderr)
            code = max(code, 2 if isinstance(error, InputError) else 1)
        else:
            print_paths(written)
    if missing_codes():
        print(f"left out, since not installed: {', '.join(missing_codes())}", file=sys.stderr)
    return code


def _write_own(name: str, runs: Path, results: Path) -> list[Path]:
    """Execute a figure file and write its table, figure and spacetime diagram under its name.

    Raises:
        InputError: The file has no function that makes a product, or the name of another output.
        RunError: An exception in the file, with the line.
    """
    file, shown = Path(name).resolve(), paths.shown(Path(name))
    if file.stem in (*captions(), *CHAPTERS):
        raise InputError(shown, "", file.stem, "a name that is not that of a figure of the paper or of a chapter")
    try:
        make = run_path(str(file)).get("make")
        if not callable(make):
            raise InputError(shown, "make", "no such function", "make(runs), which returns a Product")
        product = make(runs)
        if not isinstance(product, Product):
            raise InputError(shown, "make", f"{type(product).__name__} returned", "a Product")
        return write_product(product, file.stem, results)
    except (InputError, RunError):
        raise
    except Exception as error:
        lines = [frame.lineno for frame in traceback.extract_tb(error.__traceback__) if frame.filename == str(file)]
        place = f", line {lines[-1]}" if lines else ""
        raise RunError(one_line(f"{shown}{place}: {type(error).__name__}: ", error)) from error


def fit(results: Path, runs: Path, **asked: Any) -> int:
    """Fit parameters of scenes to measured data.

    The data are the [[measured]] tables of the scenes, or those that --measured or --quoted name.

    Examples:
      beads fit example-measured --free contact.restitution
      beads fit shot.toml --law elastic --law power --free striker.speed=2±1%
    """
    return run_fit(request_of(**asked), runs, results)


def predict(fit: str, scene: str, settings: tuple[str, ...], results: Path) -> None:
    """Predict forces and observables of a scene by a fit, with errors and the spread over laws.

    Materials, contact law and electronics are taken from the fit, all else from the scene.

    Examples:
      beads predict fit-shot other.toml
      beads predict results/fit-example-measured fig4 --set striker.speed='0.2 m/s'
    """
    found = predict_scene(folder_named(fit, results), scene, settings)
    case, stem = found.simulation.case, f"predict-{Path(scene).stem}"
    print(*prediction_lines(found), sep="\n")
    print_paths(write_part(part_of(case.scene), chapter_of(found, stem), results))


def overlay(run: str, settings: tuple[str, ...], runs: Path, results: Path, measured: Path | None = None) -> None:
    """Draw measured traces over computed ones, with deviations.

    Examples:
      beads overlay example-measured
      beads overlay example-measured --set contact.restitution=0.9
      beads overlay yade:fig4 --measured shot-12.csv
    """
    if Path(run).is_dir() or (":" in run and not Path(run).exists()):
        if settings:
            raise InputError(f"--set {settings[0]}", "", "not allowed for a finished run")
        opened, name, _ = open_shown("overlay", run, runs)
        scene = scene_now(run.partition(":")[2]) or scene_now(opened.record.scene_name)  # names the measured data
        layout, trace, engine = opened.layout, opened.trace, opened.record.engine
    else:
        case = planned_case(run, *settings)
        refuse(case, REFERENCE)
        scene, layout, trace, engine = case.scene, case.layout, exact(case).trace, REFERENCE
        name = f"overlay-{scene.name}"
    entries, folder, where = entries_of(scene, measured, run)
    aligned, misfits, remarks = lay_over(entries, folder, where, layout, trace)
    drawn = write_product(draw_overlay(layout, trace, engine, aligned, misfits), name, results) if aligned else ()
    print(*text_table([HEADINGS, *misfit_rows(misfits)]), sep="\n")
    for remark in remarks:
        print(remark, file=sys.stderr)
    print_paths(drawn)


def claims(**options: Any) -> int:
    """Judge the paper's statements, and engines by published numbers.

    Examples:
      beads claims
      beads claims --file my-cases.toml
    """
    return run_chapter("claims", Options(**options))


def trade(**options: Any) -> int:
    """Measure error against cost for all engines and time steps.

    Examples:
      beads trade --quick
      beads trade --budget 600
    """
    return run_chapter("trade", Options(**options))


def stability(**options: Any) -> int:
    """Measure stable steps, extreme scenes, long runs.

    Examples:
      beads stability
      beads stability --quick
    """
    return run_chapter("stability", Options(**options))


def elements(**options: Any) -> int:
    """Measure effect and cost of each modelling element.

    Examples:
      beads elements
      beads elements --quick
    """
    return run_chapter("elements", Options(**options))


def calibration(**options: Any) -> int:
    """Fit parameters of each contact law to the paper's experiments.

    Examples:
      beads calibration
      beads calibration --quick
    """
    return run_chapter("calibration", Options(**options))
