"""Arguments and options of the commands, each declared once: what they mean, how they are read and completed."""

import os
import re
from collections.abc import Callable, Iterable
from math import isnan
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import click
from click.shell_completion import CompletionItem

from drivers.base import paths
from postproc.figures import captions

RUNS = "Folder of the run folders (default: runs/ of the checkout)."


class _Number(click.FloatRange):
    """Number in a range; that of click takes nan."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> float:
        """Value of a text."""
        number = super().convert(value, param, ctx)
        return self.fail(f"{value} is not a number", param, ctx) if isnan(number) else number


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


def _slice(text: str) -> tuple[int, int]:
    match = re.fullmatch(r"([0-9]{1,8})/([0-9]{1,8})", text)
    if match and 1 <= int(match[1]) <= int(match[2]):
        return int(match[1]), int(match[2])
    raise click.BadParameter(f"found {text}; allowed: I/N with I from 1 to N")


def _bodies(text: str) -> tuple[int, int]:
    if match := re.fullmatch(r"([0-9]{1,8})(?:-([0-9]{1,8}))?", text):
        return int(match[1]), int(match[2] or match[1])
    raise click.BadParameter(f"found {text}; allowed: a body, such as 9, or a range of bodies, such as 5-9")


def _engines_file(text: str) -> Path:
    """Path of ``--engines``; adds the engines of that file for this process and its child processes."""
    path = Path(text).absolute()
    os.environ[paths.ENGINES_VARIABLE] = str(path)
    return path


def _scene_names(_: click.Context) -> Iterable[str]:
    return (path.stem for path in paths.SCENES.glob("*.toml"))


def _run_names(context: click.Context) -> Iterable[str]:
    folders = Path(context.params.get("runs") or paths.RUNS).glob("[!.]*/[!.]*-*-*/")
    return (f"{folder.parent.name}:{folder.name.rsplit('-', 2)[0]}" for folder in folders)


def _engine_names(_: click.Context) -> Iterable[str]:
    from drivers.engines import engine_names  # takes longer than the rest of a completion

    return engine_names()


NAMES: dict[str, Callable[[click.Context], Iterable[str]]] = {  # that a shell completes, by placeholder
    "SCENE": _scene_names,
    "RUN": _run_names,
    "STUDY": lambda _: (path.stem for path in paths.STUDIES.glob("*.toml")),
    "ENGINE": _engine_names,
    "NAME": lambda _: captions(),
}
FILE_TO_WRITE = click.Path(dir_okay=False, writable=True, path_type=Path)
TYPES: dict[str, Any] = {  # of values, by placeholder
    "DIR": _folder_to_write,
    "FILE": click.Path(path_type=Path),
    "FOLDER": click.Path(path_type=Path),
    "SECONDS": _Number(0, min_open=True),
    "N": click.IntRange(1, 10**8),
    "CASE": click.IntRange(1),
    "I/N": _slice,
    "A-B": _bodies,
}


def _complete(context: click.Context, parameter: click.Parameter, incomplete: str) -> list[CompletionItem[str]]:
    """Names that begin with the incomplete word; if there is none, the shell completes paths."""
    kinds = NAMES.keys() & re.findall("[A-Z]+", str(parameter.metavar))
    names = {name for kind in kinds for name in NAMES[kind](context) if name.startswith(incomplete)}
    return [*map(CompletionItem, sorted(names))] or [CompletionItem(incomplete, type="file")]


def option(words: str, text: str, **more: Any) -> click.Option:
    """Option of a command.

    Args:
        words: option, then the parameter of the function if it has another name, then the placeholder of the value
            in capital letters, without which it is a flag, and ``...`` if it is repeatable.
        text: help text.
        more: further arguments of ``click.Option``.
    """
    names = [word for word in words.split() if word != "..." and not word.isupper()]
    if value := next((word for word in words.split() if word.isupper()), ""):
        more = _of_value(value) | {"multiple": "..." in words.split()} | more
    return click.Option(names, help=text, **({} if value else {"is_flag": True}) | more)


def argument(name: str, value: str, text: str, **more: Any) -> click.Argument:
    """Argument of a command, for which a placeholder stands in the help; with ``...`` there may be any number."""
    return click.Argument([name], help=text, **_of_value(value) | {"nargs": -1 if value.endswith("...") else 1} | more)


def _of_value(value: str) -> dict[str, Any]:
    """Type and completion of a value, by its placeholder."""
    named = NAMES.keys() & re.findall("[A-Z]+", value)
    return {"metavar": value, "type": TYPES.get(value), "shell_complete": _complete if named else None}


def _print_definitions(context: click.Context, _: click.Parameter, asked: bool) -> None:
    """Print the definitions of all observables."""
    if asked:
        from drivers.base.terminal import text_table
        from postproc.read.observables import DEFINITIONS, SYMBOLS

        print(SYMBOLS, "", *text_table(DEFINITIONS.items()), sep="\n")
        context.exit()


def print_paths(written: Iterable[Path]) -> None:
    """Print the paths of written files, each as soon as it is written."""
    for path in written:
        print(paths.shown(path), flush=True)


DECLARED: tuple[click.Parameter, ...] = (
    argument("scene", "SCENE", "A scene file, or the name of a scene in inputs/scenes."),
    argument("study", "STUDY", "A study file, or the name of a study in inputs/studies."),
    argument("run", "RUN", "A run folder, or ENGINE:SCENE for the newest run of that scene."),
    option(
        "--set settings KEY=VALUE ...",
        "A key of the scene with its value, such as chain.count=60 or run.time_step='10 ns'; an empty value removes "
        "the key; runs lists runs with this setting, where * is any text; repeatable.",
    ),
    option(
        "--engine engines ENGINE ...",
        "Take this engine only; repeatable (default: all that are installed, or those of the study).",
    ),
    option(
        "--engines engines_file FILE",
        "File with engines of your own, as well as those of each engines.toml (see drivers/README.md).",
        type=_engines_file,
        is_eager=True,
        expose_value=False,
    ),
    option("--require ENGINE ...", "Fail if this engine does not run; repeatable."),
    option("--allow-missing", "Accept that engines of --engine or all codes are missing."),
    option("--runs DIR", RUNS, default=lambda: paths.RUNS),
    option(
        "--results DIR",
        "Folder for tables and figures (default: results/ of the checkout).",
        default=lambda: paths.RESULTS,
    ),
    option("--unsafe", "Accept a scene that a guard refuses, for instance a time step above the stability limit."),
    option(
        "--measured FILE",
        "CSV file with forces in N, in columns named after gauges, such as bead_9 [N] (default: the [[measured]] "
        "tables of the scene, for any other file).",
    ),
    option(
        "--frames N",
        "Number of times (default: 12 in a film, 100 for ParaView).",
        type=click.IntRange(2, 10_000),
    ),
    option(
        "--quick",
        "Do less: fewer scenes, steps and seeds, no long runs; for fit no profiles, no data left out, no runs of the "
        "codes.",
    ),
    option(
        "--only patterns PATTERN ...",
        "Take only cases with KEY=GLOB, such as 'striker.speed=2 m/s', or with a label that matches; repeatable "
        "(default: all cases).",
    ),
    option("--dry-run", "Print what would be done, without doing it."),
    option("--json as_json", "Print JSON."),
    option(
        "--dask ADDRESS",
        "Run on the Dask cluster at ADDRESS; without ADDRESS, on a local Dask cluster.",
        is_flag=False,
        flag_value="local",
        default="",
    ),
    option(
        "--list every",
        "Print the state of each case: done, failed, timeout, refused, stale, claimed, to do, not installed.",
    ),
    option(
        "--free KEY[=LOW..HIGH] ...",
        "Fit this key of the scene, such as contact.restitution=0.5..1, or with prior knowledge striker.speed=2±1%; "
        "repeatable (default bounds: inputs/calibration.toml).",
    ),
    option(
        "--law laws LAW ...",
        "Fit this contact law of inputs/calibration.toml (elastic, viscoelastic, power); repeatable: all on the same "
        "data, and compared.",
    ),
    option(
        "--level levels X ...",
        "Measure widths at this share of the peak; repeatable (default: 0.002 and 0.04).",
        type=_Number(0, 1, min_open=True, max_open=True),
    ),
    option(
        "--predict OBSERVABLE ...",
        "Predict this observable, such as wall_peak or bead_8_reflected_arrival, with its error; repeatable.",
    ),
    option(
        "--quoted SET,...",
        "Fit to data that the paper quotes: sets of inputs/calibration.toml, such as fig4,table1.",
        type=lambda text: tuple(name.strip() for name in text.split(",")) if text else (),
        default="",
    ),
    option(
        "--beads ranges A-B ...", "Energy of the bodies A to B, counted from the wall, the striker last; repeatable."
    ),
    argument(
        "what",
        "SCENE|RUN...",
        "Scenes by name or file, or exactly two runs: run folders, or ENGINE:SCENE for the newest run.",
        required=True,
    ),
    option(
        "--scene SCENE",
        "Scene of the deck before changes, by name or file (default: the one that render wrote into FOLDER).",
    ),
    option(
        "--sideways X",
        "Multiply displacements from the axis by X (default: 1).",
        default=1.0,
        type=_Number(0, 1e6, min_open=True),
    ),
    option(
        "--studies",
        "Write the page first, then make figures and studies and add them; short studies where no table exists.",
    ),
    argument(
        "table",
        "[TABLE]",
        "A table, such as chain.bead or axis, or a file: scene, study, engines (default: all files).",
        default="",
    ),
    option("--markdown", "Print the tables in Markdown."),
    option("--write", "Write the tables of all files into inputs/README.md."),
    option("--rerun", "Run again even if the run is done or, with auto, failed."),
    option("--time-limit SECONDS", "Stop a run after this time (default: by beads and steps)."),
    option(
        "--definitions",
        "Print the definitions of all observables and exit.",
        is_eager=True,
        expose_value=False,
        callback=_print_definitions,
    ),
    option("--from source SIGNAL", "Source of the transfer function: drive, or a gauge.", default=""),
    option("--to target SIGNAL", "Target of the transfer function: a gauge, such as wall.", default=""),
    option("--frequency F", "Measure harmonics of this frequency (default: that of a sine drive)."),
    option("--since TIME", "Begin of the record, such as '0.2 ms' (default: 0 s).", default="0 s"),
    option("--until TIME", "End of the record (default: that of the run)."),
    option("--window NAME", "hann (default), boxcar, blackmanharris or flattop.", default="hann"),
    argument("run", "SCENE|RUN", "A scene, for its exact motion; or a run folder, or ENGINE:SCENE."),
    option("--own KEY[=LOW..HIGH] ...", "As --free, with a value of its own for each data set; repeatable."),
    option("--workers N", "Number of processes on this machine (default: number of cores)."),
    option("--retry", "Run failed cases again."),
    option("--yes", "Accept a study of more than 20,000 cases."),
    option("--slice part I/N", "Run part I of N here, without writing the table."),
    option("--slurm", "Run as a Slurm job array."),
    option("--slices N", "Number of tasks of the job array (default: by the expected time)."),
    option("--slurm-line lines LINE ...", "Add a line to the job script, such as '#SBATCH --mem=2G'; repeatable."),
    option("--wait", "Wait for the job array, then write the table."),
    option("--x COLUMN", "Draw --y against this column of the table.", default=""),
    option("--y COLUMN", "Column of numbers; a name may be without its unit.", default=""),
    option("--log", "Make the axes of --x and --y logarithmic."),
    option("--power-law", "Fit y = C x^n to each curve of each engine."),
    argument("case", "CASE", "Number of the case, as in the table of the study."),
    option("--prune", "Remove runs that are not done, or whose build or deck is not today's."),
    option("--out DIR", "Folder for the deck.", required=True),
    argument("folder", "FOLDER", "Folder with a deck that was run by hand, and its output."),
    argument("names", "[NAME]...", "Figures (default: all)."),
    option(
        "--file FILE",
        "Judge the cases of a file alone (default: all claims and inputs/independent.toml).",
        default=paths.INDEPENDENT,
    ),
    option("--budget budget_s SECONDS", "Engine time of all runs together (default: 300 s; 30 s with --quick)."),
    argument("name", "ENGINE", "Name of an engine, such as verlet or an entry of your engines.toml."),
)
PARAMETERS = {  # by option or placeholder
    **{str(each.metavar) if isinstance(each, click.Argument) else each.opts[0]: each for each in DECLARED},
    # further ones of the same name or placeholder
    "--runs-read": option("--runs DIR", RUNS, default=lambda: paths.RUNS, type=Path),
    "--out-file": option(
        "--out FILE",
        "Page to write (default: results/report.html).",
        type=click.Path(dir_okay=False, writable=True, path_type=Path),
    ),
    "ALL": argument("scenes", "[SCENE]...", "Scenes by name or file (default: all)."),
    "QUOTED": argument("scenes", "[SCENE]...", "Scenes by name or file (default: the scenes of --quoted)."),
    "PAPER": argument("scenes", "[SCENE]...", "Scenes by name or file (default: the paper's four)."),
}
