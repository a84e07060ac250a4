"""How far two traces are from each other, as shares of what changes: a static load is none of it."""

from math import nan

import numpy as np

from drivers.chain.chain import Array, Chain, energy_put_in
from drivers.chain.trace import Trace

STILL = 1e-12  # of the largest force: what changes less is rounding, and nothing moves


def still(force_N: Array) -> bool:
    """Whether nothing moves, but by rounding. Shape (samples, contacts)."""
    return bool(np.abs(force_N - force_N[0]).max() <= STILL * np.abs(force_N).max())


def largest_change_N(force_N: Array) -> float:
    """Largest ``|F - F(0)|`` of any contact, over which errors of forces are counted. Shape (samples, contacts).

    Where nothing moves, the largest force; 1 N where there is none.
    """
    change = np.abs(force_N if still(force_N) else force_N - force_N[0])
    return float(change.max()) or 1.0


def beside(share: float, reference_N: Array) -> str:
    """The same share of the largest force, in words, where a static load makes that more than twice the change."""
    plain, scale_N = float(np.abs(reference_N).max()), largest_change_N(reference_N)
    return f", {share * scale_N / plain:.1e} of the largest force" if plain > 2 * scale_N else ""


def largest_kinetic_J(chain: Chain, motion: Trace) -> float:
    """Largest kinetic energy, over which errors of the energy are counted; where nothing moves, what contacts hold."""
    kinetic, put_in = float(motion.kinetic_energy_J.max()), energy_put_in(chain, float(motion.time_s[-1]))
    return kinetic if kinetic > STILL * put_in else put_in or 1.0


def share_of_change(difference_N: Array, reference: Trace) -> Array:
    """A force difference over the largest change of force of the reference."""
    return np.asarray(difference_N / largest_change_N(reference.force_N))


def residual(trace: Trace, reference: Trace) -> Array:
    """Largest difference over all contacts at each sample, over the reference's largest change. Shape (samples,)."""
    return share_of_change(np.abs(trace.force_N - reference.force_N).max(axis=1), reference)


def apart(trace: Trace, other: Trace, limit: float) -> tuple[float, float]:
    """Largest residual, and the time in s at which it first passes a limit; NaN: never."""
    share = residual(trace, other)
    beyond = share > limit
    return float(share.max()), float(trace.time_s[np.argmax(beyond)]) if beyond.any() else nan
