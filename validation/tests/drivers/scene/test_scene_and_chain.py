"""Tests of scenes and chains: quantities, settings, masses, equilibrium, patterns, tapers, leaning chains."""

from decimal import Decimal
from math import inf, pi, sqrt
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.base.units import divided, quantity, to_si
from drivers.chain.chain import hertz_stiffness
from drivers.engines import engine_names, load_engine
from drivers.scene.model import RIGID_MATERIAL, Material
from drivers.scene.read_scene import read_scene
from drivers.scene.settings import settings_between
from validation.tests.helpers.scenes import SceneWriter, case_of

PTFE = Material.model_construct(youngs_modulus=1.46e9, poisson_ratio=0.46)
BRASS = Material.model_construct(youngs_modulus=115e9, poisson_ratio=0.307)
FEW_DIGITS = st.builds(lambda digits, power: Decimal(digits).scaleb(power), st.integers(1, 10**6), st.integers(-9, 3))
PREFIXES = {"p": -12, "n": -9, "u": -6, "µ": -6, "m": -3, "": 0, "k": 3, "M": 6, "G": 9}
UNITS = ("m", "s", "kg", "N", "Pa", "m/s", "m/s^2", "kg/m^3")


@settings(deadline=None)  # the first example loads the library of units
@given(st.sampled_from([*PREFIXES]), st.sampled_from(["m", "s", "Pa", "N", "m/s"]), FEW_DIGITS)
def test_quantity_is_the_double_nearest_to_its_decimal(prefix: str, unit: str, number: Decimal) -> None:
    assert to_si(f"{number} {prefix}{unit}", unit) == float(number.scaleb(PREFIXES[prefix]))


def test_quantities_of_other_units_and_spellings() -> None:
    for text, unit, value in ((" 0.2 in", "m", 0.00508), ("7.2 km/hour ", "m/s", 2.0), ("-.5e0 m/s", "m/s", -0.5)):
        assert to_si(text, unit) == value


@given(st.sampled_from(UNITS), st.floats(1e-28, 1e28) | st.floats(-1e28, -1e-28) | st.just(0.0))
def test_quantity_reads_back_as_the_same_double(unit: str, value: float) -> None:
    assert to_si(quantity(value, unit), unit) == value


def test_quantities_have_short_texts() -> None:
    assert [quantity(1e-7, "s"), quantity(1.226e-4, "kg"), quantity(1e-15, "m")] == ["0.1 us", "0.1226 g", "1e-15 m"]


@given(FEW_DIGITS, st.integers(1, 10**6))
def test_step_is_the_double_nearest_to_its_decimal(step: Decimal, steps: int) -> None:
    assert divided(float(step * steps), steps) == float(step)


def test_steps_and_samples_of_a_scene_are_as_written() -> None:
    case = case_of("fig4", "run.sample_interval=0.02 ms", "run.time_step=250 ns")
    assert case.scene.time_step_s == case.at(case.scene.steps_per_sample).scene.time_step_s == 2.5e-7
    assert "timestep        2.5e-07\n" in load_engine("liggghts").render(case).files["chain.in"]
    scene = read_scene("fig4", ("run.duration=10.5 us",))
    assert (scene.samples, scene.steps_per_sample, scene.steps) == (11, 10, 100)


def dump(*settings: str, scene: str = "fig4") -> dict[str, Any]:
    return read_scene(scene, settings).model_dump(mode="json", exclude_none=True)


@pytest.mark.parametrize(
    "keys",
    [
        (),
        ("gravity=0 m/s^2", "chain.count=60", "seed=7", "wall.material=steel"),
        ('run.record=["forces", "state"]', "contact.rotation=false"),
        ("wall=", "tube=", "striker="),
        ("chain.sensors.0.mass=0.117 g", "chain.lateral_offset=30 um"),
    ],
)
def test_settings_between_scenes_are_those_that_were_given(keys: tuple[str, ...]) -> None:
    between = [f"{key}={value}" for key, value in settings_between(dump(*keys), dump()).items()]
    assert sorted(between) == sorted(keys)


def test_settings_read_back_as_the_same_scene() -> None:
    """A table that the file lacks is one setting, and a rounded step the same step."""
    ((key, table),) = settings_between(dump(), dump("tube=")).items()
    assert (key, table) == ("tube", '{inner_diameter="5 mm", material="ptfe", friction=0.05}')
    assert dump("tube=", f"tube={table}") == dump()
    third = dump("run.time_step=0.333333333333 us")
    assert third["run"]["time_step"] == 1 / 3e6
    assert dump(f"run.time_step={settings_between(third, dump())['run.time_step']}") == third


def test_changed_material_has_no_source() -> None:
    ptfe = read_scene("fig4", ("materials.ptfe.youngs_modulus=600 MPa",)).materials["ptfe"]
    assert (ptfe.youngs_modulus, ptfe.poisson_ratio, ptfe.source) == (600e6, 0.46, None)


def test_hertz_stiffness_of_beads_and_walls() -> None:
    """Of equal beads as in the paper's equation 7, of a rigid flat, and of two materials."""
    modulus, nu, radius = 1.46e9, 0.46, 2.38e-3
    equation_7 = 2 * modulus / (3 * (1 - nu**2)) * sqrt(radius * radius / (2 * radius))
    assert hertz_stiffness(PTFE, radius, PTFE, radius) == pytest.approx(equation_7, rel=1e-15)
    assert hertz_stiffness(PTFE, radius, RIGID_MATERIAL, inf) == pytest.approx(2 * sqrt(2) * equation_7, rel=1e-15)
    compliance = (1 - 0.46**2) / 1.46e9 + (1 - 0.307**2) / 115e9
    assert hertz_stiffness(PTFE, 2e-3, BRASS, inf) == pytest.approx(4 / 3 / compliance * sqrt(2e-3), rel=1e-15)


def test_contacts_in_equilibrium_carry_the_weight_above() -> None:
    chain = case_of("fig4", "chain.precompression=2 N").chain
    weights = 9.81 * chain.mass_kg[:21]
    carried = 2 + np.cumsum(weights[::-1])[::-1]
    np.testing.assert_allclose(chain.force_N[:21], carried, rtol=1e-14)
    assert chain.force_N[21] == 0
    assert not chain.acceleration_m_s2[:21].any()
    assert chain.acceleration_m_s2[21] == pytest.approx(-9.81)


def test_beads_without_loads_just_touch() -> None:
    chain = case_of("fig4", "gravity=", "chain.origin=1 m").chain
    np.testing.assert_allclose(chain.height_m, 1 + 0.00476 * (np.arange(22) + 0.5), rtol=1e-15)


def test_beads_above_a_gap_fall_freely(scene_file: SceneWriter) -> None:
    path = scene_file(top='gravity = "9.81 m/s^2"', chain='bead = [{ from_wall = 3, gap_below = "20 um" }]')
    chain = case_of(path).chain
    np.testing.assert_allclose(chain.force_N[:2], 9.81 * 1.226e-4 * np.array([2, 1]), rtol=1e-14)
    assert chain.overlap_m[2] == -20e-6
    assert not chain.force_N[2:].any()
    np.testing.assert_allclose(chain.acceleration_m_s2, [0, 0, -9.81, -9.81, -9.81, -9.81], atol=1e-12)


def test_masses_come_from_sensor_bead_chain_or_density(scene_file: SceneWriter) -> None:
    text = 'sensors = [{ from_wall = 2, mass = "0.1 g" }, { from_wall = 3 }]\n'
    text += 'bead = [{ from_wall = 4, mass = "1 g" }, { from_wall = 5, diameter = "6 mm", material = "steel" }]'
    mass = case_of(scene_file(chain=text)).chain.mass_kg
    steel, ptfe = 7780 * pi / 6 * 0.006**3, 2200 * pi / 6 * 0.00476**3
    np.testing.assert_allclose(mass, [1.226e-4, 1e-4, 1.226e-4, 1e-3, steel, ptfe], rtol=1e-15)


def test_scattered_masses_follow_the_seed() -> None:
    settings = (
        "chain.mass_scatter=0.0008 g",
        "chain.count=400",
        "chain.sensors=[]",
        "chain.bead=[{from_wall=3, mass='1 g'}]",
    )
    drawn, again, other = (case_of("fig4", *settings, f"seed={seed}").chain for seed in (0, 0, 1))
    np.testing.assert_array_equal(drawn.mass_kg, again.mass_kg)
    assert [*np.flatnonzero(drawn.mass_kg == other.mass_kg)] == [2, 400], "the bead with a mass, and the striker"
    assert np.std(np.delete(drawn.mass_kg, [2, 400])) == pytest.approx(0.8e-6, rel=0.1)


def test_pattern_is_the_table_of_its_beads() -> None:
    keys, others = ("chain.sensors=[]", "chain.mass="), "chain.bead=[{from_wall=['3', '7-9'], mass='0.2 g'}]"
    short = case_of("fig4", *keys, "chain.pattern=[{}, {material='steel', diameter='3 mm'}]", others)
    beads = dict.fromkeys(range(2, 21, 2), "material='steel', diameter='3 mm'")
    beads |= {3: "mass='0.2 g'", 7: "mass='0.2 g'", 8: f"{beads[8]}, mass='0.2 g'", 9: "mass='0.2 g'"}
    table = ", ".join(f"{{from_wall={place}, {values}}}" for place, values in beads.items())
    long = case_of("fig4", *keys, f"chain.bead=[{table}]")
    for engine in engine_names():
        assert load_engine(engine).render(short).files == load_engine(engine).render(long).files


def test_tapers_keep_the_density() -> None:
    by_ratio = case_of("fig4", "chain.sensors=[]", "chain.taper=0.9").chain
    assert by_ratio.radius_m[20] == pytest.approx(2.38e-3 * 0.9**20, rel=1e-12)
    assert by_ratio.mass_kg[20] == pytest.approx(1.226e-4 * 0.9**60, rel=1e-12)
    linear = case_of("fig4", "chain.sensors=[]", "chain.taper_to=2.38 mm").chain
    np.testing.assert_allclose(np.diff(linear.radius_m[:21]), -2.38e-3 / 2 / 20, rtol=1e-10)
    np.testing.assert_allclose(linear.mass_kg[:21] / linear.radius_m[:21] ** 3, 1.226e-4 / 2.38e-3**3, rtol=1e-12)


def test_leaning_chain_feels_the_part_of_gravity_along_its_axis() -> None:
    upright, leaning, flat = (case_of("fig4", f"chain.angle={angle}") for angle in ("0 deg", "60 deg", "90 deg"))
    np.testing.assert_allclose(leaning.chain.load_N, upright.chain.load_N / 2, rtol=1e-14)
    assert not flat.chain.load_N.any()
    assert "gravity" not in flat.reasons
    assert "horizontal" in next(each.reason for each in flat.elements if each.name == "gravity")
    assert "leaning by 60 deg: z is the axis, gravity along it 4.905 m/s^2" in leaning.summary
