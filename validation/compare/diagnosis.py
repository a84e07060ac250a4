"""Diagnosis of a wrong run of a straight chain: the one change of the scene that explains it.

It judges nothing. Single changes of the scene are tried: each is integrated in this repository, its factor fitted to
the forces of the run, and it is named only if it leaves no more than rounding explains. Stiffnesses and masses by the
run's own motion say where to begin, and are told if no single change explains the run.
"""

from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from drivers.chain.case import Case
from drivers.chain.chain import Array, arrays_of, build_chain
from drivers.chain.schemes import heights_and_reach
from drivers.chain.trace import FORCE, Trace, finite_part, largest_change_N, overlaps
from drivers.engines import load_engine
from drivers.laws import viscoelastic
from drivers.run.scheme import scheme_of
from postproc.read.signals import integral
from validation.reference.hertz_chain import HertzChain, contact_force, hertz_force
from validation.reference.tube import INCREMENTAL
from validation.reference.velocity_verlet import integrate_verlet_absolute

MIN_SAMPLES = 12
LITTLE = 1e-2  # of the largest force or momentum: less tells no ratio
TOLD, SIGNIFICANT = 3, 1e-3  # number of ratios in a sentence, and their least difference from 1
CANDIDATES = 8  # contacts and beads that are tried alone
MAX_TRIES, CONVERGED, PROBE = 12, 0.9, 1e-6  # of a fit; ratio of squares at its end; change of the factor for its slope
MAX_DRAGGED_STEPS, MAX_WORK = 20_000, 2_000_000  # steps of a loop in Python; bodies times steps of a trial

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
    if not departure:
        return "", ""
    samples = min(scheme.samples, len(trace.time_s))
    if not case.chain.straight or samples < MIN_SAMPLES or case.work > MAX_WORK:
        size = f"with {samples} samples and {case.work:g} bodies times steps"
        return departure, f"no cause sought {size if case.chain.straight else 'in three dimensions'}"
    force, (stiffness, mass) = trace.force_N[:samples], own_ratios(case, trace)
    limits_N = scheme.explained(FORCE)[:samples, np.newaxis] * max(scheme.scales[FORCE], largest_change_N(force))
    early = load_engine(engine).shear == INCREMENTAL
    for change in _changes(case, trace, stiffness, mass):
        if cause := _explains(case, change, force, limits_N, early=early):
            return departure, cause
    ratios = {f"stiffness of contact {place}": ratio for place, ratio in enumerate(stiffness.tolist(), 1)}
    ratios |= {f"mass of bead {place}": ratio for place, ratio in enumerate(mass.tolist(), 1)}
    furthest = sorted(ratios, key=lambda words: -abs(ratios[words] - 1))[:TOLD]
    told = ", ".join(f"{words} {ratios[words]:.5g}" for words in furthest if abs(ratios[words] - 1) > SIGNIFICANT)
    return departure, f"no single change explains it; {f'largest: {told}' if told else 'masses and stiffnesses agree'}"


def own_ratios(case: Case, trace: Trace) -> tuple[Array, Array]:
    """Stiffness of each contact and mass of each bead by a run's own motion, divided by the scene's. Shape (bodies,).

    Least squares of ``F = r k d^(3/2)``, less the scene's dissipative force, over the samples at which a contact is
    closed, and of ``r m (v - v(0)) = integral of the net force`` for each bead. They are 1 where little moves, and
    without heights and velocities.
    """
    chain, part = case.chain, finite_part(trace)
    if part is None or part.height_m is None or part.velocity_m_s is None:
        return np.ones(chain.bodies), np.ones(chain.bodies)
    force, overlap = part.force_N, overlaps(chain, part.height_m)
    net = chain.load_N - np.diff(force, axis=1, append=0.0)
    earlier = part.velocity_m_s - 0.5 * case.scene.time_step_s * net / chain.mass_kg
    closed, overlap = (force != 0) & (overlap > 0), np.maximum(overlap, 0.0)
    lost = chain.law.force(chain.damping, overlap, -np.diff(earlier, axis=1, prepend=0.0)) if chain.damped else 0.0
    gained = chain.mass_kg * (part.velocity_m_s - part.velocity_m_s[0])
    if chain.drive:
        gained[:, chain.drive.body] = 0.0
    impulse = np.column_stack([integral(part.time_s, column) for column in net.T])
    return _slopes(closed * hertz_force(chain.stiffness, overlap), force - lost), _slopes(gained, impulse)


def _slopes(scene: Array, own: Array) -> Array:
    """Slope of each column against the scene's by least squares through 0; 1 where the scene's are small."""
    squares, sizes = (scene**2).sum(axis=0), np.abs(scene).max(axis=0)
    moved = sizes > LITTLE * sizes.max()
    return np.where(moved, (own * scene).sum(axis=0) / np.where(moved, squares, 1.0), 1.0)


def _explains(case: Case, change: Change, force_N: Array, limits_N: Array, *, early: bool) -> str:
    """Words of a change that explains forces to within their limits, with its fitted factor; else empty."""
    (words, changed, factor), samples, before = change, len(force_N), np.inf
    with np.errstate(all="ignore"):
        for _ in range(MAX_TRIES):
            made = _forces(case, changed(abs(factor)), early=early)[:samples]
            off = force_N - made
            if (np.abs(off) <= limits_N).all():
                return words.format(f"{abs(factor):.7g}")
            if not (off**2).sum() < CONVERGED * before:
                break
            before = float((off**2).sum())
            slope = (_forces(case, changed(abs(factor + PROBE)), early=early)[:samples] - made) / PROBE
            step = float((slope * off).sum() / (slope**2).sum())
            if not np.isfinite(step):
                break
            factor += min(max(step, -0.5), 0.5)
    return ""


def _changes(case: Case, trace: Trace, stiffness: Array, mass: Array) -> Iterator[Change]:
    """Changes to try: of step, start, loads and damping, of all contacts or beads, of those that differ most."""
    chain, materials, scene = case.chain, case.scene.materials, case.scene
    speed, places = chain.velocity_m_s, np.arange(chain.bodies)

    def times(name: str, value: Any, factor: float) -> Values:
        return {name: factor * value}

    def lighter(factor: float) -> Values:  # of a dump of total forces, from which the loads of the scene are subtracted
        return times("load_N", chain.load_N, factor) | {"read": (factor - 1) * np.cumsum(chain.load_N[::-1])[::-1]}

    def stiffer(at: NDArray[np.bool_], factor: float) -> Values:
        return {"stiffness": np.where(at, factor, 1.0) * chain.stiffness}

    def heavier(at: NDArray[np.bool_], factor: float) -> Values:
        mass_kg = np.where(at, factor, 1.0) * chain.mass_kg
        return {"mass_kg": mass_kg, "load_N": chain.load_N - scene.axial_gravity * (mass_kg - chain.mass_kg)}

    def harder(name: str, factor: float) -> Values:
        changed = materials[name].model_copy(update={"youngs_modulus": factor * materials[name].youngs_modulus})
        return {"stiffness": build_chain(scene.model_copy(update={"materials": materials | {name: changed}})).stiffness}

    slower = 1.0
    if trace.velocity_m_s is not None and speed.any():
        slower = float(trace.velocity_m_s[0] @ speed / (speed @ speed))
    by_ratio = viscoelastic(1.0).coefficient(chain.stiffness, chain.reduced_mass_kg)
    dragged = float(scene.steps <= MAX_DRAGGED_STEPS and chain.drive is None)
    for words, name, value, factor in (
        ("a time step {} times the scene's", "time_step_s", scene.time_step_s, 1 / _furthest(mass)),
        ("start speeds {} times the scene's", "velocity_m_s", speed, slower),
        ("loads {} times the scene's", "load_N", chain.load_N, 1.0),
        ("dissipation {} times the scene's", "damping", chain.damping, 1.0),
        ("contacts with a damping ratio of {}", "damping", 0.0 if chain.damped else by_ratio, 0.01),
        ("non-viscous damping of {}", "local", dragged, 0.1),
        ("a viscous drag of {} N s/m on each body", "viscous", dragged, 0.0),
    ):
        if np.any(value):
            yield words, partial(times, name, value), factor
    if chain.load_N.any():
        yield "loads {} times the scene's", lighter, 1.0
    for noun, words, changed, ratio in (
        ("contact", "{} times as stiff", stiffer, stiffness),
        ("bead", "with {} of its mass", heavier, mass),
    ):
        yield f"all {noun}s {words}", partial(changed, places >= 0), _furthest(ratio)
        for place in np.argsort(-np.abs(ratio - 1))[:CANDIDATES].tolist():
            yield f"{noun} {place + 1} {words}", partial(changed, places == place), float(ratio[place])
    for name in sorted({*chain.materials, chain.wall or ""} & {*materials}):
        yield f"Young's modulus of {name} {{}} times the scene's", partial(harder, name), _furthest(stiffness)


def _furthest(ratios: Array) -> float:
    """The ratio that differs most from 1."""
    return float(ratios[np.argmax(np.abs(ratios - 1))])


def _forces(case: Case, changed: Values, *, early: bool) -> Array:
    """Forces of a case with some values of its chain changed. Shape (samples, bodies).

    YADE's deck (``early``) has the velocities of half a step before time 0, by the forces of the scene. Besides arrays
    of ``HertzChain``, ``changed`` may have a time step and the coefficients of ``_dragged``.
    """
    scene, chain = case.scene, case.chain
    step_s, read_N = changed.pop("time_step_s", scene.time_step_s), changed.pop("read", 0.0)
    local, viscous = changed.pop("local", 0.0), changed.pop("viscous", 0.0)
    arrays = replace(arrays_of(chain), **changed)
    if early:
        gained = 0.5 * scene.time_step_s * (arrays.acceleration_m_s2 - arrays_of(chain).acceleration_m_s2)
        arrays = replace(arrays, velocity_m_s=arrays.velocity_m_s + gained)
    if local or viscous:
        return _dragged(case, arrays, local, viscous)
    timing = step_s, scene.steps_per_sample, scene.samples
    return np.asarray(integrate_verlet_absolute(arrays, *heights_and_reach(case), *timing).force_N + read_N)


def _dragged(case: Case, chain: HertzChain, local: float, viscous: float) -> Array:
    """Forces with Cundall's damping, or with a drag.

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
            kept.append(force)
        acceleration = (force - np.append(force[1:], 0.0) + chain.load_N + drag) / chain.mass_kg
        against = np.sign(acceleration * (velocity + 0.5 * step_s * acceleration))
        velocity = velocity + step_s * acceleration * (1 - local * against)
        overlap = overlap - step_s * np.diff(velocity, prepend=0.0)
    return np.array(kept)
