"""A three-dimensional chain as the integrator sees it, and what an integration gives back."""

from dataclasses import dataclass

import numpy as np

from validation.reference.hertz_chain import Array


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
            if name in ("wall_m", "friction", "bore_m", "bore_friction", "turns"):
                continue
            array = np.array(value, dtype=float)
            shape = (bodies, 3) if name in ("place_m", "velocity_m_s") else (bodies,)
            if array.shape != shape or not bodies:
                raise ValueError(f"{name}: shape {array.shape}, expected {shape}")
            if not (np.isfinite(array) | (name == "radius_m")).all():
                raise ValueError(f"{name}: not finite")
            if name in ("mass_kg", "radius_m") and not (array > 0).all():
                raise ValueError(f"{name}: not above zero")
            object.__setattr__(self, name, array)


@dataclass(frozen=True)
class Extremes:
    """The largest of each contact in a motion, step by step; arrays of shape (bodies,).

    Attributes:
        overlap_m: of the contact under each body.
        closing_m_s: the speed along its line at which it closes.
        bore_overlap_m: likewise of the bore.
        bore_closing_m_s: likewise.
        impacts: closings of contacts, each by the square of its energy over the largest one's.
    """

    overlap_m: Array
    closing_m_s: Array
    bore_overlap_m: Array
    bore_closing_m_s: Array
    impacts: float


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
