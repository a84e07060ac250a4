"""Labels of observables and scene keys in figures and tables, with their units."""

import re
from dataclasses import dataclass
from math import floor, log10

from drivers.base import units
from drivers.scene.settings import unit_of
from postproc.read.observables import describe

MATERIALS = "materials."
KEYS = (  # scene keys with a label of their own; other keys are labelled by the name of their column
    (r"materials\.(.+)\.youngs_modulus", r"Young's modulus of \1"),
    (r"materials\.(.+)\.poisson_ratio", r"Poisson's ratio of \1"),
    (r"materials\.(.+)\.density", r"density of \1"),
    (r"chain\.count", "number of beads"),
    (r"chain\.(material|diameter|mass)", r"bead \1"),
    (r"chain\.mass_scatter", "scatter of the bead masses"),
    (r"chain\.sensors\.\d+\.mass", "sensor mass"),
    (r"contact\.restitution", "coefficient of restitution"),
    (r"contact\.friction", "friction between beads"),
    (r"tube\.friction", "friction at the tube"),
    (r"sensor\.time_constant", "time constant of the gauges"),
    (r"run\.(.+)", r"\1"),
)


@dataclass(frozen=True)
class Label:
    """Label of a quantity and its SI unit; the unit is empty for a plain number."""

    words: str
    unit: str

    def axis(self, largest: float) -> tuple[str, float]:
        """Label of an axis up to ``largest`` in SI units, and the factor from SI units to the unit on the axis."""
        unit, factor = self.unit, 1.0
        if unit == "kg":
            unit, factor = "g", 1e3
        elif unit in units.PREFIXED and "/" not in unit and largest > 0:
            power = min(max(floor(log10(largest)) // 3 * 3, min(units.PREFIXES)), max(units.PREFIXES))
            power = 0 if largest >= 0.1 and power < 0 else power
            unit, factor = units.PREFIXES[power] + unit, 10.0**-power
        return f"{self.words} ({_plain(unit)})" if unit else self.words, factor

    def value(self, value: object) -> str:
        """Text of a value in SI units, with four digits."""
        if not isinstance(value, float):
            return str(value)
        shown = float(f"{value:.4g}")
        return _plain(units.quantity(shown, self.unit)) if self.unit else f"{shown:g}"


def observable_label(name: str) -> Label:
    """Label of an observable, named with or without its unit."""
    observable = describe(name)
    match = observable.match(name)
    parts = {}
    if match:
        parts = {field: text.replace("pct", "\u00a0%").replace("_", " ") for field, text in match.groupdict().items()}
    if parts.get("gauge") == "wall":
        parts["gauge"] = "the wall"
    return Label(observable.words.format(**parts), observable.unit)


def key_label(name: str, key: str) -> Label:
    """Label of a column of a study, which holds the values of a scene key; a name of its own is used if it has one.

    Moduli, Poisson's ratios and densities are named in full.
    """
    for pattern, words in KEYS if name == key or key.startswith(MATERIALS) else ():
        if match := re.fullmatch(pattern, key):
            return Label(match.expand(words).replace("_", " "), unit_of(key))
    return Label(re.sub("[._]", " ", name), unit_of(key))


def _plain(text: str) -> str:
    """A unit or quantity with the signs µ and ² instead of ``u`` and ``^2``."""
    return re.sub(r"\bu(?=[a-zA-Z])", "µ", text).replace("^2", "²")
