"""The scene: what a physicist writes, read from TOML into a frozen, validated model in SI units.

``read_scene`` is the only reader of scenes and of ``inputs/materials.toml``. Beads are counted from
the wall, as in the paper: bead 1 rests on the wall.
"""

from math import isfinite
from pathlib import Path
from typing import Annotated, Final, Literal

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, StringConstraints

from drivers.base import units

MAX_BEADS = 1_000_000
RIGID = "rigid"
VISCOELASTIC: Final = "viscoelastic"
POWER: Final = "power"
LEAST_RESTITUTION, MAX_DAMPING_RATIO = 1e-4, 50.0  # about the same: beyond, bodies all but stick

Name = Annotated[str, StringConstraints(pattern=r"^[A-Za-z][A-Za-z0-9_-]*$", max_length=60)]
FromWall = Annotated[int, Field(ge=1, le=MAX_BEADS)]
PoissonRatio = Annotated[float, Field(ge=0, lt=0.5, allow_inf_nan=False)]
Friction = Annotated[float, Field(ge=0, le=100, allow_inf_nan=False)]


def _accuracy(value: object) -> object:
    numbers = value.values() if isinstance(value, dict) and value else [value]
    if not all(isinstance(each, int | float) and not isinstance(each, bool) and 0 < each < 1 for each in numbers):
        raise units.NotAllowedError(
            "an error above 0 and below 1, such as 1e-4 for the force, or { wall_peak = 1e-3 } for what gauges show"
        )
    return value


Accuracy = Annotated[float | dict[str, float], BeforeValidator(_accuracy)]


def _stated(value: object) -> object:
    plain = isinstance(value, int | float) and not isinstance(value, bool) and isfinite(value)
    if not plain and not (isinstance(value, str) and units.NUMBER_AND_UNIT.fullmatch(value)):
        raise units.NotAllowedError('a number with its unit, such as "2.1 N/V", or a plain number where there is none')
    return value


Stated = Annotated[str | float, BeforeValidator(_stated)]  # its unit is that of something in a file, and read there
Share = Annotated[float, Field(ge=0, lt=1)]
Text = Annotated[str, StringConstraints(min_length=1, max_length=1000)]


class Part(BaseModel):
    """A table of the scene file: frozen, strict, no unknown keys."""

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True)


class Material(Part):
    """Elastic constants; ``density`` serves only where a mass is left out."""

    youngs_modulus: units.Modulus
    poisson_ratio: PoissonRatio
    density: units.Density | None = None
    source: str | None = None

    @property
    def compliance(self) -> float:
        """``(1 - nu^2) / E``, its share of ``1/E*``, in 1/Pa."""
        return float((1 - self.poisson_ratio**2) / self.youngs_modulus)


class Sensor(Part):
    """A bead that carries a force gauge; ``mass`` left out: the bead's own."""

    from_wall: FromWall
    mass: units.Mass | None = None


class Bead(Part):
    """What is particular about one bead.

    ``gap_below`` takes the bead, and those above it, off what lies beneath; ``velocity`` is positive upwards,
    ``lateral_velocity`` points across the axis.
    """

    from_wall: FromWall
    diameter: units.Length | None = None
    mass: units.Mass | None = None
    material: Name | None = None
    gap_below: units.Gap | None = None
    velocity: units.Velocity | None = None
    lateral_velocity: units.Velocity | None = None


class Chain(Part):
    """The beads."""

    count: Annotated[int, Field(ge=0, le=MAX_BEADS)]
    material: Name
    diameter: units.Length
    mass: units.Mass | None = None
    sensors: tuple[Sensor, ...] = Field(default=(), strict=False)
    bead: tuple[Bead, ...] = Field(default=(), strict=False)
    precompression: units.Force = 0.0
    mass_scatter: units.MassSpread = 0.0
    lateral_offset: units.Gap | None = None
    origin: units.Height = 0.0


class Striker(Part):
    """What strikes the top bead, just touching it at time 0 and moving down with ``speed``."""

    shape: Literal["sphere", "flat"] = "sphere"
    material: Name
    diameter: units.Length | None = None
    mass: units.Mass | None = None
    speed: units.Speed


class Wall(Part):
    """A flat half-space below bead 1; the material ``rigid`` does not yield at all."""

    material: Name


class Tube(Part):
    """The apparatus; whether a deck models it is decided by what the scene requires.

    ``top`` is where it ends; with ``sides`` it is a mesh of so many flat sides instead of a cylinder.
    """

    inner_diameter: units.Length
    material: Name
    friction: Friction = 0.0
    top: units.Height | None = None
    sides: Annotated[int, Field(ge=3, le=1000)] | None = None


class Contact(Part):
    """What contacts do beyond Hertz's law.

    They are elastic unless one of ``restitution``, that of an impact, and ``damping_ratio``, B of
    ``drivers.chain.contact_law``, is given; with a ``dissipation`` of "power" it is ``gamma``, in N (s/m)^alpha, and
    may be ``alpha``, 1.75 if left out. Without ``rotation`` friction turns no bead: to see what turning does.
    """

    dissipation: Literal["viscoelastic", "power"] = VISCOELASTIC
    restitution: Annotated[float, Field(ge=LEAST_RESTITUTION, le=1, allow_inf_nan=False)] | None = None
    damping_ratio: Annotated[float, Field(ge=0, le=MAX_DAMPING_RATIO)] | None = None
    gamma: Annotated[float, Field(ge=0, allow_inf_nan=False)] | None = None
    alpha: Annotated[float, Field(ge=1, le=3)] | None = None
    friction: Friction = 0.0
    rotation: bool = True

    @property
    def elastic(self) -> "Contact":
        """The same without dissipation."""
        return Contact(friction=self.friction, rotation=self.rotation)


class Gauge(Part):
    """Electronics behind all gauges, the wall's included: a first-order high-pass, in post-processing only."""

    time_constant: units.Duration


class Run(Part):
    """How long, how fine, and what to keep."""

    duration: units.Duration
    sample_interval: units.Duration
    time_step: units.Duration | None = None
    accuracy: Accuracy | None = None
    record: tuple[Literal["forces", "state"], ...] = Field(default=("forces",), strict=False)


class Measured(Part):
    """A measured trace in a file, or ``values`` that somebody quotes, to be laid over what is computed.

    It is no part of the physics: no deck, run or record of a run knows of it. Where gauges read something else than a
    force, one entry holds the gauges of one ``gain``.

    Attributes:
        file: a table of comma-separated values with a row of headings; its path is seen from the scene file.
        time: heading of its column of time, with or without the unit; left out: ``time``.
        gauges: heading by gauge, such as ``wall``; left out: the columns named after gauges.
        time_unit, unit: of columns whose headings name no unit.
        gain: force per reading; left out: 1, of columns in a unit of force.
        gain_uncertainty: relative standard error of the gain.
        trigger: time in the file at which the striker meets the chain; left out: found by alignment.
        baseline: reading at rest; left out: found from quiet samples.
        drift: whether the baseline is a straight line through quiet samples.
        noise: standard deviation of a reading; left out: that of quiet samples.
        values: quoted numbers by observable, with or without the unit in its name.
        errors: relative standard error of each.
        source: where it comes from, in words.
    """

    file: Text | None = None
    time: Text | None = None
    gauges: dict[Name, Text] | None = None
    time_unit: Text | None = None
    unit: Text | None = None
    gain: Stated | None = None
    gain_uncertainty: Share = 0.0
    trigger: units.Instant | None = None
    baseline: Stated | None = None
    drift: bool = False
    noise: Stated | None = None
    values: dict[Text, Stated] | None = None
    errors: dict[Text, Annotated[float, Field(gt=0, allow_inf_nan=False)]] | None = None
    source: str | None = None


class SceneFile(Part):
    """A scene as its file holds it."""

    title: str = ""
    gravity: units.Acceleration = 0.0
    seed: Annotated[int, Field(ge=0, lt=2**63)] = 0
    chain: Chain
    striker: Striker | None = None
    wall: Wall | None = None
    tube: Tube | None = None
    contact: Contact = Contact()
    sensor: Gauge | None = None
    materials: dict[Name, Material] = Field(default_factory=dict)
    run: Run
    measured: tuple[Measured, ...] = Field(default=(), strict=False, exclude=True)  # so that no dump differs by it


class Scene(SceneFile):
    """A scene ready to be built: ``materials`` holds all that it names, ``run.time_step`` divides the interval.

    A scene that asks for an accuracy gets its time step when its case is planned, and has the interval until then.

    Attributes:
        name: the scene file's name without its ending.
        file: the scene file as messages name it; no part of the physics, no more than ``measured`` and ``folder``.
        folder: the scene file's, from which paths in it are seen.
        steps_per_sample: time steps from one sample to the next.
        samples: samples recorded, the one at time 0 included.
    """

    name: str
    file: str = Field(exclude=True)
    folder: Path = Field(default=Path(), exclude=True)
    steps_per_sample: int
    samples: int

    @property
    def time_step_s(self) -> float:
        """The time step in seconds."""
        assert self.run.time_step is not None  # read_scene admits no scene without
        return self.run.time_step

    @property
    def steps(self) -> int:
        """Time steps from time 0 to the last sample."""
        return self.steps_per_sample * (self.samples - 1)

    @property
    def bodies(self) -> int:
        """Beads, and the striker where there is one."""
        return self.chain.count + (self.striker is not None)

    @property
    def three_dimensional(self) -> bool:
        """Whether beads may move sideways and turn."""
        return self.chain.lateral_offset is not None or any(bead.lateral_velocity for bead in self.chain.bead)
