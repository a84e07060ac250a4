"""The exact solitary wave of the discrete Hertz chain without precompression.

A wave of speed c (beads per second) with overlaps ``phi(j - c t)`` obeys the advance-delay equation
``m c^2 phi'' = k (G(x+1) - 2 G(x) + G(x-1))`` with ``G = phi^(3/2)``. Integrated twice it says
``phi = (k / m c^2) tent * G``, with the tent of half-width 1 (English and Pego, Proc. AMS 133:1763, 2005):
a fixed point, found here with m = k = c = 1 by Petviashvili's iteration on a Fourier grid.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache

import numpy as np

from validation.reference.hertz_chain import ENERGY_SHARE, EXPONENT, Array

LENGTH_BEADS = 24.0  # beads: the wave falls double-exponentially, to nothing within 4
POINTS = 2048
ITERATIONS = 200
MAX_RESIDUAL = 5e-15


@dataclass(frozen=True)
class TravellingWave:
    """The wave with m = k = c = 1: its profiles and what follows for any chain.

    Attributes:
        place: in beads, about the peak; shape (points,).
        force: contact force at ``place``.
        velocity: of a bead at ``place``.
        residual: largest violation of the fixed-point equation, over the largest overlap.
        speed_by_force: c = this times k^(1/3) m^(-1/2) F_m^(1/6).
        speed_by_velocity: c = this times (k/m)^(2/5) v_m^(1/5).
        force_by_velocity: F_m = this times k^(2/5) m^(3/5) v_m^(6/5).
        momentum_by_velocity: momentum = this times m v_m.
        energy_by_velocity: energy = this times m v_m^2.
        kinetic_share: of the energy, averaged over a period.
    """

    place: Array
    force: Array
    velocity: Array
    residual: float
    speed_by_force: float
    speed_by_velocity: float
    force_by_velocity: float
    momentum_by_velocity: float
    energy_by_velocity: float
    kinetic_share: float

    @property
    def contact_over_average(self) -> float:
        """Peak contact force over the peak of a sensor's average of two: beta of Eq. (6) without precompression."""
        from scipy.interpolate import CubicSpline

        force = CubicSpline(self.place, self.force)
        return float(self.force.max() / force(0.5))

    def width(self, level: float, *, averaged: bool) -> float:
        """Full width in beads at a share of the peak, of the contact force or of a sensor's average of two.

        The average of neighbouring contacts is taken half a bead to either side.
        """
        from scipy.interpolate import CubicSpline
        from scipy.optimize import brentq

        force = CubicSpline(self.place, self.force)
        half = 0.5 if averaged else 0.0

        def signal(x: float) -> float:
            return float(force(x - half) + force(x + half)) / 2

        return 2 * float(brentq(lambda x: signal(x) - level * signal(0.0), 0.0, 6.0, xtol=1e-14))


def fixed_point(power: float = EXPONENT, speed: float = 1.0) -> tuple[Array, Array, float]:
    """The wave of a speed in a chain with ``F = overlap^power`` and m = 1, by Petviashvili's iteration.

    Returns:
        Places in beads, overlaps there, and the largest violation of the equation over the largest overlap.

    Raises:
        ArithmeticError: the fixed point was not reached.
    """
    place: Array = (np.arange(POINTS, dtype=float) - POINTS // 2) * (LENGTH_BEADS / POINTS)

    def image_of(overlap: Array) -> Array:
        return _smooth(np.maximum(overlap, 0.0) ** power, 2) / speed**2

    overlap = speed ** (2 / (power - 1)) * np.exp(-(place**2))
    for _ in range(ITERATIONS):
        image = image_of(overlap)
        overlap = float(overlap @ overlap / (overlap @ image)) ** (power / (power - 1)) * image
    residual = float(np.abs(image_of(overlap) - overlap).max() / overlap.max())
    if not residual < MAX_RESIDUAL:
        raise ArithmeticError(f"the travelling wave is not found: residual {residual:.1e}")
    return place, overlap, residual


def _smooth(values: Array, times: int) -> Array:
    """Convolution with the box of width 1, once or twice: twice is the tent."""
    wave_number = np.fft.rfftfreq(POINTS, LENGTH_BEADS / POINTS)
    return np.asarray(np.fft.irfft(np.fft.rfft(values) * np.sinc(wave_number) ** times, POINTS))


@cache
def solve_travelling_wave() -> TravellingWave:
    """The wave of the Hertz chain and what follows from it.

    Raises:
        ArithmeticError: it was not found.
    """
    place, overlap, residual = fixed_point()
    force = np.maximum(overlap, 0.0) ** EXPONENT
    velocity = _smooth(force, 1)
    spacing = LENGTH_BEADS / POINTS
    peak_force, peak_velocity = float(force.max()), float(velocity.max())
    momentum = float(velocity.sum()) * spacing
    kinetic = 0.5 * float(velocity @ velocity) * spacing
    elastic = ENERGY_SHARE * float(force @ np.maximum(overlap, 0.0)) * spacing
    return TravellingWave(
        place=place,
        force=force,
        velocity=velocity,
        residual=residual,
        speed_by_force=peak_force ** (-1 / 6),
        speed_by_velocity=peak_velocity ** (-1 / 5),
        force_by_velocity=peak_force * peak_velocity ** (-6 / 5),
        momentum_by_velocity=momentum / peak_velocity,
        energy_by_velocity=(kinetic + elastic) / peak_velocity**2,
        kinetic_share=kinetic / (kinetic + elastic),
    )


def constants(wave: TravellingWave) -> Iterator[str]:
    """Lines with the wave's constants for any chain."""
    yield f"speed c         = {wave.speed_by_force:.10f} k^(1/3) m^(-1/2) F_m^(1/6)   beads per second"
    yield f"                = {wave.speed_by_velocity:.10f} (k/m)^(2/5) v_m^(1/5)"
    yield f"force F_m       = {wave.force_by_velocity:.10f} k^(2/5) m^(3/5) v_m^(6/5)"
    yield f"momentum        = {wave.momentum_by_velocity:.10f} m v_m"
    yield f"energy          = {wave.energy_by_velocity:.10f} m v_m^2, of which kinetic {wave.kinetic_share:.10f}"
    for averaged, name in ((True, "sensor average"), (False, "contact force ")):
        widths = ", ".join(f"{wave.width(x, averaged=averaged):.6f} at {x:g}" for x in (0.002, 0.04, 0.5))
        yield f"width, {name}: {widths} of the peak (beads)"
    yield f"residual of the fixed point: {wave.residual:.1e}"
