"""Power law: ``F = max(0, k d^(3/2) + gamma sgn(d') |d'|^alpha)`` for d >= 0, with the same gamma for all contacts.

Carretero-Gonzalez, Khatri, Porter, Kevrekidis and Daraio, Phys. Rev. Lett. 102:024102, 2009: alpha = 1.75 for steel,
brass and PTFE; with alpha = 1 it is a linear dashpot. The force jumps by ``gamma v^alpha`` when a contact closes at
speed v, and the restitution depends on the speed.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any, ClassVar

import numpy as np
from pydantic import Field

from drivers.base.errors import InputProblem
from drivers.laws.law import ELASTIC, Dissipation
from validation.reference.hertz_chain import VISCOELASTIC_POWER, Array

ALPHA = 1.75  # default


@dataclass(frozen=True)
class Power(Dissipation):
    """Dissipative force by a power of the closing speed; gamma in N (s/m)^alpha."""

    gamma: float
    exponent: float = ALPHA

    name: ClassVar[str] = "power"
    keys: ClassVar[Mapping[str, Any]] = {
        "gamma": Annotated[float, Field(ge=0, allow_inf_nan=False, description="coefficient in N (s/m)^alpha")],
        "alpha": Annotated[float, Field(ge=1, le=3, description=f"exponent of the speed; else {ALPHA}")],
    }
    overlap_power: ClassVar[float] = VISCOELASTIC_POWER
    needed: ClassVar[Mapping[str, str]] = {"gamma": "a number of 0 or more, in N (s/m)^alpha"}
    codes: ClassVar[Mapping[str, str]] = {
        "lammps": "velocity limit_damping",
        "yade": "damping * copysign(abs(closing) ** alpha, closing)",
    }
    cannot: ClassVar[Mapping[str, str]] = {"liggghts": "it has no such damping and runs no code in its loop"}

    @classmethod
    def of(cls, given: Mapping[str, float]) -> Dissipation:
        """Law of the keys ``gamma`` and ``alpha``; elastic without gamma."""
        return cls(given["gamma"], given.get("alpha", ALPHA)) if given.get("gamma") else ELASTIC

    @property
    def alpha(self) -> float:
        """Exponent of the closing speed."""
        return self.exponent

    @property
    def description(self) -> str:
        """Description of the dissipation."""
        return f"dissipative force of {self.gamma:.6g} N (s/m)^a times closing speed^a, a = {self.alpha:.6g}"

    def coefficient(self, stiffness: Array, reduced_mass_kg: Array) -> Array:
        """Gamma at each contact. Shape (contacts,)."""
        return np.where(stiffness > 0, self.gamma, 0.0)

    def lammps(self, kn: float, reduced_mass_kg: float) -> float:
        """Gamma: LAMMPS' ``damping velocity`` is a linear dashpot."""
        return self.gamma

    def refusal(self, code: str) -> InputProblem | None:
        """Refuse other exponents than 1 on LAMMPS."""
        if code == "lammps" and self.alpha != 1:
            return "contact.alpha", f"{self.alpha:g}", '1, or contact.dissipation = "viscoelastic"'
        return super().refusal(code)
