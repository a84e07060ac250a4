"""Oblique impact of one sphere on a flat plane: the tangential laws of LIGGGHTS and YADE, and closed formulas.

The plane is z = 0, the sphere comes from above with a velocity along x. Spin is about y, positive where the sphere
rolls along x, so that its lowest point moves at ``v_x - r spin``. Overlap ``d = r - z``.
"""

from dataclasses import astuple, dataclass
from math import cos, pi, sqrt

from numba import njit

Numbers = tuple[float, float, float, float, float]


@dataclass(frozen=True)
class TangentialLaw:
    """Law of friction of a code, without tangential damping.

    Attributes:
        incremental: True if the contact stores its force and adds ``-k_t ds`` at each step (YADE's
            ``Law2_ScGeom_MindlinPhys_Mindlin``); False if it stores its displacement s, with the force ``-k_t s``
            (LIGGGHTS' ``tangential history``). In both, ``k_t`` is that of the present overlap, and the force and the
            stored value are limited to friction times the normal force.
        arm: c in the lever arm ``r - c d`` of the spin and of the force.
    """

    incremental: bool
    arm: float


LIGGGHTS = TangentialLaw(incremental=False, arm=0.5)  # to the middle of the overlap
YADE = TangentialLaw(incremental=True, arm=1.0)  # to the plane (noRatch=False)


@dataclass(frozen=True)
class ObliqueContact:
    """A sphere on a plane, SI units.

    The normal force is ``max(0, k d^(3/2) + 2 B sqrt(m K) d')`` with ``K = 3/2 k sqrt(d)``, as in both codes; the
    tangential stiffness is ``k_t = shear sqrt(d)``.

    Attributes:
        stiffness: k above, ``4/3 E* sqrt(r)``.
        shear: ``8 G* sqrt(r)``.
        friction: coefficient of Coulomb's law.
        damping_ratio: B above; 0 is elastic.
    """

    radius_m: float
    mass_kg: float
    stiffness: float
    shear: float
    friction: float
    damping_ratio: float = 0.0


@dataclass(frozen=True)
class Rebound:
    """Velocities after the impact, away from the plane and along x, spin, duration of contact, and largest overlap."""

    normal_m_s: float
    tangential_m_s: float
    spin_rad_s: float
    duration_s: float
    overlap_m: float


def integrate_oblique(
    contact: ObliqueContact, law: TangentialLaw, normal_m_s: float, tangential_m_s: float, time_step_s: float
) -> Rebound:
    """Integrate an impact without spin from the first touch to separation, step by step as both codes do.

    Forces at step n follow from the position at n and the velocities at n - 1/2, then velocities and position advance:
    ``v += dt F/m; z += dt v``.
    """
    return Rebound(*_impact(astuple(contact), law.incremental, law.arm, normal_m_s, tangential_m_s, time_step_s))


@njit(cache=True)
def _impact(
    body: tuple[float, float, float, float, float, float], incremental: bool, arm: float, vn: float, vt: float,
    dt: float,
) -> Numbers:  # fmt: skip
    r, m, k, shear, friction, ratio = body
    inertia = 0.4 * m * r * r
    z, vx, vz, spin = r - dt * vn, vt, -vn, 0.0
    kept = 0.0  # force or displacement
    steps, deepest = 0, 0.0
    while z < r:
        d = r - z
        deepest = max(deepest, d)
        root = sqrt(d)
        normal = max(0.0, k * d * root - 2 * ratio * sqrt(m * 1.5 * k * root) * vz)
        stiffness = shear * root
        slip = vx - (r - arm * d) * spin
        if incremental:
            kept -= stiffness * (slip * dt)
            force = kept
        else:
            kept += slip * dt
            force = -stiffness * kept
        most = friction * normal
        if abs(force) > most:
            force *= most / abs(force)
            kept = force if incremental else -force / stiffness
        vx += dt * force / m
        vz += dt * normal / m
        spin -= dt * (r - arm * d) * force / inertia
        z += dt * vz
        steps += 1
    return vz, vx, spin, steps * dt, deepest


def sticking_restitution(contact: ObliqueContact) -> float:
    """Ratio of the contact velocities after and before an elastic impact without slip, for overlaps << radius.

    During the Hertz impact, the velocity of the contact (incremental law) or its displacement (total law) obeys
    ``u'' = -7/(2 m) shear sqrt(d(t)) u``. In ``(d/d_max)^(5/2)`` this is the hypergeometric equation, and both laws
    give ``cos(2 pi sqrt(1/400 + 7/10 shear/k))/cos(pi/10)``. The absolute value may exceed 1: neither law conserves
    energy while the normal force changes.
    """
    return cos(2 * pi * sqrt(1 / 400 + 0.7 * contact.shear / contact.stiffness)) / cos(pi / 10)
