"""Chains and motions, the input and output of the integrators, and the contact law."""

from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Flag = NDArray[np.bool_]  # shape (1,); another thread sets it to end an integration, whose result then has no meaning
NEVER: Flag = np.zeros(1, bool)  # of an integration that nothing ends
EXPONENT = 3 / 2  # exponent of the overlap in Hertz's law
VISCOELASTIC_POWER = 1 / 4  # exponent of the overlap in the viscoelastic damping force
ENERGY_SHARE = 1 / (1 + EXPONENT)  # elastic energy divided by force times overlap
SINES = (3, 7, 11)  # columns of A in a segment; phi, omega and beta follow each
COLUMNS = 15  # of a segment: t_i, c0, c1, three sines
LEAST_WINDOWED = 64  # bodies; in shorter chains a window of moving bodies gains little
SAME_TIME = 1 + 1e-12  # a time that equals the beginning of a segment up to rounding belongs to this segment


def _checked(name: str, values: Array, shape: tuple[int, ...]) -> Array:
    """Array of a chain as doubles, checked for shape and range."""
    array = np.array(values, dtype=float)
    if array.shape != shape or not array.size:
        raise ValueError(f"{name}: shape {array.shape}, expected {shape}, for one or more bodies")
    if not (np.isfinite(array) | (name == "radius_m")).all():
        raise ValueError(f"{name}: not finite")
    if name in ("mass_kg", "radius_m") and not (array > 0).all():
        raise ValueError(f"{name}: not above zero")
    if name in ("stiffness", "damping") and (array < 0).any():
        raise ValueError(f"{name}: below zero")
    return array


@dataclass(frozen=True, eq=False)
class Drive:
    """Drive of one body by a force of time, or by its displacement.

    All wave forms are tables of segments. With ``tau = t - t_i`` after the beginning t_i of segment i, the value is
    ``w = c0 + c1 tau + sum of A_m sin(phi_m + omega_m tau + beta_m tau^2 / 2)`` with three sines, until the next
    segment begins; the last one has no end. A sine under a Hann window is three sines, a chirp has beta, a polygon has
    c0 and c1.

    Attributes:
        body: index of the body, from 0 for the lowest.
        prescribed: True if the value is the displacement of the body since time 0, in m, on which forces have no
            effect; False if it is a force on the body, in N. Both are upwards positive.
        segments: table of segments, the first of which begins at time 0. Shape (segments, ``COLUMNS``).

    Raises:
        ValueError: the table has another shape, values that are not finite, or beginnings that do not increase from 0.
    """

    body: int
    prescribed: bool
    segments: Array

    def __post_init__(self) -> None:
        table = np.array(self.segments, dtype=float)
        if table.ndim != 2 or table.shape[1] != COLUMNS or not len(table) or not np.isfinite(table).all():
            raise ValueError(f"segments: shape {table.shape}, expected finite values of shape (segments, {COLUMNS})")
        if table[0, 0] != 0 or not (np.diff(table[:, 0]) > 0).all():
            raise ValueError("segments: expected beginnings that increase from 0")
        object.__setattr__(self, "segments", table)

    def at(self, time_s: Array) -> tuple[Array, Array, Array]:
        """Values, their rates and second derivatives at some times, of any shape; at a kink those after it."""
        place = np.searchsorted(self.segments[:, 0], np.asarray(time_s) * SAME_TIME, side="right") - 1
        rows = np.moveaxis(self.segments[place], -1, 0)
        value, rate, bend = wave(rows, time_s - rows[0])
        return value, rate, bend


@dataclass(frozen=True)
class HertzChain:
    """A chain of bodies 1 to n from the lowest up, contact j under body j; arrays of shape (n,), SI units.

    Attributes:
        mass_kg: Mass of each body.
        stiffness: k of each contact in ``F = k overlap^(3/2)``; 0 for a missing contact.
        overlap_m: Overlap of each contact at time 0, negative for a gap. No absolute heights enter, which avoids
            cancellation.
        velocity_m_s: Velocity at time 0, upwards positive.
        load_N: Constant force on each body, upwards positive.
        damping: C of each contact in ``F = max(0, k overlap^(3/2) + C overlap^p d overlap/dt)``; default 0.
        alpha: Exponent of the velocity-power law (``dissipative_force``), with gamma in ``damping``; 0: the law above.
        overlap_power: p of the law above, above 0 and at most 3/2; without meaning for the velocity-power law.
        drive: Force of time on a body, added to its load, or motion of a body; its velocity at time 0 is that of the
            drive. None: no drive.

    Raises:
        ValueError: an array has a wrong shape or values that are not finite; a mass is not above zero; a stiffness or
            damping is below zero; alpha is between 0 and 1; with alpha, a contact has no gamma; p is out of range; the
            driven body is not there.
    """

    mass_kg: Array
    stiffness: Array
    overlap_m: Array
    velocity_m_s: Array
    load_N: Array
    damping: Array = field(default_factory=lambda: np.zeros(0))
    alpha: float = 0.0
    overlap_power: float = VISCOELASTIC_POWER
    drive: Drive | None = None

    def __post_init__(self) -> None:
        if not np.size(self.damping):
            object.__setattr__(self, "damping", np.zeros(np.shape(self.mass_kg)))
        for name in self.__dataclass_fields__:
            if name not in ("alpha", "overlap_power", "drive"):
                object.__setattr__(self, name, _checked(name, getattr(self, name), (np.size(self.mass_kg),)))
        if self.alpha and not 1 <= self.alpha < np.inf:
            raise ValueError(f"alpha: {self.alpha}, expected 0, or 1 or more")
        if not 0 < self.overlap_power <= EXPONENT:
            raise ValueError(f"overlap_power: {self.overlap_power}, expected above 0 and at most 3/2")
        if self.alpha and (self.damping[self.stiffness > 0] == 0).any():
            raise ValueError("damping: 0 at a contact, expected a gamma above zero at each contact")
        if self.drive is not None:
            if not 0 <= self.drive.body < self.mass_kg.size:
                raise ValueError(f"drive: body {self.drive.body}, expected 0 to {self.mass_kg.size - 1}")
            if self.drive.prescribed:
                self.velocity_m_s[self.drive.body] = self.drive.at(np.zeros(1))[1][0]

    @property
    def elastic(self) -> bool:
        """True if no contact dissipates energy."""
        return not self.damping.any()

    @cached_property
    def force_N(self) -> Array:
        """Force of each contact at time 0."""
        return contact_force(self, self.overlap_m, self.velocity_m_s)

    @cached_property
    def acceleration_m_s2(self) -> Array:
        """Acceleration of each body at time 0 by the forces on it."""
        load = np.ravel(loads_N(self.load_N, self.drive, np.zeros(1)))
        return np.asarray((self.force_N - np.append(self.force_N[1:], 0.0) + load) / self.mass_kg)


@dataclass(frozen=True)
class Motion:
    """Samples of an integration; arrays of shape (samples, bodies).

    Attributes:
        force_N: Force of each contact, compression positive.
        displacement_m: Displacement of each body since time 0, upwards positive.
        velocity_m_s: Velocity of each body, upwards positive.
        drive_work_J: Work of the drive since time 0. Shape (samples,); None without a drive.
        drive_impulse_N_s: Impulse of the drive since time 0. Shape (samples,); None without a drive.
        dissipated_J: Energy dissipated in each contact since time 0; None unless asked for, as the next.
        passed_J: Energy that each body has passed to the contact below it since time 0, without the work of the static
            force.
    """

    force_N: Array
    displacement_m: Array
    velocity_m_s: Array
    drive_work_J: Array | None = None
    drive_impulse_N_s: Array | None = None
    dissipated_J: Array | None = None
    passed_J: Array | None = None


# field of TubeChain -> key of the deck; the deck also has the keys of a straight chain
TUBE_KEYS = {
    "place_m": "place_m",
    "velocity_m_s": "velocity_xyz_m_s",
    "wall_m": "wall_m",
    "shear": "shear_N_m-3/2",
    "friction": "friction",
    "bore_m": "bore_m",
    "bore_stiffness": "bore_stiffness_N_m-3/2",
    "bore_shear": "bore_shear_N_m-3/2",
    "bore_friction": "bore_friction",
    "turns": "turns",
}


@dataclass(frozen=True)
class TubeChain:
    """Bodies 1 to n from the lowest up, contact j under body j; arrays of shape (n,) and (n, 3), SI units.

    Attributes:
        mass_kg: Mass of each body.
        radius_m: Radius; inf for a flat striker, which moves along the axis only.
        stiffness: k of each contact in ``F = k overlap^(3/2)``; 0 for a missing contact (first contact without a wall).
        damping: C of each contact in ``F = max(0, k overlap^(3/2) + C overlap^(1/4) d overlap/dt)``, the only law here.
        shear: k_t of each contact: a shear displacement ds adds the force ``k_t sqrt(overlap) ds``.
        load_N: Constant force on each body along the axis, upwards positive.
        bore_stiffness: k of each body's elastic contact with the bore; 0 for a body outside the tube.
        bore_shear: k_t of each body's contact with the bore.
        place_m: Centres at time 0, of a flat striker the centre of its face; the axis is x = y = 0.
        velocity_m_s: Velocities at time 0; spins at time 0 are zero.
        wall_m: Height of the wall under body 1.
        friction: Coefficient of friction between bodies and with the wall.
        bore_m: Radius of the bore.
        bore_friction: Coefficient of friction with the bore.
        turns: True if friction turns the bodies.

    Raises:
        ValueError: an array has a wrong shape or values that are not finite; a mass or radius is not above zero.
    """

    mass_kg: Array
    radius_m: Array
    stiffness: Array
    damping: Array
    shear: Array
    load_N: Array
    bore_stiffness: Array
    bore_shear: Array
    place_m: Array
    velocity_m_s: Array
    wall_m: float
    friction: float
    bore_m: float
    bore_friction: float
    turns: bool = True

    def __post_init__(self) -> None:
        bodies = np.size(self.mass_kg)
        for name in self.__dataclass_fields__:
            value = getattr(self, name)
            if np.ndim(value):
                shape = (bodies, 3) if name in ("place_m", "velocity_m_s") else (bodies,)
                object.__setattr__(self, name, _checked(name, value, shape))


@dataclass(frozen=True)
class Extremes:
    """Extreme values over all steps of a motion; arrays of shape (bodies,).

    Attributes:
        overlap_m: Largest overlap of the contact under each body.
        bore_overlap_m: Largest overlap of each body with the bore.
        speed_m_s: Largest relative speed of the contact while it has a force; zeros for a tube.
        kinetic_J: Largest kinetic energy of all bodies but one that moves as prescribed; NaN after a blow-up.
        risen_J: Largest rise of the total energy above that at time 0, shear springs not counted: by exact motion it
            never rises. 0 with a drive, NaN after a blow-up.
    """

    overlap_m: Array
    bore_overlap_m: Array
    speed_m_s: Array
    kinetic_J: float
    risen_J: float


@dataclass(frozen=True)
class TubeMotion:
    """Samples of an integration; velocities and spins belong to the time of the forces.

    Attributes:
        force_N: Axial force of the contact under each body, including friction. Shape (samples, bodies).
        bore_N: Force of the bore on each body. Shape (samples, bodies, 3).
        place_m: Centre of each body. Shape (samples, bodies, 3).
        velocity_m_s: Velocity of each body. Shape (samples, bodies, 3).
        spin_rad_s: Angular velocity of each body. Shape (samples, bodies, 3).
        extremes: Extreme values over all steps; None unless asked for.
    """

    force_N: Array
    bore_N: Array
    place_m: Array
    velocity_m_s: Array
    spin_rad_s: Array
    extremes: Extremes | None = None


def check_timing(time_step_s: float, steps_per_sample: int, samples: int) -> None:
    """Checks the steps and samples of an integration.

    Raises:
        ValueError: the step is not above zero, or a count is below one.
    """
    if not (np.isfinite(time_step_s) and time_step_s > 0):
        raise ValueError(f"time_step_s: {time_step_s}, expected above zero")
    if steps_per_sample < 1 or samples < 1:
        raise ValueError("steps_per_sample, samples: expected at least one")


def wave(segment: Any, tau: Any) -> tuple[Any, Any, Any]:
    """Value, rate and second derivative of a segment; the kernels compile this function for single numbers."""
    value, rate, bend = segment[1] + segment[2] * tau, segment[2] + 0.0 * tau, 0.0 * tau
    for k in SINES:
        amplitude, sweep = segment[k], segment[k + 3]
        turning = segment[k + 2] + sweep * tau
        angle = segment[k + 1] + tau * (segment[k + 2] + 0.5 * sweep * tau)
        sine, cosine = np.sin(angle), np.cos(angle)
        value = value + amplitude * sine
        rate = rate + amplitude * turning * cosine
        bend = bend + amplitude * (sweep * cosine - turning * turning * sine)
    return value, rate, bend


def loads_N(constant_N: Array, drive: Drive | None, time_s: Array) -> Array:
    """Loads on all bodies with the force of a drive. Shape (times, bodies), or (bodies,) without such a force."""
    if drive is None or drive.prescribed:
        return constant_N
    loads = np.tile(constant_N, (len(time_s), 1))
    loads[:, drive.body] += drive.at(time_s)[0]
    return loads


def hertz_force(stiffness: Array, overlap_m: Array) -> Array:
    """``F = k overlap^(3/2)`` for positive overlaps, else 0."""
    closed = np.maximum(overlap_m, 0.0)
    force = np.asarray(stiffness * closed)
    force *= np.sqrt(closed)  # in place: a new array of a long chain costs more than the product
    return force


def dissipative_force(
    damping: Array, alpha: float, overlap_power: float, overlap_m: Array, closing_m_s: Array
) -> Array:
    """Dissipative force of a contact, to be added to the Hertz force (the sum is then limited to 0 and above).

    It is ``C d^p d'`` without alpha, and ``gamma sgn(d') |d'|^alpha`` for d >= 0 with alpha (Carretero-Gonzalez
    et al., Phys. Rev. Lett. 102, 024102, 2009); ``damping`` is C or gamma in N (s/m)^alpha. The force of the power law
    jumps when a contact closes; at that instant (d = 0, d' > 0) the result is the value after the jump.
    """
    if not alpha:
        root = np.sqrt(np.maximum(overlap_m, 0.0))  # of which numpy takes the powers 1/2 and 1 at once
        return np.asarray(damping * root ** (2 * overlap_power) * closing_m_s)
    power = np.sign(closing_m_s) * np.abs(closing_m_s) ** alpha
    return np.asarray(np.where(overlap_m >= 0.0, damping * power, 0.0))


def contact_force(chain: HertzChain, overlap_m: Array, velocity_m_s: Array) -> Array:
    """Contact forces from overlaps and velocities of shape (..., bodies).

    With the power law a sample at the instant of closing has the force after the jump.
    """
    elastic = hertz_force(chain.stiffness, overlap_m)
    if chain.elastic:
        return elastic
    closing = np.concatenate([np.zeros_like(velocity_m_s[..., :1]), velocity_m_s[..., :-1]], axis=-1) - velocity_m_s
    law = chain.damping, chain.alpha, chain.overlap_power
    return np.asarray(np.maximum(elastic + dissipative_force(*law, overlap_m, closing), 0.0))


def hertz_energy(stiffness: Any, overlap_m: Array) -> Array:
    """Elastic energy ``E = (2/5) k d^(5/2)`` for an overlap of 0 or more, in J."""
    return np.asarray(ENERGY_SHARE * stiffness * overlap_m**2 * overlap_m**0.5)  # a tenth of the time of a power of 5/2


def hertz_energy_beyond_tangent(stiffness: Array, overlap_m: Array, change_m: Array) -> Array:
    """Change of the elastic energy less its linear part, ``E(d + x) - E(d) - F(d) x``, in J; zero for open contacts.

    For d > 0 it is ``E(d) y^2 (15/2 + 10 y + 5 y^2 + y^3)`` with ``y = sqrt(1 + x/d) - 1``, without cancellation; for
    x < -d, where the contact is open, y is -1 and ``-F(d) (x + d)`` is added.

    Args:
        stiffness: k of each contact. Shape (contacts,).
        overlap_m: overlaps d; a gap is negative. Shape (contacts,).
        change_m: changes x of the overlaps. Shape (..., contacts).
    """
    pressed = overlap_m > 0
    if not pressed.any():  # of a long chain half the time
        return hertz_energy(stiffness, np.maximum(overlap_m + change_m, 0.0))
    start = np.where(pressed, overlap_m, 1.0)
    ratio = np.maximum(change_m / start, -1.0)
    y = ratio / (np.sqrt(1 + ratio) + 1)
    energy = hertz_energy(stiffness, start) * y**2 * (7.5 + y * (10 + y * (5 + y)))
    energy -= hertz_force(stiffness, start) * np.minimum(change_m + start, 0.0)
    loose = ~pressed
    overlap = np.maximum(overlap_m[loose] + change_m[..., loose], 0.0)
    energy[..., loose] = hertz_energy(stiffness[loose], overlap)
    return np.asarray(energy)


def columns_of_sums(chain: HertzChain, *, energies: bool) -> int:
    """Number of integrals besides the motion: work and impulse of a drive; with ``energies`` two more a body."""
    return 2 * (chain.drive is not None or energies) + 2 * energies * chain.mass_kg.size


def motion_of(
    chain: HertzChain, time_s: Array, force_N: Array, overlap_m: Array, velocity_m_s: Array, sums: Array
) -> Motion:
    """Motion from overlaps, ``overlap_j = start_j + u_{j-1} - u_j``, with the integrals of the kernels.

    Integrated are, with the speed v and the net force N of contacts and constant load of the driven body, ``f v`` and
    ``f`` of a force f, or ``-N u'`` and ``-N`` of a displacement u, whose actuator has the force ``m u'' - N``; the
    power dissipated in each contact, ``(F - k d^(3/2)) d'``; and ``(F(0) - F) v`` of each body, with the elastic force
    F(0) at time 0.

    Args:
        chain: The chain.
        time_s: Sample times. Shape (samples,).
        force_N: Forces. Shape (samples, bodies).
        overlap_m: Overlaps. Shape (samples, bodies).
        velocity_m_s: Velocities. Shape (samples, bodies).
        sums: Integrals as ``columns_of_sums`` counts them. Shape (samples, columns).
    """
    n, drive = chain.mass_kg.size, chain.drive
    more: dict[str, Array] = {}
    if drive is not None:
        work, impulse = sums[:, 0], sums[:, 1]
        if drive.prescribed:
            mass, rate = chain.mass_kg[drive.body], drive.at(time_s)[1]
            work, impulse = work + 0.5 * mass * (rate**2 - rate[0] ** 2), impulse + mass * (rate - rate[0])
        more = {"drive_work_J": work, "drive_impulse_N_s": impulse}
    if sums.shape[1] > 2:
        more |= {"dissipated_J": sums[:, 2 : 2 + n], "passed_J": sums[:, 2 + n :]}
    moved = np.asarray(chain.overlap_m - overlap_m)
    return Motion(force_N, np.cumsum(moved, axis=-1, out=moved), velocity_m_s, **more)
