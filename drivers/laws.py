"""Laws of dissipation: forces in addition to Hertz's elastic force (``drivers.chain.chain``), which all contacts share.

The force is ``F = max(0, k d^(3/2) + C d^p d')`` of the overlap d and the closing speed d', or with an exponent alpha
``F = max(0, k d^(3/2) + C sgn(d') |d'|^alpha)`` for d >= 0. ``validation.reference`` integrates it. A further law of
this form is a class here, which holds its texts for the codes, and its keys in ``Contact`` of ``drivers.scene.model``.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from math import acos, acosh, cosh, exp, log, pi, sqrt
from typing import ClassVar

import numpy as np

from drivers.base.errors import InputProblem
from validation.reference.hertz_chain import EXPONENT, VISCOELASTIC_POWER, Array, dissipative_force

ALPHA = 1.75  # default of the power law
ZETA_1 = sqrt(5 / 6)  # damping ratio B of the viscoelastic law at which zeta is 1
LIGGGHTS_COEFFICIENT = 0.05  # LIGGGHTS' coefficientRestitution has to be larger
# polynomial of LAMMPS' damping tsuji, lowest power first: gamma / sqrt(m* kn sqrt(R* overlap)) of its coefficient
TSUJI = (1.2728, -4.2783, 11.087, -22.348, 27.467, -18.022, 4.8218)
MINIMUM_AT = 1.1  # coefficient close to the polynomial's minimum, which is negative


class Dissipation:
    """Law of a scene's contacts: this class is that of elastic ones, derived classes dissipate.

    Attributes:
        name: value of ``contact.dissipation`` in a scene.
        keys: the law's keys in the table ``[contact]``, each with words for its value if it has to be given.
        overlap_power: p of the dissipative force; without meaning with alpha.
        alpha: exponent of the closing speed; 0 for a force proportional to it.
        codes: text that a code needs for the law, by code; other codes do not have the law.
        cannot: reason why a code cannot model the law, by code.
        by_mass: True if ``lammps`` depends on the reduced mass.
        sideways: True if the law is modelled for beads that move sideways.
    """

    name: ClassVar[str] = "elastic"
    keys: ClassVar[Mapping[str, str]] = {}
    overlap_power: ClassVar[float] = VISCOELASTIC_POWER
    codes: ClassVar[Mapping[str, str]] = {}
    cannot: ClassVar[Mapping[str, str]] = {}
    by_mass: ClassVar[bool] = False
    sideways: ClassVar[bool] = False
    alpha: float = 0.0

    @classmethod
    def of(cls, given: Mapping[str, float]) -> "Dissipation":
        """Law of the keys that a scene gives."""
        return cls(**given)

    @property
    def damped(self) -> bool:
        """True if contacts dissipate energy."""
        return type(self) is not Dissipation

    @property
    def description(self) -> str:
        """Description of the dissipation."""
        return "impacts have a restitution of 1"

    def coefficient(self, stiffness: Array, reduced_mass_kg: Array) -> Array:
        """C of each contact, in N s^a m^-(a+p) with alpha a. Shape (contacts,)."""
        return np.zeros(len(stiffness))

    def slope(self, coefficient: Array, overlap_m: Array, speed_m_s: Array) -> Array:
        """``dF/dd'`` in N s/m: ``C d^p``, or ``C alpha |d'|^(alpha - 1)`` with alpha. Shape (contacts,)."""
        if not self.alpha:
            return np.asarray(coefficient * overlap_m**self.overlap_power)
        return np.asarray(coefficient * self.alpha * np.abs(speed_m_s) ** (self.alpha - 1))

    def force(self, coefficient: Array, overlap_m: Array, closing_m_s: Array) -> Array:
        """Dissipative force in N, before the sum with the elastic force is limited to 0 and above."""
        return dissipative_force(coefficient, self.alpha, self.overlap_power, overlap_m, closing_m_s)

    def lammps(self, kn: float, reduced_mass_kg: float) -> float:
        """Damping coefficient of LAMMPS for a pair of types with ``F = kn sqrt(R*) d^(3/2)`` and a reduced mass.

        LIGGGHTS' ``gamman`` is the same coefficient.
        """
        return 0.0

    def refusal(self, code: str) -> InputProblem | None:
        """Key, found and allowed if a code cannot model the law; else None."""
        if not self.damped or code in self.codes:
            return None
        reason = self.cannot.get(code, "the law has no text for this code")
        return "contact.dissipation", f'"{self.name}"', f"another law, since {reason}"


ELASTIC = Dissipation()


@dataclass(frozen=True)
class HuntCrossley(Dissipation):
    """``F = max(0, k d^(3/2) (1 + a d'))`` with the slowness a in s/m: dissipation in proportion to the elastic force.

    Hunt and Crossley, J. Appl. Mech. 42:440, 1975, with ``lambda = a k``. An impact of two free bodies obeys
    ``v dv/(1 + a v) = -(k/m*) d^(3/2) dd`` with ``v = d'``. The integral of the right side from contact to separation
    is zero, so that the restitution e of an impact at the speed v depends on ``x = a v`` alone:

    ``x - ln(1 + x) = -e x - ln(1 - e x)``, ``e = 1 - (2/3) x + (4/9) x^2 - ...``

    The restitution decreases with the speed of an impact, and no rebound is faster than 1/a.
    """

    slowness: float

    name = "hunt-crossley"
    keys: ClassVar[Mapping[str, str]] = {"slowness": 'an inverse speed, such as "0.1 s/m"'}
    overlap_power = EXPONENT
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


@dataclass(frozen=True)
class KuwabaraKono(Dissipation):
    """``F = max(0, k (d^(3/2) + (3/2) A sqrt(d) d'))``, a viscoelastic sphere in slow impact.

    Kuwabara and Kono, Jpn. J. Appl. Phys. 26:1230, 1987; Brilliantov, Spahn, Hertzsch and Poeschel, Phys. Rev. E
    53:5382, 1996, with A, the relaxation time of the material in s. The restitution decreases with the speed of an
    impact.
    """

    relaxation: float

    name = "kuwabara-kono"
    keys: ClassVar[Mapping[str, str]] = {"relaxation": 'a time, such as "1 us"'}
    overlap_power = 1 / 2
    codes: ClassVar[Mapping[str, str]] = {
        "lammps": "viscoelastic limit_damping",
        "liggghts": " limitForce on",
        "yade": "damping * sqrt(overlap) * closing",
    }
    by_mass = True

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


@dataclass(frozen=True)
class Power(Dissipation):
    """``F = max(0, k d^(3/2) + gamma sgn(d') |d'|^alpha)`` for d >= 0, with the same gamma for all contacts.

    Carretero-Gonzalez, Khatri, Porter, Kevrekidis and Daraio, Phys. Rev. Lett. 102:024102, 2009: alpha = 1.75 for
    steel, brass and PTFE; with alpha = 1 it is a linear dashpot; gamma is in N (s/m)^alpha. The force jumps by
    ``gamma v^alpha`` when a contact closes at speed v, and the restitution depends on the speed.
    """

    gamma: float
    alpha: float = ALPHA

    name = "power"
    keys: ClassVar[Mapping[str, str]] = {"gamma": "a number of 0 or more, in N (s/m)^alpha", "alpha": ""}
    codes: ClassVar[Mapping[str, str]] = {
        "lammps": "velocity limit_damping",
        "yade": "damping * copysign(abs(closing) ** alpha, closing)",
    }
    cannot: ClassVar[Mapping[str, str]] = {"liggghts": "it has no such damping and runs no code in its loop"}

    @classmethod
    def of(cls, given: Mapping[str, float]) -> Dissipation:
        """Law of the keys ``gamma`` and ``alpha``; elastic without gamma."""
        return cls(**given) if given.get("gamma") else ELASTIC

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


@dataclass(frozen=True)
class Viscoelastic(Dissipation):
    """``F = max(0, k d^(3/2) + 2 B sqrt(m* K) d')`` with the tangent stiffness ``K = (3/2) k d^(1/2)``.

    ``1/m* = 1/m1 + 1/m2`` is the reduced mass (at the wall the bead's own mass), B the damping ratio (Tsuji, Tanaka and
    Ishida, Powder Technol. 71:239, 1992; without attraction). In ``u ~ d^(5/4)`` and a rescaled time an impact is a
    linear oscillator with the damping ratio ``zeta = sqrt(6/5) B``; the impact ends when the acceleration is zero
    (Schwager and Poeschel, Granular Matter 9:465, 2007, for a linear spring). So the restitution depends only on B, not
    on speed, size or modulus:

    ``e = exp(-2 a / tan(a))`` with ``cos(a) = zeta``; for zeta > 1 ``e = exp(-2 a / tanh(a))`` with ``cosh(a) = zeta``.

    Attributes:
        damping_ratio: B.
        given: the restitution, if the scene gives it.
    """

    damping_ratio: float
    given: float | None = None

    name = "viscoelastic"
    keys: ClassVar[Mapping[str, str]] = {"restitution": "", "damping_ratio": ""}
    codes: ClassVar[Mapping[str, str]] = {
        "lammps": "tsuji limit_damping",
        "liggghts": " limitForce on",
        "yade": "betan",
    }
    sideways = True

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


LAWS: dict[str, type[Dissipation]] = {law.name: law for law in (HuntCrossley, KuwabaraKono, Power, Viscoelastic)}


def restitution(damping_ratio: float) -> float:
    """Restitution of an impact of two free bodies by the viscoelastic law; 1 for a damping ratio of 0."""
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
