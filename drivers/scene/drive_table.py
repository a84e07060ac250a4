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

    form: Literal["sine", "half-sine", "step", "ramp", "chirp", "file"]
    force: units.SignedForce | None = None
    displacement: units.Displacement | None = None
    from_wall: FromWall | None = None
    start: units.StartTime = 0.0
    duration: units.Duration | None = None
    frequency: units.Frequency | None = None
    end_frequency: units.Frequency | None = None
    cycles: Annotated[float, Field(ge=1e-9, le=1e9, allow_inf_nan=False)] | None = None
    window: Literal["none", "hann"] | None = None
    file: Text | None = Field(default=None, exclude=True)


class StoredDrive(DriveTable):
    """Drive with the points of its file, at least two: times, and either forces or displacements."""

    time_s: tuple[float, ...] = Field(default=(), strict=False)
    force_N: tuple[float, ...] = Field(default=(), strict=False)
    displacement_m: tuple[float, ...] = Field(default=(), strict=False)

    @property
    def prescribed(self) -> bool:
        """True if the displacement of the body is given."""
        return self.displacement is not None or bool(self.displacement_m)
