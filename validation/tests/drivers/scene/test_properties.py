"""Properties of random scenes: conservation laws, scaling, and codes that move as their scheme."""

from copy import deepcopy
from math import ceil, pi, sqrt
from typing import Any

import numpy as np
import pytest
from hypothesis import given, reject, settings
from hypothesis import strategies as st

from drivers.base.errors import InputError
from drivers.chain.case import Case, build_case
from drivers.chain.trace import Trace
from drivers.engines import codes
from drivers.limits.refusal import inability
from drivers.run.compute import compute
from drivers.run.guard import energy_error
from drivers.scene.read_scene import make_scene
from validation.accuracy.budget import budget_of
from validation.accuracy.exact_motion import exact_motion_of
from validation.checks import FAIL
from validation.tests.helpers.runs import need

Tables = dict[str, Any]
FACTORS = st.floats(0.01, 100)
# tolerances; largest of 500 random scenes: 2e-11 (with a large energy of precompression), 2e-14, 4e-12
ENERGY_TOLERANCE, MOMENTUM_TOLERANCE, SCALING_TOLERANCE = 1e-9, 1e-13, 1e-10


def fixed_number(examples: int) -> settings:
    """Settings for a given number of examples, the same each time."""
    return settings(max_examples=examples, deadline=None, derandomize=True, database=None)


def decades(low: float, high: float) -> st.SearchStrategy[float]:
    """Numbers whose logarithms are uniform."""
    return st.floats(np.log10(low), np.log10(high)).map(lambda exponent: float(10.0**exponent))


def text_of(value: float, unit: str) -> str:
    return f"{float(value)!r} {unit}"


@st.composite
def scenes(draw: st.DrawFn, *, loads: bool = True, walls: tuple[str, ...] = ("brass", "rigid", "m"),
           strikers: tuple[str, ...] = ("flat", "sphere")) -> Tables:  # fmt: skip
    """Tables of a random scene file; the scene defines the materials ``m`` and ``odd``."""
    count, diameter_m, modulus_Pa = draw(st.integers(1, 30)), draw(decades(1e-3, 20e-3)), draw(decades(1e8, 210e9))
    speed_m_s, density, stiffer = draw(decades(0.01, 10)), draw(st.floats(1000, 9000)), draw(decades(0.1, 10))
    bead_kg = density * pi / 6 * diameter_m**3
    stiffness = modulus_Pa * sqrt(diameter_m) / 3
    collision_s = (bead_kg**2 / (stiffness**2 * speed_m_s)) ** 0.2
    velocity = st.floats(-1, 1).map(lambda share: text_of(round(share, 6) * speed_m_s, "m/s"))
    sizes = decades(0.5, 2).map(lambda ratio: text_of(ratio * diameter_m, "m"))
    masses = decades(0.1, 10).map(lambda ratio: text_of(ratio * bead_kg, "kg"))
    gaps = decades(0.01, 10).map(lambda ratio: text_of(ratio * speed_m_s * collision_s, "m"))
    optional = {"diameter": sizes, "mass": masses, "material": st.just("odd"), "gap_below": gaps}

    shape = draw(st.sampled_from((None, *strikers)))
    struck = shape is not None
    beads: list[Tables] = [
        draw(st.fixed_dictionaries({"from_wall": st.just(place)}, optional=optional | {"velocity": velocity}))
        for place in draw(st.lists(st.integers(1, count), max_size=4, unique=True))
    ]
    if not struck:
        moving: Tables = next((bead for bead in beads if bead["from_wall"] == count), {"from_wall": count})
        beads = [*(bead for bead in beads if bead is not moving), moving]
        moving["velocity"] = text_of(-speed_m_s, "m/s")
    samples, share = draw(st.integers(20, 60)), draw(st.floats(0.3, 1))
    interval_s = collision_s * (2 * count + 10) * share / samples
    step_s = interval_s / ceil(interval_s / collision_s * draw(st.integers(10, 40)))
    data: Tables = {
        "chain": {"count": count, "material": "m", "diameter": text_of(diameter_m, "m"), "bead": beads},
        "materials": {
            name: {"youngs_modulus": text_of(ratio * modulus_Pa, "Pa"), "poisson_ratio": draw(st.floats(0, 0.49)),
                   "density": text_of(density, "kg/m^3")}
            for name, ratio in (("m", 1), ("odd", stiffer))
        },
        "run": {"duration": text_of(interval_s * samples, "s"), "sample_interval": text_of(interval_s, "s"),
                "time_step": text_of(step_s, "s")},
    }  # fmt: skip
    if struck:
        data["striker"] = {"shape": shape, "material": draw(st.sampled_from(("m", "odd"))), "mass": draw(masses)}
        data["striker"] |= {"speed": text_of(speed_m_s, "m/s")} | ({"diameter": draw(sizes)} if shape != "flat" else {})
    if draw(st.booleans()):
        data["chain"]["mass"] = draw(masses)
    if walls and draw(st.sampled_from((True, True, True, False))):
        data["wall"] = {"material": draw(st.sampled_from(walls))}
    if loads and draw(st.booleans()):
        data["gravity"] = text_of(draw(decades(0.1, 100)), "m/s^2")
    if loads and draw(st.booleans()):
        force_N = draw(decades(1e-4, 1)) * stiffness * (collision_s * speed_m_s) ** 1.5
        data["chain"]["precompression"] = text_of(force_N, "N")
    return data


def case_of(data: Tables) -> Case:
    try:
        return build_case(make_scene(deepcopy(data), "drawn", "a drawn scene"))
    except InputError:
        reject()


def motion_of(case: Case) -> Trace:
    return exact_motion_of(case, finer=False).trace


def largest_momentum_N_s(case: Case, trace: Trace) -> float:
    """Upper bound of the momentum, from the kinetic energy."""
    return float(np.sqrt(2 * trace.kinetic_energy_J.max() * case.chain.mass_kg.sum()))


def rescaled(value: Any, factors: dict[str, float], factor: float | None = None) -> Any:
    """Tables with the quantities of some keys multiplied by their factors."""
    if isinstance(value, dict):
        return {key: rescaled(each, factors, factors.get(key)) for key, each in value.items()}
    if isinstance(value, list):
        return [rescaled(each, factors) for each in value]
    if factor is None:
        return value
    number, unit = value.split()
    return text_of(float(number) * factor, unit)


@given(scenes())
@fixed_number(20)
def test_energy_is_conserved(data: Tables) -> None:
    case = case_of(data)
    assert energy_error(case.chain, motion_of(case)).max() < ENERGY_TOLERANCE


@given(scenes(walls=()))
@fixed_number(20)
def test_free_chain_has_the_momentum_of_its_loads(data: Tables) -> None:
    case = case_of(data)
    trace = motion_of(case)
    change = trace.momentum_N_s - trace.momentum_N_s[0] - case.chain.load_N.sum() * trace.time_s
    assert np.abs(change).max() <= MOMENTUM_TOLERANCE * largest_momentum_N_s(case, trace)


@given(scenes(walls=("rigid", "m")), FACTORS, FACTORS, st.floats(0.3, 3))
@fixed_number(20)
def test_moduli_masses_and_speeds_scale_times_and_forces(data: Tables, a: float, b: float, c: float) -> None:
    """Dimensional analysis: lengths scale as (m v^2 / k)^(2/5), times as (m^2 / (k^2 v))^(1/5), forces as k x^(3/2)."""
    length, time, force = (b * c**2 / a) ** 0.4, (b**2 / (a**2 * c)) ** 0.2, (a**2 * b**3 * c**6) ** 0.2
    factors = {"youngs_modulus": a, "density": b, "mass": b, "speed": c, "velocity": c, "gap_below": length}
    factors |= dict.fromkeys(("duration", "sample_interval", "time_step"), time)
    factors |= {"gravity": c / time, "precompression": force}
    case, other = case_of(data), case_of(rescaled(data, factors))
    one_N, other_N = motion_of(case).force_N, motion_of(other).force_N
    assert np.abs(other_N / force - one_N).max() <= SCALING_TOLERANCE * one_N.max()


@pytest.mark.long
@given(scenes())
@fixed_number(12)
def test_codes_move_as_their_scheme(data: Tables) -> None:
    """All that a deck says of a chain moves it: places, sizes, masses, stiffnesses, velocities, loads."""
    case = case_of(data)
    for engine in codes():
        need(engine)
        if inability(case, engine) is None:
            checks = budget_of(case, engine, compute(case, engine).done).checks
            verdicts = {check.quantity: check.verdict for check in checks if check.quantity.startswith("model: ")}
            assert verdicts.keys() == {"model: force", "model: energy", "model: momentum"}
            assert FAIL not in verdicts.values(), engine
