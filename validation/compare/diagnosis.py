"""Diagnosis of a wrong run of a straight chain: its law by its own motion, and the one change that explains it.

It judges nothing. Masses, stiffnesses and dissipation are measured as ratios to the scene's, from recorded heights,
velocities and forces, wherever a contact or body moved enough to tell. Then single changes of the scene are tried: each
is integrated in this repository, its factor fitted to the forces of the run, and it is named only if it leaves no more
than rounding explains.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from drivers.chain.case import Case
from drivers.chain.chain import Array, arrays_of, furthest_m, hertz_stiffness, stiffness_by
from drivers.chain.schemes import heights_and_reach
from drivers.chain.trace import FORCE, Trace, finite_part, largest_change_N, overlaps
from drivers.engines import INCREMENTAL, load_engine
from drivers.laws import viscoelastic
from drivers.run.scheme import Scheme, scheme_of
from postproc.read.signals import integral
from validation.reference.hertz_chain import HertzChain, contact_force, hertz_force
from validation.reference.velocity_verlet import integrate_verlet_absolute

MIN_SAMPLES = 12
ROUNDINGS = 8.0  # rounding errors of a height, in an overlap
SURE = 1e-2  # largest uncertainty of a ratio that is told
SIGNIFICANT = 5.0  # uncertainties by which a ratio differs
TOLD = 3  # largest number of ratios in a sentence
CANDIDATES = 3  # contacts and bodies that are tried alone
MAX_TRIES, CONVERGED, PROBE = 12, 0.9, 1e-6  # of a fit; ratio of squares at its end; change of the factor for its slope
MAX_DRAGGED_STEPS, MAX_WORK = 20_000, 2_000_000  # steps of a loop in Python; bodies times steps of a trial


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


Places = NDArray[np.bool_]  # contacts or bodies of a group. Shape (bodies,)
Values = dict[str, Any]  # changed values of a chain
# words of a change of the scene with its factor, changed values by the factor, and the first factor to try
Change = tuple[str, Callable[[float], Values], float]


def diagnosis(case: Case, engine: str, trace: Trace) -> tuple[str, str]:
    """First departure of a run, finished or failed, from its scheme, and its cause; empty if there is none."""
    scheme = scheme_of(case, engine)
    try:
        departure = scheme.departure(engine, trace)
    except ArithmeticError:  # no exact motion to compare a run of ``reference`` with
        departure = ""
    return (departure, _cause(scheme, engine, trace)) if departure else ("", "")


def _cause(scheme: Scheme, engine: str, trace: Trace) -> str:
    """The change of the scene that explains a run, else the largest ratios of its law."""
    case, samples = scheme.case, min(scheme.samples, len(trace.time_s))
    if not case.chain.straight or samples < MIN_SAMPLES or case.work > MAX_WORK:
        return f"no cause sought with {samples} samples, {case.work:g} bodies times steps, or in three dimensions"
    force, table = trace.force_N[:samples], measured_ratios(case, trace)
    limits_N = scheme.explained(FORCE)[:samples, np.newaxis] * max(scheme.scales[FORCE], largest_change_N(force))
    early = load_engine(engine).shear == INCREMENTAL
    for change in _changes(case, trace, table):
        if sentence := _explains(case, change, force, limits_N, early=early):
            return sentence
    told = [str(row) for row in table if row.off > SIGNIFICANT][:TOLD]
    return (
        f"no single change explains it; {'largest: ' * bool(told)}{', '.join(told) or 'its law is that of the scene'}"
    )


def measured_ratios(case: Case, trace: Trace) -> list[Ratio]:
    """Ratios of a run's own law to the scene's, the surest difference first; empty without heights and velocities.

    Least squares of ``F = r k d^(3/2) + s C d^p d'`` over the samples at which a contact is closed, and of
    ``r m (v - v(0)) = integral of the net force`` for each body. The integral over samples and the rounding of heights
    make a ratio uncertain.
    """
    chain, step_s = case.chain, case.scene.time_step_s
    part = finite_part(trace)
    if part is None or part.height_m is None or part.velocity_m_s is None:
        return []
    time_s, force, velocity, overlap = part.time_s, part.force_N, part.velocity_m_s, overlaps(chain, part.height_m)
    samples = len(time_s)
    above = np.column_stack([force[:, 1:], np.zeros(samples)])
    earlier = velocity - 0.5 * step_s * (force - above + chain.load_N) / chain.mass_kg
    closing = np.column_stack([np.zeros(samples), earlier[:, :-1]]) - earlier
    rounding = ROUNDINGS * float(np.spacing(furthest_m(chain)))
    rows = []
    for j in np.flatnonzero(chain.stiffness).tolist():
        closed = (overlap[:, j] > 0) & (force[:, j] != 0)
        columns = [hertz_force(chain.stiffness[j], overlap[closed, j])]
        if chain.damped:
            columns.append(chain.law.force(chain.damping[j], overlap[closed, j], closing[closed, j]))
        if closed.sum() < MIN_SAMPLES:
            continue
        wrong = 1.5 * rounding / float(np.ptp(overlap[closed, j]) or rounding) + 1e-12
        for name, (ratio, error) in zip(("stiffness", "dissipation"), _fitted(columns, force[closed, j]), strict=False):
            rows.append(Ratio(name, j + 1, ratio, error + wrong))
    driven = chain.drive.body if chain.drive else -1
    for j in (place for place in range(chain.bodies) if place != driven and samples >= MIN_SAMPLES):
        gained, net = velocity[:, j] - velocity[0, j], force[:, j] - above[:, j] + chain.load_N[j]
        impulse, coarse = integral(time_s, net), integral(time_s[::2], net[::2])
        # the integral over samples, and the sum over steps by which the scheme takes it
        off = np.abs(impulse[::2] - coarse).max() + step_s**2 * np.abs(np.gradient(net, time_s)).max()
        off /= chain.mass_kg[j] * np.abs(gained).max() or 1e-300
        ((ratio, error),) = _fitted([gained * chain.mass_kg[j]], impulse)
        rows.append(Ratio("mass", j + 1, ratio, error + float(off) + 1e-12))
    return sorted((row for row in rows if row.uncertainty < SURE), key=lambda row: -row.off)


def _fitted(columns: list[Array], target: Array) -> list[tuple[float, float]]:
    """Coefficients of columns by least squares, with standard errors; infinite ones if they are not determined."""
    matrix = np.column_stack(columns)
    sizes = np.abs(matrix).max(axis=0) + 1e-300
    scaled = matrix / sizes
    solution, _, rank, _ = np.linalg.lstsq(scaled, target)
    if rank < len(columns):
        return [(1.0, np.inf)] * len(columns)
    variance = float(((target - scaled @ solution) ** 2).sum()) / (len(target) - len(columns))
    errors = np.sqrt(variance * np.diag(np.linalg.inv(scaled.T @ scaled)))
    return [*zip((solution / sizes).tolist(), (errors / sizes).tolist(), strict=True)]


def _explains(case: Case, change: Change, force_N: Array, limits_N: Array, *, early: bool) -> str:
    """Words of a change that explains forces to within their limits, with its fitted factor; else empty."""
    (words, changed, factor), samples, before = change, len(force_N), np.inf
    with np.errstate(all="ignore"):
        for _ in range(MAX_TRIES):
            made = _forces(case, changed(factor), early=early)[:samples]
            off = np.abs(force_N - made)
            if (off <= limits_N).all():
                return words.format(f"{abs(factor):.7g}")
            if not (off**2).sum() < CONVERGED * before:
                break
            before = float((off**2).sum())
            slope = (_forces(case, changed(factor + PROBE), early=early)[:samples] - made) / PROBE
            step = float((slope * (force_N - made)).sum() / (slope**2).sum())
            factor += min(max(step, -0.5), 0.5)
    return ""


def _changes(case: Case, trace: Trace, table: list[Ratio]) -> Iterator[Change]:
    """Changes to try: of step, start, loads and damping, of all contacts or bodies, of those that differ most."""
    chain, materials, scene = case.chain, case.scene.materials, case.scene
    speed, everywhere = chain.velocity_m_s, np.ones(chain.bodies, bool)

    def guess(quantity: str, at: Places = everywhere) -> float:
        return float(np.median([row.ratio for row in table if row.quantity == quantity and at[row.place - 1]] or [1.0]))

    def groups(noun: str, quantity: str) -> dict[str, Places]:
        surest = [row.place for row in table if row.quantity == quantity][:CANDIDATES]
        single = {f"{noun} {place}": np.arange(chain.bodies) == place - 1 for place in surest}
        return {f"all {noun}s": everywhere} | single

    def stiffer(at: Places, factor: float) -> Values:
        return {"stiffness": np.where(at, factor, 1.0) * chain.stiffness}

    def heavier(at: Places, factor: float) -> Values:
        mass_kg = np.where(at, factor, 1.0) * chain.mass_kg
        return {"mass_kg": mass_kg, "load_N": chain.load_N - chain.gravity_m_s2 * (mass_kg - chain.mass_kg)}

    def harder(name: str, factor: float) -> Values:
        changed = materials[name].model_copy(update={"youngs_modulus": abs(factor) * materials[name].youngs_modulus})
        other = scene.model_copy(update={"materials": materials | {name: changed}})
        return {"stiffness": stiffness_by(hertz_stiffness, other, chain.materials, chain.radius_m)}

    slower = 1.0
    if trace.velocity_m_s is not None and speed.any():
        slower = float(trace.velocity_m_s[0] @ speed / (speed @ speed))
    by_ratio = viscoelastic(1.0).coefficient(chain.stiffness, chain.reduced_mass_kg)
    dragged = float(scene.steps <= MAX_DRAGGED_STEPS and chain.drive is None)
    for words, name, value, factor in (
        ("a time step {} times the scene's", "time_step_s", scene.time_step_s, 1 / guess("mass")),
        ("start speeds {} times the scene's", "velocity_m_s", speed, slower),
        ("loads {} times the scene's", "load_N", chain.load_N, 1.0),
        ("dissipation {} times the scene's", "damping", chain.damping, guess("dissipation")),
        ("contacts with a damping ratio of {}", "damping", 0.0 if chain.damped else by_ratio, 0.01),
        ("non-viscous damping of {}", "local", dragged, 0.1),
        ("a viscous drag of {} N s/m on each body", "viscous", dragged, 0.0),
    ):
        if np.any(value):
            yield words, partial(_times, name, value), factor
    for name in sorted({*chain.materials, chain.wall or ""} & {*materials}):
        yield f"Young's modulus of {name} {{}} times the scene's", partial(harder, name), guess("stiffness")
    pairs = np.array([f"{a} with {b}" for a, b in zip(chain.materials, (chain.wall, *chain.materials), strict=False)])
    contacts, beads = groups("contact", "stiffness"), groups("bead", "mass")
    for name, at in (contacts | {f"contacts of {pair}": pairs == pair for pair in sorted({*pairs})}).items():
        yield f"{name} {{}} times as stiff", partial(stiffer, at), guess("stiffness", at)
    for name, at in beads.items():
        yield f"{name} with {{}} of its mass", partial(heavier, at), guess("mass", at)


def _times(name: str, value: Any, factor: float) -> Values:
    return {name: factor * value}


def _forces(case: Case, changed: Values, *, early: bool) -> Array:
    """Forces of a case with some values of its chain changed. Shape (samples, bodies).

    They are those that an adapter would read. YADE gives the forces of contacts, and its deck (``early``) has the
    velocities of half a step before time 0, by the forces of the scene. The others give net forces on bodies, from
    which the adapter subtracts the loads of the scene from the lowest body upwards. Besides arrays of ``HertzChain``,
    ``changed`` may have a time step and the coefficients of ``_dragged``.
    """
    scene, chain, values = case.scene, case.chain, dict(changed)
    step_s = float(values.pop("time_step_s", scene.time_step_s))
    drag = [float(values.pop(name, 0.0)) for name in ("local", "viscous")]
    bent = replace(chain, **{name: values[name] for name in ("mass_kg", "stiffness") if name in values})
    arrays = replace(arrays_of(bent), **values | {name: abs(values[name]) for name in ("damping",) if name in values})
    if early:
        gained = 0.5 * scene.time_step_s * (arrays.acceleration_m_s2 - arrays_of(chain).acceleration_m_s2)
        arrays = replace(arrays, velocity_m_s=arrays.velocity_m_s + gained)
    if any(drag):
        return _dragged(case, arrays, *drag)
    where, counts = heights_and_reach(case), (scene.steps_per_sample, scene.samples)
    forces = integrate_verlet_absolute(arrays, *where, step_s, *counts).force_N
    return forces if early else np.asarray(forces - np.append(0.0, np.cumsum(arrays.load_N - chain.load_N)[:-1]))


def _dragged(case: Case, chain: HertzChain, local: float, viscous: float) -> Array:
    """Forces with Cundall's damping, or with a drag, which is part of the forces that a code gives.

    Cundall's is ``a (1 - local sign(a v))`` with v predicted for the time of the forces, as in YADE; the drag is
    ``-viscous v`` with v of half a step before, as in LAMMPS.
    """
    step_s, overlap, kept = case.scene.time_step_s, chain.overlap_m.copy(), []
    drag = -viscous * chain.velocity_m_s
    velocity = chain.velocity_m_s - 0.5 * step_s * (case.chain.acceleration_m_s2 + drag / chain.mass_kg)
    for step in range(case.scene.steps + 1):
        force = contact_force(chain, overlap, velocity)
        drag = -viscous * velocity if step else drag
        if step % case.scene.steps_per_sample == 0:
            kept.append(force - np.append(0.0, np.cumsum(drag)[:-1]))
        acceleration = (force - np.append(force[1:], 0.0) + chain.load_N + drag) / chain.mass_kg
        against = np.sign(acceleration * (velocity + 0.5 * step_s * acceleration))
        velocity = velocity + step_s * acceleration * (1 - local * against)
        overlap = overlap - step_s * np.diff(velocity, prepend=0.0)
    return np.array(kept)
