"""The linear limit: a long chain held by a force F_0, its top bead given a small speed v at time 0.

Small motions see springs ``K = (3/2) k^(2/3) F_0^(1/3)``. No frequency above ``omega_c = 2 sqrt(K/m)`` travels, and
long waves travel at ``c = 2 R sqrt(K/m)`` (Nesterenko, Dynamics of Heterogeneous Materials, chapter 1). Until the far
end answers, contact n below the top carries

    F_n - F_0 = v sqrt(K m) 4 n J_2n(tau) / tau,   tau = omega_c t

which follows from Schroedinger's infinite chain, ``u'_n = v J_2n(tau)`` (Ann. Phys. 44, 916, 1914), with a mirror
image for the free end: ``u'_n = v (J_2n + J_2n+2)`` for the bead n below the top, and ``F_n = K (u_n-1 - u_n)``.
"""

from dataclasses import dataclass
from math import pi, sqrt

import numpy as np
from scipy.optimize import brentq, curve_fit
from scipy.special import jn_zeros, jv, jvp

from drivers.chain.case import Case
from drivers.chain.chain import Array
from drivers.chain.contact_law import contact_stiffness_at
from drivers.chain.trace import Trace
from postproc.read.signals import first_peak

UPPER_CONTACT, LOWER_CONTACT = 5, 30  # contacts below the top, between which the front is timed
LAST_TAU = 70.0  # of the top contact's record: some twenty periods
ECHO = 4  # in tau, per bead of the chain: from the top to the wall and back, at the speed of long waves


@dataclass(frozen=True)
class Fit:
    """``J_m(tau) / tau`` with ``tau = rate t`` through a record; ``amplitude_N`` is the height of its first maximum.

    Attributes:
        misfit: root mean square of what is left, over the amplitude.
    """

    rate_per_s: float
    amplitude_N: float
    misfit: float


def response(order: int, tau: Array) -> Array:
    """``J_m(tau) / tau``, which is 0 at 0 for the orders above 1 that occur. Shape as ``tau``."""
    safe = np.where(tau > 0, tau, 1.0)
    return np.asarray(np.where(tau > 0, jv(order, safe) / safe, 0.0))


def first_maximum(order: int) -> float:
    """Where ``J_m(tau) / tau`` has its first maximum: ``tau J_m' = J_m``."""
    ends = 0.9 * order, jn_zeros(order, 1)[0]
    return float(brentq(lambda tau: tau * jvp(order, tau) - jv(order, tau), *ends, xtol=1e-13))


def fit(time_s: Array, force_N: Array, order: int, last_tau: float) -> Fit:
    """The response fitted to a dynamic force by least squares, its time scale and amplitude free.

    It starts from the record's own first maximum; nothing of the chain enters.

    Args:
        time_s: shape (samples,).
        force_N: above its static value. Shape (samples,).
        order: m, twice the contact's place below the top.
        last_tau: where the fit ends.

    Raises:
        ValueError: there is no maximum, or the record ends before the fit does.
    """
    top, peak = first_maximum(order), first_peak(time_s, force_N)
    if peak is None:
        raise ValueError("the signal never comes")
    rate, height = top / peak.time_s, float(response(order, np.array(top)))
    if rate * time_s[-1] < last_tau:
        raise ValueError(f"the run ends at tau = {rate * time_s[-1]:.3g}, the fit at {last_tau:.3g}: too short")
    used = rate * time_s <= last_tau
    measured = force_N[used] / peak.value

    def model(time: Array, scale: float, amplitude: float) -> Array:
        return amplitude * response(order, scale * rate * time) / height

    (scale, amplitude), _ = curve_fit(model, time_s[used], measured, p0=(1.0, 1.0))
    left = measured - model(time_s[used], scale, amplitude)
    return Fit(scale * rate, amplitude * peak.value, float(np.sqrt(np.mean(left**2)) / amplitude))


def measure(case: Case, trace: Trace) -> dict[str, float]:
    """Cutoff from the top contact's long record, speed of sound from when the front passes two far contacts.

    A front's arrival is that of the first maximum of the response fitted to it up to its first zero. That of contact n
    is late by ``first_maximum(2 n) - 2 n`` in tau, which dispersion does: the exact lateness is taken off.
    """
    beads = case.chain.beads
    if ECHO * beads < LAST_TAU + 2 * LOWER_CONTACT:
        raise ValueError(f"{beads} beads: the signal is back before it has passed")
    top = fit(trace.time_s, _dynamic(case, trace, 1), 2, LAST_TAU)
    near, far = (_arrival(case, trace, place) for place in (UPPER_CONTACT, LOWER_CONTACT))
    spring, mass = _spring(case)
    scale = -4 * float(case.chain.velocity_m_s[-1]) * sqrt(spring * mass)  # the force before J_2(tau) / tau
    steps = first_maximum(2 * LOWER_CONTACT) - first_maximum(2 * UPPER_CONTACT)
    return {
        "cutoff_frequency_Hz": top.rate_per_s / (2 * pi),
        "sound_speed_m_s": float(case.chain.radius_m[-1]) * steps / (far - near),
        "impulse_share": top.amplitude_N / float(response(2, np.array(first_maximum(2)))) / scale,
        "misfit": top.misfit,
    }


def _arrival(case: Case, trace: Trace, place: int) -> float:
    order = 2 * place
    found = fit(trace.time_s, _dynamic(case, trace, place), order, float(jn_zeros(order, 1)[0]))
    return first_maximum(order) / found.rate_per_s


def _dynamic(case: Case, trace: Trace, below: int) -> Array:
    """Force above its static value, of the contact so many places below the top bead's centre."""
    column = case.chain.beads - below
    return np.asarray(trace.force_N[:, column] - trace.force_N[0, column])


def _spring(case: Case) -> tuple[float, float]:
    """K and m of the chain, whose beads are equal."""
    chain = case.chain
    stiffness, mass = float(chain.stiffness[-1]), float(chain.mass_kg[-1])
    return contact_stiffness_at(stiffness, chain.precompression_N), mass


def theory(case: Case) -> dict[str, float]:
    """The formulas at the top."""
    spring, mass = _spring(case)
    return {
        "cutoff_frequency_Hz": sqrt(spring / mass) / pi,
        "sound_speed_m_s": 2 * float(case.chain.radius_m[-1]) * sqrt(spring / mass),
        "impulse_share": 1.0,
        "misfit": 0.0,
    }


QUANTITIES = {
    "cutoff_frequency_Hz": "highest frequency that travels",
    "sound_speed_m_s": "speed of long waves",
    "impulse_share": "size of the top contact's record, over 4 v sqrt(K m)",
    "misfit": "what of the top contact's record is not J_2(tau)/tau, over its peak",
}
SOURCE = "K = (3/2) k^(2/3) F_0^(1/3), omega_c = 2 sqrt(K/m), c = 2 R sqrt(K/m), F - F_0 ~ J_2(omega_c t)/t"
