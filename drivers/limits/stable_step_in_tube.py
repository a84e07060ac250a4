"""The stability limit in three dimensions: springs of contacts and bore, with displacement across the axis and spin.

All contacts are taken at the largest overlaps of the motion, lines of centres along the axis, and the bore on one side.
Friction only cuts shear springs, so that a contact that slides may be stable beyond.
"""

from dataclasses import dataclass

import numpy as np
from scipy.linalg import eigvals_banded

from drivers.chain.chain import Array, Chain, energy_put_in
from drivers.chain.contact_law import contact_stiffness, overlap_of_energy
from drivers.chain.integrator_arrays import tube_arrays_of
from drivers.limits.energy_bounds import OVERSHOOT, SAFETY, Reached, at_most, late_damping, wear
from validation.reference.tube import integrate_tube

CONVERGED, MOST_TRIES = 1e-9, 100
FINE = 0.125  # of the bounds' step, as for straight chains
MOST = 20_000_000  # bodies times steps that are followed, some seconds


@dataclass(frozen=True)
class SidewaysReached:
    """What contacts and the bore reach in a motion.

    Attributes:
        contacts: of the contacts between bodies.
        bore: likewise of each body with the bore; no impacts.
    """

    contacts: Reached
    bore: Reached


def predicted_sideways_limit(chain: Chain, duration_s: float) -> float:
    """The time step in s beyond which a three-dimensional run of that duration blows up; inf where nothing closes."""
    return sideways_stable_step(chain, sideways_reached(chain, duration_s))


def sideways_reached(chain: Chain, duration_s: float) -> SidewaysReached:
    """What a motion reaches, followed at a fine step: all of it, or where that takes long its beginning."""
    bounds = _bounds(chain, duration_s)
    step = FINE * sideways_stable_step(chain, bounds)
    if not np.isfinite(step):
        return bounds
    steps = max(1.0, np.ceil(duration_s / step))
    followed = min(steps, max(1.0, MOST // chain.bodies))
    found = integrate_tube(tube_arrays_of(chain), step, int(followed), 2).extremes
    contacts = Reached(found.overlap_m, found.closing_m_s, found.impacts * steps / followed)
    return SidewaysReached(contacts, Reached(found.bore_overlap_m, found.bore_closing_m_s, 0.0))


def _bounds(chain: Chain, duration_s: float) -> SidewaysReached:
    """The same by energy alone."""
    contacts, bore = at_most(chain, duration_s), _bore_stiffness(chain)
    energy = energy_put_in(chain, duration_s)
    with np.errstate(divide="ignore"):
        deepest = np.where(bore > 0, overlap_of_energy(bore, energy), 0.0)
    closing = np.where(bore > 0, np.sqrt(2 * energy / chain.mass_kg), 0.0)
    return SidewaysReached(contacts, Reached(deepest, closing, 0.0))


def sideways_stable_step(chain: Chain, reached: SidewaysReached) -> float:
    """The predicted limit in s for what a motion reaches, as ``drivers.limits.stable_step.stable_step``."""
    safety = SAFETY / wear(reached.contacts.impacts)
    step = safety * _limit(chain, reached, 0.0, safety)
    if not np.isfinite(step):
        step = 1.0
    found = step
    for _ in range(MOST_TRIES):
        found = safety * _limit(chain, reached, step, safety)
        if not np.isfinite(found) or abs(found / step - 1) < CONVERGED:
            break
        step = (step * found**4) ** 0.2
    return found


def _limit(chain: Chain, reached: SidewaysReached, step: float, safety: float) -> float:
    assert chain.lateral is not None
    normal = reached.contacts.spring(chain, step)
    overlap = np.maximum(reached.contacts.overlap_m, OVERSHOOT * reached.contacts.closing_m_s * step)
    pressed = np.maximum(reached.bore.overlap_m, OVERSHOOT * reached.bore.closing_m_s * step)
    pressed = np.maximum(pressed, 0.0)
    bore = chain.lateral.bore
    slips = chain.lateral.friction > 0
    shear = chain.lateral.shear_stiffness * np.sqrt(np.maximum(overlap, 0.0)) if slips else np.zeros(chain.bodies)
    held = contact_stiffness(_bore_stiffness(chain), pressed)
    dragged = np.zeros(chain.bodies)
    if bore is not None and bore.friction > 0:
        dragged = bore.shear_stiffness * np.sqrt(pressed)
    normal = late_damping(chain, normal, step / safety)
    return linear_sideways_limit(chain, normal, shear, held, dragged)


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
    bands = np.zeros((6, 3 * bodies))
    for row in range(3):
        for column in range(3):
            if column >= row:
                bands[5 - (column - row), column::3] = own[:, row, column]
            bands[5 - (column + 3 - row), 3 + column :: 3] = beside[1:, row, column]
    last = 3 * bodies - 1
    return float(eigvals_banded(bands, select="i", select_range=(last, last))[0])


def _bore_stiffness(chain: Chain) -> Array:
    lateral = chain.lateral
    return np.zeros(chain.bodies) if lateral is None or lateral.bore is None else lateral.bore.stiffness
