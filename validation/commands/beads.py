"""The command ``beads``: its commands in the order in which a user meets them, its errors and exit codes."""

import drivers.environment  # noqa: F401 - before imports that another environment lacks

# isort: split
import errno
import os
import re
import resource
import signal
import sys
import threading
from collections.abc import Callable
from pathlib import Path
from typing import NoReturn

import click
from click.shell_completion import shell_complete

from drivers.base.errors import InputError, RunError, one_line, printable
from validation.commands.options import instead
from validation.commands.sections import HELP_OPTIONS, SECTIONS

IMPOSSIBLE_NAMES = (errno.ENAMETOOLONG, errno.ELOOP)
EMPTY = re.compile(r"(--[\w-]+=)?")  # a word without a value, as of a variable that is not set
LEAST_MEMORY_BYTES = 1.5e9  # of addresses: libraries need 1.0e9 to start threads, else they wait for ever or abort
COMPLETE = "_BEADS_COMPLETE"  # set by a shell that asks for completions


class _Group(click.Group):
    """Group that lists its commands by section, in their order."""

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        for title, commands in SECTIONS.items():
            with formatter.section(title):
                formatter.write_dl([(f"{command.name:11}", command.get_short_help_str(100)) for command in commands])


BEADS = _Group(
    "beads",
    commands=[command for commands in SECTIONS.values() for command in commands],
    help="Run chains of beads on several codes and judge the results.\n\nHelp on a command: beads COMMAND --help",
    epilog="\b\nexamples:\n  beads plan fig4\n  beads run fig4 --engine verlet\n  beads compare fig4",
    context_settings=HELP_OPTIONS,
    subcommand_metavar="COMMAND ...",
    params=[instead("--version", "Print version and commit.", "options", "print_version")],
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
            _check_memory()
            return BEADS.invoke(context) or 0
    except click.exceptions.Exit as end:
        return end.exit_code if arguments else 2
    except click.UsageError as error:
        program = f"beads {arguments[0]}" if arguments[0] in BEADS.commands else "beads"
        print(one_line(f"{program}: ", _statement(error), f" (see {program} --help)"), file=sys.stderr)
        return 2


def _statement(error: click.UsageError) -> str:
    """Message of a wrong command line, which begins with the option or argument."""
    if isinstance(error, click.BadParameter) and not isinstance(error, click.MissingParameter) and error.param:
        option = isinstance(error.param, click.Option)
        return f"{error.param.opts[0] if option else error.param.metavar}: {error.message}"
    message = error.format_message().rstrip(".")
    return f"{message[0].lower()}{message[1:]}"


def _check_memory() -> None:
    limit, _ = resource.getrlimit(resource.RLIMIT_AS)
    if 0 <= limit < LEAST_MEMORY_BYTES:
        least = f"{LEAST_MEMORY_BYTES / 1e6:.0f} MB are needed"
        raise RunError(f"the memory is limited to {limit / 1e6:.0f} MB (ulimit -v); {least}")


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
        _check_present_folder()
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


def _check_present_folder() -> None:
    try:
        Path.cwd()
    except OSError as error:
        raise InputError("the present folder", "", "removed", "one that exists") from error


if __name__ == "__main__":
    main()
