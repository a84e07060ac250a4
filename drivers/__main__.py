# PYTHON_ARGCOMPLETE_OK
"""``python -m drivers``: renders decks and runs them."""

import argparse
import re
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import drivers.environment  # noqa: F401 - checks the environment before further imports
from drivers.base import command_line, paths
from drivers.base.command_line import SEVERAL, Command, Options, argument, seconds
from drivers.base.errors import InputError, RunError

if TYPE_CHECKING:
    from drivers.batch.study_cases import Request

AUTO = "auto"  # instead of an engine's name: the cheapest engine that can model the scene


def main() -> int:
    """Runs the command line and returns its exit code."""
    arguments = _parser().parse_args()
    for option, default in (("runs", paths.RUNS), ("results", paths.RESULTS), ("out", None)):
        if option in arguments and "prune" not in arguments:
            setattr(arguments, option, getattr(arguments, option) or default)
            command_line.must_be_folder(f"--{option}", getattr(arguments, option))
    return int(arguments.action(arguments))


def _count(text: str) -> int:
    if not (text.isascii() and text.isdecimal() and len(text) < 9 and int(text) > 0):
        raise argparse.ArgumentTypeError(f"found {text}; allowed: a whole number from 1")
    return int(text)


def _slice(text: str) -> tuple[int, int]:
    found = re.fullmatch(r"([0-9]{1,8})/([0-9]{1,8})", text)
    if found and 1 <= int(found[1]) <= int(found[2]):
        return int(found[1]), int(found[2])
    raise argparse.ArgumentTypeError(f"found {text}; allowed: I/N with I from 1 to N")


def _engines(asked: list[str], *, automatic: bool = False) -> tuple[list[str], list[str]]:
    """Engines to run, and engines left out since they are not installed (empty if engines are named)."""
    from drivers.engines import engine_names, installed, load_engine

    for name in asked:
        load_engine(name, "--engine", also=(AUTO,) * automatic)
    found = asked or installed(engine_names())
    return list(dict.fromkeys(found)), [] if asked else [name for name in engine_names() if name not in found]


def _render(arguments: argparse.Namespace) -> int:
    from drivers.engines import load_engine
    from drivers.limits.refusal import refuse
    from validation.accuracy.plan import planned_case

    (name,), _ = _engines([arguments.engine])
    case = planned_case(arguments.scene, *arguments.settings)
    if not arguments.unsafe:
        refuse(case, name)
    engine = load_engine(name)
    deck = engine.deck_by_hand(engine.render(case))
    arguments.out.mkdir(parents=True, exist_ok=True)
    for file in deck.write(arguments.out):
        print(file)
    return 0


def _run(arguments: argparse.Namespace) -> int:
    from drivers.base.progress import counted
    from drivers.limits.refusal import inability, refuse
    from drivers.run.run import run_case
    from validation.accuracy.assess import assess
    from validation.accuracy.plan import cheapest, planned_case

    asked = arguments.engine
    named = [name for name in asked if name != AUTO]
    _engines(named, automatic=True)  # refuses a wrong name before the case is planned
    case = planned_case(arguments.scene, *arguments.settings)
    names, missing = _engines([*named, cheapest(case)] if AUTO in asked else named)
    refusals = {} if asked else {name: error for name in names if (error := inability(case, name))}
    names = [name for name in names if name not in refusals]
    for name in [] if arguments.unsafe else names:
        refuse(case, name)  # before any engine starts
    failures = 0
    for name in names:
        try:
            with counted(f"{case.scene.name} on {name}"):
                ended = run_case(case, name, arguments.runs, rerun=arguments.rerun, limit_s=arguments.time_limit)
                ended = assess(ended, case)
        except (RunError, OSError) as error:
            print(f"{case.scene.name}: {name}: {error}", file=sys.stderr)
            failures += 1
            continue
        print(paths.shown(ended.folder), flush=True)
        for warning in ended.record.warnings or ():
            print(f"{case.scene.name}: {name} warning: {warning}", file=sys.stderr)
        if ended.missed:
            print(f"{case.scene.name}: {name} missed the accuracy: {ended.missed}", file=sys.stderr)
            failures += 1
        if not ended.done:
            stderr = ended.folder / "stderr.txt"
            said = f" (see {paths.shown(stderr)})" if stderr.is_file() and stderr.stat().st_size else ""
            print(f"{case.scene.name}: {name} {ended.record.status}: {ended.record.reason}{said}", file=sys.stderr)
            failures += 1
    for name, refusal in refusals.items():
        print(f"not run on {name}: {refusal}", file=sys.stderr)
    if missing:
        print(f"not run, not installed ({len(missing)}): {', '.join(missing)}", file=sys.stderr)
    return 1 if failures else 0


def _plan(arguments: argparse.Namespace) -> int:
    from validation.accuracy.plan_report import plan_report

    for line in plan_report(arguments.scene, tuple(arguments.settings)):
        print(line)
    return 0


def request_of(
    study: str | Path, runs: Path, engines: Sequence[str] = (), patterns: Sequence[str] = (), *, retry: bool = False
) -> "Request":
    """Request for a study, with the functions of higher packages that a batch calls."""
    from drivers.batch.study_cases import Request
    from drivers.engines._entries import entry_files
    from postproc.read.observables import observe
    from postproc.read.residual import residual
    from validation.accuracy.plan import plan_case

    chosen = (tuple(engines), tuple(patterns))
    return Request(study, runs.absolute(), plan_case, observe, residual, *chosen, retry=retry, entries=entry_files())


def _batch(arguments: argparse.Namespace) -> int:
    from drivers.base.processes import cores
    from drivers.batch.study_commands import JobArray, batch, run_part
    from drivers.run.execute import Place

    for option in ("wait", "slices", "slurm_line"):
        if getattr(arguments, option) and not arguments.slurm:
            raise InputError(f"--{option.replace('_', '-')}", "", "needs --slurm")
    for option in ("dry_run", "workers"):
        if arguments.slice and getattr(arguments, option):
            words = f"--{option.replace('_', '-')}"
            raise InputError(words, "", "not allowed with --slice")
    request = request_of(arguments.study, arguments.runs, arguments.engine, arguments.only, retry=arguments.retry)
    if arguments.slice:
        return run_part(request, *arguments.slice)
    place = Place(arguments.workers or cores(), processes=not arguments.dask, dask=arguments.dask or "")
    array = JobArray(arguments.wait, arguments.slices, tuple(arguments.slurm_line)) if arguments.slurm else None
    return batch(request, arguments.results, place, array, dry_run=arguments.dry_run, yes=arguments.yes)


def _status(arguments: argparse.Namespace) -> int:
    from drivers.batch.study_commands import status

    request = request_of(arguments.study, arguments.runs, arguments.engine, arguments.only)
    return status(request, every=arguments.list)


def _show(arguments: argparse.Namespace) -> int:
    from drivers.batch.study_commands import show
    from validation.accuracy.assess import assess

    return show(request_of(arguments.study, arguments.runs, arguments.engine), arguments.case, assess)


def _runs(arguments: argparse.Namespace) -> int:
    from drivers.inventory.prune import prune
    from drivers.inventory.run_folders import print_runs

    if arguments.dry_run and not arguments.prune:
        raise InputError("--dry-run", "", "needs --prune")
    if arguments.runs and not arguments.runs.is_dir():
        raise InputError(f"--runs {arguments.runs}", "", "folder not found")
    runs, selected = arguments.runs or paths.RUNS, (arguments.scenes, arguments.engine, arguments.settings)
    if arguments.prune:
        prune(runs, *selected, dry_run=arguments.dry_run)
    else:
        print_runs(runs, *selected)
    return 0


def _scenes(_: argparse.Namespace) -> int:
    from drivers.scene.shipped import print_shipped

    print_shipped()
    return 0


def _engine(words: str) -> Options:
    """Option that names engines."""
    return argument("--engine", words, "ENGINE", **SEVERAL)


WHERE = command_line.ENGINES | command_line.RUNS
ONE_ENGINE = argument("--engine", "name of the engine, such as liggghts", "ENGINE", required=True)
OUT = argument("--out", "folder for the deck", "DIR", type=Path, required=True)
CASE = argument("case", "number of the case, as in the table of the study", "CASE", type=_count)
DRY_RUN = argument(
    "--dry-run",
    "print what would be done, without doing it; batch checks every case and keeps this list of cases and the builds "
    "found in the runs folder",
)
RUN = (
    _engine("name of an engine, or auto for the cheapest; repeatable (default: all installed ones)")
    | WHERE
    | argument("--rerun", "run again even if the run is done")
    | argument("--time-limit", "stop a run after this time (default: by beads and steps)", "SECONDS", type=seconds)
)
STUDY = (
    command_line.STUDY
    | command_line.RUNS
    | _engine("name of an engine; repeatable (default: the engines of the study)")
    | command_line.ENGINES
)
ONLY = (
    "take only cases with KEY=GLOB, such as 'striker.speed=2 m/s', or with a label that matches; "
    "repeatable (default: all cases)"
)
SELECTION = STUDY | argument("--only", ONLY, "PATTERN", **SEVERAL)
PLACES = (
    argument("--slice", "run part I of N here, without writing the table", "I/N", type=_slice)
    | argument(
        "--dask",
        "run on the Dask cluster at ADDRESS; without ADDRESS, on a local Dask cluster",
        "ADDRESS",
        nargs="?",
        const="local",
    )
    | argument("--slurm", "run as a Slurm job array")
)
BATCH = (
    SELECTION
    | argument("--results", "folder for the tables (default: results/ of the checkout)", "DIR", type=Path)
    | argument("--workers", "number of processes on this machine (default: number of cores)", "N", type=_count)
    | DRY_RUN
    | argument("--retry", "run failed cases again")
    | argument("--yes", "accept a study of more than 20,000 cases")
    | PLACES
    | argument("--slices", "number of tasks of the job array (default: by the expected time)", "N", type=_count)
    | argument(
        "--slurm-line", "add a line to the job script, such as '#SBATCH --mem=2G'; repeatable", "LINE", **SEVERAL
    )
    | argument("--wait", "wait for the job array, then write the table")
)
LIST = argument("--list", "print the state of each case: done, failed, timeout, stale, claimed, to do, not installed")
LISTED = (
    argument("scenes", "scenes by name or file (default: all)", "SCENE", nargs="*")
    | _engine("list runs of this engine; repeatable (default: all)")
    | argument(
        "--set",
        "list runs with this setting, such as 'striker.speed=2 m/s'; repeatable: values of a key add up",
        "KEY=GLOB",
        dest="settings",
        **SEVERAL,
    )
    | WHERE
    | argument(
        "--prune",
        "remove runs that no command will use again: failed runs, runs of other builds and older decks; runs of the "
        "last ten minutes are kept",
    )
    | DRY_RUN
)

COMMANDS = {
    "render": Command(
        _render,
        "write the deck of a scene for one engine, without running it",
        command_line.SCENE | command_line.SETTINGS | ONE_ENGINE | command_line.ENGINES | OUT | command_line.UNSAFE,
        ("fig4 --engine liggghts --out deck",),
    ),
    "run": Command(
        _run,
        "run a scene and print the run folders",
        command_line.SCENE | command_line.SETTINGS | RUN | command_line.UNSAFE,
        ("fig4 --engine yade", "fig4 --set chain.count=60 --set run.time_step='50 ns'"),
    ),
    "plan": Command(
        _plan,
        "print time step, expected errors and cost of a scene",
        command_line.SCENE | command_line.SETTINGS | command_line.ENGINES,
        ("fig4", "fig4 --set run.time_step= --set run.accuracy=1e-4"),
    ),
    "batch": Command(
        _batch,
        "run the missing cases of a study and write its table",
        BATCH,
        ("sensitivity", "wall-material --engine verlet --workers 2 --dry-run"),
        exclusive=tuple(PLACES),
    ),
    "status": Command(_status, "count the rows of a study by state", SELECTION | LIST, ("sensitivity --list",)),
    "runs": Command(
        _runs,
        "list the run folders, or remove those that are obsolete",
        LISTED,
        ("fig4 --engine yade", "--set 'striker.speed=*'", "--prune --dry-run"),
    ),
    "scenes": Command(_scenes, "list the shipped scenes, studies and materials", {}),
    "show": Command(
        _show,
        "write one case of a study as run folders with their decks",
        STUDY | CASE,
        ("wall-material 3 --engine lammps",),
    ),
}


def _parser() -> command_line.Parser:
    summary = "render scenes to decks and run them"
    return command_line.build_parser("python -m drivers", summary, ["run fig4 --engine verlet"], COMMANDS)


if __name__ == "__main__":
    command_line.run_main(main)
