"""What the command lines share: one-line errors and exit codes."""

import argparse
import os
import signal
import sys
from collections.abc import Callable
from pathlib import Path
from typing import NoReturn

from drivers.base.errors import InputError, RunError


class Parser(argparse.ArgumentParser):
    """A parser that says in one line what is wrong."""

    def error(self, message: str) -> NoReturn:
        """Exits with code 2."""
        self.exit(2, f"{self.prog}: {message} (see {self.prog} --help)\n")


def seconds(text: str) -> float:
    """Reads an option in seconds, above zero."""
    try:
        value = float(text)
    except ValueError:
        value = 0.0
    if not 0 < value < float("inf"):
        raise argparse.ArgumentTypeError(f"found {text}; allowed: seconds above zero")
    return value


def must_be_folder(option: str, path: Path | None) -> None:
    """Refuses a file where a folder is to be made.

    Raises:
        InputError: it is one.
    """
    for place in (path, *path.parents) if path is not None else ():
        if place.exists():
            if not place.is_dir():
                raise InputError(f"{option} {path}", "", f"{place} is a file", "a folder")
            return


def must_be_file(option: str, path: Path | None) -> None:
    """Refuses a folder or a device where a file is to be written.

    Raises:
        InputError: it is one, or no folder can hold it.
    """
    if path is not None:
        if path.exists() and not path.is_file():
            raise InputError(f"{option} {path}", "", "a folder" if path.is_dir() else "a device", "a file")
        must_be_folder(option, path.parent)


def run_main(main: Callable[[], int]) -> NoReturn:
    """Runs a command line: 0 all good, 1 something ran and failed, 2 the input is wrong.

    A request to end is met like Ctrl-C, so that engines are killed and nothing half-done stays.
    """
    for request in (signal.SIGTERM, signal.SIGHUP):
        signal.signal(request, signal.default_int_handler)
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
            print(f"error: {error}", file=sys.stderr)
        code = 1
    except KeyboardInterrupt:
        print("interrupted", file=sys.stderr)
        code = 130
    sys.exit(code)
