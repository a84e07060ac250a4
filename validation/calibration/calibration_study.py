"""Calibration on the paper's experiments: which laws fit which of its data, how surely, and what remains."""

from collections.abc import Iterator, Mapping, Sequence
from itertools import groupby
from math import isfinite, isnan, nan
from typing import Any

from drivers.base import paths
from postproc.draw.style import FAINT, pyplot
from postproc.paper.calibrated import calibrated
from validation.calibration.free import FACTOR, Free, known_range
from validation.calibration.laws import Point, Remark, fit_all, plan
from validation.calibration.outcome import interval_in_words, value_in_words
from validation.calibration.rows import DatumRow, Parameter
from validation.studies import Options, Picture, Study, Tables, rows_in

MAIN, DATA, PROFILES, REMARKS = "calibration", "calibration-data", "calibration-profiles", "calibration-remarks"
UNLIKELY = 0.05  # probability of chi-square from which down a law does not fit
FAR = 2.0  # standard errors from which on a datum is named
ADRIFT = 0.1  # standard errors by which a fit may depart from inputs/paper/calibrated.toml
LOOKS = (("#555555", "v"), ("#999933", "s"), ("#0072b2", "o"), ("#56b4e9", "P"), ("#d55e00", "^"), ("#cc79a7", "D"))
STYLES = ("-", "--", ":")  # of selections
FORCE, SPEED, DURATION = "bead_9_amplitude_N", "speed_9_to_5_m_s", "bead_5_duration_4pct_s"
WORDS = {FORCE: "force", SPEED: "speed", DURATION: "duration", "wall_envelope_per_s": "envelope"}


def measure(options: Options) -> dict[str, Any]:
    """Rows of all fits."""
    return dict(zip((MAIN, DATA, PROFILES, REMARKS), fit_all(quick=options.quick), strict=True))


def _fits(tables: Tables) -> Iterator[tuple[list[Parameter], list[DatumRow]]]:
    """Parameters and data of each fit."""
    data = rows_in(tables[DATA], DatumRow)
    for (law, selection), rows in groupby(rows_in(tables[MAIN], Parameter), lambda row: (row.law, row.data)):
        yield list(rows), [row for row in data if (row.law, row.data) == (law, selection)]


def _in_words(row: Parameter) -> str:
    """A parameter with its error, and with its interval where it was profiled."""
    low, high = known_range(row.parameter, row.unit) or (row.value / FACTOR, row.value * FACTOR)
    free = Free(row.parameter, row.unit, row.value, low, high)
    text = f"{row.parameter.removeprefix('materials.')} {value_in_words(free, row.value, row.error)}"
    if isfinite(row.error) and not isnan(row.low_95pct):
        text += f" (95 %: {interval_in_words(free, (row.low_95pct, row.high_95pct), row.value, row.error)})"
    return text


def _shared(rows: Sequence[Parameter]) -> list[str]:
    """Parameters that all data share, in words; strikes of single data sets are left to the table."""
    return [_in_words(row) for row in rows if ":" not in row.parameter and row.unit + row.parameter != "none"]


def _missed(data: Sequence[DatumRow]) -> list[str]:
    """Data that a fit misses by far, or does not show."""
    far = [row for row in data if row.counts and not abs(row.off) <= FAR]
    return [f"{_name(row)} " + (f"by {row.off:+.1f}" if isfinite(row.off) else "is not seen") for row in far]


def _name(row: DatumRow) -> str:
    return f"{row.data_set}: {WORDS.get(row.datum, row.datum)}"


def _fit_in_words(row: Parameter) -> str:
    """Goodness of a fit."""
    freedom = f"{row.freedom} degrees of freedom" if row.freedom >= 0 else "fewer data than parameters"
    text = f"chi-square {row.chi_square:.3g} with {freedom}"
    return text + (f", probability {row.probability:.2g}" if row.freedom > 0 else "")


def sentences(tables: Tables) -> Iterator[str]:
    """A line for each fit: parameters, goodness, and the data that it misses."""
    for rows, data in _fits(tables):
        parts = [*_shared(rows), _fit_in_words(rows[0])]
        if missed := _missed(data):
            parts.append(f"missed, in standard errors: {', '.join(missed)}")
        yield f"{rows[0].law} on {rows[0].data}: {'; '.join(parts)}"


def missed(tables: Tables) -> list[str]:
    """Parameters of the figures' chains with dissipation that the fit does not give, a line each."""
    file, where = calibrated(), paths.shown(paths.CALIBRATED)
    rows = rows_in(tables[MAIN], Parameter)
    fitted = {row.parameter: row for row in rows if (row.law, row.data) == (file.law, file.data)}
    lines = []
    for each in file.parameter:
        row = fitted.get(each.key)
        if row is None:
            lines.append(f"{where}: {each.key}: no fit of the law {file.law} to {file.data}")
        elif not max(abs(row.value - each.value), abs(row.error - each.error)) <= ADRIFT * each.error:
            found, kept = (f"{one.value:.5g} ± {one.error:.3g} {each.unit}".rstrip() for one in (row, each))
            lines.append(f"{where}: {each.key}: {kept}; the fit gives {found}")
    return lines


def section(tables: Tables) -> Mapping[str, Any]:
    """Fits in words, the data of the last selection by every law, and what the fits say of themselves."""
    summary = [
        {
            "law": rows[0].law,
            "data": rows[0].data,
            "parameters": _shared(rows),
            "goodness": _fit_in_words(rows[0]),
            "missed": _missed(data),
            "verdict": "no fit" if rows[0].probability < UNLIKELY else "fits" if rows[0].freedom > 0 else "no test",
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
    told = [remark for remark in remarks if "chi-square" not in remark.partition(": ")[2][:10]]
    return {"summary": summary, "laws": laws, "data": data, "remarks": told, "far": FAR}


def _last(tables: Tables) -> list[DatumRow]:
    """Data of the last selection, by all laws."""
    return [row for row in rows_in(tables[DATA], DatumRow) if row.data == plan().selections[-1]]


def _order(row: DatumRow, rows: Sequence[DatumRow]) -> int:
    """Place of a datum among all."""
    return next(place for place, each in enumerate(rows) if (each.data_set, each.datum) == (row.data_set, row.datum))


def figures(tables: Tables) -> dict[str, Picture]:
    """Data with the best fits of each law, and profiles."""
    found = {MAIN: Picture("Measured data, elastic theory and the best fits of each law", lambda: draw_data(tables))}
    if len(tables[PROFILES]):
        words = "Profiles of the parameters: what the data leave open"
        found[PROFILES] = Picture(words, lambda: draw_profiles(tables))
    return found


def _looks() -> dict[str, tuple[str, str]]:
    """Colour and marker by law."""
    return dict(zip([law.name for law in plan().law], LOOKS, strict=False))


def draw_data(tables: Tables) -> Any:
    """Speed and duration against force, and by how much each datum is missed, all data fitted together."""
    shown, looks = _last(tables), _looks()
    figure = pyplot().figure(figsize=(6.8, 6.6), layout="constrained")
    upper, lower = figure.subfigures(2, 1, height_ratios=(1, 1.2))
    above, below = upper.subplots(1, 2), lower.subplots(1, 2)
    for axis, datum, scale, label in zip(
        above, (SPEED, DURATION), (1.0, 1e6), ("speed (m/s)", "duration at 4 % (µs)"), strict=True
    ):
        for law, (colour, marker) in looks.items():
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
        for law, (colour, marker) in looks.items():
            rows = [row for row in own if row.law == law]
            off = [row.off if counts else row.fitted / row.measured for row in rows]
            axis.plot(off, [names.index(_name(row)) for row in rows], marker, color=colour, ms=4, mfc="none")
        axis.set(yticks=range(len(names)), yticklabels=names, ylim=(len(names) - 0.5, -0.5))
        axis.axvline(0.0 if counts else 1.0, color=FAINT, lw=0.7)
        axis.set_xlabel("fitted less measured, in standard errors" if counts else "computed over quoted, not fitted")
    return figure


def draw_profiles(tables: Tables) -> Any:
    """Rise of chi-square against each parameter, a panel each, a curve for each law and selection."""
    points, looks = rows_in(tables[PROFILES], Point), _looks()
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
            (lines[f"{law} on {data}"],) = axis.plot(x, y, color=looks[law][0], ls=style, lw=1.1)
        for rise in (1.0, 3.84):
            axis.axhline(rise, color=FAINT, lw=0.5)
        axis.set(ylim=(0, 6), xlabel=label)
    for axis in axes.flat[len(names) :]:
        axis.remove()
    figure.supylabel("rise of chi-square (68 % at 1, 95 % at 3.84)", fontsize=8)
    figure.legend(lines.values(), lines.keys(), loc="outside lower center", ncols=2, fontsize=6)
    return figure


STUDY = Study(
    MAIN,
    "parameters that the paper's experiments ask for",
    {MAIN: Parameter, DATA: DatumRow, PROFILES: Point, REMARKS: Remark},
    measure,
    lambda tables: list(sentences(tables)),
    section,
    figures,
    missed,
)
