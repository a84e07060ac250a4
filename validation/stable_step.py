"""The stability limit of velocity Verlet on a chain: 2 over the highest frequency that its contacts reach."""

import numpy as np
from scipy.linalg import eigvalsh_tridiagonal

from drivers.chain import Array, Chain
from drivers.stability import SAFETY, Reached, at_most
from drivers.trace import Trace
from validation.arrays import arrays_of
from validation.reference.hertz_chain import HertzChain
from validation.reference.verlet import integrate_verlet

CONVERGED = 1e-9
FINE = 0.125  # of the bound's step: limits so found are within 0.3 % of exact ones, on 300 random scenes
AT_ONCE = 1_000_000  # bodies times steps kept at a time
MOST = 500_000_000  # bodies times steps that are followed, some seconds; beyond, bounds by energy have to do


def predicted_limit(chain: Chain, duration_s: float) -> float:
    """The time step in s beyond which a run of that duration blows up."""
    return stable_step(chain, reached(chain, duration_s))


def reached(chain: Chain, duration_s: float) -> Reached:
    """What contacts reach in a motion, followed at a step that is certainly stable; bounds where that takes long."""
    bounds = at_most(chain, duration_s)
    step = FINE * stable_step(chain, bounds)
    if not np.isfinite(step) or chain.bodies * duration_s / step > MOST:
        return bounds
    return _followed(chain, step, max(1, int(np.ceil(duration_s / step))))


def stable_step(chain: Chain, reached: Reached) -> float:
    """The predicted limit in s, ``SAFETY * 2 / omega_max``; inf for a chain without a contact that closes.

    Stiffnesses are tangents of Hertz's law at the largest overlaps, or at those that a step of that size makes.
    """
    step = SAFETY * linear_limit(chain, reached.spring(chain, 0.0))
    if not np.isfinite(step):  # no overlap to begin with: a step's own
        step = 1.0
    while True:
        found = SAFETY * linear_limit(chain, reached.spring(chain, step))
        if not np.isfinite(found) or abs(found / step - 1) < CONVERGED:
            return found
        step = (step * found**4) ** 0.2  # where steps make the overlap, found goes with step^(-1/4)


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
    """What contacts reach in a trace that keeps its velocities."""
    assert trace.velocity_m_s is not None
    return _reached(chain, trace.force_N, trace.velocity_m_s)


def _followed(chain: Chain, step: float, left: int) -> Reached:
    """What contacts reach by velocity Verlet, of which no samples are kept."""
    arrays = arrays_of(chain)
    overlap, closing = np.zeros(chain.bodies), np.zeros(chain.bodies)
    while left:
        steps = min(left, max(1, AT_ONCE // chain.bodies))
        motion = integrate_verlet(arrays, step, 1, steps + 1)
        part = _reached(chain, motion.force_N, motion.velocity_m_s)
        overlap, closing = np.maximum(overlap, part.overlap_m), np.maximum(closing, part.closing_m_s)
        moved = motion.displacement_m[-1]
        pressed = arrays.overlap_m + np.append(0.0, moved[:-1]) - moved
        arrays = HertzChain(arrays.mass_kg, arrays.stiffness, pressed, motion.velocity_m_s[-1], arrays.load_N)
        left -= steps
    return Reached(overlap, closing)


def _reached(chain: Chain, force_N: Array, velocity_m_s: Array) -> Reached:
    there = chain.stiffness > 0
    overlap = np.zeros(chain.bodies)
    overlap[there] = (np.maximum(force_N.max(axis=0), 0.0)[there] / chain.stiffness[there]) ** (2 / 3)
    closing = np.column_stack([np.zeros(len(velocity_m_s)), velocity_m_s[:, :-1]]) - velocity_m_s
    opened = (force_N <= 0) & there
    return Reached(overlap, np.where(opened, np.maximum(closing, 0.0), 0.0).max(axis=0))
