"""Law of a run, measured from its own state and compared with the scene's.

With the overlap d_j of each contact from the recorded heights, the closing speed d_j' and the recorded forces F_j:

* stiffness and damping: least squares of ``F_j = k_j d_j^(3/2) + C_j x_j + b_j`` over the samples at which contact j
  is closed, with ``x`` of the contact law, such as ``d^(1/4) d'``;
* masses and loads: least squares of ``m_j (v_j - v_j(0)) = L_j t + integral of (F_j - F_{j+1} - b_j + b_{j+1})``;
* clock: least squares of ``z_j - z_j(0) = q integral of v_j + s (v_j - v_j(0))`` over all bodies, with q the time
  between samples divided by the scene's, and s the time by which recorded velocities are late;
* start: heights and velocities at time 0.

No motion is integrated. Each value is a ratio to the scene's. Its uncertainty includes the rounding of heights, the
time step, and the error of integrals over samples, so that coarse samples make a ratio less certain, not wrong.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from drivers.chain.case import Case
from drivers.chain.chain import Array, Chain, furthest_m
from drivers.chain.trace import Trace, overlaps
from drivers.laws.viscoelastic import Viscoelastic
from postproc.read.signals import integral

MIN_SAMPLES = 12
FIT_SAMPLES = 500  # evenly spread samples are enough for a fit
CLOCK_SAMPLES = 1_000_000  # of all bodies together
MAX_BODIES = 2_000
ROUNDINGS = 8.0  # rounding errors of a height, in an overlap
SIGNIFICANCE = 5.0  # uncertainties by which a value that is not the scene's differs
MIN_UNCERTAINTY = 1e-9  # of a ratio
PROPORTIONAL = 0.05  # largest relative deviation of heights at the start from speeds times a delay
NEGLIGIBLE = 1e-9  # of the largest column of a fit: a column that cannot be measured
STIFFNESS, DAMPING, MASS, LOAD, RESISTANCE = "stiffness", "damping", "mass", "load", "resistance"
INTERVAL, LATE_VELOCITY, EARLY_START, LATE_SAMPLES = "interval", "late velocity", "early start", "late samples"
START_SPEED, START_OVERLAP = "start speed", "start overlap"


@dataclass(frozen=True)
class LawRow:
    """A measured value of a run.

    Attributes:
        quantity: one of the constants above.
        place: contact or body, counted from the wall; 0 for the whole chain.
        ratio: value divided by the scene's. Values that a scene has as 0 are added to 1: damping as damping ratio, a
            load divided by the largest force, resistance (force against the motion, Cundall's damping) divided by the
            force, times divided by the time step.
        uncertainty: of the ratio.
    """

    quantity: str
    place: int
    ratio: float
    uncertainty: float

    @property
    def uncertainties_off(self) -> float:
        """Difference from the scene's value divided by the uncertainty."""
        return abs(self.ratio - 1) / self.uncertainty

    @property
    def differs(self) -> bool:
        """True if the value is not the scene's."""
        return not abs(self.ratio - 1) <= SIGNIFICANCE * self.uncertainty


def measure_law(case: Case, trace: Trace, step_s: float) -> list[LawRow]:
    """Parameters of a run of a straight chain, from its own forces, heights and velocities.

    Args:
        case: the scene that was to be run.
        trace: the run, finished or failed, with heights and velocities.
        step_s: time step of velocity Verlet, which takes closing speeds half a step late; 0 for an exact motion.

    Raises:
        ValueError: the reason why the law cannot be measured.
    """
    chain = case.chain
    if chain.lateral is not None:
        raise ValueError("only straight chains are measured")
    if chain.drive is not None:
        raise ValueError("only chains without a drive are measured")
    if chain.bodies > MAX_BODIES:
        raise ValueError(f"more than {MAX_BODIES} bodies")
    if trace.height_m is None or trace.velocity_m_s is None:
        raise ValueError("no heights and velocities were recorded")
    state = np.hstack([trace.force_N, trace.height_m, trace.velocity_m_s])
    samples = int(np.argmin(np.append(np.isfinite(state).all(axis=1), False)))
    if samples < MIN_SAMPLES:
        raise ValueError(f"only {samples} samples, {MIN_SAMPLES} are needed")
    force, height, velocity = np.split(state[:samples], 3, axis=1)
    time_s = trace.time_s[:samples]
    overlap = overlaps(chain, height)
    net = force - _above(force) + chain.load_N
    earlier = velocity - 0.5 * step_s * net / chain.mass_kg
    closing = np.column_stack([np.zeros(samples), earlier[:, :-1]]) - earlier
    contacts, offset_N = _contacts(chain, overlap, closing, force)
    bodies = _bodies(chain, time_s, velocity, force - offset_N, step_s)
    return [
        *contacts,
        *bodies,
        *_clock(case, time_s, height, velocity),
        *_start(case, time_s[1], height[:2], velocity[:2]),
    ]


def _above(force_N: Array) -> Array:
    """Force in the contact above each body. Shape (samples, bodies)."""
    return np.column_stack([force_N[:, 1:], np.zeros(len(force_N))])


def _fit(columns: list[Array], target: Array, samples: int = FIT_SAMPLES) -> tuple[list[float], list[float]]:
    """Coefficients of columns by least squares and their standard errors; NaN for columns that are negligible."""
    every = max(len(target) // samples, 1)
    columns, target = [column[::every] for column in columns], target[::every]
    sizes = np.array([np.abs(column).max() for column in columns])
    usable = np.flatnonzero(sizes > NEGLIGIBLE * sizes.max())
    values, errors = np.full((2, len(columns)), np.nan)
    if usable.size and len(target) > usable.size:
        scaled = np.column_stack([columns[place] / sizes[place] for place in usable])
        solution, _, rank, _ = np.linalg.lstsq(scaled, target)
        if rank == usable.size:
            left = target - scaled @ solution
            variance = float(left @ left) / (len(target) - usable.size)
            spread = np.sqrt(variance * np.diag(np.linalg.inv(scaled.T @ scaled)))
            values[usable], errors[usable] = solution / sizes[usable], spread / sizes[usable]
    return values.tolist(), errors.tolist()


def _contacts(chain: Chain, overlap_m: Array, closing_m_s: Array, force_N: Array) -> tuple[list[LawRow], Array]:
    """Stiffness and damping of each contact, and the constant part of its force in N. Shape (bodies,)."""
    law = chain.law if chain.damped else Viscoelastic(1.0)
    lossy = law.force(law.coefficient(chain.stiffness, chain.reduced_mass_kg), overlap_m, closing_m_s)
    rows, offset = [], np.zeros(chain.bodies)
    for j in np.flatnonzero(chain.stiffness):
        closed = (overlap_m[:, j] > 0) & (force_N[:, j] != 0)
        elastic = chain.stiffness[j] * overlap_m[closed, j] ** 1.5
        if closed.sum() < MIN_SAMPLES or np.ptp(elastic) < NEGLIGIBLE * elastic.max():
            continue
        largest = float(elastic.max())
        constant = np.full(len(elastic), largest)
        values, errors = _fit([elastic, lossy[closed, j], constant], force_N[closed, j])
        rounding = 1.5 * ROUNDINGS * float(np.spacing(furthest_m(chain)) / overlap_m[closed, j].max()) + MIN_UNCERTAINTY
        varying = rounding * largest / float(np.ptp(elastic))
        if not np.isfinite(values[0] + errors[0]):
            continue
        rows.append(LawRow(STIFFNESS, int(j) + 1, values[0], errors[0] + varying))
        if np.isfinite(values[1]):
            uncertainty = errors[1] + varying * largest / float(np.abs(lossy[closed, j]).max())
            rows.append(LawRow(DAMPING, int(j) + 1, values[1] + (not chain.damped), uncertainty))
        if abs(values[2]) > SIGNIFICANCE * (errors[2] + varying):
            offset[j] = values[2] * largest
    return rows, offset


def _bodies(chain: Chain, time_s: Array, velocity_m_s: Array, force_N: Array, step_s: float) -> Iterator[LawRow]:
    """Mass and load of each body; resistance of all, if masses alone do not explain the impulses."""
    net, interval = force_N - _above(force_N), float(time_s[1] - time_s[0])
    largest = float(np.abs(force_N).max()) or 1.0
    moving = net + chain.load_N
    for j in range(chain.bodies):
        gained, impulse = velocity_m_s[:, j] - velocity_m_s[0, j], integral(time_s, net[:, j])
        coarse = integral(time_s[::2], net[::2, j])
        off = (
            float(np.abs(impulse[::2] - coarse).max()) + step_s**2 * float(np.abs(np.diff(net[:, j])).max()) / interval
        )
        off += float(np.spacing(np.abs(impulse).max())) * len(time_s)
        if not np.abs(gained).max() or off > 0.1 * float(np.abs(impulse).max()):
            continue
        against = integral(time_s, np.abs(moving[:, j]) * np.sign(velocity_m_s[:, j]))
        values, errors = _fit([gained, -time_s], impulse)
        mass, size = float(chain.mass_kg[j]), float(np.abs(gained).max())
        rows = [LawRow(MASS, j + 1, values[0] / mass, (errors[0] + off / size) / mass + MIN_UNCERTAINTY)]
        load = float(chain.load_N[j])
        unit = abs(load) or largest
        ratio = values[1] / load if load else 1 + values[1] / largest
        rows.append(LawRow(LOAD, j + 1, ratio, (errors[1] + off / float(time_s[-1])) / unit + MIN_UNCERTAINTY))
        if rows[0].differs and errors[0] > off / size:  # a mass does not explain the impulses
            values, resisted = _fit([gained, -time_s, against], impulse)
            if resisted[0] < 0.1 * errors[0] and 0 < values[2] < 1:
                rows = [
                    LawRow(MASS, j + 1, values[0] / mass, (resisted[0] + off / size) / mass + MIN_UNCERTAINTY),
                    LawRow(
                        RESISTANCE,
                        j + 1,
                        1 + values[2],
                        resisted[2] + off / float(np.abs(against).max()) + MIN_UNCERTAINTY,
                    ),
                ]
        yield from (row for row in rows if np.isfinite(row.ratio))


def _clock(case: Case, time_s: Array, height_m: Array, velocity_m_s: Array) -> Iterator[LawRow]:
    """Interval between samples, and delay of recorded velocities in time steps, from all bodies after sample 0."""
    step_s, times = case.scene.time_step_s, time_s[1:] - time_s[1]
    moved, gained = height_m[1:] - height_m[1], velocity_m_s[1:] - velocity_m_s[1]
    travelled = np.column_stack([integral(times, column) for column in velocity_m_s[1:].T])
    coarse = np.column_stack([integral(times[::2], column) for column in velocity_m_s[1::2].T])
    furthest = float(np.abs(moved).max())
    if not furthest:
        return
    off = float(np.abs(travelled[::2] - coarse).max()) + step_s**2 * float(
        np.abs(np.diff(gained, axis=0)).max() / times[1]
    )
    off += ROUNDINGS * float(np.spacing(np.abs(height_m).max()))
    values, errors = _fit([travelled.ravel(), gained.ravel()], moved.ravel(), CLOCK_SAMPLES)
    yield LawRow(INTERVAL, 0, values[0], errors[0] + off / furthest + MIN_UNCERTAINTY)
    if np.isfinite(values[1]):
        uncertainty = (errors[1] + off / float(np.abs(gained).max())) / step_s + MIN_UNCERTAINTY
        yield LawRow(LATE_VELOCITY, 0, 1 + values[1] / step_s, uncertainty)


def _start(case: Case, interval: float, height_m: Array, velocity_m_s: Array) -> Iterator[LawRow]:
    """Start of the bodies, from the first two samples: speeds and overlaps, and delays of the samples in time steps."""
    chain, step_s = case.chain, case.scene.time_step_s
    rounding = ROUNDINGS * float(np.spacing(furthest_m(chain)))
    speed = chain.velocity_m_s
    if fastest := float(np.abs(speed).max()):
        shift = height_m[0] - chain.height_m
        early_s = float(shift @ speed / (speed @ speed))
        if np.abs(shift - early_s * speed).max() <= PROPORTIONAL * np.abs(shift).max():  # else: other start heights
            yield LawRow(EARLY_START, 0, 1 + early_s / step_s, rounding / (fastest * step_s) + 1e-3)
        j = int(np.argmax(np.abs(velocity_m_s[0])))
        mean, change = velocity_m_s[:, j].mean(), float(np.abs(np.diff(velocity_m_s, axis=0)).max())
        if mean:
            late_s = interval - float(np.diff(height_m[:, j])[0] / mean)
            uncertainty = (interval * change + rounding) / abs(mean) / step_s
            yield LawRow(LATE_SAMPLES, 0, 1 + late_s / step_s, uncertainty + MIN_UNCERTAINTY)
        for moving in np.flatnonzero(speed):
            yield LawRow(START_SPEED, int(moving) + 1, float(velocity_m_s[0, moving] / speed[moving]), MIN_UNCERTAINTY)
    overlap = overlaps(chain, height_m[:1])[0]
    for contact in np.flatnonzero(chain.overlap_m * chain.stiffness):
        scene_m = float(chain.overlap_m[contact])
        ratio = float(overlap[contact] / scene_m)
        yield LawRow(START_OVERLAP, int(contact) + 1, ratio, rounding / abs(scene_m) + MIN_UNCERTAINTY)
