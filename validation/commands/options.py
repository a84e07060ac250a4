"""Arguments and options of the commands, each defined once, and the readers and checks of their values."""

import os
import re
from collections.abc import Callable
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import click

from drivers.base import paths
from drivers.base.errors import InputError
from validation.commands import completion

HELP_OPTIONS = {"help_option_names": ["-h", "--help"]}
Decorator = Callable[[Callable[..., Any]], Callable[..., Any]]


def command(
    *examples: str, name: str = "", kind: type[click.Command] = click.Command, words: str = ""
) -> Callable[[Callable[..., Any]], click.Command]:
    """Make a function a command, named after it, with the first line of its docstring as help.

    Args:
        examples: words of example command lines, after ``beads`` and the name of the command.
        name: name of the command; empty for that of the function.
        kind: class of the command.
        words: help text; empty for the docstring.
    """

    def decorate(function: Callable[..., Any]) -> click.Command:
        called = name or function.__name__
        lines = (f"  beads {called} {example}".rstrip() for example in examples)
        epilog = "\n".join(["\b", f"example{'s' * (len(examples) > 1)}:", *lines])
        look: dict[str, Any] = {"cls": kind, "help": words or None, "epilog": epilog, "context_settings": HELP_OPTIONS}
        decorator: Callable[[Callable[..., Any]], click.Command] = click.command(called, **look)
        return decorator(function)

    return decorate


def at_least_one(text: str) -> int:
    """Whole number from 1, as text."""
    if not (text.isascii() and text.isdecimal() and len(text) < 9 and int(text) > 0):
        raise click.BadParameter(f"found {text}; allowed: a whole number from 1")
    return int(text)


def _slice(text: str) -> tuple[int, int]:
    found = re.fullmatch(r"([0-9]{1,8})/([0-9]{1,8})", text)
    if found and 1 <= int(found[1]) <= int(found[2]):
        return int(found[1]), int(found[2])
    raise click.BadParameter(f"found {text}; allowed: I/N with I from 1 to N")


def _number(kind: Callable[[str], float], allowed: Callable[[float], bool], words: str) -> Callable[[str], float]:
    """Reader of a number within limits."""

    def number(text: str) -> float:
        try:
            value = kind(text)
        except ValueError:
            value = None
        if value is None or not allowed(value):
            raise click.BadParameter(f"found {text}; allowed: {words}")
        return value

    return number


_seconds = _number(float, lambda value: 0 < value < float("inf"), "seconds above zero")


def _names(text: str) -> tuple[str, ...]:
    """Names that are separated by commas."""
    return tuple(name.strip() for name in text.split(",")) if text else ()


def _engines_file(text: str) -> Path:
    """Path of ``--engines``; adds the engines of that file for this process and its child processes."""
    path = Path(text).absolute()
    os.environ[paths.ENGINES_VARIABLE] = str(path)
    return path


def must_be_folder(option: str, path: Path | None) -> None:
    """Refuse a folder that cannot be made or written to, by a trial that leaves no file.

    Raises:
        InputError: the path is a file or below a file, or the system refuses.
    """
    if path is None:
        return
    try:
        there = next(place for place in (path, *path.parents) if place.exists() or place.is_symlink())
        if not there.is_dir():
            found = f"{there} is {'a file' if there.is_file() else 'no folder'}"
            raise InputError(f"{option} {path}", "", found, "a folder")
        with TemporaryDirectory(prefix=f".{path.name}-", dir=there):
            pass
    except OSError as error:
        allowed = "a folder that can be made and written to"
        raise InputError(f"{option} {path}", "", error.strerror or str(error), allowed) from error


def must_be_file(option: str, path: Path | None) -> None:
    """Refuse a folder or a device where a file is to be written.

    Raises:
        InputError: the path is a folder or a device, or its folder cannot be written to.
    """
    if path is None or not path.exists():
        must_be_folder(option, path)
    elif not path.is_file():
        raise InputError(f"{option} {path}", "", "a folder" if path.is_dir() else "a device", "a file")
    else:
        must_be_folder(option, path.parent)


def _checked(check: Callable[[str, Path | None], None]) -> dict[str, Any]:
    """Argument of ``click.option`` that checks a path, also if it is the default."""

    def checked(context: click.Context, parameter: click.Parameter, path: Path | None) -> Path | None:
        if not context.resilient_parsing:
            check(parameter.opts[0], path)
        return path

    return {"callback": checked}


SCENE = click.argument(
    "scene",
    metavar="SCENE",
    help="A scene file, or the name of a scene in inputs/scenes.",
    shell_complete=completion.scenes,
)
STUDY = click.argument(
    "study",
    metavar="STUDY",
    help="A study file, or the name of a study in inputs/studies.",
    shell_complete=completion.studies,
)
RUN = click.argument(
    "run",
    metavar="RUN",
    help="A run folder, or ENGINE:SCENE for the newest run of that scene.",
    shell_complete=completion.runs,
)
ENGINE_NAME = click.argument(
    "name",
    metavar="ENGINE",
    help="Name of an engine, such as verlet or an entry of your engines.toml.",
    shell_complete=completion.engines,
)
CASE = click.argument(
    "case", metavar="CASE", type=at_least_one, help="Number of the case, as in the table of the study."
)


def scenes_argument(default: str) -> Decorator:
    """Argument for any number of scenes; ``default`` says which are taken without it."""
    words = f"Scenes by name or file (default: {default})."
    look: dict[str, Any] = {"metavar": "[SCENE]...", "nargs": -1, "help": words, "shell_complete": completion.scenes}
    return click.argument("scenes", **look)


SCENES_OR_RUNS = click.argument(
    "what",
    metavar="[SCENE|RUN]...",
    nargs=-1,
    help="Scenes by name or file, or exactly two runs: run folders, or ENGINE:SCENE for the newest run.",
    shell_complete=completion.scenes_and_runs,
)
SCENE_OR_RUN = click.argument(
    "run",
    metavar="SCENE|RUN",
    help="A scene, for its exact motion; or a run folder, or ENGINE:SCENE.",
    shell_complete=completion.scenes_and_runs,
)
FIGURES = click.argument(
    "names", metavar="[NAME]...", nargs=-1, help="Figures (default: all).", shell_complete=completion.figures
)

SETTINGS = click.option(
    "--set",
    "settings",
    metavar="KEY=VALUE",
    multiple=True,
    help="A key of the scene with its value, such as chain.count=60 or run.time_step='10 ns'; an empty value removes "
    "the key; runs lists runs with this setting, where * is any text; repeatable.",
)
ENGINE = click.option(
    "--engine",
    "engines",
    metavar="ENGINE",
    multiple=True,
    help="Take this engine only; repeatable (default: all that are installed, or those of the study).",
    shell_complete=completion.engines,
)
ENGINES = click.option(
    "--engines",
    "engines_file",
    metavar="FILE",
    type=_engines_file,
    is_eager=True,
    expose_value=False,
    help="File with engines of your own, as well as those of each engines.toml (see inputs/README.md).",
)
REQUIRE = click.option(
    "--require",
    "required",
    metavar="ENGINE",
    multiple=True,
    help="Fail if this engine does not run; repeatable.",
    shell_complete=completion.engines,
)
ALLOW_MISSING = click.option(
    "--allow-missing",
    is_flag=True,
    help="Accept that engines of --engine, all codes or runs of --against are missing.",
)
_runs = partial(
    click.option,
    "--runs",
    metavar="DIR",
    type=Path,
    default=lambda: paths.RUNS,
    help="Folder of the run folders (default: runs/ of the checkout).",
)
RUNS = _runs(**_checked(must_be_folder))
RUNS_READ = _runs()  # of a command that only reads runs
RESULTS = click.option(
    "--results",
    metavar="DIR",
    type=Path,
    default=lambda: paths.RESULTS,
    help="Folder for tables and figures (default: results/ of the checkout).",
    **_checked(must_be_folder),
)
DECK_FOLDER = click.option(
    "--out", metavar="DIR", type=Path, required=True, help="Folder for the deck.", **_checked(must_be_folder)
)
PAGE = click.option(
    "--out",
    metavar="FILE",
    type=Path,
    help="Page to write (default: results/report.html).",
    **_checked(must_be_file),
)
UNSAFE = click.option(
    "--unsafe",
    is_flag=True,
    help="Accept a scene that a guard refuses, for instance a time step above the stability limit.",
)
RERUN = click.option("--rerun", is_flag=True, help="Run again even if the run is done.")
TIME_LIMIT = click.option(
    "--time-limit",
    metavar="SECONDS",
    type=_seconds,
    help="Stop a run after this time (default: by beads and steps).",
)
MEASURED = click.option(
    "--measured",
    metavar="FILE",
    type=Path,
    help="CSV file with forces in N, in columns named after gauges, such as bead_9 [N] (default: the [[measured]] "
    "tables of the scene, for any other file).",
)
AGAINST = click.option(
    "--against",
    metavar="DIR",
    type=Path,
    help="Compare the run folders in --runs with those in this folder, run by run.",
)
LEVELS = click.option(
    "--level",
    "levels",
    metavar="X",
    multiple=True,
    type=_number(float, lambda share: 0 < share < 1, "a share of the peak, above 0 and below 1"),
    help="Measure widths at this share of the peak; repeatable (default: 0.002 and 0.04).",
)
JSON = click.option("--json", "as_json", is_flag=True, help="Print JSON.")
FRAMES = click.option(
    "--frames",
    metavar="N",
    type=_number(int, lambda count: 2 <= count <= 10_000, "whole numbers from 2 to 10000"),
    help="Number of times (default: 12 in a film, 100 for ParaView).",
)
SIDEWAYS = click.option(
    "--sideways",
    metavar="X",
    default=1.0,
    type=_number(float, lambda factor: 0 < factor <= 1e6, "a factor above 0, up to 1e6"),
    help="Multiply displacements from the axis by X (default: 1).",
)
QUICK = click.option(
    "--quick",
    is_flag=True,
    help="Do less: fewer scenes, steps and seeds, no long runs; for fit no profiles, no data left out, no runs of the "
    "codes.",
)
BUDGET = click.option(
    "--budget",
    "budget_s",
    metavar="SECONDS",
    type=_seconds,
    help="Engine time of all runs together (default: 300 s; 30 s with --quick).",
)
CASES_FILE = click.option(
    "--file", metavar="FILE", type=Path, help="File with the cases (default: inputs/independent.toml)."
)
STUDIES = click.option(
    "--studies",
    is_flag=True,
    help="Write the page first, then run the studies and add them; short studies where no table exists.",
)
FREE = click.option(
    "--free",
    metavar="KEY[=LOW..HIGH]",
    multiple=True,
    help="Fit this key of the scene, such as contact.restitution=0.5..1; repeatable (default bounds: "
    "inputs/calibration.toml).",
)
FREE_BY_SET = click.option(
    "--own",
    metavar="KEY[=LOW..HIGH]",
    multiple=True,
    help="As --free, with a value of its own for each data set; repeatable.",
)
QUOTED = click.option(
    "--quoted",
    metavar="SET,...",
    type=_names,
    default="",
    help="Fit to data that the paper quotes: sets of inputs/calibration.toml, such as fig4,table1.",
)
ONLY = click.option(
    "--only",
    "patterns",
    metavar="PATTERN",
    multiple=True,
    help="Take only cases with KEY=GLOB, such as 'striker.speed=2 m/s', or with a label that matches; repeatable "
    "(default: all cases).",
)
LIST = click.option(
    "--list",
    "every",
    is_flag=True,
    help="Print the state of each case: done, failed, timeout, stale, claimed, to do, not installed.",
)
DRY_RUN = click.option(
    "--dry-run",
    is_flag=True,
    help="Print what would be done, without doing it; batch still checks every case.",
)
PRUNE = click.option(
    "--prune",
    is_flag=True,
    help="Remove runs that no command will use again: failed runs, runs of other builds and older decks; runs of the "
    "last ten minutes are kept.",
)
RETRY = click.option("--retry", is_flag=True, help="Run failed cases again.")
YES = click.option("--yes", is_flag=True, help="Accept a study of more than 20,000 cases.")
WORKERS = click.option(
    "--workers",
    metavar="N",
    type=at_least_one,
    help="Number of processes on this machine (default: number of cores).",
)
SLICE = click.option(
    "--slice", "part", metavar="I/N", type=_slice, help="Run part I of N here, without writing the table."
)
DASK = click.option(
    "--dask",
    metavar="ADDRESS",
    is_flag=False,
    flag_value="local",
    default="",
    help="Run on the Dask cluster at ADDRESS; without ADDRESS, on a local Dask cluster.",
)
SLURM = click.option("--slurm", is_flag=True, help="Run as a Slurm job array.")
SLICES = click.option(
    "--slices",
    metavar="N",
    type=at_least_one,
    help="Number of tasks of the job array (default: by the expected time).",
)
SLURM_LINES = click.option(
    "--slurm-line",
    "slurm_lines",
    metavar="LINE",
    multiple=True,
    help="Add a line to the job script, such as '#SBATCH --mem=2G'; repeatable.",
)
WAIT = click.option("--wait", is_flag=True, help="Wait for the job array, then write the table.")
