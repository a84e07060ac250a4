"""Rows of the tables of fits, for the command and for the study."""

from collections.abc import Iterator
from dataclasses import dataclass
from math import nan

from postproc.read.observables import describe
from validation.calibration.certainty import RISES
from validation.calibration.data_sets import MeasuredNumber
from validation.calibration.outcome import Outcome


@dataclass(frozen=True)
class Parameter:
    """A parameter of one fit, in the SI unit of its key; the standard error is inf if the data do not determine it.

    ``law`` is the name of a law or the applied settings; ``data`` names the data sets.
    """

    law: str
    data: str
    parameter: str
    unit: str
    value: float
    error: float
    low_68pct: float
    high_68pct: float
    low_95pct: float
    high_95pct: float
    chi_square: float
    freedom: int
    probability: float


@dataclass(frozen=True)
class DatumRow:
    """A datum with its fitted value and its prediction by a fit without it; NaN if there is no number."""

    law: str
    data: str
    data_set: str
    datum: str
    unit: str
    measured: float
    error: float
    fitted: float
    fitted_error: float
    off: float
    by_the_others: float
    by_the_others_error: float
    by_the_others_off: float
    counts: bool
    because: str


def parameter_rows(law: str, data: str, outcome: Outcome) -> Iterator[Parameter]:
    """A row for each parameter of a fit; one without a name where none is free."""
    found = outcome.fit
    for index, free in enumerate(found.problem.free):
        profile = outcome.profiles.get(free.label)
        (low, high), (lower, higher) = (profile.interval(rise) if profile else (nan, nan) for rise in RISES.values())
        value, error = free.value(float(found.place[index])), float(outcome.certainty.errors[index])
        yield Parameter(
            law, data, free.label, free.unit, value, error, low, high, lower, higher,
            found.chi_square, found.freedom, outcome.probability,
        )  # fmt: skip
    if not found.problem.free:
        none = (nan, nan, nan, nan, nan, nan)
        yield Parameter(law, data, "none", "", *none, found.chi_square, found.freedom, outcome.probability)


def datum_rows(law: str, data: str, outcome: Outcome) -> Iterator[DatumRow]:
    """A row for each datum; for traces and prior knowledge only the deviation in standard errors."""
    for line in outcome.predictions:
        name, number = line.datum.name, line.datum.number or MeasuredNumber(line.datum.name, nan, nan)
        yield DatumRow(
            law, data, line.datum.data_set, name, describe(name).unit, number.value, number.error, line.fitted,
            line.error, line.off, line.without, line.without_error, line.without_off, number.fitted, number.because,
        )  # fmt: skip
