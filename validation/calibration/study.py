"""The fits of ``make calibration``: each law on the paper's quoted data, for every reading of what the paper leaves open."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from math import inf, nan

import numpy as np

from drivers.base.progress import following
from drivers.run.execute import Place, execute
from postproc.paper.quoted import quoted
from postproc.paper.simulate import Simulation
from postproc.read.observables import LATER_PROMINENCE
from postproc.read.sensors import sensor_signals
from postproc.read.signals import incident_pulse, peaks, train_envelope
from validation.calibration.calibration_file import Answer, Law, calibration_file
from validation.calibration.certainty import contours
from validation.calibration.data_sets import CUT, paper_data
from validation.calibration.outcome import Outcome, solve
from validation.calibration.problem import motion_values, pose, simulated
from validation.calibration.rows import DatumRow, Parameter, datum_rows, parameter_rows

MODULUS = "materials.ptfe.youngs_modulus"
RESTITUTION, CONTOUR_LAW = "contact.restitution", "viscoelastic"  # of the contours, with the modulus
MODULI_PA, RESTITUTIONS = np.geomspace(0.3e9, 2.4e9, 15), np.linspace(0.8, 1.0, 11)
MAXIMA = (2, 3, 4)  # numbers of maxima for an envelope
TOP = "chain.sensors=[{ from_wall = 11 }, { from_wall = 10 }]"  # Fig. 5, sensors where the pulse enters
MAX_DEVIATION = 2.0  # standard errors; data with larger deviations are missed


@dataclass(frozen=True)
class FitRow:
    """A law fitted for one reading of the paper; NaN for a parameter that the fit does not have.

    ``missed`` names the data that deviate by more than ``MAX_DEVIATION`` standard errors.
    """

    law: str
    reading: str
    modulus_Pa: float
    modulus_error_Pa: float
    modulus_low_Pa: float
    modulus_high_Pa: float
    dissipation: float
    dissipation_error: float
    time_constant_s: float
    force_scale: float
    speed_scale: float
    cut: float
    chi_square: float
    freedom: int
    probability: float
    missed: str


@dataclass(frozen=True)
class ContourRow:
    """Smallest chi-square at a modulus and a restitution, with all other parameters fitted."""

    reading: str
    modulus_Pa: float
    restitution: float
    chi_square: float


@dataclass(frozen=True)
class NotFitted:
    """A quantity of the same experiments that is not fitted; ``measured`` is NaN if no number is quoted."""

    law: str
    reading: str
    quantity: str
    unit: str
    measured: float
    computed: float


@dataclass(frozen=True)
class Remark:
    """A sentence about a fit."""

    law: str
    reading: str
    sentence: str


@dataclass(frozen=True)
class StudyRows:
    """Rows of all tables, by kind."""

    fits: list[FitRow]
    parameters: list[Parameter]
    data: list[DatumRow]
    contours: list[ContourRow]
    not_fitted: list[NotFitted]
    remarks: list[Remark]


@dataclass(frozen=True, eq=False)
class _Job:
    """Fits of some laws for one reading; ``thorough`` with search, profiles and predictions without each datum."""

    answers: tuple[Answer, ...]
    laws: tuple[Law, ...]
    thorough: bool
    seeds: tuple[tuple[str, tuple[tuple[str, float], ...]], ...] = ()  # values by law
    contour: bool = False


def reading_of(answers: Sequence[Answer]) -> str:
    """Name of a reading: the answers that are not the default; "default" for the first reading."""
    default = calibration_file().readings()[0]
    other = [
        f"{choice.name}: {each.name}"
        for choice, each, usual in zip(calibration_file().choice, answers, default, strict=True)
        if each.name != usual.name
    ]
    return "; ".join(other) or "default"


def study(*, quick: bool = False) -> StudyRows:
    """All fits, in parallel: first each law for the default reading, then the other readings from there.

    The short study starts at the parameters found before.
    """
    asked = calibration_file()
    readings, laws = asked.readings(quick=quick), asked.law
    known = tuple((law.name, tuple(law.found.items())) for law in laws)
    done = list[StudyRows]()
    if not quick:
        first = [_Job(readings[0], (law,), thorough=True) for law in reversed(laws)]  # the longest first
        results = dict(following(execute(_run, first, Place(processes=True)), "fits of the default", len(first), "fit"))
        done = [results[job] for job in reversed(first)]
        known = tuple((law.name, _values_in(each, law.name)) for law, each in zip(laws, done, strict=True))
    drawn = [readings[0], *(each for each in readings if reading_of(each) == "electronics: RC about 1 ms")]
    jobs = [_Job(each, laws, thorough=False, seeds=known) for each in (readings if quick else readings[1:])]
    jobs += [_Job(each, laws, thorough=False, seeds=known, contour=True) for each in drawn if not quick]
    results = dict(following(execute(_run, jobs, Place(processes=True)), "fits of all readings", len(jobs), "reading"))
    done += [results[job] for job in jobs]
    names = StudyRows.__dataclass_fields__
    return StudyRows(**{name: [row for each in done for row in getattr(each, name)] for name in names})


def _values_in(rows: StudyRows, law: str) -> tuple[tuple[str, float], ...]:
    return tuple((row.parameter, row.value) for row in rows.parameters if row.law == law)


def _run(job: _Job) -> StudyRows:
    """Rows of a job."""
    found, earlier = StudyRows([], [], [], [], [], []), list[dict[str, float]]()
    reading, seeds = reading_of(job.answers), dict(job.seeds)
    for law in job.laws:
        if job.contour and law.name != CONTOUR_LAW:
            continue
        outcome = fit_law(law, job.answers, [dict(seeds.get(law.name, ())), *earlier], thorough=job.thorough)
        earlier.append(outcome.fit.values)
        if job.contour:
            found.contours.extend(_contours(reading, outcome))
            continue
        found.fits.append(_fit_row(law, reading, outcome))
        found.parameters.extend(parameter_rows(law.name, reading, outcome))
        found.data.extend(datum_rows(law.name, reading, outcome))
        found.not_fitted.extend(_not_fitted(law, reading, outcome))
        found.remarks.extend(Remark(law.name, reading, sentence) for sentence in [*outcome.sentences()][1:])
    return found


def fit_law(
    law: Law, answers: Sequence[Answer], seeds: Sequence[dict[str, float]] = (), *, thorough: bool = True
) -> Outcome:
    """Fit of a law to all quoted data, for one reading."""
    asked = calibration_file()
    free = (*asked.free, *law.free, *(text for answer in answers for text in answer.free))
    problem = pose(paper_data(asked.data, law.set, answers), free, answers=answers)
    return solve(problem, quick=not thorough, seeds=[seed for seed in seeds if seed], search=thorough)


def _fit_row(law: Law, reading: str, outcome: Outcome) -> FitRow:
    found = outcome.fit
    labels = [free.label for free in found.problem.free]

    def of(label: str) -> tuple[float, float]:
        known = found.problem.fixed.get(label, nan)
        return (outcome.value(labels.index(label)), outcome.error(labels.index(label))) if label in labels else (known, nan)

    dissipation = of(law.free[0].partition("=")[0]) if law.free else (nan, nan)
    missed = [line.datum.label for line in outcome.predictions if line.datum.number and not abs(line.off) <= MAX_DEVIATION]
    return FitRow(
        law.name, reading, *of(MODULUS), *outcome.interval(labels.index(MODULUS), 1.0), *dissipation,
        of("sensor.time_constant")[0], of("reading.force_scale")[0], of("reading.speed_scale")[0], of(CUT)[0],
        found.chi_square, found.freedom, outcome.probability, "; ".join(missed),
    )  # fmt: skip


def _contours(reading: str, outcome: Outcome) -> Iterator[ContourRow]:
    labels = [free.label for free in outcome.fit.problem.free]
    grid = contours(outcome.fit, labels.index(MODULUS), labels.index(RESTITUTION), (MODULI_PA, RESTITUTIONS))
    for restitution, row in zip(RESTITUTIONS, grid, strict=True):
        for modulus_Pa, chi_square in zip(MODULI_PA, row, strict=True):
            yield ContourRow(reading, float(modulus_Pa), float(restitution), float(chi_square))


def _not_fitted(law: Law, reading: str, outcome: Outcome) -> Iterator[NotFitted]:
    """Quantities of the same experiments that are not fitted."""
    problem, place = outcome.fit.problem, outcome.fit.place
    for name, more, numbers in (("fig5", (TOP,), _fig5), ("fig4", (), _fig4)):
        (each,) = paper_data([name], (*law.set, *more))
        shared = replace(each, own=())
        simulation = simulated(shared, motion_values(problem, shared, place))
        if simulation is not None:
            for row in numbers(simulation):
                yield NotFitted(law.name, reading, *row)


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
            yield f"Fig. 5: incident pulse {at}, rise", "us", paper.fig5_incident_rise_us, shape.rise_s * 1e6
            yield f"Fig. 5: incident pulse {at}, decay", "1/us", paper.fig5_incident_decay_per_us, shape.decay_per_s * 1e-6
            yield f"Fig. 5: incident pulse {at}, duration", "us", paper.fig5_incident_duration_us, shape.duration_s * 1e6


def _fig4(simulation: Simulation) -> Iterator[Number]:
    """Fig. 4: reflected divided by incident peak at the ninth bead; the paper calls it significantly smaller than 1."""
    values = simulation.values
    ratio = values["bead_9_reflected_amplitude_N"] / values["bead_9_amplitude_N"]
    yield "Fig. 4: reflected divided by incident peak at bead 9", "", nan, ratio
    yield "Fig. 4: speed from bead 5 to the wall", "m/s", quoted().fig4_speed_m_s, _speed_to_wall(simulation)


def _speed_to_wall(simulation: Simulation) -> float:
    """Peak-to-peak speed from bead 5 to the wall, over the distance of the bead's centre from the wall."""
    lowest = min(simulation.case.layout.sensors, key=lambda sensor: sensor.height_m)
    travel_s = simulation.values["wall_arrival_s"] - simulation.values[f"bead_{lowest.from_wall}_arrival_s"]
    return lowest.height_m / travel_s if travel_s > 0 else inf
