"""The parts of an error."""

from dataclasses import dataclass


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
