"""Laws of dissipation: forces in addition to Hertz's elastic force (``drivers.chain.chain``), which all contacts share.

The force is ``F = max(0, k d^(3/2) + C d^p d')`` of the overlap d and the closing speed d', or with an exponent alpha
``F = max(0, k d^(3/2) + C sgn(d') |d'|^alpha)`` for d >= 0. ``validation.reference`` integrates it. A further law of
this form is a function here, its C in ``Dissipation``, its place in ``LAWS``, its keys in ``Contact`` of
``drivers.scene.model`` and ``LAW_KEYS`` of ``drivers.scene.rules``, and its name in the adapters of the codes that have
it.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from math import acos, acosh, cosh, exp, log, sqrt

import numpy as np

from validation.reference.hertz_chain import EXPONENT, VISCOELASTIC_POWER, Array, dissipative_force

HUNT_CROSSLEY, KUWABARA_KONO, POWER, VISCOELASTIC = "hunt-crossley", "kuwabara-kono", "power", "viscoelastic"
ALPHA = 1.75  # default of the power law
ZETA_1 = sqrt(5 / 6)  # damping ratio B of the viscoelastic law at which zeta is 1


@dataclass(frozen=True)
class Dissipation:
    """Law of a scene's contacts with its value; by default that of elastic ones.

    Attributes:
        name: value of ``contact.dissipation`` in a scene.
        value: slowness a, relaxation time A, coefficient gamma or damping ratio B, in SI units; 0 if elastic.
        description: description of the dissipation.
        overlap_power: p of the dissipative force; without meaning with alpha.
        alpha: exponent of the closing speed; 0 for a force proportional to it.
    """

    name: str = "elastic"
    value: float = 0.0
    description: str = "impacts have a restitution of 1"
    overlap_power: float = VISCOELASTIC_POWER
    alpha: float = 0.0

    def coefficient(self, stiffness: Array, reduced_mass_kg: Array) -> Array:
        """C of each contact, in N s^a m^-(a+p) with alpha a. Shape (contacts,)."""
        if self.name == VISCOELASTIC:
            return np.asarray(2 * self.value * np.sqrt(EXPONENT * stiffness * reduced_mass_kg))
        if self.name == POWER:
            return np.where(stiffness > 0, self.value, 0.0)
        return np.asarray((EXPONENT if self.name == KUWABARA_KONO else 1.0) * self.value * stiffness)

    def slope(self, coefficient: Array, overlap_m: Array, speed_m_s: Array) -> Array:
        """``dF/dd'`` in N s/m: ``C d^p``, or ``C alpha |d'|^(alpha - 1)`` with alpha. Shape (contacts,)."""
        if not self.alpha:
            return np.asarray(coefficient * overlap_m**self.overlap_power)
        return np.asarray(coefficient * self.alpha * np.abs(speed_m_s) ** (self.alpha - 1))

    def force(self, coefficient: Array, overlap_m: Array, closing_m_s: Array) -> Array:
        """Dissipative force in N, before the sum with the elastic force is limited to 0 and above."""
        return dissipative_force(coefficient, self.alpha, self.overlap_power, overlap_m, closing_m_s)


ELASTIC = Dissipation()


def hunt_crossley(slowness: float) -> Dissipation:
    """``F = max(0, k d^(3/2) (1 + a d'))`` with the slowness a in s/m: dissipation in proportion to the elastic force.

    Hunt and Crossley, J. Appl. Mech. 42:440, 1975, with ``lambda = a k``. An impact of two free bodies obeys
    ``v dv/(1 + a v) = -(k/m*) d^(3/2) dd`` with ``v = d'``. The integral of the right side from contact to separation
    is zero, so that the restitution e of an impact at the speed v depends on ``x = a v`` alone:

    ``x - ln(1 + x) = -e x - ln(1 - e x)``, ``e = 1 - (2/3) x + (4/9) x^2 - ...``

    The restitution decreases with the speed of an impact, and no rebound is faster than 1/a. ``C = a k`` in
    N s m^-5/2.
    """
    description = f"dissipative force of Hunt and Crossley with a slowness of {slowness:.6g} s/m"
    return Dissipation(HUNT_CROSSLEY, slowness, description, overlap_power=EXPONENT)


def kuwabara_kono(relaxation: float) -> Dissipation:
    """``F = max(0, k (d^(3/2) + (3/2) A sqrt(d) d'))``, a viscoelastic sphere in slow impact.

    Kuwabara and Kono, Jpn. J. Appl. Phys. 26:1230, 1987; Brilliantov, Spahn, Hertzsch and Poeschel, Phys. Rev. E
    53:5382, 1996, with A, the relaxation time of the material in s. The restitution decreases with the speed of an
    impact. ``C = (3/2) A k`` in N s m^-3/2.
    """
    description = f"dissipative force of Kuwabara and Kono with a relaxation time of {relaxation:.6g} s"
    return Dissipation(KUWABARA_KONO, relaxation, description, overlap_power=1 / 2)


def power(gamma: float, alpha: float = ALPHA) -> Dissipation:
    """``F = max(0, k d^(3/2) + gamma sgn(d') |d'|^alpha)`` for d >= 0, with the same gamma for all contacts.

    Carretero-Gonzalez, Khatri, Porter, Kevrekidis and Daraio, Phys. Rev. Lett. 102:024102, 2009: alpha = 1.75 for
    steel, brass and PTFE; with alpha = 1 it is a linear dashpot; gamma is in N (s/m)^alpha. The force jumps by
    ``gamma v^alpha`` when a contact closes at speed v, and the restitution depends on the speed.
    """
    description = f"dissipative force of {gamma:.6g} N (s/m)^a times closing speed^a, a = {alpha:.6g}"
    return Dissipation(POWER, gamma, description, alpha=alpha)


def viscoelastic(damping_ratio: float = 0.0, restitution: float | None = None) -> Dissipation:
    """``F = max(0, k d^(3/2) + 2 B sqrt(m* K) d')`` with the tangent stiffness ``K = (3/2) k d^(1/2)``.

    ``1/m* = 1/m1 + 1/m2`` is the reduced mass (at the wall the bead's own mass), B the damping ratio (Tsuji, Tanaka and
    Ishida, Powder Technol. 71:239, 1992; without attraction). In ``u ~ d^(5/4)`` and a rescaled time an impact is a
    linear oscillator with the damping ratio ``zeta = sqrt(6/5) B``; the impact ends when the acceleration is zero
    (Schwager and Poeschel, Granular Matter 9:465, 2007, for a linear spring). So the restitution depends only on B, not
    on speed, size or modulus:

    ``e = exp(-2 a / tan(a))`` with ``cos(a) = zeta``; for zeta > 1 ``e = exp(-2 a / tanh(a))`` with ``cosh(a) = zeta``.

    ``C = 2 B sqrt((3/2) k m*)`` in N s m^-5/4.

    Args:
        damping_ratio: B.
        restitution: the restitution of an impact instead of B.
    """
    ratio = damping_ratio if restitution is None else damping_ratio_of(restitution)
    return Dissipation(VISCOELASTIC, ratio, f"impacts have a restitution of {restitution_of(ratio):.6g}")


LAWS: dict[str, Callable[..., Dissipation]] = {
    HUNT_CROSSLEY: hunt_crossley,
    KUWABARA_KONO: kuwabara_kono,
    POWER: power,
    VISCOELASTIC: viscoelastic,
}


def restitution_of(damping_ratio: float) -> float:
    """Restitution of an impact of two free bodies by the viscoelastic law; 1 for a damping ratio of 0."""
    zeta = damping_ratio / ZETA_1
    root = sqrt(abs(1 - zeta) * (1 + zeta))
    if root == 0:
        return exp(-2)
    return exp(-2 * (acos(zeta) if zeta < 1 else acosh(zeta)) * zeta / root)


@cache
def damping_ratio_of(restitution: float) -> float:
    """Damping ratio B of an impact with a restitution above 0 and at most 1."""
    from scipy.optimize import brentq

    loss = -log(restitution)
    if loss == 0:
        return 0.0
    most = ZETA_1 * cosh(loss / 2) * (1 + 1e-12)
    return float(brentq(lambda ratio: log(restitution_of(ratio)) + loss, 0.0, most, xtol=1e-300, rtol=1e-15))
