"""``python -m drivers``: renders decks and runs them."""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from drivers.base.command_line import Parser, must_be_folder, run_main, seconds
from drivers.base.errors import InputError, RunError

if TYPE_CHECKING:
    from drivers.batch.study_cases import Request

AUTO = "auto"  # in place of an engine: the cheapest that models what the scene requires


def main() -> int:
    """Reads the command line and does what it says."""
    arguments = _parser().parse_args()
    return int(arguments.action(arguments))


def _parser() -> Parser:
    parser = Parser(prog="python -m drivers", description="Scene files to decks to runs.")
    commands = parser.add_subparsers(required=True, metavar="COMMAND")

    render = commands.add_parser("render", help="write an engine's deck for a scene")
    _add_scene(render)
    render.add_argument("--engine", required=True, metavar="E", help="its name, such as verlet")
    render.add_argument("--out", required=True, type=Path, metavar="DIR", help="folder to write the deck to")
    _add_unsafe(render)
    render.set_defaults(action=_render)

    run = commands.add_parser("run", help="run a scene and print the run folders")
    _add_scene(run)
    run.add_argument(
        "--engine", action="append", metavar="E", help="repeatable; auto: the cheapest; left out: all installed"
    )
    run.add_argument("--runs", type=Path, metavar="DIR", help="where run folders go (default: runs/ of the checkout)")
    run.add_argument("--rerun", action="store_true", help="run again what is done")
    run.add_argument("--time-limit", type=seconds, metavar="S", help="seconds after which a run is killed")
    _add_unsafe(run)
    run.set_defaults(action=_run)

    plan = commands.add_parser("plan", help="time step, engine, errors and cost to expect of a scene")
    _add_scene(plan)
    plan.set_defaults(action=_plan)

    batch = commands.add_parser("batch", help="run what is not done of a study and write its table")
    _add_study(batch)
    batch.add_argument("--results", type=Path, metavar="DIR", help="where the tables go (default: results/)")
    batch.add_argument("--workers", type=_count, metavar="N", help="processes on this machine (default: its cores)")
    batch.add_argument(
        "--dry-run", action="store_true", help="validate every case, say what there is to do, run nothing"
    )
    batch.add_argument("--retry", action="store_true", help="run failed cases again")
    batch.add_argument("--yes", action="store_true", help="yes, more than 20,000 cases")
    place = batch.add_mutually_exclusive_group()
    place.add_argument("--slice", type=_slice, metavar="I/N", help="run part I of N here, and write no table")
    place.add_argument(
        "--dask",
        nargs="?",
        const="local",
        metavar="ADDRESS",
        help="run on a Dask cluster; without an address on one of its own",
    )
    place.add_argument("--slurm", action="store_true", help="run as a Slurm job array")
    batch.add_argument(
        "--slices", type=_count, metavar="N", help="tasks of the job array (default: by the time to expect)"
    )
    batch.add_argument("--wait", action="store_true", help="wait for the job array, then write the table")
    batch.set_defaults(action=_batch)

    status = commands.add_parser("status", help="what is done, failed, stale, running and to do of a study")
    _add_study(status)
    status.add_argument("--list", action="store_true", help="case by case")
    status.set_defaults(action=_status)

    show = commands.add_parser("show", help="lay a case of a study out as run folders with their decks")
    _add_study(show, select=False)
    show.add_argument("case", type=_count, metavar="CASE", help="its number, as in the table")
    show.set_defaults(action=_show)
    return parser


def _add_scene(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("scene", metavar="SCENE", help="a scene file, or the name of one in inputs/scenes")
    parser.add_argument(
        "--set",
        action="append",
        default=[],
        metavar="KEY=VALUE",
        dest="settings",
        help="lay a value over the scene, such as chain.count=60 or run.time_step='10 ns'; empty: leave the key out",
    )


def _add_unsafe(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--unsafe", action="store_true", help="do what a guard refuses, such as too large a time step")


def _add_study(parser: argparse.ArgumentParser, *, select: bool = True) -> None:
    parser.add_argument("study", metavar="STUDY", help="a study file, or the name of one in inputs/studies")
    parser.add_argument("--runs", type=Path, metavar="DIR", help="where runs are kept (default: runs/ of the checkout)")
    parser.add_argument("--engine", action="append", default=[], metavar="E", help="repeatable; one of the study's")
    if select:
        parser.add_argument(
            "--only",
            action="append",
            default=[],
            metavar="PATTERN",
            help="cases with KEY=GLOB, such as 'striker.speed=2 m/s', or with a label like GLOB; repeatable",
        )


def _count(text: str) -> int:
    if not (text.isascii() and text.isdecimal() and len(text) < 9 and int(text) > 0):
        raise argparse.ArgumentTypeError(f"found {text}; allowed: a whole number from 1")
    return int(text)


def _slice(text: str) -> tuple[int, int]:
    part, _, parts = text.partition("/")
    try:
        found = _count(part), _count(parts)
    except argparse.ArgumentTypeError:
        found = (1, 0)
    if found[0] > found[1]:
        raise argparse.ArgumentTypeError(f"found {text}; allowed: I/N with I from 1 to N")
    return found


def _engines(asked: list[str] | None, *, automatic: bool = False) -> tuple[list[str], list[str]]:
    """Engines to run and engines left out because nobody asked for them and they are not installed."""
    from drivers.engines import engine_names, load_engine

    names = engine_names()
    for name in asked or []:
        if name not in names:
            raise InputError("--engine", "", f'"{name}"', ", ".join(names + [AUTO] * automatic))
    if asked:
        return list(dict.fromkeys(asked)), []
    missing = [name for name in names if load_engine(name).find() is None]
    return [name for name in names if name not in missing], missing


def _render(arguments: argparse.Namespace) -> int:
    from drivers.engines import load_engine
    from drivers.limits.refusal import refuse
    from validation.accuracy.plan import planned_case

    (name,), _ = _engines([arguments.engine])
    case = planned_case(arguments.scene, *arguments.settings)
    if not arguments.unsafe:
        refuse(case, name)
    deck = load_engine(name).render(case)
    must_be_folder("--out", arguments.out)
    arguments.out.mkdir(parents=True, exist_ok=True)
    for file in deck.write(arguments.out):
        print(file)
    return 0


def _run(arguments: argparse.Namespace) -> int:
    from drivers.base import paths
    from drivers.limits.refusal import inability, refuse
    from drivers.run.run import run_case
    from validation.accuracy.assess import assess
    from validation.accuracy.costs import cheapest
    from validation.accuracy.plan import planned_case

    asked = arguments.engine or []
    named = [name for name in asked if name != AUTO]
    _engines(named, automatic=True)  # a wrong name is wrong before anything is planned
    case = planned_case(arguments.scene, *arguments.settings)
    names, missing = _engines([*named, cheapest(case)] if AUTO in asked else named)
    refusals = {} if asked else {name: error for name in names if (error := inability(case, name))}
    names = [name for name in names if name not in refusals]
    for name in [] if arguments.unsafe else names:
        refuse(case, name)  # before any engine starts
    runs = _runs(arguments)
    failures = 0
    for name in names:
        try:
            ended = run_case(case, name, runs, rerun=arguments.rerun, limit_s=arguments.time_limit)
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
    from drivers.batch.study_cases import Request, Step, Steps

    steps = Steps(
        plan=Step("validation.accuracy.plan", "plan_case"),
        observe=Step("postproc.read.observables", "observe"),
        residual=Step("postproc.read.residual", "residual"),
        assess=Step("validation.accuracy.assess", "assess"),
    )
    return Request(study, runs, steps, tuple(engines), tuple(patterns), retry)


def _batch(arguments: argparse.Namespace) -> int:
    from drivers.base import paths
    from drivers.base.processes import cores
    from drivers.batch.study_commands import Where, batch, run_part

    runs, results = _runs(arguments), arguments.results or paths.RESULTS
    must_be_folder("--results", results)
    for option in ("wait", "slices"):
        if getattr(arguments, option) and not arguments.slurm:
            raise InputError(f"--{option}", "", "no --slurm", "it goes with --slurm")
    for option in ("dry_run", "workers"):
        if arguments.slice and getattr(arguments, option):
            words = f"--{option.replace('_', '-')}"
            raise InputError(words, "", "--slice", "one of the two: a slice runs here, by itself")
    request = request_of(arguments.study, runs, arguments.engine, arguments.only, retry=arguments.retry)
    if arguments.slice:
        return run_part(request, *arguments.slice)
    where = Where(arguments.workers or cores(), arguments.dask, arguments.slurm, arguments.wait, arguments.slices)
    return batch(request, results, where, dry_run=arguments.dry_run, yes=arguments.yes)


def _status(arguments: argparse.Namespace) -> int:
    from drivers.batch.study_commands import status

    request = request_of(arguments.study, _runs(arguments), arguments.engine, arguments.only)
    return status(request, every=arguments.list)


def _show(arguments: argparse.Namespace) -> int:
    from drivers.batch.study_commands import show

    return show(request_of(arguments.study, _runs(arguments), arguments.engine), arguments.case)


def _runs(arguments: argparse.Namespace) -> Path:
    """Where runs are kept."""
    from drivers.base import paths

    runs: Path = arguments.runs or paths.RUNS
    must_be_folder("--runs", runs)
    return runs


if __name__ == "__main__":
    run_main(main)
