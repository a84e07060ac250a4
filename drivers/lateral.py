"""What a three-dimensional chain has beside a straight one: places off the axis, friction, the bore of its tube."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Bore:
    """The inside of a tube about the chain's axis; arrays of shape (bodies,).

    Attributes:
        stiffness: k of each body's contact with it in F = k overlap^(3/2); 0 for a body that is not in the tube.
        shear_stiffness: as ``Lateral.shear_stiffness``.
        sides: flat sides of the mesh that stands for it; None: a true cylinder.
    """

    radius_m: float
    stiffness: Array
    shear_stiffness: Array
    friction: float
    sides: int | None

    @cached_property
    def guided(self) -> list[int]:
        """The bodies in the tube, counted from 0."""
        return [int(body) for body in np.flatnonzero(self.stiffness)]


@dataclass(frozen=True)
class Lateral:
    """Freedom to move sideways and to turn; arrays of shape (bodies, 2), or (bodies,).

    Attributes:
        offset_m: centres off the axis at time 0.
        velocity_m_s: across the axis at time 0.
        shear_stiffness: k_t of each contact: a shear ds adds ``k_t sqrt(overlap) ds`` to its tangential force.
        friction: of contacts between bodies and with the wall.
    """

    offset_m: Array
    velocity_m_s: Array
    shear_stiffness: Array
    friction: float
    bore: Bore | None

    @property
    def slips(self) -> bool:
        """Whether any contact has friction: only then do bodies turn."""
        return self.friction > 0 or (self.bore is not None and self.bore.friction > 0)
