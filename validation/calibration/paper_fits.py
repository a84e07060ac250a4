"""The fits of ``make calibration``: each law on the paper's numbers, for all readings of what the paper leaves open."""

import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from math import nan
from typing import Any

from drivers.base.terminal import following
from drivers.run.execute import Place, execute
from drivers.scene.read_scene import apply_setting
from postproc.paper.quoted import quoted
from postproc.paper.simulate import Simulation
from postproc.read.observables import LATER_PROMINENCE
from postproc.read.sensors import sensor_signals
from postproc.read.signals import incident_pulse, peaks, train_envelope
from validation.calibration.calibration_file import Answer, Law, calibration_file
from validation.calibration.data_sets import paper_data
from validation.calibration.outcome import DatumRow, Outcome, solve
from validation.calibration.problem import motion_values, pose, simulated

MODULUS = "materials.ptfe.youngs_modulus"
MAXIMA = (2, 3, 4)  # numbers of maxima for an envelope
TOP = "chain.sensors=[{ from_wall = 11 }, { from_wall = 10 }]"  # Fig. 5, sensors where the pulse enters
FITS, PARAMETERS, DATA = "calibration", "calibration-parameters", "calibration-data"
TABLES = (FITS, PARAMETERS, DATA)
NOT_FITTED = "not fitted"  # data set of quantities of the same experiments that are not fitted

Rows = dict[str, list[Any]]  # of each table, by its name


def reading_of(answers: Sequence[Answer]) -> str:
    """Name of a reading: the answers that are not the default; "default" for the first reading."""
    default = calibration_file().readings()[0]
    other = [
        f"{choice.name}: {answer.name}"
        for choice, answer, usual in zip(calibration_file().choice, answers, default, strict=True)
        if answer.name != usual.name
    ]
    return "; ".join(other) or "default"


def study(*, quick: bool = False) -> dict[str, list[Any]]:
    """Rows of all tables: each law for the default reading, then from there for all others.

    The short study starts at the parameters found before.
    """
    asked = calibration_file()
    readings, laws = asked.readings(quick=quick), asked.law
    if quick:
        known = {law.name: law.found for law in laws}
        done = _in_parallel(partial(_fit_laws, laws, known), readings)
    else:
        found = [fit_law(law, readings[0]) for law in following(laws, "laws", len(laws), "law")]
        first = [_rows(law, reading_of(readings[0]), each) for law, each in zip(laws, found, strict=True)]
        known = {law.name: each.fit.values for law, each in zip(laws, found, strict=True)}
        done = [*first, *_in_parallel(partial(_fit_laws, laws, known), readings[1:])]
    return {name: [row for rows in done for row in rows[name]] for name in TABLES}


def _in_parallel(work: Callable[[Any], Rows], items: Sequence[Any]) -> list[Rows]:
    """Results of all readings, in their order."""
    under_way = following(execute(work, items, Place(processes=True)), "readings", len(items), "reading")
    results = {id(item): result for item, result in under_way}
    return [results[id(item)] for item in items]


def _fit_laws(laws: Sequence[Law], known: Mapping[str, Mapping[str, float]], answers: Sequence[Answer]) -> Rows:
    """Rows of all laws for one reading, from known parameters and from each other: a larger law is never worse."""
    tables, earlier = dict[str, list[Any]](), list[Mapping[str, float]]()
    for law in laws:
        outcome = fit_law(law, answers, [known[law.name], *earlier], thorough=False)
        earlier.append(outcome.fit.values)
        for name, rows in _rows(law, reading_of(answers), outcome).items():
            tables.setdefault(name, []).extend(rows)
    return tables


def fit_law(
    law: Law, answers: Sequence[Answer], seeds: Sequence[Mapping[str, float]] = (), *, thorough: bool = True
) -> Outcome:
    """Fit of a law to all quoted data, for one reading."""
    asked = calibration_file()
    free = (*asked.free, *law.free, *(text for answer in answers for text in answer.free))
    problem = pose(paper_data(asked.data, law.set, answers), free, answers=answers)
    return solve(problem, law.name, reading_of(answers), quick=not thorough, seeds=seeds, search=thorough)


def _rows(law: Law, reading: str, outcome: Outcome) -> Rows:
    """Rows of a fit by table."""
    return {
        FITS: [outcome.row],
        PARAMETERS: outcome.parameters,
        DATA: [*outcome.data, *_not_fitted(law, reading, outcome)],
    }


def _not_fitted(law: Law, reading: str, outcome: Outcome) -> Iterator[DatumRow]:
    """Quantities of the same experiments that are not fitted."""
    problem, place = outcome.fit.problem, outcome.fit.place
    for name, more, numbers in (("fig5", (TOP,), _fig5), ("fig4", (), _fig4)):
        (data,) = (each for each in problem.sets if each.name == name)
        tables = json.loads(data.tables)
        for setting in more:
            apply_setting(tables, setting)
        shown = replace(data, tables=json.dumps(tables))
        simulation = simulated(shown, motion_values(problem, data, place), whole=True)
        if simulation is not None:
            for quantity, unit, measured, computed in numbers(simulation):
                yield DatumRow(law.name, reading, NOT_FITTED, quantity, unit, measured, nan, computed, nan, nan)


Number = tuple[str, str, float, float]  # name, unit, measured, computed


def _fig5(simulation: Simulation) -> Iterator[Number]:
    """Fig. 5: envelope at the wall through 2, 3 and 4 maxima of the train, and the incident pulse at two beads."""
    time, signals = simulation.trace.time_s, sensor_signals(simulation.case.layout, simulation.trace)
    wall, paper = signals["wall"], quoted()
    maxima = peaks(time, wall - wall[0], LATER_PROMINENCE)
    leading = [replace(peak, value=peak.value + float(wall[0])) for peak in maxima]
    for count in MAXIMA:
        curve = train_envelope(leading, count)
        rate = curve.rate_per_s if curve else nan
        yield f"Fig. 5: envelope through {count} maxima", "1/us", paper.fig5_measured_envelope_per_us, rate * 1e-6
    for bead in (11, 10):
        shape, at = incident_pulse(time, signals[f"bead_{bead}"] - signals[f"bead_{bead}"][0]), f"at bead {bead}"
        if shape is not None:
            pulse = f"Fig. 5: incident pulse {at}"
            yield f"{pulse}, rise", "us", paper.fig5_incident_rise_us, shape.rise_s * 1e6
            yield f"{pulse}, decay", "1/us", paper.fig5_incident_decay_per_us, shape.decay_per_s * 1e-6
            yield f"{pulse}, duration", "us", paper.fig5_incident_duration_us, shape.duration_s * 1e6


def _fig4(simulation: Simulation) -> Iterator[Number]:
    """Fig. 4: reflected divided by incident peak at the ninth bead; the paper calls it significantly smaller than 1."""
    values = simulation.values
    ratio = values["bead_9_reflected_amplitude_N"] / values["bead_9_amplitude_N"]
    yield "Fig. 4: reflected divided by incident peak at bead 9", "", nan, ratio
    lowest = min(simulation.case.layout.sensors, key=lambda sensor: sensor.height_m)
    travel_s = values["wall_arrival_s"] - values[f"bead_{lowest.from_wall}_arrival_s"]
    speed = lowest.height_m / travel_s if travel_s > 0 else nan  # peak to peak, from the bead's centre
    yield "Fig. 4: speed from bead 5 to the wall", "m/s", quoted().fig4_speed_m_s, speed
