"""Tables of input files, and types of their keys that several tables share."""

from typing import Annotated

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, StringConstraints

from drivers.base.errors import CONTROL
from drivers.base.units import NotAllowedError

MAX_BEADS = 1_000_000
Name = Annotated[str, StringConstraints(pattern=r"^[A-Za-z][A-Za-z0-9_-]*$", max_length=60)]
FromWall = Annotated[int, Field(ge=1, le=MAX_BEADS)]


def _plain_text(value: str) -> str:
    if CONTROL.search(value):
        raise NotAllowedError("text without control characters")
    return value


Title = Annotated[str, AfterValidator(_plain_text)]
Text = Annotated[str, StringConstraints(min_length=1, max_length=1000), AfterValidator(_plain_text)]


class Part(BaseModel):
    """Table of the scene file: frozen, strict, no unknown keys."""

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True)
