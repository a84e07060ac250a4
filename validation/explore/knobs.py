"""Knobs of a scene: its keys with values that can be turned, their ranges, and the settings that a turn makes."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from math import inf, log, nan
from typing import Any

from drivers.base.errors import InputError
from drivers.base.messages import model_at
from drivers.base.units import NUMBER_AND_UNIT, divided, quantity, to_si
from drivers.chain.case import Case
from drivers.laws import LAWS
from drivers.scene.model import RIGID, Scene
from drivers.scene.read_scene import library_materials
from drivers.scene.rules import FORM_KEYS, LAW_KEYS, SHAPE_KEYS
from drivers.scene.settings import look_up, setting_text, unit_of
from validation.calibration.parameters import ELASTIC, GAIN, TRIGGER, Free, around, law_of, stated, unknown

STRIKER, WALL, LAW, SENSORS = "striker", "wall.material", "contact.dissipation", "chain.sensors"
NONE = "none"  # choice without the table
CHAIN = ("count", "diameter", "mass", "precompression", "angle", "lateral_offset")
SIDEWAYS = ("contact.friction", "tube.friction", "tube.inner_diameter")
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
        range: Range of a number; None for a choice or a text.
        choices: Settings by choice; none for a number or a text.
        shared: Further keys that have the same value.
        parts_of_s: Time of which a number is a whole part; 0 without one.
        ending: Words after a number whose key has no SI unit.
        title: Words in place of the key.
    """

    key: str
    text: str
    range: Free | None = None
    choices: Mapping[str, Mapping[str, str]] = field(default_factory=dict)
    shared: tuple[str, ...] = ()
    parts_of_s: float = 0.0
    ending: str = ""
    title: str = ""

    @property
    def free(self) -> bool:
        """True if a fit can find its value."""
        return self.range is not None and not self.parts_of_s and not self.key.startswith(("run", "chain.count"))

    @property
    def form(self) -> tuple[object, ...]:
        """Key and kind, on which its widgets depend."""
        return self.key, self.range is None, *self.choices

    @property
    def value(self) -> float:
        """Present value of a number in its SI unit, without one the lower end of its range."""
        if self.range is None or not self.text:
            return self.range.low if self.range else nan
        number = self.text.removesuffix(self.ending)
        return to_si(number, self.range.unit) if self.range.unit else float(number)

    @property
    def place(self) -> float:
        """Place of the present value in the range, from 0 to 1."""
        return self.range.coordinate(self.value) if self.range else 0.0

    @property
    def step(self) -> float:
        """Step of the place, which changes a whole number, too."""
        if self.parts_of_s:
            return STEP_OF_PARTS
        whole = self.key == "chain.count" and self.range and self.range.start
        return max(STEP, 1.01 / self.range.slope(self.range.coordinate(whole))) if self.range and whole else STEP

    def text_at(self, place: float) -> str:
        """Value at a place in the range, to three digits."""
        assert self.range is not None
        value = self.range.value(place)
        if self.parts_of_s:
            parts = min(PARTS, key=lambda parts: abs(log(parts * value / self.parts_of_s)))
            return quantity(divided(self.parts_of_s, parts), "s")
        if self.key == "chain.count":
            return str(round(value))
        value = float(f"{value:.3g}" if self.key.rpartition(".")[2] != TRIGGER else f"{value:.6g}")
        return quantity(value, self.range.unit) if self.range.unit else f"{value:g}{self.ending}"

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
    """Keys with numbers of the bodies, contacts, gauges, drive and run, those that the scene has."""
    tables: dict[str, Any] = {"contact": LAW_KEYS[scene.contact.dissipation]}
    if scene.striker:
        tables = {STRIKER: ("speed", *SHAPE_KEYS[scene.striker.shape])} | tables
    if scene.drive:
        tables["drive"] = (*FORM_KEYS[scene.drive.form], "start")
    stated_keys = (f"{table}.{key}" for table, keys in tables.items() for key in keys)
    yield from (key for key in stated_keys if type(look_up(scene, key)) is float)
    for key in CHAIN:
        if look_up(scene, f"chain.{key}") is not None or key == "angle":
            yield f"chain.{key}"
    yield from ("gravity", *(f"materials.{name}.youngs_modulus" for name in scene.materials))
    yield from (key for key in SIDEWAYS if scene.three_dimensional and look_up(scene, key) is not None)
    yield from ("sensor.time_constant", "run.duration", "run.time_step")


def _number(scene: Scene, key: str, text: str) -> Knob:
    """Knob of a number; its range is that of the option, or a tenth of and ten times the value within its bounds."""
    value, unit, (least, most) = look_up(scene, key), unit_of(key), _bounds(key)
    if not isinstance(value, (int, float, type(None))) or (value is None and "=" not in text and key not in FROM_ZERO):
        raise unknown(scene.file, "--knob", key, [*_numbers(scene)], "a key of the scene with a number")
    if key == "chain.count":  # beads with entries of their own stay
        least = max(least, 1.0, *scene.chain.sensor_at, *scene.chain.bead_at)
    low, high = around(value) if value else FROM_ZERO.get(key, (0.0, scene.run.duration if unit == "s" else 1.0))
    usual = Free(key, unit, nan if value is None else value, max(low, least), min(high, most))
    free = stated(text, usual, scene.file, "--knob")
    interval_s = scene.run.sample_interval if key == "run.time_step" else 0.0
    return Knob(key, setting_text(key, value), free, parts_of_s=interval_s)


@cache
def _bounds(key: str) -> tuple[float, float]:
    """Smallest and largest value that the model of scenes allows for a key.

    Raises:
        InputError: Scenes have no such key.
    """
    *path, last = key.split(".")
    schema = model_at(Scene, path).model_json_schema()["properties"]
    if last not in schema:
        raise InputError("explore", "--knob", key, "a key of the scene with a number")
    kinds = schema[last].get("anyOf", [schema[last]])
    lows = (kind.get("minimum", kind.get("exclusiveMinimum")) for kind in kinds)
    highs = (kind.get("maximum", kind.get("exclusiveMaximum")) for kind in kinds)
    return next(filter(None, lows), -inf), next(filter(None, highs), inf)


def _choices(case: Case) -> Iterator[Knob]:
    """Shape of the striker, law of dissipation, wall, and the gauges as text."""
    scene = case.scene
    if scene.striker:
        diameter, mass_kg = scene.striker.diameter or scene.chain.diameter, float(case.chain.mass_kg[-1])
        sphere = {"striker.shape": "sphere", "striker.diameter": quantity(diameter, "m")}
        sphere["striker.mass"] = setting_text("striker.mass", scene.striker.mass)
        flat = {"striker.shape": "flat", "striker.diameter": "", "striker.mass": quantity(mass_kg, "kg")}
        yield Knob("striker.shape", scene.striker.shape, choices={"sphere": sphere, "flat": flat})
    laws = {law: dict(text.split("=", 1) for text in law_of(law)) for law in (ELASTIC, *LAWS)}
    stated_keys = {key: getattr(scene.contact, key) for key in LAW_KEYS[scene.contact.dissipation]}
    law = scene.contact.dissipation if any(value is not None for value in stated_keys.values()) else ELASTIC
    laws[law] |= {f"contact.{key}": setting_text(f"contact.{key}", value) for key, value in stated_keys.items()}
    yield Knob(LAW, law, choices=laws)
    walls = {name: {"wall": f'{{material="{name}"}}'} for name in (*library_materials(), *scene.materials, RIGID)} | {
        NONE: {"wall": ""}
    }
    yield Knob(WALL, scene.wall.material if scene.wall else NONE, choices=walls)
    yield Knob(SENSORS, ", ".join(map(str, scene.chain.sensor_at)))


def _sensors(text: str, scene: Scene) -> str:
    """Sensors at the beads of a text such as ``9, 5``; new ones have the mass of the first of the scene."""
    masses = {place: sensor.mass for place, sensor in scene.chain.sensor_at.items()}
    entries = []
    for part in filter(None, map(str.strip, text.split(","))):
        place = int(part) if part.isascii() and part.isdecimal() else part
        mass_kg = masses.get(place, next(iter(masses.values()), None)) if isinstance(place, int) else None
        entries.append({"from_wall": place} | ({"mass": mass_kg} if mass_kg else {}))
    return setting_text(SENSORS, entries)


def _measured(scene: Scene, triggers_s: Mapping[str, float]) -> Iterator[Knob]:
    """Gain of each measured trace, and trigger of each file once it is stated or found."""
    files: dict[str, list[str]] = {}
    for place, entry in enumerate(scene.measured):
        if entry.file is None:
            continue
        key = f"measured.{place}"
        files.setdefault(entry.file, []).append(f"{key}.{TRIGGER}")
        gauges = ", ".join(entry.gauges or ("all gauges",))
        if entry.gain is not None:
            match = NUMBER_AND_UNIT.fullmatch(str(entry.gain))
            number, ending = (float(match[1]), f" {match[2]}") if match else (float(entry.gain), "")
            low, high = sorted((number / GAIN_FACTOR, number * GAIN_FACTOR))
            free = Free(f"{key}.{GAIN}", "", number, low, high)
            yield Knob(f"{key}.{GAIN}", f"{number:g}{ending}", free, ending=ending, title=f"gain of {gauges}")
    for keys in files.values():
        stated_s = next((each for key in keys if (each := look_up(scene, key)) is not None), None)
        value = stated_s if stated_s is not None else triggers_s.get(keys[0])
        if value is not None:
            reach_s, text = TRIGGER_SHARE * scene.run.duration, setting_text(keys[0], float(f"{value:.6g}"))
            free = Free(keys[0], "s", value, value - reach_s, value + reach_s)
            yield Knob(keys[0], text, free, shared=(*keys[1:],), title="trigger")
