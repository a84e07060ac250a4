"""The linear limit: a long chain under a force F_0, whose top bead has a small speed v at time 0.

For small motions contacts are springs ``K = (3/2) k^(2/3) F_0^(1/3)``. No frequency above ``omega_c = 2 sqrt(K/m)``
propagates, and long waves travel at ``c = 2 R sqrt(K/m)`` (Nesterenko, Dynamics of Heterogeneous Materials, chapter 1).
Until the reflection from the far end arrives, the force in contact n below the top is

    F_n - F_0 = v sqrt(K m) 4 n J_2n(tau) / tau,   tau = omega_c t

which follows from Schroedinger's infinite chain, ``u'_n = v J_2n(tau)`` (Ann. Phys. 44, 916, 1914), with a mirror
image for the free end: ``u'_n = v (J_2n + J_2n+2)`` for the bead n below the top, and ``F_n = K (u_n-1 - u_n)``.
"""

from math import pi, sqrt

import numpy as np
from scipy.optimize import brentq, curve_fit
from scipy.special import jn_zeros, jv, jvp

from drivers.chain.case import Case
from drivers.chain.chain import Array, contact_stiffness_at
from drivers.chain.trace import Trace
from postproc.read.signals import peak_in

UPPER_CONTACT, LOWER_CONTACT = 5, 30  # contacts below the top between which the front is timed
LAST_TAU = 70.0  # end of the top contact's record: some twenty periods
ECHO_TAU = 4  # per bead: time of a long wave to the wall and back


def response(order: int, tau: Array) -> Array:
    """``J_m(tau) / tau`` for orders above 1; 0 at ``tau = 0``. Shape as ``tau``."""
    safe = np.where(tau > 0, tau, 1.0)
    return np.asarray(np.where(tau > 0, jv(order, safe) / safe, 0.0))


def first_maximum(order: int) -> float:
    """Place tau of the first maximum of ``J_m(tau) / tau``: ``tau J_m' = J_m``."""
    ends = 0.9 * order, jn_zeros(order, 1)[0]
    return float(brentq(lambda tau: tau * jvp(order, tau) - jv(order, tau), *ends, xtol=1e-13))


def fit(time_s: Array, force_N: Array, order: int, last_tau: float) -> tuple[float, float, float]:
    """Fits ``J_m(tau) / tau`` with ``tau = rate t`` to a dynamic force by least squares; rate and amplitude are free.

    The fit starts from the first maximum of the record and uses no property of the chain.

    Args:
        time_s: shape (samples,).
        force_N: force above the static value. Shape (samples,).
        order: m, twice the number of the contact below the top.
        last_tau: end of the fit.

    Returns:
        Rate in 1/s, height of the first maximum in N, and root mean square of the residual divided by this height.

    Raises:
        ValueError: there is no maximum, or the record is shorter than the fit.
    """
    top, peak = first_maximum(order), peak_in(time_s, force_N, "no signal within the run")
    rate, height = top / peak.time_s, float(response(order, np.array(top)))
    if rate * time_s[-1] < last_tau:
        raise ValueError(f"run too short: it ends at tau = {rate * time_s[-1]:.3g}, the fit at {last_tau:.3g}")
    used = rate * time_s <= last_tau
    measured = force_N[used] / peak.value

    def model(time: Array, scale: float, amplitude: float) -> Array:
        return amplitude * response(order, scale * rate * time) / height

    (scale, amplitude), _ = curve_fit(model, time_s[used], measured, p0=(1.0, 1.0))
    left = measured - model(time_s[used], scale, amplitude)
    return scale * rate, amplitude * peak.value, float(np.sqrt(np.mean(left**2)) / amplitude)


def measure(case: Case, trace: Trace) -> dict[str, float]:
    """Cutoff frequency from the record of the top contact, speed of sound from the front's arrivals at two contacts.

    The arrival is the first maximum of the response, fitted up to its first zero. By dispersion the maximum at contact
    n is late by ``first_maximum(2 n) - 2 n`` in tau; this exact delay is subtracted.
    """
    beads = case.chain.beads
    if ECHO_TAU * beads < LAST_TAU + 2 * LOWER_CONTACT:
        raise ValueError(f"{beads} beads: the reflection arrives before the signal has passed")
    rate, amplitude, misfit = fit(trace.time_s, _dynamic(case, trace, 1), 2, LAST_TAU)
    near, far = (_arrival(case, trace, place) for place in (UPPER_CONTACT, LOWER_CONTACT))
    spring, mass = _spring(case)
    scale = -4 * float(case.chain.velocity_m_s[-1]) * sqrt(spring * mass)  # the force before J_2(tau) / tau
    steps = first_maximum(2 * LOWER_CONTACT) - first_maximum(2 * UPPER_CONTACT)
    return {
        "cutoff_frequency_Hz": rate / (2 * pi),
        "sound_speed_m_s": float(case.chain.radius_m[-1]) * steps / (far - near),
        "impulse_share": amplitude / float(response(2, np.array(first_maximum(2)))) / scale,
        "misfit": misfit,
    }


def _arrival(case: Case, trace: Trace, place: int) -> float:
    order = 2 * place
    rate, _, _ = fit(trace.time_s, _dynamic(case, trace, place), order, float(jn_zeros(order, 1)[0]))
    return first_maximum(order) / rate


def _dynamic(case: Case, trace: Trace, below: int) -> Array:
    """Force above the static value of the contact ``below`` places under the top bead."""
    column = case.chain.beads - below
    return np.asarray(trace.force_N[:, column] - trace.force_N[0, column])


def _spring(case: Case) -> tuple[float, float]:
    """K and m of a chain of equal beads."""
    chain = case.chain
    stiffness, mass = float(chain.stiffness[-1]), float(chain.mass_kg[-1])
    return contact_stiffness_at(stiffness, chain.precompression_N), mass


def theory(case: Case) -> dict[str, float]:
    """Values by the formulas at the top of this module."""
    spring, mass = _spring(case)
    return {
        "cutoff_frequency_Hz": sqrt(spring / mass) / pi,
        "sound_speed_m_s": 2 * float(case.chain.radius_m[-1]) * sqrt(spring / mass),
        "impulse_share": 1.0,
        "misfit": 0.0,
    }


QUANTITIES = {
    "cutoff_frequency_Hz": "highest frequency that propagates",
    "sound_speed_m_s": "speed of long waves",
    "impulse_share": "amplitude of the top contact's record, divided by 4 v sqrt(K m)",
    "misfit": "deviation of the top contact's record from J_2(tau)/tau, divided by the peak",
}
SOURCE = "K = (3/2) k^(2/3) F_0^(1/3), omega_c = 2 sqrt(K/m), c = 2 R sqrt(K/m), F - F_0 ~ J_2(omega_c t)/t"
