"""Wave forms of drives as tables of segments (``Drive`` of ``validation.reference``), and the energy that they put in.

Before ``drive.start`` a drive is 0; after its end it holds its last value, and a half-sine returns to 0. A new form is
a function here, an entry of ``FORMS``, and its keys in ``drivers.scene.drive_table`` and ``drive_rules``.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import ceil, inf, pi

import numpy as np

from drivers.scene.drive_table import StoredDrive
from drivers.scene.model import Scene
from validation.reference.hertz_chain import COLUMNS, SAME_TIME, SINES, Array, Drive

Sine = tuple[float, float, float, float]  # amplitude, phase in rad, angular frequency in rad/s, its rate in rad/s^2
Segment = tuple[float, float, float, Sequence[Sine]]  # beginning since the start in s, value, rate, sines
SUMMED = 20_001  # times at which a drive is summed up
ROUNDED = 1e-12  # of the amplitude: a smaller value at the end of a wave is 0


def _step(amplitude: float, _: StoredDrive) -> list[Segment]:
    return [(0.0, amplitude, 0.0, ())]


def _ramp(amplitude: float, table: StoredDrive) -> list[Segment]:
    assert table.duration is not None
    return [(0.0, 0.0, amplitude / table.duration, ()), (table.duration, amplitude, 0.0, ())]


def _half_sine(amplitude: float, table: StoredDrive) -> list[Segment]:
    assert table.duration is not None
    return [(0.0, 0.0, 0.0, [(amplitude, 0.0, pi / table.duration, 0.0)]), (table.duration, 0.0, 0.0, ())]


def _sine(amplitude: float, table: StoredDrive) -> list[Segment]:
    assert table.frequency is not None
    duration = table.cycles / table.frequency if table.cycles else inf
    return _wave(amplitude, 2 * pi * table.frequency, 0.0, duration, windowed=table.window == "hann")


def _chirp(amplitude: float, table: StoredDrive) -> list[Segment]:
    """Sine whose frequency changes at a constant rate."""
    assert table.frequency is not None
    assert table.end_frequency is not None
    assert table.duration is not None
    sweep = 2 * pi * (table.end_frequency - table.frequency) / table.duration
    return _wave(amplitude, 2 * pi * table.frequency, sweep, table.duration, windowed=table.window == "hann")


def _wave(amplitude: float, turning: float, sweep: float, duration: float, *, windowed: bool) -> list[Segment]:
    """Sine until its end; the Hann window ``(1 - cos(2 pi tau / duration)) / 2`` makes it a sum of three."""
    if not windowed:
        angle = duration * (turning + 0.5 * sweep * duration) if np.isfinite(duration) else 0.0
        left = float(np.sin(angle))
        end = (duration, amplitude * left if abs(left) > ROUNDED * (1 + angle) else 0.0, 0.0, ())
        return [(0.0, 0.0, 0.0, [(amplitude, 0.0, turning, sweep)]), end]
    aside = 2 * pi / duration
    sides: list[Sine] = [(-amplitude / 4, 0.0, turning + shift, sweep) for shift in (aside, -aside)]
    return [(0.0, 0.0, 0.0, [(amplitude / 2, 0.0, turning, sweep), *sides]), (duration, 0.0, 0.0, ())]


def _polygon(_: float, table: StoredDrive) -> list[Segment]:
    """Straight lines between the points of a file."""
    times, values = np.array(table.time_s), np.array(table.force_N or table.displacement_m)
    rates = np.append(np.diff(values) / np.diff(times), 0.0)
    return [(time, value, rate, ()) for time, value, rate in zip(times, values, rates, strict=True)]


FORMS: dict[str, Callable[[float, StoredDrive], list[Segment]]] = {
    "sine": _sine,
    "half-sine": _half_sine,
    "step": _step,
    "ramp": _ramp,
    "chirp": _chirp,
    "file": _polygon,
}


def drive_of(scene: Scene) -> Drive | None:
    """Drive of a scene; None if it has none."""
    table = scene.drive
    if table is None:
        return None
    amplitude = table.displacement if table.prescribed else table.force
    segments = [each for each in FORMS[table.form](amplitude or 0.0, table) if each[0] < inf]
    if table.start + segments[0][0] > 0:
        segments.insert(0, (-table.start, 0.0, 0.0, ()))
    rows = np.zeros((len(segments), COLUMNS))
    for row, (begin, value, rate, sines) in zip(rows, segments, strict=True):
        row[:3] = table.start + begin, value, rate
        for place, sine in zip(SINES, sines, strict=False):
            row[place : place + 4] = sine
    return Drive((table.from_wall or scene.bodies) - 1, table.prescribed, rows)


def drive_words(scene: Scene) -> str:
    """Description of a drive, such as ``bead 20 is driven by a force of 0.5 N, sine of 5000 Hz``; else empty."""
    table = scene.drive
    if table is None:
        return ""
    body = (
        "the striker"
        if (table.from_wall or scene.bodies) > scene.chain.count
        else f"bead {table.from_wall or scene.bodies}"
    )
    what, size = ("displacement", table.displacement) if table.prescribed else ("force", table.force)
    words = f"{body} is driven by a {what}"
    words += f" of {size:g} {'m' if table.prescribed else 'N'}" if size is not None else ""
    frequency = "" if table.frequency is None else f" of {table.frequency:g} Hz"
    frequency += "" if table.end_frequency is None else f" to {table.end_frequency:g} Hz"
    cycles = "" if table.cycles is None else f", {table.cycles:g} cycles"
    lasts = "" if table.duration is None else f" in {table.duration:g} s"
    window = " with a Hann window" if table.window == "hann" else ""
    points = f" of {len(table.time_s)} points" if table.time_s else ""
    return f"{words}, {table.form}{frequency}{points}{cycles}{lasts}{window}, from {table.start:g} s"


@dataclass(frozen=True)
class SegmentSteps:
    """Segment of a drive as decks have it.

    Attributes:
        first: first step in the segment; ``until``: last step, or that of the run.
        begin_s: time from which the segment's time tau counts.
        value, rate: value at tau = 0, and its rate without the sines.
        sines: amplitude, phase, angular frequency and its rate of each sine.
    """

    first: int
    until: int
    begin_s: float
    value: float
    rate: float
    sines: list[list[float]]


def pieces_of(drive: Drive | None, time_step_s: float, steps: int) -> list[SegmentSteps]:
    """Segments with at least one step of a run; empty without a drive."""
    if drive is None:
        return []
    firsts = [ceil(begin / (time_step_s * SAME_TIME)) for begin in drive.segments[:, 0].tolist()]
    untils = [min(first - 1, steps) for first in [*firsts[1:], steps + 1]]
    pieces = []
    for first, until, row in zip(firsts, untils, drive.segments.tolist(), strict=True):
        if first <= until:
            sines = [row[place : place + 4] for place in SINES if row[place]]
            pieces.append(SegmentSteps(first, until, row[0], row[1], row[2], sines))
    return pieces


def energy_with_drive(
    drive: Drive, chain: tuple[Array, Array, Array], start_J: float, hertz_J: float, duration_s: float
) -> float:
    """Upper bound on the energy that can turn into motion, with the work of the drive.

    A force f on a body of mass m does work at a rate of at most ``|f| sqrt(2 E / m)``, so that ``sqrt(E)`` grows by at
    most ``integral of |f| / sqrt(2 m)``. A contact with the energy E has a force of at most ``c E^(3/5)`` with
    ``c = k^(2/5) (5/2)^(3/5)``, so that a displacement u makes ``E^(2/5)`` grow by at most
    ``(2/5) c integral of |u'|``; here E includes the Hertz energy at rest.

    Args:
        drive: the drive.
        chain: masses, stiffnesses of the contacts and constant loads of all bodies.
        start_J: energy put in without the drive.
        hertz_J: Hertz energy at time 0.
        duration_s: duration of the run.
    """
    mass_kg, stiffness, load_N = chain
    mass = float(mass_kg[drive.body])
    kinks = drive.segments[:, 0]
    times = np.union1d(np.linspace(0.0, duration_s, SUMMED), kinks[kinks < duration_s])
    value, rate, _ = drive.at(times)
    if not drive.prescribed:
        return float((np.sqrt(start_J) + np.trapezoid(np.abs(value), times) / np.sqrt(2 * mass)) ** 2)
    loaded = float(np.abs(load_N).sum() * np.ptp(value))
    forced = stiffness[drive.body : drive.body + 2].max() ** 0.4 * 2.5**0.6
    root = (start_J + hertz_J + loaded) ** 0.4 + 0.4 * forced * np.trapezoid(np.abs(rate), times)
    return float(root**2.5 + 0.5 * mass * (rate**2).max())
