"""Arguments and options of the commands, each declared once: what they mean, how they are read and completed."""

import os
import re
from collections.abc import Callable, Iterable
from contextlib import suppress
from functools import partial
from importlib import import_module
from math import isfinite
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import click
from click.shell_completion import CompletionItem

from drivers.base import paths
from postproc.figures import captions

# by option, its name in the function if that is another, the placeholder of its value, and ... if it is repeatable
TEXTS = {
    "scene SCENE": "A scene file, or the name of a scene in inputs/scenes.",
    "scene [SCENE]": "A scene file, or the name of a scene (default: that of the fit).",
    "scenes [SCENE]...": "Scenes by name or file (default: all, report: the paper's four).",
    "scenes [SCENE|FIT]...": "Scenes with measured data, by name or file; or the folder of a fit, to fit it again.",
    "study STUDY": "A study file, or the name of a study in inputs/studies.",
    "run RUN": "A run folder, or ENGINE:SCENE for the newest run of that scene.",
    "--set settings KEY=VALUE ...": "A key of the scene with its value, such as chain.count=60 or run.time_step='10"
    " ns'; an empty value removes the key; runs lists runs with this setting, where * is any text.",
    "--engine engines ENGINE ...": "Take this engine only (default: all that are installed, or those of the study).",
    "--engines engines_file FILE": "Engines of your own, beside those of each engines.toml (see drivers/README.md).",
    "--require ENGINE ...": "Fail if this engine does not run.",
    "--allow-missing": "Accept that engines of --engine or all codes are missing.",
    "--runs DIR": "Folder of the run folders (default: runs/ of the checkout).",
    "--results DIR": "Folder for tables and figures (default: results/ of the checkout).",
    "--unsafe": "Accept a scene that a guard refuses, for instance a time step above the stability limit.",
    "--measured FILE": "CSV file with columns as bead_9 [N] (default: the [[measured]] tables of the scene).",
    "--frames COUNT": "Number of times (default: 12 in a film, 100 for ParaView).",
    "--quick": "Do less: fewer scenes, steps and seeds; for fit no profiles, no runs of the codes.",
    "--only patterns PATTERN ...": "Take only cases with KEY=GLOB, such as 'striker.speed=2 m/s', or a label like it.",
    "--dry-run": "Print what would be done, without doing it.",
    "--long": "One row for each sample and contact, instead of a column for each contact.",
    "--json as_json": "Print JSON.",
    "--dask ADDRESS": "Run on the Dask cluster at ADDRESS; without ADDRESS, on a local Dask cluster.",
    "--list every": "Print the state of each case.",
    "--free KEY[=LOW..HIGH] ...": "Fit this key, as contact.restitution=0.5..1, with a prior striker.speed=2±1%.",
    "--law laws LAW ...": "Fit this law: elastic, viscoelastic, power, hunt-crossley, kuwabara-kono, with constants as"
    " power,alpha=1.5; several are compared.",
    "--uncertain KEY=ERROR ...": "Fit this key with the scene's value as prior knowledge, as striker.speed=1%.",
    "fit FIT": "Folder of a fit, or its name in the results, such as fit-example-measured.",
    "--vary KEY=LOW..HIGH ...": "Vary this key, as striker.speed=0.05..2 or chain.count=5..40.",
    "--gauges LOW..HIGH": "Place the sensor beads between these beads, counted from the wall.",
    "--pin KEY": "Minimise the error of this parameter (default: tell the laws apart).",
    "--candidates N": "Number of experiments to compare (default: 100).",
    "--level levels SHARE ...": "Measure widths at this share of the peak (default: 0.002 and 0.04).",
    "--quoted SET,...": "Fit to data that the paper quotes: sets of inputs/calibration.toml, such as fig4,table1.",
    "--beads ranges A-B ...": "Energy of the bodies A to B, counted from the wall, the striker last.",
    "what SCENE|RUN...": "Scenes by name or file; or two runs, each a run folder, or ENGINE:SCENE for the newest run.",
    "--scene SCENE": "Scene of the deck before changes (default: the one that render wrote into FOLDER).",
    "--sideways FACTOR": "Multiply displacements from the axis by this (default: 1).",
    "--studies": "Add figures and studies after the page is written; short studies where no table exists.",
    "table [TABLE]": "A table, such as chain.bead or axis, or a file: scene, study, engines, run (default: all files).",
    "--write": "Write the tables of all files into inputs/README.md.",
    "--rerun": "Run again even if the run is done or, with auto, failed.",
    "--time-limit SECONDS": "Stop a run after this time (default: by beads and steps).",
    "--version": "Print version and commit.",
    "--definitions": "Print the definitions of all observables and exit.",
    "--from source SIGNAL": "Source of the transfer function: drive, or a gauge.",
    "--to target SIGNAL": "Target of the transfer function: a gauge, such as wall.",
    "--frequency F": "Measure harmonics of this frequency (default: that of a sine drive).",
    "--since TIME": "Begin of the record, such as '0.2 ms' (default: that of the run).",
    "--until TIME": "End of the record (default: that of the run).",
    "--window NAME": "hann (default), boxcar, blackmanharris or flattop.",
    "run SCENE|RUN": "A scene, for its exact motion; or a run folder, or ENGINE:SCENE.",
    "--own KEY[=LOW..HIGH] ...": "As --free, with a value of its own for each data set.",
    "--workers N": "Number of processes on this machine (default: number of cores).",
    "--retry": "Run failed cases again.",
    "--yes": "Accept a study of more than 20,000 cases.",
    "--slice part I/N": "Run part I of N here, without writing the table.",
    "--slurm": "Run as a Slurm job array.",
    "--slices N": "Number of tasks of the job array (default: by the expected time).",
    "--slurm-line lines LINE ...": "Add a line to the job script, such as '#SBATCH --mem=2G'.",
    "--wait": "Wait for the job array, then write the table.",
    "--x COLUMN": "Draw --y against this column of the table.",
    "--y COLUMN": "Column of numbers; a name may be without its unit.",
    "--log": "Make the axes of --x and --y logarithmic.",
    "--power-law": "Fit y = C x^n to each curve of each engine.",
    "case CASE": "Number of the case, as in the table of the study.",
    "--prune": "Remove runs that are not done, or whose build or deck is not today's.",
    "--out FILE": "File to write (default: report.html, or a table named after RUN, in results/).",
    "folder [FOLDER]": "Folder with a deck that was run by hand, and its output.",
    "--dump FILE": "Dump of a deck of your own, binary or text (default: that of the rendered deck).",
    "--columns NAMES": "Names of all its columns, such as id,z,vz,fz (default: those in the dump).",
    "names [FIGURE]...": "Figures of the paper (default: all), or Python files.",
    "--knob knobs KEY=FROM..TO ...": "Turn this key first, within this range, as striker.speed=0.1..5.",
    "--no-browser quiet": "Open no browser.",
    "--file FILE": "Judge the cases of a file alone (default: all claims and inputs/independent.toml).",
    "--budget budget_s SECONDS": "Engine time of all runs together (default: 300 s; 30 s with --quick).",
    "name ENGINE": "Name of an engine, such as verlet or an entry of your engines.toml.",
}


class _Number(click.FloatRange):
    """Finite number in a range; that of click may be nan or infinite."""

    name = "number"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> float:
        """Value of a text."""
        number = super().convert(value, param, ctx)
        return number if isfinite(number) else self.fail(f"{value} is not a finite number", param, ctx)


class _Count(click.IntRange):
    """Whole number in a range."""

    name = "whole number"


def _folder_to_write(text: str | Path) -> Path:
    """Path of a folder that can be made and written to, after a trial that leaves no file."""
    path = Path(text)
    try:
        there = next(place for place in (path, *path.parents) if place.exists() or place.is_symlink())
        with TemporaryDirectory(prefix=f".{path.name}-", dir=there):
            return path
    except OSError as error:
        allowed = "a folder that can be made and written to"
        raise click.BadParameter(f"found {path} ({error.strerror or error}); allowed: {allowed}") from error


def _file_to_write(text: str) -> Path:
    """Path of a file that is there or can be made, together with its folder."""
    path = Path(text)
    if path.exists() and not path.is_file():
        raise click.BadParameter(f"found {path}, {'a folder' if path.is_dir() else 'a device'}; allowed: a file")
    return _folder_to_write(path.parent) / path.name


def _slice(text: str) -> tuple[int, int]:
    match = re.fullmatch(r"([0-9]{1,8})/([0-9]{1,8})", text)
    if match and 1 <= int(match[1]) <= int(match[2]):
        return int(match[1]), int(match[2])
    raise click.BadParameter(f"found {text}; allowed: I/N with I from 1 to N")


def _bodies(text: str) -> tuple[int, int]:
    if match := re.fullmatch(r"([0-9]{1,8})(?:-([0-9]{1,8}))?", text):
        return int(match[1]), int(match[2] or match[1])
    raise click.BadParameter(f"found {text}; allowed: a body, such as 9, or a range of bodies, such as 5-9")


def _quantity(text: str, unit: str) -> float:
    from drivers.base.units import to_si  # takes longer than the rest of a completion

    with suppress(ValueError):
        if (value := to_si(text, unit)) > 0 or (value == 0 and unit == "s"):
            return value
    raise click.BadParameter(f'found "{text}"; allowed: a quantity in {unit}, such as 1 k{unit}')


def _engines_file(text: str) -> Path:
    """Path of ``--engines``; adds the engines of that file for this process and its child processes."""
    path = Path(text).absolute()
    os.environ[paths.ENGINES_VARIABLE] = str(path)
    return path


def _instead(function: str, context: click.Context, _: click.Parameter, asked: bool) -> None:
    """Call a function instead of the command."""
    if asked:
        getattr(import_module(f"{__package__}.key_commands"), function)()
        context.exit()


def _only(_: click.Context, __: click.Parameter, given: tuple[str, ...]) -> str:
    """The value of a required option that stands once."""
    if len(given) > 1:
        raise click.BadParameter(f"found {', '.join(given)}; allowed: one")
    return given[0]


NAMES: dict[str, Callable[[], Iterable[str]]] = {  # that a shell completes, by placeholder
    "SCENE": lambda: (path.stem for path in paths.SCENES.glob("*.toml")),
    "STUDY": lambda: (path.stem for path in paths.STUDIES.glob("*.toml")),
    "ENGINE": lambda: import_module("drivers.engines").engine_names(),  # takes longer than the rest
    "FIGURE": captions,
}
TYPES: dict[str, Any] = {  # of values that are no text, by placeholder
    "DIR": _folder_to_write,
    "RUN": click.Path(),
    "FILE": click.Path(path_type=Path),
    "FOLDER": click.Path(path_type=Path),
    "[FOLDER]": click.Path(path_type=Path, file_okay=False),
    "SECONDS": _Number(0, min_open=True),
    "SHARE": _Number(0, 1, min_open=True, max_open=True),
    "FACTOR": _Number(0, 1e6, min_open=True),
    "N": _Count(1, 10**8),
    "COUNT": _Count(2, 10_000),
    "CASE": _Count(1),
    "I/N": _slice,
    "A-B": _bodies,
    "TIME": lambda text: _quantity(text, "s"),
    "F": lambda text: _quantity(text, "Hz"),
    "SET,...": lambda text: tuple(map(str.strip, text.split(","))) if text else (),
}
UNUSUAL: dict[str, dict[str, Any]] = {  # further arguments of click.Option
    "--runs": {"default": lambda: paths.RUNS},
    "--results": {"default": lambda: paths.RESULTS},
    "--window": {"default": "hann", "type": click.Choice(("hann", "boxcar", "blackmanharris", "flattop"))},
    "--out": {"type": _file_to_write},
    "--quoted": {"default": ""},
    "--dask": {"is_flag": False, "flag_value": "local"},
    "--engines": {"type": _engines_file, "is_eager": True, "expose_value": False},
    "--version": {"callback": partial(_instead, "version"), "is_eager": True, "expose_value": False},
    "--definitions": {"callback": partial(_instead, "definitions"), "is_eager": True, "expose_value": False},
}


def _complete(kind: str, _: click.Context, __: click.Parameter, incomplete: str) -> list[CompletionItem[str]]:
    """Names that begin with the incomplete word; if there is none, the shell completes paths."""
    names = sorted(name for name in NAMES[kind]() if name.startswith(incomplete))
    return [*map(CompletionItem, names)] or [CompletionItem(incomplete, type="file")]


def _parameter(words: str, text: str, **more: Any) -> click.Parameter:
    """Option or argument of a command, from an entry of ``TEXTS``."""
    names = [word for word in words.split() if word != "..." and not word.isupper()]
    value = next((word for word in words.split() if word.isupper()), "")
    look: dict[str, Any] = {"metavar": value, "type": TYPES.get(value), "help": text}
    for named in NAMES.keys() & re.findall("[A-Z]+", value):
        look["shell_complete"] = partial(_complete, named)
    if not words.startswith("--"):
        return click.Argument(names, **look, nargs=-1 if value.endswith("...") else 1, required=value[0] != "[")
    if not value:
        look = {"is_flag": True, "help": text}
    elif "..." in words.split():
        look |= {"multiple": True, "help": f"{text.removesuffix('.')}; repeatable."}
    elif value not in TYPES:
        look["default"] = ""
    return click.Option(names, **look | UNUSUAL.get(names[0], {}) | more)


PARAMETERS = {  # by option, or by placeholder of an argument
    **{words.split()[not words.startswith("--")]: _parameter(words, text) for words, text in TEXTS.items()},
    "--runs-read": _parameter("--runs FOLDER", TEXTS["--runs DIR"]),
    "--one-engine": _parameter(
        "--engine ENGINE", "The engine of the deck.", multiple=True, callback=_only, required=True, default=None
    ),
    "--tests": _parameter("--only only PATTERN", "Run the tests with this in their names, such as scene or server."),
    "--every-test": _parameter("--all every", "Go on after a minute."),
    "--out-deck": _parameter("--out DIR", "Folder for the deck.", required=True, type=_folder_to_write),
}


def print_paths(written: Iterable[Path]) -> None:
    """Print the paths of written files, each as soon as it is written."""
    for path in written:
        print(paths.shown(path), flush=True)
