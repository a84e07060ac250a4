"""Calibration on the paper's experiments: fits of each contact law, their uncertainty and the remaining deviations."""

from collections.abc import Iterator, Mapping, Sequence
from itertools import groupby
from math import isfinite, isnan, nan
from typing import Any

from drivers.base import paths
from drivers.base.tolerances import tolerance
from postproc.draw.style import GREY, pyplot
from postproc.paper.calibrated import calibrated
from validation.calibration.calibration_file import calibration_file
from validation.calibration.free import FACTOR, Free, known_range
from validation.calibration.laws import Point, Remark, fit_all
from validation.calibration.outcome import interval_text, value_text
from validation.calibration.rows import DatumRow, Parameter
from validation.chapters import Chapter, Options, Picture, Tables, rows_in
from validation.checks import FAIL, Check, judged, without_run

MAIN, DATA, PROFILES, REMARKS = "calibration", "calibration-data", "calibration-profiles", "calibration-remarks"
MIN_PROBABILITY = 0.05  # of chi-square; below it a law does not fit
MAX_DEVIATION = 2.0  # standard errors; data with larger deviations are listed
MARKERS = (("#555555", "v"), ("#999933", "s"), ("#0072b2", "o"), ("#56b4e9", "P"), ("#d55e00", "^"), ("#cc79a7", "D"))
STYLES = ("-", "--", ":")  # line styles of selections
FORCE, SPEED, DURATION = "bead_9_amplitude_N", "speed_9_to_5_m_s", "bead_5_duration_4pct_s"
DATUM_NAMES = {FORCE: "force", SPEED: "speed", DURATION: "duration", "wall_envelope_per_s": "envelope"}


def measure(options: Options) -> dict[str, Any]:
    """Rows of all fits."""
    return dict(zip((MAIN, DATA, PROFILES, REMARKS), fit_all(quick=options.quick), strict=True))


def _fits(tables: Tables) -> Iterator[tuple[list[Parameter], list[DatumRow]]]:
    """Rows of parameters and of data of each fit."""
    data = rows_in(tables[DATA], DatumRow)
    for (law, selection), rows in groupby(rows_in(tables[MAIN], Parameter), lambda row: (row.law, row.data)):
        yield list(rows), [row for row in data if (row.law, row.data) == (law, selection)]


def _parameter_text(row: Parameter) -> str:
    """A parameter with its error and, if it was profiled, its interval."""
    low, high = known_range(row.parameter, row.unit) or (row.value / FACTOR, row.value * FACTOR)
    free = Free(row.parameter, row.unit, row.value, low, high)
    text = f"{row.parameter.removeprefix('materials.')} {value_text(free, row.value, row.error)}"
    if isfinite(row.error) and not isnan(row.low_95pct):
        text += f" (95 %: {interval_text(free, (row.low_95pct, row.high_95pct), row.value, row.error)})"
    return text


def _shared(rows: Sequence[Parameter]) -> list[str]:
    """Parameters shared by all data, as text; parameters of single data sets are in the table only."""
    return [_parameter_text(row) for row in rows if ":" not in row.parameter and row.unit + row.parameter != "none"]


def _missed(data: Sequence[DatumRow]) -> list[str]:
    """Data that deviate from a fit by more than ``MAX_DEVIATION``, or are missing from the motion."""
    far = [row for row in data if row.counts and not abs(row.off) <= MAX_DEVIATION]
    return [f"{_name(row)} " + (f"{row.off:+.1f}" if isfinite(row.off) else "missing") for row in far]


def _name(row: DatumRow) -> str:
    return f"{row.data_set}: {DATUM_NAMES.get(row.datum, row.datum)}"


def _goodness(row: Parameter) -> str:
    """Goodness of a fit as text."""
    freedom = f"{row.freedom} degrees of freedom" if row.freedom >= 0 else "fewer data than parameters"
    text = f"chi-square {row.chi_square:.3g} with {freedom}"
    return text + (f", probability {row.probability:.2g}" if row.freedom > 0 else "")


def _verdict(row: Parameter) -> str:
    """Verdict on a fit by its probability."""
    if row.probability < MIN_PROBABILITY:
        return "no fit"
    return "fits" if row.freedom > 0 else "no test"


def sentences(tables: Tables) -> Iterator[str]:
    """A line for each fit: parameters, goodness, and the data with large deviations."""
    for rows, data in _fits(tables):
        parts = [*_shared(rows), _goodness(rows[0])]
        if missed := _missed(data):
            parts.append(f"deviations in standard errors: {', '.join(missed)}")
        yield f"{rows[0].law} on {rows[0].data}: {'; '.join(parts)}"


def judge(tables: Tables) -> Iterator[Check]:
    """Are the parameters of the figures' dissipative chains those of the fit?"""
    file, where = calibrated(), paths.shown(paths.CALIBRATED)
    rows = rows_in(tables[MAIN], Parameter)
    fitted = {row.parameter: row for row in rows if (row.law, row.data) == (file.law, file.data)}
    for each in file.parameter:
        row = fitted.get(each.key)
        if row is None:
            yield without_run(where, file.law, f"{each.key}: no fit to {file.data}", FAIL)
            continue
        drift = max(abs(row.value - each.value), abs(row.error - each.error)) / each.error
        found, stored = (f"{one.value:.5g} ± {one.error:.3g} {each.unit}".rstrip() for one in (row, each))
        place = f"{stored}; the fit gives {found}"
        yield judged(where, file.law, each.key, drift, tolerance("calibration", "stored"), place)


def section(tables: Tables) -> Mapping[str, Any]:
    """Fits as text, data of the last selection with all laws, and remarks on the fits."""
    summary = [
        {
            "law": rows[0].law,
            "data": rows[0].data,
            "parameters": _shared(rows),
            "goodness": _goodness(rows[0]),
            "missed": _missed(data),
            "verdict": _verdict(rows[0]),
        }
        for rows, data in _fits(tables)
    ]
    shown = _last(tables)
    laws = list(dict.fromkeys(row.law for row in shown))
    data = []
    for (_, name), own in groupby(
        sorted(shown, key=lambda row: _order(row, shown)), lambda row: (row.data_set, _name(row))
    ):
        rows = {row.law: row for row in own}
        one = next(iter(rows.values()))
        measured = "" if isnan(one.measured) else f"{one.measured:.4g}" + f" ± {one.error:.2g}" * (one.error > 0)
        cells = [(f"{rows[law].fitted:.4g}", rows[law].off) if law in rows else ("", nan) for law in laws]
        data.append({"name": name, "unit": one.unit, "measured": measured, "counts": one.counts, "cells": cells})
    remarks = [f"{row.law} on {row.data}: {row.sentence}" for row in rows_in(tables[REMARKS], Remark)]
    shown_remarks = [remark for remark in remarks if "chi-square" not in remark.partition(": ")[2][:10]]
    return {"summary": summary, "laws": laws, "data": data, "remarks": shown_remarks, "far": MAX_DEVIATION}


def _last(tables: Tables) -> list[DatumRow]:
    """Rows of data of the last selection, for all laws."""
    return [row for row in rows_in(tables[DATA], DatumRow) if row.data == calibration_file().selections[-1]]


def _order(row: DatumRow, rows: Sequence[DatumRow]) -> int:
    """Index of a datum in the table."""
    return next(place for place, each in enumerate(rows) if (each.data_set, each.datum) == (row.data_set, row.datum))


def figures(tables: Tables) -> dict[str, Picture]:
    """Data with the best fits of each law, and profiles."""
    found = {MAIN: Picture("Measured data, elastic theory and the best fit of each law", lambda: draw_data(tables))}
    if len(tables[PROFILES]):
        caption = "Profiles of the parameters: rise of chi-square"
        found[PROFILES] = Picture(caption, lambda: draw_profiles(tables))
    return found


def _markers() -> dict[str, tuple[str, str]]:
    """Colour and marker by law."""
    return dict(zip([law.name for law in calibration_file().law], MARKERS, strict=False))


def draw_data(tables: Tables) -> Any:
    """Speed and duration against force, and the deviation of each datum, with all data fitted together."""
    shown, markers = _last(tables), _markers()
    figure = pyplot().figure(figsize=(6.8, 6.6), layout="constrained")
    upper, lower = figure.subfigures(2, 1, height_ratios=(1, 1.2))
    above, below = upper.subplots(1, 2), lower.subplots(1, 2)
    for axis, datum, scale, label in zip(
        above, (SPEED, DURATION), (1.0, 1e6), ("speed (m/s)", "duration at 4 % (µs)"), strict=True
    ):
        for law, (colour, marker) in markers.items():
            forces = {row.data_set: row for row in shown if row.law == law and row.datum == FORCE}
            pairs = [(forces[row.data_set], row) for row in shown if row.law == law and row.datum == datum]
            pairs.sort(key=lambda pair: pair[0].fitted)
            if pairs:
                x, y = [force.fitted for force, _ in pairs], [row.fitted * scale for _, row in pairs]
                axis.plot(x, y, color=colour, marker=marker, ms=3.5, lw=0.9, label=law)
                measured = pairs
        x, y = ([row.measured for row in rows] for rows in zip(*measured, strict=True))
        errors = ([row.error for row in rows] for rows in zip(*measured, strict=True))
        look = {"xerr": next(errors), "yerr": [each * scale for each in next(errors)], "fmt": "k.", "lw": 0.7, "ms": 7}
        axis.errorbar(x, [each * scale for each in y], **look, label="measured")
        axis.set(xscale="log", xlabel="force at bead 9 (N)", ylabel=label)
    upper.legend(*above[0].get_legend_handles_labels(), loc="outside upper center", ncols=4, fontsize=6)
    for axis, counts in zip(below, (True, False), strict=True):
        own = [row for row in shown if row.counts == counts and not isnan(row.measured)]
        names = list(dict.fromkeys(_name(row) for row in own))
        for law, (colour, marker) in markers.items():
            rows = [row for row in own if row.law == law]
            off = [row.off if counts else row.fitted / row.measured for row in rows]
            axis.plot(off, [names.index(_name(row)) for row in rows], marker, color=colour, ms=4, mfc="none")
        axis.set(yticks=range(len(names)), yticklabels=names, ylim=(len(names) - 0.5, -0.5))
        axis.axvline(0.0 if counts else 1.0, color=GREY, lw=0.7)
        axis.set_xlabel("fitted minus measured, in standard errors" if counts else "computed over quoted, not fitted")
    return figure


def draw_profiles(tables: Tables) -> Any:
    """Rise of chi-square: a panel for each parameter, a curve for each law and selection."""
    points, markers = rows_in(tables[PROFILES], Point), _markers()
    names, selections = (
        list(dict.fromkeys(values)) for values in zip(*((p.parameter, p.data) for p in points), strict=True)
    )
    rows = -(-len(names) // 2)
    figure, axes = pyplot().subplots(rows, 2, figsize=(6.8, 1.4 + 2.2 * rows), squeeze=False, layout="constrained")
    lines = {}
    for axis, name in zip(axes.flat, names, strict=False):
        scale, label = (1e-9, "Young's modulus (GPa)") if "modulus" in name else (1.0, name.removeprefix("contact."))
        own = [point for point in points if point.parameter == name]
        for (law, data), curve in groupby(own, lambda point: (point.law, point.data)):
            x, y = zip(*((point.value * scale, point.rise) for point in curve), strict=True)
            style = STYLES[selections.index(data) % len(STYLES)]
            (lines[f"{law} on {data}"],) = axis.plot(x, y, color=markers[law][0], ls=style, lw=1.1)
        for rise in (1.0, 3.84):
            axis.axhline(rise, color=GREY, lw=0.5)
        axis.set(ylim=(0, 6), xlabel=label)
    for axis in axes.flat[len(names) :]:
        axis.remove()
    figure.supylabel("rise of chi-square (68 % at 1, 95 % at 3.84)", fontsize=8)
    figure.legend(lines.values(), lines.keys(), loc="outside lower center", ncols=2, fontsize=6)
    return figure


CHAPTER = Chapter(
    MAIN,
    "parameters fitted to the paper's experiments",
    {MAIN: Parameter, DATA: DatumRow, PROFILES: Point, REMARKS: Remark},
    measure,
    lambda tables: list(sentences(tables)),
    section,
    figures,
    judge,
)
