"""What the command lines share: one-line errors and exit codes."""

import argparse
import errno
import os
import platform
import signal
import sys
import tomllib
from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory, gettempdir
from typing import Any, NoReturn

from drivers.base import paths
from drivers.base.errors import InputError, RunError, one_line
from drivers.base.files import home_of
from drivers.base.processes import git

IMPOSSIBLE_NAMES = (errno.ENAMETOOLONG, errno.ELOOP)


class Parser(argparse.ArgumentParser):
    """A parser that says in one line what is wrong, and takes options by their whole names only.

    That of a whole command line has a ``description``, and so ``--version``.
    """

    def __init__(self, **words: Any) -> None:
        super().__init__(allow_abbrev=False, **words)
        if "description" in words:
            self.add_argument("--version", action=_Version, nargs=0, help="print version and commit")

    def parse_args(self, *words: Any, **more: Any) -> Any:
        """Completes the words so far, if a shell asks for that."""
        if "_ARGCOMPLETE" in os.environ:
            from drivers.completion import complete

            complete(self)
        return super().parse_args(*words, **more)

    def error(self, message: str) -> NoReturn:
        """Exits with code 2."""
        self.exit(2, one_line(f"{self.prog}: ", message, f" (see {self.prog} --help)") + "\n")


class _Version(argparse.Action):
    def __call__(self, parser: argparse.ArgumentParser, *_: Any) -> NoReturn:
        project = tomllib.loads((paths.ROOT / "pyproject.toml").read_text())["project"]
        changes = " and changes" * bool(git("status", "--porcelain"))
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
    """Reads ``--engines``: from here on, its entries are engines of this process and of those it starts."""
    path = Path(text).absolute()
    os.environ[paths.ENGINES_VARIABLE] = str(path)
    return path


def engines_again() -> list[str]:
    """``--engines`` as it was given, for a command that does the same again."""
    given = os.environ.get(paths.ENGINES_VARIABLE)
    return ["--engines", given] if given else []


def must_be_folder(option: str, path: Path | None) -> None:
    """Refuses a folder that cannot be made or written to; tried beside or in what there is, and nothing stays.

    Raises:
        InputError: it is a file, or below one, or the system refuses.
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
        InputError: it is one, or no folder can hold it.
    """
    if path is None or not path.exists():
        must_be_folder(option, path)
    elif not path.is_file():
        raise InputError(f"{option} {path}", "", "a folder" if path.is_dir() else "a device", "a file")
    else:
        must_be_folder(option, path.parent)


def run_main(main: Callable[[], int]) -> NoReturn:
    """Runs a command line: 0 all good, 1 something ran and failed, 2 the input is wrong.

    A request to end is met like Ctrl-C, so that engines are killed and nothing half-done stays.
    """
    for request in (signal.SIGTERM, signal.SIGHUP):
        signal.signal(request, signal.default_int_handler)
    if not any(os.access(place, os.W_OK) for place in (paths.ROOT, home_of("~"))):  # where numba keeps compiled code
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
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())  # the reader has gone: nothing to say
        else:
            print(one_line("error: ", error), file=sys.stderr)
        code = 2 if isinstance(error, OSError) and error.errno in IMPOSSIBLE_NAMES else 1
    except KeyboardInterrupt:
        print("interrupted", file=sys.stderr)
        code = 130
    sys.exit(code)
