"""Lower bound of the stability limit of velocity Verlet on a chain, 2 / omega_max.

All contacts are assumed to have their largest stiffness, simultaneously and permanently. Contacts that close one at a
time and only for a few steps may be stable at several times this limit; ``drivers.limits.trial`` tests such steps.

In three dimensions the bound includes shear springs, bore contacts, displacements across the axis and spin. Contacts
are assumed to have the largest overlaps of the motion and lines of centres along the axis, and all beads to touch the
bore on the same side. Sliding only weakens shear springs.
"""

from dataclasses import replace
from math import log
from weakref import WeakKeyDictionary

import numpy as np

from drivers.chain.chain import Array, Chain, arrays_of, energy_put_in, tube_arrays_of
from drivers.chain.contact_law import contact_stiffness
from drivers.chain.lateral import block_bands
from drivers.limits.energy_bounds import SAFETY, at_most, bore_stiffness, deepest_m, late_damping, wear
from validation.reference.hertz_chain import Extremes
from validation.reference.tube import integrate_tube
from validation.reference.velocity_verlet import follow_verlet

STEP_TOLERANCE, MAX_ITERATIONS = 1e-9, 100
# step divided by the energy bound of the limit; 0.01 would change limits by up to 0.3 %, or 2 % with light flying beads
FINE_STEP_SHARE = 0.05
# largest number of bodies times steps integrated, a few seconds; the rest of the run is extrapolated
MAX_BODY_STEPS, MAX_BODY_STEPS_3D = 500_000_000, 20_000_000
FIRST_SHARE = 0.01  # fraction of these steps integrated first; sufficient for most refusals

_limits: WeakKeyDictionary[Chain, dict[tuple[float, float], float]] = WeakKeyDictionary()


def predicted_limit(chain: Chain, duration_s: float, share: float = 1.0) -> float:
    """Lower bound of the stability limit of a run, in s; inf if no contact closes.

    Computed once for each chain, duration and share.
    """
    known = _limits.setdefault(chain, {})
    if (duration_s, share) not in known:
        known[duration_s, share] = stable_step(chain, reached(chain, duration_s, share), duration_s)
    return known[duration_s, share]


def reached(chain: Chain, duration_s: float, share: float = 1.0) -> Extremes:
    """Extremes of the motion, integrated at a fine step for at most the fraction ``share`` of ``MAX_BODY_STEPS``."""
    bounds = at_most(chain, duration_s)
    step = FINE_STEP_SHARE * stable_step(chain, bounds, duration_s)
    if not np.isfinite(step):
        return bounds
    steps = max(1.0, np.ceil(duration_s / step))
    most = share * (MAX_BODY_STEPS if chain.lateral is None else MAX_BODY_STEPS_3D)
    followed = min(steps, max(1.0, most // chain.bodies))
    if chain.lateral is None:
        extremes = follow_verlet(arrays_of(chain), step, int(followed))
    else:
        extremes = integrate_tube(tube_arrays_of(chain), step, int(followed), 2).extremes
    return replace(extremes, impacts_J=extremes.impacts_J * steps / followed)


def stable_step(chain: Chain, reached: Extremes, duration_s: float) -> float:
    """Predicted limit in s, ``SAFETY / wear * 2 / omega_max``; inf for a chain in which no contact closes.

    Contact stiffnesses belong to the largest overlap of the motion, or to the overlap made by one step, if larger.
    Many impacts lower the limit, and so does damping (``late_damping``).
    """
    safety = SAFETY / wear(impacts_counted(chain, reached, duration_s))
    step = safety * _limit(chain, reached, 0.0, safety)
    if not np.isfinite(step):  # no overlap in the motion
        step = 1.0
    limit = step
    for _ in range(MAX_ITERATIONS):
        limit = safety * _limit(chain, reached, step, safety)
        if not np.isfinite(limit) or abs(limit / step - 1) < STEP_TOLERANCE:
            break
        step = (step * limit**4) ** 0.2  # the limit scales as step^(-1/4) if one step makes the overlap
    return limit


def impacts_counted(chain: Chain, reached: Extremes, duration_s: float) -> float:
    """Largest weighted number of impacts of any body.

    An impact has the fraction f of the energy put in. Its error multiplies its energy, so the logarithm of the energy
    is a random walk, which has to cover ``ln (1 + 1/f)`` to gain the energy put in. The number of steps of a random
    walk scales as the square of the distance, so an impact has the weight ``(ln 2 / ln (1 + 1/f))^2``.
    """
    largest = 0.5 * chain.reduced_mass_kg * reached.closing_m_s**2
    hit = (reached.impacts_J > 0) & (largest > 0)
    put_in = max(energy_put_in(chain, duration_s), float(largest.max()))
    counted = np.zeros(chain.bodies + 1)  # contacts under each body and above the last
    counted[:-1][hit] = reached.impacts_J[hit] / largest[hit] * (log(2) / np.log1p(put_in / largest[hit])) ** 2
    return float((counted[:-1] + counted[1:]).max())


def _limit(chain: Chain, reached: Extremes, step: float, safety: float) -> float:
    """``2 / omega_max`` of the contact springs at a given step, in s."""
    deepest = deepest_m(reached.overlap_m, reached.closing_m_s, step)
    spring = contact_stiffness(chain.stiffness, deepest)
    normal = late_damping(chain, spring, reached.speed_m_s, step / safety)
    if chain.lateral is None:
        return linear_limit(chain, normal)
    shear, dragged = np.zeros(chain.bodies), np.zeros(chain.bodies)
    if chain.lateral.friction > 0:
        shear = chain.lateral.shear_stiffness * np.sqrt(deepest)
    pressed = deepest_m(reached.bore_overlap_m, reached.bore_closing_m_s, step)
    if chain.bore is not None and chain.bore.friction > 0:
        dragged = chain.bore.shear_stiffness * np.sqrt(pressed)
    held = contact_stiffness(bore_stiffness(chain), pressed)
    return linear_sideways_limit(chain, normal, shear, held, dragged)


def linear_limit(chain: Chain, spring_N_m: Array) -> float:
    """``2 / omega_max`` in s of a straight chain of springs (a tridiagonal matrix); inf without springs."""
    from scipy.linalg import eigvalsh_tridiagonal

    above = np.append(spring_N_m[1:], 0.0)
    mass = chain.mass_kg
    diagonal = (spring_N_m + above) / mass
    coupling = -spring_N_m[1:] / np.sqrt(mass[:-1] * mass[1:])
    last = len(mass) - 1
    highest = (
        eigvalsh_tridiagonal(diagonal, coupling, select="i", select_range=(last, last))[0] if last else diagonal[0]
    )
    return float(2 / np.sqrt(highest)) if highest > 0 else float("inf")


def linear_sideways_limit(chain: Chain, normal: Array, shear: Array, held: Array, dragged: Array) -> float:
    """``2 / omega_max`` in s of a three-dimensional chain of springs in N/m (banded matrices); inf without springs.

    In the plane through the axis and the bore's contact each body has a displacement w along the axis, u across the
    axis, and s, the spin times the radius. Contact j has the strains ``w_j - w_{j-1}`` and
    ``u_j - u_{j-1} - s_j - s_{j-1}``, the bore contact ``u`` and ``w + s``. Perpendicular to that plane the bore
    contact has the strain ``u + t``, with t for the spin about the axis. Inertias are m and ``2/5 m``.

    Args:
        chain: the chain; a flat face moves along the axis only.
        normal: normal stiffness of contacts, shape (bodies,).
        shear: shear stiffness of contacts.
        held: normal stiffness of the bore contacts.
        dragged: shear stiffness of the bore contacts.
    """
    level = np.isinf(chain.radius_m)
    inverse = np.column_stack([1 / chain.mass_kg, np.where(level, 0, 1 / chain.mass_kg)])
    inverse = np.sqrt(np.column_stack([inverse, 2.5 * inverse[:, 1]]))
    along, across, spin = np.eye(3)
    contacts = [(normal, along, -along), (shear, across - spin, -across - spin)]
    within = _highest(inverse, contacts, [(held, across), (dragged, along + spin)])
    aside, about = np.eye(3)[1], np.eye(3)[0]  # the first coordinate is the spin about the axis here
    turned = np.column_stack([inverse[:, 2], inverse[:, 1:]])
    beyond = _highest(turned, [(shear, aside - spin, -aside - spin)], [(dragged, aside + about)])
    highest = max(within, beyond)
    return float(2 / np.sqrt(highest)) if highest > 0 else float("inf")


def _highest(inverse: Array, contacts: list[tuple[Array, Array, Array]], alone: list[tuple[Array, Array]]) -> float:
    """Largest eigenvalue of springs with three coordinates for each body.

    Args:
        inverse: square roots of the inverse inertias, shape (bodies, 3).
        contacts: for each kind of spring below the bodies: stiffnesses, and strains per coordinate of the body and per
            coordinate of the body below.
        alone: for each kind of spring between body and bore: stiffnesses, and strains per coordinate of the body.
    """
    from scipy.linalg import eigvals_banded

    bodies = len(inverse)
    diagonal, coupling = np.zeros((bodies, 3, 3)), np.zeros((bodies, 3, 3))
    for spring, here, below in contacts:
        diagonal += spring[:, None, None] * np.outer(here, here)
        diagonal[:-1] += spring[1:, None, None] * np.outer(below, below)
        coupling[1:] += spring[1:, None, None] * np.outer(below, here)
    for spring, here in alone:
        diagonal += spring[:, None, None] * np.outer(here, here)
    diagonal *= inverse[:, :, None] * inverse[:, None, :]
    coupling[1:] *= inverse[:-1, :, None] * inverse[1:, None, :]
    last = 3 * bodies - 1
    return float(eigvals_banded(block_bands(diagonal, coupling[1:]), select="i", select_range=(last, last))[0])
