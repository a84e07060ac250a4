"""The fits of ``make calibration``: each dissipation law fitted to each selection of the paper's quoted data."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from math import nan

from drivers.base.progress import following
from drivers.run.execute import Place, execute
from postproc.paper.quoted import quoted
from postproc.paper.simulate import Simulation
from postproc.read.observables import LATER_PROMINENCE
from postproc.read.sensors import sensor_signals
from postproc.read.signals import incident_pulse, peaks, train_envelope
from validation.calibration.calibration_file import Law, calibration_file
from validation.calibration.data_sets import paper_data
from validation.calibration.outcome import Outcome, solve
from validation.calibration.problem import motion_values, own_values, pose, simulated
from validation.calibration.rows import DatumRow, Parameter, datum_rows, parameter_rows

MAXIMA = (2, 3, 4)  # numbers of maxima for an envelope
TOP = "chain.sensors=[{ from_wall = 11 }, { from_wall = 10 }]"  # Fig. 5, sensors where the pulse enters
NOT_QUOTED = "no error is quoted"
REFLECTED = "run.duration=1.6 ms"  # Fig. 4, long enough for the reflected wave


@dataclass(frozen=True)
class Point:
    """A point of a profile: rise of chi-square at a value of one parameter, with all others fitted again."""

    law: str
    data: str
    parameter: str
    value: float
    rise: float


@dataclass(frozen=True)
class Remark:
    """A sentence about a fit."""

    law: str
    data: str
    sentence: str


Rows = tuple[list[Parameter], list[DatumRow], list[Point], list[Remark]]


def fit_all(*, quick: bool = False) -> Rows:
    """Runs all fits in parallel; rows are in the order of the file."""
    asked = calibration_file()
    laws = [law for law in asked.law if not quick or law.name in asked.quick]
    selections = asked.selections[:: len(asked.selections) - 1] if quick else asked.selections
    jobs = [(law, data, quick) for law in laws for data in selections]
    longest_first = sorted(jobs, key=lambda job: (len(job[0].free), len(job[1])), reverse=True)
    found = dict(following(execute(_fit_job, longest_first, Place(processes=True)), "fits", len(jobs), "fit"))
    parts = zip(*(found[job] for job in jobs), strict=True)
    parameters, data, points, remarks = ([row for rows in part for row in rows] for part in parts)
    return parameters, data, points, remarks


def _fit_job(job: tuple[Law, str, bool]) -> Rows:
    return fit_one(*job)


def fit_one(law: Law, data: str, quick: bool) -> Rows:
    """Rows of the fit of one law to one selection."""
    sets = paper_data([name.strip() for name in data.split(",")], law.set)
    outcome = solve(pose(sets, law.free), quick=quick)
    parameters = [*parameter_rows(law.name, data, outcome)]
    rows = [*datum_rows(law.name, data, outcome), *_not_fitted(law, data, outcome)]
    points = [
        Point(law.name, data, label, float(value), float(rise))
        for label, each in outcome.profiles.items()
        for value, rise in zip(each.value, each.chi_square - each.chi_square.min(), strict=True)
    ]
    return parameters, rows, points, [Remark(law.name, data, sentence) for sentence in outcome.sentences()]


def _not_fitted(law: Law, data: str, outcome: Outcome) -> Iterator[DatumRow]:
    """Rows of quantities that the paper quotes for the same experiments and that are not fitted."""
    problem, place = outcome.fit.problem, outcome.fit.place
    for name, more, numbers in (("fig5", TOP, _fig5), ("fig4", REFLECTED, _fig4)):
        (each,) = paper_data([name], (*law.set, more))
        simulation = simulated(each, motion_values(own_values(problem, each, place)))
        if simulation is None:
            continue
        for name, unit, measured, computed in numbers(simulation):
            none = (nan, nan, nan, nan, nan)
            yield DatumRow(law.name, data, each.name, name, unit, measured, nan, computed, *none, False, NOT_QUOTED)


Number = tuple[str, str, float, float]  # name, unit, measured (NaN if no number is quoted), computed


def _fig5(simulation: Simulation) -> Iterator[Number]:
    """Fig. 5: envelope at the wall through 2, 3 and 4 maxima of the train, and the incident pulse."""
    time, signals, paper = (
        simulation.trace.time_s,
        sensor_signals(simulation.case.layout, simulation.trace),
        quoted(),
    )
    wall = signals["wall"]
    maxima = peaks(time, wall - wall[0], LATER_PROMINENCE)
    leading = [replace(peak, value=peak.value + float(wall[0])) for peak in maxima]
    for count in MAXIMA:
        curve = train_envelope(leading, count)
        rate = curve.rate_per_s if curve else nan
        yield f"wall envelope through {count} maxima", "1/us", paper.fig5_measured_envelope_per_us, rate * 1e-6
    reading = signals["bead_11"]
    shape = incident_pulse(time, reading - reading[0])
    if shape is not None:
        yield "incident pulse, rise", "us", paper.fig5_incident_rise_us, shape.rise_s * 1e6
        yield "incident pulse, decay", "1/us", paper.fig5_incident_decay_per_us, shape.decay_per_s * 1e-6
        yield "incident pulse, duration", "us", paper.fig5_incident_duration_us, shape.duration_s * 1e6


def _fig4(simulation: Simulation) -> Iterator[Number]:
    """Fig. 4: reflected over incident peak at the ninth bead; the paper calls it significantly smaller than 1."""
    values = simulation.values
    ratio = values["bead_9_reflected_amplitude_N"] / values["bead_9_amplitude_N"]
    yield "reflected over incident peak at bead 9", "", nan, ratio
