"""Chains as the integrators see them, what an integration gives back, and the contact law."""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
EXPONENT = 3 / 2  # of the overlap in Hertz's law
ENERGY_SHARE = 1 / (1 + EXPONENT)  # elastic energy over force times overlap


def _checked(name: str, values: Array, shape: tuple[int, ...]) -> Array:
    """An array of a chain as doubles, where it can be one of its name."""
    array = np.array(values, dtype=float)
    if array.shape != shape or not array.size:
        raise ValueError(f"{name}: shape {array.shape}, expected {shape}, for one or more bodies")
    if not (np.isfinite(array) | (name == "radius_m")).all():
        raise ValueError(f"{name}: not finite")
    if name in ("mass_kg", "radius_m") and not (array > 0).all():
        raise ValueError(f"{name}: not above zero")
    if name in ("stiffness", "damping") and (array < 0).any():
        raise ValueError(f"{name}: below zero")
    return array


@dataclass(frozen=True)
class HertzChain:
    """A chain of bodies 1 to n from the lowest up, contact j under body j; arrays of shape (n,), SI units.

    Attributes:
        stiffness: k of each contact in ``F = k overlap^(3/2)``; 0 where there is none.
        overlap_m: at time 0, a gap negative. Only these lengths enter, no absolute height: nothing cancels.
        velocity_m_s: at time 0, upwards positive.
        load_N: constant force on each body, upwards positive.
        damping: C of each contact in ``F = max(0, k overlap^(3/2) + C overlap^(1/4) d overlap/dt)``; left out: all 0.
        alpha: 0, or the exponent of the velocity-power law (``dissipative_force``), whose gamma the damping then is.

    Raises:
        ValueError: an array of another shape, not finite, a mass not above zero, a stiffness or a damping below zero;
            an alpha that is neither 0 nor 1 or more, or a contact without gamma beside one that has an alpha.
    """

    mass_kg: Array
    stiffness: Array
    overlap_m: Array
    velocity_m_s: Array
    load_N: Array
    damping: Array = field(default_factory=lambda: np.zeros(0))
    alpha: float = 0.0

    def __post_init__(self) -> None:
        if not np.size(self.damping):
            object.__setattr__(self, "damping", np.zeros(np.shape(self.mass_kg)))
        for name in self.__dataclass_fields__:
            if name != "alpha":
                object.__setattr__(self, name, _checked(name, getattr(self, name), (np.size(self.mass_kg),)))
        if self.alpha and not 1 <= self.alpha < np.inf:
            raise ValueError(f"alpha: {self.alpha}, expected 0, or 1 or more")
        if self.alpha and (self.damping[self.stiffness > 0] == 0).any():
            raise ValueError("damping: 0 at a contact, expected a gamma above zero where there is an alpha")

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


# keys of a deck, as ``__main__`` reads it, by field of TubeChain; those of a straight chain go before them
TUBE_KEYS = {
    "place_m": "place_m",
    "velocity_m_s": "velocity_xyz_m_s",
    "wall_m": "wall_m",
    "shear": "shear_N_m-3/2",
    "friction": "friction",
    "bore_m": "bore_m",
    "bore_stiffness": "bore_stiffness_N_m-3/2",
    "bore_shear": "bore_shear_N_m-3/2",
    "bore_friction": "bore_friction",
    "turns": "turns",
}


@dataclass(frozen=True)
class TubeChain:
    """Bodies 1 to n from the lowest up, contact j under body j; arrays of shape (n,) and (n, 3), SI units.

    Attributes:
        radius_m: inf for a level face, which moves along the axis only; its place is the face's.
        stiffness: k of each contact in ``F = k overlap^(3/2)``; 0 where there is none (a free chain's first).
        damping: C in ``F = max(0, k overlap^(3/2) + C overlap^(1/4) d overlap/dt)``.
        shear: k_t of each contact: a shear ds adds ``k_t sqrt(overlap) ds``.
        load_N: along the axis.
        bore_stiffness: k of each body's contact with the bore, elastic; 0 for a body outside.
        bore_shear: k_t likewise.
        place_m: at time 0, the axis is x = y = 0.
        velocity_m_s: at time 0; nothing spins then.
        wall_m: height of the wall under body 1.
        turns: whether friction turns bodies.

    Raises:
        ValueError: an array of another shape or not finite, a mass or a radius not above zero.
    """

    mass_kg: Array
    radius_m: Array
    stiffness: Array
    damping: Array
    shear: Array
    load_N: Array
    bore_stiffness: Array
    bore_shear: Array
    place_m: Array
    velocity_m_s: Array
    wall_m: float
    friction: float
    bore_m: float
    bore_friction: float
    turns: bool = True

    def __post_init__(self) -> None:
        bodies = np.size(self.mass_kg)
        for name in self.__dataclass_fields__:
            value = getattr(self, name)
            if np.ndim(value):
                shape = (bodies, 3) if name in ("place_m", "velocity_m_s") else (bodies,)
                object.__setattr__(self, name, _checked(name, value, shape))


@dataclass(frozen=True)
class Extremes:
    """The largest of each contact in a motion, step by step; arrays of shape (bodies,).

    Attributes:
        overlap_m: of the contact under each body.
        closing_m_s: the speed along its line at which it closes.
        bore_overlap_m: likewise of the bore.
        bore_closing_m_s: likewise.
        impacts_J: of all its closings, the energies ``mu v^2 / 2`` together, mu being the reduced mass.
        speed_m_s: at which it closes or parts while it has a force; of straight chains only.
    """

    overlap_m: Array
    closing_m_s: Array
    bore_overlap_m: Array
    bore_closing_m_s: Array
    impacts_J: Array
    speed_m_s: Array = field(default_factory=lambda: np.zeros(0))


@dataclass(frozen=True)
class TubeMotion:
    """Samples of an integration; velocities and spins at the time of the forces.

    Attributes:
        force_N: of the contact under each body, along the axis, friction included. Shape (samples, bodies).
        bore_N: by the bore on each body. Shape (samples, bodies, 3).
        place_m: likewise.
        velocity_m_s: likewise.
        spin_rad_s: likewise.
    """

    force_N: Array
    bore_N: Array
    place_m: Array
    velocity_m_s: Array
    spin_rad_s: Array
    extremes: Extremes


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


def dissipative_force(damping: Array, alpha: float, overlap_m: Array, closing_m_s: Array) -> Array:
    """Force of a contact beside Hertz's, which their sum never makes attractive: ``C d^(1/4) d'``, or a power of d'.

    With an alpha it is ``gamma sgn(d') |d'|^alpha`` where d >= 0 (Carretero-Gonzalez et al., Phys. Rev. Lett. 102,
    024102, 2009), the damping being gamma in N (s/m)^alpha. It jumps where a contact closes; at that instant, d = 0
    and d' > 0, it is the value just after.
    """
    if not alpha:
        return np.asarray(damping * np.maximum(overlap_m, 0.0) ** 0.25 * closing_m_s)
    power = np.sign(closing_m_s) * np.abs(closing_m_s) ** alpha
    return np.asarray(np.where(overlap_m >= 0.0, damping * power, 0.0))


def contact_force(chain: HertzChain, overlap_m: Array, velocity_m_s: Array) -> Array:
    """Forces of contacts that may lose energy, from overlaps and velocities of shape (..., bodies).

    By the power law a sample at the instant at which a contact closes shows the force just after.
    """
    elastic = hertz_force(chain.stiffness, overlap_m)
    if chain.elastic:
        return elastic
    closing = np.concatenate([np.zeros_like(velocity_m_s[..., :1]), velocity_m_s[..., :-1]], axis=-1) - velocity_m_s
    return np.asarray(np.maximum(elastic + dissipative_force(chain.damping, chain.alpha, overlap_m, closing), 0.0))


def displacements(chain: HertzChain, overlap_m: Array) -> Array:
    """Displacements since time 0 from overlaps of shape (samples, bodies): ``overlap_j = start_j + u_{j-1} - u_j``."""
    return np.asarray(-np.cumsum(overlap_m - chain.overlap_m, axis=-1))
