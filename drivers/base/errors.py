"""Errors that end a command or a run, each a message of one line."""

import re
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from typing import Any

InputProblem = tuple[str, str, str]  # key, found, allowed; without the last `found` is a whole statement
MAX_CHARACTERS = 270  # of a message; with the name of its scene in front a line stays below 300
MAX_PROBLEMS = 12  # listed of one input


# control characters, with those of terminals and of the direction of writing; except tabs and ends of lines
CONTROL = re.compile("[\x00-\x08\x0b-\x1f\x7f-\x9f\u061c\u200b-\u200f\u2028-\u202e\u2060-\u2069\ufeff]")


def printable(text: str, *, lines: bool = True) -> str:
    """Text with a question mark for each control character, which could change a terminal.

    Without ``lines`` tabs and ends of lines are replaced, too.
    """
    return CONTROL.sub("?", text if lines else text.translate({ord("\t"): "?", ord("\n"): "?"}))


def one_line(*parts: object, longest: int = MAX_CHARACTERS) -> str:
    """Join the parts of a message on one line; parts that are too long lose their middle, the longest first."""
    lines = [printable(re.sub(r"[\s\x00-\x1f\x7f]+", " ", str(part))) for part in parts]
    for left, place in enumerate(sorted(range(len(lines)), key=lambda place: len(lines[place]))):
        line, share = lines[place], longest // (len(lines) - left)
        if len(line) > share:
            line = lines[place] = f"{line[: share // 2 - 2]} ... {line[len(line) - share // 2 + 3 :]}"
        longest -= len(line)
    return "".join(lines)


class InputError(Exception):
    """Wrong input: exit code 2.

    Args:
        where: the file (or option) that holds the input.
        key: dotted path of the offending key; empty for the whole file.
        found: the value found; or, with no ``allowed``, a whole statement such as "file not found".
        allowed: the values allowed.
        more: further problems of the same input.
    """

    def __init__(self, where: str, key: str, found: str, allowed: str = "", *more: InputProblem) -> None:
        super().__init__(where, key, found, allowed, *more)  # kept by pickle, from process to process

    @property
    def problems(self) -> list[InputProblem]:
        """All problems of the input."""
        return [self.args[1:4], *self.args[4:]]

    def __str__(self) -> str:
        """All problems on one line, numbered if there are several."""
        where, problems = self.args[0], self.problems
        if len(problems) == 1:
            return one_line(where, ": ", *_statement(*problems[0]))
        listed = [one_line(f" ({n}) ", *_statement(*problem)) for n, problem in enumerate(problems[:MAX_PROBLEMS], 1)]
        rest = f" and {len(problems) - MAX_PROBLEMS} more" if len(problems) > MAX_PROBLEMS else ""
        return one_line(where, f": {len(problems)} problems:", *listed, rest, longest=MAX_PROBLEMS * MAX_CHARACTERS)


def _statement(key: str, found: str, allowed: str) -> tuple[str, str, str]:
    """Parts of a message: the key, then the value found and those allowed, or a whole statement."""
    place = f"{key}: " if key else ""
    return (place, f"found {found}", f"; allowed: {allowed}") if allowed else (place, found, "")


def refuse_any(where: str, problems: Iterable[InputProblem]) -> None:
    """Refuse an input that has any problems.

    Raises:
        InputError: lists the first of each key.
    """
    by_key = dict[str, InputProblem]()
    for problem in problems:
        by_key.setdefault(problem[0], problem)
    if by_key:
        first, *more = by_key.values()
        raise InputError(where, *first, *more)


@contextmanager
def gathered(problems: list[InputProblem], where: str) -> Iterator[None]:
    """Collect the problems of an input instead of raising the first; problems of other files are raised."""
    try:
        yield
    except InputError as error:
        if error.args[0] != where:
            raise
        problems += error.problems


class RunError(Exception):
    """A run that cannot count as done.

    Args:
        reason: the message, kept in the run's record.
        status: ``failed``, ``timeout``, or ``not run``.
        partial: the part of the result that exists, for a diagnosis; in memory only.
    """

    def __init__(self, reason: str, status: str = "failed", partial: Any = None) -> None:
        super().__init__(reason, status)
        self.status = status
        self.partial = partial

    def __str__(self) -> str:
        """Reason of the failure, without control characters."""
        return printable(str(self.args[0]))


def digits_apart(first: float, second: float) -> tuple[str, str]:
    """Two numbers with as many digits as show that they differ, at least four."""
    pairs = ((f"{first:.{digits}g}", f"{second:.{digits}g}") for digits in range(4, 18))
    return next((pair for pair in pairs if pair[0] != pair[1]), (repr(first), repr(second)))
