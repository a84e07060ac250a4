"""Settings that change one scene to another, and texts of quantities."""

from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.base.units import quantity, to_si
from drivers.scene.read_scene import read_scene
from drivers.scene.settings import settings_between

UNITS = ("m", "s", "kg", "N", "Pa", "m/s", "m/s^2", "kg/m^3")


def dump(*settings: str, scene: str = "fig4") -> dict[str, Any]:
    return read_scene(scene, settings).model_dump(mode="json", exclude_none=True)


@pytest.mark.parametrize(
    "settings",
    [
        (),
        ("striker.speed=3 m/s",),
        ("gravity=0 m/s^2", "chain.count=60", "seed=7"),
        ("run.time_step=50 ns", "run.duration=1.2 ms"),
        ("run.time_step=", "run.accuracy=0.0001"),
        ('run.record=["forces", "state"]', "contact.rotation=false"),
        ("wall=", "tube="),
        ("striker=",),
        ("wall.material=steel",),
        ("materials.ptfe.youngs_modulus=0.6 GPa", "materials.brass.poisson_ratio=0.3"),
        ('chain.sensors=[{from_wall=3, mass="0.1 g"}]', 'chain.bead=[{from_wall=1, gap_below="1 um"}]'),
        ("chain.sensors.0.mass=0.117 g",),
        ("chain.sensors=[]", "striker.material=steel"),
        ("chain.lateral_offset=30 um",),
    ],
)
def test_settings_between_scenes_are_those_that_were_given(settings: tuple[str, ...]) -> None:
    found = [f"{key}={value}" for key, value in settings_between(dump(*settings), dump()).items()]
    assert sorted(found) == sorted(settings)


def test_a_table_missing_in_the_file_is_one_setting() -> None:
    (setting,) = settings_between(dump(), dump("tube=")).items()
    assert setting == ("tube", '{inner_diameter="5 mm", material="ptfe", friction=0.05}')
    assert dump("tube=", f"tube={setting[1]}") == dump()


def test_rounded_steps_read_back_as_the_same_scene() -> None:
    third = dump("run.time_step=0.333333333333 us")
    assert third["run"]["time_step"] == 1 / 3e6
    text = settings_between(third, dump())["run.time_step"]
    assert dump(f"run.time_step={text}") == third


@given(st.sampled_from(UNITS), st.floats(1e-28, 1e28) | st.floats(-1e28, -1e-28) | st.just(0.0))
def test_a_quantity_reads_back_as_the_same_double(unit: str, value: float) -> None:
    assert to_si(quantity(value, unit), unit) == value


@pytest.mark.parametrize(
    ("value", "unit", "text"),
    [
        (1e-7, "s", "0.1 us"), (8e-4, "s", "0.8 ms"), (2e-8, "s", "20 ns"), (0.00476, "m", "4.76 mm"),
        (2.0, "m/s", "2 m/s"), (1.226e-4, "kg", "0.1226 g"), (1.46e9, "Pa", "1.46 GPa"), (0.0132, "N", "13.2 mN"),
        (9.81, "m/s^2", "9.81 m/s^2"), (2200.0, "kg/m^3", "2200 kg/m^3"), (1e-15, "m", "1e-15 m"), (0.0, "N", "0 N"),
    ],
)  # fmt: skip
def test_quantities_have_short_texts(value: float, unit: str, text: str) -> None:
    assert quantity(value, unit) == text
