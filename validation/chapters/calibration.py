"""Calibration on the paper's experiments: conclusions that hold for all readings of what the paper leaves open."""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd

from drivers.base import paths
from drivers.base.tolerances import tolerance
from postproc.draw.overlay import number
from postproc.paper.calibrated import calibrated
from validation.calibration.calibration_file import calibration_file
from validation.calibration.draw import draw_data, name_of
from validation.calibration.outcome import MAX_DEVIATION, DatumRow, FitRow, Parameter, value_text
from validation.calibration.paper_fits import DATA, FITS, MODULUS, NOT_FITTED, PARAMETERS, study
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
    by_fit: dict[tuple[str, str], list[Parameter]] = {}
    for row in rows_in(tables[PARAMETERS], Parameter):
        if ":" not in row.parameter:
            by_fit.setdefault((row.law, row.data), []).append(row)
    return by_fit


def _texts(rows: Sequence[Parameter]) -> list[str]:
    """Parameters with their errors, by the last part of their keys."""
    names = [row.parameter.rpartition(".")[2].replace("_", " ").replace("youngs", "Young's") for row in rows]
    return [f"{name} {value_text(row)}" for name, row in zip(names, rows, strict=True)]


def _missed(row: FitRow) -> str:
    """Names of the numbers that a fit misses."""
    return "; ".join(name_of(*label.split(": ")) for label in row.missed.split("; ") if label)


def sentences(tables: Tables) -> Iterator[str]:
    """Conclusions over all readings, then a line for each law in the default reading."""
    yield from conclusions(tables)
    parameters = _parameters(tables)
    for row in (row for row in rows_in(tables[FITS], FitRow) if row.data == DEFAULT):
        goodness = (
            f"chi-square {row.chi_square:.3g} with {row.freedom} degrees of freedom, probability {row.probability:.2g}"
        )
        missed = f"missed: {_missed(row)}" if row.missed else "no number is missed"
        yield f"{row.law}: {', '.join(_texts(parameters[row.law, row.data]))}; {goodness}; {missed}"


def conclusions(tables: Tables) -> Iterator[str]:
    """Laws that fit in some reading, the range of their moduli, and the numbers that most fits miss."""
    rows, parameters = rows_in(tables[FITS], FitRow), _parameters(tables)
    readings, fitting = list(dict.fromkeys(row.data for row in rows)), [row for row in rows if _holds(row)]
    if not fitting:
        yield f"no law fits in any of {len(readings)} readings of the paper"
        return
    counts = [f"{law} in {sum(row.law == law for row in fitting)}" for law in _laws(rows)]
    least = f"(probability above {MIN_PROBABILITY:g})"
    yield f"of {len(readings)} readings of the paper, laws fit {least}: {', '.join(counts)}"
    low, high = bounds(tables, MODULUS)
    yield f"Young's modulus of the fits that hold, with their errors: {low * 1e-9:.2f} to {high * 1e-9:.2f} GPa"
    for law in _laws(fitting):
        of_law = [parameters[fitted.law, fitted.data] for fitted in fitting if fitted.law == law]
        if all(any(row.parameter == GAUGES for row in fitted) for fitted in of_law):
            yield f"{law} fits only with the electronics of the gauges"
    missed = ", ".join(f"{name} ({count})" for name, count in often_missed(tables).items()) or "none"
    yield f"missed by more than one standard error in most of the {len(fitting)} fits that hold: {missed}"


def stored_conclusions() -> list[str]:
    """The conclusions of the full study that are stored with the parameters of the figures."""
    file, modulus = calibrated(), next(kept for kept in calibrated().parameter if kept.key == MODULUS)
    return [
        f"over all readings of the paper (make calibration), these laws fit in some: {', '.join(file.laws)}",
        f"Young's modulus of these fits, with their errors: {modulus.low * 1e-9:.2f} to {modulus.high * 1e-9:.2f} GPa",
        f"missed by more than one standard error in most of these fits: {', '.join(file.missed)}",
    ]


def _full(rows: Sequence[FitRow]) -> bool:
    """True if the fits are on all readings of the paper."""
    return len({row.data for row in rows}) == len(calibration_file().readings())


def _laws(rows: Sequence[FitRow]) -> list[str]:
    """Names of the laws in some rows, in the order of the file."""
    return [law.name for law in calibration_file().law if any(row.law == law.name for row in rows)]


def bounds(tables: Tables, key: str) -> tuple[float, float]:
    """Lowest and highest value of a parameter, with its error, in the fits that hold."""
    rows = _of_held_fits(tables, PARAMETERS)
    rows = rows[rows["parameter"] == key]
    error = rows["error"].where(np.isfinite(rows["error"]), 0.0)
    low, high = (rows["value"] - error).clip(lower=rows["least"]), (rows["value"] + error).clip(upper=rows["most"])
    return float(low.min()), float(high.max())


def _of_held_fits(tables: Tables, name: str) -> pd.DataFrame:
    """Rows of a table that belong to the fits that hold."""
    fits = tables[FITS]
    return tables[name].merge(fits.loc[fits["probability"] >= MIN_PROBABILITY, ["law", "data"]])


def often_missed(tables: Tables) -> dict[str, int]:
    """Numbers that more than half of the fits that hold miss by more than one standard error, with how many do."""
    rows, fits = _of_held_fits(tables, DATA), sum(map(_holds, rows_in(tables[FITS], FitRow)))
    rows = rows[(rows["data_set"] != NOT_FITTED) & np.isfinite(rows["measured"])]
    names = [name_of(*pair) for pair in zip(rows["data_set"], rows["datum"], strict=True)]
    counts = (rows["off"].abs() > 1).groupby(names, sort=False).sum()
    return {str(name): int(count) for name, count in counts.items() if count > fits / 2}


def judge(tables: Tables) -> Iterator[Check]:
    """Are the parameters of the figures' dissipative chains, and the stored conclusions, those of the fits?"""
    file, where = calibrated(), paths.shown(paths.CALIBRATED)
    fits = rows_in(tables[FITS], FitRow)
    if _full(fits):
        present = tuple(_laws([row for row in fits if _holds(row)])), tuple(often_missed(tables))
        if present != (file.laws, file.missed):
            yield without_run(where, "", f"laws and missed: the fits give {present}", FAIL)
    rows = rows_in(tables[PARAMETERS], Parameter)
    fitted = {row.parameter: row for row in rows if (row.law, row.data) == (file.law, file.reading)}
    for kept in file.parameter:
        row = fitted.get(kept.key)
        if row is None:
            yield without_run(where, file.law, f"{kept.key}: no fit", FAIL)
            continue
        changes = [row.value - kept.value, row.error - kept.error]
        if _full(fits):
            changes += [new - old for new, old in zip(bounds(tables, kept.key), (kept.low, kept.high), strict=True)]
        drift = max(map(abs, changes)) / kept.error
        given, stored = (f"{shown.value:.5g} ± {shown.error:.3g} {kept.unit}".rstrip() for shown in (row, kept))
        place = f"{stored}; the fit gives {given}"
        yield judged(where, file.law, kept.key, drift, tolerance("calibration", "stored"), place)


def section(tables: Tables) -> Mapping[str, Any]:
    """Conclusions, a row for each law and reading, the numbers of the default reading, and remarks."""
    rows, parameters = rows_in(tables[FITS], FitRow), _parameters(tables)
    shown = [
        row for row in rows_in(tables[DATA], DatumRow) if row.data == DEFAULT and row.unit + row.because + row.data_set
    ]
    numbers: dict[str, list[DatumRow]] = {}
    for row in shown:
        name = row.datum if row.data_set == NOT_FITTED else name_of(row.data_set, row.datum)
        numbers.setdefault(name, []).append(row)
    return {
        "short": not _full(rows),
        "conclusions": list(conclusions(tables)) if _full(rows) else stored_conclusions(),
        "fits": [
            {
                "row": row,
                "fits": _holds(row),
                "parameters": _texts(parameters[row.law, row.data]),
                "missed": _missed(row),
            }
            for row in rows
        ],
        "default": DEFAULT,
        "choices": calibration_file().choice,
        "laws": list(dict.fromkeys(row.law for row in shown)),
        "numbers": {name: {row.law: row for row in alike} for name, alike in numbers.items()},
        "far": MAX_DEVIATION,
        "least": MIN_PROBABILITY,
        "number": number,
    }


def figures(tables: Tables) -> dict[str, Picture]:
    """Measured against fitted numbers."""
    data = [row for row in rows_in(tables[DATA], DatumRow) if row.data == DEFAULT and row.data_set != NOT_FITTED]
    return {FITS: ("Measured and fitted numbers, with the errors of both", lambda: draw_data(data))}


CHAPTER = Chapter(
    FITS,
    "parameters fitted to the paper's experiments",
    {FITS: FitRow, PARAMETERS: Parameter, DATA: DatumRow},
    measure,
    lambda tables: list(sentences(tables)),
    section,
    figures,
    judge,
)
