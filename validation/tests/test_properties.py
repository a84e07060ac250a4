"""Any scene that can be drawn: what motions keep, how they scale, and what decks say of the scene."""

from copy import deepcopy
from math import ceil, pi, sqrt
from typing import Any

import numpy as np
from hypothesis import assume, given, reject, settings
from hypothesis import strategies as st

from drivers import paths
from drivers.case import Case, build_case
from drivers.chain import Array
from drivers.errors import InputError
from drivers.guard import energy_error
from drivers.read_scene import make_scene, read_toml
from drivers.trace import Trace
from validation.arrays import arrays_of
from validation.errors import trace_of, truth_of
from validation.reference.verlet import integrate_verlet

Tables = dict[str, Any]
LIBRARY = read_toml(paths.MATERIALS)
FACTORS = st.floats(0.01, 100)
LOADED = {"gravity", "precompression"}


def some(examples: int) -> settings:
    return settings(max_examples=examples, deadline=None, derandomize=True, database=None)


def decades(low: float, high: float) -> st.SearchStrategy[float]:
    return st.floats(np.log10(low), np.log10(high)).map(lambda exponent: float(10.0**exponent))


def text_of(value: float, unit: str) -> str:
    return f"{float(value)!r} {unit}"


@st.composite
def scenes(draw: st.DrawFn, *, loads: bool = True, walls: tuple[str, ...] = ("brass", "rigid", "m"),
           strikers: tuple[str, ...] = ("flat", "sphere")) -> Tables:  # fmt: skip
    """Tables of a scene file; ``m`` and ``odd`` are materials of the scene's own."""
    count, diameter_m, modulus_Pa = draw(st.integers(1, 30)), draw(decades(1e-3, 20e-3)), draw(decades(1e8, 210e9))
    speed_m_s, density, stiffer = draw(decades(0.01, 10)), draw(st.floats(1000, 9000)), draw(decades(0.1, 10))
    bead_kg = density * pi / 6 * diameter_m**3
    stiffness = modulus_Pa * sqrt(diameter_m) / 3
    collision_s = (bead_kg**2 / (stiffness**2 * speed_m_s)) ** 0.2
    velocity = st.floats(-1, 1).map(lambda share: text_of(share * speed_m_s, "m/s"))
    sizes = decades(0.5, 2).map(lambda ratio: text_of(ratio * diameter_m, "m"))
    masses = decades(0.1, 10).map(lambda ratio: text_of(ratio * bead_kg, "kg"))
    gaps = decades(0.01, 10).map(lambda ratio: text_of(ratio * speed_m_s * collision_s, "m"))
    particular = {"diameter": sizes, "mass": masses, "material": st.just("odd"), "gap_below": gaps}

    shape = draw(st.sampled_from((None, *strikers)))
    struck = shape is not None
    beads = [
        draw(st.fixed_dictionaries({"from_wall": st.just(place)}, optional=particular | {"velocity": velocity}))
        for place in draw(st.lists(st.integers(1, count), max_size=4, unique=True))
    ]
    if not struck:
        moving = next((bead for bead in beads if bead["from_wall"] == count), {"from_wall": count})
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
    if walls and draw(st.integers(0, 3)):
        data["wall"] = {"material": draw(st.sampled_from(walls))}
    if loads and draw(st.booleans()):
        data["gravity"] = text_of(draw(decades(0.1, 100)), "m/s^2")
    if loads and draw(st.booleans()):
        force_N = draw(decades(1e-4, 1)) * stiffness * (collision_s * speed_m_s) ** 1.5
        data["chain"]["precompression"] = text_of(force_N, "N")
    return data


def case_of(data: Tables) -> Case:
    try:
        return build_case(make_scene(deepcopy(data), LIBRARY, "drawn", "a drawn scene"))
    except InputError:
        reject()


def motion_of(case: Case) -> Trace:
    return truth_of(case, finer=False).trace


def moved(trace: Trace) -> Array:
    assert trace.velocity_m_s is not None
    return trace.velocity_m_s


def rescaled(value: Any, factors: dict[str, float]) -> Any:
    """Tables with the quantities under some keys multiplied."""
    if isinstance(value, list):
        return [rescaled(each, factors) for each in value]
    if not isinstance(value, dict):
        return value
    return {
        key: times(each, factors[key]) if key in factors else rescaled(each, factors) for key, each in value.items()
    }


def times(quantity: str, factor: float) -> str:
    number, unit = quantity.split()
    return text_of(float(number) * factor, unit)


def turned_round(data: Tables, case: Case) -> Tables:
    """The bodies of a free chain from the top down, a striker among them as a bead."""
    chain = case.chain
    gap_m = np.append(0.0, np.maximum(-chain.overlap_m[:0:-1], 0.0))  # contact j lies under body j, turned round above
    beads = [
        {
            "from_wall": place,
            "diameter": text_of(2 * chain.radius_m[-place], "m"),
            "mass": text_of(chain.mass_kg[-place], "kg"),
            "material": chain.materials[-place],
            "velocity": text_of(-chain.velocity_m_s[-place], "m/s"),
            "gap_below": text_of(gap_m[place - 1], "m"),
        }
        for place in range(1, chain.bodies + 1)
    ]
    table = data["chain"] | {"count": chain.bodies, "bead": beads}
    return {key: data[key] for key in ("materials", "run")} | {"chain": table}


@given(scenes())
@some(60)
def test_energy_is_conserved(data: Tables) -> None:
    case = case_of(data)
    assert energy_error(case.chain, motion_of(case)).max() < 1e-9


@given(scenes(walls=()))
@some(60)
def test_a_free_chain_has_the_momentum_of_its_loads(data: Tables) -> None:
    case = case_of(data)
    trace = motion_of(case)
    change = trace.momentum_N_s - trace.momentum_N_s[0] - case.chain.load_N.sum() * trace.time_s
    scale = (np.abs(moved(trace)) @ case.chain.mass_kg).max()
    assert np.abs(change).max() <= 1e-12 * scale


@given(scenes())
@some(60)
def test_the_scheme_gets_its_momentum_from_the_wall_and_the_loads(data: Tables) -> None:
    """Velocity Verlet kicks by trapezoids, so that sampled at every step nothing is left over."""
    case = case_of(data)
    step_s, samples = case.scene.time_step_s, case.scene.steps + 1
    motion = integrate_verlet(arrays_of(case.chain), step_s, 1, samples)
    trace = trace_of(case, step_s * np.arange(samples), motion)
    net_N = trace.force_N[:, 0] + case.chain.load_N.sum()
    impulse = np.append(0.0, np.cumsum(0.5 * step_s * (net_N[1:] + net_N[:-1])))
    given_N_s = np.abs(case.chain.load_N).sum() * trace.time_s[-1] + step_s * np.abs(trace.force_N[:, 0]).sum()
    scale = (np.abs(moved(trace)) @ case.chain.mass_kg).max() + given_N_s
    assert np.abs(trace.momentum_N_s - trace.momentum_N_s[0] - impulse).max() <= 1e-12 * scale


@given(scenes(loads=False, walls=(), strikers=("sphere",)))
@some(60)
def test_a_chain_turned_round_has_the_same_forces(data: Tables) -> None:
    case = case_of(data)
    force_N = motion_of(case).force_N[:, 1:]
    assume(force_N.size and force_N.max() > 0)
    turned_N = motion_of(case_of(turned_round(data, case))).force_N[:, 1:]
    assert np.abs(turned_N[:, ::-1] - force_N).max() < 1e-9 * force_N.max()


@given(scenes(walls=("rigid", "m")), FACTORS, FACTORS, st.floats(0.3, 3))
@some(60)
def test_moduli_masses_and_speeds_scale_times_and_forces(data: Tables, a: float, b: float, c: float) -> None:
    """Of dimensional analysis: a length (m v^2 / k)^(2/5), a time (m^2 / (k^2 v))^(1/5), a force k length^(3/2)."""
    length, time, force = (b * c**2 / a) ** 0.4, (b**2 / (a**2 * c)) ** 0.2, (a**2 * b**3 * c**6) ** 0.2
    factors = {"youngs_modulus": a, "density": b, "mass": b, "speed": c, "velocity": c, "gap_below": length}
    factors |= dict.fromkeys(("duration", "sample_interval", "time_step"), time)
    factors |= {"gravity": c / time, "precompression": force}
    case, other = case_of(data), case_of(rescaled(data, factors))
    one_N, other_N = motion_of(case).force_N, motion_of(other).force_N
    assert np.abs(other_N / force - one_N).max() < 1e-9 * one_N.max()


def arrival_s(data: Tables, contact: int) -> float:
    """When a contact first bears a tenth of the most it ever does."""
    trace = motion_of(case_of(data))
    force_N = trace.force_N[:, contact - 1]
    level_N = 0.1 * force_N.max()
    after = int(np.argmax(force_N > level_N))
    assert after
    near = slice(after - 1, after + 1)
    return float(np.interp(level_N, force_N[near], trace.time_s[near]))


@given(
    scenes(loads=False, walls=(), strikers=("flat", "sphere")),
    st.sampled_from(("speed", "youngs_modulus", "mass")),
    st.floats(1.05, 3),
)
@some(60)
def test_speed_stiffness_and_lightness_make_a_wave_arrive_earlier(data: Tables, what: str, factor: float) -> None:
    assume(False)
