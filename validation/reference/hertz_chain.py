"""The chain as the integrators see it, what an integration gives back, and their contact law."""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
EXPONENT = 3 / 2  # of the overlap in Hertz's law
ENERGY_SHARE = 1 / (1 + EXPONENT)  # elastic energy over force times overlap


@dataclass(frozen=True)
class HertzChain:
    """A chain of bodies 1 to n from the lowest up, contact j under body j; arrays of shape (n,), SI units.

    Attributes:
        stiffness: k of each contact in ``F = k overlap^(3/2)``; 0 where there is none.
        overlap_m: at time 0, a gap negative. Only these lengths enter, no absolute height: nothing cancels.
        velocity_m_s: at time 0, upwards positive.
        load_N: constant force on each body, upwards positive.
        damping: C of each contact in ``F = max(0, k overlap^(3/2) + C overlap^(1/4) d overlap/dt)``; left out: all 0.

    Raises:
        ValueError: an array of another shape, not finite, a mass not above zero, a stiffness or a damping below zero.
    """

    mass_kg: Array
    stiffness: Array
    overlap_m: Array
    velocity_m_s: Array
    load_N: Array
    damping: Array = field(default_factory=lambda: np.zeros(0))

    def __post_init__(self) -> None:
        if not np.size(self.damping):
            object.__setattr__(self, "damping", np.zeros(np.shape(self.mass_kg)))
        for name in self.__dataclass_fields__:
            array = np.ascontiguousarray(getattr(self, name), dtype=float)
            if array.ndim != 1 or array.shape != np.shape(self.mass_kg) or not array.size:
                raise ValueError(f"{name}: shape {array.shape}, expected one value a body")
            if not np.isfinite(array).all():
                raise ValueError(f"{name}: not finite")
            object.__setattr__(self, name, array)
        if (self.mass_kg <= 0).any():
            raise ValueError("mass_kg: not above zero")
        for name in ("stiffness", "damping"):
            if (getattr(self, name) < 0).any():
                raise ValueError(f"{name}: below zero")

    @property
    def elastic(self) -> bool:
        """Whether no contact loses energy."""
        return not self.damping.any()


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


def check_timing(time_step_s: float, steps_per_sample: int, samples: int) -> None:
    """Checks the steps and samples of an integration.

    Raises:
        ValueError: a step not above zero, or counts below one.
    """
    if not (np.isfinite(time_step_s) and time_step_s > 0):
        raise ValueError(f"time_step_s: {time_step_s}, expected above zero")
    if steps_per_sample < 1 or samples < 1:
        raise ValueError("steps_per_sample, samples: expected at least one")


def hertz_force(stiffness: Array, overlap_m: Array) -> Array:
    """``F = k overlap^(3/2)`` where there is overlap, else 0."""
    closed = np.maximum(overlap_m, 0.0)
    return np.asarray(stiffness * closed * np.sqrt(closed))


def contact_force(chain: HertzChain, overlap_m: Array, velocity_m_s: Array) -> Array:
    """Forces of contacts that may lose energy, from overlaps and velocities of shape (..., bodies)."""
    elastic = hertz_force(chain.stiffness, overlap_m)
    if chain.elastic:
        return elastic
    closing = np.concatenate([np.zeros_like(velocity_m_s[..., :1]), velocity_m_s[..., :-1]], axis=-1) - velocity_m_s
    return np.asarray(np.maximum(elastic + chain.damping * np.maximum(overlap_m, 0.0) ** 0.25 * closing, 0.0))


def displacements(chain: HertzChain, overlap_m: Array) -> Array:
    """Displacements since time 0 from overlaps of shape (samples, bodies): ``overlap_j = start_j + u_{j-1} - u_j``."""
    return np.asarray(-np.cumsum(overlap_m - chain.overlap_m, axis=-1))
