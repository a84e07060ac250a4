"""Rules for combinations of keys of a scene; rules for single values are in the model."""

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from drivers.base.errors import InputProblem
from drivers.base.messages import shorten
from drivers.laws import HUNT_CROSSLEY, KUWABARA_KONO, POWER, VISCOELASTIC
from drivers.scene.model import RIGID, ChainTable, MeasuredEntry, Part, Scene, places_of

LEAST_M, MOST_M = 1e-9, 1e3  # diameters of beads
STEP_TOLERANCE = 1e-9  # relative; accepts steps written with ten digits
MAX_STEPS = 2**31 - 1  # LIGGGHTS counts steps in 32 bits
MAX_VALUES = 100_000_000  # samples x contacts; a run and its assessment take 150 bytes of memory for each
# keys by the value of another key, with words for their value if they have to be given; other keys are refused
Choices = Mapping[str, Mapping[str, str]]
LAW_KEYS: Choices = {
    HUNT_CROSSLEY: {"slowness": 'an inverse speed, such as "0.1 s/m"'},
    KUWABARA_KONO: {"relaxation": 'a time, such as "1 us"'},
    POWER: {"gamma": "a number of 0 or more, in N (s/m)^alpha", "alpha": ""},
    VISCOELASTIC: {"restitution": "", "damping_ratio": ""},
}
AMPLITUDE = {"force": "", "displacement": ""}
FREQUENCY, TIME = 'a frequency, such as "5 kHz"', 'a time, such as "10 us"'
FORM_KEYS: Choices = {
    "sine": {**AMPLITUDE, "frequency": FREQUENCY, "cycles": "", "window": ""},
    "half-sine": {**AMPLITUDE, "duration": TIME},
    "step": {"force": 'a force, such as "1 N"'},  # a step of a displacement would be of infinite speed
    "ramp": {**AMPLITUDE, "duration": TIME},
    "chirp": {**AMPLITUDE, "frequency": FREQUENCY, "end_frequency": FREQUENCY, "duration": TIME, "window": ""},
    "file": {"file": "the name of a CSV file"},
}
SHAPE_KEYS: Choices = {
    "sphere": {"diameter": "the diameter of the sphere", "mass": ""},
    "flat": {"mass": "a mass, as a flat striker has no volume"},
}
FOR_VALUES = {"values", "errors", "gain_uncertainty", "source"}  # keys of quoted values in [[measured]]


def problems_of(scene: Scene) -> Iterator[InputProblem]:
    """Problems with keys that contradict each other; ``materials`` are all known ones, and drives have their points."""
    yield from _bad_times(scene)
    yield from _wrong_materials(scene)
    yield from _wrong_beads(scene.chain)
    yield from _wrong_pattern(scene.chain)
    yield from _wrong_without_beads(scene)
    if scene.striker is not None:
        yield from _keys_by_choice(scene.striker, "striker", "shape", SHAPE_KEYS)
    yield from _keys_by_choice(scene.contact, "contact", "dissipation", LAW_KEYS)
    yield from _one_of(scene.contact, "contact", "restitution", "damping_ratio", needed=False)
    yield from _wrong_sideways(scene)
    yield from _wrong_drive(scene)
    for i, measured in enumerate(scene.measured):
        yield from _wrong_measured(measured, f"measured.{i}")


def _one_of(table: Part, key: str, *names: str, needed: bool = True) -> Iterator[InputProblem]:
    """Problem with keys of which one, or without ``needed`` at most one, can be given."""
    given = [name for name in names if getattr(table, name) is not None]
    if len(given) > 1:
        yield key, f"both {' and '.join(given)}", f"{'exactly' if needed else 'at most'} one of the two"
    elif needed and not given:
        yield key, f"no {' and no '.join(names)}", "exactly one of the two"


def _keys_by_choice(table: Part, where: str, choice: str, keys: Choices) -> Iterator[InputProblem]:
    """Problems with the keys of a table that the value of its key ``choice`` needs or excludes."""
    chosen = getattr(table, choice)
    for key in sorted({key for of_choice in keys.values() for key in of_choice}):
        value, needed = getattr(table, key), keys[chosen].get(key)
        if value is not None and needed is None:
            able = " or ".join(f'"{name}"' for name, of_choice in keys.items() if key in of_choice)
            found = f'{shorten(value)} with {where}.{choice} = "{chosen}"'
            yield f"{where}.{key}", found, f"this key only with {where}.{choice} = {able}"
        elif value is None and needed:
            yield f"{where}.{key}", f"missing key; give {needed}", ""


def _bad_times(scene: Scene) -> Iterator[InputProblem]:
    """Problems with the samples, the time step and the columns of a run."""
    run, interval_s, step_s, steps = scene.run, scene.run.sample_interval, scene.run.time_step, scene.steps_per_sample
    yield from _one_of(run, "run", "time_step", "accuracy")
    if step_s is not None and abs(interval_s / step_s - steps) > STEP_TOLERANCE * steps:
        found = f"{step_s:g} s, which does not divide run.sample_interval = {interval_s:g} s"
        yield "run.time_step", found, f'for instance "{interval_s / steps * 1e6:.12g} us"'
    if scene.samples < 2:
        yield "run.duration", f"{run.duration:g} s", f"at least one run.sample_interval ({interval_s:g} s)"
    contacts = scene.chain.count + 1
    if scene.samples * contacts > MAX_VALUES:
        allowed = f"at most {MAX_VALUES:,} samples times contacts; use a longer interval or a shorter duration"
        yield "run.sample_interval", f"{scene.samples:.3g} samples of {contacts} contacts", allowed
    elif scene.steps > MAX_STEPS:
        found = f"{step_s:g} s, which results in {scene.steps:.3g} steps"
        yield "run.time_step", found, f"at most {MAX_STEPS:.3g} steps"
    if "forces" not in run.record:
        yield "run.record", shorten(list(run.record)), 'a list that contains "forces"'


def named_materials(scene: Scene) -> dict[str, str]:
    """Names of the materials in use, by key of the scene."""
    parts: dict[str, Any] = {"chain": scene.chain}
    for what in ("bead", "pattern"):
        parts |= {f"chain.{what}.{i}": part for i, part in enumerate(getattr(scene.chain, what) or ())}
    parts |= {"striker": scene.striker, "wall": scene.wall, "tube": scene.tube}
    return {f"{key}.material": part.material for key, part in parts.items() if part is not None and part.material}


def _wrong_materials(scene: Scene) -> Iterator[InputProblem]:
    if RIGID in scene.materials:
        yield f"materials.{RIGID}", "a material of this name", f'another name; "{RIGID}" is a wall without deformation'
    for key, name in named_materials(scene).items():
        known = sorted({*scene.materials, *([RIGID] if key == "wall.material" else [])})
        if name not in known:
            yield key, f'"{name}"', f"{', '.join(known)}, or a material defined in [materials.{name}]"


def _wrong_beads(chain: ChainTable) -> Iterator[InputProblem]:
    """Problems with the beads of the entries of a chain."""
    allowed = f"1 to {chain.count}, the beads of the chain" if chain.count else "no entry, as the chain has no beads"
    for what in ("sensors", "bead"):
        seen: set[int] = set()
        for i, entry in enumerate(getattr(chain, what)):
            for place in places_of(entry.from_wall):
                if place > chain.count:
                    yield f"chain.{what}.{i}.from_wall", str(place), allowed
                elif place in seen:
                    yield f"chain.{what}.{i}.from_wall", f"{place} twice", "each bead once"
                seen.add(place)
    beads = chain.bead_at
    for i, sensor in enumerate(chain.sensors):
        for place in places_of(sensor.from_wall):
            if sensor.mass is not None and place in beads and beads[place].mass is not None:
                found = f"a mass of bead {place} both here and in chain.bead"
                yield f"chain.sensors.{i}.mass", found, "one of the two"


def _wrong_pattern(chain: ChainTable) -> Iterator[InputProblem]:
    """Problems with the keys of a pattern and of a taper."""
    yield from _one_of(chain, "chain.taper", "taper", "taper_to", needed=False)
    if chain.taper_to is not None and any(member.diameter for member in chain.members):
        yield "chain.taper_to", f"{chain.taper_to:g} m for a pattern with diameters", "chain.taper"
    if chain.pattern is not None and not 1 <= len(chain.pattern) <= max(chain.count, 1):
        yield "chain.pattern", f"{len(chain.pattern)} members", f"1 to {max(chain.count, 1)}, the beads of the chain"
    with np.errstate(over="ignore"):  # perhaps beyond doubles: inf
        top_m = chain.diameter * chain.taper_at(np.float64(max(chain.count, 1)))
    if chain.taper is not None and not LEAST_M <= top_m <= MOST_M:
        found = f"{chain.taper:g}, with which the top bead has no diameter from {LEAST_M:g} to {MOST_M:g} m"
        yield "chain.taper", found, "a ratio closer to 1, or fewer beads"


def _wrong_without_beads(scene: Scene) -> Iterator[InputProblem]:
    """Problems with a chain that has no beads."""
    if scene.chain.count:
        return
    if scene.striker is None or scene.wall is None:
        yield "chain.count", "0", "1 or more; 0 only with a striker and a wall"
    elif scene.striker.shape == "flat":
        yield "striker.shape", '"flat" on a flat wall', '"sphere"; two flat faces are not a Hertz contact'
    if scene.chain.precompression:
        yield "chain.precompression", f"{scene.chain.precompression:g} N", "0 N, as the chain has no beads"


def _wrong_sideways(scene: Scene) -> Iterator[InputProblem]:
    """Problems with beads that can move sideways."""
    chain, contact, offset = scene.chain, scene.contact, scene.chain.lateral_offset
    if not scene.three_dimensional:
        return
    if chain.angle:
        allowed = "an upright chain, as beads that move sideways would fall across the axis"
        yield "chain.angle", f"{chain.angle:g} deg for beads that move sideways", allowed
    if contact.dissipation != VISCOELASTIC and (contact.slowness or contact.relaxation or contact.gamma):
        allowed = f'"{VISCOELASTIC}"; the other laws are modelled for straight chains only'
        yield "contact.dissipation", f'"{contact.dissipation}" for beads that move sideways', allowed
    if scene.run.accuracy is not None:
        allowed = "a run.time_step; errors are predicted for straight chains only"
        yield "run.accuracy", "an accuracy for beads that move sideways", allowed
    if scene.drive is not None:
        yield "drive", "a drive of beads that move sideways", "a drive of a straight chain"
    if offset is not None and scene.tube is None:
        yield "chain.lateral_offset", f"{offset:g} m without a tube", "an offset only with a [tube]"
    elif offset is not None and chain.count == 0:
        yield "chain.count", "0 with chain.lateral_offset", "1 or more"


def _wrong_drive(scene: Scene) -> Iterator[InputProblem]:
    """Problems with the keys of a drive, and of a drive with other keys of its scene."""
    drive, count = scene.drive, scene.chain.count
    if drive is None:
        return
    stated = drive.model_copy(update={"file": "in the record"}) if drive.time_s else drive  # which keeps the points
    yield from _keys_by_choice(stated, "drive", "form", FORM_KEYS)
    yield from _one_of(drive, "drive", *AMPLITUDE, needed=drive.form not in ("step", "file"))
    if drive.form == "sine" and drive.window == "hann" and drive.cycles is None:
        yield "drive.cycles", "missing key; a window needs a number of cycles", ""
    if drive.from_wall is not None and drive.from_wall > count:
        allowed = f"1 to {count}, the beads of the chain" if count else "no such key, as the chain has no beads"
        yield "drive.from_wall", str(drive.from_wall), allowed
    if drive.prescribed and drive.from_wall is None and scene.striker is not None:
        yield "drive", "a displacement of the striker, which has a speed", "drive.from_wall of a bead, or a force"
    for i, bead in enumerate(scene.chain.bead):
        if drive.prescribed and bead.velocity is not None and (drive.from_wall or count) in places_of(bead.from_wall):
            yield f"chain.bead.{i}.velocity", "a velocity of a bead with a prescribed displacement", "no velocity"
    if drive.start >= scene.run.duration:
        yield "drive.start", f"{drive.start:g} s", f"below run.duration, {scene.run.duration:g} s"


def _wrong_measured(measured: MeasuredEntry, key: str) -> Iterator[InputProblem]:
    """Problems with an entry of ``[[measured]]``: a file and quoted values exclude each other."""
    yield from _one_of(measured, key, "file", "values")
    values, errors = measured.values, measured.errors or {}
    if values is None and errors:
        yield f"{key}.errors", "errors for a file", "errors with values only; for a file, gain_uncertainty and noise"
    if values is None:
        return
    for name in sorted(measured.model_fields_set - FOR_VALUES):
        yield f"{key}.{name}", "a key for files in an entry with values", ", ".join(sorted(FOR_VALUES))
    for name in sorted(values.keys() - errors.keys()):
        yield f"{key}.errors.{name}", "missing key; give the relative standard error of the value", ""
    for name in sorted(errors.keys() - values.keys()):
        yield f"{key}.errors.{name}", "an error without a value", f"errors of {', '.join(values)}"
