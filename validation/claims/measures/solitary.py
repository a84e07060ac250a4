"""A single solitary wave in an uncompressed chain, compared with the exact travelling wave of the discrete chain.

With contact stiffness k and bead mass m the exact wave has, at any amplitude,

    F_m = A k^(2/5) m^(3/5) v_m^(6/5),   c = B (k/m)^(2/5) v_m^(1/5) = C k^(1/3) m^(-1/2) F_m^(1/6) beads per second

and its widths in beads. The long-wave limit (Nesterenko, Dynamics of Heterogeneous Materials, 1.4: the paper's Eqs. 2
and 3) has C = (4/5)^(1/2), and B = (16/25)^(1/5).
"""

import numpy as np

from drivers.chain.case import Case
from drivers.chain.chain import Array
from drivers.chain.trace import Trace
from postproc.read.sensors import sensor_average
from postproc.read.signals import Peak, rising_crossing
from validation.claims.measures.first_waves import first_wave, sensor_places, velocity_down
from validation.claims.measures.passing_waves import forces_of
from validation.reference.travelling_wave import solve_travelling_wave

LONG_WAVE_BY_VELOCITY = 0.64**0.2
WIDTHS = ((False, 0.04), (False, 0.5), (True, 0.04), (True, 0.5))  # True for a sensor's average; share of the peak
FORMATION_CONTACTS = 30  # below the strike: there the wave differs from the exact one by 2e-9


def measure(case: Case, trace: Trace) -> dict[str, float]:
    """Velocity, force and widths at the lower sensor, speed from the upper to the lower sensor."""
    lower, upper = sensor_places(case)
    time = trace.time_s
    force, before = first_wave(time, trace.force_N[:, lower - 1]), first_wave(time, trace.force_N[:, upper - 1])
    velocity = first_wave(time, velocity_down(trace)[:, lower - 1]).value
    speed = (upper - lower) / (force.time_s - before.time_s)
    stiffness, mass = float(case.chain.stiffness[lower]), float(case.chain.mass_kg[lower - 1])
    average = sensor_average(trace.force_N, lower)
    widths = [
        _width_s(time, average if averaged else trace.force_N[:, lower - 1], share) * speed
        for averaged, share in WIDTHS
    ]
    return _by_quantity(
        velocity / float(np.abs(case.chain.velocity_m_s).max()),
        force.value / (stiffness**0.4 * mass**0.6 * velocity**1.2),
        speed / (stiffness ** (1 / 3) * mass**-0.5 * force.value ** (1 / 6)),
        speed / ((stiffness / mass) ** 0.4 * velocity**0.2),
        widths,
    )


def theory(case: Case) -> dict[str, float]:
    """Constants of the exact wave; its amplitude from scipy's integration of the strike."""
    wave, chain = solve_travelling_wave(), case.chain
    speed = float(np.abs(chain.velocity_m_s).max())
    stiffness, mass = float(chain.stiffness[-1]), float(chain.mass_kg[0])
    time_unit = (mass / stiffness) ** 0.4 * speed**-0.2
    time, force = forces_of(chain, 1.3 * FORMATION_CONTACTS * time_unit)
    peak = first_wave(time, force[:, -1 - FORMATION_CONTACTS]).value
    velocity = (peak / (wave.force_by_velocity * stiffness**0.4 * mass**0.6)) ** (5 / 6)
    widths = [wave.width(share, averaged=averaged) for averaged, share in WIDTHS]
    return _by_quantity(velocity / speed, wave.force_by_velocity, wave.speed_by_force, wave.speed_by_velocity, widths)


def _by_quantity(
    strike: float, force: float, by_force: float, by_velocity: float, widths: list[float]
) -> dict[str, float]:
    below = 1 - by_velocity / LONG_WAVE_BY_VELOCITY
    return dict(zip(QUANTITIES, (strike, force, by_force, by_velocity, below, *widths), strict=True))


def _width_s(time_s: Array, values: Array, share: float) -> float:
    """Time from rising through a share of the first peak to falling through it."""
    peak = first_wave(time_s, values)
    level = share * peak.value
    # the falling edge is a rising edge in reversed time
    mirrored = Peak(-peak.time_s, peak.value, len(values) - 1 - peak.sample)
    fall = -rising_crossing(-time_s[::-1], values[::-1], level, mirrored)
    return fall - rising_crossing(time_s, values, level, peak)


QUANTITIES = {
    "peak_velocity_over_strike": "largest bead velocity divided by the speed of the striker",
    "force_by_velocity": "F_m / (k^(2/5) m^(3/5) v_m^(6/5))",
    "speed_by_force": "c / (k^(1/3) m^(-1/2) F_m^(1/6)), c in beads per second",
    "speed_by_velocity": "c / ((k/m)^(2/5) v_m^(1/5)), c in beads per second",
    "speed_below_long_wave": "1 less the speed divided by that of the long-wave limit at the same velocity",
    "contact_width_4pct_diameters": "full width of a contact force at 4 % of its peak",
    "contact_width_half_diameters": "full width of a contact force at half its peak",
    "average_width_4pct_diameters": "full width of a sensor's average at 4 % of its peak",
    "average_width_half_diameters": "full width of a sensor's average at half its peak",
}
SOURCE = "the exact travelling wave of the discrete chain (English and Pego, Proc. AMS 133:1763, 2005)"
