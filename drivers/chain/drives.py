"""Wave forms of drives as tables of segments (``Drive`` of ``validation.reference``).

Before ``drive.start`` a drive is 0; after its end it holds its last value, and a half-sine returns to 0. A new form is
a function here, an entry of ``FORMS``, and its keys in ``drivers.scene.model`` and ``drivers.scene.rules``.
"""

from collections.abc import Callable, Sequence
from math import ceil, inf, pi
from typing import Any

import numpy as np

from drivers.base.units import quantity
from drivers.scene.model import DriveTable, Scene
from drivers.scene.settings import unit_of
from validation.reference.hertz_chain import COLUMNS, SAME_TIME, SINES, Drive

ROUNDED = 1e-12  # of the amplitude: a smaller value at the end of a wave is 0


def _segment(begin_s: float, value: float = 0.0, rate: float = 0.0, *sines: float) -> list[float]:
    """Row of a table of segments; for each sine amplitude, phase, angular frequency and its rate."""
    return [begin_s, value, rate, *sines, *[0.0] * (COLUMNS - 3 - len(sines))]


def _lines(time_s: Sequence[float], value: Sequence[float]) -> list[list[float]]:
    """Straight lines between points, and the last value after them."""
    rates = np.append(np.diff(value) / np.diff(time_s), 0.0)
    return [_segment(*row) for row in zip(time_s, value, rates.tolist(), strict=True)]


def _half_sine(amplitude: float, table: DriveTable) -> list[list[float]]:
    duration = table.duration or inf
    return [_segment(0.0, 0.0, 0.0, amplitude, 0.0, pi / duration, 0.0), _segment(duration)]


def _sine(amplitude: float, table: DriveTable) -> list[list[float]]:
    """Sine, or chirp: its frequency changes at a constant rate."""
    first = table.frequency or inf
    duration = table.duration or (table.cycles / first if table.cycles else inf)
    turning, sweep = 2 * pi * first, 2 * pi * ((table.end_frequency or first) - first) / duration
    if table.window == "hann":  # (1 - cos(2 pi tau / duration)) / 2 makes it a sum of three
        sides = [(-amplitude / 4, 0.0, turning + shift, sweep) for shift in (2 * pi / duration, -2 * pi / duration)]
        return [_segment(0.0, 0.0, 0.0, amplitude / 2, 0.0, turning, sweep, *sides[0], *sides[1]), _segment(duration)]
    angle = duration * (turning + 0.5 * sweep * duration) if duration < inf else 0.0
    left = float(np.sin(angle))
    end = amplitude * left if abs(left) > ROUNDED * (1 + angle) else 0.0
    return [_segment(0.0, 0.0, 0.0, amplitude, 0.0, turning, sweep), _segment(duration, end)]


FORMS: dict[str, Callable[[float, DriveTable], list[list[float]]]] = {
    "sine": _sine,
    "half-sine": _half_sine,
    "step": lambda amplitude, table: _lines([0.0], [amplitude]),
    "ramp": lambda amplitude, table: _lines([0.0, table.duration or inf], [0.0, amplitude]),
    "chirp": _sine,
    "file": lambda amplitude, table: _lines(table.time_s, table.force_N or table.displacement_m),
}


def drive_of(scene: Scene) -> Drive | None:
    """Drive of a scene; None if it has none."""
    table = scene.drive
    if table is None:
        return None
    amplitude = table.displacement if table.prescribed else table.force
    rows = np.array([row for row in FORMS[table.form](amplitude or 0.0, table) if row[0] < inf])
    rows[:, 0] += table.start
    if rows[0, 0] > 0:
        rows = np.vstack([_segment(0.0), rows])
    return Drive((table.from_wall or scene.bodies) - 1, table.prescribed, rows)


def drive_words(scene: Scene) -> str:
    """Description of a drive, such as ``drive of bead 20: form sine, force 0.5 N, frequency 5 kHz``; else empty."""
    table = scene.drive
    if table is None:
        return ""
    place = table.from_wall or scene.bodies
    parts = [f"drive of {'the striker' if place > scene.chain.count else f'bead {place}'}: form {table.form}"]
    said = {"form", "from_wall", "time_s", "force_N", "displacement_m"}
    for key, value in sorted(table.model_dump(exclude=said, exclude_none=True).items()):
        unit = unit_of(f"drive.{key}")
        parts.append(f"{key.replace('_', ' ')} {quantity(value, unit) if unit else value}")
    return ", ".join([*parts, *([f"{len(table.time_s)} points"] if table.time_s else [])])


def pieces_of(drive: Drive | None, time_step_s: float, steps: int) -> list[dict[str, Any]]:
    """Segments with at least one step of a run, for templates of decks; empty without a drive.

    Their keys are ``first`` and ``until``, the first and the last step; ``begin_s``, ``value`` and ``rate``, the time,
    value and rate at the beginning; and ``sines``, amplitude, phase, angular frequency and its rate of each sine.
    """
    if drive is None:
        return []
    firsts = [ceil(begin / (time_step_s * SAME_TIME)) for begin in drive.segments[:, 0].tolist()]
    untils = [min(first - 1, steps) for first in [*firsts[1:], steps + 1]]
    pieces = []
    for first, until, row in zip(firsts, untils, drive.segments.tolist(), strict=True):
        if first <= until:
            sines = [row[place : place + 4] for place in SINES if row[place]]
            values = dict(zip(("begin_s", "value", "rate"), row, strict=False))
            pieces.append({"first": first, "until": until, **values, "sines": sines})
    return pieces
