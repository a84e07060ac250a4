"""The limit of the time step, measured by scanning steps until the energy blows up, against the one predicted.

Stable windows interleave with unstable ones, so steps are tried one by one, each a per cent larger than the last.
"""

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from math import inf, nan

import numpy as np

from drivers.base.errors import RunError
from drivers.chain.case import Case
from drivers.chain.chain import energy_put_in
from drivers.chain.trace import Trace
from drivers.engines import installed_codes
from drivers.limits.criteria import CRITERIA
from drivers.limits.stable_step import reached_in, stable_step
from drivers.run.run import default_limit_s
from drivers.run.session import Session
from validation.accuracy.schemes import truth_of, verlet_of
from validation.served_runs import serving
from validation.stability.subjects import RANDOM, SHIPPED, Subject
from validation.studies import VERLET, progress

BLOWN_UP, BAD = 1.0, 0.1  # energy gained, over the kinetic energy at time 0
LEAST_KINETIC = 0.01  # of the energy put in; where it is less, that is what gains are counted in
FINENESS = 0.01
LOWEST, HIGHEST = 0.15, 2.5  # shares of the predicted limit that are scanned
SHARES = np.exp(np.arange(np.log(LOWEST), np.log(HIGHEST), np.log1p(FINENESS)))
BELOW = 0.9  # where codes are scanned for the blow-up alone; Verlet, with the same errors, is scanned from ``LOWEST``
CRITERION_KEYS = ("rayleigh_s", "hertz_s", "p_wave_s")
JUDGED = (SHIPPED, RANDOM)  # groups on which the measured limit has to lie from 1 to WITHIN times the predicted one
WITHIN = 1.25


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


def measure_limits(subjects: Sequence[Subject], names: Sequence[str] | None = None) -> list[Limit]:
    """Limits of all subjects by Verlet and codes, all installed ones by default; these run side by side."""
    names = installed_codes() if names is None else names
    limits = [_scan(each, VERLET, prediction(each.case), lambda case: gain(case, verlet_of(case))) for each in subjects]
    progress(f"limits: {len(subjects)} scenes by {VERLET}")
    predicted_s = [limit.predicted_s for limit in limits]
    with ThreadPoolExecutor() as pool:
        parts = pool.map(lambda name: list(_by_code(name, subjects, predicted_s)), names)
        for name, part in zip(names, parts, strict=True):
            limits += part
            progress(f"limits: {len(part)} scenes by {name}")
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


def _by_code(name: str, subjects: Sequence[Subject], predicted_s: Sequence[float]) -> Iterator[Limit]:
    with serving(name) as session:
        for subject, predicted in zip(subjects, predicted_s, strict=True):
            yield _scan(subject, name, predicted, lambda case: _gain_in(session, case), whole=subject.whole_scan)


def _gain_in(session: Session, case: Case) -> float:
    """The gain on a code; inf where it lost a body before it could be seen."""
    outcome = session.run(session.engine.render(case), default_limit_s(case))
    try:
        return gain(case, session.engine.read(case, session.case)) if outcome.code == 0 else inf
    except RunError:
        return inf


def _scan(
    subject: Subject, method: str, predicted_s: float, gain_at: Callable[[Case], float], *, whole: bool = True
) -> Limit:
    """Tries larger and larger steps until the energy blows up; ``whole`` scans find where it is bad as well."""
    case, measured_s, bad_s = subject.case, nan, nan
    for step_s in predicted_s * SHARES[(LOWEST if whole else BELOW) <= SHARES]:
        with np.errstate(all="ignore"):
            found = gain_at(case.sampled_at_every(step_s))
        if whole and found > BAD and np.isnan(bad_s):
            bad_s = step_s
        if found > BLOWN_UP:
            measured_s = step_s
            break
    criteria = {key: share * time(case) for key, (share, time) in zip(CRITERION_KEYS, CRITERIA.values(), strict=True)}
    return Limit(
        subject.group, subject.name, subject.value, method, case.chain.bodies, predicted_s, measured_s, bad_s,
        ratio=measured_s / predicted_s, **criteria, steps=float(case.sample_times_s[-1]) / measured_s,
    )  # fmt: skip
