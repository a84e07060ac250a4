"""Parser, help texts, one-line errors and exit codes of the three command lines."""

import argparse
import errno
import os
import platform
import signal
import sys
import tomllib
from collections.abc import Callable, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory, gettempdir
from typing import Any, NoReturn

from drivers.base import paths
from drivers.base.errors import InputError, RunError, one_line
from drivers.base.files import home_of
from drivers.base.processes import git, local_changes

IMPOSSIBLE_NAMES = (errno.ENAMETOOLONG, errno.ELOOP)


# help texts that several commands share
SCENE = "a scene file, or the name of a scene in inputs/scenes"
STUDY = "a study file, or the name of a study in inputs/studies"
RUN = "a run folder, or ENGINE:SCENE for the newest run of that scene"
SET = "set a key of the scene, such as chain.count=60 or run.time_step='10 ns'; an empty value removes it; repeatable"
ENGINES_FILE = "file with engines of your own, as well as those of each engines.toml (see inputs/README.md)"
MEASURED = (
    "CSV file with forces in N, in columns named after gauges, such as bead_9 [N] "
    "(default: the [[measured]] tables of the scene, for any other file)"
)
RUNS = "folder of the run folders (default: runs/ of the checkout)"
RESULTS = "folder for tables and figures (default: results/ of the checkout)"


class _Formatter(argparse.RawDescriptionHelpFormatter):
    """Help formatter that adds the indent of the commands to the width of their column."""

    def add_argument(self, action: argparse.Action) -> None:
        super().add_argument(action)
        if isinstance(action, argparse._SubParsersAction):
            self._action_max_length += self._indent_increment


class Parser(argparse.ArgumentParser):
    """Parser of a command line or of one of its commands.

    Errors take one line, and options are accepted by their full names only.

    Args:
        summary: one line on what the command does, in lower case without a full stop.
        examples: command lines that are shown below the options.
        version: True for a whole command line, which has ``--version``.
    """

    def __init__(self, *, summary: str, examples: Sequence[str], version: bool = False, **words: Any) -> None:
        epilog = "\n  ".join([f"example{'s' * (len(examples) > 1)}:", *examples])
        description = f"{summary[0].upper()}{summary[1:]}."
        super().__init__(
            allow_abbrev=False, formatter_class=_Formatter, description=description, epilog=epilog, **words
        )
        self._commands: argparse._SubParsersAction[Parser] | None = None
        if version:
            self.description = f"{description}\nHelp on a command: {self.prog} COMMAND --help"
            self.add_argument("--version", action=_Version, nargs=0, help="print version and commit")

    def add_commands(self) -> Callable[..., "Parser"]:
        """Adds commands: the returned function adds one by its name, summary and examples."""
        commands = self.add_subparsers(title="commands", required=True, metavar="COMMAND", dest="command")
        self._commands = commands
        return lambda name, summary, examples: commands.add_parser(
            name, help=summary, summary=summary, examples=examples
        )

    def parse_args(self, *words: Any, **more: Any) -> Any:
        """Parses the words; completes them for a shell that asks, and prints the help if there are none."""
        if "_ARGCOMPLETE" in os.environ:
            from drivers.completion import complete

            complete(self)
        if not words and len(sys.argv) == 1:
            self.print_help()
            self.exit(2)
        found, unknown = self.parse_known_args(*words, **more)
        if unknown:
            command = getattr(found, "command", None)
            chosen = self._commands.choices[command] if self._commands and command else self
            chosen.error(f"unrecognized arguments: {' '.join(unknown)}")
        return found

    def error(self, message: str) -> NoReturn:
        """Exits with code 2."""
        self.exit(2, one_line(f"{self.prog}: ", message, f" (see {self.prog} --help)") + "\n")


class _Version(argparse.Action):
    def __call__(self, parser: argparse.ArgumentParser, *_: Any) -> NoReturn:
        project = tomllib.loads((paths.ROOT / "pyproject.toml").read_text())["project"]
        changes = " and changes" * local_changes()
        commit = git("rev-parse", "--short=10", "HEAD") or "unknown"
        print(f"{project['name']} {project['version']}, commit {commit}{changes}, Python {platform.python_version()}")
        parser.exit()


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
