"""The parts of an error."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Any

from postproc.read.observables import of_kind

PARTS = ("whole", "model", "rounding", "truncation", "sampling")


@dataclass(frozen=True)
class Parts:
    """Signed parts of the error of one quantity, as shares of the true value (of the largest force for ``force``).

    Attributes:
        whole: the error of what the run shows.
        where: contact and time of the largest error, for ``force``.
    """

    quantity: str
    whole: float
    model: float
    rounding: float
    truncation: float
    sampling: float
    where: str = ""


def for_terminal(error_budget: Iterable[dict[str, Any]]) -> Iterator[tuple[str, str]]:
    """Quantity and numbers of the lines that a terminal shows of a record's budget: of the force and of peaks.

    Records of other versions may lack some parts: these lines are left out.
    """
    for each in error_budget:
        quantity = each["quantity"]
        if (quantity == "force" or of_kind([quantity], "peak")) and set(PARTS) <= each.keys():
            yield quantity, " ".join(f"{each[part]:10.1e}" for part in PARTS)
