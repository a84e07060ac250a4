"""Several laws fitted to identical data: comparison, and observables that they predict."""

import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from copy import deepcopy
from dataclasses import dataclass, replace
from math import hypot, isfinite, nan

from drivers.base.errors import InputError
from postproc.read.observables import describe, without_unit
from validation.calibration.calibration_file import Law
from validation.calibration.certainty import with_error
from validation.calibration.data_sets import DataSet
from validation.calibration.free import did_you_mean
from validation.calibration.outcome import Outcome, solve
from validation.calibration.problem import Problem, motion_values, simulated
from validation.calibration.rows import ModelRow, PredictionRow

DECISIVE = 6.0  # excess of Akaike's criterion: a ratio of likelihoods of 20
MIN_SHARE = 0.01  # relative difference of two predictions that is worth an experiment
MOST_LISTED = 4


@dataclass(frozen=True)
class Model:
    """A law as fitted: its problem, and its name; empty for the law of the scene."""

    law: str
    problem: Problem


def solve_all(
    models: Sequence[Model], *, quick: bool = False, count: Callable[[], None] = lambda: None
) -> dict[str, Outcome]:
    """Outcomes by law; each fit also starts from the earlier ones, so that a larger model is never worse."""
    found = dict[str, Outcome]()
    for model in models:
        seeds = [each.fit.values for each in found.values()]
        found[model.law] = solve(model.problem, quick=quick, seeds=seeds, count=count)
    return found


def settings_of(law: Law, settings: Sequence[str]) -> tuple[str, ...]:
    """Settings of a law; those of the command come last, so that ``contact.alpha=1.5`` stays."""
    return (*law.set, *settings)


def verdict(rows: Sequence[ModelRow], explained: Mapping[str, bool]) -> Iterator[str]:
    """Sentences on the laws that fit, and on the best of them.

    Where no law explains the data, differences of chi-square are divided by that of the best law per degree of freedom.
    """
    best = min(rows, key=lambda row: row.aic)
    scatter = max(1.0, best.chi_square / best.freedom) if best.freedom > 0 and not explained[best.law] else 1.0
    for law in (row.law for row in rows if not explained[row.law]):
        yield f"{law} does not explain the data"
    near = [row.law for row in rows if row.aic_excess / scatter < DECISIVE]
    if len(near) > 1:
        yield f"undecided: the data do not tell {' from '.join(near)} (AIC within {DECISIVE:g})"
    elif len(rows) > 1:
        second = min((row for row in rows if row is not best), key=lambda row: row.aic)
        excess = second.aic_excess / scatter
        yield f"{best.law} is the best law: the AIC of the next, {second.law}, is {excess:.3g} higher"


def predict(law: str, outcome: Outcome, names: Sequence[str]) -> list[PredictionRow]:
    """Observables of each scene in the fitted motion; a gauge of a bead without a sensor is added.

    Args:
        law: Name of the law.
        outcome: The fit.
        names: Observables, with or without their units; none for all observables of waves.

    Raises:
        InputError: No scene shows an observable.
    """
    rows, problem = list[PredictionRow](), outcome.fit.problem
    scenes = {data.source: data for data in problem.sets if not any(free.own == data.name for free in problem.free
              if free.of_motion)} or {problem.sets[0].source: problem.sets[0]}
    for data in scenes.values():
        shown = _with_gauges(data, names)
        simulation = simulated(shown, motion_values(problem, data, outcome.fit.place))
        known = {without_unit(name): name for name in simulation.values} if simulation else {}
        every = [name for name in known.values() if describe(name).of_wave]
        for name in [known[without_unit(each)] for each in names if without_unit(each) in known] if names else every:
            value, error = with_error(outcome.fit, outcome.certainty, _observable(problem, data, shown, name))
            rows.append(PredictionRow(law, data.name, name, describe(name).unit, value, error))
    for name in names:
        if without_unit(name) not in {without_unit(row.observable) for row in rows}:
            hint = did_you_mean(without_unit(name), known) or f"allowed: {', '.join(known)}"
            raise InputError(problem.sets[0].where, f"--predict {name}", f"an unknown observable; {hint}")
    return rows


def _with_gauges(data: DataSet, names: Sequence[str]) -> DataSet:
    """Data set with a sensor at each named bead that has none; a sensor without a mass changes nothing."""
    tables = deepcopy(data.tables)
    sensors = tables["chain"].setdefault("sensors", [])
    asked = {int(found[1]) for name in names if (found := re.match(r"bead_(\d+)_", name))}
    new = sorted(asked - {sensor.get("from_wall") for sensor in sensors}, reverse=True)
    sensors += [{"from_wall": bead} for bead in new]
    sensors.sort(key=lambda sensor: -sensor["from_wall"])
    return replace(data, tables=tables) if new else data


def _observable(problem: Problem, data: DataSet, shown: DataSet, name: str) -> Callable[..., float]:
    """An observable of the shown data set as a function of the coordinates."""

    def at(place: object) -> float:
        simulation = simulated(shown, motion_values(problem, data, place))  # type: ignore[arg-type]
        return simulation.values[name] if simulation else nan

    return at


def differences(rows: Sequence[PredictionRow], laws: Sequence[str]) -> Iterator[str]:
    """Sentences on the observables that two laws predict most differently, in their errors."""
    by_law = {law: {(row.scene, row.observable): row for row in rows if row.law == law} for law in laws}
    first, *others = laws
    for other in others:
        found = []
        for key, one in by_law[first].items():
            two = by_law[other].get(key)
            if two and isfinite(one.value + two.value) and one.value:
                change = two.value - one.value
                if abs(change) > MIN_SHARE * abs(one.value):
                    found.append((abs(change) / (hypot(one.error, two.error) or 1e-300), one, two))
        for sigma, one, two in sorted(found, key=lambda each: -each[0])[:MOST_LISTED]:
            pair = f"{one.value:.4g} against {two.value:.4g} {one.unit}".rstrip()
            yield f"{first} and {other} differ in {one.scene}: {one.observable}: {pair}, {sigma:.1f} standard errors"
