"""How far two traces are from each other."""

from math import nan

import numpy as np

from drivers.chain.chain import Array
from drivers.chain.trace import Trace


def share_of_largest(difference_N: Array, reference: Trace) -> Array:
    """A force difference over the largest force of the reference; of a chain without forces: over 1 N."""
    return np.asarray(difference_N / (float(np.abs(reference.force_N).max()) or 1.0))


def residual(trace: Trace, reference: Trace) -> Array:
    """Largest difference over all contacts at each sample, over the reference's largest force. Shape (samples,)."""
    return share_of_largest(np.abs(trace.force_N - reference.force_N).max(axis=1), reference)


def apart(trace: Trace, other: Trace, limit: float) -> tuple[float, float]:
    """Largest residual, and the time in s at which it first passes a limit; NaN: never."""
    share = residual(trace, other)
    beyond = share > limit
    return float(share.max()), float(trace.time_s[np.argmax(beyond)]) if beyond.any() else nan
