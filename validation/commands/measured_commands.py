"""Commands of measured data: overlays, fits, and predictions and designs of experiments by fits."""

import sys
from pathlib import Path

from drivers.base.errors import InputError
from drivers.base.files import whole_file
from drivers.base.terminal import print_paths, text_table
from drivers.engines import REFERENCE
from drivers.limits import refuse
from drivers.run.inventory import scene_now
from postproc.draw.overlay import HEADINGS, draw_overlay, lay_over, misfit_rows
from postproc.draw.plot import Product, write_product
from postproc.read.measured import entries_of
from postproc.read.motion import Simulation, case_of_run, exact
from validation.accuracy.plan import planned_case
from validation.calibration import design as designs
from validation.calibration import predict as predictions
from validation.calibration.command import confirm
from validation.calibration.command import fit as fit_laws
from validation.commands.run_commands import Words, open_shown
from validation.report.parts import prediction_part, write_part


def fit(
    sources: Words, free: Words, laws: Words, uncertain: Words, own: Words, *, measured: Path | None = None,
    quoted: Words, settings: Words, quick: bool, results: Path, runs: Path,
) -> int:  # fmt: skip
    """Fit parameters of scenes to measured data.

    The data are the [[measured]] tables of the scenes, or those that --measured or --quoted name. Triggers that are not
    stated, and gains with an uncertainty, are fitted with the parameters. The folder of a fit is fitted again.

    Examples:
      beads fit example-measured --free contact.restitution
      beads fit shot.toml --law elastic --law power --free striker.speed=2±1%
    """
    asked = {"free": free, "laws": laws, "uncertain": uncertain, "own": own, "measured": measured, "quoted": quoted}
    return confirm(fit_laws(*sources, settings=settings, quick=quick, results=results, **asked), runs)


def predict(fit: str, *, other: str = "", settings: Words, results: Path) -> None:
    """Predict another scene by a fit, with errors and spread over laws.

    Materials, contact law and electronics are taken from the fit, all else from the scene.

    Examples:
      beads predict fit-shot other.toml
      beads predict fit-shot --set 'striker.speed=0.2 m/s'
    """
    found = predictions.predict(_folder(fit, results), other, settings)
    print(*text_table(predictions.rows_of_text(found)), "", *found.said, sep="\n")
    chapter = predictions.chapter_of(found, f"predict-{found.scene.name}")
    print_paths(write_part(prediction_part(found.scene), chapter, results))


def _folder(fit: str, results: Path) -> Path:
    """Folder of a fit by its path, or by its name in the folder of results."""
    return Path(fit) if Path(fit).exists() else results / fit


def design(
    fit: str, vary: Words, gauges: str, pin: str, settings: Words, results: Path, candidates: int = designs.CANDIDATES
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


def overlay(shown: str, settings: Words, *, measured: Path | None = None, runs_read: Path, results: Path) -> None:
    """Draw measured traces over computed ones, with deviations.

    Examples:
      beads overlay example-measured
      beads overlay example-measured --set contact.restitution=0.9
      beads overlay yade:fig4 --measured shot-12.csv
    """
    if Path(shown).is_dir() or (":" in shown and not Path(shown).exists()):
        if settings:
            raise InputError(f"--set {settings[0]}", "", "not allowed for a finished run")
        opened, name, _ = open_shown("overlay", shown, runs_read)
        scene = scene_now(shown.partition(":")[2]) or scene_now(opened.record.scene_name)  # names the measured data
        motion = Simulation(case_of_run(opened), opened.record.engine, opened.trace)
    else:
        case = planned_case(shown, *settings)
        refuse(case, REFERENCE)
        scene, motion = case.scene, exact(case)
        name = f"overlay-{scene.name}"
    aligned, misfits, remarks = lay_over(*entries_of(scene, measured, shown), motion)
    drawn = write_product(draw_overlay(motion, aligned, misfits), name, results) if aligned else ()
    print(*text_table([HEADINGS, *misfit_rows(misfits)]), sep="\n")
    for remark in remarks:
        print(remark, file=sys.stderr)
    print_paths(drawn)
