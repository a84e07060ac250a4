"""Model of a scene file: frozen, validated, in SI units.

Beads are counted from the wall, as in the paper: bead 1 rests on the wall.
"""

from math import cos, isfinite, radians
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from pydantic import BeforeValidator, Field, create_model

from drivers.base import units
from drivers.laws import LAWS
from drivers.laws.law import ContactLaw
from drivers.laws.viscoelastic import Viscoelastic
from drivers.scene.bead_entries import ByBead, InOneList, OfBead
from drivers.scene.drive_table import DriveTable, StoredDrive
from drivers.scene.part import MAX_BEADS, Name, Part, Text, Title

RIGID = "rigid"
RIGID_PA = 1e40  # modulus of a rigid wall in decks: its part of 1/E* is below rounding

PoissonRatio = Annotated[float, Field(ge=0, lt=0.5, allow_inf_nan=False)]
Friction = Annotated[float, Field(ge=0, le=100, allow_inf_nan=False)]


def _accuracy(value: object) -> object:
    numbers = value.values() if isinstance(value, dict) and value else [value]
    if not all(
        isinstance(number, int | float) and not isinstance(number, bool) and 0 < number < 1 for number in numbers
    ):
        raise units.NotAllowedError(
            "an error above 0 and below 1, such as 1e-4 for the force, or { wall_peak = 1e-3 } for an observable"
        )
    return value


Accuracy = Annotated[float | dict[str, float], BeforeValidator(_accuracy)]


def _number_with_unit(value: object) -> object:
    plain = isinstance(value, int | float) and not isinstance(value, bool) and isfinite(value)
    if not plain and not (isinstance(value, str) and units.NUMBER_AND_UNIT.fullmatch(value)):
        raise units.NotAllowedError('a number with its unit, such as "2.1 N/V", or a plain number without a unit')
    return value


NumberWithUnit = Annotated[str | float, BeforeValidator(_number_with_unit)]  # postproc converts it to SI units
Fraction = Annotated[float, Field(ge=0, lt=1)]


class Material(Part):
    """Elastic constants; ``density`` is needed only for bodies without a ``mass``."""

    youngs_modulus: units.Modulus
    poisson_ratio: PoissonRatio
    density: units.Density | None = None
    source: str | None = None

    @property
    def compliance(self) -> float:
        """Contribution of the material to ``1/E*``, ``(1 - nu^2) / E``, in 1/Pa."""
        return float((1 - self.poisson_ratio**2) / self.youngs_modulus)


class Sensor(OfBead):
    """Bead with a force gauge; the default of ``mass`` is the mass of the other beads."""

    mass: units.Mass | None = None


class Bead(OfBead):
    """Properties of one bead that differ from the others.

    ``gap_below`` raises the bead and all bodies above it by a gap. ``velocity`` is positive upwards;
    ``lateral_velocity`` is perpendicular to the axis.
    """

    diameter: units.Length | None = None
    mass: units.Mass | None = None
    material: Name | None = None
    gap_below: units.Gap | None = None
    velocity: units.Velocity | None = None
    lateral_velocity: units.Velocity | None = None


class Member(Part):
    """Bead of a pattern; the defaults of its properties are those of the chain."""

    material: Name | None = None
    diameter: units.Length | None = None
    mass: units.Mass | None = None


class ChainTable(Part):
    """Beads of the chain.

    A ``pattern`` is repeated from the wall. With ``taper`` each bead has this share of the diameter of the bead below;
    with ``taper_to`` diameters change linearly to that of the top bead. A mass given for the chain or for a member is
    that of a bead of its full diameter: tapered beads have its density. ``angle`` to the vertical is in degrees.
    """

    count: Annotated[int, Field(ge=0, le=MAX_BEADS)]
    material: Name
    diameter: units.Length
    mass: units.Mass | None = None
    pattern: tuple[Member, ...] | None = Field(default=None, strict=False)
    taper: Annotated[float, Field(ge=0.01, le=10, allow_inf_nan=False)] | None = None
    taper_to: units.Length | None = None
    angle: units.Angle | None = None
    sensors: Annotated[tuple[Annotated[Sensor, ByBead], ...], InOneList] = Field(default=(), strict=False)
    bead: Annotated[tuple[Annotated[Bead, ByBead], ...], InOneList] = Field(default=(), strict=False)
    precompression: units.Force = 0.0
    mass_scatter: units.MassSpread = 0.0
    lateral_offset: units.Gap | None = None
    origin: units.Height = 0.0

    @property
    def members(self) -> tuple[Member, ...]:
        """Members of the pattern; without a pattern, one with the properties of the chain."""
        return self.pattern or (Member(),)

    def is_like(self, member: Member) -> bool:
        """True if a member has the material and the diameter of the chain."""
        return member.material in (None, self.material) and member.diameter in (None, self.diameter)

    def taper_at(self, from_wall: Any) -> Any:
        """Diameter of a bead, or of an array of beads, divided by that of its member without taper."""
        if self.taper is not None:
            return self.taper ** (from_wall - 1.0)
        if self.taper_to is not None:
            return 1.0 + (self.taper_to / self.diameter - 1.0) * (from_wall - 1.0) / max(self.count - 1, 1)
        return 0.0 * from_wall + 1.0


class Striker(Part):
    """Striker: touches the top bead at time 0 and moves down with ``speed``."""

    shape: Literal["sphere", "flat"] = "sphere"
    material: Name
    diameter: units.Length | None = None
    mass: units.Mass | None = None
    speed: units.Speed


class Wall(Part):
    """Flat half-space below bead 1; the material ``rigid`` is not deformed."""

    material: Name


class Tube(Part):
    """Tube around the chain, modelled only if beads can move sideways.

    ``top`` is the height of the upper end.
    """

    inner_diameter: units.Length
    material: Name
    friction: Friction = 0.0
    top: units.Height | None = None


class ContactTable(Part):
    """Friction of contacts, and their law of dissipation (``drivers.laws``) with its keys.

    Contacts are elastic by default. With ``rotation = false`` beads do not spin.
    """

    dissipation: str
    friction: Friction = 0.0
    rotation: bool = True

    @property
    def given(self) -> dict[str, float]:
        """Keys of laws of dissipation that the scene gives."""
        values = {key: getattr(self, key) for law in LAWS.values() for key in law.keys}
        return {key: value for key, value in values.items() if value is not None}

    @property
    def law(self) -> ContactLaw:
        """Contact law."""
        return LAWS[self.dissipation].of(self.given)

    @property
    def elastic(self) -> "Contact":
        """This contact without dissipation."""
        return self.model_copy(update=dict.fromkeys(self.given) | {"dissipation": Viscoelastic.name})


if TYPE_CHECKING:
    Contact = ContactTable
else:
    _keys: dict[str, Any] = {key: (kind | None, None) for law in LAWS.values() for key, kind in law.keys.items()}
    _name = (Literal[tuple(LAWS)], Viscoelastic.name)
    Contact = create_model("Contact", __base__=ContactTable, __module__=__name__, dissipation=_name, **_keys)


class Gauge(Part):
    """Electronics of all gauges, including the wall gauge: a first-order high-pass, in post-processing only."""

    time_constant: units.Duration


class Run(Part):
    """Duration, sampling, time step or accuracy, and recorded quantities."""

    duration: units.Duration
    sample_interval: units.Duration
    time_step: units.Duration | None = None
    accuracy: Accuracy | None = None
    record: tuple[Literal["forces", "state"], ...] = Field(default=("forces",), strict=False)


class MeasuredEntry(Part):
    """Measured trace in a file, or quoted ``values``, for comparison with computed results.

    Decks, runs and run records do not depend on it. Gauges with different ``gain`` need separate entries.

    Attributes:
        file: CSV file with headings; the path is relative to the scene file.
        time: heading of the time column, with or without the unit; default: found by its name or unit.
        gauges: heading by gauge, such as ``wall``; default: the columns named after gauges.
        time_unit, unit: units of columns for which the file names none.
        gain: force per reading, or reading per force; default 1 for columns in a unit of force.
        gain_uncertainty: relative standard error of the gain.
        trigger: time in the file at which the striker touches the chain; default: found by alignment.
        baseline: reading at rest; default: found from quiet samples.
        drift: True if the baseline is a straight line through quiet samples.
        noise: standard deviation of a reading; default: of the readings about a smooth curve.
        values: quoted numbers by observable, with or without the unit in the observable's name.
        errors: relative standard error of each value.
        source: origin of the data, free text.
    """

    file: Text | None = None
    time: Text | None = None
    gauges: dict[Name, Text] | None = None
    time_unit: Text | None = None
    unit: Text | None = None
    gain: NumberWithUnit | None = None
    gain_uncertainty: Fraction = 0.0
    trigger: units.Instant | None = None
    baseline: NumberWithUnit | None = None
    drift: bool = False
    noise: NumberWithUnit | None = None
    values: dict[Text, NumberWithUnit] | None = None
    errors: dict[Text, Annotated[float, Field(gt=0, allow_inf_nan=False)]] | None = None
    source: str | None = None


class SceneFile(Part):
    """Contents of a scene file."""

    title: Title = ""
    gravity: units.Acceleration = 0.0
    seed: Annotated[int, Field(ge=0, lt=2**63)] = 0
    chain: ChainTable
    striker: Striker | None = None
    wall: Wall | None = None
    tube: Tube | None = None
    contact: Contact = Contact(dissipation=Viscoelastic.name)
    drive: DriveTable | None = None
    sensor: Gauge | None = None
    materials: dict[Name, Material] = Field(default_factory=dict)
    run: Run
    measured: tuple[MeasuredEntry, ...] = Field(default=(), strict=False, exclude=True)  # runs do not depend on it


class Scene(SceneFile):
    """Complete scene: ``materials`` holds all materials in use, and ``run.time_step`` divides the sample interval.

    With ``run.accuracy``, the time step equals the sample interval until the step is planned. ``file``, ``folder`` and
    ``measured`` are not part of the physics.

    Attributes:
        name: name of the scene file without the suffix.
        drive: drive with the points of its file.
        file: scene file as named in messages.
        folder: folder of the scene file; paths in the scene file are relative to this folder.
        steps_per_sample: time steps per sample interval.
        samples: number of samples, including the sample at time 0.
    """

    name: str
    drive: StoredDrive | None = None
    file: str = Field(exclude=True)
    folder: Path = Field(default=Path(), exclude=True)
    steps_per_sample: int
    samples: int

    @property
    def time_step_s(self) -> float:
        """Time step in s."""
        assert self.run.time_step is not None  # read_scene always sets it
        return self.run.time_step

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

    def elastic_constants(self, material: str) -> tuple[float, float]:
        """Young's modulus in Pa and Poisson's ratio of a material of the scene, or of the rigid wall."""
        if material == RIGID:
            return RIGID_PA, 0.0
        return self.materials[material].youngs_modulus, self.materials[material].poisson_ratio
