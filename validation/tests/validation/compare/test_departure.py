"""First departures of runs from the exact motion, and their causes."""

import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from drivers.chain.case import Case
from drivers.chain.chain import Array
from drivers.chain.trace import Trace, until
from validation.__main__ import main
from validation.accuracy.baseline import baseline_of
from validation.accuracy.schemes import verlet_in_heights, verlet_of
from validation.compare.comparison import run_and_compare
from validation.compare.departure import (
    CHAOS,
    LEVELS,
    MODEL,
    NONE,
    SET_UP,
    TRUNCATION,
    UNKNOWN,
    Departure,
    departure,
    departure_rows,
)
from validation.stability.measured_limits import random_case
from validation.tests.helpers.runs import blown_up, finished
from validation.tests.helpers.scenes import case_of

WEIGHTLESS = "gravity=0 m/s^2"
BOUNCING = ("run.duration=20 ms", "run.sample_interval=5 us")
Change = Callable[[Array], Array]


def as_code(case: Case, **changes: Change) -> Trace:
    """Trace of a case as a code would compute it with some arrays of its chain changed."""
    arrays: dict[str, Any] = {name: change(getattr(case.chain, name).copy()) for name, change in changes.items()}
    changed = replace(case, chain=replace(case.chain, **arrays))
    return verlet_in_heights(changed)


def times(factor: float, body: int) -> Change:
    """Multiplies one body's value, counted from 1; -1 is the last."""

    def change(values: Array) -> Array:
        values[body if body < 0 else body - 1] *= factor
        return values

    return change


def test_one_bouncing_body_is_not_chaotic() -> None:
    long = (
        "run.duration=45 ms",
        "run.sample_interval=5 us",
        "run.time_step=0.5 us",
        "chain.count=0",
        "chain.sensors=[]",
    )
    case = case_of("fig4", "striker.speed=0.1 m/s", *long)
    found = departure(case, "yade", verlet_in_heights(case))
    assert {each.kind for each in (found, *found.later)} == {TRUNCATION}


@pytest.mark.parametrize(("step", "first_us"), [("1 us", 1), ("0.1 us", 12)])
def test_a_good_run_departs_by_truncation(step: str, first_us: float) -> None:
    case = case_of("fig4", f"run.time_step={step}")
    found = departure(case, "yade", as_code(case))
    assert (found.kind, found.contact) == (TRUNCATION, 22)
    assert found.time_s == pytest.approx(first_us * 1e-6)
    assert LEVELS[0] < found.share
    assert "as for velocity Verlet at this step" in found.words
    assert [each.kind for each in found.later] == [TRUNCATION] * (step == "1 us")


def test_the_exact_motion_never_departs() -> None:
    case = case_of("fig4")
    found = departure(case, "reference", baseline_of(case).exact)
    assert found.kind == NONE
    assert math.isnan(found.time_s)
    assert found.words.startswith("is the exact motion; exact to ")


def test_chaos_comes_after_reflections() -> None:
    """The step is so small that truncation stays below the first level until chaos amplifies it."""
    case = case_of("fig4", *BOUNCING, "run.time_step=10 ns")
    found = departure(case, "verlet", verlet_of(case))
    assert found.kind == CHAOS
    assert {each.kind for each in found.later} == {CHAOS}
    assert 4e-3 < found.time_s < 8e-3  # the wave comes to the wall at 0.5 ms
    coarse = case.at(50)
    kinds = [each.kind for each in _all(departure(coarse, "verlet", verlet_of(coarse)))]
    assert kinds[0] == TRUNCATION
    assert kinds[-1] == CHAOS
    assert kinds == sorted(kinds, reverse=True)


def test_truncation_stays_truncation_after_a_reflection() -> None:
    """Until half a millisecond rounding errors have only added up."""
    case = case_of("fig6b")
    found = departure(case, "verlet", verlet_of(case))
    (later,) = found.later
    assert (found.kind, later.kind) == (TRUNCATION, TRUNCATION)
    assert "exceeds 0.0001 of" in later.words
    assert later.time_s == pytest.approx(507e-6)


def test_rounding_separates_a_code_from_verlet_when_the_chain_is_chaotic(shared_runs: Path) -> None:
    """Rounding separates two runs by 1e-8 of the largest change at 8 ms and by 1 % at 20 ms, so by 1e-6 between."""
    case = case_of("fig4", *BOUNCING)
    found = departure(case, "liggghts", finished(case, "liggghts", shared_runs).trace)
    (parted,) = [each for each in _all(found) if "with other rounding" in each.words]
    assert parted.kind == CHAOS
    assert 8e-3 < parted.time_s < 16e-3


@pytest.mark.parametrize("scene", ["fig4", "fig5", "fig6b"])
def test_a_wrong_wall_law(scene: str) -> None:
    """Under gravity the force at time 0 is wrong; without gravity the fault shows when the wave arrives."""
    heavy, weightless = case_of(scene), case_of(scene, WEIGHTLESS)
    early = departure(heavy, "yade", as_code(heavy, stiffness=times(0.707, 1)))
    assert (early.kind, early.time_s, early.contact) == (SET_UP, 0.0, 1)
    assert "at time 0 contact 1 has" in early.words
    later = departure(weightless, "yade", as_code(weightless, stiffness=times(0.707, 1)))
    assert (later.kind, later.contact) == (MODEL, 1)
    wall = baseline_of(weightless).exact.force_N[:, 0]
    arrival = weightless.sample_times_s[int(np.argmax(wall > 1e-3 * wall.max()))]
    assert 0.8 * arrival < later.time_s <= arrival


@pytest.mark.parametrize(
    ("changes", "contact", "words"),
    [
        ({"mass_kg": times(1.05, -1)}, 0, "kinetic energy"),
        ({"velocity_m_s": times(0.0, -1)}, 0, "kinetic energy is 0 J"),
        ({"velocity_m_s": times(1 + 1e-7, -1)}, 0, "kinetic energy"),
        ({"load_N": lambda load: 0 * load}, 1, "before any wave arrives"),
        ({"overlap_m": lambda overlap: 0 * overlap}, 1, "at time 0 contact 1 has"),
    ],
)
def test_a_wrong_start(changes: dict[str, Change], contact: int, words: str) -> None:
    case = case_of("fig4")
    bent = as_code(case, **changes)
    if "overlap_m" in changes:  # heights come from the scene
        bent = verlet_of(replace(case, chain=replace(case.chain, overlap_m=0 * case.chain.overlap_m)))
    found = departure(case, "yade", bent)
    assert found.kind == SET_UP
    assert found.time_s <= case.sample_times_s[1]
    assert found.contact == contact
    assert words in found.words


def test_a_fault_at_the_first_change_of_a_force() -> None:
    case = case_of("fig4", WEIGHTLESS)
    found = departure(case, "yade", as_code(case, stiffness=times(1.1, -1)))
    assert (found.kind, found.contact, found.time_s) == (SET_UP, 22, case.sample_times_s[1])
    assert "at the first change of any force" in found.words


def test_a_wrong_sensor_mass_shows_when_the_wave_arrives() -> None:
    case = case_of("fig4")
    found = departure(case, "yade", as_code(case, mass_kg=times(1.05, 5)))
    assert found.kind == MODEL
    assert found.contact in (5, 6)
    assert 0.2e-3 < found.time_s < 0.45e-3


def test_forces_stamped_a_sample_late() -> None:
    case = case_of("fig4")
    good = as_code(case)
    late = np.vstack([good.force_N[:1], good.force_N[:-1]])
    found = departure(case, "yade", replace(good, force_N=late))
    assert (found.kind, found.contact) == (SET_UP, 22)


def test_velocities_of_another_time_change_no_force() -> None:
    case = case_of("fig4")
    good = as_code(case)
    energy = good.kinetic_energy_J.copy()
    energy[1:] = (energy[1:] + energy[:-1]) / 2
    found = departure(case, "yade", replace(good, kinetic_energy_J=energy))
    assert (found.kind, found.contact) == (MODEL, 0)
    assert "with correct forces" in found.words


@pytest.mark.parametrize("samples", [None, 300, 2])
def test_failed_runs_have_departures_too(samples: int | None) -> None:
    case = case_of("fig4")
    whole = departure(case, "yade", as_code(case, stiffness=times(0.7, 0)))
    found = departure(case, "yade", until(as_code(case, stiffness=times(0.7, 0)), samples or 801))
    assert (found.time_s, found.contact, found.kind) == (whole.time_s, whole.contact, SET_UP)
    good = as_code(case)
    torn = departure(case, "yade", until(good, samples or 801))
    assert torn.kind == (NONE if samples == 2 else TRUNCATION)
    assert not torn.later


def test_a_blow_up_is_found_where_it_begins() -> None:
    case = case_of("fig4")
    found = departure(case, "yade", blown_up(as_code(case), 200))
    assert found.time_s == pytest.approx(200e-6)
    assert found.kind == MODEL


def test_unknown_departures() -> None:
    trace = verlet_of(case_of("fig4"))
    long = case_of("fig4", "chain.count=20001", "chain.sensors=[]", "run.duration=2 us")
    assert departure(long, "yade", trace).kind == UNKNOWN
    assert "20000 bodies" in departure(long, "yade", trace).words
    coarse = case_of("fig4", "run.time_step=40 us", "run.sample_interval=40 us")
    assert departure(coarse, "yade", trace).kind == UNKNOWN
    assert "blows up" in departure(coarse, "yade", trace).words


def test_three_dimensional_runs_are_compared_with_their_own_law_of_friction() -> None:
    case = case_of("fig5-tube", "run.duration=0.2 ms")
    own, other = (verlet_of(case, law) for law in ("total", "incremental"))
    assert departure(case, "liggghts", own).kind == TRUNCATION
    assert departure(case, "yade", other).kind == TRUNCATION
    assert departure(case, "yade", own).kind in (MODEL, SET_UP)


def test_good_runs_of_random_scenes_are_not_at_fault() -> None:
    for number in range(20):
        case = random_case(number, accuracy=1e-4)
        found = departure(case, "yade", as_code(case))
        assert found.kind in (NONE, TRUNCATION, CHAOS), found.words
        assert found.words


def test_a_chain_that_rests() -> None:
    case = case_of("fig4", "striker=")
    assert departure(case, "yade", as_code(case)).kind == NONE


def test_departures_come_with_the_comparison(
    shared_runs: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    compared = run_and_compare("fig4", (WEIGHTLESS,), shared_runs)
    assert set(compared.departures) == set(compared.runs)
    rows = departure_rows(compared.departures)
    assert {engine for engine, _ in rows} == set(compared.runs)
    assert {each.kind for engine, each in rows if engine == "reference"} == {NONE}
    words = ["--set", WEIGHTLESS, "--runs", str(shared_runs), "--allow-missing"]
    monkeypatch.setattr("sys.argv", ["", "compare", "fig4", *words])
    assert main() == 0
    printed = capsys.readouterr().out
    assert all(each.words in printed for _, each in rows)


def _all(found: Departure) -> list[Departure]:
    return [found, *found.later]
