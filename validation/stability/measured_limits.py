"""The limit of the time step, measured by scanning steps until the energy blows up, against the one predicted.

Stable windows interleave with unstable ones, so steps are tried one by one, each a per cent larger than the last.
"""

import tempfile
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from drivers.base.errors import RunError
from drivers.chain.case import Case
from drivers.chain.chain import Array, energy_put_in
from drivers.chain.trace import Trace
from drivers.engines import installed_codes
from drivers.limits.criteria import CRITERIA
from drivers.limits.stable_step import reached_in, stable_step
from drivers.run.run import default_limit_s
from drivers.run.session import Session, served_by
from validation.accuracy.error_measures import truth_of, verlet_of
from validation.stability.subjects import RANDOM, SHIPPED, Subject

BLOWN_UP, BAD = 1.0, 0.1  # energy gained, over the kinetic energy at time 0
LEAST_KINETIC = 0.01  # of the energy put in; where it is less, that is what gains are counted in
FINENESS = 0.01
LOWEST, HIGHEST = 0.15, 2.5  # shares of the predicted limit that are scanned
BELOW = 0.9  # where codes are scanned for the blow-up alone; Verlet, with the same errors, is scanned from ``LOWEST``
VERLET = "verlet"
CRITERION_KEYS = ("rayleigh_s", "hertz_s", "p_wave_s")
JUDGED, WITHIN = (
    (SHIPPED, RANDOM),
    1.25,
)  # where the measured limit has to lie from 1 to so many times the predicted one


@dataclass(frozen=True)
class Limit:
    """The limit of one scene by one method; steps in s.

    Attributes:
        group: what scenes it belongs to: the paper's, random ones, or a sweep of one parameter.
        value: of the parameter, where it is a sweep's.
        predicted_s: from the exact motion, before any run.
        measured_s: the smallest step scanned at which the energy blows up; NaN if none does.
        bad_s: the smallest at which it gains a tenth of what there was; NaN where it was not looked for.
        rayleigh_s, hertz_s, p_wave_s: what users' criteria say (``drivers.limits.criteria.CRITERIA``).
        steps: of the run at the limit.
    """

    group: str
    scene: str
    value: float
    method: str
    bodies: int
    predicted_s: float
    measured_s: float
    bad_s: float
    ratio: float
    rayleigh_s: float
    hertz_s: float
    p_wave_s: float
    steps: float


def measure(
    subjects: list[Subject], say: Callable[[str], object] = print, names: Sequence[str] | None = None
) -> list[Limit]:
    """Limits of all subjects by Verlet and codes, all installed ones by default; these run side by side."""
    names = installed_codes() if names is None else names
    limits = [_by_verlet(subject) for subject in subjects]
    starts = {id(subject): limit for subject, limit in zip(subjects, limits, strict=True)}
    say(f"limits: {len(subjects)} scenes by {VERLET}")
    with ThreadPoolExecutor() as pool:
        parts = pool.map(lambda name: list(_by_code(name, subjects, starts)), names)
        for name, part in zip(names, parts, strict=True):
            limits += part
            say(f"limits: {len(part)} scenes by {name}")
    return limits


def prediction(case: Case) -> float:
    """The predicted limit in s, from the exact motion."""
    return stable_step(case.chain, reached_in(case.chain, truth_of(case, 1e-8).fine))


def gain(case: Case, trace: Trace) -> float:
    """The largest energy gain over the kinetic energy at time 0; inf where values are not finite.

    Where hardly anything moves at time 0 and weight sets all in motion, over what the scene puts in.
    """
    change = np.nan_to_num(trace.total_energy_J - trace.total_energy_J[0], nan=np.inf)
    put_in = energy_put_in(case.chain, float(case.sample_times_s[-1]))
    kinetic = float(trace.kinetic_energy_J[0])
    settles = case.chain.wall is not None and kinetic < LEAST_KINETIC * put_in
    return float(change.max() / (put_in if settles else kinetic or put_in))


def _scan(case: Case, predicted_s: float, gain_at: Callable[[Case], float], lowest: float) -> tuple[float, float]:
    """The smallest steps at which the energy blows up, and at which it is bad."""
    bad = float("nan")
    for share in _shares(lowest):
        found = gain_at(case.sampled_at_every(share * predicted_s))
        if found > BAD and not bad <= share * predicted_s:
            bad = share * predicted_s
        if found > BLOWN_UP:
            return share * predicted_s, bad
    return float("nan"), bad


def _shares(lowest: float) -> Array:
    shares = np.exp(np.arange(np.log(LOWEST), np.log(HIGHEST), np.log1p(FINENESS)))
    return np.asarray(shares[shares >= lowest])


def _by_verlet(subject: Subject) -> Limit:
    predicted = prediction(subject.case)

    def gain_at(case: Case) -> float:
        with np.errstate(all="ignore"):
            return gain(case, verlet_of(case))

    return _limit(subject, VERLET, predicted, *_scan(subject.case, predicted, gain_at, LOWEST))


def _by_code(name: str, subjects: list[Subject], by_verlet: dict[int, Limit]) -> Iterator[Limit]:
    with tempfile.TemporaryDirectory() as folder, served_by(name, Path(folder)) as session:
        for subject in subjects:
            predicted = by_verlet[id(subject)].predicted_s
            lowest = LOWEST if subject.whole_scan else BELOW
            measured, bad = _scan(subject.case, predicted, lambda case: _gain_in(session, case), lowest)
            yield _limit(subject, name, predicted, measured, bad if subject.whole_scan else float("nan"))


def _gain_in(session: Session, case: Case) -> float:
    """The gain on a code; inf where it lost a body before it could be seen."""
    engine = session.engine
    outcome = session.run(engine.render(case), default_limit_s(case))
    if outcome.code != 0:
        return float("inf")
    try:
        with np.errstate(all="ignore"):
            return gain(case, engine.read(case, session.case))
    except RunError:
        return float("inf")


def _limit(subject: Subject, method: str, predicted_s: float, measured_s: float, bad_s: float) -> Limit:
    case = subject.case
    return Limit(
        group=subject.group,
        scene=subject.name,
        value=subject.value,
        method=method,
        bodies=case.chain.bodies,
        predicted_s=predicted_s,
        measured_s=measured_s,
        bad_s=bad_s,
        ratio=measured_s / predicted_s,
        **{key: fraction * time(case) for key, (fraction, time) in zip(CRITERION_KEYS, CRITERIA.values(), strict=True)},
        steps=float(case.sample_times_s[-1]) / measured_s,
    )
