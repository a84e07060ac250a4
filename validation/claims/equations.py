"""Claims on the long-wave equation and on exact solitary waves, with and without static force."""

from functools import cache

import numpy as np
from scipy.interpolate import CubicSpline

from postproc.paper import theory
from postproc.paper.quoted import quoted
from postproc.paper.simulate import case_of
from validation.claims.paper_numbers import STATIC_N, ptfe_beads, speed_by_eq4
from validation.reference import travelling_wave
from validation.reference.travelling_wave import fixed_point, solve_at_amplitude, solve_travelling_wave

AMPLITUDES = (1.0, 10.0, 100.0)  # dynamic force divided by the static force
SWEPT_AMPLITUDES = (0.1, 1.0, 10.0, 100.0, 1e3, 1e4)


def convergence_order() -> float:
    """Order in a/L with which accelerations of the lattice converge to those of Eq. (1), for three wave lengths."""
    p, mean, swing = ptfe_beads(), 0.01, 0.006
    errors = []
    # the largest difference of accelerations divided by the largest one, for one period of a strongly modulated strain
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


def discrete_force_coefficient() -> float:
    """The coefficient of the last form of Eq. (3) for the exact solitary wave of the discrete chain."""
    p, wave = ptfe_beads(), solve_travelling_wave()
    speed = wave.speed_by_force * p.stiffness ** (1 / 3) * p.mass_kg**-0.5 * p.diameter_m  # at 1 N
    return theory.force_coefficient(p, speed, 1.0)


def precompressed_discrete() -> float:
    """Largest deviation of Eq. (4) from the exact wave of the discrete chain, for 0.1 to 1e4 static forces."""
    diameter_m = ptfe_beads().diameter_m
    return max(
        abs(speed_by_eq4(1 + amplitude) / (_wave(amplitude).speed * diameter_m) - 1) for amplitude in SWEPT_AMPLITUDES
    )


@cache
def _wave(amplitude: float, modulus_MPa: float = 1460) -> travelling_wave.PrecompressedWave:
    """Exact wave of a given dynamic force, divided by the static force."""
    chain = case_of("table1", f"materials.ptfe.youngs_modulus={modulus_MPa} MPa").chain
    return solve_at_amplitude(float(chain.stiffness[1]), float(chain.mass_kg[0]), STATIC_N, amplitude)


def beta(amplitude: float) -> float:
    """Beta of a wave of a given dynamic force, divided by the static force."""
    return _wave(amplitude).beta


def beta_spread() -> float:
    """Largest relative difference of beta between 600, 1000 and 1460 MPa, per cent."""
    betas = np.array(
        [[_wave(amplitude, modulus).beta for modulus in quoted().ptfe_moduli_MPa] for amplitude in AMPLITUDES]
    )
    return float(100 * ((betas.max(axis=1) - betas.min(axis=1)) / betas.mean(axis=1)).max())


def width_at_half(amplitude: float) -> float:
    """Width at half the peak of a wave of a given dynamic force divided by the static force, in diameters."""
    wave = _wave(amplitude)
    return float(np.ptp(wave.place[wave.force_N > wave.force_N.max() / 2]))


def wave_width(of: str) -> float:
    """Width of the exact wave at 0.2 % of its peak, of the averaged or of the contact force, in diameters."""
    return solve_travelling_wave().width(0.002, averaged=of == "average")


def averaging_lowers() -> float:
    """Peak of the averaged force divided by that of the contact force."""
    return 1 / solve_travelling_wave().contact_over_average


def averaging_widens() -> float:
    """Width of the averaged force at 0.2 % divided by that of the contact force."""
    return wave_width("average") / wave_width("contact")


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


def _sound() -> float:
    """Speed of sound of the discrete chain under the static force, beads per second."""
    p = ptfe_beads()
    return travelling_wave.sound_speed(p.stiffness, p.mass_kg, STATIC_N)


def least_mach() -> float:
    """Smallest speed of exact waves divided by the speed of sound, for 0.1 to 1e4 static forces."""
    return min(_wave(amplitude).speed for amplitude in SWEPT_AMPLITUDES) / _sound()


def weakly_nonlinear() -> float:
    """Speed above that of sound of an exact wave of a tenth of the static force, divided by that of the KdV soliton.

    The soliton of this chain's KdV equation has ``V = c_0 [1 + (xi_m - xi_0) / (12 xi_0)]``, as Eq. (4) to first order.
    """
    amplitude = 0.1
    strain_above = (1 + amplitude) ** (2 / 3) - 1  # divided by the static one
    return float((_wave(amplitude).speed / _sound() - 1) / (strain_above / 12))
