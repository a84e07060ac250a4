"""Measures by name: each reads the numbers of a case from a run, and says how large theory has them.

A further measure is a module or class of the form of ``Measure`` and a line in ``MEASURES``.
"""

from typing import Protocol

from drivers.chain.case import Case
from drivers.chain.trace import Trace
from validation.independent import impact, linear, solitary, weak
from validation.independent.passing_waves import Collision, Train, Wall

UNITS = (("_m_s", "m/s"), ("_N", "N"), ("_Hz", "Hz"), ("_s", "s"), ("_m", "m"), ("_diameters", "diameters"))


class Measure(Protocol):
    """Two pure functions of a case; names of quantities end with their unit, or have none.

    Attributes:
        QUANTITIES: what each quantity is, in words, by its name.
        SOURCE: where the theory is from.
    """

    QUANTITIES: dict[str, str]
    SOURCE: str

    def measure(self, case: Case, trace: Trace) -> dict[str, float]:
        """The quantities as a run shows them.

        Raises:
            ValueError: the run does not show them, and fails by it: a wave never comes, say.
        """
        ...

    def theory(self, case: Case) -> dict[str, float]:
        """The quantities by a closed form or a solver of its own, as many as it knows.

        Raises:
            ValueError: the case is none of its kind.
        """
        ...


MEASURES: dict[str, Measure] = {
    "collision": Collision(),
    "impact": impact,
    "small signal": linear,
    "solitary wave": solitary,
    "train": Train(),
    "wall": Wall(),
    "weak strike": weak,
}


def unit_of(quantity: str) -> str:
    """The unit at the end of a quantity's name; empty where it is a plain number."""
    return next((unit for ending, unit in UNITS if quantity.endswith(ending)), "")
