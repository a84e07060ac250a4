"""Every number of a run is declared, with its unit and kind."""

import pytest

from postproc.paper.simulate import exact
from postproc.read.observables import OBSERVABLES, describe, observe, of_kind, without_unit
from validation.tests.helpers.scenes import case_of

SCENES = (
    ("fig4",), ("fig5", "contact.restitution=0.9"), ("fig5", "sensor.time_constant=1 ms"), ("steel-chain", "wall="),
)  # fmt: skip


@pytest.mark.parametrize("scene", SCENES)
def test_whatever_a_run_shows_is_declared_once_and_ends_in_its_unit(scene: tuple[str, ...]) -> None:
    case = case_of(*scene)
    values = observe(case.layout, exact(case).trace, (0.002, 0.04, 0.5, 1e-6))
    for name in values:
        (found,) = {observable for observable in OBSERVABLES if describe(name) == observable}
        assert name.endswith(found.ending)
        assert describe(without_unit(name)) == found, "a scene may leave the unit out"
        assert without_unit(without_unit(name)) == without_unit(name)


def test_each_declared_observable_is_shown_by_a_run() -> None:
    shown = set()
    for scene in SCENES:
        case = case_of(*scene)
        shown |= {describe(name) for name in observe(case.layout, exact(case).trace)}
    assert shown == set(OBSERVABLES)


@pytest.mark.parametrize(
    ("name", "unit", "kind"),
    [
        ("wall_peak_N", "N", "peak"), ("wall_peak", "N", "peak"), ("wall_peak_2_N", "N", "later peak"),
        ("speed_9_to_5_m_s", "m/s", "speed"), ("bead_12_width_0.2pct", "diameters", "width"),
        ("wall_envelope_per_s", "1/s", "rate"), ("momentum_end_N_s", "N s", "momentum"), ("wall_peek_N", "", ""),
    ],
)  # fmt: skip
def test_a_name_tells_unit_and_kind(name: str, unit: str, kind: str) -> None:
    assert (describe(name).unit, describe(name).kind) == (unit, kind)


def test_names_are_chosen_by_kind_in_their_order() -> None:
    names = ["force", "speed_9_to_5", "wall_peak", "bead_9_reflected_arrival", "bead_9_arrival", "wall_peak_2"]
    assert of_kind(names, "peak", "speed") == ["speed_9_to_5", "wall_peak"]
    assert of_kind(names, "arrival") == ["bead_9_arrival"]
