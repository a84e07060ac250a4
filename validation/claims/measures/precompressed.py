"""A solitary wave in a precompressed chain: its speed against three theories at the same dynamic force.

Exact: the travelling wave of the discrete chain with this peak force (``validation.reference.travelling_wave``). Long
waves: the paper's Eq. (4), with the sound speed c_0 and ``f = ((F_0 + F_d) / F_0)^(2/3)``,

    V = c_0 sqrt((4/15) (3 + 2 f^(5/2) - 5 f)) / (f - 1)

Uncompressed: the exact wave of the chain without precompression whose peak force is F_d. The ratio to its speed is the
tuning by precompression of Daraio, Nesterenko, Herbold and Jin (Phys. Rev. E 73, 026610, 2006).
"""

from math import sqrt

from drivers.chain.case import Case
from drivers.chain.trace import Trace
from validation.claims.measures.first_waves import first_wave, sensor_places
from validation.reference.travelling_wave import solve_at_amplitude, solve_travelling_wave, sound_speed


def measure(case: Case, trace: Trace) -> dict[str, float]:
    """Speed from the upper to the lower sensor, divided by those that belong to the peak force of the lower."""
    lower, upper = sensor_places(case)
    chain, static_N = case.chain, case.chain.precompression_N
    near, far = (first_wave(trace.time_s, trace.force_N[:, place - 1] - static_N) for place in (upper, lower))
    speed, peak_N = (upper - lower) / (far.time_s - near.time_s), far.value
    stiffness, mass = float(chain.stiffness[lower]), float(chain.mass_kg[lower])
    sound = sound_speed(stiffness, mass, static_N)
    f = (1 + peak_N / static_N) ** (2 / 3)
    uncompressed = solve_travelling_wave().speed_by_force * stiffness ** (1 / 3) * mass**-0.5 * peak_N ** (1 / 6)
    return {
        "force_over_static": peak_N / static_N,
        "speed_over_exact": speed / solve_at_amplitude(stiffness, mass, static_N, peak_N / static_N).speed,
        "speed_over_long_wave": speed / sound * (f - 1) / sqrt(4 / 15 * (3 + 2 * f**2.5 - 5 * f)),
        "speed_over_uncompressed": speed / uncompressed,
    }


def theory(case: Case) -> dict[str, float]:
    """Both theories of the precompressed chain; ValueError for a chain to which they do not apply."""
    chain = case.chain
    beads, between = slice(0, chain.beads), slice(1, chain.beads)
    unequal = any(values.min() < values.max() for values in (chain.mass_kg[beads], chain.stiffness[between]))
    if not chain.precompression_N or chain.gravity_m_s2 or unequal:
        raise ValueError("a chain without precompression, with gravity or of unequal beads")
    return {"speed_over_exact": 1.0, "speed_over_long_wave": 1.0}


QUANTITIES = {
    "force_over_static": "peak dynamic force divided by the static force",
    "speed_over_exact": "speed divided by that of the exact wave with this peak force",
    "speed_over_long_wave": "speed divided by that of the long-wave limit with this peak force",
    "speed_over_uncompressed": "speed divided by that of the exact wave with this peak force in an uncompressed chain",
}
SOURCE = "the exact travelling wave of the precompressed discrete chain; its long-wave limit, the paper's Eq. (4)"
