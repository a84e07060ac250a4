"""Exact solitary wave of the discrete Hertz chain, with and without precompression.

A wave of speed c (beads per second) with overlaps ``phi(j - c t)`` obeys the advance-delay equation
``m c^2 phi'' = k (G(x+1) - 2 G(x) + G(x-1))`` with ``G = phi^(3/2)``. Two integrations give the fixed-point equation
``phi = (k / m c^2) tent * G``, where * is a convolution and the tent function has half-width 1 (English and Pego, Proc.
AMS 133:1763, 2005). It is solved here for m = k = c = 1 by Petviashvili's iteration on a Fourier grid.

In a chain with static overlap d, overlaps are ``d + w(j - c t)``, with
``m c^2 w = tent * (F(d + w) - F(d))`` and ``F = k overlap^(3/2)``. With K = F'(d) the linear part moves to the left,
``(m c^2 - K tent) w = tent * (F(d + w) - F(d) - K w)``, and the iteration converges for every c above the sound speed.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cache, cached_property
from math import exp, log, sqrt
from typing import Any

import numpy as np

from validation.reference.hertz_chain import ENERGY_SHARE, EXPONENT, Array

LENGTH_BEADS = 24.0  # length of the grid; the wave decays double-exponentially and vanishes within 4 beads
POINTS = 2048
ITERATIONS = 200
MAX_RESIDUAL = 5e-15
# precompressed chain, steep and long waves: doubling the points changes results by rounding only
POINTS_PER_BEAD, POINTS_PER_BEAD_LONG = 64, 16
LONG_WAVE_MACH = 1.05  # waves below this Mach number count as long
TAIL_EXPONENT = 38.0  # e-folds after which the tail is below rounding
STABILISER_EXPONENT = 2.2  # of Petviashvili's factor, for a nonlinearity with an effective power between 3/2 and 2
MAX_ITERATIONS = 500
CHANGE_TOLERANCE = 1e-14  # relative change per iteration
MAX_RESIDUAL_PRECOMPRESSED = 1e-13
MAX_MACH = 1e4
MIN_AMPLITUDE, MAX_AMPLITUDE = 1e-2, 1e20  # divided by the static force


@dataclass(frozen=True)
class TravellingWave:
    """Wave for m = k = c = 1, with coefficients of the scaling laws for any chain.

    Attributes:
        place: Distance from the peak in beads; shape (points,).
        force: Contact force at ``place``.
        velocity: Bead velocity at ``place``.
        residual: Largest residual of the fixed-point equation divided by the largest overlap.
        speed_by_force: c = this times k^(1/3) m^(-1/2) F_m^(1/6).
        speed_by_velocity: c = this times (k/m)^(2/5) v_m^(1/5).
        force_by_velocity: F_m = this times k^(2/5) m^(3/5) v_m^(6/5).
        momentum_by_velocity: momentum = this times m v_m.
        energy_by_velocity: energy = this times m v_m^2.
        kinetic_share: Kinetic energy divided by total energy, averaged over a period.
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
        """Peak contact force divided by peak sensor reading (mean of two contacts), beta of Eq. (6) for F_0 = 0."""
        return float(self.force.max() / self.curve(0.5))

    @cached_property
    def curve(self) -> Any:
        """Spline of the contact force against the distance from the peak in beads."""
        from scipy.interpolate import CubicSpline  # takes longer to load than all others

        return CubicSpline(self.place, self.force)

    def width(self, level: float, *, averaged: bool) -> float:
        """Full width in beads at the fraction ``level`` of the peak.

        The signal is the contact force or, if ``averaged``, a sensor's mean of the contacts half a bead to either side.
        """
        half = 0.5 if averaged else 0.0

        def signal(x: float) -> float:
            return float(self.curve(x - half) + self.curve(x + half)) / 2

        return 2 * _root(lambda x: signal(x) - level * signal(0.0), 0.0, 6.0, 1e-14)


def _root(function: Callable[[float], float], low: float, high: float, tolerance: float = 2e-12) -> float:
    from scipy.optimize import brentq  # as above

    return float(brentq(function, low, high, xtol=tolerance))


def fixed_point(power: float = EXPONENT, speed: float = 1.0) -> tuple[Array, Array, float]:
    """Wave of a given speed in a chain with ``F = overlap^power`` and m = 1, by Petviashvili's iteration.

    Returns:
        Places in beads, overlaps there, and the largest residual of the equation divided by the largest overlap.

    Raises:
        ArithmeticError: the iteration did not converge.
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
        raise ArithmeticError(f"the travelling wave did not converge: residual {residual:.1e}")
    return place, overlap, residual


def _smooth(values: Array, times: int) -> Array:
    """Convolution with the box of width 1, once or twice; twice equals the tent function."""
    return _convolved(values, np.sinc(np.fft.rfftfreq(POINTS, LENGTH_BEADS / POINTS)) ** times)


def _convolved(values: Array, kernel: Array) -> Array:
    """Convolution with a kernel given in Fourier space."""
    return np.asarray(np.fft.irfft(np.fft.rfft(values) * kernel, len(values)))


@cache
def solve_travelling_wave() -> TravellingWave:
    """Solitary wave of the Hertz chain without precompression.

    Raises:
        ArithmeticError: the iteration did not converge.
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


@dataclass(frozen=True)
class PrecompressedWave:
    """Solitary wave of a precompressed chain; dynamic forces are total minus static forces.

    Attributes:
        place: Distance from the peak in beads; shape (points,).
        force_N: Dynamic contact force at ``place``.
        static_N: Static force, F_0.
        speed: Speed in beads per second.
    """

    place: Array
    force_N: Array
    static_N: float
    speed: float

    @property
    def average_N(self) -> Array:
        """Dynamic mean of two neighbouring contact forces, the reading of a sensor bead."""
        half = round(0.5 / (self.place[1] - self.place[0]))
        return np.asarray((np.roll(self.force_N, half) + np.roll(self.force_N, -half)) / 2)

    @property
    def amplitude(self) -> float:
        """Peak dynamic force divided by the static force, ``(F_m - F_0) / F_0``."""
        return float(self.force_N.max()) / self.static_N

    @property
    def beta(self) -> float:
        """Peak dynamic contact force divided by peak dynamic average, the coefficient of the paper's Eq. (6)."""
        return float(self.force_N.max() / self.average_N.max())


def sound_speed(stiffness: float, mass_kg: float, static_N: float) -> float:
    """Sound speed in beads per second, ``sqrt(K/m)`` with ``K = (3/2) k^(2/3) F_0^(1/3)``."""
    return sqrt(EXPONENT * stiffness ** (2 / 3) * static_N ** (1 / 3) / mass_kg)


def solve_at_speed(stiffness: float, mass_kg: float, static_N: float, speed: float) -> PrecompressedWave:
    """Wave with a given speed in beads per second.

    Raises:
        ValueError: the speed is not above the sound speed, or above ``MAX_MACH`` times the sound speed.
        ArithmeticError: the iteration did not converge, as for amplitudes below about 0.005 of the static force.
    """
    sound = sound_speed(stiffness, mass_kg, static_N)
    if not sound < speed <= MAX_MACH * sound:
        expected = f"above the sound speed ({sound:g}), up to {MAX_MACH:g} times the sound speed"
        raise ValueError(f"speed: {speed:g} beads/s, expected {expected}")
    mach = speed / sound
    # the tail decays as exp(-q x), mach^2 q^2 = 4 sinh^2(q / 2)
    decay = _root(lambda q: mach * q - 2 * float(np.sinh(q / 2)), 1e-6, 100.0)
    per_bead = POINTS_PER_BEAD_LONG if mach < LONG_WAVE_MACH else POINTS_PER_BEAD
    points = 2 ** int(np.ceil(np.log2(2 * max(12.0, TAIL_EXPONENT / decay) * per_bead)))
    place = (np.arange(points) - points // 2) / per_bead
    tent = np.sinc(np.fft.rfftfreq(points, 1 / per_bead)) ** 2
    overlap = (static_N / stiffness) ** (1 / EXPONENT)
    rigidity = EXPONENT * static_N / overlap
    left = mass_kg * speed**2 - rigidity * tent

    def dynamic_force(w: Array) -> Array:
        return np.asarray(stiffness * np.maximum(overlap + w, 0.0) ** EXPONENT - static_N)

    wave = overlap * (mach**4 - 0.5) * np.exp(-((place * min(decay / 3, 1.0)) ** 2))
    for _ in range(MAX_ITERATIONS):
        image = _convolved(dynamic_force(wave) - rigidity * wave, tent / left)
        new = float(wave @ wave / (wave @ image)) ** STABILISER_EXPONENT * image
        change = float(np.abs(new - wave).max() / np.abs(new).max())
        wave = new
        if change < CHANGE_TOLERANCE:
            break
    defect = _convolved(dynamic_force(wave), tent) / (mass_kg * speed**2) - wave
    residual = float(np.abs(defect).max() / np.abs(wave).max())
    if not residual < MAX_RESIDUAL_PRECOMPRESSED:
        raise ArithmeticError(f"the precompressed wave did not converge: residual {residual:.1e}")
    return PrecompressedWave(place, dynamic_force(wave), static_N, speed)


def solve_at_amplitude(stiffness: float, mass_kg: float, static_N: float, amplitude: float) -> PrecompressedWave:
    """Wave with a peak dynamic force of ``amplitude`` times the static force.

    Raises:
        ValueError: the amplitude is below ``MIN_AMPLITUDE`` (lost in rounding) or above ``MAX_AMPLITUDE``.
    """
    if not MIN_AMPLITUDE <= amplitude <= MAX_AMPLITUDE:
        raise ValueError(f"amplitude: {amplitude:g}, expected from {MIN_AMPLITUDE:g} to {MAX_AMPLITUDE:g}")

    sound = sound_speed(stiffness, mass_kg, static_N)
    # long-wave theory, Eq. (4) of the paper: (c/c_0)^2 - 1 is accurate to a few per cent
    f = (1 + amplitude) ** (2 / 3)
    guess = sqrt(4 / 15 * (3 + 2 * f**2.5 - 5 * f)) / (f - 1)

    def excess(log_mach_above: float) -> float:
        wave = solve_at_speed(stiffness, mass_kg, static_N, sound * (1 + exp(log_mach_above)))
        return log(wave.amplitude / amplitude)

    centre = log(guess - 1)
    root = _root(excess, centre - 0.3, centre + 0.3, 1e-12)
    return solve_at_speed(stiffness, mass_kg, static_N, sound * (1 + exp(root)))


def constants(wave: TravellingWave) -> Iterator[str]:
    """Lines of text with the coefficients of the scaling laws."""
    yield f"speed c         = {wave.speed_by_force:.10f} k^(1/3) m^(-1/2) F_m^(1/6)   beads per second"
    yield f"                = {wave.speed_by_velocity:.10f} (k/m)^(2/5) v_m^(1/5)"
    yield f"force F_m       = {wave.force_by_velocity:.10f} k^(2/5) m^(3/5) v_m^(6/5)"
    yield f"momentum        = {wave.momentum_by_velocity:.10f} m v_m"
    yield f"energy          = {wave.energy_by_velocity:.10f} m v_m^2, kinetic share {wave.kinetic_share:.10f}"
    for averaged, name in ((True, "sensor average"), (False, "contact force ")):
        widths = ", ".join(f"{wave.width(x, averaged=averaged):.6f} at {x:g}" for x in (0.002, 0.04, 0.5))
        yield f"width, {name}: {widths} of the peak (beads)"
    yield f"residual of the fixed point: {wave.residual:.1e}"
