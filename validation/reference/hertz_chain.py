"""The chain as the integrators see it, and what an integration gives back."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True)
class HertzChain:
    """A chain of bodies 1 to n from the lowest up, contact j under body j; arrays of shape (n,), SI units.

    Attributes:
        stiffness: k of each contact in ``F = k overlap^(3/2)``; 0 where there is none.
        overlap_m: at time 0, a gap negative. Only these lengths enter, no absolute height: nothing cancels.
        velocity_m_s: at time 0, upwards positive.
        load_N: constant force on each body, upwards positive.

    Raises:
        ValueError: an array of another shape, not finite, a mass not above zero, a stiffness below zero.
    """

    mass_kg: Array
    stiffness: Array
    overlap_m: Array
    velocity_m_s: Array
    load_N: Array

    def __post_init__(self) -> None:
        for name in self.__dataclass_fields__:
            array = np.ascontiguousarray(getattr(self, name), dtype=float)
            if array.ndim != 1 or array.shape != np.shape(self.mass_kg) or not array.size:
                raise ValueError(f"{name}: shape {array.shape}, expected one value a body")
            if not np.isfinite(array).all():
                raise ValueError(f"{name}: not finite")
            object.__setattr__(self, name, array)
        if (self.mass_kg <= 0).any():
            raise ValueError("mass_kg: not above zero")
        if (self.stiffness < 0).any():
            raise ValueError("stiffness: below zero")


@dataclass(frozen=True)
class Motion:
    """Samples of an integration; arrays of shape (samples, bodies).

    Attributes:
        force_N: of each contact, compression positive.
        displacement_m: of each body since time 0, upwards positive.
        velocity_m_s: upwards positive.
    """

    force_N: Array
    displacement_m: Array
    velocity_m_s: Array


def hertz_force(stiffness: Array, overlap_m: Array) -> Array:
    """``F = k overlap^(3/2)`` where there is overlap, else 0."""
    closed = np.maximum(overlap_m, 0.0)
    return np.asarray(stiffness * closed * np.sqrt(closed))


def displacements(chain: HertzChain, overlap_m: Array) -> Array:
    """Displacements since time 0 from overlaps of shape (samples, bodies): ``overlap_j = start_j + u_{j-1} - u_j``."""
    return np.asarray(-np.cumsum(overlap_m - chain.overlap_m, axis=-1))
