"""Cases beyond the paper in chains under load: small motions, and their linear theories.

A measure has two functions of its name: its quantities in a run, and by its theory as far as that goes. They raise a
ValueError if the run does not show the quantities, for example without a wave, or if the theory does not apply. Its
quantities, whose names end with their unit, and its source stand in ``inputs/independent.toml``.
"""

from functools import partial
from math import pi, sqrt

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_banded
from scipy.optimize import brentq, curve_fit
from scipy.signal import find_peaks
from scipy.signal.windows import blackmanharris, kaiser
from scipy.special import jn_zeros, jv, jvp

from drivers.chain.case import Case
from drivers.chain.chain import Array, Chain, contact_stiffness_at
from drivers.chain.trace import Trace
from postproc.linear.modes import modes_of, springs_N_m
from postproc.read.signals import Peak, first_peak

first_wave = partial(first_peak, missing="no wave within run.duration")


def sensor_places(case: Case) -> tuple[int, int]:
    """Places from the wall of the lowest and the highest sensor; ValueError with fewer than two."""
    places = sorted(case.scene.chain.sensor_at)
    if len(places) < 2:
        raise ValueError("fewer than two sensors: the wave is read between two")
    return places[0], places[-1]


def velocity_down(trace: Trace) -> Array:
    """Downward velocities of all bodies, shape (samples, bodies); ValueError if they were not recorded."""
    if trace.velocity_m_s is None:
        raise ValueError("no state recorded; set run.record to forces and state")
    return -trace.velocity_m_s


# The linear limit: a long chain under a force F_0, whose top bead has a small speed v at time 0.
#
# For small motions contacts are springs ``K = (3/2) k^(2/3) F_0^(1/3)``. No frequency above ``omega_c = 2 sqrt(K/m)``
# propagates, and long waves travel at ``c = 2 R sqrt(K/m)`` (Nesterenko, Dynamics of Heterogeneous Materials, chapter
# 1). Until the reflection from the far end arrives, the force in contact n below the top is
#
#     F_n - F_0 = v sqrt(K m) 4 n J_2n(tau) / tau,   tau = omega_c t
#
# which follows from Schroedinger's infinite chain, ``u'_n = v J_2n(tau)`` (Ann. Phys. 44, 916, 1914), with a mirror
# image for the free end: ``u'_n = v (J_2n + J_2n+2)`` for the bead n below the top, and ``F_n = K (u_n-1 - u_n)``.

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
    top, peak = first_maximum(order), first_peak(time_s, force_N, "no signal within the run")
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


def small_signal(case: Case, trace: Trace) -> dict[str, float]:
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
    return contact_stiffness_at(stiffness, case.scene.chain.precompression), mass


def small_signal_theory(case: Case) -> dict[str, float]:
    """Values by the formulas above."""
    spring, mass = _spring(case)
    return {
        "cutoff_frequency_Hz": sqrt(spring / mass) / pi,
        "sound_speed_m_s": 2 * float(case.chain.radius_m[-1]) * sqrt(spring / mass),
        "impulse_share": 1.0,
        "misfit": 0.0,
    }


# A weak strike on a chain under its own weight: amplitude and arrival of the signal against depth.
#
# The contact under the bead at depth h (top bead: 1) carries the weight of h beads, so for small motions it is a spring
# ``K = (3/2) k^(2/3) F^(1/3) ~ h^(1/3)``. The motion is a sum over the modes of this chain of springs. The leading peak
# is a power of depth (Hong, Ji and Kim, Phys. Rev. Lett. 82, 3058, 1999): for a contact force ``overlap^p`` the
# velocity is proportional to ``h^-(1/3 + 1/p)/4 = h^(-1/4)``, the force, sqrt(K m) times the velocity, to
# ``h^(-1/12)``, the wave speed to ``h^((1 - 1/p)/2) = h^(1/6)``, the arrival time to ``h^(5/6)``. Simulations gave
# 0.250 (patt-sol/9808008). Arrivals depend on the stiffness of the chain, amplitudes of velocity do not.
#
# These powers hold at medium depths. In longer chains the exponent of the velocity grows: -0.230 at depth 45, -0.240 at
# 130, -0.250 at 500, -0.257 at 2500, -0.261 at 16000. Near the top the springs change within a wavelength of long
# waves, which the powers above neglect: with m = 1 and K = h^(1/3), the outgoing waves of a struck top are ``h^(1/3)
# H_2/5(6/5 omega h^(5/6))``, whose velocities have a spectrum of omega^(1/10) instead of a flat one. With a front of
# duration h^(1/6) the peak tends to ``h^(-1/12 - 11/60) = h^(-4/15)``, that of the force to ``h^(-1/10)``.

DEPTHS = (20, 100, 450)  # of the judged amplitudes
FIT_DEPTHS = np.arange(200, 451, 10)  # of the fitted power law: the published exponents hold there
FITTED_SHARE = 0.7  # of a peak: the samples above determine its height
DEGREE = 6  # of the fitted polynomial


def weak_strike(case: Case, trace: Trace) -> dict[str, float]:
    """Leading peaks of downward bead velocities and of contact forces above the static forces."""
    bead = _deep_beads(case)
    force = trace.force_N[:, bead] - trace.force_N[0, bead]
    return _weak_values(trace.time_s, velocity_down(trace)[:, bead], force)


def weak_strike_theory(case: Case) -> dict[str, float]:
    """Leading peaks of the linear chain, by its modes."""
    velocity, force = motion_by_modes(case.chain, case.sample_times_s, _deep_beads(case))
    return _weak_values(case.sample_times_s, -velocity, force)


def loaded_springs_N_m(chain: Chain) -> Array:
    """Contact stiffnesses, shape (bodies,); ValueError if a contact has no static load: no motion is linear there."""
    spring = springs_N_m(chain)
    if chain.bodies > chain.beads or not spring.all():
        raise ValueError("a striker, or a contact without static load: no linear motion")
    return spring


def motion_by_modes(chain: Chain, time_s: Array, bodies: NDArray[np.int_]) -> tuple[Array, Array]:
    """Small motions about equilibrium from the velocities at time 0, as a sum of modes.

    Args:
        chain: straight, with all contacts closed.
        time_s: shape (samples,).
        bodies: indices of the wanted bodies, from the lowest up.

    Returns:
        Upward velocities of these bodies, and forces of the contacts below them above the static forces. Shape
        (samples, wanted), each.
    """
    modes, mass, spring = modes_of(chain), chain.mass_kg, loaded_springs_N_m(chain)
    frequency, shape = 2 * np.pi * modes.frequency_Hz, modes.shape
    part = shape.T @ (mass * chain.velocity_m_s) / (mass @ shape**2)
    shortened = np.diff(shape, axis=0, prepend=0.0)[bodies] * spring[bodies, np.newaxis]
    phase = np.outer(time_s, frequency)
    return (np.cos(phase) * part) @ shape[bodies].T, -(np.sin(phase) * (part / frequency)) @ shortened.T


def leading_peak(time_s: Array, signal: Array) -> Peak:
    """First maximum, of a polynomial through the samples around it, which smooths rounding.

    Raises:
        ValueError: there is no maximum, or too few samples around it.
    """
    missing = "no leading peak at this depth within the run, or run.sample_interval is too long"
    peak = first_peak(time_s, signal, missing)
    low = FITTED_SHARE * signal[peak.sample]
    first = peak.sample - int(np.argmax(signal[peak.sample :: -1] < low)) + 1
    last = peak.sample + int(np.argmax(signal[peak.sample :] < low)) - 1
    if last - first < DEGREE:
        raise ValueError(missing)
    top = slice(first, last + 1)
    curve = np.polynomial.Polynomial.fit(time_s[top], signal[top], DEGREE)
    level = curve.deriv().roots()
    places = level.real[(np.abs(level.imag) < 1e-9 * time_s[-1])]
    place = float(places[np.argmin(np.abs(places - peak.time_s))])
    return Peak(place, float(curve(place)), peak.sample)


def _deep_beads(case: Case) -> NDArray[np.int_]:
    """Indices of the beads at all depths of DEPTHS and FIT_DEPTHS."""
    depths = np.array([*DEPTHS, *FIT_DEPTHS])
    if depths.max() > case.chain.beads:
        raise ValueError(f"{case.chain.beads} beads: too few for a depth of {depths.max()}")
    return np.asarray(case.chain.beads - depths)


def _weak_values(time_s: Array, velocity_m_s: Array, force_N: Array) -> dict[str, float]:
    values: dict[str, float] = {}
    for name, unit, signals in (("velocity", "m_s", velocity_m_s), ("force", "N", force_N)):
        peaks = [leading_peak(time_s, column) for column in signals.T]
        values |= {f"{name}_{depth}_deep_{unit}": peak.value for depth, peak in zip(DEPTHS, peaks, strict=False)}
        values[f"{name}_exponent"] = power_of_depth([peak.value for peak in peaks[len(DEPTHS) :]])
    values[f"arrival_{DEPTHS[-1]}_deep_s"] = peaks[len(DEPTHS) - 1].time_s  # arrival of the force
    values["arrival_exponent"] = power_of_depth([peak.time_s for peak in peaks[len(DEPTHS) :]])
    return values


def power_of_depth(values: list[float]) -> float:
    """Exponent of depth in values at the depths ``FIT_DEPTHS``, by least squares of logarithms."""
    return float(np.polyfit(np.log(FIT_DEPTHS), np.log(values), 1)[0])


# Band edges: the edge lines in the spectrum of a finite chain that a weak strike rings.
#
# In an infinite chain of contacts with the stiffness K waves propagate up to ``omega = 2 sqrt(K/m)``. If heavy and
# light beads alternate, with masses M and m, up to ``sqrt(2 K/M)`` (acoustic band), and from ``sqrt(2 K/m)`` to
# ``sqrt(2 K (1/m + 1/M))`` (optical band; Brillouin, Wave Propagation in Periodic Structures, 1953). The modes of a
# finite chain without states in the gap lie inside the bands, the outermost next to the edges: their distance is
# proportional to ``1/count^2``. The gap is the widest interval between neighbouring modes.

PADDING = 4  # length of the transformed record divided by that of the samples
FLOOR = 1e-6  # share of the largest power: above rounding and sums of frequencies, below every rung mode


def lines_Hz(time_s: Array, force_N: Array) -> Array:
    """Frequencies of the maxima in the summed power of dynamic forces, by parabolas through logarithms.

    Sidelobes of the window, Blackman and Harris' of four terms, lie 92 dB below its main lobe, 8 samples of an unpadded
    spectrum wide: lines closer than that merge.

    Args:
        time_s: equally spaced, shape (samples,).
        force_N: shape (samples, contacts).
    """
    samples = len(time_s)
    dynamic = (force_N - force_N[0]) * blackmanharris(samples, sym=False)[:, np.newaxis]
    power = (np.abs(np.fft.rfft(dynamic, PADDING * samples, axis=0)) ** 2).sum(axis=1)
    places, _ = find_peaks(power, height=FLOOR * power.max())
    left, top, right = (np.log(power[places + step]) for step in (-1, 0, 1))
    shift = (left - right) / (left - 2 * top + right) / 2
    spacing_s = float(time_s[-1] - time_s[0]) / (samples - 1)
    return np.asarray((places + shift) / (PADDING * samples * spacing_s))


def bands(_: Case, trace: Trace) -> dict[str, float]:
    """Lines at the band edges and number of lines."""
    return _edges(lines_Hz(trace.time_s, trace.force_N))


def bands_theory(case: Case) -> dict[str, float]:
    """The same of the modes of the chain's springs and masses; ValueError for a chain without such modes."""
    loaded_springs_N_m(case.chain)
    return _edges(modes_of(case.chain).frequency_Hz)


def _edges(frequency_Hz: Array) -> dict[str, float]:
    """Quantities of ascending frequencies; ValueError for fewer than two."""
    if len(frequency_Hz) < 2:
        raise ValueError("fewer than two lines in the spectrum")
    below = int(np.argmax(np.diff(frequency_Hz)))
    return {
        "below_gap_Hz": float(frequency_Hz[below]),
        "above_gap_Hz": float(frequency_Hz[below + 1]),
        "highest_Hz": float(frequency_Hz[-1]),
        "lines": float(len(frequency_Hz)),
    }


# Transfer function of a weakly driven chain: contact forces of two places divided by a sine force on a body.
#
# Under a weak force ``A e^(i Omega t)`` the displacements ``u e^(i Omega t)`` solve ``(K - Omega^2 M) u = A``, with the
# masses M and the tridiagonal matrix K of the contact stiffnesses. A start from rest leaves free motions in an elastic
# chain, at the frequencies of its modes: a Kaiser window over the whole record takes them out, the harmonics and the
# shift of the mean as well. The finite amplitude A adds shares of the order of ``(A / F_0)^2``, and of ``A / F_0`` at
# sums and differences of the modes' frequencies, of which some lie near the drive's.

SHAPE = 20.0  # beta of the window
CYCLES = 6.5  # half width of its main lobe, in cycles of the record: sqrt(1 + (beta / pi)^2); sidelobes below 2e-8


def driven(case: Case, trace: Trace) -> dict[str, float]:
    """Gains and phases of the contact forces below the highest and the lowest sensor bead."""
    force_N, omega = _sine(case)
    window = kaiser(len(trace.time_s), SHAPE)
    turning = window * np.exp(-1j * omega * trace.time_s)
    return _transfer(case, 2j / window.sum() * (turning @ (trace.force_N - trace.force_N[0])) / force_N)


def driven_theory(case: Case) -> dict[str, float]:
    """The same of the linear equations; ValueError if the record does not separate the drive from the nearest mode."""
    chain, (_, omega) = case.chain, _sine(case)
    spring = loaded_springs_N_m(chain)
    assert chain.drive is not None
    nearest_Hz = np.abs(modes_of(chain).frequency_Hz - omega / (2 * pi)).min()
    if nearest_Hz * case.scene.run.duration < CYCLES:
        raise ValueError("run.duration: too short to separate the drive's frequency from that of the nearest mode")
    beside = -spring[1:]
    diagonal = spring + np.append(spring[1:], 0.0) - omega**2 * chain.mass_kg
    rows = np.array([np.append(0.0, beside), diagonal, np.append(beside, 0.0)])
    unit = np.zeros(chain.bodies)
    unit[chain.drive.body] = 1.0
    moved = solve_banded((1, 1), rows, unit)
    return _transfer(case, -spring * np.diff(moved, prepend=0.0))


def _sine(case: Case) -> tuple[float, float]:
    """Amplitude in N, upwards positive, and angular frequency of the drive; ValueError for another drive."""
    drive = case.scene.drive
    if drive is None or drive.form != "sine" or not drive.force or not drive.frequency or drive.cycles or drive.start:
        raise ValueError("no sine force that lasts from time 0")
    return drive.force, 2 * pi * drive.frequency


def _transfer(case: Case, part: Array) -> dict[str, float]:
    """Quantities of the complex amplitudes of contact forces divided by that of the drive, shape (contacts,)."""
    far, near = sensor_places(case)
    places = {"near": near - 1, "far": far - 1}
    gains = {f"{name}_gain": float(np.abs(part[place])) for name, place in places.items()}
    return gains | {f"{name}_phase_rad": float(np.angle(part[place])) for name, place in places.items()}


# Impurity: a bead of mass ``(1 + e) m`` in a precompressed chain transmits ``1/(1 + e^2 tan^2(q/2))`` of the energy of
# small waves with the wavenumber q per bead (closed forms: Martinez, Yasuda, Kim, Kevrekidis, Porter and Yang,
# arXiv:1602.08651). A struck bead puts equal energy into all q, so its mean over q from 0 to pi, ``1/(1 + |e|)``, is
# the share that passes of what goes towards the impurity.


def impurity(case: Case, trace: Trace) -> dict[str, float]:
    """Energy below the impurity at the end, divided by half the energy of the strike."""
    return _transmitted(case, velocity_down(trace)[-1], trace.force_N[-1] - trace.force_N[0])


def impurity_theory(case: Case) -> dict[str, float]:
    """The same by the modes of the finite chain."""
    velocity, force = motion_by_modes(case.chain, case.sample_times_s[-1:], np.arange(case.chain.beads))
    return _transmitted(case, -velocity[0], force[0])


def _transmitted(case: Case, velocity_m_s: Array, dynamic_N: Array) -> dict[str, float]:
    """Kinetic energy and that of the springs at one time; ValueError without a single impurity."""
    chain = case.chain
    odd = np.flatnonzero(chain.mass_kg != np.median(chain.mass_kg))
    if len(odd) != 1 or np.count_nonzero(chain.velocity_m_s) != 1:
        raise ValueError("not one bead of another mass, and one struck bead")
    below = slice(0, int(odd[0]))
    energy = chain.mass_kg[below] * velocity_m_s[below] ** 2 + dynamic_N[below] ** 2 / loaded_springs_N_m(chain)[below]
    return {"transmitted_share": float(energy.sum() / (chain.mass_kg @ chain.velocity_m_s**2 / 2))}
