"""Axes of a study, expanded to lists of choices."""

import csv
import math
import re
from contextlib import suppress
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Field

from drivers.base import paths, units
from drivers.base.errors import InputError
from drivers.base.messages import shorten
from drivers.scene.model import Part
from drivers.scene.read_scene import library, read_value
from drivers.scene.settings import look_up

MAX_VALUES = 1_000_000
FORMS = ("values", "from", "factors", "zip", "seeds", "table")
HEADING = re.compile(r"(?P<key>[^\[\]]+?)(?: *\[(?P<unit>[^\[\]]+)\])?")
NAME = r"^[A-Za-z][A-Za-z0-9_.-]*$"

Choice = dict[str, Any]  # key of a scene -> value as in a scene file

Keys = Annotated[
    tuple[Annotated[str, Field(min_length=1)], ...],
    BeforeValidator(lambda value: (value,) if isinstance(value, str) else value),
]


class Axis(Part):
    """Table ``[[axis]]`` of a study file, in one of six forms.

    ``key`` with ``values``; ``key`` with ``from``, ``to``, ``count`` and ``spacing``; or ``key`` with ``factors`` of
    the base scene's value. With several keys all get the same value. ``zip``: lists of equal length, one for each key.
    ``seeds``: number of random draws. ``table``: a CSV file with a column for each key and a row for each case.
    """

    key: Keys = Field(default=(), strict=False, description="scene key, or keys with the same values")
    name: Annotated[str, Field(pattern=NAME, max_length=60)] | None = Field(
        default=None, description="name of the column"
    )
    values: tuple[Any, ...] | None = Field(default=None, strict=False, description="values")
    from_: str | int | float | None = Field(default=None, alias="from", description="first value")
    to: str | int | float | None = Field(default=None, description="last value")
    count: Annotated[int, Field(ge=2, le=MAX_VALUES)] | None = Field(default=None, description="number of values")
    spacing: Literal["linear", "log"] = Field(default="linear", description="spacing of the range")
    factors: tuple[Annotated[float, Field(gt=0, allow_inf_nan=False)], ...] | None = Field(
        default=None, strict=False, description="factors of the base value"
    )
    zip: dict[str, Annotated[tuple[Any, ...], Field(strict=False)]] | None = Field(
        default=None, description="lists by key that vary together"
    )
    seeds: Annotated[int, Field(ge=1, le=MAX_VALUES)] | None = Field(default=None, description="number of random draws")
    table: str | None = Field(default=None, description="CSV file: a column for each key")


def expand(axis: Axis, base: dict[str, Any], folder: Path, where: str, place: str) -> list[Choice]:
    """Choices of an axis, in order.

    Args:
        axis: the axis.
        base: tables of the base scene, whose values factors multiply.
        folder: folder of the study file, to which the paths of tables are relative.
        where: study file as named in messages.
        place: key of the axis in messages.

    Raises:
        InputError: the axis is wrong or has no values.
    """
    given = {form: getattr(axis, "from_" if form == "from" else form) for form in FORMS}
    forms = [form for form, value in given.items() if value is not None]
    if len(forms) != 1:
        raise InputError(where, place, f"{', '.join(forms) or 'none of them'}", f"exactly one of {', '.join(FORMS)}")
    form, value = forms[0], given[forms[0]]
    if bool(axis.key) != (form in ("values", "from", "factors")):
        needs = "a key" if not axis.key else f"no key with {form}"
        raise InputError(where, f"{place}.key", str(list(axis.key)), needs)
    if value == ():
        raise InputError(where, f"{place}.{form}", "an empty list", f"at least one {form.removesuffix('s')}")
    match form:
        case "zip":
            return _zipped(value, where, f"{place}.zip")
        case "table":
            return _table(folder / value, where, f"{place}.table")
        case "seeds":
            return [{"seed": seed} for seed in range(1, value + 1)]
        case "factors":
            return [{key: _multiplied(base, key, factor, where, place) for key in axis.key} for factor in value]
    values = _range(axis, where, place) if form == "from" else value
    return [dict.fromkeys(axis.key, value) for value in values]


def _zipped(lists: dict[str, tuple[Any, ...]], where: str, place: str) -> list[Choice]:
    lengths = {key: len(values) for key, values in lists.items()}
    if not lists or 0 in lengths.values():
        raise InputError(where, place, "an empty list", "keys with at least one value each")
    if len(set(lengths.values())) > 1:
        found = ", ".join(f"{length} of {key}" for key, length in lengths.items())
        raise InputError(where, place, found, "lists of equal length")
    return [dict(zip(lists, row, strict=True)) for row in zip(*lists.values(), strict=True)]


def _range(axis: Axis, where: str, place: str) -> list[Any]:
    """Values from one end to the other, both included; whole numbers at both ends give whole numbers."""
    if axis.from_ is None or axis.to is None or axis.count is None:
        missing = "count" if axis.to is not None else "to"
        raise InputError(where, f"{place}.{missing}", "missing key; give from, to and count")
    low, unit = _number(axis.from_, where, f"{place}.from")
    high, other = _number(axis.to, where, f"{place}.to")
    if unit != other:
        try:
            high = units.to_si(str(axis.to), unit)
        except ValueError as error:
            allowed = f"a quantity in {unit or 'plain numbers'}, as from has"
            raise InputError(where, f"{place}.to", shorten(str(axis.to)), allowed) from error
    ends, log = f"{axis.from_} to {axis.to}", axis.spacing == "log"
    if not math.isfinite(high - low):
        raise InputError(where, f"{place}.from", shorten(ends), "a finite range")
    if log and not (low > 0 and high > 0):
        raise InputError(where, f"{place}.from", ends, 'ends above zero for spacing = "log"')
    first, last = (math.log(low), math.log(high)) if log else (low, high)
    inner = [first + (last - first) * i / (axis.count - 1) for i in range(1, axis.count - 1)]
    values = [low, *(math.exp(point) if log else point for point in inner), high]
    if isinstance(axis.from_, int) and isinstance(axis.to, int):
        return list(dict.fromkeys(round(value) for value in values))
    return [f"{value!r} {unit}" if unit else value for value in values]


def _number(value: str | int | float, where: str, place: str) -> tuple[float, str]:
    """Number and unit of a value; the unit is empty for a plain number."""
    number, unit = str(value), ""
    if isinstance(value, str):
        match = units.NUMBER_AND_UNIT.fullmatch(value)
        if match is None:
            raise InputError(where, place, shorten(value), 'a number with its unit, such as "2 m/s", or a plain number')
        number, unit = match.groups()
    if not math.isfinite(float(number)):
        raise InputError(where, place, shorten(value), "a finite number")
    return float(number), unit


def _multiplied(base: dict[str, Any], key: str, factor: float, where: str, place: str) -> Any:
    """Value of the base scene at a key, times a factor."""
    value = look_up(base, key)
    if value is None and key.startswith("materials."):
        value = look_up(library(), key.removeprefix("materials."))
    if isinstance(value, (int, float)) and not isinstance(value, bool):
        product = float(str(value)) * factor  # by its text: float() fails for very large whole numbers
        return int(product) if isinstance(value, int) and product.is_integer() else product
    match = units.NUMBER_AND_UNIT.fullmatch(value) if isinstance(value, str) else None
    if match is None:
        found = f"{'nothing' if value is None else shorten(value)} at {key} of the base scene"
        raise InputError(where, f"{place}.factors", found, "a number or a quantity there")
    return f"{float(match.group(1)) * factor!r} {match.group(2)}"


def _table(path: Path, where: str, place: str) -> list[Choice]:
    """Rows of a CSV file; headings are keys, with a unit in brackets for columns of plain numbers."""
    try:
        if path.exists() and not path.is_file():  # reading a device or a pipe might not end
            raise ValueError("no regular file")
        with open(path, encoding="utf-8-sig", newline="") as file:
            rows = [row for row in csv.reader(file, strict=True) if row]
    except (OSError, ValueError, csv.Error) as error:
        found = error.strerror if isinstance(error, OSError) else str(error)
        raise InputError(where, place, f"{paths.shown(path)}: {found}", "a readable CSV file") from error
    shown = paths.shown(path)
    if len(rows) < 2:
        raise InputError(shown, "", f"{len(rows)} lines", "a line of keys and at least one line of values")
    columns: dict[str, str] = {}
    for heading in rows[0]:
        match = HEADING.fullmatch(heading.strip())
        if match is None:
            raise InputError(shown, "line 1", shorten(heading), "a key of the scene, such as striker.speed [m/s]")
        if match["key"].strip() in columns:
            raise InputError(shown, "line 1", "a key twice", "each key once")
        columns[match["key"].strip()] = match["unit"] or ""
    choices = []
    for number, row in enumerate(rows[1:], start=2):
        if len(row) != len(columns):
            raise InputError(shown, f"line {number}", f"{len(row)} values", f"{len(columns)}, one for each key")
        cells = zip(columns.items(), row, strict=True)
        choices.append({key: _cell(cell.strip(), unit, shown, f"line {number}, {key}") for (key, unit), cell in cells})
    return choices


def _cell(text: str, unit: str, where: str, place: str) -> Any:
    if not unit:
        if not text:
            raise InputError(where, place, "empty cell; give a value")
        return read_value(text)
    with suppress(ValueError):
        if math.isfinite(float(text)):
            return f"{text} {unit}"
    raise InputError(where, place, shorten(text), f"a plain number, since the heading has its unit ({unit})")
