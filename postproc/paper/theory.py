"""The paper's equations (1) to (7): the long-wave theory of a chain of equal spheres, and its sensor bead.

x is the position along the chain, xi = -u_x the compressive strain, a the diameter of the particles; SI units.
Equation numbers are those of Daraio, Nesterenko, Herbold and Jin.
"""

from dataclasses import dataclass
from math import pi, sqrt

import numpy as np

from drivers.chain.case import Case
from drivers.chain.chain import Array, bead_mass, hertz_force, hertz_overlap
from drivers.scene.model import Member


@dataclass(frozen=True)
class Particles:
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


def long_wave_acceleration(particles: Particles, strain: Array, length_m: float) -> Array:
    """u_tt by Eq. (1) for a strain that is periodic over ``length_m``, differentiated on its Fourier grid.

    ``u_tt = -c^2 { xi^(3/2) + (a^2/10) xi^(1/4) (xi^(5/4))_xx }_x``, for xi > 0 at equally spaced positions.
    """
    a, c = particles.diameter_m, particles.speed_constant_m_s
    dispersive = strain**0.25 * _derivative(strain**1.25, length_m, 2)
    return -(c**2) * _derivative(strain**1.5 + a**2 / 10 * dispersive, length_m, 1)


def _derivative(values: Array, length_m: float, order: int) -> Array:
    wave_number = 2j * pi * np.fft.rfftfreq(len(values), length_m / len(values))
    return np.asarray(np.fft.irfft(np.fft.rfft(values) * wave_number**order, len(values)))


def lattice_acceleration(particles: Particles, displacement_m: Array) -> Array:
    """Accelerations of the beads of a closed chain: ``m u_tt = F_j - F_{j+1}`` with Hertz forces between neighbours.

    ``u_0 - u_1`` is the overlap of beads 0 and 1. There are beads + 1 displacements; the last is that of bead 0, one
    period further.
    """
    overlap = displacement_m[:-1] - displacement_m[1:]
    force = hertz_force(particles.stiffness, np.maximum(overlap, 0.0))
    return np.asarray((np.roll(force, 1) - force) / particles.mass_kg)


HUMP_WAVE_NUMBER = sqrt(10) / 5  # times 1/a
GRID = 64  # points of the Fourier grid over one period
HUMP_LENGTH = pi / HUMP_WAVE_NUMBER  # from zero to zero, in diameters: 4.967, "five" in the paper


def solitary_strain(particles: Particles, speed_m_s: float, place_m: Array) -> Array:
    """Eq. (2): one hump of the periodic solution, ``xi = (5 V^2 / 4 c^2)^2 cos^4(sqrt(10) x / 5a)``, else zero."""
    amplitude = (5 * speed_m_s**2 / (4 * particles.speed_constant_m_s**2)) ** 2
    angle = HUMP_WAVE_NUMBER * place_m / particles.diameter_m
    return np.asarray(np.where(np.abs(angle) < pi / 2, amplitude * np.cos(angle) ** 4, 0.0))


def stationary_residual(power: float, stretch: float = 1.0) -> float:
    """Largest violation of the long-wave equation by its periodic solution, divided by the largest of its terms.

    For ``F ~ overlap^n`` (n = 3/2: Eq. (1)) a wave of speed V satisfies the once integrated equation
    ``V^2 xi = c_n^2 { xi^n + n a^2 / (6 (n+1)) xi^((n-1)/2) (xi^((n+1)/2))_xx }``, solved by
    ``xi^((n-1)/2) = cos(k x)`` with ``k a = (n-1) (6 / (n (n+1)))^(1/2)`` and ``V^2 = 2 c_n^2 / (n+1)``: Eq. (2) for
    n = 3/2, a harmonic wave for n = 3. If (n+1)/(n-1) is whole, all terms are band-limited and derivatives are exact.

    Args:
        power: Exponent n of the contact law.
        stretch: Factor on the wave length; only 1 gives a solution.
    """
    n = power
    wave_number = (n - 1) * sqrt(6 / (n * (n + 1))) / stretch
    period = 2 * pi / wave_number
    root = np.cos(2 * pi * np.arange(GRID) / GRID)  # xi^((n-1)/2), with its sign
    curvature = _derivative(root ** ((n + 1) / (n - 1)), period, 2)
    right = root ** (2 * n / (n - 1)) + n / (6 * (n + 1)) * root * curvature
    left = 2 / (n + 1) * root ** (2 / (n - 1))
    return float(np.abs(left - right).max() / np.abs(left).max())


def speed_from_strain(particles: Particles, strain: float) -> float:
    """Eq. (3), first form: ``V_s = (2/sqrt 5) c xi_m^(1/4)``."""
    return float(2 / sqrt(5) * particles.speed_constant_m_s * strain**0.25)


def speed_from_velocity(particles: Particles, velocity_m_s: float) -> float:
    """Eq. (3), second form: ``V_s = (16/25)^(1/5) c^(4/5) v_m^(1/5)``."""
    return float((16 / 25) ** 0.2 * particles.speed_constant_m_s**0.8 * velocity_m_s**0.2)


def speed_from_force(particles: Particles, force_N: float) -> float:
    """Eq. (3), last form as printed: ``V_s = 0.68 (2 E / (a rho^(3/2) (1-nu^2)))^(1/3) F_m^(1/6)``."""
    return float(0.68 * _force_scale(particles) * force_N ** (1 / 6))


def _force_scale(particles: Particles) -> float:
    p = particles
    inside = 2 * p.youngs_modulus_Pa / (p.diameter_m * p.density_kg_m3**1.5 * (1 - p.poisson_ratio**2))
    return float(inside ** (1 / 3))


def force_coefficient(particles: Particles, speed_m_s: float, force_N: float) -> float:
    """Coefficient of Eq. (3), printed as 0.68, for a wave of this speed and peak force; for sound that of Eq. (4)."""
    return float(speed_m_s / (_force_scale(particles) * force_N ** (1 / 6)))


def sound_speed(particles: Particles, force_N: float) -> float:
    """c_0 of Eq. (1): ``c_0 = (3/2)^(1/2) c xi_0^(1/4)`` with the strain under a static force."""
    return float(sqrt(1.5) * particles.speed_constant_m_s * particles.strain(force_N) ** 0.25)


def precompressed_speed(particles: Particles, force_N: float, static_N: float) -> float:
    """Eq. (4): speed of a solitary wave of total peak force ``force_N`` on a chain under ``static_N``.

    ``V_s = 0.9314 (4 E^2 F_0 / (a^2 rho^3 (1-nu^2)^2))^(1/6) S / (f^(2/3) - 1)`` with ``f = F_m / F_0`` and
    ``S^2 = (4/15) [3 + 2 f^(5/3) - 5 f^(2/3)]``.
    """
    f = force_N / static_N
    bracket = 4 / 15 * (3 + 2 * f ** (5 / 3) - 5 * f ** (2 / 3))
    return float(0.9314 * _force_scale(particles) * static_N ** (1 / 6) * sqrt(bracket) / (f ** (2 / 3) - 1))


def sensor_forces(first_N: Array, second_N: Array, gauge_share: float) -> tuple[Array, Array]:
    """Eq. (5): forces F_3, F_4 on the faces of a gauge of mass m between two caps, 2M together.

    ``F_3,4 = (F_1 + F_2)/2 +- (F_1 - F_2)/2 m / (2M + m)``, F_1 on the side from which the wave comes; ``gauge_share``
    is m / (2M + m).
    """
    mean, half = (first_N + second_N) / 2, (first_N - second_N) / 2
    return mean + half * gauge_share, mean - half * gauge_share


def contact_force(beta: float, average_N: float, static_N: float) -> float:
    """Eq. (6): peak contact force ``F_m = beta F_{m,e} + F_0`` from the dynamic average of a sensor."""
    return beta * average_N + static_N


def bulk_modulus_to_youngs(bulk_speed_m_s: float, poisson_ratio: float, density_kg_m3: float) -> float:
    """Young's modulus in Pa from a bulk sound speed, ``E = 3 rho c_b^2 (1 - 2 nu)``."""
    return 3 * density_kg_m3 * bulk_speed_m_s**2 * (1 - 2 * poisson_ratio)


def hertz_contact(particles: Particles, force_N: float) -> tuple[float, float]:
    """Radius ``(3 F R* / 4 E*)^(1/3)`` in m, peak pressure ``3 F / (2 pi radius^2)`` in Pa (Hertz 1882)."""
    reduced_radius = particles.diameter_m / 4
    reduced_modulus = particles.youngs_modulus_Pa / (2 * (1 - particles.poisson_ratio**2))
    radius_m = (3 * force_N * reduced_radius / (4 * reduced_modulus)) ** (1 / 3)
    return radius_m, 3 * force_N / (2 * pi * radius_m**2)
