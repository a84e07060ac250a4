"""Calibration on the paper's experiments: what survives all readings of what the paper leaves open, and what does not."""

from collections.abc import Iterator, Mapping, Sequence
from math import isfinite, isnan
from typing import Any

from drivers.base import paths
from drivers.base.tolerances import tolerance
from postproc.paper.calibrated import calibrated
from postproc.draw.overlay import number
from validation.calibration.calibration_file import calibration_file
from validation.calibration.draw_study import draw_contours, draw_data, name_of
from validation.calibration.rows import DatumRow, Parameter
from validation.calibration.study import MAX_DEVIATION, ContourRow, FitRow, NotFitted, Remark, reading_of, study
from validation.chapters import Chapter, Options, Picture, Tables, rows_in
from validation.checks import FAIL, Check, judged, without_run

MAIN, PARAMETERS, DATA = "calibration", "calibration-parameters", "calibration-data"
CONTOURS, NOT_FITTED, REMARKS = "calibration-contours", "calibration-not-fitted", "calibration-remarks"
MIN_PROBABILITY = 0.05  # of chi-square; below it a law does not fit


def measure(options: Options) -> dict[str, Any]:
    """Rows of all fits."""
    found = study(quick=options.quick)
    tables = (found.fits, found.parameters, found.data, found.contours, found.not_fitted, found.remarks)
    return dict(zip(CHAPTER.tables, tables, strict=True))


def _holds(row: FitRow) -> bool:
    return row.probability >= MIN_PROBABILITY


def _modulus(row: FitRow) -> str:
    error = f" ± {row.modulus_error_Pa * 1e-9:.2f}" if isfinite(row.modulus_error_Pa) else ""
    return f"{row.modulus_Pa * 1e-9:.2f}{error} GPa"


def _dissipation(row: FitRow) -> str:
    """Parameter of the dissipation with its error; empty for an elastic chain."""
    if isnan(row.dissipation):
        return ""
    (text,) = (law.free[0] for law in calibration_file().law if law.name == row.law)
    error = f" ± {row.dissipation_error:.2g}" if isfinite(row.dissipation_error) else ""
    return f"{text.rpartition('.')[2]} {row.dissipation:.3g}{error}"


def _others(row: FitRow) -> str:
    """Parameters of the readings and of the electronics."""
    named = (
        ("RC", row.time_constant_s * 1e3, " ms"), ("cut", row.cut * 100, " %"),
        ("true force divided by read", row.force_scale, ""), ("true speed divided by read", row.speed_scale, ""),
    )  # fmt: skip
    return ", ".join(f"{name} {value:.2g}{unit}" for name, value, unit in named if not isnan(value))


def sentences(tables: Tables) -> Iterator[str]:
    """Conclusions over all readings, then a line for each law in the default reading."""
    rows, data = rows_in(tables[MAIN], FitRow), rows_in(tables[DATA], DatumRow)
    yield from conclusions(rows, data)
    default = reading_of(calibration_file().readings()[0])
    for row in (row for row in rows if row.reading == default):
        parts = [_modulus(row), _dissipation(row), _others(row), _goodness(row)]
        missed = f"missed: {row.missed}" if row.missed else "no datum is missed"
        yield f"{row.law}: {', '.join(part for part in parts if part)}; {missed}"


def conclusions(rows: Sequence[FitRow], data: Sequence[DatumRow]) -> Iterator[str]:
    """Laws that fit in some reading, the range of their moduli, and the numbers that no fit gives."""
    readings = list(dict.fromkeys(row.reading for row in rows))
    fitting = [row for row in rows if _holds(row)]
    if not fitting:
        yield f"no law fits in any of {len(readings)} readings"
        return
    counts = [
        f"{law} in {sum(row.law == law for row in fitting)}" for law in dict.fromkeys(row.law for row in rows)
    ]
    yield f"of {len(readings)} readings of the paper, laws fit (probability above {MIN_PROBABILITY:g}): {', '.join(counts)}"
    low, high = min(row.modulus_low_Pa for row in fitting), max(row.modulus_high_Pa for row in fitting)
    yield f"modulus of the fits that hold, with their errors: {low * 1e-9:.2f} to {high * 1e-9:.2f} GPa"
    for law in dict.fromkeys(row.law for row in fitting):
        own = [row for row in fitting if row.law == law]
        without = [row.reading for row in own if isnan(row.time_constant_s)]
        if not without:
            yield f"{law} fits only with the electronics of the gauges"
    held = {(row.law, row.reading) for row in fitting}
    off = {}
    for row in data:
        if (row.law, row.data) in held and not isnan(row.measured):
            off.setdefault((row.data_set, row.datum), []).append(abs(row.off))
    worst = [f"{name_of(*key)} ({min(values):.1f} to {max(values):.1f})" for key, values in off.items() if min(values) > 1]
    yield f"missed by more than one standard error in every fit that holds: {', '.join(worst) or 'none'}"


def _goodness(row: FitRow) -> str:
    return f"chi-square {row.chi_square:.3g} with {row.freedom} degrees of freedom, probability {row.probability:.2g}"


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
    """Conclusions, a row for each law and reading, data of the default reading, what is not fitted, and remarks."""
    rows, data = rows_in(tables[MAIN], FitRow), rows_in(tables[DATA], DatumRow)
    default = reading_of(calibration_file().readings()[0])
    fits = [
        {
            "law": row.law,
            "reading": row.reading,
            "modulus": _modulus(row),
            "dissipation": _dissipation(row),
            "others": _others(row),
            "goodness": f"{row.chi_square:.1f} of {row.freedom}",
            "probability": f"{row.probability:.2g}",
            "fits": _holds(row),
            "missed": row.missed,
        }
        for row in rows
    ]
    shown = [row for row in data if row.data == default]
    laws = list(dict.fromkeys(row.law for row in shown))
    cells: dict[str, dict[str, Any]] = {}
    for row in shown:
        if not isnan(row.measured):
            line = cells.setdefault(name_of(row.data_set, row.datum), {"measured": row, "cells": {}})
            line["cells"][row.law] = row
    table = [
        {
            "name": name,
            "unit": line["measured"].unit,
            "measured": f"{line['measured'].measured:.4g} ± {line['measured'].error:.2g}",
            "cells": [
                (number(line["cells"][law].fitted, 4), line["cells"][law].off, number(line["cells"][law].chi_square_without, 3))
                for law in laws
            ],
        }
        for name, line in cells.items()
    ]
    quantities: dict[str, dict[str, Any]] = {}
    for row in (row for row in rows_in(tables[NOT_FITTED], NotFitted) if row.reading == default):
        line = quantities.setdefault(row.quantity, {"unit": row.unit, "measured": number(row.measured, 4), "cells": {}})
        line["cells"][row.law] = number(row.computed, 4)
    remarks = [f"{row.law}: {row.sentence}" for row in rows_in(tables[REMARKS], Remark) if row.reading == default]
    return {
        "conclusions": list(conclusions(rows, data)),
        "default": [fit for fit in fits if fit["reading"] == default],
        "readings": [fit for fit in fits if fit["reading"] != default],
        "choices": [
            {"name": choice.name, "answers": [(each.name, each.because) for each in choice.answer]}
            for choice in calibration_file().choice
        ],
        "laws": laws,
        "data": table,
        "not_fitted": quantities,
        "remarks": remarks,
        "far": MAX_DEVIATION,
    }


def figures(tables: Tables) -> dict[str, Picture]:
    """Measured against computed data, and contours of chi-square."""
    rows, data = rows_in(tables[MAIN], FitRow), rows_in(tables[DATA], DatumRow)
    found = {MAIN: Picture("Measured and fitted numbers, with the errors of both", lambda: draw_data(data))}
    if len(tables[CONTOURS]):
        caption = "Chi-square of the viscoelastic law over modulus and restitution; 1 is elastic"
        contours = rows_in(tables[CONTOURS], ContourRow)
        found[CONTOURS] = Picture(caption, lambda: draw_contours(contours, rows))
    return found


CHAPTER = Chapter(
    MAIN,
    "parameters fitted to the paper's experiments",
    {
        MAIN: FitRow, PARAMETERS: Parameter, DATA: DatumRow, CONTOURS: ContourRow, NOT_FITTED: NotFitted,
        REMARKS: Remark,
    },
    measure,
    lambda tables: list(sentences(tables)),
    section,
    figures,
    judge,
)  # fmt: skip
