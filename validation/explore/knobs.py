"""Knobs of a scene: its keys with values that can be turned, their ranges, and the settings that a turn makes."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache
from math import inf, isclose, log, nan

from drivers.base.messages import model_at
from drivers.base.units import NUMBER_AND_UNIT, divided, quantity
from drivers.chain.case import Case
from drivers.laws import LAWS
from drivers.scene.model import RIGID, Part, Scene
from drivers.scene.read_scene import library_materials
from drivers.scene.rules import LAW_KEYS
from drivers.scene.settings import look_up, setting_text, unit_of
from validation.calibration.parameters import ELASTIC, GAIN, TRIGGER, Free, around, law_of, stated, unknown

ALONG = ("chain.angle",)  # only if beads cannot move sideways
SIDEWAYS = ("contact.friction", "tube.friction", "tube.inner_diameter")  # only if beads can move so
FIXED = ("chain.mass_scatter", "chain.origin", "run.sample_interval", "run.accuracy")  # numbers without a knob
SENSORS = "chain.sensors"
NONE = "none"  # choice without the table
# ranges of values that are 0 or left out in most scenes
FROM_ZERO = {
    "chain.precompression": (0.0, 20.0),
    "chain.angle": (0.0, 90.0),
    "gravity": (0.0, 20.0),
    "contact.friction": (0.0, 1.0),
    "tube.friction": (0.0, 1.0),
    "sensor.time_constant": (5e-5, 0.1),  # from half the duration of a pulse to a value without visible effect
}
TABLES = ("striker", "chain", "materials", "contact", "gravity", "wall", "drive", "sensor", "tube", "run", "measured")
ROUNDING = 0.005  # of a value with three digits
STEP, STEP_OF_PARTS = 0.002, 0.05  # of a place in a range
PARTS = [digit * 10**power for power in range(9) for digit in (1, 2, 4, 5, 8)]  # of a sample interval
GAIN_FACTOR = 2.0  # from the stated gain to both ends
TRIGGER_SHARE = 0.1  # of the run's duration, from the trigger to both ends


@dataclass(frozen=True)
class Knob:
    """A key of a scene that can be turned.

    Attributes:
        key: The key.
        text: Present value, as in a setting; empty without one.
        range: Range of a number, which starts at the present value, without one at its lower end; None for others.
        step: Step of the place in the range.
        choices: Settings by choice; none for a number or a text.
        shared: Further keys that have the same value.
        parts_of_s: Time of which a number is a whole part; 0 without one.
        title: Words in place of the key.
    """

    key: str
    text: str
    range: Free | None = None
    step: float = STEP
    choices: Mapping[str, Mapping[str, str]] = field(default_factory=dict)
    shared: tuple[str, ...] = ()
    parts_of_s: float = 0.0
    title: str = ""

    @property
    def free(self) -> str:
        """Option ``--free`` by which a fit finds its value, with bounds if it has none; empty if no fit can."""
        if self.range is None or self.key.startswith(("run", "chain.count")):
            return ""
        return self.key if self.text else f"{self.key}={self.text_at(0)}..{self.text_at(1)}"

    def has(self, other: "Knob") -> bool:
        """True if the value of another knob is in the range, up to rounding, or among the choices."""
        if self.range and other.range:
            value = other.range.start
            return isclose(value, self.range.value(self.range.coordinate(value)), rel_tol=ROUNDING)
        return not self.choices or other.text in self.choices

    @property
    def place(self) -> float:
        """Place of the present value in the range, from 0 to 1."""
        return self.range.coordinate(self.range.start) if self.range else 0.0

    def text_at(self, place: float) -> str:
        """Value at a place in the range, to three digits."""
        assert self.range is not None
        value = self.range.value(place)
        if self.parts_of_s:
            parts = min(PARTS, key=lambda parts: abs(log(parts * value / self.parts_of_s)))
            return quantity(divided(self.parts_of_s, parts), "s")
        if self.key == "chain.count":
            return str(round(value))
        text = f"{value:.{6 if self.range.is_trigger else 3}g}"
        return quantity(float(text), self.range.unit) if self.range.unit else text

    def settings(self, text: str, scene: Scene) -> dict[str, str]:
        """Settings by key that give the value, typed or chosen; empty texts remove keys."""
        if self.key == SENSORS:
            return {SENSORS: _sensors(text, scene)}
        return dict(self.choices.get(text, dict.fromkeys((self.key, *self.shared), text)))


def knobs_of(case: Case, asked: Sequence[str] = (), triggers_s: Mapping[str, float] | None = None) -> list[Knob]:
    """Knobs of a scene, those of ``--knob`` first, then by table.

    Args:
        case: The case of the scene.
        asked: Options ``KEY=FROM..TO``.
        triggers_s: Triggers that were found, by key.

    Raises:
        InputError: A key of ``asked`` has no number, or its range is wrong.
    """
    scene, ranges = case.scene, {text.partition("=")[0].strip(): text for text in asked}
    numbers = {key: _number(scene, key, ranges.get(key, key)) for key in dict.fromkeys((*ranges, *_numbers(scene)))}
    first = [numbers.pop(key) for key in ranges]
    others = (*_choices(case), *numbers.values(), *_measured(scene, triggers_s or {}))
    return [*first, *sorted(others, key=lambda knob: TABLES.index(knob.key.partition(".")[0]))]


def _numbers(scene: Scene) -> Iterator[str]:
    """Keys of its numbers, of materials the moduli alone, and keys without a value that start from 0."""
    yield from ("gravity", "sensor.time_constant", *(f"materials.{name}.youngs_modulus" for name in scene.materials))
    for table, part in scene:
        for name, value in part if isinstance(part, Part) else ():
            key = f"{table}.{name}"
            fixed = key in FIXED or key in (ALONG if scene.three_dimensional else SIDEWAYS)
            if not fixed and (isinstance(value, float) or key in ("chain.count", *FROM_ZERO)):
                yield key


def _number(scene: Scene, key: str, text: str) -> Knob:
    """Knob of a number; its range is that of the option, or a tenth of and ten times the value within its bounds."""
    value, unit, bounds = look_up(scene, key), unit_of(key), _bounds(key)
    missing = value is None and "=" not in text and key not in FROM_ZERO
    if bounds is None or missing or isinstance(value, bool) or not isinstance(value, int | float | None):
        raise unknown(scene.file, "--knob", key, [*_numbers(scene)], "a key of the scene with a number")
    least, most = bounds
    if key == "chain.count":  # beads with entries of their own stay
        least = max(least, 1.0, *scene.chain.sensor_at, *scene.chain.bead_at)
    low, high = around(value) if value else FROM_ZERO.get(key, (0.0, scene.run.duration if unit == "s" else 1.0))
    usual = Free(key, unit, nan if value is None else value, max(low, least), min(high, most))
    free, step, parts_of_s = stated(text, usual, scene.file, "--knob"), STEP, 0.0
    if value is None:
        free = replace(free, start=free.low)
    if key == "run.time_step":
        step, parts_of_s = STEP_OF_PARTS, scene.run.sample_interval
    elif key == "chain.count":  # a step changes a whole number, too
        step = max(STEP, 1.01 / free.slope(free.coordinate(free.start)))
    return Knob(key, setting_text(key, value), free, step, parts_of_s=parts_of_s)


@cache
def _bounds(key: str) -> tuple[float, float] | None:
    """Smallest and largest value that the model of scenes allows for a key; None for an unknown key."""
    *path, last = key.split(".")
    schema = model_at(Scene, path).model_json_schema()["properties"].get(last)
    if schema is None:
        return None
    stated_ends = {name: end for kind in schema.get("anyOf", [schema]) for name, end in kind.items()}
    least = stated_ends.get("minimum", stated_ends.get("exclusiveMinimum", -inf))
    return least, stated_ends.get("maximum", stated_ends.get("exclusiveMaximum", inf))


def _choices(case: Case) -> Iterator[Knob]:
    """Shape of the striker, law of dissipation, wall, and the gauges as text."""
    scene = case.scene
    if scene.striker:
        diameter, mass_kg = scene.striker.diameter or scene.chain.diameter, float(f"{case.chain.mass_kg[-1]:.6g}")
        sphere = {"striker.shape": "sphere", "striker.diameter": quantity(diameter, "m")}
        sphere["striker.mass"] = setting_text("striker.mass", scene.striker.mass)
        flat = {"striker.shape": "flat", "striker.diameter": "", "striker.mass": quantity(mass_kg, "kg")}
        yield Knob("striker.shape", scene.striker.shape, choices={"sphere": sphere, "flat": flat})
    laws = {law: dict(text.split("=", 1) for text in law_of(law)) for law in (ELASTIC, *LAWS)}
    stated_keys = {f"contact.{key}": getattr(scene.contact, key) for key in LAW_KEYS[scene.contact.dissipation]}
    law = scene.contact.dissipation if any(value is not None for value in stated_keys.values()) else ELASTIC
    laws[law] |= {key: setting_text(key, value) for key, value in stated_keys.items()}
    yield Knob("contact.dissipation", law, choices=laws)
    names = (*library_materials(), *scene.materials, RIGID)
    walls = {name: {"wall": f'{{material="{name}"}}'} for name in names} | {NONE: {"wall": ""}}
    yield Knob("wall.material", scene.wall.material if scene.wall else NONE, choices=walls)
    yield Knob(SENSORS, ", ".join(map(str, scene.chain.sensor_at)))


def _sensors(text: str, scene: Scene) -> str:
    """Sensors at the beads of a text such as ``9, 5``; new ones have the mass of the first of the scene."""
    masses = {str(place): sensor.mass for place, sensor in scene.chain.sensor_at.items()}
    entries = []
    for place in filter(None, map(str.strip, text.split(","))):
        mass_kg = masses.get(place, next(iter(masses.values()), None))
        where = {"from_wall": int(place) if place.isdecimal() else place}
        entries.append(where | ({"mass": mass_kg} if mass_kg else {}))
    return setting_text(SENSORS, entries)


def _measured(scene: Scene, triggers_s: Mapping[str, float]) -> Iterator[Knob]:
    """Gain of each measured trace, and trigger of each file once it is stated or found."""
    files: dict[str, list[str]] = {}
    for place, entry in enumerate(scene.measured):
        if entry.file is None:
            continue
        files.setdefault(entry.file, []).append(f"measured.{place}.{TRIGGER}")
        if entry.gain is not None:
            key, match = f"measured.{place}.{GAIN}", NUMBER_AND_UNIT.fullmatch(str(entry.gain))
            gain, unit = (float(match[1]), match[2]) if match else (float(entry.gain), "")
            low, high = sorted((gain / GAIN_FACTOR, gain * GAIN_FACTOR))
            title = f"gain of {', '.join(entry.gauges or ('all gauges',))}"
            yield Knob(key, str(entry.gain), Free(key, unit, gain, low, high), title=title)
    for file, (key, *others) in files.items():
        values = (*(look_up(scene, each) for each in (key, *others)), triggers_s.get(key))
        value = next((each for each in values if each is not None), None)
        if value is not None:
            reach_s, title = TRIGGER_SHARE * scene.run.duration, f"trigger of {file}{' (found)' * (key in triggers_s)}"
            free = Free(key, "s", value, value - reach_s, value + reach_s)
            yield Knob(key, setting_text(key, float(f"{value:.6g}")), free, shared=(*others,), title=title)
