"""Calibration on the paper's experiments: conclusions that hold for all readings of what the paper leaves open."""

from collections.abc import Iterator, Mapping, Sequence
from math import isfinite
from typing import Any

from drivers.base import paths
from drivers.base.tolerances import tolerance
from postproc.draw.overlay import number
from postproc.paper.calibrated import calibrated
from validation.calibration.calibration_file import calibration_file
from validation.calibration.draw import draw_contours, draw_data, name_of
from validation.calibration.outcome import MAX_DEVIATION, DatumRow, FitRow, Parameter, value_text
from validation.calibration.paper_fits import (
    CONTOURS,
    DATA,
    FITS,
    MODULUS,
    NOT_FITTED,
    PARAMETERS,
    ContourRow,
    study,
)  # fmt: skip
from validation.chapters import Chapter, Options, Picture, Tables, rows_in
from validation.checks import FAIL, Check, judged, without_run

MIN_PROBABILITY = 0.05  # of chi-square; below it a law does not fit
GAUGES = "sensor.time_constant"
DEFAULT = "default"  # reading with the first answer to each question


def measure(options: Options) -> dict[str, Any]:
    """Rows of all fits."""
    return study(quick=options.quick)


def _holds(row: FitRow) -> bool:
    return row.probability >= MIN_PROBABILITY


def _parameters(tables: Tables) -> dict[tuple[str, str], list[Parameter]]:
    """Parameters of each fit that all data share, by law and reading."""
    found: dict[tuple[str, str], list[Parameter]] = {}
    for row in rows_in(tables[PARAMETERS], Parameter):
        if ":" not in row.parameter:
            found.setdefault((row.law, row.data), []).append(row)
    return found


def _texts(rows: Sequence[Parameter]) -> list[str]:
    """Parameters with their errors, by the last part of their keys."""
    return [f"{row.parameter.rpartition('.')[2].replace('_', ' ')} {value_text(row)}" for row in rows]


def sentences(tables: Tables) -> Iterator[str]:
    """Conclusions over all readings, then a line for each law in the default reading."""
    yield from conclusions(tables)
    parameters = _parameters(tables)
    for row in (row for row in rows_in(tables[FITS], FitRow) if row.data == DEFAULT):
        goodness = (
            f"chi-square {row.chi_square:.3g} with {row.freedom} degrees of freedom, probability {row.probability:.2g}"
        )
        missed = f"missed: {row.missed}" if row.missed else "no number is missed"
        yield f"{row.law}: {', '.join(_texts(parameters[row.law, row.data]))}; {goodness}; {missed}"


def conclusions(tables: Tables) -> Iterator[str]:
    """Laws that fit in some reading, the range of their moduli, and the numbers that no fit gives."""
    rows, parameters = rows_in(tables[FITS], FitRow), _parameters(tables)
    readings, fitting = list(dict.fromkeys(row.data for row in rows)), [row for row in rows if _holds(row)]
    if not fitting:
        yield f"no law fits in any of {len(readings)} readings of the paper"
        return
    laws = list(dict.fromkeys(row.law for row in rows))
    counts = ", ".join(f"{law} in {sum(row.law == law for row in fitting)}" for law in laws)
    yield f"of {len(readings)} readings of the paper, laws fit (probability above {MIN_PROBABILITY:g}): {counts}"
    moduli = [row for each in fitting for row in parameters[each.law, each.data] if row.parameter == MODULUS]
    low, high = min(row.value - row.error for row in moduli), max(row.value + row.error for row in moduli)
    yield f"Young's modulus of the fits that hold, with their errors: {low * 1e-9:.2f} to {high * 1e-9:.2f} GPa"
    for law in laws:
        own = [parameters[each.law, each.data] for each in fitting if each.law == law]
        if own and all(any(row.parameter == GAUGES for row in each) for each in own):
            yield f"{law} fits only with the electronics of the gauges"
    missed = ", ".join(missed_by_all(tables)) or "none"
    yield f"missed by more than one standard error in every fit that holds: {missed}"


def missed_by_all(tables: Tables) -> list[str]:
    """Numbers that every fit that holds misses by more than one standard error, with the range of the deviations."""
    held = {(row.law, row.data) for row in rows_in(tables[FITS], FitRow) if _holds(row)}
    off: dict[str, list[float]] = {}
    for row in rows_in(tables[DATA], DatumRow):
        if (row.law, row.data) in held and isfinite(row.off) and isfinite(row.measured):
            off.setdefault(name_of(row.data_set, row.datum), []).append(abs(row.off))
    return [f"{name} ({min(each):.1f} to {max(each):.1f})" for name, each in off.items() if min(each) > 1]


def judge(tables: Tables) -> Iterator[Check]:
    """Are the parameters of the figures' dissipative chains those of the fit?"""
    file, where = calibrated(), paths.shown(paths.CALIBRATED)
    rows = rows_in(tables[PARAMETERS], Parameter)
    fitted = {row.parameter: row for row in rows if (row.law, row.data) == (file.law, file.reading)}
    for each in file.parameter:
        row = fitted.get(each.key)
        if row is None:
            yield without_run(where, file.law, f"{each.key}: no fit", FAIL)
            continue
        drift = max(abs(row.value - each.value), abs(row.error - each.error)) / each.error
        found, stored = (f"{one.value:.5g} ± {one.error:.3g} {each.unit}".rstrip() for one in (row, each))
        place = f"{stored}; the fit gives {found}"
        yield judged(where, file.law, each.key, drift, tolerance("calibration", "stored"), place)


def section(tables: Tables) -> Mapping[str, Any]:
    """Conclusions, a row for each law and reading, the numbers of the default reading, and remarks."""
    rows, parameters = rows_in(tables[FITS], FitRow), _parameters(tables)
    shown = [
        row for row in rows_in(tables[DATA], DatumRow) if row.data == DEFAULT and row.unit + row.because + row.data_set
    ]
    numbers: dict[str, list[DatumRow]] = {}
    for row in shown:
        numbers.setdefault(name_of(row.data_set, row.datum), []).append(row)
    return {
        "conclusions": list(conclusions(tables)),
        "fits": [
            {"row": row, "fits": _holds(row), "parameters": _texts(parameters[row.law, row.data])} for row in rows
        ],
        "default": DEFAULT,
        "choices": calibration_file().choice,
        "laws": list(dict.fromkeys(row.law for row in shown)),
        "numbers": {name: {row.law: row for row in each} for name, each in numbers.items()},
        "far": MAX_DEVIATION,
        "least": MIN_PROBABILITY,
        "number": number,
    }


def figures(tables: Tables) -> dict[str, Picture]:
    """Measured against fitted numbers, and contours of chi-square."""
    data = [row for row in rows_in(tables[DATA], DatumRow) if row.data == DEFAULT and row.data_set != NOT_FITTED]
    found = {FITS: Picture("Measured and fitted numbers, with the errors of both", lambda: draw_data(data))}
    if len(tables[CONTOURS]):
        points, fits = rows_in(tables[CONTOURS], ContourRow), rows_in(tables[FITS], FitRow)
        caption = "Chi-square of the viscoelastic law over modulus and restitution; 1 is elastic"
        parameters = rows_in(tables[PARAMETERS], Parameter)
        found[CONTOURS] = Picture(caption, lambda: draw_contours(points, fits, parameters))
    return found


CHAPTER = Chapter(
    FITS,
    "parameters fitted to the paper's experiments",
    {FITS: FitRow, PARAMETERS: Parameter, DATA: DatumRow, CONTOURS: ContourRow},
    measure,
    lambda tables: list(sentences(tables)),
    section,
    figures,
    judge,
)
