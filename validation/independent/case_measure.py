"""What reads the numbers of an independent case from a run, and what says how large they should be."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

from drivers.chain.case import Case
from drivers.chain.trace import Trace

UNITS = (("_m_s", "m/s"), ("_N", "N"), ("_Hz", "Hz"), ("_s", "s"), ("_m", "m"), ("_diameters", "diameters"))


@dataclass(frozen=True)
class Measure:
    """Two pure functions of a case; names of quantities end with their unit, or have none.

    Attributes:
        quantities: what each quantity is, in words, by its name.
        measure: the quantities as a run shows them. Raises a ValueError that says what is missing where it shows
            none: a wave that never comes fails the run.
        theory: the quantities by a closed form or a solver of its own, as many as it knows. Raises a ValueError where
            the case is none of its kind.
        source: where the theory is from.
    """

    quantities: Mapping[str, str]
    measure: Callable[[Case, Trace], dict[str, float]]
    theory: Callable[[Case], dict[str, float]]
    source: str


def unit_of(quantity: str) -> str:
    """The unit at the end of a quantity's name; empty where it is a plain number."""
    return next((unit for ending, unit in UNITS if quantity.endswith(ending)), "")
