"""The fits of ``make calibration``: each law of dissipation to each selection of what the paper quotes."""

import os
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass, replace
from functools import cache
from math import nan
from multiprocessing import active_children, get_context
from typing import Annotated

from pydantic import Field

from drivers.base import paths
from drivers.base.messages import validate
from drivers.base.progress import counted
from drivers.scene.model import Part
from drivers.scene.read_scene import read_toml
from postproc.paper.quoted import quoted
from postproc.paper.simulate import Simulation
from postproc.read.observables import LATER
from postproc.read.sensors import sensor_signals
from postproc.read.signals import incident_pulse, peaks, train_envelope
from validation.calibration.data_sets import paper_data
from validation.calibration.outcome import Outcome, solve
from validation.calibration.problem import of_motion, own_values, pose, simulated
from validation.calibration.rows import DatumRow, Parameter, datum_rows, parameter_rows

MAXIMA = (2, 3, 4)  # that an envelope is drawn through
TOP = "chain.sensors=[{ from_wall = 11 }, { from_wall = 10 }]"  # of Fig. 5, where the pulse enters
NOT_QUOTED = "no error is quoted"
REFLECTED = "run.duration=1.6 ms"  # of Fig. 4, until the reflected wave has come by


class Law(Part):
    """A law of the contacts, by settings, and the parameters that are free in it."""

    name: str
    set: Annotated[tuple[str, ...], Field(strict=False)] = ()
    free: Annotated[tuple[str, ...], Field(strict=False)]


class Plan(Part):
    """The fits of the study; those of the short one are its ``quick`` laws on the first and last selection."""

    selections: Annotated[tuple[str, ...], Field(strict=False, min_length=1)]
    quick: Annotated[tuple[str, ...], Field(strict=False, min_length=1)]
    law: Annotated[tuple[Law, ...], Field(strict=False, min_length=1)]


@dataclass(frozen=True)
class Point:
    """A point of a profile: least rise of chi-square at a value of one parameter, all others fitted anew."""

    law: str
    data: str
    parameter: str
    value: float
    rise: float


@dataclass(frozen=True)
class Remark:
    """What a fit says of itself, a sentence."""

    law: str
    data: str
    sentence: str


Rows = tuple[list[Parameter], list[DatumRow], list[Point], list[Remark]]


@cache
def plan() -> Plan:
    """The fits that ``inputs/calibration.toml`` asks for.

    Raises:
        InputError: the file is wrong.
    """
    tables = {key: value for key, value in read_toml(paths.CALIBRATION).items() if key in Plan.model_fields}
    return validate(Plan, tables, paths.shown(paths.CALIBRATION))


def fit_all(*, quick: bool = False) -> Rows:
    """All fits, side by side, their rows in the order of the file."""
    asked = plan()
    laws = [law for law in asked.law if not quick or law.name in asked.quick]
    selections = asked.selections[:: len(asked.selections) - 1] if quick else asked.selections
    jobs = [(law, data, quick) for law in laws for data in selections]
    by_length = sorted(
        range(len(jobs)), key=lambda place: (len(jobs[place][0].free), len(jobs[place][1])), reverse=True
    )
    found: dict[int, Rows] = {}
    context = get_context("forkserver")
    context.set_forkserver_preload(["drivers.base.ends_with_parent", __name__])
    pool = ProcessPoolExecutor(min(len(jobs), os.cpu_count() or 1), context)
    try:
        with counted("fits", len(jobs), "fit") as count:
            places = {pool.submit(fit_one, *jobs[place]): place for place in by_length}
            for future in as_completed(places):
                found[places[future]] = future.result()
                count()
    except BaseException:
        for process in active_children():  # else an interrupt waits for fits that are under way
            process.terminate()
        raise
    finally:
        pool.shutdown(wait=False, cancel_futures=True)
    parts = zip(*(found[place] for place in range(len(jobs))), strict=True)
    parameters, data, points, remarks = ([row for rows in part for row in rows] for part in parts)
    return parameters, data, points, remarks


def fit_one(law: Law, data: str, quick: bool) -> Rows:
    """One law fitted to one selection, as rows."""
    sets = paper_data([name.strip() for name in data.split(",")], law.set)
    outcome = solve(pose(sets, law.free), quick=quick)
    parameters = [*parameter_rows(law.name, data, outcome)]
    rows = [*datum_rows(law.name, data, outcome), *_beyond(law, data, outcome)]
    points = [
        Point(law.name, data, label, float(value), float(rise))
        for label, each in outcome.profiles.items()
        for value, rise in zip(each.value, each.chi_square - each.chi_square.min(), strict=True)
    ]
    return parameters, rows, points, [Remark(law.name, data, sentence) for sentence in outcome.sentences()]


def _beyond(law: Law, data: str, outcome: Outcome) -> Iterator[DatumRow]:
    """What the paper says of the same experiments and nothing here is fitted to."""
    problem, place = outcome.fit.problem, outcome.fit.place
    for name, more, numbers in (("fig5", TOP, _fig5), ("fig4", REFLECTED, _fig4)):
        (each,) = paper_data([name], (*law.set, more))
        simulation = simulated(each, of_motion(own_values(problem, each, place)))
        if simulation is None:
            continue
        for name, unit, measured, computed in numbers(simulation):
            none = (nan, nan, nan, nan, nan)
            yield DatumRow(law.name, data, each.name, name, unit, measured, nan, computed, *none, False, NOT_QUOTED)


Number = tuple[str, str, float, float]  # name, unit, measured (NaN where no number is quoted), computed


def _fig5(simulation: Simulation) -> Iterator[Number]:
    """Fig. 5: the envelope at the wall through several numbers of maxima of its train, and the pulse that enters."""
    time, signals, paper = (
        simulation.trace.time_s,
        sensor_signals(simulation.case.layout, simulation.trace),
        quoted().fig5,
    )
    wall = signals["wall"]
    maxima = peaks(time, wall - wall[0], LATER)
    leading = [replace(peak, value=peak.value + float(wall[0])) for peak in maxima]
    for count in MAXIMA:
        curve = train_envelope(leading, count)
        rate = curve.rate_per_s if curve else nan
        yield f"wall envelope through {count} maxima", "1/us", paper.measured_envelope_per_us, rate * 1e-6
    reading = signals["bead_11"]
    shape = incident_pulse(time, reading - reading[0])
    if shape is not None:
        yield "incident pulse, rise", "us", paper.incident_rise_us, shape.rise_s * 1e6
        yield "incident pulse, decay", "1/us", paper.incident_decay_per_us, shape.decay_per_s * 1e-6
        yield "incident pulse, duration", "us", paper.incident_duration_us, shape.duration_s * 1e6


def _fig4(simulation: Simulation) -> Iterator[Number]:
    """Fig. 4: the reflected wave over the incident one at the ninth bead, which is said to be significantly smaller."""
    values = simulation.values
    ratio = values["bead_9_reflected_amplitude_N"] / values["bead_9_amplitude_N"]
    yield "reflected over incident peak at bead 9", "", nan, ratio
