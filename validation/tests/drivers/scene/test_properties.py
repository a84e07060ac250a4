"""Properties of random scenes: conservation laws, symmetry, scaling, and decks that contain the chain exactly."""

import json
import re
from copy import deepcopy
from itertools import pairwise
from math import ceil, inf, pi, sqrt
from typing import Any

import numpy as np
from hypothesis import assume, given, reject, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from drivers.base import paths
from drivers.base.decks import Deck
from drivers.base.errors import InputError
from drivers.chain.case import Case, build_case
from drivers.chain.chain import Array, arrays_of
from drivers.chain.contact_law import hertz_stiffness
from drivers.chain.schemes import trace_of
from drivers.chain.trace import Trace
from drivers.engines import engine_names, load_engine
from drivers.run.guard import energy_error
from drivers.scene.model import Material
from drivers.scene.read_scene import make_scene, read_toml
from validation.accuracy.exact_motion import exact_motion_of
from validation.reference.velocity_verlet import integrate_verlet

Tables = dict[str, Any]
LIBRARY = read_toml(paths.MATERIALS)
FACTORS = st.floats(0.01, 100)
# tolerances; largest of 500 random scenes: 2e-11 (with a large energy of precompression), 2e-14, 7e-13, 4e-12
ENERGY_TOLERANCE, MOMENTUM_TOLERANCE, REVERSAL_TOLERANCE, SCALING_TOLERANCE = 1e-9, 1e-13, 1e-11, 1e-10


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
        return build_case(make_scene(deepcopy(data), LIBRARY, "drawn", "a drawn scene"))
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


def reversed_scene(data: Tables, case: Case) -> Tables:
    """Scene with the bodies of a free chain in reverse order; the striker becomes a bead."""
    chain = case.chain
    gap_m = np.append(0.0, np.maximum(-chain.overlap_m[:0:-1], 0.0))  # contact j is below body j, reversed above it
    columns = {"diameter": (2 * chain.radius_m[::-1], "m"), "mass": (chain.mass_kg[::-1], "kg"),
               "velocity": (-chain.velocity_m_s[::-1], "m/s"), "gap_below": (gap_m, "m")}  # fmt: skip
    beads = [
        {"from_wall": i + 1, "material": chain.materials[-1 - i]}
        | {key: text_of(values[i], unit) for key, (values, unit) in columns.items()}
        for i in range(chain.bodies)
    ]
    table = data["chain"] | {"count": chain.bodies, "bead": beads}
    return {key: data[key] for key in ("materials", "run")} | {"chain": table}


@given(scenes())
@fixed_number(60)
def test_energy_is_conserved(data: Tables) -> None:
    case = case_of(data)
    assert energy_error(case.chain, motion_of(case)).max() < ENERGY_TOLERANCE


@given(scenes(walls=()))
@fixed_number(60)
def test_a_free_chain_has_the_momentum_of_its_loads(data: Tables) -> None:
    case = case_of(data)
    trace = motion_of(case)
    change = trace.momentum_N_s - trace.momentum_N_s[0] - case.chain.load_N.sum() * trace.time_s
    assert np.abs(change).max() <= MOMENTUM_TOLERANCE * largest_momentum_N_s(case, trace)


@given(scenes())
@fixed_number(60)
def test_momentum_in_verlet_comes_from_the_wall_and_the_loads(data: Tables) -> None:
    """Velocity Verlet integrates forces by the trapezoidal rule: with samples at every step the sums agree."""
    case = case_of(data)
    step_s, samples = case.scene.time_step_s, case.scene.steps + 1
    motion = integrate_verlet(arrays_of(case.chain), step_s, 1, samples)
    trace = trace_of(case, step_s * np.arange(samples, dtype=float), motion)
    net_N = trace.force_N[:, 0] + case.chain.load_N.sum()
    impulse = np.append(0.0, np.cumsum(0.5 * step_s * (net_N[1:] + net_N[:-1])))
    given_N_s = np.abs(case.chain.load_N).sum() * trace.time_s[-1] + step_s * np.abs(trace.force_N[:, 0]).sum()
    scale = largest_momentum_N_s(case, trace) + given_N_s
    error_N_s = np.abs(trace.momentum_N_s - trace.momentum_N_s[0] - impulse).max()
    assert error_N_s <= MOMENTUM_TOLERANCE * scale


@given(scenes(loads=False, walls=(), strikers=("sphere",)))
@fixed_number(60)
def test_a_reversed_chain_has_the_same_forces(data: Tables) -> None:
    case = case_of(data)
    force_N = motion_of(case).force_N[:, 1:]
    assume(force_N.size and force_N.max() > 0)
    reversed_N = motion_of(case_of(reversed_scene(data, case))).force_N[:, 1:]
    assert np.abs(reversed_N[:, ::-1] - force_N).max() < REVERSAL_TOLERANCE * force_N.max()


@given(scenes(walls=("rigid", "m")), FACTORS, FACTORS, st.floats(0.3, 3))
@fixed_number(60)
def test_moduli_masses_and_speeds_scale_times_and_forces(data: Tables, a: float, b: float, c: float) -> None:
    """Dimensional analysis: lengths scale as (m v^2 / k)^(2/5), times as (m^2 / (k^2 v))^(1/5), forces as k x^(3/2)."""
    length, time, force = (b * c**2 / a) ** 0.4, (b**2 / (a**2 * c)) ** 0.2, (a**2 * b**3 * c**6) ** 0.2
    factors = {"youngs_modulus": a, "density": b, "mass": b, "speed": c, "velocity": c, "gap_below": length}
    factors |= dict.fromkeys(("duration", "sample_interval", "time_step"), time)
    factors |= {"gravity": c / time, "precompression": force}
    case, other = case_of(data), case_of(rescaled(data, factors))
    one_N, other_N = motion_of(case).force_N, motion_of(other).force_N
    assert np.abs(other_N / force - one_N).max() <= SCALING_TOLERANCE * one_N.max()


def arrival_s(data: Tables, contact: int) -> float:
    """Time at which the force of a contact first exceeds a tenth of its maximum."""
    trace = motion_of(case_of(data))
    force_N = trace.force_N[:, contact - 1]
    level_N = 0.1 * force_N.max()
    after = int(np.argmax(force_N > level_N))
    assert after > 0
    near = slice(after - 1, after + 1)
    return float(np.interp(level_N, force_N[near], trace.time_s[near]))


@given(scenes(loads=False, walls=()), st.floats(1.05, 3), st.integers(4, 30))
@fixed_number(30)
def test_waves_arrive_earlier_with_faster_strikers_stiffer_or_lighter_beads(
    data: Tables, factor: float, count: int
) -> None:
    data["chain"] |= {"count": count, "bead": [], "mass": "1 g"}
    striker = {"material": "odd", "mass": "2 g", "diameter": "8 mm", "speed": "1 m/s"}
    data["striker"] = {"shape": "sphere"} | striker | data.get("striker", {})
    if data["striker"]["shape"] == "flat":
        del data["striker"]["diameter"]
    chain = case_of(data).chain
    collision_s = (chain.mass_kg.max() ** 2 / (chain.stiffness[1:].min() ** 2 * -chain.velocity_m_s[-1])) ** 0.2
    data["run"] = {"duration": text_of(3 * (count + 5) * collision_s, "s")}
    data["run"] |= dict.fromkeys(("sample_interval", "time_step"), text_of(collision_s / 20, "s"))
    contact = count // 2 + 1
    arrival = arrival_s(data, contact)
    assert arrival_s(rescaled(data, {"speed": factor}), contact) < arrival
    assert arrival_s(rescaled(data, {"youngs_modulus": factor}), contact) < arrival
    lighter = data | {"chain": rescaled(data["chain"], {"mass": 1 / factor})}  # the same striker
    assert arrival_s(lighter, contact) < arrival


def number_after(pattern: str, text: str) -> float:
    found = re.search(pattern + r" *([-+.\de]+)", text)
    return float(found.group(1)) if found else 0.0


def stiffnesses(wall: Material | None, materials: list[Material], radius_m: Array) -> Array:
    below = zip([wall, *materials[:-1]], [inf, *radius_m[:-1]], strict=True)
    found = [
        hertz_stiffness(*under, *body) for under, body in zip(below, zip(materials, radius_m, strict=True), strict=True)
    ]
    return np.array(found if wall else [0.0, *found[1:]])


def elastic(young: str, poisson: str) -> Material:
    return Material.model_construct(youngs_modulus=float(young), poisson_ratio=float(poisson))


def chain_in_json(deck: Deck) -> Tables:
    (text,) = deck.files.values()
    values = json.loads(text)
    read = {key: np.array(values[key]) for key in ("height_m", "mass_kg", "velocity_m_s", "load_N", "overlap_m")}
    radius_m = [inf if diameter is None else diameter / 2 for diameter in values["diameter_m"]]
    return read | {"radius_m": np.array(radius_m), "stiffness": np.array(values["stiffness_N_m-3/2"])}


def chain_in_data_file(deck: Deck) -> tuple[NDArray[np.int64], Tables]:
    """Atom types (from 1) and arrays of the chain, from a data file and the loads of LAMMPS or LIGGGHTS."""
    main, data = deck.files["chain.in"], deck.files["chain.data"]
    atoms, velocities = (np.loadtxt(part.splitlines(), ndmin=2) for part in re.split("Atoms|Velocities", data)[1:])
    radius_m, height_m = atoms[:, 2] / 2, atoms[:, 6]
    mass_kg = atoms[:, 3] * 4 / 3 * pi * radius_m**3
    load_N = -number_after("gravity", main) * mass_kg
    load_N[int(number_after("group top id", main)) - 1] += number_after("addforce 0 0", main)
    read = {"height_m": height_m, "radius_m": radius_m, "mass_kg": mass_kg, "velocity_m_s": velocities[:, 3]}
    return atoms[:, 1].astype(int), read | {"load_N": load_N}


def flatten_top(read: Tables) -> None:
    """Turn the top atom into a flat face at the height of its lowest point."""
    read["height_m"][-1] -= read["radius_m"][-1]
    read["radius_m"][-1] = inf


def root_of_reduced(radius_m: Array) -> Array:
    return np.asarray(1 / np.sqrt(1 / radius_m + np.append(0, 1 / radius_m[:-1])))


def chain_in_liggghts(deck: Deck) -> Tables:
    main, (kinds, read) = deck.files["chain.in"], chain_in_data_file(deck)
    wall = int(number_after("primitive type", main)) - 1  # -1 without a wall
    constants = {name: words.split() for name, words in re.findall(r"^fix (\w+) all \S+ \w+ \w+ (.*)$", main, re.M)}
    if "kn" in constants:  # number of types, then a stiffness for each pair of types
        table = np.array(constants["kn"][1:], dtype=float).reshape(2 * [int(constants["kn"][0])])
        stiffness = table[np.append(wall, kinds[:-1] - 1), kinds - 1] * root_of_reduced(read["radius_m"])
        stiffness[0] *= wall >= 0
        flatten_top(read)
    else:
        types = [elastic(*pair) for pair in zip(constants["young"], constants["poisson"], strict=True)]
        below = types[wall] if wall >= 0 else None
        stiffness = stiffnesses(below, [types[kind - 1] for kind in kinds], read["radius_m"])
    return read | {"stiffness": stiffness}


def chain_in_lammps(deck: Deck) -> Tables:
    main, (kinds, read) = deck.files["chain.in"], chain_in_data_file(deck)
    pairs = re.findall(r"^pair_coeff +(\d+) (\d+) hertz (\S+)", main, re.M)
    by_pair = {frozenset((int(one), int(other))): float(kn) for one, other, kn in pairs}
    kn = [number_after("wall/gran granular hertz", main), *(by_pair[frozenset(pair)] for pair in pairwise(kinds))]
    read["stiffness"] = np.array(kn) * root_of_reduced(read["radius_m"])
    if re.search(r"^# types: .*\d flat ", main, re.M):
        flatten_top(read)
    return read


def chain_in_yade(deck: Deck) -> Tables:
    (text,) = deck.files.values()
    kinds = {key: elastic(*pair) for key, *pair in re.findall(r'label="(.*?)", young=(.*?), poisson=(.*?),', text)}
    rows = re.findall(r'^    \((.*), (.*), (.*), (.*), "(.*)"\),$', text, re.M)
    for height, material in re.findall(r'face = utils.wall\((.*?), .*material="(.*?)"', text):
        mass, velocity = number_after("face.state.mass =", text), number_after(r"\.vel = \(0, 0,", text)
        rows.append((height, inf, mass, velocity, material))
    height_m, radius_m, mass_kg, velocity_m_s = np.array([row[:4] for row in rows], dtype=float).T
    wall = next((kinds[key] for key in re.findall(r'wall = .*utils.wall\(.*material="(.*?)"', text)), None)
    load_N = -number_after("\ng =", text) * mass_kg
    load_N[int(number_after(r"setPermF\(bodies\[", text))] += number_after(r"setPermF\(.*\(0, 0,", text)
    read = {"height_m": height_m, "radius_m": radius_m, "mass_kg": mass_kg, "velocity_m_s": velocity_m_s}
    return read | {"stiffness": stiffnesses(wall, [kinds[row[4]] for row in rows], radius_m), "load_N": load_N}


# readers of decks; decks of all other engines are JSON
DECK_READERS = {"lammps": chain_in_lammps, "liggghts": chain_in_liggghts, "yade": chain_in_yade}


@given(scenes())
@fixed_number(60)
def test_decks_contain_the_chain_exactly(data: Tables) -> None:
    case = case_of(data)
    chain = case.chain
    half_step_before = chain.velocity_m_s - 0.5 * case.scene.time_step_s * chain.acceleration_m_s2  # for leapfrog
    for engine in engine_names():
        read = DECK_READERS.get(engine, chain_in_json)(load_engine(engine).render(case))
        rounding = np.spacing(np.abs(chain.height_m).max())  # from adding and subtracting the radius of a flat face
        np.testing.assert_allclose(read["height_m"], chain.height_m, rtol=0, atol=rounding)
        np.testing.assert_array_equal(read["radius_m"], chain.radius_m)
        velocity_m_s = half_step_before if engine == "yade" else chain.velocity_m_s
        np.testing.assert_array_equal(read["velocity_m_s"], velocity_m_s)
        for name in ("mass_kg", "stiffness", "load_N"):
            np.testing.assert_allclose(read[name], getattr(chain, name), rtol=1e-14, atol=0, err_msg=f"{engine} {name}")
        np.testing.assert_array_equal(read.get("overlap_m", chain.overlap_m), chain.overlap_m)


@given(scenes(), st.integers(0, 2**62), st.booleans())
@fixed_number(40)
def test_decks_are_reproducible_and_a_seed_changes_only_scattered_masses(
    data: Tables, seed: int, scattered: bool
) -> None:
    if scattered:
        data["chain"]["mass_scatter"] = text_of(0.01 * case_of(data).chain.mass_kg.min(), "kg")
    case, again, other = case_of(data), case_of(data), case_of(data | {"seed": seed + 1})
    for engine in engine_names():
        deck, same, reseeded = (load_engine(engine).render(each).files for each in (case, again, other))
        assert deck == same
        assert (deck == reseeded) == (not scattered or (case.chain.mass_kg == other.chain.mass_kg).all())
    own = {bead["from_wall"] for bead in data["chain"]["bead"] if "mass" in bead} if scattered else set(range(1, 31))
    drawn = np.array([place not in own and place <= case.chain.beads for place in range(1, case.chain.bodies + 1)])
    np.testing.assert_array_equal(case.chain.mass_kg != other.chain.mass_kg, drawn & scattered)
    for name in ("stiffness", "radius_m", "velocity_m_s", "materials"):
        np.testing.assert_array_equal(getattr(case.chain, name), getattr(other.chain, name))
