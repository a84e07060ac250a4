"""Spectra of signals: amplitudes, spectrograms, transfer functions, and harmonics of a drive.

Amplitude spectra are scaled by the mean of the window, so that a sine of amplitude A at a frequency of the spectrum
shows A. The resolution is 1 divided by the length of the record; the window makes a line wider (Harris, Proc. IEEE
66:51, 1978): hann by 4 such steps between its zeros, boxcar by 2.
"""

from dataclasses import dataclass
from math import floor, pi
from typing import Any

import numpy as np

from drivers.chain.chain import Array

WINDOWS = ("hann", "boxcar", "blackmanharris", "flattop")
PARTS = 16  # of a record, in the windows of its spectrogram
HARMONICS = 5
LEAST_AMPLITUDE = 1e-6  # of the largest of the source: smaller ones give no transfer function


@dataclass(frozen=True)
class Spectrum:
    """Amplitude spectrum of a signal; ``amplitude`` in the unit of the signal. Shape (frequencies,)."""

    frequency_Hz: Array
    amplitude: Array

    @property
    def resolution_Hz(self) -> float:
        """Distance of frequencies."""
        return float(self.frequency_Hz[1])


@dataclass(frozen=True)
class Harmonic:
    """Part ``amplitude sin(2 pi frequency t + phase_rad)`` of a signal."""

    frequency_Hz: float
    amplitude: float
    phase_rad: float


def spectrum_of(time_s: Array, signal: Array, window: str = "hann") -> Spectrum:
    """Amplitude spectrum of a signal without its mean. Samples are equally spaced; both shapes (samples,)."""
    from scipy.signal import periodogram

    frequency, power = periodogram(signal, _rate_Hz(time_s), window=window, detrend="constant", scaling="spectrum")
    return Spectrum(np.asarray(frequency), np.sqrt(2 * power))


def spectrogram_of(time_s: Array, signal: Array, window: str = "hann") -> tuple[Array, Array, Array]:
    """Times, frequencies and amplitudes of a spectrogram, from windows of a ``PARTS``th of the record that overlap.

    Frequencies between those of the window are interpolated by zeros after its samples. Shapes (times,),
    (frequencies,), (frequencies, times).
    """
    from scipy.signal import spectrogram

    length = min(max(len(signal) // PARTS, 8), len(signal))
    frequency, time, power = spectrogram(
        signal - signal.mean(), _rate_Hz(time_s), window=window, nperseg=length, noverlap=length * 3 // 4,
        nfft=8 * length, detrend=False, scaling="spectrum",
    )  # fmt: skip
    return np.asarray(time) + float(time_s[0]), np.asarray(frequency), np.sqrt(2 * np.asarray(power))


def transfer_of(time_s: Array, source: Array, target: Array, window: str = "hann") -> tuple[Array, Array]:
    """Frequencies and complex transfer function ``S_xy / S_xx`` from a source x to a target y. Shape (frequencies,).

    With one window over the whole record this is the quotient of the Fourier transforms. It is NaN where the amplitude
    of the source is below ``LEAST_AMPLITUDE`` of its largest.
    """
    from scipy.signal import csd

    def density(one: Array, other: Array) -> Any:
        return csd(one, other, _rate_Hz(time_s), window=window, nperseg=len(one), detrend="constant")

    (frequency, cross), power = density(source, target), density(source, source)[1].real
    with np.errstate(divide="ignore", invalid="ignore"):
        quotient = np.where(power > LEAST_AMPLITUDE**2 * power.max(), cross / power, np.nan)
    return np.asarray(frequency), np.asarray(quotient)


def harmonics_of(time_s: Array, signal: Array, frequency_Hz: float, count: int = HARMONICS) -> list[Harmonic]:
    """Parts of a signal at a frequency and its multiples, by least squares over the last whole number of periods.

    Multiples above half the sampling rate are left out.

    Raises:
        ValueError: the record is shorter than a period, or has fewer than four samples a period.
    """
    rate, length = _rate_Hz(time_s), float(time_s[-1] - time_s[0])
    periods = floor(length * frequency_Hz * (1 + 1e-12))
    if periods < 1:
        raise ValueError(f"the record of {length:.4g} s is shorter than a period of {1 / frequency_Hz:.4g} s")
    if rate < 4 * frequency_Hz:
        raise ValueError(f"{rate / frequency_Hz:.3g} samples a period of {frequency_Hz:g} Hz, at least 4 are needed")
    used = time_s >= time_s[-1] - periods / frequency_Hz * (1 + 1e-12)
    orders = [order for order in range(1, count + 1) if 2 * order * frequency_Hz < 0.99 * rate]
    angles = [2 * pi * order * frequency_Hz * time_s[used] for order in orders]
    columns = [np.ones(int(used.sum())), *(wave(angle) for angle in angles for wave in (np.sin, np.cos))]
    coefficients, *_ = np.linalg.lstsq(np.column_stack(columns), signal[used])
    return [
        Harmonic(order * frequency_Hz, float(np.hypot(sine, cosine)), float(np.arctan2(cosine, sine)))
        for order, sine, cosine in zip(orders, coefficients[1::2], coefficients[2::2], strict=True)
    ]


def _rate_Hz(time_s: Array) -> float:
    """Samples per second of equally spaced times."""
    return float((len(time_s) - 1) / (time_s[-1] - time_s[0]))
