"""Oblique impact of one sphere on a flat plane: the tangential laws of LIGGGHTS and YADE, elastic theory, rigid bodies.

The plane is z = 0, the sphere comes from above with a velocity along x. Spin is about y, positive where the sphere
rolls along x, so that its lowest point moves at ``v_x - r spin``. Overlap ``d = r - z``.
"""

from collections.abc import Callable
from dataclasses import astuple, dataclass
from math import cos, pi, sqrt

import numpy as np
from numba import njit
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]
Numbers = tuple[float, float, float, float, float, float]
Motion = tuple[float, float, float]  # speed towards the plane, velocity along x, spin


@dataclass(frozen=True)
class TangentialLaw:
    """Law of friction of a code, without tangential damping.

    Attributes:
        incremental: True if the contact stores its force and adds ``-k_t ds`` at each step (YADE's
            ``Law2_ScGeom_MindlinPhys_Mindlin``); False if it stores its displacement s, with the force ``-k_t s``
            (LIGGGHTS' ``tangential history``). In both, ``k_t`` is that of the present overlap, and the force and the
            stored value are limited to friction times the normal force.
        slip_arm: c in the lever arm ``r - c d`` of the spin in the velocity of the contact.
        torque_arm: c in the lever arm ``r - c d`` of the force.
    """

    incremental: bool
    slip_arm: float
    torque_arm: float


# lever arms at a plane: LIGGGHTS to the middle of the overlap; YADE's wall the radius for the slip (default
# ``noRatch``) and to the plane for the torque
LIGGGHTS = TangentialLaw(incremental=False, slip_arm=0.5, torque_arm=0.5)
YADE = TangentialLaw(incremental=True, slip_arm=0.0, torque_arm=1.0)
YADE_ONE_ARM = TangentialLaw(incremental=True, slip_arm=1.0, torque_arm=1.0)  # noRatch=False: the plane for both


@dataclass(frozen=True)
class ObliqueContact:
    """A sphere on a plane, SI units.

    The normal force is ``max(0, k d^(3/2) + 2 B sqrt(m K) d')`` with ``K = 3/2 k sqrt(d)``, as in both codes; the
    tangential stiffness is ``k_t = shear sqrt(d)``.

    Attributes:
        stiffness: k above, ``4/3 E* sqrt(r)``.
        shear: ``8 G* sqrt(r)``.
        damping_ratio: B above; 0 is elastic.
        friction: coefficient of Coulomb's law.
    """

    radius_m: float
    mass_kg: float
    stiffness: float
    shear: float
    friction: float
    damping_ratio: float = 0.0


@dataclass(frozen=True)
class Rebound:
    """Motion after the impact, arrays of one shape.

    Attributes:
        normal_m_s: velocity of the centre away from the plane.
        tangential_m_s: velocity of the centre along x.
        spin_rad_s: about y.
        sliding: fraction of the contact's steps in which the force was limited by friction.
        duration_s: duration of the contact.
        overlap_m: largest overlap.
    """

    normal_m_s: Array
    tangential_m_s: Array
    spin_rad_s: Array
    sliding: Array
    duration_s: Array
    overlap_m: Array

    def contact_m_s(self, radius_m: float) -> Array:
        """Velocity along x of the point of the sphere that touched, ``v_x - r spin``."""
        return self.tangential_m_s - radius_m * self.spin_rad_s


def integrate_oblique(
    contact: ObliqueContact,
    law: TangentialLaw,
    normal_m_s: ArrayLike,
    tangential_m_s: ArrayLike,
    time_step_s: float,
    spin_rad_s: ArrayLike = 0.0,
) -> Rebound:
    """Integrate impacts from the first touch to separation, step by step as both codes do.

    Forces at step n follow from the position at n and the velocities at n - 1/2, then velocities and position advance:
    ``v += dt F/m; z += dt v``.

    Args:
        contact: sphere and plane.
        law: law of a code.
        normal_m_s: speed of the centre towards the plane, above zero.
        tangential_m_s: velocity of the centre along x.
        time_step_s: the time step.
        spin_rad_s: spin before the impact.

    Returns:
        Arrays of the shape to which the three motions broadcast.
    """
    body, rule = astuple(contact), astuple(law)
    return _each(lambda motion: _impact(body, rule, motion, time_step_s), normal_m_s, tangential_m_s, spin_rad_s)


def _each(impact: Callable[[Motion], Numbers], *motions: ArrayLike) -> Rebound:
    """Rebounds of impacts one by one, in the shape to which the three motions broadcast."""
    normal, tangential, spin = np.broadcast_arrays(*motions)
    rows = [
        impact((float(vn), float(vt), float(w)))
        for vn, vt, w in zip(normal.flat, tangential.flat, spin.flat, strict=True)
    ]
    return Rebound(*np.array(rows).T.reshape(6, *normal.shape))


@njit(cache=True)
def _impact(body: Numbers, rule: tuple[bool, float, float], motion: Motion, dt: float) -> Numbers:
    (r, m, k, shear, friction, ratio), (incremental, slip_arm, torque_arm) = body, rule
    vn, vt, spin = motion
    inertia = 0.4 * m * r * r
    z, vx, vz = r - dt * vn, vt, -vn
    kept = 0.0  # force or displacement
    steps, slides, deepest = 0, 0, 0.0
    while z < r:
        d = r - z
        deepest = max(deepest, d)
        root = sqrt(d)
        normal = max(0.0, k * d * root - 2 * ratio * sqrt(m * 1.5 * k * root) * vz)
        stiffness = shear * root
        slip = vx - (r - slip_arm * d) * spin
        if incremental:
            kept -= stiffness * (slip * dt)
            force = kept
        else:
            kept += slip * dt
            force = -stiffness * kept
        most = friction * normal
        if abs(force) > most:
            slides += 1
            force *= most / abs(force)
            kept = force if incremental else -force / stiffness
        vx += dt * force / m
        vz += dt * normal / m
        spin -= dt * (r - torque_arm * d) * force / inertia
        z += dt * vz
        steps += 1
    return vz, vx, spin, slides / steps, steps * dt, deepest


def gross_sliding(
    contact: ObliqueContact, restitution: ArrayLike, normal_m_s: ArrayLike, tangential_m_s: ArrayLike
) -> tuple[Array, Array]:
    """Tangential velocity and spin after an impact without initial spin that slides throughout, by momentum alone.

    ``v_t' = v_t - mu (1 + e) v_n``, so ``e_t = 1 - mu (1 + e)/tan(theta)``; ``spin = 5 mu (1 + e) v_n/(2 r)``.
    Rigid bodies slide throughout if ``tan(theta) >= 7/2 mu (1 + e)`` (Foerster et al., Phys. Fluids 6, 1108).
    """
    impulse = contact.friction * (1 + np.asarray(restitution)) * np.asarray(normal_m_s)
    return np.asarray(tangential_m_s) - impulse, 2.5 * impulse / contact.radius_m


def sticking_restitution(contact: ObliqueContact) -> float:
    """Ratio of the contact velocities after and before an elastic impact without slip, for overlaps << radius.

    During the Hertz impact, the velocity of the contact (incremental law) or its displacement (total law) obeys
    ``u'' = -7/(2 m) shear sqrt(d(t)) u``. In ``(d/d_max)^(5/2)`` this is the hypergeometric equation, and both laws
    give ``cos(2 pi sqrt(1/400 + 7/10 shear/k))/cos(pi/10)``. The absolute value may exceed 1: neither law conserves
    energy while the normal force changes.
    """
    return cos(2 * pi * sqrt(1 / 400 + 0.7 * contact.shear / contact.stiffness)) / cos(pi / 10)
