"""The command ``beads``: its commands in the order in which a user meets them, its errors and exit codes."""

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
from collections.abc import Callable
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import Any, NoReturn

import click
from click.shell_completion import shell_complete

from drivers.base.errors import InputError, RunError, one_line, printable
from validation.commands.options import PARAMETERS

SECTIONS = {  # functions with the words of their parameters, in the order in which a user meets the commands
    "a scene": {
        "scenes": "",
        "keys": "[TABLE] --write",
        "plan": "SCENE --set --engine",
        "draw": "SCENE --set --results",
        "explore": "SCENE --set --knob --no-browser --runs --results",
        "modes": "SCENE --set --results",
        "run": "SCENE --set --engine --runs --rerun --time-limit --unsafe",
        "compare": "SCENE|RUN... --set --engine --runs --require --allow-missing --unsafe",
    },
    "a run": {
        "observables": "RUN --runs-read --level --json --definitions",
        "spacetime": "RUN --runs-read --results",
        "spectrum": "RUN --from --to --frequency --since --until --window --json --runs-read --results",
        "energy": "RUN --beads --runs-read --results",
        "film": "RUN --frames --sideways --runs-read --results",
        "table": "RUN --long --out --runs-read --results",
        "vtk": "RUN --frames --runs-read --results",
    },
    "measured data": {
        "overlay": "SCENE|RUN --set --measured --runs-read --results",
        "fit": "[SCENE|FIT]... --free --law --uncertain --own --measured --quoted --set --quick --results --runs",
        "predict": "FIT [SCENE] --set --results",
        "design": "FIT --vary --gauges --pin --candidates --set --results",
    },
    "studies": {
        "batch": "STUDY --engine --only --runs --results --workers --dry-run --retry --yes --slice --dask "
        "--slurm --slices --slurm-line --wait",
        "study": "STUDY --runs --results --x --y --log --power-law",
        "status": "STUDY --engine --only --runs --list",
        "show": "STUDY CASE --engine --runs",
    },
    "files of runs": {
        "runs": "[SCENE]... --set --engine --runs-read --prune --dry-run",
        "render": "SCENE --set --one-engine --out-deck --unsafe",
        "import_": "[FOLDER] --dump --columns --scene --set --one-engine --runs",
    },
    "report and paper": {
        "report": "[SCENE]... --studies --out --engine --runs --require --allow-missing",
        "figures": "[FIGURE]... --runs --results",
        "claims": "--file --runs --results",
        "trade": "--quick --budget --results",
        "stability": "--quick --runs --results",
        "elements": "--quick --runs --results",
        "calibration": "--quick --results",
    },
    "engines": {
        "engine": "ENGINE --tests --every-test --results",
        "wave": "",
    },
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
                named = [self.commands[name.rstrip("_")] for name in listed]
                formatter.write_dl([(f"{command.name:11}", command.get_short_help_str(100)) for command in named])


def _check_memory() -> None:
    limit, _ = resource.getrlimit(resource.RLIMIT_AS)
    if 0 <= limit < LEAST_MEMORY_BYTES:
        least = f"{LEAST_MEMORY_BYTES / 1e6:.0f} MB are needed"
        raise RunError(f"the memory is limited to {limit / 1e6:.0f} MB (ulimit -v); {least}")


FUNCTIONS = {  # module and docstring by name, read without loading the modules
    node.name: (file.stem, ast.get_docstring(node) or "")
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


def _command(function: str, usage: str) -> click.Command:
    """Command of a function, whose docstring with examples at the end is the help."""
    module, docstring = FUNCTIONS[function]
    text, _, examples = docstring.partition("\n\nExample")
    return click.Command(
        function.rstrip("_"),  # import_ is a command
        callback=partial(_act, module, function),
        params=[PARAMETERS[word] for word in (*usage.split(), "--engines")],
        help=text,
        epilog=f"\b\nexample{examples}",
    )


BEADS = _Group(
    "beads",
    commands=[_command(*declared) for section in SECTIONS.values() for declared in section.items()],
    help="Run chains of beads on several codes and judge the results.\n\nHelp on a command: beads COMMAND --help",
    epilog="\b\nexamples:\n  beads plan fig4\n  beads run fig4 --engine verlet\n  beads compare fig4",
    context_settings={"help_option_names": ["-h", "--help"]},
    subcommand_metavar="COMMAND ...",
    callback=_check_memory,
    params=[PARAMETERS["--version"]],
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
