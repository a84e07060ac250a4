"""Values of scenes in SI units, and arrays of chains in equilibrium."""

from decimal import Decimal
from math import inf, pi, sqrt

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.base.units import divided, to_si
from drivers.chain.contact_law import hertz_stiffness
from drivers.chain.elements import choose_elements
from drivers.engines import load_engine
from drivers.scene.model import Material
from drivers.scene.read_scene import read_scene
from validation.tests.helpers.scenes import SceneWriter, case_of

PTFE = Material.model_construct(youngs_modulus=1.46e9, poisson_ratio=0.46)
BRASS = Material.model_construct(youngs_modulus=115e9, poisson_ratio=0.307)


@pytest.mark.parametrize(
    ("text", "unit", "value"),
    [
        ("4.76 mm", "m", 0.00476),
        ("0.1226 g", "kg", 0.0001226),
        ("0.1 us", "s", 1e-7),
        ("10 µs", "s", 1e-5),
        ("1.46 GPa", "Pa", 1.46e9),
        ("9.81 m/s^2", "m/s^2", 9.81),
        ("0.2 in", "m", 0.00508),
        (" 7.2 km/hour ", "m/s", 2.0),
        ("-.5e0 m/s", "m/s", -0.5),
    ],
)
def test_quantities_are_the_closest_double(text: str, unit: str, value: float) -> None:
    assert to_si(text, unit) == value


FEW_DIGITS = st.builds(lambda digits, power: Decimal(digits).scaleb(power), st.integers(1, 10**6), st.integers(-9, 3))
PREFIXES = {"p": -12, "n": -9, "u": -6, "m": -3, "": 0, "k": 3, "M": 6, "G": 9}


@given(st.sampled_from([*PREFIXES]), st.sampled_from(["m", "s", "Pa", "N", "m/s"]), FEW_DIGITS)
def test_a_quantity_is_the_double_nearest_to_its_decimal(prefix: str, unit: str, number: Decimal) -> None:
    assert to_si(f"{number} {prefix}{unit}", unit) == float(number.scaleb(PREFIXES[prefix]))


@given(FEW_DIGITS, st.integers(1, 10**6))
def test_a_step_is_the_double_nearest_to_its_decimal(step: Decimal, steps: int) -> None:
    assert divided(float(step * steps), steps) == float(step)


@pytest.mark.parametrize("interval", ["1 us", "5 us", "10 us", "0.02 ms"])
def test_a_step_of_a_scene_is_as_written(interval: str) -> None:
    case = case_of("fig4", f"run.sample_interval={interval}", "run.time_step=250 ns")
    assert case.scene.time_step_s == 2.5e-7
    assert case.at(case.scene.steps_per_sample).scene.time_step_s == 2.5e-7
    assert "timestep        2.5e-07\n" in load_engine("liggghts").render(case).files["chain.in"]


def test_hertz_law_is_the_papers_equation_7() -> None:
    modulus, nu, radius = 1.46e9, 0.46, 2.38e-3
    equation_7 = 2 * modulus / (3 * (1 - nu**2)) * sqrt(radius * radius / (2 * radius))
    assert hertz_stiffness(PTFE, radius, PTFE, radius) == pytest.approx(equation_7, rel=1e-15)


def test_a_flat_rigid_wall_is_twice_root_two_as_stiff_as_a_bead() -> None:
    between_beads = hertz_stiffness(PTFE, 1e-3, PTFE, 1e-3)
    assert hertz_stiffness(PTFE, 1e-3, None, inf) == pytest.approx(2 * sqrt(2) * between_beads, rel=1e-15)


def test_compliances_of_different_materials_add_up() -> None:
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
    settings = ("chain.mass_scatter=0.0008 g", "chain.count=400", "chain.sensors=[]")
    one, again = case_of("fig4", *settings).chain, case_of("fig4", *settings).chain
    other = case_of("fig4", *settings, "seed=1").chain
    np.testing.assert_array_equal(one.mass_kg, again.mass_kg)
    assert (one.mass_kg[:400] != other.mass_kg[:400]).all()
    assert np.std(one.mass_kg[:400]) == pytest.approx(0.8e-6, rel=0.1)


def test_settings_change_the_scene_of_the_file() -> None:
    scene = read_scene("fig4", ("chain.count=60", "chain.sensors.1.from_wall=33", "striker=", "title=plain words"))
    assert scene.chain.count == 60
    assert [sensor.from_wall for sensor in scene.chain.sensors] == [9, 33]
    assert scene.striker is None
    assert scene.title == "plain words"


def test_a_scene_overrides_one_constant_of_a_material() -> None:
    scene = read_scene("fig4", ("materials.ptfe.youngs_modulus=600 MPa",))
    assert scene.materials["ptfe"].youngs_modulus == 600e6
    assert scene.materials["ptfe"].poisson_ratio == 0.46
    assert scene.materials["ptfe"].source is None


def test_samples_and_steps() -> None:
    scene = read_scene("fig4", ("run.duration=10.5 us",))
    assert (scene.samples, scene.steps_per_sample, scene.steps) == (11, 10, 100)


def test_a_collinear_chain_needs_no_tube() -> None:
    case = case_of("fig4")
    modelled = {element.name for element in choose_elements(case.scene, case.chain) if element.modelled}
    assert modelled == {"gravity", "wall", "striker", "sensor masses"}
    assert all(element.reason for element in case.elements)
    assert "no bead touches the bore" in next(e.reason for e in case.elements if e.name == "tube")
