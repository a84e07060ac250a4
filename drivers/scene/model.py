"""Model of a scene file: frozen, validated, in SI units.

Beads are counted from the wall, as in the paper: bead 1 rests on the wall.
"""

import re
from math import cos, isfinite, radians
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    ValidationInfo,
    WithJsonSchema,
    computed_field,
)
from pydantic.json_schema import SkipJsonSchema
from pydantic_core import PydanticCustomError

from drivers.base import units
from drivers.base.errors import CONTROL
from drivers.laws import ALPHA, ELASTIC, LAWS, Dissipation

RIGID = "rigid"
MAX_BEADS = 1_000_000
RANGE = re.compile(r" *([0-9]{1,9}) *(?:- *([0-9]{1,9}) *)?")  # of beads

Name = Annotated[str, Field(pattern=r"^[A-Za-z][A-Za-z0-9_-]*$", max_length=60)]


def _plain_text(value: str) -> str:
    if CONTROL.search(value):
        raise ValueError("text without control characters")
    return value


Title = Annotated[str, AfterValidator(_plain_text)]
Text = Annotated[str, Field(min_length=1, max_length=1000), AfterValidator(_plain_text)]


class Part(BaseModel):
    """Table of the scene file: frozen, strict, no unknown keys."""

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True, allow_inf_nan=False)


def places_of(from_wall: object) -> list[int]:
    """Beads of a ``from_wall``: one number, a range such as ``"5-9"``, or a list of both.

    Raises:
        ValueError: anything else, or a bead that no chain has.
    """
    if isinstance(from_wall, list | tuple) and from_wall:
        return [place for entry in from_wall for place in places_of(entry)]
    if type(from_wall) in (int, str) and (ends := RANGE.fullmatch(str(from_wall))):
        first, last = int(ends[1]), int(ends[2] or ends[1])
        if 1 <= first <= last <= MAX_BEADS:
            return [*range(first, last + 1)]
    raise ValueError(f'a bead such as 5, a range such as "5-9", up to {MAX_BEADS}, or a list of them')


def _with_places(from_wall: Any) -> Any:
    places_of(from_wall)
    return tuple(from_wall) if isinstance(from_wall, list) else from_wall


Places = Annotated[
    Any,
    AfterValidator(_with_places),
    WithJsonSchema({"type": "integer", "minimum": 1, "maximum": MAX_BEADS}),
    Field(description='bead, "5-9", or list'),
]


def _from_record(value: Any, info: ValidationInfo) -> Any:
    """Refuse a key in a file: it is derived by the reader, and in the records of runs."""
    if info.context != units.SI:
        raise PydanticCustomError("extra_forbidden", "unknown key")
    return value


FromRecord = BeforeValidator(_from_record)
Points = SkipJsonSchema[Annotated[tuple[float, ...], Field(strict=False), FromRecord]]

Friction = Annotated[float, Field(ge=0, le=100)]


def _accuracy(value: object) -> object:
    numbers = value.values() if isinstance(value, dict) and value else [value]
    if not all(isinstance(number, float) and 0 < number < 1 for number in numbers):
        raise ValueError(
            "an error above 0 and below 1, such as 1e-4 for the force, or { wall_peak = 1e-3 } for an observable"
        )
    return value


Accuracy = Annotated[float | dict[str, float], BeforeValidator(_accuracy)]


def _number_with_unit(value: Any) -> Any:
    plain = type(value) in (int, float) and isfinite(value)
    if not plain and not (isinstance(value, str) and units.NUMBER_AND_UNIT.fullmatch(value)):
        raise ValueError('a number with its unit, such as "2.1 N/V", or a plain number without a unit')
    return value


NumberWithUnit = Annotated[str | float, BeforeValidator(_number_with_unit)]  # postproc converts it to SI units
Positive = Annotated[float, Field(gt=0)]


class Material(Part):
    """Elastic constants of a material."""

    youngs_modulus: units.Modulus = Field(description="Young's modulus")
    poisson_ratio: float = Field(ge=0, lt=0.5, description="Poisson's ratio")
    density: units.Density | None = Field(default=None, description="density, for bodies without a mass")
    source: str | None = Field(default=None, description="origin of the constants")

    @property
    def compliance(self) -> float:
        """Contribution of the material to ``1/E*``, ``(1 - nu^2) / E``, in 1/Pa."""
        return float((1 - self.poisson_ratio**2) / self.youngs_modulus)


RIGID_MATERIAL = Material.model_construct(youngs_modulus=1e40, poisson_ratio=0.0)  # its part of 1/E* is below rounding


class Sensor(Part):
    """Beads with a force gauge; the default of ``mass`` is the mass of the other beads."""

    from_wall: Places
    mass: units.Mass | None = Field(default=None, description="mass of the bead with its gauge")


class Bead(Part):
    """Properties of beads that differ from the others; ``gap_below`` also raises all bodies above the bead."""

    from_wall: Places
    diameter: units.Length | None = Field(default=None, description="diameter")
    mass: units.Mass | None = Field(default=None, description="mass")
    material: Name | None = Field(default=None, description="material")
    gap_below: units.Gap | None = Field(default=None, description="gap below, at time 0")
    velocity: units.Velocity | None = Field(default=None, description="initial velocity, upwards positive")
    lateral_velocity: units.Velocity | None = Field(default=None, description="initial velocity across the axis")


class Member(Part):
    """Bead of a pattern; the defaults of its properties are those of the chain."""

    material: Name | None = Field(default=None, description="material")
    diameter: units.Length | None = Field(default=None, description="diameter")
    mass: units.Mass | None = Field(default=None, description="mass")


class ChainTable(Part):
    """Beads of the chain.

    A ``pattern`` is repeated from the wall. A mass given for the chain or for a member is that of a bead of its full
    diameter: tapered beads have its density.
    """

    count: int = Field(ge=0, le=MAX_BEADS, description="number of beads; 0: striker on wall")
    material: Name = Field(description="material of the beads")
    diameter: units.Length = Field(description="diameter of the beads")
    mass: units.Mass | None = Field(default=None, description="mass of a bead; else by density")
    pattern: tuple[Member, ...] | None = Field(default=None, strict=False, description="beads that differ in turn")
    taper: float | None = Field(default=None, ge=0.01, le=10, description="diameter divided by that of the bead below")
    taper_to: units.Length | None = Field(default=None, description="diameter of the top bead; linear")
    angle: units.Angle | None = Field(default=None, description="angle of the axis to the vertical")
    sensors: tuple[Sensor, ...] = Field(default=(), strict=False, description="beads with a gauge")
    bead: tuple[Bead, ...] = Field(default=(), strict=False, description="single beads that differ")
    precompression: units.Force = Field(default=0.0, description="downward force on the top bead")
    mass_scatter: units.MassSpread = Field(default=0.0, description="standard deviation of masses")
    lateral_offset: units.Gap | None = Field(default=None, description="standard deviation across the axis")
    origin: units.Height = Field(default=0.0, description="height of the lower end")

    @property
    def sensor_at(self) -> dict[int, Sensor]:
        """Entry of each bead with a gauge, by its number from the wall."""
        return {place: sensor for sensor in self.sensors for place in places_of(sensor.from_wall)}

    @property
    def bead_at(self) -> dict[int, Bead]:
        """Entry of each bead that differs, by its number from the wall."""
        return {place: bead for bead in self.bead for place in places_of(bead.from_wall)}

    @property
    def members(self) -> tuple[Member, ...]:
        """Members of the pattern; without a pattern, one with the properties of the chain."""
        return self.pattern or (Member(),)

    def taper_at(self, from_wall: Any) -> Any:
        """Diameter of a bead, or of an array of beads, divided by that of its member without taper."""
        if self.taper is not None:
            return self.taper ** (from_wall - 1.0)
        if self.taper_to is not None:
            return 1.0 + (self.taper_to / self.diameter - 1.0) * (from_wall - 1.0) / max(self.count - 1, 1)
        return 0.0 * from_wall + 1.0


class Striker(Part):
    """Striker: touches the top bead at time 0 and moves down with ``speed``."""

    shape: Literal["sphere", "flat"] = Field(default="sphere", description="flat: plane face, no diameter")
    material: Name = Field(description="material")
    diameter: units.Length | None = Field(default=None, description="diameter of the sphere")
    mass: units.Mass | None = Field(default=None, description="mass; else by density")
    speed: units.Speed = Field(description="impact speed, downwards")


class Wall(Part):
    """Flat half-space below bead 1; the material ``rigid`` is not deformed."""

    material: Name = Field(description='any material, or "rigid"')


class Tube(Part):
    """Tube around the chain, modelled only if beads can move sideways."""

    inner_diameter: units.Length = Field(description="diameter of the bore")
    material: Name = Field(description="material")
    friction: Friction = Field(default=0.0, description="friction of beads on the bore")
    top: units.Height | None = Field(default=None, description="height of the upper end; else above all bodies")


class Contact(Part):
    """Friction of contacts, and their law of dissipation (``drivers.laws``) with its keys; elastic by default."""

    dissipation: Literal["hunt-crossley", "kuwabara-kono", "power", "viscoelastic"] = Field(
        default="viscoelastic", description="law of dissipation"
    )
    friction: Friction = Field(default=0.0, description="friction of beads, wall and striker")
    rotation: bool = Field(default=True, description="false: beads do not spin")
    slowness: units.Slowness | None = Field(default=None, description="a of hunt-crossley")
    relaxation: units.Duration | None = Field(default=None, description="A of kuwabara-kono")
    gamma: float | None = Field(default=None, ge=0, description="coefficient in N (s/m)^alpha")
    alpha: float | None = Field(default=None, ge=1, le=3, description=f"exponent of the speed; else {ALPHA}")
    # about equivalent limits; with stronger damping bodies stick together
    restitution: float | None = Field(default=None, ge=1e-4, le=1, description="restitution of an impact")
    damping_ratio: float | None = Field(default=None, ge=0, le=50, description="damping ratio B")

    @property
    def law(self) -> Dissipation:
        """Law of dissipation; elastic with a value of 0."""
        general = {"dissipation", "friction", "rotation"}
        law = LAWS[self.dissipation](**self.model_dump(exclude=general, exclude_none=True))
        return law if law.value else ELASTIC


class DriveTable(Part):
    """Drive of one body by a force or, as by a piezo, by its displacement; both are upwards positive.

    The amplitude is ``force`` or ``displacement``; ``drivers.chain.drives`` defines the wave forms. Times in a file
    count from ``start``; runs depend on its points, at least two times and either forces or displacements, not on its
    name.
    """

    form: Literal["sine", "half-sine", "step", "ramp", "chirp", "file"] = Field(description="wave form")
    force: units.SignedForce | None = Field(default=None, description="amplitude, upwards positive")
    displacement: units.Displacement | None = Field(default=None, description="amplitude, upwards positive")
    from_wall: int | None = Field(default=None, ge=1, le=MAX_BEADS, description="driven bead; else striker or top bead")
    start: units.StartTime = Field(default=0.0, description="beginning")
    duration: units.Duration | None = Field(default=None, description="duration of the wave form")
    frequency: units.Frequency | None = Field(default=None, description="frequency, of a chirp at its start")
    end_frequency: units.Frequency | None = Field(default=None, description="frequency of a chirp at its end")
    cycles: float | None = Field(default=None, ge=1e-9, le=1e9, description="periods of a sine")
    window: Literal["none", "hann"] | None = Field(default=None, description="envelope")
    file: Text | None = Field(default=None, exclude=True, description="CSV file, such as time_us,force_mN")
    time_s: Points = ()
    force_N: Points = ()
    displacement_m: Points = ()

    @property
    def prescribed(self) -> bool:
        """True if the displacement of the body is given."""
        return self.displacement is not None or bool(self.displacement_m)


class Gauge(Part):
    """Electronics of all gauges, including the wall gauge: a first-order high-pass, in post-processing only."""

    time_constant: units.Duration = Field(description="high-pass behind all gauges")


class Run(Part):
    """Duration, sampling, time step or accuracy, and recorded quantities."""

    duration: units.Duration = Field(description="duration")
    sample_interval: units.Duration = Field(description="time between samples")
    time_step: units.Duration | None = Field(default=None, description="time step; divides the sample interval")
    accuracy: Accuracy | None = Field(default=None, description="allowed error of force or observables")
    record: tuple[Literal["forces", "state"], ...] = Field(
        default=("forces",), strict=False, description="state: positions and velocities"
    )


class MeasuredEntry(Part):
    """Measured trace in a file, or quoted ``values``, for comparison with computed results.

    Decks, runs and run records do not depend on it. Gauges with different ``gain`` need separate entries.
    """

    file: Text | None = Field(default=None, description="CSV file with headings")
    time: Text | None = Field(default=None, description="heading of the time column")
    gauges: dict[Name, Text] | None = Field(default=None, min_length=1, description="heading by gauge")
    time_unit: Text | None = Field(default=None, description="unit of time; else from file")
    unit: Text | None = Field(default=None, description="unit of readings; else from file")
    gain: NumberWithUnit | None = Field(default=None, description="force per reading, or reading per force")
    gain_uncertainty: float = Field(default=0.0, ge=0, lt=1, description="relative standard error")
    trigger: units.Instant | None = Field(default=None, description="time of the impact; else by alignment")
    baseline: NumberWithUnit | None = Field(default=None, description="reading at rest; else from quiet samples")
    drift: bool = Field(default=False, description="true: straight baseline")
    noise: NumberWithUnit | None = Field(default=None, description="standard deviation of a reading")
    values: dict[Text, NumberWithUnit] | None = Field(
        default=None, min_length=1, description="quoted numbers by observable"
    )
    errors: dict[Text, Positive] | None = Field(default=None, description="relative standard errors")
    source: str | None = Field(default=None, description="origin of the data")


class Scene(Part):
    """Contents of a scene file; when it is read, they are complete.

    ``materials`` then holds all materials in use, and ``run.time_step`` divides the sample interval. With
    ``run.accuracy``, the time step equals the sample interval until the step is planned. ``file``, ``folder`` and
    ``measured`` are not part of the physics.

    Attributes:
        name: name of the scene file without the suffix.
        file: scene file as named in messages.
        folder: folder of the scene file; paths in the scene file are relative to this folder.
    """

    title: Title = Field(default="", description="title")
    gravity: units.Acceleration = Field(default=0.0, description="gravity, downwards")
    seed: int = Field(default=0, ge=0, lt=2**63, description="seed of random masses and offsets")
    chain: ChainTable = Field(description="beads")
    striker: Striker | None = Field(default=None, description="body that strikes the top bead")
    wall: Wall | None = Field(default=None, description="half-space below bead 1")
    tube: Tube | None = Field(default=None, description="bore around the beads")
    contact: Contact = Field(default=Contact(), description="friction and dissipation")
    drive: DriveTable | None = Field(default=None, description="driven body")
    sensor: Gauge | None = Field(default=None, description="electronics of gauges")
    materials: dict[Name, Material] = Field(default_factory=dict, description="materials of this scene")
    run: Run = Field(description="duration, sampling, time step")
    measured: tuple[MeasuredEntry, ...] = Field(
        default=(), strict=False, exclude=True, description="measured data"
    )  # runs do not depend on it
    name: SkipJsonSchema[Annotated[str, FromRecord]] = ""
    file: SkipJsonSchema[Annotated[str, FromRecord]] = Field(default="", exclude=True)
    folder: SkipJsonSchema[Annotated[Path, FromRecord]] = Field(default=Path(), exclude=True)

    @computed_field  # type: ignore[prop-decorator]  # as pydantic advises for mypy
    @property
    def steps_per_sample(self) -> int:
        """Time steps per sample interval; 1 without a time step."""
        run = self.run
        return 1 if run.time_step is None else max(1, round(run.sample_interval / run.time_step))

    @computed_field  # type: ignore[prop-decorator]  # as pydantic advises for mypy
    @property
    def samples(self) -> int:
        """Number of samples, including the sample at time 0."""
        return int(self.run.duration / self.run.sample_interval * (1 + 1e-12) + 1e-9) + 1

    @property
    def time_step_s(self) -> float:
        """Time step in s; the sample interval until a step is planned for an accuracy."""
        return self.run.time_step or self.run.sample_interval

    @property
    def steps(self) -> int:
        """Number of time steps from time 0 to the last sample."""
        return self.steps_per_sample * (self.samples - 1)

    @property
    def bodies(self) -> int:
        """Number of beads, plus one for the striker if present."""
        return self.chain.count + (self.striker is not None)

    @property
    def axial_gravity(self) -> float:
        """Acceleration of gravity along the axis in m/s^2; none in a horizontal chain."""
        angle_deg = self.chain.angle or 0.0
        return self.gravity * (cos(radians(angle_deg)) if angle_deg < 90 else 0.0)

    @property
    def three_dimensional(self) -> bool:
        """True if beads can move sideways and turn."""
        return self.chain.lateral_offset is not None or any(bead.lateral_velocity for bead in self.chain.bead)

    def material(self, name: str) -> Material:
        """Material of the scene, or of the rigid wall."""
        return RIGID_MATERIAL if name == RIGID else self.materials[name]
