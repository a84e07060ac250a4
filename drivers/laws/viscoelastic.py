"""Viscoelastic law: ``F = max(0, k d^(3/2) + 2 B sqrt(m* K) d')`` with the tangent stiffness ``K = (3/2) k d^(1/2)``.

``1/m* = 1/m1 + 1/m2`` is the reduced mass (at the wall the bead's own mass), B the damping ratio (Tsuji, Tanaka and
Ishida, Powder Technol. 71:239, 1992; without attraction). In ``u ~ d^(5/4)`` and a rescaled time an impact is a linear
oscillator with the damping ratio ``zeta = sqrt(6/5) B``; the impact ends when the acceleration is zero (Schwager and
Poeschel, Granular Matter 9:465, 2007, for a linear spring). So the restitution depends only on B, not on speed, size or
modulus:

``e = exp(-2 a / tan(a))`` with ``cos(a) = zeta``; for zeta > 1 ``e = exp(-2 a / tanh(a))`` with ``cosh(a) = zeta``.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cache
from math import acos, acosh, cosh, exp, log, pi, sqrt
from typing import Annotated, Any, ClassVar

import numpy as np
from pydantic import Field

from drivers.base.errors import InputProblem
from drivers.laws.law import ELASTIC, Dissipation
from validation.reference.hertz_chain import EXPONENT, VISCOELASTIC_POWER, Array

ZETA_1 = sqrt(5 / 6)  # damping ratio B at which zeta is 1
MIN_RESTITUTION, MAX_DAMPING_RATIO = 1e-4, 50.0  # about equivalent; with stronger damping bodies stick together
LIGGGHTS_COEFFICIENT = 0.05  # LIGGGHTS' coefficientRestitution has to be larger
# polynomial of LAMMPS' damping tsuji, lowest power first: gamma / sqrt(m* kn sqrt(R* overlap)) of its coefficient
TSUJI = (1.2728, -4.2783, 11.087, -22.348, 27.467, -18.022, 4.8218)
MINIMUM_AT = 1.1  # coefficient close to the polynomial's minimum, which is negative


@dataclass(frozen=True)
class Viscoelastic(Dissipation):
    """Dissipative force with a constant restitution, by the damping ratio B; ``given`` is the restitution if given."""

    damping_ratio: float
    given: float | None = None

    name: ClassVar[str] = "viscoelastic"
    keys: ClassVar[Mapping[str, Any]] = {
        "restitution": Annotated[
            float, Field(ge=MIN_RESTITUTION, le=1, allow_inf_nan=False, description="restitution of an impact")
        ],
        "damping_ratio": Annotated[float, Field(ge=0, le=MAX_DAMPING_RATIO, description="damping ratio B")],
    }
    overlap_power: ClassVar[float] = VISCOELASTIC_POWER
    codes: ClassVar[Mapping[str, str]] = {
        "lammps": "tsuji limit_damping",
        "liggghts": " limitForce on",
        "yade": "betan",
    }
    sideways: ClassVar[bool] = True

    @classmethod
    def problems(cls, given: Mapping[str, float]) -> Iterator[InputProblem]:
        """Problem of two keys of which one is enough."""
        if len(given) == 2:
            yield "contact", "both restitution and damping_ratio", "one of the two; each determines the other"

    @classmethod
    def of(cls, given: Mapping[str, float]) -> Dissipation:
        """Law of the key ``restitution`` or ``damping_ratio``; elastic without either, or at B = 0."""
        wanted = given.get("restitution")
        ratio = given.get("damping_ratio", damping_ratio(wanted) if wanted else 0.0)
        return cls(ratio, wanted) if ratio else ELASTIC

    @property
    def description(self) -> str:
        """Description of the dissipation."""
        return f"impacts have a restitution of {restitution(self.damping_ratio):.6g}"

    def coefficient(self, stiffness: Array, reduced_mass_kg: Array) -> Array:
        """``C = 2 B sqrt((3/2) k m*)`` in ``F = max(0, k d^(3/2) + C d^(1/4) d')``, in N s m^-5/4."""
        return np.asarray(2 * self.damping_ratio * np.sqrt(EXPONENT * stiffness * reduced_mass_kg))

    @property
    def with_attraction(self) -> float:
        """Restitution ``e' = exp(-pi zeta / sqrt(1 - zeta^2))`` of the law with attractive forces; 0 for zeta >= 1.

        LIGGGHTS takes e' with and without ``limitForce``: ``zeta = |ln e'| / sqrt(ln(e')^2 + pi^2)``.
        """
        zeta = self.damping_ratio / ZETA_1
        return exp(-pi * zeta / sqrt((1 - zeta) * (1 + zeta))) if zeta < 1 else 0.0

    def lammps(self, kn: float, reduced_mass_kg: float) -> float:
        """Coefficient of LAMMPS' ``damping tsuji``: its polynomial equals ``2 sqrt(3/2) B``.

        Up to B = 0.52 it is the restitution of the law with attractive forces; above, it exceeds 1 and has no meaning.
        """
        from scipy.optimize import brentq

        wanted = 2 * sqrt(1.5) * self.damping_ratio

        def excess(coefficient: float) -> float:
            return sum(factor * coefficient**power for power, factor in enumerate(TSUJI)) - wanted

        ends = (0.0, MINIMUM_AT) if wanted <= TSUJI[0] else (MINIMUM_AT, 3 + wanted)
        return float(brentq(excess, *ends, xtol=1e-300, rtol=1e-15))

    def refusal(self, code: str) -> InputProblem | None:
        """Refuse a damping that LIGGGHTS does not accept."""
        if code != "liggghts" or self.with_attraction > LIGGGHTS_COEFFICIENT:
            return super().refusal(code)
        loss = -log(LIGGGHTS_COEFFICIENT)
        most = ZETA_1 * loss / sqrt(loss**2 + pi**2)  # damping ratio with this coefficient
        if self.given is None:
            return "contact.damping_ratio", f"{self.damping_ratio:g}", f"below {most:.4g}"
        return "contact.restitution", f"{self.given:g}", f"above {restitution(most):.4g}"


def restitution(damping_ratio: float) -> float:
    """Restitution of an impact of two free bodies; 1 for a damping ratio of 0."""
    zeta = damping_ratio / ZETA_1
    root = sqrt(abs(1 - zeta) * (1 + zeta))
    if root == 0:
        return exp(-2)
    return exp(-2 * (acos(zeta) if zeta < 1 else acosh(zeta)) * zeta / root)


@cache
def damping_ratio(wanted: float) -> float:
    """Damping ratio B of an impact with the restitution ``wanted``, above 0 and at most 1."""
    from scipy.optimize import brentq

    loss = -log(wanted)
    if loss == 0:
        return 0.0
    most = ZETA_1 * cosh(loss / 2) * (1 + 1e-12)
    return float(brentq(lambda ratio: log(restitution(ratio)) + loss, 0.0, most, xtol=1e-300, rtol=1e-15))
