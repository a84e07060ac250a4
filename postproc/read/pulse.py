"""Shape of a pulse and of a train of them: exponential envelope, rise, decay, duration."""

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import make_interp_spline

from drivers.chain.chain import Array
from postproc.read.signals import Peak, peaks, rising_crossing

ONSET = 0.02
UNLIKE = 2.0
ENVELOPE_MAXIMA = 3  # that the envelope of a train goes through
FINER = 100  # times the samples: where the fit and the pulse end


@dataclass(frozen=True)
class Envelope:
    """``amplitude_N exp(rate_per_s t)`` through maxima, by least squares of the logarithm."""

    amplitude_N: float
    rate_per_s: float

    def at(self, time_s: Array) -> Array:
        """The envelope's force, same shape as ``time_s``."""
        return np.asarray(self.amplitude_N * np.exp(self.rate_per_s * time_s))


def envelope(maxima: list[Peak]) -> Envelope:
    """The exponential through maxima; at least two are needed."""
    rate, start = np.polyfit([peak.time_s for peak in maxima], np.log([peak.value for peak in maxima]), 1)
    return Envelope(float(np.exp(start)), float(rate))


def train_envelope(maxima: list[Peak]) -> Envelope | None:
    """The exponential through a train's first ``ENVELOPE_MAXIMA``; None where there are fewer, or one is not above 0.

    Maxima of a train come at like intervals: one more than twice as late as another belongs to what comes back later.

    Args:
        maxima: in the order of time.
    """
    leading = maxima[:ENVELOPE_MAXIMA]
    if len(leading) < ENVELOPE_MAXIMA or min(peak.value for peak in leading) <= 0:
        return None
    intervals = np.diff([peak.time_s for peak in leading])
    return envelope(leading) if intervals.max() <= UNLIKE * intervals.min() else None


@dataclass(frozen=True)
class PulseShape:
    """An incident pulse at one place.

    Attributes:
        peak: its first maximum.
        rise_s: from ``ONSET`` of the peak to the peak.
        decay_per_s: rate of the exponential from the peak to half of it; NaN if it never falls so far.
        duration_s: from ``ONSET`` until it first falls below that again, or until the reflected wave arrives.
    """

    peak: Peak
    rise_s: float
    decay_per_s: float
    duration_s: float


def incident_pulse(time_s: Array, signal: Array) -> PulseShape | None:
    """The shape of the first pulse of a signal whose largest later maximum is the reflected wave; None without them.

    Args:
        time_s: equally spaced. Shape (samples,).
        signal: above its static value. Shape (samples,).
    """
    found = peaks(time_s, signal)
    if len(found) < 2:
        return None
    first, reflected = found[0], max(found[1:], key=lambda peak: peak.value)
    onset = rising_crossing(time_s, signal, ONSET * first.value, first)
    after = np.linspace(first.time_s, reflected.time_s, FINER * (reflected.sample - first.sample))
    falling = np.asarray(make_interp_spline(time_s, signal, k=5)(after))
    half = int(np.argmax(falling < first.value / 2))
    rate = np.polyfit(after[:half], np.log(falling[:half]), 1)[0] if half > 1 else np.nan
    quiet = falling < ONSET * first.value
    end = int(np.argmax(quiet)) if quiet.any() else int(np.argmin(falling))
    return PulseShape(first, first.time_s - onset, float(rate), float(after[end]) - onset)
