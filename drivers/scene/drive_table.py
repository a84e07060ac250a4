"""Table ``[drive]`` of a scene file, and the same with the points of its file."""

from typing import Annotated, Literal

from pydantic import Field

from drivers.base import units
from drivers.scene.part import FromWall, Part, Text


class DriveTable(Part):
    """Drive of one body by a force or, as by a piezo, by its displacement; both are upwards positive.

    The amplitude is ``force`` or ``displacement``; ``drivers.chain.drives`` defines the wave forms. Times in a file
    count from ``start``; runs depend on its contents (``StoredDrive``), not on its name.
    """

    form: Literal["sine", "half-sine", "step", "ramp", "chirp", "file"] = Field(description="wave form")
    force: units.SignedForce | None = Field(default=None, description="amplitude, upwards positive")
    displacement: units.Displacement | None = Field(default=None, description="amplitude, upwards positive")
    from_wall: FromWall | None = Field(default=None, description="driven bead; else striker or top bead")
    start: units.StartTime = Field(default=0.0, description="beginning")
    duration: units.Duration | None = Field(default=None, description="duration of the wave form")
    frequency: units.Frequency | None = Field(default=None, description="frequency, of a chirp at its start")
    end_frequency: units.Frequency | None = Field(default=None, description="frequency of a chirp at its end")
    cycles: Annotated[float, Field(ge=1e-9, le=1e9, allow_inf_nan=False)] | None = Field(
        default=None, description="periods of a sine"
    )
    window: Literal["none", "hann"] | None = Field(default=None, description="envelope")
    file: Text | None = Field(default=None, exclude=True, description="CSV file, such as time_us,force_mN")


class StoredDrive(DriveTable):
    """Drive with the points of its file, at least two: times, and either forces or displacements."""

    time_s: tuple[float, ...] = Field(default=(), strict=False)
    force_N: tuple[float, ...] = Field(default=(), strict=False)
    displacement_m: tuple[float, ...] = Field(default=(), strict=False)

    @property
    def prescribed(self) -> bool:
        """True if the displacement of the body is given."""
        return self.displacement is not None or bool(self.displacement_m)
