"""Lower bound of the stability limit from energy alone, and the exactness of the reference that an error needs.

The total energy bounds each overlap, and so each contact stiffness and the highest frequency, without integrating the
motion. For most scenes the bound is within a tenth of the limit; ``drivers.limits.stable_step`` integrates the motion
if a closer bound is needed.
"""

from functools import lru_cache
from math import floor, log10

import numpy as np

from drivers.chain.case import Case
from drivers.chain.chain import Array, Chain, energy_put_in
from drivers.chain.contact_law import contact_stiffness, hertz_force, overlap_of_energy
from validation.reference.adaptive import MIN_TOLERANCE
from validation.reference.hertz_chain import EXPONENT, Extremes

SAFETY = 0.968  # factor on 2 / omega_max; below this limit none of 2,750 random scenes blows up
# Factor on the overlap v dt of the first step of an impact. A light body that hits a heavy one doubles its kinetic
# energy if y = (v dt / overlap)^(5/2) solves (5/8 y)^2 = 1 + y / 4; then dt = 2 / omega at 1.195 times that overlap.
OVERSHOOT = 1.195
# Coarse steps change the energy of impacts at random. At steps below (n + 1)^-0.2 of the limit, fewer than one in a
# thousand of 20,000 bodies that bounce n + 1 times doubled its energy.
WEAR_EXPONENT = 0.2
EXACT_SHARE = 1e-3  # of an error: allowed error of the exact motion against which it is measured
MAX_TOLERANCE = 1e-6  # of the reference, whose own values count as exact


def deepest_m(overlap_m: Array, closing_m_s: Array, time_step_s: float) -> Array:
    """Largest overlaps at a given step, in m: of the motion, or of one step at the closing speed, if larger."""
    return np.asarray(np.maximum(overlap_m, OVERSHOOT * closing_m_s * time_step_s))


def late_damping(chain: Chain, spring_N_m: Array, speed_m_s: Array, time_step_s: float) -> Array:
    """Stiffness ``K + 2 D / dt`` of undamped springs with the same stability limit as the damped contacts.

    The codes use the closing speed of half a step before, ``M (x+ - 2 x + x-) / dt^2 = -K x - D (x - x-) / dt`` with
    the slope D of the dissipative force. The solution alternates in sign (x+ = -x) at ``4 M / dt^2 = K + 2 D / dt``.
    With ``D = 2 B sqrt(m* K)`` a single contact of frequency w is stable up to ``(sqrt(1 + B^2) - B) 2 / w``.

    Returns:
        Stiffness in N/m, shape (bodies,).
    """
    if not chain.damped or not time_step_s:
        return spring_N_m
    root = np.divide(spring_N_m, EXPONENT * chain.stiffness, out=np.zeros(chain.bodies), where=chain.stiffness > 0)
    slope = chain.law.slope(chain.damping, root**2, speed_m_s)
    return np.asarray(spring_N_m + 2 * slope / time_step_s)


def wear(impacts: float) -> float:
    """Divisor of the stability limit for a number of impacts (``drivers.limits.stable_step.impacts_counted``)."""
    return float((1 + impacts) ** WEAR_EXPONENT)


@lru_cache(maxsize=2)
def at_most(chain: Chain, duration_s: float) -> Extremes:
    """Energy bounds on overlaps and speeds of contacts and bore contacts; energies of impacts are set to 0.

    If a contact at equilibrium, with tangent stiffness K, takes up the energy E by an additional overlap x, then
    ``E >= (2/5) k x^(5/2)`` and ``E >= K x^2 / 2``, since Hertz's force is convex.
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
    with np.errstate(divide="ignore", invalid="ignore"):  # without a bore the stiffness is 0; the energy may be 0
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
    """Hertz stiffness of each body's contact with the bore; 0 without a bore."""
    return np.zeros(chain.bodies) if chain.bore is None else chain.bore.stiffness


@lru_cache(maxsize=2)
def share_at_most(chain: Chain, duration_s: float, time_step_s: float) -> tuple[float, float]:
    """Upper bounds of the ratio of the step to ``SAFETY * 2 / omega_max``, and of the number of impacts.

    The highest frequency is bounded by the row sums of the stiffness matrix (Gershgorin). An impact lasts longer than
    ``4 / omega``, and only one impact at a time can have all the energy.
    """
    bounds = at_most(chain, duration_s)
    spring = contact_stiffness(chain.stiffness, deepest_m(bounds.overlap_m, bounds.closing_m_s, time_step_s))
    # largest K / m of a body pressed into the bore with all the energy; the eigenvalues add up
    in_bore = float((contact_stiffness(bore_stiffness(chain), bounds.bore_overlap_m) / chain.mass_kg).max())
    highest = float(np.sqrt(_rows(chain, spring).max() + in_bore))
    impacts = duration_s * highest / 4
    if chain.damped:  # solves limit^2 (K + b / limit) = 4 for each row
        late = _rows(chain, late_damping(chain, spring, bounds.speed_m_s, 1.0) - spring)
        highest = float((late + np.sqrt(late**2 + 16 * _rows(chain, spring))).max()) / 4
    return time_step_s * highest / 2 / SAFETY, impacts


def _rows(chain: Chain, spring_N_m: Array) -> Array:
    """Row sums that bound the eigenvalues of springs and masses (Gershgorin), shape (bodies,)."""
    root = np.sqrt(chain.mass_kg)
    coupling = spring_N_m / (root * np.append(np.inf, root[:-1]))
    return np.asarray(
        (spring_N_m + np.append(spring_N_m[1:], 0.0)) / chain.mass_kg + coupling + np.append(coupling[1:], 0.0)
    )


def certainly_stable(chain: Chain, duration_s: float, time_step_s: float) -> bool:
    """True if the energy bounds prove that the step is stable; always False for three-dimensional scenes."""
    if chain.lateral is not None:
        return False
    share, impacts = share_at_most(chain, duration_s, time_step_s)
    return share * wear(impacts) <= 1


def needed_tolerance(case: Case) -> float:
    """Tolerance of the reference that determines the force error of a run to 1 %: a power of ten.

    At a step of x times the stability limit, the force error of velocity Verlet is 0.25 x^2 times the largest change
    or more on all shipped scenes. Powers of ten let cases of similar steps share a run of the reference.
    """
    chain, duration = case.chain, case.duration_s
    force = hertz_force(chain.stiffness, at_most(chain, duration).overlap_m)
    change = float((force - chain.elastic_N).max() / (force.max() or 1.0))
    share, _ = share_at_most(chain, duration, case.scene.time_step_s)
    return float(10.0 ** floor(log10(min(max(EXACT_SHARE * share**2 * change, MIN_TOLERANCE), MAX_TOLERANCE))))
