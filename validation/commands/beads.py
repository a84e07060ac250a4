"""The command ``beads``: its options, its commands in the order in which a user meets them, errors and exit codes."""

import drivers.environment  # noqa: F401 - before imports that another environment lacks

# isort: split
import ast
import errno
import os
import re
import resource
import signal
import sys
import threading
from collections.abc import Callable, Iterable
from contextlib import suppress
from functools import partial
from importlib import import_module
from math import isfinite
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NoReturn

import click
from click.shell_completion import CompletionItem, shell_complete

from drivers.base import paths
from drivers.base.errors import InputError, RunError, one_line, printable
from postproc.figures import captions

# by option, its name in functions if that is another, the placeholder of its value, and ... if it is repeatable
TEXTS = {
    "scene SCENE": "A scene file, or the name of a scene in inputs/scenes.",
    "other [SCENE]": "A scene file, or the name of a scene (default: that of the fit).",
    "scenes [SCENE]...": "Scenes by name or file (default: all, report: the paper's four).",
    "sources [SCENE|FIT]...": "Scenes with measured data, by name or file; or the folder of a fit, to fit it again.",
    "study STUDY": "A study file, or the name of a study in inputs/studies.",
    "run RUN": "A run folder, or ENGINE:SCENE for the newest run of that scene.",
    "--set settings KEY=VALUE ...": "A key of the scene with its value, such as chain.count=60 or run.time_step='10"
    " ns'; an empty value removes the key; runs lists runs with this setting, where * is any text.",
    "--engine engines ENGINE ...": "Take this engine only (default: all that are installed, or those of the study).",
    "--engines engines_file FILE": "Engines of your own, beside those of each engines.toml (see drivers/README.md).",
    "--engine engine ENGINE": "The engine of the deck.",
    "--require ENGINE ...": "Fail if this engine does not run.",
    "--allow-missing": "Accept that engines of --engine or all codes are missing.",
    "--runs DIR": "Folder of the run folders (default: runs/ of the checkout).",
    "--runs runs_read FOLDER": "Folder of the run folders (default: runs/ of the checkout).",
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
    "--scene rendered SCENE": "Scene of the deck before changes (default: the one that render wrote into FOLDER).",
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
    "shown SCENE|RUN": "A scene, for its exact motion; or a run folder, or ENGINE:SCENE.",
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
    "--out deck DIR": "Folder for the deck.",
    "folder [FOLDER]": "Folder with a deck that was run by hand, and its output.",
    "--dump FILE": "Dump of a deck of your own, binary or text (default: that of the rendered deck).",
    "--columns NAMES": "Names of all its columns, such as id,z,vz,fz (default: those in the dump).",
    "names [FIGURE]...": "Figures of the paper (default: all), or Python files.",
    "--knob knobs KEY=FROM..TO ...": "Turn this key first, within this range, as striker.speed=0.1..5.",
    "--no-browser quiet": "Open no browser.",
    "--file FILE": "Judge the cases of a file alone (default: all claims and inputs/independent.toml).",
    "--budget budget_s SECONDS": "Engine time of all runs together (default: 300 s; 30 s with --quick).",
    "name ENGINE": "Name of an engine, such as verlet or an entry of your engines.toml.",
    "--only tests PATTERN": "Run the tests with this in their names, such as scene or server.",
    "--all all_tests": "Go on after a minute.",
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


def _engine_names() -> Iterable[str]:
    from drivers.engines import engine_names  # takes longer than the rest of a completion

    return engine_names()


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
    "ENGINE": _engine_names,
    "FIGURE": captions,
}
TYPES: dict[str, Any] = {  # of values that are no text, by placeholder
    "DIR": _folder_to_write,
    "RUN": click.Path(),
    **dict.fromkeys(("FILE", "FOLDER"), click.Path(path_type=Path)),
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
UNUSUAL: dict[str, dict[str, Any]] = {  # further arguments of click.Option, by name in functions
    "runs": {"default": lambda: paths.RUNS},
    "runs_read": {"default": lambda: paths.RUNS},
    "results": {"default": lambda: paths.RESULTS},
    "engine": {"multiple": True, "callback": _only, "required": True, "default": None},
    "window": {"default": "hann", "type": click.Choice(("hann", "boxcar", "blackmanharris", "flattop"))},
    "out": {"type": _file_to_write},
    "deck": {"required": True},
    "quoted": {"default": ""},
    "dask": {"is_flag": False, "flag_value": "local"},
    "engines_file": {"type": _engines_file, "is_eager": True, "expose_value": False},
    "version": {"callback": partial(_instead, "version"), "is_eager": True, "expose_value": False},
    "definitions": {"callback": partial(_instead, "definitions"), "is_eager": True, "expose_value": False},
}


def _complete(kind: str, _: click.Context, __: click.Parameter, incomplete: str) -> list[CompletionItem[str]]:
    """Names that begin with the incomplete word; if there is none, the shell completes paths."""
    names = sorted(name for name in NAMES[kind]() if name.startswith(incomplete))
    return [*map(CompletionItem, names)] or [CompletionItem(incomplete, type="file")]


def _parameter(words: str, text: str) -> click.Parameter:
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
    return click.Option(names, **look | UNUSUAL.get(names[-1].removeprefix("--"), {}))


PARAMETERS = {str(made.name): made for made in map(_parameter, TEXTS, TEXTS.values())}
SECTIONS = {  # functions in the order in which a user meets the commands
    "a scene": "scenes keys plan draw explore modes run compare",
    "a run": "observables spacetime spectrum energy film table vtk",
    "measured data": "overlay fit predict design",
    "studies": "batch study status show",
    "files of runs": "runs render import_",
    "report and paper": "report figures claims trade stability elements calibration",
    "engines": "engine wave",
}
# options that have a meaning only with another one of the same command, and those that others exclude
NEEDS = {
    "--slices": "--slurm",
    "--slurm-line": "--slurm",
    "--wait": "--slurm",
    "--dry-run": "--prune",
    "--columns": "--dump",
    "--x": "--y",
    "--y": "--x",
    "--log": "--x",
    "--power-law": "--x",
}
CLASHES = {"--slurm": "--slice --dask", "--dask": "--slice", "--dry-run": "--slice", "--workers": "--slice --slurm"}
IMPOSSIBLE_NAMES = (errno.ENAMETOOLONG, errno.ELOOP)
EMPTY = re.compile(r"(--[\w-]+=)?")  # a word without a value, as of a variable that is not set
LEAST_MEMORY_BYTES = 1.5e9  # of addresses: libraries need 1.0e9 to start threads, else they wait for ever or abort
COMPLETE = "_BEADS_COMPLETE"  # set by a shell that asks for completions


class _Group(click.Group):
    """Group that lists its commands by section, in their order."""

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        for title, listed in SECTIONS.items():
            with formatter.section(title):
                named = [self.commands[name.rstrip("_")] for name in listed.split()]
                formatter.write_dl([(f"{command.name:11}", command.get_short_help_str(100)) for command in named])


def _check_memory() -> None:
    limit, _ = resource.getrlimit(resource.RLIMIT_AS)
    if 0 <= limit < LEAST_MEMORY_BYTES:
        least = f"{LEAST_MEMORY_BYTES / 1e6:.0f} MB are needed"
        raise RunError(f"the memory is limited to {limit / 1e6:.0f} MB (ulimit -v); {least}")


FUNCTIONS = {  # module, docstring and parameters by name, read without loading the modules
    node.name: (file.stem, ast.get_docstring(node) or "", [each.arg for each in node.args.args + node.args.kwonlyargs])
    for file in Path(__file__).parent.glob("*_commands.py")
    for node in ast.parse(file.read_text()).body
    if isinstance(node, ast.FunctionDef)
}


def _act(module: str, function: str, **given: Any) -> Any:
    """Load a module of this package and call a function in it with what is given."""
    options = {each.opts[0]: given.get(str(each.name)) for each in click.get_current_context().command.params}
    for option in filter(options.get, options):
        if not options.get(NEEDS.get(option, ""), True):
            raise InputError(option, "", f"needs {NEEDS[option]}")
        for other in filter(options.get, CLASHES.get(option, "").split()):
            raise InputError(option, "", f"not allowed with {other}")
    given = {name: value for name, value in given.items() if value is not None}
    return getattr(import_module(f"{__package__}.{module}"), function)(**given)


def _command(function: str) -> click.Command:
    """Command of a function, with its parameters and its docstring, which ends with examples."""
    module, docstring, names = FUNCTIONS[function]
    text, _, examples = docstring.partition("\n\nExample")
    return click.Command(
        function.rstrip("_"),  # import_ is a command
        callback=partial(_act, module, function),
        params=[PARAMETERS[name] for name in (*names, *["definitions"] * (function == "observables"), "engines_file")],
        help=text,
        epilog=f"\b\nexample{examples}",
    )


BEADS = _Group(
    "beads",
    commands=[*map(_command, " ".join(SECTIONS.values()).split())],
    help="Run chains of beads on several codes and judge the results.\n\nHelp on a command: beads COMMAND --help",
    epilog="\b\nexamples:\n  beads plan fig4\n  beads run fig4 --engine verlet\n  beads compare fig4",
    context_settings={"help_option_names": ["-h", "--help"]},
    subcommand_metavar="COMMAND ...",
    callback=_check_memory,
    params=[PARAMETERS["version"]],
)


def main() -> NoReturn:
    """Run the command line of this process and exit with its code."""
    run_main(answer)


def answer() -> int:
    """Run the command line of this process and return its exit code.

    Raises:
        InputError, RunError, OSError: the command failed.
    """
    if asked := os.environ.get(COMPLETE):
        return shell_complete(BEADS, {}, "beads", COMPLETE, asked)
    arguments = sys.argv[1:]
    if empty := [place for place, word in enumerate(arguments) if EMPTY.fullmatch(word)]:
        before = arguments[empty[0]].removesuffix("=") or ["beads", *arguments][empty[0]]
        raise InputError("beads", "", f"an empty word after {before}", "a value")
    try:
        with BEADS.make_context("beads", [*arguments] or ["--help"]) as context:
            return BEADS.invoke(context) or 0
    except click.exceptions.Exit as end:
        return end.exit_code if arguments else 2
    except click.UsageError as error:
        program, message = error.ctx.command_path if error.ctx else "beads", error.format_message().rstrip(".")
        line = one_line(f"{program}: ", f"{message[0].lower()}{message[1:]}", f" (see {program} --help)")
        print(line, file=sys.stderr)
        return 2


def run_main(main: Callable[[], int]) -> NoReturn:
    """Run a command line and exit with code 0 (all good), 1 (a run failed) or 2 (wrong input).

    SIGTERM and SIGHUP act like Ctrl-C: engines are killed and unfinished files removed.
    """
    for request in (signal.SIGTERM, signal.SIGHUP):
        signal.signal(request, signal.default_int_handler)
    sys.unraisablehook = _interrupt_again
    for stream in ("stdout", "stderr"):  # None if closed by the caller, and then print() would write to the other
        if getattr(sys, stream) is None:
            setattr(sys, stream, os.fdopen(os.open(os.devnull, os.O_WRONLY), "w"))
    write = sys.stdout.write
    setattr(sys.stdout, "write", lambda text: write(printable(text)))  # noqa: B010 - mypy refuses an assignment
    try:
        code = main()
        sys.stdout.flush()
    except InputError as error:
        print(error, file=sys.stderr)
        code = 2
    except (RunError, OSError, UnicodeError, MemoryError) as error:
        if isinstance(error, BrokenPipeError):
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())  # the reader has closed the pipe
        else:
            print(one_line("error: ", str(error) or "out of memory"), file=sys.stderr)
        code = 2 if isinstance(error, OSError) and error.errno in IMPOSSIBLE_NAMES else 1
    except (KeyboardInterrupt, SystemError) as error:
        interrupt = error if isinstance(error, KeyboardInterrupt) else error.__cause__  # inside compiled code
        if not isinstance(interrupt, KeyboardInterrupt):
            raise
        print(": ".join(["interrupted", *map(str, interrupt.args)]), file=sys.stderr)
        code = 130
    sys.exit(code)


def _interrupt_again(dropped: "sys.UnraisableHookArgs") -> None:
    """Repeat an interrupt that came where Python drops exceptions, as in callbacks of compiled code."""
    if issubclass(dropped.exc_type, KeyboardInterrupt):
        threading.Timer(0.01, os.kill, (os.getpid(), signal.SIGTERM)).start()
    else:
        sys.__unraisablehook__(dropped)


if __name__ == "__main__":
    main()
