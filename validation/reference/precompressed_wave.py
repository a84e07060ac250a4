"""The exact solitary wave of the discrete Hertz chain under a static force.

A wave of speed c (beads per second) whose overlaps exceed the static ones by ``w(j - c t)`` obeys
``m c^2 w = tent * (F(d + w) - F(d))`` with ``F = k overlap^(3/2)`` and the tent of half-width 1. With K = F'(d)
the linear part moves to the left, ``(m c^2 - K tent) w = tent * (F(d + w) - F(d) - K w)``, which Petviashvili's
iteration solves on a Fourier grid for every c above the speed of sound. Without a static force: ``travelling_wave``.
"""

from dataclasses import dataclass
from math import exp, log, sqrt

import numpy as np

from validation.reference.hertz_chain import EXPONENT, Array

POINTS_PER_BEAD, POINTS_PER_BEAD_LONG = (
    64,
    16,
)  # grid points, of steep waves and long ones: twice as many change nothing beyond rounding
LONG_WAVE_MACH = 1.05  # times the speed of sound: slower waves are long
TAIL_EXPONENT = 38.0  # e-folds until the tail has fallen below rounding
STABILISER_EXPONENT = 2.2  # exponent of Petviashvili's factor: the nonlinearity acts like a power between 3/2 and 2
ITERATIONS = 500
CHANGE_TOLERANCE = 1e-14  # relative change in an iteration
MAX_RESIDUAL = 1e-13
MAX_MACH = 1e4  # times the speed of sound
MIN_AMPLITUDE, MAX_AMPLITUDE = 1e-2, 1e20  # amplitudes over the static force, both tested


@dataclass(frozen=True)
class PrecompressedWave:
    """A solitary wave; forces are dynamic, that is above the static one.

    Attributes:
        place: in beads, about the peak; shape (points,).
        force_N: dynamic contact force at ``place``.
        static_N: the force it rides on.
        speed: in beads per second.
        residual: largest violation of the fixed-point equation, over the largest overlap.
    """

    place: Array
    force_N: Array
    static_N: float
    speed: float
    residual: float

    @property
    def average_N(self) -> Array:
        """Dynamic mean of two neighbouring contact forces: what a sensor bead reads."""
        half = round(0.5 / (self.place[1] - self.place[0]))
        return np.asarray((np.roll(self.force_N, half) + np.roll(self.force_N, -half)) / 2)

    @property
    def amplitude(self) -> float:
        """``(F_m - F_0) / F_0``."""
        return float(self.force_N.max()) / self.static_N

    @property
    def beta(self) -> float:
        """Peak dynamic contact force over the peak dynamic average: the coefficient of the paper's Eq. (6)."""
        return float(self.force_N.max() / self.average_N.max())


def sound_speed(stiffness: float, mass_kg: float, static_N: float) -> float:
    """Speed of long small waves in beads per second: ``sqrt(K/m)`` with ``K = (3/2) k^(2/3) F_0^(1/3)``."""
    return sqrt(EXPONENT * stiffness ** (2 / 3) * static_N ** (1 / 3) / mass_kg)


def solve_at_speed(stiffness: float, mass_kg: float, static_N: float, speed: float) -> PrecompressedWave:
    """The wave of a given speed, in beads per second.

    Raises:
        ValueError: a speed not above that of sound, or beyond ``MAX_MACH`` times it.
        ArithmeticError: the iteration did not get there (amplitudes below some 0.005 of the static force).
    """
    sound = sound_speed(stiffness, mass_kg, static_N)
    if not sound < speed <= MAX_MACH * sound:
        expected = f"above that of sound ({sound:g}), up to {MAX_MACH:g} times it"
        raise ValueError(f"speed: {speed:g} beads/s, expected {expected}")
    mach = speed / sound
    decay = _tail_decay(mach)
    per_bead = POINTS_PER_BEAD_LONG if mach < LONG_WAVE_MACH else POINTS_PER_BEAD
    points = 2 ** int(np.ceil(np.log2(2 * max(12.0, TAIL_EXPONENT / decay) * per_bead)))
    place = (np.arange(points) - points // 2) / per_bead
    tent = np.sinc(np.fft.rfftfreq(points, 1 / per_bead)) ** 2
    overlap = (static_N / stiffness) ** (1 / EXPONENT)
    rigidity = EXPONENT * static_N / overlap
    left = mass_kg * speed**2 - rigidity * tent

    def dynamic_force(w: Array) -> Array:
        return np.asarray(stiffness * np.maximum(overlap + w, 0.0) ** EXPONENT - static_N)

    def smooth(values: Array, kernel: Array) -> Array:
        return np.asarray(np.fft.irfft(np.fft.rfft(values) * kernel, points))

    wave = overlap * (mach**4 - 0.5) * np.exp(-((place * min(decay / 3, 1.0)) ** 2))
    for _ in range(ITERATIONS):
        image = smooth(dynamic_force(wave) - rigidity * wave, tent / left)
        new = float(wave @ wave / (wave @ image)) ** STABILISER_EXPONENT * image
        change = float(np.abs(new - wave).max() / np.abs(new).max())
        wave = new
        if change < CHANGE_TOLERANCE:
            break
    defect = smooth(dynamic_force(wave), tent) / (mass_kg * speed**2) - wave
    residual = float(np.abs(defect).max() / np.abs(wave).max())
    if not residual < MAX_RESIDUAL:
        raise ArithmeticError(f"the precompressed wave is not found: residual {residual:.1e}")
    return PrecompressedWave(place, dynamic_force(wave), static_N, speed, residual)


def solve_at_amplitude(stiffness: float, mass_kg: float, static_N: float, amplitude: float) -> PrecompressedWave:
    """The wave whose peak dynamic force is ``amplitude`` times the static force.

    Raises:
        ValueError: below ``MIN_AMPLITUDE``, where the wave is lost in rounding, or above ``MAX_AMPLITUDE``.
    """
    from scipy.optimize import brentq

    if not MIN_AMPLITUDE <= amplitude <= MAX_AMPLITUDE:
        raise ValueError(f"amplitude: {amplitude:g}, expected from {MIN_AMPLITUDE:g} to {MAX_AMPLITUDE:g}")

    sound = sound_speed(stiffness, mass_kg, static_N)
    # (c/c_0)^2 - 1 of the long-wave theory, Eq. (4) of the paper, is good to a few per cent
    f = (1 + amplitude) ** (2 / 3)
    guess = sqrt(4 / 15 * (3 + 2 * f**2.5 - 5 * f)) / (f - 1)

    def excess(log_mach_above: float) -> float:
        wave = solve_at_speed(stiffness, mass_kg, static_N, sound * (1 + exp(log_mach_above)))
        return log(wave.amplitude / amplitude)

    centre = log(guess - 1)
    root = float(brentq(excess, centre - 0.3, centre + 0.3, xtol=1e-12))
    return solve_at_speed(stiffness, mass_kg, static_N, sound * (1 + exp(root)))


def _tail_decay(mach: float) -> float:
    """The rate q at which the tail falls, per bead: ``mach^2 q^2 = 4 sinh^2(q/2)``."""
    from scipy.optimize import brentq

    return float(brentq(lambda q: mach * q - 2 * np.sinh(q / 2), 1e-6, 100.0))
