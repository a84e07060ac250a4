"""Stability limit of velocity Verlet on a chain: 2 over the highest frequency that its contacts reach.

In three dimensions there are springs of contacts and bore, displacement across the axis and spin. All contacts are
taken at the largest overlaps of the motion, lines of centres along the axis, and the bore on one side. Friction only
cuts shear springs, so that a contact that slides may be stable beyond.
"""

from dataclasses import replace

import numpy as np
from scipy.linalg import eigvals_banded, eigvalsh_tridiagonal

from drivers.chain.chain import Array, Chain, arrays_of, tube_arrays_of
from drivers.chain.contact_law import contact_stiffness, hertz_overlap
from drivers.chain.lateral import block_bands
from drivers.chain.trace import Trace, overlaps
from drivers.limits.energy_bounds import SAFETY, Reached, at_most, bore_stiffness, late_damping, wear
from validation.reference.tube import integrate_tube
from validation.reference.velocity_verlet import integrate_verlet

STEP_TOLERANCE, MAX_ITERATIONS = 1e-9, 100
FINE_STEP_SHARE = 0.125  # of the bounds' step: limits so found are within 0.3 % of exact ones, on 300 random scenes
BODY_STEPS_PER_CHUNK = 1_000_000  # bodies times steps kept at a time
# bodies times steps that are followed, some seconds; what comes later is taken to be alike
MAX_BODY_STEPS, MAX_BODY_STEPS_3D = 500_000_000, 20_000_000
BEGINNING = 0.01  # share of them, followed first: most of what is refused shows there


def predicted_limit(chain: Chain, duration_s: float, share: float = 1.0) -> float:
    """Time step in s beyond which a run of that duration blows up; inf where nothing closes."""
    return stable_step(chain, reached(chain, duration_s, share))


def reached(chain: Chain, duration_s: float, share: float = 1.0) -> Reached:
    """Extremes of a motion, followed at a fine step: all of it, or what a share of the most body steps takes."""
    bounds = at_most(chain, duration_s)
    step = FINE_STEP_SHARE * stable_step(chain, bounds)
    if not np.isfinite(step):
        return bounds
    steps = max(1.0, np.ceil(duration_s / step))
    most = share * (MAX_BODY_STEPS if chain.lateral is None else MAX_BODY_STEPS_3D)
    followed = min(steps, max(1.0, most // chain.bodies))
    follow = _follow if chain.lateral is None else _follow_in_three_dimensions
    found = follow(chain, step, int(followed))
    return replace(found, impacts=found.impacts * steps / followed)


def stable_step(chain: Chain, reached: Reached) -> float:
    """Predicted limit in s, ``SAFETY * 2 / omega_max``; inf for a chain without a contact that closes.

    Stiffnesses are tangents of Hertz's law at the largest overlaps, or at those that a step of that size makes. Many
    impacts lower the limit, and so does damping, which codes have half a step late (``late_damping``).
    """
    safety = SAFETY / wear(reached.impacts)
    step = safety * _limit(chain, reached, 0.0, safety)
    if not np.isfinite(step):  # no overlap to begin with: a step's own
        step = 1.0
    found = step
    for _ in range(MAX_ITERATIONS):
        found = safety * _limit(chain, reached, step, safety)
        if not np.isfinite(found) or abs(found / step - 1) < STEP_TOLERANCE:
            break
        step = (step * found**4) ** 0.2  # where steps make the overlap, found goes with step^(-1/4)
    return found


def _limit(chain: Chain, reached: Reached, step: float, safety: float) -> float:
    """``2 / omega_max`` of the springs that contacts are with steps of that size."""
    normal = late_damping(chain, reached.spring(chain, step), step / safety)
    if chain.lateral is None:
        return linear_limit(chain, normal)
    shear, dragged = np.zeros(chain.bodies), np.zeros(chain.bodies)
    if chain.lateral.friction > 0:
        shear = chain.lateral.shear_stiffness * np.sqrt(np.maximum(reached.deepest_m(step), 0.0))
    pressed = reached.deepest_in_bore_m(step)
    if chain.bore is not None and chain.bore.friction > 0:
        dragged = chain.bore.shear_stiffness * np.sqrt(pressed)
    held = contact_stiffness(bore_stiffness(chain), pressed)
    return linear_sideways_limit(chain, normal, shear, held, dragged)


def linear_limit(chain: Chain, spring_N_m: Array) -> float:
    """``2 / omega_max`` of the chain with springs for contacts, by the eigenvalues of a tridiagonal matrix; or inf."""
    above = np.append(spring_N_m[1:], 0.0)
    mass = chain.mass_kg
    diagonal = (spring_N_m + above) / mass
    beside = -spring_N_m[1:] / np.sqrt(mass[:-1] * mass[1:])
    last = len(mass) - 1
    highest = eigvalsh_tridiagonal(diagonal, beside, select="i", select_range=(last, last))[0] if last else diagonal[0]
    return float(2 / np.sqrt(highest)) if highest > 0 else float("inf")


def linear_sideways_limit(chain: Chain, normal: Array, shear: Array, held: Array, dragged: Array) -> float:
    """``2 / omega_max`` of springs in N/m, by the eigenvalues of banded matrices; or inf.

    In the plane through the axis and the bore's contact each body has a displacement w along the axis, u across it and
    a spin, times its radius, s: contact j strains by ``w_j - w_{j-1}`` and ``u_j - u_{j-1} - s_j - s_{j-1}``, the bore
    by ``u`` and ``w + s``. Across that plane are u, the spin as before and the one about the axis, t: the bore strains
    by ``u + t``. Inertias are m and ``2/5 m``.

    Args:
        chain: the bodies; a level face moves along the axis only.
        normal: of contacts, shape (bodies,).
        shear: of contacts.
        held: by the bore, normal to it.
        dragged: by the bore, along it.
    """
    level = np.isinf(chain.radius_m)
    inverse = np.column_stack([1 / chain.mass_kg, np.where(level, 0, 1 / chain.mass_kg)])
    inverse = np.sqrt(np.column_stack([inverse, 2.5 * inverse[:, 1]]))
    along, across, spin = np.eye(3)
    beside = [(normal, along, -along), (shear, across - spin, -across - spin)]
    within = _highest(inverse, beside, [(held, across), (dragged, along + spin)])
    aside, about = np.eye(3)[1], np.eye(3)[0]  # the axis' place goes to the spin about it
    turned = np.column_stack([inverse[:, 2], inverse[:, 1:]])
    beyond = _highest(turned, [(shear, aside - spin, -aside - spin)], [(dragged, aside + about)])
    highest = max(within, beyond)
    return float(2 / np.sqrt(highest)) if highest > 0 else float("inf")


def _highest(inverse: Array, contacts: list[tuple[Array, Array, Array]], alone: list[tuple[Array, Array]]) -> float:
    """The highest eigenvalue of springs on three coordinates a body.

    Args:
        inverse: roots of the inverse inertias, shape (bodies, 3).
        contacts: springs under each body, how its own coordinates strain them, and how those of the body below do.
        alone: springs of each body with what does not move, and how its coordinates strain them.
    """
    bodies = len(inverse)
    own, beside = np.zeros((bodies, 3, 3)), np.zeros((bodies, 3, 3))
    for spring, here, below in contacts:
        own += spring[:, None, None] * np.outer(here, here)
        own[:-1] += spring[1:, None, None] * np.outer(below, below)
        beside[1:] += spring[1:, None, None] * np.outer(below, here)
    for spring, here in alone:
        own += spring[:, None, None] * np.outer(here, here)
    own *= inverse[:, :, None] * inverse[:, None, :]
    beside[1:] *= inverse[:-1, :, None] * inverse[1:, None, :]
    last = 3 * bodies - 1
    return float(eigvals_banded(block_bands(own, beside[1:]), select="i", select_range=(last, last))[0])


def reached_in(chain: Chain, trace: Trace) -> Reached:
    """Extremes of a straight chain's trace that keeps its state and is sampled finely."""
    assert trace.velocity_m_s is not None
    assert trace.height_m is not None
    overlap, closing, energies = _extremes(chain, trace.force_N, trace.velocity_m_s, overlaps(chain, trace.height_m))
    nothing = np.zeros(chain.bodies)
    return Reached(overlap, closing, nothing, nothing, _counted(energies))


def _follow(chain: Chain, step: float, left: int) -> Reached:
    """Extremes by velocity Verlet of a straight chain, of which no samples are kept."""
    arrays = arrays_of(chain)
    nothing, energies = np.zeros(chain.bodies), np.zeros(0)
    overlap, closing = nothing, nothing
    while left:
        steps = min(left, max(1, BODY_STEPS_PER_CHUNK // chain.bodies))
        motion = integrate_verlet(arrays, step, 1, steps + 1)
        moved = motion.displacement_m
        pressed = arrays.overlap_m + np.column_stack([np.zeros(len(moved)), moved[:, :-1]]) - moved
        deeper, faster, more = _extremes(chain, motion.force_N, motion.velocity_m_s, pressed)
        overlap, closing = np.maximum(overlap, deeper), np.maximum(closing, faster)
        energies = np.append(energies, more)
        arrays = replace(arrays, overlap_m=pressed[-1], velocity_m_s=motion.velocity_m_s[-1])
        left -= steps
    return Reached(overlap, closing, nothing, nothing, _counted(energies))


def _follow_in_three_dimensions(chain: Chain, step: float, steps: int) -> Reached:
    """Extremes by velocity Verlet of a three-dimensional chain."""
    return Reached(**vars(integrate_tube(tube_arrays_of(chain), step, steps, 2).extremes))


def _extremes(chain: Chain, force_N: Array, velocity_m_s: Array, overlap_m: Array) -> tuple[Array, Array, Array]:
    """Largest overlaps and speeds of closing, and ``mu v^2 / 2`` of each impact in J, mu being the reduced mass.

    Overlaps are those of the forces; of damped contacts, whose forces do not tell them, those of the places.
    """
    there = chain.stiffness > 0
    closing = np.column_stack([np.zeros(len(velocity_m_s)), velocity_m_s[:, :-1]]) - velocity_m_s
    closing = np.where((force_N <= 0) & there, np.maximum(closing, 0.0), 0.0)  # 0 where it is closed or opens
    inverse = 1 / chain.mass_kg
    inverse = inverse + np.append(0.0, inverse[:-1])
    energies = (0.5 * closing[:-1] ** 2 / inverse)[(force_N[:-1] <= 0) & (force_N[1:] > 0)]
    largest = np.maximum(overlap_m.max(axis=0), 0.0) if chain.damping_ratio else np.zeros(chain.bodies)
    if not chain.damping_ratio:
        largest[there] = hertz_overlap(chain.stiffness[there], np.maximum(force_N.max(axis=0), 0.0)[there])
    return largest, closing.max(axis=0), energies


def _counted(energies_J: Array) -> float:
    """Impacts counted by the square of their energy over the largest one's: as they count in a random walk."""
    largest = float(energies_J.max(initial=0.0))
    return float(((energies_J / largest) ** 2).sum()) if largest else 0.0
