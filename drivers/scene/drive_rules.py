"""Rules for the table ``[drive]`` of a scene, and the reader of its file."""

from collections.abc import Iterator
from math import nan
from pathlib import Path

from drivers.base import paths
from drivers.base.errors import InputError, InputProblem
from drivers.base.files import read_file
from drivers.base.messages import shorten
from drivers.base.units import to_si
from drivers.scene.model import DriveTable, Scene, StoredDrive

# keys by form: needed ones, then optional ones; other keys are refused
KEYS: dict[str, tuple[tuple[str, ...], tuple[str, ...]]] = {
    "sine": (("frequency",), ("cycles", "window")),
    "half-sine": (("duration",), ()),
    "step": ((), ()),
    "ramp": (("duration",), ()),
    "chirp": (("frequency", "end_frequency", "duration"), ("window",)),
    "file": (("file",), ()),
}
AMPLITUDES = ("force", "displacement")
VALUES = {"force": "force_N", "displacement": "displacement_m"}  # first words of headings and keys of stored values
SI = {"time": "s", "force": "N", "displacement": "m"}
LEAST_S, LARGEST = 1e-300, 1e9  # in SI units
HEADINGS = "two headings with units, such as time_us,force_mN or time_us,displacement_nm"
MAX_POINTS = 100_000


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


def with_points(drive: DriveTable, folder: Path, where: str) -> StoredDrive:
    """Drive with the points of its file, if it has one.

    Args:
        drive: table of the scene.
        folder: folder of the scene file.
        where: scene as messages name it.

    Raises:
        InputError: the file is missing or has no such table of numbers, times do not increase from 0 on, or a first
            displacement is not 0.
    """
    values = {key: getattr(drive, key) for key in DriveTable.model_fields}
    if drive.file is not None:
        path = folder / drive.file
        try:
            values |= _points(path)
        except FileNotFoundError as error:
            found, allowed = f"no such file: {paths.shown(path)}", f"a CSV file, relative to {paths.shown(folder)}"
            raise InputError(where, "drive.file", found, allowed) from error
    return StoredDrive.model_construct(**values)


def _points(path: Path) -> dict[str, tuple[float, ...]]:
    """Times and values of a file by key of ``StoredDrive``, in SI units; lines with # are comments."""
    shown = paths.shown(path)
    try:
        lines = read_file(path, "a CSV file").decode("utf-8-sig").splitlines()
    except ValueError as error:
        raise InputError(shown, "", f"a file that cannot be read: {error}", "CSV text in UTF-8") from error
    rows = [(n, line.split(",")) for n, line in enumerate(lines, 1) if line.strip() and not line.startswith("#")]
    headings = [tuple(cell.strip().partition("_")[::2]) for cell in rows[0][1]] if rows else []
    name = next((key for key in VALUES if [word for word, _ in headings] == ["time", key]), None)
    if name is None:
        raise InputError(shown, "line 1", shorten(lines[0] if lines else ""), HEADINGS)
    try:
        factors = [to_si(f"1 {unit}", SI[word]) for word, unit in headings]
    except ValueError as error:
        raise InputError(shown, f"line {rows[0][0]}", shorten(lines[rows[0][0] - 1]), HEADINGS) from error
    if not 2 < len(rows) <= MAX_POINTS:
        raise InputError(shown, "", f"{len(rows) - 1} rows of numbers", f"2 to {MAX_POINTS:,} rows")
    points, last = list[tuple[float, float]](), -LEAST_S
    for n, cells in rows[1:]:
        try:
            time, value = (float(cell) * factor for cell, factor in zip(cells, factors, strict=True))
        except ValueError:
            time = value = nan
        if not (last < time < LARGEST and abs(value) < LARGEST):
            raise InputError(shown, f"line {n}", shorten(",".join(cells)), "two numbers, times that increase from 0")
        points.append((time, value))
        last = time
    if name == "displacement" and points[0][1] != 0:
        raise InputError(shown, name, f"{points[0][1]:g} m first", "0 first, the displacement at time 0")
    times, values = zip(*points, strict=True)
    return {"time_s": times, VALUES[name]: values}
