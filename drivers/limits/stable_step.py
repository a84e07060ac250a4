"""The stability limit of velocity Verlet on a chain: 2 over the highest frequency that its contacts reach."""

from dataclasses import replace

import numpy as np
from scipy.linalg import eigvalsh_tridiagonal

from drivers.chain.chain import Array, Chain
from drivers.chain.contact_law import hertz_overlap
from drivers.chain.integrator_arrays import arrays_of
from drivers.chain.trace import Trace, overlaps
from drivers.limits.energy_bounds import SAFETY, Reached, at_most, late_damping, wear
from drivers.limits.stable_step_in_tube import predicted_sideways_limit, sideways_reached
from validation.reference.velocity_verlet import integrate_verlet

CONVERGED, MOST_TRIES = 1e-9, 100
FINE = 0.125  # of the bound's step: limits so found are within 0.3 % of exact ones, on 300 random scenes
AT_ONCE = 1_000_000  # bodies times steps kept at a time
MOST = 500_000_000  # bodies times steps that are followed, some seconds; what comes later is taken to be alike


def predicted_limit(chain: Chain, duration_s: float) -> float:
    """The time step in s beyond which a run of that duration blows up."""
    if chain.lateral is not None:
        return predicted_sideways_limit(chain, duration_s)
    return stable_step(chain, reached(chain, duration_s))


def reached(chain: Chain, duration_s: float) -> Reached:
    """What contacts reach in a motion, followed at a fine step: all of it, or where that takes long its beginning."""
    if chain.lateral is not None:
        return sideways_reached(chain, duration_s).contacts
    bounds = at_most(chain, duration_s)
    step = FINE * stable_step(chain, bounds)
    if not np.isfinite(step):
        return bounds
    steps = max(1.0, np.ceil(duration_s / step))
    followed = min(steps, max(1.0, MOST // chain.bodies))
    found = _followed(chain, step, int(followed))
    return replace(found, impacts=found.impacts * steps / followed)


def stable_step(chain: Chain, reached: Reached) -> float:
    """The predicted limit in s, ``SAFETY * 2 / omega_max``; inf for a chain without a contact that closes.

    Stiffnesses are tangents of Hertz's law at the largest overlaps, or at those that a step of that size makes. Many
    impacts lower the limit, and so does damping, which codes have half a step late (``late_damping``).
    """
    safety = SAFETY / wear(reached.impacts)
    step = safety * linear_limit(chain, reached.spring(chain, 0.0))
    if not np.isfinite(step):  # no overlap to begin with: a step's own
        step = 1.0
    found = step
    for _ in range(MOST_TRIES):
        found = safety * linear_limit(chain, late_damping(chain, reached.spring(chain, step), step / safety))
        if not np.isfinite(found) or abs(found / step - 1) < CONVERGED:
            break
        step = (step * found**4) ** 0.2  # where steps make the overlap, found goes with step^(-1/4)
    return found


def linear_limit(chain: Chain, spring_N_m: Array) -> float:
    """``2 / omega_max`` of the chain with springs for contacts, by the eigenvalues of a tridiagonal matrix; or inf."""
    above = np.append(spring_N_m[1:], 0.0)
    mass = chain.mass_kg
    diagonal = (spring_N_m + above) / mass
    beside = -spring_N_m[1:] / np.sqrt(mass[:-1] * mass[1:])
    last = len(mass) - 1
    highest = eigvalsh_tridiagonal(diagonal, beside, select="i", select_range=(last, last))[0] if last else diagonal[0]
    return float(2 / np.sqrt(highest)) if highest > 0 else float("inf")


def reached_in(chain: Chain, trace: Trace) -> Reached:
    """What contacts reach in a trace that keeps its velocities and is sampled finely."""
    assert trace.velocity_m_s is not None
    speed = _closing_speeds(chain, trace.force_N, trace.velocity_m_s)
    impacts = _counted(_impact_energies(chain, trace.force_N, speed))
    if chain.damping_ratio:  # forces do not tell overlaps
        assert trace.height_m is not None
        return Reached(np.maximum(overlaps(chain, trace.height_m).max(axis=0), 0.0), speed.max(axis=0), impacts)
    return Reached(_largest_overlaps(chain, trace.force_N), speed.max(axis=0), impacts)


def _followed(chain: Chain, step: float, left: int) -> Reached:
    """What contacts reach by velocity Verlet, of which no samples are kept."""
    arrays = arrays_of(chain)
    overlap, closing, energies = np.zeros(chain.bodies), np.zeros(chain.bodies), np.zeros(0)
    while left:
        steps = min(left, max(1, AT_ONCE // chain.bodies))
        motion = integrate_verlet(arrays, step, 1, steps + 1)
        moved = motion.displacement_m
        if chain.damping_ratio:  # forces do not tell overlaps
            pressed = arrays.overlap_m + np.column_stack([np.zeros(len(moved)), moved[:, :-1]]) - moved
            overlap = np.maximum(overlap, pressed.max(axis=0))
        else:
            overlap = np.maximum(overlap, _largest_overlaps(chain, motion.force_N))
        speed = _closing_speeds(chain, motion.force_N, motion.velocity_m_s)
        closing = np.maximum(closing, speed.max(axis=0))
        energies = np.append(energies, _impact_energies(chain, motion.force_N, speed))
        pressed = arrays.overlap_m + np.append(0.0, moved[-1, :-1]) - moved[-1]
        arrays = replace(arrays, overlap_m=pressed, velocity_m_s=motion.velocity_m_s[-1])
        left -= steps
    return Reached(overlap, closing, _counted(energies))


def _largest_overlaps(chain: Chain, force_N: Array) -> Array:
    there = chain.stiffness > 0
    overlap = np.zeros(chain.bodies)
    overlap[there] = hertz_overlap(chain.stiffness[there], np.maximum(force_N.max(axis=0), 0.0)[there])
    return overlap


def _closing_speeds(chain: Chain, force_N: Array, velocity_m_s: Array) -> Array:
    """Speed at which each open contact closes, at each sample; 0 where it is closed or opens."""
    closing = np.column_stack([np.zeros(len(velocity_m_s)), velocity_m_s[:, :-1]]) - velocity_m_s
    return np.where((force_N <= 0) & (chain.stiffness > 0), np.maximum(closing, 0.0), 0.0)


def _impact_energies(chain: Chain, force_N: Array, closing_m_s: Array) -> Array:
    """``mu v^2 / 2`` of each closing of a contact, in J; mu is the two bodies' reduced mass. Shape (impacts,)."""
    inverse = 1 / chain.mass_kg
    inverse = inverse + np.append(0.0, inverse[:-1])
    energy = 0.5 * closing_m_s[:-1] ** 2 / inverse
    return np.asarray(energy[(force_N[:-1] <= 0) & (force_N[1:] > 0)])


def _counted(energies_J: Array) -> float:
    """Impacts counted by the square of their energy over the largest one's: as they count in a random walk."""
    largest = float(energies_J.max(initial=0.0))
    return float(((energies_J / largest) ** 2).sum()) if largest else 0.0
