"""Diagnosis of a wrong run of a straight chain: its law by its own motion, and the one change that explains it.

It judges nothing. Masses, stiffnesses and dissipation are measured as ratios to the scene's, from recorded heights,
velocities and forces, wherever a contact or body moved enough to tell. Then single changes of the scene are tried: each
is integrated in this repository, its factor fitted to the forces of the run, and it is named only if it leaves no more
than rounding explains.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cache, partial
from typing import Any, NamedTuple

import numpy as np

from drivers.chain.case import Case
from drivers.chain.chain import Array, Chain, arrays_of, furthest_m
from drivers.chain.residual import FORCE, largest_change_N
from drivers.chain.schemes import heights_and_reach
from drivers.chain.trace import Trace, overlaps
from drivers.laws.viscoelastic import Viscoelastic
from drivers.run.scheme import Scheme, apart
from postproc.read.signals import integral
from validation.reference.hertz_chain import COLUMNS, SINES, contact_force, hertz_force
from validation.reference.velocity_verlet import integrate_verlet_absolute

MIN_SAMPLES = 12
ROUNDINGS = 8.0  # rounding errors of a height, in an overlap
SURE = 1e-2  # largest uncertainty of a ratio that is told
SIGNIFICANT = 5.0  # uncertainties by which a ratio differs
TOLD = 3  # largest number of ratios in a sentence
CANDIDATES = 3  # contacts and bodies that are tried, besides those of the first departure
MAX_TRIES, FITTED, PROBE = 12, 1e-13, 1e-6  # of a fit; change of the factor at its end, and for its slope
MAX_DRAGGED_STEPS, MAX_WORK = 200_000, 20_000_000  # steps of a loop in Python; bodies times steps of a trial


@dataclass(frozen=True)
class Ratio:
    """Value of a run divided by the scene's, of a contact or body counted from the wall.

    Attributes:
        quantity: ``stiffness``, ``dissipation`` or ``mass``.
    """

    quantity: str
    place: int
    ratio: float
    uncertainty: float

    @property
    def off(self) -> float:
        """Difference from the scene's value divided by the uncertainty."""
        return abs(self.ratio - 1) / self.uncertainty

    def __str__(self) -> str:
        where = "bead" if self.quantity == "mass" else "contact"
        return f"{self.quantity} of {where} {self.place} {self.ratio:.9g} ± {self.uncertainty:.1g}"


class Change(NamedTuple):
    """A change of the scene: words with the factor, the forces of a run with a factor, and the first factor to try."""

    words: str
    forces: Callable[[float], Array]
    first: float | None = 1.0  # None: nothing to fit


def diagnosis(case: Case, engine: str, trace: Trace) -> str:
    """Sentence on the change of the scene that explains a run, or on the largest ratios of its law."""
    scheme, chain = Scheme(case, ""), case.chain
    if chain.lateral is not None:
        return "only straight chains are diagnosed"
    samples = min(scheme.samples, len(trace.time_s))
    if samples < MIN_SAMPLES or case.work > MAX_WORK:
        return f"not diagnosed: {samples} samples, {case.work:g} bodies times steps"
    right, force = scheme.of(engine).force_N[:samples], trace.force_N[:samples]
    limits = scheme.explained(FORCE)[:samples]
    table = measured_ratios(case, trace)
    beyond = apart(force, right, scheme.scale(FORCE)) > limits[:, np.newaxis]
    first = int(np.argmax(beyond[np.argmax(beyond.any(axis=1))]))
    for change in _changes(case, first, table):
        if sentence := _explains(change, force, limits):
            return sentence
    told = [str(row) for row in table if row.off > SIGNIFICANT][:TOLD]
    return f"no single change explains it; largest: {', '.join(told) or 'no ratio of its law differs'}"


def measured_ratios(case: Case, trace: Trace) -> list[Ratio]:
    """Ratios of a run's own law to the scene's, the surest difference first; empty without heights and velocities.

    Least squares of ``F = r k d^(3/2) + s C d^p d'`` over the samples at which a contact is closed, and of
    ``r m (v - v(0)) = integral of the net force`` for each body. The integral over samples and the rounding of heights
    make a ratio uncertain.
    """
    chain = case.chain
    if trace.height_m is None or trace.velocity_m_s is None:
        return []
    state = np.hstack([trace.force_N, trace.height_m, trace.velocity_m_s])
    samples = int(np.argmin(np.append(np.isfinite(state).all(axis=1), False)))
    force, height, velocity = np.split(state[:samples], 3, axis=1)
    time_s, overlap = trace.time_s[:samples], overlaps(chain, height)
    above = np.column_stack([force[:, 1:], np.zeros(samples)])
    earlier = velocity - 0.5 * case.scene.time_step_s * (force - above + chain.load_N) / chain.mass_kg
    closing = np.column_stack([np.zeros(samples), earlier[:, :-1]]) - earlier
    rounding = ROUNDINGS * float(np.spacing(furthest_m(chain)))
    rows = []
    for j in np.flatnonzero(chain.stiffness):
        closed = (overlap[:, j] > 0) & (force[:, j] != 0)
        columns = [hertz_force(chain.stiffness[j], overlap[closed, j])]
        if chain.damped:
            columns.append(chain.law.force(chain.damping[j], overlap[closed, j], closing[closed, j]))
        if closed.sum() < MIN_SAMPLES:
            continue
        wrong = 1.5 * rounding / float(np.ptp(overlap[closed, j]) or rounding) + 1e-12
        for name, (ratio, error) in zip(("stiffness", "dissipation"), _fitted(columns, force[closed, j]), strict=False):
            rows.append(Ratio(name, int(j) + 1, ratio, error + wrong))
    driven = chain.drive.body if chain.drive else -1
    for j in (place for place in range(chain.bodies) if place != driven and samples >= MIN_SAMPLES):
        gained, net = velocity[:, j] - velocity[0, j], force[:, j] - above[:, j] + chain.load_N[j]
        impulse, coarse = integral(time_s, net), integral(time_s[::2], net[::2])
        sampling = float(np.abs(impulse[::2] - coarse).max()) / (
            chain.mass_kg[j] * float(np.abs(gained).max()) or 1e-300
        )
        ((ratio, error),) = _fitted([gained * chain.mass_kg[j]], impulse)
        rows.append(Ratio("mass", j + 1, ratio, error + sampling + 1e-12))
    return sorted((row for row in rows if row.uncertainty < SURE), key=lambda row: -row.off)


def _fitted(columns: list[Array], target: Array) -> list[tuple[float, float]]:
    """Coefficients of columns by least squares, with their standard errors; infinite ones if they are not determined."""
    matrix = np.column_stack(columns)
    sizes = np.abs(matrix).max(axis=0)
    if not sizes.all():
        return [(1.0, np.inf)] * len(columns)
    scaled = matrix / sizes
    solution, _, rank, _ = np.linalg.lstsq(scaled, target)
    if rank < len(columns):
        return [(1.0, np.inf)] * len(columns)
    variance = float(((target - scaled @ solution) ** 2).sum()) / (len(target) - len(columns))
    errors = np.sqrt(variance * np.diag(np.linalg.inv(scaled.T @ scaled)))
    return [*zip((solution / sizes).tolist(), (errors / sizes).tolist(), strict=True)]


def _explains(change: Change, force_N: Array, limits: Array) -> str:
    """Words of a change that explains forces to within their limits, with its fitted factor; else empty."""
    factor, samples = change.first, len(force_N)
    with np.errstate(all="ignore"):
        for _ in range(MAX_TRIES):
            made = change.forces(1.0 if factor is None else factor)[:samples]
            if (apart(force_N, made, largest_change_N(made)) <= limits[:, np.newaxis]).all():
                return change.words.format("" if factor is None else f"{factor:.9g}")
            if factor is None or not np.isfinite(made).all():
                return ""
            slope = (change.forces(factor + PROBE)[:samples] - made) / PROBE
            step = float((slope * (force_N - made)).sum() / ((slope**2).sum() or np.inf))
            if not abs(step) > FITTED:
                return ""
            factor += float(np.clip(step, -0.5, 0.5))
    return ""


def _changes(case: Case, first: int, table: list[Ratio]) -> Iterator[Change]:
    """Changes to try: of time, start and drive, of all contacts or bodies, then of those that differ or depart first."""
    chain, arrays, step_s, every = (
        case.chain,
        arrays_of(case.chain),
        case.scene.time_step_s,
        case.scene.steps_per_sample,
    )
    height, reach = heights_and_reach(case)
    bodies = np.arange(chain.bodies)

    def forces(*timing: Any, height: Array = height, **changed: Any) -> Array:
        """Forces of a changed chain; its dissipation follows from stiffnesses and masses, unless that is given."""
        other = replace(chain, **{name: changed[name] for name in ("mass_kg", "stiffness") if name in changed})
        damping = chain.law.coefficient(other.stiffness, other.reduced_mass_kg)
        moved = replace(arrays, **({"damping": damping} | changed))
        return integrate_verlet_absolute(moved, height, reach, *(timing or (step_s, every, case.scene.samples))).force_N

    def median(quantity: str) -> float:
        return float(np.median([row.ratio for row in table if row.quantity == quantity] or [1.0]))

    yield Change("a time step {} times the scene's", lambda r: forces(r * step_s, every, case.scene.samples))
    all_steps = cache(lambda: forces(step_s, 1, case.scene.steps + 1 + every))
    for steps, words in ((1, "one step early"), (-1, "one step late"), (every, "one sample early")):
        place = np.maximum(np.arange(case.scene.samples) * every + steps, 0)
        later = np.append(0, place[1:])
        yield Change(f"samples after the first are {words}", lambda _, at=later: all_steps()[at], None)
        yield Change(f"all samples are {words}", lambda _, at=place: all_steps()[at], None)
    speed, load, drive = chain.velocity_m_s, chain.load_N, chain.drive
    if speed.any():
        yield Change("start speeds {} times the scene's", lambda r: forces(velocity_m_s=r * speed))
        for sign, words in ((0.5, "ahead"), (-0.5, "behind")):
            shifted = speed + sign * step_s * chain.acceleration_m_s2
            yield Change(f"velocities start half a step {words}", lambda _, v=shifted: forces(velocity_m_s=v), None)
    if load.any():
        touching = height - np.cumsum(np.minimum(chain.overlap_m, 0.0) - chain.overlap_m)
        yield Change("loads {} times the scene's", lambda r: forces(load_N=r * load))
        yield Change("bodies start just touching", lambda _: forces(height=touching), None)
    if drive is not None:
        sized = np.isin(np.arange(COLUMNS), (1, 2, *SINES))
        louder = lambda r: replace(drive, segments=drive.segments * np.where(sized, r, 1.0))  # noqa: E731
        yield Change("a drive {} times the scene's", lambda r: forces(drive=louder(r)))
    if chain.damped:
        lossy = median("dissipation")
        yield Change("dissipation {} times the scene's", lambda r: forces(damping=abs(r) * chain.damping), lossy)
    else:
        by_ratio = Viscoelastic(1.0).coefficient(chain.stiffness, chain.reduced_mass_kg)
        yield Change("contacts with a damping ratio of {}", lambda r: forces(damping=abs(r) * by_ratio), 0.01)
    if case.scene.steps <= MAX_DRAGGED_STEPS:
        yield Change("non-viscous damping of {}", lambda r: _dragged(case, r, 0.0), 0.1)
        yield Change("a viscous drag of {} N s/m on each body", lambda r: _dragged(case, 0.0, r), 0.0)
    pairs = np.array([f"{a} with {b}" for a, b in zip(chain.materials, (chain.wall, *chain.materials), strict=False)])
    for quantity, noun in (("stiffness", "contact"), ("mass", "bead")):
        sure = [row.place - 1 for row in table if row.quantity == quantity and row.off > SIGNIFICANT][:CANDIDATES]
        near = [place for place in (first - 1, first, first + 1) if 0 <= place < chain.bodies]
        groups = {f"all {noun}s": bodies >= 0}
        groups |= {f"contacts of {pair}": pairs == pair for pair in {*pairs}} if quantity == "stiffness" else {}
        groups |= {f"{noun} {place + 1}": bodies == place for place in dict.fromkeys([*sure, *near])}
        for name, at in groups.items():
            of_group = [row.ratio for row in table if row.quantity == quantity and at[row.place - 1]]
            guess = float(np.median(of_group or [1.0]))
            if quantity == "stiffness":
                stiffer = partial(_stiffer, forces, chain.stiffness, at)
                yield Change(f"{name} {{}} times as stiff", stiffer, guess)
            for weight_N, words in ((chain.gravity_m_s2 * chain.mass_kg, ""), (0 * load, ", but not of its weight")):
                if quantity == "mass":
                    heavier = partial(_heavier, forces, chain, at, weight_N)
                    yield Change(f"{name} with {{}} of its mass{words}", heavier, guess)


def _stiffer(forces: Callable[..., Array], stiffness: Array, at: Array, factor: float) -> Array:
    return forces(stiffness=np.where(at, factor, 1.0) * stiffness)


def _heavier(forces: Callable[..., Array], chain: Chain, at: Array, weight_N: Array, factor: float) -> Array:
    more = np.where(at, factor, 1.0)
    return forces(mass_kg=more * chain.mass_kg, load_N=chain.load_N - (more - 1) * weight_N)


def _dragged(case: Case, local: float, viscous: float) -> Array:
    """Forces with Cundall's damping, ``a (1 - local sign(a v))``, or a drag ``-viscous v`` with v of half a step before.

    Both are those of the codes: YADE's ``damping``, with v predicted for the time of the forces, and ``fix viscous``.
    """
    chain, step_s, every = case.chain, case.scene.time_step_s, case.scene.steps_per_sample
    arrays, overlap, kept = arrays_of(case.chain), chain.overlap_m.copy(), []
    velocity = chain.velocity_m_s - 0.5 * step_s * chain.acceleration_m_s2
    for step in range(case.scene.steps + 1):
        force = contact_force(arrays, overlap, velocity)
        kept += [force] if step % every == 0 else []
        net = force - np.append(force[1:], 0.0) + chain.load_N - viscous * velocity
        acceleration = net / chain.mass_kg
        predicted = velocity + 0.5 * step_s * acceleration
        velocity = velocity + step_s * acceleration * (1 - local * np.sign(acceleration * predicted))
        overlap = overlap + step_s * -np.diff(velocity, prepend=0.0)
    return np.array(kept)
