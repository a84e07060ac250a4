"""Differences between two traces, relative to the largest change of force: a static load does not count."""

from math import nan

import numpy as np

from drivers.chain.chain import Array, Chain, energy_put_in
from drivers.chain.trace import Trace

FORCE = "force"  # quantity: forces of all contacts
REST_SHARE = 1e-12  # of the largest force: smaller changes are rounding


def is_at_rest(force_N: Array) -> bool:
    """True if no force changes by more than rounding. Shape (samples, contacts)."""
    change_N, largest_N = _largest(force_N)
    return change_N <= REST_SHARE * largest_N


def largest_change_N(force_N: Array) -> float:
    """Largest ``|F - F(0)|`` of any contact, the scale of force errors. Shape (samples, contacts).

    If nothing moves, the largest force; 1 N if there is no force.
    """
    change_N, largest_N = _largest(force_N)
    return (largest_N if change_N <= REST_SHARE * largest_N else change_N) or 1.0


def _largest(force_N: Array) -> tuple[float, float]:
    """Largest ``|F - F(0)|`` and ``|F|`` of any contact, from the extremes of each: no copy of a large array."""
    low, high, start = force_N.min(axis=0), force_N.max(axis=0), force_N[0]
    return float(np.maximum(high - start, start - low).max()), float(np.maximum(high, -low).max())


def static_load_remark(share: float, reference_N: Array) -> str:
    """Remark with the same error relative to the largest force, if that is more than twice the largest change."""
    plain, scale_N = float(np.abs(reference_N).max()), largest_change_N(reference_N)
    return f", {share * scale_N / plain:.1e} of the largest force" if plain > 2 * scale_N else ""


def largest_kinetic_J(chain: Chain, motion: Trace) -> float:
    """Largest kinetic energy, the scale of energy errors; if nothing moves, the energy put in."""
    kinetic, put_in = float(motion.kinetic_energy_J.max()), energy_put_in(chain, float(motion.time_s[-1]))
    return kinetic if kinetic > REST_SHARE * put_in else put_in or 1.0


def share_of_change(difference_N: Array, reference: Trace) -> Array:
    """Force difference divided by the largest change of force of the reference."""
    return np.asarray(difference_N / largest_change_N(reference.force_N))


def residual(trace: Trace, reference: Trace) -> Array:
    """Largest difference at each sample, divided by the reference's largest change of force. Shape (samples,)."""
    return share_of_change(np.abs(trace.force_N - reference.force_N).max(axis=1), reference)


def parted_s(trace: Trace, other: Trace, limit: float) -> float:
    """Time in s at which the residual first exceeds a limit; NaN if it never does."""
    beyond = residual(trace, other) > limit
    return float(trace.time_s[np.argmax(beyond)]) if beyond.any() else nan
