"""Entries of single beads: one for each bead of a range such as ``"5-9"`` or of a list."""

import re
from typing import Annotated, Any

from pydantic import AfterValidator, BeforeValidator, Field, PrivateAttr, ValidatorFunctionWrapHandler, WrapValidator

from drivers.base.units import NotAllowedError
from drivers.scene.part import FromWall, Part

RANGE = re.compile(r" *([0-9]{1,9}) *(?:- *([0-9]{1,9}) *)?")
MAX_IN_RANGE = 100_000


def places_of(value: object) -> list[object]:
    """Beads of a ``from_wall``: one number, a range such as ``"5-9"``, or a list of both."""
    if isinstance(value, list | tuple):
        return [place for entry in value for place in places_of(entry)]
    if isinstance(value, str) and (ends := RANGE.fullmatch(value)):
        first, last = int(ends[1]), int(ends[2] or ends[1])
        if 1 <= first <= last <= MAX_IN_RANGE:
            return [*range(first, last + 1)]
    return [value]  # refused by the type of the key, unless it is a number


def _by_bead(entry: object, read: ValidatorFunctionWrapHandler) -> list[Any]:
    """Read an entry as one entry for each of its beads; errors have the index of the entry in the file."""
    if not isinstance(entry, dict) or "from_wall" not in entry:
        return [read(entry)]
    return [read(entry | {"from_wall": place}) for place in places_of(entry["from_wall"]) or [[]]]


def _in_one_list(entries: tuple[list[Any], ...]) -> tuple[Any, ...]:
    """Entries of all beads. Further beads of a range come last: ``chain.bead.2`` is the entry 2 of the file."""
    for index, beads in enumerate(entries):
        for bead in beads:
            bead._entry = index
    first = [beads[0] for beads in entries]
    return (*first, *(bead for beads in entries for bead in beads[1:]))


def _place(value: object) -> object:
    if isinstance(value, str | list | tuple):
        raise NotAllowedError(f'a bead such as 5, a range such as "5-9", up to {MAX_IN_RANGE}, or a list of them')
    return value


Place = Annotated[FromWall, BeforeValidator(_place)]
ByBead, InOneList = WrapValidator(_by_bead), AfterValidator(_in_one_list)


class OfBead(Part):
    """Entry of one bead; a range in the file becomes an entry for each of its beads."""

    from_wall: Place = Field(description='bead, "5-9", or list')
    _entry: int = PrivateAttr(default=0)

    @property
    def entry(self) -> int:
        """Index of the entry in the file, for messages."""
        return self._entry
