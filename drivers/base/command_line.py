"""Parser, help texts, one-line errors and exit codes of the three command lines."""

import argparse
import errno
import os
import platform
import signal
import sys
import tomllib
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory, gettempdir
from typing import Any, NoReturn

from drivers.base import paths
from drivers.base.errors import InputError, RunError, one_line, printable
from drivers.base.files import home_of
from drivers.base.processes import git, local_changes

IMPOSSIBLE_NAMES = (errno.ENAMETOOLONG, errno.ELOOP)
Options = dict[str, dict[str, Any]]  # arguments of argparse by option or position
SEVERAL: dict[str, Any] = {"action": "append", "default": []}


def argument(name: str, words: str, metavar: str = "", **look: Any) -> Options:
    """One option or position with its help text; without a metavar a switch."""
    return {name: ({"metavar": metavar} if metavar else {"action": "store_true"}) | {"help": words} | look}


@dataclass(frozen=True)
class Command:
    """A command.

    Attributes:
        action: function of the parsed arguments that runs it.
        summary: one line of help, in lower case without a full stop.
        options: its options and positions.
        examples: example command lines, without program and command.
        exclusive: options that exclude each other.
    """

    action: Callable[[argparse.Namespace], Any]
    summary: str
    options: Options
    examples: tuple[str, ...] = ("",)
    exclusive: tuple[str, ...] = ()


class Parser(argparse.ArgumentParser):
    """Parser of a command line or of one of its commands, whose parsers are ``commands``.

    Errors take one line, and options are accepted by their full names only.
    """

    def __init__(self, summary: str, examples: Iterable[str], **words: Any) -> None:
        lines = [*examples]
        super().__init__(
            allow_abbrev=False,
            formatter_class=argparse.RawDescriptionHelpFormatter,
            description=f"{summary[0].upper()}{summary[1:]}.",
            epilog="\n  ".join([f"example{'s' * (len(lines) > 1)}:", *lines]),
            **words,
        )
        self.commands: dict[str, Parser] = {}

    def parse_args(self, *words: Any, **more: Any) -> Any:
        """Parses the words; completes them for a shell that asks, and prints the help if there are none."""
        if "_ARGCOMPLETE" in os.environ:
            import argcomplete

            argcomplete.autocomplete(self, always_complete_options=False)
        if not words and len(sys.argv) == 1:
            self.print_help()
            self.exit(2)
        found, unknown = self.parse_known_args(*words, **more)
        if self.commands and found.version:
            print(_version())
            self.exit()
        if self.commands and found.command is None:
            self.error("the following arguments are required: COMMAND")
        if unknown:
            self.commands.get(found.command, self).error(f"unrecognized arguments: {' '.join(unknown)}")
        return found

    def error(self, message: str) -> NoReturn:
        """Exits with code 2."""
        self.exit(2, one_line(f"{self.prog}: ", message, f" (see {self.prog} --help)") + "\n")


def build_parser(program: str, summary: str, examples: Iterable[str], commands: Mapping[str, Command]) -> Parser:
    """Parser of a command line, such as ``python -m drivers``, with its commands and ``--version``."""
    parser = Parser(summary, (f"{program} {example}" for example in examples), prog=program)
    parser.description = f"{parser.description}\nHelp on a command: {program} COMMAND --help"
    parser.add_argument("--version", action="store_true", help="print version and commit")
    adders = parser.add_subparsers(title="commands", metavar="COMMAND", dest="command")
    for name, command in commands.items():
        lines = (f"{program} {name} {example}".rstrip() for example in command.examples)
        adder = adders.add_parser(name, help=command.summary, summary=command.summary, examples=lines)
        adder.set_defaults(action=command.action)
        alternatives = adder.add_mutually_exclusive_group() if command.exclusive else adder
        for option, look in command.options.items():
            added = (alternatives if option in command.exclusive else adder).add_argument(option, **look)
            if "_ARGCOMPLETE" in os.environ:
                from drivers.completion import complete

                complete(added)
        parser.commands[name] = adder
    return parser


def _version() -> str:
    """Line with the version of the project and of Python, and the commit."""
    project = tomllib.loads((paths.ROOT / "pyproject.toml").read_text())["project"]
    changes = " and changes" * local_changes()
    commit = git("rev-parse", "--short=10", "HEAD") or "unknown"
    return f"{project['name']} {project['version']}, commit {commit}{changes}, Python {platform.python_version()}"


def seconds(text: str) -> float:
    """Reads an option in seconds, above zero."""
    try:
        value = float(text)
    except ValueError:
        value = 0.0
    if not 0 < value < float("inf"):
        raise argparse.ArgumentTypeError(f"found {text}; allowed: seconds above zero")
    return value


def engines_file(text: str) -> Path:
    """Reads ``--engines``: adds the engines of that file for this process and its child processes."""
    path = Path(text).absolute()
    os.environ[paths.ENGINES_VARIABLE] = str(path)
    return path


# options that several commands share
SCENE = argument("scene", "a scene file, or the name of a scene in inputs/scenes", "SCENE")
STUDY = argument("study", "a study file, or the name of a study in inputs/studies", "STUDY")
SETTINGS = argument(
    "--set",
    "set a key of the scene, such as chain.count=60 or run.time_step='10 ns'; an empty value removes it; repeatable",
    "KEY=VALUE",
    dest="settings",
    **SEVERAL,
)
ENGINES = argument(
    "--engines",
    "file with engines of your own, as well as those of each engines.toml (see inputs/README.md)",
    "FILE",
    type=engines_file,
)
MEASURED = argument(
    "--measured",
    "CSV file with forces in N, in columns named after gauges, such as bead_9 [N] "
    "(default: the [[measured]] tables of the scene, for any other file)",
    "FILE",
    type=Path,
)
RUNS = argument("--runs", "folder of the run folders (default: runs/ of the checkout)", "DIR", type=Path)
RESULTS = argument("--results", "folder for tables and figures (default: results/ of the checkout)", "DIR", type=Path)
UNSAFE = argument("--unsafe", "accept a scene that a guard refuses, for instance a time step above the stability limit")


def engines_again() -> list[str]:
    """The given option ``--engines``, for a command line that repeats this one."""
    given = os.environ.get(paths.ENGINES_VARIABLE)
    return ["--engines", given] if given else []


def must_be_folder(option: str, path: Path | None) -> None:
    """Refuses a folder that cannot be made or written to, by a trial that leaves no file.

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
    """Refuses a folder or a device where a file is to be written.

    Raises:
        InputError: the path is a folder or a device, or its folder cannot be written to.
    """
    if path is None or not path.exists():
        must_be_folder(option, path)
    elif not path.is_file():
        raise InputError(f"{option} {path}", "", "a folder" if path.is_dir() else "a device", "a file")
    else:
        must_be_folder(option, path.parent)


def run_main(main: Callable[[], int]) -> NoReturn:
    """Runs a command line and exits with code 0 (all good), 1 (a run failed) or 2 (wrong input).

    SIGTERM and SIGHUP act like Ctrl-C: engines are killed and unfinished files removed.
    """
    for request in (signal.SIGTERM, signal.SIGHUP):
        signal.signal(request, signal.default_int_handler)
    if not any(os.access(place, os.W_OK) for place in (paths.ROOT, home_of("~"))):  # numba writes compiled code there
        os.environ.setdefault("NUMBA_CACHE_DIR", gettempdir())
    if sys.stdout is not None:
        write = sys.stdout.write
        setattr(sys.stdout, "write", lambda text: write(printable(text)))  # noqa: B010 - mypy refuses an assignment
    try:
        code = main()
        if sys.stdout is not None:
            sys.stdout.flush()
    except InputError as error:
        print(error, file=sys.stderr)
        code = 2
    except (RunError, OSError, UnicodeError) as error:
        if isinstance(error, BrokenPipeError):
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())  # the reader has closed the pipe
        else:
            print(one_line("error: ", error), file=sys.stderr)
        code = 2 if isinstance(error, OSError) and error.errno in IMPOSSIBLE_NAMES else 1
    except KeyboardInterrupt as error:
        print(": ".join(["interrupted", *map(str, error.args)]), file=sys.stderr)
        code = 130
    sys.exit(code)
