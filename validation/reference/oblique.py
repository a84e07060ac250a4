"""Oblique impact of one sphere on a flat plane: the tangential laws of LIGGGHTS and YADE, elastic theory, rigid bodies.

The plane is z = 0, the sphere comes from above with a velocity along x. Spin is about y, positive where the sphere
rolls along x, so that its lowest point moves at ``v_x - r spin``. Overlap ``d = r - z``.
"""

from dataclasses import dataclass
from math import cos, hypot, log, pi, sqrt

import numpy as np
from numba import njit
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]
Numbers = tuple[float, float, float, float, float, float]


@dataclass(frozen=True)
class TangentialLaw:
    """How a code finds the friction force of a contact, without tangential damping.

    Attributes:
        incremental: whether the force itself is kept and gets ``-k_t ds`` at each step (YADE's
            ``Law2_ScGeom_MindlinPhys_Mindlin``). Otherwise the displacement s is kept and the force is all of it
            times the present stiffness, ``-k_t s`` (LIGGGHTS' ``tangential history``). ``k_t`` is that of the present
            overlap in both, and both cut the force, and with it what is kept, back to friction times normal force.
        slip_arm: c in the arm ``r - c d`` with which the spin enters the velocity of the contact.
        torque_arm: c in the arm ``r - c d`` of the force.
    """

    incremental: bool
    slip_arm: float
    torque_arm: float


# the arms at a plane: LIGGGHTS has the middle of the overlap for both, YADE's wall the whole radius for the slip
# (``noRatch``, its default) and the plane for the torque
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
        damping_ratio: B above; 0 is elastic. YADE's ``betan``; for LIGGGHTS' from a restitution see ``damping_ratio``.
        friction: coefficient of Coulomb's law.

    Raises:
        ValueError: radius, mass or stiffness not above zero, or another value below zero or not finite.
    """

    radius_m: float
    mass_kg: float
    stiffness: float
    shear: float
    friction: float
    damping_ratio: float = 0.0

    def __post_init__(self) -> None:
        for name in self.__dataclass_fields__:
            value = getattr(self, name)
            above = name in ("radius_m", "mass_kg", "stiffness")
            if not np.isfinite(value) or value < 0 or (above and value == 0):
                raise ValueError(f"{name}: {value}, expected {'above zero' if above else 'zero or above'}")


@dataclass(frozen=True)
class Rebound:
    """Motion after the impact, arrays of one shape.

    Attributes:
        normal_m_s: velocity of the centre away from the plane.
        tangential_m_s: velocity of the centre along x.
        spin_rad_s: about y.
        sliding: share of the contact's steps in which the force was cut back to friction.
        duration_s: of the contact.
        overlap_m: the greatest.
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

    def angle_rad(self, radius_m: float) -> Array:
        """Rebound angle of that point from the normal; negative where it goes back."""
        return np.asarray(np.arctan2(self.contact_m_s(radius_m), self.normal_m_s))


def contact_moduli(youngs_Pa: tuple[float, float], poisson: tuple[float, float]) -> tuple[float, float]:
    """``E*`` and ``G*`` of two bodies, the compliances added; an infinite modulus is a rigid body.

    ``1/E* = (1 - nu1^2)/E1 + (1 - nu2^2)/E2``, ``1/G* = 2(2 - nu1)(1 + nu1)/E1 + 2(2 - nu2)(1 + nu2)/E2`` (Mindlin).
    """
    (e1, e2), (n1, n2) = youngs_Pa, poisson
    normal = (1 - n1**2) / e1 + (1 - n2**2) / e2
    return 1 / normal, 1 / (2 * (2 - n1) * (1 + n1) / e1 + 2 * (2 - n2) * (1 + n2) / e2)


def damping_ratio(restitution: float) -> float:
    """``-sqrt(5/6) ln e / sqrt(ln^2 e + pi^2)``, LIGGGHTS' for a coefficient of restitution above 0 and up to 1."""
    if not 0 < restitution <= 1:
        raise ValueError(f"restitution: {restitution}, expected above 0 and up to 1")
    return sqrt(5 / 6) * log(1 / restitution) / hypot(log(restitution), pi)


def integrate_oblique(
    contact: ObliqueContact,
    law: TangentialLaw,
    normal_m_s: ArrayLike,
    tangential_m_s: ArrayLike,
    time_step_s: float,
    spin_rad_s: ArrayLike = 0.0,
) -> Rebound:
    """Integrates impacts from the first touch to separation, step by step as both codes do.

    Forces at step n follow from the position at n and the velocities at n - 1/2, then velocities and position advance:
    ``v += dt F/m; z += dt v``.

    Args:
        contact: sphere and plane.
        law: a code's.
        normal_m_s: speed of the centre towards the plane, above zero.
        tangential_m_s: velocity of the centre along x.
        time_step_s: the time step.
        spin_rad_s: before the impact.

    Returns:
        Arrays of the shape to which the three motions broadcast.

    Raises:
        ValueError: a step or a normal speed not above zero, or a step too long to see the contact.
    """
    motions = _motions(contact, normal_m_s, tangential_m_s, time_step_s, spin_rad_s)
    body, rule = _numbers(contact), (law.incremental, law.slip_arm, law.torque_arm)
    rows = [_impact(body, rule, (float(vn), float(vt), float(spin)), time_step_s) for vn, vt, spin in motions.T]
    return Rebound(*np.array(rows).T.reshape(6, *_shape(normal_m_s, tangential_m_s, spin_rad_s)))


def integrate_half_space(
    contact: ObliqueContact,
    normal_m_s: ArrayLike,
    tangential_m_s: ArrayLike,
    time_step_s: float,
    spin_rad_s: ArrayLike = 0.0,
    springs: int = 400,
) -> Rebound:
    """The same impact with stick and slip at each place of the contact, the answer of elastic theory.

    Half spaces whose normal and tangential tractions do not couple, Coulomb's law at each place, and friction along x
    everywhere: the assumptions of Maw, Barber and Fawcett (Wear 38, 101). Such a contact is equivalent to a row of
    independent springs under the profile ``x^2/r`` (Popov and Hess, Method of Dimensionality Reduction), for any
    history of load: each enters unstrained, slips where its own friction is reached, and leaves. The arm is the radius.

    Args:
        contact: sphere and plane.
        normal_m_s: as for ``integrate_oblique``.
        tangential_m_s: likewise.
        time_step_s: likewise.
        spin_rad_s: likewise.
        springs: on one half of the widest contact; 100 give the rebound to 1e-5.

    Returns:
        Likewise; ``sliding`` counts the steps in which every spring slips.

    Raises:
        ValueError: as ``integrate_oblique``, or springs below 10.
    """
    if springs < 10:
        raise ValueError(f"springs: {springs}, expected at least 10")
    motions = _motions(contact, normal_m_s, tangential_m_s, time_step_s, spin_rad_s)
    body = _numbers(contact)
    rows = [
        _impact_of_springs(body, springs, (float(vn), float(vt), float(spin)), time_step_s)
        for vn, vt, spin in motions.T
    ]
    return Rebound(*np.array(rows).T.reshape(6, *_shape(normal_m_s, tangential_m_s, spin_rad_s)))


def _numbers(contact: ObliqueContact) -> Numbers:
    return (
        contact.radius_m,
        contact.mass_kg,
        contact.stiffness,
        contact.shear,
        contact.friction,
        contact.damping_ratio,
    )


def _shape(*motion: ArrayLike) -> tuple[int, ...]:
    return np.broadcast_shapes(*(np.shape(part) for part in motion))


def _motions(
    contact: ObliqueContact, normal: ArrayLike, tangential: ArrayLike, time_step_s: float, spin: ArrayLike
) -> Array:
    """The motions one a column, checked."""
    if not (np.isfinite(time_step_s) and time_step_s > 0):
        raise ValueError(f"time_step_s: {time_step_s}, expected above zero")
    parts = (np.asarray(part, dtype=float) for part in (normal, tangential, spin))
    motions = np.array([part.ravel() for part in np.broadcast_arrays(*parts)])
    if not ((motions[0] > 0) & np.isfinite(motions).all(axis=0)).all():
        raise ValueError("normal_m_s: expected above zero, and all motions finite")
    # a Hertz impact takes 2.94 d/v, d the greatest overlap without damping
    if (2.94 * _deepest(contact.mass_kg, contact.stiffness, motions[0]) / motions[0] < 20 * time_step_s).any():
        raise ValueError(f"time_step_s: {time_step_s}, expected at most a twentieth of the contact")
    return motions


def _deepest(m: float, k: float, speed: Array) -> Array:
    """Greatest overlap of an elastic Hertz impact."""
    return np.asarray((1.25 * m * speed**2 / k) ** 0.4)


@njit(cache=True)
def _impact(body: Numbers, rule: tuple[bool, float, float], motion: tuple[float, float, float], dt: float) -> Numbers:
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


@njit(cache=True)
def shear_of_springs(kept: Array, rise: Array, overlap: float, most: float, moved: float) -> tuple[float, bool]:
    """Moves the plane's springs along and lets those slip that reach friction.

    Args:
        kept: force of each spring, changed.
        rise: overlap at which each meets the sphere.
        overlap: present one.
        most: friction times normal force; each spring may bear its share by its compression.
        moved: stiffness of one spring times displacement of the contact.

    Returns:
        Their force, and whether every one slips.
    """
    share = np.maximum(0.0, overlap - rise).sum()
    force, slid = 0.0, True
    for j in range(kept.size):
        pressed = overlap - rise[j]
        if pressed <= 0.0:  # left, or never met
            kept[j] = 0.0
            continue
        bound = most * pressed / share
        kept[j] -= moved
        if abs(kept[j]) > bound:
            kept[j] *= bound / abs(kept[j])
        else:
            slid = False
        force += kept[j]
    return force, slid


@njit(cache=True)
def _impact_of_springs(body: Numbers, springs: int, motion: tuple[float, float, float], dt: float) -> Numbers:
    (r, m, k, shear, friction, ratio), (vn, vt, spin) = body, motion
    inertia = 0.4 * m * r * r
    # the foundation's stiffness is k_t = shear sqrt(d) at a contact of half width a = sqrt(r d)
    width = 1.01 * sqrt(r * (1.25 * m * vn**2 / k) ** 0.4) / springs
    stiffness = shear / sqrt(r) * width
    place = (np.arange(springs, dtype=np.float64) + 0.5) * width
    rise = place * place / r
    kept = np.zeros(springs)
    z, vx, vz = r - dt * vn, vt, -vn
    steps, slides, deepest = 0, 0, 0.0
    while z < r:
        d = r - z
        deepest = max(deepest, d)
        root = sqrt(d)
        normal = max(0.0, k * d * root - 2 * ratio * sqrt(m * 1.5 * k * root) * vz)
        moved = (vx - r * spin) * dt
        force, slid = shear_of_springs(kept, rise, d, friction * normal, stiffness * moved)
        slides += slid
        vx += dt * force / m
        vz += dt * normal / m
        spin -= dt * r * force / inertia
        z += dt * vz
        steps += 1
    return vz, vx, spin, slides / steps, steps * dt, deepest


def gross_sliding(
    contact: ObliqueContact, restitution: ArrayLike, normal_m_s: ArrayLike, tangential_m_s: ArrayLike
) -> tuple[Array, Array]:
    """Tangential velocity and spin after an impact without spin that slides along x throughout, by momentum alone.

    ``v_t' = v_t - mu (1 + e) v_n``, so ``e_t = 1 - mu (1 + e)/tan(theta)``; ``spin = 5 mu (1 + e) v_n/(2 r)``.
    Rigid bodies slide throughout from ``tan(theta) = 7/2 mu (1 + e)`` on (Foerster et al., Phys. Fluids 6, 1108).
    """
    impulse = contact.friction * (1 + np.asarray(restitution)) * np.asarray(normal_m_s)
    return np.asarray(tangential_m_s) - impulse, 2.5 * impulse / contact.radius_m


def sticking_restitution(contact: ObliqueContact) -> float:
    """Velocity of the contact after over before an elastic impact that never slips, overlap small beside the radius.

    With a kept force the contact's velocity, with a kept displacement the displacement itself obeys
    ``u'' = -7/(2 m) shear sqrt(d(t)) u`` during the Hertz impact. In ``(d/d_max)^(5/2)`` that is the hypergeometric
    equation, and both laws give ``cos(2 pi sqrt(1/400 + 7/10 shear/k))/cos(pi/10)``. The absolute value may be above 1:
    neither law conserves energy while the normal force changes.
    """
    return cos(2 * pi * sqrt(1 / 400 + 0.7 * contact.shear / contact.stiffness)) / cos(pi / 10)


def scaled_angle(tangent: ArrayLike, poisson: float, friction: float) -> Array:
    """``psi = 2 (1 - nu)/(mu (2 - nu)) tan(theta)`` of Maw, Barber and Fawcett (Wear 38, 101), for like materials.

    Of the incoming contact point: below 1 it sticks at first. Serves for the outgoing point, too.
    """
    return 2 * (1 - poisson) / (friction * (2 - poisson)) * np.asarray(tangent)
