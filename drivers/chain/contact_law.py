"""Hertz's elastic contact: stiffness, force, overlap, energy; the laws of dissipation are in ``drivers.laws``.

Functions of overlap, force and energy accept one contact or arrays of contacts.
"""

from collections.abc import Callable
from functools import cache
from math import pi, sqrt
from typing import Any, TypeVar

import numpy as np

from drivers.scene.model import Material
from validation.reference.hertz_chain import EXPONENT, Array

Value = TypeVar("Value", float, Array)  # stiffnesses of type Any are also floats or Arrays
# k or k_t of a contact, from material and radius of both bodies
ContactStiffness = Callable[[Material | None, float, Material | None, float], float]


def hertz_stiffness(first: Material | None, radius_1_m: float, second: Material | None, radius_2_m: float) -> float:
    """Hertz stiffness k in F = k overlap^(3/2), in N m^-3/2.

    ``k = (4/3) E* sqrt(R*)`` with ``1/E* = (1-nu1^2)/E1 + (1-nu2^2)/E2`` and ``1/R* = 1/R1 + 1/R2``, the general
    form of the paper's Eq. (7). A radius of inf is a flat face; None is a rigid material.
    """
    compliance = sum(m.compliance for m in (first, second) if m is not None)
    curvature = 1 / radius_1_m + 1 / radius_2_m
    return 4 / 3 / compliance / sqrt(curvature)


def mindlin_stiffness(first: Material | None, radius_1_m: float, second: Material | None, radius_2_m: float) -> float:
    """Shear stiffness k_t in ``dF_t = k_t sqrt(overlap) ds``, in N m^-3/2.

    ``k_t = 8 G* sqrt(R*)`` with ``1/G* = 2(2-nu1)(1+nu1)/E1 + 2(2-nu2)(1+nu2)/E2``: Mindlin's contact without slip.
    """
    compliance = sum(
        2 * (2 - m.poisson_ratio) * (1 + m.poisson_ratio) / m.youngs_modulus for m in (first, second) if m is not None
    )
    return 8 / compliance / sqrt(1 / radius_1_m + 1 / radius_2_m)


@cache
def conformity(radius_m: float, bore_radius_m: float) -> float:
    """Ratio of the contact stiffness of a sphere in a bore to that on a flat of the same material.

    Hertz's elliptic contact (Johnson, Contact Mechanics, section 4.2) with the relative curvatures ``1/R - 1/R_bore``
    across the axis and ``1/R`` along the axis; the force is proportional to overlap^(3/2) as well. A bore radius of
    inf is a flat.

    Raises:
        ValueError: the sphere does not fit into the bore.
    """
    from scipy.optimize import brentq
    from scipy.special import ellipe, ellipkm1

    if not 0 < radius_m < bore_radius_m:
        raise ValueError(f"radius_m: {radius_m}, expected above zero and below that of the bore, {bore_radius_m}")
    across, along = (1 / radius_m - 1 / bore_radius_m) / 2, 1 / radius_m / 2
    if across == along:
        return 1.0

    def curvatures(squared: float) -> tuple[float, float]:
        """``E/m - K`` and ``K - E``; their ratio is that of the relative curvatures along and across the axis."""
        second, first = float(ellipkm1(squared)), float(ellipe(1 - squared))
        return first / squared - second, second - first

    def excess(squared: float) -> float:
        over, under = curvatures(squared)
        return over / under - along / across

    squared = brentq(excess, 1e-300, 1 - 1e-12, xtol=1e-300, rtol=1e-15)  # m = (b/a)^2 of the ellipse's axes a > b
    over, under = curvatures(squared)
    second, curved = float(ellipkm1(squared)), sqrt(over * under)
    f1_cubed = 4 / (pi * (1 - squared)) * squared**0.75 * curved
    f2 = 2 / pi * squared**0.25 * f1_cubed ** (-1 / 3) * second
    mean_radius = 1 / (2 * sqrt(across * along))
    return float(sqrt(mean_radius / radius_m) * f2**-1.5)


def hertz_force(stiffness: Any, overlap_m: Value) -> Value:
    """Force ``F = k d^(3/2)`` for an overlap of 0 or more, in N."""
    force: Value = stiffness * overlap_m**EXPONENT
    return force


def hertz_overlap(stiffness: Any, force_N: Value) -> Value:
    """Overlap ``d = (F / k)^(2/3)`` for a force of 0 or more, in m."""
    overlap: Value = (force_N / stiffness) ** (1 / EXPONENT)
    return overlap


def contact_stiffness(stiffness: float | Array, overlap_m: Array) -> Array:
    """Tangent stiffness ``dF/dd = (3/2) k d^(1/2)``, in N/m."""
    return np.asarray(EXPONENT * stiffness * np.sqrt(overlap_m))


def contact_stiffness_at(stiffness: float, force_N: float) -> float:
    """Tangent stiffness at the force F, ``(3/2) k^(2/3) F^(1/3)``, in N/m."""
    return float(EXPONENT * float(stiffness) ** (2 / 3) * float(force_N) ** (1 / 3))
