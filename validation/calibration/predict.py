"""Observables that a fit predicts, with errors, and those that two laws predict differently."""

import re
from collections.abc import Iterator, Sequence
from copy import deepcopy
from dataclasses import replace
from functools import partial
from math import hypot, isfinite, nan

from drivers.base.errors import InputError
from drivers.chain.chain import Array
from postproc.read.observables import describe, without_unit
from validation.calibration.data_sets import DataSet
from validation.calibration.free import did_you_mean
from validation.calibration.outcome import DatumRow, Outcome
from validation.calibration.problem import Problem, motion_values, simulated

MIN_SHARE = 0.01  # relative difference of two predictions that is worth an experiment
MOST_LISTED = 4


def predict(outcome: Outcome, names: Sequence[str]) -> list[DatumRow]:
    """Observables of each data set in the fitted motion; a gauge is added at a bead without a sensor.

    Args:
        outcome: The fit.
        names: Observables, with or without their units, in addition to all observables of waves.

    Raises:
        InputError: No scene shows an observable.
    """
    found, problem, known = list[DatumRow](), outcome.fit.problem, dict[str, str]()
    for data in problem.sets:
        shown = _with_gauges(data, names)
        simulation = simulated(shown, motion_values(problem, data, outcome.fit.place))
        own = {without_unit(name): name for name in simulation.values} if simulation else {}
        every = [name for name in own if describe(name).of_wave]
        for name in dict.fromkeys(own[without_unit(each)] for each in (*names, *every) if without_unit(each) in own):
            value, error = outcome.fit.number(partial(_observable, problem, data, shown, name))
            row = outcome.row
            found.append(DatumRow(row.law, row.data, data.name, name, describe(name).unit, nan, nan, value, error, nan))
        known |= own
    for name in names:
        if without_unit(name) not in known:
            hint = did_you_mean(without_unit(name), known) or f"allowed: {', '.join(known)}"
            raise InputError(problem.sets[0].where, f"--predict {name}", f"unknown observable; {hint}")
    return found


def _with_gauges(data: DataSet, names: Sequence[str]) -> DataSet:
    """Data set with a sensor at each named bead that has none; a sensor without a mass changes nothing."""
    tables = deepcopy(data.tables)
    sensors = tables["chain"].setdefault("sensors", [])
    asked = {int(found[1]) for name in names if (found := re.match(r"bead_(\d+)_", name))}
    new = asked - {sensor["from_wall"] for sensor in sensors}
    sensors.extend({"from_wall": bead} for bead in new)
    sensors.sort(key=lambda sensor: -sensor["from_wall"])
    return replace(data, tables=tables) if new else data


def _observable(problem: Problem, data: DataSet, shown: DataSet, name: str, place: Array) -> float:
    """An observable at given coordinates."""
    simulation = simulated(shown, motion_values(problem, data, place))
    return simulation.values[name] if simulation else nan


def differences(rows: Sequence[DatumRow], laws: Sequence[str]) -> Iterator[str]:
    """Sentences on the observables that the first law and another predict most differently, in their errors."""
    first, *others = laws
    for other in others:
        two = {row.label: row for row in rows if row.law == other}
        pairs = [(row, two[row.label]) for row in rows if row.law == first and row.label in two]
        found = [
            (abs(b.fitted - a.fitted) / max(hypot(a.fitted_error, b.fitted_error), 1e-300), a, b)
            for a, b in pairs
            if isfinite(a.fitted + b.fitted) and abs(b.fitted - a.fitted) > MIN_SHARE * abs(a.fitted)
        ]
        for errors, a, b in sorted(found, key=lambda each: -each[0])[:MOST_LISTED]:
            pair = f"{a.fitted:.4g} against {b.fitted:.4g} {a.unit}".rstrip()
            yield f"{first} and {other} differ in {a.label}: {pair}, {errors:.1f} standard errors"
