"""Commands of measured data: overlays, fits, and predictions and designs of experiments by fits."""

import sys
from pathlib import Path
from typing import Any

from drivers.base.errors import InputError
from drivers.base.files import whole_file
from drivers.base.terminal import print_paths, text_table
from drivers.engines import REFERENCE
from drivers.limits import refuse
from drivers.run.inventory import scene_now
from postproc.draw.overlay import HEADINGS, draw_overlay, lay_over, misfit_rows
from postproc.draw.product import Product, write_product
from postproc.read.measured import entries_of
from postproc.read.motion import Simulation, case_of_run, exact
from validation.accuracy.plan import planned_case
from validation.calibration import design as designs
from validation.calibration import predict as predictions
from validation.calibration.command import confirm
from validation.calibration.command import fit as fit_laws
from validation.commands.run_commands import open_shown
from validation.report.parts import prediction_part, write_part


def fit(scenes: tuple[str, ...], runs: Path, **asked: Any) -> int:
    """Fit parameters of scenes to measured data.

    The data are the [[measured]] tables of the scenes, or those that --measured or --quoted name. Triggers that are not
    stated, and gains with an uncertainty, are fitted with the parameters. The folder of a fit is fitted again.

    Examples:
      beads fit example-measured --free contact.restitution
      beads fit shot.toml --law elastic --law power --free striker.speed=2±1%
    """
    return confirm(fit_laws(*scenes, **asked), runs)


def predict(fit: str, settings: tuple[str, ...], results: Path, scene: str = "") -> None:
    """Predict another scene by a fit, with errors and spread over laws.

    Materials, contact law and electronics are taken from the fit, all else from the scene.

    Examples:
      beads predict fit-shot other.toml
      beads predict fit-shot --set 'striker.speed=0.2 m/s'
    """
    found = predictions.predict(_folder(fit, results), scene, settings)
    print(*text_table(predictions.rows_of_text(found)), "", *found.said, sep="\n")
    chapter = predictions.chapter_of(found, f"predict-{found.scene.name}")
    print_paths(write_part(prediction_part(found.scene), chapter, results))


def _folder(fit: str, results: Path) -> Path:
    """Folder of a fit by its path, or by its name in the folder of results."""
    return Path(fit) if Path(fit).exists() else results / fit


def design(
    fit: str,
    vary: tuple[str, ...],
    gauges: str,
    pin: str,
    settings: tuple[str, ...],
    results: Path,
    candidates: int = designs.CANDIDATES,
) -> None:
    """Find the experiment that tells laws apart or pins a parameter.

    Examples:
      beads design fit-shot --vary striker.speed=0.05..2 --gauges 2..15
      beads design fit-shot --vary striker.speed=0.05..2 --pin contact.restitution
    """
    folder = _folder(fit, results)
    found = designs.design(folder, vary, gauges, pin, candidates, settings)
    name = f"design-{folder.resolve().name.removeprefix('fit-')}"
    written = write_product(Product(designs.draw(found), found.table), name, results)
    with whole_file(results / f"{name}.toml") as draft:
        draft.write_text(found.scene, encoding="utf-8")
    print(*designs.lines(found), sep="\n")
    print_paths([*written, results / f"{name}.toml"])


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
        motion = Simulation(case_of_run(opened), opened.record.engine, opened.trace)
    else:
        case = planned_case(run, *settings)
        refuse(case, REFERENCE)
        scene, motion = case.scene, exact(case)
        name = f"overlay-{scene.name}"
    aligned, misfits, remarks = lay_over(*entries_of(scene, measured, run), motion)
    drawn = write_product(draw_overlay(motion, aligned, misfits), name, results) if aligned else ()
    print(*text_table([HEADINGS, *misfit_rows(misfits)]), sep="\n")
    for remark in remarks:
        print(remark, file=sys.stderr)
    print_paths(drawn)
