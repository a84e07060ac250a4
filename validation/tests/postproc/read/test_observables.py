"""Every number of a run is declared with its unit and kind, and belongs to the wave in its name."""

from math import isnan

import pytest

from postproc.paper.simulate import exact
from postproc.read.observables import OBSERVABLES, Observable, describe, not_shown, observe, of_kind, without_unit
from validation.tests.helpers.scenes import case_of

SCENES = (
    ("fig4",), ("fig5", "contact.restitution=0.9"), ("fig5", "sensor.time_constant=1 ms"), ("steel-chain", "wall="),
    ("fig6d", "chain.sensors=[{from_wall=14}, {from_wall=8}]", "run.duration=0.6 ms"),
)  # fmt: skip


@pytest.mark.parametrize("scene", SCENES)
def test_every_observable_of_a_run_is_declared_once_and_ends_in_its_unit(scene: tuple[str, ...]) -> None:
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
def test_a_name_gives_unit_and_kind(name: str, unit: str, kind: str) -> None:
    assert (describe(name).unit, describe(name).kind) == (unit, kind)


def test_names_are_chosen_by_kind_in_their_order() -> None:
    names = ["force", "speed_9_to_5", "wall_peak", "bead_9_reflected_arrival", "bead_9_arrival", "wall_peak_2"]
    assert of_kind(names, "peak", "speed") == ["speed_9_to_5", "wall_peak"]
    assert of_kind(names, "arrival") == ["bead_9_arrival"]


@pytest.mark.parametrize(("mass", "speed", "places"), [("0.5 g", "0.89 m/s", (14, 8)), ("1 g", "0.3 m/s", (15, 6))])
def test_a_train_is_distinguished_from_its_reflection(mass: str, speed: str, places: tuple[int, int]) -> None:
    """Reflected waves go up at the speed of a wave; there are no more pulses than in a long chain."""
    upper, lower = places
    sensors = "chain.sensors=[{from_wall=%d}, {from_wall=%d}]" % places  # noqa: UP031 - braces are TOML's
    strike = (f"striker.mass={mass}", f"striker.speed={speed}", "run.duration=2.4 ms")
    case = case_of("fig6d", sensors, *strike)
    values = observe(case.layout, exact(case).trace)
    climb = values[f"bead_{upper}_reflected_arrival_s"] - values[f"bead_{lower}_reflected_arrival_s"]
    back = (upper - lower) * case.scene.chain.diameter / climb
    assert 0.8 < back / values[f"speed_{upper}_to_{lower}_m_s"] < 1.6
    assert values[f"bead_{lower}_reflected_arrival_s"] > values["wall_arrival_s"]
    far = case_of("fig6d", f"chain.count={40 + 18}", sensors.replace(str(upper), str(40 + upper)), *strike)
    seen = observe(far.layout, exact(far).trace)
    assert 3 <= values[f"bead_{upper}_pulses"] <= seen[f"bead_{40 + upper}_pulses"]
    assert seen[f"bead_{40 + upper}_pulses"] >= 8


@pytest.mark.parametrize(("mass", "share"), [("0.2452 g", 0.142), ("0.4904 g", 0.387)])
def test_the_second_wave_of_a_train_has_its_known_share_of_the_first(mass: str, share: float) -> None:
    """Strikers of two and four bead masses; the contacts are open between the waves, and the front comes first."""
    case = case_of("wave-train", "chain.sensors=[{from_wall=20}]", f"striker.mass={mass}")
    values = observe(case.layout, exact(case).trace)
    first, second = values["bead_20_amplitude_N"], values["bead_20_second_amplitude_N"]
    assert second / first == pytest.approx(share, abs=5e-4)
    assert 0 <= values["bead_20_valley_N"] < 1e-5 * first
    assert values["bead_20_front_arrival_s"] < values["bead_20_arrival_s"] < values["bead_20_second_arrival_s"]
    assert "contact_loss_s" not in values, "nothing is pressed together at time 0"


def test_a_strong_wave_opens_contacts_behind_it_and_a_weak_one_does_not() -> None:
    strong = case_of("fig4")
    weak = case_of("fig4", "striker.speed=1 cm/s", "chain.precompression=1 N")
    assert 0 < observe(strong.layout, exact(strong).trace)["contact_loss_s"] < 8e-4
    assert isnan(observe(weak.layout, exact(weak).trace)["contact_loss_s"])


@pytest.mark.parametrize("weak", [0.2, 0.05, 0.005])
def test_a_weak_wave_before_a_strong_one_is_the_first(weak: float) -> None:
    """The gauges show two strikes; force and speed are those of the first."""
    beads = "[{from_wall=40, velocity='-2 m/s', gap_below='3 mm'}, {from_wall=39, velocity='-%g m/s'}]" % weak  # noqa: UP031
    settings = ("chain.count=40", "striker=", "chain.sensors=[{from_wall=30}, {from_wall=20}]", f"chain.bead={beads}")
    case = case_of("fig4", "gravity=", "run.duration=4 ms", *settings)
    values = observe(case.layout, exact(case).trace)
    alone = case_of("fig4", "gravity=", "run.duration=4 ms", *settings[:3], settings[3].replace("-2 m/s", "0 m/s"))
    first = observe(alone.layout, exact(alone).trace)
    for name in ("bead_30_amplitude_N", "bead_20_amplitude_N", "bead_30_arrival_s", "speed_30_to_20_m_s"):
        assert values[name] == pytest.approx(first[name], rel=1e-6)
    assert values["bead_30_pulses"] == 2
    assert first["bead_30_pulses"] == 1


def test_observables_that_a_run_does_not_show_are_nan() -> None:
    """Strikes from both ends give no speed between gauges; at bead 1 a wave and its reflection coincide."""
    ends = "chain.bead=[{from_wall=21, velocity='-1 m/s'}, {from_wall=1, velocity='1 m/s'}]"
    sensors = "chain.sensors=[{from_wall=18}, {from_wall=15}, {from_wall=5}, {from_wall=1}]"
    case = case_of("fig4", "gravity=", "striker=", "wall=", ends, sensors)
    values = observe(case.layout, exact(case).trace)
    assert isnan(values["speed_15_to_5_m_s"])
    assert isnan(values["transmission_15_to_5"])
    assert values["transmission_18_to_15"] == pytest.approx(1, abs=0.01)
    case = case_of("fig4", sensors)
    values = observe(case.layout, exact(case).trace)
    assert isnan(values["bead_1_reflected_amplitude_N"])
    assert values["bead_5_reflected_amplitude_N"] > 1


def test_each_observable_that_may_be_nan_has_a_reason_and_no_other() -> None:
    """Until 20 us no gauge shows a pulse; so no observable of a pulse is seen, and all others are."""
    unseen, seen = set[Observable](), set[Observable]()
    for scene in (*SCENES, ("fig4", "run.duration=20 us")):
        case = case_of(*scene)
        for name, value in observe(case.layout, exact(case).trace).items():
            (unseen if isnan(value) else seen).add(describe(name))
    assert unseen == {observable for observable in OBSERVABLES if observable.gaps[0]}
    assert seen == set(OBSERVABLES)


def test_rows_that_do_not_show_an_observable_are_counted_with_the_reason() -> None:
    nan = float("nan")
    rows = [{"wall_peak_2_N": nan, "bead_9_peak_N": 1.0}, {"wall_peak_2_N": nan}, {"wall_peak_2_N": 2.0}]
    assert not_shown(["wall_peak_2_N", "bead_9_peak_N"], rows) == [
        "wall_peak_2_N: not seen in 2 of 3 rows: the wall shows no such maximum before the end of the run",
        "bead_9_peak_N: not in 2 of 3 rows: their scenes have no such gauge",
    ]
    assert not_shown(["wall_peak_2_N"], rows[2:]) == []


LACKING = [("bead_9_peak_N", "chain.sensors=[]"), ("bead_9_reflected_arrival_s", "wall="), ("wall_peak_2_N", "wall="),
           ("bead_5_width_4pct_diameters", "chain.sensors=[{from_wall=5}]"), ("energy_lost_J", "contact="),
           ("speed_9_to_5_m_s", "chain.sensors=[{from_wall=9},{from_wall=7},{from_wall=5}]")]  # fmt: skip


@pytest.mark.parametrize(("name", "setting"), LACKING)
def test_a_scene_without_the_thing_that_an_observable_needs_does_not_have_it(name: str, setting: str) -> None:
    damped = ("fig4", "contact.restitution=0.9", "run.duration=0.3 ms")
    cases = [case_of(*damped), case_of(*damped, setting)]
    rows = [observe(case.layout, exact(case).trace) for case in cases]
    assert [name in row for row in rows] == [True, False]
    (line,) = (line for line in not_shown([name], rows) if "not in 1 of 2 rows" in line)
    assert line.endswith(f"their scenes have no {describe(name).gaps[1]}")
