"""Chain: a scene as arrays of masses, radii, contact stiffnesses, overlaps and start values.

Bodies are the beads 1 to n from the wall upwards, then the striker. Contact j is below body j, so all arrays have one
entry for each body. A missing contact (below bead 1 of a free chain) has stiffness 0. Contacts are elastic by Hertz's
law, of which the functions of overlap and force accept one contact or arrays of contacts; ``drivers.laws`` adds to it.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields
from functools import cache, cached_property, lru_cache
from itertools import pairwise
from math import inf, pi, sqrt
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from drivers.base.errors import InputError
from drivers.chain.drives import drive_of
from drivers.laws import Dissipation
from drivers.scene.model import Material, Member, Scene
from validation.reference.hertz_chain import ENERGY_SHARE, EXPONENT, Drive, HertzChain, TubeChain

Array = NDArray[np.float64]
LEVEL_M = 10.0  # radius of a sphere that replaces a flat face; its slope is 1e-5 at 0.1 mm off the axis
AT_REST = 1e-9  # largest unbalanced force on a bead at rest, divided by the total load
Value = TypeVar("Value", float, Array)  # stiffnesses of type Any are also floats or Arrays
Beads = tuple[list[str], Array, Array]  # material, diameter in m and mass in kg of each bead
# k or k_t of a contact, from material and radius of both bodies
ContactStiffness = Callable[[Material, float, Material, float], float]


def hertz_stiffness(first: Material, radius_1_m: float, second: Material, radius_2_m: float) -> float:
    """Hertz stiffness k in F = k overlap^(3/2), in N m^-3/2.

    ``k = (4/3) E* sqrt(R*)`` with ``1/E* = (1-nu1^2)/E1 + (1-nu2^2)/E2`` and ``1/R* = 1/R1 + 1/R2``, the general
    form of the paper's Eq. (7). A radius of inf is a flat face.
    """
    curvature = 1 / radius_1_m + 1 / radius_2_m
    return 4 / 3 / (first.compliance + second.compliance) / sqrt(curvature)


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


@dataclass(frozen=True, eq=False)  # compared by identity, for caches
class Chain:
    """Parameters and start values of a chain, in SI units; read-only arrays of shape (bodies,).

    In a three-dimensional chain overlaps are along the lines of centres; heights, velocities and forces along the axis.
    In a straight one all quantities across the axis and of friction are zero, without a tube those of the bore.

    Attributes:
        materials: name of each body's material.
        mass_kg: masses.
        radius_m: radii; inf for a flat striker.
        stiffness: k of each contact in F = k overlap^(3/2), N m^-3/2.
        overlap_m: overlaps at time 0; a gap is negative.
        velocity_m_s: velocities at time 0, upwards positive.
        load_N: constant force on each body, weight and precompression, upwards positive.
        beads: number of beads.
        wall: material of the wall; None for a free chain.
        wall_height_m: height of the wall, or of bead 1's lowest point in a free chain.
        law: law of dissipation.
        drive: force of time on a body, or its motion; its velocity at time 0 is that of the drive. None: no drive.
        across_m: positions of the centres across the axis at time 0. Shape (bodies, 2).
        across_velocity_m_s: velocities across the axis at time 0. Shape (bodies, 2).
        shear_stiffness: k_t of each contact: a shear ds adds ``k_t sqrt(overlap) ds`` to the tangential force.
        straight: True if the bodies move along the axis only.
        friction: coefficient between bodies and with the wall.
        turns: True if friction turns bodies.
        bore_m: radius of the tube's bore about the axis.
        bore_stiffness: k of each body's contact with the bore in F = k overlap^(3/2); 0 for bodies outside the tube.
        bore_shear: k_t of these contacts, as in ``shear_stiffness``.
        bore_friction: coefficient with the bore.
        top_m: height of the tube's upper end; inf for one above all bodies.
    """

    materials: tuple[str, ...]
    mass_kg: Array
    radius_m: Array
    stiffness: Array
    overlap_m: Array
    velocity_m_s: Array
    load_N: Array
    beads: int
    wall: str | None
    wall_height_m: float
    law: Dissipation
    drive: Drive | None
    across_m: Array
    across_velocity_m_s: Array
    shear_stiffness: Array
    bore_stiffness: Array
    bore_shear: Array
    straight: bool = True
    friction: float = 0.0
    turns: bool = False
    bore_m: float = 0.0
    bore_friction: float = 0.0
    top_m: float = inf

    @property
    def bodies(self) -> int:
        """Number of beads, plus one for the striker if present."""
        return len(self.mass_kg)

    @property
    def sphere_radius_m(self) -> Array:
        """Radius of each body; 0 for a flat striker. Shape (bodies,)."""
        return np.where(np.isinf(self.radius_m), 0.0, self.radius_m)

    @property
    def damped(self) -> bool:
        """True if contacts dissipate energy in impacts."""
        return self.law.value > 0

    @property
    def slips(self) -> bool:
        """True if contacts, between bodies or with wall or bore, have friction."""
        return max(self.friction, self.bore_friction) > 0

    @cached_property
    def guided(self) -> list[int]:
        """Indices of the bodies in the tube, from 0."""
        return [int(body) for body in np.flatnonzero(self.bore_stiffness)]

    @cached_property
    def height_m(self) -> Array:
        """Heights of the centres at time 0 (of a flat striker: its face). Shape (bodies,).

        Damped bodies that just touch start with a gap of a few rounding errors, since the dissipative force grows as
        a small power of the overlap. With the power law, closing bodies start with an overlap of that size, since they
        have a force.
        """
        radius = self.sphere_radius_m
        below = np.concatenate([[0.0], radius[:-1]])
        height = np.asarray(self.wall_height_m + np.cumsum((below + radius - self.overlap_m) * self.axial_share))
        if self.damped:
            touching = ((self.overlap_m == 0) & (self.stiffness > 0)).astype(int)
            apart = np.where((self.closing_m_s > 0) & (self.law.alpha > 0), -touching, touching)
            height = height + 4 * np.cumsum(apart) * np.spacing(np.abs(height).max())
        return height

    @property
    def place_m(self) -> Array:
        """Positions of the centres at time 0 (of a flat striker: its face). Shape (bodies, 3)."""
        return np.column_stack([self.across_m, self.height_m])

    @property
    def velocity_xyz_m_s(self) -> Array:
        """Velocities at time 0. Shape (bodies, 3)."""
        return np.column_stack([self.across_velocity_m_s, self.velocity_m_s])

    @cached_property
    def axial_share(self) -> Array:
        """Cosine of the angle between the axis and each line of centres; 1 in a straight chain. Shape (bodies,)."""
        across = np.zeros(self.bodies)
        across[1:] = np.hypot(*np.diff(self.across_m, axis=0).T)
        across[np.isinf(self.radius_m)] = 0.0  # a flat face stays level
        apart = self.radius_m + np.append(0.0, self.radius_m[:-1]) - self.overlap_m
        return np.asarray(np.sqrt(1 - (across / apart) ** 2))

    @cached_property
    def smaller_radius_m(self) -> Array:
        """Smaller radius of the two bodies at each contact. Shape (bodies,)."""
        return np.asarray(np.minimum(self.radius_m, np.append(np.inf, self.radius_m[:-1])))

    @property
    def closing_m_s(self) -> Array:
        """Closing speeds of the contacts along the axis at time 0. Shape (bodies,)."""
        return np.asarray(np.append(0.0, self.velocity_m_s[:-1]) - self.velocity_m_s)

    @cached_property
    def force_N(self) -> Array:
        """Contact forces along the axis at time 0; with the power law, just after contacts close. Shape (bodies,)."""
        elastic = self.elastic_N
        if not self.damped:
            return elastic
        lost = self.law.force(self.damping, self.overlap_m, self.closing_m_s)
        return np.asarray(np.maximum(elastic + lost * self.axial_share, 0.0))

    @cached_property
    def elastic_N(self) -> Array:
        """Elastic part of the contact forces along the axis at time 0. Shape (bodies,)."""
        return np.asarray(hertz_force(self.stiffness, np.maximum(self.overlap_m, 0.0)) * self.axial_share)

    @cached_property
    def reduced_mass_kg(self) -> Array:
        """``1 / (1/m1 + 1/m2)`` of the two bodies at each contact; at the wall the bead's mass. Shape (bodies,)."""
        inverse = 1 / self.mass_kg
        return np.asarray(1 / (inverse + np.append(0.0, inverse[:-1])))

    @cached_property
    def damping(self) -> Array:
        """Coefficient C of the dissipative force of each contact (``drivers.laws``). Shape (bodies,)."""
        return self.law.coefficient(self.stiffness, self.reduced_mass_kg)

    @cached_property
    def acceleration_m_s2(self) -> Array:
        """Accelerations at time 0 without a drive; exactly zero for beads in equilibrium. Shape (bodies,)."""
        above = np.append(self.force_N[1:], 0.0)
        net = self.force_N - above + self.load_N
        rounding = 1e-12 * (self.force_N + above + np.abs(self.load_N))
        if not self.straight:
            rounding = rounding + AT_REST * np.abs(self.load_N).sum()
        return np.asarray(np.where(np.abs(net) <= rounding, 0.0, net) / self.mass_kg)

    @property
    def resting_J(self) -> float:
        """Hertz energy of the contacts at time 0, in J."""
        return ENERGY_SHARE * float(self.elastic_N @ np.maximum(self.overlap_m, 0.0))


def ordinary_beads(scene: Scene) -> Beads:
    """Beads by the keys of the chain, its pattern and its taper, without ``[[chain.bead]]``, sensors and scatter."""
    table, members = scene.chain, scene.chain.members
    places, taper = np.arange(table.count) % len(members), table.taper_at(np.arange(1.0, table.count + 1))
    materials = [member.material or table.material for member in members]
    diameters = [member.diameter or table.diameter for member in members]
    masses = [bead_mass(scene, member) for member in members] if table.count else [0.0]
    sizes, weights = np.array(diameters)[places] * taper, np.array(masses)[places] * taper**3
    return [materials[place] for place in places.tolist()], sizes, weights


def beads_of(scene: Scene) -> Beads:
    """All beads of a scene.

    A mass given for one bead is used without scatter. Other beads have the mass of the chain or of their member in the
    pattern or, with a diameter or material of their own, the mass computed from the density; the scatter is added to
    these masses.
    """
    table, (materials, diameters, masses) = scene.chain, ordinary_beads(scene)
    given = {from_wall: sensor.mass for from_wall, sensor in table.sensor_at.items() if sensor.mass is not None}
    given |= {from_wall: bead.mass for from_wall, bead in table.bead_at.items() if bead.mass is not None}
    for from_wall, bead in table.bead_at.items():
        place = from_wall - 1
        materials[place] = bead.material or materials[place]
        diameters[place] = bead.diameter or diameters[place]
        if (bead.material is not None or bead.diameter is not None) and from_wall not in given:
            key = f"chain.bead.{table.bead.index(bead)}"
            masses[place] = sphere_mass(scene, key, materials[place], diameters[place])
    if table.mass_scatter:  # drawn for all beads, so that a mass given for one bead does not change other masses
        masses = masses + np.random.default_rng(scene.seed).normal(0.0, table.mass_scatter, table.count)
    for from_wall, mass in given.items():
        masses[from_wall - 1] = mass
    return materials, diameters, masses


def bead_mass(scene: Scene, member: Member) -> float:
    """Mass of a member of the pattern without taper, in kg."""
    table = scene.chain
    alike = member.material in (None, table.material) and member.diameter in (None, table.diameter)
    if given := member.mass or (table.mass if alike else None):
        return given
    key = f"chain.pattern.{table.pattern.index(member)}" if table.pattern else "chain"
    return sphere_mass(scene, key, member.material or table.material, member.diameter or table.diameter)


def sphere_mass(scene: Scene, key: str, material: str, diameter_m: float) -> float:
    """Mass of a sphere of a table of the scene from the density of its material, in kg.

    Raises:
        InputError: the material has no density.
    """
    density = scene.materials[material].density
    if density is None:
        raise InputError(scene.file, f"{key}.mass", f"missing key; give a mass, or a density in [materials.{material}]")
    return density * pi / 6 * diameter_m**3


def build_chain(scene: Scene) -> Chain:
    """Straight chain of a scene.

    Beads that rest on the wall start in static equilibrium: contact j carries the precompression and the weight
    of beads j to n. Beads above a gap, and beads of a free chain, start touching without force. The striker just
    touches the top bead; its weight is not part of the equilibrium.
    """
    table = scene.chain
    count, striker = table.count, scene.striker
    materials, diameter, mass = beads_of(scene)
    radius = diameter / 2
    velocity, across_velocity = np.zeros(scene.bodies), np.zeros((scene.bodies, 2))
    for from_wall, bead in table.bead_at.items():
        velocity[from_wall - 1] = bead.velocity or 0.0
        across_velocity[from_wall - 1, 0] = bead.lateral_velocity or 0.0
    gaps = {from_wall: bead.gap_below for from_wall, bead in table.bead_at.items() if bead.gap_below is not None}
    if striker is not None:
        materials = [*materials, striker.material]
        radius = np.append(radius, inf if striker.diameter is None else striker.diameter / 2)
        mass = np.append(mass, striker.mass or sphere_mass(scene, "striker", striker.material, 2 * radius[-1]))
        velocity[-1] = -striker.speed
    drive, zeros = drive_of(scene), np.zeros(scene.bodies)
    if drive is not None and drive.prescribed:
        velocity[drive.body] = drive.at(np.zeros(1))[1][0]
    stiffness = stiffness_by(hertz_stiffness, scene, materials, radius)
    load = -scene.axial_gravity * mass
    if count:
        load[count - 1] -= table.precompression
    overlap = _overlaps(stiffness, load[:count], gaps, resting=scene.wall is not None)
    return Chain(
        materials=tuple(materials),
        mass_kg=mass,
        radius_m=radius,
        stiffness=stiffness,
        overlap_m=overlap,
        velocity_m_s=velocity,
        load_N=load,
        beads=count,
        wall=scene.wall.material if scene.wall else None,
        wall_height_m=table.origin,
        law=scene.contact.law,
        drive=drive,
        across_m=np.zeros((scene.bodies, 2)),
        across_velocity_m_s=across_velocity,
        shear_stiffness=zeros,
        bore_stiffness=zeros,
        bore_shear=zeros,
    )


@lru_cache(maxsize=8)
def arrays_of(chain: Chain) -> HertzChain:
    """Straight chain as input of the integrators."""
    arrays = (chain.mass_kg, chain.stiffness, chain.overlap_m, chain.velocity_m_s, chain.load_N, chain.damping)
    return HertzChain(*arrays, chain.law.alpha, chain.law.overlap_power, chain.drive)


def tube_arrays_of(chain: Chain) -> TubeChain:
    """Three-dimensional chain as input of the integrators; the bore is a true cylinder."""
    own: dict[str, Any] = {
        "shear": chain.shear_stiffness,
        "velocity_m_s": chain.velocity_xyz_m_s,
        "wall_m": chain.wall_height_m,
    }
    alike = {field.name: getattr(chain, field.name) for field in fields(TubeChain) if field.name not in own}
    return TubeChain(**alike, **own)


def moving_at_start(chain: Chain) -> float:
    """Sum of the magnitudes of all momenta at time 0, in N s.

    The lower limit is the momentum of the total mass at a speed of one rounding error of heights per second.
    """
    moving = float(chain.mass_kg @ np.abs(chain.velocity_m_s))
    return max(moving, float(chain.mass_kg.sum() * np.spacing(np.abs(chain.height_m).max(initial=0.0))))


def furthest_m(chain: Chain) -> float:
    """Largest coordinate in a deck, in m; the rounding error of heights is proportional to it."""
    height = float(np.abs(chain.height_m).max())
    return height + LEVEL_M if not chain.straight and np.isinf(chain.radius_m[-1]) else height


def above_rim_m(radius_m: float, rim_m: float) -> float:
    """Height of a sphere's centre above the rim of a narrower tube that it touches, in m; 0 for a flat face."""
    return sqrt(radius_m**2 - rim_m**2) if rim_m < radius_m < inf else 0.0


def sphere_for_face(scene: Scene, chain: Chain) -> tuple[float, float]:
    """Radius and Young's modulus, in SI units, of a sphere with the same contact law as the striker's flat face.

    With ``1/E* = c_bead + c_face`` of the flat contact, the sphere's radius S and compliance c satisfy
    ``c_bead + c = sqrt(S / (S + R)) / E*``. c is positive for ``S > R c_bead / (2 c_face)``; S is about twice that,
    since larger spheres increase the rounding error of heights. If beads move sideways, S is at least ``LEVEL_M``.
    """
    bead, face = (scene.materials[name] for name in chain.materials[-2:])
    under = float(chain.radius_m[-2])
    radius = float(f"{under * bead.compliance / face.compliance:.1g}")
    if not chain.straight:
        radius = max(radius, LEVEL_M)
    compliance = (bead.compliance + face.compliance) * sqrt(radius / (radius + under)) - bead.compliance
    return radius, (1 - face.poisson_ratio**2) / compliance


def stiffness_by(law: ContactStiffness, scene: Scene, materials: Sequence[str], radius_m: Array) -> Array:
    """Stiffness of the contact below each body, from a contact law; 0 for a missing contact. Shape (bodies,)."""

    @cache  # a million beads have few kinds of contacts
    def between(below: str, radius_below_m: float, above: str, radius_above_m: float) -> float:
        return law(scene.material(below), radius_below_m, scene.materials[above], radius_above_m)

    bodies = [*zip(materials, radius_m.tolist(), strict=True)]
    lowest = between(scene.wall.material, inf, *bodies[0]) if scene.wall else 0.0
    return np.array([lowest, *(between(*below, *above) for below, above in pairwise(bodies))])


def _overlaps(stiffness: Array, bead_load_N: Array, gaps: dict[int, float], *, resting: bool) -> Array:
    """Overlaps at time 0: of the static equilibrium below the first gap, and 0 above it."""
    overlap = np.zeros(len(stiffness))
    first_free = min(gaps, default=len(bead_load_N) + 1) if resting else 1
    held = slice(0, first_free - 1)
    carried = -np.cumsum(bead_load_N[held][::-1])[::-1]  # load on each contact
    overlap[held] = hertz_overlap(stiffness[held], np.maximum(carried, 0.0))
    for place, gap in gaps.items():
        overlap[place - 1] = -gap
    return overlap
