"""Any scene that can be drawn: what motions keep, how they scale, and what decks say of the scene."""

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
from drivers.chain.trace import Trace
from drivers.engines import engine_names, load_engine
from drivers.run.guard import energy_error
from drivers.scene.model import Material
from drivers.scene.read_scene import make_scene, read_toml
from validation.accuracy.schemes import trace_of, truth_of
from validation.reference.velocity_verlet import integrate_verlet

Tables = dict[str, Any]
LIBRARY = read_toml(paths.MATERIALS)
FACTORS = st.floats(0.01, 100)
# worst of 500 draws: 2e-11 (what a precompression holds is many times what is put in), 2e-14, 7e-13, 4e-12
ENERGY, MOMENTUM, TURNED, SCALED = 1e-9, 1e-13, 1e-11, 1e-10


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
    velocity = st.floats(-1, 1).map(lambda share: text_of(round(share, 6) * speed_m_s, "m/s"))
    sizes = decades(0.5, 2).map(lambda ratio: text_of(ratio * diameter_m, "m"))
    masses = decades(0.1, 10).map(lambda ratio: text_of(ratio * bead_kg, "kg"))
    gaps = decades(0.01, 10).map(lambda ratio: text_of(ratio * speed_m_s * collision_s, "m"))
    particular = {"diameter": sizes, "mass": masses, "material": st.just("odd"), "gap_below": gaps}

    shape = draw(st.sampled_from((None, *strikers)))
    struck = shape is not None
    beads: list[Tables] = [
        draw(st.fixed_dictionaries({"from_wall": st.just(place)}, optional=particular | {"velocity": velocity}))
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
    return truth_of(case, finer=False).trace


def most_N_s(case: Case, trace: Trace) -> float:
    """The most momentum that its kinetic energy allows."""
    return float(np.sqrt(2 * trace.kinetic_energy_J.max() * case.chain.mass_kg.sum()))


def rescaled(value: Any, factors: dict[str, float], factor: float | None = None) -> Any:
    """Tables with the quantities under some keys multiplied."""
    if isinstance(value, dict):
        return {key: rescaled(each, factors, factors.get(key)) for key, each in value.items()}
    if isinstance(value, list):
        return [rescaled(each, factors) for each in value]
    if factor is None:
        return value
    number, unit = value.split()
    return text_of(float(number) * factor, unit)


def turned_round(data: Tables, case: Case) -> Tables:
    """The bodies of a free chain from the top down, a striker among them as a bead."""
    chain = case.chain
    gap_m = np.append(0.0, np.maximum(-chain.overlap_m[:0:-1], 0.0))  # contact j lies under body j, turned round above
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
@some(60)
def test_energy_is_conserved(data: Tables) -> None:
    case = case_of(data)
    assert energy_error(case.chain, motion_of(case)).max() < ENERGY


@given(scenes(walls=()))
@some(60)
def test_a_free_chain_has_the_momentum_of_its_loads(data: Tables) -> None:
    case = case_of(data)
    trace = motion_of(case)
    change = trace.momentum_N_s - trace.momentum_N_s[0] - case.chain.load_N.sum() * trace.time_s
    assert np.abs(change).max() <= MOMENTUM * most_N_s(case, trace)


@given(scenes())
@some(60)
def test_the_scheme_gets_its_momentum_from_the_wall_and_the_loads(data: Tables) -> None:
    """Velocity Verlet kicks by trapezoids, so that sampled at every step nothing is left over."""
    case = case_of(data)
    step_s, samples = case.scene.time_step_s, case.scene.steps + 1
    motion = integrate_verlet(arrays_of(case.chain), step_s, 1, samples)
    trace = trace_of(case, step_s * np.arange(samples, dtype=float), motion)
    net_N = trace.force_N[:, 0] + case.chain.load_N.sum()
    impulse = np.append(0.0, np.cumsum(0.5 * step_s * (net_N[1:] + net_N[:-1])))
    given_N_s = np.abs(case.chain.load_N).sum() * trace.time_s[-1] + step_s * np.abs(trace.force_N[:, 0]).sum()
    scale = most_N_s(case, trace) + given_N_s
    error_N_s = np.abs(trace.momentum_N_s - trace.momentum_N_s[0] - impulse).max()
    assert error_N_s <= MOMENTUM * scale


@given(scenes(loads=False, walls=(), strikers=("sphere",)))
@some(60)
def test_a_chain_turned_round_has_the_same_forces(data: Tables) -> None:
    case = case_of(data)
    force_N = motion_of(case).force_N[:, 1:]
    assume(force_N.size and force_N.max() > 0)
    turned_N = motion_of(case_of(turned_round(data, case))).force_N[:, 1:]
    assert np.abs(turned_N[:, ::-1] - force_N).max() < TURNED * force_N.max()


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
    assert np.abs(other_N / force - one_N).max() <= SCALED * one_N.max()


def arrival_s(data: Tables, contact: int) -> float:
    """When a contact first bears a tenth of the most it ever does."""
    trace = motion_of(case_of(data))
    force_N = trace.force_N[:, contact - 1]
    level_N = 0.1 * force_N.max()
    after = int(np.argmax(force_N > level_N))
    assert after > 0
    near = slice(after - 1, after + 1)
    return float(np.interp(level_N, force_N[near], trace.time_s[near]))


@given(scenes(loads=False, walls=()), st.floats(1.05, 3), st.integers(4, 30))
@some(30)
def test_speed_stiffness_and_lightness_make_a_wave_arrive_earlier(data: Tables, factor: float, count: int) -> None:
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
    slowest = arrival_s(data, contact)
    assert arrival_s(rescaled(data, {"speed": factor}), contact) < slowest
    assert arrival_s(rescaled(data, {"youngs_modulus": factor}), contact) < slowest
    lighter = data | {"chain": rescaled(data["chain"], {"mass": 1 / factor})}  # the striker as heavy as before
    assert arrival_s(lighter, contact) < slowest


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


def said_by_json(deck: Deck) -> Tables:
    (text,) = deck.files.values()
    values = json.loads(text)
    said = {key: np.array(values[key]) for key in ("height_m", "mass_kg", "velocity_m_s", "load_N", "overlap_m")}
    radius_m = [inf if diameter is None else diameter / 2 for diameter in values["diameter_m"]]
    return said | {"radius_m": np.array(radius_m), "stiffness": np.array(values["stiffness_N_m-3/2"])}


def said_by_data(deck: Deck) -> tuple[NDArray[np.int64], Tables]:
    """Types of the atoms, from 1 up, and what the data and the loads of LAMMPS and its descendants say."""
    main, data = deck.files["chain.in"], deck.files["chain.data"]
    atoms, velocities = (np.loadtxt(part.splitlines(), ndmin=2) for part in re.split("Atoms|Velocities", data)[1:])
    radius_m, height_m = atoms[:, 2] / 2, atoms[:, 6]
    mass_kg = atoms[:, 3] * 4 / 3 * pi * radius_m**3
    load_N = -number_after("gravity", main) * mass_kg
    load_N[int(number_after("group top id", main)) - 1] += number_after("addforce 0 0", main)
    said = {"height_m": height_m, "radius_m": radius_m, "mass_kg": mass_kg, "velocity_m_s": velocities[:, 3]}
    return atoms[:, 1].astype(int), said | {"load_N": load_N}


def flattened(said: Tables) -> None:
    """The uppermost atom is that of a flat face, which touches with its lowest point."""
    said["height_m"][-1] -= said["radius_m"][-1]
    said["radius_m"][-1] = inf


def root_of_reduced(radius_m: Array) -> Array:
    return np.asarray(1 / np.sqrt(1 / radius_m + np.append(0, 1 / radius_m[:-1])))


def said_by_liggghts(deck: Deck) -> Tables:
    main, (kinds, said) = deck.files["chain.in"], said_by_data(deck)
    wall = int(number_after("primitive type", main)) - 1  # -1 where there is none
    constants = {name: words.split() for name, words in re.findall(r"^fix (\w+) all \S+ \w+ \w+ (.*)$", main, re.M)}
    if "kn" in constants:  # of pairs of types, after their number
        table = np.array(constants["kn"][1:], dtype=float).reshape(2 * [int(constants["kn"][0])])
        stiffness = table[np.append(wall, kinds[:-1] - 1), kinds - 1] * root_of_reduced(said["radius_m"])
        stiffness[0] *= wall >= 0
        flattened(said)
    else:
        types = [elastic(*pair) for pair in zip(constants["young"], constants["poisson"], strict=True)]
        below = types[wall] if wall >= 0 else None
        stiffness = stiffnesses(below, [types[kind - 1] for kind in kinds], said["radius_m"])
    return said | {"stiffness": stiffness}


def said_by_lammps(deck: Deck) -> Tables:
    main, (kinds, said) = deck.files["chain.in"], said_by_data(deck)
    pairs = re.findall(r"^pair_coeff +(\d+) (\d+) hertz (\S+)", main, re.M)
    by_pair = {frozenset((int(one), int(other))): float(kn) for one, other, kn in pairs}
    kn = [number_after("wall/gran granular hertz", main), *(by_pair[frozenset(pair)] for pair in pairwise(kinds))]
    said["stiffness"] = np.array(kn) * root_of_reduced(said["radius_m"])
    if re.search(r"^# types: .*\d flat ", main, re.M):
        flattened(said)
    return said


def said_by_yade(deck: Deck) -> Tables:
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
    said = {"height_m": height_m, "radius_m": radius_m, "mass_kg": mass_kg, "velocity_m_s": velocity_m_s}
    return said | {"stiffness": stiffnesses(wall, [kinds[row[4]] for row in rows], radius_m), "load_N": load_N}


SAID = {"lammps": said_by_lammps, "liggghts": said_by_liggghts, "yade": said_by_yade}  # others are of this repository


@given(scenes())
@some(60)
def test_decks_say_what_the_chain_says(data: Tables) -> None:
    case = case_of(data)
    chain = case.chain
    early = chain.velocity_m_s - 0.5 * case.scene.time_step_s * chain.acceleration_m_s2  # of YADE's leapfrog
    for engine in engine_names():
        said = SAID.get(engine, said_by_json)(load_engine(engine).render(case))
        allowed = np.spacing(np.abs(chain.height_m).max())  # of a radius added to a face's height and taken off
        np.testing.assert_allclose(said["height_m"], chain.height_m, rtol=0, atol=allowed)
        np.testing.assert_array_equal(said["radius_m"], chain.radius_m)
        np.testing.assert_array_equal(said["velocity_m_s"], early if engine == "yade" else chain.velocity_m_s)
        for name in ("mass_kg", "stiffness", "load_N"):
            np.testing.assert_allclose(said[name], getattr(chain, name), rtol=1e-14, atol=0, err_msg=f"{engine} {name}")
        np.testing.assert_array_equal(said.get("overlap_m", chain.overlap_m), chain.overlap_m)


@given(scenes(), st.integers(0, 2**62), st.booleans())
@some(40)
def test_decks_are_the_same_each_time_and_a_seed_changes_scattered_masses_alone(
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
