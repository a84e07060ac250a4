# PYTHON_ARGCOMPLETE_OK
"""``python -m drivers``: renders decks and runs them."""

import argparse
import re
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import drivers.environment  # noqa: F401 - before anything that it lacks
from drivers.base import paths
from drivers.base.command_line import Parser, engines_file, must_be_folder, run_main, seconds
from drivers.base.errors import InputError, RunError

if TYPE_CHECKING:
    from drivers.batch.study_cases import Request

AUTO = "auto"  # in place of an engine: the cheapest that models what the scene requires


def main() -> int:
    """Reads the command line and does what it says."""
    arguments = _parser().parse_args()
    for option, default in (("runs", paths.RUNS), ("results", paths.RESULTS), ("out", None)):
        if option in arguments and "prune" not in arguments:
            setattr(arguments, option, getattr(arguments, option) or default)
            must_be_folder(f"--{option}", getattr(arguments, option))
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
    """Engines to run and engines left out because nobody asked for them and they are not installed."""
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
    deck = load_engine(name).render(case)
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
    _engines(named, automatic=True)  # a wrong name is wrong before anything is planned
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
            print(f"{case.scene.name}: {name} {ended.record.status}: {ended.record.reason}", file=sys.stderr)
            failures += 1
    for name, refusal in refusals.items():
        print(f"not run on {name}: {refusal}", file=sys.stderr)
    if missing:
        print(f"not run, since not installed ({len(missing)}): {', '.join(missing)}", file=sys.stderr)
    return 1 if failures else 0


def _plan(arguments: argparse.Namespace) -> int:
    from validation.accuracy.plan_report import plan_report

    for line in plan_report(arguments.scene, tuple(arguments.settings)):
        print(line)
    return 0


def request_of(
    study: str | Path, runs: Path, engines: Sequence[str] = (), patterns: Sequence[str] = (), *, retry: bool = False
) -> "Request":
    """A study that is asked for, with the functions of higher rooms that a batch needs."""
    from drivers.batch.study_cases import Request, Steps
    from drivers.engines._entries import entry_files

    steps = Steps(
        plan="validation.accuracy.plan:plan_case",
        observe="postproc.read.observables:observe",
        residual="postproc.read.residual:residual",
        assess="validation.accuracy.assess:assess",
    )
    return Request(study, runs, steps, tuple(engines), tuple(patterns), time.time() if retry else 0.0, entry_files())


def _batch(arguments: argparse.Namespace) -> int:
    from drivers.base.processes import cores
    from drivers.batch.study_commands import Where, batch, run_part

    for option in ("wait", "slices", "slurm_line"):
        if getattr(arguments, option) and not arguments.slurm:
            raise InputError(f"--{option.replace('_', '-')}", "", "no --slurm", "it goes with --slurm")
    for option in ("dry_run", "workers"):
        if arguments.slice and getattr(arguments, option):
            words = f"--{option.replace('_', '-')}"
            raise InputError(words, "", "--slice", "one of the two: a slice runs here, by itself")
    request = request_of(arguments.study, arguments.runs, arguments.engine, arguments.only, retry=arguments.retry)
    if arguments.slice:
        return run_part(request, *arguments.slice)
    where = Where(
        arguments.workers or cores(),
        arguments.dask,
        arguments.slurm,
        arguments.wait,
        arguments.slices,
        tuple(arguments.slurm_line),
    )
    return batch(request, arguments.results, where, dry_run=arguments.dry_run, yes=arguments.yes)


def _status(arguments: argparse.Namespace) -> int:
    from drivers.batch.study_commands import status

    request = request_of(arguments.study, arguments.runs, arguments.engine, arguments.only)
    return status(request, every=arguments.list)


def _show(arguments: argparse.Namespace) -> int:
    from drivers.batch.study_commands import show

    return show(request_of(arguments.study, arguments.runs, arguments.engine), arguments.case)


def _runs(arguments: argparse.Namespace) -> int:
    from drivers.inventory.prune import prune
    from drivers.inventory.run_folders import print_runs

    if arguments.dry_run and not arguments.prune:
        raise InputError("--dry-run", "", "no --prune", "it goes with --prune")
    if arguments.runs and not arguments.runs.is_dir():
        raise InputError(f"--runs {arguments.runs}", "", "no such folder", "a folder of runs")
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


# by the word for its value in the help: how an option is read
SEVERAL: dict[str, Any] = {"action": "append", "default": []}
KINDS: dict[str, dict[str, Any]] = {
    "": {"action": "store_true"},
    "SCENE": {},
    "SCENE ...": {"nargs": "*", "metavar": "SCENE"},
    "STUDY": {},
    "E": SEVERAL,
    "PATTERN": SEVERAL,
    "LINE": SEVERAL,
    "KEY=VALUE": SEVERAL | {"dest": "settings"},
    "KEY=GLOB": SEVERAL | {"dest": "settings"},
    "NAME": {"required": True},
    "DIR": {"type": Path},
    "FILE": {"type": engines_file},
    "FOLDER": {"type": Path, "required": True},
    "CASE": {"type": _count},
    "N": {"type": _count},
    "S": {"type": seconds},
    "I/N": {"type": _slice},
    "ADDRESS": {"nargs": "?", "const": "local"},
}
PLACES = ("--slice", "--dask", "--slurm")  # of a batch, one of them
OPTIONS = {
    "scene SCENE": "a scene file, or the name of one in inputs/scenes",
    "scenes SCENE ...": "scenes by name or file; left out: all",
    "study STUDY": "a study file, or the name of one in inputs/studies",
    "case CASE": "its number, as in the table",
    "--set KEY=VALUE": "a value over the scene's, as chain.count=60 or run.time_step='10 ns'; empty: leave the key out",
    "--set KEY=GLOB": "runs with such a value, as 'striker.speed=2 m/s'; repeatable: values of a key add up",
    "--engine NAME": "its name, such as verlet",
    "--engine E": "repeatable; left out: all that are installed, or the study's; for run also auto: the cheapest",
    "--engines FILE": "entries of own builds and adapters, over those of the engines.toml that there are",
    "--only PATTERN": "cases with KEY=GLOB, such as 'striker.speed=2 m/s', or with a label like GLOB; repeatable",
    "--out FOLDER": "folder to write the deck to",
    "--runs DIR": "where runs are kept (default: runs/ of the checkout)",
    "--results DIR": "where the tables go (default: results/)",
    "--prune": "remove runs that no command would use again: failed ones, of former builds and decks, leftovers",
    "--rerun": "run again what is done",
    "--time-limit S": "seconds after which a run is killed",
    "--unsafe": "do what a guard refuses, such as too large a time step",
    "--workers N": "processes on this machine (default: its cores)",
    "--dry-run": "say what there is to do, and do nothing; of a batch every case is validated",
    "--retry": "run failed cases again",
    "--yes": "yes, more than 20,000 cases",
    "--slice I/N": "run part I of N here, and write no table",
    "--dask ADDRESS": "run on a Dask cluster; without an address on one of its own",
    "--slurm": "run as a Slurm job array",
    "--slices N": "tasks of the job array (default: by the time to expect)",
    "--slurm-line LINE": "line of the job's script, such as 'module load lammps' or '#SBATCH --mem=2G'; repeatable",
    "--wait": "wait for the job array, then write the table",
    "--list": "case by case",
}
SCENE = ("scene SCENE", "--set KEY=VALUE")
STUDY = ("study STUDY", "--runs DIR", "--engine E", "--engines FILE")
SOME = (*STUDY, "--only PATTERN")
HERE = ("--results DIR", "--workers N", "--dry-run", "--retry", "--yes")
BATCH = (*SOME, *HERE, "--slice I/N", "--dask ADDRESS", "--slurm", "--slices N", "--slurm-line LINE", "--wait")
RUN = ("--engine E", "--engines FILE", "--runs DIR", "--rerun", "--time-limit S", "--unsafe")
# by name: what it does, how, and its options
COMMANDS: dict[str, tuple[Callable[[argparse.Namespace], int], str, tuple[str, ...]]] = {
    "render": (
        _render,
        "write an engine's deck for a scene",
        (*SCENE, "--engine NAME", "--engines FILE", "--out FOLDER", "--unsafe"),
    ),
    "run": (_run, "run a scene and print the run folders", (*SCENE, *RUN)),
    "plan": (_plan, "time step, engine, errors and cost to expect of a scene", (*SCENE, "--engines FILE")),
    "batch": (_batch, "run what is not done of a study and write its table", BATCH),
    "status": (_status, "what is done, failed, stale, running and to do of a study", (*SOME, "--list")),
    "runs": (
        _runs,
        "list the runs there are, by scene, engine and settings; or remove those of no use",
        ("scenes SCENE ...", "--engine E", "--set KEY=GLOB", "--engines FILE", "--runs DIR", "--prune", "--dry-run"),
    ),
    "scenes": (_scenes, "list the shipped scenes, studies and materials", ()),
    "show": (_show, "lay a case of a study out as run folders with their decks", (*STUDY, "case CASE")),
}


def _parser() -> Parser:
    parser = Parser(prog="python -m drivers", description="Scene files to decks to runs.")
    commands = parser.add_subparsers(required=True, metavar="COMMAND")
    for name, (action, summary, options) in COMMANDS.items():
        command = commands.add_parser(name, help=summary)
        command.set_defaults(action=action)
        place = command.add_mutually_exclusive_group() if "--slurm" in options else command
        for option in options:
            flag, _, word = option.partition(" ")
            kind = KINDS[word] | ({"metavar": KINDS[word].get("metavar", word)} if word else {})
            (place if flag in PLACES else command).add_argument(flag, help=OPTIONS[option], **kind)
    return parser


if __name__ == "__main__":
    run_main(main)
