"""Claims on equations (1) to (7) and on exact solitary waves."""

from functools import cache
from math import sqrt

import numpy as np
from scipy.interpolate import CubicSpline

from postproc.paper import theory
from postproc.paper.quoted import quoted
from postproc.paper.simulate import case_of
from validation.claims.chains import ptfe_beads
from validation.reference import travelling_wave
from validation.reference.travelling_wave import fixed_point, solve_at_amplitude, solve_travelling_wave

STATIC_N = 0.02  # any value: statements depend on the ratio of amplitude to static force only
AMPLITUDES = (1.0, 10.0, 100.0)
SWEPT_AMPLITUDES = (0.1, 1.0, 10.0, 100.0, 1e3, 1e4)


def speed_constant() -> float:
    """Speed constant c of the discrete chain, ``c^2 = k a^(5/2) / m``, over that of the formula."""
    p = ptfe_beads()
    return sqrt(p.stiffness * p.diameter_m**2.5 / p.mass_kg) / p.speed_constant_m_s


def sound_speed() -> float:
    """Long-wave sound speed of the discrete chain over ``c xi_0^(1/4)``."""
    p = ptfe_beads()
    beads_per_s = travelling_wave.sound_speed(p.stiffness, p.mass_kg, STATIC_N)
    return float(beads_per_s * p.diameter_m / (p.speed_constant_m_s * p.strain(STATIC_N) ** 0.25))


def convergence_order() -> float:
    """Order in a/L with which accelerations of the lattice converge to those of Eq. (1), for three wave lengths."""
    p, mean, swing = ptfe_beads(), 0.01, 0.006
    errors = []
    # the largest difference of accelerations over the largest, for one period of a strongly modulated strain
    for beads in (64, 256):
        length = beads * p.diameter_m
        wave_number = 2 * np.pi / length
        place = np.arange(beads + 1) * p.diameter_m
        displacement = -mean * place - swing / wave_number * np.sin(wave_number * place)
        strain = mean + swing * np.cos(wave_number * place[:-1])
        lattice = theory.lattice_acceleration(p, displacement)
        long_wave = theory.long_wave_acceleration(p, strain, length)
        errors.append(float(np.abs(lattice - long_wave).max() / np.abs(lattice).max()))
    return float(np.log(errors[0] / errors[1]) / np.log(4))


def stationary_residual(power: float) -> float:
    """Largest violation of the long-wave equation of a chain with ``F ~ overlap^power`` by its periodic solution."""
    return theory.stationary_residual(power)


def hump_length() -> float:
    """Length of the hump of Eq. (2), in particle diameters."""
    return theory.HUMP_LENGTH


def amplitude_power() -> float:
    """Power of ``5 V^2 / 4 c^2`` in the strain of a wave that obeys Eq. (1): from the first form of Eq. (3)."""
    p = ptfe_beads()
    strains = [0.01, 0.02]
    speeds = [theory.speed_from_strain(p, strain) for strain in strains]
    return float(np.log(strains[1] / strains[0]) / np.log(speeds[1] ** 2 / speeds[0] ** 2))


def harmonics() -> float:
    """Largest difference between ``cos^4 y`` and ``[3 + cos 4y + 4 cos 2y] / 8``."""
    y = np.linspace(-np.pi, np.pi, 1001)
    return float(np.abs(np.cos(y) ** 4 - (3 + np.cos(4 * y) + 4 * np.cos(2 * y)) / 8).max())


def wavelength(multiple: float) -> float:
    """Wave length of the harmonic ``cos (multiple y)`` of Eq. (2), in diameters."""
    return 2 * np.pi / (multiple * theory.HUMP_WAVE_NUMBER)


def strain_coefficient() -> float:
    """``V_s / (c xi_m^(1/4))`` of the hump of Eq. (2)."""
    p, speed = ptfe_beads(), 150.0
    peak = float(theory.solitary_strain(p, speed, np.zeros(1))[0])
    return float(speed / (p.speed_constant_m_s * peak**0.25))


def velocity_coefficient() -> float:
    """``V_s / (c^(4/5) v_m^(1/5))`` of the hump of Eq. (2), whose particles move with ``v = V_s xi``."""
    p, speed = ptfe_beads(), 150.0
    velocity = speed * float(theory.solitary_strain(p, speed, np.zeros(1))[0])
    return float(speed / (p.speed_constant_m_s**0.8 * velocity**0.2))


def force_coefficient() -> float:
    """The coefficient of the last form of Eq. (3), from its first form and Eq. (7)."""
    p, strain = ptfe_beads(), 0.01
    return theory.force_coefficient(p, theory.speed_from_strain(p, strain), p.force_N(strain))


def discrete_force_coefficient() -> float:
    """The coefficient of the last form of Eq. (3) for the exact solitary wave of the discrete chain."""
    p, wave = ptfe_beads(), solve_travelling_wave()
    speed = wave.speed_by_force * p.stiffness ** (1 / 3) * p.mass_kg**-0.5 * p.diameter_m  # at 1 N
    return theory.force_coefficient(p, speed, 1.0)


def sound_coefficient() -> float:
    """The coefficient of Eq. (4), from c_0 of Eq. (1) and Eq. (7)."""
    return theory.force_coefficient(ptfe_beads(), theory.sound_speed(ptfe_beads(), STATIC_N), STATIC_N)


def weak_limit() -> float:
    """Eq. (4) over c_0 for a wave of 1e-4 of the static force."""
    return _eq4(1 + 1e-4) / theory.sound_speed(ptfe_beads(), STATIC_N)


def strong_limit() -> float:
    """Eq. (4) over Eq. (3) for a wave of 1e12 times the static force."""
    return _eq4(1e12) / theory.speed_from_force(ptfe_beads(), 1e12 * STATIC_N)


def _eq4(force_over_static: float) -> float:
    """Speed of Eq. (4) in m/s for a peak force, static part included, over the static force."""
    return theory.precompressed_speed(ptfe_beads(), force_over_static * STATIC_N, STATIC_N)


def precompressed_discrete() -> float:
    """Largest deviation of Eq. (4) from the exact wave of the discrete chain, for 0.1 to 1e4 static forces."""
    diameter_m = ptfe_beads().diameter_m
    return max(abs(_eq4(1 + each) / (_wave(each).speed * diameter_m) - 1) for each in SWEPT_AMPLITUDES)


def sensor_share() -> float:
    """``(F_3 - F_4) / (F_1 - F_2)`` from Newton's law for two caps and a gauge that move as one body."""
    third, fourth = _faces(3.0, 1.0)
    return (third - fourth) / 2.0


def _faces(first_N: float, second_N: float) -> tuple[float, float]:
    """F_3 and F_4 from the momentum of each part; unknowns are the two forces and the acceleration."""
    caps, gauge = quoted().sensor_caps_g, quoted().sensor_gauge_g
    parts = np.array([[1.0, 0.0, caps / 2], [1.0, -1.0, -gauge], [0.0, 1.0, -caps / 2]])
    third, fourth, _ = np.linalg.solve(parts, [first_N, 0.0, second_N])
    return float(third), float(fourth)


def contact_law() -> float:
    """Contact stiffness of the decks over that of Eq. (7)."""
    return float(case_of("table1").chain.stiffness[1]) / ptfe_beads().stiffness


@cache
def _wave(amplitude: float) -> travelling_wave.PrecompressedWave:
    """Exact wave of a given amplitude over the static force."""
    p = ptfe_beads()
    return solve_at_amplitude(p.stiffness, p.mass_kg, STATIC_N, amplitude)


def beta(amplitude: float, modulus_MPa: float = 1460) -> float:
    """Beta of a wave of a given amplitude over the static force."""
    chain = case_of("table1", f"materials.ptfe.youngs_modulus={modulus_MPa} MPa").chain
    stiffness, mass = float(chain.stiffness[1]), float(chain.mass_kg[0])
    return solve_at_amplitude(stiffness, mass, STATIC_N, amplitude).beta


def averaged_width() -> float:
    """Width of the averaged force at 0.2 % of its peak, in diameters."""
    return solve_travelling_wave().width(0.002, averaged=True)


def energy_in_five(outer_share: float) -> float:
    """Largest share of the energy in five neighbouring beads, per cent.

    Kinetic energy of the five, energy of the four contacts between them, and a share of that of the two outer contacts.
    """
    wave = solve_travelling_wave()
    velocity, force = CubicSpline(wave.place, wave.velocity), CubicSpline(wave.place, wave.force)

    def energy(centre: float, beads: int) -> float:
        # bead j at place j, contacts half a bead to either side
        place = np.arange(beads) - (beads - 1) / 2 + centre
        contact = np.arange(beads + 1) - beads / 2 + centre
        weight = np.ones(beads + 1)
        weight[[0, -1]] = outer_share
        kinetic = 0.5 * (velocity(place) ** 2).sum()
        return float(kinetic + 0.4 * (weight * np.maximum(force(contact), 0.0) ** (5 / 3)).sum())

    centres = np.linspace(-0.5, 0.5, 101)
    return 100 * max(energy(centre, 5) / energy(centre, 15) for centre in centres)


def strain_power(power: float) -> float:
    """Power of the speed in the peak overlap of exact waves of a chain with ``F ~ overlap^power``, at two speeds."""
    slow, fast = (float(fixed_point(power, speed)[1].max()) for speed in (1.0, 2.0))
    return float(np.log2(fast / slow))


def least_mach() -> float:
    """Smallest speed of exact waves over the speed of sound, for 0.1 to 1e4 static forces."""
    p = ptfe_beads()
    sound = travelling_wave.sound_speed(p.stiffness, p.mass_kg, STATIC_N)
    return min(_wave(amplitude).speed for amplitude in SWEPT_AMPLITUDES) / sound


def weakly_nonlinear() -> float:
    """Speed above that of sound of an exact wave of a tenth of the static force, over that of the KdV soliton.

    The soliton of this chain's KdV equation has ``V = c_0 [1 + (xi_m - xi_0) / (12 xi_0)]``, as Eq. (4) to first order.
    """
    p, amplitude = ptfe_beads(), 0.1
    wave = _wave(amplitude)
    excess = wave.speed / travelling_wave.sound_speed(p.stiffness, p.mass_kg, STATIC_N) - 1
    strain_above = (1 + amplitude) ** (2 / 3) - 1  # over the static one
    return float(excess / (strain_above / 12))


def narrow_interval() -> float:
    """Largest change of the speed of Eq. (4) for a tenth more relative amplitude, from 2 to 1000, per cent."""
    return max(100 * (_eq4(1.1 * f) / _eq4(f) - 1) for f in (2.0, 10.0, 100.0, 1000.0))


def face_average() -> float:
    """``(F_3 + F_4) / (F_1 + F_2)`` from Newton's law for two caps and a gauge that move as one body."""
    third, fourth = _faces(3.0, 1.0)
    return (third + fourth) / 4.0


def beta_spread() -> float:
    """Largest relative difference of beta between 600, 1000 and 1460 MPa, per cent."""
    found = np.array([[beta(a, modulus) for modulus in quoted().ptfe_moduli_MPa] for a in AMPLITUDES])
    return float(100 * ((found.max(axis=1) - found.min(axis=1)) / found.mean(axis=1)).max())


def averaging_lowers() -> float:
    """Peak of the averaged force over that of the contact force."""
    return 1 / solve_travelling_wave().contact_over_average


def averaging_widens() -> float:
    """Width of the averaged force at 0.2 % over that of the contact force."""
    wave = solve_travelling_wave()
    return wave.width(0.002, averaged=True) / wave.width(0.002, averaged=False)
