"""Commands that run scenes and judge or list runs: ``run``, ``compare``, ``fit``, ``runs``."""

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from drivers.base import paths
from drivers.base.errors import InputError, RunError
from validation.commands import completion, options
from validation.commands.options import command, must_be_folder, one_of, option, seconds

if TYPE_CHECKING:
    from drivers.run.run_folder import EndedRun

AUTO = "auto"  # instead of an engine's name: the cheapest engine that can model the scene


@command("fig4 --engine yade", "fig4 --engine auto", "fig4 --set chain.count=60 --set run.time_step='50 ns'")
@options.SCENE
@options.SETTINGS
@options.ENGINE
@options.RUNS
@option("--rerun", "", "Run again even if the run is done or, with auto, failed.")
@option("--time-limit", "SECONDS", "Stop a run after this time (default: by beads and steps).", type=seconds)
@options.UNSAFE
def run(
    scene: str,
    settings: tuple[str, ...],
    engines: tuple[str, ...],
    runs: Path,
    rerun: bool,
    time_limit: float | None,
    unsafe: bool,
) -> int:
    """Run a scene and print the run folders.

    --engine auto takes the cheapest engine that models the scene, after those whose build or run failed the next one.
    """
    from drivers.base.terminal import counted
    from drivers.engines import engine_names, installed, load_engine
    from drivers.limits import inability, refuse
    from drivers.run.run import is_done, run_case
    from validation.accuracy.budget import assess
    from validation.accuracy.costs import auto_engines
    from validation.accuracy.plan import planned_case

    for name in engines:
        if name != AUTO:
            load_engine(name, "--engine", also=(AUTO,))  # refuses a wrong name before the case is planned
    case = planned_case(scene, *settings)
    auto = auto_engines(case, None if rerun else runs)
    asked = [next(auto) if name == AUTO else name for name in dict.fromkeys(engines)]
    names = list(dict.fromkeys(asked or installed(engine_names())))
    missing = [] if asked else [name for name in engine_names() if name not in names]
    refusals = {name: error for name in names if (error := inability(case, name))}
    for refusal in refusals.values() if asked else ():
        raise refusal
    names = [name for name in names if name not in refusals]
    for name in [] if unsafe else names:
        if rerun or not is_done(case, name, runs):
            refuse(case, name)  # before any engine starts
    failures = 0
    for name in names:  # --engine auto adds the next engine after one that fails
        by_auto = bool(asked) and name not in engines
        try:
            with counted(f"running {case.scene.name} on {name}"):
                ended = run_case(case, name, runs, rerun=rerun, limit_s=time_limit)
            with counted(f"measuring the error of {case.scene.name} on {name}"):
                ended = assess(ended, case, time_limit)
        except (RunError, OSError) as error:
            wrong = f": {error}"
        else:
            wrong = _trouble(ended)
            if not (by_auto and wrong):
                print(paths.shown(ended.folder), flush=True)
        if wrong:
            print(f"{case.scene.name}: {name}{wrong}{'; --engine auto leaves it out' * by_auto}", file=sys.stderr)
            failures += not by_auto
        if wrong and by_auto and (another := next(auto)) not in names:
            names.append(another)
            if not unsafe:
                refuse(case, another)
    for name, refusal in refusals.items():
        print(f"not run on {name}: {refusal}", file=sys.stderr)
    if missing:
        print(f"not run, not installed ({len(missing)}): {', '.join(missing)}", file=sys.stderr)
    return 1 if failures else 0


def _trouble(ended: "EndedRun") -> str:
    """Print the warnings of a run; returns why it failed or missed its accuracy, as the end of a line, or nothing."""
    from validation.accuracy.budget import missed_accuracy

    for warning in ended.record.warnings or ():
        print(f"{ended.record.scene_name}: {ended.record.engine} warning: {warning}", file=sys.stderr)
    if ended.done:
        return f" missed the accuracy: {missed}" if (missed := missed_accuracy(ended)) else ""
    stderr = ended.folder / "stderr.txt"
    said = f" (see {paths.shown(stderr)})" if stderr.is_file() and stderr.stat().st_size else ""
    return f" {ended.trouble}{said}"


@command("deck --engine liggghts", "deck --engine yade --scene fig4 --set run.time_step='0.2 us'", name="import")
@click.argument("folder", metavar="FOLDER", type=Path, help="Folder with a deck that was run by hand, and its output.")
@option(
    "--scene",
    "SCENE",
    "Scene of the deck before changes, by name or file (default: the one that render wrote into FOLDER).",
    shell_complete=completion.scenes,
)
@options.SETTINGS
@options.ENGINE
@options.RUNS
def import_(folder: Path, scene: str | None, settings: tuple[str, ...], engines: tuple[str, ...], runs: Path) -> int:
    """Make a run folder of a deck that was run by hand.

    The deck may have been changed: the record names each line that differs from the scene's deck.
    """
    from drivers.chain.case import build_case
    from drivers.engines import load_engine
    from drivers.run.run import import_run
    from drivers.run.run_folder import scene_of
    from validation.accuracy.budget import assess
    from validation.accuracy.plan import planned_case

    engine = load_engine(one_of(engines), "--engine")
    if settings and not scene:
        raise InputError("--set", "", "needs --scene")
    case = planned_case(scene, *settings) if scene else build_case(scene_of(folder))
    ended = assess(import_run(folder, case, engine.name, runs), case)
    print(paths.shown(ended.folder))
    print(*(f"deck changed: {edit}" for edit in ended.record.edits or ["nothing"]), sep="\n", file=sys.stderr)
    if wrong := _trouble(ended):
        print(f"{ended.record.scene_name}: {ended.record.engine}{wrong}", file=sys.stderr)
    return int(bool(wrong))


@command("fig4", "fig4 --set run.time_step='1 us'", "yade:fig4 liggghts:fig4")
@click.argument(
    "what",
    metavar="SCENE|RUN...",
    nargs=-1,
    required=True,
    help="Scenes by name or file, or exactly two runs: run folders, or ENGINE:SCENE for the newest run.",
    shell_complete=completion.scenes_and_runs,
)
@options.SETTINGS
@options.ENGINE
@options.RUNS_READ
@options.REQUIRE
@options.ALLOW_MISSING
@options.UNSAFE
def compare(
    what: tuple[str, ...],
    settings: tuple[str, ...],
    engines: tuple[str, ...],
    runs: Path,
    required: tuple[str, ...],
    allow_missing: bool,
    unsafe: bool,
) -> int:
    """Run scenes and judge them on every engine, or compare runs."""
    must_be_folder("--runs", runs)
    from validation.compare.comparison import EngineSelection, compare_runs, compare_scenes

    asked = EngineSelection(engines, required, allow_missing)
    folders = [source for source in what if Path(source).is_dir() or ":" in source]
    if folders:
        if len(folders) != 2 or len(what) != 2:
            raise InputError("compare", "", " ".join(what), "scenes, or exactly two runs")
        for option, given in (("set", settings), ("engine", engines), ("require", required)):
            if given:
                raise InputError(f"--{option}", "", "not allowed with two runs")
        from drivers.run.inventory import run_folder

        return compare_runs(*(run_folder(folder, runs) for folder in folders))
    return compare_scenes(what, settings, runs, asked, unsafe=unsafe)


@command("example-measured --free contact.restitution", "shot.toml --law elastic --law power --free striker.speed=2±1%")
@options.scenes_argument("the scenes of --quoted")
@option(
    "--free",
    "KEY[=LOW..HIGH]",
    "Fit this key of the scene, such as contact.restitution=0.5..1, or with prior knowledge striker.speed=2±1%; "
    "repeatable (default bounds: inputs/calibration.toml).",
    multiple=True,
)
@option(
    "--law laws",
    "LAW",
    "Fit this contact law of inputs/calibration.toml (elastic, viscoelastic, power); repeatable: all on the same "
    "data, and compared.",
    multiple=True,
)
@option(
    "--predict",
    "OBSERVABLE",
    "Predict this observable, such as wall_peak or bead_8_reflected_arrival, with its error; repeatable.",
    multiple=True,
)
@option("--own", "KEY[=LOW..HIGH]", "As --free, with a value of its own for each data set; repeatable.", multiple=True)
@options.MEASURED
@option(
    "--quoted",
    "SET,...",
    "Fit to data that the paper quotes: sets of inputs/calibration.toml, such as fig4,table1.",
    type=lambda text: tuple(name.strip() for name in text.split(",")) if text else (),
    default="",
)
@options.SETTINGS
@options.QUICK
@options.RESULTS
@options.RUNS
def fit(results: Path, runs: Path, **asked: Any) -> int:
    """Fit parameters of scenes to measured data.

    The data are the [[measured]] tables of the scenes, or those that --measured or --quoted name.
    """
    from validation.calibration.command import FitRequest, run_fit

    return run_fit(FitRequest(**asked), runs, results)


@command("fig4 --engine yade", "--set 'striker.speed=*'", "--prune --dry-run")
@options.scenes_argument("all")
@options.SETTINGS
@options.ENGINE
@options.RUNS_READ
@option(
    "--prune",
    "",
    "Remove runs that are not done, or whose build or deck is not today's.",
)
@options.DRY_RUN
def runs(
    scenes: tuple[str, ...],
    settings: tuple[str, ...],
    engines: tuple[str, ...],
    runs: Path,
    prune: bool,
    dry_run: bool,
) -> None:
    """List the run folders, or remove those that are obsolete."""
    from drivers.run import inventory

    if dry_run and not prune:
        raise InputError("--dry-run", "", "needs --prune")
    if runs != paths.RUNS and not runs.is_dir():
        raise InputError(f"--runs {runs}", "", "folder not found")
    if prune:
        inventory.prune(runs, scenes, engines, settings, dry_run=dry_run)
    else:
        inventory.print_runs(runs, scenes, engines, settings)
