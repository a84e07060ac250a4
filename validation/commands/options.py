"""Arguments and options of several commands, and the readers and checks of values."""

import os
from collections.abc import Callable, Iterable
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
    *examples: str,
    name: str = "",
    kind: type[click.Command] = click.Command,
    text: str = "",
    engines: bool = True,
) -> Callable[[Callable[..., Any]], click.Command]:
    """Make a function a command, named after it, with the first line of its docstring as help.

    Args:
        examples: words of example command lines, after ``beads`` and the name of the command.
        name: name of the command; empty for that of the function.
        kind: class of the command.
        text: help text; empty for the docstring.
        engines: True if the command loads engines, so that it has the option ``--engines``.
    """

    def decorate(function: Callable[..., Any]) -> click.Command:
        called = name or function.__name__
        lines = (f"  beads {called} {example}".rstrip() for example in examples)
        epilog = "\n".join(["\b", f"example{'s' * (len(examples) > 1)}:", *lines])
        look: dict[str, Any] = {"cls": kind, "help": text or None, "epilog": epilog, "context_settings": HELP_OPTIONS}
        decorator: Callable[[Callable[..., Any]], click.Command] = click.command(called, **look)
        made = decorator(function)
        made.params += [ENGINES] * engines
        return made

    return decorate


def option(names: str, value: str, text: str, **more: Any) -> Decorator:
    """Option of a command.

    Args:
        names: option, and the parameter of the function if it has another name.
        value: placeholder of the value in the help; empty for a flag.
        text: help text.
        more: further arguments of ``click.option``.
    """
    kind: dict[str, Any] = {"metavar": value} if value else {"is_flag": True}
    return click.option(*names.split(), help=text, **kind, **more)


def number(kind: Callable[[str], float], allowed: Callable[[float], bool], described: str) -> Callable[[str], float]:
    """Reader of a number within limits."""

    def read(text: str) -> float:
        try:
            value = kind(text)
        except ValueError:
            value = None
        if value is None or not allowed(value):
            raise click.BadParameter(f"found {text}; allowed: {described}")
        return value

    return read


at_least_one = number(int, lambda count: 0 < count < 10**8, "a whole number from 1")
seconds = number(float, lambda value: 0 < value < float("inf"), "seconds above zero")


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
    if path and path.exists() and not path.is_file():
        raise InputError(f"{option} {path}", "", "a folder" if path.is_dir() else "a device", "a file")
    must_be_folder(option, path.parent if path and path.is_file() else path)


def print_paths(written: Iterable[Path]) -> None:
    """Print the paths of written files, each as soon as it is written."""
    for path in written:
        print(paths.shown(path), flush=True)


def one_of(engines: tuple[str, ...]) -> str:
    """The only engine given.

    Raises:
        InputError: none or several are given.
    """
    if len(engines) != 1:
        raise InputError("--engine", "", ", ".join(engines) or "none", "one engine")
    return engines[0]


def checked(check: Callable[[str, Path | None], None]) -> Callable[..., Path | None]:
    """Callback of an option that checks a path, also if it is the default."""

    def callback(context: click.Context, parameter: click.Parameter, path: Path | None) -> Path | None:
        if not context.resilient_parsing:
            check(parameter.opts[0], path)
        return path

    return callback


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


def scenes_argument(default: str) -> Decorator:
    """Argument for any number of scenes; ``default`` says which are taken without it."""
    text = f"Scenes by name or file (default: {default})."
    look: dict[str, Any] = {"metavar": "[SCENE]...", "nargs": -1, "help": text, "shell_complete": completion.scenes}
    return click.argument("scenes", **look)


SETTINGS = option(
    "--set settings",
    "KEY=VALUE",
    "A key of the scene with its value, such as chain.count=60 or run.time_step='10 ns'; an empty value removes "
    "the key; runs lists runs with this setting, where * is any text; repeatable.",
    multiple=True,
)
ENGINE = option(
    "--engine engines",
    "ENGINE",
    "Take this engine only; repeatable (default: all that are installed, or those of the study).",
    multiple=True,
    shell_complete=completion.engines,
)
ENGINES = click.Option(
    ["--engines", "engines_file"],
    metavar="FILE",
    type=_engines_file,
    is_eager=True,
    expose_value=False,
    help="File with engines of your own, as well as those of each engines.toml (see drivers/README.md).",
)
REQUIRE = option(
    "--require required",
    "ENGINE",
    "Fail if this engine does not run; repeatable.",
    multiple=True,
    shell_complete=completion.engines,
)
ALLOW_MISSING = option(
    "--allow-missing", "", "Accept that engines of --engine, all codes or runs of --against are missing."
)
_runs = partial(
    click.option,
    "--runs",
    metavar="DIR",
    type=Path,
    default=lambda: paths.RUNS,
    help="Folder of the run folders (default: runs/ of the checkout).",
)
RUNS = _runs(callback=checked(must_be_folder))
RUNS_READ = _runs()  # of a command that only reads runs
RESULTS = option(
    "--results",
    "DIR",
    "Folder for tables and figures (default: results/ of the checkout).",
    type=Path,
    default=lambda: paths.RESULTS,
    callback=checked(must_be_folder),
)
UNSAFE = option(
    "--unsafe", "", "Accept a scene that a guard refuses, for instance a time step above the stability limit."
)
MEASURED = option(
    "--measured",
    "FILE",
    "CSV file with forces in N, in columns named after gauges, such as bead_9 [N] (default: the [[measured]] "
    "tables of the scene, for any other file).",
    type=Path,
)
FRAMES = option(
    "--frames",
    "N",
    "Number of times (default: 12 in a film, 100 for ParaView).",
    type=number(int, lambda count: 2 <= count <= 10_000, "whole numbers from 2 to 10000"),
)
QUICK = option(
    "--quick",
    "",
    "Do less: fewer scenes, steps and seeds, no long runs; for fit no profiles, no data left out, no runs of the "
    "codes.",
)
ONLY = option(
    "--only patterns",
    "PATTERN",
    "Take only cases with KEY=GLOB, such as 'striker.speed=2 m/s', or with a label that matches; repeatable "
    "(default: all cases).",
    multiple=True,
)
DRY_RUN = option("--dry-run", "", "Print what would be done, without doing it.")
