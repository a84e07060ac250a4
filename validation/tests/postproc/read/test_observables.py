"""Every number of a run is declared with its unit and kind, and belongs to the wave in its name."""

import gc
from functools import cache
from math import isnan, nan
from weakref import ref

import pytest

from postproc.read.motion import exact
from postproc.read.observables import OBSERVABLES, Observable, describe, not_shown, observe, of_kind, without_unit
from validation.tests.helpers.scenes import case_of

SCENES = (
    ("fig5", "contact.restitution=0.9"), ("steel-chain", "wall="), ("fig4", "run.duration=20 us"),
    ("fig6d", "chain.sensors=[{from_wall=14}, {from_wall=8}]", "run.duration=0.6 ms"),
)  # fmt: skip
DAMPED = ("fig4", "contact.restitution=0.9", "run.duration=0.3 ms")


@cache
def values_of(*scene: str) -> dict[str, float]:
    """Observables of the exact motion of a scene, with a width at a level of many digits."""
    case = case_of(*scene)
    return observe(case.layout, exact(case).trace, (0.002, 0.04, 0.5, 1e-6))


def test_every_observable_of_a_run_is_declared_once_and_nan_only_if_it_has_a_reason() -> None:
    """Until 20 us no gauge shows a pulse; so no observable of a pulse is seen, and all others are."""
    unseen, seen = set[Observable](), set[Observable]()
    for name, value in (pair for scene in SCENES for pair in values_of(*scene).items()):
        (observable,) = {observable for observable in OBSERVABLES if observable.match(name)}
        assert name.endswith(observable.ending)
        assert describe(without_unit(name)) == observable, "a scene may leave the unit out"
        (unseen if isnan(value) else seen).add(observable)
    assert unseen == {observable for observable in OBSERVABLES if observable.gaps[0]}
    assert seen == set(OBSERVABLES)
    assert all(observable.definition for observable in OBSERVABLES)


def test_the_trace_of_a_run_is_freed_with_its_last_name() -> None:
    """Circles of references would keep it until a collection, which goes by the number of objects, not their bytes."""
    case = case_of("fig4")
    trace = exact(case).trace
    kept = ref(trace)
    gc.disable()
    try:
        observe(case.layout, trace)
        del trace
        assert kept() is None
    finally:
        gc.enable()


def test_a_name_gives_unit_and_kind() -> None:
    for name, unit, kind in (
        ("wall_peak_N", "N", "peak"), ("wall_peak_2", "N", "later peak"), ("speed_9_to_5_m_s", "m/s", "speed"),
        ("bead_12_width_0.2pct", "diameters", "width"), ("wall_envelope_per_s", "1/s", "rate"), ("wall_peek_N", "", ""),
    ):  # fmt: skip
        assert (describe(name).unit, describe(name).kind) == (unit, kind)
    names = ["force", "speed_9_to_5", "wall_peak", "bead_9_reflected_arrival", "bead_9_arrival", "wall_peak_2"]
    assert of_kind(names, "peak", "speed") == ["speed_9_to_5", "wall_peak"]


def test_missing_observables_are_counted_with_the_reason() -> None:
    rows = [{"wall_peak_2_N": nan, "bead_9_peak_N": 1.0}, {"wall_peak_2_N": nan}, {"wall_peak_2_N": 2.0}]
    assert not_shown(["wall_peak_2_N", "bead_9_peak_N"], rows) == [
        "wall_peak_2_N: not seen in 2 of 3 rows: the wall shows no such maximum before the end of the run",
        "bead_9_peak_N: not in 2 of 3 rows: their scenes have no such gauge",
    ]
    assert not_shown(["wall_peak_2_N"], rows[2:]) == []


LACKING = [("bead_9_peak_N", "chain.sensors=[]"), ("bead_9_reflected_arrival_s", "wall="), ("wall_peak_2_N", "wall="),
           ("bead_9_reflected_amplitude_N", "wall="),
           ("bead_5_width_4pct_diameters", "chain.sensors=[{from_wall=5}]"), ("energy_lost_J", "contact="),
           ("speed_9_to_5_m_s", "chain.sensors=[{from_wall=9},{from_wall=7},{from_wall=5}]")]  # fmt: skip


@pytest.mark.parametrize(("name", "setting"), LACKING)
def test_a_scene_lacks_an_observable_without_the_thing_that_it_needs(name: str, setting: str) -> None:
    rows = [values_of(*DAMPED), values_of(*DAMPED, setting)]
    assert [name in row for row in rows] == [True, False]
    line = not_shown([name], rows)[-1]
    assert line.endswith(f"not in 1 of 2 rows: their scenes have no {describe(name).gaps[1]}")
