"""Solitary waves on the paper's chains: speeds by its Eqs. (3) and (4), and strikes that give a wave of some amplitude.

The amplitude of Table 1 is the peak of the sensor averages above their static value, for a chain without lighter sensor
beads, with E = 1.46 GPa and gravity, and with the striker counted among the 21 beads: this reading reproduces the
printed numbers. Measured and simulated speeds are compared at equal averages as well.
"""

from collections.abc import Callable, Sequence
from functools import cache
from math import ceil, floor, log10, pi, sqrt
from typing import NamedTuple

import numpy as np
import pandas as pd
from scipy.interpolate import make_interp_spline

from drivers.base.errors import InputError, RunError
from drivers.chain.case import Case, build_case
from drivers.chain.chain import Array, bead_mass, hertz_force, hertz_overlap
from drivers.scene.model import Member
from postproc.paper import force_accuracy, quoted
from postproc.read.motion import Simulation, case_of, exact
from postproc.read.signals import first_peak
from validation.reference.travelling_wave import solve_travelling_wave

SCENE = "table1"
MARGIN, BEADS_BELOW = 1.3, 10  # duration of a search: this many travel times, to this many beads below the lower sensor
END_FACTOR = 1.15  # duration of the final run divided by the arrival at the lower sensor, so that the peak has passed
EXACT, BY_CODE = 1e-9, 1e-7  # relative tolerances of amplitudes of the reference and of codes
MAX_CORRECTIONS = 12
LEAST_SLOPE = 0.1  # of the logarithms; that of weak strikes under a static force tends to 0
COLUMNS = ("speed_m_s", "width_0.2pct_diameters", "width_4pct_diameters")
HALF_DIGITS = (0.5, 0.05, 0.05)  # of the printed numbers
FITTED_STRIKES = 9  # between which the numbers of a row are interpolated
SPEED_RATIO = 1.02  # of the striker speeds that give a slope
WAVE_OVER_STRIKER = 0.682  # v_m of the leading wave divided by the speed of an equal striker, by the reference

Amplitude = Callable[[Simulation], float]


class Particles(NamedTuple):
    """Equal spheres of one material."""

    youngs_modulus_Pa: float
    poisson_ratio: float
    density_kg_m3: float
    diameter_m: float

    @property
    def speed_constant_m_s(self) -> float:
        """The constant c of Eq. (1): ``c^2 = 2 E / (pi rho (1 - nu^2))``; of the order of the bulk sound speed."""
        return sqrt(2 * self.youngs_modulus_Pa / (pi * self.density_kg_m3 * (1 - self.poisson_ratio**2)))

    @property
    def mass_kg(self) -> float:
        """Mass of one particle."""
        return self.density_kg_m3 * pi / 6 * self.diameter_m**3

    @property
    def stiffness(self) -> float:
        """Hertz stiffness k of Eq. (7) for two equal spheres, ``F = k overlap^(3/2)``."""
        return 2 * self.youngs_modulus_Pa / (3 * (1 - self.poisson_ratio**2)) * sqrt(self.diameter_m / 4)

    def force_N(self, strain: float) -> float:
        """Eq. (7) at the overlap ``a xi``."""
        return float(hertz_force(self.stiffness, self.diameter_m * strain))

    def strain(self, force_N: float) -> float:
        """Inverse of ``force_N``."""
        return float(hertz_overlap(self.stiffness, force_N) / self.diameter_m)


def particles_of(case: Case) -> Particles:
    """Beads of a case, taken to be equal, with the density that gives their mass."""
    scene = case.scene
    material, diameter = scene.materials[scene.chain.material], scene.chain.diameter
    density = bead_mass(scene, Member()) / (pi / 6 * diameter**3)
    return Particles(material.youngs_modulus, material.poisson_ratio, density, diameter)


def speed_from_force(particles: Particles, force_N: float) -> float:
    """Eq. (3), last form as printed: ``V_s = 0.68 (2 E / (a rho^(3/2) (1-nu^2)))^(1/3) F_m^(1/6)``."""
    return float(0.68 * force_scale(particles) * force_N ** (1 / 6))


def force_scale(particles: Particles) -> float:
    """Speed in Eq. (3) at 1 N without its coefficient, ``(2 E / (a rho^(3/2) (1-nu^2)))^(1/3)``."""
    p = particles
    inside = 2 * p.youngs_modulus_Pa / (p.diameter_m * p.density_kg_m3**1.5 * (1 - p.poisson_ratio**2))
    return float(inside ** (1 / 3))


def precompressed_speed(particles: Particles, force_N: float, static_N: float) -> float:
    """Eq. (4): speed of a solitary wave of total peak force ``force_N`` on a chain under ``static_N``.

    ``V_s = 0.9314 (4 E^2 F_0 / (a^2 rho^3 (1-nu^2)^2))^(1/6) S / (f^(2/3) - 1)`` with ``f = F_m / F_0`` and
    ``S^2 = (4/15) [3 + 2 f^(5/3) - 5 f^(2/3)]``.
    """
    f = force_N / static_N
    bracket = 4 / 15 * (3 + 2 * f ** (5 / 3) - 5 * f ** (2 / 3))
    return float(0.9314 * force_scale(particles) * static_N ** (1 / 6) * sqrt(bracket) / (f ** (2 / 3) - 1))


def sensor_pair(case: Case) -> tuple[int, int]:
    """Numbers of the beads with the upper and the lower sensor.

    Raises:
        InputError: The scene does not have two sensors.
    """
    beads = [sensor.from_wall for sensor in case.layout.sensors]
    if len(beads) != 2:
        allowed = "two sensors, for the speed between them"
        raise InputError(case.scene.file, "chain.sensors", f"{len(beads)} sensors", allowed)
    return beads[0], beads[1]


def sensor_amplitude(simulation: Simulation) -> float:
    """Peak of the sensor averages above their static value, mean over the sensors, in N: F_m of Table 1."""
    return float(np.mean([simulation.values[f"bead_{bead}_amplitude_N"] for bead in sensor_pair(simulation.case)]))


def contact_peak(simulation: Simulation) -> float:
    """Mean of the first peaks of the contact forces between the upper and the lower sensor, static part included."""
    upper, lower = sensor_pair(simulation.case)
    force = simulation.trace.force_N[:, lower:upper]
    firsts = [first_peak(simulation.trace.time_s, column - column[0]) for column in force.T]
    return float(np.mean(force[0] + [peak.value for peak in firsts]))


def static_force(case: Case) -> float:
    """Mean static force of the contacts between the upper and the lower sensor, N."""
    upper, lower = sensor_pair(case)
    return float(case.chain.force_N[lower:upper].mean())


def striker_speed(simulation: Simulation) -> float:
    """Speed of the striker at time 0 in m/s."""
    return -float(simulation.case.chain.velocity_m_s[-1])


def speed_between_sensors(simulation: Simulation) -> float:
    """Peak-to-peak speed between the two sensors in m/s."""
    upper, lower = sensor_pair(simulation.case)
    return simulation.values[f"speed_{upper}_to_{lower}_m_s"]


def strike(speed_m_s: float, duration_s: float, *settings: str) -> Case:
    """The chain of Table 1 with this striker speed, for a duration rounded up to a whole microsecond."""
    duration = f"run.duration={np.ceil(duration_s * 1e6):.0f} us"
    return case_of(SCENE, *settings, f"striker.speed={speed_m_s!r} m/s", duration)


def strike_for(force_N: float, amplitude: Amplitude, *settings: str) -> Simulation:
    """Exact simulation of the strike with a given amplitude, just long enough for the wave to pass the sensors.

    The search starts from the speed for a wave without static force.

    Raises:
        RunError: No striker speed gives the amplitude.
    """
    case, wave = strike(1.0, 1e-6, *settings), solve_travelling_wave()
    chain, j = case.chain, case.chain.beads // 2
    stiffness, mass = float(chain.stiffness[j]), float(chain.mass_kg[j])
    speed = float((force_N / (wave.force_by_velocity * stiffness**0.4 * mass**0.6)) ** (5 / 6) / WAVE_OVER_STRIKER)
    beads = chain.beads - sensor_pair(case)[1] + BEADS_BELOW
    travel_s = beads / (wave.speed_by_force * stiffness ** (1 / 3) * mass**-0.5 * force_N ** (1 / 6))
    long = strike(speed, MARGIN * travel_s, *settings)

    (motion,) = settled(lambda cases: [*map(exact, cases)], [long], [force_N], amplitude, EXACT)
    arrival_s = motion.values[f"bead_{sensor_pair(long)[1]}_arrival_s"]
    return exact(strike(striker_speed(motion), END_FACTOR * arrival_s, *settings))


def _struck_at(case: Case, speed_m_s: float) -> Case:
    """The case with another striker speed."""
    assert case.scene.striker is not None
    striker = case.scene.striker.model_copy(update={"speed": speed_m_s})
    return build_case(case.scene.model_copy(update={"striker": striker}))


@np.errstate(invalid="ignore", divide="ignore")
def settled(
    run: Callable[[Sequence[Case]], Sequence[Simulation]],
    cases: Sequence[Case],
    forces_N: Sequence[float],
    amplitude: Amplitude = sensor_amplitude,
    tolerance: float = BY_CODE,
) -> Sequence[Simulation]:
    """Strikes on an engine, with speeds corrected until the engine's own amplitudes are right.

    Without static force the logarithm of the amplitude is a straight line of slope 6/5 in that of the striker speed;
    elsewhere the slope is that of the last two strikes.

    Raises:
        RunError: No striker speed gives an amplitude.
    """
    slope, before = np.full(len(cases), 6 / 5), np.full((2, len(cases)), np.nan)
    for _ in range(MAX_CORRECTIONS):
        motions = run(cases)
        here = np.log([[*map(striker_speed, motions)], [*map(amplitude, motions)]])
        off = here[1] - np.log(forces_N)
        wrong = ~(np.abs(off) <= tolerance)
        if not wrong.any() or np.isnan(off).any():
            break
        change = np.divide(*(here - before)[::-1])
        slope, before = np.where(change > LEAST_SLOPE, change, slope), here
        speeds = np.exp(here[0] - off / slope).tolist()
        cases = [_struck_at(*pair) if bad else pair[0] for *pair, bad in zip(cases, speeds, wrong, strict=True)]
    if wrong.any():
        raise RunError(f"{SCENE}: no striker speed gives a wave of {', '.join(f'{each:g}' for each in forces_N)} N")
    return motions


def table1_numbers(simulation: Simulation) -> list[float]:
    """Numbers of a row of Table 1, in the order of ``COLUMNS``."""
    lower = sensor_pair(simulation.case)[1]
    widths = [simulation.values[f"bead_{lower}_{name}"] for name in COLUMNS[1:]]
    return [speed_between_sensors(simulation), *widths]


@cache
def fitting_force(force_N: float, *settings: str) -> float:
    """Amplitude that gives most of the printed numbers of a row of Table 1, whose F_m is printed to one digit.

    It is F_m as printed if all numbers follow there. Else it is, of three digits, within the rounding of F_m and among
    the amplitudes that give most numbers, the one with the smallest largest miss; numbers are interpolated.
    """
    row, half_N = pd.DataFrame(quoted().table1).set_index("force_N").loc[force_N], 10 ** floor(log10(force_N)) / 2
    printed = row[[f"computed_{name}" for name in COLUMNS]].to_numpy()

    def misses(numbers: Array) -> Array:
        return np.asarray(np.abs(numbers - printed) / HALF_DIGITS)

    if (misses(np.array(table1_numbers(strike_for(force_N, sensor_amplitude, *settings)))) <= 1).all():
        return force_N
    ends = force_N - half_N, force_N + half_N
    slowest = strike_for(ends[0], sensor_amplitude, *settings)
    faster = np.geomspace(1.0, (ends[1] / ends[0]) ** (5 / 6), FITTED_STRIKES) * striker_speed(slowest)
    strikes = [exact(_struck_at(slowest.case, speed_m_s)) for speed_m_s in faster]
    numbers = make_interp_spline([*map(sensor_amplitude, strikes)], [*map(table1_numbers, strikes)])
    amplitudes = np.linspace(*ends, 101)
    off = misses(numbers(amplitudes))
    best = np.lexsort((off.max(axis=1), -(off <= 1).sum(axis=1)))[0]
    return float(round(amplitudes[best], 3 - ceil(log10(force_N))))


def measured_points() -> pd.DataFrame:
    """Measured points with the stated uncertainties, and the speed error by the positions of the sensors."""
    paper, table, case = quoted(), quoted().table1, case_of("table1")
    force, speed = np.array(table["force_N"]), np.array(table["measured_speed_m_s"])
    share = np.array([*map(force_accuracy, force)])
    upper, lower = sensor_pair(case)
    gap = float(case.chain.height_m[upper - 1] - case.chain.height_m[lower - 1])
    return pd.DataFrame({
        "force_N": force, "speed_m_s": speed, "force_error_N": share * force,
        "speed_error_m_s": paper.accuracy_speed * speed,
        "speed_error_by_position_m_s": np.sqrt(2) * paper.accuracy_sensor_position_m / gap * speed,
    })  # fmt: skip


@cache
def score(modulus_MPa: float, amplitude: Amplitude = sensor_amplitude) -> pd.DataFrame:
    """Deviation of the experiment from a modulus, with gravity, in per cent of the speed and in standard errors.

    Speeds are compared at equal amplitudes; the error of the force is converted by the slope of the simulated speed.
    """
    points, simulated, slopes = measured_points(), list[float](), list[float]()
    for force_N in points["force_N"]:
        motion = strike_for(force_N, amplitude, f"materials.ptfe.youngs_modulus={modulus_MPa} MPa")
        other = exact(_struck_at(motion.case, -SPEED_RATIO * float(motion.case.chain.velocity_m_s[-1])))
        speed, faster = speed_between_sensors(motion), speed_between_sensors(other)
        simulated.append(speed)
        slopes.append(float(np.log(faster / speed) / np.log(amplitude(other) / amplitude(motion))))
    off = points["speed_m_s"] / simulated - 1
    by_force = slopes * points["force_error_N"] / points["force_N"]
    error = np.hypot(points["speed_error_m_s"] / points["speed_m_s"], by_force)
    return pd.DataFrame({
        "modulus_MPa": modulus_MPa, "force_N": points["force_N"], "measured_m_s": points["speed_m_s"],
        "simulated_m_s": simulated, "deviation_pct": 100 * off, "deviation_standard_errors": off / error,
    })  # fmt: skip
