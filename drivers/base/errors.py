"""What can be wrong, told in one line."""

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from drivers.chain.trace import Trace


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


class RunError(Exception):
    """A run that cannot count as done; the message is the reason that its record keeps.

    Args:
        reason: why.
        status: ``failed`` or ``timeout``.
        trace: what there is of one, for whoever asks what went wrong: it is kept in memory alone.
    """

    def __init__(self, reason: str, status: str = "failed", trace: "Trace | None" = None) -> None:
        super().__init__(reason, status)
        self.status = status
        self.trace = trace

    def __str__(self) -> str:
        """The reason."""
        return str(self.args[0])
