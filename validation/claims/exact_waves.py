"""What the paper says of solitary waves, computed from the exact travelling wave of the discrete chain."""

import numpy as np
from scipy.interpolate import CubicSpline

from postproc.paper.quoted import quoted
from postproc.paper.simulate import case_of
from validation.reference.precompressed_wave import PrecompressedWave, solve_at_amplitude
from validation.reference.travelling_wave import fixed_point, solve_travelling_wave

STATIC_N = 0.02  # any static force: only the amplitude over it matters
AMPLITUDES = (1.0, 10.0, 100.0)


def _precompressed(amplitude: float, modulus_MPa: float = 1460) -> PrecompressedWave:
    chain = case_of("table1", f"materials.ptfe.youngs_modulus={modulus_MPa} MPa").chain
    return solve_at_amplitude(float(chain.stiffness[1]), float(chain.mass_kg[0]), STATIC_N, amplitude)


def averaged_width() -> float:
    """Width of the averaged force at 0.2 % of its peak, in diameters."""
    return solve_travelling_wave().width(0.002, averaged=True)


def energy_in_five() -> float:
    """Share of the energy in five neighbouring beads, in per cent, at the moment when it is largest.

    Kinetic energy of the five, and the energy of their six contacts, of the outer two one half.
    """
    wave = solve_travelling_wave()
    velocity, force = CubicSpline(wave.place, wave.velocity), CubicSpline(wave.place, wave.force)

    def share(centre: float, beads: int) -> float:
        # bead j at place j, contacts half a bead to either side
        place = np.arange(beads) - (beads - 1) / 2 + centre
        contact = np.arange(beads + 1) - beads / 2 + centre
        weight = np.ones(beads + 1)
        weight[[0, -1]] = 0.5
        kinetic = 0.5 * (velocity(place) ** 2).sum()
        return float(kinetic + 0.4 * (weight * np.maximum(force(contact), 0.0) ** (5 / 3)).sum())

    centres = np.linspace(-0.5, 0.5, 101)
    return 100 * max(share(centre, 5) / share(centre, 15) for centre in centres)


def power_three() -> float:
    """Power of the speed in the peak overlap of exact waves of a chain with F ~ overlap^3, at two speeds."""
    slow, fast = (float(fixed_point(3.0, speed)[1].max()) for speed in (1.0, 2.0))
    return float(np.log2(fast / slow))


def beta_linear() -> float:
    """Beta of a wave of a tenth of the static force."""
    return _precompressed(0.1).beta


def beta_spread() -> float:
    """Largest relative difference of beta between 600, 1000 and 1460 MPa, per cent."""
    found = np.array([[_precompressed(a, modulus).beta for modulus in quoted().ptfe.moduli_MPa] for a in AMPLITUDES])
    return float(100 * ((found.max(axis=1) - found.min(axis=1)) / found.mean(axis=1)).max())


def averaging_lowers() -> float:
    """Peak of the averaged force over that of the contact force."""
    return 1 / solve_travelling_wave().contact_over_average


def averaging_widens() -> float:
    """Width of the averaged force at 0.2 % over that of the contact force."""
    wave = solve_travelling_wave()
    return wave.width(0.002, averaged=True) / wave.width(0.002, averaged=False)
