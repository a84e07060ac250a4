"""Pulses, reflections, speeds and transmission, computed a second time from the definitions in ``postproc/README.md``.

Nothing here is imported from ``postproc.read.signals`` or ``sensors``: plain loops, parabolas through three samples.
"""

from dataclasses import dataclass
from math import inf, isnan, nan

import numpy as np
import pytest

from drivers.chain.case import Case, build_case
from drivers.chain.chain import Array
from drivers.chain.schemes import exact_of, verlet_of
from drivers.chain.trace import Trace, part_of
from drivers.scene.model import Sensor
from postproc.read.observables import observe
from validation.tests.helpers.adversarial import adversarial_case
from validation.tests.helpers.scenes import case_of

FROM_BOTH_ENDS = "chain.bead=[{from_wall=21,velocity='-1 m/s'},{from_wall=1,velocity='1 m/s'}]"
OVERTAKEN = "chain.bead=[{from_wall=21,velocity='-2 m/s',gap_below='0.4 mm'},{from_wall=20,velocity='-0.05 m/s'}]"
SENSORS = "chain.sensors=[{from_wall=19},{from_wall=15},{from_wall=11},{from_wall=5},{from_wall=1}]"
SCENES = [
    ("fig4", (SENSORS, "contact.restitution=0.8")),
    ("fig6d", ("striker.mass=0.5 g", "chain.sensors=[{from_wall=14},{from_wall=8}]", "run.duration=1.6 ms")),
    ("fig4", ("striker=", "wall=", "gravity=", FROM_BOTH_ENDS, SENSORS)),
    ("fig4", ("striker=", "gravity=", OVERTAKEN, SENSORS)),
    ("fig4", (SENSORS, "chain.precompression=20 N", "striker.speed=1 mm/s")),
]
SAMPLES = 1500


@dataclass
class Maximum:
    """A maximum of a signal between samples; its prominence is that of the largest sample."""

    sample: int
    time_s: float
    height: float
    prominence: float


def maxima(time: Array, s: Array) -> list[Maximum]:
    """All maxima of a signal, as defined."""
    found = []
    k = 1
    while k < len(s) - 1:
        end = k
        while end < len(s) - 1 and s[end + 1] == s[k]:
            end += 1
        if s[k - 1] < s[k] and end < len(s) - 1 and s[end + 1] < s[k]:
            place = (k + end) // 2
            low = []
            for way in (-1, 1):
                least, at = s[place], place
                while 0 <= at < len(s) and s[at] <= s[place]:
                    least, at = min(least, s[at]), at + way
                low.append(least)
            left, right = s[place] - s[place - 1], s[place] - s[place + 1]
            shift = (left - right) / (left + right) / 2 if left + right else 0.0
            top, moment = s[place] + (left - right) * shift / 4, time[place] + shift * (time[1] - time[0])
            found.append(Maximum(place, float(moment), float(top), s[place] - max(low)))
        k = end + 1
    return found


def pulses_of(time: Array, s: Array, largest_N: float) -> list[Maximum]:
    """Pulses of a signal without its static load."""
    extent = s.max() - s.min()
    kept: list[Maximum] = []
    if extent <= 1e-9 * largest_N:
        return kept
    for maximum in maxima(time, s):
        before = max((pulse.height for pulse in kept), default=0.0)
        if maximum.prominence >= max(1e-4 * extent, 0.01 * maximum.height) and maximum.height > 0.05 * before:
            kept.append(maximum)
    return kept


def goes_up(force: Array, j: int, pulse: Maximum, previous: int) -> bool:
    """True if a pulse at bead j goes up; ``previous`` is the sample of the maximum before, or 0."""
    j = min(j, force.shape[1] - 1)
    if j == 0:
        return False
    below, above = force[:, j - 1] - force[0, j - 1], force[:, j] - force[0, j]
    start = min(range(previous, pulse.sample + 1), key=lambda k: (below[k] + above[k], k))
    rise = range(start, pulse.sample + 1)
    gained = sum(below[k] - above[k] for k in rise)
    return bool(gained > 1e-6 * sum(abs(below[k]) + abs(above[k]) for k in rise))


def defined(case: Case, trace: Trace) -> dict[str, float]:
    """Observables by their definitions."""
    time, force, wall = trace.time_s, np.column_stack([trace.force_N, 0 * trace.time_s]), case.layout.wall
    largest_N = np.abs(force).max()
    gauges = {
        f"bead_{sensor.from_wall}": force[:, sensor.from_wall - 1 : sensor.from_wall + 1].mean(axis=1)
        for sensor in case.layout.sensors
    }
    gauges |= {"wall": force[:, 0]} if wall else {}
    signals = {name: signal - signal[0] for name, signal in gauges.items()}
    pulses = {name: pulses_of(time, signal, largest_N) for name, signal in signals.items()}
    after = pulses["wall"][0].time_s if wall and pulses["wall"] else inf
    values: dict[str, float] = {}
    first_goes_up = {}
    for name, own in pulses.items():
        values[f"{name}_amplitude_N"] = own[0].height if own else nan
        values[f"{name}_arrival_s"] = own[0].time_s if own else nan
    for sensor in case.layout.sensors:
        j, name = sensor.from_wall, f"bead_{sensor.from_wall}"
        own = pulses[name]
        before = [0, *(pulse.sample for pulse in own[:-1])]
        up = [goes_up(trace.force_N, j, *pair) and not (j == 1 and wall) for pair in zip(own, before, strict=False)]
        first_goes_up[name] = bool(up and up[0])
        back = [k for k, pulse in enumerate(own) if up[k] and pulse.time_s > after]
        train = [pulse for k, pulse in enumerate(own[: back[0] if back else None]) if not (wall and up[k])]
        values[f"{name}_pulses"] = len(train)
        if wall:
            values[f"{name}_reflected_amplitude_N"] = own[back[0]].height if back else nan
            values[f"{name}_reflected_arrival_s"] = own[back[0]].time_s if back else nan
        two = len(train) > 1
        values[f"{name}_second_amplitude_N"] = train[1].height if two else nan
        values[f"{name}_second_arrival_s"] = train[1].time_s if two else nan
        values[f"{name}_valley_N"] = min(signals[name][train[0].sample : train[1].sample + 1]) if two else nan
    bonds = trace.force_N[:, :-1] if case.layout.striker else trace.force_N
    held = [column for column in bonds.T if column[0] > 1e-9 * largest_N]
    if held:
        values["contact_loss_s"] = min([time[k] for column in held for k in np.flatnonzero(column <= 0)], default=nan)
    for upper, lower in zip(case.layout.sensors[:-1], case.layout.sensors[1:], strict=True):
        i, j = upper.from_wall, lower.from_wall
        travel = values[f"bead_{j}_arrival_s"] - values[f"bead_{i}_arrival_s"]
        seen = travel > 0 and not first_goes_up[f"bead_{i}"] and not first_goes_up[f"bead_{j}"]
        values[f"speed_{i}_to_{j}_m_s"] = (upper.height_m - lower.height_m) / travel if seen else nan
        ratio = values[f"bead_{j}_amplitude_N"] / values[f"bead_{i}_amplitude_N"]
        values[f"transmission_{i}_to_{j}"] = ratio ** (1 / (i - j)) if seen and not (wall and j == 1) else nan
    return values


def compare(case: Case, trace: Trace, names: str = "") -> None:
    """Compare the observables whose names contain a text; a small difference is one of interpolation."""
    observed, values = observe(case.layout, trace), defined(case, trace)
    assert {name for name in observed if "reflected" in name or "pulses" in name} <= values.keys()
    for name, value in values.items():
        assert isnan(observed[name]) == isnan(value), (name, observed[name], value)
        if names in name and not isnan(value):
            wave_N = values[name.replace("valley", "second_amplitude")] if "valley" in name else 0.0  # valleys may be 0
            assert observed[name] == pytest.approx(value, rel=2e-4, abs=2e-4 * wave_N), name
    assert any(value > 0 for name, value in values.items() if "pulses" in name)


@pytest.mark.parametrize(("scene", "settings"), SCENES)
def test_observables_are_as_defined(scene: str, settings: tuple[str, ...]) -> None:
    case = case_of(scene, *settings)
    compare(case, exact_of(case))


@pytest.mark.parametrize("kind", ["light bead", "light striker", "gaps", "head on"])
def test_pulses_of_random_scenes_are_as_defined(kind: str) -> None:
    for number in range(2):
        scene = adversarial_case(kind, number, damped=number % 2 == 1).scene
        places = sorted({scene.chain.count, (scene.chain.count + 1) // 2, 1} - {0}, reverse=True)
        sensors = tuple(Sensor(from_wall=place) for place in places if place <= scene.chain.count)
        case = build_case(scene.model_copy(update={"chain": scene.chain.model_copy(update={"sensors": sensors})}))
        trace = verlet_of(case)
        compare(case, part_of(trace, slice(None, None, max(1, len(trace.time_s) // SAMPLES))), "pulses")
