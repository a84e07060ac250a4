"""Rules for combinations of keys of a scene; rules for single values are in the model."""

from collections.abc import Iterator
from contextlib import suppress

from drivers.base.errors import InputProblem
from drivers.base.messages import shorten
from drivers.laws import LAWS, Viscoelastic
from drivers.scene.model import (
    RIGID,
    Bead,
    ChainTable,
    Contact,
    DriveTable,
    MeasuredEntry,
    Scene,
    SceneFile,
    Sensor,
)

LEAST_M, MOST_M = 1e-9, 1e3  # diameters of beads
# keys of drives by form: needed ones, then optional ones; other keys are refused
KEYS: dict[str, tuple[tuple[str, ...], tuple[str, ...]]] = {
    "sine": (("frequency",), ("cycles", "window")),
    "half-sine": (("duration",), ()),
    "step": ((), ()),
    "ramp": (("duration",), ()),
    "chirp": (("frequency", "end_frequency", "duration"), ("window",)),
    "file": (("file",), ()),
}
AMPLITUDES = ("force", "displacement")
PLAY_TOLERANCE = 1e-6  # relative; for rounding of the difference of two diameters


def problems_of_alternatives(file: SceneFile) -> Iterator[InputProblem]:
    """Problems with keys that exclude each other."""
    run = file.run
    if RIGID in file.materials:
        yield f"materials.{RIGID}", "a material of this name", f'another name; "{RIGID}" is a wall without deformation'
    if (run.time_step is None) == (run.accuracy is None):
        found = "no time_step and no accuracy" if run.time_step is None else "both time_step and accuracy"
        yield "run", found, "exactly one of the two"
    yield from _dissipation(file.contact)
    if file.drive is not None:
        yield from drive_problems(file.drive)
    for i, measured in enumerate(file.measured):
        yield from _measured_choices(measured, f"measured.{i}")


def _dissipation(contact: Contact) -> Iterator[InputProblem]:
    """Problems with the keys of the laws of dissipation."""
    chosen, given = LAWS[contact.dissipation], contact.given
    for key, value in given.items():
        if key not in chosen.keys:
            found = f'{value:g} with contact.dissipation = "{contact.dissipation}"'
            law = next(law.name for law in LAWS.values() if key in law.keys)
            yield f"contact.{key}", found, f'this key only with contact.dissipation = "{law}"'
    for key, needed in chosen.keys.items():
        if needed and key not in given:
            yield f"contact.{key}", f"missing key; give {needed}", ""
    if chosen is Viscoelastic and given.keys() >= chosen.keys.keys():
        yield "contact", "both restitution and damping_ratio", "one of the two; each determines the other"


def _measured_choices(measured: MeasuredEntry, key: str) -> Iterator[InputProblem]:
    """Problems with an entry of ``[[measured]]``: a file and quoted values exclude each other."""
    if (measured.file is None) == (measured.values is None):
        found = "no file and no values" if measured.file is None else "both file and values"
        yield key, found, "exactly one of the two"
    if measured.file is not None and measured.errors is not None:
        yield f"{key}.errors", "errors for a file", "errors with values only; for a file, gain_uncertainty and noise"
    if measured.values is not None:
        for name in sorted(measured.model_fields_set - {"values", "errors", "gain_uncertainty", "source"}):
            yield f"{key}.{name}", "a key for files in an entry with values", "errors, gain_uncertainty, source"
        if not measured.values:
            yield f"{key}.values", "empty; give one or more observables", ""
        errors = measured.errors or {}
        for name in measured.values:
            if name not in errors:
                yield f"{key}.errors.{name}", "missing key; give the relative standard error of the value", ""
        for name in errors:
            if name not in measured.values:
                yield f"{key}.errors.{name}", "an error without a value", f"errors of {', '.join(measured.values)}"
    if measured.gauges is not None and not measured.gauges:
        yield f"{key}.gauges", 'empty; give a heading by gauge, such as { wall = "CH1" }', ""


def contradictions(scene: Scene) -> Iterator[InputProblem]:
    """Problems with keys that contradict each other."""
    chain, striker, wall, tube = scene.chain, scene.striker, scene.wall, scene.tube
    count = chain.count
    if "forces" not in scene.run.record:
        yield "run.record", shorten(list(scene.run.record)), 'a list that contains "forces"'
    yield from _wrong_beads(chain)
    if count == 0:
        if striker is None or wall is None:
            yield "chain.count", "0", "1 or more; 0 only with a striker and a wall"
        if chain.precompression:
            yield "chain.precompression", f"{chain.precompression:g} N", "0 N, as the chain has no beads"
    if striker is not None:
        yield from _striker_contradictions(scene)
    yield from _missing_densities(scene)
    yield from _pattern_contradictions(chain)
    tapers = chain.taper_at(1), chain.taper_at(count)
    widest = max(member.diameter or chain.diameter for member in chain.members) * max(tapers)
    widest = max([widest, *(bead.diameter for bead in chain.bead if bead.diameter)])
    if tube is not None and count and tube.inner_diameter < widest:
        yield "tube.inner_diameter", f"{tube.inner_diameter:g} m", f"at least the largest bead diameter, {widest:g} m"
    yield from drive_contradictions(scene)
    if scene.three_dimensional:
        yield from _tube_contradictions(scene, widest)


def _wrong_beads(chain: ChainTable) -> Iterator[InputProblem]:
    """Problems with the beads of the entries of a chain, one for each key."""
    wrong: dict[str, tuple[str, str]] = {}
    allowed = f"1 to {chain.count}, the beads of the chain" if chain.count else "no entry, as the chain has no beads"
    lists: dict[str, tuple[Sensor | Bead, ...]] = {"sensors": chain.sensors, "bead": chain.bead}
    for what, entries in lists.items():
        places: set[int] = set()
        for entry in sorted(entries, key=lambda bead: bead.entry):
            key = f"chain.{what}.{entry.entry}.from_wall"
            if entry.from_wall > chain.count:
                wrong.setdefault(key, (str(entry.from_wall), allowed))
            elif entry.from_wall in places:
                wrong.setdefault(key, (f"{entry.from_wall} twice", "each bead once"))
            places.add(entry.from_wall)
    with_mass = {bead.from_wall for bead in chain.bead if bead.mass is not None}
    for sensor in chain.sensors:
        if sensor.mass is not None and sensor.from_wall in with_mass:
            found = f"a mass of bead {sensor.from_wall} both here and in chain.bead"
            wrong.setdefault(f"chain.sensors.{sensor.entry}.mass", (found, "one of the two"))
    yield from ((key, *problem) for key, problem in wrong.items())


def _missing_densities(scene: Scene) -> Iterator[InputProblem]:
    """Problems with beads that have no mass and no density."""
    chain, wanted = scene.chain, dict[str, str]()
    for i, member in enumerate(chain.members if chain.count else ()):
        if member.mass is None and (chain.mass is None or not chain.is_like(member)):
            wanted[f"chain.pattern.{i}." if chain.pattern else "chain."] = member.material or chain.material
    for bead in chain.bead:
        if bead.mass is None and (bead.material is not None or bead.diameter is not None):
            member = chain.members[(bead.from_wall - 1) % len(chain.members)]
            wanted[f"chain.bead.{bead.entry}."] = bead.material or member.material or chain.material
    for key, material in wanted.items():
        if scene.materials[material].density is None:
            yield f"{key}mass", f"missing key; give a mass, or a density in [materials.{material}]", ""


def _pattern_contradictions(chain: ChainTable) -> Iterator[InputProblem]:
    """Problems with the keys of a pattern and of a taper."""
    if chain.taper is not None and chain.taper_to is not None:
        yield "chain.taper", "both taper and taper_to", "one of the two"
    if chain.taper_to is not None and any(member.diameter for member in chain.pattern or ()):
        yield "chain.taper_to", f"{chain.taper_to:g} m for a pattern with diameters", "chain.taper"
    if chain.pattern is not None and not 1 <= len(chain.pattern) <= max(chain.count, 1):
        yield "chain.pattern", f"{len(chain.pattern)} members", f"1 to {max(chain.count, 1)}, the beads of the chain"
    if chain.taper is not None:
        with suppress(OverflowError):
            last = chain.diameter * chain.taper_at(max(chain.count, 1))
            if LEAST_M <= last <= MOST_M:
                return
        found = f"{chain.taper:g}, with which the top bead has no diameter from {LEAST_M:g} to {MOST_M:g} m"
        yield "chain.taper", found, "a ratio closer to 1, or fewer beads"


def _striker_contradictions(scene: Scene) -> Iterator[InputProblem]:
    striker = scene.striker
    assert striker is not None
    if striker.shape == "flat":
        if striker.diameter is not None:
            yield "striker.diameter", f"{striker.diameter:g} m for a flat striker", "no diameter"
        if striker.mass is None:
            yield "striker.mass", "missing key; a flat striker needs a mass, as it has no volume", ""
        if scene.chain.count == 0:
            yield "striker.shape", '"flat" on a flat wall', '"sphere"; two flat faces are not a Hertz contact'
        return
    if striker.diameter is None:
        yield "striker.diameter", "missing key; give the diameter of the sphere", ""
    if striker.mass is None and scene.materials[striker.material].density is None:
        yield "striker.mass", f"missing key; give a mass, or a density in [materials.{striker.material}]", ""


def _tube_contradictions(scene: Scene, widest: float) -> Iterator[InputProblem]:
    """Problems with the keys of a three-dimensional scene."""
    chain, tube, offset = scene.chain, scene.tube, scene.chain.lateral_offset
    if chain.angle:
        allowed = "an upright chain, as beads that move sideways would fall across the axis"
        yield "chain.angle", f"{chain.angle:g} deg for beads that move sideways", allowed
    law = scene.contact.law
    if law.damped and not law.sideways:
        able = " or ".join(f'"{law.name}"' for law in LAWS.values() if law.sideways)
        allowed = f"{able}; the other laws are modelled for straight chains only"
        yield "contact.dissipation", f'"{law.name}" for beads that move sideways', allowed
    if scene.run.accuracy is not None:
        allowed = "a run.time_step; errors are predicted for straight chains only"
        yield "run.accuracy", "an accuracy for beads that move sideways", allowed
    if tube is None:
        if offset is not None:
            yield "chain.lateral_offset", f"{offset:g} m without a tube", "an offset only with a [tube]"
        return
    if chain.count == 0:
        yield "chain.count", "0 with chain.lateral_offset", "1 or more"
        return
    play = (tube.inner_diameter - widest) / 2
    if play <= 0:
        yield "tube.inner_diameter", f"{tube.inner_diameter:g} m", f"more than the largest bead diameter, {widest:g} m"
    elif offset is not None and offset > play * (1 + PLAY_TOLERANCE):
        yield "chain.lateral_offset", f"{offset:g} m", f"at most the play of {play:.4g} m"


def drive_problems(drive: DriveTable) -> Iterator[InputProblem]:
    """Problems with the keys of a drive."""
    needed, optional = KEYS[drive.form]
    given = [key for key in AMPLITUDES if getattr(drive, key) is not None]
    wanted = "no amplitude, since the file has values" if drive.form == "file" else "exactly one of the two"
    if len(given) != (drive.form != "file"):
        yield "drive", " and ".join(given) or "no force and no displacement", wanted
    for key in sorted({key for keys in KEYS.values() for part in keys for key in part} - {*needed, *optional}):
        if getattr(drive, key) is not None:
            forms = " or ".join(f'"{form}"' for form, keys in KEYS.items() if key in (*keys[0], *keys[1]))
            yield f"drive.{key}", f'this key with drive.form = "{drive.form}"', f"this key only with {forms}"
    for key in needed:
        if getattr(drive, key) is None:
            yield f"drive.{key}", f'missing key; drive.form = "{drive.form}" needs it', ""
    if drive.form == "sine" and drive.window == "hann" and drive.cycles is None:
        yield "drive.cycles", "missing key; a window needs a number of cycles", ""
    if drive.form == "step" and drive.displacement is not None:
        yield "drive.form", '"step" of a displacement, a motion of infinite speed', '"ramp" with a drive.duration'


def drive_contradictions(scene: Scene) -> Iterator[InputProblem]:
    """Problems of a drive with other keys of its scene."""
    drive, count = scene.drive, scene.chain.count
    if drive is None:
        return
    if scene.three_dimensional:
        yield "drive", "a drive of beads that move sideways", "a drive of a straight chain"
    if drive.from_wall is not None and drive.from_wall > count:
        allowed = f"1 to {count}, the beads of the chain" if count else "no such key, as the chain has no beads"
        yield "drive.from_wall", str(drive.from_wall), allowed
    if drive.prescribed and drive.from_wall is None and scene.striker is not None:
        yield "drive", "a displacement of the striker, which has a speed", "drive.from_wall of a bead, or a force"
    for i, bead in enumerate(scene.chain.bead):
        if drive.prescribed and bead.velocity is not None and bead.from_wall == (drive.from_wall or count):
            yield f"chain.bead.{i}.velocity", "a velocity of a bead with a prescribed displacement", "no velocity"
    if drive.start >= scene.run.duration:
        yield "drive.start", f"{drive.start:g} s", f"below run.duration, {scene.run.duration:g} s"
