"""Dissipation of a contact: one law for all engines, and the restitution that comes out of it.

``F = max(0, k d^(3/2) + 2 B sqrt(m* K) d')`` with the tangent stiffness ``K = (3/2) k d^(1/2)``, the reduced mass
``1/m* = 1/m1 + 1/m2`` (at the wall the bead's own) and the damping ratio B (Tsuji, Tanaka and Ishida, Powder Technol.
71:239, 1992; without attraction). In ``u ~ d^(5/4)`` and a time of its own an impact is that of a linear oscillator of
damping ratio ``zeta = sqrt(6/5) B``, and ends where its acceleration is zero (as Schwager and Poeschel, Granular
Matter 9:465, 2007, have it for a linear spring). So the restitution depends on B alone, not on speed, size or modulus:

``e = exp(-2 a / tan(a))`` with ``cos(a) = zeta``; for zeta > 1 ``e = exp(-2 a / tanh(a))`` with ``cosh(a) = zeta``.
"""

from functools import cache
from math import acos, acosh, cosh, exp, log, pi, sqrt

RATIO = sqrt(5 / 6)  # B over zeta


def restitution(damping_ratio: float) -> float:
    """The restitution of an impact of two bodies under no other force; 1 for a damping ratio of 0."""
    zeta = damping_ratio / RATIO
    root = sqrt(abs(1 - zeta) * (1 + zeta))
    if root == 0:
        return exp(-2)
    return exp(-2 * (acos(zeta) if zeta < 1 else acosh(zeta)) * zeta / root)


@cache
def damping_ratio(wanted: float) -> float:
    """The damping ratio B at which an impact has that restitution, above 0 and at most 1."""
    from scipy.optimize import brentq

    loss = -log(wanted)
    if loss == 0:
        return 0.0
    most = RATIO * cosh(loss / 2) * (1 + 1e-12)
    return float(brentq(lambda ratio: log(restitution(ratio)) + loss, 0.0, most, xtol=1e-300, rtol=1e-15))


def with_attraction(damping_ratio: float) -> float:
    """``e' = exp(-pi zeta / sqrt(1 - zeta^2))``, the restitution if bodies could pull; 0 where none is left.

    It is what LIGGGHTS has to be given, whether it limits forces or not: ``zeta = |ln e'| / sqrt(ln(e')^2 + pi^2)``.
    """
    zeta = damping_ratio / RATIO
    return exp(-pi * zeta / sqrt((1 - zeta) * (1 + zeta))) if zeta < 1 else 0.0


def damping_ratio_with_attraction(wanted: float) -> float:
    """The damping ratio of a restitution e' of the law with attraction."""
    loss = -log(wanted)
    return RATIO * loss / sqrt(loss**2 + pi**2)
