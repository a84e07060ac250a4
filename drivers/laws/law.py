"""Interface of a law of dissipation: a force in addition to Hertz's elastic force, which all contacts share.

The force is ``F = max(0, k d^(3/2) + C d^p d')`` of the overlap d and the closing speed d', or with an exponent alpha
``F = max(0, k d^(3/2) + C sgn(d') |d'|^alpha)`` for d >= 0. Its elastic part is in ``drivers.chain.chain``, its
integration in ``validation.reference``. To add a law of this form, write a module of this package with one class; its
texts for the codes go into the class, and a comment for the reader of a deck into the templates.
"""

from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from drivers.base.errors import InputProblem
from validation.reference.hertz_chain import VISCOELASTIC_POWER, Array, dissipative_force


@dataclass(frozen=True)
class Dissipation(ABC):
    """Base of the laws of dissipation; no code has a law until the law names the code.

    Attributes:
        name: value of ``contact.dissipation`` in a scene.
        damped: True if contacts dissipate energy.
        keys: types of the law's keys in the table ``[contact]``, with their units and ranges.
        needed: words for the value of a key without which the law is incomplete, by key.
        overlap_power: p of the dissipative force; without meaning with alpha.
        codes: text that a code needs for the law, by code; a law does not inherit it from another law.
        cannot: reason why a code cannot model the law, by code.
        by_mass: True if ``lammps`` depends on the reduced mass.
        sideways: True if beads that move sideways are modelled.
    """

    name: ClassVar[str]
    damped: ClassVar[bool] = True
    keys: ClassVar[Mapping[str, Any]] = {}
    needed: ClassVar[Mapping[str, str]] = {}
    overlap_power: ClassVar[float]
    codes: ClassVar[Mapping[str, str]] = {}
    cannot: ClassVar[Mapping[str, str]] = {}
    by_mass: ClassVar[bool] = False
    sideways: ClassVar[bool] = False

    def __init_subclass__(cls) -> None:
        """Empty the codes of a law that names none itself."""
        cls.codes = vars(cls).get("codes", {})

    @classmethod
    def problems(cls, given: Mapping[str, float]) -> Iterator[InputProblem]:
        """Problems with the keys of the law that a scene gives."""
        for key, value in cls.needed.items():
            if key not in given:
                yield f"contact.{key}", f"missing key; give {value}", ""

    @classmethod
    def of(cls, given: Mapping[str, float]) -> "Dissipation":
        """Law of the keys that a scene gives."""
        return cls(**given)

    @property
    def alpha(self) -> float:
        """Exponent of the closing speed; 0 for a force proportional to it."""
        return 0.0

    @property
    @abstractmethod
    def description(self) -> str:
        """Description of the dissipation."""

    @abstractmethod
    def coefficient(self, stiffness: Array, reduced_mass_kg: Array) -> Array:
        """C of each contact, in N s^a m^-(a+p) with alpha a. Shape (contacts,)."""

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
        raise NotImplementedError(f"{self.name}: no coefficient for LAMMPS and LIGGGHTS")

    def refusal(self, code: str) -> InputProblem | None:
        """Key, found and allowed if a code cannot model the law; else None."""
        if not self.damped or code in self.codes:
            return None
        reason = self.cannot.get(code, "the law has no text for this code")
        return "contact.dissipation", f'"{self.name}"', f"another law, since {reason}"


@dataclass(frozen=True)
class Elastic(Dissipation):
    """No dissipation."""

    name: ClassVar[str] = "elastic"
    damped: ClassVar[bool] = False
    overlap_power: ClassVar[float] = VISCOELASTIC_POWER
    sideways: ClassVar[bool] = True

    @property
    def description(self) -> str:
        """Description of the dissipation."""
        return "impacts have a restitution of 1"

    def coefficient(self, stiffness: Array, reduced_mass_kg: Array) -> Array:
        """Zeros. Shape (contacts,)."""
        return np.zeros(len(stiffness))

    def lammps(self, kn: float, reduced_mass_kg: float) -> float:
        """Return 0."""
        return 0.0


ELASTIC = Elastic()
