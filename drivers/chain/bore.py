"""Contact of a bead with the bore of a tube: conformal across the axis, and so stiffer than with a flat."""

from functools import cache
from math import cos, pi, sqrt

from scipy.optimize import brentq
from scipy.special import ellipe, ellipkm1


@cache
def conformity(radius_m: float, bore_radius_m: float) -> float:
    """How many times a sphere in a bore is as stiff as on a flat of the same material.

    Hertz's elliptic contact (Johnson, Contact Mechanics, section 4.2) with the relative curvatures ``1/R - 1/R_bore``
    across the axis and ``1/R`` along it; the force still goes with overlap^(3/2). A bore of inf is a flat.

    Raises:
        ValueError: the sphere does not fit.
    """
    if not 0 < radius_m < bore_radius_m:
        raise ValueError(f"radius_m: {radius_m}, expected above zero and below that of the bore, {bore_radius_m}")
    across, along = (1 / radius_m - 1 / bore_radius_m) / 2, 1 / radius_m / 2
    if across == along:
        return 1.0
    # the ellipse's axes a (across) > b: m = (b/a)^2 solves along/across = ((1/m) E - K) / (K - E)
    squared = brentq(lambda m: _curvatures(m) - along / across, 1e-300, 1 - 1e-12, xtol=1e-300, rtol=1e-15)
    second = float(ellipkm1(squared))
    first = float(ellipe(1 - squared))
    curved = sqrt((first / squared - second) * (second - first))
    f1_cubed = 4 / (pi * (1 - squared)) * squared**0.75 * curved
    f2 = 2 / pi * squared**0.25 * f1_cubed ** (-1 / 3) * second
    mean_radius = 1 / (2 * sqrt(across * along))
    return float(sqrt(mean_radius / radius_m) * f2**-1.5)


def in_edge(sides: int) -> float:
    """The share of a cylinder's stiffness that each flat side of a mesh gets.

    Beads come to rest in its edges, where two sides hold them: ``2 k_side cos(pi/n)^(5/2) = k``.
    """
    return float(1 / (2 * cos(pi / sides) ** 2.5))


def _curvatures(squared: float) -> float:
    """Ratio of the relative curvatures of a contact ellipse with ``(b/a)^2`` squared."""
    second, first = float(ellipkm1(squared)), float(ellipe(1 - squared))
    return (first / squared - second) / (second - first)
