"""Errors that end a command or a run, told in one line."""

import re
from collections.abc import Iterable
from typing import Any

InputProblem = tuple[str, str, str]  # key, found, allowed
LONGEST = 270  # characters of a message; with the name of its scene before it, a line stays below 300


def one_line(*parts: object, longest: int = LONGEST) -> str:
    """Parts of a message on one line; what is too long loses its middle, the longest part first."""
    lines = [re.sub(r"[\s\x00-\x1f\x7f]+", " ", str(part)) for part in parts]
    for left, place in enumerate(sorted(range(len(lines)), key=lambda place: len(lines[place]))):
        line, share = lines[place], longest // (len(lines) - left)
        if len(line) > share:
            line = lines[place] = f"{line[: share // 2 - 2]} ... {line[len(line) - share // 2 + 3 :]}"
        longest -= len(line)
    return "".join(lines)


class InputError(Exception):
    """The input is wrong: exit code 2.

    Args:
        where: the file (or option) that holds the input.
        key: dotted path of the offending key; empty when the whole file is meant.
        found: what stands there.
        allowed: what may stand there.
    """

    def __init__(self, where: str, key: str, found: str, allowed: str) -> None:
        super().__init__(where, key, found, allowed)  # so that it passes from process to process

    def __str__(self) -> str:
        """The one line."""
        where, key, found, allowed = self.args
        return one_line(where, f": {key}" if key else "", f": found {found}", f"; allowed: {allowed}")


def refuse_any(where: str, problems: Iterable[InputProblem]) -> None:
    """Refuses an input for the first of its problems.

    Raises:
        InputError: there is one.
    """
    for problem in problems:
        raise InputError(where, *problem)


class RunError(Exception):
    """A run that cannot count as done; the message is the reason that its record keeps.

    Args:
        reason: why.
        status: ``failed`` or ``timeout``.
        partial: what there is of its result, for whoever asks what went wrong; kept in memory alone.
    """

    def __init__(self, reason: str, status: str = "failed", partial: Any = None) -> None:
        super().__init__(reason, status)
        self.status = status
        self.partial = partial

    def __str__(self) -> str:
        """The reason."""
        return str(self.args[0])
