"""One impact, of two spheres or of a sphere on a plane: peak force, peak overlap, duration, restitution.

Hertz's law ``F = k d^(3/2)`` with the reduced mass m* and the speed v at which the bodies meet gives

    d_max = (5 m* v^2 / (4 k))^(2/5),   F_max = k d_max^(3/2),   duration = 2 I d_max / v,
    I = integral from 0 to 1 of dx / sqrt(1 - x^(5/2)) = sqrt(pi) Gamma(7/5) / Gamma(9/10)

(Landau and Lifshitz, Theory of Elasticity, problem 9.1; Johnson, Contact Mechanics, section 11.4).
"""

from math import gamma, pi, sqrt

import numpy as np

from drivers.chain.case import Case
from drivers.chain.chain import Array, hertz_force
from drivers.chain.trace import Trace, overlaps
from drivers.laws import VISCOELASTIC, restitution_of
from postproc.read.signals import peak_in

DURATION = 2 * sqrt(pi) * gamma(7 / 5) / gamma(9 / 10)  # in d_max / v: 2.94328


def measure(case: Case, trace: Trace) -> dict[str, float]:
    """Peak force, peak overlap, restitution, and for elastic bodies the duration."""
    contact = case.chain.bodies - 1  # the top contact
    force = trace.force_N[:, contact]
    closed = np.flatnonzero(force > 0)
    if closed.size < 4 or closed[0] == 0 or closed[-1] == len(force) - 1:
        raise ValueError("the bodies do not meet and separate within run.duration")
    if trace.height_m is None or trace.velocity_m_s is None:
        raise ValueError("no state recorded; set run.record to forces and state")
    overlap = overlaps(case.chain, trace.height_m)[:, contact]
    strongest, deepest = (peak_in(trace.time_s, signal, "the force has no maximum") for signal in (force, overlap))
    values = {"peak_force_N": strongest.value, "peak_overlap_m": deepest.value}
    values["restitution"] = -_closing(trace.velocity_m_s[-1], contact) / _closing(trace.velocity_m_s[0], contact)
    if not case.chain.damped:
        values["duration_s"] = _duration(trace.time_s, force)
    return values


def _duration(time_s: Array, force_N: Array) -> float:
    """Time from closing to opening, by linear extrapolation of ``F^(2/3)``, which is proportional to the overlap.

    The next term of the overlap is of power 7/2 in time: 1/400 of the impact after closing it is linear to 1e-8.
    """
    overlap = np.cbrt(np.maximum(force_N, 0.0)) ** 2
    closed = np.flatnonzero(overlap)

    def zero(near: int, far: int) -> float:
        slope = (overlap[far] - overlap[near]) / (time_s[far] - time_s[near])
        return float(time_s[near] - overlap[near] / slope)

    return zero(closed[-1], closed[-2]) - zero(closed[0], closed[1])


def theory(case: Case) -> dict[str, float]:
    """Hertz's closed form for elastic bodies; the scene's restitution."""
    chain, contact = case.chain, case.chain.bodies - 1
    if np.count_nonzero(chain.stiffness) != 1 or chain.load_N.any():
        raise ValueError("a case with loads or with more than one contact")
    if chain.law.name == VISCOELASTIC:
        return {"restitution": restitution_of(chain.law.value)}
    speed = _closing(chain.velocity_m_s, contact)
    mass, stiffness = float(chain.reduced_mass_kg[contact]), float(chain.stiffness[contact])
    deepest = (5 * mass * speed**2 / (4 * stiffness)) ** 0.4
    return {
        "restitution": 1.0,
        "peak_force_N": hertz_force(stiffness, deepest),
        "peak_overlap_m": deepest,
        "duration_s": DURATION * deepest / speed,
    }


def _closing(velocity_m_s: Array, contact: int) -> float:
    """Closing speed of the bodies at a contact, negative when they separate."""
    below = float(velocity_m_s[contact - 1]) if contact else 0.0
    return below - float(velocity_m_s[contact])


QUANTITIES = {
    "peak_force_N": "largest contact force",
    "peak_overlap_m": "largest overlap, from the bodies' heights",
    "duration_s": "time from closing to opening of the contact",
    "restitution": "separation speed divided by impact speed",
}
SOURCE = "Hertz's impact in closed form (Johnson, Contact Mechanics, 11.4)"
