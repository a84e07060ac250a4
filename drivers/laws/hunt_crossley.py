"""Law of Hunt and Crossley: ``F = max(0, k d^(3/2) (1 + a d'))``, a dissipation in proportion to the elastic force.

Hunt and Crossley, J. Appl. Mech. 42:440, 1975, with ``lambda = a k``. An impact of two free bodies obeys
``v dv/(1 + a v) = -(k/m*) d^(3/2) dd`` with ``v = d'``. The integral of the right side from contact to separation is
zero, so that the restitution e of an impact at the speed v depends on ``x = a v`` alone:

``x - ln(1 + x) = -e x - ln(1 - e x)``, ``e = 1 - (2/3) x + (4/9) x^2 - ...``

The restitution decreases with the speed of an impact, and no rebound is faster than 1/a.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any, ClassVar

import numpy as np
from pydantic import Field

from drivers.base import units
from drivers.laws.law import Dissipation
from validation.reference.hertz_chain import EXPONENT, Array

Slowness = Annotated[float, units.in_unit("a slowness above zero", "s/m", "0.1 s/m", 1e-9, 1e9)]


@dataclass(frozen=True)
class HuntCrossley(Dissipation):
    """Dissipative force proportional to ``d^(3/2) d'``, by the slowness a in s/m."""

    slowness: float

    name: ClassVar[str] = "hunt-crossley"
    keys: ClassVar[Mapping[str, Any]] = {"slowness": Annotated[Slowness, Field(description="a of hunt-crossley")]}
    overlap_power: ClassVar[float] = EXPONENT
    needed: ClassVar[Mapping[str, str]] = {"slowness": 'an inverse speed, such as "0.1 s/m"'}
    codes: ClassVar[Mapping[str, str]] = {"yade": "damping * overlap * sqrt(overlap) * closing"}
    cannot: ClassVar[Mapping[str, str]] = dict.fromkeys(
        ("lammps", "liggghts"), "none of its dampings is proportional to overlap^(3/2)"
    )

    @property
    def description(self) -> str:
        """Description of the dissipation."""
        return f"dissipative force of Hunt and Crossley with a slowness of {self.slowness:.6g} s/m"

    def coefficient(self, stiffness: Array, reduced_mass_kg: Array) -> Array:
        """``C = a k`` in ``F = max(0, k d^(3/2) + C d^(3/2) d')``, in N s m^-5/2. Shape (contacts,)."""
        return np.asarray(self.slowness * stiffness)
