"""Law of Kuwabara and Kono: ``F = max(0, k (d^(3/2) + (3/2) A sqrt(d) d'))``, a viscoelastic sphere in slow impact.

Kuwabara and Kono, Jpn. J. Appl. Phys. 26:1230, 1987; Brilliantov, Spahn, Hertzsch and Poeschel, Phys. Rev. E 53:5382,
1996, with A, the relaxation time of the material. The restitution decreases with the speed of an impact.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any, ClassVar

import numpy as np
from pydantic import Field

from drivers.base import units
from drivers.laws.law import Dissipation
from validation.reference.hertz_chain import EXPONENT, Array


@dataclass(frozen=True)
class KuwabaraKono(Dissipation):
    """Dissipative force proportional to ``sqrt(d) d'``, by the relaxation time A in s."""

    relaxation: float

    name: ClassVar[str] = "kuwabara-kono"
    keys: ClassVar[Mapping[str, Any]] = {
        "relaxation": Annotated[units.Duration, Field(description="A of kuwabara-kono")]
    }
    overlap_power: ClassVar[float] = 1 / 2
    needed: ClassVar[Mapping[str, str]] = {"relaxation": 'a time, such as "1 us"'}
    codes: ClassVar[Mapping[str, str]] = {
        "lammps": "viscoelastic limit_damping",
        "liggghts": " limitForce on",
        "yade": "damping * sqrt(overlap) * closing",
    }
    by_mass: ClassVar[bool] = True

    @property
    def description(self) -> str:
        """Description of the dissipation."""
        return f"dissipative force of Kuwabara and Kono with a relaxation time of {self.relaxation:.6g} s"

    def coefficient(self, stiffness: Array, reduced_mass_kg: Array) -> Array:
        """``C = (3/2) A k`` in ``F = max(0, k d^(3/2) + C d^(1/2) d')``, in N s m^-3/2. Shape (contacts,)."""
        return np.asarray(EXPONENT * self.relaxation * stiffness)

    def lammps(self, kn: float, reduced_mass_kg: float) -> float:
        """Coefficient eta of LAMMPS' ``damping viscoelastic``, whose force is ``eta m* sqrt(R* d) d'``."""
        return EXPONENT * self.relaxation * kn / reduced_mass_kg
