"""Pulses, reflections, speeds and transmission, computed a second time from the definitions in ``postproc/README.md``.

Nothing here is imported from ``postproc.read.signals`` or ``sensors``: plain loops, polynomials through six samples.
"""

from dataclasses import dataclass
from math import isnan, nan

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

TRAIN = ("striker.mass=0.5 g", "chain.sensors=[{from_wall=14},{from_wall=8}]", "run.duration=1.6 ms")
FROM_BOTH_ENDS = "chain.bead=[{from_wall=21,velocity='-1 m/s'},{from_wall=1,velocity='1 m/s'}]"
OVERTAKEN = "chain.bead=[{from_wall=21,velocity='-2 m/s',gap_below='0.4 mm'},{from_wall=20,velocity='-0.05 m/s'}]"
SENSORS = "chain.sensors=[{from_wall=19},{from_wall=15},{from_wall=11},{from_wall=5},{from_wall=1}]"
SCENES = [
    ("fig4", ()),
    ("fig4", (SENSORS, "contact.restitution=0.8")),
    ("fig4", ("sensor.time_constant=0.2 ms",)),
    ("fig6d", TRAIN),
    ("fig6d", (*TRAIN, "striker.mass=2 g")),
    ("fig4", ("striker=", "wall=", "gravity=", FROM_BOTH_ENDS, SENSORS)),
    ("fig4", ("striker=", "gravity=", OVERTAKEN, SENSORS)),
    ("fig4", (SENSORS, "chain.precompression=20 N", "striker.speed=1 mm/s")),
    ("fig4", (SENSORS, "chain.precompression=20 N", "striker=", "chain.bead=[{from_wall=21,velocity='-1 cm/s'}]")),
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
            found.append(Maximum(place, *highest(time, s, place), s[place] - max(low)))
        k = end + 1
    return found


def highest(time: Array, s: Array, place: int) -> tuple[float, float]:
    """Time and height of the highest point of quintic polynomials on both sides of a sample."""
    best = time[place], s[place]
    step = time[1] - time[0]
    for left in (place - 1, place):
        first = min(max(left - 2, 0), len(s) - 6)
        nodes = np.arange(6.0) - (left - first)
        row = np.polyfit(nodes, s[first : first + 6], 5)
        roots = np.roots(np.polyder(row))
        for at in roots[np.abs(roots.imag) < 1e-9].real:
            if 0 <= at <= 1 and np.polyval(row, at) > best[1]:
                best = time[left] + at * step, float(np.polyval(row, at))
    return float(best[0]), float(best[1])


def pulses_of(time: Array, s: Array, largest_N: float) -> list[Maximum]:
    extent = s.max() - s.min()
    kept: list[Maximum] = []
    if extent <= 1e-9 * largest_N:
        return kept
    for each in maxima(time, s):
        before = max((other.height for other in kept), default=0.0)
        if each.prominence >= max(1e-4 * extent, 0.01 * each.height) and each.height > 0.05 * before:
            kept.append(each)
    return kept


def goes_up(force: Array, j: int, pulse: Maximum, previous: int) -> bool:
    """True if a pulse at bead j goes up; ``previous`` is the sample of the maximum before, or 0."""
    contacts = force.shape[1]
    if j == contacts:
        j = contacts - 1
    if j == 0:
        return False
    below, above = force[:, j - 1] - force[0, j - 1], force[:, j] - force[0, j]
    start = min(range(previous, pulse.sample + 1), key=lambda k: (below[k] + above[k], k))
    rise = range(start, pulse.sample + 1)
    gained = sum(below[k] - above[k] for k in rise)
    return bool(gained > 1e-6 * sum(abs(below[k]) + abs(above[k]) for k in rise))


def defined(case: Case, trace: Trace, gauges: dict[str, Array]) -> dict[str, float]:
    """Observables by their definitions, from the signals of the gauges."""
    time, force, wall = trace.time_s, trace.force_N, case.layout.wall
    largest_N = np.abs(force).max()
    values: dict[str, float] = {}
    found = {name: pulses_of(time, f - f[0], largest_N) for name, f in gauges.items()}
    ups = {}
    for sensor in case.layout.sensors:
        j, name = sensor.from_wall, f"bead_{sensor.from_wall}"
        own, previous, up = found[name], 0, []
        for pulse in own:
            up.append(goes_up(force, j, pulse, previous) and not (j == 1 and wall))
            previous = pulse.sample
        ups[name] = bool(up and up[0])
        until = len(own)
        if not wall:
            values[f"{name}_pulses"] = len(own)
        else:
            after = found["wall"][0].time_s if found["wall"] else np.inf
            back = [k for k, pulse in enumerate(own) if up[k] and pulse.time_s > after]
            until = back[0] if back else until
            values[f"{name}_pulses"] = sum(not each for each in up[:until])
            values[f"{name}_reflected_amplitude_N"] = own[back[0]].height if back else nan
            values[f"{name}_reflected_arrival_s"] = own[back[0]].time_s if back else nan
        train = [pulse for pulse, rises in zip(own[:until], up, strict=False) if not (wall and rises)]
        signal, pair = gauges[name] - gauges[name][0], train[:2]
        values[f"{name}_second_amplitude_N"] = pair[1].height if len(pair) == 2 else nan
        values[f"{name}_second_arrival_s"] = pair[1].time_s if len(pair) == 2 else nan
        between = signal[pair[0].sample : pair[1].sample + 1] if len(pair) == 2 else [nan]
        values[f"{name}_valley_N"] = min(between)
    bonds = force[:, :-1] if case.layout.striker else force
    held = [column for column in bonds.T if column[0] > 1e-9 * largest_N]
    if held:
        values["contact_loss_s"] = min([time[k] for column in held for k in np.flatnonzero(column <= 0)], default=nan)
    for name, own in found.items():
        values[f"{name}_amplitude_N"] = own[0].height if own else nan
        values[f"{name}_arrival_s"] = own[0].time_s if own else nan
    for upper, lower in zip(case.layout.sensors[:-1], case.layout.sensors[1:], strict=True):
        i, j = upper.from_wall, lower.from_wall
        one, two = (f"bead_{k}" for k in (i, j))
        travel = values[f"{two}_arrival_s"] - values[f"{one}_arrival_s"]
        seen = travel > 0 and not ups[one] and not ups[two]
        values[f"speed_{i}_to_{j}_m_s"] = (upper.height_m - lower.height_m) / travel if seen else nan
        ratio = values[f"{two}_amplitude_N"] / values[f"{one}_amplitude_N"]
        values[f"transmission_{i}_to_{j}"] = ratio ** (1 / (i - j)) if seen and not (wall and j == 1) else nan
    return values


def compare(case: Case, trace: Trace, names: str = "") -> dict[str, float]:
    """Compare the observables whose names contain a text; a small difference is one of interpolation."""
    said = observe(case.layout, trace)
    force = np.column_stack([trace.force_N, np.zeros(len(trace.force_N))])
    gauges = {
        f"bead_{s.from_wall}": (force[:, s.from_wall - 1] + force[:, s.from_wall]) / 2 for s in case.layout.sensors
    }
    if case.layout.wall:
        gauges["wall"] = force[:, 0]
    if case.layout.time_constant_s is not None:
        gauges = {name: leaked(trace.time_s, f, case.layout.time_constant_s) for name, f in gauges.items()}
    own = defined(case, trace, gauges)
    assert {name for name in said if "reflected" in name or "pulses" in name} <= own.keys()
    for name, value in own.items():
        assert isnan(said[name]) == isnan(value), (name, said[name], value)
        if names in name and not isnan(value):
            wave_N = own[name.replace("valley", "second_amplitude")] if "valley" in name else 0.0  # valleys may be 0
            assert said[name] == pytest.approx(value, rel=2e-4, abs=2e-4 * wave_N), name
    return own


def leaked(time: Array, force: Array, constant_s: float) -> Array:
    """Signal behind a first-order high-pass, by 200 steps in each interval of the samples."""
    y, change, fine = np.zeros_like(force), force - force[0], 200
    ratio = (time[1] - time[0]) / constant_s / fine
    z = 0.0
    for k in range(1, len(force)):
        for part in (np.arange(fine) + 0.5) / fine:
            z += ratio * (change[k - 1] + part * (change[k] - change[k - 1]) - z) / (1 + ratio / 2)
        y[k] = change[k] - z
    return y


@pytest.mark.parametrize(("scene", "settings"), SCENES)
def test_somebody_else_computes_the_same_from_the_text(scene: str, settings: tuple[str, ...]) -> None:
    case = case_of(scene, *settings)
    values = compare(case, exact_of(case))
    assert any(not isnan(value) for name, value in values.items() if "pulses" in name)


@pytest.mark.parametrize("kind", ["light bead", "light striker", "gaps", "head on"])
def test_the_same_pulses_are_counted_and_seen_on_random_scenes(kind: str) -> None:
    for number in range(4):
        scene = adversarial_case(kind, number, damped=number % 2 == 1).scene
        places = sorted({scene.chain.count, (scene.chain.count + 1) // 2, 1} - {0}, reverse=True)
        sensors = tuple(Sensor(from_wall=place) for place in places if place <= scene.chain.count)
        case = build_case(scene.model_copy(update={"chain": scene.chain.model_copy(update={"sensors": sensors})}))
        trace = verlet_of(case)
        compare(case, part_of(trace, slice(None, None, max(1, len(trace.time_s) // SAMPLES))), "pulses")
