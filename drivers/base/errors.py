"""Errors that end a command or a run, told in one line."""

from collections.abc import Iterable
from typing import Any

InputProblem = tuple[str, str, str]  # key, found, allowed


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
        place = f"{where}: {key}" if key else where
        return f"{place}: found {found}; allowed: {allowed}".replace("\n", " ")


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
