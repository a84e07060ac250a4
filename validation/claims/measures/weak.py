"""A weak strike on a chain under its own weight: amplitude and arrival of the signal against depth.

The contact under the bead at depth h (top bead: 1) carries the weight of h beads, so for small motions it is a spring
``K = (3/2) k^(2/3) F^(1/3) ~ h^(1/3)``. The motion is a sum over the modes of this chain of springs. The leading peak
is a power of depth (Hong, Ji and Kim, Phys. Rev. Lett. 82, 3058, 1999): for a contact force ``overlap^p`` the velocity
is proportional to ``h^-(1/3 + 1/p)/4 = h^(-1/4)``, the force, sqrt(K m) times the velocity, to ``h^(-1/12)``, the wave
speed to ``h^((1 - 1/p)/2) = h^(1/6)``, the arrival time to ``h^(5/6)``. Simulations gave 0.250 (patt-sol/9808008).
Arrivals depend on the stiffness of the chain, amplitudes of velocity do not.

These powers hold at medium depths. In longer chains the exponent of the velocity grows: -0.230 at depth 45, -0.240 at
130, -0.250 at 500, -0.257 at 2500, -0.261 at 16000. Near the top the springs change within a wavelength of long waves,
which the powers above neglect: with m = 1 and K = h^(1/3), the outgoing waves of a struck top are
``h^(1/3) H_2/5(6/5 omega h^(5/6))``, whose velocities have a spectrum of omega^(1/10) instead of a flat one. With a
front of duration h^(1/6) the peak tends to ``h^(-1/12 - 11/60) = h^(-4/15)``, that of the force to ``h^(-1/10)``.
"""

import numpy as np
from numpy.typing import NDArray

from drivers.chain.case import Case
from drivers.chain.chain import Array, Chain
from drivers.chain.trace import Trace
from postproc.linear.modes import modes_of, springs_N_m
from postproc.read.signals import Peak, peak_in
from validation.claims.measures.first_waves import velocity_down

DEPTHS = (20, 100, 450)  # of the judged amplitudes
FIT_DEPTHS = np.arange(200, 451, 10)  # of the fitted power law: the published exponents hold there
FITTED_SHARE = 0.7  # of a peak: the samples above determine its height
DEGREE = 6  # of the fitted polynomial


def measure(case: Case, trace: Trace) -> dict[str, float]:
    """Leading peaks of downward bead velocities and of contact forces above the static forces."""
    bead = _beads(case)
    force = trace.force_N[:, bead] - trace.force_N[0, bead]
    return _values(trace.time_s, velocity_down(trace)[:, bead], force)


def theory(case: Case) -> dict[str, float]:
    """Leading peaks of the linear chain, by its modes."""
    velocity, force = motion_by_modes(case.chain, case.sample_times_s, _beads(case))
    return _values(case.sample_times_s, -velocity, force)


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
    peak = peak_in(time_s, signal, missing)
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


def _beads(case: Case) -> NDArray[np.int_]:
    """Indices of the beads at all depths of DEPTHS and FIT_DEPTHS."""
    depths = np.array([*DEPTHS, *FIT_DEPTHS])
    if depths.max() > case.chain.beads:
        raise ValueError(f"{case.chain.beads} beads: too few for a depth of {depths.max()}")
    return np.asarray(case.chain.beads - depths)


def _values(time_s: Array, velocity_m_s: Array, force_N: Array) -> dict[str, float]:
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


FIT_RANGE = f"{FIT_DEPTHS[0]} to {FIT_DEPTHS[-1]} deep"
QUANTITIES = {
    **{f"velocity_{depth}_deep_m_s": f"leading peak of the velocity of bead {depth} from the top" for depth in DEPTHS},
    **{f"force_{depth}_deep_N": f"leading peak of the force under bead {depth} from the top" for depth in DEPTHS},
    f"arrival_{DEPTHS[-1]}_deep_s": f"time of the leading peak of the force under bead {DEPTHS[-1]} from the top",
    "velocity_exponent": f"exponent of depth in the peak velocity, {FIT_RANGE}",
    "force_exponent": f"exponent of depth in the peak force, {FIT_RANGE}",
    "arrival_exponent": f"exponent of depth in the time of the peak force, {FIT_RANGE}",
}
SOURCE = "modes of the linearised chain, K = (3/2) k^(2/3) F^(1/3)"
