"""Quantities with units, such as ``"4.76 mm"``, converted to SI floats.

The conversion uses decimal arithmetic: "4.76 mm" becomes the double closest to 0.00476, and a deck shows 0.00476, not
0.0047599999999999995.
"""

import re
from contextlib import suppress
from dataclasses import dataclass
from decimal import Decimal
from functools import cache, lru_cache
from math import nan
from typing import TYPE_CHECKING, Annotated, Any

from pydantic import BeforeValidator, GetJsonSchemaHandler, ValidationInfo
from pydantic_core import CoreSchema

from drivers.base.cache import cached

if TYPE_CHECKING:
    import pint

NUMBER_AND_UNIT = re.compile(  # without ways back, which would take the square of the length of a wrong text
    r" *+([+-]?+(?:[0-9]++\.?+[0-9]*+|\.[0-9]++)(?:[eE][+-]?+[0-9]{1,4}+)?+) *+([A-Za-zµμ](?: *+[\w*/^().·-])*+) *+"
)
PREFIXES = {-9: "n", -6: "u", -3: "m", 0: "", 3: "k", 6: "M", 9: "G"}
SI = "SI"  # context of a validation whose quantities are numbers in SI units, as in a run record
PREFIXED = ("m", "s", "N", "Pa", "m/s")
# in SI units; products of such numbers stay within the range of doubles
LARGEST, SMALLEST = Decimal("1e30"), Decimal("1e-30")


@cache
def _registry() -> "pint.UnitRegistry[Any]":
    import pint

    return pint.UnitRegistry(non_int_type=Decimal)


@lru_cache(maxsize=256)
def _factor(unit_text: str, unit: str) -> str:
    """Factor from ``unit_text`` to ``unit``, as decimal text; any exception if the units do not convert."""

    def by_pint() -> str:
        registry = _registry()
        parsed = registry.parse_units(unit_text)
        single, double = (Decimal(registry.Quantity(Decimal(count), parsed).to(unit).magnitude) for count in (1, 2))
        if double != 2 * single:
            raise ValueError("a unit with an offset")
        return str(single)

    return str(cached([unit_text, unit], by_pint))


@lru_cache(maxsize=4096)  # scenes that differ in one key are read by the thousand
def to_si(text: str, unit: str) -> float:
    """Value of ``text`` in the SI ``unit``.

    Raises:
        ValueError: not a number with a unit of that dimension, or out of range.
    """
    match = NUMBER_AND_UNIT.fullmatch(text)
    if match is None or len(match[2]) > 60:  # pint takes minutes for a long word
        raise ValueError("not a number with a unit")
    number, unit_text = match.groups()
    try:
        # offset units (degC) and odd exponents raise various errors of pint
        value = Decimal(number) * Decimal(_factor(unit_text, unit))
    except Exception as error:
        raise ValueError(f"not a unit of {unit}") from error
    if value and not SMALLEST <= abs(value) <= LARGEST:
        raise ValueError(f"not from {SMALLEST:g} to {LARGEST:g} {unit}")
    return float(value)


def divided(value: float, parts: int) -> float:
    """Part of a value, in decimal arithmetic: a twentieth of 5e-06 is 2.5e-07, not 2.5000000000000004e-07."""
    return float(Decimal(repr(value)) / parts)


def quantity(value: float, unit: str) -> str:
    """Text of a value in an SI unit, such as ``0.1 us``; it reads back as the same double."""
    number = Decimal(repr(value))
    if unit == "kg":
        number, unit = number.scaleb(3), "g"
    elif unit in PREFIXED and number:
        power = min((number.adjusted() + 1) // 3 * 3, max(PREFIXES))
        power = power if power in PREFIXES else 0
        number, unit = number.scaleb(-power), PREFIXES[power] + unit
    digits = "f" if abs(number.adjusted()) <= 6 else "g"
    return f"{number.normalize():{digits}} {unit}"


@dataclass(frozen=True)
class InUnit(BeforeValidator):
    """Validator that reads a quantity, and the SI unit and the range of its result."""

    unit: str = ""
    least: float = 0.0
    most: float = 0.0

    def __get_pydantic_json_schema__(self, schema: CoreSchema, handler: GetJsonSchemaHandler) -> dict[str, Any]:
        """JSON schema of the number, with its unit."""
        return handler(schema) | {"unit": self.unit, "minimum": self.least, "maximum": self.most}


def in_unit(what: str, unit: str, example: str, least: float, most: float, *, zero: bool = False) -> InUnit:
    """Validator of quantities between bounds in the SI unit; with ``zero``, 0 is allowed as well."""
    allowed = f'{what} with its unit, such as "{example}", {"0, or " * zero}from {least:g} to {most:g} {unit}'

    def read(value: object, info: ValidationInfo) -> float:
        number = value if isinstance(value, float) and info.context == SI else nan
        if isinstance(value, str):
            with suppress(ValueError):
                number = to_si(value, unit)
        if not (least <= number <= most or (zero and number == 0)):
            raise ValueError(allowed)
        return number

    return InUnit(read, unit=unit, least=0.0 if zero else least, most=most)


# generous bounds, from colloids to boulders
Length = Annotated[float, in_unit("a length above zero", "m", "4.76 mm", 1e-9, 1e3)]
Gap = Annotated[float, in_unit("a length of zero or more", "m", "10 um", 1e-30, 1e12, zero=True)]
Angle = Annotated[float, in_unit("an angle from 0 to 90 deg", "deg", "30 deg", 1e-9, 90, zero=True)]
Height = Annotated[float, in_unit("a height", "m", "0.1 m", -1e12, 1e12)]
Mass = Annotated[float, in_unit("a mass above zero", "kg", "0.1226 g", 1e-24, 1e12)]
MassSpread = Annotated[float, in_unit("a mass of zero or more", "kg", "0.0008 g", 1e-30, 1e12, zero=True)]
Duration = Annotated[float, in_unit("a time above zero", "s", "0.8 ms", 1e-21, 1e9)]
StartTime = Annotated[float, in_unit("a time of zero or more", "s", "10 us", 1e-21, 1e9, zero=True)]
Instant = Annotated[float, in_unit("a time", "s", "12 us", -1e9, 1e9)]
Speed = Annotated[float, in_unit("a speed above zero", "m/s", "2 m/s", 1e-12, 1e4)]
Slowness = Annotated[float, in_unit("a slowness above zero", "s/m", "0.1 s/m", 1e-9, 1e9)]
Velocity = Annotated[float, in_unit("a velocity (upwards positive)", "m/s", "-0.5 m/s", -1e4, 1e4)]
Acceleration = Annotated[
    float, in_unit("an acceleration of zero or more", "m/s^2", "9.81 m/s^2", 1e-30, 1e7, zero=True)
]
Force = Annotated[float, in_unit("a force of zero or more", "N", "2 N", 1e-30, 1e9, zero=True)]
SignedForce = Annotated[float, in_unit("a force (upwards positive)", "N", "-0.5 mN", -1e9, 1e9)]
Displacement = Annotated[float, in_unit("a displacement (upwards positive)", "m", "-20 nm", -1e3, 1e3)]
Frequency = Annotated[float, in_unit("a frequency above zero", "Hz", "5 kHz", 1e-9, 1e18)]
Modulus = Annotated[float, in_unit("a pressure above zero", "Pa", "1.46 GPa", 1.0, 1e14)]
Density = Annotated[float, in_unit("a density above zero", "kg/m^3", "2200 kg/m^3", 1e-3, 1e6)]
