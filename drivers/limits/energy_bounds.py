"""Bounds of the time step by the frequencies that contacts can reach, from energy alone.

A contact's overlap cannot exceed what all the energy that turns into motion could press into it, so its stiffness and
the chain's highest frequency are bounded without following the motion. The bound is within a tenth of the limit for
most scenes; ``drivers.limits.stable_step`` follows the motion where that is not enough.
"""

from functools import lru_cache

import numpy as np

from drivers.chain.chain import Array, Chain, energy_put_in
from drivers.chain.contact_law import contact_stiffness, overlap_of_energy
from validation.reference.hertz_chain import Extremes

SAFETY = 0.968  # of 2 / omega_max, impacts counted: of 2,750 random scenes none blows up below
# overlaps of a first step count so many times: a light body that touches a heavy one gains its own kinetic energy where
# y = (v dt / overlap)^(5/2) has (5/8 y)^2 = 1 + y / 4, which is 2 / omega at 1.195 times the overlap v dt
OVERSHOOT = 1.195
# coarse steps change the energy of impacts at random: of 20,000 bodies that bounce n + 1 times, fewer than one in a
# thousand gains its own energy below (n + 1)^-0.2 of the limit
WEAR_EXPONENT = 0.2


def deepest_m(overlap_m: Array, closing_m_s: Array, time_step_s: float) -> Array:
    """Largest overlaps with steps of that size: the motion's, or one step's at the speed of closing."""
    return np.asarray(np.maximum(overlap_m, OVERSHOOT * closing_m_s * time_step_s))


def late_damping(chain: Chain, spring_N_m: Array, speed_m_s: Array, time_step_s: float) -> Array:
    """``K + 2 D / dt``: springs that are as unstable at a step as damped ones, shape (bodies,), in N/m.

    The codes take the closing speed half a step late, ``M (x+ - 2 x + x-) / dt^2 = -K x - D (x - x-) / dt``, which
    flips from step to step (x+ = -x) at ``4 M / dt^2 = K + 2 D / dt``; a contact has ``D = 2 B sqrt(m* K)``. So a
    single contact of frequency w is stable up to ``(sqrt(1 + B^2) - B) 2 / w``. By a power of the closing speed it has
    ``D = gamma alpha |d'|^(alpha - 1)``, the slope of the force at the speeds given.
    """
    if not chain.damped or not time_step_s:
        return spring_N_m
    if chain.gamma:
        damping = np.where(speed_m_s > 0, chain.damping * chain.alpha * speed_m_s ** (chain.alpha - 1), 0.0)
        return np.asarray(spring_N_m + 2 * damping / time_step_s)
    return np.asarray(spring_N_m + 4 * chain.damping_ratio * np.sqrt(chain.reduced_mass_kg * spring_N_m) / time_step_s)


def wear(impacts: float) -> float:
    """By what impacts beyond the first divide the limit (``drivers.limits.stable_step.impacts_counted``)."""
    return float((1 + impacts) ** WEAR_EXPONENT)


@lru_cache(maxsize=2)
def at_most(chain: Chain, duration_s: float) -> Extremes:
    """Bounds of what contacts and the bore reach, by energy; impacts are not bounded so.

    About equilibrium, a contact that takes up the energy E by a further overlap x has ``E >= (2/5) k x^(5/2)`` and
    ``E >= K x^2 / 2`` with its stiffness K at rest, since Hertz's force curves upwards.
    """
    energy = energy_put_in(chain, duration_s)
    resting = np.maximum(chain.overlap_m, 0.0)
    with np.errstate(divide="ignore", invalid="ignore"):
        by_hertz = overlap_of_energy(chain.stiffness, energy)
        by_spring = np.sqrt(2 * energy / contact_stiffness(chain.stiffness, resting))
    further = np.where(chain.stiffness > 0, np.fmin(by_hertz, by_spring), 0.0)
    inverse = 1 / chain.mass_kg
    closing = np.sqrt(2 * energy * (inverse + np.append(0.0, inverse[:-1]))) * (chain.stiffness > 0)
    bore = bore_stiffness(chain)
    with np.errstate(divide="ignore", invalid="ignore"):  # a straight chain has no bore, and may have no energy
        deepest = np.where(bore > 0, overlap_of_energy(bore, energy), 0.0)
    return Extremes(
        overlap_m=resting + further,
        closing_m_s=closing,
        speed_m_s=closing,
        impacts_J=np.zeros(chain.bodies),
        bore_overlap_m=deepest,
        bore_closing_m_s=np.where(bore > 0, np.sqrt(2 * energy / chain.mass_kg), 0.0),
    )


def bore_stiffness(chain: Chain) -> Array:
    """Hertz stiffness of each body's contact with the bore; 0 where there is none."""
    return np.zeros(chain.bodies) if chain.bore is None else chain.bore.stiffness


@lru_cache(maxsize=2)
def share_at_most(chain: Chain, duration_s: float, time_step_s: float) -> tuple[float, float]:
    """Bounds of the step's share of ``SAFETY * 2 / omega_max``, and of the impacts there can be.

    The highest frequency is bounded by rows of the matrix of springs and masses (Gershgorin). An impact lasts longer
    than ``4 / omega``, and only one at a time has all the energy.
    """
    bounds = at_most(chain, duration_s)
    spring = contact_stiffness(chain.stiffness, deepest_m(bounds.overlap_m, bounds.closing_m_s, time_step_s))
    # the highest K / m of a body that presses into the bore with all the energy; eigenvalues of both add up
    in_bore = float((contact_stiffness(bore_stiffness(chain), bounds.bore_overlap_m) / chain.mass_kg).max())
    highest = float(np.sqrt(_rows(chain, spring).max() + in_bore))
    impacts = duration_s * highest / 4
    if chain.damped:  # 1 / limit is where limit^2 (K + b / limit) = 4, row by row
        late = _rows(chain, late_damping(chain, spring, bounds.speed_m_s, 1.0) - spring)
        highest = float((late + np.sqrt(late**2 + 16 * _rows(chain, spring))).max()) / 4
    return time_step_s * highest / 2 / SAFETY, impacts


def _rows(chain: Chain, spring_N_m: Array) -> Array:
    """What bounds the eigenvalues of springs and masses, row by row. Shape (bodies,)."""
    root = np.sqrt(chain.mass_kg)
    beside = spring_N_m / (root * np.append(np.inf, root[:-1]))
    return np.asarray(
        (spring_N_m + np.append(spring_N_m[1:], 0.0)) / chain.mass_kg + beside + np.append(beside[1:], 0.0)
    )


def certainly_stable(chain: Chain, duration_s: float, time_step_s: float) -> bool:
    """Whether a step is stable by these bounds, which know of straight chains only."""
    if chain.lateral is not None:
        return False
    share, impacts = share_at_most(chain, duration_s, time_step_s)
    return share * wear(impacts) <= 1
