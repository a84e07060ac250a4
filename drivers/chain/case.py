"""Case: a scene prepared for all engines, with its modelling elements. The rules here need the built chain.

Elements without any effect are left out. An exactly straight chain has no force across its axis, so its beads never
touch the tube, slip or turn.
"""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from math import inf, pi
from typing import Any

import numpy as np

from drivers.base.errors import InputProblem, refuse_any
from drivers.base.units import divided
from drivers.chain.chain import Array, Chain, above_rim_m, build_chain, moving_at_start, ordinary_beads
from drivers.chain.drives import drive_words, pieces_of
from drivers.laws import VISCOELASTIC
from drivers.scene.model import RIGID, Material, Scene
from validation.reference.adaptive import MIN_TOLERANCE

LEAST_DENSITY_KG_M3 = 1e-4  # of a bead, far below that of air; the motion of lighter ones takes for ever
PLAY_TOLERANCE = 1e-6  # relative; for rounding of the difference of two diameters
MAX_OVERLAP = 0.5  # at rest, divided by the radius; far beyond Hertz's law, and codes lose contacts at larger overlaps
# elements of straight chains, and further elements of three-dimensional chains
STRAIGHT = frozenset(
    {"gravity", "wall", "striker", "precompression", "sensor masses", "mass scatter", "damping", "drive"}
)
SIDEWAYS = frozenset({"lateral freedom", "tube", "friction", "rotation"})
NONE = "the scene has none"
ALL_DIGITS = 17  # significant digits of a double


@dataclass(frozen=True)
class ModellingElement:
    """Modelling element, modelled or left out, with the reason."""

    name: str
    modelled: bool
    reason: str


def choose_elements(scene: Scene, chain: Chain) -> tuple[ModellingElement, ...]:
    """Modelling elements of a scene, each modelled or left out, with the reason."""
    striker, scatter, pressed = scene.striker, scene.chain.mass_scatter, scene.chain.precompression
    sensors, (_, _, ordinary_kg) = scene.chain.sensor_at, ordinary_beads(scene)
    unlike = len([place for place, sensor in sensors.items() if sensor.mass not in (None, ordinary_kg[place - 1])])
    gravity, angle = f"{scene.axial_gravity:g} m/s^2", scene.chain.angle
    gravity += f" along the axis, which leans by {angle:g} deg" if angle else ""
    across = "horizontal: gravity acts across the axis, along which alone the beads of a straight chain move"
    wall = "rigid half-space" if chain.wall == RIGID else f"half-space of {chain.wall}"
    shape = "flat face" if striker and striker.shape == "flat" else "sphere"
    alike = "sensor beads weigh as much as the others" if sensors else "no bead carries a sensor"
    damped = chain.law.description
    if chain.law.name == VISCOELASTIC:
        damped += f", by a damping ratio of {chain.law.value:.6g}"
    axis = "the chain is exactly straight: no force acts across its axis, so no"
    freedom, still = "a bead moves across the axis", f"{axis} bead turns"
    slipping = f"coefficient {chain.friction:g} between beads and with the wall, {chain.bore_friction:g} in the bore"
    untouched = f"{axis} bead touches the bore" if scene.tube else NONE
    if not chain.straight:
        if scene.chain.lateral_offset is not None:
            freedom = f"beads off the axis by {scene.chain.lateral_offset:g} m, standard deviation, seed {scene.seed}"
        still = "rotation = false in the scene" if chain.slips else "without friction no bead turns"
    rows: tuple[tuple[str, Any, Any, str], ...] = (  # name, value, reason if modelled, reason if not
        ("gravity", scene.axial_gravity, gravity, across if scene.gravity else NONE),
        ("wall", chain.wall, f"{wall}, Hertz law with R* = R", "a free chain"),
        ("striker", striker, striker and f"{shape} of {striker.material} at {striker.speed:g} m/s", NONE),
        ("precompression", pressed, f"{pressed:g} N on the top bead", NONE),
        ("sensor masses", unlike, f"{unlike} of {len(sensors)} sensor beads are of another mass", alike),
        ("mass scatter", scatter, f"standard deviation {scatter:g} kg, seed {scene.seed}", NONE),
        ("lateral freedom", not chain.straight, freedom, f"{axis} bead leaves it"),
        ("tube", chain.bore_m, f"bore of {2 * chain.bore_m:g} m, a true cylinder", untouched),
        ("friction", chain.slips, slipping, f"{axis} contact slips" if chain.straight else NONE),
        ("rotation", chain.turns, "friction turns beads", still),
        ("damping", chain.damped, damped, "restitution 1: contacts are elastic"),
        ("drive", chain.drive, drive_words(scene), NONE),
    )
    return tuple(
        ModellingElement(name, bool(there), str(why if there else why_not)) for name, there, why, why_not in rows
    )


@dataclass(frozen=True)
class SensorBead:
    """Bead with a gauge, counted from the wall; ``height_m`` is the height at time 0."""

    from_wall: int
    height_m: float
    diameter_m: float


@dataclass(frozen=True)
class Layout:
    """Properties of a chain that post-processing needs; stored in the record of a run.

    Attributes:
        sensors: sensor beads from the top of the chain to the wall, in the order in which a wave passes them.
        wall: True if the chain has a wall.
        striker: True if the chain has a striker.
        load_N: sum of all weights and the precompression, upwards positive.
        moving_N_s: sum of the magnitudes of all momenta at time 0.
        damped: True if contacts dissipate energy in impacts.
        slips: True if contacts have friction.
        time_constant_s: time constant of the gauges' electronics; None if gauges show the force itself.
    """

    sensors: tuple[SensorBead, ...]
    wall: bool
    striker: bool
    load_N: float
    moving_N_s: float = 0.0
    damped: bool = False
    slips: bool = False
    time_constant_s: float | None = None


def read_layout(stored: dict[str, Any]) -> Layout:
    """Layout from a run record; keys missing in older records get their defaults."""
    sensors = tuple(SensorBead(**sensor) for sensor in stored["sensors"])
    return Layout(**(stored | {"sensors": sensors}))


@dataclass(frozen=True)
class StepPlan:
    """Time step planned for an accuracy; errors by quantity, as in ``validation.accuracy.motions``.

    Attributes:
        asked: largest errors allowed.
        predicted: errors of velocity Verlet at the chosen step in absolute heights, measured on this case.
        refused_steps: steps per sample at the smallest step that was too coarse; 0 if no step was too coarse.
    """

    asked: dict[str, float]
    predicted: dict[str, float]
    refused_steps: int


@dataclass(frozen=True, eq=False)
class Case:
    """Scene with its chain and modelling elements; input of decks and of the readers of raw output.

    Attributes:
        reference_tolerance: largest force error of the reference, divided by the largest force.
        plan: planned time step if the scene asks for an accuracy (``validation.accuracy.plan``).
        full: case with all elements of the scene, if elements are left out for the accuracy; else None.
        digits: significant digits of its output.
    """

    scene: Scene
    chain: Chain
    elements: tuple[ModellingElement, ...]
    reference_tolerance: float = MIN_TOLERANCE
    plan: StepPlan | None = None
    full: "Case | None" = None
    digits: int = ALL_DIGITS

    def at(self, steps_per_sample: int) -> "Case":
        """Case with another time step."""
        run = self.scene.run
        run = run.model_copy(update={"time_step": divided(run.sample_interval, steps_per_sample)})
        return replace(self, scene=self.scene.model_copy(update={"run": run}))

    def sampled_at_every(self, time_step_s: float) -> "Case":
        """Case with any time step and a sample at every step; the duration changes by less than a step."""
        samples = max(2, int(self.duration_s / time_step_s * (1 + 1e-12)) + 1)
        times = {"duration": (samples - 1) * time_step_s, "sample_interval": time_step_s, "time_step": time_step_s}
        run = self.scene.run.model_copy(update=times)
        return replace(self, scene=self.scene.model_copy(update={"run": run}), plan=None)

    @property
    def work(self) -> int:
        """Number of bodies times steps; the cost of a run is proportional to it."""
        return self.chain.bodies * self.scene.steps

    @property
    def duration_s(self) -> float:
        """Time of the last sample, in s."""
        return (self.scene.samples - 1) * (self.scene.steps_per_sample * self.scene.time_step_s)

    @property
    def sample_times_s(self) -> Array:
        """Sample times as multiples of the time step, in s. Shape (samples,)."""
        return np.arange(self.scene.samples, dtype=float) * (self.scene.steps_per_sample * self.scene.time_step_s)

    def materials_by(self, labels: Iterable[str]) -> dict[str, Material]:
        """Material by label of each body, and that of the wall by its own name."""
        wall = {self.chain.wall: self.chain.wall} if self.chain.wall else {}
        named = dict(zip(labels, self.chain.materials, strict=True)) | wall
        return {label: self.scene.material(name) for label, name in named.items()}

    @property
    def reasons(self) -> dict[str, str]:
        """Reasons of the elements that decks model, by name."""
        return {element.name: element.reason for element in self.elements if element.modelled}

    @property
    def drive_pieces(self) -> list[dict[str, Any]]:
        """Segments of the drive with at least one step of the run, as by ``pieces_of``."""
        return pieces_of(self.chain.drive, self.scene.time_step_s, self.scene.steps)

    @property
    def layout(self) -> Layout:
        """Properties of the chain that post-processing needs."""
        scene, chain = self.scene, self.chain
        places = sorted(scene.chain.sensor_at, reverse=True)
        heights, radii = chain.height_m, chain.radius_m
        return Layout(
            sensors=tuple(SensorBead(j, float(heights[j - 1]), float(2 * radii[j - 1])) for j in places),
            wall=chain.wall is not None,
            striker=scene.striker is not None,
            load_N=float(chain.load_N.sum()),
            moving_N_s=moving_at_start(chain),
            damped=chain.damped,
            slips=chain.slips,
            time_constant_s=scene.sensor.time_constant if scene.sensor else None,
        )

    @property
    def summary(self) -> str:
        """Description of the case for the head of a deck; without the scene's name, as equal decks share a run."""
        chain, reasons = self.chain, self.reasons
        beads = f"{chain.beads} bead{'s' if chain.beads != 1 else ''}"
        wall = "a rigid wall" if chain.wall == RIGID else f"a wall of {chain.wall}"
        text = f"{beads} on {wall}" if chain.wall else f"{beads} in a free chain"
        if "striker" in reasons:
            text += f", struck by a {reasons['striker']}"
        if self.scene.chain.angle:
            leaning = f"leaning by {self.scene.chain.angle:g} deg"
            text += f"; {leaning}: z is the axis, gravity along it {self.scene.axial_gravity:.4g} m/s^2"
        if "drive" in reasons:
            text += f"; {reasons['drive']}"
        if chain.damped:
            text += f"; {chain.law.description}"
        return text


def build_case(scene: Scene) -> Case:
    """Case of a scene; a time step for an accuracy is not planned here.

    Raises:
        InputError: a mass is missing, or a mass, a load or the tube is not allowed.
    """
    chain = build_chain(scene)
    refuse_any(scene.file, _impossible(scene, chain))
    if scene.three_dimensional:
        from drivers.chain.lateral import with_lateral  # imports scipy

        chain = with_lateral(scene, chain)
    return Case(scene, chain, choose_elements(scene, chain))


def _impossible(scene: Scene, chain: Chain) -> Iterator[InputProblem]:
    """Problems of the built chain: masses below zero or of no matter, large overlaps at rest, tubes that do not fit."""
    if (chain.mass_kg <= 0).any():
        place = int(np.argmin(chain.mass_kg)) + 1
        found = f"{scene.chain.mass_scatter:g} kg, with which the mass of bead {place} is not above zero"
        yield "chain.mass_scatter", found, "a smaller scatter"
    least_kg = LEAST_DENSITY_KG_M3 * 4 / 3 * pi * chain.radius_m**3
    for body in np.flatnonzero((chain.mass_kg > 0) & (chain.mass_kg < least_kg) & np.isfinite(least_kg))[:1].tolist():
        key = "striker.mass" if body == chain.beads else "chain.mass"
        yield key, f"{chain.mass_kg[body]:g} kg of body {body + 1}", f"at least {least_kg[body]:.2g} kg for its size"
    deepest = chain.overlap_m / chain.smaller_radius_m
    if (deepest > MAX_OVERLAP).any():
        contact = int(np.argmax(deepest)) + 1
        key = "chain.precompression" if scene.chain.precompression else "gravity"
        found = f"a load that makes an overlap of {chain.overlap_m[contact - 1]:g} m at contact {contact}"
        yield key, found, f"overlaps of at most {MAX_OVERLAP:g} of the radius"
    tube, offset, radius = scene.tube, scene.chain.lateral_offset, chain.radius_m
    if tube is None:
        return
    widest = 2 * radius[: chain.beads].max(initial=0.0)
    play = tube.inner_diameter - widest if chain.beads else inf
    if play < 0 or (play == 0 and scene.three_dimensional):
        yield "tube.inner_diameter", f"{tube.inner_diameter:g} m", f"more than the largest bead diameter, {widest:g} m"
        return
    if offset is not None and offset > (1 + PLAY_TOLERANCE) * play / 2:
        yield "chain.lateral_offset", f"{offset:g} m", f"at most the play of {play / 2:.4g} m"
    if not scene.three_dimensional:
        return
    height = chain.height_m
    yield from _passing(tube.inner_diameter / 2, chain)
    if tube.top is not None and height[chain.beads - 1] > tube.top:
        yield "tube.top", f"{tube.top:g} m", f"at least {height[chain.beads - 1]:.4g} m, the height of the top bead"
    if scene.striker is not None and radius[-1] >= tube.inner_diameter / 2:
        rim = height[-1] - above_rim_m(radius[-1], tube.inner_diameter / 2)
        if tube.top is None or tube.top > rim:
            most = f"at most {rim:.4g} m, as the striker is wider than the bore and starts above it"
            yield "tube.top", *((f"missing key; give {most}", "") if tube.top is None else (f"{tube.top:g} m", most))


def _passing(bore_radius_m: float, chain: Chain) -> Iterator[InputProblem]:
    """Problem of a tube in which a bead could pass a neighbour or touch its second neighbour."""
    radius = chain.radius_m[chain.radius_m < bore_radius_m]
    play = bore_radius_m - radius
    reach, across = radius[1:] + radius[:-1], play[1:] + play[:-1]
    apart = np.sqrt(np.maximum(reach**2 - across**2, 0.0))
    if (apart[1:] + apart[:-1] <= radius[2:] + radius[:-2]).any() or (across >= reach).any():
        allowed = "a tube so narrow that beads stay in line, each between its neighbours"
        yield "tube.inner_diameter", f"{2 * bore_radius_m:g} m", allowed
