"""Rows of the tables of fits, for the command and for the study."""

from collections.abc import Iterator
from dataclasses import dataclass
from math import nan

from postproc.read.observables import describe
from validation.calibration.certainty import RISES
from validation.calibration.outcome import Outcome


@dataclass(frozen=True)
class ModelRow:
    """A law with its goodness: Akaike's and Schwarz's criteria for known errors; the best of its table has excess 0.

    ``data`` names the data sets and the readings of open sentences.
    """

    law: str
    data: str
    chi_square: float
    freedom: int
    probability: float
    aic: float
    bic: float
    aic_excess: float


@dataclass(frozen=True)
class Parameter:
    """A parameter of one fit, in the SI unit of its key; the standard error is inf if the data do not determine it.

    ``start``, ``least`` and ``most`` are its starting value and bounds; ``prior`` is 0 without prior knowledge.
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
    start: float
    least: float
    most: float
    prior: float


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
    chi_square_without: float
    because: str


@dataclass(frozen=True)
class PredictionRow:
    """An observable that was not fitted, with its standard error by that of the parameters."""

    law: str
    scene: str
    observable: str
    unit: str
    value: float
    error: float


def model_rows(outcomes: dict[str, Outcome], data: str) -> list[ModelRow]:
    """A row for each law fitted to the same data."""
    lowest = min(each.fit.aic for each in outcomes.values())
    return [
        ModelRow(
            law, data, each.fit.chi_square, each.fit.freedom, each.probability, each.fit.aic, each.fit.bic,
            each.fit.aic - lowest,
        )
        for law, each in outcomes.items()
    ]  # fmt: skip


def parameter_rows(law: str, data: str, outcome: Outcome) -> Iterator[Parameter]:
    """A row for each parameter of a fit."""
    for index, free in enumerate(outcome.fit.problem.free):
        (low, high), (lower, higher) = (outcome.interval(index, rise) for rise in RISES.values())
        yield Parameter(
            law, data, free.label, free.unit, outcome.value(index), outcome.error(index), low, high, lower, higher,
            free.start, free.low, free.high, free.prior,
        )  # fmt: skip


def datum_rows(law: str, data: str, outcome: Outcome) -> Iterator[DatumRow]:
    """A row for each datum; for traces and prior knowledge only the deviation in standard errors."""
    for line in outcome.predictions:
        name, number = line.datum.name, line.datum.number
        unit = describe(name).unit or name.rpartition("_")[2] * (number is not None)
        measured, error, because = (number.value, number.error, number.because) if number else (nan, nan, "")
        yield DatumRow(
            law, data, line.datum.data_set, name, unit, measured, error, line.fitted, line.error, line.off,
            line.without, line.without_error, line.without_off, line.without_chi_square, because,
        )  # fmt: skip
